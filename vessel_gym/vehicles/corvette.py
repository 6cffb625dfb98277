"""Ships in surge, sway and yaw; the SIGMA-class corvette is one (data/corvette.toml).

Frames: North-East-Down, body x forward, y starboard, origin amidships. Positive rudder turns the
ship to starboard (yaw rate r > 0), as in the thesis' figures; Davidson and Schiff count it the other
way, so Y'delta and N'delta change sign together.

Sources: Clarke, Gedling & Hine (1983) for the linear derivatives (eqs. 2.19 and 2.23 of the thesis that the
task comes from, Hermawan (2020), misprint two of them); Fossen (2011) for the structure; Fujii & Tuda (1961)
for the rudder; Hoerner (1965) for cross-flow drag.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache, cached_property, partial
from typing import ClassVar

import numpy as np
from numba import njit
from scipy.optimize import root

from estimators import LinearModel, NonlinearModel, wrap, zero_order_hold
from estimators.checks import shown
from vessel_gym.compiled import gufunc
from vessel_gym.disturbances import Sea
from vessel_gym.sensors import Instrument, nominal_sd
from vessel_gym.vehicles.files import load

TRUTH = ("x", "y", "psi", "u", "v", "r")
"""Truth state: position north, east [m], heading [rad], surge, sway through the water [m/s], yaw rate [rad/s]."""


_CROSS_FLOW = np.array([
    [0.0109, 0.177, 0.353, 0.452, 0.473, 0.493, 0.558, 0.646, 0.834, 0.988, 1.308, 1.639, 1.860, 2.313, 2.600, 3.009],
    [1.966, 1.966, 1.898, 1.787, 1.584, 1.245, 1.084, 0.999, 0.880, 0.828, 0.760, 0.691, 0.657, 0.631, 0.596, 0.587],
])  # fmt: skip
"""Hoerner's curve: beam / (2 draught) and cross-flow drag; as read by Leite, Aranha, Umeda & Conti (1998)."""


