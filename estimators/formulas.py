"""Formulas of small matrices: written once, in NumPy, and computed by NumPy or, for many rows at once, compiled.

A formula is a function of vectors ``(..., n)`` and matrices ``(..., n, m)`` in NumPy's words. Given arrays it is
computed. Given a `Symbol` in place of each array it is noted down: each of its steps becomes a sentence ("S is C times
PC"), and one compiled function carries out the sentences of any formula: nothing is compiled anew for another filter.

There the rows of a batch lie last, some 64 side by side, so that a sentence is a few loops over neighbours, which
become vector instructions. Each row meets the same operations in the same order as it would alone, and no sums are
fused or reordered: the same bits in any batch, on any processor.
"""

import math
from collections.abc import Callable
from enum import IntEnum
from functools import partial
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin


class Verb(IntEnum):
    """What a sentence does; those from ADD to WHERE do it entry by entry.

    Kernels have these numbers compiled into them, so that this file belongs to what their cache is named after
    (`estimators.compiled`).
    """

    MATMUL = 0
    ADD = 1
    SUBTRACT = 2
    MULTIPLY = 3
    DIVIDE = 4
    MAXIMUM = 5
    MINIMUM = 6
    GREATER = 7
    SQRT = 8
    ABSOLUTE = 9
    FLOOR = 10
    ISFINITE = 11
    LOG1P = 12
    WHERE = 13
    SOLVE = 14
    CHOLESKY = 15
    ROTATE = 16
    LOOKUP = 17
    SYMMETRISE = 18


_ENTRYWISE = {getattr(np, verb.name.lower()): verb for verb in Verb if Verb.ADD <= verb < Verb.WHERE}
_ENTRYWISE |= {np.logical_and: Verb.MULTIPLY, np.bitwise_and: Verb.MULTIPLY}  # of masks
_NOTHING = {Verb.ADD: 0.0, Verb.MULTIPLY: 1.0}
"""What changes nothing."""


def is_noted(value: Any) -> bool:
    """Whether this is a `Symbol`: the formula that has it is noted, not computed."""
    return isinstance(value, Symbol)


class Symbol(NDArrayOperatorsMixin):
    """What stands for an array while a formula is noted: its shape is that of one row, and its masks are 1 and 0."""

    def __init__(
        self, program: "Program", buffer: int, shape: tuple[int, ...], start: int = 0, steps: Any = None
    ) -> None:
        self.program, self.buffer, self.shape, self.start = program, buffer, shape, start
        self.steps = steps if steps is not None else (*shape[1:], 1)[: len(shape)]

    def __bool__(self) -> bool:
        raise TypeError("a formula is noted for all rows and cannot go another way for some of them: use np.where")

    def __array_ufunc__(self, ufunc: Any, method: str, *parts: Any, **others: Any) -> "Symbol":
        if method == "__call__" and not others:
            if ufunc in _ENTRYWISE:
                return self.program.entrywise(_ENTRYWISE[ufunc], *parts)
            if ufunc in _WRITTEN:
                return _WRITTEN[ufunc](self.program, *parts)
        raise TypeError(f"a formula that is to be compiled cannot have np.{ufunc.__name__} in it, so used")

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> "Symbol":
        if function not in _WRITTEN:
            raise TypeError(f"a formula that is to be compiled cannot have np.{function.__name__} in it")
        return _WRITTEN[function](self.program, *args, **kwargs)

    def __len__(self) -> int:
        return self.shape[0]

    @property
    def size(self) -> int:
        """Entries of a row."""
        return math.prod(self.shape)

    @property
    def ndim(self) -> int:
        """Axes of a row."""
        return len(self.shape)

    @property
    def mT(self) -> "Symbol":
        """The transposed matrix."""
        return Symbol(self.program, self.buffer, self.shape[::-1], self.start, self.steps[::-1])

    def spread(self) -> "Symbol":
        """The same, with steps that stay where there is one row or column only."""
        steps = tuple(step if size > 1 else 0 for step, size in zip(self.steps, self.shape, strict=True))
        return Symbol(self.program, self.buffer, self.shape, self.start, steps)

    def diagonal(self, offset: int = 0, axis1: int = -2, axis2: int = -1) -> "Symbol":
        """The diagonal of a matrix, whose axes are the last two."""
        if (offset, axis1, axis2) != (0, -2, -1) or self.ndim != 2:
            raise TypeError("of a formula's matrices diagonal(0, -2, -1) alone can be had")
        return Symbol(self.program, self.buffer, (min(self.shape),), self.start, (sum(self.steps),))

    def sum(self, axis: int | tuple[int, int]) -> "Symbol":
        """The sum over the last axis, the one before, or both."""
        if axis not in (-1, -2, (-2, -1)):
            raise TypeError(f"a formula sums over its last axes, -1, -2 or (-2, -1), not {axis}: the batch's are first")
        matrix = self[..., None, :] if self.ndim == 1 else self
        if axis != -1:
            matrix = np.ones((1, matrix.shape[0])) @ matrix
        if axis != -2:
            matrix = matrix @ np.ones((matrix.shape[1], 1))
        if axis == -2:
            return matrix[..., 0, :]
        return matrix[..., 0] if axis == -1 and self.ndim == 2 else matrix[..., 0, 0]

    def __getitem__(self, key: Any) -> "Symbol":
        first, *named = key if isinstance(key, tuple) else (key,)
        if first is not Ellipsis:
            raise TypeError("a formula's arrays are indexed from behind, a[..., i]: the first axes are the batch's")
        keys: list[Any] = [slice(None)] * (self.ndim - sum(each is not None for each in named)) + named
        axis, start = 0, self.start
        shape: list[int] = []
        steps: list[int] = []
        for each in keys:
            if each is None:
                shape, steps = [*shape, 1], [*steps, 0]
                continue
            chosen, step = range(self.shape[axis])[each], self.steps[axis]
            axis += 1
            if isinstance(chosen, int):
                start += chosen * step
            else:
                start += chosen.start * step
                shape, steps = [*shape, len(chosen)], [*steps, chosen.step * step]
        return Symbol(self.program, self.buffer, tuple(shape), start, tuple(steps))


