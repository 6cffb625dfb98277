"""Arrays of tracers: NumPy itself stacks, indexes and broadcasts them, and calls each one's operations."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, ClassVar

import numpy as np

from estimators.engine.program import Program, constant_array
from estimators.engine.tracer import (
    NotTraceable,
    Tracer,
    cast,
    constant,
    numpy_function,
    operation,
    power,
    where,
)


class TracedArray(np.ndarray):
    """An object array of `Tracer` and constants: one row of a batch, whose leading axes are gone."""

    __array_priority__ = 2000.0
    stronger: ClassVar[set[type]] = set()
    """Classes that NumPy asks instead where both are operands; `estimators.engine.matrices` adds its own."""

    @staticmethod
    def of(value: Any) -> "TracedArray":
        """A scalar, a list or an array as one."""
        array = np.empty((), object)
        if isinstance(value, Tracer):
            array[()] = value
        else:
            array = (
                np.array(value, object)
                if isinstance(value, list | tuple)
                else np.asarray(value, object)
            )
        return array.view(TracedArray)

    def __array_ufunc__(self, ufunc: Any, method: str, *operands: Any, **others: Any) -> Any:
        return (
            NotImplemented
            if self._yields(map(type, operands))
            else _apply(ufunc, method, operands, others)
        )

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        return NotImplemented if self._yields(types) else _apply_function(function, args, kwargs)

    def _yields(self, types: Iterable[type]) -> bool:
        return not self.stronger.isdisjoint(types)

    def __array_finalize__(self, source: Any) -> None:
        """NumPy calls it of every view."""

    def __getitem__(self, key: Any) -> Any:
        if isinstance(key, Tracer | TracedArray):
            raise NotTraceable(
                "x[mask] has other entries in each row: use np.where, and lookup for x[index]"
            )
        return super().__getitem__(key)

    def __setitem__(self, key: Any, value: Any) -> None:
        if isinstance(key, Tracer | TracedArray):
            if np.shape(key) != self.shape or np.size(value) != 1:
                raise NotTraceable("x[mask] = values in a traced function is of masks of x's shape and one value: use "
                                   "np.where")  # fmt: skip
            key, value = ..., _where_array(key, scalar(value), self)
        super().__setitem__(key, value)

    @property
    def mT(self) -> Any:
        """The transposed matrix."""
        return np.swapaxes(self, -1, -2)

    def astype(self, dtype: Any, *_: Any, **__: Any) -> Any:
        """As another kind of number."""
        kind = np.dtype(dtype).kind
        if kind == "O" or np.dtype(dtype).itemsize not in (1, 8):
            raise NotTraceable(
                f"a traced function computes with float64, int64 and masks, not {np.dtype(dtype)}"
            )
        return each_entry(lambda x: cast(constant(_program(self), x), kind), self)

    def mean(self, axis: Any = None, **others: Any) -> Any:  # type: ignore[override]
        """The mean over axes of the row."""
        count = self.size if axis is None else np.prod([self.shape[i] for i in np.atleast_1d(axis)])
        return self.sum(axis, **others) / float(count)

    def var(self, axis: Any = None, ddof: float = 0.0, **others: Any) -> Any:  # type: ignore[override]
        """The variance along axes of the row."""
        apart = self - self.mean(axis, keepdims=True)
        mean = (apart * apart).mean(axis, **others)
        count = self.size // np.size(mean)
        return mean if ddof == 0.0 else mean * float(count) / (count - ddof)

    def std(self, axis: Any = None, ddof: float = 0.0, **others: Any) -> Any:  # type: ignore[override]
        """The standard deviation along axes of the row."""
        return np.sqrt(self.var(axis, ddof, **others))

    def clip(self, low: Any = None, high: Any = None, **_: Any) -> Any:  # type: ignore[override]
        """Within bounds."""
        return _clip(self, low, high)


Tracer.as_array = TracedArray.of


def _program(*operands: Any) -> Program:
    """The program of some operands."""
    for operand in operands:
        for each in [operand] if isinstance(operand, Tracer) else np.asarray(operand, object).flat:
            if isinstance(each, Tracer):
                return each.program
    raise NotTraceable("nothing in this array depends on what a function is traced with")


def scalar(value: Any) -> Any:
    """The entry of an array of one, a tracer or a number as it is."""
    if isinstance(value, np.ndarray) and value.size == 1:
        return value.reshape(()).item() if value.dtype != object else value.reshape(-1)[0]
    return value


def _plain(value: Any) -> Any:
    """An object array that calls the operations of its entries."""
    if isinstance(value, TracedArray):
        return value.view(np.ndarray)
    if isinstance(value, Tracer):
        return TracedArray.of(value).view(np.ndarray)
    if isinstance(value, list | tuple):
        return type(value)(map(_plain, value))
    return value


def _operand(value: Any) -> Any:
    if (
        isinstance(value, np.ndarray)
        and not isinstance(value, TracedArray)
        and value.dtype != object
    ):
        return constant_array(value).astype(object)
    return _plain(value)


def _wrapped(value: Any) -> Any:
    """A result as an array of tracers, where there is one in it."""
    if isinstance(value, tuple | list):
        return type(value)(map(_wrapped, value))
    if isinstance(value, np.ndarray) and value.dtype == object:
        return value.view(TracedArray)
    return value


def each_entry(function: Callable[..., Any], *operands: Any) -> Any:
    """A function of scalars of each entry."""
    found = np.frompyfunc(function, len(operands), 1)(*map(_operand, operands))
    return found if isinstance(found, Tracer) else TracedArray.of(found)


def _recorded(opcode: str) -> Callable[..., Any]:
    """An opcode of scalars, computed at once where none is traced."""

    def apply(*operands: Any) -> Any:
        for each in operands:
            if isinstance(each, Tracer):
                return operation(opcode, *operands)
        with np.errstate(all="ignore"):
            return numpy_function(opcode)(*operands)

    return apply


def _sign(x: Any) -> Any:
    return (
        where(x > 0.0, 1.0, where(x < 0.0, -1.0, x + 0.0)) if isinstance(x, Tracer) else np.sign(x)
    )


def _mask(x: Any) -> Any:
    return cast(x, "b") if isinstance(x, Tracer) else bool(x)


_and, _or, _xor, _not = map(_recorded, ("and", "or", "xor", "not"))
_OPCODES = (
    "negative", "absolute", "sqrt", "floor", "ceil", "trunc", "rint", "sin", "cos", "tan", "exp", "expm1", "log",
    "log1p", "arctan", "arcsin", "arccos", "tanh", "isfinite", "isnan", "add", "subtract", "multiply", "divide",
    "maximum", "minimum", "copysign", "fmod", "remainder", "arctan2", "hypot", "greater", "less", "equal",
    "greater equal", "less equal", "not equal", "and", "or", "xor", "not", "left shift", "right shift", "floor divide",
)  # fmt: skip
_SCALAR: dict[Any, Callable[..., Any]] = {
    **{numpy_function(opcode): _recorded(opcode) for opcode in _OPCODES},
    np.fabs: _recorded("absolute"),
    np.positive: lambda x: x,
    np.conjugate: lambda x: x,
    np.square: lambda x: power(x, 2) if isinstance(x, Tracer) else np.square(x),
    np.heaviside: lambda x, y: where(x > 0.0, 1.0, where(x < 0.0, 0.0, where(x == 0.0, y, x))),
    np.reciprocal: lambda x: 1.0 / x,
    np.sign: _sign,
    np.power: lambda x, y: (
        power(x, y) if isinstance(x, Tracer) or isinstance(y, Tracer) else np.power(x, y)
    ),
    np.float_power: lambda x, y: power(x, y),
    np.log2: lambda x: operation("log", x) / float(np.log(2.0)),
    np.log10: lambda x: operation("log", x) / float(np.log(10.0)),
    **dict.fromkeys((np.deg2rad, np.radians), lambda x: x * (np.pi / 180.0)),
    **dict.fromkeys((np.rad2deg, np.degrees), lambda x: x * (180.0 / np.pi)),
    np.isinf: lambda x: (
        operation("equal", operation("absolute", x), np.inf)
        if isinstance(x, Tracer)
        else np.isinf(x)
    ),
    np.signbit: lambda x: (
        operation("copysign", 1.0, x) < 0.0 if isinstance(x, Tracer) else np.signbit(x)
    ),
    np.logical_and: lambda x, y: _and(_mask(x), _mask(y)),
    np.logical_or: lambda x, y: _or(_mask(x), _mask(y)),
    np.logical_xor: lambda x, y: _xor(_mask(x), _mask(y)),
    np.logical_not: lambda x: _not(_mask(x)),
}
"""NumPy's functions entry by entry, of scalars."""
SCALAR_FUNCTIONS: dict[str, Callable[..., Any]] = {
    **{ufunc.__name__: function for ufunc, function in _SCALAR.items()}, "where": where,
}  # fmt: skip
"""The same by their names."""
_COUNTED = {np.add}  # a sum of masks counts them


