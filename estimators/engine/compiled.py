"""Functions of arrays ``(..., n)`` that run compiled, traced at the first call with each shape."""

from collections.abc import Callable, Sequence
from functools import partial, update_wrapper
from typing import Any

import numpy as np

from estimators.engine.arrays import TracedArray, each_entry, entries
from estimators.engine.function import Argument, Function
from estimators.engine.matching import in_memory
from estimators.engine.matrices import TracedMatrix, is_small, is_traced, stored, view
from estimators.engine.program import Program
from estimators.engine.tracer import Tracer, cast


def trace(
    function: Callable[..., Any],
    rows: Sequence[Argument | None],
    sealed: bool = False,
    own: int = 0,
) -> Function:
    """A function of arrays, traced for rows of some shapes.

    Args:
        function: Pure; it gets tracers of a row of each argument.
        rows: A row of each argument; None for an argument that is None.
        sealed: See `Function`.
        own: See `Function`.

    Raises:
        NotTraceable: if the function uses an operation that cannot be traced.
    """
    program = Program()
    given = [None if row is None else _input(program, i, row) for i, row in enumerate(rows)]
    results = function(*given)
    names = tuple(results) if isinstance(results, dict) else ()
    several = isinstance(results, tuple | list | dict)
    listed = results.values() if names else results if several else [results]
    outputs = [_output(program, each) for each in listed]
    return Function(program, rows, outputs, several, names, sealed, own)


def _input(program: Program, argument: int, row: Argument) -> Any:
    """An argument as a vector or matrix, or as the tracers of its entries."""
    if row.whole and row.shape and row.kind in "fb":
        value = program.add("input_matrix", (), "f", row.size, (argument,))
        return stored(program, value, row.shape, row.kind)

    def entry(column: int) -> Tracer:
        return Tracer(program, program.add("input", (), row.kind, None, (argument, column)))

    return each_entry(entry, np.arange(row.size).reshape(row.shape))


class SideBySide(list[Any]):
    """Arrays of floats whose entries are one result, a vector a row."""


def _output(program: Program, result: Any) -> tuple[list[Any], Argument]:
    """The scalars and matrices of a result, and its row."""
    if isinstance(result, SideBySide):
        parts = [_output(program, each) for each in result]
        size = sum(argument.size for _, argument in parts)
        return [each for part, _ in parts for each in part], Argument((size,))
    result = result if is_traced(result) else TracedArray.of(result)
    scalars = entries(result, program)
    kinds = {x.kind for x in scalars}
    kind = kinds.pop() if len(kinds) == 1 else "f"
    row = Argument(result.shape, kind)
    if isinstance(result, TracedMatrix) and not is_small(result):
        return [view(program, result)], row
    return [cast(x, kind).value for x in scalars], row


class Compiled:
    """A function of arrays, traced for each set of shapes it is called with; see `compiled`.

    Args:
        function: As for `compiled`; it may also return a dictionary, whose values a call returns.
        axes: As for `compiled`.
        matrices: As for `compiled`.
        options: Options of `trace`.

    Attributes:
        function: The function that is traced.
        names: Keys of the dictionary that the function returned when it was last traced.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        axes: Sequence[int] | None = None,
        matrices: bool = False,
        **options: Any,
    ) -> None:
        update_wrapper(self, function)
        self.function, self._rows, self._options = function, (axes, matrices), options
        self.__self__ = getattr(function, "__self__", None)  # the object whose method it is
        self._traced: dict[Any, Function] = {}
        self._last: Any = None, None  # constants of the last call, and what it called
        self._known: dict[Any, Any] = {}  # the same with names, by shapes of earlier calls
        self.names: tuple[str, ...] = ()

    def __get__(self, instance: Any, owner: Any = None) -> Any:
        if instance is None:  # the class' own: plain, with the object as an argument
            return self.function
        own, bound = vars(instance), self.function.__get__(instance)
        place = f"{self.function.__module__}.{self.function.__qualname__}"
        if place not in own or own[place].function != bound:  # a copy has those of its original
            own[place] = Compiled(bound, *self._rows, **self._options)
        return own[place]

    def __call__(self, *arrays: Any, **static: Any) -> Any:
        """Results for arrays; for tracers, the function becomes part of the traced caller."""
        constants, call = self._last
        return call(*arrays) if static == constants else self._call(static, *arrays)

    def _call(self, static: dict[str, Any], *arrays: Any) -> Any:
        """Results for arguments unlike those of the last call."""
        shapes = *static.items(), *(getattr(each, "shape", None) for each in arrays)
        if known := self._known.pop(shapes, None):  # absent while it may call this function
            self._last, self.names = known
            results = self._last[1](*arrays)
            self._known[shapes] = known
            return results
        if any(map(is_traced, arrays)):
            return self.function(*arrays, **static)
        axes, matrices = self._rows
        held = [None if each is None else in_memory(each) for each in arrays]
        rows = [
            None if a is None else Argument(a.shape[a.ndim - k :], a.dtype.kind, matrices)
            for a, k in zip(held, axes or (1,) * len(held), strict=True)
        ]
        key = *rows, *static.items()
        if key not in self._traced:
            self._traced[key] = trace(partial(self.function, **static), rows, **self._options)
            self._traced[key].otherwise = partial(self._call, static)
        function = self._traced[key]
        results = function.compute(*held)
        self._known[shapes] = (static, function.call), function.names
        self._last, self.names = self._known[shapes]
        return results

    def __reduce__(self) -> Any:
        if (instance := self.__self__) is not None:
            return getattr, (instance, self.function.__name__)
        name = getattr(self.function, "__qualname__", "<locals>")
        made = partial(Compiled, **self._options), (self.function, *self._rows)
        return made if "<locals>" in name else name


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
