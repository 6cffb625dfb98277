"""Checks of users' functions: they get copies, repeat themselves and return finite values.

A function that writes into its arguments changes neither the truth, nor a belief, nor another row.
"""

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from estimators import Gaussian
from estimators.checks import numbers, short_repr
from vessel_gym.verified import is_verified

_ORDINARY = 1e9
"""Largest ordinary number in SI units; functions of larger ones may overflow."""


class Copying:
    """A function that is called with copies of its arguments.

    Args:
        function: Function of the user.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function = function

    def __call__(self, *arguments: Any) -> Any:
        """Result of the function."""
        return self.function(*map(copied, arguments))


_OBSERVED = ("observe", "observe_state", "observe_std", "observe_measurements", "observe_mission")
_NAMESAKES = (
    "parameters", "scenario", "prior", "reference", "commanded", "exogenous", "over", "effect",
    *_OBSERVED,
)  # fmt: skip
RETURNED: dict[str, tuple[str, ...]] = {name: (name,) for name in _NAMESAKES} | {
    "start": ("state", "actuators"), "actuate": ("actuators",), "step": ("state",),
    "known_input": ("known input",), "initial_score_state": ("score_state",),
    "score": ("reward", "end", "score_state"), "draw": ("drawn",), "effect_at": ("effect",),
}  # fmt: skip
"""Methods of vehicles, tasks and disturbances by name, and what each returns."""
_CONSTANT = ("parameters", "scenario", "commanded", "exogenous")
"""Arrays that may have one row for all."""


class CheckedMethods:
    """A user's object whose methods get copies and return checked arrays, one row per vehicle.

    Args:
        own: The user's vehicle, task or disturbance.
        **columns: Fixed numbers of columns of results, by the names in `RETURNED`.

    Attributes:
        title: Name of the object's class.
        columns: Numbers of columns by result; results that are not listed may have any number.
        steps: ``(B,)`` steps since the start, for error messages.
        ended: Mask ``(B,)`` of rows whose episode is over, None for no rows; these are not checked.
    """

    commanding = None
    """None: commands come from the user's method, not from columns of the reference."""

    def __init__(self, own: Any, **columns: int) -> None:
        self._own, self.title, self.columns = own, type(own).__name__, columns
        self.steps: np.ndarray = np.zeros(1, int)
        self.ended: np.ndarray | None = None

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._own, name)
        if not callable(value):
            return value
        method = copying(value)
        if name in RETURNED:
            method = partial(self._checked, name, method)
        setattr(self, name, method)
        return method

    def _checked(self, name: str, method: Callable[..., Any], *arguments: Any) -> Any:
        """Checked result of a method; an error names the method."""
        title = f"{name} of {self.title}"
        try:
            returned = method(*arguments)
        except ValueError as error:
            if "truth value of an array" not in str(error):
                raise
            raise ValueError(
                f"{title} must take several vehicles at once: use np.where for if, & for and"
            ) from error
        if name == "commanded" and returned is None:
            return None
        arrays = [each for each in arguments if isinstance(each, np.ndarray)]
        rows, what = len(arrays[0] if arrays else arguments[0].state), RETURNED[name]
        if name == "prior":
            if not isinstance(returned, Gaussian):
                raise TypeError(f"{title} must give a Gaussian, got {short_repr(returned)}")
            rows_of(title, returned.mean, rows, self.columns.get(name))
            return returned
        if len(what) == 1:
            return self._array(title, what[0], returned, rows, arrays)
        if not isinstance(returned, tuple | list) or len(returned) != len(what):
            raise ValueError(
                f"{title} must give {len(what)} arrays, {', '.join(what)}, got"
                f" {short_repr(returned)}"
            )
        read = arrays[:-1] if name == "score" else arrays
        return tuple(
            self._array(f"{title}, as the {part},", part, values, rows, read)
            for part, values in zip(what, returned, strict=True)
        )

    def _array(
        self, title: str, what: str, values: Any, rows: int, arguments: list[np.ndarray]
    ) -> np.ndarray:
        """Checked array of a result; only score states and observations may be infinite."""
        scalar = what in ("reward", "end", "over")
        columns, constant = self.columns.get(what), what in _CONSTANT
        array = rows_of(title, values, rows, columns, scalar, constant)
        if what == "over":
            return array != 0.0
        if what == "end":
            end, ends = array.astype(int), len(self._own.end_reasons)
            if (end != array).any() or end.min() < 0 or end.max() >= ends:
                raise ValueError(
                    f"score of {self.title} gave the numbers of end_reasons"
                    f" {short_repr(array.tolist())}: they must be whole and below {ends}"
                )
            return end
        if what in _OBSERVED:
            self.columns.setdefault(what, array.shape[1])
            return array
        ordinary = [each for each in arguments if each.ndim == 2]
        score: dict[str, Any] = {"sound": _not_nan, "wanted": "numbers everywhere"}
        kind = score if what == "score_state" else {}
        refuse_not_finite(title, array, self.steps, self.ended, *ordinary, **kind)
        return array


