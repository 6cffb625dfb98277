"""Models whose measurements contain the unknown input of the step that has ended: y(k) = C x(k) + H d(k-1) + v(k)."""

from dataclasses import replace

import numpy as np
import pytest

from estimators import (
    EndedUMVFilter,
    Gaussian,
    LinearModel,
    UMVFilter,
    input_delayed,
    make,
    stacked,
)
from estimators.consistency import simulate

N, P, Q = 4, 3, 2
PRIOR = 25.0
FILTERS = "kf-umv-ui", "kf-umv-ui-wdf", "ekf-ui-wdf", "ukf-umv", "ulise"


def _model(seed: int = 4) -> LinearModel:
    """A random model of which C G shows one input and H the other."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((N, N))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    C, G, H = (rng.standard_normal(shape) for shape in ((P, N), (N, Q), (P, Q)))
    G[:, 1] -= np.linalg.pinv(C) @ (C @ G[:, 1])
    H[:, 0] = 0.0
    return LinearModel(A, C, 0.1 * np.eye(N), 0.2 * np.eye(P), G=G, H=H, delayed_feedthrough=True)


def _beliefs(filter, prior: Gaussian, y: np.ndarray) -> list:
    belief, beliefs = filter.init(prior), []
    for k, each in enumerate(y):
        belief = filter.update(belief if k == 0 else filter.predict(belief), each)
        beliefs.append(belief)
    return beliefs


def _measurements(seed: int, steps: int = 60) -> np.ndarray:
    """Numbers of which a tenth is missing."""
    rng = np.random.default_rng(seed)
    y = rng.standard_normal((steps, P))
    y[rng.random((steps, P)) < 0.1] = np.nan
    return y


@pytest.mark.parametrize("name", FILTERS)
def test_it_is_the_direct_feedthrough_of_what_the_input_did_to_state_and_measurement(name: str):
    """X' + G d of `UMVFilter` with G' = A G, H' = C G + H is x, and its d the input of the step that has ended."""
    model, y = _model(), _measurements(1)
    direct = make("kf-umv-ui", input_delayed(model), input_prior=PRIOR)
    assert isinstance(direct, UMVFilter)
    found = _beliefs(make(name, model, input_prior=PRIOR), Gaussian(np.zeros(N), np.eye(N)), y)
    # The first measurement contains no input: the other filter begins behind it.
    plain = make("kf", replace(model, delayed_feedthrough=False))
    start = plain.predict(plain.update(plain.init(Gaussian(np.zeros(N), np.eye(N))), y[0]))
    expected = _beliefs(direct, Gaussian(start.mean, start.cov), y[1:])
    for one, other in zip(found[1:], expected, strict=True):
        assert one.input_mean == pytest.approx(other.input_mean, abs=1e-7)
        assert one.mean == pytest.approx(other.mean + model.G @ other.input_mean, abs=1e-7)
        joined = np.block(
            [[other.cov, other.state_input_cov], [other.state_input_cov.T, other.input_cov]]
        )
        drive = np.hstack([np.eye(N), model.G])
        assert one.cov == pytest.approx(drive @ joined @ drive.T, abs=1e-7)


def test_a_kalman_filter_told_the_variance_has_it_as_white_noise_of_state_and_measurement():
    model, y, D = _model(), _measurements(3), np.array([[0.5, 0.2], [0.2, 0.9]])
    found = _beliefs(make("kf", model, input_cov=D), Gaussian(np.zeros(N), np.eye(N)), y)
    whole = stacked(model)
    noisy = LinearModel(whole.A, whole.C, whole.Q + whole.G @ D @ whole.G.T, whole.R)
    start = Gaussian(np.zeros(N + Q), np.diag([1.0] * N + [0.0] * Q))
    for one, other in zip(found, _beliefs(make("kf", noisy), start, y), strict=True):
        assert np.r_[one.mean, one.input_mean] == pytest.approx(other.mean, abs=1e-10)
        assert one.cov == pytest.approx(other.cov[:N, :N], abs=1e-10)
        assert one.input_cov == pytest.approx(other.cov[N:, N:], abs=1e-10)


@pytest.mark.parametrize("name", FILTERS)
def test_errors_do_not_depend_on_how_large_the_input_is(name: str):
    model, prior = _model(), Gaussian(np.zeros(N), np.eye(N))
    d, errors = np.random.default_rng(5).standard_normal((40, 3, Q)), []
    for size in (1.0, 1000.0):
        runs = simulate(model, prior, np.random.default_rng(6), 3, 40, d=size * d)
        rows = Gaussian(np.zeros((3, N)), prior.cov)
        last = _beliefs(make(name, model, input_prior=PRIOR), rows, runs.y)[-1]
        errors.append(np.concatenate([last.mean - runs.x[-1], last.input_mean - size * d[-2]], -1))
    assert errors[1] == pytest.approx(errors[0], abs=1e-8)


def test_a_filter_of_what_acts_now_refuses_the_model_and_says_which_takes_it():
    assert isinstance(make("kf-umv-ui", _model()), EndedUMVFilter)
    with pytest.raises(ValueError, match=r"delayed_feedthrough: use EndedUMVFilter"):
        UMVFilter(_model())
    C, G = np.array(_model().C), np.array(_model().G)
    C[:, -1], G[:, 1] = 0.0, np.arange(N) == N - 1  # exactly unseen, on every processor
    with pytest.raises(ValueError, match=r"needs rank\(C G \+ H\) = 2"):
        EndedUMVFilter(replace(_model(), C=C, G=G, H=np.zeros((P, Q))))


@pytest.mark.parametrize("name", FILTERS)
def test_no_input_has_acted_at_the_first_step(name: str):
    filter = make(name, _model(), input_prior=PRIOR)
    first = filter.update(filter.init(Gaussian(np.zeros(N), np.eye(N))), np.ones(P))
    assert not first.input_mean.any()
    assert not first.input_cov.any()
