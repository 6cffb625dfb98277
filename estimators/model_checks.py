"""Checks of a model's matrices: shapes, definiteness, and functions at their first call."""

import operator
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np

from estimators.checks import as_array, check_takes, frozen, integer, short_repr
from estimators.engine.matrices import is_traced
from estimators.first_use import FirstUse, is_own
from estimators.linalg import masked
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
    with np.errstate(over="ignore"):  # correlations: rounding is a share of standard deviations
        unit = np.clip(cov / scale[..., None] / scale[..., None, :], -1e100, 1e100)
    if (np.abs(unit - unit.mT) > 1e-9).any():
        raise ValueError(f"{name} must be symmetric")
    lowest = np.linalg.eigvalsh(unit)[..., 0].min()
    impossible = (variances < 0.0).any() or ((variances == 0.0)[..., None] & (cov != 0.0)).any()
    if impossible or lowest < -1e-9:
        lowest = min(lowest, np.linalg.eigvalsh(cov)[..., 0].min())
        zero = ", and what goes with a variance of 0 must be 0" if impossible else ""
        raise ValueError(
            f"{name} must be positive semidefinite, its smallest eigenvalue is {lowest:.3g}{zero}"
        )
    return cov if symmetric else 0.5 * cov + 0.5 * cov.mT


def usable(R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """R ``(..., p, p)`` without measurements whose variance is not finite, and the mask ``(..., p)`` of the others.

    Receivers report an unknown variance as NaN or infinity: such a measurement tells nothing.
    """
    finite = np.isfinite(R.diagonal(0, -2, -1))
    if is_traced(R):
        return masked(R, finite), finite
    return (R, finite) if finite.all() else (masked(R, finite), finite)


def check_matrices(
    model: Any, shapes: dict[str, str], of_state: str = "", **options: tuple[str, int | None]
) -> None:
    """Check a model's matrices and indices of angles, and set its sizes n, p and q.

    Arrays are kept as read-only copies; functions are checked when they are first called.
    Where one of G and H is given, the other is 0 unless it is, too.

    Args:
        model: `LinearModel` or `NonlinearModel`.
        shapes: Letters of rows and columns of each matrix, in the order in which sizes are looked
            for; m is any size.
        of_state: Matrices whose functions are of ``(x, u)``; others are of u.
        **options: For the letter of a size, the argument that gives it, and its value.

    Raises:
        ValueError: naming what does not fit.
    """
    for name in shapes:
        value = getattr(model, name)
        if isinstance(value, FirstUse):  # of the model of which this one is a copy
            value = value.function
            object.__setattr__(model, name, value)
        if callable(value):
            check_takes(name, value, *(("x", "u") if name in of_state else ("u",)))
        if callable(value) or (value is None and name not in "QR"):
            continue
        array = as_covariance(name, value) if name in "QR" else as_array(name, value)
        if array.ndim < 2:
            raise ValueError(f"{name} must be a matrix, got shape {array.shape}")
        if not np.isfinite(array).all():
            raise ValueError(f"{name} must be finite")
        object.__setattr__(model, name, frozen(array))
    sizes = {
        letter: _size(model, letter, shapes, *options.get(letter, ("", None))) for letter in "np"
    } | {"q": 0}
    if model.G is not None or model.H is not None:
        sizes["q"] = _size(model, "q", shapes)
        for name, rows in ("G", "n"), ("H", "p"):
            if getattr(model, name) is None:
                object.__setattr__(model, name, frozen(np.zeros((sizes[rows], sizes["q"]))))
    for name, letters in shapes.items():
        value, shape = getattr(model, name), (sizes[letters[0]], sizes.get(letters[1]))
        array = value.nominal if isinstance(value, StateNoise) else _table(value)
        if isinstance(array, np.ndarray) and not all(
            wanted in (None, found) for wanted, found in zip(shape, array.shape[-2:], strict=True)
        ):
            expected = ", ".join("m" if each is None else str(each) for each in shape)
            raise ValueError(f"{name} has shape {array.shape}, expected (..., {expected})")
        if callable(value) and not isinstance(value, Schedule):
            set_function(model, name, value, shape, name in of_state)
    for letter, size in sizes.items():
        object.__setattr__(model, letter, size)
    for name, size in ("state_angles", sizes["n"]), ("measurement_angles", sizes["p"]):
        indices = getattr(model, name)
        try:
            angles = tuple(operator.index(i) for i in indices)
        except TypeError:
            angles = (-1,)
        if any(not 0 <= i < size for i in angles):
            raise ValueError(f"{name} must be indices below {size}, got {short_repr(indices)}")
        object.__setattr__(model, name, angles)


def set_function(
    model: Any, name: str, value: Any, shape: tuple[int | None, ...], of_state: bool = True
) -> None:
    """Let a function of a model be compared when it is first used, unless it is this package's."""
    own = value.function if isinstance(value, StateNoise | FirstUse) else value
    own = own.function if isinstance(own, FirstUse) else own
    if is_own(own):
        return
    checks: dict[str, Any] = {"Q": partial(as_covariance, "Q"), "R": _check_noise}
    noise = isinstance(value, StateNoise)
    used = FirstUse(name, own, shape, of_state or noise, checks.get(name))
    object.__setattr__(model, name, StateNoise(used, value.nominal) if noise else used)


def _check_noise(R: np.ndarray) -> None:
    as_covariance("R", usable(R)[0])


def _size(
    model: Any, letter: str, shapes: dict[str, str], option: str = "", number: int | None = None
) -> int:
    """A size that the user gives, or the first matrix that has it: an array, a table, or a function without ``u``.

    Args:
        model: The model.
        letter: Of the size.
        shapes: As for `check_matrices`.
        option: The argument that gives the size, if there is one: functions are only called for
            such a size.
        number: What the user gives.
    """
    if number is not None:
        return integer(option, number, 1)
    axes = {
        name: shape.rindex(letter) - 2
        for name, shape in shapes.items()
        if letter in shape and name != "B"
    }
    for name, axis in axes.items():
        if isinstance(table := _table(getattr(model, name)), np.ndarray):
            return table.shape[axis]
    symbol = next(iter(axes))
    if option and callable(function := getattr(model, symbol)):
        with suppress(Exception):  # a function of u may do anything without one
            return as_array(symbol, function(None)).shape[axes[symbol]]
    remedy = (
        f"give {option}=, or one of {{}} as an array"
        if option
        else "give one of {} as an array, not as a function"
    )
    raise ValueError(f"cannot tell {option or letter}: {remedy.format(', '.join(axes))}")


def _table(matrix: Any) -> Any:
    """The table of a matrix that has one."""
    return matrix.table if isinstance(matrix, Schedule) else matrix
