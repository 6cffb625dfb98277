"""The PUNA: energy, trim, turns, gusts, the paper's own form, the contract of a vehicle."""

from dataclasses import replace

import numpy as np
import pytest
from sensing import assumed, exogenous, sensors_of, without_a_filter
from stepping import puna_step

from estimators import Model, wrap
from studies.papers.puna.model import PlanarPuna, planar_derivative
from vessel_gym.disturbances import Air
from vessel_gym.models.state_space import StateSpace
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.point_mass import COEFFICIENTS, UNCERTAIN, PointMass
from vessel_gym.vehicles.puna import STATE, Puna, airspeed, puna_rates, trim

BODY = load("puna")
C = BODY.vector()
VEHICLE = Puna()
SENSORS = sensors_of(VEHICLE)
DEG = np.pi / 180.0
MISSILE = PointMass(
    1005.0, 0.3376, (-1.9431, -0.1499, 0.2359), (21.9, 0.0), (3.312e-9, -1.142e-4, 1.224)
)
"""The one aircraft whose constants are published in the form of the PUNA's paper: the missile of Subchan & Zbikowski
(2009), that flies at 272 m/s. At the paper's 20 m/s it would need a lift coefficient of 119."""
AIR = Air(wind=3.0, gust=1.06, vertical_gust=0.7)


# In these tests a state is that of the literature, in wind axes ``(..., 10)``: x, y, altitude,
# airspeed, flight-path angle, course through the air, bank, wind north, east, down.


def random_states(rng: np.random.Generator, n: int) -> np.ndarray:
    """States ``(n, 10)`` over all that the aircraft can meet, and more."""
    low = np.array([-500.0, -500.0, 0.0, 8.0, -1.2, -7.0, -0.9, -5.0, -5.0, -2.0])
    high = np.array([500.0, 500.0, 300.0, 35.0, 1.2, 7.0, 0.9, 5.0, 5.0, 2.0])
    return rng.uniform(low, high, (n, 10))


def random_controls(rng: np.random.Generator, n: int) -> np.ndarray:
    return rng.uniform([0.0, -0.07, -0.6], [16.0, 0.2, 0.6], (n, 3))


def air_velocity(state: np.ndarray) -> np.ndarray:
    """Velocity through the air: north, east, down."""
    V, gamma, chi = state[..., 3], state[..., 4], state[..., 5]
    return np.stack(
        [V * np.cos(gamma) * np.cos(chi), V * np.cos(gamma) * np.sin(chi), -V * np.sin(gamma)], -1
    )


def ground_velocity(state: np.ndarray) -> np.ndarray:
    """Velocity over ground: north, east, down."""
    return air_velocity(state) + state[..., 7:]


def own_state(states: np.ndarray) -> np.ndarray:
    """The aircraft's own state ``(..., 7)``: position, velocity over ground, bank."""
    return np.concatenate(
        [states[..., :3], ground_velocity(states) * [1, 1, -1], states[..., 6:7]], -1
    )


def in_wind_axes(own: np.ndarray, wind: np.ndarray) -> np.ndarray:
    """States ``(..., 10)`` of own states and winds."""
    north, east, up = np.moveaxis(own[..., 3:6] - wind * [1, 1, -1], -1, 0)
    level = np.hypot(north, east)
    axes = np.stack([np.hypot(level, up), np.arctan2(up, level), np.arctan2(east, north)], -1)
    return np.concatenate(
        [own[..., :3], axes, own[..., 6:], np.broadcast_to(wind, own.shape[:-1] + (3,))], -1
    )


