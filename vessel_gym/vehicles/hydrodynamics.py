"""Hydrodynamic coefficients of a torpedo-shaped vehicle from its dimensions.

The vehicle is divided into strips across its axis. Each formula is a function with its source;
``docs/hydrodynamics.md`` compares them with two vehicles of published coefficients.

Sources: Prestero (2001), whose thesis on REMUS collects most of these formulas; Lamb (1932) and
Fossen (2011) for the added mass of a spheroid; Blevins (1979) for the added mass of sections;
Hoerner (1965, 1975) for drag and lift; Triantafyllou & Amzallag (1984) for axial drag.
"""

from collections import namedtuple
from dataclasses import dataclass
from typing import Any

import numpy as np

# --- shape ----------------------------------------------------------------------------------------


class Hull:
    """A body of revolution; x [m] counts forward from the origin of the body axes."""

    diameter: float
    bow: float
    """Foremost x [m]."""
    stern: float
    """Aftmost x [m]."""
    joints: tuple[float, ...] = ()
    """Positions x [m] at which pieces of different curvature meet."""

    def radius(self, x: Any) -> Any:
        """Radius [m] at ``x``, zero beyond the ends."""
        raise NotImplementedError

    def strips(self, *cuts: float) -> tuple[np.ndarray, np.ndarray]:
        """Middles and widths [m] of strips that cross no joint, no cut and not the origin.

        Gauss-Legendre quadrature after x = sin, which removes the root at a blunt end. Cuts beyond
        the ends lengthen the range.
        """
        edges = np.unique([self.stern, *self.joints, 0.0, self.bow, *cuts])
        t, weight = np.polynomial.legendre.leggauss(24)
        middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
        x = middle[:, None] + half[:, None] * np.sin(0.5 * np.pi * t)
        dx = half[:, None] * (weight * 0.5 * np.pi * np.cos(0.5 * np.pi * t))
        return x.ravel(), dx.ravel()


@dataclass(frozen=True)
class Spheroid(Hull):
    """A prolate spheroid with the origin in its middle."""

    length: float  # m
    diameter: float  # m

    @property
    def bow(self) -> float:  # type: ignore[override]
        """Foremost x [m]."""
        return 0.5 * self.length

    @property
    def stern(self) -> float:  # type: ignore[override]
        """Aftmost x [m]."""
        return -0.5 * self.length

    def radius(self, x: Any) -> Any:
        """Radius [m] at ``x``, zero beyond the ends."""
        share = 2.0 * x / self.length
        return 0.5 * self.diameter * np.sqrt(np.maximum(0.0, 1.0 - share**2))


@dataclass(frozen=True)
class Fins:
    """Four equal stern fins in a cross, two rudders and two stern planes; dimensions of one fin."""

    area: float  # m2
    span: float  # m, from the hull to the tip
    position: float  # m, x of the middle of the chord, where the lift acts; negative is aft
    taper: float  # chord at the tip / at the root

    @property
    def chord(self) -> float:
        """Mean chord [m]."""
        return self.area / self.span

    @property
    def aspect_ratio(self) -> float:
        """Effective aspect ratio, doubled by the mirror effect of the hull; Hoerner (1965)."""
        return 2.0 * self.span**2 / self.area

    def plate_drag_coefficient(self) -> float:
        """Drag coefficient across the flow; Whicker & Fehlner (1958), in Prestero (2001)."""
        return 0.1 + 0.7 * self.taper


# --- formulas -------------------------------------------------------------------------------------


def lamb_factor(length: float, diameter: float) -> float:
    """Added mass of a prolate spheroid along its axis, over the displaced mass.

    Lamb (1932), art. 114-115; Fossen (2011). The length must exceed the diameter.
    """
    e2 = 1.0 - (diameter / length) ** 2
    e = np.sqrt(e2)
    alpha = 2.0 * (1.0 - e2) / e**3 * (np.arctanh(e) - e)
    return alpha / (2.0 - alpha)


def section_added_mass(
    radius: np.ndarray, tip: np.ndarray | float, water_density: float
) -> np.ndarray:
    """Added mass [kg/m] of a circle across the flow, with a fin on either side up to ``tip``.

    Blevins (1979).
    """
    tip = np.maximum(tip, radius)
    square = np.divide(radius**2, tip, out=np.zeros_like(radius), where=tip > 0.0) ** 2
    return np.pi * water_density * (tip**2 - radius**2 + square)


