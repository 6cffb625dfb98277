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
from estimators.engine.matrices import MatrixTracer, is_traced, matrix_input
from estimators.engine.program import Program
from estimators.engine.tracer import Tracer, cast


def trace(
    function: Callable[..., Any],
    rows: Sequence[Argument | None],
    matrices: bool = False,
    sealed: bool = False,
) -> Function:
    """A function of arrays, traced for rows of some shapes.

    Args:
        function: Pure; it gets tracers of a row of each argument.
        rows: The arguments; None stands for itself.
        matrices: Do vectors and matrices stand for themselves (`MatrixTracer`), and not for their
            entries?
        sealed: See `Function`.

    Raises:
        NotTraceable: if it does what a traced function cannot do.
    """
    program, arguments, given = Program(), list[Argument](), list[Any]()
    for row in rows:
        if row is None:
            given.append(None)
        else:
            inputs = matrix_input if matrices and row.kind in "fb" else scalar_inputs
            given.append(inputs(program, len(arguments), row.shape, row.kind))
            arguments.append(row)
    results = function(*given)
    several = isinstance(results, tuple | list)
    outputs = [*map(partial(_output, program), results if several else [results])]
    return Function(program, arguments, outputs, several, sealed)


def scalar_inputs(program: Program, argument: int, shape: tuple[int, ...], kind: str) -> Any:
    """Tracers of the entries of an argument."""
    scalars = np.empty(math.prod(shape), object)
    for column in range(scalars.size):
        value = program.add("input", (), kind, None, (argument, column))
        scalars[column] = Tracer(program, value)
    return scalars.reshape(shape).view(TracedArray)


def _output(program: Program, result: Any) -> tuple[list[Any], Argument]:
    """The scalars or the matrix of a result, and its row."""
    if isinstance(result, MatrixTracer):
        return [result.view], Argument(result.shape, result.kind)
    if not isinstance(result, Tracer):
        result = TracedArray.of(result)
    scalars = entries(result, program)
    kinds = {*map(attrgetter("kind"), scalars)}
    kind = kinds.pop() if len(kinds) == 1 else "f"
    values = [*map(attrgetter("value"), map(partial(cast, kind=kind), scalars))]
    return values, Argument(result.shape, kind)


class Compiled:
    """A function of arrays that is traced for the shapes that it is called with; see `compiled`."""

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
        """Results for arrays; of tracers, what is traced with its caller."""
        constants, function = self._last
        if static != constants or (results := function.call(*arrays)) is None:
            return self._call(arrays, static)
        return results if function.several else results[0]

    def _call(self, arrays: tuple[Any, ...], static: dict[str, Any]) -> Any:
        """Results for arguments unlike the last ones."""
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

    It must be pure, and is frozen when it is traced: what it reads of its surroundings counts as it
    was then.

    Args:
        function: A class of filters, whose attribute ``compiled`` becomes True; or a function,
            of positional arguments that are arrays, and named ones that are constants and can
            be hashed. A method counts its object as a constant. It is traced with the batch's axes
            gone, once for rows of the same shapes; called with tracers it is traced with its
            caller.
        axes: How many last axes of each argument are a row's: 0 for a number; None: 1 for all.
        matrices: Whether its vectors and matrices are traced as such, in the words of
            `estimators.engine.matrices`, and not entry by entry: for what is large.
    """
    if isinstance(function, type):
        function.compiled = True  # type: ignore[attr-defined]
        return function
    if function is None:
        return partial(compiled, axes=axes, matrices=matrices)
    return Compiled(function, axes, matrices)
