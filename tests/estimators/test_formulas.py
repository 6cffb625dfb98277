"""Formulas of small matrices: what is executed compiled is what NumPy computes, for every row by itself."""

import pickle
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from estimators import Belief, Filter, Gaussian, KalmanFilter, LinearModel, Recovery, Schedule, make
from estimators.engine import compiled
from estimators.engine.matrices import matrix_input
from estimators.engine.program import Program
from estimators.filter import Model, Rng
from estimators.linalg import joined, semidefinite_cholesky, singular, solve, solve_upper, symmetrise
from estimators.reading import Reading
from tests.estimators.cases import (
    Case,
    arrays,
    assert_same,
    every_case,
    kalman_system,
    random_covariance,
    simulate,
    some_readings,
)


def squared(root: np.ndarray) -> np.ndarray:
    return root @ root.mT


ROWS = (1, 2, 63, 64, 65, 200)
"""Of one row, of a block and of several, one of them not full."""
FORMULAS: dict[str, Callable[..., Any]] = {
    "sums": lambda S, B, x, m: S @ B - 2.0 * B + B / 3.0,
    "transposed": lambda S, B, x, m: (S @ B).mT @ S,
    "vectors": lambda S, B, x, m: np.matvec(S, x) + np.vecmat(x, S) - x,
    "slices": lambda S, B, x, m: joined([B[..., 1:, :], B[..., :1, ::-1]], -2) + B[..., 2, None, :],
    "beside": lambda S, B, x, m: joined([S, B, np.eye(3)], -1),
    "masks": lambda S, B, x, m: np.where((m & np.isfinite(x))[..., None], B, 0.0) + np.where(~m, x, 1.0)[..., None],
    "sizes": lambda S, B, x, m: np.maximum(np.abs(x), 0.5) - np.minimum(np.square(x), 0.5) + np.sqrt(x * x),
    "comparisons": lambda S, B, x, m: np.where(x > 0.1, x, -x) + np.where(x < -0.2, np.floor(x), np.log1p(x * x)),
    "sums of entries": lambda S, B, x, m: B.sum(-2).sum(-1) + B.sum(-1).sum(-1) * B.sum((-2, -1)) + x.sum(-1),
    "diagonal": lambda S, B, x, m: S.diagonal(0, -2, -1) - np.remainder(x, 0.7),
    "solve": lambda S, B, x, m: solve(S, B),
    "solve any matrix": lambda S, B, x, m: np.linalg.solve(S + 5.0 * np.eye(3)[[1, 2, 0]], B) % B[..., :1, :],
    "solve by a triangle": lambda S, B, x, m: solve_upper(semidefinite_cholesky(S).mT, B),
    "cholesky": lambda S, B, x, m: semidefinite_cholesky(S),
    "cholesky of less than full rank": lambda S, B, x, m: squared(semidefinite_cholesky(B @ B.mT)),
    "symmetrise": lambda S, B, x, m: symmetrise(S @ S),
    "singular values": lambda S, B, x, m: (singular(B)[1] * singular(B)[0][..., None, :]) @ singular(B)[1].mT,
    "squared": lambda S, B, x, m: (singular(S)[1] * np.square(singular(S)[0])[..., None, :]) @ singular(S)[1].mT,
}  # fmt: skip


def executed(formula: Callable[..., Any], S: np.ndarray, B: np.ndarray, x: np.ndarray, m: np.ndarray) -> np.ndarray:
    """The formula of ``S (B, 3, 3)``, ``B (B, 3, 2)``, ``x (B, 3)`` and a mask ``m (B, 3)``, compiled."""
    return np.asarray(compiled(formula, axes=(2, 2, 1, 1), matrices=True)(S, B, x, m))


def tracers() -> tuple[Any, ...]:
    """Tracers of a row of what `given` gives."""
    program = Program()
    shapes: Any = ((3, 3), (3, 2), (3,), (3,))
    return tuple(matrix_input(program, i, 0, shape, "fffb"[i]) for i, shape in enumerate(shapes))


def given(rows: int) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(rows)
    mask = rng.random((rows, 3)) < 0.5
    return random_covariance(rng, 3, (rows,)), rng.normal(size=(rows, 3, 2)), rng.normal(size=(rows, 3)), mask


