"""Matrices of a model that depend on the known input or the state."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from estimators.checks import finite_array, frozen, integer, number
from estimators.engine import Compiled, TracedMatrix, by_entries, is_traced, lookup, matrix

Matrix = np.ndarray | Callable[[np.ndarray | None], np.ndarray]
Function = Callable[[np.ndarray, np.ndarray | None], np.ndarray]
StateMatrix = np.ndarray | Function


def resolve(value: Any, *arguments: Any) -> Any:
    """A matrix, or a function's value, in NumPy or traced entry by entry with its arguments."""
    if not callable(value):
        return value
    if not any(isinstance(each, TracedMatrix) for each in arguments):
        return value(*arguments)
    return matrix(value(*map(by_entries, arguments)))


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
        follows = f"matrices follow component {self.component} of"
        if u is None:
            raise ValueError(f"this model needs a known input u: its {follows} it")
        if self.component >= u.shape[-1]:
            raise ValueError(f"{follows} the known input, but u has {u.shape[-1]}")
        index = u[..., self.component] * self.scale + self.middle
        if is_traced(u):
            return lookup(self.table, index)
        # The first entry where u is not a number.
        within = np.fmin(np.fmax(index, 0.0), len(self.table) - 1.0)
        return self.table.take(within.astype(np.intp), axis=0)

    def changed(self, change: Callable[[np.ndarray], np.ndarray]) -> "Schedule":
        """A copy with the function ``change``, such as doubling, applied to the table."""
        return replace(self, table=change(self.table))


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

    def changed(self, change: Callable[[np.ndarray], np.ndarray]) -> "StateNoise":
        """A copy with the function ``change``, such as doubling, applied to R."""
        return StateNoise(lambda x, u: change(self.function(x, u)), change(self.nominal))
