"""Elementary functions: within 2 units in the last place; NumPy's bits at every width."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from estimators.engine import compiled, sincos
from estimators.engine.elementary import EXPANSIONS

pytestmark = pytest.mark.skipif(
    np.finfo(np.longdouble).nmant < 63, reason="needs a long double of more digits"
)
N = 20_000
EDGES = np.outer([1.0, -1.0], [
    0.0, np.inf, 5e-324, 2.2250738585072014e-308, 0.5, 1.0, np.nextafter(1.0, 2.0), np.nextafter(1.0, 0.0), 2.0,
    709.7, 709.8, 708.4, 745.1, 745.2, 1e5, np.nan,
]).ravel()  # fmt: skip
LARGEST = np.outer([1.0, -1.0], [1e308, 1.7976931348623157e308]).ravel()


def magnitudes(low: float, high: float) -> Callable[[np.random.Generator], np.ndarray]:
    """Numbers of either sign between powers of ten."""
    return lambda rng: 10.0 ** rng.uniform(low, high, N) * rng.choice([-1.0, 1.0], N)


def between(low: float, high: float) -> Callable[[np.random.Generator], np.ndarray]:
    return lambda rng: rng.uniform(low, high, N)


def beside(value: float) -> Callable[[np.random.Generator], np.ndarray]:
    """Numbers on both sides of a value, which it takes many digits to tell from it."""
    return lambda rng: value + 10.0 ** rng.uniform(-16.0, -1.0, N) * rng.choice([-1.0, 1.0], N)


def quarters(rng: np.random.Generator) -> np.ndarray:
    """Angles next to quarters of a turn, where a sine or a cosine is almost 0."""
    return rng.integers(-600_000, 600_000, N) * (0.5 * np.pi)


_ANGLES = (between(-10.0, 10.0), between(-1e4, 1e4), magnitudes(-323.0, 0.0), quarters)
RANGES = {
    "sin": _ANGLES, "cos": _ANGLES, "tan": (*_ANGLES, between(-1e6, 1e6)),
    "exp": (between(-746.0, 711.0), between(-1.0, 1.0), between(-746.0, -707.0), magnitudes(-323.0, 0.0)),
    "log": (magnitudes(-323.0, 308.0), between(0.5, 2.0), beside(1.0)),
    "log1p": (magnitudes(-323.0, 308.0), between(-1.0, 2.0), magnitudes(-20.0, 0.0), beside(-1.0)),
    "arctan": (magnitudes(-323.0, 308.0), between(-3.0, 3.0)),
    "arcsin": (between(-1.0, 1.0), magnitudes(-323.0, 0.0), beside(1.0), beside(-1.0)),
    "tanh": (between(-25.0, 25.0), between(-1.0, 1.0), magnitudes(-323.0, 3.0)),
}  # fmt: skip


@pytest.fixture(autouse=True)
def _without_warnings() -> Iterator[None]:
    with np.errstate(all="ignore"):
        yield


def units(found: np.ndarray, *operands: np.ndarray, name: str) -> np.ndarray:
    """How far results are from the exact ones, in units in the last place."""
    exact = getattr(np, name)(*(each.astype(np.longdouble) for each in operands))
    nearest = exact.astype(float)
    apart = np.abs(found.astype(np.longdouble) - exact) / np.spacing(np.abs(nearest)).astype(
        np.longdouble
    )
    same = (found == nearest) | (np.isnan(found) & np.isnan(nearest))
    return np.where(same, 0.0, np.nan_to_num(apart.astype(float), nan=np.inf))


def bits(values: np.ndarray) -> np.ndarray:
    """Those of numbers; NaN is one number."""
    return np.where(np.isnan(values), np.nan, values).view(np.int64)


def run(name: str, *operands: np.ndarray) -> np.ndarray:
    """The function of each row, compiled."""
    function = compiled(lambda x: getattr(np, name)(*(x[..., i] for i in range(len(operands)))))
    return function(np.stack(operands, -1))


def formula(name: str, *operands: np.ndarray) -> np.ndarray:
    """The package's formula, computed in NumPy."""
    if name in ("sin", "cos"):
        return sincos(*operands)[name == "cos"]
    return EXPANSIONS[name](*operands)


def check(name: str, *operands: np.ndarray) -> None:
    """Within two units, tangents four, with NumPy's signs of zeros, and in NumPy the bits of what is compiled."""
    found, expected = run(name, *operands), getattr(np, name)(*operands)
    # a tangent is a quotient of two rounded numbers, also the hyperbolic one
    assert units(found, *operands, name=name).max() <= (4.0 if name in ("tan", "tanh") else 2.0)
    signed = np.isnan(found) | (np.signbit(found) == np.signbit(expected))
    assert (
        signed | ((operands[0] == 0.0) & (name in ("sin", "tan")))
    ).all()  # of -0.0 they are 0.0
    if name != "tan":
        np.testing.assert_array_equal(bits(formula(name, *operands)), bits(found))


@pytest.mark.parametrize("name", RANGES)
def test_a_function_of_one_number(name: str):
    rng = np.random.default_rng(1)
    edges = EDGES if name in ("sin", "cos", "tan") else np.concatenate([EDGES, LARGEST])
    for x in (edges, *(draw(rng) for draw in RANGES[name])):
        check(name, x)


@pytest.mark.parametrize("name", ["sin", "cos"])
def test_sines_of_large_angles_are_within_two_and_a_half(name: str):
    x = np.random.default_rng(2).uniform(-1e6, 1e6, 10 * N)
    assert units(formula(name, x), x, name=name).max() <= 2.5
    assert (np.abs(formula(name, LARGEST)) <= 1.0).all()  # without an accurate digit, but bounded


def pairs(edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.repeat(edges, len(edges)), np.tile(edges, len(edges))


@pytest.mark.parametrize("name", ["arctan2", "hypot"])
def test_a_function_of_two_numbers(name: str):
    rng = np.random.default_rng(3)
    check(name, *pairs(np.concatenate([EDGES, LARGEST])))
    for draw in (between(-3.0, 3.0), magnitudes(-323.0, 308.0), magnitudes(-160.0, -150.0)):
        check(name, draw(rng), draw(rng))


def test_remainders_are_numpys_to_the_last_bit():
    rng = np.random.default_rng(5)
    drawn = magnitudes(-5.0, 20.0)(rng), magnitudes(-5.0, 5.0)(rng)
    edges = pairs(np.concatenate([EDGES, LARGEST, [3.0, 0.1, 1e17, -5.0]]))
    for x, y in (drawn, edges):
        for function in (np.remainder, np.fmod):
            found = compiled(function, axes=(0, 0))(x, y)
            np.testing.assert_array_equal(bits(found), bits(function(x, y)))
