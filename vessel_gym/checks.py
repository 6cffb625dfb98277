"""Checks of arguments, each with an error message of one sentence."""

import math
from collections.abc import Collection, Mapping
from functools import partial
from typing import Any

import numpy as np

from estimators.checks import AT_LEAST_0, UP_TO_1, number, numbers, short_repr
from estimators.engine import Compiled
from estimators.factory import unknown

LARGEST = 1e15
"""Bound of numbers in SI units; larger ones are no quantities of a vehicle, a sea or a time."""
_DEGREES = "in radians (np.deg2rad makes them of degrees)"
RANGES = {
    "positive": (0.0, LARGEST, "a number above 0"),
    "not_negative": (AT_LEAST_0, LARGEST, "a number of at least 0"),
    "finite": (-LARGEST, LARGEST, "a finite number"),
    "share": (AT_LEAST_0, UP_TO_1, "a number from 0 to 1"),
    "direction": (-6.3, 6.3, f"an angle of at most one turn, {_DEGREES}"),
    "deflection": (-1.6, 1.6, f"an angle of at most a quarter of a turn, {_DEGREES}"),
}
"""Kinds of numbers: exclusive lower and upper bounds, and words for the error message."""


def check_numbers(of: object, values: Mapping[str, object] | None = None, **kinds: str) -> None:
    """Refuse numbers out of range.

    Args:
        of: A record with the numbers, or a title for the error message.
        values: Numbers by name, if ``of`` is a title.
        **kinds: Names of numbers, separated by spaces, by their kind in `RANGES`; a number whose
            name has a question mark may be None.

    Raises:
        ValueError: naming the number and its range.
    """
    title = of if isinstance(of, str) else type(of).__name__
    for kind, names in kinds.items():
        low, high, what = RANGES[kind]
        for name in names.split():
            value = getattr(of, name.rstrip("?")) if values is None else values[name.rstrip("?")]
            if value is not None or not name.endswith("?"):
                number(f"{name.rstrip('?')} of {title}", value, low, high, what)


def check_pair(name: str, value: object) -> None:
    """Refuse anything but two ordered numbers above 0.

    Raises:
        ValueError: naming the argument.
    """
    pair = numbers(value)
    if pair is None or pair.shape != (2,) or not 0.0 < pair[0] <= pair[1] < LARGEST:
        raise ValueError(f"{name} must be (least, greatest), both above 0, got {short_repr(value)}")


def instance(name: str, value: object, kind: type) -> None:
    """Refuse an object of another class.

    Raises:
        TypeError: naming the argument and the class.
    """
    if not isinstance(value, kind):
        raise TypeError(f"{name} must be of class {kind.__name__}, got {short_repr(value)}")


def one_of(kind: str, value: object, known: Collection[str]) -> str:
    """The value, if it is one of the known names.

    Raises:
        ValueError: for any other value, listing the known names.
    """
    if isinstance(value, str) and value in known:
        return value
    raise ValueError(unknown(kind, value, known))


def all_are(kind: type, values: object) -> bool:
    """Are values a tuple or list of objects of a class?"""
    return isinstance(values, tuple | list) and all(isinstance(each, kind) for each in values)


def check_names(name: str, value: object) -> None:
    """Refuse anything but a tuple or list of strings; one string would pass as its letters.

    Raises:
        TypeError: naming the argument.
    """
    if not all_are(str, value):
        raise TypeError(f"{name} must be a tuple of names, got {short_repr(value)}")


def function(name: str, value: object, of: str) -> None:
    """Refuse an object that cannot be called.

    Raises:
        TypeError: for anything but a function or None.
    """
    if value is not None and not callable(value):
        raise TypeError(f"{name} must be a function of {of}, got {short_repr(value)}")


def options(name: str, value: object) -> dict[str, Any]:
    """Copy of a dictionary of options; empty for None.

    Raises:
        TypeError: for anything but a mapping from strings, or None.
    """
    if value is None:
        return {}
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise TypeError(
            f"{name} must be a dictionary of values by name, or None, got {short_repr(value)}"
        )
    return dict(value)


def is_integer(value: object) -> bool:
    """Is a value a whole number? NumPy's integers are; True and 2.0 are not."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def is_compiled(part: Any) -> bool:
    """Is a part or function decorated ``@compiled``? A method is compiled if its object is.

    A disturbance with another one ``beside`` it is compiled if both are. The decorator of a class
    does not count for its subclasses, which may override methods in NumPy.
    """
    part = part.func if isinstance(part, partial) else part
    if isinstance(part, Compiled):
        return True
    part = getattr(part, "__self__", part)
    beside = getattr(part, "beside", None)
    return vars(type(part)).get("compiled", False) and (beside is None or is_compiled(beside))


_BOUNDS = np.array(-1.0), np.array(1.0)  # arrays take less time than Python's numbers
_FEW = 4  # so many numbers take less time in Python than in NumPy


def checked_action(
    action: Any, shape: tuple[int, ...], ended: np.ndarray | None = None
) -> np.ndarray:
    """Action ``(B, a)`` in float64, clipped to [-1, 1], and 0 where an episode has ended.

    Raises:
        ValueError: for another shape, or values that are not finite.
    """
    asked = action if type(action) is np.ndarray and action.dtype.kind == "f" else numbers(action)
    if asked is None:
        raise ValueError(f"action must be an array of numbers, got {short_repr(action)}")
    if asked.shape != shape:
        raise ValueError(f"action has shape {asked.shape}, expected {shape}")
    checked = np.array(asked, float, order="C", ndmin=2)
    if ended is not None:
        checked[ended] = 0.0
    if checked.size <= _FEW and len(checked) == 1:  # a loop takes a third of NumPy's time
        for each in checked[0].tolist():
            if not -1.0 <= each <= 1.0:
                break
        else:
            return checked
    # The sum of squares is finite if all numbers are, unless it overflows; it takes a fifth of the
    # time of checking each number.
    if not math.isfinite(np.vdot(checked, checked)) and not np.isfinite(checked).all():
        raise ValueError("action must be finite, got NaN or infinity")
    np.maximum(checked, _BOUNDS[0], out=checked)  # these take half the time of `numpy.clip`
    return np.minimum(checked, _BOUNDS[1], out=checked)


_ORDINARY = 1e9
"""Largest ordinary number in SI units; functions of larger ones may overflow."""


def refuse_not_finite(
    method: str, values: np.ndarray, steps: np.ndarray, ended: np.ndarray | None,
    *arguments: np.ndarray,
) -> None:  # fmt: skip
    """Refuse results ``(B, ...)`` of a user's method that are not finite.

    Rows are exempt if their episode is over, or if arguments ``(B, k)`` are not ordinary: a
    diverged vehicle or belief is not an error of the method.

    Raises:
        ValueError: naming the method, the step and the row.
    """
    if math.isfinite(values.sum()):  # a tenth of the time of what follows
        return
    bad = ~np.isfinite(values).reshape(len(values), -1).all(-1)
    for each in arguments:
        bad &= (np.abs(each) < _ORDINARY).all(-1)
    if ended is not None:
        bad &= ~ended
    if bad.any():
        row = int(np.argmax(bad))
        raise ValueError(
            f"{method} gave {short_repr(values[row].tolist())} at step {steps[row]} in row {row}:"
            " it must give finite numbers"
        )
