"""Controllers of a ship's turns: free, on a track, and in a trial whose action is the rudder angle.

All are designed from the ship's linear models.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from agents.controllers import AUTOPILOT, register_controller
from agents.controllers.loops import Loop, first_order, parts_of, regulator_gains
from vessel_gym.system import System
from vessel_gym.tasks.track import Track
from vessel_gym.tasks.turning_circle import TurningCircle
from vessel_gym.tasks.turning_trial import TurningTrial
from vessel_gym.vehicles.corvette import secant_models, steady_turns
from vessel_gym.vehicles.corvette_equations import CorvetteParameters


@dataclass(frozen=True)
class Tolerances:
    """Deviations that count alike in the quadratic cost (Bryson's rule).

    Each weight is 1 / tolerance^2: what is infinite does not count.
    """

    heading: float = 0.05  # rad, the task's own tolerance
    yaw_rate: float = 0.02  # rad/s
    rudder_rate: float = 0.5  # of the full rate
    integral: float = 1.0  # rad s of heading or, on a track, m s of distance; infinite: none
    integral_limit: float = 4.0
    # rad, for which a PID asks at the tolerance of the heading: one for one, as usual on ships
    rudder: float = 0.05
    distance: float = np.inf  # m from the track, if there is one
    others: float = np.inf  # m/s of sway, rad of the rudder

    @property
    def on_track(self) -> bool:
        """True for a ship on a track."""
        return bool(np.isfinite(self.distance))


ON_TRACK = Tolerances(
    rudder_rate=0.7, integral=1000.0, integral_limit=2000.0, distance=10.0, others=1000.0
)


@cache
def gains(ship: CorvetteParameters, dt: float, tolerances: Tolerances) -> np.ndarray:
    """LQ gains ``(k, n)`` of the rudder rate for each of `steady_turns`.

    The states are deviations from the steady turn in (v, r, psi, rudder), on a track the distance,
    and their integral where there is one. The design model is the filters' secant model of the
    commanded turn.
    """
    t, per_step, K = tolerances, ship.rudder_rate * dt, []
    scales = [t.others, t.yaw_rate, t.heading, t.others, t.distance, t.integral]
    kept = [True, True, True, True, t.on_track, np.isfinite(t.integral)]
    Q = np.diag((1.0 / np.array(scales)[kept]) ** 2)
    for speed, a, b in zip(steady_turns(ship).speed, *secant_models(ship, dt), strict=True):
        A, B = np.eye(len(Q)), np.zeros((len(Q), 1))
        A[:3, :3], A[:3, 3] = a, b[:, 0]
        if t.on_track:
            A[4, :3] = dt * np.array([1.0, 0.5 * dt * speed, speed])
        if np.isfinite(t.integral):
            A[-1, 4 if t.on_track else 2] = dt
        # the rudder moves linearly within the step
        B[:3, 0], B[3, 0] = 0.5 * per_step * b[:, 0], per_step
        K.append(regulator_gains(A, B, Q, np.array([[t.rudder_rate**-2]]))[0])
    return np.array(K)


class _Helm:
    """A controller of the rudder; in a `TurningTrial` it asks for the angle that follows.

    Args:
        system: The environment's system (its task's scales, its ship).

    Raises:
        ValueError: if the system's task is another.
    """

    kind: type = TurningCircle
    tolerances = Tolerances()  # of the design

    def __init__(self, system: System) -> None:
        self._task, vehicle = parts_of(system, self.kind)
        self._ship, self._dt, self._turns = (
            self._task.ship,
            vehicle.dt,
            steady_turns(self._task.ship),
        )
        self._design()
        self.reset(1)

    def _design(self) -> None:
        raise NotImplementedError

    def reset(self, num_envs: int) -> None:
        """Clear the integral."""
        raise NotImplementedError

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Share ``(B, 1)`` of the full rudder rate; in a trial, of the limit of the angle."""
        rate = np.clip(self._rate(observations), -1.0, 1.0).astype(np.float32)[:, None]
        if not isinstance(self._task, TurningTrial):
            return rate
        turn = self._ship.rudder_rate * self._dt / self._ship.rudder_limit
        return np.clip(observations[:, 4:5] + turn * rate, -1.0, 1.0).astype(np.float32)

    def _rate(self, observations: np.ndarray) -> np.ndarray:
        raise NotImplementedError

    def _steady(self, observations: np.ndarray, table: np.ndarray) -> np.ndarray:
        """Entries of a table of steady turns for the commanded yaw rates."""
        commanded = self._task.command_scale * observations[:, 5]
        return np.sign(commanded) * np.interp(np.abs(commanded), self._turns.yaw_rate, table)


