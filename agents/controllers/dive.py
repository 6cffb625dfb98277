"""Controllers of dives: course and flight-path loops designed from the linearised vehicle."""

from collections import defaultdict
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import root

from agents.controllers import AUTOPILOT, register_controller
from agents.controllers.loops import Control, Controller, bryson, jacobian, regulator_gains
from estimators import wrap
from estimators.engine import compiled
from vessel_gym.processes import interpolated
from vessel_gym.tasks.dive import Dive
from vessel_gym.vehicles.auv import AUV

# Deviations that count alike in the quadratic costs (Bryson's rule): weights are 1 / tolerance^2.
DIRECTION = 0.06  # rad, of course and flight path
RATE = 0.4  # rad/s, of yaw and pitch
FIN = 0.3  # rad
SPEED = 2.0  # s, time constant in which an error of speed is to vanish
AHEAD = 1.0  # vehicle lengths to the point that the guidance aims at


class Regulator(NamedTuple):
    """A regulator about steady motions, tabulated over commands -c to c in equal steps ``(m,)``.

    Attributes:
        gains: ``(k,)`` of the fin on the plane's states, of which the last is the direction.
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

    def steady(self, command: np.ndarray) -> list[np.ndarray]:
        """Drift, fin and thrust of the steady motions with commands ``(...)``."""
        share = np.clip(command / self.command[-1], -1.0, 1.0)
        at = 0.5 * (len(self.command) - 1.0) * (1.0 + share)
        return [interpolated(each, at) for each in self[2:]]

    def feedback(self, *deviation: np.ndarray) -> np.ndarray:
        """Fin [rad] against deviations of the states, ``(...)`` each."""
        return np.stack(deviation, -1) @ self.gains


@cache
def regulator(vehicle: AUV, lateral: bool) -> Regulator:
    """The regulator of a plane of motion.

    The stern plane acts on heave, pitch rate and flight path, about steady dives and climbs of up
    to 45 deg; the rudder on sway, roll, yaw rate and course, about steady level turns.
    """
    names, speed = vehicle.state_names, vehicle.body.cruise_speed
    if lateral:
        plane, rate, fin, side = ["v", "p", "r", "phi", "psi"], 2, 0, 1.0
        command = np.linspace(-1.0, 1.0, 81) * (speed / (4.0 * vehicle.body.length))
    else:
        plane, rate, fin, side = ["w", "q", "theta"], 1, -2, -1.0
        command = np.deg2rad(np.linspace(-45.0, 45.0, 91))
    index = [names.index(name) for name in plane]
    surge, tilt, balanced = names.index("u"), index[rate + 1], index[: rate + 1]

    def motion(z: np.ndarray, command: float) -> tuple[np.ndarray, np.ndarray]:
        state, actuators = np.zeros(len(names)), np.zeros(len(vehicle.action_names))
        state[[surge, index[0], tilt]], actuators[[fin, -1]] = (speed, *z[:2]), z[2:]
        if lateral:
            state[index[rate]] = command
        return state, actuators

    def residual(z: np.ndarray, command: float) -> np.ndarray:
        state, actuators = motion(z, command)
        balance = ((_after(vehicle, state, actuators) - state) / vehicle.dt)[[surge, *balanced]]
        return balance if lateral else np.append(balance, z[1] - np.arctan2(z[0], speed) - command)

    guess = np.array([0.0, 0.0, 0.0, vehicle.body.cruise_thrust])
    table = _steady_motions(residual, command, guess)
    state, actuators = motion(table[len(command) // 2], 0.0)

    def step(x: np.ndarray) -> np.ndarray:
        state[index], actuators[fin] = x[:-1], x[-1]
        return _after(vehicle, state, actuators)[index]

    AB = jacobian(step, np.append(state[index], actuators[fin]))
    gains = _gains(AB[:, :-1], AB[:, -1:], side / speed, rate)
    return Regulator(gains, command, table[:, 0], table[:, 2], table[:, 3])


def _after(vehicle: AUV, state: np.ndarray, actuators: np.ndarray) -> np.ndarray:
    """State ``(n,)`` after a step in still water with constant actuators."""
    flows = np.zeros(len(vehicle.ambient_flows))
    return vehicle.drift(state, np.concatenate([actuators, actuators]), flows)


def _steady_motions(
    residual: Callable[[np.ndarray, float], np.ndarray], command: np.ndarray, guess: np.ndarray
) -> np.ndarray:
    """Solutions ``(m, 4)`` of ``residual(z, command) = 0``, each from its neighbour's."""
    table, middle = np.empty((len(command), len(guess))), len(command) // 2
    for indices in (range(middle, len(command)), range(middle, -1, -1)):
        z = guess
        for i in indices:
            found = root(residual, z, args=(command[i],), tol=1e-12)
            if np.abs(found.fun).max() > 1e-9:
                raise RuntimeError(f"the vehicle has no steady motion at {command[i]:.3g}")
            table[i] = z = found.x
    return table


