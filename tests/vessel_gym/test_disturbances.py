"""Waves, gusts and current: stationary from the first step, with the spectrum and the sizes that they claim.

Statistical tests have fixed seeds; a band with false-alarm rate 1e-6 would fail one correct seed in a million.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import chi2, norm

from vessel_gym.disturbances import Air, Sea, Water
from vessel_gym.envs.sigma_corvette import SEAS

FALSE_ALARM = 1e-6
DEG = np.pi / 180.0

every_sea = pytest.mark.parametrize("sea", SEAS.values(), ids=SEAS)


def transition_and_noise(sea: Sea) -> tuple[np.ndarray, np.ndarray]:
    """A and Q of ``x+ = A x + w`` as `Sea.advance` has them."""
    A = sea.advance(np.eye(5), np.zeros((5, 5))).T
    root = sea.advance(np.zeros((5, 5)), np.eye(5)).T
    return A, root @ root.T


def run(sea: Sea, seed: int, rows: int, steps: int) -> np.ndarray:
    """Independent records ``(steps, rows, 5)``."""
    rng = np.random.default_rng(seed)
    states = np.empty((steps, rows, 5))
    states[0] = sea.start(rng.standard_normal((rows, 5)))
    for k in range(1, steps):
        states[k] = sea.advance(states[k - 1], rng.standard_normal((rows, 5)))
    return states


def assert_variance(samples: np.ndarray, variance: float):
    """Independent normal samples with mean zero have this variance (chi-square band)."""
    low, high = chi2.ppf([FALSE_ALARM / 2, 1 - FALSE_ALARM / 2], samples.size) / samples.size
    assert low * variance < np.mean(samples**2) < high * variance


# --- exact ------------------------------------------------------------------------------------------


@every_sea
def test_a_step_keeps_the_stationary_covariance(sea):
    A, Q = transition_and_noise(sea)
    P = sea.stationary_cov
    np.testing.assert_allclose(A @ P @ A.T + Q, P, rtol=0, atol=1e-12)
    size = np.sqrt(np.outer(np.diag(P), np.diag(P)))  # rad2 are small: relative too
    np.testing.assert_allclose((A @ P @ A.T + Q) / size, P / size, rtol=0, atol=1e-12)


@every_sea
def test_the_start_has_the_stationary_covariance(sea):
    root = sea.start(np.eye(5)).T
    np.testing.assert_allclose(root @ root.T, sea.stationary_cov, rtol=1e-12, atol=1e-18)


@every_sea
def test_the_stationary_covariance_is_what_the_sizes_say(sea):
    P = sea.stationary_cov
    np.testing.assert_allclose(np.diag(P)[[1, 2]], [sea.wave**2, sea.gust**2], rtol=1e-12)
    assert P[3, 3] + P[4, 4] == pytest.approx(sea.current**2)  # RMS of the current's speed
    assert P[3, 3] == P[4, 4]
    assert P[0, 0] == pytest.approx((sea.wave / sea.peak) ** 2)  # yaw angle of a narrow band about the peak
    np.testing.assert_allclose(P[~np.eye(5, dtype=bool)], 0.0, atol=1e-18)


@every_sea
def test_two_half_steps_are_one_step(sea):
    half_A, half_Q = transition_and_noise(replace(sea, dt=0.25))
    A, Q = transition_and_noise(sea)
    np.testing.assert_allclose(half_A @ half_A, A, rtol=0, atol=1e-13)
    np.testing.assert_allclose(half_A @ half_Q @ half_A.T + half_Q, Q, rtol=1e-9, atol=1e-16)


@pytest.mark.parametrize(
    ("name", "sd", "digit"), [("calm", 5e-4, 1e-4), ("moderate", 3.6e-3, 1e-4), ("rough", 9e-3, 1e-3)]
)
def test_the_yaw_increment_of_a_step_has_the_size_that_was_chosen(name, sd, digit):
    sea = SEAS[name]
    assert np.sqrt(sea.unknown_input_var) == pytest.approx(sd, abs=0.5 * digit)
    P = sea.stationary_cov
    assert sea.unknown_input_var == pytest.approx(0.25 * (P[1, 1] + 2 * P[1, 2] + P[2, 2]), rel=1e-12)


def test_the_unknown_input_is_the_yaw_rate_of_waves_and_gusts_over_a_step():
    state = np.random.default_rng(0).normal(size=(4, 3, 5))
    forcing = SEAS["rough"].forcing(state)
    assert forcing.shape == (4, 3, 3)
    np.testing.assert_allclose(forcing[..., 0], 0.5 * (state[..., 1] + state[..., 2]))
    np.testing.assert_array_equal(forcing[..., 1:], state[..., 3:])


def test_a_gust_decays_with_its_time_constant_and_a_current_with_its_own():
    sea = Sea(wave=0.01, peak=0.8, gust=0.01, current=0.5, gust_time=12.0, current_time=800.0, dt=0.4)
    state = np.array([0.0, 0.0, 1.0, 1.0, -2.0])
    for _ in range(30):  # 12 s
        state = sea.advance(state, np.zeros(5))
    decay = np.exp(-12.0 / 800.0)
    np.testing.assert_allclose(state, [0.0, 0.0, np.exp(-1.0), decay, -2.0 * decay], rtol=1e-12, atol=1e-15)


def test_the_wave_yaw_rate_is_the_rate_of_the_wave_yaw_angle():
    sea = SEAS["rough"]
    fine = replace(sea, dt=1e-4)
    state = np.array([0.02, 0.01, 0.0, 0.0, 0.0])
    after = fine.advance(state, np.zeros(5))
    assert (after[0] - state[0]) / 1e-4 == pytest.approx(0.01, abs=1e-5)
    rate = -(sea.peak**2) * 0.02 - 2 * sea.damping * sea.peak * 0.01
    assert (after[1] - state[1]) / 1e-4 == pytest.approx(rate, rel=1e-3)


def test_a_batch_of_seas_is_a_loop():
    sea, rng = SEAS["moderate"], np.random.default_rng(1)
    state, normals = rng.normal(size=(6, 5)), rng.normal(size=(6, 5))
    whole = sea.advance(state, normals)
    for i in range(6):
        np.testing.assert_allclose(sea.advance(state[i], normals[i]), whole[i], rtol=1e-13, atol=1e-15)


# --- statistical ------------------------------------------------------------------------------------


@every_sea
def test_records_have_the_stationary_sizes_from_the_first_step_to_the_last(sea):
    states = run(sea, seed=2, rows=2000, steps=240)
    P = np.diag(sea.stationary_cov)
    for k in (0, 1, 239):  # rows are independent
        for i in range(5):
            assert_variance(states[k, :, i], P[i])
        assert_variance(sea.forcing(states[k])[..., 0], sea.unknown_input_var)


@pytest.mark.slow
@every_sea
def test_the_spectrum_of_the_wave_yaw_rate_peaks_at_the_peak_frequency(sea):
    rows, steps = 1000, 1024
    rate = run(sea, seed=3, rows=rows, steps=steps)[:, :, 1]
    window = np.hanning(steps)[:, None]
    power = (np.abs(np.fft.rfft(window * rate, axis=0)) ** 2).mean(1)
    power = np.convolve(power, np.ones(3) / 3, mode="same")
    omega = 2 * np.pi * np.fft.rfftfreq(steps, sea.dt)
    # 5 % off the peak the spectrum is 0.8 of it; the average of 1000 rows is good to 3 %, so that the highest of
    # some 500 bins lies outside by chance in less than 1e-6 of all seeds (6.5 standard deviations).
    assert omega[np.argmax(power)] == pytest.approx(sea.peak, rel=0.05)


@pytest.mark.slow
def test_the_spectrum_of_the_wave_yaw_rate_has_the_width_of_its_damping():
    sea = SEAS["rough"]
    rows, steps = 4000, 1024
    rate = run(sea, seed=4, rows=rows, steps=steps)[:, :, 1]
    power = (np.abs(np.fft.rfft(np.hanning(steps)[:, None] * rate, axis=0)) ** 2).mean(1)
    omega = 2 * np.pi * np.fft.rfftfreq(steps, sea.dt)
    # Half power at w0 (sqrt(1 + lambda^2) +- lambda), against the power at w0.
    at_peak = np.interp(sea.peak, omega, power)
    low, high = (np.interp(sea.peak * (np.sqrt(1.01) + s * 0.1), omega, power) for s in (-1, 1))
    # A ratio of two averages of 4000 has a standard deviation of 2.2 % of itself; five of them, both sides,
    # twice: 1.2e-6.
    for power_at_half in (low, high):
        assert power_at_half / at_peak == pytest.approx(0.5, rel=5 * np.sqrt(2 / rows))


def test_gusts_are_correlated_over_their_time_constant():
    sea = SEAS["moderate"]
    gust = run(sea, seed=5, rows=4000, steps=31)[:, :, 2]
    correlation = np.corrcoef(gust[0], gust[30])[0, 1]  # 15 s apart
    band = norm.isf(FALSE_ALARM / 2) / np.sqrt(4000 - 3)  # of Fisher's z
    assert abs(np.arctanh(correlation) - np.arctanh(np.exp(-1.0))) < band


# --- under water ------------------------------------------------------------------------------------

WATER = Water(turbulence=0.01, spin=0.002, current=0.2, velocities=2, rates=1, currents=2, current_time=50.0, dt=0.1)


def test_the_water_kicks_every_velocity_as_it_says_and_forgets_it():
    rng = np.random.default_rng(0)
    first = WATER.start(rng.standard_normal((100_000, WATER.size)))
    after = WATER.advance(first, rng.standard_normal((100_000, WATER.size)))
    for kicks in (WATER.forcing(first), WATER.forcing(after)):
        for component, sd in zip(kicks.T, WATER.kick_sd, strict=True):
            assert_variance(component, sd**2)
    np.testing.assert_array_equal(WATER.kick_sd[:3], [0.01, 0.01, 0.002])
    correlation = np.corrcoef(first.T, after.T)
    assert np.abs(correlation - np.eye(2 * WATER.size)).max() < 5.0 / np.sqrt(100_000)  # 5 standard errors


def test_increments_of_the_current_keep_a_gauss_markov_process_stationary():
    """``c+ = phi c + w`` with the variance of w: the speed's RMS stays what it is, whatever the step."""
    for dt in (0.01, 0.1, 10.0):
        water = replace(WATER, dt=dt)
        phi = np.exp(-dt / water.current_time)
        variance = phi**2 * water.current_sd**2 + water.kick_sd[-1] ** 2
        np.testing.assert_allclose(variance, water.current_sd**2, rtol=1e-12)
    assert np.hypot(WATER.current_sd, WATER.current_sd) == pytest.approx(0.2)


