"""Filters whose equations are compiled: they are what NumPy computes, for every row by itself."""

import pickle
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from estimators import Belief, Filter, Gaussian, KalmanFilter, LinearModel, Recovery, Schedule, make
from estimators.filter import Model, Rng
from estimators.linalg import symmetrise
from estimators.measurement import Measurement
from tests.estimators.cases import (
    Case,
    arrays,
    assert_same,
    kalman_system,
    one_of_each,
    simulate,
    some_measurements,
)


@one_of_each("deterministic")
def test_a_compiled_filter_is_the_same_source_over_numpy(case: Case):
    """Step by step from the same belief, with gaps: no further apart than their rounding, entry for entry."""
    compiled, plain = (make(case.name, case.system(3).model, **case.options) for _ in range(2))
    if not compiled.formulas:
        pytest.skip("it is NumPy, and nothing else")
    assert compiled._programs == {}
    plain._programs = None
    system = case.system(3)
    record = simulate(system, 3, runs=70, steps=12)
    available = some_measurements(np.random.default_rng(3), compiled.model.p, 12, 70)
    belief = compiled.init(system.rows(70))
    for k in range(12):
        after = [f.predict(belief, record.u[k]) for f in (compiled, plain)]
        assert_same(*after, 1e-12)
        after = [f.update(after[0], record.y[k], available=available[k]) for f in (compiled, plain)]
        assert_same(*after, 1e-12 * condition(after[0]))
        belief = after[0]


def condition(belief: Belief) -> float:
    """How much rounding a measurement's covariance magnifies, 10 at least."""
    assert belief.innovation_cov is not None
    return max(10.0, float(np.linalg.cond(belief.innovation_cov).max()))


@one_of_each("deterministic")
def test_a_compiled_row_is_the_row_alone_to_the_last_bit(case: Case):
    filter, system = case.make(case.system(4).model), case.system(4)
    record = simulate(system, 4, runs=67, steps=5)
    belief, alone = filter.init(system.rows(67)), filter.init(system.rows(1))
    for k in range(5):
        belief = filter.update(filter.predict(belief, record.u[k]), record.y[k])
        alone = filter.update(filter.predict(alone, record.u[k, 65:66]), record.y[k, 65:66])
    assert_same(belief[65:66], alone)


def test_a_packed_belief_is_like_any_other():
    model = LinearModel(np.eye(2), np.eye(2), np.eye(2), np.eye(2))
    filter = make("kf", model)
    belief = filter.update(
        filter.predict(filter.init(Gaussian(np.zeros((4, 2)), np.eye(2)))), np.ones((4, 2))
    )
    again = pickle.loads(pickle.dumps(belief))
    assert_same(belief, again)
    assert_same(belief[1:3], again[1:3])
    rows = np.array([True, False, False, True])
    assert_same(belief.with_rows(rows, filter.init(Gaussian(np.ones((2, 2)), np.eye(2)))),
                again.with_rows(rows, filter.init(Gaussian(np.ones((2, 2)), np.eye(2)))))  # fmt: skip
    assert_same(filter.predict(belief), filter.predict(again))
    begun, predicted = filter.init(Gaussian(np.ones((4, 2)), np.eye(2))), filter.predict(belief)
    for one, other in ((begun, filter.predict(begun)), (belief, filter.update(begun, np.ones((4, 2)))),
                       (predicted, begun)):  # fmt: skip
        unpacked = (pickle.loads(pickle.dumps(each)) for each in (one, other))
        assert_same(
            one.with_rows(rows, other[:2]), next(unpacked).with_rows(rows, next(unpacked)[:2])
        )
    with pytest.raises(AttributeError, match="has no attribute 'members'"):
        _ = belief.members  # type: ignore[attr-defined]


