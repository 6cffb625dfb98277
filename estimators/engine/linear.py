"""Linear algebra of traced matrices: products, factorisations, solutions, each an instruction."""

from functools import partial
from typing import Any

import numpy as np

from estimators.engine import unrolled
from estimators.engine.matrices import (
    FUNCTIONS,
    MatrixTracer,
    by_scalars,
    is_small,
    joined,
    matrix,
    shapes,
)
from estimators.engine.program import Program
from estimators.engine.tracer import program_of


def _matrices(*operands: Any) -> tuple[Program, Any, Any]:
    """The program of two operands, and the operands as matrices."""
    program = program_of(operands)
    return program, *map(partial(matrix, program), operands)


def _misfit(word: str, *operands: Any) -> ValueError:
    return ValueError(f"{shapes(operands)} have no {word} in a traced formula")


def _for_every_row(program: Program, values: np.ndarray) -> MatrixTracer:
    """A matrix that is the same for all rows, with the batch's axes."""
    return MatrixTracer(program, program.table(values), values.shape)


def _matmul(a: Any, b: Any) -> Any:
    program, a, b = _matrices(a, b)
    if not a.ndim == b.ndim == 2 or a.shape[1] != b.shape[0]:
        raise _misfit("product (of a matrix and a vector: np.matvec)", a, b)
    rows, columns = a.shape[0], b.shape[1]
    if a.shape[1] == 0:
        return _for_every_row(program, np.zeros((rows, columns)))
    if is_small(a, b):
        return by_scalars(unrolled.product, a, b)
    symmetric = a.view == b.mT.view
    value = program.add("matmul", (a.view, b.view), "f", rows * columns, (symmetric,))
    return MatrixTracer(program, value, (rows, columns))


def congruence(a: Any, p: Any) -> Any:
    """``A P A'`` of a symmetric P."""
    _, whole, p = _matrices(a, p)
    return by_scalars(unrolled.congruence, whole, p) if is_small(whole, p) else a @ p @ a.mT


def symmetrise(a: Any) -> Any:
    """The symmetric part of A."""
    return by_scalars(unrolled.symmetrise, a) if is_small(a) else 0.5 * (a + a.mT)


def _matvec(a: Any, x: Any) -> Any:
    return _matmul(a, x[..., None])[..., 0]


def solve_lower(t: Any, b: Any) -> Any:
    """``L^-1 B`` of a lower triangular L."""
    program, t, b = _matrices(t, b)
    if b.ndim != 2 or t.shape != (b.shape[0],) * 2:
        raise _misfit("solution (of a vector b: b[..., None])", t, b)
    if is_small(t, b):
        return by_scalars(unrolled.solve_lower, t, b)
    return MatrixTracer(program, program.add("solve_lower", (t.view, b.view), "f", b.size), b.shape)


def solve_upper(t: Any, b: Any) -> Any:
    """``U^-1 B`` of an upper triangular U: a lower one, read backwards."""
    return solve_lower(t[..., ::-1, ::-1], b[..., ::-1, :])[..., ::-1, :]


def solve_definite(s: Any, b: Any) -> Any:
    """``S^-1 B`` of a symmetric positive definite S; NaN of any other."""
    root = cholesky(s)
    return solve_upper(root.mT, solve_lower(root, b))


def _of_square(opcode: str, a: Any) -> MatrixTracer:
    if a.shape != a.shape[::-1] or a.ndim != 2:
        raise _misfit(opcode, a)
    return MatrixTracer(a.program, a.program.add(opcode, (a.view,), "f", a.size), a.shape)


def cholesky(s: Any) -> Any:
    """Lower triangular L with ``L L' = S``; NaN of an S that is not positive definite."""
    small = is_small(s) and s.shape == s.shape[::-1]
    return by_scalars(unrolled.cholesky, s) if small else _of_square("cholesky", s)


semidefinite_cholesky: Any = partial(_of_square, "semidefinite_cholesky")
"""Lower triangular L with ``L L' = S`` of a positive semidefinite S."""


def rotated(a: Any) -> tuple[Any, Any]:
    """``A V`` with orthogonal columns, and the rotation V: an SVD without the last division.

    Source: Hestenes (1958), Inversion of matrices by biorthogonalization; de Rijk (1989) for its
    accuracy.
    """
    return _rotated(a, True)


def _rotated(a: Any, wanted: bool) -> tuple[Any, Any]:
    program, (m, n), k = a.program, a.shape, a.shape[1] if wanted else 0
    if n == 1:
        return a, _for_every_row(program, np.ones((1, 1)))
    value = program.add("rotate", (a.view,), "f", m * n + k * n, (k,))
    rotation = np.arange(m * n, m * n + k * n).reshape(k, n)
    return MatrixTracer(program, value, (m, n)), MatrixTracer(program, value, rotation)


def orthogonal(a: Any) -> Any:
    """``A V`` alone."""
    return _rotated(a, False)[0]


__all__ = [
    "cholesky",
    "congruence",
    "joined",
    "orthogonal",
    "rotated",
    "semidefinite_cholesky",
    "solve_definite",
    "solve_lower",
    "solve_upper",
    "symmetrise",
]
FUNCTIONS |= {
    np.matmul: _matmul,
    np.matvec: _matvec,
    np.vecmat: lambda x, a: _matvec(a.mT if a.ndim == 2 else a, x),
}
