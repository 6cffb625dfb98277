"""Controllers of a ship's turns: free, on a track, and in a trial whose action is the rudder angle.

All are designed from the ship's linear models.
"""

from functools import partialmethod
from typing import Any

import numpy as np

from agents.controllers import AUTOPILOT, register_controller
from agents.controllers.loops import (
    Control,
    Controller,
    bryson,
    first_order,
    pid_gains,
    regulator_gains,
)
from estimators import Log
from estimators.engine import compiled
from vessel_gym.system import System
from vessel_gym.tasks.channel import Channel
from vessel_gym.tasks.track import Steering, Track
from vessel_gym.tasks.turning import TurningTrial
from vessel_gym.vehicles.corvette import secant_models, steady_turns
from vessel_gym.vehicles.corvette_equations import CorvetteParameters
from vessel_gym.vehicles.corvette_thesis import ThesisCorvette


def gains(
    ship: CorvetteParameters, dt: float, yaw_rate: float, heading: float, distance: float,
    integral: float, rudder_rate: float,
) -> np.ndarray:  # fmt: skip
    """LQ gains of the rudder rate as polynomials ``(7, 6)`` of the commanded yaw rate.

    `numpy.polyval` takes them, at a yaw rate that is 1 for the tightest of `steady_turns`. They
    interpolate the gains for seven turns, at Chebyshev's nodes. The states are deviations from the
    steady turn in (v, r, psi, rudder), the distance from a track and an integral, of that or else
    of psi. The design model is the filters' secant model of the commanded turn.

    Args:
        ship: Parameters of the ship.
        dt: Time step [s].
        yaw_rate: Tolerance [rad/s]: deviations of as many tolerances count alike in the cost.
        heading: Tolerance [rad].
        distance: Tolerance [m]; infinite if there is no track.
        integral: Tolerance [rad s or m s]; infinite for none.
        rudder_rate: Tolerance, as a share of the full rate.

    Raises:
        numpy.linalg.LinAlgError: if there are no such gains.
    """
    turns, per_step = steady_turns(ship), ship.rudder_rate * dt
    last = len(turns.speed) - 1
    nodes = np.rint(0.5 * last * (1.0 - np.cos(np.linspace(0.0, np.pi, 7)))).astype(int)
    (a, b), speed = (table[nodes] for table in secant_models(ship, dt)), turns.speed[nodes]
    A, B = np.tile(np.eye(6), (len(nodes), 1, 1)), np.zeros((len(nodes), 6, 1))
    A[:, :3, :3], A[:, :3, 3] = a, b[..., 0]
    A[:, 4, 0], A[:, 4, 1], A[:, 4, 2] = dt, 0.5 * dt**2 * speed, dt * speed
    A[:, 5, 4 if np.isfinite(distance) else 2] = dt
    # the rudder moves linearly within the step
    B[:, :3], B[:, 3] = 0.5 * per_step * b, per_step
    tolerances = np.array([np.inf, yaw_rate, heading, np.inf, distance, integral])
    there, K = np.isfinite(tolerances) | (np.arange(6) < 4), np.zeros((len(nodes), 6))
    Q, R = bryson(*tolerances[there]), bryson(rudder_rate)
    K[:, there] = regulator_gains(A[:, there][..., there], B[:, there], Q, R)[:, 0]
    return np.polyfit(nodes / last, K, len(nodes) - 1)


def _action(observation: np.ndarray, rate: np.ndarray, task: Steering, vehicle: Any) -> np.ndarray:
    """Action ``(..., 1)`` for a share ``(...)`` of the full rudder rate.

    For a `ThesisCorvette` it asks for the angle that follows.
    """
    action = np.clip(rate, -1.0, 1.0)
    if isinstance(vehicle, ThesisCorvette):
        turn = task.ship.rudder_rate * vehicle.dt / task.ship.rudder_limit
        action = np.clip(observation[..., 4] + turn * action, -1.0, 1.0)
    return action[..., None]


def _steady(observation: np.ndarray, values: np.ndarray, task: Steering) -> np.ndarray:
    """Values of the steady turns, interpolated at the commanded yaw rate ``(...)``."""
    commanded = task.command_scale * observation[..., 5]
    return np.sign(commanded) * steady_turns(task.ship).interpolated(values, commanded)


