"""Arrays of tracers, which NumPy stacks, indexes and broadcasts like any objects."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from estimators.engine.program import KINDS, NotTraceable, Program
from estimators.engine.tracer import (
    OPCODES,
    Tracer,
    cast,
    constant,
    operation,
    power,
    program_of,
    where,
)


class TracedArray(np.ndarray):
    """Object array of `Tracer` and constants: one row of a batch, without the batch's axes."""

    __array_priority__ = 2000.0

    @staticmethod
    def of(value: Any) -> "TracedArray":
        """A scalar, list or array as a traced array."""
        # NumPy takes five times as long to find the array of a tracer.
        array = value.__array__() if isinstance(value, Tracer) else np.asarray(value, object)
        return array.view(TracedArray)

    def __array_ufunc__(self, ufunc: Any, method: str, *operands: Any, **others: Any) -> Any:
        """Apply one of NumPy's functions to each entry, or reduce an axis by it."""
        name, (out,) = ufunc.__name__, others.pop("out", (None,))
        if others.pop("dtype", None) not in (None, float) or others.keys() - {"axis", "keepdims"}:
            raise NotTraceable(f"a traced function cannot have np.{name} with such options in it")
        if name in ("matmul", "vecdot", "matvec", "vecmat") and method == "__call__":
            found = ufunc(*(np.asarray(_plain(each), object) for each in operands), **others)
        elif name not in SCALAR_FUNCTIONS or method not in ("__call__", "reduce", "accumulate"):
            raise NotTraceable(f"a traced function cannot have np.{name} in it, so used")
        elif method == "__call__":
            found = each_entry(SCALAR_FUNCTIONS[name], *operands)
        else:
            array = _plain(operands[0])
            if np.ndim(array) == 0:
                raise NotTraceable(
                    f"np.{name} of a number a row is over the batch: give it an axis of the row"
                )
            if ufunc is np.add:  # a sum of masks counts them
                array = each_entry(
                    lambda x: cast(x, "i") if getattr(x, "kind", "") == "b" else x, array
                ).view(np.ndarray)
            # with an identity, so that several axes can be reduced
            each = np.frompyfunc(SCALAR_FUNCTIONS[name], 2, 1, identity=ufunc.identity)
            found = getattr(each, method)(array, *operands[1:], **others)
        if out is not None:
            if not isinstance(out, TracedArray):
                raise NotTraceable(
                    "a traced function cannot write into a fresh array of floats: use np.stack or"
                    " np.where"
                )
            out[...] = found
            return out
        return _wrapped(found)

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        if (own := FUNCTIONS.get(function)) is not None:
            return own(*args, **kwargs)
        if function.__name__ not in _REARRANGING:
            raise NotTraceable(f"a traced function cannot have np.{function.__name__} in it")
        return _wrapped(
            function(*map(_plain, args), **{name: _plain(value) for name, value in kwargs.items()})
        )

    def __getitem__(self, key: Any) -> Any:
        if isinstance(key, Tracer | TracedArray):
            raise NotTraceable(
                "x[mask] has other entries in each row: use np.where, and lookup for x[index]"
            )
        return super().__getitem__(key)

    @property
    def program(self) -> Program | None:
        """The program of its entries; None if all are constants."""
        return program_of(self.flat)

    def astype(self, dtype: Any, *_: Any, **__: Any) -> Any:
        """The entries as another kind of number."""
        found = np.dtype(dtype)
        if found not in KINDS.values():
            raise NotTraceable(f"a traced function has float64, int64 and masks, not {found}")
        return each_entry(lambda x: cast(x, found.kind), self)

    def mean(self, axis: Any = None, **others: Any) -> Any:  # type: ignore[override]
        """The mean over axes of the row."""
        total = self.sum(axis, **others)
        return total / (self.size / np.size(total))


Tracer.array = TracedArray


def _plain(value: Any) -> Any:
    """An object array that calls the operations of its entries."""
    if isinstance(value, Tracer):
        value = TracedArray.of(value)
    if isinstance(value, TracedArray):
        return value.view(np.ndarray)
    return type(value)(map(_plain, value)) if isinstance(value, list | tuple) else value


def _wrapped(value: Any) -> Any:
    """A result, as an array of tracers if it contains one."""
    if isinstance(value, tuple | list):
        return type(value)(map(_wrapped, value))
    if isinstance(value, np.ndarray) and value.dtype == object:
        return value.view(TracedArray)
    return value


def each_entry(function: Callable[..., Any], *operands: Any) -> Any:
    """A function of scalars, applied to each entry."""
    found = np.frompyfunc(function, len(operands), 1)(*map(_plain, operands))
    return _wrapped(found)


