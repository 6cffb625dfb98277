"""Fixed-wing aircraft: a point mass in coordinated turns, in a wind (data/puna.toml).

Frames: x north, y east, altitude h up; positive bank turns to starboard. The wind has components
north, east and down, in its direction of motion.

In the literature the state has airspeed and the angles of the velocity through the air. Here it has
the velocity over ground. A gust then changes only the wind, so that filters need only white noise
on the wind. The equations have no pole at the vertical.

Sources: the paper on Dubins paths and the ensemble Kalman filter for a PUNA ("Pesawat Udara Nir
Awak", in Indonesian) for the task and the controls (thrust and angle of attack);
`printed_rates` has its equation of motion, and `forces` its drag, lift and density, which it
prints without constants. Gryte (2018), the Skywalker X8, for the constants. Beard & McLain (2012),
ch. 9, for the point mass and the bank.
"""

from collections import namedtuple
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from estimators.engine import compiled, sincos
from vessel_gym.sensors import Bias, Known, Sensor, plain
from vessel_gym.vehicles.files import Particulars, load
from vessel_gym.vehicles.simulated import Actuator, SimulatedVehicle, root

STATE = ("x", "y", "h", "north", "east", "climb", "phi")
"""Components of the state: position, altitude [m], velocity over ground [m/s], bank [rad]."""

Coefficients = namedtuple("Coefficients", (
    "mass", "area", "gravity", "drag_2", "drag_1", "drag_0", "lift_1", "lift_0",
    "density_2", "density_1", "density_0", "thrust", "bank_rate",
))  # fmt: skip
"""Coefficients of the equations of motion, in the order of their vector."""

COEFFICIENTS = Coefficients._fields

UNCERTAIN = (
    "lift", "drag of the angle of attack", "drag at zero angle", "mass", "thrust", "bank",
)  # fmt: skip
"""Parameters that `mismatch` spreads: one factor scales all coefficients of a kind."""
_NOMINAL = np.ones(len(UNCERTAIN))

# m/s2, largest lift: no wing bears more. At 20 m/s the PUNA reaches 50; the bound limits the turn
# in a step.
HARDEST = 200.0


