"""The PUNA: Newton's equations, trim, turns, wind, the paper's own form, sensors."""

from dataclasses import replace

import numpy as np
import pytest
from sensing import assumed, exogenous, sensors_of, without_a_filter
from stepping import puna_step

from agents.papers.puna.model import PlanarPuna, planar_derivative
from vessel_gym.disturbances import Air
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.puna import (
    UNCERTAIN,
    Puna,
    PunaParameters,
    airspeed,
    printed_rates,
    puna_rates,
    trim,
)

BODY = load("puna")
C = BODY.vector()
VEHICLE = Puna()
SENSORS = sensors_of(VEHICLE)
DEG = np.pi / 180.0
MISSILE = PunaParameters(
    mass=1005.0,
    area=0.3376,
    drag=(-1.9431, -0.1499, 0.2359),
    lift=(21.9, 0.0),
    density=(3.312e-9, -1.142e-4, 1.224),
    cruise_speed=272.0,
    thrust_limit=6000.0,
)
"""The one aircraft whose constants are published in the form of the PUNA's paper: the missile of Subchan & Zbikowski
(2009), that flies at 272 m/s. At the paper's 20 m/s it would need a lift coefficient of 119."""
AIR = Air(wind=3.0, gust=1.06, vertical_gust=0.7)


UP = np.array([1.0, 1.0, -1.0])
"""Signs of north, east and up against north, east and down."""