def axes_rates(states: np.ndarray, controls: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Rates ``(..., 10)`` of states by the vehicle's own equations and the chain rule, the wind constant."""
    rates = puna_rates(own_state(states), controls, states[..., 7:], c)
    (north, east, down), (along, across, up) = (
        np.moveaxis(air_velocity(states), -1, 0),
        np.moveaxis(rates[..., 3:6], -1, 0),
    )
    level, climb = np.hypot(north, east), -down
    level_rate = (north * along + east * across) / level
    V2 = level**2 + climb**2
    speed_rate, slope_rate = (
        (level * level_rate + climb * up) / np.sqrt(V2),
        (up * level - climb * level_rate) / V2,
    )
    axes = np.stack([speed_rate, slope_rate, (north * across - east * along) / level**2], -1)
    return np.concatenate(
        [rates[..., :3], axes, rates[..., 6:], np.zeros(rates.shape[:-1] + (3,))], -1
    )


def axes_step(
    states: np.ndarray, control: np.ndarray, c: np.ndarray, dt: float, substeps: int
) -> np.ndarray:
    """States ``(..., 10)`` after a step of the vehicle's; courses go on from those before."""
    wind = states[..., 7:]
    moved = in_wind_axes(puna_step(own_state(states), control, wind, c, dt, substeps), wind)
    moved[..., 5] = states[..., 5] + wrap(moved[..., 5] - states[..., 5])
    return moved


def energy(states: np.ndarray) -> np.ndarray:
    """Kinetic energy against the air and potential energy [J] of states ``(..., 10)``, ``(...)``."""
    return BODY.mass * (0.5 * states[..., 3] ** 2 + BODY.gravity * states[..., 2])


def split(winds: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """States of the air ``(..., 6)`` that make winds ``(..., 3)``, split anyhow into mean and gusts."""
    parts = rng.normal(size=winds.shape)
    z = np.concatenate([winds[..., :2] - parts[..., :2], parts], -1)
    return np.insert(z, 4, winds[..., 2] - np.sqrt(3.0) * parts[..., 2], axis=-1)


def level_flight(speed: float, bank: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """State ``(10,)`` and control ``(3,)`` of level flight at sea level, north, in still air."""
    steady = trim(speed, BODY, bank)
    state = np.zeros(10)
    state[[3, 6]] = speed, bank
    return state, np.array([steady.thrust, steady.alpha, bank])


# --- the compiled equations -----------------------------------------------------------------------


def test_velocity_changes_by_thrust_lift_drag_and_weight():
    """Newton in earth axes, from the vectors."""
    states, controls = (
        random_states(np.random.default_rng(0), 200),
        random_controls(np.random.default_rng(1), 200),
    )
    thrust, alpha = controls[:, 0], controls[:, 1]
    h, V, phi = states[:, 2], states[:, 3], states[:, 6]
    density = 4.319e-9 * h**2 - 1.176e-4 * h + 1.225
    pressure = 0.5 * density * V**2 * 0.75
    lift, drag = (
        pressure * (4.0203 * alpha + 0.08674),
        pressure * (1.0555 * alpha**2 + 0.07909 * alpha + 0.0197),
    )
    ahead = air_velocity(states) / V[:, None]
    starboard = np.cross([0.0, 0.0, 1.0], ahead)
    starboard /= np.linalg.norm(starboard, axis=-1, keepdims=True)
    above = np.cross(ahead, -starboard)
    normal = np.cos(phi)[:, None] * above + np.sin(phi)[:, None] * starboard
    force = (thrust * np.cos(alpha) - drag)[:, None] * ahead + (lift + thrust * np.sin(alpha))[
        :, None
    ] * normal
    acceleration = force / 3.364 + [0.0, 0.0, 9.81]

    rates = puna_rates(own_state(states), controls, states[:, 7:], C)
    np.testing.assert_allclose(rates[:, 3:6], acceleration * [1, 1, -1], rtol=0, atol=1e-11)
    np.testing.assert_allclose(
        rates[:, :3], ground_velocity(states) * [1, 1, -1], rtol=0, atol=1e-12
    )
    np.testing.assert_allclose(rates[:, 6], 2.0 * (controls[:, 2] - phi), rtol=1e-12)


def test_the_density_is_that_of_the_standard_atmosphere():
    h = np.linspace(-100.0, 1000.0, 12)
    standard = 1.225 * (1.0 - 0.0065 * h / 288.15) ** 4.25588  # ISO 2533
    np.testing.assert_allclose(np.polyval(BODY.density, h), standard, rtol=1e-4)
    assert np.polyval(BODY.density, np.linspace(-1e5, 1e5, 1001)).min() > 0.0


def test_without_thrust_and_drag_energy_is_conserved():
    c = replace(BODY, drag=(0.0, 0.0, 0.0)).vector()
    states = random_states(np.random.default_rng(2), 20)
    states[:, 2], states[:, 3:5], states[:, 7:] = 200.0, [20.0, 0.1], 0.0
    states[:, 4] = np.linspace(-0.3, 0.3, 20)
    control = np.tile([0.0, 0.03, 0.3], 2)
    after = states
    for _ in range(600):
        after = axes_step(after, control, c, 0.1, 1)
    np.testing.assert_allclose(energy(after), energy(states), rtol=1e-6)
    assert np.ptp(after[:, 3]) > 1.0  # it went up and down


# --- where the equations have poles ---------------------------------------------------------------


@pytest.mark.parametrize(
    "gamma", [np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-9, np.pi / 2 + 1e-9, np.pi, 5.0]
)
@pytest.mark.parametrize("speed", [0.0, 1e-12, 0.5, 20.0])
def test_vertical_flight_and_rest_stay_finite_and_bounded(gamma, speed):
    rng = np.random.default_rng(8)
    axes = random_states(rng, 20)
    axes[:, 3], axes[:, 4] = speed, gamma
    states, winds, controls = own_state(axes), axes[:, 7:], np.tile(random_controls(rng, 20), 2)
    slippery = (
        BODY.drag[2] - 0.25 * BODY.drag[1] ** 2 / BODY.drag[0]
    )  # the least coefficient of drag
    pull = BODY.mass * BODY.gravity + BODY.thrust_limit
    fastest = np.sqrt(2.0 * pull / (np.polyval(BODY.density, 500.0) * BODY.area * slippery))
    for _ in range(100):
        states = puna_step(states, controls, winds, C, 0.1, 4)
        states[:, 3:6] += 0.01 * rng.standard_normal((20, 3))
        assert np.isfinite(states).all()
        assert in_wind_axes(states, winds)[:, 3].max() < fastest
        assert np.isfinite(SENSORS.exact(states, exogenous(VEHICLE, winds))).all()


def test_a_tail_slide_turns_into_a_dive_with_the_same_velocity():
    state = np.array([0.0, 0.0, 100.0, 0.3, np.pi / 2, 0.2, 0.0, 1.0, 0.0, 0.0])
    after = axes_step(state, np.zeros(6), C, 0.1, 1)
    np.testing.assert_allclose(air_velocity(after), [0.0, 0.0, 0.981 - 0.3], rtol=0, atol=1e-3)
    assert after[4] == pytest.approx(-np.pi / 2, abs=1e-3)


# --- gusts ----------------------------------------------------------------------------------------


def test_a_steady_wind_shifts_the_track_and_nothing_else():
    rng = np.random.default_rng(10)
    states, controls = random_states(rng, 20), np.tile(random_controls(rng, 20), 2)
    states[:, 9] = 0.0  # an updraft carries it into thinner air
    still = states.copy()
    still[:, 7:] = 0.0
    drifted, straight = (axes_step(x, controls, C, 2.0, 20) for x in (states, still))
    np.testing.assert_allclose(
        drifted[:, :2] - straight[:, :2], 2.0 * states[:, 7:9], rtol=0, atol=1e-11
    )
    np.testing.assert_allclose(drifted[:, 2:7], straight[:, 2:7], rtol=0, atol=1e-11)
    c = replace(BODY, density=(0.0, 0.0, 1.2)).vector()
    states[:, 9] = 1.5
    rising, straight = (axes_step(x, controls, c, 2.0, 20) for x in (states, still))
    np.testing.assert_allclose(rising[:, 2] - straight[:, 2], -3.0, rtol=0, atol=1e-11)
    np.testing.assert_allclose(rising[:, 3:7], straight[:, 3:7], rtol=0, atol=1e-11)


# --- the step -------------------------------------------------------------------------------------


def test_one_step_is_converged_in_full_reversals():
    state, control = level_flight(20.0)
    state[2] = 100.0
    coarse, fine, actuators, slopes = state, state, control[None], []
    for k in range(300):
        side = 1.0 if k // 25 % 2 == 0 else -1.0
        after = VEHICLE.actuate(actuators, np.array([[side, 0.1 + 0.11 * side, -side]]))
        moving = np.concatenate([actuators, after], -1)[0]
        coarse, fine = axes_step(coarse, moving, C, 0.1, 1), axes_step(fine, moving, C, 0.1, 20)
        actuators = after
        slopes.append(fine[4])
    assert np.abs(slopes).max() > 40 * DEG
    np.testing.assert_allclose(coarse[:3], fine[:3], rtol=0, atol=0.03)
    np.testing.assert_allclose(coarse[3:], fine[3:], rtol=0, atol=2e-4)


# --- what the aircraft does -----------------------------------------------------------------------


@pytest.mark.parametrize(("speed", "alpha", "thrust"), [(15.0, 3.29, 2.87), (20.0, 1.32, 4.06)])
def test_level_flight_takes_the_angle_and_thrust_of_the_x8(speed, alpha, thrust):
    steady = trim(speed, BODY)
    assert steady.alpha / DEG == pytest.approx(alpha, rel=0.01)
    assert steady.thrust == pytest.approx(thrust, rel=0.01)


@pytest.mark.parametrize("speed", [10.0, 15.0, 20.0, 30.0])
def test_trimmed_flight_stays_as_it_is(speed):
    state, control = level_flight(speed)
    after = axes_step(state, np.tile(control, 2), C, 60.0, 600)
    np.testing.assert_allclose(after[2:], state[2:], rtol=0, atol=1e-7)
    np.testing.assert_allclose(after[:2], [60.0 * speed, 0.0], rtol=0, atol=1e-7)


def test_infeasible_level_flight_is_refused():
    with pytest.raises(ValueError, match="no level flight at 8 m/s: lift"):
        trim(8.0, BODY)
    with pytest.raises(ValueError, match=r"no level flight at 45 m/s: it takes 17\.\d N"):
        trim(45.0, BODY)
    assert trim(9.5, BODY).alpha < BODY.alpha_high
    with pytest.raises(ValueError, match=r"no level flight at 9\.5 m/s"):
        trim(9.5, BODY, bank=0.6)


def test_level_flight_is_stable():
    state, control = level_flight(20.0)
    moving, h = [2, 3, 4, 6], 1e-6  # position and course do not act back, altitude hardly
    offsets = h * np.eye(10)[moving]
    rates = [axes_rates(state + sign * offsets, control, C)[:, moving] for sign in (1, -1)]
    eigenvalues = np.linalg.eigvals(((rates[0] - rates[1]) / (2.0 * h)).T)
    assert eigenvalues.real.max() < 1e-3
    phugoid = np.abs(eigenvalues.imag).max()
    assert phugoid == pytest.approx(np.sqrt(2.0) * 9.81 / 20.0, rel=0.02)  # Lanchester


@pytest.mark.parametrize("bank", [10.0, -22.2, 30.0, 35.0])
@pytest.mark.parametrize("speed", [15.0, 20.0])
def test_a_level_coordinated_turn_has_the_radius_of_its_bank(speed, bank):
    bank *= DEG
    state, control = level_flight(speed, bank)
    radius = speed**2 / (9.81 * np.tan(bank))
    steps = 200
    period = 2.0 * np.pi * abs(radius) / speed
    track = [state]
    for _ in range(steps):
        track.append(axes_step(track[-1], np.tile(control, 2), C, period / steps, 1))
    track = np.array(track)
    np.testing.assert_allclose(np.hypot(track[:, 0], track[:, 1] - radius), abs(radius), rtol=1e-6)
    np.testing.assert_allclose(
        track[-1, [0, 1, 2, 3, 4]], state[[0, 1, 2, 3, 4]], rtol=0, atol=1e-4
    )
    assert track[-1, 5] == pytest.approx(np.sign(bank) * 2.0 * np.pi, rel=1e-6)


def test_bank_limit_holds_the_published_circle_in_tail_wind():
    in_still_air, in_tail_wind = np.arctan(np.array([20.0, 23.8]) ** 2 / (9.81 * 100.0)) / DEG
    assert in_still_air == pytest.approx(22.2, abs=0.05)
    assert in_tail_wind == pytest.approx(30.0, abs=0.05)
    assert BODY.bank_limit > 30 * DEG
    steady = trim(20.0, BODY, bank=BODY.bank_limit)
    assert steady.alpha < 0.5 * BODY.alpha_high
    assert steady.thrust < 0.5 * BODY.thrust_limit


def test_all_thrust_climbs_at_20_degrees():
    steady = trim(20.0, BODY)
    state = level_flight(20.0)[0]
    state[4] = 20 * DEG
    rates = axes_rates(state, np.array([BODY.thrust_limit, steady.alpha, 0.0]), C)
    assert rates[3] == pytest.approx(0.2, abs=0.2)


# --- the paper's own form -------------------------------------------------------------------------


def test_paper_form_without_angle_of_attack_is_planar_flight():
    states, controls = (
        random_states(np.random.default_rng(11), 100),
        random_controls(np.random.default_rng(12), 100),
    )
    states[:, [5, 6, 7, 8, 9]] = 0.0
    controls[:, 1:] = 0.0
    planar = planar_derivative(states[:, [4, 3, 0, 2]], controls[:, :2], C)
    np.testing.assert_allclose(
        planar, axes_rates(states, controls, C)[:, [4, 3, 0, 2]], rtol=0, atol=1e-12
    )


def test_paper_form_is_equation_1_with_lift_along_the_body():
    rng = np.random.default_rng(13)
    gamma, v, x, h = rng.uniform([-1.0, 10.0, 0.0, 0.0], [1.0, 30.0, 100.0, 200.0], (50, 4)).T
    T, alpha = rng.uniform([0.0, -0.1], [16.0, 0.2], (50, 2)).T
    m, g = 3.364, 9.81
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
    standard = np.zeros((50, 10))
    standard[:, [4, 3, 0, 2]] = state
    ours = axes_rates(standard, np.stack([T, alpha, 0.0 * T], -1), C)
    np.testing.assert_allclose(
        ours[:, 3] - printed[:, 1], L * np.sin(alpha) / m, rtol=0, atol=1e-12
    )  # brakes twice


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


def told(noise: float = 1.0, how: str | None = None, air: Air = AIR) -> tuple[StateSpace, Model]:
    """What filters are told of the aircraft in an air, with so many times the sensors' nominal noise."""
    return assumed(VEHICLE, "nonlinear", air, sensors_of(VEHICLE, noise), how)


AROUND = (
    "mean wind north", "mean wind east", "gust north", "gust east", "gust down 1", "gust down 2",
    "bias x", "bias y", "bias h",
)  # fmt: skip
"""What filters estimate besides the aircraft's own state."""


def test_the_start_is_trimmed_for_20_m_s():
    _, actuators = VEHICLE.start(np.zeros((4, 7)))
    np.testing.assert_allclose(actuators, np.tile(level_flight(20.0)[1], (4, 1)))
    actuators += 1.0  # a copy
    np.testing.assert_allclose(BODY.cruise, level_flight(20.0)[1])


def test_actions_reach_from_limit_to_limit_and_0_is_cruising():
    np.testing.assert_allclose(BODY.commands(np.zeros(3)), BODY.cruise)
    np.testing.assert_allclose(BODY.commands(-np.ones(3)), [0.0, -4 * DEG, -35 * DEG], atol=1e-15)
    np.testing.assert_allclose(BODY.commands(np.ones(3)), [16.0, 12 * DEG, 35 * DEG])
    actions = np.random.default_rng(22).uniform(-1.0, 1.0, (50, 3))
    np.testing.assert_allclose(BODY.actions(BODY.commands(actions)), actions, atol=1e-14)
    assert (
        np.diff(BODY.commands(np.linspace(-1.0, 1.0, 41)[:, None] * np.ones(3)), axis=0) > 0.0
    ).all()


def test_angle_of_attack_moves_at_its_rate_between_its_limits():
    actuators, track = np.array([[2.0, 0.02, 0.0], [2.0, 0.02, 0.0]]), []
    for _ in range(6):
        actuators = VEHICLE.actuate(actuators, np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]))
        track.append(actuators[:, 1])
    up, down = np.array(track).T
    steps = 0.05 * np.arange(1, 7)
    np.testing.assert_allclose(up, np.minimum(0.02 + steps, 12 * DEG), rtol=1e-12)
    np.testing.assert_allclose(down, np.maximum(0.02 - steps, -4 * DEG), rtol=1e-12)


def test_bank_is_commanded_at_once_and_lags_itself():
    actuators = VEHICLE.actuate(
        np.zeros((3, 3)), np.array([[0.0, 0.0, a] for a in (-1.0, 0.5, 1.0)])
    )
    np.testing.assert_allclose(actuators[:, 2], np.array([-35.0, 17.5, 35.0]) * DEG)
    state, control = level_flight(20.0)
    control[2] = BODY.bank_limit
    for _ in range(100):
        state = axes_step(state, np.tile(control, 2), C, 0.1, 1)
        assert state[6] <= BODY.bank_limit
    assert state[6] == pytest.approx(BODY.bank_limit)


def test_thrust_lags_exponentially_between_none_and_all():
    actuators = np.tile([2.0, 0.0, 0.0], (2, 1))
    for _ in range(7):
        actuators = VEHICLE.actuate(actuators, np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]))
    decay = np.exp(-0.7 / BODY.thrust_lag)
    np.testing.assert_allclose(actuators[:, 0], [16.0 - 14.0 * decay, 2.0 * decay], rtol=1e-12)


