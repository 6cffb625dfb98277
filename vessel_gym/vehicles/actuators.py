"""Actuators within their limits and rates: one kernel for those of all vehicles."""

from typing import NamedTuple

import numpy as np

from estimators.compiled import rowwise


class Actuator(NamedTuple):
    """How an action in [-1, 1] moves an actuator over a step.

    It asks for ``kept * before + base + gain (offset + action)``. The actuator follows as a lag leaves of what is
    missing the share ``lag``, turns by ``turn`` at most, and stays within limits.
    """

    above: float
    """The gain of an action from 0 on."""
    below: float | None = None
    """That of a negative one; None: the same."""
    offset: float = 0.0
    base: float = 0.0
    kept: float = 0.0
    lag: float = 0.0
    turn: float = np.inf
    limit: float = np.inf


def figures(*actuators: Actuator) -> np.ndarray:
    """What `moved` needs to know of actuators ``(a, 8)``."""
    return np.array([each if each.below is not None else each._replace(below=each.above) for each in actuators], float)


@rowwise("void(f8[:,:],f8[:,:],f8[:,::1],f8[:,::1])")
def moved(before: np.ndarray, action: np.ndarray, figures: np.ndarray, after: np.ndarray) -> None:
    """Actuators ``(B, a)`` a step after those ``before``, of which `figures` are known."""
    for i in range(len(figures)):
        above, below, offset, base, kept, lag, turn, limit = figures[i]
        for row in range(len(after)):
            old = before[row, i]
            gain = below if action[row, i] < 0.0 else above
            asked = kept * old + base + gain * (offset + action[row, i])
            if lag > 0.0:
                asked += (old - asked) * lag
            after[row, i] = min(max(min(max(asked, old - turn), old + turn), -limit), limit)


@rowwise("void(f8[:,:],f8[:,:],f8[:,:],f8[:,::1])")
def mean_input(before: np.ndarray, after: np.ndarray, commanded: np.ndarray, out: np.ndarray) -> None:
    """Means of actuators over a step ``(B, a)``, and what is commanded ``(B, k)``, side by side."""
    a = before.shape[1]
    for row in range(len(out)):
        for i in range(a):
            out[row, i] = 0.5 * (before[row, i] + after[row, i])
        for i in range(commanded.shape[1]):
            out[row, a + i] = commanded[row, i]
