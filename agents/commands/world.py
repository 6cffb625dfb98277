"""Options of an environment on the command line."""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class World:
    """Options of an environment, beside its estimator.

    Attributes:
        estimator_options: Options of the estimator, as name=value, e.g. members=50.
        sensors: clean, nominal, degraded, budget or denied.
        disturbance: calm, moderate or rough.
        mismatch: Relative spread of the truth's parameters.
        observe: mean, mean+std or measurement.
        guidance: Observe the mission relative to the reference; without it the state alone.
        termination: Who ends a mission: task or belief; the environment's default if not given.
        vessel: Vehicle file, or the name of one that comes with the package, for environments that
            take one.
    """

    estimator_options: tuple[str, ...] = ()
    sensors: str = "nominal"
    disturbance: str = "moderate"
    mismatch: float = 0.0
    observe: str = "mean"
    guidance: bool = True
    termination: str | None = None
    vessel: str | None = None

    def options(self, estimator: str | None = None) -> dict[str, Any]:
        """Keyword arguments of `gymnasium.make`; without an estimator the environment's own.

        Raises:
            ValueError: for an unknown kind of observation, or estimator options of another form.
        """
        from vessel_gym.checks import one_of

        one_of("--observe", self.observe, ("mean", "mean+std", "measurement"))
        options = assigned("--estimator-options", self.estimator_options) or None
        guidance = None if self.guidance else False
        given = vars(self) | {
            "estimator": estimator,
            "estimator_options": options,
            "guidance": guidance,
        }
        return {name: value for name, value in given.items() if value is not None}


def assigned(option: str, words: Sequence[str]) -> dict[str, Any]:
    """Values by name, of words as name=value; a value is TOML, or else a text.

    Raises:
        ValueError: for a word of another form.
    """
    values = {}
    for word in words:
        name, _, text = word.partition("=")
        if not (name and text):
            raise ValueError(f"{option} takes words as name=value, got {word!r}")
        try:
            values[name] = tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            values[name] = text
    return values