# --- in the air -------------------------------------------------------------------------------------

AIR = Air(wind=3.0, gust=1.06, vertical_gust=0.7)


def dryden(length: float, sd: float, vertical: bool, airspeed: float, lag: float) -> float:
    """Covariance of a gust and itself ``lag`` seconds later, from its one-sided spectrum in MIL-F-8785C."""
    time = length / airspeed

    def spectrum(omega: float) -> float:
        square = (time * omega) ** 2
        if vertical:
            return sd**2 * time / np.pi * (1.0 + 3.0 * square) / (1.0 + square) ** 2
        return 2.0 * sd**2 * time / np.pi / (1.0 + square)

    return quad(spectrum, 0.0, np.inf, weight="cos", wvar=lag)[0] if lag else quad(spectrum, 0.0, np.inf)[0]


def gusts_by_state(air: Air) -> np.ndarray:
    """The matrix ``(3, 4)`` from the gusts' state to the gusts, as `Air.gusts` has it."""
    return air.gusts(np.eye(4)).T


@pytest.mark.parametrize("air", [AIR, replace(AIR, airspeed=14.0, length=120.0, vertical_length=80.0, dt=0.25)])
def test_gusts_have_the_dryden_spectra(air):
    """Their covariance at every lag is the transform of the spectrum, and they do not know of each other."""
    A, _ = air.discrete
    C, P = gusts_by_state(air), air.stationary_cov
    for steps in (0, 1, 7, 30, 100):
        covariance = C @ np.linalg.matrix_power(A, steps) @ P @ C.T
        lag = steps * air.dt
        level = dryden(air.length, air.gust, False, air.airspeed, lag)
        down = dryden(air.vertical_length, air.vertical_gust, True, air.airspeed, lag)
        np.testing.assert_allclose(covariance, np.diag([level, level, down]), rtol=0, atol=2e-6)


