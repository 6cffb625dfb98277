"""Vectors and matrices of a row, whose operations are single instructions where they are large.

Filters' equations are NumPy functions of vectors ``(..., n)`` and matrices ``(..., n, m)``, traced
for a row without leading axes. Operations of few rows and columns are unrolled.
"""

import math
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any

import numpy as np

from estimators.engine.arrays import SCALAR_FUNCTIONS, TracedArray, entries
from estimators.engine.program import NotTraceable, Program, View
from estimators.engine.tracer import Tracer, cast, constant, known, program_of

_FEW = 10  # rows or columns of a matrix up to which its operations are unrolled
_MANY = 2000  # entries of a matrix from which its known zeros are not looked for


class TracedMatrix(TracedArray):
    """A vector or matrix of a row, whose operations are loops if it is large."""

    def __array_ufunc__(self, ufunc: Any, method: str, *operands: Any, **others: Any) -> Any:
        if method == "__call__" and ufunc in PRODUCTS:
            return PRODUCTS[ufunc](*operands)
        if method == "__call__" and not is_small(*operands):
            return _each(ufunc.__name__, *operands)
        return matrix(super().__array_ufunc__(ufunc, method, *operands, **others))

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        if function is np.where and not (is_small(*args) or is_sparse(args[1])):
            return _each("where", *args)
        if function is np.concatenate and not is_small(*args[0]):
            return _joined(*args, **kwargs)
        return matrix(super().__array_function__(function, types, args, kwargs))

    def sum(self, axis: Any = None, **others: Any) -> Any:  # type: ignore[override]
        """The sum over axes of the row."""
        if is_small(self) or axis not in (-1, -2, (-2, -1)):
            return super().sum(axis, **others)
        if self.ndim == 1:
            return self[None].sum(-1)[0]
        if axis == -1:
            return np.matvec(self, np.ones(self.shape[1]))
        over_rows: Any = np.vecmat(np.ones(self.shape[0]), self)
        return over_rows if axis == -2 else over_rows.sum(-1)


PRODUCTS: dict[Any, Callable[..., Any]] = {}
"""NumPy's products of matrices; set by `estimators.engine.linear`."""


class Entry(Tracer):
    """An entry of a matrix in memory, which is read where it is used by itself."""

    __slots__ = ("matrix", "place")

    def __init__(self, program: Program, matrix: int, kind: str, place: int) -> None:
        self.program, self.matrix, self.kind, self.place = program, matrix, kind, place

    @property
    def value(self) -> int:  # type: ignore[override]
        """Its value as a scalar."""
        place = View(self.matrix, (1, 1), self.place, (0, 0))
        return self.program.add("element", (place,), self.kind)


def matrix(value: Any) -> Any:
    """Traced arrays as matrices, those of constants as arrays, and anything else as it is."""
    if isinstance(value, tuple | list):
        return type(value)(map(matrix, value))
    if not isinstance(value, TracedArray):
        return value
    return value.view(TracedMatrix) if value.program else np.array(value.tolist())


def by_entries(value: Any) -> Any:
    """A matrix as an array whose operations are unrolled, however large it is."""
    return value.view(TracedArray) if isinstance(value, TracedMatrix) else value


def stored(program: Program, value: int, shape: tuple[int, ...], kind: str = "f") -> TracedMatrix:
    """A matrix of the entries of a value, row by row."""
    places = np.arange(math.prod(shape)).reshape(shape)
    return np.frompyfunc(partial(Entry, program, value, kind), 1, 1)(places).view(TracedMatrix)


def is_small(*operands: Any) -> bool:
    """Are operations of these unrolled? They are of matrices with few rows and columns."""
    return all(max(getattr(each, "shape", ()), default=1) <= _FEW for each in operands)


def is_sparse(value: Any) -> bool:
    """Are a third of the entries of a matrix, or more, known to be zero?"""
    size = np.size(value) if np.ndim(value) == 2 else _MANY
    return size < _MANY and 3 * sum(map(is_zero, np.asarray(value).flat)) >= size


def is_zero(x: Any) -> bool:
    """Is a number known to be 0?"""
    if isinstance(x, Entry):
        return False
    return bool((known(x) if isinstance(x, Tracer) else x) == 0.0)


def view(program: Program, array: Any) -> View:
    """Places of the entries of a matrix in memory; entries of several values are packed."""
    rows = np.atleast_2d(np.asarray(array))
    if rows.dtype != object:
        value = program.table(rows)
    else:
        flat = rows.ravel().tolist()
        if {*map(type, flat)} == {Entry} and len({each.matrix for each in flat}) == 1:
            places = np.array([each.place for each in flat])
            start, steps = int(places[0]), _steps(places, rows.shape)
            if (places == start + np.indices(rows.shape).reshape(2, -1).T @ steps).all():
                return View(flat[0].matrix, rows.shape, start, steps)
        scalars = [constant(program, each).value for each in flat]
        value = program.add("pack", tuple(scalars), "f", len(flat))
    return View(value, rows.shape, 0, _steps(np.arange(rows.size), rows.shape))


