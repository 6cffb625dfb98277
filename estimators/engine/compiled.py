"""Functions of arrays ``(..., n)`` that run compiled, traced at the first call with each shape."""

import math
from collections.abc import Callable, Sequence
from functools import partial, update_wrapper
from operator import attrgetter
from typing import Any

import numpy as np

from estimators.engine.arrays import TracedArray, entries
from estimators.engine.function import Argument, Function
from estimators.engine.matching import in_memory
from estimators.engine.matrices import TracedMatrix, is_small, is_traced, stored, view
from estimators.engine.program import Program
from estimators.engine.tracer import Tracer, cast


def trace(
    function: Callable[..., Any],
    rows: Sequence[Argument | None],
    matrices: bool | Sequence[bool] = False,
    sealed: bool = False,
    own: int = 0,
) -> Function:
    """A function of arrays, traced for rows of some shapes.

    Args:
        function: Pure; it gets tracers of a row of each argument.
        rows: Shape and kind of a row of each argument; None for an argument that is None.
        matrices: Are operations of large vectors and matrices loops (`TracedMatrix`), not unrolled? One
            answer, or one for each row.
        sealed: See `Function`.
        own: See `Function`.

    Raises:
        NotTraceable: if the function uses an operation that cannot be traced.
    """
    program, arguments, given = Program(), list[Argument](), list[Any]()
    whole = [matrices] * len(rows) if isinstance(matrices, bool) else matrices
    for row, as_matrix in zip(rows, whole, strict=True):
        if row is None:
            given.append(None)
        else:
            inputs = matrix_inputs if as_matrix and row.kind in "fb" else scalar_inputs
            given.append(inputs(program, len(arguments), row.shape, row.kind))
            arguments.append(row)
    results = function(*given)
    several = isinstance(results, tuple | list)
    outputs = [*map(partial(_output, program), results if several else [results])]
    return Function(program, arguments, outputs, several, sealed, own)


def scalar_inputs(program: Program, argument: int, shape: tuple[int, ...], kind: str) -> Any:
    """Tracers of the entries of an argument."""
    scalars = np.empty(math.prod(shape), object)
    for column in range(scalars.size):
        value = program.add("input", (), kind, None, (argument, column))
        scalars[column] = Tracer(program, value)
    return scalars.reshape(shape).view(TracedArray)


def matrix_inputs(program: Program, argument: int, shape: tuple[int, ...], kind: str) -> Any:
    """An argument as a vector, matrix or number."""
    if not shape:
        return scalar_inputs(program, argument, shape, kind)[()]
    value = program.add("input_matrix", (), "f", math.prod(shape), (argument,))
    return stored(program, value, shape, kind)


class SideBySide(list[Any]):
    """Arrays of floats whose entries are one result, a vector a row."""


def _output(program: Program, result: Any) -> tuple[list[Any], Argument]:
    """The scalars and matrices of a result, and its row."""
    if isinstance(result, SideBySide):
        parts = [_output(program, each) for each in result]
        size = sum(argument.size for _, argument in parts)
        return [each for part, _ in parts for each in part], Argument((size,))
    if not isinstance(result, Tracer):
        result = TracedArray.of(result) if not isinstance(result, TracedMatrix) else result
    if isinstance(result, TracedMatrix) and not is_small(result):
        return [view(program, result)], Argument(result.shape, _kind(entries(result, program)))
    scalars = entries(result, program)
    kind = _kind(scalars)
    values = [*map(attrgetter("value"), map(partial(cast, kind=kind), scalars))]
    return values, Argument(result.shape, kind)


def _kind(scalars: Sequence[Tracer]) -> str:
    """The kind of an array of numbers."""
    kinds = {*map(attrgetter("kind"), scalars)}
    return kinds.pop() if len(kinds) == 1 else "f"


class Compiled:
    """A function of arrays, traced for each set of shapes it is called with; see `compiled`."""

    def __init__(
        self, function: Callable[..., Any], axes: Sequence[int] | None, matrices: bool
    ) -> None:
        update_wrapper(self, function)
        self.function, self._axes, self._matrices = function, axes, matrices
        self._traced: dict[Any, Function] = {}
        self._last: Any = None, None  # constants of the last call, and the traced function

    @property
    def __self__(self) -> Any:
        """The object whose method it is; None of a function."""
        return getattr(self.function, "__self__", None)

    def __get__(self, instance: Any, owner: Any = None) -> Any:
        if instance is None:  # the class' own: plain, with the object as an argument
            return self.function
        own = instance.__dict__.get(_METHODS)
        if own is None:
            own = instance.__dict__[_METHODS] = _Methods()
        if self not in own:
            own[self] = Compiled(self.function.__get__(instance), self._axes, self._matrices)
        return own[self]

    def __call__(self, *arrays: Any, **static: Any) -> Any:
        """Results for arrays; for tracers, the function becomes part of the traced caller."""
        constants, function = self._last
        if static != constants or (results := function.call(*arrays)) is None:
            return self._call(arrays, static)
        return results if function.several else results[0]

    def _call(self, arrays: tuple[Any, ...], static: dict[str, Any]) -> Any:
        """Results for arguments of other shapes than at the last call."""
        if any(map(is_traced, arrays)):
            return self.function(*arrays, **static)
        axes = self._axes or (1,) * len(arrays)
        held: list[np.ndarray] = []
        rows: list[Argument | None] = []
        for each, k in zip(arrays, axes, strict=True):
            if each is None:
                rows.append(None)
            else:
                held.append(a := in_memory(each))
                rows.append(Argument(a.shape[a.ndim - k :], a.dtype.kind))
        key = *rows, *static.items()
        if key not in self._traced:
            self._traced[key] = trace(partial(self.function, **static), rows, self._matrices)
        function = self._traced[key]
        results = function.compute(*held)
        self._last = static, function
        return results if function.several else results[0]

    def __reduce__(self) -> Any:
        if (instance := self.__self__) is not None:
            return getattr, (instance, self.function.__name__)
        name = getattr(self.function, "__qualname__", "<locals>")
        return (
            (Compiled, (self.function, self._axes, self._matrices)) if "<locals>" in name else name
        )


class _Methods(dict[Compiled, Compiled]):
    """Compiled methods of an object; a copy compiles its own, as its attributes may differ."""

    def __reduce__(self) -> Any:
        return _Methods, ()


_METHODS = "_compiled_methods"


def compiled(
    function: Any = None, *, axes: Sequence[int] | None = None, matrices: bool = False
) -> Any:
    """Compile a plain NumPy function of arrays ``(..., n)``, or a class of filters, at first use.

    The function must be pure. Other values that it reads, such as globals and attributes, are
    constants from the time at which it is traced.

    Args:
        function: A class of filters, whose attribute ``compiled`` becomes True. Or a function whose
            positional arguments are arrays and whose keyword arguments are hashable constants; the
            object of a method is a constant, too. The function is traced for one row, without batch
            axes, once for each set of shapes. Called by a function that is being traced, it becomes
            part of that function.
        axes: Number of last axes of each argument that form a row, 0 for a number. None: 1 for
            every argument.
        matrices: True to trace vectors and matrices as a whole, with the operations of
            `estimators.engine.matrices`, instead of entry by entry; for large ones.
    """
    if isinstance(function, type):
        function.compiled = True  # type: ignore[attr-defined]
        return function
    if function is None:
        return partial(compiled, axes=axes, matrices=matrices)
    return Compiled(function, axes, matrices)