class _Regulator(Controller):
    """Linear-quadratic regulator about the commanded steady turn.

    It acts on the observation alone: what it regulates is what the estimator believes. No gain is
    chosen by hand: they follow from the linear model and from tolerances. Only ratios of these
    matter, so that of the rudder's rate is fixed. The ``numbers`` are the limits of the distance
    and of the integral, and `gains`.
    """

    state_size = 1  # the integral

    def _design(self, limit: float, *tolerances: float) -> None:
        """Set the numbers from tolerances as of `gains`, and the integral's limit in its own."""
        _, _, distance, integral, _ = tolerances
        K = gains(self._task.ship, self._vehicle.dt, *tolerances)
        self.numbers = np.array([6.0 * distance, limit * integral, *K.flat])

    @staticmethod
    @compiled
    def control(
        observation: np.ndarray, state: np.ndarray, numbers: np.ndarray, *, task: Any, vehicle: Any
    ) -> Control:
        """Share ``(..., 1)`` of the full rudder rate, or in a trial of the limit of the angle."""
        turns, farthest, most = steady_turns(task.ship), numbers[0], numbers[1]
        heading = integrated = -task.HEADING_SCALE * observation[..., 0]
        off = np.zeros_like(heading)
        if isinstance(task, Track):
            integrated = task.track_scale * observation[..., 7]
            off = np.clip(integrated, -farthest, farthest)
        sway, rudder = (_steady(observation, each, task) for each in (turns.sway, turns.rudder))
        deviation = np.stack([
            task.SWAY_SCALE * observation[..., 2] - sway,
            -task.rate_scale * observation[..., 1],
            heading,
            task.ship.rudder_limit * observation[..., 4] - rudder,
            off,
            state[..., 0],
        ], -1)  # fmt: skip
        turn = np.abs(task.command_scale * observation[..., 5:6]) / turns.yaw_rate[-1]
        powers = np.minimum(turn, 1.0) ** np.arange(6, -1, -1)
        K = np.vecmat(powers, numbers[2:].reshape(7, 6))
        wanted = -(K * deviation).sum(-1)
        # The integral waits while the steering gear is saturated, so that it cannot wind up.
        grown = state[..., 0] + vehicle.dt * integrated * (np.abs(wanted) < 1.0)
        integral = np.clip(grown, -most, most)
        return _action(observation, wanted, task, vehicle), integral[..., None]


@register_controller(TurningTrial, AUTOPILOT)
class TurningAutopilot(_Regulator):
    """Linear-quadratic regulator with integral action about the commanded steady turn.

    Args:
        system: The environment's system.
        yaw_rate: Tolerance [rad/s].
        heading: Tolerance [rad], by default the task's own.
        integral: Tolerance of the integral of the heading error [rad s]; it stays within four.
    """

    kind = TurningTrial
    tunable = {
        "yaw_rate": Log(2e-4, 2.0), "heading": Log(5e-4, 5.0), "integral": Log(0.01, 100.0)
    }  # fmt: skip

    def __init__(
        self, system: System, yaw_rate: float = 0.02, heading: float = 0.05, integral: float = 1.0
    ) -> None:
        super().__init__(system)
        self._design(4.0, yaw_rate, heading, np.inf, integral, 0.5)


@register_controller(TurningTrial, "lqg")
class TurningRegulator(TurningAutopilot):
    """The autopilot's regulator without its integral: no memory, and a bias under steady loads."""

    tunable = {name: TurningAutopilot.tunable[name] for name in ("yaw_rate", "heading")}
    __init__ = partialmethod(TurningAutopilot.__init__, integral=np.inf)


@register_controller(Track, AUTOPILOT)
class TrackAutopilot(_Regulator):
    """Linear-quadratic regulator with integral action about the commanded turn, on its track.

    It counters the current, too, in which the observation's heading error already crabs.

    Args:
        system: The environment's system.
        yaw_rate: Tolerance [rad/s].
        heading: Tolerance [rad].
        distance: Tolerance from the track, in `Track.track_scale`; at most six count.
        integral: Tolerance of the integral of the distance, in `Track.track_scale` seconds; it
            stays within two.
    """

    kind = Track
    tunable = {
        "yaw_rate": Log(1e-3, 10.0), "heading": Log(5e-3, 50.0), "distance": Log(0.01, 100.0),
        "integral": Log(0.5, 5000.0),
    }  # fmt: skip

    def __init__(
        self, system: System, yaw_rate: float = 0.05, heading: float = 0.12, distance: float = 0.75,
        integral: float = 80.0,
    ) -> None:  # fmt: skip
        super().__init__(system)
        scale = self._task.track_scale
        self._design(2.0, yaw_rate, heading, scale * distance, scale * integral, 0.7)


