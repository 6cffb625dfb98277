"""Training of a filter's gain."""

import numpy as np
import pytest

pytest.importorskip("torch")

from dataclasses import replace

from agents.training.learned_filter import train_filter
from estimators import GainNetwork, Gaussian, LearnedGainFilter, LinearModel, make, rmse

BELIEVED = LinearModel([[1.0, 0.2], [-0.05, 0.97]], [[1.0, 0.0]], np.diag([1e-5, 4e-4]), [[4e-3]], B=[[0.0], [0.1]])
TRUE = replace(BELIEVED, A=[[1.0, 0.2], [-0.2, 0.97]])
PRIOR = Gaussian(np.zeros(2), 0.04 * np.eye(2))


def _sailed(seed: int, series: int, steps: int = 40) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """States, measurements of which some are lost, and the known input."""
    rng = np.random.default_rng(seed)
    x, xs, ys, u = 0.2 * rng.normal(size=(series, 2)), [], [], rng.normal(size=(steps, series, 1))
    for k in range(steps):
        xs.append(x)
        ys.append(x[:, :1] + np.sqrt(4e-3) * rng.normal(size=(series, 1)))
        x = TRUE.transition(x, u[k]) + rng.normal(size=(series, 2)) * np.sqrt(np.diag(TRUE.Q))
    y = np.array(ys)
    y[rng.random(y.shape) < 0.1] = np.nan
    return np.array(xs), y, u


def _error(filter, x: np.ndarray, y: np.ndarray, u: np.ndarray, settled: int = 0) -> float:
    belief, errors = filter.init(Gaussian(np.zeros(x.shape[1:]), PRIOR.cov)), []
    for k in range(len(y)):
        if k:
            belief = filter.predict(belief, u[k - 1])
        belief = filter.update(belief, y[k])
        errors.append(belief.mean - x[k])
    return float(rmse(np.array(errors[settled:]), 0.0).mean())


@pytest.mark.slow
def test_what_is_learned_holds_on_other_series_and_is_the_same_again():
    """Between the Kalman filter of what is believed and that of what is true, on series that it has not seen."""
    series = _sailed(0, 60)
    learned, one, other = (
        train_filter(BELIEVED, PRIOR, *series, hidden=8, epochs=epochs, rate=1e-2) for epochs in (60, 3, 3)
    )
    for name, array in vars(one).items():
        np.testing.assert_array_equal(array, getattr(other, name))
    unseen = _sailed(1, 200)
    wrong, ours, best = (
        _error(filter, *unseen)
        for filter in (make("kf", BELIEVED), LearnedGainFilter(BELIEVED, learned), make("kf", TRUE))
    )
    assert best < ours < 0.97 * wrong


def test_before_it_learns_it_is_nearly_the_steady_kalman_filter():
    """One epoch at a rate of nothing: where the model is true it is as good once settled, but for the gaps."""
    x, y, u = _sailed(0, 20)
    network = train_filter(TRUE, PRIOR, x, y, u, hidden=4, epochs=1, rate=1e-12)
    assert isinstance(network, GainNetwork)
    assert network.size == 4
    unseen = _sailed(1, 100)
    mine, theirs = (
        _error(filter, *unseen, settled=25) for filter in (LearnedGainFilter(TRUE, network), make("kf", TRUE))
    )
    assert theirs < mine < 1.1 * theirs


def test_whole_turns_of_an_angle_teach_nothing():
    """A course and its measurements with whole turns taken off and put on give the same network."""
    model = LinearModel([[1.0, 0.2], [0.0, 0.97]], [[1.0, 0.0]], np.diag([1e-5, 4e-4]), [[4e-3]],
                        state_angles=(0,), measurement_angles=(0,))  # fmt: skip
    x, y, _ = _sailed(0, 10)
    turns = 2.0 * np.pi * np.random.default_rng(0).integers(-2, 3, x.shape[:2] + (1,))
    one, other = (
        train_filter(model, PRIOR, x + states, y + measurements, hidden=4, epochs=3, rate=1e-2)
        for states, measurements in ((0.0, 0.0), (turns * [1.0, 0.0], turns[::-1]))
    )
    for name, array in vars(one).items():
        np.testing.assert_allclose(getattr(other, name), array, rtol=0, atol=1e-8, err_msg=name)


def test_series_that_do_not_fit_are_named():
    x, y, u = _sailed(0, 5, steps=4)
    with pytest.raises(ValueError, match=r"y has shape \(4, 5, 2\), expected \(T, series, 1\)"):
        train_filter(BELIEVED, PRIOR, x, x, u)
    with pytest.raises(ValueError, match="needs five series at least, got 4"):
        train_filter(BELIEVED, PRIOR, x[:, :4], y[:, :4], u[:, :4])
    with pytest.raises(ValueError, match="the model has B: give the known input u"):
        train_filter(BELIEVED, PRIOR, x, y)
    with pytest.raises(ValueError, match="needs a LinearModel of arrays"):
        train_filter(replace(BELIEVED, A=lambda u: np.eye(2)), PRIOR, x, y, u)
    with pytest.raises(ValueError, match="rate must be a positive number"):
        train_filter(BELIEVED, PRIOR, x, y, u, rate=0.0)
    for shape in (u[:, 0], u[:-1], u[:, :4]):
        with pytest.raises(ValueError, match=r"u has shape .*, expected \(T, series, m\) = \(4, 5, m\)"):
            train_filter(BELIEVED, PRIOR, x, y, shape)
    holes = x.copy()
    holes[1, 2, 0] = np.nan
    with pytest.raises(ValueError, match="x must be finite: it is the truth"):
        train_filter(BELIEVED, PRIOR, holes, y, u)
    with pytest.raises(ValueError, match="y has no measurement of channel 0"):
        train_filter(BELIEVED, PRIOR, x, np.full_like(y, np.nan), u)
    for prior in (None, Gaussian(np.zeros(3), np.eye(3)), Gaussian(np.zeros((5, 2)), np.eye(2)),
                  Gaussian(np.zeros(2), np.broadcast_to(np.eye(2), (5, 2, 2)))):  # fmt: skip
        with pytest.raises(ValueError, match="prior must be one Gaussian of 2 states for all series"):
            train_filter(BELIEVED, prior, x, y, u)
    twice = replace(BELIEVED, C=[[1.0, 0.0], [1.0, 0.0]], R=np.full((2, 2), 4e-3))
    with pytest.raises(ValueError, match="innovations have a singular covariance: give every channel noise"):
        train_filter(twice, PRIOR, x, np.repeat(y, 2, -1), u)
