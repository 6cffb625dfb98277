"""The extended Kalman filter against FilterPy, an independent implementation."""

from typing import Any

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter

from estimators import Gaussian, NonlinearModel, compiled, make
from tests.estimators.cases import random_covariance


@pytest.mark.parametrize("seed", range(4))
def test_given_analytic_jacobians(seed: int):
    rng = np.random.default_rng(seed)
    A, C = 0.6 * rng.normal(size=(3, 3)), rng.normal(size=(2, 3))
    Q, R, P = (random_covariance(rng, k) for k in (3, 2, 3))

    def f(x: np.ndarray, u: Any) -> np.ndarray:
        return np.sin(np.matvec(A, x))

    def h(x: np.ndarray, u: Any = None) -> np.ndarray:
        return np.matvec(C, x) + 0.1 * np.matvec(C, x) ** 3

    class Analytic(ExtendedKalmanFilter):
        def predict_x(self, u: Any = 0) -> None:
            self.F, self.x = np.cos(A @ self.x)[:, None] * A, f(self.x, u)

    filter, other = (
        make("ekf", NonlinearModel(compiled(f), compiled(h), Q, R)),
        Analytic(dim_x=3, dim_z=2),
    )
    belief = filter.init(Gaussian(rng.normal(size=3), P))
    other.Q, other.R = Q, R
    for y in rng.normal(size=(50, 2)):
        # One step at a time: a nonlinear filter may amplify rounding.
        other.x, other.P = belief.mean.copy(), belief.cov.copy()
        belief = filter.update(belief, y)
        other.update(y, lambda x: (1.0 + 0.3 * (C @ x) ** 2)[:, None] * C, h)
        np.testing.assert_allclose(belief.mean, other.x, rtol=0, atol=1e-11)
        np.testing.assert_allclose(belief.cov, other.P, rtol=0, atol=1e-11)
        np.testing.assert_allclose(belief.innovation, other.y, rtol=0, atol=1e-12)
        np.testing.assert_allclose(belief.innovation_cov, other.S, rtol=1e-11)
        other.x, other.P = belief.mean.copy(), belief.cov.copy()
        belief = filter.predict(belief)
        other.predict()
        np.testing.assert_allclose(belief.mean, other.x, rtol=0, atol=1e-12)
        np.testing.assert_allclose(belief.cov, other.P, rtol=0, atol=1e-11)
