"""Cost of control effort, the same factor in the rewards of all tasks: travel of the actuators, and its reversals."""

import numpy as np

TRAVEL = 1.25
"""Cost of the full rate at every step; the steering of a good autopilot in moderate seas takes a tenth of it."""
REVERSALS = 4.0
"""Cost of a reversal from one full rate to the other at every step; smaller changes of the rate cost in proportion."""


def smoothness(rate: np.ndarray, before: np.ndarray, price: float = 1.0) -> np.ndarray:
    """Factor of a reward ``(...)``, in (0, 1]: 1 / (1 + price (TRAVEL |rate| + REVERSALS |rate - before| / 2)).

    The terms are means over the actuators. They are linear, so that of an episode they count the
    travel, and the reversals times their size. The factor has no lower bound but 0: more effort
    always costs more.

    Args:
        rate: ``(..., k)`` rates of the actuators as shares of the full one.
        before: ``(..., k)`` those of the step before.
        price: Relative to the rudder of a ship.
    """
    effort = TRAVEL * np.abs(rate) + 0.5 * REVERSALS * np.abs(rate - before)
    return 1.0 / (1.0 + price / rate.shape[-1] * effort.sum(-1))
