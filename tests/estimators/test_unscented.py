"""Laws of the sigma points: FilterPy's sums, exact moments, beliefs without variance."""

import dataclasses

import numpy as np
import pytest
from filterpy.kalman import MerweScaledSigmaPoints
from filterpy.kalman import UnscentedKalmanFilter as FilterPyUnscented
from hypothesis import given, settings
from hypothesis import strategies as st

from estimators import Gaussian, LinearModel, NonlinearModel, make
from tests.estimators.cases import (
    assert_covariance,
    assert_same,
    kalman_system,
    pushed_vehicle,
    random_covariance,
    turning_vehicle,
)

POINTS = [
    {},
    {"alpha": 0.3, "kappa": 1.0},
    {"alpha": 1.0, "beta": 0.0, "kappa": 0.0},
    {"alpha": 0.5, "kappa": -1.5},
]
"""The defaults; close points; cubature points; a negative weight in the middle."""


# --- against FilterPy -----------------------------------------------------------------------------


def _nonlinear(seed: int) -> NonlinearModel:
    rng = np.random.default_rng(seed)
    A, B, C = 0.6 * rng.normal(size=(3, 3)), rng.normal(size=(3, 1)), rng.normal(size=(2, 3))
    return NonlinearModel(
        lambda x, u: np.sin(np.matvec(A, x)) + np.matvec(B, u),
        lambda x, u: np.matvec(C, x) + 0.1 * np.matvec(C, x) ** 3,
        random_covariance(rng, 3), random_covariance(rng, 2),
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("points", POINTS, ids=str)
@pytest.mark.parametrize("seed", range(3))
def test_ukf_agrees_with_filterpy(seed: int, points: dict[str, float]):
    model, rng = _nonlinear(seed), np.random.default_rng(seed)
    weights = {"alpha": 1.0, "beta": 2.0, "kappa": 0.0, **points}
    other = FilterPyUnscented(
        3, 2, dt=1.0, fx=lambda x, dt, u: model.transition(x, u),
        hx=lambda x: model.measurement(x, None),
        points=MerweScaledSigmaPoints(3, **weights),
    )  # fmt: skip
    filter = make("ukf", model, **points)
    belief = filter.init(Gaussian(rng.normal(size=3), random_covariance(rng, 3)))
    other.Q, other.R = model.Q, model.R
    for k in range(30):
        y, u = rng.normal(size=2), rng.normal(size=1)
        R = model.R * (1.0 + k % 3)
        # One step at a time: a nonlinear filter amplifies rounding.
        other.x, other.P = belief.mean.copy(), belief.cov.copy()
        belief = filter.predict(belief, u)
        other.predict(u=u)
        close = {"rtol": 0, "atol": 1e-11 * max(1.0, np.abs(other.P).max(), np.abs(other.x).max())}
        np.testing.assert_allclose(belief.mean, other.x, **close)
        np.testing.assert_allclose(belief.cov, other.P, **close)
        belief = filter.update(belief, y, R=R)
        other.update(y, R=R)
        np.testing.assert_allclose(belief.mean, other.x, **close)
        np.testing.assert_allclose(belief.cov, other.P, **close)
        np.testing.assert_allclose(belief.innovation, other.y, **close)
        np.testing.assert_allclose(belief.innovation_cov, other.S, rtol=1e-10)


# --- moments --------------------------------------------------------------------------------------


SQUARE = make(
    "ukf",
    NonlinearModel(lambda x, u: x**2, lambda x, u: x**2, [[0.0]], [[1.0]]),
    alpha=1.0,
    beta=0.0,
    kappa=2.0,
)


@settings(derandomize=True, max_examples=40, deadline=None)
@given(mean=st.floats(-3.0, 3.0), variance=st.floats(1e-3, 4.0))
def test_mean_and_variance_of_a_square_are_exact(mean: float, variance: float):
    """Mean m^2 + P and variance 4 m^2 P + 2 P^2: with kappa = 3 - n and beta = 0, exactly."""
    filter = SQUARE
    belief = filter.init(Gaussian([mean], [[variance]]))
    squared = 4.0 * mean**2 * variance + 2.0 * variance**2
    predicted = filter.predict(belief)
    assert predicted.mean[0] == pytest.approx(mean**2 + variance, rel=1e-13)
    assert predicted.cov[0, 0] == pytest.approx(squared, rel=1e-13)
    updated = filter.update(belief, [0.0])
    assert updated.innovation[0] == pytest.approx(-(mean**2) - variance, rel=1e-13)
    assert updated.innovation_cov[0, 0] == pytest.approx(squared + 1.0, rel=1e-13)
    gain = 2.0 * mean * variance / (squared + 1.0)
    assert updated.mean[0] == pytest.approx(
        mean - gain * (mean**2 + variance), rel=1e-12, abs=1e-13
    )
    assert updated.cov[0, 0] == pytest.approx(variance - gain * 2.0 * mean * variance, rel=1e-11)


@settings(derandomize=True, max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(1, 6),
    alpha=st.floats(1e-3, 2.0),
    kappa=st.floats(-0.9, 3.0),
    above=st.floats(0.0, 2.0),
)
def test_every_transform_that_is_accepted_gives_covariances(
    seed: int, n: int, alpha: float, kappa: float, above: float
):
    """At the lowest beta too, where the weight of the middle is as negative as it may be."""
    rng = np.random.default_rng(seed)
    M = rng.normal(size=(n, n))
    model = NonlinearModel(
        lambda x, u: np.cos(np.matvec(M, x)),
        lambda x, u: np.matvec(M, x) ** 2,
        np.zeros((n, n)),
        np.zeros((n, n)),
    )
    lowest = 0.0 - alpha**2 * (kappa * n) / n
    filter = make("ukf", model, alpha=alpha, kappa=kappa * n, beta=max(lowest, -50.0) + above)
    belief = filter.predict(
        filter.init(Gaussian(rng.normal(size=(4, n)), random_covariance(rng, n)))
    )
    assert_covariance(belief.cov, 1.0)
    S = filter.update(
        filter.init(Gaussian(rng.normal(size=(4, n)), random_covariance(rng, n))), np.zeros(n)
    )
    assert_covariance(S.cov, 1.0)


def test_close_points_lose_no_digits_to_their_large_weights():
    """Weights are 1e6, of both signs; the result is a Jacobian's but for the second order in P."""
    model = _nonlinear(0)
    model = dataclasses.replace(model, Q=1e-6 * model.Q, R=1e-6 * model.R)
    rng = np.random.default_rng(0)
    prior = Gaussian(rng.normal(size=3), 1e-6 * random_covariance(rng, 3))
    u = np.ones(1)
    y = model.measurement(model.transition(prior.mean, u), u) + 1e-3
    close, near, jacobian = (
        filter.update(filter.predict(filter.init(prior), u), y)
        for filter in (
            make("ukf", model, alpha=1e-3),
            make("ukf", model, alpha=0.1),
            make("ekf", model),
        )
    )
    np.testing.assert_allclose(close.mean, near.mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(close.cov, near.cov, rtol=0, atol=1e-11)
    np.testing.assert_allclose(close.mean, jacobian.mean, rtol=0, atol=1e-5)
    np.testing.assert_allclose(close.cov, jacobian.cov, rtol=0, atol=1e-10)


# --- beliefs without variance ---------------------------------------------------------------------


@pytest.mark.parametrize("rank", [0, 1, 2, 3])
def test_a_belief_without_variance_in_some_directions_is_carried_on_as_by_the_kalman_filter(
    rank: int,
):
    system, rng = kalman_system(0), np.random.default_rng(rank)
    root = rng.normal(size=(4, rank))
    model = dataclasses.replace(system.model, Q=np.zeros((4, 4)))
    prior = Gaussian(np.zeros(4), root @ root.T)
    functions = NonlinearModel(model.transition, model.measurement, model.Q, model.R)
    beliefs = []
    for filter in (make("ukf", functions), make("kf", model)):
        belief = filter.init(prior)
        for _ in range(5):
            belief = filter.predict(filter.update(belief, np.ones(3)), np.ones(2))
            assert_covariance(belief.cov)
        beliefs.append(belief)
    assert_same(*beliefs, 1e-8)
    assert np.linalg.matrix_rank(beliefs[0].cov, tol=1e-9) == rank


def test_an_unknown_input_shows_in_a_state_that_was_known_exactly():
    """Without variance along G the points do not spread, but C is the derivative there."""
    model = LinearModel(
        A=[[1.0, 0.1], [0.0, 1.0]],
        C=np.eye(2),
        Q=np.diag([1.0, 0.0]),
        R=np.eye(2),
        G=[[0.0], [1.0]],
    )
    functions = NonlinearModel(model.transition, model.measurement, model.Q, model.R, G=model.G)
    beliefs = []
    for filter in (make("ukf-umv", functions), make("kf-umv-ui-wdf", model)):
        belief = filter.predict(filter.init(Gaussian([30.0, -2.0], np.zeros((2, 2)))))
        beliefs.append(filter.update(belief, [30.0, 5.0]))
    assert beliefs[0].input_mean[0] == pytest.approx(7.0, abs=1e-8)
    assert_same(*beliefs, 1e-8)


# --- options --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["ukf", "ukf-umv"])
@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"alpha": 0.0}, "alpha must be positive"),
        ({"alpha": np.nan}, "alpha must be positive"),
        ({"kappa": -4.0}, "kappa must be above -n = -4"),
        ({"beta": -0.1}, "beta must be at least .* = 0 for variances to be, got -0.1"),
        ({"kappa": -2.0, "beta": 0.4}, "beta must be at least .* = 0.5 for"),
        ({"kappa": 2.0, "beta": -0.6}, "beta must be at least .* = -0.5 for"),
    ],
)
def test_options_that_would_give_negative_variances_are_refused_with_the_bound(
    name: str, options: dict[str, float], problem: str
):
    model = (turning_vehicle if name == "ukf" else pushed_vehicle)(0).model
    with pytest.raises(ValueError, match=problem):
        make(name, model, **options)
