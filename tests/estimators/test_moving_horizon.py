"""What `mhe` promises beyond the common laws: the most probable course of the last states, whatever the horizon."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares

from estimators import Belief, Gaussian, LinearModel, NonlinearModel, Recovery, make, nees
from tests.estimators.cases import (
    System,
    assert_same,
    kalman_system,
    simulate,
    some_measurements,
    track,
    turning_vehicle,
)  # fmt: skip


def _as_belief(window: Belief) -> Belief:
    return Belief(**{name: getattr(window, name) for name in Belief.__dataclass_fields__})


@pytest.mark.parametrize("horizon", [1, 2, 5, 30])
@pytest.mark.parametrize("functions", [False, True], ids=["matrices", "linear functions"])
def test_on_a_linear_system_it_is_the_kf_for_every_horizon(horizon: int, functions: bool):
    system = kalman_system(0)
    model, record = system.model, simulate(system, 0, 3, 20)
    available = some_measurements(np.random.default_rng(0), model.p, 20, 3)
    told = NonlinearModel(model.transition, model.measurement, model.Q, model.R) if functions else model
    mhe = track(make("mhe", told, horizon=horizon), system.rows(3), record, available=available)
    for one, other in zip(mhe, track(make("kf", model), system.rows(3), record, available=available), strict=True):
        assert_same(_as_belief(one), other, 1e-8 if functions else 1e-11)  # Jacobians by differences


def test_with_a_horizon_of_1_it_is_the_iekf_where_that_takes_whole_steps():
    system = turning_vehicle(3)
    system = dataclasses.replace(system, model=dataclasses.replace(system.model, R=0.1 * system.model.R))
    record = simulate(system, 3, 5, 15)
    options = {"iterations": 50, "tolerance": 1e-11}
    mhe = track(make("mhe", system.model, horizon=1, **options), system.rows(5), record)
    for one, other in zip(mhe, track(make("iekf", system.model, **options), system.rows(5), record), strict=True):
        assert_same(_as_belief(one), other, 1e-7)


def test_where_steps_must_be_shorter_it_stays_finite_and_the_iekf_alone_arrives():
    """Whole steps of Gauss and Newton's method on an arc tangent from far away go farther yet."""
    model = NonlinearModel(lambda x, u: x, lambda x, u: np.arctan(x), [[1e-4]], [[1e-4]])
    prior = Gaussian([[3.0], [5.0]], [[100.0]])
    for name, arrives in (("iekf", True), ("mhe", False)):
        filter = make(name, model, **({"horizon": 1} if name == "mhe" else {}))
        belief = filter.update(filter.init(prior), np.zeros((2, 1)))
        assert np.isfinite(belief.mean).all()
        np.testing.assert_array_equal(np.abs(belief.mean[:, 0]) < 1e-2, arrives)


def test_the_horizon_counts_times_whether_or_not_a_measurement_came():
    system = kalman_system(0)
    filter = make("mhe", system.model, horizon=3)
    belief = filter.update(filter.init(system.prior), np.ones(3))
    seen = []
    for _ in range(3):
        seen.append(belief.seen.any(-1).tolist())
        belief = filter.predict(belief, np.zeros(2))
    assert seen == [[False, False, True], [False, True, False], [True, False, False]]
    assert not belief.seen.any()
    twice = filter.update(filter.update(belief, np.ones(3)), np.ones(3))
    assert twice.seen.any(-1).tolist() == [False, True, True]


BEACONS = np.array([[-3.0, 0.0], [0.0, 4.0]])


