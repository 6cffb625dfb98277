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
        if self.compared or (rows := self._rows(arguments)) is None:
            return
        given = [each for each in rows if each is not None]
        size = max((np.abs(each).max(initial=0.0) for each in given), default=0.0)
        plain = self.function.function if isinstance(self.function, Compiled) else self.function
        with np.errstate(all="ignore"):
            together, again = (self._value(plain, rows) for _ in range(2))
            alone = []
            for i in range(len(given[0]) if given else 1):
                alone.append(self._value(plain, [a if a is None else a[i, 0] for a in rows]))
                self._check_shape(alone[-1].shape)
            if not np.array_equal(together, again, equal_nan=True):
                raise ValueError(
                    f"{self.name} gave two values for the same arguments: it must depend on these"
                    " alone, without random numbers, clocks or counters of its own"
                )
            expected = np.stack(alone)[:, None]
            if together.ndim == len(self.shape) == 2:  # a matrix for all rows
                together = np.broadcast_to(together, expected.shape)
            if not _close(together, expected, size):
                raise ValueError(self._of_leading_axes())
            if plain is not self.function and not _close(self.function(*rows), together, size):
                raise ValueError(
                    f"{self.name} gives other values compiled than in NumPy: what is compiled must"
                    " be pure, and keeps what it read when it was traced"
                )
        if self.check is not None:
            self.check(alone[0])
        self.compared = True

    def _rows(self, arguments: tuple[np.ndarray | None, ...]) -> list[Any] | None:
        """Rows ``(k, 1, n)`` near the first finite ones, k no other size; None if none is."""
        given = [each for each in arguments if each is not None]
        leading = np.broadcast_shapes(*(each.shape[:-1] for each in given))
        widths = [each.shape[-1] for each in given]
        flat = [np.broadcast_to(a, leading + a.shape[-1:]).reshape(-1, a.shape[-1]) for a in given]
        finite = np.isfinite(np.concatenate(flat, -1)).all(-1) if given else np.ones(1, bool)
        if not finite.any():
            return None
        count = next(k for k in range(3, 99) if k not in {*self.shape, *widths})
        apart = np.random.default_rng(0).uniform(0.0, _NEAR, (count, 1, max(widths, default=0)))
        apart[0] = 0.0
        row = (each[np.argmax(finite)] for each in flat)
        near = (a + np.where(a, a, 1.0) * apart[..., : len(a)] for a in row)  # of the same signs
        return [None if each is None else read_only(next(near)) for each in arguments]

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
    plain = function.function if isinstance(function, Compiled) else function
    plain = plain.func if isinstance(plain, partial) else plain
    return str(getattr(plain, "__module__", "")).split(".")[0] in _OWN


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
