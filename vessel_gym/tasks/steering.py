"""Base of the tasks of a ship: time scale, yaw rates of steady turns, scales of observations."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from estimators.checks import integer
from vessel_gym.checks import check_numbers, instance
from vessel_gym.tasks.helm import smoothness
from vessel_gym.tasks.task import Task
from vessel_gym.vehicles.corvette import steady_turns
from vessel_gym.vehicles.corvette_equations import CorvetteParameters


def wrapped(angle: np.ndarray) -> np.ndarray:
    """Angle in (-pi, pi]; angles within half a turn of 0 keep all digits."""
    return angle + 2.0 * np.pi * np.floor(0.5 - angle / (2.0 * np.pi))


def first_component(estimates: np.ndarray | None, like: np.ndarray) -> np.ndarray:
    """First component ``(...)`` of estimates ``(..., k)``; 0, shaped as ``like``, without any."""
    return np.zeros_like(like) if estimates is None else estimates[..., 0]


@dataclass(frozen=True)
class Steering(Task):
    """Base of the tasks in which a ship is steered by her rudder."""

    ship: CorvetteParameters
    pace: float = 1.0  # time to sail the ship's own length, relative to the corvette's
    horizon: int = 600  # steps

    def __post_init__(self) -> None:
        instance(f"ship of {type(self).__name__}", self.ship, CorvetteParameters)
        check_numbers(self, positive="pace")
        integer(f"horizon of {type(self).__name__}", self.horizon, 1)

    @property
    def dt(self) -> float:
        """Time step [s]."""
        return 0.5 * self.pace

    @property
    def preview(self) -> float:
        """Time [s] by which the observed command is ahead."""
        return 10.0 * self.pace

    def yaw_rate(self, radius: np.ndarray) -> np.ndarray:
        """Yaw rate [rad/s] of the steady turn with a signed radius [m]."""
        return self.turning(1.0 / radius)

    def turning(self, curvature: np.ndarray) -> np.ndarray:
        """Yaw rate [rad/s] of the steady turn with a signed curvature [1/m]."""
        return np.copysign(np.interp(np.abs(curvature), *self._turns), curvature)

    @cached_property
    def _turns(self) -> tuple[np.ndarray, np.ndarray]:
        """Curvatures [1/m] and yaw rates [rad/s] of steady turns."""
        turns = steady_turns(self.ship)
        return 1.0 / turns.radius, turns.yaw_rate

    def smooth(self, actuators: np.ndarray, before: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Factor of the reward for the steering ``(...)``, and next score state ``(..., 2)``.

        Args:
            actuators: Rudder [rad] ``(..., 1)``.
            before: Rudder [rad] after the step before, and its rate as a share of the full rate
                ``(..., 2)``.
        """
        rate = (actuators - before[..., :1]) / (self.ship.rudder_rate * self.dt)
        factor = smoothness(rate, before[..., 1:], self.RUDDER_PRICE)
        return factor, np.concatenate([actuators, rate], -1)

    RUDDER_PRICE = 1.0  # of effort, in `smooth`
    SWAY_SCALE = 2.0  # m/s
    HEADING_SCALE = 0.1  # rad, errors and uncertainty
    INPUT_SCALE = 0.01  # rad

    @property
    def rate_scale(self) -> float:
        """Scale [rad/s] of errors and standard deviations of the yaw rate."""
        return 0.01 / self.pace

    @property
    def command_scale(self) -> float:
        """Scale [rad/s] of the commanded yaw rate."""
        return 0.04 / self.pace

    @cached_property
    def _known_scales(self) -> list[float]:
        return [self.ship.rudder_limit, self.command_scale, self.command_scale]

    @cached_property
    def _mean_gains(self) -> np.ndarray:
        errors = self.HEADING_SCALE, self.rate_scale, self.SWAY_SCALE, self.INPUT_SCALE
        return 1.0 / np.array([*errors, *self._known_scales])
