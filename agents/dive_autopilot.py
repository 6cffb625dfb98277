"""Line-of-sight guidance for dives, with course and flight-path loops designed from the linearised vehicle."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.optimize import root

from agents.regulator import regulator_gains
from estimators import wrap
from vessel_gym.system import System
from vessel_gym.tasks.dive import Dive
from vessel_gym.vehicles.auv import AUV

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


class Loop(NamedTuple):
    """A regulator about steady motions, which are tabulated over rising commands ``(m,)``.

    Attributes:
        gains: ``(k,)`` of the fin on the plane's states; the last of them is the direction.
        command: flight-path angle [rad] or yaw rate [rad/s].
        drift: velocity through the water across the body [m/s].
        fin: rad.
        thrust: N.
    """

    gains: np.ndarray
    command: np.ndarray
    drift: np.ndarray
    fin: np.ndarray
    thrust: np.ndarray

    def steady(self, command: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Drift, fin and thrust of the steady motions with commands ``(B,)``."""
        drift, fin, thrust = (np.interp(command, self.command, table) for table in self[2:])
        return drift, fin, thrust


@cache
def vertical_loop(vehicle: AUV, tolerances: DiveTolerances) -> Loop:
    """The stern plane on heave, pitch rate and flight path, about steady dives and climbs of up to 45 deg."""
    speed, names = vehicle.body.cruise_speed, vehicle.truth_names
    moving = [names.index(name) for name in ("u", "w", "q")]

    def motion(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        heave, pitch, stern, thrust = z
        return _state(vehicle, u=speed, w=heave, theta=pitch), _actuators(vehicle, stern, thrust)

    def residual(z: np.ndarray, angle: float) -> np.ndarray:
        changes = _changes(vehicle, *motion(z))[moving]
        return np.append(changes, z[1] - np.arctan2(z[0], speed) - angle)

    command = np.deg2rad(np.linspace(-45.0, 45.0, 91))
    table = _steady_motions(residual, command, np.array([0.0, 0.0, 0.0, vehicle.body.cruise_thrust]))
    level = motion(table[len(command) // 2])
    gains = _gains(vehicle, *level, _VERTICAL, -2 if len(level[1]) > 1 else -1, -1.0 / speed, 1, tolerances)
    return Loop(gains, command, table[:, 0], table[:, 2], table[:, 3])


@cache
def lateral_loop(vehicle: AUV, tolerances: DiveTolerances) -> Loop:
    """The rudder on sway, roll, yaw rate and course, about steady level turns."""
    speed, names = vehicle.body.cruise_speed, vehicle.truth_names
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
    table = _steady_motions(residual, command, np.array([0.0, 0.0, 0.0, vehicle.body.cruise_thrust]))
    straight = motion(table[len(command) // 2], 0.0)
    gains = _gains(vehicle, *straight, _LATERAL, 0, 1.0 / speed, 2, tolerances)
    return Loop(gains, command, table[:, 0], table[:, 2], table[:, 3])


def _state(vehicle: AUV, **values: float) -> np.ndarray:
    """A state ``(n,)`` with these components, the others zero."""
    state = np.zeros(len(vehicle.truth_names))
    for name, value in values.items():
        state[vehicle.truth_names.index(name)] = value
    return state


def _actuators(vehicle: AUV, stern: float, thrust: float) -> np.ndarray:
    actuators = np.zeros(len(vehicle.action_names))
    actuators[-2:] = stern, thrust
    return actuators


def _after(vehicle: AUV, state: np.ndarray, actuators: np.ndarray) -> np.ndarray:
    """States ``(..., n)`` after a step with the actuators held."""
    control = np.concatenate([actuators, actuators], -1)
    return vehicle.advance(state, control, vehicle.vector(np.ones(vehicle.normals)))


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


def _gains(
    vehicle: AUV, state: np.ndarray, actuators: np.ndarray, plane: tuple[str, ...], fin: int, drift: float, rate: int,
    tolerances: DiveTolerances,
) -> np.ndarray:  # fmt: skip
    """Gains ``(k,)`` of the linear-quadratic regulator of one plane, by central differences of the vehicle's step.

    Args:
        vehicle: What is regulated.
        state: Steady motion ``(n,)``.
        actuators: Its actuators ``(a,)``.
        plane: States of the plane; the first moves the direction by ``drift`` a unit, the last is its angle.
        fin: Which actuator.
        drift: rad per m/s.
        rate: Which state of the plane is the rate.
        tolerances: What deviations cost.
    """
    index, step = [vehicle.truth_names.index(name) for name in plane], 1e-5
    offsets = step * np.eye(len(state))[index]
    held = np.tile(actuators, (len(plane), 1))
    A = (_after(vehicle, state + offsets, held) - _after(vehicle, state - offsets, held)).T
    push = np.zeros_like(actuators)
    push[fin] = step
    B = _after(vehicle, state, actuators + push) - _after(vehicle, state, actuators - push)
    A, B = A[index] / (2.0 * step), B[index, None] / (2.0 * step)
    direction = np.zeros((1, len(plane)))
    direction[0, 0], direction[0, -1] = drift, 1.0
    Q = direction.T @ direction / tolerances.direction**2
    Q[rate, rate] += tolerances.rate**-2
    R = np.array([[tolerances.fin**-2]])
    return regulator_gains(A, B, Q, R)[0]


class DiveAutopilot:
    """Line-of-sight guidance onto the path; regulators that hold the course and the flight path that it asks for.

    It acts on the observation alone. The guidance aims at a point on the path's tangent a look-ahead distance on
    (Fossen 2011, sec. 10.3) and adds the turn that the path makes; the regulators act on deviations from the steady
    dive and turn that fit, so that the righting moment and the buoyancy need no integral.

    Args:
        system: The environment's system.
        tolerances: The design's tolerances.

    Raises:
        ValueError: if the system's task is no dive.
    """

    def __init__(self, system: System, tolerances: DiveTolerances | None = None) -> None:
        task, vehicle = system.task, system.vehicle
        if not isinstance(task, Dive) or not isinstance(vehicle, AUV):
            raise ValueError(f"this autopilot flies dives, not {type(task).__name__}")
        tolerances = tolerances or DiveTolerances()
        self._task, self._body = task, vehicle.body
        self._ahead = tolerances.look_ahead * vehicle.body.length
        self._vertical = vertical_loop(vehicle, tolerances)
        self._lateral = lateral_loop(vehicle, tolerances) if "rudder" in vehicle.action_names else None
        self._thrust_gain = vehicle.body.mass / tolerances.speed

    def reset(self, num_envs: int) -> None:
        """Nothing to forget: the autopilot has no memory."""

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Actions ``(B, a)``: fins and thrust."""
        o, speed = self._task.named(observations), self._body.cruise_speed
        zero = np.zeros(len(observations))
        roll = o.get("roll", zero)
        surge, sway, heave = o["surge error"] + speed, o.get("sway", zero), o["heave"]
        over_ground = (
            surge + o["current ahead"],
            sway + o.get("current to starboard", zero),
            heave + o["current below"],
        )
        ahead, aside, below = _levelled(*over_ground, roll, o["pitch"])
        path = _levelled(o["path ahead"], o.get("path to starboard", zero), o["path below"], roll, o["pitch"])

        wanted = o["pitch error"] + o["pitch"] - np.arctan(path[2] / self._ahead)
        heave_, stern, thrust = self._vertical.steady(wanted)
        climb = np.arctan2(-below, np.hypot(ahead, aside))
        drift = heave - heave_
        deviation = np.stack([drift, o["pitch rate"], climb - wanted + drift / speed], -1)
        fins = [stern - deviation @ self._vertical.gains]

        if self._lateral is not None:
            turn, rate = o["heading error"], o["curvature"] * speed
            cross = path[0] * np.sin(turn) - path[1] * np.cos(turn)
            course = wrap(turn - np.arctan(cross / self._ahead) - np.arctan2(aside, ahead))
            sway_, rudder, turning = self._lateral.steady(rate)
            drift = sway - sway_
            deviation = np.stack([drift, o["roll rate"], o["yaw rate"] - rate, roll, -course - drift / speed], -1)
            fins.insert(0, rudder - deviation @ self._lateral.gains)
            thrust = thrust + turning - self._body.cruise_thrust
        thrust = thrust - self._thrust_gain * o["surge error"]
        actions = [fin / self._body.fin_limit for fin in fins] + [2.0 * thrust / self._body.thrust_limit - 1.0]
        return np.clip(np.stack(actions, -1), -1.0, 1.0).astype(np.float32)


def _levelled(
    x: np.ndarray, y: np.ndarray, z: np.ndarray, roll: np.ndarray, pitch: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A vector in body axes as seen along the heading: ahead, to starboard, down."""
    aside, below = y * np.cos(roll) - z * np.sin(roll), y * np.sin(roll) + z * np.cos(roll)
    return x * np.cos(pitch) + below * np.sin(pitch), aside, below * np.cos(pitch) - x * np.sin(pitch)
