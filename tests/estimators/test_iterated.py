"""What `iekf` promises beyond the common laws: its update is the most probable state."""

import dataclasses

import numpy as np
import pytest
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import least_squares

from estimators import Gaussian, NonlinearModel, Recovery, make, nees, wrap
from tests.estimators.cases import assert_same, simulate, track, turning_vehicle

R = np.diag([0.01, 1e-4])
BEACON = np.array([1.0, -2.0])


def _range_and_bearing(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
    away = x[..., :2] - BEACON
    return np.stack(
        [np.hypot(away[..., 0], away[..., 1]), np.arctan2(away[..., 1], away[..., 0])], -1
    )


MODEL = NonlinearModel(
    lambda x, u: x, _range_and_bearing, 1e-4 * np.eye(2), R, measurement_angles=(1,)
)
"""Measurements far more precise than the predicted place: the measurement function is nonlinear over its spread."""
PRIOR = Gaussian(np.zeros(2), np.array([[1.0, 0.3], [0.3, 0.5]]))


def _drawn(rows: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """True places, and a measurement of each."""
    rng = np.random.default_rng(seed)
    x = PRIOR.mean + rng.normal(size=(rows, 2)) @ np.linalg.cholesky(PRIOR.cov).T
    y = _range_and_bearing(x, None) + rng.normal(size=(rows, 2)) * np.sqrt(np.diag(R))
    return x, np.stack([y[:, 0], wrap(y[:, 1])], -1)


def _updated(
    y: np.ndarray, available: np.ndarray | None = None, model: NonlinearModel = MODEL, **options
):
    filter = make("iekf", model, **options)
    return filter.update(
        filter.init(Gaussian(np.zeros((len(y), 2)), PRIOR.cov)), y, available=available
    )


def _jacobian(x: np.ndarray) -> np.ndarray:
    north, east = np.moveaxis(x - BEACON, -1, 0)
    r2 = north**2 + east**2
    r = np.sqrt(r2)
    return np.stack(
        [np.stack([north / r, east / r], -1), np.stack([-east / r2, north / r2], -1)], -2
    )


def _gradient(x: np.ndarray, y: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Of the negative log of the posterior, by derivatives written by hand."""
    e = y - _range_and_bearing(x, None)
    e = np.where(seen, np.stack([e[:, 0], wrap(e[:, 1])], -1), 0.0)
    return np.linalg.solve(PRIOR.cov, (x - PRIOR.mean)[..., None])[..., 0] - np.vecmat(
        e / np.diag(R), _jacobian(x)
    )


@pytest.mark.parametrize(
    "missing", [False, True], ids=["every measurement arrives", "measurements are missing"]
)
def test_the_estimate_is_where_the_gradient_of_the_posterior_is_zero(missing: bool):
    _, y = _drawn(400)
    seen = np.random.default_rng(1).random(y.shape) < 0.6 if missing else np.ones(y.shape, bool)
    belief = _updated(y, seen, iterations=1000, tolerance=1e-12)  # a range alone: slowly
    # In units of the estimate's own deviations: by how many of them it is off the point where the
    # gradient is zero.
    off = np.abs(np.vecmat(_gradient(belief.mean, y, seen), np.linalg.cholesky(belief.cov)))
    assert off.max() < 1e-6
    once = _updated(y, seen, iterations=1)
    assert (
        np.median(
            np.abs(np.vecmat(_gradient(once.mean, y, seen), np.linalg.cholesky(once.cov))).max(-1)
        )
        > 0.1
    )


def test_it_is_the_minimum_that_an_optimiser_finds_from_the_prediction():
    _, y = _drawn(60, seed=2)
    belief = _updated(y, iterations=100, tolerance=1e-12)
    root = cholesky(PRIOR.cov, lower=True)

    def residuals(x: np.ndarray, measurement: np.ndarray) -> np.ndarray:
        e = measurement - _range_and_bearing(x, None)
        e = np.array([e[0], float(wrap(e[1]))]) / np.sqrt(np.diag(R))
        return np.concatenate([e, solve_triangular(root, x - PRIOR.mean, lower=True)])

    for row, measurement in enumerate(y):
        found = least_squares(
            residuals, PRIOR.mean, args=(measurement,), xtol=1e-14, ftol=1e-14, gtol=1e-14
        )
        np.testing.assert_allclose(belief.mean[row], found.x, rtol=0, atol=1e-6)
        curvature = np.linalg.inv(found.jac.T @ found.jac)
        np.testing.assert_allclose(
            belief.cov[row], curvature, rtol=0, atol=1e-5 * np.abs(curvature).max()
        )
        # The innovation's density is that of the posterior's cost at its minimum: nothing is lost
        # in between.
        nis = belief.innovation[row] @ np.linalg.solve(
            belief.innovation_cov[row], belief.innovation[row]
        )
        assert nis == pytest.approx(2.0 * found.cost, rel=1e-6)


def test_one_iteration_is_the_ekf():
    system = turning_vehicle(1)
    record = simulate(system, 1, 5, 15)
    available = np.random.default_rng(1).random(record.y.shape) < 0.7
    once, ekf = make("iekf", system.model, iterations=1), make("ekf", system.model)
    ekf._programs = None  # the same NumPy
    tracks = (track(filter, system.rows(5), record, available=available) for filter in (once, ekf))
    for one, other in zip(*tracks, strict=True):
        assert_same(one, other)


def test_it_knows_better_than_the_ekf_how_good_it_is_and_is_better():
    """Precise measurements of an uncertain place: the mean NEES of 4,000 has a standard error of 0.03 if it is 1."""
    x, y = _drawn(4000, seed=3)
    iterated, once = _updated(y), _updated(y, iterations=1)
    better = nees(iterated.mean, iterated.cov, x)
    assert abs(better.mean() - 2.0) < 0.3
    assert nees(once.mean, once.cov, x).mean() > 10.0
    errors = [np.sqrt(np.square(b.mean - x).sum(-1).mean()) for b in (iterated, once)]
    assert errors[0] < 0.5 * errors[1]


def test_where_whole_steps_would_climb_they_are_made_shorter():
    """``y = arctan(x)``, read where it is flat: Newton's steps from 0 leap further each time."""
    model = NonlinearModel(lambda x, u: x, lambda x, u: np.arctan(3.0 * x), [[1e-4]], [[1e-4]])
    filter = make("iekf", model, iterations=100, tolerance=1e-10)
    for place in (0.3, 1.0, 2.5):
        y = np.arctan(3.0 * place)
        belief = filter.update(filter.init(Gaussian([-2.5], [[9.0]])), [y])
        x = belief.mean[0]
        gradient = (x + 2.5) / 9.0 - (y - np.arctan(3.0 * x)) * 3.0 / (1.0 + 9.0 * x * x) / 1e-4
        assert abs(gradient) * np.sqrt(belief.cov[0, 0]) < 1e-6
        assert abs(x - place) < 0.5


def test_an_angle_is_compared_the_short_way_at_every_estimate():
    """The same measurements, with every bearing a whole turn further or nearer."""
    _, y = _drawn(50, seed=4)
    turned = y + np.array([0.0, 2.0 * np.pi]) * np.random.default_rng(4).integers(-2, 3, (50, 1))
    assert_same(_updated(turned), _updated(y), 1e-8)


def test_a_state_that_is_known_exactly_stays_and_a_perfect_measurement_is_met():
    model = NonlinearModel(
        lambda x, u: x, lambda x, u: np.exp(x[..., :1]) + x[..., 1:], np.zeros((2, 2)), [[0.0]]
    )
    filter = make("iekf", model, iterations=50, tolerance=1e-12)
    belief = filter.update(filter.init(Gaussian([0.5, 1.0], np.diag([1.0, 0.0]))), [4.0])
    np.testing.assert_allclose(belief.mean, [np.log(3.0), 1.0], rtol=0, atol=1e-9)
    assert belief.recovery < Recovery.PREDICTION


def test_a_function_that_fails_away_from_the_prediction_costs_no_more_than_the_ekf():
    """The first step leads to where the square root is none: the estimate stays on this side."""
    model = NonlinearModel(lambda x, u: x, lambda x, u: np.sqrt(x), [[1e-4]], [[1e-2]])
    filter = make("iekf", model)
    belief = filter.update(filter.init(Gaussian([[1.0], [1.0]], [[4.0]])), [[0.0], [1.5]])
    assert np.isfinite(belief.mean).all()
    assert (belief.recovery < Recovery.PREDICTION).all()


def test_a_row_is_not_moved_by_the_iterations_that_others_need():
    _, y = _drawn(20, seed=5)
    together = _updated(y)
    for row in range(20):
        assert_same(together[row : row + 1], _updated(y[row : row + 1]), 1e-12)


def test_iterations_that_end_too_soon_leave_a_belief():
    _, y = _drawn(50, seed=6)
    for iterations in (2, 3):
        belief = _updated(y, iterations=iterations, tolerance=1e-12)
        assert belief.healthy.all()
        assert np.isfinite(belief.mean).all()


def test_an_own_jacobian_serves_at_every_estimate():
    model = dataclasses.replace(MODEL, measurement_jacobian=lambda x, u: _jacobian(x))
    _, y = _drawn(30, seed=7)
    assert_same(_updated(y, model=model), _updated(y), 1e-6)
