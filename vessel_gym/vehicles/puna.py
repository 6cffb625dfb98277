"""Fixed-wing unmanned aircraft: a point mass that turns coordinated, in a wind; the PUNA is one (data/puna.toml).

Frames: x north, y east, altitude h up; angles of the velocity through the air: gamma above the horizon, chi from north
towards east; positive bank turns to starboard (chi rises). Wind components are north, east, down, where it blows to.

The same equations come in two forms. In wind axes (airspeed, gamma, chi) they are those of the literature, and
controllers are designed from them. The environment's state holds the velocity over ground instead: a gust then changes
nothing but the wind, so that white noise on the wind is all that a filter has to be told, and there is no pole at the
vertical.

Sources: the paper on Dubins paths and the ensemble Kalman filter for a PUNA ("Pesawat Udara Nir Awak", in Indonesian)
for the task, the controls (thrust and angle of attack) and the form of drag, lift and density; it prints no constant
(`data/puna.toml` has those of the Skywalker X8, Gryte 2018). Beard & McLain (2012), ch. 9, for the point mass in wind
axes and the bank.
`PlanarPuna` is the paper's own form in the vertical plane: it resolves lift along the body and drag along the velocity.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar, Protocol

import numpy as np
from numba import njit
from scipy.optimize import brentq

from estimators import NonlinearModel
from estimators.checks import shown
from vessel_gym.compiled import gufunc, inlined, sincos
from vessel_gym.disturbances import Air
from vessel_gym.sensors import Instrument, nominal_sd
from vessel_gym.vehicles.files import load

WIND_AXES = ("x", "y", "h", "V", "gamma", "chi", "phi", "wind north", "wind east", "wind down")
"""State of the equations in wind axes: position [m], altitude [m], airspeed [m/s], flight-path angle, course through
the air and bank [rad], wind [m/s]."""

TRUTH = (
    "x", "y", "h", "north", "east", "climb", "phi", "mean wind north", "mean wind east", "gust north", "gust east",
    "gust down 1", "gust down 2", "bias x", "bias y", "bias h",
)  # fmt: skip
"""Truth state: position and altitude [m], velocity over ground [m/s], bank [rad], mean wind [m/s], the gusts' state
[m/s] (down: the first plus sqrt(3) times the second), bias of the GNSS [m]."""

COEFFICIENTS = (
    "mass", "area", "gravity", "drag_2", "drag_1", "drag_0", "lift_1", "lift_0", "density_2", "density_1", "density_0",
    "thrust", "bank_rate",
)  # fmt: skip

_FACTORS = {
    "lift": ("lift_1", "lift_0"),
    "drag of the angle of attack": ("drag_2", "drag_1"),
    "drag at zero angle": ("drag_0",),
    "mass": ("mass",),
    "thrust": ("thrust",),
    "bank": ("bank_rate",),
}
UNCERTAIN = tuple(_FACTORS)
"""What `mismatch` spreads: one factor scales all coefficients of a kind."""

SLOWEST = 2.0  # m/s: slower than this, angles turn as at this speed. Nothing flies there, and nothing is infinite
HARDEST = 200.0  # m/s2: no wing bears more lift. At 20 m/s the aircraft reaches 50; it bounds how fast a step may turn


@dataclass(frozen=True)
class PointMass:
    """What the equations know of an aircraft, SI units; angles of attack in rad.

    Drag ``C_D = A1 a^2 + A2 a + A3``, lift ``C_L = B1 a + B2``, density ``C1 h^2 + C2 h + C3``: eq. 2 of the paper.
    """

    mass: float  # kg
    area: float  # m2, of the wing
    drag: tuple[float, float, float]  # A1, A2, A3
    lift: tuple[float, float]  # B1, B2
    density: tuple[float, float, float] = (4.319e-9, -1.1760e-4, 1.225)  # C1, C2, C3: ISO 2533, to second order in h
    gravity: float = 9.81  # m/s2
    bank_rate: float = 2.0  # 1/s, b of phi' = b (phi_c - phi): Beard & McLain (2012), the number assumed

    def vector(self, factors: np.ndarray | None = None) -> np.ndarray:
        """The coefficients of the compiled equations ``(..., 13)``, in the order of `COEFFICIENTS`.

        Args:
            factors: ``(..., 6)`` on the `UNCERTAIN` ones, 1 if not given.
        """
        c = np.array([self.mass, self.area, self.gravity, *self.drag, *self.lift, *self.density, 1.0, self.bank_rate])
        if factors is None:
            return c
        c = np.tile(c, factors.shape[:-1] + (1,))
        for i, names in enumerate(_FACTORS.values()):
            c[..., [COEFFICIENTS.index(name) for name in names]] *= factors[..., i : i + 1]
        return c


MISSILE = PointMass(1005.0, 0.3376, (-1.9431, -0.1499, 0.2359), (21.9, 0.0), (3.312e-9, -1.142e-4, 1.224))
"""The one aircraft whose constants are published in the paper's form: the missile of Subchan & Zbikowski (2009), that
flies at 272 m/s. At the paper's 20 m/s it would need a lift coefficient of 119."""


