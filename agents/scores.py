"""What a flight was like: the figures of each episode, by the task that was flown."""

import numpy as np

from agents.metrics import Metric
from agents.rollouts import Rollout
from agents.sheets import sheet_of
from agents.statistics import Interval, crossed_interval, share_interval
from vessel_gym.system import System


def metrics(system: System) -> tuple[Metric, ...]:
    """What episodes of a system's task are measured by, in the order in which it is worth reading."""
    return sheet_of(system).metrics


def scores(rollout: Rollout) -> dict[str, np.ndarray]:
    """Every metric of every episode, ``(N,)`` by key.

    Only times that an episode lived through count. A figure that an episode or an estimator does not have is NaN, such
    as NEES without a covariance.

    Raises:
        ValueError: if the rollout kept no history, or is not of an environment with an estimator in the loop.
        TypeError: for what is no rollout.
    """
    if not isinstance(rollout, Rollout):
        raise TypeError(f"scores are those of a rollout, got {rollout!r}")
    if not hasattr(rollout.env.unwrapped, "core"):
        raise ValueError(f"{rollout.env_id} has no estimator in the loop, so its flights have no such figures")
    if not rollout.history:
        raise ValueError("scores need the history of a rollout: fly it with record=True")
    return sheet_of(rollout.env.unwrapped.core.system).scores(rollout)


def mean(metric: Metric, values: np.ndarray) -> Interval | None:
    """The mean of a metric ``(runs, seeds)`` with its 95 % interval; seeds that lack it in a run are left out.

    What one agent did or did not do has Clopper and Pearson's interval.
    """
    values = values[:, np.isfinite(values).all(axis=0)]
    if metric.yes_or_no and len(values) == 1 and values.size:
        share = share_interval(int(np.count_nonzero(values)), values.size)
        return Interval(100.0 * share.mean, 100.0 * share.low, 100.0 * share.high)
    return crossed_interval(values) if values.size else None