@dataclass(frozen=True)
class CorvetteParameters:
    """Particulars of a ship, SI units: what a vehicle file gives, each number there with its source.

    What has a default may be left out. ``given`` holds measured or computed derivatives by name, which replace the
    estimated ones (`GIVEN`): non-dimensional (prime I: divided by ``rho / 2``, powers of L and U) as those of Clarke,
    without the ship's own mass (Yr, not Yr - m), rudder to starboard positive.
    """

    length: float  # m, between perpendiculars
    beam: float  # m
    draught: float  # m
    mass: float  # kg
    speed: float  # m/s, service speed U
    resistance: float  # N at U, grows with the square of the speed
    rudder_area: float | None = None  # m2, of all rudders; None: Ydelta is given
    x_g: float = 0.0  # m, centre of gravity forward of amidships
    water_density: float = 1025.0  # kg/m3, sea water; Fossen (2011)
    yaw_radius: float = 0.25  # gyration radius / L; Fossen (2011), sec. 3.3
    drag_coefficient: float | None = None  # cross-flow drag; None: by Hoerner's curve
    rudder_aspect: float = 1.5  # effective aspect ratio, assumed
    rudder_limit: float = float(np.deg2rad(35.0))  # rad, usual; the angle of the trials of MSC.137(76)
    rudder_rate: float = float(np.deg2rad(65.0 / 28.0))  # rad/s, the least; SOLAS II-1/29
    slipstream: float = 1.1  # inflow speed at the rudder / u, assumed
    straightening: float = 0.4  # share of the geometric drift angle that the rudder sees; Yasukawa & Yoshimura (2015)
    given: tuple[tuple[str, float], ...] = ()  # derivatives by name

    TABLES: ClassVar = {
        "particulars": ("length", "beam", "draught", "mass", "x_g", "yaw_radius", "water_density"),
        "derivatives": (
            "Xudot", "Yvdot", "Yrdot", "Nvdot", "Nrdot", "Yv", "Yr", "Nv", "Nr", "drag_coefficient",
        ),
        "rudder": (
            "rudder_area", "rudder_aspect", "rudder_limit", "rudder_rate", "slipstream", "straightening", "Ydelta",
        ),
        "propulsion": ("speed", "resistance"),
    }  # fmt: skip
    """Where the keys stand in a vehicle file; those that are no fields of this class go to ``given``."""

    @cached_property
    def block_coefficient(self) -> float:
        """C_B that displaces the mass (the corvette's: 0.452; printed 0.65)."""
        return self.mass / (self.water_density * self.length * self.beam * self.draught)

    @cached_property
    def clarke(self) -> dict[str, float]:
        """Non-dimensional (prime I) derivatives by Clarke et al. (1983), with m', I'z and the rudder's."""
        L, B, T, Cb = self.length, self.beam, self.draught, self.block_coefficient
        slender = np.pi * (T / L) ** 2
        mass = self.mass / (0.5 * self.water_density * L**3)
        rudder = 0.5 * np.pi * (self.rudder_area or 0.0) / L**2
        return {
            "Yvdot": -slender * (1 + 0.16 * Cb * B / T - 5.1 * (B / L) ** 2),
            "Yrdot": -slender * (0.67 * B / L - 0.0033 * (B / T) ** 2),
            "Nvdot": -slender * (1.1 * B / L - 0.041 * B / T),
            "Nrdot": -slender * (1 / 12 + 0.017 * Cb * B / T - 0.33 * B / L),
            "Yv": -slender * (1 + 0.40 * Cb * B / T),
            "Yr": -slender * (-1 / 2 + 2.2 * B / L - 0.080 * B / T),
            "Nv": -slender * (1 / 2 + 2.4 * T / L),
            "Nr": -slender * (1 / 4 + 0.039 * B / T - 0.56 * B / L),
            "m": mass,
            "Iz": mass * self.yaw_radius**2 + mass * (self.x_g / L) ** 2,
            "Ydelta": -rudder,
            "Ndelta": 0.5 * rudder,
        }

    @cached_property
    def stability(self) -> float:
        """Of the straight course, Yv' (Nr' - m' x_g') - Nv' (Yr' - m') with the rudder at rest: positive if it is.

        The criterion of Davidson & Schiff (1946). An unstable ship turns at small helm to either side.
        """
        c, at = self.clarke | dict(self.given), dict(zip(COEFFICIENTS, self.vector(), strict=True))
        force = at["rudder"] * self.slipstream * self.straightening / (0.5 * self.water_density * self.length**2)
        Yv, Yr, Nv, Nr = c["Yv"] - force, c["Yr"] + 0.5 * force, c["Nv"] + 0.5 * force, c["Nr"] - 0.25 * force
        return float(Yv * (Nr - c["m"] * self.x_g / self.length) - Nv * (Yr - c["m"]))

    def vector(self) -> np.ndarray:
        """The coefficients of the compiled equations, dimensional, in the order of `COEFFICIENTS`."""
        given, L, rho = dict(self.given), self.length, self.water_density
        c = self.clarke | given
        volume = self.mass / rho
        surge_added = 2.7 * rho * volume ** (5 / 3) / L**2  # Soding (1982)
        q = 0.5 * rho
        lift_slope = 6.13 * self.rudder_aspect / (self.rudder_aspect + 2.25)  # Fujii & Tuda (1961)
        drag = self.drag_coefficient
        if drag is None:
            drag = float(np.interp(0.5 * self.beam / self.draught, *_CROSS_FLOW))
        rudder = q * (self.rudder_area or 0.0) * lift_slope
        values = {
            "mass": self.mass,
            "mass_x_g": self.mass * self.x_g,
            "surge_inertia": self.mass + (-q * L**3 * given["Xudot"] if "Xudot" in given else surge_added),
            "sway_inertia": self.mass - q * L**3 * c["Yvdot"],
            "sway_yaw_inertia": self.mass * self.x_g - q * L**4 * c["Yrdot"],
            "yaw_sway_inertia": self.mass * self.x_g - q * L**4 * c["Nvdot"],
            "yaw_inertia": q * L**5 * (c["Iz"] - c["Nrdot"]),
            "Yv": q * L**2 * c["Yv"],
            "Yr": q * L**3 * c["Yr"],
            "Nv": q * L**3 * c["Nv"],
            "Nr": q * L**4 * c["Nr"],
            "cross_flow": q * self.draught * drag,
            "resistance": self.resistance / self.speed**2,
            "thrust": self.resistance,
            "rudder": -q * L**2 * given["Ydelta"] / self.slipstream**2 if "Ydelta" in given else rudder,
            "slipstream": self.slipstream,
            "straightening": self.straightening,
            "half_length": 0.5 * L,
        }
        return np.array([values[name] for name in COEFFICIENTS])

    def mistakes(self) -> Iterator[tuple[str, str]]:
        """What no ship can be: the name of a number, and a sentence on it."""
        L, B, T = self.length, self.beam, self.draught
        if B >= L:
            yield "beam", f"a ship of {L:g} m is not {B:g} m wide"
        if T >= B:
            yield "draught", f"a ship {B:g} m wide is not {T:g} m deep in the water"
        if not 0.1 < self.block_coefficient < 1.0:
            box = self.mass / self.block_coefficient
            yield "mass", f"{self.mass:g} kg are no mass of a hull in a box that displaces {box:.4g} kg"
        if abs(self.x_g) > 0.5 * L:
            yield "x_g", f"a centre of gravity {self.x_g:g} m from amidships is not in a ship of {L:g} m"
        if self.rudder_area is None and "Ydelta" not in dict(self.given):
            yield "rudder", "the rudder needs 'rudder_area', or 'Ydelta' as measured"
        if self.rudder_area is not None and self.rudder_area >= L * T:
            yield "rudder_area", f"a rudder of {self.rudder_area:g} m2 is as large as the hull's profile"
        m = dict(zip(COEFFICIENTS, self.vector(), strict=True))
        if min(
            m["surge_inertia"], m["sway_inertia"], m["yaw_inertia"],
            m["sway_inertia"] * m["yaw_inertia"] - m["sway_yaw_inertia"] * m["yaw_sway_inertia"],
        ) <= 0.0:  # fmt: skip
            yield "derivatives", "the added masses leave an inertia that is not positive"


