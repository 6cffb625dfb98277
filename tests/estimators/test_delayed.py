"""Measurements that come late: the belief is what it had been if they had come in time."""

import pickle

import numpy as np
import pytest

from estimators import (
    Belief,
    Delayed,
    Filter,
    Gaussian,
    LinearModel,
    NonlinearModel,
    RandomKeys,
    by_age,
    make,
    run,
)
from estimators.tracing import PREDICTIONS
from estimators.window import Forecast
from tests.estimators.batch import least_squares
from tests.estimators.cases import CASES, Case, kalman_system, one_of_each, simulate, some_cases

STEPS, ROWS, HORIZON = 18, 4, 4


class Late:
    """A run in which rows begin again, and measurements with their times of arrival."""

    def __init__(self, case: Case, seed: int = 0) -> None:
        self.case, self.system = case, case.system(0)
        rng = np.random.default_rng(seed)
        self.record = simulate(self.system, 1, ROWS, STEPS)
        self.y = self.record.y.copy()
        self.y[rng.random(self.y.shape) < 0.1] = np.nan
        self.begins = np.zeros((STEPS, ROWS), bool)
        self.begins[0] = True
        self.begins[7, 1] = self.begins[8, 2] = self.begins[9, 1] = self.begins[STEPS - 3, 3] = True
        delay = rng.integers(0, HORIZON + 1, self.y.shape)
        for row in range(ROWS):  # nothing outlives its episode, and all has come in the end
            ends = [*np.flatnonzero(self.begins[1:, row]) + 1, STEPS]
            first = 0
            for end in ends:
                left = end - 1 - np.arange(first, end)
                delay[first:end, row] = np.minimum(delay[first:end, row], left[:, None])
                first = end
        self.delay = delay
        self.keys = RandomKeys.seeded(list(range(ROWS)))

    def flown(self, filter: Filter | Delayed, y: np.ndarray):
        system, fresh = self.system, self.keys.of("begins")
        beliefs, belief = [], filter.init(system.rows(ROWS), rng=self.keys.at(0))
        for k in range(STEPS):
            if k:
                belief = filter.predict(belief, self.record.u[k - 1], rng=self.keys.at(k))
                again = self.begins[k]
                if again.any():
                    begun = filter.init(system.rows(ROWS), rng=fresh.at(k))
                    belief = belief.with_rows(again, begun[again])
            belief = filter.update(
                belief, y[k], rng=self.keys.at(k), u=self.record.u[max(k - 1, 0)]
            )
            beliefs.append(belief)
        return beliefs


def assert_beliefs_equal(one, other, tolerance: float) -> None:
    for name in (
        "mean",
        "cov",
        "input_mean",
        "input_cov",
        "ensemble",
        "innovation",
        "recovery",
        "available",
    ):
        mine, theirs = getattr(one, name), getattr(other, name)
        assert (mine is None) == (theirs is None), name
        if mine is not None:
            np.testing.assert_allclose(
                mine, theirs, rtol=0, atol=tolerance * max(1.0, np.abs(theirs).max()), err_msg=name
            )


@one_of_each()
def test_shuffled_measurements_end_where_ordered_ones_do_in_rows_that_begin_at_times_of_their_own(
    case: Case,
):
    late = Late(case)
    filter = case.make(late.system.model)
    ordered = late.flown(filter, late.y)
    shuffled = late.flown(Delayed(filter, HORIZON), by_age(late.y, late.delay))
    assert (late.delay[np.isfinite(late.y)] > 0).mean() > 0.5
    assert_beliefs_equal(shuffled[-1], ordered[-1], 1e-12)
    np.testing.assert_array_equal(shuffled[-1].refused, 0)
    for k in np.flatnonzero(late.begins[1:].any(1)):  # and at the end of every episode
        rows = late.begins[k + 1]
        assert_beliefs_equal(shuffled[k][rows], ordered[k][rows], 1e-12)


@some_cases("kf", "enkf", "kf-umv-ui", "ekf on a turning vehicle")
def test_without_a_horizon_it_is_the_filter_itself_to_the_last_bit(case: Case):
    late = Late(case)
    filter = case.make(late.system.model)
    for one, other in zip(
        late.flown(Delayed(filter, 0), late.y[..., None, :]),
        late.flown(filter, late.y),
        strict=True,
    ):
        assert_beliefs_equal(one, other, 0.0)


