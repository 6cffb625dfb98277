"""What `huber-kf` and `robust-kf` promise beyond the common laws."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimators import Gaussian, LinearModel, make
from estimators.robust import least_favourable_covariance
from tests.estimators.cases import (
    assert_close,
    assert_same,
    kalman_system,
)

GAMMA = 1.345


# --- huber-kf -------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [1.0, 5.0, 100.0])
@pytest.mark.parametrize("iterations", [1, 2, 5])
def test_the_huber_update_is_karlgaards_in_information_form(iterations: int, size: float):
    """Reweighted updates by Cholesky roots of R and P; weights start at the prediction."""
    for seed in range(10):
        system = kalman_system(seed)
        model, prior, inv = system.model, system.prior, np.linalg.inv
        y = np.random.default_rng(seed).normal(scale=size, size=model.p)
        filter = make("huber-kf", model, iterations=iterations)
        belief = filter.update(filter.init(prior), y)
        whitening, mean = [inv(np.linalg.cholesky(cov)) for cov in (model.R, prior.cov)], prior.mean
        for _ in range(iterations):
            V, P = (
                W.T @ np.diag(np.minimum(1.0, GAMMA / np.maximum(np.abs(W @ e), 1e-300))) @ W
                for W, e in zip(whitening, (y - model.C @ mean, prior.mean - mean), strict=True)
            )
            cov = inv(P + model.C.T @ V @ model.C)
            mean = cov @ (P @ prior.mean + model.C.T @ V @ y)
        # The formulas invert; the filter does not. Weights of 1 / 100 cost the inverses two digits
        # or so.
        assert_close(belief.mean, mean, 1e-10)
        np.testing.assert_allclose(belief.cov, cov, rtol=0, atol=1e-10 * np.abs(cov).max())


def test_an_exact_measurement_is_no_outlier():
    I2 = np.eye(2)
    filter = make("huber-kf", LinearModel(I2, I2, I2, np.diag([0.0, 1.0])))
    belief = filter.update(filter.init(Gaussian(np.zeros(2), I2)), [50.0, 50.0])
    assert belief.healthy
    np.testing.assert_allclose(belief.mean[0], 50.0, rtol=1e-12)
    assert belief.mean[1] < 5.0  # the noisy one is taken for an outlier


# --- robust-kf ------------------------------------------------------------------------------------


@pytest.mark.slow
@settings(derandomize=True, max_examples=200, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1), n=st.integers(1, 12), spread=st.floats(0.0, 4.0), size=st.floats(-9.0, 9.0),
    radius=st.floats(-8.0, 3.0).map(lambda power: 10.0**power),
)  # fmt: skip
def test_the_worst_covariance_has_the_relative_entropy_allowed(
    seed: int, n: int, spread: float, size: float, radius: float
):
    rng = np.random.default_rng(seed)
    axes = np.linalg.qr(rng.normal(size=(n, n)))[0]
    values = 10.0 ** (size + rng.uniform(-spread, 0.0, size=n))
    P = axes * values @ axes.T
    V = least_favourable_covariance(0.5 * (P + P.T), radius)
    np.testing.assert_array_equal(V, V.T)
    # Both have the same axes: growth 1 / (1 - x) along each, largest along the largest, x = theta l
    # below 1.
    growth = np.diagonal(axes.T @ V @ axes) / values
    x = 1.0 - 1.0 / growth
    theta = x / values
    # V is exact to rounding of its largest entry, which is that much more of its smallest.
    rounding = 1e-13 * V.max() / values
    assert (growth > 1.0 - rounding).all()
    np.testing.assert_allclose(
        theta, theta[values.argmax()], rtol=0, atol=(2.0 * rounding / values).max()
    )
    entropy = 0.5 * (growth - 1.0 - np.log(growth)).sum()
    sure = rounding.max() / x.max()
    np.testing.assert_allclose(entropy, 0.5 * radius, rtol=1e-10 + 10.0 * n * sure)


def test_the_worst_of_a_zero_variance_is_zero():
    P = np.stack([np.zeros((2, 2)), np.diag([0.0, 2.0]), np.full((2, 2), np.nan), np.eye(2)])
    V = least_favourable_covariance(P, 0.1)
    np.testing.assert_array_equal(V[:2], np.diag([0.0, 1.0]) * V[:2, 1:, 1:])
    assert V[0, 1, 1] == 0.0
    assert V[1, 1, 1] > 2.0
    assert not np.isfinite(V[2]).all()
    np.testing.assert_array_equal(V[3], least_favourable_covariance(np.eye(2), 0.1))


def test_a_robust_prediction_has_the_worst_covariance():
    """The worst prediction in the ball: Levy & Nikoukhah (2013), section III."""
    system = kalman_system(1)
    model, filter = system.model, make("robust-kf", system.model, radius=0.1)
    belief, plain = filter.init(system.prior), make("kf", model)
    expected = plain.init(system.prior)
    for _ in range(10):
        belief = filter.predict(filter.update(belief, np.ones(3)), np.ones(2))
        expected = plain.predict(plain.update(expected, np.ones(3)), np.ones(2))
        expected = expected.replace(cov=least_favourable_covariance(expected.cov, 0.1))
        assert_same(belief, expected, 1e-12)