def _gains(A: np.ndarray, B: np.ndarray, drift: float, rate: int) -> np.ndarray:
    """Gains ``(k,)`` of a plane's regulator.

    Its states move by ``A (k, k)`` and ``B (k, 1)``: the first moves the direction by ``drift``
    [rad per m/s], number ``rate`` is the angular velocity, the last the angle.
    """
    direction = np.zeros(len(A))
    direction[[0, -1]] = drift, 1.0
    Q = np.outer(direction, direction) / DIRECTION**2
    Q[rate, rate] += RATE**-2
    return regulator_gains(A, B, Q, bryson(FIN))[0]


@register_controller(Dive, AUTOPILOT)
class DiveAutopilot(Controller):
    """Line-of-sight guidance onto the path; regulators of the course and flight path it asks for.

    It acts on the observation alone. The guidance aims at a point on the path's tangent a
    look-ahead distance on (Fossen 2011, sec. 10.3) and adds the turn that the path makes; the
    regulators act on deviations from the steady dive and turn that fit, so that the righting moment
    and the buoyancy need no integral.
    """

    kind, vehicle = Dive, AUV

    def _design(self) -> None:
        self._body, turns = self._vehicle.body, "rudder" in self._vehicle.action_names
        self._ahead = AHEAD * self._body.length
        self._vertical = regulator(self._vehicle, lateral=False)
        self._lateral = regulator(self._vehicle, lateral=True) if turns else None

    @compiled
    def control(self, observation: np.ndarray, state: np.ndarray) -> Control:
        """Actions ``(..., a)``, fins and thrust; there is no state."""
        o, body = self._observed(observation), self._body
        heave, stern, thrust = self._vertical.steady(o["wanted climb"])
        drift = o["heave"] - heave
        climb = o["climb"] - o["wanted climb"] + drift / body.cruise_speed
        fins = [stern - self._vertical.feedback(drift, o["pitch rate"], climb)]
        if self._lateral is not None:
            sway, rudder, turning = self._lateral.steady(o["turning"])
            drift = o["sway"] - sway
            rates = o["roll rate"], o["yaw rate"] - o["turning"]
            course = -o["course error"] - drift / body.cruise_speed
            feedback = self._lateral.feedback(drift, *rates, o["roll"], course)
            fins.insert(0, rudder - feedback)
            thrust = thrust + turning - body.cruise_thrust
        thrust = thrust - body.mass / SPEED * o["surge error"]
        shares = [fin / body.fin_limit for fin in fins]
        return np.stack([*shares, 2.0 * thrust / body.thrust_limit - 1.0], -1), state

    def _observed(self, observation: np.ndarray) -> dict[str, Any]:
        """Observed quantities in SI, ``(...)`` each, and what the guidance makes of them.

        Beside the names of the task: ``climb``, the flight-path angle over ground, and the wanted
        one; ``course error``; ``turning`` [rad/s] of the path.
        """
        o, speed = defaultdict(float, self._task.named(observation)), self._body.cruise_speed
        attitude, turn = (o["roll"], o["pitch"]), o["heading error"]
        ahead, aside, below = _levelled(
            o["surge error"] + speed + o["current ahead"],
            o["sway"] + o["current to starboard"],
            o["heave"] + o["current below"],
            *attitude,
        )
        path = _levelled(o["path ahead"], o["path to starboard"], o["path below"], *attitude)
        aside_of_path = path[0] * np.sin(turn) - path[1] * np.cos(turn)
        o["climb"] = np.arctan2(-below, np.hypot(ahead, aside))
        o["turning"] = o["curvature"] * speed
        o["wanted climb"] = o["pitch error"] + o["pitch"] - np.arctan(path[2] / self._ahead)
        sight = np.arctan(aside_of_path / self._ahead)
        o["course error"] = wrap(turn - sight - np.arctan2(aside, ahead))
        return o


def _levelled(
    x: np.ndarray, y: np.ndarray, z: np.ndarray, roll: np.ndarray, pitch: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A vector in body axes as seen along the heading: ahead, to starboard, down."""
    aside, below = y * np.cos(roll) - z * np.sin(roll), y * np.sin(roll) + z * np.cos(roll)
    ahead = x * np.cos(pitch) + below * np.sin(pitch)
    return ahead, aside, below * np.cos(pitch) - x * np.sin(pitch)