COEFFICIENTS = (
    "mass", "mass_x_g", "surge_inertia", "sway_inertia", "sway_yaw_inertia", "yaw_sway_inertia", "yaw_inertia",
    "Yv", "Yr", "Nv", "Nr", "cross_flow", "resistance", "thrust", "rudder", "slipstream", "straightening",
    "half_length",
)  # fmt: skip
UNCERTAIN = tuple(
    COEFFICIENTS.index(name)
    for name in ("Yv", "Yr", "Nv", "Nr", "cross_flow", "resistance", "rudder", "straightening", "sway_inertia",
                 "yaw_inertia")
)  # fmt: skip
"""The coefficients that `mismatch` perturbs: hydrodynamics and inertia, not geometry."""


@njit(cache=True)
def _cross_flow(v: float, r: float, a: float) -> tuple[float, float]:
    """Integrals of |v + x r| (v + x r) {1, x} over -a <= x <= a, in closed form."""
    if abs(r) * a <= abs(v):  # the flow has one sign along the hull
        sign = 1.0 if v >= 0.0 else -1.0
        return sign * (2.0 * a * v * v + 2.0 / 3.0 * a**3 * r * r), sign * 4.0 / 3.0 * a**3 * v * r
    if abs(r) * a < 1e-12:  # nothing moves, and r * r would underflow
        return 0.0, 0.0
    bow, stern = v + a * r, v - a * r
    cubic = (abs(bow) ** 3 - abs(stern) ** 3) / 3.0
    quartic = (bow * abs(bow) ** 3 - stern * abs(stern) ** 3) / 4.0
    return cubic / r, (quartic - v * cubic) / (r * r)


