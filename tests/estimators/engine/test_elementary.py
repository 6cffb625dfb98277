"""Elementary functions: within 2 units in the last place, and the same bits in NumPy and compiled at every width."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from estimators.engine import compiled, sincos
from estimators.engine.elementary import EXPANSIONS

pytestmark = pytest.mark.skipif(
    np.finfo(np.longdouble).nmant < 63, reason="needs a long double of more digits"
)
N = 20_000
EDGES = np.array([
    0.0, -0.0, np.inf, -np.inf, np.nan, 5e-324, -5e-324, 2.2250738585072014e-308, -2.2250738585072014e-308, 0.5, -0.5,
    1.0, -1.0, np.nextafter(1.0, 2.0), np.nextafter(-1.0, -2.0), np.nextafter(1.0, 0.0), np.nextafter(-1.0, 0.0), 2.0,
    -2.0, 709.7, 709.8, -708.4, -745.1, -745.2, 1e5, -1e5,
])  # fmt: skip
LARGEST = np.array([1e308, -1e308, 1.7976931348623157e308, -1.7976931348623157e308])


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
    "expm1": (between(-50.0, 711.0), between(-1.0, 1.0), magnitudes(-323.0, 0.0)),
    "log": (magnitudes(-323.0, 308.0), between(0.5, 2.0), beside(1.0)),
    "log1p": (magnitudes(-323.0, 308.0), between(-1.0, 2.0), magnitudes(-20.0, 0.0), beside(-1.0)),
    "arctan": (magnitudes(-323.0, 308.0), between(-3.0, 3.0)),
    "arcsin": (between(-1.0, 1.0), magnitudes(-323.0, 0.0), beside(1.0), beside(-1.0)),
    "arccos": (between(-1.0, 1.0), magnitudes(-323.0, 0.0), beside(1.0), beside(-1.0)),
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
    return function(np.stack(operands, -1))  # type: ignore[no-any-return]


@pytest.mark.parametrize("name", RANGES)
def test_a_function_is_within_two_units_in_the_last_place(name: str):
    rng = np.random.default_rng(1)
    for draw in RANGES[name]:
        x = draw(rng)
        found = EXPANSIONS[name][1](x)
        assert units(found, x, name=name).max() <= 2.0
        np.testing.assert_array_equal(bits(run(name, x)), bits(found))


@pytest.mark.parametrize("name", ["sin", "cos"])
def test_sines_of_large_angles_are_within_two_and_a_half(name: str):
    x = np.random.default_rng(2).uniform(-1e6, 1e6, 10 * N)
    assert units(EXPANSIONS[name][1](x), x, name=name).max() <= 2.5
    assert (
        np.abs(EXPANSIONS[name][1](LARGEST)) <= 1.0
    ).all()  # without an accurate digit, but bounded


@pytest.mark.parametrize("name", RANGES)
def test_infinities_subnormals_and_signs_of_zeros_are_numpys(name: str):
    x = EDGES if name in ("sin", "cos", "tan") else np.concatenate([EDGES, LARGEST])
    found, expected = EXPANSIONS[name][1](x), getattr(np, name)(x)
    assert units(found, x, name=name).max() <= 2.0
    signed = np.isnan(found) | (np.signbit(found) == np.signbit(expected))
    assert (signed | ((x == 0.0) & (name == "sin"))).all()  # the sine of -0.0 is 0.0
    np.testing.assert_array_equal(bits(run(name, x)), bits(found))
    for value in x:  # alone, where no rows lie side by side
        np.testing.assert_array_equal(
            bits(run(name, np.array([value]))), bits(EXPANSIONS[name][1](np.array([value])))
        )


@pytest.mark.parametrize("name", ["arctan2", "hypot"])
def test_functions_of_two_numbers(name: str):
    rng = np.random.default_rng(3)
    for draw in (
        between(-3.0, 3.0),
        magnitudes(-323.0, 308.0),
        magnitudes(-160.0, -150.0),
        magnitudes(-8.0, 8.0),
    ):
        x, y = draw(rng), draw(rng)
        found = EXPANSIONS[name][1](x, y)
        assert units(found, x, y, name=name).max() <= 2.0
        np.testing.assert_array_equal(bits(run(name, x, y)), bits(found))
    edges = np.concatenate([EDGES, LARGEST])
    x, y = np.repeat(edges, len(edges)), np.tile(edges, len(edges))
    found, expected = EXPANSIONS[name][1](x, y), getattr(np, name)(x, y)
    assert units(found, x, y, name=name).max() <= 2.0
    assert (np.isnan(found) | (np.signbit(found) == np.signbit(expected))).all()
    np.testing.assert_array_equal(bits(run(name, x, y)), bits(found))


def test_sine_and_cosine_are_one_call_with_the_bits_of_each():
    x = np.random.default_rng(4).uniform(-100.0, 100.0, N)
    sine, cosine = compiled(sincos, axes=(0,))(x)
    np.testing.assert_array_equal(sine, EXPANSIONS["sin"][1](x))
    np.testing.assert_array_equal(cosine, EXPANSIONS["cos"][1](x))
    assert np.abs(sine * sine + cosine * cosine - 1.0).max() < 1e-15


def test_remainders_and_quotients_are_numpys_to_the_last_bit():
    rng = np.random.default_rng(5)
    edges = np.concatenate([EDGES, LARGEST, [3.0, 0.1, 1e17, -5.0]])
    x = np.concatenate(
        [np.repeat(edges, len(edges)), 10.0 ** rng.uniform(-5, 20, N) * rng.choice([-1, 1], N)]
    )
    y = np.concatenate(
        [np.tile(edges, len(edges)), 10.0 ** rng.uniform(-5, 5, N) * rng.choice([-1, 1], N)]
    )
    for function in (np.remainder, np.floor_divide, np.fmod):
        found = compiled(lambda x, function=function: function(x[..., 0], x[..., 1]))(
            np.stack([x, y], -1)
        )
        np.testing.assert_array_equal(bits(found), bits(function(x, y)))
    n, m = rng.integers(-99, 99, 500), rng.integers(-9, 9, 500)
    m[m == 0] = 5
    found = compiled(lambda n, m: n % m, axes=(0, 0))(n, m)
    assert found.dtype == np.int64
    np.testing.assert_array_equal(found, n % m)