def test_at_every_step_it_knows_just_what_has_come():
    """The posterior of all measurements that have come by then, by least squares."""
    system = kalman_system(0)
    record = simulate(system, 3, 1, 16)
    delay = np.random.default_rng(0).integers(0, 7, record.y.shape)
    series = run(
        Delayed(make("kf", system.model), 6), system.prior, by_age(record.y, delay), u=record.u
    )
    for k in range(1, 16):
        taken = np.arange(k + 1)[:, None]
        known = np.where(taken + delay[: k + 1, 0] <= k, record.y[: k + 1, 0], np.nan)
        posterior = least_squares(system, known, record.u[:, 0])
        n = system.model.n
        own = slice(k * n, (k + 1) * n)
        np.testing.assert_allclose(series.mean[k, 0], posterior.x[k], rtol=0, atol=1e-10)
        np.testing.assert_allclose(series.cov[k, 0], posterior.cov[own, own], rtol=0, atol=1e-10)


def _walk() -> tuple[LinearModel, Gaussian]:
    return LinearModel(np.eye(2), np.eye(2), 0.1 * np.eye(2), np.eye(2)), Gaussian(
        np.zeros((3, 2)), np.eye(2)
    )


def _measurements(ages: int, *come: tuple[int, int, int, float]) -> np.ndarray:
    y = np.full((3, ages, 2), np.nan)
    for row, age, channel, value in come:
        y[row, age, channel] = value
    return y


def test_what_comes_too_late_or_twice_is_refused_and_counted_until_a_row_begins_again():
    model, prior = _walk()
    delayed = Delayed(make("kf", model), 2)
    belief = delayed.update(delayed.init(prior), _measurements(1))
    belief = delayed.update(
        delayed.predict(belief), _measurements(3, (0, 2, 0, 9.0), (1, 1, 0, 1.0))
    )  # 0: before it began
    np.testing.assert_array_equal(belief.refused, [1, 0, 0])
    for _ in range(2):
        belief = delayed.update(delayed.predict(belief), _measurements(1))
    before = belief
    belief = delayed.update(
        delayed.predict(belief), _measurements(5, (1, 3, 1, 9.0), (1, 4, 0, 9.0), (2, 2, 0, 1.0))
    )
    np.testing.assert_array_equal(belief.refused, [1, 2, 0])
    again = delayed.update(
        delayed.predict(belief), _measurements(4, (2, 3, 0, 9.0), (2, 1, 0, 2.0))
    )
    twice = delayed.update(
        again, _measurements(2, (2, 1, 0, 5.0))
    )  # the channel has told of that step
    np.testing.assert_array_equal(twice.refused, [1, 2, 2])
    np.testing.assert_array_equal(twice.mean, again.mean)
    plain = make("kf", model)
    untouched = plain.update(plain.predict(before.now), np.full((3, 2), np.nan))
    np.testing.assert_array_equal(
        belief.mean[:2], untouched.mean[:2]
    )  # refused measurements leave nothing
    rows = np.array([False, True, False])
    begun = twice.with_rows(rows, delayed.init(prior)[rows])
    np.testing.assert_array_equal(begun.refused, [1, 0, 2])
    following = delayed.update(
        delayed.predict(begun), _measurements(3, (1, 2, 0, 9.0), (1, 1, 0, 1.0))
    )
    np.testing.assert_array_equal(following.refused, [1, 1, 2])


def test_measurements_of_one_step_may_come_in_several_calls():
    model, prior = _walk()
    filter = make("kf", model)
    delayed = Delayed(filter, 3)
    whole = filter.update(filter.init(prior), [[1.0, 2.0]] * 3)
    parts = delayed.update(delayed.init(prior), [[[1.0, np.nan]]] * 3)
    parts = delayed.update(parts, [[[np.nan, 2.0]]] * 3)
    np.testing.assert_array_equal(parts.mean, whole.mean)
    np.testing.assert_array_equal(parts.cov, whole.cov)


