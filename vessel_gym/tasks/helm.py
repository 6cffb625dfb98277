"""Cost of control effort in the rewards of all tasks: travel and reversals of actuators."""

import numpy as np

TRAVEL = 1.25
"""Cost of the full rate in every step; a good autopilot in moderate seas needs a tenth of that."""
REVERSALS = 4.0
"""Cost of a reversal between full rates in every step; smaller changes cost in proportion."""


def smoothness(rate: np.ndarray, before: np.ndarray, price: float = 1.0) -> np.ndarray:
    """Factor of a reward: 1 / (1 + price (TRAVEL |rate| + REVERSALS |rate - before| / 2)).

    The terms are means over the actuators. They are linear, so that their sum over an episode
    counts the travel, and the reversals times their size. The factor has no lower bound but 0: more
    effort always costs more.

    Args:
        rate: ``(..., k)`` rates of the actuators as shares of the full rate.
        before: ``(..., k)`` rates in the step before.
        price: Cost relative to a ship's rudder.
    """
    effort = TRAVEL * np.abs(rate) + 0.5 * REVERSALS * np.abs(rate - before)
    return 1.0 / (1.0 + price / rate.shape[-1] * effort.sum(-1))
