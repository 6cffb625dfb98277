"""The manoeuvring model of measured ships: laws of its equations, exact derivatives, the file."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.vessel_gym.identification.voyages import SHIP, coefficients
from vessel_gym.identification.prediction import simulate, simulate_with_slopes
from vessel_gym.vehicles.manoeuvring import _P, COEFFICIENTS, C, _rates, _rudder, rates
from vessel_gym.vehicles.measured_ship import MeasuredShip, read

P = SHIP.vector()


def flow(rng: np.random.Generator, rows: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """States, controls and winds in all four quadrants."""
    state = rng.normal(size=(rows, 6)) * (10.0, 10.0, 2.0, 0.3, 0.1, 0.05)
    return state, rng.normal(size=(rows, 2)) * (0.4, 8.0), rng.normal(size=(rows, 4)) * 2.0


def test_compiled_equations_are_numpys() -> None:
    rng = np.random.default_rng(0)
    state, control, air = flow(rng, 200)
    c = coefficients(rng)
    expected = np.array([_rates(*row, c, P) for row in zip(state, control, air, strict=True)])
    np.testing.assert_allclose(rates(state, control, air, c, P), expected, rtol=1e-10, atol=1e-12)


def test_a_ship_alike_on_both_sides_turns_alike_to_both_sides() -> None:
    rng = np.random.default_rng(1)
    state, control, air = flow(rng, 100)
    c = coefficients(rng)
    c[[C.Yn, C.Nn, C.Ynb, C.Nnb, C.Ynub, C.Nnub, C.d0]] = 0.0
    c[C.gm] = c[C.gp]
    mirror = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])
    mirrored = rates(state * mirror, control * (-1.0, 1.0), air * (1.0, -1.0, 1.0, -1.0), c, P)
    np.testing.assert_allclose(mirrored, rates(state, control, air, c, P) * mirror, rtol=1e-12, atol=1e-15)


def test_the_sea_and_the_sky_have_no_direction() -> None:
    rng = np.random.default_rng(2)
    state, control, air = flow(rng, 50)
    c, angle = coefficients(rng), 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    turned = state.copy()
    turned[:, 2] += angle
    winds = (air.reshape(-1, 2, 2) @ turn.T).reshape(-1, 4)
    expected = rates(state, control, air, c, P)
    expected[:, :2] = expected[:, :2] @ turn.T
    np.testing.assert_allclose(rates(turned, control, winds, c, P), expected, rtol=1e-9, atol=1e-11)


def test_a_ship_at_rest_in_a_calm_stays() -> None:
    c = coefficients(np.random.default_rng(3))
    np.testing.assert_allclose(rates(np.zeros(6), np.array([0.3, 0.0]), np.zeros(4), c, P)[[0, 1, 2]], 0.0)
    assert np.abs(rates(np.zeros(6), np.array([0.3, 0.0]), np.zeros(4), c, P)).max() < 1e-7


def test_on_a_straight_course_thrust_is_resistance() -> None:
    c = np.zeros(len(COEFFICIENTS))
    c[[C.R0, C.k0, C.CrY, C.CrN, C.aH]] = 0.02, 0.3, 1.0, 1.0, 0.2
    n = 10.0
    thrust = 0.3 * 1000.0 * SHIP.propeller_diameter**4 * n**2
    speed = np.sqrt(thrust / (0.02 * 0.5 * 1000.0 * SHIP.length * SHIP.draught))
    states = simulate(
        np.array([0.0, 0, 0, 0.5 * speed, 0, 0]), np.tile([0.0, n], (4000, 1)), np.zeros((4000, 4)), c, P, 0.2
    )
    np.testing.assert_allclose(states[-1, 3], speed, rtol=1e-6)


def rudder_force(u: float, v: float, race: float, n: float = 10.0, **values: float) -> float:
    """Sway force of a rudder of 1e-3 rad, over that of a rudder of the same angle in an undisturbed flow of 1 m/s."""
    c = np.zeros(len(COEFFICIENTS))
    for name, value in values.items():
        c[getattr(C, name)] = value
    numbers = (np.array(each) for each in (u, v, 0.0))
    force = _rudder(*numbers, (np.array(1e-3), np.array(n)), np.array(race), c, P)[1]
    return float(force / (-P[_P.rudder] * 1e-3))


def test_a_rudder_meets_the_slipstream_of_momentum_theory_on_a_part_of_its_height() -> None:
    far = np.sqrt(1.0 + 8.0 / np.pi * 2.0)  # of a thrust 2 rho D^2 (1 m/s)^2
    share = SHIP.propeller_diameter / np.sqrt(1.5 * SHIP.rudder_area)
    assert rudder_force(1.0, 0.0, 2.0, eps=1.0) == pytest.approx(1.0, rel=1e-5)
    assert rudder_force(1.0, 0.0, 0.0, eps=1.0, kappa=1.0) == pytest.approx(1.0, rel=1e-5)
    assert rudder_force(1.0, 0.0, 2.0, eps=1.0, kappa=1.0) == pytest.approx(share * far**2 + 1.0 - share, rel=1e-5)
    assert rudder_force(0.0, 0.0, 2.0, kappa=0.5) == pytest.approx(share * 0.25 * (far**2 - 1.0), rel=1e-5)


def test_a_rudder_hardly_feels_a_propeller_that_hardly_turns_ahead_or_astern() -> None:
    for u in (2.0, 0.0, -2.0):
        stopped, turning = (rudder_force(u, 0.0, 0.0, n=n, eps=0.7, kappa=0.5, kapb=0.03) for n in (0.0, 1e-9))
        assert turning == pytest.approx(stopped, abs=1e-4)


def test_the_wake_shrinks_with_drift() -> None:
    straight, drifting = (rudder_force(1.0, v, 0.0, eps=0.6) for v in (0.0, 0.5))
    assert straight == pytest.approx(0.6**2, rel=1e-5)
    assert drifting == pytest.approx((1.0 - 0.4 * np.exp(-4.0 * 0.5**2 / (1.0 + 0.5**2))) ** 2, rel=1e-3)


def test_slopes_are_the_derivatives_of_the_simulation() -> None:
    rng = np.random.default_rng(4)
    state, _, _ = flow(rng, 3)
    control, air = rng.normal(size=(30, 3, 2)) * (0.4, 8.0), rng.normal(size=(30, 3, 4))
    c = coefficients(rng)
    states, slopes = simulate_with_slopes(state, control, air, c, P, 0.2, 10)
    np.testing.assert_array_equal(states, simulate(state, control, air, c, P, 0.2)[10::10])
    for i in range(6 + len(c)):
        step = np.zeros(6 + len(c))
        step[i] = 1e-6
        up, down = (
            simulate(state + sign * step[:6], control, air, c + sign * step[6:], P, 0.2)[10::10] for sign in (1.0, -1.0)
        )
        np.testing.assert_allclose(slopes[..., i], (up - down) / 2e-6, rtol=2e-5, atol=2e-6)


def test_a_file_holds_a_ship(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    root = 0.01 * rng.normal(size=(len(COEFFICIENTS),) * 2)
    ship = MeasuredShip(SHIP, coefficients(rng), root @ root.T, 12, 30.0, {"yaw": 1e-3}, {60.0: np.arange(6.0)}, ("a",))
    ship.write(tmp_path / "ship.toml")
    found = read(tmp_path / "ship.toml")
    assert (found.particulars, found.degrees_of_freedom, found.noise, found.logs) == (SHIP, 12, {"yaw": 1e-3}, ("a",))
    np.testing.assert_allclose(found.coefficients, ship.coefficients, rtol=1e-5)
    np.testing.assert_allclose(found.covariance, ship.covariance, atol=1e-4 * ship.covariance.max())
    found.write(tmp_path / "again.toml")
    assert (tmp_path / "again.toml").read_text()[:2000] == (tmp_path / "ship.toml").read_text()[:2000]


@pytest.mark.parametrize(
    ("line", "text", "sentence"),
    [
        ("length", "length = -3.0", "line 4: length must be a number above 0, got -3"),
        ("length", "longth = 3.0", "line 4: unknown key in"),
        ("length", "length = nan", "line 4: length must be a finite number, got nan"),
        ("length", "", "needs a 'length'"),
        ("kind", 'kind = "ship"', "line 1: a measured ship's file has kind = 'measured ship', got 'ship'"),
        ("mx", "mx = true", "mx must be a finite number, got True"),
        ("[noise]", "[nois]", "unknown table 'nois'"),
        ("[standard_errors]", "[standard]", "unknown table 'standard'"),
    ],
)
def test_a_mistake_is_named_with_its_line(tmp_path: Path, line: str, text: str, sentence: str) -> None:
    path = tmp_path / "ship.toml"
    replace(MeasuredShip.assumed(SHIP)).write(path)
    lines = path.read_text().splitlines()
    at = next(i for i, each in enumerate(lines) if each.startswith(line))
    path.write_text("\n".join([*lines[:at], text, *lines[at + 1 :]]))
    with pytest.raises(ValueError, match=r"ship\.toml, line") as error:
        read(path)
    assert sentence in str(error.value)
