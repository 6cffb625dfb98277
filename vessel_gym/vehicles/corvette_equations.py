"""Ships in surge, sway, yaw and roll: particulars and equations of motion.

Frames: north-east-down; body x forward, y starboard, origin amidships. Positive rudder turns the
ship to starboard (yaw rate r > 0), as in the thesis' figures. Davidson and Schiff use the opposite
sign, so Y'delta and N'delta change sign together. Positive roll is starboard down.

Sources: Hermawan (2020), the thesis of the task, for the corvette's particulars; Clarke, Gedling &
Hine (1983) for linear derivatives (eqs. 2.19 and 2.23 of the thesis misprint two of them); Fossen
(2011) for the structure; Fujii & Tuda (1961) for the rudder; Hoerner (1965) for cross-flow drag;
Yasukawa & Yoshimura (2015) for the propellers' effect on the rudder; Blanke & Christensen (1993),
in Perez (2005), for roll, which follows sway and yaw without an effect on them; Norrbin (1972), "On
the added resistance due to steering on a straight course", for the cost of steering.
"""

from collections import namedtuple
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from estimators.engine import compiled, linearise, sincos
from vessel_gym.vehicles.files import Particulars
from vessel_gym.vehicles.vehicle import GRAVITY

STATE = ("x", "y", "psi", "u", "v", "r", "phi", "p")
"""Components of the state.

They are position north, east [m], heading [rad], surge, sway through the water [m/s], yaw rate
[rad/s], roll [rad] and roll rate [rad/s].
"""
AROUND = (
    "current north", "current east", "surge force", "sway force", "yaw moment", "roll moment",
    "wave sway",
)  # fmt: skip
"""Flow and loads around a ship.

They are a current [m/s], external forces [N] and moments [N m] in the ship's frame, and the sway
velocity [m/s] of waves, which only carries it sideways.
"""

Coefficients = namedtuple("Coefficients", (
    "mass", "mass_x_g", "surge_inertia", "sway_inertia", "sway_yaw_inertia", "yaw_sway_inertia",
    "yaw_inertia", "Yv", "Yr", "Nv", "Nr", "cross_flow", "resistance", "thrust", "thrust_rise",
    "service_speed", "rudder", "slipstream", "race", "race_power", "straightening", "half_length",
    "roll_inertia", "righting", "roll_damping", "roll_damping_speed", "hull_arm", "rudder_arm",
))  # fmt: skip
"""Coefficients of the equations of motion, in the order of their vector."""

COEFFICIENTS = Coefficients._fields
UNCERTAIN = [COEFFICIENTS.index(name) for name in (
    "Yv", "Yr", "Nv", "Nr", "cross_flow", "resistance", "rudder", "straightening", "sway_inertia",
    "yaw_inertia",
)]  # fmt: skip
"""Indices of the coefficients that `mismatch` perturbs: hydrodynamics and inertia, not geometry."""
_CROSS_FLOW = np.array([
    [0.0109, 0.177, 0.353, 0.452, 0.473, 0.493, 0.558, 0.646,
     0.834, 0.988, 1.308, 1.639, 1.860, 2.313, 2.600, 3.009],
    [1.966, 1.966, 1.898, 1.787, 1.584, 1.245, 1.084, 0.999,
     0.880, 0.828, 0.760, 0.691, 0.657, 0.631, 0.596, 0.587],
])  # fmt: skip
"""Hoerner's curve of cross-flow drag over beam / (2 draught).

As read by Leite, Aranha, Umeda & Conti (1998).
"""


