"""Ships that are steered by a rudder: what tasks, controllers and linear models ask of one, and her steering gear."""

from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from vessel_gym.vehicles.actuators import Actuator, actuator_parameters
from vessel_gym.vehicles.whole_state import Simulated


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


class SteeredByRate(Simulated, verified=True):
    """A ship in batches whose action is the rudder *rate*, and whose heading gets increments."""

    ship: Any
    angles: ClassVar[tuple[str, ...]] = ("psi",)
    action_names: ClassVar[tuple[str, ...]] = ("rudder rate",)
    steering: ClassVar[tuple[int, ...]] = (0,)
    incremented: ClassVar[tuple[str, ...]] = ("psi",)
    grades: ClassVar[str] = "ship"
    rates: ClassVar[dict[str, str]] = {"r": "psi"}

    @cached_property
    def _actuators(self) -> np.ndarray:
        return actuator_parameters(Actuator(self.ship.rudder_rate * self.dt, kept=1.0, limit=self.ship.rudder_limit))