def test_a_schedule_is_looked_up_as_it_is_called():
    table = np.random.default_rng(0).normal(size=(7, 2, 2)) * 0.3
    schedule = Schedule(table, component=1, scale=2.0, middle=3.5)
    model = LinearModel(schedule, np.eye(2), np.eye(2), np.eye(2))
    called = LinearModel(lambda u: schedule(u), np.eye(2), np.eye(2), np.eye(2))
    u = np.stack([np.zeros(90), np.linspace(-4.0, 4.0, 90)], -1)
    u[:6, 1] = (
        1e10,
        -1e10,
        1e300,
        np.inf,
        -np.inf,
        np.nan,
    )  # beyond the table, and beyond all whole numbers
    one, other = (
        f.predict(f.init(Gaussian(np.ones((90, 2)), np.eye(2))), u)
        for f in (make("kf", model), make("kf", called))
    )
    np.testing.assert_array_equal(one.mean, other.mean)
    np.testing.assert_array_equal(schedule(u[:6]), table[[6, 0, 6, 6, 0, 0]])
    with pytest.raises(ValueError, match="needs a known input u"):
        schedule(None)


class Alpha(Filter[Belief]):
    """A filter of one's own, of a constant gain."""

    formulas = True

    def _predict(self, belief: Belief, u: np.ndarray | None, rng: Rng) -> Belief:
        mean, cov = self._asked("_moved", belief, u)
        return Belief.predicted(belief, mean, cov, u)

    def _update(self, belief: Belief, measurement: Measurement, rng: Rng) -> Belief:
        mean = belief.mean + 0.5 * np.where(measurement.available, measurement.innovation, 0.0)
        return Belief.updated(belief, mean, belief.cov, measurement, belief.cov + measurement.R)


def test_a_filter_of_ones_own_may_be_formulas():
    model: Model = LinearModel(0.9 * np.eye(2), np.eye(2), np.eye(2), np.eye(2))
    own, plain = Alpha(model), Alpha(model)
    plain._programs = None
    y = np.random.default_rng(0).normal(size=(9, 2))
    one, other = (
        f.update(f.predict(f.init(Gaussian(np.zeros((9, 2)), np.eye(2)))), y) for f in (own, plain)
    )
    assert own._programs
    assert_same(one, other, 1e-15)
    assert arrays(one).keys() == arrays(other).keys()


class Fading(KalmanFilter):
    """A Kalman filter of one's own, in NumPy of any kind."""

    forget, updates = 1.0, 0

    def _predict(self, belief: Belief, u: np.ndarray | None, rng: Rng) -> Belief:
        before = super()._predict(belief, u, rng)
        return before.replace(cov=before.cov * self.forget)

    def _update(self, belief: Belief, measurement: Measurement, rng: Rng) -> Belief:
        self.updates += 1
        mean = belief.mean.copy()
        if np.abs(measurement.innovation).max() > 1e6:
            mean[..., 0] = 0.0
        return super()._update(belief.replace(mean=np.clip(mean, -1e9, 1e9)), measurement, rng)


def test_a_filter_below_one_of_ours_is_numpy_until_it_says_otherwise():
    model: Model = LinearModel(0.9 * np.eye(2), np.eye(2), np.eye(2), np.eye(2))
    own, ours = Fading(model), make("kf", model)
    y = np.random.default_rng(0).normal(size=(9, 2))
    one, other = (
        f.update(f.predict(f.init(Gaussian(np.zeros((9, 2)), np.eye(2)))), y) for f in (own, ours)
    )
    assert_same(one, other, 1e-14)
    own.forget = 2.0  # which counts from now on
    assert (own.predict(one).cov > 1.5 * ours.predict(other).cov)[:, 0, 0].all()
    assert own.updates == 1


