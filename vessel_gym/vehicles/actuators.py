"""Actuators with limits, rates and lags."""

from typing import NamedTuple

import numpy as np


class Actuator(NamedTuple):
    """Response of an actuator to an action in [-1, 1] over a step.

    The command is ``kept * before + base + gain (offset + action)``. A lag leaves the share ``lag``
    of the difference between actuator and command. A step changes the actuator by at most ``turn``,
    and its limits are +-``limit``.
    """

    above: float
    """Gain of actions from 0 on."""
    below: float
    """Gain of negative actions."""
    offset: float = 0.0
    base: float = 0.0
    kept: float = 0.0
    lag: float = 0.0
    turn: float = np.inf
    limit: float = np.inf


def actuated(before: np.ndarray, action: np.ndarray, parameters: np.ndarray) -> np.ndarray:
    """Actuators ``(..., a)`` after a step from ``before``, with parameters ``(a, 8)``.

    A row of the parameters is an `Actuator`.
    """
    above, below, offset, base, kept, lag, turn, limit = parameters.T
    asked = kept * before + base + np.where(action < 0.0, below, above) * (offset + action)
    asked = np.where(lag > 0.0, asked + (before - asked) * lag, asked)
    turned = np.clip(asked, before - turn, before + turn)
    return np.clip(turned, -limit, limit)