@dataclass(frozen=True, kw_only=True)
class PunaParameters(PointMass):
    """An aircraft with its actuators and their limits: what a vehicle file gives, each number there with its source."""

    cruise_speed: float  # m/s
    thrust_limit: float  # N
    thrust_lag: float = 0.5  # s, assumed
    alpha_low: float = float(np.deg2rad(-4.0))  # rad, assumed
    alpha_high: float = float(np.deg2rad(12.0))  # rad, assumed: clear of the stall
    alpha_rate: float = 0.5  # rad/s, assumed: the short-period motion that a point mass leaves out
    bank_limit: float = float(np.deg2rad(35.0))  # rad, assumed

    TABLES: ClassVar = {
        "particulars": ("mass", "area", "gravity"),
        "aerodynamics": ("drag", "lift", "density"),
        "limits": ("alpha_low", "alpha_high", "alpha_rate", "bank_limit", "bank_rate"),
        "propulsion": ("cruise_speed", "thrust_limit", "thrust_lag"),
    }
    """Where the keys stand in a vehicle file."""

    def mistakes(self) -> Iterator[tuple[str, str]]:
        """What no aircraft can be: the name of a number, and a sentence on it."""
        if self.alpha_low >= self.alpha_high:
            yield "alpha_high", f"{self.alpha_high:g} rad are no upper limit where the lower is {self.alpha_low:g} rad"
        if self.lift[0] <= 0.0:
            yield "lift", f"a wing lifts more at a higher angle of attack, not {self.lift[0]:g} a rad"
        if np.polyval(self.drag, np.linspace(self.alpha_low, self.alpha_high, 101)).min() <= 0.0:
            yield "drag", "within the limits of the angle of attack it becomes a thrust"
        if self.density[2] <= 0.0:
            yield "density", f"air weighs more than {self.density[2]:g} kg/m3 at sea level"
        try:
            trim(self.cruise_speed, self)
        except ValueError as error:
            yield "cruise_speed", str(error)

    @cached_property
    def cruise(self) -> np.ndarray:
        """Thrust, angle of attack and bank ``(3,)`` of level flight at the cruising speed, at sea level."""
        steady = trim(self.cruise_speed, self)
        return np.array([steady.thrust, steady.alpha, 0.0])

    def commands(self, action: np.ndarray) -> np.ndarray:
        """Thrust, angle of attack and bank ``(..., 3)`` that actions ask for: limits at -1 and 1, cruising at 0."""
        below, above = self._reach
        return self.cruise + action * np.where(action < 0.0, below, above)

    def actions(self, commands: np.ndarray) -> np.ndarray:
        """The actions ``(..., 3)`` that ask for thrust, angle of attack and bank."""
        below, above = self._reach
        change = commands - self.cruise
        return change / np.where(change < 0.0, below, above)

    @cached_property
    def _reach(self) -> tuple[np.ndarray, np.ndarray]:
        """From cruising to the lower limits and to the upper ones."""
        low = np.array([0.0, self.alpha_low, -self.bank_limit])
        return self.cruise - low, np.array([self.thrust_limit, self.alpha_high, self.bank_limit]) - self.cruise