@dataclass(frozen=True)
class CorvetteParameters(Particulars):
    """Particulars of a ship in SI units: the content of a vehicle file.

    A file states a source for each number, and may leave out numbers with a default. ``given``
    holds measured or computed derivatives by name (see ``GIVEN``), which replace estimates. They
    are non-dimensional as Clarke's (prime I: divided by ``rho / 2`` and powers of L and U), and
    exclude the ship's own mass (Yr, not Yr - m). Rudder to starboard is positive.
    """

    length: float  # m, between perpendiculars
    beam: float  # m
    draught: float  # m
    mass: float  # kg
    speed: float  # m/s, service speed U
    resistance: float  # N at U, grows with the square of the speed
    rudder_area: float = 0.0  # m2, of all rudders; 0: Ydelta is given
    x_g: float = 0.0  # m, centre of gravity forward of amidships
    water_density: float = 1025.0  # kg/m3, sea water; Fossen (2011)
    yaw_radius: float = 0.25  # gyration radius / L; Fossen (2011), sec. 3.3
    drag_coefficient: float | None = None  # cross-flow drag; None: by Hoerner's curve
    rudder_aspect: float = 1.5  # effective aspect ratio, assumed
    rudder_limit: float = float(np.deg2rad(35.0))  # rad, usual; as in the trials of MSC.137(76)
    rudder_rate: float = float(np.deg2rad(65.0 / 28.0))  # rad/s, the least; SOLAS II-1/29
    slipstream: float = 1.1  # inflow speed at the rudder / u, assumed
    straightening: float = 0.4  # share of the drift that the rudder sees; Yasukawa & Yoshimura
    thrust_coefficient: float = 0.0  # K_T at rest; 0: constant thrust and slipstream
    thrust_slope: float = 0.0  # by which K_T falls with J
    advance_ratio: float = 0.0  # J at service speed
    race: float = 0.47  # share of the race that the rudder is in; Yasukawa & Yoshimura (2015)
    metacentric_height: float | None = None  # GM, m; None: 8 % of the beam, assumed
    roll_period: float | None = None  # s; None: by GM, IMO's intact stability code, A.749(18)
    gravity_height: float | None = None  # KG, m; None: 1.5 draughts, assumed
    frontal_area: float | None = None  # m2 above the water; None: 0.82 B^2, as the corvette's
    lateral_area: float | None = None  # m2 above the water; None: 0.083 L^2, as the corvette's
    given: tuple[tuple[str, float], ...] = ()  # derivatives by name

    GIVEN = (
        "Xudot", "Yvdot", "Yrdot", "Nvdot", "Nrdot", "Yv", "Yr", "Nv", "Nr", "Ydelta",
    )  # fmt: skip

    @cached_property
    def block_coefficient(self) -> float:
        """Block coefficient C_B from the mass (the corvette's: 0.452; printed 0.65)."""
        return self.mass / (self.water_density * self.length * self.beam * self.draught)

    @cached_property
    def clarke(self) -> dict[str, float]:
        """Derivatives by Clarke et al. (1983), m', I'z and the rudder's, in the prime I system."""
        L, B, T, Cb = self.length, self.beam, self.draught, self.block_coefficient
        slender = np.pi * (T / L) ** 2
        mass = self.mass / (0.5 * self.water_density * L**3)
        rudder = 0.5 * np.pi * self.rudder_area / L**2
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
    def stiffness(self) -> float:
        """Metacentric height GM [m]."""
        return self.metacentric_height or 0.08 * self.beam

    @cached_property
    def period_of_roll(self) -> float:
        """Natural period of roll [s]."""
        radius = 0.373 + 0.023 * self.beam / self.draught - 0.043 * self.length / 100.0
        return self.roll_period or 2.0 * radius * self.beam / np.sqrt(self.stiffness)

    @cached_property
    def _propellers(self) -> tuple[float, float]:
        """Rise of the thrust as the ship slows down, and power of the race; 0: constant thrust."""
        if not self.thrust_coefficient:
            return 0.0, 0.0
        fall = self.thrust_slope * self.advance_ratio
        at_speed = self.thrust_coefficient - fall
        return fall / at_speed, 8.0 / np.pi * at_speed * (self.speed / self.advance_ratio) ** 2

    @cached_property
    def _roll(self) -> dict[str, float]:
        """Coefficients of roll by name; damping by Perez (2005)."""
        righting = self.mass * GRAVITY * self.stiffness
        natural = 2.0 * np.pi / self.period_of_roll
        inertia = righting / natural**2
        damping = 2.0 * natural * inertia
        height = self.gravity_height or 1.5 * self.draught
        return {
            "roll_inertia": inertia,
            "righting": righting,
            "roll_damping": damping * 0.071,
            "roll_damping_speed": damping * (0.051 / np.sqrt(GRAVITY * self.length)),
            # arms of hull and rudders below the centre of gravity
            "hull_arm": height - 0.5 * self.draught,
            "rudder_arm": height - 0.34 * self.draught,
        }

    def values(self) -> Coefficients:
        """Dimensional coefficients of the equations of motion."""
        given, L, rho = dict(self.given), self.length, self.water_density
        c, q, drag = self.clarke | given, 0.5 * rho, self.drag_coefficient
        surge_added = 2.7 * rho * (self.mass / rho) ** (5 / 3) / L**2  # Soding (1982)
        if "Xudot" in given:
            surge_added = -q * L**3 * given["Xudot"]
        if drag is None:
            drag = float(np.interp(0.5 * self.beam / self.draught, *_CROSS_FLOW))
        lift_slope = 6.13 * self.rudder_aspect / (self.rudder_aspect + 2.25)  # Fujii & Tuda (1961)
        rudder = q * self.rudder_area * lift_slope
        if "Ydelta" in given:
            rudder = -q * L**2 * given["Ydelta"] / self.slipstream**2
        rise, race_power = self._propellers
        return Coefficients(
            mass=self.mass,
            mass_x_g=self.mass * self.x_g,
            surge_inertia=self.mass + surge_added,
            sway_inertia=self.mass - q * L**3 * c["Yvdot"],
            sway_yaw_inertia=self.mass * self.x_g - q * L**4 * c["Yrdot"],
            yaw_sway_inertia=self.mass * self.x_g - q * L**4 * c["Nvdot"],
            yaw_inertia=q * L**5 * (c["Iz"] - c["Nrdot"]),
            Yv=q * L**2 * c["Yv"],
            Yr=q * L**3 * c["Yr"],
            Nv=q * L**3 * c["Nv"],
            Nr=q * L**4 * c["Nr"],
            cross_flow=q * self.draught * drag,
            resistance=self.resistance / self.speed**2,
            thrust=self.resistance,
            thrust_rise=rise,
            service_speed=self.speed,
            rudder=rudder,
            slipstream=1.0 if rise else self.slipstream,
            race=self.race if rise else 0.0,
            race_power=race_power,
            straightening=self.straightening,
            half_length=0.5 * L,
            **self._roll,
        )

    def vector(self) -> np.ndarray:
        """Dimensional coefficients of the equations of motion, in the order of `COEFFICIENTS`."""
        return np.array(self.values())

    def accelerations(self, moving: np.ndarray) -> np.ndarray:
        """Accelerations ``(..., 3)`` of an upright ship without current and external loads.

        They are those of surge, sway [m/s2] and yaw [rad/s2].

        Args:
            moving: Surge, sway [m/s], yaw rate [rad/s] and rudder [rad] ``(..., 4)``.
        """
        return _accelerations(moving, self.vector())

    def jacobian(self, moving: np.ndarray) -> np.ndarray:
        """Exact derivatives ``(..., 3, 4)`` of `accelerations` by ``moving (..., 4)``."""
        return _jacobian(moving, self.vector())

    def mistakes(self) -> Iterator[tuple[str, str]]:
        """Errors in the particulars: the name of a number, and a sentence."""
        L, B, T = self.length, self.beam, self.draught
        if B >= L:
            yield "beam", f"a ship of {L:g} m is not {B:g} m wide"
        if T >= B:
            yield "draught", f"a ship {B:g} m wide is not {T:g} m deep in the water"
        if not 0.1 < self.block_coefficient < 1.0:
            box = self.mass / self.block_coefficient
            yield (
                "mass",
                f"{self.mass:g} kg are no mass of a hull in a box that displaces {box:.4g} kg",
            )
        if abs(self.x_g) > 0.5 * L:
            yield (
                "x_g",
                f"a centre of gravity {self.x_g:g} m from amidships is not in a ship of {L:g} m",
            )
        if not self.rudder_area and "Ydelta" not in dict(self.given):
            yield "rudder", "the rudder needs 'rudder_area', or 'Ydelta' as measured"
        if self.rudder_area >= L * T:
            yield (
                "rudder_area",
                f"a rudder of {self.rudder_area:g} m2 is as large as the hull's profile",
            )
        propellers = self.thrust_coefficient, self.thrust_slope, self.advance_ratio
        if any(propellers) and not all(propellers):
            wanted = "'thrust_coefficient', 'thrust_slope', 'advance_ratio'"
            yield "propulsion", f"propellers need {wanted}, or none"
            return
        if any(propellers) and propellers[0] <= propellers[1] * propellers[2]:
            yield "thrust_coefficient", "propellers of this slope give no thrust at this J"
            return
        m = self.values()
        if min(
            m.surge_inertia, m.sway_inertia, m.yaw_inertia,
            m.sway_inertia * m.yaw_inertia - m.sway_yaw_inertia * m.yaw_sway_inertia,
        ) <= 0.0:  # fmt: skip
            yield "derivatives", "the added masses leave an inertia that is not positive"