class Program:
    """A formula as it was noted."""

    def __init__(self) -> None:
        self._sentences: list[tuple[int, tuple[int, int, int], tuple[Symbol, ...]]] = []
        self._sizes: list[int] = []  # of buffers, in numbers a row
        self._constants: dict[int, np.ndarray] = {}  # what buffers hold that are the same for all rows
        self._loads: list[tuple[Symbol, int, int]] = []  # from which array, and its column
        self._tables: list[np.ndarray] = []
        self._said: dict[Any, Symbol] = {}
        self.ask: Callable[..., Any]  # for what no formula says, see `estimators.filter.Filter`
        self.run: Callable[..., int]

    # --- noting -----------------------------------------------------------------------------------

    def symbol(self, *shape: int) -> Symbol:
        """A new one."""
        self._sizes.append(math.prod(shape))
        return Symbol(self, len(self._sizes) - 1, shape)

    def given(self, array: int, column: int, *shape: int) -> Any:
        """What stands in an array that is given, from a column on."""
        symbol = self.symbol(*shape)
        self._loads.append((symbol, array, column))
        return symbol

    def of(self, value: Any) -> Symbol:
        """What stands for a value: itself, or an array that is the same for all rows."""
        if isinstance(value, Symbol):
            return value
        array = np.asarray(value, float)
        if array.ndim > 2:
            raise TypeError("what differs from row to row must be given")
        for buffer, known in self._constants.items():
            if known.shape == array.shape and np.array_equal(known, array):
                return Symbol(self, buffer, array.shape)
        symbol = self.symbol(*array.shape)
        self._constants[symbol.buffer] = array
        return symbol

    def entrywise(self, verb: Verb, *parts: Any) -> Symbol:
        """Entry by entry, what has one row or column being the same in all."""
        operands = [self.of(part) for part in parts]
        shape = np.broadcast_shapes(*(operand.shape for operand in operands))
        for one, other in zip(operands, operands[::-1], strict=True):
            constant = self._constants.get(one.buffer)
            if constant is not None and other.shape == shape and (constant == _NOTHING.get(verb)).all():
                return other
        rows, columns = (1,) * (2 - len(shape)) + shape
        return self.once(verb, (rows, columns, 1), shape, *(operand.spread() for operand in operands))

    def say(self, verb: int, sizes: tuple[int, int, int], out: Symbol, *parts: Symbol) -> Symbol:
        """A sentence."""
        self._sentences.append((verb, sizes, (out, *parts)))
        return out

    def once(self, verb: int, sizes: tuple[int, int, int], shape: tuple[int, ...], *parts: Symbol) -> Symbol:
        """A sentence that gives a new symbol, or the one that it gave before."""
        key = verb, shape, *((part.buffer, part.start, part.shape, part.steps) for part in parts)
        if key not in self._said:
            self._said[key] = self.say(verb, sizes, self.symbol(*shape), *parts)
        return self._said[key]

    def lookup(self, table: np.ndarray, index: Symbol) -> Symbol:
        """The matrix of a table ``(k, n, m)`` at an index, the first or last one beyond."""
        out, start = self.symbol(*table.shape[1:]), sum(each.size for each in self._tables)
        self._tables.append(table)
        where = Symbol(self, out.buffer, (), start, ())  # not a place in a buffer, but in the tables
        return self.say(Verb.LOOKUP, (*table.shape[1:], len(table)), out, self.of(index), where)

    # --- carrying out -----------------------------------------------------------------------------

    def finish(self, wanted: list[tuple[Any, int]]) -> None:
        """Make `run`, which puts what is ``wanted`` into the columns told of an array ``(B, k)``.

        Numbers are laid out so that buffers which are no longer needed give their place to later ones.
        """
        from estimators.sentences import (  # late: whoever only imports a filter need not wait for numba
            WORDS,
            carried_out,
        )

        results = [(self.of(value), column) for value, column in wanted]
        last = {part.buffer: i for i, (_, _, parts) in enumerate(self._sentences) for part in parts}
        last |= {symbol.buffer: len(self._sentences) for symbol, _ in results}
        last |= {buffer: len(self._sentences) for buffer in self._constants}  # they are put there once for all blocks
        places: dict[int, int] = {}
        free: dict[int, list[int]] = {}
        size = 0

        def placed(buffer: int) -> int:
            nonlocal size
            if buffer not in places:
                if free.get(self._sizes[buffer]):
                    places[buffer] = free[self._sizes[buffer]].pop()
                else:
                    places[buffer], size = size, size + self._sizes[buffer]
            return places[buffer]

        for buffer in (*self._constants, *(symbol.buffer for symbol, _, _ in self._loads)):
            placed(buffer)
        code = []
        for i, (verb, sizes, parts) in enumerate(self._sentences):
            words = [verb, *(_side_by_side(sizes, parts) if Verb.ADD <= verb <= Verb.WHERE else sizes)]
            for part in parts:
                table = verb == Verb.LOOKUP and part is parts[2]
                words += [part.start + (0 if table else placed(part.buffer))]
                words += [0] * (2 - part.ndim) + list(part.steps)
            code.append(words + [0] * (WORDS - len(words)))
            for buffer in {part.buffer for part in parts}:
                if last[buffer] == i:
                    free.setdefault(self._sizes[buffer], []).append(places[buffer])
        where = [places[b] + i for b, values in self._constants.items() for i in range(values.size)]
        values = [float(x) for array in self._constants.values() for x in array.flat]
        loads = [(array, column, placed(s.buffer), self._sizes[s.buffer]) for s, array, column in self._loads]
        stores = []
        for symbol, column in results:
            shape, steps = (1,) * (2 - symbol.ndim) + symbol.shape, (0,) * (2 - symbol.ndim) + symbol.steps
            stores.append((column, *shape, placed(symbol.buffer) + symbol.start, *steps))
        header = [len(code), len(where), len(loads), len(stores), size]
        told = np.array([*header, *np.ravel(code), *where, *np.ravel(loads), *np.ravel(stores)], np.int64).astype(
            np.uint64
        )
        numbers = np.concatenate([values, *(np.ravel(table) for table in self._tables)])
        self.run = partial(carried_out, told.astype(np.uint64), numbers)