def _ranges(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
    return np.linalg.norm(x[..., None, :2] - BEACONS, axis=-1)


def _drift(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
    north, east, heading = np.moveaxis(x, -1, 0)
    return np.stack([north + 0.3 * np.cos(heading), east + 0.3 * np.sin(heading), heading + 0.1], -1)


RANGES = NonlinearModel(_drift, _ranges, np.diag([1e-3, 1e-3, 1e-3]), 1e-3 * np.eye(2), state_angles=(2,))
START = System(RANGES, np.zeros(3), np.diag([1.0, 1.0, 1.0]), 0)
"""Distances to two beacons, read far more precisely than the start is known, and a heading that nobody reads."""


def _course(rows: int, steps: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    x, xs, ys = START.mean + rng.normal(size=(rows, 3)) * np.sqrt(np.diag(START.cov)), [], []
    for k in range(steps):
        x = _drift(x, None) + rng.normal(size=x.shape) * np.sqrt(1e-3) if k else x
        xs.append(x)
        ys.append(_ranges(x, None) + rng.normal(size=(rows, 2)) * np.sqrt(1e-3))
    return np.array(xs), np.array(ys)


def _followed(name: str, ys: np.ndarray, **options: object) -> list[Belief]:
    filter = make(name, RANGES, **options)
    belief, beliefs = filter.init(START.rows(ys.shape[1])), []
    for k, y in enumerate(ys):
        belief = filter.update(filter.predict(belief) if k else belief, y)
        beliefs.append(belief)
    return beliefs


def test_the_course_is_what_an_optimiser_finds_of_all_measurements():
    """While nothing has left the window: the minimum of the whole cost, over the states of all times at once."""
    _, ys = _course(12, 6, 1)
    ys[3, :, 0] = np.nan
    beliefs = _followed("mhe", ys, horizon=6, iterations=200, tolerance=1e-11)
    roots = [np.linalg.cholesky(cov) for cov in (START.cov, RANGES.Q)]
    found = 0
    for row in range(12):

        def residuals(z: np.ndarray, row: int = row) -> np.ndarray:
            x = z.reshape(6, 3)
            parts = [solve_triangular(roots[0], x[0], lower=True)]
            parts += [solve_triangular(roots[1], b - _drift(a, None), lower=True) for a, b in pairwise(x)]
            return np.concatenate([*parts, np.nan_to_num((ys[:, row] - _ranges(x, None)) / np.sqrt(1e-3)).ravel()])

        states = beliefs[-1].states[row]
        best = least_squares(residuals, states.ravel(), xtol=1e-15, ftol=1e-15, gtol=1e-15)
        cov = np.linalg.inv(best.jac.T @ best.jac)
        off = np.abs(best.x.reshape(6, 3) - states) / np.sqrt(np.diag(cov)).reshape(6, 3)
        found += off.max() < 1e-4
        np.testing.assert_allclose(beliefs[-1].mean[row], states[-1], rtol=0, atol=1e-9)
        if off.max() < 1e-4:
            np.testing.assert_allclose(beliefs[-1].cov[row], cov[-3:, -3:], rtol=0, atol=1e-4 * np.abs(cov).max())
    assert found >= 11  # Gauss and Newton's method without shorter steps may miss one


def test_a_longer_memory_of_the_measurements_is_worth_it_where_the_start_is_hardly_known():
    """The distance to one beacon, and dead reckoning: where the place is shows after several measurements alone.

    The mean NEES of 300 runs has a standard error of 0.12 where it is true: 2.5 is 4 of them above.
    """
    beacon, rng, runs = np.array([-10.0, 0.0]), np.random.default_rng(7), 300
    model = NonlinearModel(
        lambda x, u: x + u,
        lambda x, u: np.linalg.norm(x - beacon, axis=-1, keepdims=True),
        0.0025 * np.eye(2),
        [[0.01]],
    )
    filters = [make("ekf", model), make("iekf", model), make("mhe", model, iterations=20)]
    beliefs = [f.init(Gaussian(np.zeros((runs, 2)), 9.0 * np.eye(2))) for f in filters]
    x = 3.0 * rng.normal(size=(runs, 2))
    for k in range(12):
        u = np.array([np.cos(0.3 * k), np.sin(0.3 * k)])
        x = x + u + 0.05 * rng.normal(size=x.shape)
        y = model.measurement(x, None) + 0.1 * rng.normal(size=(runs, 1))
        beliefs = [f.update(f.predict(b, u), y) for f, b in zip(filters, beliefs, strict=True)]
    ekf, iekf, mhe = (np.sqrt(np.square(b.mean - x).sum(-1).mean()) for b in beliefs)
    assert mhe < 0.7 * iekf
    assert mhe < 0.5 * ekf
    consistent = [nees(b.mean, b.cov, x).mean() for b in beliefs]
    assert consistent[0] > 10.0
    assert consistent[2] < 2.5


def test_two_measurements_of_one_time_and_predictions_without_any():
    system = kalman_system(1)
    filters = [make("mhe", system.model, horizon=3), make("kf", system.model)]
    beliefs, rng = [f.init(system.rows(2)) for f in filters], np.random.default_rng(0)
    for k in range(12):
        y, u = rng.normal(size=(2, 3)), rng.normal(size=(2, 2))
        if k % 3 != 1:
            beliefs = [f.predict(b, u) for f, b in zip(filters, beliefs, strict=True)]
        if k % 4 != 2:
            beliefs = [f.update(b, y) for f, b in zip(filters, beliefs, strict=True)]
        for name in ("mean", "cov"):
            np.testing.assert_allclose(*(getattr(b, name) for b in beliefs), rtol=0, atol=1e-10)


def test_rows_that_begin_again_join_rows_that_run():
    system = turning_vehicle(0)
    record, filter = simulate(system, 0, 4, 6), make("mhe", system.model, horizon=3)
    belief, mask = track(filter, system.rows(4), record)[-1], np.array([True, False, False, True])
    fresh = filter.init(system.rows(2))
    merged = filter.update(filter.predict(belief.with_rows(mask, fresh), record.u[0]), record.y[1])
    alone = filter.update(filter.predict(fresh, record.u[0, mask]), record.y[1, mask])
    whole = filter.update(filter.predict(belief, record.u[0]), record.y[1])
    assert_same(merged[mask], alone, 1e-12)
    assert_same(merged[~mask], whole[~mask], 1e-12)


def test_a_row_that_recovers_goes_on_from_what_it_then_believes():
    """Two perfect sensors that repeat each other: `kf` with the pseudo-inverse, and the same from then on."""
    model = LinearModel(0.9 * np.eye(2), [[1.0, 0.0], [1.0, 0.0]], 0.1 * np.eye(2), np.zeros((2, 2)))
    filters = [make("mhe", model), make("kf", model)]
    beliefs = [f.init(Gaussian(np.zeros(2), np.eye(2))) for f in filters]
    for y in (1.0, 0.5, 0.7):
        beliefs = [f.update(f.predict(b), [y, y]) for f, b in zip(filters, beliefs, strict=True)]
        for name in ("mean", "cov", "recovery"):
            np.testing.assert_allclose(*(getattr(b, name) for b in beliefs), rtol=0, atol=1e-12)
        assert beliefs[0].recovery == Recovery.PSEUDO_INVERSE
    np.testing.assert_array_equal(beliefs[0].start_mean, beliefs[0].mean)


def test_a_function_that_fails_loses_its_row_alone():
    model = NonlinearModel(lambda x, u: np.sqrt(x), lambda x, u: x, 0.01 * np.eye(1), np.eye(1))
    filter = make("mhe", model, horizon=3)
    belief = filter.init(Gaussian([[4.0], [-1.0]], [[0.01]]))
    for _ in range(3):
        belief = filter.update(filter.predict(belief), [[1.5], [1.5]])
        assert np.isfinite(belief.mean).all()
        assert belief.recovery[0] == Recovery.USUAL
