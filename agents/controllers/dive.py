"""Controllers of dives: course and flight-path loops designed from the linearised vehicle."""

from collections import defaultdict
from functools import cache, partialmethod
from typing import Any, NamedTuple

import numpy as np

from agents.controllers import AUTOPILOT, register_controller
from agents.controllers.loops import Control, Controller, bryson, jacobian, regulator_gains
from estimators import Log, wrap
from estimators.engine import compiled
from vessel_gym.processes import interpolated
from vessel_gym.system import System
from vessel_gym.tasks.dive import Dive, VerticalDive
from vessel_gym.vehicles.auv import AUV
from vessel_gym.vehicles.simulated import root

SPEED = 2.0  # s, time constant in which an error of speed is to vanish


class SteadyMotions(NamedTuple):
    """Steady motions in a plane, for commands -c to c in equal steps ``(m,)``.

    Attributes:
        command: flight-path angle [rad] or yaw rate [rad/s].
        drift: velocity through the water across the body [m/s].
        fin: rad.
        thrust: N.
        A: ``(k, k)`` of the plane's states after a step, about the one straight ahead; the middle
            one is the angular velocity, the last one the angle.
        B: ``(k, 1)`` of the fin.
        direction: ``(k,)`` of motion, by states.
    """

    command: np.ndarray
    drift: np.ndarray
    fin: np.ndarray
    thrust: np.ndarray
    A: np.ndarray
    B: np.ndarray
    direction: np.ndarray

    def at(self, command: np.ndarray) -> list[np.ndarray]:
        """Drift, fin and thrust of the steady motions with commands ``(...)``."""
        share = np.clip(command / self.command[-1], -1.0, 1.0)
        place = 0.5 * (len(self.command) - 1.0) * (1.0 + share)
        return [interpolated(each, place) for each in self[1:4]]

    def gains(self, direction: float, rate: float) -> np.ndarray:
        """Gains ``(k,)`` of the fin on the states, for tolerances of the direction and its rate.

        Only ratios of tolerances matter, so the fin's is fixed.
        """
        Q = np.outer(self.direction, self.direction) / direction**2
        middle = len(Q) // 2
        Q[middle, middle] += rate**-2
        return regulator_gains(self.A, self.B, Q, bryson(0.3))[0]