def _side_by_side(sizes: tuple[int, int, int], parts: tuple[Symbol, ...]) -> tuple[int, int, int]:
    """Rows, columns, and how many entries lie side by side in every part, so that they can be done at once."""
    rows, columns, _ = sizes
    steps = [(0,) * (2 - part.ndim) + tuple(part.steps) for part in parts]
    if columns > 1 and any(step != 1 for _, step in steps):
        return sizes
    if rows == 1 or all(step == columns for step, _ in steps):
        return 1, 1, rows * columns
    return rows, 1, columns


def _matmul(program: Program, a: Any, b: Any) -> Symbol:
    a, b = program.of(a), program.of(b)
    if a.ndim != 2 or b.ndim != 2:
        raise TypeError("@ is of matrices; of a matrix and a vector there is np.matvec")
    if a.shape[1] == 0:
        return program.of(np.zeros((a.shape[0], b.shape[1])))
    return program.once(Verb.MATMUL, (a.shape[0], b.shape[1], a.shape[1]), (a.shape[0], b.shape[1]), a, b)


def _matvec(program: Program, a: Any, x: Any) -> Symbol:
    return _matmul(program, a, program.of(x)[..., None])[..., 0]


def _where(program: Program, mask: Any, a: Any, b: Any) -> Symbol:
    return program.entrywise(Verb.WHERE, mask, a, b)


