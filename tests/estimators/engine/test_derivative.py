"""Random functions traced and compiled: values are NumPy's, and derivatives those of differences."""

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from estimators.engine import NotTraceable, compiled, jacobian, machine, repeat
from estimators.engine.arrays import TracedArray, entries
from estimators.engine.compiled import trace
from estimators.engine.foreign import compare
from estimators.engine.function import Argument
from estimators.engine.interpret import interpret
from tests.estimators.engine.random_functions import EXACT, ROUNDED, RandomFunction

UNSIGNED = ("maximum", "minimum", "clip", "largest", "in place", "sum", "cumulative")
"""Of zeros of both signs NumPy's extremes are either, from lane to lane; its sums of negative zeros begin with 0.0."""
SPECIAL = np.array([0.0, -0.0, np.inf, -np.inf, np.nan, 1e308, 5e-324, 0.5, 1.2, -1.5])


@pytest.fixture(autouse=True)
def _cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(machine, "folder", lambda: tmp_path)
    with np.errstate(all="ignore"):
        yield


def slopes(function: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """A function's values, one after the other, and their derivatives to each entry of x."""

    def both(x: Any) -> Any:
        values = TracedArray.of(entries(function(x), x.flat[0].program))
        return values, jacobian(values, x)

    return both


def slope(function: Callable[[Any], Any], *at: float) -> np.ndarray:
    return compiled(slopes(function))(np.array(at))[1]  # type: ignore[no-any-return]


def differences(function: Callable[[Any], Any], x: np.ndarray, step: float) -> np.ndarray:
    """Central differences of sixth order ``(rows, m, n)``."""
    columns = []
    for j in range(x.shape[-1]):
        h = np.zeros(x.shape[-1])
        h[j] = step
        total: Any = 0.0
        for k, weight in ((1, 45.0), (2, -9.0), (3, 1.0)):
            total = total + weight * (function(x + k * h) - function(x - k * h))
        columns.append(total / (60.0 * step))
    return np.stack(columns, -1)


def check(
    function: RandomFunction, rng: np.random.Generator, exact: bool, seen: Counter[str]
) -> None:
    """One function: its values for ordinary and special numbers, and its derivatives for ordinary ones."""
    seen.update(name for name, _ in function.steps)
    ordinary = rng.normal(size=(17, function.n)) * 1.5
    special = rng.choice(SPECIAL, (13, function.n))
    traced, _ = trace(function, [Argument((function.n,))])
    both, _ = trace(slopes(function), [Argument((function.n,))])
    names = {name for name, _ in function.steps}
    unsigned = not names.isdisjoint(UNSIGNED)
    for x in (
        (ordinary, special) if exact and not (unsigned and "copysign" in names) else (ordinary,)
    ):
        expected = function(x.copy())
        found = both.compute([x])[0].reshape(expected.shape)
        if exact:
            signs = unsigned | (np.signbit(found) == np.signbit(expected))
            same = (found == expected) & signs | (found != found) & (expected != expected)
            assert same.all(), (function, x[~same.reshape(len(x), -1).all(-1)])
        else:
            noisy = [interpret(traced, [x], 2.0**-50, rng)[0] for _ in range(3)]
            compare(found, expected, noisy)
    _, found = both.compute([ordinary])

    def plain(x: np.ndarray) -> np.ndarray:
        return np.asarray(function(x)).reshape(len(x), -1)  # type: ignore[no-any-return]

    coarse, fine = differences(plain, ordinary, 1e-3), differences(plain, ordinary, 7e-4)
    scale = 1.0 + np.abs(fine) + np.abs(plain(ordinary))[..., None]
    smooth = (
        np.abs(coarse - fine) < 1e-9 * scale
    )  # elsewhere there is a kink, or a jump, next to it
    wrong = smooth & ~(np.abs(found - fine) < 1e-7 * scale)
    assert not wrong.any(), (function, ordinary[wrong.any((1, 2))], found[wrong], fine[wrong])
    seen["slopes"] += smooth.size
    seen["smooth"] += int(smooth.sum())


@pytest.mark.parametrize(
    "count",
    [pytest.param(120, marks=pytest.mark.slow), pytest.param(10_000, marks=pytest.mark.nightly)],
)
def test_random_functions_and_their_derivatives(count: int):
    seen: Counter[str] = Counter()
    for seed in range(count):
        rng = np.random.default_rng(seed)
        exact = seed % 2 == 0
        check(RandomFunction(rng, exact), rng, exact, seen)
    assert {*EXACT, *ROUNDED} <= set(seen)
    assert seen["smooth"] > 0.8 * seen["slopes"]


def test_a_kink_has_the_slope_of_its_side():
    assert slope(lambda x: np.abs(x[..., 0]), 0.0) == 1.0
    assert slope(lambda x: np.abs(x[..., 0]), -2.0) == -1.0
    np.testing.assert_array_equal(
        slope(lambda x: np.maximum(x[..., 0], x[..., 1]), 2.0, 1.0), [[1.0, 0.0]]
    )
    np.testing.assert_array_equal(
        slope(lambda x: np.minimum(x[..., 0], x[..., 1]), 2.0, 1.0), [[0.0, 1.0]]
    )
    np.testing.assert_array_equal(slope(lambda x: np.clip(x[..., 0], -1.0, 1.0), 2.0), [[0.0]])
    np.testing.assert_array_equal(slope(lambda x: np.floor(x[..., 0]) * x[..., 0], 2.5), [[2.0]])


def test_a_branch_that_is_not_taken_spoils_no_slope_where_it_is_guarded():
    def safe(x: Any) -> Any:
        positive = x[..., 0] > 0.0
        return np.where(positive, np.sqrt(np.where(positive, x[..., 0], 1.0)), 0.0)

    np.testing.assert_array_equal(slope(safe, -1.0), [[0.0]])
    np.testing.assert_array_equal(slope(safe, 4.0), [[0.25]])


def test_slopes_of_slopes():
    def second(x: Any) -> Any:
        return jacobian(jacobian(np.exp(x[..., 0]) * x[..., 0], x), x)

    x = 0.7
    np.testing.assert_allclose(
        compiled(second)(np.array([x])), [[np.exp(x) * (2.0 + x)]], rtol=1e-15
    )


def test_a_slope_through_a_repeat():
    def newton(x: Any) -> Any:
        (root,) = repeat(20, lambda y: (0.5 * (y + x[..., 0] / y),), 1.0 + 0.0 * x[..., 0])
        return root

    np.testing.assert_allclose(slope(newton, 2.0), 0.5 / np.sqrt(2.0), rtol=1e-14)


def test_a_slope_through_a_loop_that_ends():
    def newton(x: Any) -> Any:
        target = x[..., 0]
        (root,) = repeat(10**9, lambda y: (0.5 * (y + target / y),), 1.0 + 0.0 * target,
                         active=lambda y: abs(y * y - target) > 1e-12)  # fmt: skip
        return root

    x = np.array([[2.0], [300.0], [1.0]])
    slopes = compiled(lambda x: jacobian(newton(x), x)[..., 0])(x)
    np.testing.assert_allclose(slopes[:2], 0.5 / np.sqrt(x[:2, 0]), rtol=1e-9)
    assert slopes[2] == 0.0  # its first guess does not depend on x, and is not improved


def test_what_has_no_derivative_says_so():
    from estimators.engine import bits_float, float_bits

    with pytest.raises(NotTraceable, match="has no derivative"):
        slope(lambda x: bits_float(float_bits(x[..., 0]) + np.uint64(1)), 1.0)
