"""Tracers of vectors and matrices, whose operations are single instructions however large they are.

Filters' equations are NumPy functions of vectors ``(..., n)`` and matrices ``(..., n, m)``. Traced,
each function means the same as in NumPy for arrays with any leading axes. Tracing refuses
everything else: a shape that does not fit, a mask in place of numbers, a function without an
instruction.
"""

import math
from collections.abc import Callable, Sequence
from functools import cache, partial
from operator import attrgetter
from typing import Any, NoReturn

import numpy as np

from estimators.engine.arrays import SCALAR_FUNCTIONS, TracedArray, each_entry, entries
from estimators.engine.program import NotTraceable, Program, View
from estimators.engine.tracer import OPERATORS, UNARY, Tracer, cast, constant, program_of

_FEW = 10  # rows or columns of a matrix up to which its operations are unrolled
_INDICES = {slice, int, np.int64, type(None)}
_Operators: Any = object  # which are set below, and unknown to a checker of types


class MatrixTracer(_Operators):
    """A vector or matrix of each row; entries of a mask are 1 and 0.

    ``shape``, ``ndim`` and ``size`` are those of one row. So ``shape[-1]`` is the same as in NumPy,
    but ``shape[0]`` is not.
    """

    __array_priority__ = 3000.0

    def __init__(self, program: Program, value: int, places: Any, kind: str = "f") -> None:
        """A new tracer.

        Args:
            program: Its program.
            value: Its value, or the value that contains it.
            places: Indices ``(n,)`` or ``(n, m)`` of its entries in the value; or a shape for all
                entries in order.
            kind: "b" for a mask.
        """
        if isinstance(places, tuple):
            places = np.arange(math.prod(places)).reshape(places)
        self.program, self.value, self.places, self.kind = program, value, places, kind
        self.shape, self.ndim, self.size = places.shape, places.ndim, places.size
        if not 1 <= self.ndim <= 2:
            raise NotTraceable(
                "a traced formula's arrays are numbers, vectors and matrices a row, not of shape"
                f" {self.shape}"
            )

    def __bool__(self) -> bool:
        raise NotTraceable(
            "a formula is traced for all rows and cannot branch for some of them: use np.where"
        )

    def __array__(self, *_: Any, **__: Any) -> NoReturn:
        raise NotTraceable(
            "a traced formula cannot make a NumPy array of its own: use joined or np.where"
        )

    def __array_ufunc__(self, ufunc: Any, method: str, *operands: Any, **others: Any) -> Any:
        if method != "__call__" or others:
            raise NotTraceable(f"a traced formula cannot have np.{ufunc.__name__} in it, so used")
        if ufunc in FUNCTIONS:
            return FUNCTIONS[ufunc](*operands)
        return entrywise(ufunc, *operands)

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        if function not in FUNCTIONS:
            raise NotTraceable(
                f"a traced formula cannot have np.{function.__name__} in it: estimators.linalg has"
                " solve, cholesky and others that it can"
            )
        return FUNCTIONS[function](*args, **kwargs)

    @property
    def view(self) -> View:
        """Places of its entries, as those of a matrix; steps are 0 over one row or column."""
        places = self.places if self.ndim == 2 else self.places[None]
        down, right = places.strides
        steps = down // 8 if len(places) > 1 else 0, right // 8 if places.shape[1] > 1 else 0
        return View(self.value, places.shape, int(places[0, 0]) if self.size else 0, steps)

    @property
    def mT(self) -> "MatrixTracer":
        """The transposed matrix."""
        return self._part(self.places.mT)

    def _part(self, places: Any) -> Any:
        """Entries at some places; at one, a number."""
        if getattr(places, "ndim", 0):
            return MatrixTracer(self.program, self.value, places, self.kind)
        return Tracer(self.program, self.program.entry(self.value, int(places), self.kind))

    def part(self, start: int, shape: tuple[int, ...]) -> Any:
        """Neighbouring entries of a vector, in another shape."""
        return self._part(self.places[start : start + math.prod(shape)].reshape(shape))

    def scalars(self) -> TracedArray:
        """Its entries, one by one."""
        return np.frompyfunc(self._part, 1, 1)(self.places).view(TracedArray)

    def diagonal(self, *axes: int) -> "MatrixTracer":
        """The diagonal of a matrix, whose axes are the last two."""
        if axes != (0, -2, -1):
            raise NotTraceable("a traced formula's matrices have diagonal(0, -2, -1) alone")
        return self._part(self.places.diagonal())

    def sum(self, axis: int | tuple[int, int] | None = None) -> Any:
        """The sum over the last axis, the one before, or both."""
        if axis not in (-1, -2, (-2, -1)) or (self.ndim == 1 and axis != -1):
            raise NotTraceable("a traced formula sums over its last axes, -1, -2 or (-2, -1)")
        whole: Any = self[..., None, :] if self.ndim == 1 else self
        if axis != -1:
            whole = (np.zeros((1, whole.shape[0])) + 1.0) @ whole
        if axis == -2:
            return whole[..., 0, :]
        total = (whole @ (np.zeros((whole.shape[1], 1)) + 1.0))[..., 0]
        return total if axis == -1 and self.ndim == 2 else total[..., 0]

    def __getitem__(self, key: Any) -> Any:
        first, *named = key if isinstance(key, tuple) else (key,)
        if first is not Ellipsis or not {*map(type, named)} <= _INDICES:
            raise NotTraceable(
                "a traced formula's arrays are indexed from behind, by a[..., i] with whole"
                " numbers, slices and None"
            )
        return self._part(self.places[key])