def _concatenate(program: Program, parts: Any, axis: int = 0) -> Symbol:
    """Side by side."""
    parts = [program.of(part) for part in parts]
    axis = axis % parts[0].ndim
    shape = list(parts[0].shape)
    shape[axis] = sum(part.shape[axis] for part in parts)
    whole, first = program.symbol(*shape), 0
    for part in parts:
        own = slice(first, first + part.shape[axis])
        first = own.stop
        rows, columns = (1,) * (2 - part.ndim) + part.shape
        place = whole[(..., own, *(slice(None),) * (whole.ndim - 1 - axis))]
        program.say(Verb.ADD, (rows, columns, 1), place, part, program.of(0.0))
    return whole


def _solve(program: Program, s: Any, b: Any) -> Symbol:
    """``S^-1 B`` of a symmetric positive definite S, as all are that filters solve for."""
    s, b = program.of(s), program.of(b)
    n, k = b.shape
    return program.say(Verb.SOLVE, (n, k, 0), program.symbol(n, k), s, b, program.symbol(n, n))


_WRITTEN: dict[Any, Callable[..., Symbol]] = {
    np.matmul: _matmul,
    np.matvec: _matvec,
    np.vecmat: lambda program, x, a: _matvec(program, program.of(a).mT, x),
    np.where: _where,
    np.concatenate: _concatenate,
    np.linalg.solve: _solve,
    np.negative: lambda program, a: program.entrywise(Verb.SUBTRACT, 0.0, a),
    np.square: lambda program, a: program.entrywise(Verb.MULTIPLY, a, a),
    np.remainder: lambda program, a, b: a - b * np.floor(a / b),
    np.less: lambda program, a, b: program.entrywise(Verb.GREATER, b, a),
    np.logical_not: lambda program, a: program.entrywise(Verb.SUBTRACT, 1.0, a),
    np.invert: lambda program, a: program.entrywise(Verb.SUBTRACT, 1.0, a),
}


def symmetric(a: Any) -> Any:
    """``(A + A') / 2``."""
    return a.program.once(Verb.SYMMETRISE, (len(a), len(a), 0), a.shape, a)


def root_of(s: Any) -> Any:
    """Lower triangular L with ``L L' = S``, positive semidefinite; see `estimators.linalg.semidefinite_cholesky`."""
    n = s.shape[0]
    return s.program.say(Verb.CHOLESKY, (n, n, 0), s.program.symbol(n, n), s)


def rotated(a: Any) -> tuple[Any, Any]:
    """``A V`` with orthogonal columns, and the rotation V: the singular value decomposition but for dividing.

    Source: Hestenes (1958), Inversion of matrices by biorthogonalization; de Rijk (1989) for its accuracy.
    """
    program, (m, n) = a.program, a.shape
    if n == 1:
        return a, program.of(np.ones((1, 1)))
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