@pytest.mark.parametrize("rows", ROWS)
@pytest.mark.parametrize("formula", FORMULAS.values(), ids=FORMULAS.keys())
def test_what_is_executed_is_what_numpy_computes(formula: Callable[..., Any], rows: int):
    parts = given(rows)
    np.testing.assert_allclose(executed(formula, *parts), formula(*parts), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("formula", FORMULAS.values(), ids=FORMULAS.keys())
def test_a_row_is_the_same_to_the_last_bit_in_any_batch(formula: Callable[..., Any]):
    parts = given(200)
    whole = executed(formula, *parts)
    for rows in (slice(7, 8), slice(60, 70), slice(3, 197)):
        some = (np.ascontiguousarray(part[rows]) for part in parts)
        np.testing.assert_array_equal(executed(formula, *some), whole[rows])


@pytest.mark.parametrize("function", [np.maximum, np.minimum])
def test_what_is_no_number_stays_none(function: np.ufunc):
    S, B, x, m = given(70)
    x[::3], S[::2, 0] = np.nan, np.nan
    found = executed(lambda S, B, x, m: function(x, S[..., 0, :]), S, B, x, m)
    np.testing.assert_array_equal(found, function(x, S[..., 0, :]))


def test_a_matrix_that_is_no_covariance_is_lost_and_no_other():
    S, B, x, m = given(70)
    S[5], S[66] = -np.eye(3), np.nan
    solved = executed(FORMULAS["solve"], S, B, x, m)
    lost = np.isin(np.arange(70), (5, 66))
    assert np.isnan(solved[lost]).any((-2, -1)).all()
    np.testing.assert_allclose(solved[~lost], np.linalg.solve(S[~lost], B[~lost]), rtol=0.0, atol=1e-12)


def test_a_formula_that_cannot_be_compiled_is_refused():
    _, _, x, _ = tracers()
    with pytest.raises(TypeError, match=r"cannot have np\.tanh in it"):
        np.tanh(x)
    with pytest.raises(TypeError, match=r"cannot have np\.cross in it"):
        np.cross(x, x)
    with pytest.raises(TypeError, match=r"use np\.where"):
        bool(x > 0.0)


MISTAKES: dict[str, Callable[..., Any]] = {
    "inner sizes of @": lambda S, B, x, m: B @ S,
    "inner sizes of matvec": lambda S, B, x, m: np.matvec(B, x),
    "vecmat for matvec": lambda S, B, x, m: np.vecmat(x[..., :2], B),
    "rows of solve": lambda S, B, x, m: np.linalg.solve(S, B[..., :2, :]),
    "more rows of solve": lambda S, B, x, m: np.linalg.solve(S[..., :2, :2], B),
    "no square to solve": lambda S, B, x, m: np.linalg.solve(B, B),
    "a vector to solve for": lambda S, B, x, m: np.linalg.solve(S, x),
    "a definite one": lambda S, B, x, m: solve(S[..., :2, :2], B),
    "by a triangle": lambda S, B, x, m: solve_upper(S[..., :2, :2], B),
    "a small block beside a table": lambda S, B, x, m: joined([B[..., :1, :], S], -1),
    "concatenated likewise": lambda S, B, x, m: np.concatenate([B[..., :1, :], S], -1),
    "a vector beside a matrix": lambda S, B, x, m: np.concatenate([x, S], -1),
    "along the batch": lambda S, B, x, m: np.concatenate([S, B], 0) + np.concatenate([S, B]),
    "a constant without a batch": lambda S, B, x, m: np.concatenate([x, np.zeros(2)], -1),
    "sums": lambda S, B, x, m: S + B,
    "a vector and a matrix": lambda S, B, x, m: S + x,
    "a constant of more axes": lambda S, B, x, m: x * np.eye(3),
    "a mask of other size": lambda S, B, x, m: np.where(m[..., :2], x, 0.0),
    "too many indices": lambda S, B, x, m: S[..., 0, 0, 0, 0],
    "an index too large": lambda S, B, x, m: S[..., 3, :],
    "a sum over the batch": lambda S, B, x, m: S + x.sum((-2, -1))[..., None, None] + np.ones((7, 2, 2)),
    "no square to symmetrise": lambda S, B, x, m: symmetrise(B),
    "no square to factor": lambda S, B, x, m: semidefinite_cholesky(B.mT),
}  # fmt: skip


@pytest.mark.parametrize("formula", MISTAKES.values(), ids=MISTAKES.keys())
def test_what_numpy_refuses_is_refused_while_it_is_traced(formula: Callable[..., Any]):
    with pytest.raises((ValueError, IndexError)):
        formula(*given(11))
    with pytest.raises((ValueError, TypeError, IndexError)) as caught:
        formula(*tracers())
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "formula",
    [
        lambda S, B, x, m: np.logical_not(x),
        lambda S, B, x, m: np.logical_and(x, x),
        lambda S, B, x, m: m & (x > 0.0) & x,
        lambda S, B, x, m: m + m,
        lambda S, B, x, m: m - m,
        lambda S, B, x, m: -m,
        lambda S, B, x, m: m % 2,
        lambda S, B, x, m: m.sum(-1),
        lambda S, B, x, m: np.matvec(m[..., None] & m[..., None, :], m),
        lambda S, B, x, m: np.square(m),
        lambda S, B, x, m: np.ma.array(np.eye(3)) * S,
        lambda S, B, x, m: S @ x.mT,
        lambda S, B, x, m: np.array([x[..., 0], x[..., 1], x[..., 2]]) + x,
        lambda S, B, x, m: x * 1j,
        lambda S, B, x, m: x + None,
        lambda S, B, x, m: S[..., None] * x[..., None],
        lambda S, B, x, m: x[..., True],
        lambda S, B, x, m: x.sum(-1, keepdims=True),
        lambda S, B, x, m: x.__iadd__(1.0),
        lambda S, B, x, m: x.__setitem__(Ellipsis, 0.0),
        lambda S, B, x, m: x.copy(),
        lambda S, B, x, m: len(x),
    ],
)
def test_a_word_that_would_mean_something_else_is_refused(formula: Callable[..., Any]):
    with pytest.raises((TypeError, ValueError, AttributeError)) as caught:
        formula(*tracers())
    assert "\n" not in str(caught.value)


