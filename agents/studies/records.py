"""Records of a study: what is compared, where, by which agents and in which conditions."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from agents.page import listed
from agents.seeds import evaluation_seeds

ORACLE, FLOOR = "truth", "dead-reckoning"
"""Estimators that are always run: the normalised scores of the classical agent on them are 1, 0."""
ENDS = (ORACLE, FLOOR)
MEASUREMENT = "measurement"
"""Estimator that passes on raw measurements (zero-order hold): no filter, as `ENDS` are none."""
DEFAULT = "default"
"""Stands for an environment's own default estimator."""
RAW = "raw measurements"
"""Name of the estimator of agents that observe measurements instead of estimates."""


def beyond_the_truth(found: Sequence[str], who: str) -> str:
    """A warning that an agent scores more on some estimators than on the truth, beyond chance."""
    text = "beats the truth beyond chance: check the task's score, and what its reward pays for"
    return f"On {listed(found)} {who} {text}."


class _Somewhere:
    environments: tuple[str, ...]

    def is_in(self, environment: str) -> bool:
        """Is it used in an environment?"""
        return not self.environments or environment in self.environments


@dataclass(frozen=True)
class Estimator(_Somewhere):
    """An estimator of a study.

    Attributes:
        name: In the study.
        estimator: What an environment calls it; ``"default"``; or ``"module:object"``, your own.
        options: Its options, over the environment's tuning. ``"none"`` stands for None, which TOML
            lacks.
        environments: Where it is flown; empty: everywhere.
    """

    name: str
    estimator: str = ""
    options: dict[str, Any] = field(default_factory=dict)
    environments: tuple[str, ...] = ()


@dataclass(frozen=True)
class Agent(_Somewhere):
    """An agent of a study.

    Attributes:
        name: In the study.
        kind: ``"ppo"``; a controller that is registered for the environment's task, such as
            ``"autopilot"`` (see `agents.controllers`); or ``"module:object"``: your own, called
            with the environment's `System`.
        observe: What a PPO sees: ``"mean"``, ``"mean+std"``, or ``"measurement"``: raw
            measurements, no estimator.
        memory: Of a PPO: ``"none"``, ``"frames"`` or ``"lstm"``.
        trained_on: The estimators that it is trained on, one policy each; not for raw measurements.
        flown_on: Estimators that it flies besides those of its training; empty: all. Not for raw
            measurements.
        steps: Environment steps of a training run, by environment; where there is none: the tuned
            budget.
        environments: Where it flies; empty: everywhere.
        settings: Of a PPO: hyperparameters over the tuned ones, see
            `agents.training.algorithms.hyperparameters`.
    """

    name: str
    kind: str = ""
    observe: str = "mean"
    memory: str = "none"
    trained_on: tuple[str, ...] = (DEFAULT,)
    flown_on: tuple[str, ...] = ()
    steps: dict[str, int] = field(default_factory=dict)
    environments: tuple[str, ...] = ()
    settings: dict[str, Any] = field(default_factory=dict)

    @property
    def learned(self) -> bool:
        """True for an agent that has to be trained."""
        return self.kind == "ppo"

    @property
    def raw(self) -> bool:
        """True for an agent that sees measurements instead of estimates."""
        return self.observe == MEASUREMENT

    @property
    def schools(self) -> tuple[str, ...]:
        """The estimators that it is trained on, one policy each."""
        return (RAW,) if self.raw else self.trained_on

    def policy(self, school: str) -> str:
        """Name of the policy that is trained on an estimator."""
        return self.name if self.raw else f"{self.name} trained on {school}"


@dataclass(frozen=True)
class Condition(_Somewhere):
    """A condition of the world.

    Attributes:
        name: In the study.
        sensors: Sensor suite; ``"module:object"``: a list of sensors of one's own; or the grade of
            each sensor by its name, perhaps at a rate, such as ``{"receiver": "SBAS at 0.5 Hz"}``:
            sensors that are not named are nominal, and those that an environment lacks are ignored
            there.
        disturbance: Sea, water or air by name, or ``"module:object"``: one's own.
        mismatch: Relative spread of the truth's parameters around the filters'.
        latency: Seconds by which sensors are late, by name; an environment has those of them that
            it has.
        faults: Faults of sensors by their names: fields of a
            `vessel_gym.sensor_faults.SensorFault` each.
        environments: Environments that have it; empty: all of them.
    """

    name: str
    sensors: str | dict[str, str] = "nominal"
    disturbance: str = "moderate"
    mismatch: float = 0.0
    latency: dict[str, float] = field(default_factory=dict)
    faults: tuple[dict[str, Any], ...] = ()
    environments: tuple[str, ...] = ()

    @property
    def options(self) -> dict[str, Any]:
        """As options of an environment, see `agents.studies.worlds.environment_options`."""
        names = ("sensors", "disturbance", "mismatch", "latency", "faults")
        return {name: getattr(self, name) for name in names}


@dataclass(frozen=True)
class Tuning:
    """Tuning of the classical agents with every estimator, before they are compared.

    Attributes:
        evaluations: Largest number of candidates, the same for every arm.
        episodes: Tuning seeds of a candidate in each condition.
        tunings: Tunings of each arm, with their own seeds: the unit of resampling.
        conditions: Names of the conditions for whose mean score an arm is tuned once, to be used in
            all conditions; empty: the first; ``"each"`` alone: it is tuned for each condition.
        by: What is maximised, see `agents.tuning.arm.Arm`.
    """

    evaluations: int = 100
    episodes: int = 40
    tunings: int = 3
    conditions: tuple[str, ...] = ()
    by: str = "score"


EACH = "each"
"""Stands for the tuning for each condition."""
TUNED = "tuned"
"""End of the name of an agent that is tuned."""


@dataclass(frozen=True)
class Study:
    """A study: environments, estimators, agents and conditions.

    Attributes:
        title: The question, in a line.
        environments: Registered with Gymnasium; ``"module:id"`` imports the module first.
        estimators: What is compared; `ORACLE` and `FLOOR` are always there.
        agents: Who flies; the autopilot always does, where there is one.
        conditions: Agents are trained in the first, which is flown in every environment.
        episodes: Evaluation seeds, the same for everybody.
        training_seeds: Training runs of each learned agent: the unit of resampling.
        first_seed: The first evaluation seed, see `agents.seeds.evaluation_seeds`.
        margin: Of equivalence: smaller differences of the normalised score do not matter.
        termination: One of `vessel_gym.simulation.configuration.TERMINATIONS`: what ends a
            mission, for all agents and both ends of the scale alike.
        tune: How classical agents and estimators are tuned together; None: not at all.
        compare_to: The estimator that the others are compared with; empty, or where an environment
            lacks it: the first. The reference of conditions is the first.
    """

    title: str
    environments: tuple[str, ...]
    estimators: tuple[Estimator, ...]
    agents: tuple[Agent, ...]
    conditions: tuple[Condition, ...]
    episodes: int = 100
    training_seeds: int = 10
    first_seed: int = 0
    margin: float = 0.01
    termination: str = "belief"
    tune: Tuning | None = None
    compare_to: str = ""

    @property
    def filters(self) -> list[str]:
        """Names of the estimators that are filters."""
        return [e.name for e in self.estimators if e.estimator not in (*ENDS, MEASUREMENT)]

    @property
    def seeds(self) -> list[int]:
        """The evaluation seeds."""
        return evaluation_seeds(self.episodes, self.first_seed)
