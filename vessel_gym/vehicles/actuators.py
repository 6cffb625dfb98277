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
    """What `actuated` needs to know of actuators ``(a, 8)``."""
    return np.array([each if each.below is not None else each._replace(below=each.above) for each in actuators], float)


def actuated(before: np.ndarray, action: np.ndarray, figures: np.ndarray) -> np.ndarray:
    """Actuators ``(..., a)`` a step after those ``before``, of which `figures` are known."""
    after = np.empty(before.shape)
    if after.ndim == 2 and before.shape == action.shape and before.dtype == action.dtype == float:
        _moved(before, action, figures, after)
    else:  # by hand: the kernel is for rows of floats
        before, action = np.broadcast_arrays(before, action)
        after = np.empty(before.shape)
        rows = (np.array(each, float).reshape(-1, len(figures)) for each in (before, action))
        _moved(*rows, figures, after.reshape(-1, len(figures)))
    return after


@rowwise("void(f8[:,:],f8[:,:],f8[:,::1],f8[:,::1])")
def _moved(before: np.ndarray, action: np.ndarray, figures: np.ndarray, after: np.ndarray) -> None:
    """`actuated`, of rows ``(B, a)``."""
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