def test_solve_is_numpys_for_any_matrix():
    _, B, x, m = given(70)
    A = np.random.default_rng(1).normal(size=(70, 3, 3))
    A[3] = np.eye(3)[[2, 0, 1]]  # no pivot on the diagonal
    A[4] = -A[4] @ A[4].mT
    found = executed(lambda A, B, x, m: np.linalg.solve(A, B), A, B, x, m)
    np.testing.assert_allclose(found, np.linalg.solve(A, B), rtol=1e-12 * np.linalg.cond(A).max(), atol=0.0)
    A[5] = np.ones((3, 3))
    again = executed(lambda A, B, x, m: np.linalg.solve(A, B), A, B, x, m)
    assert np.isnan(again[5]).all()
    np.testing.assert_array_equal(np.delete(again, 5, 0), np.delete(found, 5, 0))


def test_a_remainder_is_numpys_to_the_last_bit():
    S, B, x, m = given(70)
    x[:5, 0] = 1e17, -1e17, np.inf, -0.0, 5.0
    S[4, 0, 0] = np.inf
    for formula in (lambda S, B, x, m: x % 0.7, lambda S, B, x, m: 5.0 % x, lambda S, B, x, m: x % S[..., 0, :]):
        with np.errstate(all="ignore"):
            np.testing.assert_array_equal(executed(formula, S, B, x, m), formula(S, B, x, m))


def test_zeros_keep_their_signs():
    S, B, x, m = given(5)
    x[:] = [0.0, -0.0, 1.0]
    for formula in (
        lambda S, B, x, m: 1.0 / (x + 0.0),
        lambda S, B, x, m: 1.0 / (x + -0.0),
        lambda S, B, x, m: 1.0 / -x,
        lambda S, B, x, m: 1.0 / np.concatenate([x, x], -1),
    ):
        with np.errstate(all="ignore"):
            np.testing.assert_array_equal(executed(formula, S, B, x, m), formula(S, B, x, m))


# --- filters ----------------------------------------------------------------------------------------


@every_case("deterministic")
def test_a_compiled_filter_is_the_same_source_over_numpy(case: Case):
    """Step by step from the same belief, readings missing: no further apart than their rounding, entry for entry."""
    compiled, plain = (case.make(case.system(3).model) for _ in range(2))
    if not compiled.formulas:
        pytest.skip("it is NumPy, and nothing else")
    assert compiled._programs == {}
    plain._programs = None
    system = case.system(3)
    record = simulate(system, 3, runs=70, steps=12)
    available = some_readings(np.random.default_rng(3), compiled.model.p, 12, 70)
    belief = compiled.init(system.rows(70))
    for k in range(12):
        after = [f.predict(belief, record.u[k]) for f in (compiled, plain)]
        assert_same(*after, 1e-12)
        after = [f.update(after[0], record.y[k], available=available[k]) for f in (compiled, plain)]
        assert_same(*after, 1e-12 * condition(after[0]))
        belief = after[0]


