"""An arm: an estimator and a controller in an environment, and what can be tuned of both."""

from contextlib import closing
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from agents.agent import load_agent
from agents.controllers import controller_factory, is_controller
from agents.rollouts import batch
from agents.studies.worlds import environment_options, registered_id, system_of
from estimators.factory import unknown
from estimators.tunable import Linear, Log, defaults
from vessel_gym.checks import one_of
from vessel_gym.models.estimation import ENVIRONMENT_ONLY
from vessel_gym.simulation.configuration import Configuration, Options
from vessel_gym.system import System

NOISE = Log(0.001, 1000.0)
"""Range of a factor on Q or on a sensor's R."""

NO_LIKELIHOOD = "huber-kf", "huber-kf-nonlinear", "robust-kf", "steady-kf"
"""Filters in which S is not the covariance of the innovations."""

SCORE, LIKELIHOOD = "score", "likelihood"
"""What is maximised: the task's score, or the likelihood of the measurements."""

Values = dict[str, float]
"""Values of parameters by name."""


@dataclass(frozen=True)
class Parameter:
    """A parameter that can be tuned: its range, and its value as delivered."""

    range: Linear
    value: float


@dataclass(frozen=True)
class Arm:
    """An estimator and a controller, tuned together for some conditions.

    Attributes:
        env_id: A registered environment, or ``"module:id"``.
        agent: As for `agents.load_agent`.
        options: Options of the environment that all conditions share, among them the estimator.
        conditions: Further options of each condition; the mean score over all of them is tuned.
        picked: Names of the parameters to tune, or beginnings of them such as ``"estimator"``.
            Empty: all but the factor on Q, of which the filter's gain depends only through its
            ratio to R.
        by: What is maximised. By "likelihood", it is that of the measurements. Factors on Q and R
            are then tuned alone, all of them unless some are picked.

    Raises:
        ValueError: for parameters that are not there, or an arm that has nothing to tune.
    """

    env_id: str
    agent: str = "autopilot"
    options: dict[str, Any] = field(default_factory=dict)
    conditions: tuple[dict[str, Any], ...] = ({},)
    picked: tuple[str, ...] = ()
    by: str = SCORE

    @cached_property
    def worlds(self) -> list[dict[str, Any]]:
        """Options of the environment in each condition, as it takes them."""
        return [environment_options(self.env_id, self.options | each) for each in self.conditions]

    @cached_property
    def system(self) -> Any:
        """The environment's system."""
        return system_of(self.env_id)

    @cached_property
    def configurations(self) -> list[Configuration]:
        """`Configuration` in each condition; none for an environment of another package.

        Raises:
            ValueError: for another vessel, or conditions with other sensors, whose R has other
                names.
        """
        if not isinstance(self.system, System):
            return []
        if "vessel" in self.options:
            raise ValueError(
                "only the vessel of a registered environment can be tuned: register an environment"
                " with yours, and name it as module:id"
            )
        found = [Configuration(self.system, Options(**world)) for world in self.worlds]
        if len(names := {tuple(s.name for s in each.sensors.each) for each in found}) > 1:
            every = " and ".join(", ".join(each) for each in sorted(names))
            raise ValueError(f"all conditions of a tuning need equal sensors, got {every}")
        return found

    @cached_property
    def by_rows(self) -> list[Configuration]:
        """`Configuration` in each condition whose filter has its parameters as data of its rows.

        Candidates then share programs. It is empty where they cannot.
        """
        for each in self.configurations:
            filter, fuses = each.estimation.filter, each.estimation.fuses
            ours = type(filter).__module__.startswith(("estimators.", "vessel_gym."))
            if not ours or not filter.varies_by_row or fuses or each.raw is not None:
                return []
        return [Configuration(self.system, each.options, True) for each in self.configurations]

    @cached_property
    def every(self) -> dict[str, Parameter]:
        """All parameters that can be tuned, by name."""
        return self._of_estimator() | self._of_agent()

    @property
    def delivered(self) -> Values:
        """Values of all parameters as delivered."""
        return {name: each.value for name, each in self.every.items()}

    @cached_property
    def parameters(self) -> dict[str, Parameter]:
        """Parameters that are tuned, by name."""
        one_of("by", self.by, (SCORE, LIKELIHOOD))
        by_score = self.by == SCORE
        found = self.every if by_score else self._of_likelihood()
        if not found:
            raise ValueError(f"{self.agent} on {self.estimator} has nothing that can be tuned")
        if not self.picked:
            return {n: each for n, each in found.items() if not by_score or n != "estimator.Q"}
        chosen: set[str] = set()
        for name in self.picked:
            matching = {each for each in found if f"{each}.".startswith(f"{name}.")}
            if not matching:
                raise ValueError(unknown("parameter", name, found))
            chosen |= matching
        return {name: each for name, each in found.items() if name in chosen}

    def _of_likelihood(self) -> dict[str, Parameter]:
        """Factors on Q and R, if the filter has a likelihood and its candidates share a batch."""
        noise = {name: each for name, each in self._of_estimator().items() if is_noise(name)}
        if not noise or not self.by_rows or self.estimator in NO_LIKELIHOOD:
            raise ValueError(
                f"{self.estimator} cannot be tuned by likelihood: tune it by the score"
            )
        return noise

    @property
    def estimator(self) -> str:
        """Name of the estimator."""
        chosen = self.options.get("estimator") or self.system.estimator
        return chosen if isinstance(chosen, str) else chosen.__name__

    def _of_estimator(self) -> dict[str, Parameter]:
        """Factors on Q and on the R of each sensor, and the filter's own parameters."""
        if not self.configurations or self.estimator in ENVIRONMENT_ONLY:
            return {}
        filter = self.configurations[0].estimation.filter
        sensors = self.configurations[0].sensors.each
        given = (self.options.get("estimator_options") or {}).get("assume") or {}
        R = given.get("R", {})
        factors = {"Q": given.get("Q", 1.0)} | {
            f"R.{each.name}": R.get(each.name, 1.0) if isinstance(R, dict) else R
            for each in sensors
        }
        found = {name: Parameter(NOISE, value) for name, value in factors.items()}
        for name, range in filter.tunable.items():
            if not hasattr(filter, name):
                raise ValueError(f"{self.estimator} needs an attribute {name}, which is tunable")
            found[name] = Parameter(range, getattr(filter, name))
        return {f"estimator.{name}": each for name, each in found.items()}

    def _of_agent(self) -> dict[str, Parameter]:
        """The controller's parameters."""
        if not is_controller(self.agent, self.system):
            return {}
        factory: Any = controller_factory(self.agent, self.system)
        values = defaults(self.agent, factory)
        return {f"agent.{n}": Parameter(factory.tunable[n], value) for n, value in values.items()}

    def estimator_options(self, values: Values) -> dict[str, Any]:
        """Options of the estimator with some values of its parameters."""
        options = dict(self.options.get("estimator_options") or {})
        assume = dict(options.get("assume") or {})
        for name, value in under("estimator.", values).items():
            if name.startswith("R."):
                assume["R"] = under("estimator.R.", self.delivered | values)
            elif name == "Q":
                assume["Q"] = value
            else:
                options[name] = value
        return options | ({"assume": assume} if assume else {})

    @cached_property
    def _env(self) -> Any:
        """A closed environment, of whose system and spaces agents are made."""
        with closing(batch(registered_id(self.env_id), 1, self.worlds[0])) as env:
            return env

    def made_agent(self, values: Values) -> Any:
        """The agent with some values of its parameters."""
        return load_agent(self.agent, self._env, under("agent.", values))


def is_noise(name: str) -> bool:
    """Is a parameter a factor on Q or R?"""
    return name == "estimator.Q" or name.startswith("estimator.R.")


def under(prefix: str, values: Values) -> Values:
    """Values whose names have a prefix, by the rest of the name."""
    return {n.removeprefix(prefix): v for n, v in values.items() if n.startswith(prefix)}