@njit(cache=True)
def _rudder_inflow(
    u: float, v: float, r: float, rudder: float, slipstream: float, straightening: float, half_length: float
) -> tuple[float, float]:
    """Angle of attack and squared inflow speed: drift and yaw rate in a turn reduce the former."""
    inflow = slipstream * u
    side = straightening * (v - half_length * r)
    return rudder + np.arctan2(side, inflow), inflow * inflow + side * side


@njit(cache=True)
def _accelerations(u: float, v: float, r: float, rudder: float, c: np.ndarray) -> tuple[float, float, float]:
    """Surge, sway and yaw accelerations (3-DOF, added mass on the left)."""
    mass, mass_x_g, m_uu, m_vv, m_vr, m_rv, m_rr = c[0], c[1], c[2], c[3], c[4], c[5], c[6]
    Yv, Yr, Nv, Nr, cross, drag, thrust = c[7], c[8], c[9], c[10], c[11], c[12], c[13]
    lift, slip, straight, a = c[14], c[15], c[16], c[17]
    sway_drag, yaw_drag = _cross_flow(v, r, a)
    attack, inflow2 = _rudder_inflow(u, v, r, rudder, slip, straight, a)
    force = lift * inflow2 * np.sin(attack)
    # Surge: the sway added mass takes part in the centripetal term (Kirchhoff), which slows the ship in a turn.
    X = thrust - drag * u * abs(u) + m_vv * v * r + m_vr * r * r - force * np.sin(rudder)
    Y = u * (Yv * v + Yr * r) - mass * u * r - cross * sway_drag - force * np.cos(rudder)
    N = u * (Nv * v + Nr * r) - mass_x_g * u * r - cross * yaw_drag + a * force * np.cos(rudder)
    determinant = m_vv * m_rr - m_vr * m_rv
    return X / m_uu, (m_rr * Y - m_vr * N) / determinant, (m_vv * N - m_rv * Y) / determinant


@njit(cache=True)
def _derivative(
    s: np.ndarray | tuple[float, ...], rudder: float, north: float, east: float, c: np.ndarray
) -> tuple[float, float, float, float, float, float]:
    psi, u, v, r = s[2], s[3], s[4], s[5]
    du, dv, dr = _accelerations(u, v, r, rudder, c)
    cos, sin = np.cos(psi), np.sin(psi)
    return u * cos - v * sin + north, u * sin + v * cos + east, r, du, dv, dr


@gufunc("void(float64[:], float64[:], float64[:], float64[:])", "(n),(m),(p)->(n)")
def corvette_derivative(state: np.ndarray, control: np.ndarray, c: np.ndarray, out: np.ndarray) -> None:
    """Time derivative of the truth state; control is (rudder, current north, current east)."""
    out[0], out[1], out[2], out[3], out[4], out[5] = _derivative(state, control[0], control[1], control[2], c)