def _not_nan(values: np.ndarray) -> np.ndarray:
    return ~np.isnan(values)


def rows_of(
    title: str,
    values: Any,
    rows: int,
    columns: int | None = None,
    scalar: bool = False,
    constant: bool = False,
) -> np.ndarray:
    """Copy of a user's array in float64 and of shape ``(rows, columns)``, for compiled functions.

    Args:
        title: Name of the user's function.
        values: Array that the function returned.
        rows: B.
        columns: Number of columns; None for any number.
        scalar: Does the array have one number for each row? A single number then stands for all
            rows.
        constant: May one row stand for all?

    Raises:
        ValueError: for any other array.
    """
    array = numbers(values)
    if array is None:
        raise ValueError(f"{title} must give an array of real numbers, got {short_repr(values)}")
    columns = array.shape[-1] if columns is None and array.ndim else columns
    shape = (rows,) if scalar else (rows, columns)
    if array.shape == () if scalar else constant and array.shape == (1, columns):
        return np.array(np.broadcast_to(array, shape))  # type: ignore[arg-type]
    if array.shape != shape:
        each = (
            "one number"
            if scalar
            else "a row"
            if columns is None
            else f"a row of {columns} numbers"
        )
        raise ValueError(
            f"{title} must give {each} for each vehicle: for {rows} it gave shape {array.shape}"
        )
    return np.array(array, order="C")


def copying(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function itself if it is verified, otherwise `Copying` of the function."""
    return function if is_verified(function) else Copying(function)


def copied(value: Any) -> Any:
    """Copy of an array (in its memory order), or of a mapping or dataclass of arrays."""
    if isinstance(value, np.ndarray):
        return value.copy("K")
    if isinstance(value, Mapping):
        return {key: copied(each) for key, each in value.items()}
    if is_dataclass(value) and not isinstance(value, type):
        return replace(
            value, **{each.name: copied(getattr(value, each.name)) for each in fields(value)}
        )
    return value


def repeated(name: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """Value of a function that is called twice, on copies.

    Filters call functions more than once a step, and copies of an environment call them again.

    Raises:
        ValueError: if the two values differ.
    """
    with np.errstate(all="ignore"):
        first, second = (Copying(function)(*arguments) for _ in range(2))
    if not _alike(first, second):
        raise ValueError(
            f"{name} gave two values for the same arguments: it must depend on these alone, without"
            " random numbers, clocks or counters of its own"
        )
    return first


def _alike(one: Any, other: Any) -> bool:
    if isinstance(one, tuple):
        return isinstance(other, tuple) and all(map(_alike, one, other))
    try:
        return np.array_equal(one, other, equal_nan=True)
    except TypeError:  # objects that cannot be compared
        return True


def refuse_not_finite(
    name: str, values: np.ndarray, steps: np.ndarray, ended: np.ndarray | None,
    *arguments: np.ndarray, sound: Callable[[np.ndarray], np.ndarray] = np.isfinite,
    wanted: str = "finite numbers everywhere",
) -> None:  # fmt: skip
    """Refuse values ``(B, ...)`` that are not finite while the arguments ``(B, k)`` are ordinary.

    A diverged vehicle or belief is not an error of the function.

    Args:
        name: Name of the function.
        values: Values that the function returned.
        steps: ``(B,)`` steps since the start.
        ended: Mask ``(B,)`` of rows whose episode is over; None for no rows.
        arguments: Arguments of the function.
        sound: Test of accepted values.
        wanted: Words for accepted values.

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
        where = f"at step {steps[row]} in row {row}"
        raise ValueError(
            f"{name} gave {short_repr(values[row].tolist())} {where}: it must give {wanted}"
        )
