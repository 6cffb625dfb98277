"""Waves, gusts and current: stationary, with the spectrum and the sizes that they claim."""

from dataclasses import replace

import numpy as np
import pytest
from contract import OURS, make_core
from heading_ship import SEAS
from scipy.integrate import quad
from scipy.linalg import block_diag, expm
from sensing import sensors_of

from vessel_gym.disturbances import Air, Disturbance, Fault, Sea, SurfaceWater, Water
from vessel_gym.disturbances.spectrum import WaveSpectrum, WaveSystem
from vessel_gym.models.state_space import StateSpace
from vessel_gym.sensors.sensor import Bias
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.ship import Ship

every_sea = pytest.mark.parametrize("sea", SEAS.values(), ids=SEAS)


def transition_and_noise(disturbance: Disturbance) -> tuple[np.ndarray, np.ndarray]:
    """A and Q of ``z+ = A z + w`` as states are advanced."""
    process = disturbance.process
    return process.advance(np.eye(process.size)).T, process.root @ process.root.T


def yaw_increment_var(sea: Sea) -> float:
    """Stationary variance of the yaw increment that a sea gives a ship in a step."""
    ship = Ship(dt=sea.dt)
    return StateSpace.of_world(ship, sea, sensors_of(ship)).cov[0, 0]


# --- exact ----------------------------------------------------------------------------------------


@every_sea
def test_the_stationary_covariance_is_what_the_sizes_say(sea):
    P = sea.process.start_cov
    np.testing.assert_allclose(np.diag(P)[[1, 2]], [sea.wave**2, sea.gust**2], rtol=1e-12)
    assert P[3, 3] + P[4, 4] == pytest.approx(sea.current**2)  # RMS of the current's speed
    assert P[3, 3] == P[4, 4]
    assert P[0, 0] == pytest.approx(
        (sea.wave / sea.peak) ** 2
    )  # yaw angle of a narrow band about the peak
    np.testing.assert_allclose(P[~np.eye(5, dtype=bool)], 0.0, atol=1e-18)


@pytest.mark.parametrize(
    ("name", "sd", "digit"),
    [("calm", 5e-4, 1e-4), ("moderate", 3.6e-3, 1e-4), ("rough", 9e-3, 1e-3)],
)
def test_yaw_increment_of_a_step_has_its_chosen_size(name, sd, digit):
    sea = SEAS[name]
    assert np.sqrt(yaw_increment_var(sea)) == pytest.approx(sd, abs=0.5 * digit)
    P = sea.process.start_cov
    assert yaw_increment_var(sea) == pytest.approx(
        0.25 * (P[1, 1] + 2 * P[1, 2] + P[2, 2]), rel=1e-12
    )


def test_unknown_input_is_yaw_rate_of_waves_and_gusts():
    state = np.random.default_rng(0).normal(size=(4, 3, 5))
    exogenous = SEAS["rough"].effect(state, np.zeros((4, 3, 6)))
    assert exogenous.shape == (4, 3, 3)
    np.testing.assert_allclose(exogenous[..., 0], 0.5 * (state[..., 1] + state[..., 2]))
    np.testing.assert_array_equal(exogenous[..., 1:], state[..., 3:])


def test_gust_and_current_decay_with_their_time_constants():
    sea = Sea(
        wave=0.01, peak=0.8, gust=0.01, current=0.5, gust_time=12.0, current_time=800.0, dt=0.4
    )
    state = np.array([0.0, 0.0, 1.0, 1.0, -2.0])
    for _ in range(30):  # 12 s
        state = sea.process.advance(state)
    decay = np.exp(-12.0 / 800.0)
    np.testing.assert_allclose(
        state, [0.0, 0.0, np.exp(-1.0), decay, -2.0 * decay], rtol=1e-12, atol=1e-15
    )


