"""Controllers of a ship's turns: free, on a track, and in a trial whose action is the rudder angle.

All are designed from the ship's linear models.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from agents.controllers import AUTOPILOT, register_controller
from agents.controllers.loops import (
    Control,
    Controller,
    Loop,
    bryson,
    first_order,
    regulator_gains,
)
from estimators.engine import compiled, lookup
from vessel_gym.tasks.track import Track
from vessel_gym.tasks.turning import TurningTrial
from vessel_gym.vehicles.corvette import secant_models, steady_turns
from vessel_gym.vehicles.corvette_equations import CorvetteParameters
from vessel_gym.vehicles.corvette_thesis import ThesisCorvette


@dataclass(frozen=True)
class Tolerances:
    """Deviations that count alike in the quadratic cost (Bryson's rule).

    Each weight is 1 / tolerance^2: what is infinite does not count.
    """

    sway: float = np.inf  # m/s
    yaw_rate: float = 0.02  # rad/s
    heading: float = 0.05  # rad, the task's own tolerance
    rudder: float = np.inf  # rad
    distance: float = np.inf  # from the track, in `Track.track_scale`; infinite: there is none
    integral: float = 1.0  # rad s of heading or, on a track, s of distance; infinite: none
    integral_limit: float = 4.0
    rudder_rate: float = 0.5  # of the full rate


ON_TRACK = Tolerances(
    sway=1000.0,
    rudder=1000.0,
    distance=0.5,
    integral=50.0,
    integral_limit=100.0,
    rudder_rate=0.7,
)


@cache
def gains(ship: CorvetteParameters, dt: float, tolerances: Tolerances) -> np.ndarray:
    """LQ gains ``(k, 6)`` of the rudder rate for each of `steady_turns`; 0 for what is not there.

    The states are deviations from the steady turn in (v, r, psi, rudder), the distance from a track
    and an integral, of that or else of psi. The design model is the filters' secant model of the
    commanded turn.
    """
    t, per_step, turns = tolerances, ship.rudder_rate * dt, steady_turns(ship)
    scales = np.array([t.sway, t.yaw_rate, t.heading, t.rudder, t.distance, t.integral])
    there = np.isfinite(scales) | (np.arange(6) < 4)
    Q, R = np.diag((1.0 / scales[there]) ** 2), bryson(t.rudder_rate)
    K = np.zeros((len(turns.speed), 6))
    for i, (speed, a, b) in enumerate(zip(turns.speed, *secant_models(ship, dt), strict=True)):
        A, B = np.eye(6), np.zeros((6, 1))
        A[:3, :3], A[:3, 3] = a, b[:, 0]
        A[4, :3] = dt * np.array([1.0, 0.5 * dt * speed, speed])
        A[5, 4 if there[4] else 2] = dt
        # the rudder moves linearly within the step
        B[:3, 0], B[3, 0] = 0.5 * per_step * b[:, 0], per_step
        K[i, there] = regulator_gains(A[there][:, there], B[there], Q, R)[0]
    return K


class _Helm(Controller):
    """A controller of the rudder; for a `ThesisCorvette` it asks for the angle that follows."""

    kind: type = TurningTrial
    state_size = 1  # the integral
    tolerances = Tolerances()  # of the design

    def _design(self) -> None:
        self._ship, self._turns = self._task.ship, steady_turns(self._task.ship)

    def _action(self, observation: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """Action ``(..., 1)`` for a share ``(...)`` of the full rudder rate, without its limits."""
        rate = np.clip(rate, -1.0, 1.0)
        if isinstance(self._vehicle, ThesisCorvette):
            turn = self._ship.rudder_rate * self._vehicle.dt / self._ship.rudder_limit
            rate = observation[..., 4] + turn * rate
        return rate[..., None]

    def _steady(self, observation: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Values of the steady turns, interpolated at the commanded yaw rate ``(...)``."""
        commanded = self._task.command_scale * observation[..., 5]
        return np.sign(commanded) * self._turns.interpolated(values, commanded)


@register_controller(TurningTrial, AUTOPILOT)
class TurningAutopilot(_Helm):
    """Linear-quadratic regulator with integral action about the commanded steady turn.

    It acts on the observation alone: what it regulates is what the estimator believes. No gain is
    chosen by hand: they follow from the linear model and the task's own tolerances.
    """

    def _design(self) -> None:
        super()._design()
        self._gains = gains(self._ship, self._vehicle.dt, self.tolerances)

    @compiled
    def control(self, observation: np.ndarray, state: np.ndarray) -> Control:
        """Share ``(..., 1)`` of the full rudder rate, or in a trial of the limit of the angle."""
        task, turns, t = self._task, self._turns, self.tolerances
        heading = integrated = -task.HEADING_SCALE * observation[..., 0]
        off = np.zeros_like(heading)
        if np.isfinite(t.distance):
            integrated = task.track_scale * observation[..., 7]
            off = np.clip(integrated, -6.0 * t.distance, 6.0 * t.distance)
        deviation = np.stack([
            task.SWAY_SCALE * observation[..., 2] - self._steady(observation, turns.sway),
            -task.rate_scale * observation[..., 1],
            heading,
            self._ship.rudder_limit * observation[..., 4] - self._steady(observation, turns.rudder),
            off,
            state[..., 0],
        ], -1)  # fmt: skip
        turn = np.abs(task.command_scale * observation[..., 5]) / turns.yaw_rate[1]
        wanted = -(lookup(self._gains, np.rint(turn)) * deviation).sum(-1)
        # The integral waits while the steering gear is saturated, so that it cannot wind up.
        grown = state[..., 0] + self._vehicle.dt * integrated * (np.abs(wanted) < 1.0)
        integral = np.clip(grown, -t.integral_limit, t.integral_limit)
        return self._action(observation, wanted), integral[..., None]


@register_controller(TurningTrial, "lqg")
class TurningRegulator(TurningAutopilot):
    """The autopilot's regulator without its integral: no memory, and a bias under steady loads."""

    tolerances = replace(Tolerances(), integral=np.inf)


@register_controller(TurningTrial, "pid")
class TurningPID(_Helm):
    """A heading PID: the rudder by the errors of heading and yaw rate, and what the turn needs.

    Its plant is Nomoto's, the ship's linear model on a straight course reduced to first order; the
    rudder that the commanded steady turn needs is added. The steering gear follows with a tenth of
    the loop's time. On a track it heads for a point two ship lengths ahead (line of sight: Fossen
    2021, ch. 12).
    """

    AHEAD = 2.0  # ship lengths

    def _design(self) -> None:
        super()._design()
        dt, (A, B) = self._vehicle.dt, (m[0] for m in secant_models(self._ship, self._vehicle.dt))
        # one for one, as usual on ships: at an error of the heading the rudder is put as far over
        self._loop = Loop(*first_order(A[:2, :2], B[:2, 0], 1, dt), 1.0, 1.0, dt)
        self._gear = max(0.1 / self._loop.frequency, dt) * self._ship.rudder_rate

    @compiled
    def control(self, observation: np.ndarray, state: np.ndarray) -> Control:
        """Share ``(..., 1)`` of the full rudder rate, or in a trial of the limit of the angle."""
        task, limit, ahead = self._task, self._ship.rudder_limit, self.AHEAD * self._ship.length
        heading = task.HEADING_SCALE * observation[..., 0]
        if isinstance(task, Track):
            heading = heading - np.arctan2(task.track_scale * observation[..., 7], ahead)
        needed = self._steady(observation, self._turns.rudder)
        rate = task.rate_scale * observation[..., 1]
        rudder, integral = self._loop.act(heading, rate, state[..., 0], limit, needed)
        wanted = (rudder - limit * observation[..., 4]) / self._gear
        return self._action(observation, wanted), integral[..., None]


@register_controller(Track, AUTOPILOT)
class TrackAutopilot(TurningAutopilot):
    """Linear-quadratic regulator with integral action about the commanded turn, on its track.

    It acts on the observation alone: what it regulates is what the estimator believes, the current
    included, in which the observation's heading error already crabs.
    """

    kind, tolerances = Track, ON_TRACK

    def _design(self) -> None:
        t, scale = self.tolerances, self._task.track_scale
        self.tolerances = replace(
            t, distance=scale * t.distance, integral=scale * t.integral,
            integral_limit=scale * t.integral_limit,
        )  # fmt: skip
        super()._design()


@register_controller(Track, "lqg")
class TrackRegulator(TrackAutopilot):
    """The autopilot's regulator without its integral: no memory, and a bias under steady loads."""

    tolerances = replace(ON_TRACK, integral=np.inf)


@register_controller(Track, "pid")
class TrackPID(TurningPID):
    """A heading PID behind a line of sight."""

    kind = Track


@register_controller(TurningTrial, "constant-rudder")
class ConstantRudder(Controller):
    """The rudder of the trial, whatever is observed.

    It is the reference agent of ``ThesisCorvette-v0``.
    """

    kind = TurningTrial

    @compiled
    def control(self, observation: np.ndarray, state: np.ndarray) -> Control:
        """Rudder angle ``(..., 1)`` as a share of its limit."""
        share = self._task.helm / self._task.ship.rudder_limit
        return np.zeros_like(observation[..., :1]) + share, state
