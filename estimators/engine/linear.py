"""Linear algebra of traced matrices: products, factorisations and solutions, each an instruction."""

from functools import partial
from typing import Any

import numpy as np

from estimators.engine.matrices import (
    FUNCTIONS,
    MatrixTracer,
    is_mask,
    matrix,
    program_of,
    refuse_masks,
    shapes,
)
from estimators.engine.program import Program
from estimators.engine.tracer import NotTraceable


def _check_matrices(word: str, *operands: Any) -> None:
    if any(operand.ndim != 2 for operand in operands):
        raise NotTraceable(f"{word} in a traced formula is of matrices, not of {shapes(operands)}")
    refuse_masks(word, *operands)


def _check_square(word: str, a: Any) -> int:
    _check_matrices(word, a)
    if a.shape[0] != a.shape[1]:
        raise ValueError(
            f"{word} in a traced formula is of square matrices, not of shape {a.shape} a row"
        )
    return int(a.shape[0])


def _for_every_row(program: Program, values: np.ndarray) -> MatrixTracer:
    """A matrix that is the same for all rows, but has the batch's axes."""
    return MatrixTracer(program, program.table(values), values.shape)


def _matmul(a: Any, b: Any) -> Any:
    if a.ndim != 2 or b.ndim != 2:
        raise NotTraceable("@ is of matrices; of a matrix and a vector there is np.matvec")
    if is_mask(a) and is_mask(b):
        refuse_masks("@", a)
    if a.shape[1] != b.shape[0]:
        raise ValueError(
            f"{shapes((a, b))} have no product in a traced formula: the inner sizes differ"
        )
    program = program_of(a, b)
    if a.shape[1] == 0:
        return _for_every_row(program, np.zeros((a.shape[0], b.shape[1])))
    rows, columns = a.shape[0], b.shape[1]
    room = b.size if b.view.steps[1] != 1 and columns > 1 else 0
    value = program.add("matmul", (a.view, b.view), "f", rows * columns, (_picks(a, b), room))
    return MatrixTracer(program, value, (rows, columns))


def _picks(a: MatrixTracer, b: MatrixTracer) -> tuple[int, ...] | None:
    """The column of the only entry of each row of a constant matrix, -1 where there is none; None: of any other."""
    if (
        a.constant is None
        or b.shape[1] < _MANY
        or a.shape[0] > _MANY
        or b.value in b.program.tables
    ):
        return None
    entries = a.program.tables[a.value][a.places] != 0.0
    return (
        tuple(np.where(entries.any(-1), entries.argmax(-1), -1).tolist())
        if entries.sum(-1).max() == 1
        else None
    )


_MANY = 64
"""Columns of a product from which on it is worth looking at zeros of a constant factor, and rows up to which."""


def _matvec(a: Any, x: Any) -> Any:
    if (a.ndim, x.ndim) != (2, 1):
        raise NotTraceable(
            "np.matvec and np.vecmat in a traced formula are of a matrix and a vector, not"
            f" {shapes((a, x))}"
        )
    return _matmul(a, x[..., None])[..., 0]


def inner(a: Any, b: Any) -> Any:
    """``A B'`` of ``(i, N)`` and ``(j, N)``, each entry summed in eight partial sums, halves added."""
    program = program_of(a, b)
    a, b = matrix(program, a), matrix(program, b)
    _check_matrices("inner", a, b)
    if a.shape[1] != b.shape[1]:
        raise ValueError(f"{shapes((a, b))} have no inner products in a traced formula")
    symmetric = a.view == b.view
    value = program.add("inner", (a.view, b.view), "f", a.shape[0] * b.shape[0], (symmetric,))
    return MatrixTracer(program, value, (a.shape[0], b.shape[0]))


def _solved(opcode: str, room: int, s: Any, b: Any) -> Any:
    program = program_of(s, b)
    s, b = matrix(program, s), matrix(program, b)
    _check_matrices("solve (of a vector b: b[..., None])", s, b)
    if not s.shape[0] == s.shape[1] == b.shape[0]:
        raise ValueError(f"{shapes((s, b))} are no equations to solve in a traced formula")
    value = program.add(opcode, (s.view, b.view), "f", b.size, (room * s.size,))
    return MatrixTracer(program, value, b.shape)


solve_definite: Any = partial(_solved, "solve", 1)
"""``S^-1 B`` of a symmetric positive definite S; NaN of any other."""
solve_general: Any = partial(_solved, "eliminate", 1)
"""``S^-1 B`` by elimination with partial pivoting; NaN of a singular S."""
solve_lower: Any = partial(_solved, "solve lower", 0)
"""``L^-1 B`` of a lower triangular L."""
solve_upper: Any = partial(_solved, "solve upper", 0)
"""``U^-1 B`` of an upper triangular U."""


def _of_square(opcode: str, a: Any) -> MatrixTracer:
    n = _check_square(opcode, a)
    return MatrixTracer(a.program, a.program.add(opcode, (a.view,), "f", n * n), a.shape)


symmetrise: Any = partial(_of_square, "symmetrise")
"""``(A + A') / 2``."""
semidefinite_cholesky: Any = partial(_of_square, "semidefinite cholesky")
"""Lower triangular L with ``L L' = S``, positive semidefinite; see `estimators.linalg.semidefinite_cholesky`."""
cholesky: Any = partial(_of_square, "cholesky")
"""Lower triangular L with ``L L' = S``; NaN of an S that is not positive definite."""


def rotated(a: Any) -> tuple[Any, Any]:
    """``A V`` with orthogonal columns, and the rotation V: the singular value decomposition but for dividing.

    Source: Hestenes (1958), Inversion of matrices by biorthogonalization; de Rijk (1989) for its
    accuracy.
    """
    return _rotated(a, True)


def _rotated(a: Any, wanted: bool) -> tuple[Any, Any]:
    _check_matrices("singular", a)
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
    np.linalg.solve: solve_general,
}