SCALAR_FUNCTIONS: dict[str, Callable[..., Any]] = {
    **{opcode: partial(operation, opcode) for opcode in OPCODES},
    "where": where,
    "positive": lambda x: x,
    "square": lambda x: power(x, 2),
    "clip": lambda x, low, high: operation("minimum", operation("maximum", x, low), high),
    "power": power,
    "sign": lambda x: where(x > 0.0, 1.0, where(x < 0.0, -1.0, x + 0.0)),
    **dict.fromkeys(("deg2rad", "radians"), lambda x: x * (np.pi / 180.0)),
    **dict.fromkeys(("rad2deg", "degrees"), lambda x: x * (180.0 / np.pi)),
    "logical_and": lambda x, y: operation("bitwise_and", cast(x, "b"), cast(y, "b")),
    "logical_or": lambda x, y: operation("bitwise_or", cast(x, "b"), cast(y, "b")),
    "logical_not": lambda x: operation("invert", cast(x, "b")),
}
"""NumPy's functions entry by entry, of scalars, by their names."""


def _interpolated(x: Any, xp: Any, fp: Any) -> Any:
    """`numpy.interp` of constant tables, as NumPy computes it."""
    xp, fp = np.asarray(xp, float), np.asarray(fp, float)
    slopes = np.append(np.diff(fp) / np.diff(xp), 0.0)

    def one(x: Any) -> Any:
        x = SCALAR_FUNCTIONS["clip"](x, xp[0], xp[-1])
        index = sum(cast(x >= bound, "i") for bound in xp[1:])  # of the last entry up to x
        return lookup(slopes, index) * (x - lookup(xp, index)) + lookup(fp, index)

    return each_entry(one, x)


def lookup(table: Any, index: Any) -> Any:
    """Entry ``(...)`` or ``(..., m)`` of a table ``(k,)`` or ``(k, m)``; beyond, the nearest.

    Args:
        table: Numbers that are the same for all rows.
        index: Whole numbers, or floats, which are truncated; NaN is 0.
    """
    table = np.asarray(table, float)
    if isinstance(index, TracedArray):
        found = TracedArray.of([lookup(table, each) for each in index.flat])
        return found.reshape(index.shape + table.shape[1:])
    if not isinstance(index, Tracer):
        within = np.fmin(np.fmax(index, 0), len(table) - 1)
        return table.take(within.astype(np.intp), axis=0)
    program, width = index.program, table[0].size
    place, row = program.table(table), index if index.kind == "f" else cast(index, "i")

    def entry(column: int) -> Tracer:
        attributes = place, len(table), width, column
        return Tracer(program, program.add("lookup", (row.value,), "f", None, attributes))

    return each_entry(entry, np.arange(width).reshape(table.shape[1:]))


def _full(a: Any, value: Any, *_: Any, **__: Any) -> TracedArray:
    return TracedArray.of(np.full(np.shape(a), value, object))


def _reduction(ufunc: Any) -> Callable[..., Any]:
    return lambda a, axis=None, **others: ufunc.reduce(a, axis=axis, **others)


FUNCTIONS: dict[Any, Callable[..., Any]] = {
    np.where: partial(each_entry, where),
    np.clip: lambda a, *bounds, **named: TracedArray.of(a).clip(*bounds, **named),
    np.mean: lambda a, *args, **others: TracedArray.of(a).mean(*args, **others),
    **dict.fromkeys((np.zeros_like, np.empty_like), lambda a, *_, **__: _full(a, 0.0)),
    np.ones_like: lambda a, *_, **__: _full(a, 1.0),
    np.full_like: _full,
    np.round: np.rint,
    np.interp: _interpolated,
}
for _name, _ufunc in {
    "sum": np.add, "prod": np.multiply, "max": np.maximum, "min": np.minimum,
    "any": np.logical_or, "all": np.logical_and,
}.items():  # fmt: skip
    FUNCTIONS[getattr(np, _name)] = _reduction(_ufunc)
    setattr(TracedArray, _name, _reduction(_ufunc))
_REARRANGING = frozenset((
    "stack", "concatenate", "hstack", "vstack", "column_stack", "split", "moveaxis", "swapaxes",
    "transpose", "matrix_transpose", "reshape", "ravel", "squeeze", "expand_dims", "broadcast_to",
    "broadcast_arrays", "roll", "flip", "repeat", "tile", "take", "diagonal", "diag", "trace",
    "append", "atleast_1d", "atleast_2d", "dot", "inner", "outer", "cross", "einsum", "norm",
    "cumsum", "diff", "copy", "shape", "ndim", "size", "block", "unstack", "polyval",
))  # fmt: skip
"""NumPy's functions that move, add or multiply entries; NumPy applies them to any objects."""


def entries(value: Any, program: Program) -> list[Tracer]:
    """The scalars of a traced result in order, constants among them."""
    if isinstance(value, Tracer):
        return [value]
    return [*map(partial(constant, program), np.asarray(value, object).flat)]