@dataclass(frozen=True, kw_only=True)
class PunaParameters(Particulars):
    """Particulars of an aircraft in SI units, angles in rad: the content of a vehicle file.

    A file states a source for each number. Eq. 2 of the paper: drag ``C_D = A1 a^2 + A2 a + A3``,
    lift ``C_L = B1 a + B2``, density ``C1 h^2 + C2 h + C3``.
    """

    mass: float  # kg
    area: float  # m2, of the wing
    drag: tuple[float, float, float]  # A1, A2, A3
    lift: tuple[float, float]  # B1, B2
    density: tuple[float, float, float] = 4.319e-9, -1.1760e-4, 1.225  # C1, C2, C3: ISO 2533
    gravity: float = 9.81  # m/s2
    bank_rate: float = 2.0  # 1/s, b of phi' = b (phi_c - phi): Beard & McLain (2012), assumed
    cruise_speed: float  # m/s
    thrust_limit: float  # N
    thrust_lag: float = 0.5  # s, assumed
    alpha_low: float = float(np.deg2rad(-4.0))  # rad, assumed
    alpha_high: float = float(np.deg2rad(12.0))  # rad, assumed: clear of the stall
    alpha_rate: float = 0.5  # rad/s, assumed: the short-period motion that a point mass leaves out
    bank_limit: float = float(np.deg2rad(35.0))  # rad, assumed

    def mistakes(self) -> Iterator[tuple[str, str]]:
        """Errors in the particulars: the name of a number, and a sentence."""
        if self.alpha_low >= self.alpha_high:
            upper = f"where the upper is {self.alpha_high:g} rad"
            yield "alpha_low", f"{self.alpha_low:g} rad are no lower limit {upper}"
        if self.lift[0] <= 0.0:
            less = f"not {self.lift[0]:g} a rad"
            yield "lift", f"a wing lifts more at a higher angle of attack, {less}"
        if np.polyval(self.drag, np.linspace(self.alpha_low, self.alpha_high, 101)).min() <= 0.0:
            yield "drag", "within the limits of the angle of attack it becomes a thrust"
        if self.density[2] <= 0.0:
            yield "density", f"air weighs more than {self.density[2]:g} kg/m3 at sea level"
        try:
            trim(self.cruise_speed, self)
        except ValueError as error:
            yield "cruise_speed", str(error)

    def vector(self, factors: np.ndarray = _NOMINAL) -> np.ndarray:
        """Coefficients of the equations of motion ``(..., 13)``, in the order of `COEFFICIENTS`.

        Args:
            factors: Factors ``(..., 6)`` on the `UNCERTAIN` ones; default: 1.
        """
        lift, drag, drag_0, mass, thrust, bank = np.moveaxis(factors, -1, 0)
        (A1, A2, A3), (B1, B2) = self.drag, self.lift
        c = Coefficients(
            mass * self.mass, self.area, self.gravity, drag * A1, drag * A2, drag_0 * A3,
            lift * B1, lift * B2, *self.density, thrust, bank * self.bank_rate,
        )  # fmt: skip
        return np.stack(np.broadcast_arrays(*c), -1)

    @cached_property
    def cruise(self) -> np.ndarray:
        """Thrust, angle of attack, bank ``(3,)`` of level flight at cruise speed and sea level."""
        steady = trim(self.cruise_speed, self)
        return np.array([steady.thrust, steady.alpha, 0.0])

    def commands(self, action: np.ndarray) -> np.ndarray:
        """Thrust, angle of attack, bank ``(..., 3)`` of actions: limits at -1, 1, cruise at 0."""
        below, above = self._reach
        return self.cruise + action * np.where(action < 0.0, below, above)

    def actions(self, commands: np.ndarray) -> np.ndarray:
        """Actions ``(..., 3)`` that command a thrust, an angle of attack and a bank."""
        below, above = self._reach
        change = commands - self.cruise
        return change / np.where(change < 0.0, below, above)

    @cached_property
    def _reach(self) -> tuple[np.ndarray, np.ndarray]:
        """Distances from cruise to the lower limits and to the upper limits."""
        low = np.array([0.0, self.alpha_low, -self.bank_limit])
        high = np.array([self.thrust_limit, self.alpha_high, self.bank_limit])
        return self.cruise - low, high - self.cruise


class Trim(NamedTuple):
    """Steady level flight."""

    alpha: float  # rad
    thrust: float  # N


def trim(speed: float, body: PunaParameters, bank: float = 0.0) -> Trim:
    """Angle of attack and thrust of level flight at sea level, in a coordinated turn if banked.

    Args:
        speed: Airspeed [m/s].
        body: Aircraft.
        bank: Bank angle [rad].

    Raises:
        ValueError: if the aircraft cannot fly level like this within its limits of angle and
            thrust.
    """
    pressure = 0.5 * body.density[2] * speed**2 * body.area

    def thrust(alpha: np.ndarray | float) -> np.ndarray:
        return pressure * np.polyval(body.drag, alpha) / np.cos(alpha)

    def excess(alpha: np.ndarray, _: None = None) -> np.ndarray:
        across = pressure * np.polyval(body.lift, alpha) + thrust(alpha) * np.sin(alpha)
        return across * np.cos(bank) - body.mass * body.gravity

    limits = np.array([body.alpha_low, body.alpha_high])
    low, high = excess(limits)
    if low > 0.0 or high < 0.0:
        raise ValueError(
            f"no level flight at {speed:g} m/s: lift and weight balance at no angle of attack"
            " within limits"
        )
    alpha = float(root(excess, limits[:1] - low * np.diff(limits) / (high - low))[0])
    needed = float(thrust(alpha))
    if needed > body.thrust_limit:
        raise ValueError(f"no level flight at {speed:g} m/s: it takes {needed:.1f} N of thrust")
    return Trim(alpha, needed)


# --- equations of motion --------------------------------------------------------------------------


def forces(
    altitude: np.ndarray, speed: np.ndarray, alpha: np.ndarray, c: Coefficients
) -> tuple[np.ndarray, np.ndarray]:
    """Lift and drag [N], eq. 2; both have the sign of the speed."""
    density = (c.density_2 * altitude + c.density_1) * altitude + c.density_0
    pressure = 0.5 * density * speed * np.abs(speed) * c.area
    lift = pressure * (c.lift_1 * alpha + c.lift_0)
    return lift, pressure * ((c.drag_2 * alpha + c.drag_1) * alpha + c.drag_0)


