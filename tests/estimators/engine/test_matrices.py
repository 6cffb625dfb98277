"""Formulas of small matrices: compiled they are what NumPy computes, for every row by itself."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from estimators import linalg
from estimators.engine import trace
from estimators.engine.arrays import TracedArray
from estimators.engine.function import Argument
from estimators.engine.matrices import matrix
from tests.estimators.cases import random_covariance

ROWS = (1, 2, 7, 8, 9, 64, 70, 200)
SHAPES = [Argument(*row, True) for row in (((3, 3), "f"), ((3, 2), "f"), ((3,), "f"), ((3,), "b"))]
Formula = Callable[[Any, Any, Any, Any], Any]


def from_singular(a: Any, power: int) -> Any:
    values, V = linalg.singular(a)
    return (V * (values if power == 1 else np.square(values))[..., None, :]) @ V.mT


def formulas(S: Any, B: Any, x: Any, m: Any) -> dict[str, Any]:
    L = linalg.semidefinite_cholesky(S)
    return {
        "products": S @ B - 2.0 * B + B / 3.0 + (S @ B).mT[..., :1].mT,
        "vectors": np.matvec(S, x) + np.vecmat(x, S) - x,
        "masks": np.where((m & np.isfinite(x))[..., None], B, 0.0)
        + np.where(~m, x, 1.0)[..., None],
        "comparisons": np.where(x > 0.1, x, -x)
        + np.where(x < -0.2, np.sin(x), np.arctan2(x, x * x)),
        "sums of entries": B.sum(-2).sum(-1) * x.sum(-1) - S.diagonal(0, -2, -1).sum(-1),
        "masked": np.where(m[..., None] & m[..., None, :], S, np.exp(x[..., 1])[..., None, None]),
        "inner of many": linalg.joined([S, B, S @ S, B, S, B, B], -1)
        @ linalg.joined([S, B, S @ S, B, S, B, B], -1).mT,
        "inner of two of many": linalg.joined([S] * 6, -1)
        @ linalg.joined([2.0 * S, B] * 4, -1)[..., 1:, 2:].mT,
        "inner": B @ B.mT + S @ (B.mT @ S).mT @ B.mT,
        "equal numbers": (np.floor(S) == np.floor(S.mT)) * S - (S.mT != S) * np.exp(-np.abs(S)),
        "slices": linalg.joined([B[..., 1:, :], np.eye(3)[:1, :2]], -2) + B[..., 2, None, :],
        "solve": linalg.solve(S, B),
        "solve by a lower triangle": linalg.solve_lower(linalg.cholesky(S), B),
        "solve by an upper triangle": linalg.solve_upper(L.mT, B),
        "cholesky": linalg.cholesky(S) - 2.0 * linalg.symmetrise(S @ L),
        "cholesky of less than full rank": linalg.semidefinite_cholesky(B @ B.mT)
        @ linalg.semidefinite_cholesky(B @ B.mT).mT,
        "singular values": from_singular(B, 1),
        "singular values squared": from_singular(S, 2),
    }


def arguments(rows: int) -> list[np.ndarray]:
    rng = np.random.default_rng(rows)
    S, B = random_covariance(rng, 3, (rows,)), rng.normal(size=(rows, 3, 2))
    return [S, B, rng.normal(size=(rows, 3)), rng.random((rows, 3)) < 0.5]


def compute(formula: Any, *arguments: np.ndarray) -> np.ndarray:
    """A formula of matrices, compiled and computed."""
    rows = [Argument(each.shape[1:], each.dtype.kind, True) for each in arguments]
    return trace(formula, rows).compute(*arguments)


NAMES = list(formulas(*arguments(1)))


def formula(name: str) -> Formula:
    return lambda *arguments: formulas(*arguments)[name]


@pytest.mark.parametrize("name", NAMES)
def test_a_formula_has_the_same_bits_alone_and_in_any_batch(name: str):
    function = trace(formula(name), SHAPES)
    for rows in ROWS:
        parts = arguments(rows)
        found = function.compute(*parts)
        assert_allclose(found, formulas(*parts)[name], rtol=0.0, atol=1e-12)
        for some in (slice(rows - 1, rows), slice(0, 5), slice(rows // 2, rows)):
            part = function.compute(*(each[some] for each in parts))
            assert_array_equal(part, found[some])


@pytest.mark.parametrize(
    "function",
    [
        lambda x, y: np.maximum(x, y),
        lambda x, y: np.minimum(x, y),
        lambda x, y: x % y,
        lambda x, y: 1.0 / (x + -0.0),
        lambda x, y: 1.0 / np.concatenate([-x, y], -1),
    ],
)
def test_zeros_infinities_and_what_is_no_number_are_numpys(function: Any):
    x, y = np.random.default_rng(0).normal(size=(2, 70, 3))
    x[::3], y[::2] = [np.nan, 0.0, -0.0], np.nan
    x[1::3, 0], y[1::6, 0] = np.inf, -np.inf
    x[2, 0] = 1e17
    with np.errstate(all="ignore"):
        assert_array_equal(compute(function, x, y), function(x, y))


@pytest.mark.parametrize("name", ["solve", "solve by a lower triangle", "cholesky"])
def test_a_matrix_that_is_no_covariance_is_lost_and_no_other(name: str):
    S, B, x, m = arguments(70)
    expected = compute(formula(name), S, B, x, m)
    S[4], S[5], S[66] = np.diag([1.0, 1.0, 0.0]), -np.eye(3), np.nan
    found = compute(formula(name), S, B, x, m)
    lost = np.isin(np.arange(70), (4, 5, 66))
    assert np.isnan(found[lost]).any((-2, -1)).all()
    assert_array_equal(found[~lost], expected[~lost])


def test_products_without_known_zeros_have_equal_bits():
    n, rng = 12, np.random.default_rng(0)
    here, x, S = rng.random((n, n)) < 0.3, rng.normal(size=(9, n)), rng.normal(size=(9, n, n))

    def sparse(x: Any) -> Any:
        return matrix(TracedArray.of([[x[i] * x[j] if here[i, j] else 0.0
                                       for j in range(n)] for i in range(n)]))  # fmt: skip

    def products(A: Any, S: Any) -> list[Any]:
        return [A @ S, S @ A.mT, np.matvec(A, S[..., 0]), A @ here, here @ A.mT]

    rows = [Argument((n,), whole=True), Argument((n, n), whole=True)]
    found = trace(lambda x, S: products(sparse(x), S), rows)
    assert all(each.opcode != "matmul" for each in found.instructions)
    dense = here * (x[:, :, None] * x[:, None, :])
    expected = trace(products, [rows[1]] * 2).compute(dense, S)
    for one, other in zip(found.compute(x, S), expected, strict=True):
        assert_array_equal(one, other)


def test_large_matrices_are_loops_and_empty_ones_are_zero():
    def formula(S: Any) -> Any:
        return linalg.cholesky(S) @ S

    function = trace(formula, [Argument((30, 30), whole=True)])
    assert len(function.instructions) < 10
    S, H = random_covariance(np.random.default_rng(0), 30, (6,)), np.zeros((5, 3, 0))
    assert_allclose(function.compute(S), formula(S), rtol=1e-11, atol=1e-11)
    assert_array_equal(compute(lambda H: H @ H.mT + 1.0, H), np.ones((5, 3, 3)))


@pytest.mark.parametrize(
    "formula",
    [
        lambda S, B, x, m: B @ S,
        lambda S, B, x, m: S @ x,
        lambda S, B, x, m: linalg.solve(S, B[..., :2, :]),
        lambda S, B, x, m: np.concatenate([B[..., :1, :], S], -1),
        lambda S, B, x, m: np.where(m[..., :2], x, 0.0),
        lambda S, B, x, m: linalg.joined([S] * 4, -1) @ linalg.joined([S] * 5, -2),
        lambda S, B, x, m: S[..., 3, :],
    ],
)
def test_what_numpy_refuses_is_refused_while_it_is_traced(formula: Formula):
    for traced in (lambda: formula(*arguments(11)), lambda: trace(formula, SHAPES)):
        with pytest.raises((ValueError, IndexError)):
            traced()
