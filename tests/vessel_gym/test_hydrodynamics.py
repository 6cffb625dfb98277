"""Coefficients from dimensions: known limits, closed forms, scaling, energy, and two vehicles with published figures.

``python tests/vessel_gym/test_hydrodynamics.py`` writes the table of ``docs/hydrodynamics.md``.
"""

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from vessel_gym.vehicles.hydrodynamics import (
    Coefficients,
    Fins,
    Hull,
    Spheroid,
    Torpedo,
    axial_drag_coefficient,
    lamb_factor,
    section_added_mass,
)

PAGE = Path(__file__).parents[2] / "docs" / "hydrodynamics.md"


@dataclass(frozen=True)
class Myring(Hull):
    """Elliptic nose, cylinder and cubic tail, the ends cut short where asked. Myring (1976), as in Prestero (2001)."""

    nose: float  # m, length before the nose is cut
    middle: float  # m
    tail: float  # m, length before the tail is cut
    diameter: float  # m
    tail_angle: float  # rad, half the angle enclosed at the uncut tip
    origin: float  # m, aft of the (cut) nose
    nose_cut: float = 0.0  # m
    tail_cut: float = 0.0  # m

    @property
    def bow(self) -> float:
        """Foremost x [m]."""
        return self.origin

    @property
    def stern(self) -> float:
        """Aftmost x [m]."""
        return self.joints[1] - self.tail + self.tail_cut

    @property
    def joints(self) -> tuple[float, float]:
        """The ends [m] of the cylinder."""
        fore = self.origin - self.nose + self.nose_cut
        return fore, fore - self.middle

    def radius(self, x: np.ndarray) -> np.ndarray:
        """Radius [m] at ``x``, zero beyond the ends."""
        x = np.asarray(x)
        fore, aft = self.joints
        ahead = np.clip((x - fore) / self.nose, 0.0, 1.0)  # of the cylinder, in lengths of the nose
        behind = np.clip(aft - x, 0.0, self.tail)
        c, slope = self.tail, np.tan(self.tail_angle)
        nose = 0.5 * self.diameter * np.sqrt(1.0 - ahead**2)
        lost = (1.5 * self.diameter / c**2 - slope / c) * behind**2 - (
            self.diameter / c**3 - slope / c**2
        ) * behind**3
        return np.where((x >= self.stern) & (x <= self.bow), nose - lost, 0.0)


# Prestero (2001): hull, and fins by their area, effective aspect ratio 2.21, taper and place.
REMUS_HULL = Myring(
    0.191, 0.654, 0.541, 0.191, 0.436, origin=0.611, nose_cut=0.0165, tail_cut=0.0368
)
REMUS = Torpedo(
    REMUS_HULL,
    Fins(area=6.65e-3, span=np.sqrt(0.5 * 2.21 * 6.65e-3), position=-0.638, taper=0.654),
    axial_drag=axial_drag_coefficient(1.3327, 0.191, speed=1.54),  # his top speed, 3 knots
    water_density=1030.0,
)


@st.composite
def torpedoes(draw) -> Torpedo:
    """Spheroids with stern fins that reach beyond the hull's diameter or not."""
    length = draw(st.floats(0.5, 5.0))
    diameter = length / draw(st.floats(4.0, 12.0))
    area = draw(st.floats(0.01, 0.1)) * length * diameter
    span = np.sqrt(0.5 * draw(st.floats(0.5, 4.0)) * area)
    fins = Fins(area, span, draw(st.floats(-0.49, -0.3)) * length, draw(st.floats(0.3, 1.0)))
    return Torpedo(Spheroid(length, diameter), fins, draw(st.floats(0.1, 0.4)))


# Products of speeds below 1e-100 underflow, and have no 12 digits to compare.
speeds = st.tuples(
    *[st.floats(-3.0, 3.0).map(lambda speed: speed if abs(speed) > 1e-100 else 0.0)] * 3
)


def volume(hull: Hull) -> float:
    """Volume [m3]."""
    x, dx = hull.strips()
    return float(dx @ (np.pi * hull.radius(x) ** 2))


def centre_of_buoyancy(hull: Hull) -> float:
    """X of the centre of the volume [m]."""
    x, dx = hull.strips()
    return float(dx @ (np.pi * hull.radius(x) ** 2 * x)) / volume(hull)


def displaced_mass(torpedo: Torpedo) -> float:
    """Mass [kg] that is neutrally buoyant."""
    return torpedo.water_density * volume(torpedo.hull)


