"""Pilots that hold a ship on the track of a turning circle."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from agents.pilots import AUTOPILOT, register_pilot
from agents.pilots.loops import Loop, first_order
from agents.pilots.regulator import regulator_gains
from vessel_gym.system import System
from vessel_gym.tasks.circle_track import CircleTrack
from vessel_gym.vehicles.corvette import secant_models, steady_turns
from vessel_gym.vehicles.corvette_equations import CorvetteParameters


@dataclass(frozen=True)
class TrackTolerances:
    """Deviations that count alike in the quadratic cost (Bryson's rule): each weight is 1 / tolerance^2."""

    distance: float = 10.0  # m from the track, the task's own tolerance
    heading: float = 0.05  # rad, likewise
    yaw_rate: float = 0.02  # rad/s
    rudder_rate: float = 0.7  # of the full rate
    distance_integral: float = 1000.0  # m s; infinite: no integral
    rudder: float = 0.05  # rad, for which a PID asks at the tolerance of the heading


@cache
def track_gains(ship: CorvetteParameters, dt: float, tolerances: TrackTolerances) -> np.ndarray:
    """LQI gains ``(k, 6)`` for each of `steady_turns`: rudder rate from (v, r, psi, rudder, distance, its integral).

    Without the integral they are ``(k, 5)``. All are deviations from the steady turn on the track.
    """
    turns, per_step = steady_turns(ship), ship.rudder_rate * dt
    weights = np.array([
        1e-3, tolerances.yaw_rate**-1, tolerances.heading**-1, 1e-3, tolerances.distance**-1,
        tolerances.distance_integral**-1,
    ])  # fmt: skip
    n = 6 if np.isfinite(tolerances.distance_integral) else 5
    K = np.empty((len(turns.speed), n))
    for i, (a, b) in enumerate(zip(*secant_models(ship, dt), strict=True)):
        A, B = np.eye(6), np.zeros((6, 1))
        A[:3, :3], A[:3, 3] = a, b[:, 0]
        A[4, :3] = dt * np.array([1.0, 0.5 * dt * turns.speed[i], turns.speed[i]])
        A[5, 4] = dt
        B[:3, 0], B[3, 0] = 0.5 * per_step * b[:, 0], per_step  # the rudder moves linearly within the step
        K[i] = regulator_gains(A[:n, :n], B[:n], np.diag(weights[:n] ** 2), np.array([[tolerances.rudder_rate**-2]]))[0]
    return K


@register_pilot(CircleTrack, AUTOPILOT)
class TrackAutopilot:
    """Linear-quadratic regulator with integral action about the commanded turn, on the commanded track.

    It acts on the observation alone: what it regulates is what the estimator believes, the current included, in which
    the observation's heading error already crabs.

    Args:
        system: The environment's system.
        tolerances: The design's tolerances.

    Raises:
        ValueError: if the system's task is another.
    """

    def __init__(self, system: System, tolerances: TrackTolerances | None = None) -> None:
        tolerances = tolerances or TrackTolerances()
        self._task, self._dt = _circle_track(system), system.vehicle.dt
        self._ship = self._task.ship
        self._gains = track_gains(self._ship, self._dt, tolerances)
        self._turns = steady_turns(self._ship)
        self._near, self._limit = 6.0 * tolerances.distance, 2.0 * tolerances.distance_integral
        self.reset(1)

    def reset(self, num_envs: int) -> None:
        """Clear the integral."""
        self._integral = np.zeros(num_envs)

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Rudder rate ``(B, 1)`` as a share of the full rate."""
        task, turns = self._task, self._turns
        commanded = task.command_scale * observations[:, 5]
        rate, side = np.abs(commanded), np.sign(commanded)
        distance = task.TRACK_SCALE * observations[:, 7]
        deviation = np.stack(
            [
                task.SWAY_SCALE * observations[:, 2] - side * np.interp(rate, turns.yaw_rate, turns.sway),
                -task.rate_scale * observations[:, 1],
                -task.HEADING_SCALE * observations[:, 0],
                self._ship.rudder_limit * observations[:, 4] - side * np.interp(rate, turns.yaw_rate, turns.rudder),
                np.clip(distance, -self._near, self._near),
                self._integral,
            ],
            -1,
        )
        gains = self._gains[np.minimum(np.rint(rate / turns.yaw_rate[1]).astype(int), len(self._gains) - 1)]
        wanted = -np.vecdot(gains, deviation[:, : gains.shape[1]])
        # The integral waits while the steering gear is saturated, so that it cannot wind up.
        free = np.abs(wanted) < 1.0
        self._integral = np.clip(self._integral + self._dt * distance * free, -self._limit, self._limit)
        return np.clip(wanted, -1.0, 1.0).astype(np.float32)[:, None]


@register_pilot(CircleTrack, "lqg")
class TrackRegulator(TrackAutopilot):
    """The autopilot's linear-quadratic regulator without its integral: no memory, and a bias under steady loads.

    Args:
        system: The environment's system.
        tolerances: The design's tolerances, of which that of the integral is not used.

    Raises:
        ValueError: if the system's task is another.
    """

    def __init__(self, system: System, tolerances: TrackTolerances | None = None) -> None:
        super().__init__(system, replace(tolerances or TrackTolerances(), distance_integral=np.inf))


@register_pilot(CircleTrack, "pid")
class TrackPID:
    """A heading PID behind a line of sight: it heads for a point of the track two ship lengths ahead.

    The rudder by the errors of heading and yaw rate, and what the commanded turn is known to need. Its plant is
    Nomoto's, the ship's linear model on a straight course reduced to first order. The steering gear follows with a
    tenth of the loop's time. Line of sight: Fossen (2021), ch. 12.

    Args:
        system: The environment's system.
        tolerances: The design's tolerances, of heading and rudder.

    Raises:
        ValueError: if the system's task is another.
    """

    AHEAD = 2.0  # ship lengths

    def __init__(self, system: System, tolerances: TrackTolerances | None = None) -> None:
        self._task, dt = _circle_track(system), system.vehicle.dt
        self._ship, self._turns = self._task.ship, steady_turns(self._task.ship)
        tolerances = tolerances or TrackTolerances()
        A, B = (table[0] for table in secant_models(self._ship, dt))
        response, damping = first_order(A[:2, :2], B[:2, 0], 1, dt)
        self._loop = Loop(response, damping, tolerances.heading, tolerances.rudder, dt)
        self._gear = max(0.1 / self._loop.frequency, dt) * self._ship.rudder_rate
        self.reset(1)

    def reset(self, num_envs: int) -> None:
        """Clear the integral."""
        self._loop.reset(num_envs)

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Rudder rate ``(B, 1)`` as a share of the full rate."""
        task, limit, turns = self._task, self._ship.rudder_limit, self._turns
        sight = np.arctan2(task.TRACK_SCALE * observations[:, 7], self.AHEAD * self._ship.length)
        heading, rate = task.HEADING_SCALE * observations[:, 0] - sight, task.rate_scale * observations[:, 1]
        commanded = task.command_scale * observations[:, 5]
        ahead = np.sign(commanded) * np.interp(np.abs(commanded), turns.yaw_rate, turns.rudder)
        rudder = self._loop.act(heading, rate, -limit, limit, ahead)
        wanted = (rudder - limit * observations[:, 4]) / self._gear
        return np.clip(wanted, -1.0, 1.0).astype(np.float32)[:, None]


def _circle_track(system: System) -> CircleTrack:
    if not isinstance(system.task, CircleTrack):
        raise ValueError(f"this autopilot holds a ship on a track, not {type(system.task).__name__}")
    return system.task
