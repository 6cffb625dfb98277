"""Filters whose equations are compiled: they are what NumPy computes, for every row by itself."""

import numpy as np
import pytest

from estimators import Gaussian, LinearModel, RandomKeys, Schedule, make
from tests.estimators.cases import (
    Case,
    assert_same,
    one_of_each,
    simulate,
    some_measurements,
    track,
)


@one_of_each("deterministic")
def test_a_compiled_filter_is_the_same_source_over_numpy(case: Case):
    """Step by step from the same belief, with gaps: no further apart than their rounding."""
    system = case.system(3)
    compiled, plain = (case.make(system.model) for _ in range(2))
    if not compiled.formulas:
        pytest.skip("it is NumPy, and nothing else")
    plain._programs = None
    record = simulate(system, 3, runs=70, steps=12)
    available = some_measurements(np.random.default_rng(3), compiled.model.p, 12, 70)
    belief = compiled.init(system.rows(70))
    for u, y, mask in zip(record.u, record.y, available, strict=True):
        after = [f.predict(belief, u) for f in (compiled, plain)]
        assert_same(*after, 1e-12)
        belief, other = (f.update(after[0], y, available=mask) for f in (compiled, plain))
        # how much rounding a measurement's covariance magnifies
        condition = max(10.0, float(np.linalg.cond(belief.innovation_cov).max()))
        assert_same(belief, other, 1e-12 * condition)


@one_of_each()
def test_a_row_alone_has_the_bits_of_a_row_of_a_batch(case: Case):
    system, filter = case.system(4), case.make(case.system(4).model)
    record, keys = simulate(system, 4, runs=67, steps=5), RandomKeys.seeded(range(67)).of(7)
    available = some_measurements(np.random.default_rng(4), system.model.p, 5, 67)
    batch = track(filter, system.rows(67), record, keys, available)
    for row in (slice(0, 1), slice(63, 67)):
        part = record._replace(y=record.y[:, row], u=record.u[:, row])
        alone = track(filter, system.rows(len(keys.keys[row])), part, keys[row], available[:, row])
        for one, other in zip(batch, alone, strict=True):
            assert_same(one[row], other)


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
