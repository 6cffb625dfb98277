"""Controllers of a ship's turns: free, on a track, and in a trial whose action is the rudder angle.

All are designed from the ship's linear models.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from agents.controllers import AUTOPILOT, register_controller
from agents.controllers.loops import Loop, first_order, regulator_gains, task_of
from vessel_gym.system import System
from vessel_gym.tasks.track import Track
from vessel_gym.tasks.turning_circle import TurningCircle
from vessel_gym.tasks.turning_trial import TurningTrial
from vessel_gym.vehicles.corvette import secant_models, steady_turns
from vessel_gym.vehicles.corvette_equations import CorvetteParameters


@dataclass(frozen=True)
class Tolerances:
    """Deviations that count alike in the quadratic cost (Bryson's rule): each weight is 1 / tolerance^2."""

    heading: float = 0.05  # rad, the task's own tolerance
    yaw_rate: float = 0.02  # rad/s
    rudder_rate: float = 0.5  # of the full rate
    heading_integral: float = 1.0  # rad s; infinite: no integral
    # rad, for which a PID asks at the tolerance of the heading: one for one, as usual on ships
    rudder: float = 0.05


def regulator_table(
    ship: CorvetteParameters,
    dt: float,
    Q: np.ndarray,
    rudder_rate: float,
    rows: Callable[[float], np.ndarray],
) -> np.ndarray:
    """LQ gains ``(k, n)`` for each of `steady_turns`: rudder rate from (v, r, psi, rudder, further states).

    The design model is the filters' secant model of the commanded turn with the rudder and further
    states; the regulator acts on deviations from the steady turn.

    Args:
        ship: The ship.
        dt: Time step [s].
        Q: Cost of deviations ``(n, n)``.
        rudder_rate: Tolerance, as a share of the full rate.
        rows: Changes of the further states in a step ``(n - 4, n)`` by all states, at a speed.
    """
    per_step, R, K = ship.rudder_rate * dt, np.array([[rudder_rate**-2]]), []
    for speed, a, b in zip(steady_turns(ship).speed, *secant_models(ship, dt), strict=True):
        A, B = np.eye(len(Q)), np.zeros((len(Q), 1))
        A[:3, :3], A[:3, 3] = a, b[:, 0]
        A[4:] += rows(speed)
        B[:3, 0], B[3, 0] = (
            0.5 * per_step * b[:, 0],
            per_step,
        )  # the rudder moves linearly within the step
        K.append(regulator_gains(A, B, Q, R)[0])
    return np.array(K)


@cache
def gains(ship: CorvetteParameters, dt: float, tolerances: Tolerances) -> np.ndarray:
    """LQI gains ``(k, 5)`` from (v, r, psi, rudder, integral), without the integral ``(k, 4)``: `regulator_table`."""
    Q = np.diag(
        [0.0, tolerances.yaw_rate**-2, tolerances.heading**-2, 0.0, tolerances.heading_integral**-2]
    )
    n = 5 if np.isfinite(tolerances.heading_integral) else 4
    integral = np.array([[0.0, 0.0, dt, 0.0, 0.0]])
    return regulator_table(
        ship, dt, Q[:n, :n], tolerances.rudder_rate, lambda _: integral[: n - 4, :n]
    )


@register_controller(TurningCircle, AUTOPILOT)
class TurningAutopilot:
    """Linear-quadratic regulator with integral action about the commanded steady turn.

    It acts on the observation alone: what it regulates is what the estimator believes. No gain is
    chosen by hand: they follow from the linear model and the task's own tolerances.

    Args:
        system: The environment's system (its task's scales, its ship).

    Raises:
        ValueError: if the system's task is another.
    """

    tolerances: Any = Tolerances()  # of the design

    def __init__(self, system: System) -> None:
        task = task_of(system, TurningCircle, "steers turning circles")
        self._regulate(
            task, system.vehicle.dt, gains(task.ship, system.vehicle.dt, self.tolerances)
        )
        self._limit = 4.0 * self.tolerances.heading_integral

    def _regulate(self, task: Any, dt: float, gains: np.ndarray) -> None:
        self._task, self._ship, self._dt, self._gains = task, task.ship, dt, gains
        self._turns = steady_turns(task.ship)
        self.reset(1)

    def reset(self, num_envs: int) -> None:
        """Clear the integral."""
        self._integral = np.zeros(num_envs)

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Rudder rate ``(B, 1)`` as a share of the full rate."""
        task, turns = self._task, self._turns
        heading_error = -task.HEADING_SCALE * observations[:, 0]
        commanded = task.command_scale * observations[:, 5]
        rate, side = np.abs(commanded), np.sign(commanded)
        place, integrated = self._place(observations, heading_error)
        deviation = np.stack(
            [
                task.SWAY_SCALE * observations[:, 2]
                - side * np.interp(rate, turns.yaw_rate, turns.sway),
                -task.rate_scale * observations[:, 1],
                heading_error,
                self._ship.rudder_limit * observations[:, 4]
                - side * np.interp(rate, turns.yaw_rate, turns.rudder),
                *place,
                self._integral,
            ],
            -1,
        )
        gains = self._gains[
            np.minimum(np.rint(rate / turns.yaw_rate[1]).astype(int), len(self._gains) - 1)
        ]
        wanted = -np.vecdot(gains, deviation[:, : gains.shape[1]])
        # The integral waits while the steering gear is saturated, so that it cannot wind up.
        free = np.abs(wanted) < 1.0
        self._integral = np.clip(
            self._integral + self._dt * integrated * free, -self._limit, self._limit
        )
        return np.clip(wanted, -1.0, 1.0).astype(np.float32)[:, None]

    def _place(
        self, observations: np.ndarray, heading_error: np.ndarray
    ) -> tuple[list[np.ndarray], np.ndarray]:
        """Further regulated states, and the error that is integrated."""
        return [], heading_error


@register_controller(TurningCircle, "lqg")
class TurningRegulator(TurningAutopilot):
    """The autopilot's linear-quadratic regulator without its integral: no memory, and a bias under steady loads."""

    tolerances = replace(Tolerances(), heading_integral=np.inf)


@register_controller(TurningCircle, "pid")
class TurningPID:
    """A heading PID: the rudder by the errors of heading and yaw rate, and what the commanded turn is known to need.

    Its plant is Nomoto's, the ship's linear model on a straight course reduced to first order; the
    rudder that the commanded yaw rate needs there is added. The steering gear follows with a tenth
    of the loop's time.
    """

    tolerances: Any = Tolerances()  # of the design

    def __init__(self, system: System) -> None:
        self._close(task_of(system, TurningCircle, "steers turning circles"), system.vehicle.dt)

    def _close(self, task: Any, dt: float) -> None:
        """Design the loop."""
        self._task, self._ship = task, task.ship
        A, B = (table[0] for table in secant_models(self._ship, dt))
        response, damping = first_order(A[:2, :2], B[:2, 0], 1, dt)
        self._loop = Loop(response, damping, self.tolerances.heading, self.tolerances.rudder, dt)
        self._needed = damping / response  # rad of rudder for a yaw rate of 1 rad/s
        self._gear = max(0.1 / self._loop.frequency, dt) * self._ship.rudder_rate
        self.reset(1)

    def reset(self, num_envs: int) -> None:
        """Clear the integral."""
        self._loop.reset(num_envs)

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Rudder rate ``(B, 1)`` as a share of the full rate."""
        limit = self._ship.rudder_limit
        rudder = self._loop.act(
            *self._errors(observations), -limit, limit, self._ahead(observations)
        )
        wanted = (rudder - limit * observations[:, 4]) / self._gear
        return np.clip(wanted, -1.0, 1.0).astype(np.float32)[:, None]

    def _errors(self, observations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Errors of heading and yaw rate."""
        return (
            self._task.HEADING_SCALE * observations[:, 0],
            self._task.rate_scale * observations[:, 1],
        )

    def _ahead(self, observations: np.ndarray) -> np.ndarray:
        """Rudder that the commanded turn needs [rad]."""
        return self._needed * self._task.command_scale * observations[:, 5]


# --- on a track -----------------------------------------------------------------------------------

_ON_TRACK = "holds a ship on a track"


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

    See `regulator_table`.
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


@register_controller(Track, AUTOPILOT)
class TrackAutopilot(TurningAutopilot):
    """Linear-quadratic regulator with integral action about the commanded turn, on the commanded track.

    It acts on the observation alone: what it regulates is what the estimator believes, the current
    included, in which the observation's heading error already crabs.

    Args:
        system: The environment's system.

    Raises:
        ValueError: if the system's task is another.
    """

    tolerances = TrackTolerances()

    def __init__(self, system: System) -> None:
        task, t = task_of(system, Track, _ON_TRACK), self.tolerances
        self._regulate(task, system.vehicle.dt, track_gains(task.ship, system.vehicle.dt, t))
        self._near, self._limit = 6.0 * t.distance, 2.0 * t.distance_integral

    def _place(
        self, observations: np.ndarray, heading_error: np.ndarray
    ) -> tuple[list[np.ndarray], np.ndarray]:
        distance = self._task.TRACK_SCALE * observations[:, 7]
        return [np.clip(distance, -self._near, self._near)], distance


@register_controller(Track, "lqg")
class TrackRegulator(TrackAutopilot):
    """The autopilot's linear-quadratic regulator without its integral: no memory, and a bias under steady loads."""

    tolerances = replace(TrackTolerances(), distance_integral=np.inf)


@register_controller(Track, "pid")
class TrackPID(TurningPID):
    """A heading PID behind a line of sight: it heads for a point of the track two ship lengths ahead.

    The rudder by the errors of heading and yaw rate, and what the commanded turn is known to need.
    Its plant is Nomoto's, the ship's linear model on a straight course reduced to first order. The
    steering gear follows with a tenth of the loop's time. Line of sight: Fossen (2021), ch. 12.
    """

    AHEAD = 2.0  # ship lengths

    tolerances = TrackTolerances()

    def __init__(self, system: System) -> None:
        self._close(task_of(system, Track, _ON_TRACK), system.vehicle.dt)
        self._turns = steady_turns(self._ship)

    def _errors(self, observations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        heading, rate = super()._errors(observations)
        sight = np.arctan2(
            self._task.TRACK_SCALE * observations[:, 7], self.AHEAD * self._ship.length
        )
        return heading - sight, rate

    def _ahead(self, observations: np.ndarray) -> np.ndarray:
        commanded = self._task.command_scale * observations[:, 5]
        return np.sign(commanded) * np.interp(
            np.abs(commanded), self._turns.yaw_rate, self._turns.rudder
        )


# --- a turning circle trial -----------------------------------------------------------------------


class _ByAngle:
    """The rudder angle after a step, for a controller that gives the rudder rate over it."""

    _task: Any
    _ship: Any

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Rudder angle ``(B, 1)`` as a share of its limit."""
        turn = self._ship.rudder_rate * self._task.dt / self._ship.rudder_limit
        angle = observations[:, 4:5] + turn * super().act(observations)  # type: ignore[misc]
        return np.clip(angle, -1.0, 1.0).astype(np.float32)


@register_controller(TurningTrial, AUTOPILOT)
class TrialAutopilot(_ByAngle, TurningAutopilot):
    """`TurningAutopilot` for a rudder that is given as an angle."""


@register_controller(TurningTrial, "lqg")
class TrialRegulator(_ByAngle, TurningRegulator):
    """`TurningRegulator` for a rudder that is given as an angle."""


@register_controller(TurningTrial, "pid")
class TrialPID(_ByAngle, TurningPID):
    """`TurningPID` for a rudder that is given as an angle, with the rudder that the steady turn needs added."""

    def _ahead(self, observations: np.ndarray) -> np.ndarray:
        turns, rate = steady_turns(self._ship), self._task.command_scale * observations[:, 5]
        return np.copysign(np.interp(np.abs(rate), turns.yaw_rate, turns.rudder), rate)


@register_controller(TurningTrial, "constant-rudder")
class ConstantRudder:
    """The rudder of the trial, whatever is observed: the reference agent of ``ThesisCorvette-v0``.

    Args:
        system: The environment's system.
        angle: Rudder angle [rad]; None: that of the trial. The thesis prints 35 degrees (Section
            4.3.1).
    """

    def __init__(self, system: System, angle: float | None = None) -> None:
        task = task_of(system, TurningTrial, "steers turning circle trials")
        self._share = (task.helm if angle is None else angle) / task.ship.rudder_limit

    def reset(self, num_envs: int) -> None:
        """There is nothing to forget."""

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Rudder angle ``(B, 1)`` as a share of its limit."""
        return np.full((len(observations), 1), self._share, np.float32)
