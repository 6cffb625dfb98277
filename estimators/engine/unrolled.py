"""Linear algebra of small matrices, scalar by scalar, without what is known to be zero.

Matrices are arrays of scalars of one row. A covariance is computed in its lower half, and quotients
by one number are products with its reciprocal.
"""

from typing import Any

import numpy as np

from estimators.engine.arrays import TracedArray
from estimators.engine.tracer import Tracer, known, operation, where


def product(a: Any, b: Any) -> TracedArray:
    """``A B``."""
    return TracedArray.of([[_inner(row, column) for column in b.T] for row in a])


def congruence(a: Any, p: Any) -> TracedArray:
    """``A P A'`` of a symmetric P."""
    left = product(a, p)
    return _symmetric(len(a), lambda i, j: _inner(left[i], a[j]))


def symmetrise(a: Any) -> TracedArray:
    """The symmetric part of A."""
    return _symmetric(len(a), lambda i, j: _mean(a[i, j], a[j, i]))


def cholesky(s: Any) -> TracedArray:
    """Lower triangular L with ``L L' = S``; NaN of an S that is not positive definite."""
    root = TracedArray.of(np.zeros(s.shape))
    for j in range(len(s)):
        pivot = s[j, j] - _inner(root[j, :j], root[j, :j])
        root[j, j] = operation("sqrt", where(pivot > 0.0, pivot, np.nan))
        for i in range(j + 1, len(s)):
            rest = s[i, j] - _inner(root[i, :j], root[j, :j])
            root[i, j] = _divided(rest, root[j, j])
    return root


def solve_lower(t: Any, b: Any) -> TracedArray:
    """``L^-1 B`` of a lower triangular L."""
    z = TracedArray.of(np.zeros(b.shape))
    for i, j in np.ndindex(b.shape):
        z[i, j] = _divided(b[i, j] - _inner(t[i, :i], z[:i, j]), t[i, i])
    return z


def _symmetric(n: int, entry: Any) -> TracedArray:
    """A symmetric matrix of the entries of its lower half."""
    half = [[entry(i, j) for j in range(i + 1)] for i in range(n)]
    return TracedArray.of([[half[max(i, j)][min(i, j)] for j in range(n)] for i in range(n)])


def _inner(x: Any, y: Any) -> Any:
    """The inner product of two vectors."""
    terms = [a * b for a, b in zip(x, y, strict=True) if not (_is_zero(a) or _is_zero(b))]
    return sum(terms[1:], terms[0]) if terms else 0.0


def _mean(x: Any, y: Any) -> Any:
    """The mean of two numbers."""
    same = isinstance(x, Tracer) and isinstance(y, Tracer) and x.value == y.value
    return x if same else 0.5 * (x + y)


def _divided(x: Any, y: Any) -> Any:
    """``x / y`` by the reciprocal of y, which a program computes once."""
    return 0.0 if _is_zero(x) else x * (1.0 / y)


def _is_zero(x: Any) -> bool:
    """Is a number known to be 0?"""
    return bool((known(x) if isinstance(x, Tracer) else x) == 0.0)