@cache
def steady_motions(vehicle: AUV, lateral: bool) -> SteadyMotions:
    """The steady motions of a vehicle in a plane.

    The stern plane acts on heave, pitch rate and flight path, about steady dives and climbs of up
    to 45 deg; the rudder on sway, roll, yaw rate and course, about steady level turns.

    Raises:
        RuntimeError: if the vehicle has no steady motion for a command.
    """
    names, speed = vehicle.state_names, vehicle.body.cruise_speed
    if lateral:
        plane, rate, fin, side = ["v", "p", "r", "phi", "psi"], 2, 0, 1.0
        command = np.linspace(-1.0, 1.0, 81) * (speed / (4.0 * vehicle.body.length))
    else:
        plane, rate, fin, side = ["w", "q", "theta"], 1, -2, -1.0
        command = np.deg2rad(np.linspace(-45.0, 45.0, 91))
    surge, *index = (names.index(name) for name in ("u", *plane))

    def motion(z: np.ndarray, command: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        state = np.zeros((*z.shape[:-1], len(names)))
        actuators = np.zeros((*z.shape[:-1], len(vehicle.action_names)))
        state[..., surge] = speed
        state[..., [index[0], index[rate + 1]]], actuators[..., [fin, -1]] = z[..., :2], z[..., 2:]
        if lateral:
            state[..., index[rate]] = command[..., 0]
        return state, actuators

    def residual(z: np.ndarray, command: np.ndarray) -> np.ndarray:
        state, actuators = motion(z, command)
        rates = (_after(vehicle, state, actuators) - state) / vehicle.dt
        balance = rates[..., [surge, *index[: rate + 1]]]
        climb = z[..., 1:2] - np.arctan2(z[..., :1], speed)
        return balance if lateral else np.concatenate([balance, climb - command], -1)

    guess = np.tile([0.0, 0.0, 0.0, vehicle.body.cruise_thrust], (len(command), 1))
    table = root(residual, guess, command[:, None])
    if np.isnan(table).any():
        raise RuntimeError("the vehicle has no steady motion for some commands of its autopilot")
    state, actuators = motion(table[len(command) // 2], np.zeros(1))  # straight ahead

    def step(x: np.ndarray) -> np.ndarray:
        state[index], actuators[fin] = x[:-1], x[-1]
        return _after(vehicle, state, actuators)[index]

    AB, direction = jacobian(step, np.append(state[index], actuators[fin])), np.zeros(len(index))
    direction[[0, -1]] = side / speed, 1.0
    drift, _, fins, thrust = table.T
    return SteadyMotions(command, drift, fins, thrust, AB[:, :-1], AB[:, -1:], direction)


def _after(vehicle: AUV, state: np.ndarray, actuators: np.ndarray) -> np.ndarray:
    """States ``(..., n)`` after a step in still water with constant actuators."""
    flows = np.zeros(len(vehicle.ambient_flows))
    return vehicle.drift(state, np.concatenate([actuators, actuators], -1), flows)


@register_controller(Dive, AUTOPILOT)
class DiveAutopilot(Controller):
    """Line-of-sight guidance onto the path; regulators of the course and flight path it asks for.

    It acts on the observation alone. The guidance aims at a point on the path's tangent a
    look-ahead distance on (Fossen 2011, sec. 10.3) and adds the turn that the path makes; the
    regulators act on deviations from the steady dive and turn that fit, so that the righting moment
    and the buoyancy need no integral. The ``numbers`` are the look-ahead distance [m], and the
    gains of the stern plane and of the rudder, if there is one.

    Args:
        system: The environment's system.
        direction: Tolerance of course and flight path [rad], where that of a fin is 0.3 rad.
        rate: Tolerance of the rates of yaw and pitch [rad/s].
        ahead: Distance to the point that the guidance aims at, in vehicle lengths.
    """

    kind, vehicle = Dive, AUV
    tunable = {
        "direction": Log(0.003, 30.0), "rate": Log(0.05, 500.0), "ahead": Log(0.01, 100.0)
    }  # fmt: skip

    def __init__(
        self, system: System, direction: float = 0.42, rate: float = 6.0, ahead: float = 1.1
    ) -> None:
        super().__init__(system)
        planes = [False, True] if _turns(self._vehicle) else [False]
        gains = [steady_motions(self._vehicle, each).gains(direction, rate) for each in planes]
        self.numbers = np.concatenate([[ahead * self._vehicle.body.length], *gains])

    @staticmethod
    @compiled
    def control(
        observation: np.ndarray, state: np.ndarray, numbers: np.ndarray, *, task: Any, vehicle: Any
    ) -> Control:
        """Actions ``(..., a)``, fins and thrust; there is no state."""
        o, body = _observed(observation, numbers[0], task, vehicle), vehicle.body
        heave, stern, thrust = steady_motions(vehicle, False).at(o["wanted climb"])
        drift = o["heave"] - heave
        climb = o["climb"] - o["wanted climb"] + drift / body.cruise_speed
        deviation = np.stack([drift, o["pitch rate"], climb], -1)
        fins = [stern - (numbers[1:4] * deviation).sum(-1)]
        if _turns(vehicle):
            sway, rudder, turning = steady_motions(vehicle, True).at(o["turning"])
            drift = o["sway"] - sway
            rates = o["roll rate"], o["yaw rate"] - o["turning"]
            course = -o["course error"] - drift / body.cruise_speed
            deviation = np.stack([drift, *rates, o["roll"], course], -1)
            fins.insert(0, rudder - (numbers[4:] * deviation).sum(-1))
            thrust = thrust + turning - body.cruise_thrust
        thrust = thrust - body.mass / SPEED * o["surge error"]
        shares = [fin / body.fin_limit for fin in fins]
        actions = np.stack([*shares, 2.0 * thrust / body.thrust_limit - 1.0], -1)
        return np.clip(actions, -1.0, 1.0), state


@register_controller(VerticalDive, AUTOPILOT)
class VerticalDiveAutopilot(DiveAutopilot):
    """The autopilot with tolerances that were tuned in the vertical plane."""

    __init__ = partialmethod(DiveAutopilot.__init__, direction=0.22, rate=4.0, ahead=0.7)


def _turns(vehicle: AUV) -> bool:
    """Has the vehicle a rudder?"""
    return "rudder" in vehicle.action_names


def _observed(
    observation: np.ndarray, look_ahead: float, task: Any, vehicle: AUV
) -> dict[str, Any]:
    """Observed quantities in SI, ``(...)`` each, and what the guidance makes of them.

    Beside the names of the task: ``climb``, the flight-path angle over ground, and the wanted
    one; ``course error``; ``turning`` [rad/s] of the path.
    """
    o, speed = defaultdict(float, task.named(observation)), vehicle.body.cruise_speed
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
    o["wanted climb"] = o["pitch error"] + o["pitch"] - np.arctan(path[2] / look_ahead)
    sight = np.arctan(aside_of_path / look_ahead)
    o["course error"] = wrap(turn - sight - np.arctan2(aside, ahead))
    return o


def _levelled(
    x: np.ndarray, y: np.ndarray, z: np.ndarray, roll: np.ndarray, pitch: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A vector in body axes as seen along the heading: ahead, to starboard, down."""
    aside, below = y * np.cos(roll) - z * np.sin(roll), y * np.sin(roll) + z * np.cos(roll)
    ahead = x * np.cos(pitch) + below * np.sin(pitch)
    return ahead, aside, below * np.cos(pitch) - x * np.sin(pitch)