def _apply(ufunc: Any, method: str, operands: Sequence[Any], others: dict[str, Any]) -> Any:
    """One of NumPy's functions entry by entry, or its reduction."""
    out = others.pop("out", None)
    if (
        ufunc in (np.matmul, np.vecdot, np.matvec, np.vecmat)
        and method == "__call__"
        and not others
    ):
        found = ufunc(
            *(np.asarray(each, object) for each in map(_operand, operands))
        )  # terms in their order
    elif (
        ufunc not in _SCALAR
        or others.keys() - {"axis", "keepdims", "dtype"}
        or others.get("dtype") not in (None, float)
    ):
        raise NotTraceable(f"a traced function cannot have {ufunc.__name__} in it, so used")
    elif method == "__call__":
        found = np.frompyfunc(_SCALAR[ufunc], ufunc.nin, 1)(*map(_operand, operands))
    elif method in ("reduce", "accumulate") and ufunc.nin == 2:
        array = _operand(operands[0])
        if np.ndim(array) == 0:
            raise NotTraceable(
                f"np.{ufunc.__name__} of a number a row is over the batch: give it an axis of"
                " the row"
            )
        if ufunc in _COUNTED:
            array = np.frompyfunc(
                lambda x: cast(x, "i") if getattr(x, "kind", "") == "b" else x, 1, 1
            )(array)
        others.pop("dtype", None)
        each = np.frompyfunc(
            _SCALAR[ufunc], 2, 1, identity=ufunc.identity
        )  # so that several axes can be reduced
        found = getattr(each, method)(array, *operands[1:], **others)
    else:
        raise NotTraceable(f"a traced function cannot have np.{ufunc.__name__}.{method} in it")
    if out is not None:
        if not isinstance(out[0], TracedArray):
            raise NotTraceable(
                "a traced function cannot write into a fresh array of floats: use np.stack or"
                " np.where"
            )
        out[0][...] = found
        return out[0]
    return found if isinstance(found, Tracer) else _wrapped(found)


