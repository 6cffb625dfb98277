"""Linear algebra of traced matrices: products, factorisations, solutions, each an instruction."""

from functools import partial
from operator import attrgetter
from typing import Any

import numpy as np

from estimators.engine.matrices import FUNCTIONS, MatrixTracer, matrix, shapes
from estimators.engine.program import NotTraceable, Program
from estimators.engine.tracer import program_of


def _matrices(*operands: Any) -> tuple[Program, Any, Any]:
    """The program of two operands, and them as matrices."""
    program = program_of(operands)
    return program, *map(partial(matrix, program), operands)


def _check(word: str, fit: bool, *operands: Any) -> None:
    if not fit or {*map(attrgetter("ndim", "kind"), operands)} != {(2, "f")}:
        raise ValueError(f"{shapes(operands)} have no {word} in a traced formula")


def _for_every_row(program: Program, values: np.ndarray) -> MatrixTracer:
    """A matrix that is the same for all rows, but has the batch's axes."""
    return MatrixTracer(program, program.table(values), values.shape)


def _matmul(a: Any, b: Any) -> Any:
    program, a, b = _matrices(a, b)
    if (a.ndim, b.ndim) != (2, 2) or a.kind == b.kind == "b":
        raise NotTraceable(
            "@ in a traced formula is of matrices of numbers; of a matrix and a vector there is"
            " np.matvec"
        )
    if a.shape[1] != b.shape[0]:
        raise ValueError(f"{shapes((a, b))} have no product in a traced formula")
    rows, columns = a.shape[0], b.shape[1]
    if a.shape[1] == 0:
        return _for_every_row(program, np.zeros((rows, columns)))
    value = program.add("matmul", (a.view, b.view), "f", rows * columns)
    return MatrixTracer(program, value, (rows, columns))


def _matvec(a: Any, x: Any) -> Any:
    return _matmul(a, x[..., None])[..., 0]


def inner(a: Any, b: Any) -> Any:
    """``A B'`` of ``(i, N)`` and ``(j, N)``; an entry is eight partial sums, halves added."""
    program, a, b = _matrices(a, b)
    _check("inner products", a.shape[-1] == b.shape[-1], a, b)
    symmetric = a.view == b.view
    value = program.add("inner", (a.view, b.view), "f", a.shape[0] * b.shape[0], (symmetric,))
    return MatrixTracer(program, value, (a.shape[0], b.shape[0]))


def _solved(opcode: str, s: Any, b: Any) -> Any:
    program, s, b = _matrices(s, b)
    _check("solution (of a vector b: b[..., None])", s.shape[0] == s.shape[-1] == b.shape[0], s, b)
    value = program.add(opcode, (s.view, b.view), "f", b.size + s.size)  # factors stand behind it
    return MatrixTracer(program, value, b.shape)


solve_definite: Any = partial(_solved, "solve")
"""``S^-1 B`` of a symmetric positive definite S; NaN of any other."""
solve_lower: Any = partial(_solved, "solve_lower")
"""``L^-1 B`` of a lower triangular L."""
solve_upper: Any = partial(_solved, "solve_upper")
"""``U^-1 B`` of an upper triangular U."""


def _of_square(opcode: str, a: Any) -> MatrixTracer:
    _check(opcode, a.shape[0] == a.shape[-1], a)
    return MatrixTracer(a.program, a.program.add(opcode, (a.view,), "f", a.size), a.shape)


semidefinite_cholesky: Any = partial(_of_square, "semidefinite_cholesky")
"""Lower triangular L with ``L L' = S`` of a positive semidefinite S."""
cholesky: Any = partial(_of_square, "cholesky")
"""Lower triangular L with ``L L' = S``; NaN of an S that is not positive definite."""


def rotated(a: Any) -> tuple[Any, Any]:
    """``A V`` with orthogonal columns, and the rotation V: an SVD but for dividing.

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


FUNCTIONS |= {
    np.matmul: _matmul,
    np.matvec: _matvec,
    np.vecmat: lambda x, a: _matvec(a.mT if a.ndim == 2 else a, x),
}