@gufunc("void(float64[:], float64[:], float64[:], float64, int64, float64[:])", "(n),(m),(p),(),()->(n)")
def corvette_step(
    state: np.ndarray, control: np.ndarray, c: np.ndarray, dt: float, substeps: int, out: np.ndarray
) -> None:
    """RK4 over ``dt``; control is (rudder at the start, rudder at the end, current north, current east).

    The rudder moves linearly within the step, so that its rate limit is integrated exactly.
    """
    start, end, north, east = control[0], control[1], control[2], control[3]
    h = dt / substeps
    slope = (end - start) / dt
    x0, x1, x2, x3, x4, x5 = state[0], state[1], state[2], state[3], state[4], state[5]
    for i in range(substeps):
        d0 = start + slope * (i * h)
        d1, d2 = d0 + 0.5 * slope * h, d0 + slope * h
        a = _derivative((x0, x1, x2, x3, x4, x5), d0, north, east, c)
        k = 0.5 * h
        s = (x0 + k * a[0], x1 + k * a[1], x2 + k * a[2], x3 + k * a[3], x4 + k * a[4], x5 + k * a[5])
        b = _derivative(s, d1, north, east, c)
        s = (x0 + k * b[0], x1 + k * b[1], x2 + k * b[2], x3 + k * b[3], x4 + k * b[4], x5 + k * b[5])
        e = _derivative(s, d1, north, east, c)
        s = (x0 + h * e[0], x1 + h * e[1], x2 + h * e[2], x3 + h * e[3], x4 + h * e[4], x5 + h * e[5])
        f = _derivative(s, d2, north, east, c)
        w = h / 6.0
        x0 += w * (a[0] + 2.0 * b[0] + 2.0 * e[0] + f[0])
        x1 += w * (a[1] + 2.0 * b[1] + 2.0 * e[1] + f[1])
        x2 += w * (a[2] + 2.0 * b[2] + 2.0 * e[2] + f[2])
        x3 += w * (a[3] + 2.0 * b[3] + 2.0 * e[3] + f[3])
        x4 += w * (a[4] + 2.0 * b[4] + 2.0 * e[4] + f[4])
        x5 += w * (a[5] + 2.0 * b[5] + 2.0 * e[5] + f[5])
    out[0], out[1], out[2], out[3], out[4], out[5] = x0, x1, x2, x3, x4, x5


def rudder_angle_of_attack(
    u: np.ndarray, v: np.ndarray, r: np.ndarray, rudder: np.ndarray, ship: CorvetteParameters
) -> np.ndarray:
    """Angle of attack [rad] of the rudder for surge ``u``, sway ``v`` [m/s] and yaw rate ``r`` [rad/s]."""
    side = ship.straightening * (v - 0.5 * ship.length * r)
    return rudder + np.arctan2(side, ship.slipstream * u)


# --- equilibria and linear models -------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class SteadyTurn:
    """Steady turns at rising yaw rates: what helm, speed and drift hold them, shape ``(k,)`` each."""

    yaw_rate: np.ndarray  # rad/s
    speed: np.ndarray  # surge, m/s
    sway: np.ndarray  # m/s
    rudder: np.ndarray  # rad
    radius: np.ndarray  # m, of the track; infinite for the straight course


@cache
def steady_turns(ship: CorvetteParameters, points: int = 165) -> SteadyTurn:
    """Steady turns at equal steps of yaw rate, up to the one that 80 % of the rudder holds.

    Beyond, the yaw rate hardly rises with the rudder any more, and a command there could not be steered to.

    Raises:
        RuntimeError: if the ship has no steady turns (it is directionally unstable).
    """
    c, scale = ship.vector(), np.array([ship.speed, ship.speed, ship.speed / ship.length])

    def accelerations(motion: np.ndarray, rudder: float) -> np.ndarray:
        state = np.concatenate([np.zeros(3), motion])
        return corvette_derivative(state, np.array([rudder, 0.0, 0.0]), c)[3:] / scale

    def held_rudder(z: np.ndarray, rudder: float) -> np.ndarray:
        return accelerations(z * scale, rudder)

    def held_rate(z: np.ndarray, rate: float) -> np.ndarray:
        return accelerations(np.array([z[0] * scale[0], z[1] * scale[1], rate]), z[2])

    def solve(residual: Callable[[np.ndarray], np.ndarray], guess: np.ndarray) -> np.ndarray:
        found = root(residual, guess, tol=1e-13)
        if np.abs(found.fun).max() > 1e-9:
            raise RuntimeError("the ship has no steady turn at a rudder that it should hold")
        return found.x

    motion = np.array([1.0, 0.0, 0.0])  # surge, sway, yaw rate in units of scale
    for rudder in np.linspace(0.0, 0.8 * ship.rudder_limit, 57):
        motion = solve(partial(held_rudder, rudder=rudder), motion)
    rates = np.linspace(0.0, motion[2] * scale[2], points)
    solutions = np.empty((points, 3))  # surge, sway, rudder
    guess = np.array([1.0, 0.0, 0.0])
    for i, rate in enumerate(rates):
        guess = solve(partial(held_rate, rate=rate), guess)
        solutions[i] = guess * [scale[0], scale[1], 1.0]
    speed, sway, rudder = solutions.T
    with np.errstate(divide="ignore"):
        radius = np.hypot(speed, sway) / rates
    return SteadyTurn(rates, speed, sway, rudder, radius)


