"""Base of ships that are steered by a rudder: what tasks, controllers and linear models ask of one."""

import numpy as np


class SteeredShip:
    """A ship under way at service speed.

    Attributes:
        length: [m].
        beam: [m].
        speed: Service speed in calm water [m/s].
        rudder_limit: Largest rudder angle [rad].
        rudder_rate: Of the steering gear [rad/s].
    """

    length: float
    beam: float
    speed: float
    rudder_limit: float
    rudder_rate: float

    def accelerations(self, motion: np.ndarray, rudder: np.ndarray) -> np.ndarray:
        """Accelerations ``(..., 3)`` of surge, sway [m/s2] and yaw [rad/s2] in calm water, the same to both sides.

        Args:
            motion: Surge, sway [m/s] and yaw rate [rad/s] ``(..., 3)``.
            rudder: [rad] ``(..., 1)``.
        """
        raise NotImplementedError
