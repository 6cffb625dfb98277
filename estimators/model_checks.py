"""Checks of a model's matrices: shapes, definiteness, and functions when they are first called."""

import operator
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from estimators.checks import as_array, frozen, shown, whole
from estimators.engine.matrices import is_traced
from estimators.linalg import neutralised
from estimators.varying import Schedule, StateNoise


def as_covariance(name: str, value: object) -> np.ndarray:
    """``value`` as a float array ``(..., k, k)``, checked to be symmetric positive semidefinite.

    Raises:
        ValueError: naming the argument and what is wrong with it.
    """
    cov = as_array(name, value)
    if cov.ndim < 2 or cov.shape[-1] != cov.shape[-2] or cov.shape[-1] == 0:
        raise ValueError(f"{name} must be a square matrix (..., k, k), got shape {cov.shape}")
    if not np.isfinite(cov).all():
        raise ValueError(f"{name} must be finite")
    if symmetric := np.array_equal(cov, cov.mT):
        with suppress(np.linalg.LinAlgError):  # positive definite
            np.linalg.cholesky(cov)
            return cov
    variances = cov.diagonal(0, -2, -1)
    scale = np.sqrt(np.where(variances > 0.0, variances, 1.0))
    unit = cov / scale[..., None] / scale[..., None, :]  # correlations: rounding is a share of standard deviations
    if (np.abs(unit - unit.mT) > 1e-9).any():
        raise ValueError(f"{name} must be symmetric")
    lowest = np.linalg.eigvalsh(unit)[..., 0].min()
    impossible = (variances < 0.0).any() or ((variances == 0.0)[..., None] & (cov != 0.0)).any()
    if impossible or lowest < -1e-9:
        own = np.linalg.eigvalsh(cov)[..., 0].min()
        scaled = "" if own < 0.0 else "in units of its standard deviations "
        found = f"its smallest eigenvalue {scaled}is {own if own < 0.0 else lowest:.3g}"
        zero = ", and what goes with a variance of 0 must be 0" if impossible and min(own, lowest) >= 0.0 else ""
        raise ValueError(f"{name} must be positive semidefinite, {found}{zero}")
    return cov if symmetric else 0.5 * cov + 0.5 * cov.mT


def usable(R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """R ``(..., p, p)`` without the readings whose variance is not finite, and the mask ``(..., p)`` of the others.

    Receivers report an unknown variance as NaN or infinity: such a reading tells nothing.
    """
    finite = np.isfinite(R.diagonal(0, -2, -1))
    if is_traced(R):
        return neutralised(R, finite), finite
    return (R, finite) if finite.all() else (neutralised(R, finite), finite)


def store_arrays(model: Any, matrices: str) -> None:
    """Check the matrices of these letters, and Q and R, and keep as arrays those that are no functions."""
    for name in (*matrices, "Q", "R"):
        value = getattr(model, name)
        if callable(value) or (value is None and name in matrices):
            continue
        array = as_array(name, value) if name in matrices else as_covariance(name, value)
        if array.ndim < 2:
            raise ValueError(f"{name} must be a matrix, got shape {array.shape}")
        if not np.isfinite(array).all():
            raise ValueError(f"{name} must be finite")
        object.__setattr__(model, name, frozen(array))


def size_of(name: str, option: str, sources: dict[str, tuple[object, int]], number: int | None = None) -> int:
    """A size that the user tells, or the first matrix that does: an array, a table, or a function without ``u``.

    Args:
        name: The size.
        option: The argument that tells it, if there is one: functions are only called for such a size.
        sources: Matrices by name, and which axis is of this size.
        number: What the user tells.
    """
    if number is not None:
        return whole(name, number, 1)
    for matrix, axis in sources.values():
        if isinstance(table := _table(matrix), np.ndarray):
            return table.shape[axis]
    symbol, (function, axis) = next(iter(sources.items()))
    if option and callable(function):
        with suppress(Exception):  # a function of u may do anything without one
            return as_array(symbol, function(None)).shape[axis]
    remedy = f"give {option}, or one of {{}} as an array" if option else "give one of {} as an array, not as a function"
    raise ValueError(f"cannot tell {name}: {remedy.format(', '.join(sources))}")


def complete(model: Any, n: int, p: int, shapes: dict[str, tuple[int, int | None]], called: str) -> None:
    """Check a model's matrices, and have its functions checked when they are first called; keep its sizes.

    Where one of G and H is given, the other is 0 unless it is, too.

    Args:
        model: `LinearModel` or `NonlinearModel`.
        n: States.
        p: Measurements.
        shapes: Of its matrices besides G, H, Q and R; None: any number of columns.
        called: Letters of the matrices that may be functions of u.
    """
    q = 0
    if model.G is not None or model.H is not None:
        q = size_of("q", "", {"G": (model.G, -1), "H": (model.H, -1)})
        for name, rows in (("G", n), ("H", p)):
            if getattr(model, name) is None:
                object.__setattr__(model, name, frozen(np.zeros((rows, q))))
    for name, shape in (shapes | {"G": (n, q), "H": (p, q), "Q": (n, n), "R": (p, p)}).items():
        value = getattr(model, name)
        array = value.nominal if isinstance(value, StateNoise) else _table(value)
        if isinstance(array, np.ndarray):
            if wanted := _unlike(array, *shape):
                raise ValueError(f"{name} has shape {array.shape}, expected {wanted}")
        elif callable(value) and name in called:
            function = value.function if isinstance(value, _Checked) else value
            object.__setattr__(model, name, _Checked(model, name, function, shape))
    for name, size, indices in (("n", n, "state_angles"), ("p", p, "measurement_angles"), ("q", q, None)):
        object.__setattr__(model, name, size)
        if indices is None:
            continue
        given = getattr(model, indices)
        try:
            angles = tuple(operator.index(i) for i in given)
        except TypeError:
            angles = (-1,)
        if any(not 0 <= i < size for i in angles):
            raise ValueError(f"{indices} must be indices below {size}, got {shown(given)}")
        object.__setattr__(model, indices, angles)


def _table(matrix: Any) -> Any:
    """The table of a matrix that has one."""
    return matrix.table if isinstance(matrix, Schedule) else matrix


def _unlike(array: np.ndarray, rows: int, columns: int | None) -> str:
    """The expected shape, where an array has another one."""
    fits = array.ndim > 1 and array.shape[-2] == rows and columns in (None, array.shape[-1])
    return "" if fits else f"(..., {rows}, {'m' if columns is None else columns})"


@dataclass(frozen=True)
class _Checked:
    """A model's function of ``u`` until its first value has the right shape, and is a covariance if need be."""

    model: object = field(repr=False)
    name: str
    function: Callable[[np.ndarray | None], np.ndarray]
    shape: tuple[int, int | None]
    seen: bool = False

    def __call__(self, u: np.ndarray | None) -> np.ndarray:
        value = self.function(u)
        if self.seen:  # a program that was traced still asks here
            return value
        array = as_array(self.name, value)
        if wanted := _unlike(array, *self.shape):
            raise ValueError(f"{self.name} gave a matrix of shape {array.shape}, expected {wanted}")
        if self.name in "QR":
            as_covariance(self.name, array if self.name == "Q" else usable(array)[0])
        object.__setattr__(self.model, self.name, self.function)
        object.__setattr__(self, "seen", True)
        return value