def _operator(name: str, swapped: bool = False) -> Callable[..., Any]:
    ufunc = getattr(np, name)
    return lambda self, *other: ufunc(*other, self) if swapped else ufunc(self, *other)


for _name, _opcode in (OPERATORS | {"matmul": "matmul"}).items():
    setattr(MatrixTracer, f"__{_name}__", _operator(_opcode))
    setattr(MatrixTracer, f"__r{_name}__", _operator(_opcode, True))
for _name, _opcode in UNARY.items():
    setattr(MatrixTracer, f"__{_name}__", _operator(_opcode))
TracedArray.stronger.add(MatrixTracer)


def matrix(program: Program, value: Any) -> Any:
    """Tracer of a vector or matrix: a tracer as it is, packed scalars, or an array for all rows."""
    if isinstance(value, MatrixTracer | Tracer):
        return value
    array = np.asarray(value)
    if array.ndim == 0:
        return constant(program, array)
    if not isinstance(value, TracedArray):
        kind = "b" if array.dtype.kind == "b" else "f"
        return MatrixTracer(program, program.table(array), array.shape, kind)
    scalars = entries(value, program)
    kind = "b" if {*map(_kind, scalars)} == {"b"} else "f"
    return MatrixTracer(program, program.pack((*map(_value, scalars),)), value.shape, kind)


_kind, _value = attrgetter("kind"), attrgetter("value")


def is_small(*operands: Any) -> bool:
    """Are operations of these unrolled? They are of matrices with few rows and columns."""
    return all(max(operand.shape, default=1) <= _FEW for operand in operands)


def by_scalars(function: Callable[..., Any], *operands: Any) -> Any:
    """The matrix that a function of arrays of scalars returns for matrices."""
    scalars = (TracedArray.of(getattr(each, "scalars", lambda x=each: x)()) for each in operands)
    return matrix(program_of(operands), TracedArray.of(function(*scalars)))


def matrix_input(program: Program, argument: int, shape: tuple[int, ...], kind: str) -> Any:
    """An argument as a vector or matrix; without axes, a number."""
    if not shape:
        return Tracer(program, program.add("input", (), kind, None, (argument, 0)))
    value = program.add("input_matrix", (), "f", math.prod(shape), (argument,))
    return MatrixTracer(program, value, shape, kind)


