"""What arguments may be, and the sentence that answers one that may not."""

import inspect
from collections.abc import Callable, Collection, Mapping
from typing import Any

import numpy as np

from estimators.checks import shown
from estimators.factory import unknown


def one_of(kind: str, value: object, known: Collection[str]) -> str:
    """A value that is one of the known names.

    Raises:
        ValueError: if it is none, saying which there are.
    """
    if isinstance(value, str) and value in known:
        return value
    raise ValueError(unknown(kind, value, known))


def options(name: str, value: object) -> dict[str, Any]:
    """A copy of options by name; None: none.

    Raises:
        TypeError: if they are not a mapping from strings.
    """
    if value is None:
        return {}
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise TypeError(f"{name} must be a dictionary of values by name, or None, got {shown(value)}")
    return dict(value)


def no_others(name: str, function: Callable[..., Any], others: Mapping[str, object]) -> None:
    """Refuse arguments that a function collects only to say that it does not have them.

    Raises:
        TypeError: naming the first, and those that there are.
    """
    for other in others:
        listed = inspect.signature(function).parameters.values()
        known = [parameter.name for parameter in listed if parameter.kind is not parameter.VAR_KEYWORD]
        raise TypeError(unknown(f"argument of {name}", other, known))


def number(value: object) -> float:
    """A number as float; NaN for anything else, infinity for one that is too large."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        return np.nan
    try:
        return float(value)
    except OverflowError:
        return np.inf


def numbers(value: object) -> np.ndarray | None:
    """An array of real numbers as floats, or None."""
    try:
        array = np.asarray(value)
        return array.astype(float, copy=False) if array.dtype.kind in "fiub" else None
    except (TypeError, ValueError):
        return None
