"""The PUNA, a small fixed-wing unmanned aircraft: a point mass that turns coordinated, in a wind.

Frames: x north, y east, altitude h up; angles of the velocity through the air: gamma above the horizon, chi from north
towards east; positive bank turns to starboard (chi rises). Wind components are north, east, down, where it blows to.

The same equations come in two forms. In wind axes (airspeed, gamma, chi) they are those of the literature, and
controllers are designed from them. The environment's state holds the velocity over ground instead: a gust then changes
nothing but the wind, so that white noise on the wind is all that a filter has to be told, and there is no pole at the
vertical.

Sources: the paper on Dubins paths and the ensemble Kalman filter for a PUNA ("Pesawat Udara Nir Awak", in Indonesian)
for the task, the controls (thrust and angle of attack) and the form of drag, lift and density; it prints no constant.
Gryte (2018), the Skywalker X8, for those. Beard & McLain (2012), ch. 9, for the point mass in wind axes and the bank.
`PlanarPuna` is the paper's own form in the vertical plane: it resolves lift along the body and drag along the velocity.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numba import njit
from scipy.optimize import brentq

from estimators import NonlinearModel
from vessel_gym.compiled import gufunc, inlined, sincos
from vessel_gym.sensors import Bias, Known, Sensor, plain

WIND_AXES = ("x", "y", "h", "V", "gamma", "chi", "phi", "wind north", "wind east", "wind down")
"""State of the equations in wind axes: position [m], altitude [m], airspeed [m/s], flight-path angle, course through
the air and bank [rad], wind [m/s]."""

STATE = ("x", "y", "h", "north", "east", "climb", "phi")
"""State: position and altitude [m], velocity over ground [m/s] and bank [rad]."""

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
    """What the equations know of an aircraft, SI units; angles of attack in rad. Default: Skywalker X8, Gryte (2018).

    Drag ``C_D = A1 a^2 + A2 a + A3``, lift ``C_L = B1 a + B2``, density ``C1 h^2 + C2 h + C3``: eq. 2 of the paper.
    """

    mass: float = 3.364  # kg
    area: float = 0.75  # m2, of the wing
    drag: tuple[float, float, float] = (1.0555, 0.07909, 0.0197)  # A1, A2, A3
    lift: tuple[float, float] = (4.0203, 0.08674)  # B1, B2
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


@dataclass(frozen=True)
class PunaParameters(PointMass):
    """The aircraft with its actuators and their limits."""

    thrust_limit: float = 16.0  # N, half the weight, assumed: climbs at 20 deg at 20 m/s
    thrust_lag: float = 0.5  # s, assumed
    alpha_low: float = np.deg2rad(-4.0)  # rad, assumed: pushes over at -1 g at 20 m/s
    alpha_high: float = np.deg2rad(12.0)  # rad, assumed: clear of the stall
    alpha_rate: float = 0.5  # rad/s, assumed: the short-period motion that a point mass leaves out
    bank_limit: float = np.deg2rad(35.0)  # rad, see below
    cruise_speed: float = 20.0  # m/s, printed
    # 100 m of radius at 20 m/s take 22.2 deg, with 3.8 m/s of tail wind 30 deg: the rest is for gusts and corrections.

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


@gufunc("void(float64[:], float64[:], float64[:], float64[:])", "(n),(f),(k)->(k)")
def wind_axes(state: np.ndarray, wind: np.ndarray, room: np.ndarray, out: np.ndarray) -> None:
    """A state ``(7,)`` in a wind in wind axes ``(10,)``; ``room (10,)`` only tells how many there are."""
    north, east, up = state[3] - wind[0], state[4] - wind[1], state[5] + wind[2]
    level = np.hypot(north, east)
    out[0], out[1], out[2] = state[0], state[1], state[2]
    out[3], out[4], out[5], out[6] = np.hypot(level, up), np.arctan2(up, level), np.arctan2(east, north), state[6]
    out[7], out[8], out[9] = wind[0], wind[1], wind[2]


@gufunc("void(float64[:], float64[:], float64[:])", "(n),(f)->()")
def airspeed(state: np.ndarray, wind: np.ndarray, out: np.ndarray) -> None:
    """Airspeed [m/s] of a state ``(7,)`` in a wind ``(3,)``."""
    out[0] = np.hypot(np.hypot(state[3] - wind[0], state[4] - wind[1]), state[5] + wind[2])


@gufunc("void(float64[:], float64[:], float64[:])", "(n),(k)->(k)")
def puna_gnss(state: np.ndarray, template: np.ndarray, out: np.ndarray) -> None:
    """What a GNSS without noise and bias reads ``(6,)``; ``template (6,)`` only tells how many numbers they are."""
    out[0], out[1], out[2] = state[0], state[1], state[2]
    out[3], out[4], out[5] = np.hypot(state[3], state[4]), np.arctan2(state[4], state[3]), state[5]


def _pj(old, state, control, wind, c, dt, substeps, out):
    B = np.broadcast_shapes(state.shape[:-1], wind.shape[:-1])
    z = np.zeros(B + (9,))
    z[..., 0] = wind[..., 0]
    z[..., 1] = wind[..., 1]
    z[..., 4] = wind[..., 2]
    x = np.concatenate([np.broadcast_to(state, B + (7,)), z], -1)
    r = old(x, control, c, np.ones(6), dt, substeps)[..., :7]
    if out is None:
        return r
    out[...] = r
    return out


def puna_steps(state, control, wind, c, dt, substeps, out=None):
    return _pj(_ground_steps, state, control, wind, c, dt, substeps, out)


_old_puna_step = puna_step


def puna_step(state, control, wind, c, dt, substeps, out=None):
    return _pj(ground_step, state, control, wind, c, dt, substeps, out)


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

    body: PointMass = PointMass()
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


_LEVEL = ("x", "y", "north", "east", "bias x", "bias y")
_COURSE = ("x", "y", "north", "east", "phi", "mean wind north", "mean wind east", "gust north", "gust east")
_VERTICAL = ("h", "climb", "bias h")
_DOWN = (*_VERTICAL, "gust down 1", "gust down 2")
_WIND = ("north", "east", "mean wind north", "mean wind east", "gust north", "gust east")


def _velocity(readings: np.ndarray, known: Known) -> Known:
    """Velocity over ground from speed and course of a GNSS."""
    speed, course = readings[..., 3], readings[..., 4]
    return {"ground speed": speed, "course": course, "north": speed * np.cos(course), "east": speed * np.sin(course)}


def _along(readings: np.ndarray, known: Known) -> Known:
    """What airspeed and ground speed differ by, taken for a wind along the course."""
    if "ground speed" not in known:
        return {}
    speed, course = known["ground speed"], known["course"]
    fast, climb = np.clip(readings[..., 0], 0.0, 1e3), np.clip(known["climb"], -1e3, 1e3)
    along = speed - np.sqrt(np.maximum(fast**2 - climb**2, 0.0))
    return {"mean wind north": along * np.cos(course), "mean wind east": along * np.sin(course)}


@dataclass(frozen=True)
class Puna:
    """The aircraft in batches, as an environment uses it.

    Over a step the wind is constant; kicks change velocities and bank at its end. Figures of the sensors are from
    public models of small aircraft (Beard & McLain 2012, ch. 7): the GNSS has white noise and a bias that wanders.
    Ten times a second barometer, pitot tube and attitude tell of altitude, wind and bank, and only by chance
    correlations of the position in plan, whose variance would shrink between two fixes of the GNSS: hence what each
    informs. Filters estimate the whole state; their known input is ``u = (actuators before, actuators after)``.
    """

    body: PunaParameters = PunaParameters()
    dt: float = 0.1  # s
    substeps: int = 1  # one RK4 step is converged to 3 cm and 2e-4 rad in 30 s of full reversals

    state_names: ClassVar = STATE
    angles: ClassVar = ("phi",)
    parameter_names: ClassVar = COEFFICIENTS
    action_names: ClassVar = ("thrust", "angle of attack", "bank")
    kicks: ClassVar = ("kick north", "kick east", "kick climb", "kick phi")
    kicked: ClassVar = ("north", "east", "climb", "phi")
    flows: ClassVar = ("wind north", "wind east", "wind down")
    sensors: ClassVar = (
        Sensor(
            "GNSS", ("x", "y", "h", "ground speed", "course over ground", "climb"),
            lambda state, forcing: puna_gnss(state, np.empty(6)), (1.0, 1.0, 1.5, 0.05, 0.03, 0.1), rate=1.0,
            bias=Bias(("bias x", "bias y", "bias h"), start=(0.1,) * 3, pace=(0.21, 0.21, 0.40)),
            angles=(4,), scale=(100.0, 100.0, 100.0, 20.0, 3.0, 1.0), gives=("x", "y", "h", None, None, "climb"),
            inverse=_velocity, informs=(_LEVEL, _LEVEL, _VERTICAL, _COURSE, _COURSE, _DOWN),
        ),
        Sensor(
            "barometer", ("pressure altitude",), plain((2,)), (0.5,), scale=(100.0,), gives=("h",), informs=(_DOWN,)
        ),
        Sensor(
            "pitot tube", ("airspeed",), lambda state, forcing: airspeed(state, forcing[..., 4:])[..., None], (0.5,),
            scale=(20.0,), inverse=_along, informs=(_WIND,),
        ),
        Sensor(
            "attitude", ("bank",), plain((6,)), (0.02,), angles=(0,), scale=(0.5,), gives=("phi",), informs=(("phi",),)
        ),  # assumed
    )  # fmt: skip
    kinds: ClassVar = ("nonlinear",)
    linear_kinds: ClassVar = ()
    rates: ClassVar = {"climb": "h"}
    carried: ClassVar = np.vstack([np.zeros((3, 3)), np.diag([1.0, 1.0, -1.0]), np.zeros((1, 3))])
    """Velocities are over ground: the wind carries the aircraft along from the first moment."""
    normals: ClassVar = len(UNCERTAIN)
    """Normal numbers that `parameters` needs."""

    def parameters(self, mismatch: float, normals: np.ndarray) -> np.ndarray:
        """Coefficients ``(B, k)`` of the truth: the filter's, with a relative spread on the uncertain ones."""
        return self.body.vector(1.0 + mismatch * np.clip(normals, -2.0, 2.0))

    def estimated(self, kind: str) -> tuple[str, ...]:
        """All of the state."""
        return self.state_names

    def placed(self, x: np.ndarray) -> np.ndarray:
        """The state out of what filters estimate, which is the same."""
        return x

    @property
    def process_sd(self) -> np.ndarray:
        """The models leave out nothing."""
        return np.zeros(len(STATE))

    @property
    def cruise(self) -> tuple[np.ndarray, np.ndarray]:
        """Level at 100 m and the cruising speed."""
        x = np.array([0.0, 0.0, 100.0, self.body.cruise_speed, 0.0, 0.0, 0.0])
        return x, np.concatenate([self.body.cruise, self.body.cruise])

    def start(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """State ``(B, 7)`` and actuators ``(B, 3)`` to begin with: trimmed for the cruising speed."""
        return np.array(x, float), np.tile(self.body.cruise, (len(x), 1))

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
        self, state: np.ndarray, before: np.ndarray, after: np.ndarray, forcing: np.ndarray, parameters: np.ndarray
    ) -> np.ndarray:
        """The state one step later, with actuators moving from ``before`` to ``after``."""
        moved = self._advance(state, np.concatenate([before, after], -1), forcing[..., 4:], parameters)
        moved[..., 3:] += forcing[..., :4]
        return moved

    def drift(self, x: np.ndarray, u: np.ndarray, flow: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """A step that nothing kicks, as filters know it."""
        return self._advance(x, u, flow, self._nominal, out)

    def _advance(
        self, state: np.ndarray, control: np.ndarray, wind: np.ndarray, c: np.ndarray, out: np.ndarray | None = None
    ) -> np.ndarray:
        if state.ndim > 1 and control.shape[-2:-1] == (1,) and c.ndim == 1:  # an ensemble's members share both
            winds = np.broadcast_to(wind, state.shape[:-1] + (3,))
            return puna_steps(state, control[..., 0, :], winds, c, self.dt, self.substeps, out=out)
        return puna_step(state, control, wind, c, self.dt, self.substeps, out=out)

    @cached_property
    def _nominal(self) -> np.ndarray:
        return self.body.vector()

    def linear(self, kind: str) -> tuple[Any, Any]:
        """There is none."""
        raise NotImplementedError
