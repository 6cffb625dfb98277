"""Users' functions at their first use: several rows are compared with each row alone, twice."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from estimators.checks import as_array, read_only
from estimators.engine.compiled import Compiled
from estimators.engine.matrices import is_traced

_NEAR = 2.0**-10
_OWN = "estimators", "vessel_gym"


@dataclass(eq=False)
class FirstUse:
    """A function of a model, compared at the first arguments that are finite.

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

    def compare(self, *arguments: np.ndarray | None) -> None:
        """Compare the values of rows near the first finite one, unless it has been done.

        Raises:
            ValueError: naming the function, if rows depend on each other, values have another
                shape, differ from call to call, or differ compiled; or if it writes into its
                arguments.
            TypeError: naming the function, if it does not compute with such arrays.
        """
        if self.compared or (candidates := self._rows(arguments)) is None:
            return
        plain = _undecorated(self.function)
        with np.errstate(all="ignore"):
            rows, together, again, alone = self._evaluate(plain, candidates)
            if not np.array_equal(together, again, equal_nan=True):
                raise ValueError(
                    f"{self.name} gave two values for the same arguments: it must depend on these"
                    " alone, without random numbers, clocks or counters of its own"
                )
            size = max((np.abs(a).max(initial=0.0) for a in rows if a is not None), default=0.0)
            if together.shape == alone.shape[2:] and len(self.shape) == 2:  # one for all rows
                together = np.broadcast_to(together, alone.shape)
            if not _close(together, alone, size):
                raise ValueError(self._of_leading_axes())
            if plain is not self.function and not _close(self.function(*rows), together, size):
                raise ValueError(
                    f"{self.name} gives other values compiled than in NumPy: what is compiled must"
                    " be pure, and keeps what it read when it was traced"
                )
        if self.check is not None:
            self.check(alone[0, 0])
        self.compared = True

    def _rows(self, arguments: tuple[np.ndarray | None, ...]) -> list[list[Any]] | None:
        """Rows ``(k, 2, n)``, k no other size: near and far from the first finite ones, or these.

        None if none is finite.
        """
        given = [each for each in arguments if each is not None]
        leading = np.broadcast_shapes(*(each.shape[:-1] for each in given))
        widths = [each.shape[-1] for each in given]
        flat = [np.broadcast_to(a, leading + a.shape[-1:]).reshape(-1, a.shape[-1]) for a in given]
        finite = np.isfinite(np.concatenate(flat, -1)).all(-1) if given else np.ones(1, bool)
        if not finite.any():
            return None
        count = next(k for k in range(3, 99) if k not in {*self.shape, *widths})
        apart = np.random.default_rng(0).uniform(0.0, _NEAR, (count, max(widths, default=0)))
        apart[0] = 0.0
        around, same = [], []
        for each in flat:
            row = each[np.argmax(finite)]
            near = row + np.where(row, row, 1.0) * apart[:, : len(row)]  # of the same signs
            around.append(np.stack([near, 0.5 - 1.5 * near], 1))
            same.append(np.broadcast_to(row, (count, 2, len(row))).copy())
        return [
            [None if a is None else read_only(next(rows)) for a in arguments]
            for rows in (iter(around), iter(same))
        ]

    def _evaluate(self, function: Callable[..., Any], candidates: list[list[Any]]) -> Any:
        """Rows, their values together, twice, and alone; of the first rows that have values."""
        around, same = candidates
        try:
            return around, *self._values(function, around)
        except Exception:  # beyond the given point the function may have no values
            return same, *self._values(function, same)

    def _values(self, function: Callable[..., Any], rows: list[Any]) -> tuple[np.ndarray, ...]:
        together, again = (self._value(function, rows) for _ in range(2))
        leading = next((each.shape[:2] for each in rows if each is not None), (1, 1))
        alone = [
            self._value(function, [a if a is None else a[index] for a in rows])
            for index in np.ndindex(leading)
        ]
        for each in alone:
            self._check_shape(each.shape)
        return together, again, np.stack(alone).reshape(leading + alone[0].shape)

    def _value(self, function: Callable[..., Any], arguments: list[Any]) -> np.ndarray:
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
        if isinstance(value, list | tuple):
            raise ValueError(
                f"{self.name} must return an array, not a list: np.stack([...], axis=-1) of its"
                " components"
            )
        as_array(f"what {self.name} returns", value)
        return np.asarray(value)

    def _check_shape(self, shape: tuple[int, ...]) -> None:
        fits = (size in (None, n) for size, n in zip(self.shape, shape, strict=False))
        if len(shape) != len(self.shape) or not all(fits):
            wanted = ", ".join("m" if size is None else str(size) for size in self.shape)
            raise ValueError(
                f"{self.name} gave a matrix of shape {shape}, expected (..., {wanted})"
                if len(self.shape) == 2
                else f"{self._of_leading_axes()} (one row gave shape {shape}, expected ({wanted},))"
            )

    def _of_leading_axes(self) -> str:
        return (
            f"{self.name} must broadcast over leading axes, and give each row what it gives it"
            " alone: index and sum from behind, as x[..., 0]"
        )


def is_own(function: Any) -> bool:
    """Is it a function of this package, which tests compare?"""
    plain = _undecorated(function)
    plain = plain.func if isinstance(plain, partial) else plain
    return str(getattr(plain, "__module__", "")).split(".")[0] in _OWN


def _undecorated(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function in NumPy, compiled or not."""
    return function.function if isinstance(function, Compiled) else function


def rounding(array: np.ndarray) -> float:
    """Relative rounding of the numbers of an array; whole numbers count as float64."""
    return float(np.finfo(np.result_type(array.dtype, np.float16)).eps)


def _close(found: np.ndarray, expected: np.ndarray, size: float) -> bool:
    """Are arrays equal but for the rounding of them, and of arguments of a size?"""
    if found.shape != expected.shape:
        return False
    largest = np.abs(expected[np.isfinite(expected)]).max(initial=0.0)
    tolerance = max(1e-9, 64.0 * rounding(expected)) * largest + 1e-13 * size
    return np.allclose(found, expected, rtol=0.0, atol=tolerance, equal_nan=True)
