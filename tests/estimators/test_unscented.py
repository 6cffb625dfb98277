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
    assert_close,
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
        assert_close(belief.mean, other.x, 1e-11)
        assert_close(belief.cov, other.P, 1e-11)
        belief = filter.update(belief, y, R=R)
        other.update(y, R=R)
        found = belief.mean, belief.cov, belief.innovation, belief.innovation_cov
        for one, expected in zip(found, (other.x, other.P, other.y, other.S), strict=True):
            assert_close(one, expected, 1e-11)


# --- moments --------------------------------------------------------------------------------------


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
    M, zero = rng.normal(size=(n, n)), np.zeros((n, n))
    model = NonlinearModel(
        lambda x, u: np.cos(np.matvec(M, x)), lambda x, u: np.matvec(M, x) ** 2, zero, zero
    )
    beta = max(-(alpha**2) * kappa, -50.0) + above
    filter = make("ukf", model, alpha=alpha, kappa=kappa * n, beta=beta)
    belief = filter.init(Gaussian(rng.normal(size=(4, n)), random_covariance(rng, n)))
    assert_covariance(filter.predict(belief).cov, 1.0)
    assert_covariance(filter.update(belief, np.zeros(n)).cov, 1.0)


def test_close_points_lose_no_digits_to_their_large_weights():
    """Weights are 1e6, of both signs; the result is that of less close points."""
    model = _nonlinear(0)
    model = dataclasses.replace(model, Q=1e-6 * model.Q, R=1e-6 * model.R)
    rng = np.random.default_rng(0)
    prior = Gaussian(rng.normal(size=3), 1e-6 * random_covariance(rng, 3))
    u = np.ones(1)
    y = model.measurement(model.transition(prior.mean, u), u) + 1e-3
    filters = (make("ukf", model, alpha=alpha) for alpha in (1e-3, 0.1))
    close, near = (f.update(f.predict(f.init(prior), u), y) for f in filters)
    assert_close(close.mean, near.mean, 1e-9)
    assert_close(close.cov, near.cov, 1e-11)


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
        [[1.0, 0.1], [0.0, 1.0]], np.eye(2), np.diag([1.0, 0.0]), np.eye(2), G=[[0.0], [1.0]]
    )
    functions = NonlinearModel(model.transition, model.measurement, model.Q, model.R, G=model.G)
    beliefs = []
    for filter in (make("ukf-umv", functions), make("kf-umv-ui-wdf", model)):
        belief = filter.predict(filter.init(Gaussian([30.0, -2.0], np.zeros((2, 2)))))
        beliefs.append(filter.update(belief, [30.0, 5.0]))
    assert beliefs[0].input_mean[0] == pytest.approx(7.0, abs=1e-8)
    assert_same(*beliefs, 1e-8)


# --- options --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("kappa", "lowest"), [(0.0, 0.0), (-2.0, 0.5), (2.0, -0.5)])
@pytest.mark.parametrize("name", ["ukf", "ukf-umv"])
def test_a_beta_that_would_give_negative_variances_is_refused_with_the_bound(
    name: str, kappa: float, lowest: float
):
    model = (turning_vehicle if name == "ukf" else pushed_vehicle)(0).model
    make(name, model, kappa=kappa, beta=lowest)
    with pytest.raises(ValueError, match=f"beta must be at least .* = {lowest:g} for variances"):
        make(name, model, kappa=kappa, beta=lowest - 0.1)
