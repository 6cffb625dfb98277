"""Actuators within their limits and rates, those of all vehicles alike."""

from typing import NamedTuple

import numpy as np


class Actuator(NamedTuple):
    """Response of an actuator to an action in [-1, 1] over a step.

    It asks for ``kept * before + base + gain (offset + action)``. The actuator follows as a lag
    leaves of what is missing the share ``lag``, turns by ``turn`` at most, and stays within limits.
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


def actuator_parameters(*actuators: Actuator) -> np.ndarray:
    """Parameters of actuators for `actuated`, ``(a, 8)``."""
    return np.array(
        [each if each.below is not None else each._replace(below=each.above) for each in actuators],
        float,
    )


def actuated(before: np.ndarray, action: np.ndarray, parameters: np.ndarray) -> np.ndarray:
    """Actuators ``(..., a)`` a step after those ``before``, of which `actuator_parameters` are known."""
    above, below, offset, base, kept, lag, turn, limit = parameters.T
    asked = kept * before + base + np.where(action < 0.0, below, above) * (offset + action)
    asked = np.where(lag > 0.0, asked + (before - asked) * lag, asked)
    turned = np.minimum(np.maximum(asked, before - turn), before + turn)
    return np.minimum(np.maximum(turned, -limit), limit)