def sway_yaw_jacobian(state: np.ndarray, rudder: np.ndarray, ship: CorvetteParameters) -> tuple[np.ndarray, np.ndarray]:
    """d(v', r')/d(v, r) ``(..., 2, 2)`` and d(v', r')/d(rudder) ``(..., 2, 1)`` at ``(u, v, r)``.

    Central differences of the compiled equations: the linear models cannot drift away from the truth.
    """
    c = ship.vector()
    state, rudder = np.asarray(state, float), np.asarray(rudder, float)
    points = np.concatenate([state, rudder[..., None]], -1)  # (u, v, r, rudder)
    step = np.array([1e-6, 1e-8, 1e-6])
    offsets = np.zeros((3, 4))
    offsets[[0, 1, 2], [1, 2, 3]] = step

    def rates(p: np.ndarray) -> np.ndarray:
        full = np.zeros(p.shape[:-1] + (6,))
        full[..., 3:] = p[..., :3]
        control = np.zeros(p.shape[:-1] + (3,))
        control[..., 0] = p[..., 3]
        return corvette_derivative(full, control, c)[..., 4:]

    difference = rates(points[..., None, :] + offsets) - rates(points[..., None, :] - offsets)
    jacobian = np.swapaxes(difference / (2.0 * step[:, None]), -1, -2)
    return jacobian[..., :2], jacobian[..., 2:]


