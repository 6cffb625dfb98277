"""Both corvettes: published derivatives, compiled equations against plain ones, equilibria; the thesis' models."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from manoeuvres import rates_of, turning_circle
from scipy.integrate import quad
from scipy.linalg import expm
from sensing import assumed, sensors_of, without_a_filter

from estimators import LinearModel, wrap
from vessel_gym.envs.thesis_corvette import UnknownStep
from vessel_gym.vehicles.corvette import (
    secant_models,
    steady_turns,
)
from vessel_gym.vehicles.corvette_equations import (
    AROUND,
    STATE,
    CorvetteParameters,
    corvette_rates,
)
from vessel_gym.vehicles.corvette_thesis import ThesisCorvette
from vessel_gym.vehicles.files import load

SHIP = load("corvette-thesis")
SHIPS = {"thesis": SHIP, "corvette": load("corvette")}
each_ship = pytest.mark.parametrize("ship", SHIPS.values(), ids=SHIPS)
VEHICLE = ThesisCorvette(SHIP, 0.5)
L, U = SHIP.length, SHIP.speed


def ship_rates(states: np.ndarray, controls: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Rates ``(..., 8)``; controls ``(..., 8)``: rudder, and what is around."""
    return corvette_rates(states, controls[..., :1], controls[..., 1:], c)


def upright(motion: np.ndarray) -> np.ndarray:
    """States ``(..., 8)`` of ships that do not roll, out of the first of their components."""
    state = np.zeros(np.shape(motion)[:-1] + (len(STATE),))
    state[..., : np.shape(motion)[-1]] = motion
    return state


