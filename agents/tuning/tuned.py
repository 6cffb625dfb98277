"""Tuned parameters as a file: what was tuned, for what, by which seeds, and what it gained."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from agents.agent import load_agent
from agents.files import write_tables
from agents.studies.worlds import registered_id
from agents.tuning.arm import Arm, Values, under
from vessel_gym.toml_file import TomlFile

_ARM = {
    "env_id": str, "agent": str, "options": dict, "conditions": list, "picked": list,
    "by": str,
}  # fmt: skip
"""Keys of the table ``arm``, and their types."""


@dataclass(frozen=True)
class Tuned:
    """Parameters of an estimator and a controller that were tuned together.

    Attributes:
        arm: What was tuned.
        values: Value of each parameter, by name.
        made_by: Versions, source, seeds and evaluations.
        found: Scores and other results of the tuning.
    """

    arm: Arm
    values: Values
    made_by: dict[str, Any] = field(default_factory=dict)
    found: dict[str, Any] = field(default_factory=dict)

    @property
    def env_options(self) -> dict[str, Any]:
        """Estimator and its options, as keywords of `gymnasium.make`."""
        own = self.arm.estimator_options(self.values)
        options = {"estimator_options": own} if own else {}
        chosen = self.arm.worlds[0].get("estimator", self.arm.estimator)
        return {"estimator": chosen} | options

    def agent(self) -> Any:
        """The controller with its tuned parameters, for `agents.rollout`."""
        return self.arm.made_agent(self.values)

    def agent_in(self, env: Any) -> Any:
        """The controller with its tuned parameters, for an environment or a batch.

        Raises:
            ValueError: for an environment or a vessel that was not tuned, or observations that the
                controller cannot use.
        """
        if getattr(env.unwrapped, "system", self.arm.system) is not self.arm.system:
            raise ValueError(
                f"these parameters were tuned for {self.arm.env_id}, not for this environment or"
                " vessel"
            )
        return load_agent(self.arm.agent, env, under("agent.", self.values))

    def options_for(self, env_id: str, given: dict[str, Any]) -> dict[str, Any]:
        """Options of an environment with the tuned estimator in place of its own.

        Args:
            env_id: Environment.
            given: Its other options.

        Raises:
            ValueError: for an environment, vessel, sensors, estimator or options of the estimator
                that were not tuned.
        """
        arm, plain = self.arm, "as registered"
        suites = [(arm.options | each).get("sensors", "nominal") for each in arm.conditions]
        own = arm.options.get("estimator_options") or {}
        asked = {
            "environment": (registered_id(env_id), [registered_id(arm.env_id)]),
            "vessel": (given.get("vessel", plain), [plain]),
            "sensors": (given.get("sensors", "nominal"), suites),
            "estimator": (given.get("estimator", arm.estimator), [arm.estimator]),
            "estimator options": (given.get("estimator_options", own), [own]),
        }
        for what, (chosen, known) in asked.items():
            if chosen not in known:
                names = " or ".join(map(str, dict.fromkeys(map(str, known))))
                raise ValueError(
                    f"these parameters were tuned for {what} {names}, not for {chosen}: tune for"
                    " that, or leave out the tuned file"
                )
        return dict(given) | self.env_options

    def write(self, path: str | Path) -> None:
        """Write the file.

        Raises:
            TypeError: for a class or another object among the options.
            OSError: if the file cannot be written.
        """
        arm = {key: getattr(self.arm, key) for key in _ARM}
        comment = "Written by `vessel-gym tune`; see [made_by] for what it follows from."
        write_tables(Path(path), comment, vars(self) | {"arm": arm})


def load_tuned(path: str | Path) -> Tuned:
    """The tuned parameters in a file that `vessel-gym tune` has written.

    Args:
        path: File.

    Raises:
        ValueError: for a file that is no such file, or is of an environment that is not there.
        OSError: if it cannot be read.
    """
    file = TomlFile(Path(path))
    tables: list[Any] = [file.data.get(name) for name in ("arm", "values", "made_by", "found")]
    whole = all(isinstance(each, dict) for each in tables)
    arm, values, *rest = tables
    whole = whole and all(isinstance(arm.get(key), kind) for key, kind in _ARM.items())
    if not whole or not all(isinstance(each, float) for each in values.values()):
        raise ValueError(f"{path} is no file of tuned parameters, as vessel-gym tune writes it")
    arm |= {key: tuple(arm[key]) for key in ("conditions", "picked")}
    arm["options"] = {key: _without_none(value) for key, value in arm["options"].items()}
    return Tuned(Arm(**{key: arm[key] for key in _ARM}), values, *rest)


def _without_none(value: Any) -> Any:
    """A value or table in which ``"none"`` is None."""
    if isinstance(value, dict):
        return {key: _without_none(each) for key, each in value.items()}
    return None if value == "none" else value
