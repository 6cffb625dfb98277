"""Pilots of turning circles, designed from the ship's linear models."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from agents.pilots import AUTOPILOT, register_pilot
from agents.pilots.loops import Loop, first_order
from agents.pilots.regulator import regulator_gains
from vessel_gym.system import System
from vessel_gym.tasks.turning_circle import TurningCircle
from vessel_gym.vehicles.corvette import secant_models, steady_turns
from vessel_gym.vehicles.corvette_equations import CorvetteParameters


@dataclass(frozen=True)
class Tolerances:
    """Deviations that count alike in the quadratic cost (Bryson's rule): each weight is 1 / tolerance^2."""

    heading: float = 0.05  # rad, the task's own tolerance
    yaw_rate: float = 0.02  # rad/s
    rudder_rate: float = 0.5  # of the full rate
    heading_integral: float = 1.0  # rad s; infinite: no integral
    rudder: float = 0.05  # rad, for which a PID asks at the tolerance of the heading: one for one, as usual on ships


@cache
def gains(ship: CorvetteParameters, dt: float, tolerances: Tolerances) -> np.ndarray:
    """LQI gains ``(k, 5)`` for each of `steady_turns`: rudder rate from (v, r, psi, rudder, integral).

    Without the integral they are ``(k, 4)``. The design model is the filters' secant model of the commanded turn with
    the rudder as a state and the integral of the heading error; the regulator acts on deviations from the steady turn.
    """
    A_table, B_table = secant_models(ship, dt)
    per_step = ship.rudder_rate * dt
    Q = np.diag([0.0, tolerances.yaw_rate**-2, tolerances.heading**-2, 0.0, tolerances.heading_integral**-2])
    R = np.array([[tolerances.rudder_rate**-2]])
    n = 5 if np.isfinite(tolerances.heading_integral) else 4
    K = np.empty((len(A_table), n))
    for i, (a, b) in enumerate(zip(A_table, B_table, strict=True)):
        A, B = np.eye(5), np.zeros((5, 1))
        A[:3, :3], A[:3, 3] = a, b[:, 0]
        A[4, 2] = dt
        B[:3, 0] = 0.5 * per_step * b[:, 0]  # the rudder moves linearly within the step
        B[3, 0] = per_step
        K[i] = regulator_gains(A[:n, :n], B[:n], Q[:n, :n], R)[0]
    return K


@register_pilot(TurningCircle, AUTOPILOT)
class TurningAutopilot:
    """Linear-quadratic regulator with integral action about the commanded steady turn.

    It acts on the observation alone: what it regulates is what the estimator believes. No gain is
    chosen by hand: they follow from the linear model and the task's own tolerances.

    Args:
        system: The environment's system (its task's scales, its ship).
        tolerances: The design's tolerances.

    Raises:
        ValueError: if the system's task is another.
    """

    def __init__(self, system: System, tolerances: Tolerances | None = None) -> None:
        task = _turning_circle(system)
        self._task, self._ship = task, task.ship
        self._dt = system.vehicle.dt
        self._gains = gains(self._ship, self._dt, tolerances or Tolerances())
        self._turns = steady_turns(self._ship)
        self._limit = 4.0 * (tolerances or Tolerances()).heading_integral
        self.reset(1)

    def reset(self, num_envs: int) -> None:
        """Clear the integral."""
        self._integral = np.zeros(num_envs)

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Rudder rate ``(B, 1)`` as a share of the full rate."""
        task, turns = self._task, self._turns
        heading_error = -task.HEADING_SCALE * observations[:, 0]
        rate_error = -task.rate_scale * observations[:, 1]
        sway = task.SWAY_SCALE * observations[:, 2]
        rudder = self._ship.rudder_limit * observations[:, 4]
        commanded = task.command_scale * observations[:, 5]
        rate = np.abs(commanded)
        side = np.sign(commanded)
        deviation = np.stack(
            [
                sway - side * np.interp(rate, turns.yaw_rate, turns.sway),
                rate_error,
                heading_error,
                rudder - side * np.interp(rate, turns.yaw_rate, turns.rudder),
                self._integral,
            ],
            -1,
        )
        index = np.rint(rate / turns.yaw_rate[1]).astype(int)
        gains = self._gains[index]
        wanted = -np.vecdot(gains, deviation[:, : gains.shape[1]])
        # The integral waits while the steering gear is saturated, so that it cannot wind up.
        free = np.abs(wanted) < 1.0
        self._integral = np.clip(self._integral + self._dt * heading_error * free, -self._limit, self._limit)
        return np.clip(wanted, -1.0, 1.0).astype(np.float32)[:, None]


@register_pilot(TurningCircle, "lqg")
class TurningRegulator(TurningAutopilot):
    """The autopilot's linear-quadratic regulator without its integral: no memory, and a bias under steady loads.

    Args:
        system: The environment's system.
        tolerances: The design's tolerances, of which that of the integral is not used.

    Raises:
        ValueError: if the system's task is another.
    """

    def __init__(self, system: System, tolerances: Tolerances | None = None) -> None:
        super().__init__(system, replace(tolerances or Tolerances(), heading_integral=np.inf))


@register_pilot(TurningCircle, "pid")
class TurningPID:
    """A heading PID: the rudder by the errors of heading and yaw rate, and what the commanded turn is known to need.

    Its plant is Nomoto's, the ship's linear model on a straight course reduced to first order; the rudder that the
    commanded yaw rate needs there is added. The steering gear follows with a tenth of the loop's time.

    Args:
        system: The environment's system.
        tolerances: The design's tolerances, of heading and rudder.

    Raises:
        ValueError: if the system's task is another.
    """

    def __init__(self, system: System, tolerances: Tolerances | None = None) -> None:
        self._task, dt = _turning_circle(system), system.vehicle.dt
        self._ship = self._task.ship
        tolerances = tolerances or Tolerances()
        A, B = (table[0] for table in secant_models(self._ship, dt))
        response, damping = first_order(A[:2, :2], B[:2, 0], 1, dt)
        self._loop = Loop(response, damping, tolerances.heading, tolerances.rudder, dt)
        self._needed = damping / response  # rad of rudder for a yaw rate of 1 rad/s
        self._gear = max(0.1 / self._loop.frequency, dt) * self._ship.rudder_rate
        self.reset(1)

    def reset(self, num_envs: int) -> None:
        """Clear the integral."""
        self._loop.reset(num_envs)

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Rudder rate ``(B, 1)`` as a share of the full rate."""
        task, limit = self._task, self._ship.rudder_limit
        heading, rate = task.HEADING_SCALE * observations[:, 0], task.rate_scale * observations[:, 1]
        ahead = self._needed * task.command_scale * observations[:, 5]
        rudder = self._loop.act(heading, rate, -limit, limit, ahead)
        wanted = (rudder - limit * observations[:, 4]) / self._gear
        return np.clip(wanted, -1.0, 1.0).astype(np.float32)[:, None]


def _turning_circle(system: System) -> TurningCircle:
    if not isinstance(system.task, TurningCircle):
        raise ValueError(f"this autopilot steers turning circles, not {type(system.task).__name__}")
    return system.task
