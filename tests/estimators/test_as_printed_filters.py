"""Filters as their papers print them, against the papers' formulas word for word."""

import numpy as np
import pytest

from estimators import Gaussian, LinearModel, make
from tests.estimators.cases import random_covariance

RNG = np.random.default_rng(5)
A, B, C, G, H = (RNG.normal(size=size) for size in ((3, 3), (3, 1), (2, 3), (3, 1), (2, 1)))
Q, R = random_covariance(RNG, 3), random_covariance(RNG, 2)
MODEL = LinearModel(0.3 * A, C, Q, R, 0.01 * B, G, H)


def test_table_2_5_is_followed_to_the_letter():
    """The table has no prior of d, so that d is given a wide one."""
    A, B, inverse, eye = MODEL.A, MODEL.B, np.linalg.inv(R), np.eye(3)
    kf = make("kf-umv-ui", MODEL, as_printed=True, input_prior=1e6)
    x, P = np.ones(3), np.eye(3)
    belief = kf.init(Gaussian(x, P))
    for y in RNG.normal(size=(4, 2)):
        K = P @ C.T @ np.linalg.inv(R + C @ P @ C.T)
        S = np.linalg.inv(H.T @ inverse @ (np.eye(2) - C @ K) @ H)
        d = S @ H.T @ inverse @ (np.eye(2) - C @ K) @ (y - C @ x)
        x = x + K @ (y - C @ x - H @ d)
        P = (eye + K @ H @ S @ H.T @ inverse @ C) @ (eye - K @ C) @ P
        belief = kf.update(belief, y)
        np.testing.assert_allclose(belief.mean, x, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(belief.cov, P, rtol=1e-8, atol=1e-9)
        np.testing.assert_allclose(belief.input_mean, d, rtol=1e-9, atol=1e-9)
        cross = B @ H.T @ inverse @ C @ A.T
        x, P = A @ x + B @ d, A @ P @ A.T + cross + cross.T + B @ S @ B.T + Q
        belief = kf.predict(belief, np.zeros(1))
        np.testing.assert_allclose(belief.mean, x, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(belief.cov, P, rtol=1e-8, atol=1e-9)


def test_without_b_table_2_5_says_what_to_do():
    with pytest.raises(ValueError, match="give it a LinearModel with a B, or leave as_printed out"):
        make("kf-umv-ui", LinearModel(A, C, Q, R, None, G, H), as_printed=True)


def test_filters_without_a_paper_do_not_know_as_printed():
    with pytest.raises(TypeError, match="enkf has no option 'as_printed'"):
        make("enkf", MODEL, as_printed=True)
