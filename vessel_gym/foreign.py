"""Functions that users write: they are handed copies, must repeat themselves, and may give nothing that is not finite.

A function that writes where it reads changes neither the truth, nor a belief, nor another row.
"""

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from estimators.checks import shown

_ORDINARY = 1e9
"""Beyond this, in SI units, a vehicle or a belief has run away, and what is computed of it may overflow."""


class Copying:
    """A function on copies of the arrays that it is handed.

    Args:
        function: The user's.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function = function

    def __call__(self, *arguments: Any) -> Any:
        """What the function gives."""
        return self.function(*map(copied, arguments))


class CopyingMethods:
    """An object whose methods are `Copying`.

    Args:
        own: The user's vehicle or task.
    """

    def __init__(self, own: Any) -> None:
        self._own = own

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._own, name)
        if not callable(value):
            return value
        method = Copying(value)
        setattr(self, name, method)
        return method


def ours(part: Any) -> bool:
    """Is a function, or the class of an object, part of this package, and all that it stands beside?"""
    part = part.func if isinstance(part, partial) else part
    beside = getattr(part, "beside", None)
    return str(getattr(part, "__module__", "")).startswith("vessel_gym.") and (beside is None or ours(beside))


def copying(function: Callable[..., Any], owner: Any = None) -> Callable[..., Any]:
    """The function itself if it, or its owner, is `ours`, and otherwise on copies."""
    return function if ours(function if owner is None else owner) else Copying(function)


def copied(value: Any) -> Any:
    """A copy of an array, laid out alike in memory, or of a mapping or a record of arrays; anything else as it is."""
    if isinstance(value, np.ndarray):
        return np.array(value)
    if isinstance(value, Mapping):
        return {key: copied(each) for key, each in value.items()}
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **{each.name: copied(getattr(value, each.name)) for each in fields(value)})
    return value


def repeated(name: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """The value of a function that is called twice, on copies.

    Filters call functions more than once a step, and copies of an environment call them anew.

    Raises:
        ValueError: if the second value is another one.
    """
    with np.errstate(all="ignore"):
        first, second = (Copying(function)(*arguments) for _ in range(2))
    if not _alike(first, second):
        raise ValueError(
            f"{name} gave two values for the same arguments: it must depend on these alone, without random numbers, "
            "clocks or counters of its own"
        )
    return first


def _alike(one: Any, other: Any) -> bool:
    if isinstance(one, tuple):
        return isinstance(other, tuple) and all(map(_alike, one, other))
    try:
        return np.array_equal(one, other, equal_nan=True)
    except TypeError:  # objects, of which nobody knows when they are alike
        return True


def refuse_not_finite(
    name: str, values: np.ndarray, steps: np.ndarray, ended: np.ndarray | None, *arguments: np.ndarray, first: int = 0,
    sound: Callable[[np.ndarray], np.ndarray] = np.isfinite, wanted: str = "finite numbers everywhere",
) -> None:  # fmt: skip
    """Refuse values ``(B, ...)`` that are not finite though the arguments ``(B, k)`` are ordinary numbers.

    Numerical trouble of a vehicle or a belief that has run away is no mistake of a function.

    Args:
        name: The function's.
        values: What it gave.
        steps: ``(B,)`` since the start.
        ended: Mask ``(B,)`` of rows whose episode is over; None: none.
        arguments: What it was given.
        first: The number of the first row.
        sound: Which values are accepted,
        wanted: and what they are called.

    Raises:
        ValueError: naming the function, the step and the row.
    """
    bad = ~sound(values).reshape(len(values), -1).all(-1)
    for each in arguments if bad.any() else ():
        bad &= (np.abs(each) < _ORDINARY).all(-1)
    if ended is not None:
        bad &= ~ended
    if bad.any():
        row = int(np.argmax(bad))
        where = f"at step {steps[row]} in row {first + row}"
        raise ValueError(f"{name} gave {shown(values[row].tolist())} {where}: it must give {wanted}")