@cache
def secant_models(ship: CorvetteParameters, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Discrete ``A (k, 3, 3)`` and ``B (k, 3, 1)`` of (v, r, psi) for each of `steady_turns`.

    The linear model at the service speed is badly wrong in a hard turn, where the ship has lost a third of
    its speed and most of the hull force is cross-flow drag. The secant model is the mean Jacobian
    on the ray from zero to the commanded turn's equilibrium, at that turn's speed (8-point
    Gauss-Legendre): it is exact at both ends.
    """
    turns = steady_turns(ship)
    nodes, weights = np.polynomial.legendre.leggauss(8)
    A = np.zeros((len(turns.yaw_rate), 3, 3))
    B = np.zeros((len(turns.yaw_rate), 3, 1))
    for node, weight in zip(0.5 * (nodes + 1.0), 0.5 * weights, strict=True):
        state = np.stack([turns.speed, node * turns.sway, node * turns.yaw_rate], -1)
        a, b = sway_yaw_jacobian(state, node * turns.rudder, ship)
        A[:, :2, :2] += weight * a
        B[:, :2] += weight * b
    A[:, 2, 1] = 1.0
    return zero_order_hold(A, B, dt)


def linear_model(
    ship: CorvetteParameters, dt: float, Q: np.ndarray, R: np.ndarray, kind: str = "corrected"
) -> LinearModel:
    """The model that the linear filters use: x = (v, r, psi), y = (compass, wave-band yaw increment).

    ``psi+ = psi + dt r + d + w``, ``y1 = psi + d + v1``, ``y2 = d + v2``: d is what waves and gusts do to
    the heading in one step, and a motion reference unit gives it in its own noise (eq. 4.5).

    The known input is ``u = (rudder, commanded yaw rate)``; A and B follow the commanded turn by
    `secant_models`.

    Args:
        ship: Parameters.
        dt: Step [s].
        Q: ``(3, 3)`` process noise covariance.
        R: ``(2, 2)`` measurement noise covariance.
        kind: ``"corrected"``, or ``"as-printed"`` for eq. 4.3 of the thesis to the digit, kept for
            reproduction: it is neither the ship's nor dimensionally consistent.
    """
    C = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    G = np.array([[0.0], [0.0], [1.0]])
    H = np.array([[1.0], [1.0]])
    angles = {"state_angles": (2,), "measurement_angles": (0,)}
    if kind == "as-printed":
        A = np.array([[0.4159, 0.1811, 0.0], [5.4795e-10, 1.0, 0.0], [0.0, 0.5, 1.0]])
        B = np.array([[-2.6189e-7, 0.0], [2.4075e-7, 0.0], [0.0, 0.0]])
        return LinearModel(A, C, Q, R, B=B, G=G, H=H, **angles)
    if kind != "corrected":
        raise ValueError(
            f"unknown filter model {shown(kind)}: choose corrected or as-printed, or nonlinear for a nonlinear filter"
        )
    A_table, B_table = secant_models(ship, dt)
    A_table = np.concatenate([A_table[:0:-1], A_table])  # the same turn to port
    B_table = np.concatenate([B_table[:0:-1], B_table])
    B_table = np.concatenate([B_table, np.zeros_like(B_table)], -1)
    middle, scale = len(A_table) // 2 + 0.5, 1.0 / steady_turns(ship).yaw_rate[1]

    def follow(table: np.ndarray) -> Callable[[np.ndarray | None], np.ndarray]:
        def matrix(u: np.ndarray | None) -> np.ndarray:
            if u is None:
                raise ValueError("the corrected model needs u = (rudder, commanded yaw rate)")
            return table.take((u[..., 1] * scale + middle).astype(np.intp), axis=0, mode="clip")

        return matrix

    return LinearModel(follow(A_table), C, Q, R, B=follow(B_table), G=G, H=H, **angles)


def nonlinear_model(ship: CorvetteParameters, dt: float, Q: np.ndarray, R: np.ndarray) -> NonlinearModel:
    """The ship's own equations for nonlinear filters: x = (v, r, psi, u), otherwise as `linear_model`.

    Args:
        ship: Parameters.
        dt: Step [s].
        Q: ``(4, 4)`` process noise covariance.
        R: ``(2, 2)`` measurement noise covariance.
    """
    c = ship.vector()

    def transition(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        assert u is not None
        state = np.zeros(x.shape[:-1] + (6,))
        state[..., 2], state[..., 3], state[..., 4], state[..., 5] = x[..., 2], x[..., 3], x[..., 0], x[..., 1]
        control = np.zeros(u.shape[:-1] + (4,))
        control[..., :2] = u[..., :1]
        after = corvette_step(state, control, c, dt, 1)
        return after[..., [4, 5, 2, 3]]

    def measurement(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        reading = np.zeros(x.shape[:-1] + (2,))
        reading[..., 0] = x[..., 2]
        return reading

    G = np.array([[0.0], [0.0], [1.0], [0.0]])
    H = np.array([[1.0], [1.0]])
    return NonlinearModel(transition, measurement, Q, R, G=G, H=H, state_angles=(2,), measurement_angles=(0,))


# --- the vehicle as an environment uses it ----------------------------------------------------------


@dataclass(frozen=True)
class Corvette:
    """The ship in batches: actuator, truth, exact readings, filter models.

    The action is the rudder *rate*: with an angle as action, the estimate's noise would saturate
    the steering gear.
    """

    ship: CorvetteParameters = field(default_factory=lambda: load("corvette", CorvetteParameters))
    dt: float = 0.5  # s
    substeps: int = 1  # one RK4 step of 0.5 s is converged to 0.002 %

    truth_names = TRUTH
    parameter_names = COEFFICIENTS
    action_names = ("rudder rate",)
    instruments = (
        Instrument("gyro compass", ("heading [rad]",), (2e-3,)),  # 0.11 deg
        Instrument("motion reference unit", ("wave-band yaw increment [rad]",), (1e-3,)),  # 0.06 deg
    )
    unknown_inputs = 1
    process_sd = np.array([0.08, 1.5e-3, 1e-4, 0.05])  # of (v, r, psi, u) a step: what the models leave out
    normals = len(UNCERTAIN)
    """Normal numbers that `parameters` needs."""

    def parameters(self, mismatch: float, normals: np.ndarray) -> np.ndarray:
        """Coefficients ``(B, k)`` of the truth: the filter's, with a relative spread on the uncertain ones."""
        c = np.tile(self.ship.vector(), (len(normals), 1))
        c[:, UNCERTAIN] *= 1.0 + mismatch * np.clip(normals, -2.0, 2.0)
        return c

    def start(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Truth ``(B, 6)`` and actuators ``(B, 1)`` from (v, r, psi, u)."""
        truth = np.zeros((len(x), 6))
        truth[:, [4, 5, 2, 3]] = x
        return truth, np.zeros((len(x), 1))

    def filter_state(self, truth: np.ndarray, n: int = 4) -> np.ndarray:
        """The part of the truth that filters estimate: (v, r, psi) and, for n = 4, u."""
        return truth[..., [4, 5, 2, 3][:n]]

    def actuate(self, actuators: np.ndarray, action: np.ndarray) -> np.ndarray:
        """The rudder ``(B, 1)`` after a step of rudder rate ``action`` in [-1, 1]."""
        limit = self.ship.rudder_limit
        return np.minimum(np.maximum(actuators + (self.ship.rudder_rate * self.dt) * action, -limit), limit)

    def step(
        self,
        truth: np.ndarray,
        before: np.ndarray,
        after: np.ndarray,
        forcing: np.ndarray,
        parameters: np.ndarray,
    ) -> np.ndarray:
        """The truth one step later; forcing is (yaw kick d of waves and gusts, current north, current east)."""
        control = np.concatenate([before, after, forcing[:, 1:]], -1)
        truth = corvette_step(truth, control, parameters, self.dt, self.substeps)
        truth[:, 2] += forcing[:, 0]
        return truth

    def readings(self, truth: np.ndarray, forcing: np.ndarray) -> np.ndarray:
        """What perfect sensors would read ``(B, 2)``: compass and yaw increment (eq. 4.5)."""
        exact = np.empty((len(truth), 2))
        exact[:, 0] = truth[:, 2] + forcing[:, 0]
        exact[:, 1] = forcing[:, 0]
        return exact

    def model(self, kind: str, noise: float, sea: Sea) -> LinearModel | NonlinearModel:
        """The filter's model: ``"corrected"``, ``"as-printed"`` or ``"nonlinear"``.

        Args:
            kind: which one.
            noise: standard deviation of the readings relative to nominal.
            sea: not used: what a filter knows of d is an option of its own.
        """
        R = np.diag((noise * nominal_sd(self.instruments)) ** 2)
        Q = np.diag(self.process_sd**2)
        if kind == "nonlinear":
            return nonlinear_model(self.ship, self.dt, Q, R)
        return linear_model(self.ship, self.dt, Q[:3, :3], R, kind)

    def from_readings(
        self, readings: np.ndarray, previous: np.ndarray, interval: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """(v, r, psi) and d from two successive sets of readings: no model, the compass differenced.

        Args:
            readings: ``(..., 2)``.
            previous: ``(..., 2)`` the readings before.
            interval: ``(..., 2)`` seconds between the two.
        """
        change = wrap(readings[..., 0] - previous[..., 0])
        x = np.zeros(readings.shape[:-1] + (3,))
        x[..., 1] = change / interval[..., 0]
        x[..., 2] = readings[..., 0]
        return x, readings[..., 1:2]
