"""What every task can be measured by: figures of each episode, from a rollout."""

import numpy as np

from agents.metrics import NEES, RETURN, SCORE, UNHEALTHY, Metric, common
from agents.rollouts import Rollout

METRICS = (SCORE, RETURN, Metric("steps", "Steps", "", "", 0, "Steps flown."), NEES, UNHEALTHY)


def scores(rollout: Rollout) -> dict[str, np.ndarray]:
    """Every metric of every episode, ``(N,)`` by key; see `agents.scores.scores`."""
    return common(rollout)