def bare(torpedo: Torpedo) -> Torpedo:
    """The same with fins of a thousandth of a millimetre."""
    return replace(torpedo, fins=Fins(2e-12, 1e-6, torpedo.fins.position, 1.0))


def horizontal_drag(c: Coefficients, v: float, r: float) -> np.ndarray:
    return np.array(
        [c.Y_vv * v * abs(v) + c.Y_rr * r * abs(r), c.N_vv * v * abs(v) + c.N_rr * r * abs(r)]
    )


def vertical_drag(c: Coefficients, w: float, q: float) -> np.ndarray:
    return np.array(
        [c.Z_ww * w * abs(w) + c.Z_qq * q * abs(q), c.M_ww * w * abs(w) + c.M_qq * q * abs(q)]
    )


def horizontal_lift(c: Coefficients, u: float, v: float, r: float) -> np.ndarray:
    return abs(u) * np.array([c.Y_uv * v + c.Y_ur * r, c.N_uv * v + c.N_ur * r])


def vertical_lift(c: Coefficients, u: float, w: float, q: float) -> np.ndarray:
    return abs(u) * np.array([c.Z_uw * w + c.Z_uq * q, c.M_uw * w + c.M_uq * q])


def added_mass(c: Coefficients) -> np.ndarray:
    """The matrix whose rows are forces (X, Y, Z, K, M, N) per acceleration, with the sign of a mass."""
    matrix = np.diag([c.X_udot, c.Y_vdot, c.Z_wdot, c.K_pdot, c.M_qdot, c.N_rdot])
    matrix[1, 5], matrix[5, 1], matrix[2, 4], matrix[4, 2] = c.Y_rdot, c.N_vdot, c.Z_qdot, c.M_wdot
    return -matrix


# --- hulls ----------------------------------------------------------------------------------------


def test_remus_displaces_what_is_printed():
    # Prestero estimates 31.5 l; the buoyancy of 306 N that he measured is 31.2 kg of water.
    assert volume(REMUS_HULL) == pytest.approx(31.5e-3, rel=0.01)
    assert 306.0 / 9.81 / volume(REMUS_HULL) == pytest.approx(
        1000.0, rel=0.03
    )  # of fresh rather than sea water
    assert centre_of_buoyancy(REMUS_HULL) == pytest.approx(
        0.0, abs=6e-3
    )  # the origin is to be at it


# --- formulas -------------------------------------------------------------------------------------


@pytest.mark.parametrize("ratio", [1.1, 2.0, 5.2, 20.0])
def test_axial_factor_is_that_of_lamb_s_integral(ratio):
    a, b = ratio, 1.0
    along = quad(lambda s: a * b**2 / ((a**2 + s) ** 1.5 * (b**2 + s)), 0, np.inf, epsabs=1e-12)[0]
    assert lamb_factor(2 * a, 2 * b) == pytest.approx(along / (2 - along), rel=1e-7)


def test_a_section_tends_to_a_circle_and_to_a_plate():
    radius = np.array([0.0, 0.05, 0.1])
    np.testing.assert_allclose(
        section_added_mass(radius, radius, 1000.0), np.pi * 1000.0 * radius**2
    )
    np.testing.assert_allclose(section_added_mass(radius, 0.0, 1000.0), np.pi * 1000.0 * radius**2)
    assert section_added_mass(np.zeros(1), 0.2, 1000.0) == pytest.approx(np.pi * 1000.0 * 0.2**2)
    spans = np.linspace(0.1, 0.3, 50)
    assert np.all(np.diff([section_added_mass(radius[2:], tip, 1000.0)[0] for tip in spans]) > 0)


def test_the_integrals_of_a_bare_spheroid_are_closed_forms():
    a, b, rho = 0.49, 0.094, 1025.0
    torpedo = bare(Torpedo(Spheroid(2 * a, 2 * b), REMUS.fins, 0.2))
    mass = rho * 4 / 3 * np.pi * a * b**2
    np.testing.assert_allclose(
        torpedo.lateral_added_mass(), (mass, 0.0, mass * a**2 / 5), rtol=1e-6, atol=1e-6
    )
    drag = 0.5 * rho * 1.1 * np.pi * a * b
    turning = 0.5 * rho * 1.1 * 4 * b * a**4 * 2 / 15
    np.testing.assert_allclose(
        torpedo.cross_flow_integrals(), (drag, 0.0, 0.0, turning), rtol=1e-6, atol=1e-6
    )