def test_late_measurements_may_bring_covariances_of_their_own():
    model, prior = _walk()
    rng = np.random.default_rng(0)
    y, R = (
        rng.normal(size=(10, 3, 2)),
        rng.uniform(0.1, 3.0, size=(10, 3, 2))[..., None] * np.eye(2),
    )
    delay = np.minimum(rng.integers(0, 4, (10, 3, 2)), 9 - np.arange(10)[:, None, None])
    ordered = run(make("kf", model), prior, y, R=R)
    ages = by_age(y, delay)
    late_R = np.full((*ages.shape, 2), np.nan)
    for k, row, age, channel in np.argwhere(np.isfinite(ages)):
        late_R[k, row, age, channel] = R[k - age, row, channel]
        late_R[k, row, age, :, channel] = R[k - age, row, :, channel]
    shuffled = run(Delayed(make("kf", model), 3), prior, ages, R=late_R)
    np.testing.assert_allclose(shuffled.mean[-1], ordered.mean[-1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(shuffled.cov[-1], ordered.cov[-1], rtol=0, atol=1e-12)


def test_a_known_input_of_the_measurements_alone_is_theirs_when_their_step_is_repeated():
    """``u`` of `update` is not that of the prediction; a measurement of an earlier step must not mix them up."""
    model = NonlinearModel(
        lambda x, u: x + u[..., :1], lambda x, u: x * u[..., :1], 0.1 * np.eye(1), np.eye(1)
    )
    rng = np.random.default_rng(0)
    y, moved, seen = (
        rng.normal(size=(6, 3, 1)),
        rng.normal(size=(6, 3, 1)),
        rng.uniform(0.5, 2.0, size=(6, 3, 1)),
    )
    for name in ("ekf", "iekf"):
        filter = make(name, model)
        delayed = Delayed(filter, 2)
        prior = Gaussian(np.ones((3, 1)), np.eye(1))
        ordered, late = filter.init(prior), delayed.init(prior)
        for k in range(6):
            if k:
                ordered, late = filter.predict(ordered, moved[k]), delayed.predict(late, moved[k])
            ordered = filter.update(ordered, y[k], u=seen[k])
            ages = np.full((3, 3, 1), np.nan)
            ages[:, 0] = y[k] if k != 3 else np.nan
            ages[:, 2] = y[3] if k == 5 else np.nan
            late = delayed.update(late, ages, u=seen[k])
        np.testing.assert_allclose(late.mean, ordered.mean, rtol=0, atol=1e-12)
        np.testing.assert_allclose(late.cov, ordered.cov, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ["kf", "ekf", "ukf", "kf-umv-ui"])
def test_steps_without_measurements_are_repeated_as_predictions_to_the_last_bit(name: str):
    """All measurements come late by as much: one that comes finds none in the steps after it."""
    case = next(case for case in CASES if case.id == name)
    system = case.system(0)
    filter, record = make(name, system.model, **case.options), simulate(system, 1, ROWS, 12)
    delayed, ages = Delayed(filter, 4), by_age(record.y, np.full(record.y.shape, 4))
    late = delayed.init(system.rows(ROWS))
    for k in range(12):
        if k:
            late = delayed.predict(late, record.u[k - 1])
        late = delayed.update(late, ages[k])
        belief = filter.init(system.rows(ROWS))
        for i in range(k + 1):
            belief = filter.predict(belief, record.u[i - 1]) if i else belief
            belief = filter.update(belief, np.where(i + 4 <= k, record.y[i], np.nan))
        for field in (
            "mean",
            "cov",
            "input_mean",
            "input_cov",
            "innovation",
            "innovation_cov",
            "available",
        ):
            np.testing.assert_array_equal(getattr(late, field), getattr(belief, field))
    assert any(methods == PREDICTIONS for methods, *_ in filter._programs)


@pytest.mark.parametrize("name", ["ekf", "kf-umv-ui"])
def test_predictions_that_were_not_kept_are_made_again_when_a_measurement_reaches_them(name: str):
    """Where all measurements are as late, those of steps in between are not kept; copies of a belief have them all."""
    case = next(case for case in CASES if case.id == name)
    system = case.system(0)
    filter, record = case.make(system.model), simulate(system, 1, ROWS, 16)
    delay = np.minimum(np.full(record.y.shape, 6), 15 - np.arange(16)[:, None, None])
    delay[7, 1:, 0] = 3
    delayed, ages = Delayed(filter, 6), by_age(record.y, delay)
    ordered, late = filter.init(system.rows(ROWS)), delayed.init(system.rows(ROWS))
    sparse = 0
    for k in range(16):
        if k:
            ordered, late = (
                one.predict(b, record.u[k - 1]) for one, b in ((filter, ordered), (delayed, late))
            )
        ordered = filter.update(ordered, record.y[k])
        copied = pickle.loads(pickle.dumps(late)) if k < 12 else late
        late, copied = delayed.update(late, ages[k]), delayed.update(copied, ages[k])
        np.testing.assert_array_equal(copied.mean, late.mean)
        runs = [one.run for one in late.window.predicted if isinstance(one, Forecast)]
        sparse += any(len(run.found) < run.steps for run in runs)
    assert sparse
    for field in ("mean", "cov"):
        np.testing.assert_allclose(
            getattr(late, field), getattr(ordered, field), rtol=0, atol=1e-12
        )


def test_rows_can_be_taken_out_and_go_on_alone():
    late = Late(CASES[0])
    delayed = Delayed(CASES[0].make(late.system.model), HORIZON)
    belief = late.flown(delayed, by_age(late.y, late.delay))[-1]
    u, ages = np.ones((ROWS, 2)), np.full((ROWS, 4, 3), np.nan)
    ages[:, 2] = 1.0
    rows = np.array([True, False, True, False])
    together = delayed.update(delayed.predict(belief, u), ages)
    apart = delayed.update(delayed.predict(belief[rows], u[rows]), ages[rows])
    np.testing.assert_array_equal(apart.mean, together.mean[rows])
    np.testing.assert_array_equal(apart.refused, together.refused[rows])


def test_a_late_measurement_that_is_absurd_loses_no_more_than_itself():
    model, prior = _walk()
    delayed = Delayed(make("kf", model), 3)
    belief = delayed.init(prior)
    for k in range(6):
        belief = delayed.update(
            delayed.predict(belief), _measurements(4, (0, 2, 0, np.inf), (1, 2, 0, 1e308))
        )
        assert np.isfinite(belief.mean).all(), k
        assert np.isfinite(belief.cov).all(), k
    np.testing.assert_array_equal(belief.mean[[0, 2]], 0.0)


class Mean:
    """What is no `Filter` at all: a running mean, which has what is needed."""

    random = False

    def __init__(self) -> None:
        self.model = LinearModel([[1.0]], [[1.0]], [[0.0]], [[1.0]])

    def init(self, prior, rng=None):
        mean = np.array(prior.mean)
        return Belief(
            mean,
            np.broadcast_to(prior.cov, (*mean.shape, 1)),
            mean,
            prior.cov,
            np.zeros(mean.shape[:-1]),
        )

    def predict(self, belief, u=None, rng=None):
        return belief

    def update(self, belief, y, rng=None, available=None, R=None, u=None):
        return belief.replace(mean=np.where(available, 0.5 * (belief.mean + y), belief.mean))


def test_whatever_has_init_predict_and_update_may_be_delayed():
    y = np.arange(1.0, 6.0)[:, None, None]
    ordered = run(Mean(), Gaussian([[0.0]], [[1.0]]), y, available=np.ones(y.shape))
    delay = np.array([2, 0, 1, 1, 0])[:, None, None]
    shuffled = run(Delayed(Mean(), 2), Gaussian([[0.0]], [[1.0]]), by_age(y, delay))
    np.testing.assert_array_equal(shuffled.mean[-1], ordered.mean[-1])


def test_measurements_by_age_are_those_that_were_taken():
    rng = np.random.default_rng(0)
    y, delay = rng.normal(size=(8, 2, 3)), rng.integers(0, 3, (8, 2, 3))
    ages = by_age(y, delay)
    assert ages.shape == (8, 2, 3, 3)
    come = np.argwhere(np.isfinite(ages))
    taken = {(k - age, row, channel): ages[k, row, age, channel] for k, row, age, channel in come}
    assert len(taken) == len(come) == (np.arange(8)[:, None, None] + delay < 8).sum()
    assert all(y[place] == value for place, value in taken.items())


def test_what_does_not_fit_gets_one_sentence():
    model, prior = _walk()
    kf = make("kf", model)
    for horizon in (-1, 2.0, True, None, "2"):
        with pytest.raises(ValueError, match="horizon must be a whole number of at least 0"):
            Delayed(kf, horizon)
    for filter in ("kf", type(kf), None):
        with pytest.raises(
            TypeError, match=r"filter must be a filter, as estimators\.make gives one"
        ):
            Delayed(filter, 1)
    delayed = Delayed(kf, 1)
    with pytest.raises(
        ValueError, match=r"y has shape \(3, 3\), expected \(3, 'ages', 2\): measurements by age"
    ):
        delayed.update(delayed.init(prior), np.zeros((3, 3)))
    with pytest.raises(ValueError, match=r"some of them late, are for Delayed\(filter, horizon\)"):
        kf.update(kf.init(prior), np.zeros((3, 4, 2)))
    drawn = Delayed(make("enkf", model), 1)
    with pytest.raises(TypeError, match="give rng as keys"):
        drawn.init(prior, rng=np.random.default_rng(0))
    with pytest.raises(ValueError, match="delay must be whole numbers"):
        by_age(np.zeros((3, 1)), 0.5)
    series = run(delayed, prior, np.zeros((4, 3, 1, 2)))
    with pytest.raises(ValueError, match="have a likelihood once they are sorted"):
        series.log_likelihood  # noqa: B018


def test_it_says_what_the_filter_says_of_itself():
    kf = make("kf", _walk()[0])
    delayed = Delayed(kf, 2)
    assert (delayed.name, delayed.random, delayed.model) == ("kf", False, kf.model)
    assert repr(delayed) == "Delayed(KalmanFilter(n=2, p=2, q=0), horizon=2)"