def test_the_wave_yaw_rate_is_the_rate_of_the_wave_yaw_angle():
    sea = SEAS["rough"]
    fine = replace(sea, dt=1e-4)
    state = np.array([0.02, 0.01, 0.0, 0.0, 0.0])
    after = fine.process.advance(state)
    assert (after[0] - state[0]) / 1e-4 == pytest.approx(0.01, abs=1e-5)
    rate = -(sea.peak**2) * 0.02 - 2 * sea.damping * sea.peak * 0.01
    assert (after[1] - state[1]) / 1e-4 == pytest.approx(rate, rel=1e-3)


# --- under water ----------------------------------------------------------------------------------

WATER = Water(
    turbulence=0.01,
    spin=0.002,
    current=0.2,
    velocities=("u", "w"),
    rates=("q",),
    current_time=50.0,
    dt=0.1,
)


def test_the_water_adds_to_every_velocity_as_it_says():
    assert WATER.white_increments == ("u increment", "w increment", "q increment")
    np.testing.assert_allclose(WATER.white, np.sqrt(0.1) * np.diag([0.01, 0.01, 0.002]), rtol=1e-15)
    state = np.random.default_rng(0).normal(size=(4, 2))
    np.testing.assert_array_equal(WATER.effect(state, np.zeros((4, 6))), state)


# --- in the air -----------------------------------------------------------------------------------

AIR = Air(wind=3.0, gust=1.06, vertical_gust=0.7)


def dryden(length: float, sd: float, vertical: bool, airspeed: float, lag: float) -> float:
    """Covariance of a gust and itself ``lag`` seconds later, from its one-sided spectrum in MIL-F-8785C."""
    time = length / airspeed

    def spectrum(omega: float) -> float:
        square = (time * omega) ** 2
        if vertical:
            return sd**2 * time / np.pi * (1.0 + 3.0 * square) / (1.0 + square) ** 2
        return 2.0 * sd**2 * time / np.pi / (1.0 + square)

    return (
        quad(spectrum, 0.0, np.inf, weight="cos", wvar=lag)[0]
        if lag
        else quad(spectrum, 0.0, np.inf)[0]
    )


def gusts_by_state(air: Air) -> np.ndarray:
    """The matrix ``(3, 4)`` from the gusts' state to the gusts, where no mean wind blows."""
    return air.effect(np.eye(6)[2:], np.zeros((4, 7))).T


