"""Controllers that hold a ship on the track of a turning circle."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from agents.controllers import AUTOPILOT, register_controller
from agents.controllers.loops import task_of
from agents.controllers.turning import TurningAutopilot, TurningPID, regulator_table
from vessel_gym.system import System
from vessel_gym.tasks.circle_track import CircleTrack
from vessel_gym.vehicles.corvette import steady_turns
from vessel_gym.vehicles.corvette_equations import CorvetteParameters

PURPOSE = "holds a ship on a track"


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
    """LQI gains ``(k, 6)`` from (v, r, psi, rudder, distance, its integral); without the integral ``(k, 5)``.

    See `agents.controllers.turning.regulator_table`.
    """
    weights = np.array([
        1e-3, tolerances.yaw_rate**-1, tolerances.heading**-1, 1e-3, tolerances.distance**-1,
        tolerances.distance_integral**-1,
    ])  # fmt: skip
    n = 6 if np.isfinite(tolerances.distance_integral) else 5

    def rows(speed: float) -> np.ndarray:
        changes = np.zeros((2, 6))
        changes[0, :3] = dt * np.array([1.0, 0.5 * dt * speed, speed])
        changes[1, 4] = dt
        return changes[: n - 4, :n]

    return regulator_table(ship, dt, np.diag(weights[:n] ** 2), tolerances.rudder_rate, rows)


@register_controller(CircleTrack, AUTOPILOT)
class TrackAutopilot(TurningAutopilot):
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
        task, tolerances = task_of(system, CircleTrack, PURPOSE), tolerances or TrackTolerances()
        self._regulate(task, system.vehicle.dt, track_gains(task.ship, system.vehicle.dt, tolerances))
        self._near, self._limit = 6.0 * tolerances.distance, 2.0 * tolerances.distance_integral

    def _place(self, observations: np.ndarray, heading_error: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
        distance = self._task.TRACK_SCALE * observations[:, 7]
        return [np.clip(distance, -self._near, self._near)], distance


@register_controller(CircleTrack, "lqg")
class TrackRegulator(TrackAutopilot):
    """The autopilot's linear-quadratic regulator without its integral: no memory, and a bias under steady loads.

    Its arguments are those of `TrackAutopilot`.
    """

    def __init__(self, system: System, tolerances: TrackTolerances | None = None) -> None:
        super().__init__(system, replace(tolerances or TrackTolerances(), distance_integral=np.inf))


@register_controller(CircleTrack, "pid")
class TrackPID(TurningPID):
    """A heading PID behind a line of sight: it heads for a point of the track two ship lengths ahead.

    The rudder by the errors of heading and yaw rate, and what the commanded turn is known to need. Its plant is
    Nomoto's, the ship's linear model on a straight course reduced to first order. The steering gear follows with a
    tenth of the loop's time. Line of sight: Fossen (2021), ch. 12.

    Its arguments are those of `TrackAutopilot`.
    """

    AHEAD = 2.0  # ship lengths

    def __init__(self, system: System, tolerances: TrackTolerances | None = None) -> None:
        task, tolerances = task_of(system, CircleTrack, PURPOSE), tolerances or TrackTolerances()
        self._close(task, system.vehicle.dt, tolerances.heading, tolerances.rudder)
        self._turns = steady_turns(task.ship)

    def _errors(self, observations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        heading, rate = super()._errors(observations)
        sight = np.arctan2(self._task.TRACK_SCALE * observations[:, 7], self.AHEAD * self._ship.length)
        return heading - sight, rate

    def _ahead(self, observations: np.ndarray) -> np.ndarray:
        commanded = self._task.command_scale * observations[:, 5]
        return np.sign(commanded) * np.interp(np.abs(commanded), self._turns.yaw_rate, self._turns.rudder)
