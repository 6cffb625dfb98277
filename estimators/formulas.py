"""Formulas of small matrices: written once, in NumPy, and computed by NumPy or, for many rows at once, compiled.

A formula is a function of vectors ``(..., n)`` and matrices ``(..., n, m)`` in NumPy's words. Given arrays it is
computed. Given a `Symbol` in place of each array it is noted down: each of its steps becomes a sentence ("S is C times
PC"), and one compiled function carries out the sentences of any formula: nothing is compiled anew for another filter.
A word means what it means in NumPy for arrays with any leading axes. Everything else is refused while it is noted: a
shape that does not fit, a mask where numbers belong, a function without a sentence of its own.

There the rows of a batch lie last, some 64 side by side, so that a sentence is a few loops over neighbours, which
become vector instructions. Each row meets the same operations in the same order as it would alone, and no sums are
fused or reordered: the same bits in any batch, on any processor.
"""

import math
from collections.abc import Callable, Sequence
from enum import IntEnum
from functools import partial
from typing import Any, NoReturn

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from estimators.checks import numbers, shown


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
    REMAINDER = 13
    WHERE = 14
    SOLVE = 15
    CHOLESKY = 16
    ROTATE = 17
    LOOKUP = 18
    SYMMETRISE = 19
    ELIMINATE = 20


_ENTRYWISE = {getattr(np, verb.name.lower()): verb for verb in Verb if Verb.ADD <= verb < Verb.WHERE}
_ENTRYWISE |= {np.logical_and: Verb.MULTIPLY, np.bitwise_and: Verb.MULTIPLY}
_OF_MASKS = (np.logical_and, np.bitwise_and, np.logical_not, np.invert)
FUNCTIONS: dict[Any, Callable[..., "Symbol"]] = {}
"""NumPy's functions that are more than one sentence entry by entry; `estimators.operations` fills it."""
_NEUTRAL = {Verb.ADD: np.float64(-0.0), Verb.MULTIPLY: np.float64(1.0)}
"""Identity elements of the operations: 0.0 is none, for -0.0 + 0.0 is 0.0."""


def is_noted(value: Any) -> bool:
    """Whether this is a `Symbol`: the formula that has it is noted, not computed."""
    return isinstance(value, Symbol)