def test_a_step_keeps_the_gusts_stationary_and_two_half_steps_are_one():
    A, L = AIR.discrete
    P = AIR.stationary_cov
    np.testing.assert_allclose(A @ P @ A.T + L @ L.T, P, rtol=0, atol=1e-13)
    half, noise = replace(AIR, dt=0.05).discrete
    np.testing.assert_allclose(half @ half, A, rtol=0, atol=1e-13)
    np.testing.assert_allclose(half @ noise @ noise.T @ half.T + noise @ noise.T, L @ L.T, rtol=0, atol=1e-13)
    np.testing.assert_allclose(np.diag(P), [1.06**2, 1.06**2, 0.7**2 / 4, 0.7**2 / 4], rtol=1e-12)


def test_the_wind_decays_as_slowly_as_the_aircraft_crosses_it():
    mean, level, *vertical = AIR.decay
    assert mean == pytest.approx(np.exp(-0.1 / 200.0))
    assert level == pytest.approx(np.exp(-0.1 / 10.0))  # 200 m at 20 m/s
    np.testing.assert_allclose(np.reshape(vertical, (2, 2)), AIR.discrete[0][2:, 2:])


def test_what_enters_in_a_step_keeps_the_wind_as_it_is_and_lets_the_bias_wander():
    cov = AIR.noise_cov
    np.testing.assert_allclose(np.sqrt(np.diag(cov)[:4]), [0.05, 0.05, 0.05, 0.005])
    np.testing.assert_allclose(np.sqrt(np.diag(cov)[10:]), np.array([0.21, 0.21, 0.40]) * np.sqrt(0.1))
    mean, variance = AIR.decay[0], AIR.wind_sd[0] ** 2
    np.testing.assert_allclose(mean**2 * variance + np.diag(cov)[4:6], variance)
    np.testing.assert_allclose(cov[6:10, 6:10], AIR.discrete[1] @ AIR.discrete[1].T, atol=1e-15)
    blocks = np.zeros((13, 13), bool)
    blocks[6:10, 6:10] = True
    assert (cov[~(blocks | np.eye(13, dtype=bool))] == 0.0).all()
    np.testing.assert_allclose(AIR.wind_sd, [3 / np.sqrt(2), 3 / np.sqrt(2), 1.06, 1.06, 0.35, 0.35], rtol=1e-12)