def test_fin_lift_tends_to_plate_and_slender_wing():
    def slope(aspect: float) -> float:
        fins = Fins(area=0.01, span=np.sqrt(0.5 * aspect * 0.01), position=-0.4, taper=1.0)
        assert fins.aspect_ratio == pytest.approx(aspect)
        return replace(REMUS, fins=fins).fin_lift() / (0.5 * 1030.0 * 0.01)

    assert slope(1e6) == pytest.approx(0.9 * 2 * np.pi, rel=1e-4)
    assert slope(1e-3) == pytest.approx(np.pi * 1e-3, rel=1e-3)
    assert slope(2.21) == pytest.approx(3.12, abs=0.005)  # printed


def test_a_rectangular_fin_drags_more_than_a_tapered_one():
    assert REMUS.fins.plate_drag_coefficient() == pytest.approx(0.558, abs=5e-4)  # printed
    assert replace(REMUS.fins, taper=1.0).plate_drag_coefficient() == pytest.approx(0.8)


# --- the whole set --------------------------------------------------------------------------------

POWERS = {
    3: (
        "X_udot",
        "Y_vdot",
        "Z_wdot",
        "M_ww",
        "N_vv",
        "Y_ur",
        "Z_uq",
        "M_uw",
        "N_uv",
        "N_uudr",
        "M_uuds",
    ),
    4: ("Y_rdot", "N_vdot", "Z_qdot", "M_wdot", "Y_rr", "Z_qq", "M_uq", "N_ur", "K_up"),
    5: ("K_pdot", "M_qdot", "N_rdot", "K_pp", "M_qq", "N_rr"),
    2: ("X_uu", "Y_vv", "Z_ww", "Y_uv", "Z_uw", "Y_uudr", "Z_uuds"),
}


@given(torpedo=torpedoes(), factor=st.floats(0.2, 5.0))
def test_coefficients_grow_with_known_powers_of_size(torpedo, factor):
    hull, fins = torpedo.hull, torpedo.fins
    larger = replace(
        torpedo,
        hull=Spheroid(factor * hull.length, factor * hull.diameter),
        fins=Fins(factor**2 * fins.area, factor * fins.span, factor * fins.position, fins.taper),
    )
    small, large = torpedo.coefficients()._asdict(), larger.coefficients()._asdict()
    assert sum(len(names) for names in POWERS.values()) == len(small)
    for power, names in POWERS.items():
        for name in names:
            assert large[name] == pytest.approx(factor**power * small[name], rel=1e-9), name


@given(torpedo=torpedoes(), density=st.floats(900.0, 1100.0))
def test_coefficients_are_proportional_to_the_density_of_water(torpedo, density):
    here, there = torpedo.coefficients(), replace(torpedo, water_density=density).coefficients()
    for name, value in here._asdict().items():
        assert getattr(there, name) == pytest.approx(value * density / 1025.0, rel=1e-12), name


@given(torpedo=torpedoes(), motion=speeds)
def test_rolled_by_a_right_angle_the_vehicle_is_the_same(torpedo, motion):
    c, (u, v, r) = torpedo.coefficients(), motion
    flip = np.array(
        [1.0, -1.0]
    )  # starboard becomes down, and then nose-up turns against starboard-wards
    np.testing.assert_allclose(vertical_drag(c, v, -r), flip * horizontal_drag(c, v, r), rtol=1e-12)
    np.testing.assert_allclose(
        vertical_lift(c, u, v, -r), flip * horizontal_lift(c, u, v, r), rtol=1e-12
    )
    rotation = np.zeros((6, 6))
    rotation[:3, :3] = rotation[3:, 3:] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    np.testing.assert_allclose(rotation @ added_mass(c) @ rotation.T, added_mass(c), rtol=1e-12)
    assert c.Z_uuds == -c.Y_uudr
    assert c.M_uuds == c.N_uudr


@pytest.mark.slow
@given(torpedo=torpedoes(), motion=speeds)
@settings(max_examples=300)
def test_drag_and_lift_never_drive_the_vehicle_ahead_or_astern(torpedo, motion):
    c, (u, v, r) = torpedo.coefficients(), motion
    r = 3.0 * r / torpedo.hull.length  # the ends then move about as fast as the middle
    for force in (horizontal_drag(c, v, r), horizontal_lift(c, u, v, r)):
        assert force @ (v, r) <= 1e-12 * abs(force) @ np.abs((v, r))
    assert c.X_uu <= 0
    assert c.K_pp <= 0