def _clip(x: Any, low: Any = None, high: Any = None, **others: Any) -> Any:
    low, high = others.pop("min", low), others.pop("max", high)
    if others:
        raise NotTraceable("np.clip in a traced function has two bounds and no options")
    x = x if low is None else np.maximum(x, low)
    return x if high is None else np.minimum(x, high)


def _where_array(mask: Any, *choices: Any) -> Any:
    if len(choices) != 2:
        raise NotTraceable("np.where in a traced function needs a mask and two values")

    def one(mask: Any, chosen: Any, other: Any) -> Any:
        if any(isinstance(each, Tracer) for each in (mask, chosen, other)):
            return where(mask, chosen, other)
        return chosen if mask else other

    return each_entry(one, mask, *choices)


def _norm(x: Any, ord: Any = None, axis: Any = None, keepdims: bool = False) -> Any:
    if ord not in (None, 2) or (ord == 2 and np.ndim(x) > 1 and not isinstance(axis, int)):
        raise NotTraceable("np.linalg.norm in a traced function is the root of a sum of squares")
    return np.sqrt(_apply(np.add, "reduce", (x * x,), {"axis": axis, "keepdims": keepdims}))


def _chosen(masks: Any, choices: Any, default: Any = 0.0) -> Any:
    for mask, choice in zip(masks[::-1], choices[::-1], strict=True):
        default = _where_array(mask, choice, default)
    return default


def _round(x: Any, decimals: int = 0) -> Any:
    if decimals != 0:
        raise NotTraceable("np.round in a traced function is to whole numbers")
    return np.rint(x)


