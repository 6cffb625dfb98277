"""Controllers of flights: bank, altitude and airspeed loops from the linearised aircraft."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from agents.controllers import AUTOPILOT, register_controller
from agents.controllers.loops import Loop, jacobian, parts_of, regulator_gains
from vessel_gym.system import System
from vessel_gym.tasks.flight import Flight
from vessel_gym.vehicles.puna import Puna, trim


@dataclass(frozen=True)
class FlightTolerances:
    """Deviations that count alike in the quadratic costs (Bryson's rule).

    Each weight is 1 / tolerance^2.
    """

    cross_track: float = 2.0  # m
    course: float = 0.15  # rad
    bank: float = 0.25  # rad, of the command
    altitude: float = 1.0  # m
    climb: float = 0.7  # m/s
    airspeed: float = 1.0  # m/s
    thrust: float = 3.0  # N
    alpha: float = 0.007  # rad
    approach: float = 0.8  # rad, course at which the vector field meets the path from afar


@cache
def lateral_gains(vehicle: Puna, tolerances: FlightTolerances) -> np.ndarray:
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
    Q = np.diag([tolerances.cross_track**-2, tolerances.course**-2, 0.0])
    return regulator_gains(A, B, Q, np.array([[tolerances.bank**-2]]))[0]


@cache
def longitudinal_gains(vehicle: Puna, tolerances: FlightTolerances) -> np.ndarray:
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
    slope = tolerances.climb / body.cruise_speed
    Q = np.diag([tolerances.altitude**-2, tolerances.airspeed**-2, slope**-2, 0.0, 0.0])
    R = np.diag([tolerances.thrust**-2, tolerances.alpha**-2])
    return regulator_gains(AB[:, :5], AB[:, 5:], Q, R)


@register_controller(Flight, AUTOPILOT)
class FlightAutopilot:
    """Vector-field path following in plan; linear-quadratic loops for altitude and airspeed.

    It acts on the observation alone. Far from the path the vector field (Nelson et al. 2007) points
    to it at a steep course, near it along it, with the slope that is best for small errors; the
    bank that the path needs is added. In a turn the trim is that of the banked aircraft. Altitude
    is held by the climb over ground, which a gust does not change at once.

    Args:
        system: The environment's system.

    Raises:
        ValueError: if the system's task is no flight.
    """

    tolerances = FlightTolerances()  # of the design

    def __init__(self, system: System) -> None:
        self._task, vehicle = parts_of(system, Flight, Puna)
        t, self._body = self.tolerances, vehicle.body
        self._lateral, self._longitudinal = (
            lateral_gains(vehicle, t),
            longitudinal_gains(vehicle, t),
        )
        self._slope = self._lateral[0] / self._lateral[1] / t.approach
        self._banks = np.linspace(0.0, vehicle.body.bank_limit, 20)
        steady = [trim(vehicle.body.cruise_speed, vehicle.body, bank=bank) for bank in self._banks]
        self._thrusts, self._alphas = np.array([[s.thrust, s.alpha] for s in steady]).T

    def reset(self, num_envs: int) -> None:
        """Nothing to forget: the autopilot has no memory."""

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Actions ``(B, 3)``: thrust, angle of attack, bank."""
        o, body = self._task.named(observations), self._body
        speed = np.maximum(o["ground speed"], 0.5 * body.cruise_speed)
        needed = o["bank of the path"]
        astray = self._field(o["cross-track"]) - np.arctan2(o["course sine"], o["course cosine"])
        # The faster over ground, the less a bank turns the course.
        faster = speed / body.cruise_speed
        bank = needed - faster * self._lateral[1] * astray - self._lateral[2] * (o["bank"] - needed)
        bank = np.clip(bank, -body.bank_limit, body.bank_limit)

        banked = np.abs(o["bank"])
        thrust, alpha = (
            np.interp(banked, self._banks, table) for table in (self._thrusts, self._alphas)
        )
        first = len(self._task.observed)
        actuators = body.commands(observations[:, first : first + 3].astype(float))
        deviation = np.stack([
            np.clip(o["altitude error"], -10.0, 10.0),
            np.clip(o["airspeed"] - body.cruise_speed, -4.0, 4.0),
            o["climb"] / body.cruise_speed,
            actuators[:, 0] - thrust,
            actuators[:, 1] - alpha,
        ], -1)  # fmt: skip
        commands = np.stack([thrust, alpha], -1) - deviation @ self._longitudinal.T
        return self._actions(*commands.T, bank)

    def _actions(self, *commands: np.ndarray) -> np.ndarray:
        """Actions ``(B, 3)`` that ask for thrust, angle of attack and bank, ``(B,)`` each."""
        actions = self._body.actions(np.stack(commands, -1))
        return np.clip(actions, -1.0, 1.0).astype(np.float32)

    def _field(self, cross: np.ndarray) -> np.ndarray:
        """Commanded course [rad] to the left of the path at a distance to the right of it [m]."""
        return self.tolerances.approach * np.arctan(self._slope * cross)


@register_controller(Flight, "lqg")
class FlightRegulator(FlightAutopilot):
    """The linear-quadratic regulators alone, without the vector field's bound."""

    def _field(self, cross: np.ndarray) -> np.ndarray:
        return self.tolerances.approach * self._slope * cross


@register_controller(Flight, "pid")
class FlightPID(FlightAutopilot):
    """Three PID loops: of bank, angle of attack and thrust.

    They act on the errors of cross-track, altitude and airspeed. The loops know nothing of each
    other; the bank that the path takes is added. Plants are a point mass in level flight: weight
    times bank across, the slope of the lift upwards, thrust ahead.
    """

    def __init__(self, system: System) -> None:
        super().__init__(system)
        t, body, dt = self.tolerances, self._body, system.vehicle.dt
        lift = 0.5 * body.density[2] * body.cruise_speed**2 * body.area * body.lift[0]  # N/rad
        self._loops = (
            Loop(body.gravity, 0.0, t.cross_track, t.bank, dt),
            Loop(lift / body.mass, 0.0, t.altitude, t.alpha, dt),
            Loop(1.0 / body.mass, None, t.airspeed, t.thrust, dt),
        )

    def reset(self, num_envs: int) -> None:
        """Clear the integrals."""
        for loop in self._loops:
            loop.reset(num_envs)

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Actions ``(B, 3)``: thrust, angle of attack, bank."""
        o, body, (across, up, along) = self._task.named(observations), self._body, self._loops
        thrust, alpha, _ = body.cruise
        away, limit = o["ground speed"] * o["course sine"], body.bank_limit
        bank = across.act(-o["cross-track"], away, -limit, limit, o["bank of the path"])
        alpha = up.act(-o["altitude error"], -o["climb"], body.alpha_low, body.alpha_high, alpha)
        slow = body.cruise_speed - o["airspeed"]
        thrust = along.act(slow, 0.0, 0.0, body.thrust_limit, thrust)
        return self._actions(thrust, alpha, bank)
