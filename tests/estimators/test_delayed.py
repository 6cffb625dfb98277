"""Measurements that come late: the belief is what it had been if they had come in time."""

import pickle
from copy import deepcopy

import numpy as np
import pytest

from estimators import (
    Delayed,
    Filter,
    Gaussian,
    LinearModel,
    NonlinearModel,
    RandomKeys,
    make,
    run,
)
from tests.estimators.cases import CASES, Case, by_age, one_of_each, simulate, some_cases

STEPS, ROWS, HORIZON = 18, 4, 4


class Late:
    """A run in which rows begin again, and measurements with their times of arrival."""

    def __init__(self, case: Case) -> None:
        self.system, self.keys = case.system(0), RandomKeys.seeded(range(ROWS))
        rng = np.random.default_rng(0)
        self.record = simulate(self.system, 1, ROWS, STEPS)
        self.y = np.where(rng.random(self.record.y.shape) < 0.1, np.nan, self.record.y)
        self.begins = np.zeros((STEPS, ROWS), bool)
        self.begins[[7, 8, 9, STEPS - 3], [1, 2, 1, 3]] = True
        self.delay = rng.integers(0, HORIZON + 1, self.y.shape)
        for row in range(ROWS):  # nothing outlives its episode, and all has come in the end
            ends = np.append(np.flatnonzero(self.begins[:, row]), STEPS)
            for k in range(STEPS):
                left = ends[ends > k][0] - 1 - k
                self.delay[k, row] = np.minimum(self.delay[k, row], left)

    def run(self, filter: Filter | Delayed, y: np.ndarray):
        system, moves, begins = self.system, self.keys.of("moves"), self.keys.of("begins")
        beliefs, belief = [], filter.init(system.rows(ROWS), rng=begins)
        for k in range(STEPS):
            if k:
                belief = filter.predict(belief, self.record.u[k - 1], rng=moves.at(k))
            u = self.record.u[max(k - 1, 0)]
            belief = filter.update(belief, y[k], rng=self.keys.at(k), u=u)
            if (again := self.begins[k]).any():
                begun = filter.init(system.rows(ROWS), rng=begins.at(k))
                begun = filter.update(begun, y[k], rng=self.keys.at(STEPS), u=u)
                belief = belief.with_rows(again, begun[again])
            beliefs.append(belief)
        return beliefs


FIELDS = (
    *("mean", "cov", "input_mean", "input_cov", "ensemble"),
    *("innovation", "innovation_cov", "healthy", "available"),
)


def assert_equal(one, other, fields=FIELDS) -> None:
    """To the last bit."""
    for name in fields:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


@one_of_each()
def test_shuffled_measurements_end_where_ordered_ones_do(case: Case):
    """In rows that begin at times of their own; to the last bit."""
    late = Late(case)
    filter = case.make(late.system.model)
    ordered = late.run(filter, late.y)
    shuffled = late.run(Delayed(filter, HORIZON), by_age(late.y, late.delay))
    assert (late.delay[np.isfinite(late.y)] > 0).mean() > 0.5
    assert_equal(shuffled[-1], ordered[-1])
    np.testing.assert_array_equal(shuffled[-1].refused, 0)
    for k in np.flatnonzero(late.begins.any(1)):  # and at the end of every episode
        rows = late.begins[k]
        assert_equal(shuffled[k - 1][rows], ordered[k - 1][rows])


@some_cases("kf", "ukf", "kf-umv-ui")
def test_at_every_step_it_knows_just_what_has_come(case: Case):
    system = case.system(0)
    filter, record = case.make(system.model), simulate(system, 1, ROWS, 12)
    delay = np.random.default_rng(0).integers(0, 7, record.y.shape)
    late = run(Delayed(filter, 6), system.prior, by_age(record.y, delay), u=record.u)
    taken = np.arange(12)[:, None, None]
    for k in range(12):
        known = np.where(taken + delay <= k, record.y, np.nan)
        found = run(filter, system.prior, known[: k + 1], u=record.u[: k + 1])
        assert_equal(late.updated[k], found.updated[k])


KF = make("kf", LinearModel(np.eye(2), np.eye(2), 0.1 * np.eye(2), np.eye(2)))
PRIOR = Gaussian(np.zeros((3, 2)), np.eye(2))
LATE, YS = Delayed(KF, 1), np.zeros((3, 1, 2))
BEGUN = LATE.init(PRIOR)


def test_what_comes_too_late_or_twice_is_refused_and_counted():
    """Until a row begins again."""
    delayed = Delayed(KF, 2)

    def updated(belief, *come: tuple[int, int, int]):
        y = np.full((3, 5, 2), np.nan)
        for place in come:
            y[place] = 9.0
        return delayed.update(belief, y)

    def following(belief, *come: tuple[int, int, int]):
        return updated(delayed.predict(belief), *come)

    belief = following(updated(delayed.init(PRIOR)), (0, 2, 0), (1, 1, 0))
    np.testing.assert_array_equal(belief.refused, [1, 0, 0])  # row 0: of before it began
    before = following(following(belief))
    belief, untouched = following(before, (1, 3, 1), (1, 4, 0), (2, 2, 0)), following(before)
    np.testing.assert_array_equal(belief.refused, [1, 2, 0])  # row 1: older than the horizon
    np.testing.assert_array_equal(belief.mean[:2], untouched.mean[:2])
    once = updated(belief, (2, 1, 0))
    twice = updated(once, (2, 1, 0))
    np.testing.assert_array_equal(twice.refused, [1, 2, 1])
    np.testing.assert_array_equal(twice.mean, once.mean)
    rows = np.array([False, True, False])
    begun = following(twice.with_rows(rows, delayed.init(PRIOR)[rows]), (1, 2, 0), (1, 1, 0))
    np.testing.assert_array_equal(begun.refused, [1, 1, 1])