def _accumulated(ufunc: Any) -> Callable[..., Any]:
    def accumulated(a: Any, axis: Any = None) -> Any:
        a = TracedArray.of(a)
        return _apply(ufunc, "accumulate", (a if axis is not None else a.ravel(), axis or 0), {})

    return accumulated


def _reduction(ufunc: Any) -> Callable[..., Any]:
    def reduced(a: Any, axis: Any = None, **others: Any) -> Any:
        return _apply(ufunc, "reduce", (a,), {"axis": axis} | others)

    return reduced


FUNCTIONS: dict[Any, Callable[..., Any]] = {
    np.where: _where_array,
    np.clip: _clip,
    np.zeros_like: lambda a, *_, **__: TracedArray.of(np.zeros(a.shape).astype(object)),
    np.ones_like: lambda a, *_, **__: TracedArray.of(np.ones(a.shape).astype(object)),
    np.empty_like: lambda a, *_, **__: TracedArray.of(np.zeros(a.shape).astype(object)),
    np.full_like: lambda a, value, *_, **__: TracedArray.of(
        np.full(a.shape, scalar(value), object)
    ),
    np.cumsum: _accumulated(np.add),
    np.cumprod: _accumulated(np.multiply),
    np.linalg.norm: _norm,
    np.select: _chosen,
    np.round: _round,
    np.fix: np.trunc,
    np.real: np.positive,
    np.polyval: np.polyval._implementation,  # type: ignore[attr-defined]
}
for _name, _ufunc in {"sum": np.add, "prod": np.multiply, "max": np.maximum, "min": np.minimum, "any": np.logical_or,
                      "all": np.logical_and}.items():  # fmt: skip
    FUNCTIONS[getattr(np, _name)] = _reduction(_ufunc)
    setattr(TracedArray, _name, _reduction(_ufunc))
for _name in ("mean", "var", "std"):
    FUNCTIONS[getattr(np, _name)] = lambda a, *args, _name=_name, **others: getattr(TracedArray.of(a), _name)(
        *args, **others)  # fmt: skip
_REARRANGING = {
    np.stack, np.concatenate, np.hstack, np.vstack, np.dstack, np.column_stack, np.split, np.array_split, np.moveaxis,
    np.swapaxes, np.transpose, np.reshape, np.ravel, np.squeeze, np.expand_dims, np.broadcast_to, np.broadcast_arrays,
    np.roll, np.flip, np.repeat, np.tile, np.take, np.diagonal, np.diag, np.trace, np.append, np.delete, np.insert,
    np.atleast_1d, np.atleast_2d, np.dot, np.inner, np.outer, np.cross, np.einsum, np.kron, np.tensordot, np.diff,
    np.copy, np.shape, np.ndim, np.size, np.block, np.unstack, np.rot90, np.linalg.matrix_transpose,
    np.linalg.outer, np.linalg.vecdot, np.linalg.cross, np.matrix_transpose, np.linalg.diagonal, np.linalg.trace,
}  # fmt: skip
"""NumPy's functions that move entries, or add and multiply them, as they do of any objects."""


def _apply_function(function: Any, args: Sequence[Any], kwargs: dict[str, Any]) -> Any:
    """One of NumPy's functions that are not entry by entry."""
    if (own := FUNCTIONS.get(function)) is not None:
        return own(*args, **kwargs)
    if function not in _REARRANGING and not _depends((*args, *kwargs.values())):
        return function(
            *map(_floats, args), **{name: _floats(value) for name, value in kwargs.items()}
        )
    if function not in _REARRANGING:
        raise NotTraceable(f"a traced function cannot have np.{function.__name__} in it")
    return _wrapped(
        function(*map(_plain, args), **{name: _plain(value) for name, value in kwargs.items()})
    )


def _depends(value: Any) -> bool:
    """Is a tracer in it?"""
    if isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.dtype == object):
        return any(map(_depends, value if isinstance(value, list | tuple) else value.flat))
    return isinstance(value, Tracer)


def _floats(value: Any) -> Any:
    """Constants that stand in an array of objects, as floats."""
    if isinstance(value, list | tuple):
        return type(value)(map(_floats, value))
    return np.array(value.tolist()) if isinstance(value, TracedArray) else value


def entries(value: Any, program: Program) -> list[Tracer]:
    """The scalars of a traced result in order, constants among them."""
    return [constant(program, each) for each in np.asarray(value, object).reshape(-1)]