@register_controller(Channel, AUTOPILOT)
class ChannelAutopilot(TrackAutopilot):
    """The autopilot of a track, with tolerances that were tuned in channels."""

    __init__ = partialmethod(
        TrackAutopilot.__init__, yaw_rate=0.2, heading=0.6, distance=1.0, integral=55.0
    )


@register_controller(Track, "lqg")
class TrackRegulator(TrackAutopilot):
    """A `TrackAutopilot` without its integral: no memory, and a bias under steady loads."""

    tunable = {name: TrackAutopilot.tunable[name] for name in ("yaw_rate", "heading", "distance")}
    __init__ = partialmethod(TrackAutopilot.__init__, integral=np.inf)


@register_controller(TurningTrial, "pid")
class TurningPID(Controller):
    """A heading PID: the rudder by the errors of heading and yaw rate, and what the turn needs.

    Its plant is Nomoto's, the ship's linear model on a straight course reduced to first order; the
    rudder that the commanded steady turn needs is added. The steering gear follows with a tenth of
    the loop's time. The ``numbers`` are the gains, the change of the rudder angle for the full
    rate, and the look-ahead distance [m].

    Args:
        system: The environment's system.
        proportional: Rudder for an error of the heading; on ships it is usually one for one.
        integral: Integral gain, as a share; see `pid_gains`.
        damping: Damping ratio.
        ahead: Distance of the point for which it heads on a track, in ship lengths.
    """

    kind: type = TurningTrial
    state_size = 1  # the integral
    tunable = {
        "proportional": Log(0.01, 100.0), "integral": Log(0.001, 10.0), "damping": Log(0.1, 10.0)
    }  # fmt: skip

    def __init__(
        self, system: System, proportional: float = 1.0, integral: float = 0.1,
        damping: float = 1.0, ahead: float = 2.0,
    ) -> None:  # fmt: skip
        super().__init__(system)
        ship, dt = self._task.ship, self._vehicle.dt
        A, B = (table[0] for table in secant_models(ship, dt))
        plant = first_order(A[:2, :2], B[:2, 0], 1, dt)
        *found, frequency = pid_gains(*plant, proportional, integral, damping)
        gear = max(0.1 / frequency, dt) * ship.rudder_rate
        self.numbers = np.array([*found, gear, ahead * ship.length])

    @staticmethod
    @compiled
    def control(
        observation: np.ndarray, state: np.ndarray, numbers: np.ndarray, *, task: Any, vehicle: Any
    ) -> Control:
        """Share ``(..., 1)`` of the full rudder rate, or in a trial of the limit of the angle."""
        limit, rate = task.ship.rudder_limit, task.rate_scale * observation[..., 1]
        heading = task.HEADING_SCALE * observation[..., 0]
        if isinstance(task, Track):
            off = task.track_scale * observation[..., 7]
            heading = heading - np.arctan2(off, numbers[4])
        needed = _steady(observation, steady_turns(task.ship).rudder, task)
        errors = np.stack([heading, state[..., 0], rate], -1)
        wanted = needed + (numbers[:3] * errors).sum(-1)
        # The integral waits while the rudder is at its limit, so that it cannot wind up.
        integral = state[..., 0] + vehicle.dt * heading * (np.abs(wanted) < limit)
        change = np.clip(wanted, -limit, limit) - limit * observation[..., 4]
        return _action(observation, change / numbers[3], task, vehicle), integral[..., None]


@register_controller(Track, "pid")
class TrackPID(TurningPID):
    """A heading PID behind a line of sight (Fossen 2021, ch. 12)."""

    kind = Track
    tunable = TurningPID.tunable | {
        "integral": Log(0.002, 20.0), "damping": Log(0.02, 2.0), "ahead": Log(0.04, 400.0)
    }  # fmt: skip
    __init__ = partialmethod(TurningPID.__init__, integral=0.2, damping=0.2, ahead=4.0)


@register_controller(TurningTrial, "constant-rudder")
class ConstantRudder(Controller):
    """The rudder of the trial, whatever is observed.

    It is the reference agent of ``ThesisCorvette-v0``.
    """

    kind = TurningTrial

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Rudder angles ``(B, 1)`` as shares of their limit."""
        share = self._task.helm / self._task.ship.rudder_limit
        return np.full((len(observations), 1), share, np.float32)