def printed_axes(
    thrust: np.ndarray, lift: np.ndarray, drag: np.ndarray, angle: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Forces [N] along the velocity and across it, eq. 1: lift is along the body's normal."""
    sin_alpha, cos_alpha = angle
    return thrust * cos_alpha - drag - lift * sin_alpha, thrust * sin_alpha + lift * cos_alpha


@compiled
def puna_rates(
    state: np.ndarray, control: np.ndarray, wind: np.ndarray, coefficients: np.ndarray, *,
    as_printed: bool = False,
) -> np.ndarray:  # fmt: skip
    """Rates ``(..., 7)`` of position, altitude, velocity over ground and bank.

    By eq. 1 of the paper, lift is along the body's normal and drag along the velocity, and the
    weight brakes by g sin alpha, where g sin gamma is right. The paper has no turns.

    Args:
        state: ``(..., 7)``, `STATE`.
        control: Thrust [N], angle of attack and commanded bank [rad] ``(..., 3)``.
        wind: North, east and down [m/s] ``(..., 3)``.
        coefficients: ``(..., k)``, `COEFFICIENTS`.
        as_printed: True for the forces of eq. 1.
    """
    _, _, altitude, *velocity, phi = np.moveaxis(state, -1, 0)
    thrust, alpha, command = np.moveaxis(control, -1, 0)
    c = Coefficients(*np.moveaxis(coefficients, -1, 0))
    north, east = velocity[0] - wind[..., 0], velocity[1] - wind[..., 1]
    up = velocity[2] + wind[..., 2]
    level = np.sqrt(north * north + east * east)
    V = np.sqrt(level * level + up * up)
    lift, drag = forces(altitude, V, alpha, c)
    thrust = c.thrust * thrust
    (sin_phi, cos_phi), (sin_alpha, cos_alpha) = sincos(phi), sincos(alpha)
    along, across = thrust * cos_alpha - drag, lift + thrust * sin_alpha
    if as_printed:
        along, across = printed_axes(thrust, lift, drag, (sin_alpha, cos_alpha))
    along = along / c.mass
    across = np.clip(across / c.mass, -HARDEST, HARDEST)
    # Avoid a division by 0 for vertical or no motion, in which no aircraft flies.
    V, level = np.maximum(V, 1e-3), np.maximum(level, 1e-3)
    if as_printed:
        along = along + c.gravity * (up / V - sin_alpha)
    above, aside = across * cos_phi / V, across * sin_phi / level
    ahead = along / V - above * up / level
    return np.stack([
        *velocity, ahead * north - aside * east, ahead * east + aside * north,
        along * up / V + above * level - c.gravity, c.bank_rate * (command - phi),
    ], -1)  # fmt: skip


printed_rates = compiled(partial(puna_rates.function, as_printed=True))
"""`puna_rates` with the forces of eq. 1."""


def airspeed(state: np.ndarray, wind: np.ndarray) -> np.ndarray:
    """Airspeed ``(...)`` [m/s] of states ``(..., 7)`` in a wind ``(..., 3)``."""
    north, east = state[..., 3] - wind[..., 0], state[..., 4] - wind[..., 1]
    return np.hypot(np.hypot(north, east), state[..., 5] + wind[..., 2])


# --- the vehicle as an environment uses it --------------------------------------------------------


@compiled
def _fix(state: np.ndarray, exogenous: np.ndarray) -> np.ndarray:
    """Position, altitude, ground speed, course over ground and climb ``(..., 6)``."""
    _, _, _, north, east, climb, _ = np.moveaxis(state, -1, 0)
    course = np.stack([np.hypot(north, east), np.arctan2(east, north), climb], -1)
    return np.concatenate([state[..., :3], course], -1)


@compiled
def _through_the_air(state: np.ndarray, exogenous: np.ndarray) -> np.ndarray:
    """Measurement of the pitot tube ``(..., 1)``."""
    return airspeed(state, exogenous[..., 4:])[..., None]


def _velocity(measurements: np.ndarray, known: Known) -> Known:
    """Velocity over ground from speed and course of a GNSS."""
    speed, course = measurements[..., 3], measurements[..., 4]
    return {
        "ground speed": speed,
        "course": course,
        "north": speed * np.cos(course),
        "east": speed * np.sin(course),
    }


def _along(measurements: np.ndarray, known: Known) -> Known:
    """Mean wind along the course, from the difference of ground speed and airspeed."""
    if "ground speed" not in known:
        return {}
    speed, course = known["ground speed"], known["course"]
    fast, climb = np.clip(measurements[..., 0], 0.0, 1e3), np.clip(known["climb"], -1e3, 1e3)
    along = speed - np.sqrt(np.maximum(fast**2 - climb**2, 0.0))
    return {"mean wind north": along * np.cos(course), "mean wind east": along * np.sin(course)}


@compiled
@dataclass(frozen=True)
class Puna(SimulatedVehicle):
    """The PUNA in batches: actuators, state, sensors, and filters' model; or eq. 1 as printed.

    Over a step the wind is constant; increments change velocities and bank at the end of a step.
    Figures of the sensors are from public models of small aircraft (Beard & McLain 2012, ch. 7):
    the GNSS has white noise and a wandering bias. Filters estimate the whole state; their known
    input is ``u = (actuators before, actuators after)``.
    """

    body: PunaParameters = field(default_factory=lambda: load("puna", PunaParameters))
    dt: float = 0.1  # s
    substeps: int = 1  # one RK4 step is converged to 3 cm and 2e-4 rad in 30 s of full reversals
    as_printed: bool = False

    kinds = ("nonlinear", "as_printed")
    state_names = STATE
    equations = staticmethod(puna_rates)
    printed_equations = staticmethod(printed_rates)
    angles = ("phi",)
    parameter_names = COEFFICIENTS
    action_names = ("thrust", "angle of attack", "bank")
    steering = (1, 2)
    incremented = ("north", "east", "climb", "phi")
    ambient_flows = ("wind north", "wind east", "wind down")
    sensors = (
        Sensor(
            "GNSS", ("x", "y", "h", "ground speed", "course over ground", "climb"),
            _fix, (1.0, 1.0, 1.5, 0.05, 0.03, 0.1), rate=1.0,
            bias=Bias(("bias x", "bias y", "bias h"), start=(0.1,) * 3, pace=(0.21, 0.21, 0.40)),
            angles=(4,), scale=(100.0, 100.0, 100.0, 20.0, 3.0, 1.0),
            gives=("x", "y", "h", None, None, "climb"), inverse=_velocity,
        ),
        Sensor(
            "barometer", ("pressure altitude",), plain((2,)), (0.5,), scale=(100.0,), gives=("h",),
        ),
        Sensor(
            "pitot tube", ("airspeed",), _through_the_air, (0.5,), scale=(20.0,), inverse=_along,
        ),
        Sensor(  # the noise is assumed
            "attitude", ("bank",), plain((6,)), (0.02,), angles=(0,), scale=(0.5,), gives=("phi",),
        ),
    )  # fmt: skip
    grades = "fixed-wing"
    rates = {"climb": "h"}
    carried = np.vstack([np.zeros((3, 3)), np.diag([1.0, 1.0, -1.0]), np.zeros((1, 3))])
    """Velocities are over ground, so that the wind carries the aircraft from the first moment."""
    normals = len(UNCERTAIN)
    """Number of standard normal numbers that `parameters` needs."""

    @cached_property
    def cruise(self) -> tuple[np.ndarray, np.ndarray]:
        """Level flight at 100 m and cruise speed."""
        x = np.array([0.0, 0.0, 100.0, self.body.cruise_speed, 0.0, 0.0, 0.0])
        return x, np.concatenate([self.body.cruise, self.body.cruise])

    @cached_property
    def _actuators(self) -> np.ndarray:
        """Actuators with cruise at action 0, and limits at -1 and 1.

        Thrust has a lag, and the angle of attack a rate limit. The commanded bank has neither,
        because the bank itself has a lag.
        """
        body, (thrust, alpha, bank) = self.body, self.body.cruise
        below, above = body._reach
        lag, turn = np.exp(-self.dt / body.thrust_lag), body.alpha_rate * self.dt
        return np.array([
            Actuator(above[0], below[0], base=thrust, lag=lag),
            Actuator(above[1], below[1], base=alpha, turn=turn),
            Actuator(above[2], below[2], base=bank),
        ])  # fmt: skip