def test_a_late_measurement_has_the_known_input_of_its_step():
    """It does not mix up ``u`` of `update` and of `predict`."""
    one = np.eye(1)
    model = NonlinearModel(lambda x, u: x + u[..., :1], lambda x, u: x * u[..., :1], one, one)
    y, moved, seen = np.random.default_rng(0).uniform(0.5, 2.0, size=(3, 6, 3, 1))
    filter = make("ekf", model)
    delayed, prior = Delayed(filter, 2), Gaussian(np.ones((3, 1)), one)
    ordered, late = filter.init(prior), delayed.init(prior)
    ages = by_age(y, np.array([0, 0, 0, 2, 0, 0])[:, None, None])
    for k in range(6):
        if k:
            ordered, late = filter.predict(ordered, moved[k]), delayed.predict(late, moved[k])
        ordered = filter.update(ordered, y[k], u=seen[k])
        late = delayed.update(late, ages[k], u=seen[k])
    assert_equal(late, ordered)


def test_rows_can_be_taken_out_and_copies_go_on():
    late = Late(CASES[0])
    delayed = Delayed(CASES[0].make(late.system.model), HORIZON)
    belief, other = (
        late.run(delayed, by_age(size * late.y, late.delay))[-1] for size in (1.0, 0.0)
    )
    rows, u, ages = np.arange(ROWS) % 2 == 0, np.ones((ROWS, 2)), np.full((ROWS, 4, 3), np.nan)
    ages[:, 2] = 1.0

    def following(belief, part=slice(None), filter=delayed):
        return filter.update(filter.predict(belief, u[part]), ages[part])

    together, fields = following(belief)[rows], (*FIELDS, "refused", "reach")
    assert_equal(following(belief[rows], rows), together, fields)
    assert_equal(following(other.with_rows(rows, belief[rows]))[rows], together, fields)
    np.testing.assert_array_equal(belief.reach, [HORIZON] * 3 + [2])
    fresh = delayed.init(late.system.rows(ROWS)).with_rows(rows, belief[rows])
    np.testing.assert_array_equal(fresh.reach, 0)
    for copied in (deepcopy, lambda each: pickle.loads(pickle.dumps(each))):
        assert_equal(following(copied(belief), filter=copied(delayed))[rows], together)


class Own:
    """A filter that is no `Filter`, and has what is needed."""

    model, init, predict, update = KF.model, KF.init, KF.predict, KF.update


def test_whatever_has_init_predict_and_update_may_be_delayed():
    y, delay = np.random.default_rng(0).normal(size=(5, 3, 2)), np.array([2, 0, 1, 1, 0])
    ordered = run(Own(), PRIOR, y)
    shuffled = run(Delayed(Own(), 2), PRIOR, by_age(y, delay[:, None, None]))
    assert_equal(shuffled.last, ordered.last)


@pytest.mark.parametrize(
    ("call", "error", "sentence"),
    [
        (lambda: Delayed(KF, -1), ValueError, "horizon must be a whole number of at least 0"),
        (lambda: Delayed(type(KF), 1), TypeError, "filter must be a filter, as estimators"),
        (
            lambda: LATE.update(BEGUN, np.zeros((3, 3))),
            ValueError,
            r"y must have shape \(3, ages, 2\)",
        ),
        (lambda: LATE.update(BEGUN, YS, R=np.eye(2)), ValueError, "Delayed takes no R"),
        (lambda: LATE.update(BEGUN, YS, available=[True]), ValueError, r"available has shape"),
        (lambda: LATE.predict(KF.init(PRIOR)), TypeError, "must be a DelayedBelief, got Belief"),
        (
            lambda: Delayed(make("enkf", KF.model), 1).init(PRIOR, np.random.default_rng(0)),
            TypeError,
            "give rng as keys",
        ),
        (lambda: LATE.log_likelihood(BEGUN, BEGUN), ValueError, "once they are sorted"),
    ],
)
def test_what_does_not_fit_gets_one_sentence(call, error: type, sentence: str):
    with pytest.raises(error, match=sentence):
        call()


def test_an_absurd_measurement_that_comes_late_is_not_healthy():
    late = Delayed(make("pf", LinearModel([[1.0]], [[1.0]], [[1e-4]], [[0.01]])), 2)
    y = np.full((4, 3, 1), np.nan)
    y[:, 0] = 0.1
    y[1, 0], y[2, 1] = np.nan, 60.0
    beliefs = run(late, Gaussian([0.0], [[1.0]]), y, rng=0).updated
    np.testing.assert_array_equal(beliefs.healthy, [True, True, False, True])
