"""Metrics of episodes, registered for classes of tasks.

Every task has these metrics: score, return, steps, RMS error of the estimated unknown input, NEES
and failed updates. A vehicle with an attribute ``steering`` also has travel, reversals and
saturation of its actuators. `register_metrics` adds a task's own metrics. A task without its own
has the RMS error of each estimated component of the state instead.

For contributors: `agents.metrics` may import rollouts and statistics; studies, pages of episodes
and commands import `agents.metrics`.
"""

import sys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from agents.metrics.costs import STEERING
from agents.metrics.metric import (
    INPUT,
    NEES,
    RETURN,
    SCORE,
    STEPS,
    UNHEALTHY,
    Metric,
    components,
    consistency,
    ended,
    nees_of,
    rmse,
)
from agents.rollouts import Rollout
from agents.statistics import Interval, crossed_interval, share_interval
from agents.wrapped import Wrapped
from vessel_gym.models.estimation import build, chosen_disturbance
from vessel_gym.registry import Registry
from vessel_gym.system import System

__all__ = [
    "NEES",
    "SCORE",
    "STEERING",
    "UNHEALTHY",
    "Metric",
    "components",
    "consistency",
    "ended",
    "mean",
    "metrics",
    "nees_of",
    "register_metrics",
    "rmse",
    "scores",
]  # fmt: skip


def _ours() -> None:
    from agents.metrics import dive, flight, turning  # noqa: F401


_OWN_SCORE = replace(
    SCORE, meaning="The environment's own score; the return where it has none.", decimals=1
)

TASK_METRICS: Registry[tuple[Metric, ...]] = Registry("metrics", _ours)


def register_metrics(task_type: type, metrics: Sequence[Metric]) -> None:
    """Register the metrics of a class of tasks; subclasses inherit them.

    Args:
        task_type: The class of the task.
        metrics: The task's own metrics, besides those of every task (see `agents.metrics`). A
            metric with the key of one of those replaces it. To keep the metrics of a parent
            class, pass ``[*agents.metrics.metrics(system), mine]``, where the system's task is of
            the parent class.

    Raises:
        TypeError: for a task type that is no class.
        ValueError: for two metrics with one key, or if another module has registered metrics for
            this class.
    """
    keys = [m.key for m in metrics]
    if len({*keys}) < len(keys):
        raise ValueError(f"the metrics of a task need keys of their own, got {', '.join(keys)}")
    module = sys._getframe(1).f_globals.get("__name__", "")
    TASK_METRICS.register(task_type, tuple(metrics), module)


def metrics(system: System | Wrapped) -> tuple[Metric, ...]:
    """Metrics of a system's task, in the order in which tables show them.

    A task without registered metrics has those of every task, and the RMS error of each estimated
    component of the state.
    """
    found = TASK_METRICS.of(system.task)
    own = found[""] if found else [_error(name) for name in _estimated(system)]
    if isinstance(system, Wrapped) and not found:
        return (_OWN_SCORE, STEPS, *own, *((NEES, UNHEALTHY) if system.estimator else ()))
    steering = STEERING if system.vehicle.steering else ()
    every = {m.key: m for m in (SCORE, RETURN, STEPS, *steering, *own)}
    return (*every.values(), *(m for m in (INPUT, NEES, UNHEALTHY) if m.key not in every))


def _error(name: str) -> Metric:
    """The RMS error of a component of the estimated state."""
    meaning = f"RMS error of the estimated {name} [SI]."
    return Metric(f"{name.replace(' ', '_')}_rmse", name, "", "lower", 4, meaning, of=rmse(name))


def scores(rollout: Rollout, *keys: str) -> dict[str, np.ndarray]:
    """Metrics of every episode, ``(N,)`` by key: those of some keys, or else all.

    Times after the end of an episode do not count. A metric that does not exist for an episode or
    an estimator is NaN, such as NEES without a covariance.

    Raises:
        ValueError: if the rollout kept no history, or a metric is not one value an episode.
    """
    system, count = rollout.config.system, len(rollout.seeds)
    if not rollout.history and system.estimator:
        raise ValueError("scores need the history of a rollout: fly it with record=True")
    found = {}
    for m in metrics(system):
        if keys and m.key not in keys:
            continue
        values = m.of(rollout)
        values = np.full(count, np.nan) if values is None else np.asarray(values, float)
        if values.shape != (count,):
            raise ValueError(
                f"metric {m.key!r} must be one value an episode, ({count},), got {values.shape}"
            )
        found[m.key] = values
    return found


def mean(metric: Metric, values: np.ndarray) -> Interval:
    """Mean of a metric ``(runs, seeds)`` with its 95 % interval.

    A seed at which any run lacks the metric is left out. With a single run, a metric of yes or
    no has Clopper and Pearson's interval.
    """
    values = values[:, np.isfinite(values).all(axis=0)]
    if metric.yes_or_no and len(values) == 1 and values.size:
        return share_interval(int(np.count_nonzero(values)), values.size).times(100.0)
    return crossed_interval(values)


def _estimated(system: System | Wrapped) -> tuple[str, ...]:
    """Names of the components that filters estimate by default."""
    if isinstance(system, Wrapped):
        return system.estimation.space.names
    world = system.sensors_of("nominal"), chosen_disturbance(system, "moderate")
    model = {"model": system.vehicle.kinds[0]}
    return build(system, "dead-reckoning", model, *world).space.names