def test_the_noise_of_the_air_has_its_covariance_and_remembers_nothing():
    rng, rows = np.random.default_rng(11), 20_000
    state = AIR.start(rng.standard_normal((rows, AIR.size)))
    later = AIR.advance(state, rng.standard_normal((rows, AIR.size)))
    np.testing.assert_array_equal(AIR.forcing(state), state)
    scale = np.sqrt(np.diag(AIR.noise_cov))
    for sample in (state, later):
        np.testing.assert_allclose((sample / scale).T @ (sample / scale) / rows,
                                   AIR.noise_cov / np.outer(scale, scale), rtol=0, atol=0.05)  # fmt: skip
    assert np.abs((state / scale).T @ (later / scale)).max() / rows < 0.05


def test_gusts_twice_as_strong_are_the_same_gusts_doubled():
    strong = replace(AIR, gust=2.12, vertical_gust=1.4)
    np.testing.assert_allclose(strong.noise_cov[6:10, 6:10], 4.0 * AIR.noise_cov[6:10, 6:10], rtol=1e-9)
    np.testing.assert_array_equal(strong.decay, AIR.decay)


def test_a_batch_of_airs_is_a_loop():
    rng = np.random.default_rng(13)
    state, normals = AIR.start(rng.standard_normal((6, 13))), rng.standard_normal((6, 13))
    whole = AIR.advance(state, normals)
    for i in range(6):
        np.testing.assert_array_equal(AIR.advance(state[i], normals[i]), whole[i])
