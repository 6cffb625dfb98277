"""Linear algebra of traced matrices: products, factorisations, solutions.

Those of small matrices are unrolled, scalar by scalar, without what is known to be zero: a
covariance is computed in its lower half, and quotients by one number are products with its
reciprocal. Those of large ones are single instructions; a product with a matrix of many known zeros
is a loop over the columns of the other matrix.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np

from estimators.engine.arrays import TracedArray
from estimators.engine.matrices import (
    PRODUCTS,
    by_entries,
    columnwise,
    is_small,
    is_sparse,
    is_traced,
    is_zero,
    loop,
    matrix,
)
from estimators.engine.tracer import Tracer, operation, where


def product(a: Any, b: Any) -> Any:
    """``A B``."""
    (rows, inner), (length, columns) = a.shape, b.shape
    if is_small(a, b):
        return _array((_inner(row, column) for row in a for column in b.T), (rows, columns))
    if inner != length:
        raise ValueError(f"matrices of shapes {a.shape} and {b.shape} a row have no product")
    if is_sparse(a) and is_traced(b):
        return columnwise(lambda x: TracedArray.of([_inner(row, x) for row in by_entries(a)]), b)
    if is_sparse(b) and is_traced(a):
        return product(b.mT, a.mT).mT
    return loop("matmul", (rows, columns), a, b)


def congruence(a: Any, p: Any) -> Any:
    """``A P A'`` of a symmetric P."""
    left = product(a, p)
    if not is_small(a, p):
        return product(left, a.mT)
    return _symmetric(len(a), lambda i, j: _inner(left[i], a[j]))


def symmetrise(a: Any) -> Any:
    """The symmetric part of A."""
    if not is_small(a):
        return 0.5 * (a + a.mT)
    return _symmetric(len(a), lambda i, j: _mean(a[i, j], a[j, i]))


def cholesky(s: Any) -> Any:
    """Lower triangular L with ``L L' = S``; NaN of an S that is not positive definite."""
    if not is_small(s):
        return loop("cholesky", s.shape, s)
    root = TracedArray.of(np.zeros(s.shape))
    for j in range(len(s)):
        pivot = s[j, j] - _inner(root[j, :j], root[j, :j])
        root[j, j] = operation("sqrt", where(pivot > 0.0, pivot, np.nan))
        for i in range(j + 1, len(s)):
            rest = s[i, j] - _inner(root[i, :j], root[j, :j])
            root[i, j] = _divided(rest, root[j, j])
    return matrix(root)


def semidefinite_cholesky(s: Any) -> Any:
    """Lower triangular L with ``L L' = S`` of a positive semidefinite S."""
    return loop("semidefinite_cholesky", s.shape, s)


def solve_lower(t: Any, b: Any) -> Any:
    """``L^-1 B`` of a lower triangular L."""
    if len(t) != len(b):
        raise ValueError(f"matrices of shapes {t.shape} and {b.shape} a row have no solution")
    if not is_small(t, b):
        return loop("solve_lower", b.shape, t, b)
    z = TracedArray.of(np.zeros(b.shape))
    for i, j in np.ndindex(b.shape):
        z[i, j] = _divided(b[i, j] - _inner(t[i, :i], z[:i, j]), t[i, i])
    return matrix(z)


def solve_upper(t: Any, b: Any) -> Any:
    """``U^-1 B`` of an upper triangular U: a lower one, read backwards."""
    return solve_lower(t[..., ::-1, ::-1], b[..., ::-1, :])[..., ::-1, :]


def solve_definite(s: Any, b: Any) -> Any:
    """``S^-1 B`` of a symmetric positive definite S; NaN of any other."""
    root = cholesky(s)
    return solve_upper(root.mT, solve_lower(root, b))


def rotated(a: Any) -> tuple[Any, Any]:
    """``A V`` with orthogonal columns, and the rotation V: an SVD without the last division.

    Source: Hestenes (1958), Inversion of matrices by biorthogonalization; de Rijk (1989) for its
    accuracy.
    """
    m, n = a.shape
    both = loop("rotate", (m + n, n), a, attributes=(n,))
    return both[:m], both[m:]


def orthogonal(a: Any) -> Any:
    """``A V`` alone."""
    return loop("rotate", a.shape, a, attributes=(0,))


def _array(entries: Iterable[Any], shape: tuple[int, ...]) -> Any:
    """A matrix of scalars."""
    return matrix(np.fromiter(entries, object).reshape(shape).view(TracedArray))


def _symmetric(n: int, entry: Any) -> Any:
    """A symmetric matrix of the entries of its lower half."""
    half = [[entry(i, j) for j in range(i + 1)] for i in range(n)]
    return _array((half[max(place)][min(place)] for place in np.ndindex(n, n)), (n, n))


def _inner(x: Any, y: Any) -> Any:
    """The inner product of two vectors."""
    terms = [a * b for a, b in zip(x, y, strict=True) if not (is_zero(a) or is_zero(b))]
    return sum(terms[1:], terms[0]) if terms else 0.0


def _mean(x: Any, y: Any) -> Any:
    """The mean of two numbers."""
    same = isinstance(x, Tracer) and isinstance(y, Tracer) and x.value == y.value
    return x if same else 0.5 * (x + y)


def _divided(x: Any, y: Any) -> Any:
    """``x / y`` by the reciprocal of y, which a program computes once."""
    return 0.0 if is_zero(x) else x * (1.0 / y)


PRODUCTS |= {
    np.matmul: product,
    np.matvec: lambda a, x: product(a, x[:, None])[:, 0],
    np.vecmat: lambda x, a: product(x[None], a)[0],
}