@dataclass(frozen=True)
class Trim:
    """Steady level flight."""

    alpha: float  # rad
    thrust: float  # N


def trim(speed: float, body: PunaParameters, altitude: float = 0.0, bank: float = 0.0) -> Trim:
    """Angle of attack and thrust for level flight, in a coordinated turn if banked.

    Args:
        speed: Airspeed [m/s].
        body: The aircraft.
        altitude: Of the flight [m].
        bank: Angle [rad].

    Raises:
        ValueError: if the aircraft cannot fly level like this within its limits of angle and thrust.
    """
    pressure = 0.5 * float(np.polyval(body.density, altitude)) * speed**2 * body.area

    def thrust(alpha: float) -> float:
        return float(pressure * np.polyval(body.drag, alpha) / np.cos(alpha))

    def excess(alpha: float) -> float:
        across = pressure * np.polyval(body.lift, alpha) + thrust(alpha) * np.sin(alpha)
        return float(across * np.cos(bank) - body.mass * body.gravity)

    if excess(body.alpha_low) > 0.0 or excess(body.alpha_high) < 0.0:
        raise ValueError(
            f"no level flight at {speed:g} m/s: lift and weight balance at no angle of attack within limits"
        )
    alpha = float(brentq(excess, body.alpha_low, body.alpha_high, xtol=1e-14))
    if thrust(alpha) > body.thrust_limit:
        raise ValueError(f"no level flight at {speed:g} m/s: it takes {thrust(alpha):.1f} N of thrust")
    return Trim(alpha, thrust(alpha))


# --- compiled equations -----------------------------------------------------------------------------


@inlined
def _forces(altitude: float, speed: float, alpha: float, c: np.ndarray) -> tuple[float, float]:
    """Lift and drag [N], eq. 2. Falling backwards, for less than a step, both point the other way."""
    pressure = 0.5 * ((c[8] * altitude + c[9]) * altitude + c[10]) * speed * abs(speed) * c[1]
    return pressure * (c[6] * alpha + c[7]), pressure * ((c[3] * alpha + c[4]) * alpha + c[5])


@njit(cache=True)
def _derivative(
    s: np.ndarray | tuple[float, ...], thrust: float, alpha: float, command: float, north: float, east: float,
    down: float, c: np.ndarray,
) -> tuple[float, ...]:  # fmt: skip
    h, V, gamma, chi, phi = s[2], s[3], s[4], s[5], s[6]
    mass, gravity, force = c[0], c[2], c[11] * thrust
    lift, drag = _forces(h, V, alpha, c)
    sin_gamma, cos_gamma = np.sin(gamma), np.cos(gamma)
    across = (lift + force * np.sin(alpha)) / mass
    bounded_speed = max(V, SLOWEST)
    # A course has a pole straight up and down: within 1 deg of it, it turns at the rate of 1 deg.
    bounded = cos_gamma if abs(cos_gamma) > 0.0175 else (0.0175 if cos_gamma >= 0.0 else -0.0175)
    return (
        V * cos_gamma * np.cos(chi) + north, V * cos_gamma * np.sin(chi) + east, V * sin_gamma - down,
        (force * np.cos(alpha) - drag) / mass - gravity * sin_gamma,
        (across * np.cos(phi) - gravity * cos_gamma) / bounded_speed,
        across * np.sin(phi) / (bounded_speed * bounded),
        c[12] * (command - phi),
    )  # fmt: skip


@inlined
def _moved(s: tuple[float, ...], h: float, rate: tuple[float, ...]) -> tuple[float, ...]:
    return (
        s[0] + h * rate[0], s[1] + h * rate[1], s[2] + h * rate[2], s[3] + h * rate[3],
        s[4] + h * rate[4], s[5] + h * rate[5], s[6] + h * rate[6],
    )  # fmt: skip