class Symbol(NDArrayOperatorsMixin):
    """What stands for an array while a formula is noted: its masks are 1 and 0.

    ``shape``, ``ndim`` and ``size`` are those of one row: ``shape[-1]`` means what it means in NumPy, ``shape[0]`` not.
    """

    def __init__(
        self, program: "Program", buffer: int, shape: tuple[int, ...], start: int = 0, steps: Any = None,
        mask: bool = False, constant: np.dtype | None = None,
    ) -> None:  # fmt: skip
        if len(shape) > 2:
            raise TypeError(f"a formula's arrays are numbers, vectors and matrices a row, not of shape {shape}")
        self.program, self.buffer, self.shape, self.start, self.mask = program, buffer, shape, start, mask
        self.constant = constant  # the type of an array that has no axes of a batch
        self.steps = steps if steps is not None else (*shape[1:], 1)[: len(shape)]

    def __bool__(self) -> bool:
        raise TypeError("a formula is noted for all rows and cannot go another way for some of them: use np.where")

    def __array__(self, *_: Any, **__: Any) -> NoReturn:
        raise TypeError("a formula that is to be compiled cannot make a NumPy array of its own: use joined or np.where")

    def __setitem__(self, key: Any, value: Any) -> NoReturn:
        raise TypeError("a formula that is to be compiled cannot change an array in place: use joined or np.where")

    def __getattr__(self, name: str) -> NoReturn:
        raise AttributeError(f"a formula that is to be compiled cannot have .{name} in it")

    def __array_ufunc__(self, ufunc: Any, method: str, *parts: Any, **others: Any) -> "Symbol":
        if method != "__call__" or others or not (ufunc in _ENTRYWISE or ufunc in FUNCTIONS):
            raise TypeError(f"a formula that is to be compiled cannot have np.{ufunc.__name__} in it, so used")
        operands = [self.program.of(part) for part in parts]
        masks = all(operand.mask for operand in operands)
        if ufunc in _OF_MASKS and not masks:
            raise TypeError(f"np.{ufunc.__name__} in a formula is of masks, such as x > 0.0, not of numbers")
        if masks and ufunc not in (*_OF_MASKS, np.multiply):
            raise TypeError(f"np.{ufunc.__name__} in a formula is of numbers: of a mask they are 1.0 * mask")
        check_precision(operands)
        if ufunc in FUNCTIONS:
            return FUNCTIONS[ufunc](self.program, *operands)
        return self.program.entrywise(_ENTRYWISE[ufunc], *operands)

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> "Symbol":
        if function not in FUNCTIONS:
            raise TypeError(f"a formula that is to be compiled cannot have np.{function.__name__} in it")
        return FUNCTIONS[function](self.program, *args, **kwargs)

    @property
    def size(self) -> int:
        """Entries of a row."""
        return math.prod(self.shape)

    @property
    def ndim(self) -> int:
        """Axes of a row."""
        return len(self.shape)

    @property
    def dtype(self) -> np.dtype:
        """The type of a mask or of numbers."""
        return np.dtype(bool if self.mask else float)

    @property
    def mT(self) -> "Symbol":
        """The transposed matrix."""
        if self.ndim != 2:
            raise ValueError(f"a formula transposes matrices, not what has shape {self.shape} a row")
        return self._view(self.shape[::-1], self.start, self.steps[::-1])

    def _view(self, shape: tuple[int, ...], start: int, steps: Any) -> "Symbol":
        return Symbol(self.program, self.buffer, shape, start, steps, self.mask)

    def as_type(self, mask: bool) -> "Symbol":
        """The same entries as a mask, or as numbers."""
        if mask == self.mask:
            return self
        return Symbol(self.program, self.buffer, self.shape, self.start, self.steps, mask)

    def spread(self) -> "Symbol":
        """The same, with steps that stay where there is one row or column only."""
        if 1 not in self.shape:
            return self
        steps = tuple(step if size > 1 else 0 for step, size in zip(self.steps, self.shape, strict=True))
        return self._view(self.shape, self.start, steps)

    def diagonal(self, offset: int = 0, axis1: int = 0, axis2: int = 1) -> "Symbol":
        """The diagonal of a matrix, whose axes are the last two."""
        if (offset, axis1, axis2) != (0, -2, -1) or self.ndim != 2:
            raise TypeError("of a formula's matrices diagonal(0, -2, -1) alone can be had")
        return self._view((min(self.shape),), self.start, (sum(self.steps),))

    def sum(self, axis: int | tuple[int, int] | None = None, **others: Any) -> "Symbol":
        """The sum over the last axis, the one before, or both."""
        counted = len(axis) if isinstance(axis, tuple) else -axis if isinstance(axis, int | np.integer) else 3
        if others or axis not in (-1, -2, (-2, -1)) or counted > self.ndim:
            raise TypeError(
                f"a formula sums over its last axes, -1, -2 or (-2, -1), and without options: not over {shown(axis)} "
                f"of shape {self.shape} a row, for the batch's axes are first"
            )
        if self.mask:
            raise TypeError("a formula sums numbers: of a mask they are 1.0 * mask")
        matrix: Any = self[..., None, :] if self.ndim == 1 else self
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
        kinds = slice, int, np.integer
        if any(each is not None and (isinstance(each, bool) or not isinstance(each, kinds)) for each in named):
            raise TypeError("a formula's arrays are indexed by whole numbers, slices and None: use joined or np.where")
        free = self.ndim - sum(each is not None for each in named)
        if free < 0:
            raise IndexError(f"a[..., {', '.join(map(str, named))}] of shape {self.shape} a row has too many indices")
        axis, start = 0, self.start
        shape: list[int] = []
        steps: list[int] = []
        each: Any
        for each in [slice(None)] * free + named:
            if each is None:
                shape, steps = [*shape, 1], [*steps, 0]
                continue
            size, step = self.shape[axis], self.steps[axis]
            if not isinstance(each, slice) and not -size <= each < size:
                raise IndexError(f"index {each} is out of bounds for an axis of {size} in a formula")
            chosen = range(size)[each]
            axis += 1
            if isinstance(chosen, int):
                start += chosen * step
            else:
                start += chosen.start * step
                shape, steps = [*shape, len(chosen)], [*steps, chosen.step * step]
        return self._view(tuple(shape), start, tuple(steps))