def test_what_a_formula_of_ones_own_gives_is_looked_at():
    class Negative(Alpha):
        formulas = True

        def _update(self, belief: Belief, measurement: Measurement, rng: Rng) -> Belief:
            return super()._update(belief, measurement, rng).replace(cov=-1.0 * belief.cov)

    model: Model = LinearModel(np.eye(2), np.eye(2), np.eye(2), np.eye(2))
    filter = Negative(model)
    assert filter.update(
        filter.init(Gaussian(np.zeros((3, 2)), np.eye(2))), np.zeros((3, 2))
    ).recovery.all()

    for returned in (
        lambda belief: (belief.mean, belief.cov),
        lambda belief: belief.replace(mean=belief.mean[..., :1]),
        lambda belief: belief.replace(innovation=np.zeros(3)),
        lambda belief: belief.replace(innovation_cov=belief.cov[..., :1, :]),
        lambda belief: belief.replace(cov=1.0),
        lambda belief: {}["nothing"],
    ):

        class Wrong(Alpha):
            formulas = True
            given = staticmethod(returned)

            def _update(self, belief: Belief, measurement: Measurement, rng: Rng) -> Belief:
                return self.given(belief)

        filter = Wrong(model)
        with pytest.raises(
            TypeError, match="Wrong says that it is formulas, but cannot be traced as such"
        ):
            filter.update(filter.init(Gaussian(np.zeros((3, 2)), np.eye(2))), np.zeros((3, 2)))


class Information(KalmanFilter):
    """The update in information form: ``P = (I + P- C' R^-1 C)^-1 P-``, of a matrix that is not symmetric."""

    formulas = True

    def _update(self, belief: Belief, measurement: Measurement, rng: Rng) -> Belief:
        seen = measurement.C.mT @ np.linalg.solve(measurement.R, measurement.C)
        cov = np.linalg.solve(np.eye(self.model.n) + belief.cov @ seen, belief.cov)
        gain = np.linalg.solve(measurement.R, measurement.C @ cov).mT
        S = measurement.C @ belief.cov @ measurement.C.mT + measurement.R
        return Belief.updated(
            belief,
            belief.mean + np.matvec(gain, measurement.innovation),
            symmetrise(cov),
            measurement,
            S,
        )


def test_an_update_in_information_form_is_the_kalman_filters():
    system = kalman_system(5)
    record = simulate(system, 5, runs=70, steps=6)
    own, ours = Information(system.model), KalmanFilter(system.model)
    one, other = own.init(system.rows(70)), ours.init(system.rows(70))
    for k in range(6):
        one = own.update(own.predict(one, record.u[k]), record.y[k])
        other = ours.update(ours.predict(other, record.u[k]), record.y[k])
        assert not one.recovery.any()
        assert_same(one, other, 1e-11)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Marked(Belief):
    seen: np.ndarray


class Marking(KalmanFilter):
    """Remembers of each row whether any measurement has come."""

    formulas = True
    record = Marked  # type: ignore[assignment]

    def _init(self, belief: Belief, rng: Rng) -> Belief:
        return Marked.of(belief, seen=np.zeros(belief.mean.shape[:-1] + (self.model.p,), bool))

    def _predict(self, belief: Any, u: np.ndarray | None, rng: Rng) -> Belief:
        return Marked.of(super()._predict(belief, u, rng), seen=belief.seen)

    def _update(self, belief: Any, measurement: Measurement, rng: Rng) -> Belief:
        return Marked.of(
            super()._update(belief, measurement, rng), seen=~(~belief.seen & ~measurement.available)
        )


def test_a_mask_of_ones_own_is_a_mask_in_a_row_that_is_recovered():
    filter = Marking(
        LinearModel(np.eye(2), np.eye(2), np.zeros((2, 2)), np.zeros((2, 2)))
    )  # measurements without noise
    belief = filter.init(Gaussian(np.zeros((4, 2)), np.eye(2)))
    for k in range(3):
        y = np.where(np.arange(4)[:, None] == 1, np.nan, float(k) * np.ones((4, 2)))
        belief = filter.update(filter.predict(belief), y)
        assert belief.seen.dtype == bool
        np.testing.assert_array_equal(belief.seen, np.isfinite(y))
    assert (belief.recovery == Recovery.PSEUDO_INVERSE).any()


def test_a_prediction_leaves_what_the_last_update_had_to_do():
    filter = make("kf", LinearModel(np.eye(1), np.eye(1), np.eye(1), np.eye(1)))
    belief = filter.update(
        filter.init(Gaussian(np.zeros((2, 1)), np.eye(1))), np.array([[0.0], [np.nan]])
    )
    belief = belief.replace(recovery=np.array([0, 4], np.int8))
    np.testing.assert_array_equal(filter.predict(belief).recovery, [0, 4])
