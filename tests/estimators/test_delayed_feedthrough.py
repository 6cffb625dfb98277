"""Models whose measurements contain the last input: y(k) = C x(k) + H d(k-1) + v(k)."""

from dataclasses import replace

import numpy as np
import pytest

from estimators import (
    EndedUMVFilter,
    Gaussian,
    LinearModel,
    UMVFilter,
    make,
)
from estimators.kalman import with_input
from tests.estimators.cases import Record, track

N, P, Q = 4, 3, 2
PRIOR, START = 25.0, Gaussian(np.zeros(N), np.eye(N))
FILTERS = "kf-umv-ui", "kf-umv-ui-wdf", "ekf-ui-wdf", "ukf-umv", "ulise"


def _model(ended: bool = True) -> LinearModel:
    """A random model of which C G shows one input and H the other; or C G both, and H is zero."""
    rng = np.random.default_rng(4)
    A = rng.standard_normal((N, N))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    C, G, H = (rng.standard_normal(shape) for shape in ((P, N), (N, Q), (P, Q)))
    G[:, 1] -= ended * np.linalg.pinv(C) @ (C @ G[:, 1])
    H *= [0.0, ended]
    return LinearModel(A, C, 0.1 * np.eye(N), 0.2 * np.eye(P), G=G, H=H, delayed_feedthrough=ended)


Y = np.random.default_rng(1).standard_normal((60, P))
Y[np.random.default_rng(2).random(Y.shape) < 0.1] = np.nan
RECORD = Record(Y, Y, [None] * len(Y), None)


@pytest.mark.parametrize(
    ("name", "ended"), [*((name, True) for name in FILTERS), ("kf-umv-ui-wdf", False)]
)
def test_delayed_feedthrough_is_direct_of_an_equivalent_model(name: str, ended: bool):
    """X' + G d of `UMVFilter` with G' = A G, H' = C G + H is x; its d is that of the last step."""
    model = _model(ended)
    G, H = model.A @ model.G, model.C @ model.G + model.H
    equivalent = replace(model, G=G, H=H, delayed_feedthrough=False)
    direct = make("kf-umv-ui", equivalent, input_prior=PRIOR)
    assert isinstance(direct, UMVFilter)
    found = track(make(name, model, input_prior=PRIOR), START, RECORD)
    # The first measurement contains no input: the other filter begins behind it.
    assert not found[0].input_mean.any()
    assert found[0].input_cov.any() != ended  # it is its prior, or none
    plain = make("kf", replace(model, delayed_feedthrough=False))
    start = plain.predict(plain.update(plain.init(START), Y[0]))
    begun = Gaussian(start.mean, start.cov)
    expected = track(direct, begun, RECORD._replace(y=Y[1:]))
    for one, other in zip(found[1:], expected, strict=True):
        assert one.input_mean == pytest.approx(other.input_mean, abs=1e-7)
        assert one.mean == pytest.approx(other.mean + model.G @ other.input_mean, abs=1e-7)
        drive = np.hstack([np.eye(N), model.G])
        assert one.cov == pytest.approx(drive @ with_input(other)[1] @ drive.T, abs=1e-7)


def test_an_assumed_variance_is_white_noise_of_state_and_y():
    model, D = _model(), np.array([[0.5, 0.2], [0.2, 0.9]])
    found = track(make("kf", model, input_cov=D), START, RECORD)
    A, G = np.pad(model.A, (0, Q)), np.vstack([model.G, np.eye(Q)])  # d(k-1) as more states
    noisy = LinearModel(
        A, np.hstack([model.C, model.H]), np.pad(model.Q, (0, Q)) + G @ D @ G.T, model.R
    )
    start = Gaussian(np.zeros(N + Q), np.diag([1.0] * N + [0.0] * Q))
    for one, other in zip(found, track(make("kf", noisy), start, RECORD), strict=True):
        assert np.r_[one.mean, one.input_mean] == pytest.approx(other.mean, abs=1e-10)
        assert one.cov == pytest.approx(other.cov[:N, :N], abs=1e-10)
        assert one.input_cov == pytest.approx(other.cov[N:, N:], abs=1e-10)


def test_a_filter_without_delay_refuses_delayed_feedthrough():
    assert isinstance(make("kf-umv-ui", _model()), EndedUMVFilter)
    with pytest.raises(ValueError, match=r"delayed_feedthrough: use EndedUMVFilter"):
        UMVFilter(_model())
    C, G = np.array(_model().C), np.array(_model().G)
    C[:, -1], G[:, 1] = 0.0, np.arange(N) == N - 1  # exactly unseen, on every processor
    with pytest.raises(ValueError, match=r"needs rank\(C G \+ H\) = 2"):
        EndedUMVFilter(replace(_model(), C=C, G=G, H=np.zeros((P, Q))))