class Program:
    """A formula as it was noted."""

    def __init__(self) -> None:
        self._sentences: list[tuple[int, tuple[int, int, int], tuple[Symbol, ...]]] = []
        self._sizes: list[int] = []  # of buffers, in numbers a row
        self._constants: dict[int, np.ndarray] = {}  # what buffers hold that are the same for all rows
        self._buffers: dict[tuple[tuple[int, ...], bytes], int] = {}  # of constants
        self._loads: list[tuple[Symbol, int, int]] = []  # from which array, and its column
        self._tables: list[np.ndarray] = []
        self._said: dict[Any, Symbol] = {}
        self.ask: Callable[..., Any]  # for what no formula says, see `estimators.filter.Filter`
        self.run: Callable[..., int]

    # --- noting -----------------------------------------------------------------------------------

    def symbol(self, *shape: int, mask: bool = False) -> Symbol:
        """A new one."""
        self._sizes.append(math.prod(shape))
        return Symbol(self, len(self._sizes) - 1, shape, mask=mask)

    def given(self, array: int, column: int, *shape: int, mask: bool = False) -> Any:
        """What stands in an array that is given, from a column on; array number 3 is a mask."""
        symbol = self.symbol(*shape, mask=mask or array == 3)
        self._loads.append((symbol, array, column))
        return symbol

    def of(self, value: Any) -> Symbol:
        """What stands for a value: itself, or an array that is the same for all rows."""
        if isinstance(value, Symbol):
            return value
        array = None if isinstance(value, np.ndarray) and type(value) is not np.ndarray else numbers(value)
        if array is None:
            raise TypeError(f"a formula is of real numbers and masks, got {shown(value)}")
        if array.ndim > 2:
            raise TypeError("what differs from row to row must be given")
        key = array.shape, array.tobytes()
        if key not in self._buffers:
            self._buffers[key] = self.symbol(*array.shape).buffer
            self._constants[self._buffers[key]] = np.array(array)
        kind = np.asarray(value).dtype
        return Symbol(self, self._buffers[key], array.shape, mask=kind.kind == "b", constant=kind)

    def entrywise(self, verb: Verb, *parts: Any) -> Symbol:
        """Entry by entry, what has one row or column being the same in all."""
        operands = [self.of(part) for part in parts]
        values = operands[verb == Verb.WHERE :]
        axes = {len(operand.shape) for operand in operands if operand.constant is None}
        if len(axes) > 1 or any(len(operand.shape) > min(axes, default=2) for operand in operands):
            raise ValueError(f"{shapes(operands)} have axes of other number in a formula: add some by a[..., None]")
        shape = operands[0].shape
        if any(operand.shape != shape for operand in operands):
            try:
                shape = np.broadcast_shapes(*(operand.shape for operand in operands))
            except ValueError:
                raise ValueError(f"{shapes(operands)} do not fit together in a formula") from None
        mask = verb in (Verb.GREATER, Verb.ISFINITE) or all(value.mask for value in values)
        if (neutral := _NEUTRAL.get(verb)) is not None:
            for one, other in zip(operands, operands[::-1], strict=True):
                constant = self._constants.get(one.buffer)
                if constant is not None and other.shape == shape and constant.tobytes() == neutral.tobytes() * one.size:
                    return other.as_type(mask)
        rows, columns = (1,) * (2 - len(shape)) + shape
        spread = (operand.spread() for operand in operands)
        return self.once(verb, (rows, columns, 1), shape, *spread).as_type(mask)

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


def shapes(operands: Sequence[Symbol]) -> str:
    """Shapes of operands, for a sentence."""
    return f"arrays of shapes {' and '.join(str(operand.shape) for operand in operands)} a row"


def check_precision(operands: Sequence[Symbol]) -> None:
    """Refuse constants that are not float64 beside masks alone: NumPy computes with whole numbers or few digits."""
    if all(operand.mask or operand.constant is not None for operand in operands):
        for operand in operands:
            if operand.constant not in (None, bool, np.float64):
                raise TypeError(
                    f"beside a mask a formula has float64 (1.0 for 1), not a constant of {operand.constant}"
                )