def condition(belief: Belief) -> float:
    """How much rounding a reading's covariance magnifies, 10 at least."""
    assert belief.innovation_cov is not None
    return max(10.0, float(np.linalg.cond(belief.innovation_cov).max()))


@every_case("deterministic")
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
    belief = filter.update(filter.predict(filter.init(Gaussian(np.zeros((4, 2)), np.eye(2)))), np.ones((4, 2)))
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
        assert_same(one.with_rows(rows, other[:2]), next(unpacked).with_rows(rows, next(unpacked)[:2]))
    with pytest.raises(AttributeError, match="has no attribute 'members'"):
        _ = belief.members  # type: ignore[attr-defined]


def test_a_schedule_is_looked_up_as_it_is_called():
    table = np.random.default_rng(0).normal(size=(7, 2, 2)) * 0.3
    schedule = Schedule(table, component=1, scale=2.0, middle=3.5)
    model = LinearModel(schedule, np.eye(2), np.eye(2), np.eye(2))
    called = LinearModel(lambda u: schedule(u), np.eye(2), np.eye(2), np.eye(2))
    u = np.stack([np.zeros(90), np.linspace(-4.0, 4.0, 90)], -1)
    u[:6, 1] = 1e10, -1e10, 1e300, np.inf, -np.inf, np.nan  # beyond the table, and beyond all whole numbers
    one, other = (
        f.predict(f.init(Gaussian(np.ones((90, 2)), np.eye(2))), u) for f in (make("kf", model), make("kf", called))
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

    def _update(self, belief: Belief, reading: Reading, rng: Rng) -> Belief:
        mean = belief.mean + 0.5 * np.where(reading.available, reading.innovation, 0.0)
        return Belief.updated(belief, mean, belief.cov, reading, belief.cov + reading.R)


def test_a_filter_of_ones_own_may_be_formulas():
    model: Model = LinearModel(0.9 * np.eye(2), np.eye(2), np.eye(2), np.eye(2))
    own, plain = Alpha(model), Alpha(model)
    plain._programs = None
    y = np.random.default_rng(0).normal(size=(9, 2))
    one, other = (f.update(f.predict(f.init(Gaussian(np.zeros((9, 2)), np.eye(2)))), y) for f in (own, plain))
    assert own._programs
    assert_same(one, other, 1e-15)
    assert arrays(one).keys() == arrays(other).keys()


class Fading(KalmanFilter):
    """A Kalman filter of one's own, in NumPy of any kind."""

    forget, updates = 1.0, 0

    def _predict(self, belief: Belief, u: np.ndarray | None, rng: Rng) -> Belief:
        before = super()._predict(belief, u, rng)
        return before.replace(cov=before.cov * self.forget)

    def _update(self, belief: Belief, reading: Reading, rng: Rng) -> Belief:
        self.updates += 1
        mean = belief.mean.copy()
        if np.abs(reading.innovation).max() > 1e6:
            mean[..., 0] = 0.0
        return super()._update(belief.replace(mean=np.clip(mean, -1e9, 1e9)), reading, rng)


def test_a_filter_below_one_of_ours_is_numpy_until_it_says_otherwise():
    model: Model = LinearModel(0.9 * np.eye(2), np.eye(2), np.eye(2), np.eye(2))
    own, ours = Fading(model), make("kf", model)
    y = np.random.default_rng(0).normal(size=(9, 2))
    one, other = (f.update(f.predict(f.init(Gaussian(np.zeros((9, 2)), np.eye(2)))), y) for f in (own, ours))
    assert_same(one, other, 1e-14)
    own.forget = 2.0  # which counts from now on
    assert (own.predict(one).cov > 1.5 * ours.predict(other).cov)[:, 0, 0].all()
    assert own.updates == 1


def test_what_a_formula_of_ones_own_gives_is_looked_at():
    class Negative(Alpha):
        formulas = True

        def _update(self, belief: Belief, reading: Reading, rng: Rng) -> Belief:
            return super()._update(belief, reading, rng).replace(cov=-1.0 * belief.cov)

    model: Model = LinearModel(np.eye(2), np.eye(2), np.eye(2), np.eye(2))
    filter = Negative(model)
    assert filter.update(filter.init(Gaussian(np.zeros((3, 2)), np.eye(2))), np.zeros((3, 2))).recovery.all()

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

            def _update(self, belief: Belief, reading: Reading, rng: Rng) -> Belief:
                return self.given(belief)

        filter = Wrong(model)
        with pytest.raises(TypeError, match="Wrong says that it is formulas, but cannot be traced as such"):
            filter.update(filter.init(Gaussian(np.zeros((3, 2)), np.eye(2))), np.zeros((3, 2)))


class Information(KalmanFilter):
    """The update in information form: ``P = (I + P- C' R^-1 C)^-1 P-``, of a matrix that is not symmetric."""

    formulas = True

    def _update(self, belief: Belief, reading: Reading, rng: Rng) -> Belief:
        seen = reading.C.mT @ np.linalg.solve(reading.R, reading.C)
        cov = np.linalg.solve(np.eye(self.model.n) + belief.cov @ seen, belief.cov)
        gain = np.linalg.solve(reading.R, reading.C @ cov).mT
        S = reading.C @ belief.cov @ reading.C.mT + reading.R
        return Belief.updated(belief, belief.mean + np.matvec(gain, reading.innovation), symmetrise(cov), reading, S)


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
    """Remembers of each row whether any reading has come."""

    formulas = True
    record = Marked  # type: ignore[assignment]

    def _init(self, belief: Belief, rng: Rng) -> Belief:
        return Marked.of(belief, seen=np.zeros(belief.mean.shape[:-1] + (self.model.p,), bool))

    def _predict(self, belief: Any, u: np.ndarray | None, rng: Rng) -> Belief:
        return Marked.of(super()._predict(belief, u, rng), seen=belief.seen)

    def _update(self, belief: Any, reading: Reading, rng: Rng) -> Belief:
        return Marked.of(super()._update(belief, reading, rng), seen=~(~belief.seen & ~reading.available))


def test_a_mask_of_ones_own_is_a_mask_in_a_row_that_is_recovered():
    filter = Marking(LinearModel(np.eye(2), np.eye(2), np.zeros((2, 2)), np.zeros((2, 2))))  # readings without noise
    belief = filter.init(Gaussian(np.zeros((4, 2)), np.eye(2)))
    for k in range(3):
        y = np.where(np.arange(4)[:, None] == 1, np.nan, float(k) * np.ones((4, 2)))
        belief = filter.update(filter.predict(belief), y)
        assert belief.seen.dtype == bool
        np.testing.assert_array_equal(belief.seen, np.isfinite(y))
    assert (belief.recovery == Recovery.PSEUDO_INVERSE).any()


@pytest.mark.parametrize(
    ("formula", "sentence"),
    [
        (lambda P, x: P.sum(0), "sums over its last axes"),
        (lambda P, x: x[:1], "indexed from behind"),
        (lambda P, x: P.diagonal(1, -2, -1), "diagonal"),
        (lambda P, x: P @ x, "np.matvec"),
        (lambda P, x: np.sort(x), "cannot have np.sort in it"),
        (lambda P, x: 1.0 if x[..., 0] > 0.0 else 2.0, "np.where"),
    ],
)
def test_what_means_something_else_in_a_formula_is_refused(formula: Callable[..., Any], sentence: str):
    S, _, x, _ = tracers()
    with pytest.raises(TypeError, match=sentence):
        formula(S, x)


def test_a_product_over_nothing_is_zero():
    product = compiled(lambda H: H @ H.mT + 1.0, axes=(2,), matrices=True)(np.zeros((5, 3, 0)))
    np.testing.assert_array_equal(product, np.ones((5, 3, 3)))


def test_a_prediction_leaves_what_the_last_update_had_to_do():
    filter = make("kf", LinearModel(np.eye(1), np.eye(1), np.eye(1), np.eye(1)))
    belief = filter.update(filter.init(Gaussian(np.zeros((2, 1)), np.eye(1))), np.array([[0.0], [np.nan]]))
    belief = belief.replace(recovery=np.array([0, 4], np.int8))
    np.testing.assert_array_equal(filter.predict(belief).recovery, [0, 4])
