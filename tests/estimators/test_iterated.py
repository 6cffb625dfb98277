"""The promise of `iekf` beyond the common laws: its update is the most probable state."""

import numpy as np
import pytest

from estimators import Gaussian, NonlinearModel, compiled, make, nis, wrap
from tests.estimators.cases import assert_same, simulate, track, turning_vehicle

R = np.diag([0.01, 1e-4])
BEACON = np.array([1.0, -2.0])


def _range_and_bearing(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
    north, east = np.moveaxis(x[..., :2] - BEACON, -1, 0)
    return np.stack([np.hypot(north, east), np.arctan2(east, north)], -1)


MODEL = NonlinearModel(
    lambda x, u: x, _range_and_bearing, 1e-4 * np.eye(2), R, measurement_angles=(1,)
)
"""Measurements so precise that their function is nonlinear over the spread of the prediction."""
PRIOR = Gaussian(np.zeros(2), np.array([[1.0, 0.3], [0.3, 0.5]]))


def _drawn(rows: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """True places, and a measurement of each."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(rows, 2)) @ np.linalg.cholesky(PRIOR.cov).T
    return x, _range_and_bearing(x, None) + rng.normal(size=(rows, 2)) * np.sqrt(np.diag(R))


def _updated(y: np.ndarray, available: np.ndarray | None = None, **options):
    filter = make("iekf", MODEL, **options)
    belief = filter.init(Gaussian(np.zeros((len(y), 2)), PRIOR.cov))
    return filter.update(belief, y, available=available)


def _jacobian(x: np.ndarray) -> np.ndarray:
    away = x - BEACON
    r = np.linalg.norm(away, axis=-1, keepdims=True)
    return np.stack([away / r, away[..., ::-1] * [-1.0, 1.0] / r**2], -2)


@pytest.mark.parametrize(
    "missing", [False, True], ids=["every measurement arrives", "measurements are missing"]
)
def test_the_gradient_of_the_posterior_is_zero_at_the_estimate(missing: bool):
    """Derivatives are written by hand; the density of the innovation is that of the minimum."""
    _, y = _drawn(400)
    seen = np.random.default_rng(1).random(y.shape) < 0.6 if missing else np.ones(y.shape, bool)
    off = {}
    for iterations in (1, 1000):  # a range alone: slowly
        belief = _updated(y, seen, iterations=iterations, tolerance=1e-12)
        e, C = y - _range_and_bearing(belief.mean, None), _jacobian(belief.mean)
        e = np.where(seen, np.stack([e[:, 0], wrap(e[:, 1])], -1), 0.0)
        prior = belief.mean @ np.linalg.inv(PRIOR.cov)
        gradient = prior - np.vecmat(e / np.diag(R), C)
        # in units of the estimate's own deviations
        off[iterations] = np.abs(np.vecmat(gradient, np.linalg.cholesky(belief.cov))).max(-1)
    assert off[1000].max() < 1e-6
    assert np.median(off[1]) > 0.1
    curvature = np.linalg.inv(PRIOR.cov) + C.mT @ ((seen / np.diag(R))[..., None] * C)
    np.testing.assert_allclose(belief.cov, np.linalg.inv(curvature), rtol=0, atol=1e-5)
    cost = np.vecdot(e / np.diag(R), e) + np.vecdot(belief.mean, prior)
    np.testing.assert_allclose(
        nis(belief.innovation, belief.innovation_cov), cost, rtol=1e-6, atol=1e-9
    )


def test_one_iteration_is_the_ekf():
    system = turning_vehicle(1)
    record = simulate(system, 1, 5, 15)
    available = np.random.default_rng(1).random(record.y.shape) < 0.7
    filters = make("iekf", system.model, iterations=1), make("ekf", system.model)
    tracks = (track(filter, system.rows(5), record, available=available) for filter in filters)
    for one, other in zip(*tracks, strict=True):
        assert_same(one, other, 1e-10)


def test_an_exact_state_stays_and_an_exact_measurement_is_met():
    model = NonlinearModel(
        lambda x, u: x, lambda x, u: np.exp(x[..., :1]) + x[..., 1:], np.zeros((2, 2)), [[0.0]]
    )
    filter = make("iekf", model, iterations=50, tolerance=1e-12)
    belief = filter.update(filter.init(Gaussian([0.5, 1.0], np.diag([1.0, 0.0]))), [4.0])
    np.testing.assert_allclose(belief.mean, [np.log(3.0), 1.0], rtol=0, atol=1e-9)
    assert belief.available.all()


def test_a_failing_iteration_costs_no_more_than_the_ekf():
    """The first step leads to where the square root is none: the estimate stays on this side."""
    model = NonlinearModel(lambda x, u: x, compiled(lambda x, u: np.sqrt(x)), [[1e-4]], [[1e-2]])
    filter = make("iekf", model)
    belief = filter.update(filter.init(Gaussian([[1.0], [1.0]], [[4.0]])), [[0.0], [1.5]])
    assert (np.abs(np.sqrt(belief.mean + 1e-6) - [[0.0], [1.5]]) < 0.01).all()
    assert (belief.cov < 0.1).all()
