"""Check of users' functions at first use: several rows must give the same as each row alone."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from operator import is_not
from typing import Any

import numpy as np

from estimators.checks import short_repr
from estimators.engine import Compiled, is_traced

_NEAR, _GOLDEN = 2.0**-10, 0.5 * (5.0**0.5 - 1.0)
_OWN = "estimators", "vessel_gym"


@dataclass(eq=False)
class FirstUse:
    """A function of a model, checked at the first arguments that are finite.

    Attributes:
        name: Name of the function in its model.
        function: The user's function of vectors ``(..., n)``, compiled or not.
        shape: Shape of a row's value; None is any length.
        of_state: Is it a function of ``(x, u)``? Otherwise of ``u``.
        check: Check of the first value.
    """

    name: str
    function: Callable[..., Any]
    shape: tuple[int | None, ...]
    of_state: bool = True
    check: Callable[[np.ndarray], object] | None = None
    compared: bool = False

    def __call__(self, *arguments: Any) -> Any:
        """The function's value at arrays or at tracers."""
        if not (self.compared or any(map(is_traced, arguments))):
            self.compare(*arguments)
        return self.function(*arguments)

    @np.errstate(all="ignore")
    def compare(self, *arguments: np.ndarray | None) -> None:
        """Check the values of rows near the first finite one, unless they have been checked.

        Raises:
            ValueError: naming the function, if rows depend on each other, values have another
                shape, differ from call to call, or differ compiled; or if it writes into its
                arguments.
            TypeError: naming the function, if it does not compute with such arrays.
        """
        if self.compared or (candidates := self._rows(arguments)) is None:
            return
        compiled = isinstance(self.function, Compiled)
        plain = self.function.function if compiled else self.function  # type: ignore[attr-defined]
        try:
            rows, found = candidates[0], self._values(plain, candidates[0])
        except Exception:  # beyond the given point the function may have no values
            rows, found = candidates[1], self._values(plain, candidates[1])
        together, again, alone = found
        if not _equal(together, again):
            raise ValueError(
                f"{self.name} gave two values for the same arguments: it must depend on these"
                " alone, without random numbers, clocks or counters of its own"
            )
        sizes = list[float]()
        for each in (alone, *filter(_given, rows)):
            numbers = np.abs(each[np.isfinite(each)])
            sizes.append(np.maximum.reduce(numbers, initial=0.0))
        tolerance = max(1e-9, 64.0 * rounding(alone)) * sizes[0] + 1e-13 * max(sizes)
        if together.shape == alone.shape[2:] and len(self.shape) == 2:  # one for all rows
            together = together + np.zeros(alone.shape)
        if not _equal(together, alone, tolerance):
            raise ValueError(self._of_leading_axes())
        if compiled and not _equal(self.function(*rows), alone, tolerance):
            raise ValueError(
                f"{self.name} gives other values compiled than in NumPy: what is compiled must"
                " be pure, and keeps what it read when it was traced"
            )
        if self.check is not None:
            self.check(alone[0, 0])
        self.compared = True

    def _rows(self, arguments: tuple[np.ndarray | None, ...]) -> list[Any] | None:
        """Rows ``(k, 2, n)`` near and far from the first finite one, and rows equal to it.

        k differs from all other sizes. None if no row is finite.
        """
        finite: Any = np.True_
        sizes = {*self.shape}
        each: Any
        for each in filter(_given, arguments):
            finite = finite & np.logical_and.reduce(np.isfinite(each), -1)
            sizes.add(each.shape[-1])
        if not np.logical_or.reduce(finite, None):
            return None
        count, pairs = min({3, 4, 5, 6, 7, 8} - sizes), []
        for each in arguments:
            near: Any = None
            far: Any = None
            if each is not None:
                width = each.shape[-1]
                batch = each + np.zeros((*finite.shape, 1))
                row = batch.reshape(-1, width)[finite.argmax()]
                apart = _NEAR * (_GOLDEN * np.arange(count * width).reshape(count, width) % 1.0)
                apart[0] = 0.0
                near = row + (row + (row == 0.0)) * apart  # of the same signs
                near = np.array([near, 0.5 - 1.5 * near]).swapaxes(0, 1)
                far = row + np.zeros(near.shape)
                near.setflags(write=False)
                far.setflags(write=False)
            pairs.append((near, far))
        return [*zip(*pairs, strict=True)]

    def _values(self, function: Callable[..., Any], rows: Sequence[Any]) -> tuple[np.ndarray, ...]:
        """Values of rows together, twice, and alone."""
        together, again = self._value(function, rows), self._value(function, rows)
        count = max(map(len, filter(_given, rows)), default=1)
        alone, single = [], list[Any]()
        for each in rows:
            none = each is None
            single.append([None] * 2 * count if none else [*each.reshape(-1, each.shape[-1])])
        for row in zip(*single, strict=True):
            value = self._value(function, row)
            known = None not in self.shape
            expected = self.shape if known else (*self.shape[:-1], *value.shape[-1:])
            if value.shape != expected:
                raise ValueError(
                    f"{self.name} gave shape {value.shape} for one row, expected {expected}"
                )
            alone.append(value)
        return together, again, np.array(alone).reshape(count, 2, *value.shape)

    def _value(self, function: Callable[..., Any], arguments: Sequence[Any]) -> np.ndarray:
        try:
            value = function(*arguments)
        except TypeError as error:
            given = "x, u" if self.of_state else "u"
            raise TypeError(
                f"{self.name} fails: {error}; as a function of ({given}) it gets arrays, as np.sin"
                " takes them, and None for a u that is not given"
            ) from error
        except (ValueError, IndexError) as error:
            wrong = f"{self._of_leading_axes()} ({' '.join(str(error).split())[:100]})"
            if "read-only" in str(error):
                wrong = (
                    f"{self.name} writes into an array that it is given: work on a copy, as of"
                    " np.array(x)"
                )
            raise ValueError(wrong) from error
        if isinstance(value, list | tuple) or np.asarray(value).dtype.kind not in "fiub":
            raise ValueError(
                f"{self.name} must return an array of real numbers, such as np.stack([...],"
                f" axis=-1) of its components, got {short_repr(value)}"
            )
        return np.asarray(value)

    def _of_leading_axes(self) -> str:
        return (
            f"{self.name} must broadcast over leading axes, and give each row what it gives it"
            " alone: index and sum from behind, as x[..., 0]"
        )


def is_own(function: Any) -> bool:
    """Is it a function of this package, which its tests check?"""
    plain = function.function if isinstance(function, Compiled) else function
    plain = plain.func if isinstance(plain, partial) else plain
    return str(getattr(plain, "__module__", "")).split(".")[0] in _OWN


def rounding(array: np.ndarray) -> float:
    """Relative rounding of the numbers of an array; whole numbers count as float64."""
    return float(np.spacing(array.dtype.type(1)))


_given = partial(is_not, None)


def _equal(found: np.ndarray, expected: np.ndarray, tolerance: float = 0.0) -> bool:
    """Are arrays equal but for a tolerance?"""
    if found.shape != expected.shape:
        return False
    equal = (found == expected) | (np.abs(found - expected) <= tolerance)
    return bool(np.logical_and.reduce(equal | (np.isnan(found) & np.isnan(expected)), None))