@register_controller(TurningCircle, AUTOPILOT)
class TurningAutopilot(_Helm):
    """Linear-quadratic regulator with integral action about the commanded steady turn.

    It acts on the observation alone: what it regulates is what the estimator believes. No gain is
    chosen by hand: they follow from the linear model and the task's own tolerances.
    """

    def _design(self) -> None:
        self._gains = gains(self._ship, self._dt, self.tolerances)

    def reset(self, num_envs: int) -> None:
        """Clear the integral."""
        self._integral = np.zeros(num_envs)

    def _rate(self, observations: np.ndarray) -> np.ndarray:
        task, turns, t = self._task, self._turns, self.tolerances
        heading = integrated = -task.HEADING_SCALE * observations[:, 0]
        deviation = [
            task.SWAY_SCALE * observations[:, 2] - self._steady(observations, turns.sway),
            -task.rate_scale * observations[:, 1],
            heading,
            self._ship.rudder_limit * observations[:, 4] - self._steady(observations, turns.rudder),
        ]
        if t.on_track:
            integrated = task.TRACK_SCALE * observations[:, 7]
            deviation.append(np.clip(integrated, -6.0 * t.distance, 6.0 * t.distance))
        deviation.append(self._integral)
        turn = np.abs(task.command_scale * observations[:, 5]) / turns.yaw_rate[1]
        gains = self._gains[np.minimum(np.rint(turn).astype(int), len(self._gains) - 1)]
        wanted = -np.vecdot(gains, np.stack(deviation[: gains.shape[1]], -1))
        # The integral waits while the steering gear is saturated, so that it cannot wind up.
        grown = self._integral + self._dt * integrated * (np.abs(wanted) < 1.0)
        self._integral = np.clip(grown, -t.integral_limit, t.integral_limit)
        return wanted


@register_controller(TurningCircle, "lqg")
class TurningRegulator(TurningAutopilot):
    """The autopilot's regulator without its integral: no memory, and a bias under steady loads."""

    tolerances = replace(Tolerances(), integral=np.inf)


@register_controller(TurningCircle, "pid")
class TurningPID(_Helm):
    """A heading PID: the rudder by the errors of heading and yaw rate, and what the turn needs.

    Its plant is Nomoto's, the ship's linear model on a straight course reduced to first order; the
    rudder that the commanded steady turn needs is added. The steering gear follows with a tenth of
    the loop's time. On a track it heads for a point two ship lengths ahead (line of sight: Fossen
    2021, ch. 12).
    """

    AHEAD = 2.0  # ship lengths

    def _design(self) -> None:
        A, B = (table[0] for table in secant_models(self._ship, self._dt))
        plant, t = first_order(A[:2, :2], B[:2, 0], 1, self._dt), self.tolerances
        self._loop = Loop(*plant, t.heading, t.rudder, self._dt)
        self._gear = max(0.1 / self._loop.frequency, self._dt) * self._ship.rudder_rate

    def reset(self, num_envs: int) -> None:
        """Clear the integral."""
        self._loop.reset(num_envs)

    def _rate(self, observations: np.ndarray) -> np.ndarray:
        task, ship, limit = self._task, self._ship, self._ship.rudder_limit
        heading = task.HEADING_SCALE * observations[:, 0]
        if self.tolerances.on_track:
            heading -= np.arctan2(task.TRACK_SCALE * observations[:, 7], self.AHEAD * ship.length)
        needed = self._steady(observations, self._turns.rudder)
        rate = task.rate_scale * observations[:, 1]
        rudder = self._loop.act(heading, rate, -limit, limit, needed)
        return (rudder - limit * observations[:, 4]) / self._gear


@register_controller(Track, AUTOPILOT)
class TrackAutopilot(TurningAutopilot):
    """Linear-quadratic regulator with integral action about the commanded turn, on its track.

    It acts on the observation alone: what it regulates is what the estimator believes, the current
    included, in which the observation's heading error already crabs.
    """

    kind, tolerances = Track, ON_TRACK


@register_controller(Track, "lqg")
class TrackRegulator(TrackAutopilot):
    """The autopilot's regulator without its integral: no memory, and a bias under steady loads."""

    tolerances = replace(ON_TRACK, integral=np.inf)


@register_controller(Track, "pid")
class TrackPID(TurningPID):
    """A heading PID behind a line of sight."""

    kind, tolerances = Track, ON_TRACK


@register_controller(TurningTrial, "constant-rudder")
class ConstantRudder:
    """The rudder of the trial, whatever is observed: the reference agent of ``ThesisCorvette-v0``.

    Args:
        system: The environment's system.
    """

    def __init__(self, system: System) -> None:
        task, _ = parts_of(system, TurningTrial)
        self._share = task.helm / task.ship.rudder_limit

    def reset(self, num_envs: int) -> None:
        """There is nothing to forget."""

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Rudder angle ``(B, 1)`` as a share of its limit."""
        return np.full((len(observations), 1), self._share, np.float32)
