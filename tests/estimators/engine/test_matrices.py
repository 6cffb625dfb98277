"""Formulas of small matrices: compiled they are what NumPy computes, for every row by itself."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from estimators import linalg
from estimators.engine import NotTraceable, machine
from estimators.engine.compiled import given, trace
from estimators.engine.function import Argument, Function
from estimators.engine.program import Program
from tests.estimators.cases import random_covariance

ROWS = (1, 2, 3, 4, 7, 8, 9, 16, 63, 64, 65, 70, 200)
SHAPES = Argument((3, 3)), Argument((3, 2)), Argument((3,)), Argument((3,), "b")
AXES = 2, 2, 1, 1
Formula = Callable[[Any, Any, Any, Any], Any]


def squared(root: Any) -> Any:
    return root @ root.mT


def from_singular(a: Any, power: int) -> Any:
    values, V = linalg.singular(a)
    return (V * (values if power == 1 else np.square(values))[..., None, :]) @ V.mT


FORMULAS: dict[str, Formula] = {
    "sums": lambda S, B, x, m: S @ B - 2.0 * B + B / 3.0,
    "transposed": lambda S, B, x, m: (S @ B).mT @ S,
    "vectors": lambda S, B, x, m: np.matvec(S, x) + np.vecmat(x, S) - x,
    "masks": lambda S, B, x, m: np.where((m & np.isfinite(x))[..., None], B, 0.0) + np.where(~m, x, 1.0)[..., None],
    "sizes": lambda S, B, x, m: np.maximum(np.abs(x), 0.5) - np.minimum(np.square(x), 0.5) + np.sqrt(x * x),
    "comparisons": lambda S, B, x, m: np.where(x > 0.1, x, -x) + np.where(x < -0.2, np.floor(x), np.log1p(x * x)),
    "sums of entries": lambda S, B, x, m: B.sum(-2).sum(-1) + B.sum(-1).sum(-1) * B.sum((-2, -1)) + x.sum(-1),
    "diagonal": lambda S, B, x, m: S.diagonal(0, -2, -1) - np.remainder(x, 0.7),
    "masked": lambda S, B, x, m: np.where(m[..., None] & m[..., None, :], S, np.eye(3)),
    "elementary functions": lambda S, B, x, m: np.sin(x) + np.cos(x) * np.exp(x) - np.arctan2(x, np.abs(x) + 1.0),
    "numbers beside matrices": lambda S, B, x, m: x * S[..., 0, 0][..., None] + np.exp(x[..., 1])[..., None],
    "solve any matrix": lambda S, B, x, m: np.linalg.solve(S + 5.0 * np.eye(3)[[1, 2, 0]], B) % B[..., :1, :],
    "inner": lambda S, B, x, m: linalg.inner(B, B) + linalg.inner(S, B.mT @ S) @ B.mT,
    "widened by ones": lambda S, B, x, m: S[..., :1, :] * np.ones((3, 3)),
    "masks of numbers": lambda S, B, x, m: np.where(np.logical_and(x, m) | np.logical_not(x), np.tanh(x), np.sign(x)),
    "equal numbers": lambda S, B, x, m: (np.floor(S) == np.floor(S.mT)) * S - (S.mT != S) * np.expm1(-np.abs(S)),
    "slices": lambda S, B, x, m: linalg.joined([B[..., 1:, :], B[..., :1, ::-1]], -2) + B[..., 2, None, :],
    "blocks": lambda S, B, x, m: linalg.joined([S, B, np.eye(3)], -1),
    "solve": lambda S, B, x, m: linalg.solve(S, B),
    "solve by a lower triangle": lambda S, B, x, m: linalg.solve_lower(linalg.cholesky(S), B),
    "solve by an upper triangle": lambda S, B, x, m: linalg.solve_upper(linalg.semidefinite_cholesky(S).mT, B),
    "cholesky": lambda S, B, x, m: linalg.cholesky(S) - 2.0 * linalg.semidefinite_cholesky(S),
    "cholesky of less than full rank": lambda S, B, x, m: squared(linalg.semidefinite_cholesky(B @ B.mT)),
    "symmetrise": lambda S, B, x, m: linalg.symmetrise(S @ S),
    "singular values": lambda S, B, x, m: from_singular(B, 1),
    "singular values squared": lambda S, B, x, m: from_singular(S, 2),
}  # fmt: skip


@pytest.fixture(autouse=True)
def _cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = tmp_path_factory.getbasetemp() / "objects"
    kept.mkdir(exist_ok=True)
    monkeypatch.setattr(machine, "folder", lambda: kept)


def arguments(rows: int) -> list[np.ndarray]:
    rng = np.random.default_rng(rows)
    mask = rng.random((rows, 3)) < 0.5
    return [
        random_covariance(rng, 3, (rows,)),
        rng.normal(size=(rows, 3, 2)),
        rng.normal(size=(rows, 3)),
        mask,
    ]


def traced(formula: Formula) -> Function:
    return trace(formula, SHAPES, matrices=True)[0]


def run(function: Function, parts: list[np.ndarray]) -> np.ndarray:
    return function.compute(parts)[0]


def tracers() -> list[Any]:
    program = Program()
    return [given(program, i, row, matrices=True) for i, row in enumerate(SHAPES)]


@pytest.mark.parametrize("formula", FORMULAS.values(), ids=FORMULAS.keys())
def test_a_formula_is_what_numpy_computes_with_the_same_bits_alone_and_in_any_batch(
    formula: Formula,
):
    function = traced(formula)
    for rows in ROWS:
        parts = arguments(rows)
        found = run(function, parts)
        np.testing.assert_allclose(found, formula(*parts), rtol=0.0, atol=1e-12)
        for some in (slice(rows - 1, rows), slice(0, 5), slice(rows // 2, rows)):
            np.testing.assert_array_equal(
                run(function, [part[some] for part in parts]), found[some]
            )


@pytest.mark.parametrize("formula", FORMULAS.values(), ids=FORMULAS.keys())
def test_two_widths_give_the_same_bits(formula: Formula, monkeypatch: pytest.MonkeyPatch):
    parts = arguments(21)
    wide = traced(formula)
    narrow, half = traced(formula), traced(formula)
    narrow._wide, half._wide = 1, 4
    found = run(wide, parts)
    np.testing.assert_array_equal(run(narrow, parts), found)
    np.testing.assert_array_equal(run(half, parts), found)
    assert wide.text(8) != half.text(4)


@pytest.mark.skipif("x86_64" not in machine._processor()[1], reason="of processors of this family")
def test_a_processor_with_less_gives_the_same_bits(monkeypatch: pytest.MonkeyPatch):
    parts = arguments(13)
    expected = {name: run(traced(formula), parts) for name, formula in FORMULAS.items()}
    processor = machine._processor()
    monkeypatch.setattr(machine, "_processor", lambda: (*processor[:2], "x86-64-v2", ""))
    for name, formula in FORMULAS.items():
        np.testing.assert_array_equal(run(traced(formula), parts), expected[name])


@pytest.mark.parametrize("function", [np.maximum, np.minimum])
def test_what_is_no_number_stays_none(function: np.ufunc):
    S, B, x, m = arguments(70)
    x[::3], S[::2, 0] = np.nan, np.nan
    found = run(traced(lambda S, B, x, m: function(x, S[..., 0, :])), [S, B, x, m])
    np.testing.assert_array_equal(found, function(x, S[..., 0, :]))


@pytest.mark.parametrize("name", ["solve", "solve by a lower triangle", "cholesky"])
def test_a_matrix_that_is_no_covariance_is_lost_and_no_other(name: str):
    S, B, x, m = arguments(70)
    function = traced(FORMULAS[name])
    expected = run(function, [S, B, x, m])
    S = S.copy()
    S[5], S[66] = -np.eye(3), np.nan
    found = run(function, [S, B, x, m])
    lost = np.isin(np.arange(70), (5, 66))
    assert np.isnan(found[lost]).any((-2, -1)).all()
    np.testing.assert_array_equal(found[~lost], expected[~lost])


def test_solve_is_numpys_for_any_matrix():
    _, B, x, m = arguments(70)
    A = np.random.default_rng(1).normal(size=(70, 3, 3))
    A[3] = np.eye(3)[[2, 0, 1]]  # no pivot on the diagonal
    A[4] = -A[4] @ A[4].mT
    function = traced(lambda A, B, x, m: np.linalg.solve(A, B))
    found = run(function, [A, B, x, m])
    np.testing.assert_allclose(
        found, np.linalg.solve(A, B), rtol=1e-12 * np.linalg.cond(A).max(), atol=0.0
    )
    A[5] = np.ones((3, 3))
    again = run(function, [A, B, x, m])
    assert np.isnan(again[5]).all()
    np.testing.assert_array_equal(np.delete(again, 5, 0), np.delete(found, 5, 0))


def test_a_remainder_is_numpys_to_the_last_bit():
    S, B, x, m = arguments(70)
    x[:5, 0] = 1e17, -1e17, np.inf, -0.0, 5.0
    S[4, 0, 0] = np.inf
    for formula in (
        lambda S, B, x, m: x % 0.7,
        lambda S, B, x, m: 5.0 % x,
        lambda S, B, x, m: x % S[..., 0, :],
    ):
        with np.errstate(all="ignore"):
            np.testing.assert_array_equal(run(traced(formula), [S, B, x, m]), formula(S, B, x, m))


def test_zeros_keep_their_signs():
    S, B, x, m = arguments(5)
    x[:] = [0.0, -0.0, 1.0]
    for formula in (
        lambda S, B, x, m: 1.0 / (x + 0.0),
        lambda S, B, x, m: 1.0 / (x + -0.0),
        lambda S, B, x, m: 1.0 / -x,
        lambda S, B, x, m: 1.0 / np.concatenate([x, x], -1),
    ):
        with np.errstate(all="ignore"):
            np.testing.assert_array_equal(run(traced(formula), [S, B, x, m]), formula(S, B, x, m))


def test_large_matrices_are_loops_and_not_unrolled():
    function, _ = trace(lambda S: linalg.cholesky(S) @ S, [Argument((30, 30))], matrices=True)
    assert len(function.instructions) < 10
    S = random_covariance(np.random.default_rng(0), 30, (6,))
    (found,) = function.compute([S])
    np.testing.assert_allclose(found, np.linalg.cholesky(S) @ S, rtol=1e-11, atol=1e-11)


def test_a_product_over_nothing_is_zero():
    function, _ = trace(lambda H: H @ H.mT + 1.0, [Argument((3, 0))], matrices=True)
    (found,) = function.compute([np.zeros((5, 3, 0))])
    np.testing.assert_array_equal(found, np.ones((5, 3, 3)))


def test_no_equations_have_a_solution_of_no_rows():
    for word in (linalg.solve, linalg.solve_lower, linalg.solve_upper, np.linalg.solve):
        function, _ = trace(word, [Argument((0, 0)), Argument((0, 2))], matrices=True)
        assert function.compute([np.zeros((5, 0, 0)), np.zeros((5, 0, 2))])[0].shape == (5, 0, 2)


# --- refused --------------------------------------------------------------------------------------

MISTAKES: dict[str, Formula] = {
    "inner sizes of @": lambda S, B, x, m: B @ S,
    "inner sizes of matvec": lambda S, B, x, m: np.matvec(B, x),
    "vecmat for matvec": lambda S, B, x, m: np.vecmat(x[..., :2], B),
    "rows of solve": lambda S, B, x, m: np.linalg.solve(S, B[..., :2, :]),
    "more rows of solve": lambda S, B, x, m: np.linalg.solve(S[..., :2, :2], B),
    "no square to solve": lambda S, B, x, m: np.linalg.solve(B, B),
    "a vector to solve for": lambda S, B, x, m: np.linalg.solve(S, x),
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
    "definite one": lambda S, B, x, m: linalg.solve(S[..., :2, :2], B),
    "triangle": lambda S, B, x, m: linalg.solve_upper(S[..., :2, :2], B),
    "block beside a table": lambda S, B, x, m: linalg.joined([B[..., :1, :], S], -1),
    "no square for filters to symmetrise": lambda S, B, x, m: linalg.symmetrise(B),
    "no square for filters to factor": lambda S, B, x, m: linalg.semidefinite_cholesky(B.mT),
}  # fmt: skip


@pytest.mark.parametrize("formula", MISTAKES.values(), ids=MISTAKES.keys())
def test_what_numpy_refuses_is_refused_while_it_is_traced(formula: Formula):
    with pytest.raises((ValueError, IndexError)):
        formula(*arguments(11))
    with pytest.raises((ValueError, TypeError, IndexError)) as caught:
        formula(*tracers())
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "formula",
    [
        lambda S, B, x, m: x**2,
        lambda S, B, x, m: np.sqrt(m),
        lambda S, B, x, m: +m,
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
        lambda S, B, x, m: np.array([x[..., 0:1], x[..., 1:2]]),
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
def test_a_word_that_would_mean_something_else_is_refused(formula: Formula):
    with pytest.raises((TypeError, ValueError, AttributeError)) as caught:
        formula(*tracers())
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("formula", "sentence"),
    [
        (lambda S, B, x, m: S.sum(0), "sums over its last axes"),
        (lambda S, B, x, m: x[:1], "indexed from behind"),
        (lambda S, B, x, m: S.diagonal(1, -2, -1), "diagonal"),
        (lambda S, B, x, m: S @ x, r"np\.matvec"),
        (lambda S, B, x, m: np.sort(x), r"cannot have np\.sort in it"),
        (lambda S, B, x, m: np.sinh(x), r"cannot have np\.sinh in it"),
        (lambda S, B, x, m: np.cross(x, x), r"cannot have np\.cross in it"),
        (lambda S, B, x, m: 1.0 if x[..., 0] > 0.0 else 2.0, r"to np\.where"),
        (lambda S, B, x, m: 1.0 if (x > 0.0) else 2.0, r"use np\.where"),
    ],
)
def test_a_refusal_says_what_to_do(formula: Formula, sentence: str):
    with pytest.raises(NotTraceable, match=sentence):
        formula(*tracers())
