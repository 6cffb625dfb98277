"""Checks of users' arguments: they return arrays and numbers, or raise naming the argument."""

import operator
from numbers import Real
from typing import Any

import numpy as np

AT_LEAST_0, UP_TO_1 = float(np.nextafter(0.0, -1.0)), float(np.nextafter(1.0, 2.0))
"""Exclusive bounds of `number` for numbers that may be 0 or 1."""


def as_array(name: str, value: object) -> np.ndarray:
    """``value`` as a float array.

    Raises:
        ValueError: if it is not an array of real numbers.
    """
    if type(value) is np.ndarray and value.dtype == np.float64:
        return value
    array = numbers(value)
    if array is None:
        raise ValueError(f"{name} must be an array of real numbers, got {short_repr(value)}")
    return array


def frozen(array: np.ndarray) -> np.ndarray:
    """A read-only copy; the array itself if it owns its numbers and is read-only."""
    if array.flags.writeable or array.base is not None:
        array = np.array(array)
        array.setflags(write=False)
    return array


def numbers(value: object) -> np.ndarray | None:
    """An array of real numbers as floats, NaN where one is masked, pandas' NA or None; or None."""
    try:
        array = np.asarray(_unmasked(value))
        if array.dtype == object and array.ndim:  # such as a data frame's
            array = np.asarray(_unmasked(array.tolist()))
        return array.astype(float, copy=False) if array.dtype.kind in "fiub" else None
    except (TypeError, ValueError):  # rows of unequal length, objects that are no sequences
        return None


def _unmasked(value: Any) -> Any:
    """A value, or the values of a list, with NaN for missing numbers."""
    if isinstance(value, np.ma.MaskedArray):
        return np.ma.filled(value.astype(float), np.nan)
    if isinstance(value, list | tuple):
        return [
            np.nan if each is None or type(each).__name__ == "NAType" else _unmasked(each)
            for each in value
        ]
    return value


def finite_array(name: str, value: object, *shape: int | str) -> np.ndarray:
    """``value`` as a float array of finite numbers, of a shape as `shaped_array` takes it.

    Raises:
        ValueError: if it is not such an array.
    """
    array = shaped_array(name, value, *shape)
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite, got {short_repr(value)}")
    return array


def shaped_array(name: str, value: object, *shape: int | str) -> np.ndarray:
    """``value`` as a float array of a shape.

    Args:
        name: Name of the argument.
        value: The argument.
        *shape: Its shape; a letter stands for any length, a first ``"..."`` for any axes before the
            others.

    Raises:
        ValueError: if it is not such an array.
    """
    array = as_array(name, value)
    wanted = shape[1:] if shape[:1] == ("...",) else shape
    found = array.shape[array.ndim - len(wanted) :] if wanted is not shape else array.shape
    if len(found) != len(wanted) or any(
        isinstance(size, int) and size != k for size, k in zip(wanted, found, strict=True)
    ):
        comma = "," if len(shape) == 1 else ""
        raise ValueError(
            f"{name} must have shape ({', '.join(map(str, shape))}{comma}), got {array.shape}"
        )
    return array


def as_covariance(name: str, value: object) -> np.ndarray:
    """``value`` as a float array ``(..., k, k)``, checked to be symmetric positive semidefinite.

    Raises:
        ValueError: naming the argument and what is wrong with it.
    """
    cov = finite_array(name, value, "...", "k", "k")
    if cov.shape[-1] != cov.shape[-2] or cov.shape[-1] == 0:
        raise ValueError(f"{name} must be a square matrix (..., k, k), got shape {cov.shape}")
    # Correlations: rounding is a share of standard deviations. What has none correlates with none.
    scale = np.sqrt(np.maximum(cov.diagonal(0, -2, -1), 1e-300))
    with np.errstate(over="ignore"):
        unit = np.clip(cov / scale[..., None] / scale[..., None, :], -1e100, 1e100)
    if (np.abs(unit - unit.mT) > 1e-9).any():
        raise ValueError(f"{name} must be symmetric")
    if np.linalg.eigvalsh(unit).min(initial=0.0) < -1e-9:
        lowest = np.linalg.eigvalsh(cov).min()
        raise ValueError(
            f"{name} must be positive semidefinite, its smallest eigenvalue is {lowest:.3g}"
        )
    return 0.5 * cov + 0.5 * cov.mT


def as_mask(name: str, value: object) -> np.ndarray:
    """``value`` as an array of truth values: numbers other than 0 are true, missing ones false.

    Raises:
        ValueError: if it is not an array of either.
    """
    if type(value) is np.ndarray and value.dtype == bool:
        return value
    array = as_array(name, value)
    return (array != 0.0) & ~np.isnan(array)


def known_input(u: Any, batch: tuple[int, ...]) -> np.ndarray | None:
    """The known input with a row for each row of the belief, so that rows can be selected."""
    if u is None:
        return None
    u = frozen(as_array("u", u))  # the belief keeps it
    u = u if u.ndim else u[None]
    return broadcast("u", u, batch + u.shape[-1:])


def broadcast(name: str, value: np.ndarray, shape: tuple[int, ...], core: int = 1) -> np.ndarray:
    """``value`` with the leading axes of ``shape``; its last ``core`` axes must fit exactly."""
    if value.shape == shape:
        return value
    try:
        if value.shape[-core:] == shape[-core:]:
            return np.broadcast_to(value, shape)
    except ValueError:
        pass
    raise ValueError(f"{name} has shape {value.shape}, expected {shape}")


def number(
    name: str, value: object, low: float = -np.inf, high: float = np.inf, what: str = "a number"
) -> float:
    """``value`` as a float strictly between ``low`` and ``high``; NaN is refused.

    Raises:
        ValueError: if it is not a number or lies outside; ``what`` says what it should be.
    """
    as_float = as_number(value)
    if not low < as_float < high:
        raise ValueError(f"{name} must be {what}, got {short_repr(value)}")
    return as_float


def as_number(value: object) -> float:
    """A number as float; NaN for anything else, infinity for one that is too large."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, bool) or not isinstance(value, Real):
        return np.nan
    try:
        return float(value)
    except OverflowError:
        return np.inf


def integer(name: str, value: object, lowest: int) -> int:
    """``value`` as a whole number of at least ``lowest``.

    Raises:
        ValueError: if it is too small, too large, or not a whole number (True and 2.0 are refused).
    """
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < lowest:
        raise ValueError(
            f"{name} must be a whole number of at least {lowest}, got {short_repr(value)}"
        )
    if value > 2**31 - 1:
        raise ValueError(f"{name} must be at most {2**31 - 1}, got {short_repr(value)}")
    return int(value)


def indices(name: str, value: Any, size: int) -> tuple[int, ...]:
    """``value`` as a tuple of indices below ``size``.

    Raises:
        ValueError: if it is not a sequence of such indices.
    """
    try:
        found = tuple(map(operator.index, value))
    except TypeError:
        found = (-1,)
    if any(not 0 <= i < size for i in found):
        raise ValueError(f"{name} must be indices below {size}, got {short_repr(value)}")
    return found


def short_repr(value: object) -> str:
    """A value for an error message: on one line, and shortened if it is long."""
    try:
        text = " ".join(repr(value).split())
    except Exception:  # what it is counts, not what is wrong with how it shows
        text = f"a {type(value).__name__}"
    return text if len(text) <= 100 else f"{text[:80]}..."
