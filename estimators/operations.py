"""NumPy's functions and the package's own of small matrices, as formulas have them: traced, with shapes compared."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from estimators.checks import shown
from estimators.formulas import FUNCTIONS, Program, Symbol, Verb, check_precision, shapes


def _check_matrices(word: str, *operands: Symbol) -> None:
    if any(operand.ndim != 2 for operand in operands):
        raise TypeError(f"{word} in a formula is of matrices, not of {shapes(operands)}")
    if any(operand.mask for operand in operands):
        raise TypeError(f"{word} in a formula is of numbers: of a mask they are 1.0 * mask")


def _matmul(program: Program, a: Symbol, b: Symbol) -> Symbol:
    if a.ndim != 2 or b.ndim != 2:
        raise TypeError("@ is of matrices; of a matrix and a vector there is np.matvec")
    if a.shape[1] != b.shape[0]:
        raise ValueError(f"{shapes((a, b))} have no product in a formula: the inner sizes differ")
    if a.shape[1] == 0:
        return program.of(np.zeros((a.shape[0], b.shape[1])))[...]
    return program.once(Verb.MATMUL, (a.shape[0], b.shape[1], a.shape[1]), (a.shape[0], b.shape[1]), a, b)


def _matvec(program: Program, a: Symbol, x: Symbol) -> Symbol:
    if (a.ndim, x.ndim) != (2, 1):
        raise TypeError(f"np.matvec and np.vecmat in a formula are of a matrix and a vector, not {shapes((a, x))}")
    return _matmul(program, a, x[..., None])[..., 0]


def _vecmat(program: Program, x: Symbol, a: Symbol) -> Symbol:
    return _matvec(program, a.mT if a.ndim == 2 else a, x)


def _where(program: Program, mask: Any, *choices: Any) -> Symbol:
    if len(choices) != 2 or any(choice is None for choice in choices):
        raise TypeError("np.where in a formula needs a mask and two values")
    operands = [program.of(choice) for choice in choices]
    check_precision(operands)
    return program.entrywise(Verb.WHERE, mask, *operands)


def _concatenate(program: Program, parts: Any, axis: Any = 0, **others: Any) -> Symbol:
    if others or not all(isinstance(part, Symbol) for part in parts):
        raise TypeError(
            "np.concatenate in a formula is of its arrays alone, and without options: for constants beside them there "
            "is estimators.linalg.joined"
        )
    return side_by_side(parts, axis)


def side_by_side(parts: Sequence[Any], axis: Any) -> Symbol:
    """Arrays below (axis -2) or beside (axis -1) each other; constants among them are matrices."""
    program = next(part.program for part in parts if isinstance(part, Symbol))
    constants = [np.ndim(part) for part in parts if not isinstance(part, Symbol)]
    parts = [program.of(part) for part in parts]
    shape = list(parts[0].shape)
    if any(part.ndim != len(shape) for part in parts) or any(ndim != 2 for ndim in constants):
        raise ValueError(f"{shapes(parts)} cannot be joined in a formula: they need as many axes each")
    if isinstance(axis, bool) or not isinstance(axis, int | np.integer) or not -len(shape) <= axis < 0:
        raise TypeError(f"a formula joins arrays along their last axes, -1 or -2, not {shown(axis)}: give axis=")
    for other in {-1, -2} & set(range(-len(shape), 0)) - {axis}:
        if any(part.shape[other] != shape[other] for part in parts):
            raise ValueError(f"{shapes(parts)} cannot be joined along axis {axis} in a formula")
    shape[axis] = sum(part.shape[axis] for part in parts)
    whole, first = program.symbol(*shape, mask=all(part.mask for part in parts)), 0
    for part in parts:
        own = slice(first, first + part.shape[axis])
        first = own.stop
        rows, columns = (1,) * (2 - part.ndim) + part.shape
        place = whole[(..., own, *(slice(None),) * (-1 - axis))]
        program.say(Verb.ADD, (rows, columns, 1), place, part, program.of(-0.0))
    return whole


def _solve(program: Program, s: Any, b: Any) -> Symbol:
    return _solved(Verb.ELIMINATE, program, s, b)


def solve_definite(s: Any, b: Any) -> Symbol:
    """``S^-1 B`` of a symmetric positive definite S."""
    return _solved(Verb.SOLVE, (s if isinstance(s, Symbol) else b).program, s, b)


def _solved(verb: Verb, program: Program, s: Any, b: Any) -> Symbol:
    s, b = program.of(s), program.of(b)
    check_equations(s, b)
    n, k = b.shape
    return program.say(verb, (n, k, 0), program.symbol(n, k), s, b, program.symbol(n, n))


def check_equations(s: Any, b: Any) -> None:
    """Refuse what are no equations ``S X = B``.

    Raises:
        TypeError: if S and B are no matrices of numbers.
        ValueError: if S is not square or B has another number of rows.
    """
    program = (s if isinstance(s, Symbol) else b).program
    s, b = program.of(s), program.of(b)
    _check_matrices("solve (of a vector b: b[..., None])", s, b)
    if not s.shape[0] == s.shape[1] == b.shape[0]:
        raise ValueError(f"{shapes((s, b))} are no equations to solve in a formula")


FUNCTIONS |= {
    np.matmul: _matmul,
    np.matvec: _matvec,
    np.vecmat: _vecmat,
    np.where: _where,
    np.concatenate: _concatenate,
    np.linalg.solve: _solve,
    np.negative: lambda program, a: program.entrywise(Verb.MULTIPLY, -1.0, a),
    np.square: lambda program, a: program.entrywise(Verb.MULTIPLY, a, a),
    np.less: lambda program, a, b: program.entrywise(Verb.GREATER, b, a),
    np.logical_not: lambda program, a: program.entrywise(Verb.SUBTRACT, 1.0, a).as_type(True),
    np.invert: lambda program, a: program.entrywise(Verb.SUBTRACT, 1.0, a).as_type(True),
}


def _check_square(word: str, a: Symbol) -> int:
    _check_matrices(word, a)
    if a.shape[0] != a.shape[1]:
        raise ValueError(f"{word} in a formula is of square matrices, not of shape {a.shape} a row")
    return a.shape[0]


def symmetric(a: Any) -> Any:
    """``(A + A') / 2``."""
    n = _check_square("symmetrise", a)
    return a.program.once(Verb.SYMMETRISE, (n, n, 0), a.shape, a)


def root_of(s: Any) -> Any:
    """Lower triangular L with ``L L' = S``, positive semidefinite; see `estimators.linalg.semidefinite_cholesky`."""
    n = _check_square("semidefinite_cholesky", s)
    return s.program.say(Verb.CHOLESKY, (n, n, 0), s.program.symbol(n, n), s)


def rotated(a: Any) -> tuple[Any, Any]:
    """``A V`` with orthogonal columns, and the rotation V: the singular value decomposition but for dividing.

    Source: Hestenes (1958), Inversion of matrices by biorthogonalization; de Rijk (1989) for its accuracy.
    """
    _check_matrices("singular", a)
    program, (m, n) = a.program, a.shape
    if n == 1:
        return a, program.of(np.ones((1, 1)))[...]
    turned = program.symbol(m, n)
    return turned, program.say(Verb.ROTATE, (m, n, n), program.symbol(n, n), turned, a)


def orthogonal(a: Any) -> Any:
    """``A V`` alone."""
    program, (m, n) = a.program, a.shape
    if n == 1:
        return a
    turned = program.symbol(m, n)
    program.say(Verb.ROTATE, (m, n, 0), turned, turned, a)
    return turned