def random_motions(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """States ``(n, 8)`` and controls ``(n, 8)`` over all that the ship can meet, and more."""
    most = np.array([500, 500, 4, 8, 5, 0.08, 0.5, 0.2])
    state = rng.uniform(-most, most, (n, 8))
    state[:, 3] += 10.0
    most = np.array([0.61, 1, 1, 2e5, 4e5, 1e7, 5e6, 0.5])
    return state, rng.uniform(-most, most, (n, 8))


# --- parameters -----------------------------------------------------------------------------------


def test_the_block_coefficient_displaces_the_printed_mass():
    assert SHIP.block_coefficient == pytest.approx(0.452, abs=5e-4)
    assert SHIP.block_coefficient * L * 14.0 * 3.7 * 1024.0 == pytest.approx(2.423e6)
    printed = 0.65 * L * 14.0 * 3.7 * 1024.0
    assert printed == pytest.approx(3485e3, abs=500.0)  # the printed one does not


@pytest.mark.parametrize(
    ("name", "value", "digit"),
    [("Yvdot", -495, 1), ("Yrdot", -19.2, 0.1), ("Nvdot", 1.16, 0.01), ("Nrdot", -28.1, 0.1), ("Yv", -709, 1),
     ("Yr", 209.7, 0.1), ("Nv", -247.5, 0.1), ("Nr", -134.7, 0.1), ("m", 458, 1), ("Iz", 30.0, 0.1)],
)  # fmt: skip
def test_the_derivatives_are_clarke_s(name, value, digit):
    assert SHIP.clarke[name] * 1e5 == pytest.approx(value, abs=0.5 * digit)


def filter_model(kind: str) -> LinearModel:
    """The model that filters have of the thesis' ship."""
    return assumed(VEHICLE, kind, UnknownStep(), sensors_of(VEHICLE))[1]


# --- the compiled equations -----------------------------------------------------------------------


def plain_cross_flow(v: float, r: float, a: float) -> np.ndarray:
    """The two integrals of the cross-flow along the hull by quadrature, split where the flow turns round."""
    size = (abs(v) + abs(r) * a) or 1.0
    v, r = v / size, r * a / size  # of order 1, along -1 <= x <= 1
    pieces = [-1.0, -v / r, 1.0] if abs(v) < abs(r) else [-1.0, 1.0]
    integrals = [
        sum(quad(lambda x: abs(v + x * r) * (v + x * r) * x**power, *ends, epsabs=1e-13, epsrel=0.0)[0]  # noqa: B023
            for ends in pairwise(pieces))
        for power in (0, 1)
    ]  # fmt: skip
    return size**2 * a * np.array([integrals[0], a * integrals[1]])


def plain_propulsion(u: float, ship: CorvetteParameters) -> tuple[float, float]:
    """Thrust [N] and the speed [m/s] of what flows to the rudder."""
    if not ship.thrust_coefficient:
        return ship.resistance, ship.slipstream * u
    # Propellers of constant revolutions (diameter D, n turns a second), and the race behind a disc
    # of their thrust.
    nD = ship.speed / ship.advance_ratio
    at_speed, K_T = (
        ship.thrust_coefficient - ship.thrust_slope * speed / nD for speed in (ship.speed, u)
    )
    K_T = max(K_T, 0.0)
    race = np.sqrt(u**2 + 8.0 * K_T * nD**2 / np.pi)
    return ship.resistance * K_T / at_speed, (1.0 - ship.race) * u + ship.race * race


def plain_roll(
    forces: tuple[float, float, float], ship: CorvetteParameters, u: float, phi: float, p: float
) -> float:
    """Roll acceleration [rad/s2] by sway forces at hull and rudder [N] and a moment [N m]."""
    hull, rudder, moment = forces
    if ship.roll_period is None:  # IMO's weather criterion
        stiffness, height = 0.08 * ship.beam, 1.5 * ship.draught
        c = 0.373 + 0.023 * ship.beam / ship.draught - 0.00043 * ship.length
        period = 2.0 * c * ship.beam / np.sqrt(stiffness)
    else:
        stiffness, height, period = ship.metacentric_height, ship.gravity_height, ship.roll_period
    frequency = 2.0 * np.pi / period
    inertia = ship.mass * 9.81 * stiffness / frequency**2
    damping = 2.0 * frequency * (0.071 + 0.051 * u / np.sqrt(9.81 * ship.length))
    arms = -(height - 0.5 * ship.draught) * hull - (height - 0.34 * ship.draught) * rudder
    return (arms + moment) / inertia - frequency**2 * np.sin(phi) - damping * p


def plain_derivative(
    state: np.ndarray, control: np.ndarray, ship: CorvetteParameters
) -> np.ndarray:
    """The equations of motion written out with the ship's particulars, and quadrature for the cross-flow."""
    _, _, psi, u, v, r, phi, p = state
    rudder, north, east, *outside, rolling, wave_sway = control
    rho, m, x_g = ship.water_density, ship.mass, ship.x_g
    c = ship.clarke
    q = rho / 2
    surge_added = 2.7 * rho * (m / rho) ** (5 / 3) / ship.length**2
    M_A = np.diag([surge_added, 0.0, 0.0])
    M_A[1:, 1:] = -q * np.array(
        [[L**3 * c["Yvdot"], L**4 * c["Yrdot"]], [L**4 * c["Nvdot"], L**5 * c["Nrdot"]]]
    )  # fmt: skip
    M_RB = np.array([[m, 0, 0], [0, m, m * x_g], [0, m * x_g, q * L**5 * c["Iz"]]])

    thrust, inflow = plain_propulsion(u, ship)
    side = ship.straightening * (v - L / 2 * r)
    speed2 = inflow**2 + side**2
    angle = rudder + np.arctan2(side, inflow)
    normal = (
        q
        * ship.rudder_area
        * 6.13
        * ship.rudder_aspect
        / (ship.rudder_aspect + 2.25)
        * speed2
        * np.sin(angle)
    )
    rudder_force = normal * np.array([-np.sin(rudder), -np.cos(rudder), L / 2 * np.cos(rudder)])

    sway_drag, yaw_drag = plain_cross_flow(v, r, L / 2)
    drag = -q * ship.draught * ship.drag_coefficient * np.array([0.0, sway_drag, yaw_drag])
    hull = q * u * np.array(
        [0.0, L**2 * c["Yv"] * v + L**3 * c["Yr"] * r, L**3 * c["Nv"] * v + L**4 * c["Nr"] * r]
    )  # fmt: skip
    propulsion = np.array([thrust - ship.resistance * u * abs(u) / ship.speed**2, 0.0, 0.0])
    centripetal = np.array([(m * v + m * x_g * r) * r, -m * u * r, -m * x_g * u * r])
    added_centripetal = np.array(
        [(M_A[1, 1] * v + M_A[1, 2] * r) * r, 0.0, 0.0]
    )  # Clarke's Yr, Nr hold the others
    nu_dot = np.linalg.solve(
        M_RB + M_A, propulsion + hull + drag + rudder_force + centripetal + added_centripetal + outside
    )  # fmt: skip
    sideways = m * (
        nu_dot[1] + x_g * nu_dot[2] + u * r
    )  # Newton: all sway forces move the centre of gravity
    by_hull = sideways - rudder_force[1] - outside[1]
    roll = plain_roll((by_hull, rudder_force[1], rolling), ship, u, phi, p)
    turn = np.array([[np.cos(psi), -np.sin(psi)], [np.sin(psi), np.cos(psi)]])
    return np.concatenate([turn @ [u, v + wave_sway] + [north, east], [r], nu_dot, [p, roll]])


@each_ship
def test_the_compiled_equations_are_the_plain_ones(ship: CorvetteParameters):
    rng = np.random.default_rng(1)
    states, controls = random_motions(rng, 150)
    states[:20, 4:6] *= 1e-3
    states[20:25, 3] += 40.0  # faster than propellers of constant revolutions push
    # the cross-flow towards pure sway, towards pure yaw, and where it turns round at an end
    states[25:65, 5] *= 10.0 ** -rng.uniform(3, 16, 40)
    states[65:105, 4] *= 10.0 ** -rng.uniform(3, 16, 40)
    states[105:120, 4] = 0.5 * L * states[105:120, 5] * (1.0 + 1e-9 * rng.normal(size=15))
    states[120:130, 4], states[125:135, 5] = 0.0, 0.0
    own = {
        "yaw_radius": 0.22,
        "x_g": -3.0,
        "slipstream": 1.3,
        "straightening": 0.6,
        "drag_coefficient": 0.9,
    }
    for s in (ship, replace(ship, **own)):
        plain = np.array([plain_derivative(x, u, s) for x, u in zip(states, controls, strict=True)])
        compiled = ship_rates(states, controls, s.vector())
        np.testing.assert_allclose(compiled, plain, rtol=1e-9, atol=1e-11)


# --- equilibria and linear models -----------------------------------------------------------------


@each_ship
def test_a_steady_turn_is_an_equilibrium(ship: CorvetteParameters):
    turns = steady_turns(ship)
    zeros = np.zeros_like(turns.speed)
    state = upright(np.stack([zeros, zeros, zeros, turns.speed, turns.sway, turns.yaw_rate], -1))
    rates = corvette_rates(state, turns.rudder[:, None], np.zeros(len(AROUND)), ship.vector())[
        :, 3:6
    ]
    assert np.abs(rates[:, :2]).max() < 1e-8  # m/s2
    assert np.abs(rates[:, 2]).max() < 1e-10  # rad/s2


@each_ship
def test_faster_turns_are_tighter_slower_and_need_more_rudder(ship: CorvetteParameters):
    turns = steady_turns(ship)
    start = turns.yaw_rate[0], turns.speed[0], turns.sway[0], turns.rudder[0]
    np.testing.assert_allclose(start, [0.0, U, 0.0, 0.0], atol=1e-12)
    for falling in (turns.radius, turns.speed, turns.sway, -turns.rudder):
        assert (np.diff(falling) < 0.0).all()


@pytest.mark.parametrize(
    "change",
    [{}, {"rudder_area": 5.5}],
    ids=str,
)
def test_tightest_steady_turn_leaves_a_fifth_of_the_rudder(change):
    turns = steady_turns(replace(SHIP, **change))
    assert turns.rudder[-1] == pytest.approx(0.8 * SHIP.rudder_limit, abs=1e-6)


@each_ship
def test_the_jacobian_is_that_of_the_equations(ship: CorvetteParameters):
    states, controls = random_motions(np.random.default_rng(6), 20)
    found = ship.jacobian(np.column_stack([states[:, 3:6], controls[:, 0]]))
    columns, c = [], ship.vector()
    for of_state, of_control in ((3, None), (4, None), (5, None), (None, 0)):
        dx, du = (0.0 if i is None else 1e-5 * np.eye(8)[i] for i in (of_state, of_control))
        two = (ship_rates(states + k * dx, controls + k * du, c)[:, 3:6] for k in (1, -1))
        columns.append(np.subtract(*two) / 2e-5)
    expected = np.stack(columns, -1)
    np.testing.assert_allclose(found[..., :3], expected[..., :3], rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(found[..., 3], expected[..., 3], rtol=1e-6, atol=1e-7)


@each_ship
def test_the_secant_model_holds_every_steady_turn(ship: CorvetteParameters):
    dt, turns = 0.5, steady_turns(ship)
    A, B = secant_models(ship, dt)
    x = np.stack([turns.sway, turns.yaw_rate, np.zeros_like(turns.sway)], -1)
    after = (A @ x[..., None] + B * turns.rudder[:, None, None])[..., 0]
    np.testing.assert_allclose(after[:, 0], turns.sway, rtol=0, atol=1e-8)
    np.testing.assert_allclose(after[:, 1], turns.yaw_rate, rtol=0, atol=1e-10)
    np.testing.assert_allclose(after[:, 2], dt * turns.yaw_rate, rtol=0, atol=1e-10)


def test_secant_model_at_zero_rate_is_the_linearisation():
    dt = 0.5
    slopes, block = SHIP.jacobian(np.array([U, 0.0, 0.0, 0.0]))[1:, 1:], np.zeros((4, 4))
    block[:2, [0, 1, 3]], block[2, 1] = slopes, 1.0
    exact = expm(block * dt)
    A_table, B_table = secant_models(SHIP, dt)
    np.testing.assert_allclose(A_table[0], exact[:3, :3], rtol=0, atol=1e-12)
    np.testing.assert_allclose(B_table[0], exact[:3, 3:], rtol=0, atol=1e-12)


def test_filter_model_follows_the_commanded_turn_rate():
    model, turns = filter_model("corrected"), steady_turns(SHIP)
    A, B = secant_models(SHIP, 0.5)
    spacing = turns.yaw_rate[1]
    for k in (0, 1, 77, 164):
        for rate in (turns.yaw_rate[k] + 0.4 * spacing, -(turns.yaw_rate[k] + 0.4 * spacing)):
            u = np.array([[0.1, rate, 0.0]])
            np.testing.assert_array_equal(model.A(u)[0], A[k])
            np.testing.assert_array_equal(model.B(u)[0], np.hstack([B[k], np.zeros((3, 2))]))
    np.testing.assert_array_equal(
        model.A(np.array([0.1, 9.9, 0.0])), A[-1]
    )  # beyond the table: its end


@pytest.mark.parametrize("kind", ["corrected", "as_printed"])
def test_compass_and_yaw_increment_are_read_as_in_eq_4_5(kind):
    model = filter_model(kind)
    np.testing.assert_array_equal(model.C, [[0, 0, 1], [0, 0, 0]])
    np.testing.assert_array_equal(model.G, [[0], [0], [1]])
    np.testing.assert_array_equal(model.H, [[1], [1]])


def test_the_printed_model_is_eq_4_3_to_the_digit():
    model = filter_model("as_printed")
    A = [[0.4159, 0.1811, 0.0], [5.4795e-10, 1.0, 0.0], [0.0, 0.5, 1.0]]
    np.testing.assert_array_equal(model.A, A)
    np.testing.assert_array_equal(model.B[:, 0], [-2.6189e-7, 2.4075e-7, 0.0])
    np.testing.assert_array_equal(model.B[:, 1:], 0.0)


def test_the_printed_model_drops_the_identity_in_its_first_row():
    # Forward Euler of eq. 4.2 with 0.5 s gives eq. 4.3 but for that.
    A = np.array([[0.8318, 0.3622, 0.0], [1.0959e-9, 7.2702e-10, 0.0], [0.0, 1.0, 0.0]])
    b = np.array([-5.2378e-7, 4.8150e-7, 0.0])
    model = filter_model("as_printed")
    np.testing.assert_allclose(model.A, np.diag([0.0, 1.0, 1.0]) + 0.5 * A, rtol=2e-5, atol=1e-9)
    np.testing.assert_allclose(model.B[:, 0], 0.5 * b, rtol=1e-4)


# --- manoeuvres, by the standards of MSC.137(76) --------------------------------------------------


def test_turning_circle_meets_the_standard():
    found, radius, ratio = turning_circle(rates_of(SHIP), U, 35)
    np.testing.assert_allclose(
        [*np.array([*found, radius]) / L, ratio], [3.222, 1.800, 4.348, 2.204, 0.5972], atol=5e-4
    )
    assert found.advance < 4.5 * L
    assert found.tactical_diameter < 5.0 * L


# --- the vehicle as an environment uses it --------------------------------------------------------


def seen_by_filters(state: np.ndarray) -> np.ndarray:
    """What the thesis' filters estimate of states ``(..., 8)``."""
    return state[..., [VEHICLE.state_names.index(name) for name in VEHICLE.estimated("corrected")]]


def test_thesis_trial_starts_straight_whatever_the_prior():
    state, actuators = VEHICLE.start(np.random.default_rng(9).normal(size=(4, 3)))
    np.testing.assert_array_equal(
        state, np.tile([0.0, 0.0, 0.0, SHIP.speed, 0.0, 0.0, 0.0, 0.0], (4, 1))
    )
    np.testing.assert_array_equal(actuators, np.zeros((4, 1)))


def test_unknown_input_enters_the_thesis_filter_not_the_ship():
    """x+ = A x + B u + G d with y = C x + H d, and a record that was made without d."""
    model, sensors = filter_model("corrected"), sensors_of(VEHICLE)
    state, rudder = VEHICLE.start(np.zeros((1, 3)))
    c, d = VEHICLE.parameters(0.0, np.zeros((1, VEHICLE.normals))), np.array([[0.01]])
    x = seen_by_filters(state)[0]
    np.testing.assert_allclose(
        sensors.exact(state, d)[0], model.C @ x + model.H[:, 0] * 0.01, rtol=0, atol=1e-15
    )
    np.testing.assert_array_equal(
        VEHICLE.step(state, rudder, rudder, d, c), VEHICLE.step(state, rudder, rudder, 0.0 * d, c)
    )
    np.testing.assert_array_equal(model.G[:, 0], [0.0, 0.0, 1.0])


@pytest.mark.parametrize("steps", [1, 2])
def test_yaw_rate_from_two_headings_across_the_cut(steps: int):
    told = assumed(VEHICLE, "corrected", UnknownStep(), sensors_of(VEHICLE))
    now, before = np.array([[-3.1, 0.01], [0.3, 0.02]]), np.array([[3.1, 0.0], [0.2, 0.0]])
    x, d = without_a_filter(told, ("yaw increment",), now, before, steps)
    x = np.column_stack([x[:, :2], wrap(x[:, 2])])
    rates = np.array([2 * np.pi - 6.2, 0.1]) / (0.5 * steps)
    expected = [[0.0, rates[0], -3.1], [0.0, rates[1], 0.3]]
    np.testing.assert_allclose(x, expected, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(d, [[0.01], [0.02]], rtol=1e-14)
