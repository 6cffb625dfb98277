"""Laws of the sigma points: covariances, digits, beliefs without variance."""

import dataclasses
from functools import partial

import numpy as np
import pytest
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
    small, prior = 1e-6 * np.eye(3), Gaussian([1.0, -0.5, 2.0], 1e-6 * np.eye(3))
    model = NonlinearModel(lambda x, u: np.sin(x), lambda x, u: x + 0.1 * x**3, small, small)
    y = model.measurement(model.transition(prior.mean, None), None) + 1e-3
    filters = (make("ukf", model, alpha=alpha) for alpha in (1e-3, 0.1))
    close, near = (f.update(f.predict(f.init(prior)), y) for f in filters)
    assert_close(close.mean, near.mean, 1e-9)
    assert_close(close.cov, near.cov, 1e-11)


# --- beliefs without variance ---------------------------------------------------------------------


@pytest.mark.parametrize("rank", [0, 1, 2, 3])
def test_a_singular_belief_is_that_of_the_kalman_filter(rank: int):
    system, root = kalman_system(0), np.random.default_rng(rank).normal(size=(4, rank))
    model = dataclasses.replace(system.model, Q=np.zeros((4, 4)))
    functions = NonlinearModel(model.transition, model.measurement, model.Q, model.R)
    beliefs = []
    for filter in (make("ukf", functions), make("kf", model)):
        belief = filter.init(Gaussian(np.zeros(4), root @ root.T))
        for _ in range(5):
            belief = filter.predict(filter.update(belief, np.ones(3)), np.ones(2))
            assert_covariance(belief.cov)
        beliefs.append(belief)
    assert_same(*beliefs, 1e-8)
    assert np.linalg.matrix_rank(beliefs[0].cov, tol=1e-9) == rank


def test_an_unknown_input_shows_in_an_exactly_known_state():
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
def test_a_beta_of_negative_variances_is_refused_with_the_bound(kappa: float, lowest: float):
    for name, make_system in (("ukf", turning_vehicle), ("ukf-umv", pushed_vehicle)):
        build = partial(make, name, make_system(0).model, kappa=kappa)
        build(beta=lowest)
        with pytest.raises(ValueError, match=f"beta must be at least .* = {lowest:g} for varian"):
            build(beta=lowest - 0.1)