def gusts_of(air: Air) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Transition, noise and stationary covariance ``(4, 4)`` of the gusts, of which the mean wind knows nothing."""
    A, Q = transition_and_noise(air)
    whole = A, Q, air.process.start_cov
    for matrix in whole:
        assert not matrix[:2, 2:].any()
        assert not matrix[2:, :2].any()
    return tuple(matrix[2:, 2:] for matrix in whole)


@pytest.mark.parametrize(
    "air", [AIR, replace(AIR, airspeed=14.0, length=120.0, vertical_length=80.0, dt=0.25)]
)
def test_gusts_have_the_dryden_spectra(air):
    """Their covariance at every lag is the transform of the spectrum, and they do not know of each other."""
    C, (A, _, P) = gusts_by_state(air), gusts_of(air)
    for steps in (0, 1, 7, 30, 100):
        covariance = C @ np.linalg.matrix_power(A, steps) @ P @ C.T
        lag = steps * air.dt
        level = dryden(air.length, air.gust, False, air.airspeed, lag)
        down = dryden(air.vertical_length, air.vertical_gust, True, air.airspeed, lag)
        np.testing.assert_allclose(covariance, np.diag([level, level, down]), rtol=0, atol=2e-6)


def test_the_wind_decays_as_slowly_as_the_aircraft_crosses_it():
    A, _ = transition_and_noise(AIR)
    np.testing.assert_allclose(A[:2, :2], np.exp(-0.1 / 200.0) * np.eye(2))
    np.testing.assert_allclose(
        A[2:4, 2:4], np.exp(-0.1 / 10.0) * np.eye(2), atol=1e-15
    )  # 200 m at 20 m/s
    assert not A[2:4, 4:].any()
    assert not A[4:, 2:4].any()
    vertical = np.array([[0.0, 1.0], [-1.0, -2.0]]) / 2.5  # 50 m at 20 m/s
    np.testing.assert_allclose(A[4:, 4:], expm(0.1 * vertical), rtol=1e-12)


def test_the_wind_down_is_positive_down_and_the_mean_wind_level():
    wind = AIR.effect(np.array([1.0, 2.0, 0.1, 0.2, 0.5, 1.0]), np.zeros(7))
    np.testing.assert_allclose(wind, [1.1, 2.2, 0.5 + np.sqrt(3.0)])


# --- steps of any length --------------------------------------------------------------------------


SURFACE = SurfaceWater(
    WaveSpectrum.of_systems(WaveSystem(height=0.88, period=7.5)), WATER, place=(6, 7), down=8
)
FAULT = Fault("rudder", start=0.02, walk=0.01, amplitude=0.1, beside=WATER)
BY_STEP = {
    **{f"{name} sea": (sea, replace(sea, dt=0.25)) for name, sea in SEAS.items()},
    "water": (WATER, replace(WATER, dt=0.05)),
    "water below waves": (
        SURFACE.modelled,
        replace(SURFACE, beside=replace(WATER, dt=0.05)).modelled,
    ),
    "air": (AIR, replace(AIR, dt=0.05)),
    "fault": (FAULT, replace(FAULT, beside=replace(WATER, dt=0.05), dt=0.05)),
}
"""Disturbances at a step, and at half of it. A current is held over a step, in which it carries the water, too,
so that the place of a field of waves is not among them."""


@pytest.mark.parametrize("name", sorted(BY_STEP.keys() - {"fault"}))
def test_a_step_keeps_the_stationary_covariance(name: str):
    disturbance = BY_STEP[name][0]
    A, Q = transition_and_noise(disturbance)
    P = disturbance.process.start_cov
    np.testing.assert_allclose(A @ P @ A.T + Q, P, rtol=0, atol=1e-12)
    size = np.sqrt(np.outer(np.diag(P), np.diag(P)))  # rad2 are small: relative too
    np.testing.assert_allclose((A @ P @ A.T + Q) / size, P / size, rtol=0, atol=1e-12)


@pytest.mark.parametrize("pair", BY_STEP.values(), ids=BY_STEP)
def test_two_half_steps_add_as_one_step(
    pair: tuple[Disturbance, Disturbance],
):
    (A, Q), (half_A, half_Q) = map(transition_and_noise, pair)
    np.testing.assert_allclose(half_A @ half_A, A, rtol=0, atol=1e-13)
    np.testing.assert_allclose(half_A @ half_Q @ half_A.T + half_Q, Q, rtol=1e-9, atol=1e-16)
    whole, half = pair
    np.testing.assert_allclose(
        half.process.start_cov, whole.process.start_cov, rtol=1e-12, atol=1e-16
    )
    np.testing.assert_allclose(
        2.0 * half.white @ half.white.T, whole.white @ whole.white.T, rtol=1e-14
    )


@pytest.mark.parametrize(
    "bias",
    [Bias(("offset",), start=(0.1,), pace=(0.02,)), Bias(("offset",), start=(0.1,), time=30.0)],
)
def test_two_half_steps_add_to_a_bias_as_one_step(bias: Bias):
    whole, half = bias.process(0.1), bias.process(0.05)
    (A, Q), (half_A, half_Q) = (
        (each.transition, each.root @ each.root.T) for each in (whole, half)
    )
    np.testing.assert_allclose(half_A @ half_A, A, rtol=1e-14)
    np.testing.assert_allclose(half_A @ half_Q @ half_A.T + half_Q, Q, rtol=1e-12)


@pytest.mark.parametrize("name", ["corvette", "mariner"])
def test_two_half_steps_of_ship_process_noise_are_one_step(name: str):
    whole, half = (Ship(load(name), dt).process_sd for dt in (0.5, 0.25))
    np.testing.assert_allclose(2.0 * half**2, whole**2, rtol=1e-12)


# --- in an environment ----------------------------------------------------------------------------


def block_diagonal(*matrices: np.ndarray) -> np.ndarray:
    return block_diag(*(matrix for matrix in matrices if matrix.size))


@pytest.mark.slow
@pytest.mark.parametrize("env_id", OURS)
def test_noise_of_a_step_is_white_with_its_covariance(env_id: str):
    rows, steps = 500, 40
    core = make_core(env_id, rows, estimator="truth", disturbance="rough")
    core.start(11)
    noise = [core.now.noise.copy()]
    for _ in range(steps - 1):
        core.step(np.zeros((rows, core.config.action_size)))
        noise.append(core.now.noise.copy())
    white, process, bias = (
        core.config.world.disturbance.white,
        core.config.world.disturbance.process,
        core.config.sensors.bias,
    )
    cov = block_diagonal(white @ white.T, process.root @ process.root.T, bias.root @ bias.root.T)
    scale, new = np.sqrt(np.diag(cov)), np.stack(noise)
    assert not new[..., scale == 0.0].any()  # water that a current carries moves by it alone
    drawn = np.flatnonzero(scale)
    cov, scale, sample = cov[np.ix_(drawn, drawn)], scale[drawn], new[..., drawn] / scale[drawn]
    n = rows * steps
    # a correlation of 20,000 pairs has a standard deviation of at most 1.5 / sqrt(20,000): 7 of
    # them
    band = 7.0 * 1.5 / np.sqrt(n)
    np.testing.assert_allclose(
        np.einsum("tri,trj->ij", sample, sample) / n, cov / np.outer(scale, scale), atol=band
    )
    assert (np.abs(np.einsum("tri,trj->ij", sample[1:], sample[:-1])) / n < band).all()
    neighbours = sample[:, 1:], sample[:, :-1]
    assert (np.abs(np.einsum("tri,trj->ij", *neighbours)) / n < band).all()


@pytest.mark.parametrize("env_id", [
    pytest.param(env_id, marks=pytest.mark.nightly if env_id == "PunaUAV-v0" else ())
    for env_id in OURS  # a start of 20,000 flights plans as many paths
])  # fmt: skip
def test_disturbances_and_biases_start_with_their_covariance(env_id: str):
    core = make_core(env_id, 20_000, estimator="truth", disturbance="rough")
    core.start(12)
    process, bias = core.config.world.disturbance.process, core.config.sensors.bias
    cov = block_diagonal(process.start_cov, bias.start_cov)
    scale = np.sqrt(np.diag(cov)) + (np.diag(cov) == 0.0)
    sample = core.now.slow / scale
    np.testing.assert_allclose(
        sample.T @ sample / 20_000, cov / np.outer(scale, scale), atol=7.0 * 1.5 / np.sqrt(20_000)
    )


@pytest.mark.parametrize("env_id", OURS)
def test_exogenous_input_is_effect_and_white_increments(env_id: str):
    core = make_core(env_id, 3, estimator="truth", disturbance="rough")
    core.start(13)
    disturbance, names = (
        core.config.world.disturbance,
        core.config.system.vehicle.increments + core.config.system.vehicle.ambient_flows,
    )
    dt = core.config.system.vehicle.dt
    for _ in range(3):
        prescribed = core.config.system.task.exogenous(core.now.scenario, core.now.steps)
        given = core.now.exogenous - (0.0 if prescribed is None else prescribed)
        acting = dict(zip(names, given.T, strict=True))
        effect = disturbance.effect_at(
            core.now.episode_constants,
            dt * core.now.steps,
            core.now.slow[:, : core.config.world.size],
            core.now.state,
        )
        for name, values in zip(disturbance.forces, effect.T, strict=True):
            np.testing.assert_allclose(
                acting.pop(name), values, rtol=0, atol=1e-13 * np.abs(values).max()
            )
        for i, name in enumerate(disturbance.white_increments):
            np.testing.assert_array_equal(acting.pop(name), core.now.noise[:, i])
        assert not any(
            values.any() for values in acting.values()
        )  # these give everything that acts
        core.step(np.zeros((3, core.config.action_size)))
