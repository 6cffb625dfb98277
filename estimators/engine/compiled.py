"""Functions of arrays ``(..., n)`` that run compiled, traced at the first call with each shape."""

from collections.abc import Callable, Sequence
from functools import partial, update_wrapper, wraps
from typing import Any

import numpy as np

from estimators.engine.arrays import TracedArray, entries
from estimators.engine.function import Argument, Function, unlike
from estimators.engine.matching import in_memory
from estimators.engine.matrices import MatrixTracer, is_traced, matrix_input
from estimators.engine.program import Program
from estimators.engine.tracer import Tracer, cast


def trace(
    function: Callable[..., Any], rows: Sequence[Argument | None], matrices: bool = False
) -> tuple[Function, bool]:
    """A function of arrays, traced for rows of some shapes; and whether it gives several results.

    Args:
        function: Pure; it gets tracers of a row of each argument.
        rows: The arguments; None stands for itself.
        matrices: Do vectors and matrices stand for themselves (`MatrixTracer`), and not for their
            entries?

    Raises:
        NotTraceable: if it does what a traced function cannot do.
    """
    program, arguments = Program(), [row for row in rows if row is not None]
    tracers = (given(program, i, row, matrices) for i, row in enumerate(arguments))
    results = function(*(None if row is None else next(tracers) for row in rows))
    several = isinstance(results, tuple | list)
    outputs = [_output(program, each) for each in (results if several else [results])]
    return Function(program, arguments, outputs), several


def given(program: Program, argument: int, row: Argument, matrices: bool = False) -> Any:
    """Stand-in for a row of an argument."""
    if matrices and row.kind in "fb":
        return matrix_input(program, argument, 0, row.shape, row.kind)
    scalars = np.empty(row.size, object)
    for column in range(row.size):
        value = program.add("input", (), row.kind, None, (argument, column))
        scalars[column] = Tracer(program, value)
    return scalars.reshape(row.shape).view(TracedArray)


def _output(program: Program, result: Any) -> tuple[list[Any], Argument]:
    """The scalars or the matrix of a result, and its row."""
    if isinstance(result, MatrixTracer):
        return [result.view], Argument(result.shape, "b" if result.mask else "f")
    scalars = entries(result, program)
    kinds = {each.kind for each in scalars}
    kind = kinds.pop() if len(kinds) == 1 else "f"
    shape = np.asarray(result, object).shape
    return [cast(each, kind).value for each in scalars], Argument(shape, kind)


class Compiled:
    """A function of arrays that is traced for the shapes that it is called with; see `compiled`."""

    def __init__(
        self, function: Callable[..., Any], axes: Sequence[int] | None, matrices: bool
    ) -> None:
        update_wrapper(self, function)
        self.function, self._axes, self._matrices = function, axes, matrices
        self._traced: dict[Any, tuple[Function, bool]] = {}
        self._last: tuple[dict[str, Any], Callable[..., Any], bool] = {}, unlike, False

    @property
    def __self__(self) -> Any:
        """The object whose method it is; None of a function."""
        return getattr(self.function, "__self__", None)

    def __get__(self, instance: Any, owner: Any = None) -> Any:
        if instance is None:
            return wraps(self.function)(
                lambda instance, *arrays, **static: self.__get__(instance)(*arrays, **static)
            )
        own = instance.__dict__.get(_METHODS)
        if own is None:
            own = instance.__dict__[_METHODS] = _Methods()
        if self not in own:
            own[self] = Compiled(self.function.__get__(instance), self._axes, self._matrices)
        return own[self]

    def __call__(self, *arrays: Any, **static: Any) -> Any:
        """Results for arrays; of tracers, what is traced with its caller."""
        constants, call, several = self._last  # as it was called last
        if static != constants or (results := call(*arrays)) is None:
            return self._call(arrays, static)
        return results if several else results[0]

    def _call(self, arrays: tuple[Any, ...], static: dict[str, Any]) -> Any:
        """Results for arguments unlike the last ones."""
        if any(map(is_traced, arrays)):
            return self.function(*arrays, **static)
        axes = self._axes or (1,) * len(arrays)
        held = [None if each is None else in_memory(each) for each in arrays]
        rows = tuple(
            None if a is None else Argument(a.shape[a.ndim - k :], a.dtype.kind)
            for a, k in zip(held, axes, strict=True)
        )
        key = rows, *static.items()
        if key not in self._traced:
            self._traced[key] = trace(partial(self.function, **static), rows, self._matrices)
        function, several = self._traced[key]
        results = function.compute([each for each in held if each is not None])
        self._last = static, function.call, several
        return results if several else results[0]

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
        return lambda function: Compiled(function, axes, matrices)
    return Compiled(function, axes, matrices)