def _steps(places: np.ndarray, shape: tuple[int, ...]) -> tuple[int, int]:
    """Steps to the next row and column of a matrix; 0 over a single one."""
    rows, columns = shape
    down = int(places[columns] - places[0]) if rows > 1 else 0
    return down, int(places[1] - places[0]) if columns > 1 else 0


def loop(opcode: str, shape: tuple[int, ...], *operands: Any, attributes: Any = ()) -> TracedMatrix:
    """The result of an instruction of matrices."""
    program = program_of(operands)
    views = (*map(partial(view, program), operands),)
    value = program.add(opcode, views, "f", math.prod(shape), attributes)
    return stored(program, value, shape)


def _each(name: str, *operands: Any) -> TracedMatrix:
    """One of NumPy's functions entry by entry; a single row or column is repeated."""
    if name not in SCALAR_FUNCTIONS:
        raise NotTraceable(f"a traced function cannot have np.{name} in it")
    program, kinds, views = program_of(operands), "", list[Any]()
    for each in operands:
        masks = np.asarray(each).dtype == bool  # the entries of a constant are no constants each
        if is_traced(each):
            masks = {x.kind for x in entries(each, program)} == {"b"}
        kinds += "b" if masks or (name == "where" and not kinds) else "f"
        views.append(view(program, each) if np.ndim(each) else constant(program, each).value)
    shape = np.broadcast_shapes(*map(np.shape, operands))
    rows, columns = (1,) * (2 - len(shape)) + shape
    attributes = name, kinds, rows, columns
    value = program.add("each", tuple(views), "f", rows * columns, attributes)
    return stored(program, value, shape, _result_kind(name, kinds))


@cache
def _result_kind(name: str, kinds: str) -> Any:
    """The kind of the result of NumPy's function of that name for scalars of some kinds."""
    program = Program()
    values = map(program.new, kinds)
    return SCALAR_FUNCTIONS[name](*map(partial(Tracer, program), values)).kind


def _joined(parts: Sequence[Any], axis: int) -> TracedMatrix:
    """Matrices below (axis -2) or beside (axis -1) each other."""
    shape = np.concatenate([np.empty(part.shape) for part in parts], axis).shape
    step = shape[-1] if axis == -2 else 1
    sizes = np.cumsum([0, *(part.shape[axis] for part in parts[:-1])])
    places = tuple((sizes * step).tolist())
    return loop("join", shape, *parts, attributes=(places, shape[-1]))


def columnwise(function: Any, *operands: Any) -> TracedMatrix:
    """Results ``(k, N)`` of a function of vectors ``(n,)`` for each column of matrices ``(n, N)``.

    Args:
        function: Traced entry by entry.
        operands: Matrices, whose columns it gets; vectors ``(m,)`` and None are passed as they are.
    """
    program = program_of(operands)
    views = [view(program, each) for each in operands if np.ndim(each) == 2]

    def body(*parameters: tuple[int, ...]) -> list[int]:
        columns = (
            np.fromiter(map(partial(Tracer, program), column), object).view(TracedArray)
            for column in parameters
        )
        arguments = [next(columns) if np.ndim(x) == 2 else by_entries(x) for x in operands]
        return [cast(each, "f").value for each in entries(function(*arguments), program)]

    value, count = program.columns(views, body), views[0].shape[1]
    return stored(program, value, (program.sizes[value] // count, count))


def along(function: Any, *rows: Any) -> tuple[Any, ...]:
    """Results ``(..., k)`` of a function of numbers for each entry of rows ``(..., k)``.

    A compiled program contains the instructions once, while it unrolls Python's own loops. Of a
    single row, eight entries are computed side by side, and of four rows two. The results have no
    derivative.

    Args:
        function: Function of one number or array ``(...)`` from each row. It returns a sequence of
            numbers or arrays, and may use other values that are the same for all entries.
        rows: Rows of the same length.
    """
    if not any(map(is_traced, rows)):
        each = [function(*(row[..., i] for row in rows)) for i in range(np.shape(rows[0])[-1])]
        return tuple(np.stack(found, -1) for found in zip(*each, strict=True))
    columns = TracedArray.of(np.stack(rows))
    return tuple(
        by_entries(columnwise(lambda column: TracedArray.of(list(function(*column))), columns))
    )


def is_traced(value: Any) -> bool:
    """Is a value a tracer, which stands for numbers that differ from row to row?"""
    return isinstance(value, Tracer | TracedArray)