def columnwise(function: Any, *operands: Any) -> MatrixTracer:
    """Results ``(k, N)`` of a function of vectors ``(n,)`` for each column of matrices ``(n, N)``.

    Args:
        function: Traced entry by entry.
        operands: Matrices, whose columns it gets; vectors ``(m,)`` and None are passed as they are.
    """
    program = program_of(operands)
    given: list[Any] = [
        each if each is None or isinstance(each, TracedArray) else matrix(program, each)
        for each in operands
    ]
    views: list[View] = [each.view for each in given if each is not None and each.ndim == 2]
    vectors = [
        each.scalars() if isinstance(each, MatrixTracer) and each.ndim == 1 else each
        for each in given
    ]

    def body(*parameters: tuple[int, ...]) -> list[int]:
        columns = (
            TracedArray.of([Tracer(program, value) for value in column]) for column in parameters
        )
        arguments = [
            next(columns) if each is not None and each.ndim == 2 else vector
            for each, vector in zip(given, vectors, strict=True)
        ]
        return [cast(each, "f").value for each in entries(function(*arguments), program)]

    value, count = program.columns(views, body), views[0].shape[1]
    return MatrixTracer(program, value, (program.sizes[value] // count, count))


def along(function: Any, *rows: Any) -> tuple[Any, ...]:
    """Results ``(..., k)`` of a function of numbers for each entry of rows ``(..., k)``.

    A compiled program contains the instructions once, while it unrolls Python's own loops. For a
    single row, eight entries are computed side by side. The results have no derivative.

    Args:
        function: Function of one number or array ``(...)`` from each row. It returns a sequence of
            numbers or arrays, and may use other values that are the same for all entries.
        rows: Rows of the same length.
    """
    program = program_of(rows) if any(map(is_traced, rows)) else None
    if program is None:
        each = [function(*(row[..., i] for row in rows)) for i in range(np.shape(rows[0])[-1])]
        return tuple(np.stack(found, -1) for found in zip(*each, strict=True))
    columns = matrix(program, TracedArray.of(np.stack(rows)))
    return tuple(
        columnwise(lambda column: TracedArray.of(list(function(*column))), columns).scalars()
    )


def split(row: MatrixTracer, count: int) -> MatrixTracer:
    """Entries, row by row, as ``count`` rows."""
    return MatrixTracer(row.program, row.value, (count, row.size // count))


def is_traced(value: Any) -> bool:
    """Is a value a tracer, which stands for numbers that differ from row to row?"""
    return isinstance(value, MatrixTracer | Tracer | TracedArray)


@cache
def _result_kind(name: str, kinds: str) -> Any:
    """The kind of the result of NumPy's function of that name for scalars of some kinds."""
    program = Program()
    values = map(program.new, kinds)
    return SCALAR_FUNCTIONS[name](*map(partial(Tracer, program), values)).kind


def entrywise(function: Any, *values: Any) -> Any:
    """One of NumPy's functions entry by entry; a single row or column is repeated."""
    name, program = function.__name__, program_of(values)
    if name not in SCALAR_FUNCTIONS:
        raise NotTraceable(f"a traced formula cannot have np.{name} in it")
    operands = [*map(partial(matrix, program), values)]
    kinds, views, places, axes = "", [], [], set()
    for each in operands:
        whole = isinstance(each, MatrixTracer)
        kinds += "b" if each.kind == "b" or (name == "where" and not kinds) else "f"
        views.append(each.view if whole else each.value)
        places.append(each.places if whole else 0)
        if each.value not in program.tables and each.value not in program.constants:
            axes.add(each.ndim)
    kind, shape = _result_kind(name, kinds), np.broadcast(*places).shape
    if axes - {len(shape)}:  # NumPy would take the rows of a batch for those of a matrix
        raise ValueError(f"{shapes(operands)} differ in axes: add some by a[..., None]")
    if is_small(*operands):
        return by_scalars(partial(each_entry, SCALAR_FUNCTIONS[name]), *operands)
    rows, columns = (1,) * (2 - len(shape)) + shape
    value = program.add("each", tuple(views), "f", rows * columns, (name, kinds, rows, columns))
    return MatrixTracer(program, value, shape, kind)


def shapes(operands: Sequence[Any]) -> str:
    """Shapes of operands, for a sentence."""
    return f"arrays of shapes {' and '.join(str(operand.shape) for operand in operands)} a row"


def joined(parts: Sequence[Any], axis: int) -> Any:
    """Arrays below (axis -2) or beside (axis -1) each other; constants among them are matrices."""
    parts = [*map(partial(matrix, program := program_of(parts)), parts)]
    if axis >= 0:
        raise NotTraceable("a traced formula's arrays are joined along their last axes, -1 or -2")
    shape = np.concatenate([part.places for part in parts], axis).shape
    if is_small(*parts):
        return by_scalars(lambda *scalars: np.concatenate(scalars, axis), *parts)
    step = shape[-1] if axis == -2 else 1
    sizes = np.cumsum([0, *(part.shape[axis] for part in parts[:-1])])
    places = tuple((sizes * step).tolist())
    value = program.add(
        "join", tuple(part.view for part in parts), "f", math.prod(shape), (places, shape[-1])
    )
    return MatrixTracer(program, value, shape, "b" if {*map(_kind, parts)} == {"b"} else "f")


FUNCTIONS: dict[Any, Any] = {
    np.where: partial(entrywise, np.where),
    np.concatenate: joined,
}
"""NumPy's functions of whole matrices; `estimators.engine.linear` adds linear algebra."""
