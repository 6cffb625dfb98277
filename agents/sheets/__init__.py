"""Score sheets: what episodes of a kind of task are measured by, registered beside the figures that they need.

Every task has a score, a return, steps, the error of an estimated unknown input, NEES and failed updates. A sheet adds
what its task is about; without one, a task is also measured by how well each component of the state was estimated.
"""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from agents.metrics import INPUT, NEES, RETURN, SCORE, STEPS, UNHEALTHY, WATCHED, Metric, rmse
from agents.rollouts import Rollout
from vessel_gym.estimation import build, chosen_disturbance
from vessel_gym.registry import Registry
from vessel_gym.system import System

Figures = Callable[[Rollout], dict[str, np.ndarray]]
"""Several numbers of every episode of a rollout, ``(N,)`` by key."""


@dataclass(frozen=True)
class Sheet:
    """What episodes are measured by.

    Attributes:
        metrics: In the order in which they are worth reading.
        figures: Those that do not say how they are found; None if all do.
    """

    metrics: tuple[Metric, ...]
    figures: Figures | None = None

    def scores(self, rollout: Rollout) -> dict[str, np.ndarray]:
        """Every metric of every episode, ``(N,)`` by key; where a monitor watches, what it has found, too."""
        found = {} if self.figures is None else self.figures(rollout)
        every = (*self.metrics, *(WATCHED if "alarms" in rollout.history else ()))
        return {m.key: found[m.key] if m.of is None else m.of(rollout) for m in every}


def _ours() -> None:
    from agents.sheets import dive, flight, track, turning  # noqa: F401


SHEETS: Registry[Sheet] = Registry("score sheet", _ours)


def register_scores(task_type: type, metrics: Sequence[Metric], figures: Figures | None = None) -> None:
    """Say what episodes of a kind of task are measured by; subclasses inherit it.

    Args:
        task_type: The class of the task.
        metrics: Beside score, return, steps, the input's error, NEES and failed updates, which every task has; one with
            the key ``"steps"`` or ``"input_rmse"`` stands for these.
        figures: Those of the metrics that have no ``of``: a function of a `Rollout` that gives ``(N,)`` by key.

    Raises:
        TypeError: for a task type that is no class, or metrics that are none.
        ValueError: if there is no way to find a metric, two have one key, or the task has a sheet from elsewhere.
    """
    metrics = tuple(metrics)
    if not all(isinstance(m, Metric) for m in metrics):
        raise TypeError(f"a score sheet is made of metrics, got {metrics!r}")
    for m in metrics:
        if m.of is None and figures is None:
            raise ValueError(f"nothing says how {m.key!r} is found: give the metric an `of`, or the sheet its figures")
    own = [m.key for m in metrics]
    steps, inputs = (() if m.key in own else (m,) for m in (STEPS, INPUT))
    every = (SCORE, RETURN, *steps, *metrics, *inputs, NEES, UNHEALTHY)
    keys = [m.key for m in every]
    if len(set(keys)) < len(keys):
        raise ValueError(f"the metrics of a score sheet need keys of their own, got {', '.join(keys)}")
    SHEETS.register(task_type, Sheet(every, figures), sys._getframe(1).f_globals.get("__name__", ""))


def sheet_of(system: System) -> Sheet:
    """The score sheet of a system's task; for a task without one, what every task and every estimate has."""
    found = SHEETS.of(system.task)
    if found:
        return found[""]
    errors = (
        Metric(
            f"{name.replace(' ', '_')}_rmse", name, "", "lower", 4, f"RMS error of the estimated {name} [SI].",
            of=rmse(name),
        )
        for name in _estimated(system)
    )  # fmt: skip
    return Sheet((SCORE, RETURN, STEPS, *errors, INPUT, NEES, UNHEALTHY))


def _estimated(system: System) -> tuple[str, ...]:
    """What filters estimate that nobody tells otherwise, whatever acts: of the vehicle, that, its sensors' biases."""
    widest, sensors = {"model": system.vehicle.kinds[0]}, system.sensors_of("nominal")
    disturbances = (chosen_disturbance(system, name) for name in system.disturbances)
    first, *others = (
        build(system, "dead-reckoning", widest, sensors, acting).composition.names for acting in disturbances
    )
    return tuple(name for name in first if all(name in names for names in others))