@gufunc("void(float64[:], float64[:], float64[:], float64[:])", "(n),(m),(k)->(n)")
def puna_derivative(state: np.ndarray, control: np.ndarray, c: np.ndarray, out: np.ndarray) -> None:
    """Time derivative of the truth state, the wind constant; control is (thrust, angle of attack, commanded bank)."""
    rate = _derivative(state, control[0], control[1], control[2], state[7], state[8], state[9], c)
    out[0], out[1], out[2], out[3], out[4], out[5], out[6] = rate
    out[7], out[8], out[9] = 0.0, 0.0, 0.0


@gufunc("void(float64[:], float64[:], float64[:], float64, int64, float64[:])", "(n),(m),(k),(),()->(n)")
def puna_step(state: np.ndarray, control: np.ndarray, c: np.ndarray, dt: float, substeps: int, out: np.ndarray) -> None:
    """RK4 over ``dt``, the wind constant; control is (thrust, angle of attack, commanded bank) before, then after.

    Actuators move linearly within the step, so that their rates are integrated exactly.
    """
    north, east, down = state[7], state[8], state[9]
    h = dt / substeps
    s: tuple[float, ...] = (state[0], state[1], state[2], state[3], state[4], state[5], state[6])
    thrust, alpha, command = control[0], control[1], control[2]
    # over half a substep
    d_thrust = 0.5 * (control[3] - thrust) / substeps
    d_alpha = 0.5 * (control[4] - alpha) / substeps
    d_command = 0.5 * (control[5] - command) / substeps
    for i in range(substeps):
        T, a, b = thrust + 2 * i * d_thrust, alpha + 2 * i * d_alpha, command + 2 * i * d_command
        k1 = _derivative(s, T, a, b, north, east, down, c)
        T, a, b = T + d_thrust, a + d_alpha, b + d_command
        k2 = _derivative(_moved(s, 0.5 * h, k1), T, a, b, north, east, down, c)
        k3 = _derivative(_moved(s, 0.5 * h, k2), T, a, b, north, east, down, c)
        T, a, b = T + d_thrust, a + d_alpha, b + d_command
        k4 = _derivative(_moved(s, h, k3), T, a, b, north, east, down, c)
        s = _moved(_moved(_moved(_moved(s, h / 6.0, k1), h / 3.0, k2), h / 3.0, k3), h / 6.0, k4)
        if s[3] < 0.0:  # a tail slide: the same velocity, nose first
            s = (s[0], s[1], s[2], -s[3], -s[4], s[5] + np.pi, s[6])
    out[0], out[1], out[2], out[3], out[4], out[5], out[6] = s
    out[7], out[8], out[9] = north, east, down


@inlined
def _wind(s: np.ndarray) -> tuple[float, float, float]:
    """Mean wind and gusts of the truth state: north, east, down."""
    return s[7] + s[9], s[8] + s[10], s[11] + np.sqrt(3.0) * s[12]


@inlined
def _ground_rates(
    s: tuple[float, ...], thrust: float, alpha: float, command: float, wind: tuple[float, float, float],
    c: np.ndarray,
) -> tuple[float, ...]:  # fmt: skip
    """Rates of position, velocity over ground and bank: `_derivative` without its angles."""
    north, east, up, phi = s[3] - wind[0], s[4] - wind[1], s[5] + wind[2], s[6]
    level = np.sqrt(north * north + east * east)
    V = np.sqrt(level * level + up * up)
    lift, drag = _forces(s[2], V, alpha, c)
    (sin_alpha, cos_alpha), (sin_phi, cos_phi) = sincos(alpha), sincos(phi)
    force = c[11] * thrust
    along = (force * cos_alpha - drag) / c[0]
    across = min(max((lift + force * sin_alpha) / c[0], -HARDEST), HARDEST)
    # Where nothing flies, straight up or down or at rest, directions are those of a hair beside.
    V = max(V, 1e-3)
    level = max(level, 1e-3)
    above, aside = across * cos_phi / V, across * sin_phi / level
    ahead = along / V - above * up / level
    return (
        s[3], s[4], s[5],
        ahead * north - aside * east, ahead * east + aside * north,
        along * up / V + above * level - c[2],
        c[12] * (command - phi),
    )  # fmt: skip


