"""Controllers of dives, with course and flight-path loops designed from the linearised vehicle."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple, cast

import numpy as np
from scipy.optimize import root

from agents.controllers import AUTOPILOT, register_controller
from agents.controllers.loops import Loop as PID
from agents.controllers.loops import first_order, regulator_gains, task_of
from estimators import wrap
from vessel_gym.system import System
from vessel_gym.tasks.dive import Dive
from vessel_gym.vehicles.auv import AUV, AUVParameters

_VERTICAL = ("w", "q", "theta")
_LATERAL = ("v", "p", "r", "phi", "psi")


@dataclass(frozen=True)
class DiveTolerances:
    """Deviations that count alike in the quadratic costs (Bryson's rule): each weight is 1 / tolerance^2."""

    direction: float = 0.06  # rad, of course and flight path
    rate: float = 0.4  # rad/s, of yaw and pitch
    fin: float = 0.3  # rad
    speed: float = 2.0  # s, time constant in which an error of speed is to vanish
    look_ahead: float = 1.0  # vehicle lengths
    offset: float = np.inf  # m off the path; infinite: left to the guidance


class Loop(NamedTuple):
    """A regulator about steady motions, which are tabulated over rising commands ``(m,)``.

    Attributes:
        gains: ``(k,)`` of the fin on the plane's states, of which the last is the direction, and on
            the distance from the path where that is regulated, too.
        command: flight-path angle [rad] or yaw rate [rad/s].
        drift: velocity through the water across the body [m/s].
        fin: rad.
        thrust: N.
        response: Angular acceleration [rad/s2] by the fin [rad], of the plane reduced to first
            order.
        damping: Of the angular velocity there [1/s].
    """

    gains: np.ndarray
    command: np.ndarray
    drift: np.ndarray
    fin: np.ndarray
    thrust: np.ndarray
    response: float
    damping: float

    def steady(self, command: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Drift, fin and thrust of the steady motions with commands ``(B,)``."""
        drift, fin, thrust = (
            np.interp(command, self.command, table) for table in (self.drift, self.fin, self.thrust)
        )
        return drift, fin, thrust


@cache
def vertical_loop(vehicle: AUV, tolerances: DiveTolerances) -> Loop:
    """The stern plane on heave, pitch rate and flight path, about steady dives and climbs of up to 45 deg."""
    speed, names = vehicle.body.cruise_speed, vehicle.state_names
    moving = [names.index(name) for name in ("u", "w", "q")]

    def motion(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        heave, pitch, stern, thrust = z
        return _state(vehicle, u=speed, w=heave, theta=pitch), _actuators(vehicle, stern, thrust)

    def residual(z: np.ndarray, angle: float) -> np.ndarray:
        changes = _changes(vehicle, *motion(z))[moving]
        return np.append(changes, z[1] - np.arctan2(z[0], speed) - angle)

    command = np.deg2rad(np.linspace(-45.0, 45.0, 91))
    table = _steady_motions(
        residual, command, np.array([0.0, 0.0, 0.0, vehicle.body.cruise_thrust])
    )
    level = motion(table[len(command) // 2])
    A, B = _plane(vehicle, *level, _VERTICAL, -2 if len(level[1]) > 1 else -1)
    gains = _gains(A, B, vehicle.dt, -1.0 / speed, 1, speed, tolerances)
    plant = first_order(A[:2, :2], B[:2, 0], 1, vehicle.dt)  # at a given pitch
    return Loop(gains, command, table[:, 0], table[:, 2], table[:, 3], *plant)


@cache
def lateral_loop(vehicle: AUV, tolerances: DiveTolerances) -> Loop:
    """The rudder on sway, roll, yaw rate and course, about steady level turns."""
    speed, names = vehicle.body.cruise_speed, vehicle.state_names
    moving = [names.index(name) for name in ("u", "v", "p", "r")]

    def motion(z: np.ndarray, rate: float) -> tuple[np.ndarray, np.ndarray]:
        sway, roll, rudder, thrust = z
        actuators = _actuators(vehicle, 0.0, thrust)
        actuators[0] = rudder
        return _state(vehicle, u=speed, v=sway, r=rate, phi=roll), actuators

    def residual(z: np.ndarray, rate: float) -> np.ndarray:
        return _changes(vehicle, *motion(z, rate))[moving]

    tightest = speed / (4.0 * vehicle.body.length)
    command = np.linspace(-tightest, tightest, 81)
    table = _steady_motions(
        residual, command, np.array([0.0, 0.0, 0.0, vehicle.body.cruise_thrust])
    )
    straight = motion(table[len(command) // 2], 0.0)
    A, B = _plane(vehicle, *straight, _LATERAL, 0)
    gains = _gains(A, B, vehicle.dt, 1.0 / speed, 2, speed, tolerances)
    plant = first_order(A[:4, :4], B[:4, 0], 2, vehicle.dt)  # on a given heading
    return Loop(gains, command, table[:, 0], table[:, 2], table[:, 3], *plant)


def _state(vehicle: AUV, **values: float) -> np.ndarray:
    """A state ``(n,)`` with these components, the others zero."""
    state = np.zeros(len(vehicle.state_names))
    for name, value in values.items():
        state[vehicle.state_names.index(name)] = value
    return state


def _actuators(vehicle: AUV, stern: float, thrust: float) -> np.ndarray:
    actuators = np.zeros(len(vehicle.action_names))
    actuators[-2:] = stern, thrust
    return actuators


def _after(vehicle: AUV, state: np.ndarray, actuators: np.ndarray) -> np.ndarray:
    """States ``(..., n)`` after a step with constant actuators."""
    control = np.concatenate([actuators, actuators], -1)
    return vehicle.drift(state, control, np.zeros(len(vehicle.ambient_flows)))


def _changes(vehicle: AUV, state: np.ndarray, actuators: np.ndarray) -> np.ndarray:
    """Mean rates of the state ``(n,)`` over a step."""
    return (_after(vehicle, state, actuators) - state) / vehicle.dt


def _steady_motions(
    residual: Callable[[np.ndarray, float], np.ndarray], command: np.ndarray, guess: np.ndarray
) -> np.ndarray:
    """Solutions ``(m, 4)`` of ``residual(z, command) = 0``, each found from its neighbour, the middle one first."""
    table, middle = np.empty((len(command), len(guess))), len(command) // 2
    for indices in (range(middle, len(command)), range(middle, -1, -1)):
        z = guess
        for i in indices:
            found = root(residual, z, args=(command[i],), tol=1e-12)
            if np.abs(found.fun).max() > 1e-9:
                raise RuntimeError(f"the vehicle has no steady motion at {command[i]:.3g}")
            table[i] = z = found.x
    return table


def _plane(
    vehicle: AUV, state: np.ndarray, actuators: np.ndarray, plane: tuple[str, ...], fin: int
) -> tuple[np.ndarray, np.ndarray]:
    """``A (k, k)`` and ``B (k, 1)`` of the states of a plane by one fin, by central differences of the vehicle's step.

    About a steady motion ``(n,)`` with its actuators ``(a,)``.
    """
    index, step = [vehicle.state_names.index(name) for name in plane], 1e-5
    offsets = step * np.eye(len(state))[index]
    constant = np.tile(actuators, (len(plane), 1))
    A = (_after(vehicle, state + offsets, constant) - _after(vehicle, state - offsets, constant)).T
    push = np.zeros_like(actuators)
    push[fin] = step
    B = _after(vehicle, state, actuators + push) - _after(vehicle, state, actuators - push)
    return A[index] / (2.0 * step), B[index, None] / (2.0 * step)


def _gains(
    A: np.ndarray,
    B: np.ndarray,
    dt: float,
    drift: float,
    rate: int,
    speed: float,
    tolerances: DiveTolerances,
) -> np.ndarray:
    """Gains ``(k,)``, or ``(k + 1,)`` with the distance from the path, of the linear-quadratic regulator of a plane.

    Its states move by ``A (k, k)`` and ``B (k, 1)``: the first moves the direction by ``drift``
    [rad per m/s], number ``rate`` is the angular velocity, the last the angle; ``speed`` [m/s] is
    that along the path.
    """
    direction = np.zeros((1, len(A)))
    direction[0, 0], direction[0, -1] = drift, 1.0
    Q = direction.T @ direction / tolerances.direction**2
    Q[rate, rate] += tolerances.rate**-2
    if np.isfinite(tolerances.offset):
        A = np.block([[A, np.zeros((len(A), 1))], [speed * dt * direction, np.ones((1, 1))]])
        B = np.concatenate([B, np.zeros((1, 1))])
        Q = np.pad(Q, (0, 1))
        Q[-1, -1] = tolerances.offset**-2
    R = np.array([[tolerances.fin**-2]])
    return regulator_gains(A, B, Q, R)[0]


class _Seen(NamedTuple):
    """Quantities that controllers take from an observation, ``(B,)`` each."""

    surge: np.ndarray  # m/s too fast
    sway: np.ndarray  # m/s
    heave: np.ndarray  # m/s
    rates: tuple[np.ndarray, np.ndarray, np.ndarray]  # rad/s of roll, pitch and yaw
    roll: np.ndarray  # rad
    climb: np.ndarray  # rad, flight-path angle over ground
    climb_of_path: np.ndarray  # rad
    turn: np.ndarray  # rad, from the heading to the path's course
    drift: np.ndarray  # rad, from the heading to the course over ground
    turning: np.ndarray  # rad/s that the path asks for
    above: np.ndarray  # m above the path
    aside: np.ndarray  # m to starboard of the path


@register_controller(Dive, AUTOPILOT)
class DiveAutopilot:
    """Line-of-sight guidance onto the path; regulators that hold the course and the flight path that it asks for.

    It acts on the observation alone. The guidance aims at a point on the path's tangent a
    look-ahead distance on (Fossen 2011, sec. 10.3) and adds the turn that the path makes; the
    regulators act on deviations from the steady dive and turn that fit, so that the righting moment
    and the buoyancy need no integral.

    Args:
        system: The environment's system.

    Raises:
        ValueError: if the system's task is no dive.
    """

    tolerances = DiveTolerances()  # of the design

    def __init__(self, system: System) -> None:
        self._task, vehicle = task_of(system, Dive, "flies dives", AUV), cast(AUV, system.vehicle)
        tolerances, self._body = self.tolerances, vehicle.body
        self._ahead = tolerances.look_ahead * vehicle.body.length
        self._vertical = vertical_loop(vehicle, tolerances)
        self._lateral = (
            lateral_loop(vehicle, tolerances) if "rudder" in vehicle.action_names else None
        )
        self._thrust_gain = vehicle.body.mass / tolerances.speed

    def reset(self, num_envs: int) -> None:
        """Nothing to forget: the autopilot has no memory."""

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Actions ``(B, a)``: fins and thrust."""
        seen, speed = _seen(self._task, observations), self._body.cruise_speed
        wanted = seen.climb_of_path - np.arctan(seen.above / self._ahead)
        heave, stern, thrust = self._vertical.steady(wanted)
        drift = seen.heave - heave
        deviation = [drift, seen.rates[1], seen.climb - wanted + drift / speed, seen.above]
        fins = [stern - _stacked(deviation, self._vertical) @ self._vertical.gains]

        if self._lateral is not None:
            course = wrap(seen.turn - np.arctan(seen.aside / self._ahead) - seen.drift)
            sway, rudder, turning = self._lateral.steady(seen.turning)
            drift = seen.sway - sway
            rates = [seen.rates[0], seen.rates[2] - seen.turning]
            deviation = [drift, *rates, seen.roll, -course - drift / speed, seen.aside]
            fins.insert(0, rudder - _stacked(deviation, self._lateral) @ self._lateral.gains)
            thrust = thrust + turning - self._body.cruise_thrust
        return _actions(self._body, fins, thrust - self._thrust_gain * seen.surge)


@register_controller(Dive, "lqg")
class DiveRegulator(DiveAutopilot):
    """The linear-quadratic regulator of both planes with the distance from the path as a state, and no guidance.

    About the same steady motions as the autopilot, whose line-of-sight guidance this one does
    without.
    """

    tolerances = replace(DiveTolerances(), look_ahead=np.inf, offset=Dive.TRACK_TOLERANCE)


@register_controller(Dive, "pid")
class DivePID(DiveAutopilot):
    """Line-of-sight guidance; a PID loop each for course and flight path, a PI loop for the speed.

    The loops know nothing of each other and of the steady motion that the path takes, but for the
    thrust at cruising speed: their integrals have to find it. Their plants are the planes of the
    linearised vehicle, reduced to first order.
    """

    def __init__(self, system: System) -> None:
        super().__init__(system)
        t, mass, dt = self.tolerances, self._body.mass, system.vehicle.dt
        climb, course = self._vertical, self._lateral
        self._climb = PID(-climb.response, climb.damping, t.direction, t.fin, dt)
        self._course = None
        if course is not None:
            self._course = PID(course.response, course.damping, t.direction, t.fin, dt)
        self._speed = PID(1.0 / mass, None, t.speed, mass, dt)

    def reset(self, num_envs: int) -> None:
        """Clear the integrals."""
        for loop in (self._climb, self._speed, self._course):
            if loop is not None:
                loop.reset(num_envs)

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Actions ``(B, a)``: fins and thrust."""
        seen, body = _seen(self._task, observations), self._body
        limit = body.fin_limit
        climb = seen.climb_of_path - np.arctan(seen.above / self._ahead) - seen.climb
        fins = [-self._climb.act(climb, -seen.rates[1], -limit, limit)]
        if self._course is not None:
            course = wrap(seen.turn - np.arctan(seen.aside / self._ahead) - seen.drift)
            fins.insert(0, self._course.act(course, seen.turning - seen.rates[2], -limit, limit))
        thrust = self._speed.act(-seen.surge, 0.0, 0.0, body.thrust_limit, body.cruise_thrust)
        return _actions(body, fins, thrust)


def _seen(task: Dive, observations: np.ndarray) -> _Seen:
    o, speed = task.named(observations), task.auv.cruise_speed
    zero = np.zeros(len(observations))
    roll, turn = o.get("roll", zero), o.get("heading error", zero)
    surge, sway, heave = o["surge error"] + speed, o.get("sway", zero), o["heave"]
    over_ground = (
        surge + o["current ahead"],
        sway + o.get("current to starboard", zero),
        heave + o["current below"],
    )
    ahead, aside, below = _levelled(*over_ground, roll, o["pitch"])
    path = _levelled(
        o["path ahead"], o.get("path to starboard", zero), o["path below"], roll, o["pitch"]
    )
    return _Seen(
        surge=o["surge error"],
        sway=sway,
        heave=heave,
        rates=(o.get("roll rate", zero), o["pitch rate"], o.get("yaw rate", zero)),
        roll=roll,
        climb=np.arctan2(-below, np.hypot(ahead, aside)),
        climb_of_path=o["pitch error"] + o["pitch"],
        turn=turn,
        drift=np.arctan2(aside, ahead),
        turning=o.get("curvature", zero) * speed,
        above=path[2],
        aside=path[0] * np.sin(turn) - path[1] * np.cos(turn),
    )


def _stacked(deviation: list[np.ndarray], loop: Loop) -> np.ndarray:
    """The part of a deviation that a loop regulates, ``(B, k)``."""
    return np.stack(deviation[: len(loop.gains)], -1)


def _actions(body: AUVParameters, fins: list[np.ndarray], thrust: np.ndarray) -> np.ndarray:
    """Actions ``(B, a)`` that ask for fins [rad] and thrust [N]."""
    actions = [fin / body.fin_limit for fin in fins] + [2.0 * thrust / body.thrust_limit - 1.0]
    return np.clip(np.stack(actions, -1), -1.0, 1.0).astype(np.float32)


def _levelled(
    x: np.ndarray, y: np.ndarray, z: np.ndarray, roll: np.ndarray, pitch: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A vector in body axes as seen along the heading: ahead, to starboard, down."""
    aside, below = y * np.cos(roll) - z * np.sin(roll), y * np.sin(roll) + z * np.cos(roll)
    return (
        x * np.cos(pitch) + below * np.sin(pitch),
        aside,
        below * np.cos(pitch) - x * np.sin(pitch),
    )