def axial_drag_coefficient(
    length: float, diameter: float, speed: float, viscosity: float = 1.19e-6
) -> float:
    """Axial drag coefficient of a bare hull on its frontal area.

    Triantafyllou & Amzallag (1984), with the friction line of ITTC (1957). Fins, antennas and gaps
    add to this: for LAUV (da Silva et al., 2007) the total is 1.8 times as large.

    Args:
        length: Length of the hull [m].
        diameter: Diameter of the hull [m].
        speed: Speed through the water [m/s].
        viscosity: Kinematic viscosity [m2/s], of sea water at 15 degrees; ITTC (2011).
    """
    friction = 0.075 / (np.log10(speed * length / viscosity) - 2.0) ** 2
    projected_per_frontal = 4.0 * length / (np.pi * diameter)
    shape = 1.0 + 60.0 * (diameter / length) ** 3 + 0.0025 * length / diameter
    return friction * np.pi * projected_per_frontal * shape


# --- the vehicle ----------------------------------------------------------------------------------


Coefficients = namedtuple("Coefficients", (
    # added mass: force or moment per acceleration
    "X_udot", "Y_vdot", "Y_rdot", "Z_wdot", "Z_qdot", "K_pdot", "M_wdot", "M_qdot", "N_vdot",
    "N_rdot",
    # drag: per velocity times its size, e.g. Y_vv v |v|
    "X_uu", "Y_vv", "Y_rr", "Z_ww", "Z_qq", "K_pp", "M_ww", "M_qq", "N_vv", "N_rr",
    # lift of hull and centred fins, without the added-mass terms: per |u| and velocity, e.g.
    # Y_uv |u| v
    "K_up", "Y_uv", "Y_ur", "Z_uw", "Z_uq", "M_uw", "M_uq", "N_uv", "N_ur",
    # fins: per u |u| and angle
    "Y_uudr", "N_uudr", "Z_uuds", "M_uuds",
))  # fmt: skip
"""Coefficients of a hull with four equal stern fins, SI units, about the centre of buoyancy.

Body axes: x forward, y starboard, z down. Signs and names are Prestero's (2001). A positive rudder
angle pushes the stern to starboard, so that the vehicle turns to port. A positive stern plane angle
pushes the stern up, so that the vehicle dives.
"""


CROSS_FLOW_DRAG = 1.1
"""Drag coefficient of a cylinder across the flow; Hoerner (1965), as in Prestero (2001)."""


