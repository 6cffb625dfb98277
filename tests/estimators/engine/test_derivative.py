"""Random functions, compiled: NumPy's values, a row's own bits, and exact derivatives."""

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from estimators.engine import (
    NotTraceable,
    along,
    bits_float,
    compiled,
    float_bits,
    jacobian,
    machine,
)
from tests.estimators.engine.random_functions import EXACT, ROUNDED, RandomFunction

UNSIGNED = {"minimum", "clip", "largest", "in place", "sum", "cumulative"}
"""Of zeros of both signs NumPy's extremes are either; its sums of negative zeros begin with 0.0."""
SPECIAL = np.array([0.0, -0.0, np.inf, -np.inf, np.nan, 1e308, 5e-324, 0.5, 1.2, -1.5])


@pytest.fixture(autouse=True)
def _cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(machine, "folder", lambda: tmp_path)
    with np.errstate(all="ignore"):
        yield


def values_and_slopes(function: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """The compiled function that gives values and their derivatives to each entry of x."""
    return compiled(lambda x: (function(x), jacobian(function(x), x)))


def slope(function: Callable[[Any], Any], *at: float) -> Any:
    return values_and_slopes(function)(np.array(at))[1]


def differences(function: Callable[[Any], Any], x: np.ndarray, step: float) -> np.ndarray:
    """Central differences of sixth order ``(rows, m, n)``."""
    columns = []
    for h in step * np.eye(x.shape[-1]):
        steps = ((1, 45.0), (2, -9.0), (3, 1.0))
        columns.append(sum(w * (function(x + k * h) - function(x - k * h)) for k, w in steps))
    return np.stack(columns, -1) / (60.0 * step)


def distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distance of numbers: infinite if one of them is NaN or infinite and the other is not."""
    equal = (a == b) | (np.isnan(a) & np.isnan(b))
    return np.where(equal, 0.0, np.nan_to_num(np.abs(a - b), nan=np.inf))


def check_values(function: RandomFunction, found: np.ndarray, x: np.ndarray, exact: bool) -> None:
    """To the bit where each word is exact; else as near as rounding of each number allows."""
    expected = function(x.copy())
    names = {name for name, _ in function.steps}
    if exact:
        np.testing.assert_array_equal(found, expected, err_msg=str(function))
        signs = np.signbit(found) == np.signbit(expected)
        assert names & UNSIGNED or (signs | np.isnan(expected)).all(), function
        return
    rng = np.random.default_rng(0)

    def rounded(value: Any) -> Any:
        return value * (1.0 + 2.0**-50 * rng.uniform(-1.0, 1.0, value.shape))

    spread = np.max([distance(function(x, rounded), expected) for _ in range(3)], 0)
    allowed = 8.0 * spread + 4.0 * np.spacing(np.abs(expected))
    assert (distance(found, expected) <= np.nan_to_num(allowed)).all(), function


def check_slopes(
    function: RandomFunction, found: np.ndarray, x: np.ndarray, seen: Counter[str]
) -> None:
    def plain(x: np.ndarray) -> Any:
        return np.asarray(function(x)).reshape(len(x), -1)

    found = found.reshape(len(x), -1, function.n)
    coarse, fine = differences(plain, x, 1e-3), differences(plain, x, 7e-4)
    scale = 1.0 + np.abs(fine) + np.abs(plain(x))[..., None]
    smooth = np.abs(coarse - fine) < 1e-9 * scale  # elsewhere there is a kink, or a jump, beside it
    assert not (smooth & ~(np.abs(found - fine) < 1e-7 * scale)).any(), function
    seen["slopes"] += smooth.size
    seen["smooth"] += int(smooth.sum())


@pytest.mark.parametrize(
    "count",
    [pytest.param(60, marks=pytest.mark.slow), pytest.param(10_000, marks=pytest.mark.nightly)],
)
def test_random_functions_and_their_derivatives(count: int):
    seen: Counter[str] = Counter()
    for seed in range(count):
        rng, exact = np.random.default_rng(seed), seed % 2 == 0
        function = RandomFunction(rng, exact)
        names = {name for name, _ in function.steps}
        seen.update(names)
        both = values_and_slopes(function)
        ordinary = rng.normal(size=(17, function.n)) * 1.5
        values, slopes = both(ordinary)
        check_values(function, values, ordinary, exact)
        check_slopes(function, slopes, ordinary, seen)
        for row in (0, 8, 16):  # alone, or beside others: the last is no part of a whole vector
            for found, expected in zip(both(ordinary[row]), (values, slopes), strict=True):
                np.testing.assert_array_equal(found, expected[row])
        if exact and not (names & UNSIGNED and "copysign" in names):
            special = rng.choice(SPECIAL, (13, function.n))
            check_values(function, both(special)[0], special, exact)
    assert {*EXACT, *ROUNDED} <= set(seen)
    assert seen["smooth"] > 0.8 * seen["slopes"]


@pytest.mark.parametrize(
    ("function", "at", "expected"),
    [
        (lambda x: np.abs(x), [0.0], [1.0]),
        (lambda x: np.maximum(x[..., 0], x[..., 1]), [2.0, 1.0], [1.0, 0.0]),
        (lambda x: np.clip(x, -1.0, 1.0), [2.0], [0.0]),
        (lambda x: np.floor(x) * x, [2.5], [2.0]),
        # A branch that is not taken spoils no slope where its operand is guarded.
        (lambda x: np.where(x > 0.0, np.sqrt(np.where(x > 0.0, x, 1.0)), 0.0), [-1.0], [0.0]),
    ],
)
def test_a_kink_has_the_slope_of_its_side(
    function: Callable[[Any], Any], at: list[float], expected: list[float]
):
    np.testing.assert_array_equal(np.ravel(slope(function, *at)), expected)


def test_slopes_of_slopes():
    def first(x: Any) -> Any:
        return jacobian(np.exp(x[..., 0]) * x[..., 0], x)

    np.testing.assert_allclose(slope(first, 0.7), np.exp(0.7) * 2.7, rtol=1e-15)


def test_what_has_no_derivative_says_so():
    for function in (
        lambda x: bits_float(float_bits(x) + np.uint64(1)),
        lambda x: along(lambda a: [a * a], x)[0],
    ):
        with pytest.raises(NotTraceable, match="has no derivative"):
            slope(function, *np.ones(5))