def _cross_flow(v: np.ndarray, r: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Integrals of |v + x r| (v + x r) {1, x} over -a <= x <= a, in closed form."""
    cubed = a * a * a
    sign = np.where(v >= 0.0, 1.0, -1.0)  # if the flow has one sign along the hull
    sway = sign * (2.0 * a * v * v + 2.0 / 3.0 * cubed * r * r)
    yaw = sign * (4.0 / 3.0 * cubed * v * r)
    bow, stern = v + a * r, v - a * r
    bow_cubed, stern_cubed = np.abs(bow) * (bow * bow), np.abs(stern) * (stern * stern)
    cubic = 1.0 / 3.0 * (bow_cubed - stern_cubed)
    quartic = 0.25 * (bow * bow_cubed - stern * stern_cubed)
    # at slower rates r * r would underflow, and the effect is negligible
    over = 1.0 / np.where(np.abs(r) * a >= 1e-12, r, 1e150)
    both_sway, both_yaw = cubic * over, (quartic - v * cubic) * over * over
    one_sign = np.abs(r) * a <= np.abs(v)
    return np.where(one_sign, sway, both_sway), np.where(one_sign, yaw, both_yaw)


def propelled_rudder(
    u: np.ndarray, v: np.ndarray, r: np.ndarray, rudder: np.ndarray, c: Coefficients
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Load of the propellers, normal force on the rudder [N], sine and cosine of its angle."""
    # At constant revolutions, thrust and race of a propeller grow as the ship slows down.
    rise = c.thrust_rise / c.service_speed
    load = np.maximum(1.0 + c.thrust_rise - rise * u, 0.0)
    race = np.sqrt(u * u + c.race_power * load) - np.abs(u)
    # Inflow to the rudder: drift and yaw rate in a turn reduce the angle of attack.
    inflow = c.slipstream * u + c.race * race
    side = c.straightening * (v - c.half_length * r)
    sin_rudder, cos_rudder = sincos(rudder)
    # the whole inflow times the sine of the angle of attack
    attacking = inflow * sin_rudder + side * cos_rudder
    force = c.rudder * np.sqrt(inflow * inflow + side * side) * attacking
    return load, force, sin_rudder, cos_rudder


def _hull(
    u: np.ndarray, v: np.ndarray, r: np.ndarray, c: Coefficients
) -> tuple[np.ndarray, np.ndarray]:
    """Side force [N] and yaw moment [N m] of the hull, with the centripetal terms of its mass.

    The derivatives include Kirchhoff's terms, which change sign astern, and lift, which remains
    dissipative astern.
    """
    sway_drag, yaw_drag = _cross_flow(v, r, c.half_length)
    astern, surge_added = np.abs(u) - u, c.surge_inertia - c.mass
    munk = surge_added - (c.sway_inertia - c.mass)
    return (
        u * (c.Yv * v + c.Yr * r) + astern * (c.Yv * v + (c.Yr + surge_added) * r)
        - c.mass * u * r - c.cross_flow * sway_drag,
        u * (c.Nv * v + c.Nr * r)
        + astern * ((c.Nv - munk) * v + (c.Nr + c.sway_yaw_inertia - c.mass_x_g) * r)
        - c.mass_x_g * u * r - c.cross_flow * yaw_drag,
    )  # fmt: skip


@compiled
def corvette_rates(
    state: np.ndarray, control: np.ndarray, around: np.ndarray, coefficients: np.ndarray
) -> np.ndarray:
    """Rates ``(..., 8)`` of position, heading, velocities through the water, roll and roll rate.

    Roll follows from sway and yaw.

    Args:
        state: ``(..., 8)``, `STATE`.
        control: Rudder [rad] ``(..., 1)``.
        around: ``(..., 7)``, `AROUND`.
        coefficients: ``(..., k)``, `COEFFICIENTS`.
    """
    _, _, psi, u, v, r, phi, p = np.moveaxis(state, -1, 0)
    north, east, *forces, wave_sway = np.moveaxis(around, -1, 0)
    rudder, c = control[..., 0], Coefficients(*np.moveaxis(coefficients, -1, 0))
    sin, cos = sincos(psi)
    carried = v + wave_sway
    m_vv, m_vr = c.sway_inertia, c.sway_yaw_inertia
    m_rv, m_rr = c.yaw_sway_inertia, c.yaw_inertia
    load, force, sin_rudder, cos_rudder = propelled_rudder(u, v, r, rudder, c)
    # Surge: the sway added mass takes part in the centripetal term (Kirchhoff), which slows the
    # ship in a turn.
    X = (
        c.thrust * load - c.resistance * u * np.abs(u)
        + m_vv * v * r + m_vr * r * r - force * sin_rudder + forces[0]
    )  # fmt: skip
    Y, N = _hull(u, v, r, c)
    Y = Y - force * cos_rudder + forces[1]
    N = N + c.half_length * force * cos_rudder + forces[2]
    over = 1.0 / (m_vv * m_rr - m_vr * m_rv)
    sway, yaw = (m_rr * Y - m_vr * N) * over, (m_vv * N - m_rv * Y) * over
    # Side force on the ship's mass without external forces; the part without the rudder's acts on
    # the hull.
    side_force = c.mass * (sway + u * r) + c.mass_x_g * yaw - forces[1] + force * cos_rudder
    sin_roll, _ = sincos(phi)
    K = (
        c.rudder_arm * force * cos_rudder - c.hull_arm * side_force - c.righting * sin_roll
        - (c.roll_damping + c.roll_damping_speed * np.abs(u)) * p + forces[3]
    )  # fmt: skip
    return np.stack([
        u * cos - carried * sin + north, u * sin + carried * cos + east, r,
        X * (1.0 / c.surge_inertia), sway, yaw, p, K * (1.0 / c.roll_inertia),
    ], -1)  # fmt: skip


@compiled
def _accelerations(moving: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    motion = moving[..., :3]
    state = np.concatenate([0.0 * motion, motion, 0.0 * motion[..., :2]], -1)
    rates = corvette_rates(state, moving[..., 3:], np.zeros(len(AROUND)), coefficients)
    return rates[..., 3:6]


@compiled
def _jacobian(moving: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    return linearise(_accelerations, moving, coefficients)[1]