def random_flights(seed: int, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """States ``(n, 7)``, velocities through the air (north, east, down), winds and controls ``(n, 3)``.

    Over all that the aircraft can meet, and more.
    """
    rng = np.random.default_rng(seed)
    position = rng.uniform([-500.0, -500.0, 0.0], [500.0, 500.0, 300.0], (n, 3))
    V, gamma, chi = rng.uniform([8.0, -1.2, -7.0], [35.0, 1.2, 7.0], (n, 3)).T
    level, down = V * np.cos(gamma), -V * np.sin(gamma)
    air = np.stack([level * np.cos(chi), level * np.sin(chi), down], -1)
    wind, bank = rng.uniform(-1.0, 1.0, (n, 3)) * [5.0, 5.0, 2.0], rng.uniform(-0.9, 0.9, (n, 1))
    controls = rng.uniform([0.0, -0.07, -0.6], [16.0, 0.2, 0.6], (n, 3))
    return np.concatenate([position, (air + wind) * UP, bank], -1), air, wind, controls


def level_flight(speed: float, bank: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """State ``(7,)`` and control ``(3,)`` of level flight at sea level, north and in still air."""
    steady = trim(speed, BODY, bank)
    state = np.array([0.0, 0.0, 0.0, speed, 0.0, 0.0, bank])
    return state, np.array([steady.thrust, steady.alpha, bank])


# --- the compiled equations -----------------------------------------------------------------------


def test_velocity_changes_by_thrust_lift_drag_and_weight():
    """Newton in earth axes, from the vectors."""
    states, air, wind, controls = random_flights(0, 200)
    thrust, alpha, commanded = controls.T
    h, phi, V = states[:, 2], states[:, 6, None], np.linalg.norm(air, axis=-1)
    density = 4.319e-9 * h**2 - 1.176e-4 * h + 1.225
    pressure = 0.5 * density * V**2 * 0.75
    lift = pressure * (4.0203 * alpha + 0.08674)
    drag = pressure * (1.0555 * alpha**2 + 0.07909 * alpha + 0.0197)
    ahead = air / V[:, None]
    starboard = np.cross([0.0, 0.0, 1.0], ahead)
    starboard /= np.linalg.norm(starboard, axis=-1, keepdims=True)
    normal = np.cos(phi) * np.cross(ahead, -starboard) + np.sin(phi) * starboard
    along, across = thrust * np.cos(alpha) - drag, lift + thrust * np.sin(alpha)
    acceleration = (along[:, None] * ahead + across[:, None] * normal) / 3.364 + [0.0, 0.0, 9.81]
    expected = np.concatenate(
        [(air + wind) * UP, acceleration * UP, 2.0 * (commanded[:, None] - phi)], -1
    )
    rates = puna_rates(states, controls, wind, C)
    np.testing.assert_allclose(rates, expected, rtol=0, atol=1e-11)


def test_the_density_is_that_of_the_standard_atmosphere():
    h = np.linspace(-100.0, 1000.0, 12)
    standard = 1.225 * (1.0 - 0.0065 * h / 288.15) ** 4.25588  # ISO 2533
    np.testing.assert_allclose(np.polyval(BODY.density, h), standard, rtol=1e-4)
    assert np.polyval(BODY.density, np.linspace(-1e5, 1e5, 1001)).min() > 0.0


@pytest.mark.parametrize("speed", [0.0, 1e-12, 0.5, -20.0, 20.0])
def test_vertical_flight_and_rest_stay_finite_and_bounded(speed: float):
    rng, (states, _, winds, controls) = np.random.default_rng(8), random_flights(8, 20)
    states[:, 3:6] = (winds + [0.0, 0.0, speed]) * UP
    slippery = BODY.drag[2] - 0.25 * BODY.drag[1] ** 2 / BODY.drag[0]  # least coefficient of drag
    pull = BODY.mass * BODY.gravity + BODY.thrust_limit
    fastest = np.sqrt(2.0 * pull / (np.polyval(BODY.density, 500.0) * BODY.area * slippery))
    for _ in range(100):
        states = puna_step(states, np.tile(controls, 2), winds, C, 0.1, 4)
        states[:, 3:6] += 0.01 * rng.standard_normal((20, 3))
        assert airspeed(states, winds).max() < fastest  # False for NaN, too
        assert np.isfinite(SENSORS.exact(states, exogenous(VEHICLE, winds))).all()


def test_wing_load_is_limited():
    fast = np.eye(1, 7, 3) * 200.0
    moved = puna_step(fast, np.tile([0.0, 0.2, 0.0], 2), np.zeros(3), C, 0.01, 1)
    assert moved[0, 5] == pytest.approx((200.0 - 9.81) * 0.01, rel=0.02)


def test_a_steady_wind_shifts_the_track_and_nothing_else():
    states, air, wind, controls = random_flights(10, 20)
    c = replace(BODY, density=(0.0, 0.0, 1.2)).vector()  # no thinner where an updraft carries it
    still = np.concatenate([states[:, :3], air * UP, states[:, 6:]], -1)
    drifted, straight = (
        puna_step(x, np.tile(controls, 2), flow, c, 2.0, 20)
        for x, flow in ((states, wind), (still, 0.0 * wind))
    )
    shift = np.concatenate([2.0 * wind * UP, wind * UP, np.zeros((20, 1))], -1)
    np.testing.assert_allclose(drifted - straight, shift, rtol=0, atol=1e-11)


# --- what the aircraft does -----------------------------------------------------------------------


@pytest.mark.parametrize(("speed", "alpha", "thrust"), [(15.0, 3.29, 2.87), (20.0, 1.32, 4.06)])
def test_level_flight_takes_the_angle_and_thrust_of_the_x8(speed, alpha, thrust):
    steady = trim(speed, BODY)
    assert steady.alpha / DEG == pytest.approx(alpha, rel=0.01)
    assert steady.thrust == pytest.approx(thrust, rel=0.01)


@pytest.mark.parametrize("speed", [10.0, 20.0, 30.0])
def test_trimmed_flight_stays_as_it_is(speed: float):
    state, control = level_flight(speed)
    after = puna_step(state, np.tile(control, 2), np.zeros(3), C, 60.0, 600)
    np.testing.assert_allclose(after, state + 60.0 * speed * np.eye(7)[0], rtol=0, atol=1e-7)


# --- the paper's own form -------------------------------------------------------------------------


def test_paper_form_is_equation_1_with_lift_along_the_body():
    rng = np.random.default_rng(13)
    gamma, v, x, h = rng.uniform([-1.0, 10.0, 0.0, 0.0], [1.0, 30.0, 100.0, 200.0], (50, 4)).T
    T, alpha = rng.uniform([0.0, -0.1], [16.0, 0.2], (50, 2)).T
    m, g, zero = 3.364, 9.81, np.zeros(50)
    rho = 4.319e-9 * h**2 - 1.176e-4 * h + 1.225
    D = 0.5 * (1.0555 * alpha**2 + 0.07909 * alpha + 0.0197) * rho * v**2 * 0.75
    L = 0.5 * rho * v**2 * 0.75 * (4.0203 * alpha + 0.08674)
    printed = np.stack([
        T * np.sin(alpha) / (m * v) + L * np.cos(alpha) / (m * v) - g * np.cos(gamma) / v,
        (T * np.cos(alpha) - D) / m - L * np.sin(alpha) / m - g * np.sin(gamma),
        v * np.cos(gamma),
        v * np.sin(gamma),
    ], -1)  # fmt: skip
    state, control = np.stack([gamma, v, x, h], -1), np.stack([T, alpha], -1)
    np.testing.assert_allclose(
        planar_derivative(state, control, C), printed, rtol=1e-12, atol=1e-12
    )
    np.testing.assert_allclose(
        PlanarPuna().step(state, control), state + 0.01 * printed, rtol=1e-12
    )
    own = np.stack([x, zero, h, v * np.cos(gamma), zero, v * np.sin(gamma), zero], -1)
    rates = puna_rates(own, np.stack([T, alpha, zero], -1), np.zeros(3), C)
    faster = np.cos(gamma) * rates[:, 3] + np.sin(gamma) * rates[:, 5]
    np.testing.assert_allclose(
        faster - printed[:, 1], L * np.sin(alpha) / m, rtol=0, atol=1e-12
    )  # brakes twice


def test_as_printed_the_aircraft_in_a_plane_has_equation_1():
    rng = np.random.default_rng(14)
    gamma, v, h = rng.uniform([-1.0, 10.0, 0.0], [1.0, 30.0, 200.0], (50, 3)).T
    thrust, alpha = rng.uniform([0.0, -0.1], [16.0, 0.2], (50, 2)).T
    zero = np.zeros(50)
    own = np.stack([zero, zero, h, v * np.cos(gamma), zero, v * np.sin(gamma), zero], -1)
    rates = printed_rates(own, np.stack([thrust, alpha, zero], -1), np.zeros(3), C)
    forward, upward = rates[:, 3], rates[:, 5]
    planar = np.stack([gamma, v, zero, h], -1), np.stack([thrust, alpha], -1)
    turning, faster = planar_derivative(*planar, C, as_printed=True).T[:2]
    along = np.cos(gamma) * forward + np.sin(gamma) * upward
    across = np.cos(gamma) * upward - np.sin(gamma) * forward
    np.testing.assert_allclose(along, faster, rtol=0, atol=1e-12)
    np.testing.assert_allclose(across / v, turning, rtol=0, atol=1e-12)


def test_published_missile_cannot_fly_at_20_m_s():
    weight = MISSILE.mass * MISSILE.gravity
    pressure = 0.5 * MISSILE.density[2] * MISSILE.area
    assert weight / (pressure * 20.0**2) == pytest.approx(
        119.0, abs=0.5
    )  # the lift coefficient it would need
    falling = np.array([0.0, 20.0, 0.0, 1000.0])
    for alpha in np.linspace(0.0, np.pi / 2, 19):
        assert planar_derivative(falling, np.array([0.0, alpha]), MISSILE.vector())[0] < 0.0
    fast = np.array([0.0, 272.0, 0.0, 30.0])
    assert planar_derivative(fast, np.array([6000.0, 0.05]), MISSILE.vector())[0] > 0.0
    flown = PlanarPuna(MISSILE).step(falling, np.array([0.0, 0.1]))
    assert flown[3] == 1000.0  # forward Euler: gamma first
    assert flown[0] < 0.0
    assert PlanarPuna().body == BODY


# --- the vehicle in an environment ----------------------------------------------------------------


def test_actions_reach_from_limit_to_limit_and_0_is_cruising():
    np.testing.assert_allclose(BODY.commands(np.zeros(3)), level_flight(20.0)[1])
    np.testing.assert_allclose(BODY.commands(-np.ones(3)), [0.0, -4 * DEG, -35 * DEG], atol=1e-15)
    np.testing.assert_allclose(BODY.commands(np.ones(3)), [16.0, 12 * DEG, 35 * DEG])
    actions = np.random.default_rng(22).uniform(-1.0, 1.0, (50, 3))
    np.testing.assert_allclose(BODY.actions(BODY.commands(actions)), actions, atol=1e-14)
    np.testing.assert_allclose(VEHICLE.start(np.zeros((4, 7)))[1], np.tile(BODY.cruise, (4, 1)))


def test_puna_sensors_read_ground_velocity_and_gnss_bias():
    states, air, wind, _ = random_flights(16, 50)
    bias = np.random.default_rng(16).normal(size=(50, 3))
    north, east, down = (air + wind).T
    plain = np.stack([
        *(states[:, :3] + bias).T, np.hypot(north, east), np.angle(north + 1j * east), -down, states[:, 2],
        np.linalg.norm(air, axis=-1), states[:, 6],
    ], -1)  # fmt: skip
    incremented = np.hstack([np.ones((50, 4)), wind])  # increments act later and are not seen
    np.testing.assert_allclose(SENSORS.exact(states, incremented, bias), plain, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(SENSORS.bias.advance(bias), bias)


def test_exact_measurements_give_the_state_in_along_wind():
    states, air, _, _ = random_flights(17, 20)
    wind = np.random.default_rng(25).uniform(-0.3, 0.3, (20, 1)) * air * [1.0, 1.0, 0.0]
    states[:, 3:6] = (air + wind) * UP
    measurements = SENSORS.exact(states, exogenous(VEHICLE, wind))
    whole = np.hstack([states, wind[:, :2], np.zeros((20, 7))])  # the wind is taken for a mean one
    told = assumed(VEHICLE, "nonlinear", AIR, SENSORS)
    x, d = without_a_filter(told, VEHICLE.increments, measurements)
    np.testing.assert_allclose(x, whole, rtol=0, atol=1e-10)
    np.testing.assert_array_equal(d, np.zeros((20, 4)))


def test_thrust_in_the_truth_is_as_strong_as_its_factor():
    normals = np.eye(1, VEHICLE.normals, UNCERTAIN.index("thrust"))
    (state, control), still = level_flight(20.0), np.zeros(3)
    weak = puna_rates(state, control, still, VEHICLE.parameters(-0.2, normals)[0])
    weaker = puna_rates(state, control * [0.8, 1.0, 1.0], still, C)
    np.testing.assert_allclose(weak, weaker, rtol=1e-12)
