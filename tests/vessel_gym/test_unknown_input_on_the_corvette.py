"""Filters with feedthrough on the linear model of the corvette: waves and gusts as an input of no known law."""

from dataclasses import replace

import numpy as np
import pytest

from estimators import Belief, Gaussian, chi_square_band, make, nees
from vessel_gym.envs.thesis_corvette import UnknownStep
from vessel_gym.filter_models.build import compose
from vessel_gym.sensors import Sensors
from vessel_gym.vehicles.corvette_thesis import ThesisCorvette

SHIP, RUNS, STEPS = ThesisCorvette(), 1000, 60
SENSORS = Sensors(SHIP.sensors, SHIP.state_names, SHIP.increments + SHIP.ambient_flows, SHIP.dt)
MODEL = replace(
    compose(SHIP, "corrected", UnknownStep(), SENSORS).model,
    Q=np.diag([0.02, 0.002, 0.002]) ** 2, R=np.diag([0.005, 0.003]) ** 2,
)  # fmt: skip
PRIOR = Gaussian(np.zeros(3), np.diag([0.2, 0.005, 0.05]) ** 2)


def _increments(size: float) -> np.ndarray:
    """Yaw increments ``(T, 1, 1)`` of swell, with a gust that holds on: not white, and not of zero mean."""
    k = np.arange(STEPS)[:, None, None]
    return size * (0.01 * np.sin(0.6 * k) + 0.02 * (k > 30))


def _sail(d: np.ndarray, runs: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """True states ``(T, runs, 3)``, measurements ``(T, runs, 2)`` and known inputs in a turn to starboard."""
    rng = np.random.default_rng(3)
    x = rng.multivariate_normal(PRIOR.mean, PRIOR.cov, runs)
    u = np.tile([0.15, 0.02, 0.0], (runs, 1))
    xs, ys = [], []
    for k in range(STEPS):
        noise = rng.multivariate_normal(np.zeros(2), MODEL.R, runs)
        xs.append(x)
        ys.append(MODEL.measurement(x, u) + np.matvec(MODEL.H, d[k]) + noise)
        drift = rng.multivariate_normal(np.zeros(3), MODEL.Q, runs)
        x = MODEL.transition(x, u) + np.matvec(MODEL.G, d[k]) + drift
    return np.array(xs), np.array(ys), u


def _follow(name: str, ys: np.ndarray, u: np.ndarray) -> list[Belief]:
    filter = make(name, MODEL)
    belief = filter.init(Gaussian(np.tile(PRIOR.mean, (len(u), 1)), PRIOR.cov)).replace(u=u)
    beliefs = []
    for k, y in enumerate(ys):
        belief = filter.update(filter.predict(belief, u) if k else belief, y)
        beliefs.append(belief)
    return beliefs


@pytest.mark.parametrize("name", ["kf-umv-ui", "ulise"])
def test_state_and_unknown_input_of_the_corvette_are_unbiased_and_consistent(name: str):
    d = _increments(1.0)
    xs, ys, u = _sail(d, RUNS)
    final = _follow(name, ys, u)[-1]
    input_error = final.input_mean - d[-1 - make(name, MODEL).input_delay]
    for error, cov in ((final.mean - xs[-1], final.cov), (input_error, final.input_cov)):
        # Three standard errors, a false alarm of 0.27 % each; a band of 99.7 %.
        assert (np.abs(error.mean(0)) < 3.0 * error.std(0, ddof=1) / np.sqrt(RUNS)).all()
        low, high = chi_square_band(RUNS, error.shape[-1], 0.997)
        assert low < nees(error, cov, np.zeros(error.shape)).mean() < high


def test_on_the_corvette_ulise_has_the_states_of_the_filter_with_feedthrough():
    _, ys, u = _sail(_increments(1.0), 20)
    pairs = zip(_follow("kf-umv-ui", ys, u), _follow("ulise", ys, u), strict=True)
    for one, other in pairs:
        np.testing.assert_allclose(other.mean, one.mean, rtol=0, atol=1e-12)
        np.testing.assert_allclose(other.cov, one.cov, rtol=0, atol=1e-14)
        np.testing.assert_allclose(other.feedthrough_mean, one.input_mean, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ["kf-umv-ui", "ulise"])
def test_waves_a_thousand_times_higher_leave_the_errors_as_they_are(name: str):
    """The compass goes right round with them: its innovation must be told apart from a whole turn."""
    errors = []
    for size in (0.01, 10.0):
        d = _increments(size)
        xs, ys, u = _sail(d, 20)
        beliefs = _follow(name, ys, u)
        errors.append(np.array([b.mean for b in beliefs]) - xs)
    assert np.abs(errors[0] - errors[1]).max() < 1e-9


def test_a_filter_without_feedthrough_refuses_the_corvette():
    with pytest.raises(ValueError, match=r"kf-umv-ui-wdf needs H = 0 .*: use kf-umv-ui or ulise"):
        make("kf-umv-ui-wdf", MODEL)