@inlined
def _ground_substep(
    s: tuple[float, ...], i: int, h: float, thrust: float, alpha: float, command: float, d_thrust: float,
    d_alpha: float, d_command: float, wind: tuple[float, float, float], c: np.ndarray,
) -> tuple[float, ...]:  # fmt: skip
    """RK4 over the ``i``-th ``h``; actuators at the start of the first, and what they move in half of each."""
    T, a, b = thrust + 2 * i * d_thrust, alpha + 2 * i * d_alpha, command + 2 * i * d_command
    k1 = _ground_rates(s, T, a, b, wind, c)
    T, a, b = T + d_thrust, a + d_alpha, b + d_command
    k2 = _ground_rates(_moved(s, 0.5 * h, k1), T, a, b, wind, c)
    k3 = _ground_rates(_moved(s, 0.5 * h, k2), T, a, b, wind, c)
    T, a, b = T + d_thrust, a + d_alpha, b + d_command
    k4 = _ground_rates(_moved(s, h, k3), T, a, b, wind, c)
    return _moved(_moved(_moved(_moved(s, h / 6.0, k1), h / 3.0, k2), h / 3.0, k3), h / 6.0, k4)


_LANES = 16  # states that are stepped side by side: a number that the compiler knows, to see that they are independent


@gufunc(
    "void(float64[:, :], float64[:], float64[:], float64[:], float64, int64, float64[:, :])",
    "(N,n),(m),(k),(d),(),()->(N,n)",
)
def _ground_steps(
    states: np.ndarray, control: np.ndarray, c: np.ndarray, decay: np.ndarray, dt: float, substeps: int, out: np.ndarray
) -> None:
    """`ground_step` of many states ``(N, 16)`` under one control, side by side in vector instructions."""
    thrust, alpha, command = control[0], control[1], control[2]
    half = 0.5 / substeps
    d_thrust, d_alpha = half * (control[3] - thrust), half * (control[4] - alpha)
    d_command = half * (control[5] - command)
    a = np.empty((16, _LANES))
    for first in range(0, len(states), _LANES):
        size = min(_LANES, len(states) - first)
        for j in range(_LANES):
            for k in range(16):
                a[k, j] = states[first + min(j, size - 1), k]
        for i in range(substeps):
            for j in range(_LANES):
                wind = (a[7, j] + a[9, j], a[8, j] + a[10, j], a[11, j] + np.sqrt(3.0) * a[12, j])
                s: tuple[float, ...] = (a[0, j], a[1, j], a[2, j], a[3, j], a[4, j], a[5, j], a[6, j])
                s = _ground_substep(s, i, dt / substeps, thrust, alpha, command, d_thrust, d_alpha, d_command, wind, c)
                a[0, j], a[1, j], a[2, j], a[3, j], a[4, j], a[5, j], a[6, j] = s
        for j in range(size):
            row, up, down = first + j, a[11, j], a[12, j]
            for k in range(7):
                out[row, k] = a[k, j]
            out[row, 7], out[row, 8] = decay[0] * a[7, j], decay[0] * a[8, j]
            out[row, 9], out[row, 10] = decay[1] * a[9, j], decay[1] * a[10, j]
            out[row, 11], out[row, 12] = decay[2] * up + decay[3] * down, decay[4] * up + decay[5] * down
            out[row, 13], out[row, 14], out[row, 15] = a[13, j], a[14, j], a[15, j]


def ground_step(
    state: np.ndarray, control: np.ndarray, c: np.ndarray, decay: np.ndarray, dt: float, substeps: int
) -> np.ndarray:
    """`puna_step` on truth states ``(..., 16)``; at the end the wind decays by ``decay (6,)``, see `Air.decay`."""
    if state.ndim > 1 and control.shape[-2:-1] == (1,) and c.ndim == 1:  # an ensemble's members share both
        return _ground_steps(state, control[..., 0, :], c, decay, dt, substeps)
    return _ground_steps(state[..., None, :], control, c, decay, dt, substeps)[..., 0, :]


