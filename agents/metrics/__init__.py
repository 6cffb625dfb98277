"""Metrics of episodes, registered by kind of task.

Every task has a score, a return, steps, the error of an estimated unknown input, NEES and failed
updates, and, where the vehicle says which of its actuators steer, the costs of steering. A task
adds what it is about; without that, it is also measured by how well each component of the state was
estimated.

They may import rollouts and statistics; studies, pages of episodes and commands import them.
"""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

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
    at_end,
    components,
    consistency,
    core_of,
    ended,
    nees_in,
    nees_of,
    nis_consistency,
    rms,
    rmse,
    steps,
)
from agents.rollouts import Rollout
from agents.statistics import Interval, crossed_interval, share_interval
from agents.wrapped import Wrapped
from vessel_gym.estimation import WITHOUT_COVARIANCE, build, chosen_disturbance
from vessel_gym.registry import Registry
from vessel_gym.system import System

__all__ = [
    "NEES",
    "SCORE",
    "STEERING",
    "UNHEALTHY",
    "WITHOUT_COVARIANCE",
    "Metric",
    "at_end",
    "components",
    "consistency",
    "core_of",
    "ended",
    "mean",
    "metrics",
    "nees_in",
    "nees_of",
    "nis_consistency",
    "register_metrics",
    "rms",
    "rmse",
    "scores",
    "steps",
]  # fmt: skip

Computation = Callable[[Rollout], dict[str, np.ndarray]]
"""Several metrics of every episode of a rollout, ``(N,)`` by key."""


@dataclass(frozen=True)
class TaskMetrics:
    """Metrics of a kind of task, in the order in which tables show them.

    Attributes:
        metrics: All of them.
        compute: Those that have no ``of``; None if all have one.
    """

    metrics: tuple[Metric, ...]
    compute: Computation | None = None


def _ours() -> None:
    from agents.metrics import dive, flight, track, turning  # noqa: F401


_OWN_SCORE = replace(
    SCORE, meaning="The environment's own score; the return where it has none.", decimals=1
)

TASK_METRICS: Registry[TaskMetrics] = Registry("metrics", _ours)


def register_metrics(
    task_type: type, metrics: Sequence[Metric], compute: Computation | None = None
) -> None:
    """Register the metrics of a kind of task; subclasses inherit them.

    Args:
        task_type: The class of the task.
        metrics: Beside score, return, steps, the costs of steering, the input's error, NEES and
            failed updates, which every task has; one with the key ``"steps"`` or ``"input_rmse"``,
            or of a cost of steering, replaces these. Those of the parent class and one's own are
            ``[*metrics(system), mine]``, with a system of the parent.
        compute: The metrics that have no ``of``: a function of a `Rollout` that returns ``(N,)`` by
            key; None: that of the parent class.

    Raises:
        TypeError: for a task type that is no class, or metrics that are none.
        ValueError: for a metric without a computation, two metrics of one key, or metrics
            registered elsewhere.
    """
    own = [m for m in metrics if m not in (SCORE, RETURN, NEES, UNHEALTHY)]
    if not all(isinstance(m, Metric) for m in own):
        raise TypeError(f"a task is registered with objects of the class Metric, got {metrics!r}")
    inherited = TASK_METRICS.of_class(getattr(task_type, "__base__", None) or object)
    if compute is None and inherited:
        compute = inherited[""].compute
    for m in own:
        if m.of is None and compute is None:
            raise ValueError(
                f"nothing computes {m.key!r}: give the metric an `of`, or register_metrics a"
                " function"
            )
    named = {m.key for m in own}
    first, last = (
        [m for m in known if m.key not in named] for known in ((STEPS, *STEERING), (INPUT,))
    )
    every = (SCORE, RETURN, *first, *own, *last, NEES, UNHEALTHY)
    keys = [m.key for m in every]
    if len(set(keys)) < len(keys):
        raise ValueError(f"the metrics of a task need keys of their own, got {', '.join(keys)}")
    module = sys._getframe(1).f_globals.get("__name__", "")
    TASK_METRICS.register(task_type, TaskMetrics(every, compute), module)


def metrics(system: System | Wrapped) -> tuple[Metric, ...]:
    """Metrics of a system's task, in the order in which tables show them."""
    return _of_task(system).metrics


def scores(rollout: Rollout) -> dict[str, np.ndarray]:
    """Every metric of every episode, ``(N,)`` by key.

    Only times that an episode lived through count. A metric that an episode or an estimator does
    not have is NaN, such as NEES without a covariance.

    Raises:
        ValueError: if the rollout kept no history, or a metric is not one value an episode.
        TypeError: for what is no rollout.
    """
    if not isinstance(rollout, Rollout):
        raise TypeError(f"scores are those of a rollout, got {rollout!r}")
    system = core_of(rollout).system
    if not rollout.history and system.estimator:
        raise ValueError("scores need the history of a rollout: fly it with record=True")
    task = _of_task(system)
    computed = {} if task.compute is None else task.compute(rollout)
    found = {
        m.key: np.asarray(computed[m.key] if m.of is None else m.of(rollout)) for m in task.metrics
    }
    for key, values in found.items():
        if values.shape != (len(rollout.seeds),):
            raise ValueError(
                f"metric {key!r} must be one value an episode, ({len(rollout.seeds)},), got"
                f" {values.shape}"
            )
    return found


def mean(metric: Metric, values: np.ndarray) -> Interval | None:
    """Mean of a metric ``(runs, seeds)`` with its 95 % interval.

    Seeds that lack it in a run are left out. Shares of the episodes of one agent have Clopper and
    Pearson's interval.
    """
    values = values[:, np.isfinite(values).all(axis=0)]
    if metric.yes_or_no and len(values) == 1 and values.size:
        return share_interval(int(np.count_nonzero(values)), values.size).times(100.0)
    return crossed_interval(values) if values.size else None


def _of_task(system: System | Wrapped) -> TaskMetrics:
    """Registered metrics of a system's task, or those of every task and every estimate."""
    steering = STEERING if getattr(system.vehicle, "steering", ()) else ()
    found = TASK_METRICS.of(system.task)
    if found:
        possible = tuple(m for m in found[""].metrics if m not in STEERING or steering)
        return TaskMetrics(possible, found[""].compute)
    errors = [
        Metric(
            f"{name.replace(' ', '_')}_rmse",
            name,
            *("", "lower", 4, f"RMS error of the estimated {name} [SI]."),
            of=rmse(name),
        )
        for name in _estimated(system)
    ]
    if isinstance(system, Wrapped):
        last = (NEES, UNHEALTHY) if system.estimator else ()
        return TaskMetrics((_OWN_SCORE, STEPS, *errors, *last))
    return TaskMetrics((SCORE, RETURN, STEPS, *steering, *errors, INPUT, NEES, UNHEALTHY))


def _estimated(system: System | Wrapped) -> tuple[str, ...]:
    """Names of the components that filters estimate by default."""
    if isinstance(system, Wrapped):
        return system.composition.names
    world = system.sensors_of("nominal"), chosen_disturbance(system, "moderate")
    model = {"model": system.vehicle.kinds[0]}
    return build(system, "dead-reckoning", model, *world).composition.names