def test_the_state_in_wind_axes_is_what_it_was_made_of():
    rng = np.random.default_rng(23)
    states = random_states(rng, 100)
    states[:, 5] = wrap(states[:, 5])
    own, air = own_state(states), split(states[:, 7:], rng)
    np.testing.assert_allclose(AIR.effect(air, own), states[:, 7:], rtol=0, atol=1e-14)
    np.testing.assert_allclose(in_wind_axes(own, states[:, 7:]), states, rtol=0, atol=1e-10)
    np.testing.assert_allclose(airspeed(own, states[:, 7:]), states[:, 3], rtol=0, atol=1e-10)


def test_wing_load_is_limited():
    fast = np.zeros((1, 7))
    fast[:, 3] = 200.0
    moved = puna_step(fast, np.tile([0.0, 0.2, 0.0], 2), np.zeros(3), C, 0.01, 1)
    assert moved[0, 5] == pytest.approx((200.0 - 9.81) * 0.01, rel=0.02)


def test_puna_sensors_read_ground_velocity_and_gnss_bias():
    rng = np.random.default_rng(16)
    states = random_states(rng, 50)
    own, bias = own_state(states), rng.normal(size=(50, 3))
    north, east, down = ground_velocity(states).T
    plain = np.stack([
        *(states[:, :3] + bias).T, np.hypot(north, east), np.angle(north + 1j * east), -down, states[:, 2],
        states[:, 3], states[:, 6],
    ], -1)  # fmt: skip
    incremented = np.hstack(
        [np.ones((50, 4)), states[:, 7:]]
    )  # increments act later and are not seen
    np.testing.assert_allclose(SENSORS.exact(own, incremented, bias), plain, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(SENSORS.bias.advance(bias), bias)


def test_exact_measurements_give_the_state_in_along_wind():
    states = random_states(np.random.default_rng(17), 20)
    states[:, 3] = np.maximum(states[:, 3], 12.0)
    along = np.random.default_rng(25).uniform(-3.0, 3.0, 20)
    states[:, 7], states[:, 8], states[:, 9] = (
        along * np.cos(states[:, 5]),
        along * np.sin(states[:, 5]),
        0.0,
    )
    own = own_state(states)
    measurements = SENSORS.exact(own, exogenous(VEHICLE, states[:, 7:]))
    whole = np.hstack([own, states[:, 7:9], np.zeros((20, 7))])  # the wind is taken for a mean one
    known = SENSORS.states_from(measurements)
    given = [known.get(name, np.zeros(20)) for name in told()[0].names]
    np.testing.assert_allclose(np.stack(given, -1), whole, rtol=0, atol=1e-10)
    x, d = without_a_filter(told(), VEHICLE.increments, measurements)
    np.testing.assert_allclose(x, whole, rtol=0, atol=1e-10)
    np.testing.assert_array_equal(d, np.zeros((20, 4)))


def test_extreme_measurements_give_finite_states():
    measurements = np.array(
        [[0.0] * 9, [1e3, -1e3, 1e3, -5.0, 4.0, 30.0, -10.0, -3.0, 2.0], [1e300] * 9, [-1e300] * 9]
    )
    known = SENSORS.states_from(measurements)
    assert all(np.isfinite(values).all() for values in known.values())
    assert all(values[0] == 0.0 for values in known.values())
    assert set(known) >= {*STATE, *AROUND[:2]}
    x, _ = without_a_filter(told(), VEHICLE.increments, measurements)
    assert np.isfinite(x).all()
    np.testing.assert_array_equal(x[0], 0.0)


# --- mismatch -------------------------------------------------------------------------------------


def test_mismatch_scales_what_is_uncertain_and_nothing_else():
    kinds = {
        "lift": {"lift_1", "lift_0"}, "drag of the angle of attack": {"drag_2", "drag_1"},
        "drag at zero angle": {"drag_0"}, "mass": {"mass"}, "thrust": {"thrust"}, "bank": {"bank_rate"},
    }  # fmt: skip
    assert set(kinds) == set(UNCERTAIN)
    for i, kind in enumerate(UNCERTAIN):
        normals = np.zeros((2, VEHICLE.normals))
        normals[:, i] = [1.0, 5.0]  # clipped at 2
        ratio = VEHICLE.parameters(0.1, normals) / C
        for j, name in enumerate(COEFFICIENTS):
            np.testing.assert_allclose(
                ratio[:, j], [1.1, 1.2] if name in kinds[kind] else 1.0, rtol=1e-12
            )


def test_thrust_in_the_truth_is_as_strong_as_its_factor():
    normals = np.zeros((1, VEHICLE.normals))
    normals[0, UNCERTAIN.index("thrust")] = 1.0
    state, control = level_flight(20.0)
    weak = VEHICLE.parameters(-0.2, normals)[0]
    np.testing.assert_allclose(
        axes_rates(state, control, weak),
        axes_rates(state, control * [0.8, 1.0, 1.0], C),
        rtol=1e-12,
    )