@given(torpedo=torpedoes(), depth=st.floats(0.0, 0.3))
def test_the_inertia_of_body_and_water_is_symmetric_and_positive(torpedo, depth):
    m, L, d = displaced_mass(torpedo), torpedo.hull.length, torpedo.hull.diameter
    z = depth * d
    pitch = m * (L**2 + d**2) / 20  # of a homogeneous spheroid
    rigid = np.diag([m, m, m, m * d**2 / 10 + m * z**2, pitch + m * z**2, pitch])
    rigid[0, 4] = rigid[4, 0] = m * z
    rigid[1, 3] = rigid[3, 1] = -m * z
    water = added_mass(torpedo.coefficients())
    for matrix in (water, rigid + water):
        np.testing.assert_array_equal(matrix, matrix.T)
        scale = 1.0 / np.sqrt(np.diag(matrix))
        assert np.linalg.eigvalsh(matrix * np.outer(scale, scale)).min() > 1e-6


@given(torpedo=torpedoes())
def test_positive_fins_turn_dive_and_steady_the_course(torpedo):
    c = torpedo.coefficients()
    assert c.Y_uudr > 0 > c.N_uudr
    assert c.Z_uuds < 0 > c.M_uuds
    assert (
        c.Y_vdot - c.X_udot < 0 < torpedo.coefficients().N_uv
    )  # the one turns the hull across, the other back


# --- against published vehicles -------------------------------------------------------------------


def test_remus_has_the_published_coefficients_within_a_quarter():
    """Those of added mass, of drag across and of the fins; docs/hydrodynamics.md says why the others differ."""
    near = ("X_udot", "Y_vdot", "Y_rdot", "Z_qdot", "M_qdot", "Y_vv", "M_qq", "Y_uudr", "M_uuds")
    found = {re.match(r"\w+", name)[0]: of for name, *of in remus_rows()}
    for name in near:
        published, ours = found[name]
        assert ours == pytest.approx(published, rel=0.25), name
    c = REMUS.coefficients()
    alike = [
        ("Y_vdot", "Z_wdot"),
        ("Y_rdot", "N_vdot"),
        ("Z_qdot", "M_wdot"),
        ("M_qdot", "N_rdot"),
        ("Y_vv", "Z_ww"),
    ]
    assert all(getattr(c, one) == getattr(c, other) for one, other in [*alike, ("M_qq", "N_rr")])


Row = tuple[str, float, float]  # name and note of the page, published, ours


def remus_rows() -> list[Row]:
    """Published coefficients of REMUS beside ours; those that hold added mass there get it here too."""
    c, fin, x = REMUS.coefficients(), REMUS.fin_lift(), REMUS.fins.position
    munk = c.Y_vdot - c.X_udot
    return [
        ("X_udot", -0.93, c.X_udot),
        ("Y_vdot, Z_wdot", -35.5, c.Y_vdot),
        ("Y_rdot, N_vdot", 1.93, c.Y_rdot),
        ("Z_qdot, M_wdot", -1.93, c.Z_qdot),
        ("M_qdot, N_rdot", -4.88, c.M_qdot),
        ("K_pdot (a)", -0.0704, c.K_pdot),
        ("X_uu (b)", -1.62, c.X_uu),
        ("Y_vv, Z_ww (c)", -131.0, c.Y_vv),
        ("Y_rr (d)", 0.632, c.Y_rr),
        ("M_ww, -N_vv (d)", 3.18, c.M_ww),
        ("M_qq, N_rr (c)", -9.4, c.M_qq),
        ("K_pp (e)", -0.13, c.K_pp),
        ("Y_uv, Z_uw (f)", -28.6, c.Y_uv),
        ("M_uw, -N_uv (f)", 24.0, c.M_uw - munk),
        ("Y_ur, -Z_uq (f)", 5.22, c.Y_ur + c.X_udot),
        ("N_ur, M_uq (f)", -2.0, c.N_ur + c.Y_rdot),
        ("Y_uudr (g)", 9.64, fin),
        ("M_uuds (g)", -6.15, fin * x),
    ]


def table(rows: list[Row]) -> str:
    lines = ["| coefficient | published | ours | ratio |", "|---|---|---|---|"]
    lines += [f"| {name} | {old:.3g} | {new:.3g} | {new / old:.2f} |" for name, old, new in rows]
    return "\n".join(lines)


def with_table(page: str) -> str:
    """The page, with the table between its markers computed anew."""
    before, rest = page.split("<!-- remus -->\n")
    after = rest[rest.index("\n<!-- /remus -->") :]
    return f"{before}<!-- remus -->\n{table(remus_rows())}{after}"


def test_the_page_says_what_the_code_computes():
    page = PAGE.read_text(encoding="utf-8")
    assert page == with_table(page), "run python tests/vessel_gym/test_hydrodynamics.py"


if __name__ == "__main__":
    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
