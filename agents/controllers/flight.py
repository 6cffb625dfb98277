"""Controllers of flights: bank, altitude and airspeed loops from the linearised aircraft."""

from functools import cache
from typing import Any

import numpy as np

from agents.controllers import AUTOPILOT, register_controller
from agents.controllers.loops import Control, Controller, bryson, jacobian, regulator_gains
from estimators import Log, zero_order_hold
from estimators.engine import compiled
from vessel_gym.processes import interpolated
from vessel_gym.system import System
from vessel_gym.tasks.flight import Flight
from vessel_gym.vehicles.puna import Puna, trim

APPROACH = 0.8  # rad, 2 / pi of the course at which the vector field meets the path from afar


def lateral_gains(vehicle: Puna, cross_track: float, course: float) -> np.ndarray:
    """Gains ``(3,)`` of the commanded bank in level flight.

    They act on cross-track error [m], course error and bank [rad]. The first two have tolerances,
    by Bryson's rule; only ratios of tolerances matter, so that of the command is fixed.
    """
    body = vehicle.body
    speed, rate = body.cruise_speed, body.bank_rate
    A = np.array([[0.0, speed, 0.0], [0.0, 0.0, body.gravity / speed], [0.0, 0.0, -rate]])
    A, B = zero_order_hold(A, np.array([[0.0], [0.0], [rate]]), vehicle.dt)
    return regulator_gains(A, B, bryson(cross_track, course, np.inf), bryson(0.25))[0]


@cache
def longitudinal_model(vehicle: Puna) -> np.ndarray:
    """Derivatives ``(5, 7)`` of the longitudinal motion after a step about level flight.

    The motion is altitude [m], airspeed [m/s], flight-path angle [rad], thrust [N] and angle of
    attack [rad]. The derivatives are by it and by the commanded thrust and angle of attack.
    """
    body = vehicle.body
    steady, c = trim(body.cruise_speed, body), body.vector()
    decay = np.exp(-vehicle.dt / body.thrust_lag)

    def after(z: np.ndarray) -> np.ndarray:
        altitude, speed, slope, thrust, alpha, thrust_command, alpha_command = z
        level, climb = speed * np.cos(slope), speed * np.sin(slope)
        state = np.array([0.0, 0.0, altitude, level, 0.0, climb, 0.0])
        thrust_after = thrust_command + (thrust - thrust_command) * decay
        before, then = np.array([thrust, alpha, 0.0]), np.array([thrust_after, alpha_command, 0.0])
        moved = vehicle.moved(state, before, then, np.zeros(3), c)
        motion = [moved[2], np.hypot(moved[3], moved[5]), np.arctan2(moved[5], moved[3])]
        return np.array([*motion, thrust_after, alpha_command])

    level = np.array([0.0, body.cruise_speed, 0.0] + 2 * [steady.thrust, steady.alpha])
    return jacobian(after, level)


def longitudinal_gains(
    vehicle: Puna, altitude: float, climb: float, airspeed: float, thrust: float
) -> np.ndarray:
    """Gains ``(2, 5)`` of commanded thrust [N] and angle of attack [rad].

    They act on the motion of `longitudinal_model`, for tolerances in m, m/s, m/s and N. Only ratios
    of tolerances matter, so that of the angle of attack is fixed.
    """
    AB, slope = longitudinal_model(vehicle), climb / vehicle.body.cruise_speed
    Q = bryson(altitude, airspeed, slope, np.inf, np.inf)
    return regulator_gains(AB[:, :5], AB[:, 5:], Q, bryson(thrust, 0.007))


@cache
def banked_trims(vehicle: Puna) -> np.ndarray:
    """Thrust [N] and angle of attack [rad] ``(20, 2)`` of level flight at banks up to the limit."""
    body, banks = vehicle.body, np.linspace(0.0, vehicle.body.bank_limit, 20)
    steady = [trim(body.cruise_speed, body, bank=bank) for bank in banks]
    return np.array([[each.thrust, each.alpha] for each in steady])


@register_controller(Flight, AUTOPILOT)
class FlightAutopilot(Controller):
    """Vector-field path following in plan; linear-quadratic loops for altitude and airspeed.

    It acts on the observation alone. Far from the path the vector field (Nelson et al. 2007) points
    to it at a steep course, near it along it, with the slope that is best for small errors; the
    bank that the path needs is added. In a turn the trim is that of the banked aircraft. Altitude
    is held by the climb over ground, which a gust does not change at once. The ``numbers`` are
    `lateral_gains` and `longitudinal_gains`.

    Args:
        system: The environment's system.
        cross_track: Tolerance [m], where that of the bank is 0.25 rad.
        course: Tolerance [rad].
        altitude: Tolerance [m], where that of the angle of attack is 0.007 rad.
        climb: Tolerance [m/s].
        airspeed: Tolerance [m/s].
        thrust: Tolerance [N].
    """

    kind, vehicle = Flight, Puna
    tunable = {
        "cross_track": Log(0.013, 130.0), "course": Log(0.0037, 37.0),
        "altitude": Log(0.0021, 21.0), "climb": Log(0.018, 180.0),
        "airspeed": Log(0.058, 580.0), "thrust": Log(0.0046, 46.0),
    }  # fmt: skip

    def __init__(
        self, system: System, cross_track: float = 1.3, course: float = 0.37,
        altitude: float = 0.21, climb: float = 1.8, airspeed: float = 5.8, thrust: float = 0.46,
    ) -> None:  # fmt: skip
        super().__init__(system)
        lateral = lateral_gains(self._vehicle, cross_track, course)
        along = longitudinal_gains(self._vehicle, altitude, climb, airspeed, thrust)
        self.numbers = np.array([*lateral, *along.flat])

    @staticmethod
    @compiled
    def control(
        observation: np.ndarray, state: np.ndarray, numbers: np.ndarray, *, task: Any, vehicle: Any
    ) -> Control:
        """Actions ``(..., 3)``, thrust, angle of attack and bank; there is no state."""
        o, body = task.named(observation), vehicle.body
        by_cross_track, by_course, by_bank = numbers[:3]
        slope, needed = by_cross_track / by_course / APPROACH, o["bank of the path"]
        field = APPROACH * np.arctan(slope * o["cross-track"])  # to the left of the path
        astray = field - np.arctan2(o["course sine"], o["course cosine"])
        # The faster over ground, the less a bank turns the course.
        faster = np.maximum(1.0 + o["ground speed error"] / body.cruise_speed, 0.5)
        bank = needed - faster * by_course * astray - by_bank * (o["bank"] - needed)

        table = banked_trims(vehicle)
        banked = np.minimum(np.abs(o["bank"]) / body.bank_limit, 1.0) * (len(table) - 1.0)
        trims = interpolated(table, banked)  # thrust, angle of attack
        first = len(task.observed)
        actuators = body.commands(observation[..., first : first + 3])
        motion = np.stack([
            np.clip(o["altitude error"], -10.0, 10.0),
            np.clip(o["airspeed error"], -4.0, 4.0),
            o["climb"] / body.cruise_speed,
        ], -1)  # fmt: skip
        deviation = np.concatenate([motion, actuators[..., :2] - trims], -1)
        change = np.matvec(numbers[3:].reshape(2, 5), deviation)
        commands = np.concatenate([trims - change, bank[..., None]], -1)
        return np.clip(body.actions(commands), -1.0, 1.0), state
