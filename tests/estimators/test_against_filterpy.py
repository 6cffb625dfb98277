"""The Kalman filter and its extension against FilterPy, an independent implementation."""

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter, KalmanFilter

from estimators import Gaussian, NonlinearModel, make
from tests.estimators.cases import kalman_system, random_covariance, simulate

SIZES = [(0, 1, 1, 1), (1, 2, 1, 1), (2, 3, 2, 1), (3, 5, 4, 3), (4, 2, 5, 2)]


@pytest.mark.parametrize(("seed", "n", "p", "m"), SIZES)
@pytest.mark.parametrize("name", ["kf", "ekf"])
def test_kalman_filters_agree_with_filterpy_on_random_models(
    name: str, seed: int, n: int, p: int, m: int
):
    system = kalman_system(seed, n, p, m)
    model, record = system.model, simulate(system, seed, runs=1, steps=60)
    other = KalmanFilter(dim_x=n, dim_z=p, dim_u=m)
    other.F, other.B, other.H, other.Q, other.R = model.A, model.B, model.C, model.Q, model.R
    other.x, other.P = system.mean[:, None].copy(), system.cov.copy()
    filter = make(name, model)
    belief = filter.init(system.prior)
    for k in range(60):
        y, u = record.y[k, 0], record.u[k, 0]
        R = None if k % 3 else model.R * (1.0 + k)
        belief = filter.update(belief, y, R=R)
        other.update(y[:, None], R=R)
        close = {"rtol": 0, "atol": 1e-11 * max(1.0, np.abs(other.x).max())}
        np.testing.assert_allclose(belief.mean, other.x[:, 0], **close)
        np.testing.assert_allclose(belief.cov, other.P, **close)
        np.testing.assert_allclose(belief.innovation, other.y[:, 0], **close)
        np.testing.assert_allclose(belief.innovation_cov, other.S, **close)
        belief = filter.predict(belief, u)
        other.predict(u[:, None])
        np.testing.assert_allclose(belief.mean, other.x[:, 0], **close)
        np.testing.assert_allclose(belief.cov, other.P, **close)


class _Analytic(ExtendedKalmanFilter):
    """FilterPy's extended filter for a nonlinear transition with its Jacobian."""

    def __init__(self, n: int, p: int, f, jacobian) -> None:
        super().__init__(dim_x=n, dim_z=p)
        self._f, self._jacobian = f, jacobian

    def predict_x(self, u=0):
        self.F = self._jacobian(self.x, u)
        self.x = self._f(self.x, u)


@pytest.mark.parametrize("seed", range(4))
def test_ekf_agrees_with_filterpy_given_analytic_jacobians(seed: int):
    rng = np.random.default_rng(seed)
    n, p = 3, 2
    A, B, C = 0.6 * rng.normal(size=(n, n)), rng.normal(size=(n, 1)), rng.normal(size=(p, n))
    Q, R, P = (random_covariance(rng, k) for k in (n, p, n))

    def f(x, u):
        return np.sin(np.matvec(A, x)) + np.matvec(B, u)

    def f_jacobian(x, u):
        return np.cos(A @ x)[:, None] * A

    def h(x, u):
        return np.matvec(C, x) + 0.1 * np.matvec(C, x) ** 3

    def h_jacobian(x):
        return (1.0 + 0.3 * (C @ x) ** 2)[:, None] * C

    filter = make("ekf", NonlinearModel(f, h, Q, R))
    mean = rng.normal(size=n)
    belief = filter.init(Gaussian(mean, P))
    other = _Analytic(n, p, f, f_jacobian)
    other.x, other.P, other.Q, other.R = mean.copy(), P.copy(), Q, R
    for _ in range(50):
        y, u = rng.normal(size=p), rng.normal(size=1)
        # One step at a time: a nonlinear filter may amplify rounding.
        other.x, other.P = belief.mean.copy(), belief.cov.copy()
        belief = filter.update(belief, y)
        other.update(y, h_jacobian, lambda x: h(x, None))
        np.testing.assert_allclose(belief.mean, other.x, rtol=0, atol=1e-11)
        np.testing.assert_allclose(belief.cov, other.P, rtol=0, atol=1e-11)
        np.testing.assert_allclose(belief.innovation, other.y, rtol=0, atol=1e-12)
        np.testing.assert_allclose(belief.innovation_cov, other.S, rtol=1e-11)
        other.x, other.P = belief.mean.copy(), belief.cov.copy()
        belief = filter.predict(belief, u)
        other.predict(u)
        np.testing.assert_allclose(belief.mean, other.x, rtol=0, atol=1e-12)
        np.testing.assert_allclose(belief.cov, other.P, rtol=0, atol=1e-11)