@gufunc("void(float64[:], float64[:], float64[:])", "(n),(k)->(k)")
def wind_axes(state: np.ndarray, room: np.ndarray, out: np.ndarray) -> None:
    """The truth state ``(16,)`` in wind axes ``(10,)``; ``room (10,)`` only tells how many there are."""
    wind = _wind(state)
    north, east, up = state[3] - wind[0], state[4] - wind[1], state[5] + wind[2]
    level = np.hypot(north, east)
    out[0], out[1], out[2] = state[0], state[1], state[2]
    out[3], out[4], out[5], out[6] = np.hypot(level, up), np.arctan2(up, level), np.arctan2(east, north), state[6]
    out[7], out[8], out[9] = wind


@gufunc("void(float64[:], float64[:], float64[:])", "(n),(p)->(p)")
def puna_readings(state: np.ndarray, template: np.ndarray, out: np.ndarray) -> None:
    """What instruments without noise read ``(9,)``, in their order; ``template (9,)`` only tells how many they are."""
    wind = _wind(state)
    north, east, up = state[3] - wind[0], state[4] - wind[1], state[5] + wind[2]
    out[0], out[1], out[2] = state[0] + state[13], state[1] + state[14], state[2] + state[15]
    out[3], out[4], out[5] = np.hypot(state[3], state[4]), np.arctan2(state[4], state[3]), state[5]
    out[6], out[7], out[8] = state[2], np.hypot(np.hypot(north, east), up), state[6]