@dataclass(frozen=True)
class Torpedo:
    """A hull with fins, and coefficients that geometry does not determine."""

    hull: Hull
    fins: Fins
    axial_drag: float  # on the frontal area; see `axial_drag_coefficient`
    water_density: float = 1025.0  # kg/m3, sea water; Fossen (2011)

    @property
    def root(self) -> float:
        """Distance [m] of the root of a fin from the axis."""
        return self.hull.radius(self.fins.position)

    @property
    def tip(self) -> float:
        """Distance [m] of the tip of a fin from the axis."""
        return self.root + self.fins.span

    def lateral_added_mass(self) -> tuple[float, float, float]:
        """Integrals [kg, kg m, kg m2] of the sections' added mass times 1, x and x squared.

        Prestero (2001).
        """
        middle, half = self.fins.position, 0.5 * self.fins.chord
        aft, fore = middle - half, middle + half  # edges of the fins
        x, dx = self.hull.strips(aft, fore)
        finned = np.where((x > aft) & (x < fore), self.tip, 0.0)
        mass = dx * section_added_mass(self.hull.radius(x), finned, self.water_density)
        return mass.sum(), mass @ x, mass @ x**2

    def axial_added_mass(self) -> float:
        """Axial added mass [kg] of a spheroid of the hull's length and diameter; Lamb (1932)."""
        length, diameter = self.hull.bow - self.hull.stern, self.hull.diameter
        along = lamb_factor(length, diameter)
        return along * self.water_density * np.pi / 6.0 * length * diameter**2

    def roll_added_inertia(self) -> float:
        """Roll added inertia [kg m2] of a cross of four fins without a hull.

        Blevins (1979), in Prestero (2001).
        """
        return 2.0 / np.pi * self.water_density * self.tip**4 * self.fins.chord

    def cross_flow_integrals(self) -> tuple[float, float, float, float]:
        """Integrals [N s2/m2] of drag per squared cross-flow, times 1, x, x |x| and |x|^3.

        Prestero (2001), with strips of the hull and the two fins across the flow. One distribution
        for all four integrals makes the forces dissipative in every motion.
        """
        half_density = 0.5 * self.water_density
        x, dx = self.hull.strips()
        hull = half_density * CROSS_FLOW_DRAG * 2.0 * self.hull.radius(x) * dx
        fins = half_density * self.fins.plate_drag_coefficient() * 2.0 * self.fins.area
        drag, x = np.append(hull, fins), np.append(x, self.fins.position)
        return drag.sum(), drag @ x, drag @ (x * abs(x)), drag @ abs(x) ** 3

    def roll_drag(self) -> float:
        """Moment [N m s2] of the four fins per squared rate, by plate drag on strips."""
        per_area = 0.5 * self.water_density * self.fins.plate_drag_coefficient()
        return per_area * self.fins.chord * (self.tip**4 - self.root**4)  # 4 fins, integral of s^3

    def hull_lift(self) -> tuple[float, float]:
        """Lift [N s2/m2] per u and local cross-flow, and position x [m] of the lift.

        Hoerner (1975), in Prestero (2001): .003 per degree, on length times diameter, at 65 % of
        the length; measured for length / diameter of 6.7 to 10.
        """
        length = self.hull.bow - self.hull.stern
        lift = 0.5 * self.water_density * length * self.hull.diameter * 0.003 * 180.0 / np.pi
        return lift, self.hull.bow - 0.65 * length

    def fin_lift(self) -> float:
        """Lift [N s2/m2] of one fin per u squared and angle; Hoerner (1965), in Prestero (2001)."""
        slope = 1.0 / (1.0 / (1.8 * np.pi) + 1.0 / (np.pi * self.fins.aspect_ratio))
        return 0.5 * self.water_density * self.fins.area * slope

    def fin_roll_lift(self) -> float:
        """Moment [N m s2] of the lift of four fins per u and roll rate, by the inflow's angle."""
        root, tip = self.root, self.tip
        return 4.0 * self.fin_lift() * (root**2 + root * tip + tip**2) / 3.0

    def coefficients(self) -> Coefficients:
        """All coefficients.

        A surface at x with lift k meets the cross-flow v + x r in the horizontal and w - x q in the
        vertical plane. So its force -k |u| (v + x r) is dissipative. Prestero (2001) gives the fins
        these four terms but the hull only the one in v. Without the terms in r, lift feeds energy
        to a hull that turns about a point between the origin and its centre of pressure.
        """
        mass, mass_moment, mass_inertia = self.lateral_added_mass()
        drag, drag_moment, drag_turning, drag_inertia = self.cross_flow_integrals()
        hull, fin, x_f = self.hull_lift(), self.fin_lift(), self.fins.position
        lift, x = np.array([hull[0], 2.0 * fin]), np.array([hull[1], x_f])
        lift_force, lift_moment, lift_inertia = lift.sum(), lift @ x, lift @ x**2
        frontal_area = 0.25 * np.pi * self.hull.diameter**2
        return Coefficients(
            X_udot=-self.axial_added_mass(),
            Y_vdot=-mass, Y_rdot=-mass_moment, N_vdot=-mass_moment, N_rdot=-mass_inertia,
            Z_wdot=-mass, Z_qdot=mass_moment, M_wdot=mass_moment, M_qdot=-mass_inertia,
            K_pdot=-self.roll_added_inertia(),
            X_uu=-0.5 * self.water_density * frontal_area * self.axial_drag,
            Y_vv=-drag, Y_rr=-drag_turning, N_vv=-drag_moment, N_rr=-drag_inertia,
            Z_ww=-drag, Z_qq=drag_turning, M_ww=drag_moment, M_qq=-drag_inertia,
            K_pp=-self.roll_drag(), K_up=-self.fin_roll_lift(),
            Y_uv=-lift_force, Y_ur=-lift_moment, N_uv=-lift_moment, N_ur=-lift_inertia,
            Z_uw=-lift_force, Z_uq=lift_moment, M_uw=lift_moment, M_uq=-lift_inertia,
            Y_uudr=2.0 * fin, N_uudr=2.0 * fin * x_f,
            Z_uuds=-2.0 * fin, M_uuds=2.0 * fin * x_f,
        )  # fmt: skip
