"""One source of every filter's equations: compiled, in NumPy, and with a user's model that is NumPy."""

from dataclasses import replace

import numpy as np
import pytest

from estimators import Gaussian, LinearModel, NonlinearModel, RandomKeys, Schedule, make
from tests.estimators.cases import (
    Case,
    assert_same,
    one_of_each,
    simulate,
    some_measurements,
)


def _row_by_row(f):
    """A function that nothing can trace: it makes a Python list of rows, of which each is an array."""

    def rows(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        u = np.broadcast_to(u, x.shape[:-1] + u.shape[-1:])
        found = [f(x[row], u[row]) for row in np.ndindex(x.shape[:-1])]
        return np.array([each.tolist() for each in found]).reshape(*x.shape[:-1], *found[0].shape)

    return rows


def _in_numpy(case: Case, model: LinearModel) -> LinearModel | NonlinearModel:
    """The model as a user writes it: functions of NumPy, matrices for filters of linear models."""
    A, B, C = model.A, model.B, model.C
    if case.name in ("kf", "kf-umv-ui-wdf", "ulise"):
        looked_up = _row_by_row(lambda u, _: A)
        return replace(model, A=lambda u: looked_up(u, u))
    return NonlinearModel(
        _row_by_row(lambda x, u: A @ x + B @ u), _row_by_row(lambda x, u: C @ x),
        model.Q, model.R, G=model.G, H=model.H,
        transition_jacobian=lambda x, u: A, measurement_jacobian=lambda x, u: C,
    )  # fmt: skip


@pytest.mark.parametrize("of_a_user", [False, True])
@one_of_each("linear")
def test_compiled_filters_compute_what_numpy_computes(case: Case, of_a_user: bool):
    """Step by step from one belief, with gaps: no further apart than their rounding."""
    system = case.system(3)
    plain = make(case.name, system.model, **case.options)
    plain.compiled = False
    model = _in_numpy(case, system.model) if of_a_user else system.model
    filter, rows = make(case.name, model, **case.options), 12
    record, keys = simulate(system, 3, rows, 12), RandomKeys.seeded(range(rows))
    available = some_measurements(np.random.default_rng(3), model.p, 12, rows)
    belief = filter.init(system.rows(rows), rng=keys)
    for k, (u, y, mask) in enumerate(zip(record.u, record.y, available, strict=True)):
        after = [f.predict(belief, u, rng=keys.at(k)) for f in (filter, plain)]
        assert_same(*after, 1e-11)
        belief, other = (
            f.update(after[0], y, rng=keys.at(k), available=mask) for f in (filter, plain)
        )
        # how much rounding a measurement's covariance magnifies
        condition = max(10.0, float(np.linalg.cond(belief.innovation_cov).max()))
        assert_same(belief, other, 1e-12 * condition)


def test_a_schedule_is_looked_up_as_it_is_called():
    table = np.random.default_rng(0).normal(size=(7, 2, 2)) * 0.3
    schedule = Schedule(table, component=1, scale=2.0, middle=3.5)
    u = np.stack([np.zeros(90), np.linspace(-4.0, 4.0, 90)], -1)
    u[:6, 1] = 1e10, -1e10, 1e300, np.inf, -np.inf, np.nan  # beyond the table and whole numbers
    np.testing.assert_array_equal(schedule(u[:6]), table[[6, 0, 6, 6, 0, 0]])
    compiled, called = (
        make("kf", LinearModel(A, np.eye(2), np.eye(2), np.eye(2)))
        for A in (schedule, lambda u: schedule(u))
    )
    prior = Gaussian(np.ones((90, 2)), np.eye(2))
    one, other = (f.predict(f.init(prior), u) for f in (compiled, called))
    np.testing.assert_array_equal(one.mean, other.mean)