def energy(state: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Kinetic energy against the air and potential energy [J] of states ``(..., 10)``, ``(...)``."""
    return c[..., 0] * (0.5 * state[..., 3] ** 2 + c[..., 2] * state[..., 2])


# --- the paper's own form ---------------------------------------------------------------------------


@gufunc("void(float64[:], float64[:], float64[:], float64[:])", "(n),(m),(k)->(n)")
def planar_derivative(state: np.ndarray, control: np.ndarray, c: np.ndarray, out: np.ndarray) -> None:
    """Eq. (1) on (gamma, v, x, h) with control (thrust, angle of attack), its g sin(alpha) mended to g sin(gamma)."""
    gamma, v, h, thrust, alpha = state[0], state[1], state[3], control[0], control[1]
    mass, gravity = c[0], c[2]
    lift, drag = _forces(h, v, alpha, c)
    sin_alpha, cos_alpha = np.sin(alpha), np.cos(alpha)
    out[0] = (thrust * sin_alpha + lift * cos_alpha) / (mass * v) - gravity * np.cos(gamma) / v
    out[1] = (thrust * cos_alpha - drag - lift * sin_alpha) / mass - gravity * np.sin(gamma)
    out[2], out[3] = v * np.cos(gamma), v * np.sin(gamma)


@dataclass(frozen=True)
class PlanarPuna:
    """The paper's model in the vertical plane, for reproduction: state (gamma, v, x, h), thrust and angle of attack.

    Drag along the velocity, but lift along the body's normal, as printed: what comes with lift brakes twice. Subchan &
    Zbikowski (2009), whose constants are those of axial and normal force, have both along the body. No wind, no
    actuators, and nothing is bounded.
    """

    body: PointMass = field(default_factory=lambda: load("puna", PunaParameters))
    dt: float = 0.01  # s, assumed: the paper prints none

    def step(self, state: np.ndarray, control: np.ndarray) -> np.ndarray:
        """Eqs. (19) and (21), forward Euler, their second row with "+ v_k" for the printed "+ gamma_k".

        Args:
            state: ``(..., 4)``.
            control: ``(..., 2)`` thrust [N] and angle of attack [rad].
        """
        return state + self.dt * planar_derivative(state, control, self.body.vector())

    def model(self, measured: str, Q: np.ndarray, R: np.ndarray) -> NonlinearModel:
        """The paper's filter model, with one of its two sets of measurements; the known input is the control.

        Args:
            measured: ``"x"``, the position along the track alone, or ``"all"``, every state.
            Q: ``(4, 4)`` covariance of what enters in a step.
            R: ``(1, 1)`` or ``(4, 4)`` covariance of the readings.

        Raises:
            ValueError: for another set.
        """
        if measured not in ("x", "all"):
            raise ValueError(f"unknown measurement set {measured!r}: choose x or all")
        seen = [2] if measured == "x" else [0, 1, 2, 3]

        def transition(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
            assert u is not None
            return self.step(x, u)

        def measurement(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
            return x[..., seen]

        angles = (0,) if measured == "all" else ()
        return NonlinearModel(transition, measurement, Q, R, state_angles=(0,), measurement_angles=angles)


# --- the vehicle as an environment uses it ----------------------------------------------------------


class Gusts(Protocol):
    """What a filter's model needs to know of the air and of the GNSS."""

    @property
    def decay(self) -> np.ndarray:
        """How the wind decays in a step, ``(6,)``: mean, level gusts, and the vertical ones' matrix row by row."""

    @property
    def noise_cov(self) -> np.ndarray:
        """Covariance ``(13, 13)`` of what enters the state in a step, from the velocities on."""


@dataclass(frozen=True)
class Puna:
    """The aircraft in batches, as an environment uses it.

    Over a step the wind is constant; the forcing changes it at the end. Figures of the instruments are from public
    models of small aircraft (Beard & McLain 2012, ch. 7): the GNSS has white noise and a bias that wanders.
    """

    body: PunaParameters = field(default_factory=lambda: load("puna", PunaParameters))
    dt: float = 0.1  # s
    substeps: int = 1  # one RK4 step is converged to 3 cm and 2e-4 rad in 30 s of full reversals

    truth_names: ClassVar = TRUTH
    parameter_names: ClassVar = COEFFICIENTS
    action_names: ClassVar = ("thrust", "angle of attack", "bank")
    instruments: ClassVar = (
        Instrument(
            "GNSS", ("x", "y", "h", "ground speed", "course over ground", "climb"), (1.0, 1.0, 1.5, 0.05, 0.03, 0.1),
            period=10,
        ),
        Instrument("barometer", ("pressure altitude",), (0.5,)),
        Instrument("pitot tube", ("airspeed",), (0.5,)),
        Instrument("attitude", ("bank",), (0.02,)),  # assumed
    )  # fmt: skip
    unknown_inputs: ClassVar = 13
    """What enters the state in a step, from the velocities on."""
    normals: ClassVar = len(UNCERTAIN)
    """Normal numbers that `parameters` needs."""
    state_angles: ClassVar = (6,)
    measurement_angles: ClassVar = (4, 8)

    def parameters(self, mismatch: float, normals: np.ndarray) -> np.ndarray:
        """Coefficients ``(B, k)`` of the truth: the filter's, with a relative spread on the uncertain ones."""
        return self.body.vector(1.0 + mismatch * np.clip(normals, -2.0, 2.0))

    @cached_property
    def localisation(self) -> np.ndarray:
        """``(16, 9)``: which reading may correct which state of an ensemble.

        Ten times a second barometer, pitot tube and attitude tell of altitude, wind and bank, and only by chance
        correlations of the position in plan, whose variance would shrink between two fixes of the GNSS.
        """
        level = ("x", "y", "north", "east", "bias x", "bias y")
        course = ("x", "y", "north", "east", "phi", "mean wind north", "mean wind east", "gust north", "gust east")
        vertical = ("h", "climb", "bias h")
        down = (*vertical, "gust down 1", "gust down 2")
        wind = ("north", "east", "mean wind north", "mean wind east", "gust north", "gust east")
        corrected = (level, level, vertical, course, course, down, down, wind, ("phi",))
        return np.array([[float(name in names) for names in corrected] for name in TRUTH])

    @cached_property
    def wind_decay(self) -> np.ndarray:
        """How the wind decays in a step ``(6,)``, as `Air.decay`."""
        return Air(0.0, 1.0, 1.0, airspeed=self.body.cruise_speed, dt=self.dt).decay

    def start(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Truth ``(B, 16)`` and actuators ``(B, 3)`` from the state: trimmed for the cruising speed."""
        return np.array(x, float), np.tile(self.body.cruise, (len(x), 1))

    def filter_state(self, truth: np.ndarray, n: int = len(TRUTH)) -> np.ndarray:
        """The part of the truth that filters estimate: its first ``n`` components."""
        return truth[..., :n]

    def actuate(self, actuators: np.ndarray, action: np.ndarray) -> np.ndarray:
        """Actuators ``(B, 3)`` after a step of ``action`` in [-1, 1].

        At 0 the aircraft cruises level, at -1 and 1 every actuator is at a limit. Thrust follows with its lag, angle of
        attack at its rate, commanded bank at once: the bank itself lags.
        """
        body, after = self.body, self.body.commands(action)
        thrust = after[..., 0]
        after[..., 0] = thrust + (actuators[..., 0] - thrust) * np.exp(-self.dt / body.thrust_lag)
        turn = body.alpha_rate * self.dt
        after[..., 1] = np.clip(after[..., 1], actuators[..., 1] - turn, actuators[..., 1] + turn)
        return after

    def step(
        self, truth: np.ndarray, before: np.ndarray, after: np.ndarray, forcing: np.ndarray, parameters: np.ndarray
    ) -> np.ndarray:
        """The truth one step later, with actuators moving from ``before`` to ``after`` and ``forcing (B, 13)``."""
        control = np.concatenate([before, after], -1)
        moved = ground_step(truth, control, parameters, self.wind_decay, self.dt, self.substeps)
        moved[..., 3:] += forcing
        return moved

    def readings(self, truth: np.ndarray, forcing: np.ndarray) -> np.ndarray:
        """What perfect instruments read ``(B, 9)``; the forcing acts later and is not seen."""
        return puna_readings(truth, np.empty(9))

    def from_readings(
        self, readings: np.ndarray, previous: np.ndarray, interval: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """State ``(..., 16)`` and unknown input ``(..., 13)`` from the readings alone, gusts and bias as zero.

        Altitude is the barometer's. What airspeed and ground speed differ by is taken for a wind along the course.

        Args:
            readings: ``(..., 9)``.
            previous: the readings before, not needed.
            interval: seconds between the two, not needed.
        """
        x = np.zeros(readings.shape[:-1] + (len(TRUTH),))
        x[..., [0, 1, 2, 5, 6]] = readings[..., [0, 1, 6, 5, 8]]
        speed, course = readings[..., 3], readings[..., 4]
        x[..., 3], x[..., 4] = speed * np.cos(course), speed * np.sin(course)
        airspeed, climb = np.clip(readings[..., 7], 0.0, 1e3), np.clip(readings[..., 5], -1e3, 1e3)
        level = np.sqrt(np.maximum(airspeed**2 - climb**2, 0.0))
        x[..., 7], x[..., 8] = (speed - level) * np.cos(course), (speed - level) * np.sin(course)
        return x, np.zeros(readings.shape[:-1] + (self.unknown_inputs,))

    def model(self, kind: str, noise: float, air: Gusts) -> NonlinearModel:
        """The filters' model: the vehicle's own equations, and what the air does as process noise.

        The known input is ``u = (actuators before, actuators after)``.

        Args:
            kind: ``"nonlinear"``; there is no other.
            noise: standard deviation of the readings relative to nominal.
            air: how the gusts decay, and what drives them.

        Raises:
            ValueError: for another kind.
        """
        if kind != "nonlinear":
            raise ValueError(f"unknown filter model {shown(kind)}: this vehicle has the nonlinear one only")
        if not np.allclose(air.decay, self.wind_decay):
            raise ValueError(
                "the vehicle's wind decays otherwise than that of the air: give both the same times and lengths"
            )
        c = self.body.vector()

        def transition(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
            assert u is not None
            return ground_step(x, u, c, self.wind_decay, self.dt, self.substeps)

        def measurement(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
            return puna_readings(x, np.empty(9))

        Q = np.zeros((len(TRUTH), len(TRUTH)))
        Q[3:, 3:] = air.noise_cov
        return NonlinearModel(
            transition,
            measurement,
            Q,
            np.diag((noise * nominal_sd(self.instruments)) ** 2),
            state_angles=self.state_angles,
            measurement_angles=self.measurement_angles,
        )
