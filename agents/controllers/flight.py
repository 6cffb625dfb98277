"""Controllers of flights: bank, altitude and airspeed loops from the linearised aircraft."""

from functools import cache

import numpy as np

from agents.controllers import AUTOPILOT, register_controller
from agents.controllers.loops import Control, Controller, bryson, jacobian, regulator_gains
from estimators.engine import compiled
from vessel_gym.processes import interpolated
from vessel_gym.tasks.flight import Flight
from vessel_gym.vehicles.puna import Puna, trim

# Deviations that count alike in the quadratic costs, by Bryson's rule: weights are 1 / tolerance^2.
CROSS_TRACK = 2.0  # m
COURSE = 0.15  # rad
BANK = 0.25  # rad, of the command
ALTITUDE = 1.0  # m
CLIMB = 0.7  # m/s
AIRSPEED = 1.0  # m/s
THRUST = 3.0  # N
ALPHA = 0.007  # rad
APPROACH = 0.8  # rad, course at which the vector field meets the path from afar


@cache
def lateral_gains(vehicle: Puna) -> np.ndarray:
    """Gains ``(3,)`` of the commanded bank in level flight.

    They act on cross-track error [m], course error and bank [rad].
    """
    body, dt = vehicle.body, vehicle.dt
    speed, rate = body.cruise_speed, body.bank_rate
    # Over a step the bank nears its command as exp(-b t); course and cross-track are its integrals.
    decay = np.exp(-rate * dt)
    first, turn = (1.0 - decay) / rate, body.gravity / speed
    second = (dt - first) / rate
    A = np.array([
        [1.0, speed * dt, speed * turn * second],
        [0.0, 1.0, turn * first],
        [0.0, 0.0, decay],
    ])  # fmt: skip
    third = (0.5 * dt**2 - second) / rate
    B = np.array([[speed * turn * rate * third], [turn * rate * second], [rate * first]])
    Q = bryson(CROSS_TRACK, COURSE, np.inf)
    return regulator_gains(A, B, Q, bryson(BANK))[0]


@cache
def longitudinal_gains(vehicle: Puna) -> np.ndarray:
    """Gains ``(2, 5)`` of commanded thrust [N] and angle of attack [rad].

    On altitude [m], airspeed [m/s], flight-path angle [rad], thrust and angle of attack, by central
    differences of the vehicle's step about level flight.
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
    AB = jacobian(after, level)
    slope = CLIMB / body.cruise_speed
    Q = bryson(ALTITUDE, AIRSPEED, slope, np.inf, np.inf)
    R = bryson(THRUST, ALPHA)
    return regulator_gains(AB[:, :5], AB[:, 5:], Q, R)


@register_controller(Flight, AUTOPILOT)
class FlightAutopilot(Controller):
    """Vector-field path following in plan; linear-quadratic loops for altitude and airspeed.

    It acts on the observation alone. Far from the path the vector field (Nelson et al. 2007) points
    to it at a steep course, near it along it, with the slope that is best for small errors; the
    bank that the path needs is added. In a turn the trim is that of the banked aircraft. Altitude
    is held by the climb over ground, which a gust does not change at once.
    """

    kind, vehicle = Flight, Puna

    def _design(self) -> None:
        body = self._body = self._vehicle.body
        self._lateral = lateral_gains(self._vehicle)
        self._longitudinal = longitudinal_gains(self._vehicle)
        self._slope = self._lateral[0] / self._lateral[1] / APPROACH
        steady = [
            trim(body.cruise_speed, body, bank=bank)
            for bank in np.linspace(0.0, body.bank_limit, 20)
        ]
        self._trims = np.array([[s.thrust, s.alpha] for s in steady])

    @compiled
    def control(self, observation: np.ndarray, state: np.ndarray) -> Control:
        """Actions ``(..., 3)``, thrust, angle of attack and bank; there is no state."""
        o, body = self._task.named(observation), self._body
        needed = o["bank of the path"]
        field = APPROACH * np.arctan(self._slope * o["cross-track"])  # to the left of the path
        astray = field - np.arctan2(o["course sine"], o["course cosine"])
        # The faster over ground, the less a bank turns the course.
        faster = np.maximum(1.0 + o["ground speed error"] / body.cruise_speed, 0.5)
        bank = needed - faster * self._lateral[1] * astray - self._lateral[2] * (o["bank"] - needed)
        bank = np.clip(bank, -body.bank_limit, body.bank_limit)

        banked = np.minimum(np.abs(o["bank"]) / body.bank_limit, 1.0) * (len(self._trims) - 1.0)
        trims = interpolated(self._trims, banked)  # thrust, angle of attack
        first = len(self._task.observed)
        actuators = body.commands(observation[..., first : first + 3])
        motion = np.stack([
            np.clip(o["altitude error"], -10.0, 10.0),
            np.clip(o["airspeed error"], -4.0, 4.0),
            o["climb"] / body.cruise_speed,
        ], -1)  # fmt: skip
        deviation = np.concatenate([motion, actuators[..., :2] - trims], -1)
        commands = trims - deviation @ self._longitudinal.T
        return body.actions(np.concatenate([commands, bank[..., None]], -1)), state
