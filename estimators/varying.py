"""Matrices of a model, which may depend on the known input or the state."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from estimators.checks import (
    as_covariance,
    finite_array,
    frozen,
    indices,
    integer,
    number,
    shaped_array,
)
from estimators.engine import Compiled, TracedMatrix, by_entries, lookup, matrix

Matrix = ArrayLike | Callable[[Any], Any]
Function = Callable[[Any, Any], Any]
StateMatrix = ArrayLike | Function


def resolve(value: Any, *arguments: Any) -> Any:
    """A matrix, or a function's value, in NumPy or traced entry by entry with its arguments."""
    if not callable(value):
        return value
    if TracedMatrix not in map(type, arguments):
        return value(*arguments)
    return matrix(value(*map(by_entries, arguments)))


def sized(name: str, value: Any, *size: int) -> Any:
    """Values of a model's function, if their last axes have these sizes.

    Raises:
        ValueError: if they do not. Other sizes might broadcast to a wrong result.
    """
    shape = getattr(value, "shape", None) or np.shape(value)
    if shape[-len(size) :] != size:
        wanted = ", ".join(map(str, size))
        raise ValueError(f"{name} must return arrays (..., {wanted}), got shape {shape}")
    return value


def is_compiled(value: Any) -> bool:
    """Can a compiled program include it? Arrays, None, schedules and compiled functions can be."""
    value = value.function if isinstance(value, StateNoise) else value
    return not callable(value) or isinstance(value, Schedule | Compiled)


class Frozen:
    """A record whose arrays are read-only, also in copies and pickles."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(
            {name: frozen(v) if isinstance(v, np.ndarray) else v for name, v in state.items()}
        )


@dataclass(frozen=True, eq=False)
class Schedule(Frozen):
    """A matrix from a table: the entry nearest to the value of one component of the known input.

    Args:
        table: ``(k, n, m)``.
        component: Index of the component of ``u``.
        scale: Table entries per unit of the component.
        middle: Index of the entry for a component of 0, plus 0.5. The index of the entry in use is
            ``scale * u[component] + middle``, rounded down.
    """

    table: np.ndarray
    component: int
    scale: float
    middle: float

    def __post_init__(self) -> None:
        table = finite_array("table", self.table, "k", "n", "m")
        vars(self).update(
            table=frozen(table),
            component=integer("component", self.component, 0),
            scale=number("scale", self.scale, what="a finite number"),
            middle=number("middle", self.middle, what="a finite number"),
        )

    def __call__(self, u: np.ndarray | None) -> np.ndarray:
        """The matrices ``(..., n, m)`` at ``u (..., k)``, or their tracers."""
        if u is None or self.component >= u.shape[-1]:
            raise ValueError(
                f"matrices follow component {self.component} of the known input: give a u that has"
                " it"
            )
        return lookup(self.table, u[..., self.component] * self.scale + self.middle)

    def scaled(self, factor: float | np.ndarray) -> "Schedule":
        """A copy with the table multiplied by a number, or by factors ``(n, m)``."""
        return replace(self, table=factor * self.table)


@dataclass(frozen=True, eq=False)
class StateNoise:
    """Measurement noise covariance R that depends on the state, evaluated at the predicted mean.

    Args:
        function: ``R(x, u) -> (..., p, p)``.
        nominal: ``(p, p)`` covariance for uses without a state.
    """

    function: Function
    nominal: np.ndarray

    def __call__(self, u: np.ndarray | None) -> np.ndarray:
        """The nominal covariance, whatever the known input."""
        return self.nominal

    def scaled(self, factor: float | np.ndarray) -> "StateNoise":
        """A copy with R multiplied by a number, or by factors ``(p, p)``."""
        return StateNoise(lambda x, u: factor * self.function(x, u), factor * self.nominal)


def check_matrices(model: Any, **options: tuple[str, int | None]) -> None:
    """Check a model's matrices and indices of angles, and set its sizes n, p and q.

    Arrays are kept as read-only copies. If only one of G and H is given, the other is 0.

    Args:
        model: `LinearModel` or `NonlinearModel`.
        **options: For the letter of a size, the name of the argument that gives it, and its value.

    Raises:
        ValueError: naming the matrix that does not fit.
    """
    shapes = model.shapes
    for name in shapes:
        value = getattr(model, name)
        if not callable(value) and (value is not None or name in "ACQR"):
            shape = "...", *shapes[name]
            array = (
                as_covariance(name, value) if name in "QR" else finite_array(name, value, *shape)
            )
            vars(model)[name] = frozen(array)
    sizes = {letter: _size(model, letter, shapes, *options.get(letter, ())) for letter in "np"}
    sizes["q"] = 0
    if model.G is not None or model.H is not None:
        sizes["q"] = _size(model, "q", shapes)
        for name, rows in ("G", "n"), ("H", "p"):
            if getattr(model, name) is None:
                vars(model)[name] = frozen(np.zeros((sizes[rows], sizes["q"])))
    for name, letters in shapes.items():
        if (table := _nominal(model, name)) is not None:
            shaped_array(name, table, "...", *(sizes.get(each, each) for each in letters))
    every = {n: tuple(map(sizes.get, s)) if "m" not in s else () for n, s in shapes.items()}
    every |= {"transition": (sizes["n"],), "measurement": (sizes["p"],)}
    vars(model).update(sizes, sizes=every)
    for name, size in ("state_angles", sizes["n"]), ("measurement_angles", sizes["p"]):
        vars(model)[name] = indices(name, getattr(model, name), size)


def _size(
    model: Any, letter: str, shapes: dict[str, str], option: str = "", given: int | None = None
) -> int:
    """A size ``given`` as an option, or taken from the first array or table that has it."""
    if given is not None:
        return integer(option, given, 1)
    names = [name for name, shape in shapes.items() if letter in shape and name != "B"]
    for name in names:
        if (array := _nominal(model, name)) is not None:
            return array.shape[shapes[name].rindex(letter) - 2]
    remedy = f"{option}=, or " if option else ""
    raise ValueError(
        f"cannot tell {option or letter}: give {remedy}one of {', '.join(names)} as an array, not"
        " as a function"
    )


def _nominal(model: Any, name: str) -> np.ndarray | None:
    """The array of a matrix: itself, its table, or the nominal one; None for functions."""
    matrix = getattr(model, name)
    array = matrix if isinstance(matrix, np.ndarray) else getattr(matrix, "nominal", None)
    return matrix.table if isinstance(matrix, Schedule) else array
