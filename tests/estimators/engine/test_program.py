"""Programs of traced functions: instructions, kinds of numbers, tables, loops, batches, methods."""

import copy
import pickle
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from estimators.engine import (
    NotTraceable,
    along,
    as_float,
    as_integer,
    as_word,
    bits_float,
    compiled,
    float_bits,
    lookup,
    sincos,
    trace,
)
from estimators.engine.function import Argument

LOWEST, HIGHEST = np.iinfo(np.int64).min, np.iinfo(np.int64).max


def opcodes(function: Any) -> list[str]:
    """Those of a function's instructions, inputs left out."""
    instructions = trace(function, [Argument((3,))]).instructions
    return [each.opcode for each in instructions if each.opcode != "input"]


@pytest.mark.parametrize(
    ("function", "expected"),
    [
        (lambda x: (x[..., 0] + x[..., 1]) * (x[..., 0] + x[..., 1]), "add multiply"),
        (lambda x: (np.exp(x), x[..., 0] * 3.0)[1], "multiply"),
        (lambda x: x[..., 0] + 0.0, "add"),  # of -0.0 it is 0.0
        (lambda x: x[..., 0] ** 8, "multiply multiply multiply"),
        (lambda x: compiled(lambda x: x + 1.0)(x)[..., 0] * 2.0, "add multiply"),
    ],
)
def test_equal_instructions_are_one_and_needless_ones_none(function: Any, expected: str):
    assert opcodes(function) == expected.split()


def of_all_kinds(x: Any, n: Any, w: Any, m: Any) -> tuple[Any, ...]:
    """Of floats, whole numbers, words and masks."""
    return (
        n * n - 2 + m,
        n / 2 + n * m.sum(-1),
        (w ^ (w << 7)) * np.uint64(0x9E3779B97F4A7C15) + (w >> 3),
        n & 6 | ~n,
        np.maximum(n, 0),
        np.minimum(w, np.uint64(9)),
        (n > 0) & m | ~m ^ (w > np.uint64(3)),
        np.where(m, n, 0.5),
        x.astype(int),
        w.astype(float),
        m * x,
        np.mean(m, axis=-1),
        m == (n != 3),
        np.copysign(x, 0.0) - 2.0 * np.copysign(x, -0.0),
        float_bits(x),
        bits_float(float_bits(x)),
        as_integer(w),
        as_word(n),
        as_float(w),
    )


def test_results_have_the_types_that_numpy_gives():
    x, n = np.array([1.5, -2.5]), np.array([3, -4])
    w, m = np.array([3, 2**63 + 1], np.uint64), np.array([True, False])
    function = compiled(of_all_kinds)
    many = function(*(np.stack([each] * 9) for each in (x, n, w, m)))
    for found, row, expected in zip(
        function(x, n, w, m), many, of_all_kinds(x, n, w, m), strict=True
    ):
        assert found.dtype == expected.dtype
        assert_array_equal(found, expected)
        assert_array_equal(row, np.stack([expected] * 9))


def test_other_types_are_taken_as_those_of_their_kind():
    double = compiled(lambda x: 2 * x)
    for dtype, result in ("f4", float), ("i1", np.int64), ("u1", np.uint64), (">f8", float):
        found = double(np.arange(3).astype(dtype))
        assert found.dtype == result
        assert_array_equal(found, [0, 2, 4])
    for value in ["a"], [1j], [None]:
        with pytest.raises(NotTraceable, match="takes numbers"):
            double(np.array(value))


def test_the_worst_whole_numbers_do_no_harm():
    n = np.array([LOWEST, HIGHEST, 5, 0, -7, -1])
    assert_array_equal(compiled(lambda n: n + n)(n), n + n)
    found = compiled(lambda x: x.astype(int))([1e300, -1e300, np.inf, np.nan, 2.9, -2.9])
    assert_array_equal(found[-2:], [2, -2])


# --- tables and loops -----------------------------------------------------------------------------


def test_a_table_is_looked_up_as_in_numpy():
    vector, xp = np.array([3.0, 1.0, 2.0, -5.0]), np.array([-1.0, 0.0, 0.5, 4.0])
    x = np.array([0.99, 1.0, 3.0, 4.0, 1e300, -1.0, -1e300, np.nan, np.inf, -np.inf])
    n = np.array([LOWEST, -1, 0, 3, 4, HIGHEST])
    for table in (vector, np.arange(12.0).reshape(4, 3)):
        function = compiled(lambda x, table=table: lookup(table, x), axes=(0,))
        for each in (x, *x):
            assert_array_equal(function(each), lookup(table, each))
        assert_array_equal(function(n), table[[0, 0, 0, 3, 3, 3]])
    x = np.concatenate([np.linspace(-3.0, 6.0, 301), xp, x])
    found = compiled(lambda x: np.interp(x, xp, vector), axes=(0,))(x)
    assert_array_equal(found, np.interp(x, xp, vector))


def waves(x: Any) -> tuple[Any, ...]:
    """Of pairs ``(..., 2 k)`` and a number that all pairs share, in a table's entries, too."""
    first, k = x[..., 0], x.shape[-1] // 2

    def each(a: Any, b: Any) -> list[Any]:
        sine, cosine = sincos(a * first - b)
        return [np.where(a > b, sine, cosine), lookup(np.array([3.0, 1.0, 2.0]), a) + b]

    return along(each, x[..., :k], x[..., k:])


@pytest.mark.parametrize("entries", [1, 3, 8, 13, 24])
def test_a_function_along_rows_has_its_instructions_once(entries: int):
    x = 2.0 * np.random.default_rng(entries).normal(size=(21, 2 * entries))
    function = compiled(waves)
    for found, expected in zip(function(x), waves(x), strict=True):
        assert_array_equal(found, expected)
    for row, *expected in zip(x, *function(x), strict=True):
        assert_array_equal(function(row), expected)
    program = trace(waves, [Argument((2 * entries,))])
    assert sum(each.opcode == "sin" for each in program.instructions) <= 1


# --- batches --------------------------------------------------------------------------------------


@compiled(axes=(1, 0, 2))
def moved(x: np.ndarray, dt: np.ndarray, A: np.ndarray) -> np.ndarray:
    return x + dt[..., None] * (A @ x[..., None])[..., 0]


@pytest.mark.parametrize(
    ("batch", "of_dt"), [((), ()), ((1,), (1,)), ((2, 5), ()), ((4, 0), ()), ((5, 1), (4,))]
)
def test_arguments_have_batches_that_are_broadcast(batch: tuple[int, ...], of_dt: tuple[int, ...]):
    rng = np.random.default_rng(0)
    x, dt = rng.normal(size=(*batch, 2)), rng.normal(size=of_dt)
    for A in (np.eye(2), rng.normal(size=(*batch, 2, 2))):
        found, expected = moved(x, dt, A), moved.function(x, dt, A)
        assert found.shape == expected.shape
        assert_allclose(found, expected, rtol=1e-15, atol=1e-15)
    if of_dt == (4,):
        with pytest.raises(ValueError, match="broadcast"):
            moved(x[:, 0], dt, A[..., 0, :, :])


# --- functions and methods ------------------------------------------------------------------------


@dataclass(frozen=True)
class Spring:
    stiffness: float

    @compiled
    def force(self, x: np.ndarray, sign: float = -1.0) -> np.ndarray:
        return sign * self.stiffness * x

    @compiled
    def energy(self, x: np.ndarray) -> np.ndarray:
        return -0.5 * (self.force(x) * x).sum(-1)


class Namesake(Spring):
    """A subclass with the name of its base, as one in another module may have."""

    @compiled
    def force(self, x: np.ndarray) -> np.ndarray:
        return 0.0 * x

    def both(self, x: np.ndarray) -> np.ndarray:
        return self.force(x) + super().force(x)


Namesake.__dict__["force"].function.__qualname__ = "Spring.force"
Namesake.__dict__["force"].function.__module__ = "another"


def _scaled(factor: float, x: np.ndarray) -> np.ndarray:
    return factor * x


def test_methods_are_compiled_for_their_object_and_its_copies():
    x = np.ones((2, 3))
    soft, hard = Spring(1.0), Spring(5.0)
    assert_array_equal(soft.force(x), -x)
    for sign in (3.0, 2.0):  # a constant
        assert_array_equal(Spring.force(soft, x, sign=sign), sign * x)
    for again in (hard, pickle.loads(pickle.dumps(hard)), copy.deepcopy(hard)):
        assert_array_equal(again.energy(x), [7.5, 7.5])
    assert pickle.loads(pickle.dumps(moved)) is moved
    namesake = Namesake(5.0)
    assert_array_equal(namesake.both(x), -5.0 * x)
    kept = dict(vars(namesake))
    assert_array_equal(namesake.both(x), -5.0 * x)
    assert all(vars(namesake)[name] is each for name, each in kept.items())  # none is traced anew
    function = compiled(partial(_scaled, 2.5))  # which has no name
    for again in (hard.force, function):
        pickled = pickle.loads(pickle.dumps(again))
        assert_array_equal(pickled(x), again(x))
        assert again(x).shape == x.shape


@pytest.mark.parametrize(
    ("function", "sentence"),
    [
        (lambda x: x if x[0] > 0.0 else -x, "cannot branch on values"),
        (lambda x: float(x[0]), "NumPy's functions"),
        (lambda x: np.fft.fft(x), r"cannot have np\.fft in it"),
        (lambda x: x**x, "constant exponents"),
        (lambda x: x - x[..., 0].sum(), "over the batch"),
        (lambda x: x // 2.0, r"cannot have np\.floor_divide"),
        (lambda x: x & 1, "masks or whole numbers"),
        (lambda x: (x > 0.0) - (x < 0.0), "two masks"),
        (lambda x: x[x > 0.0], r"np\.where"),
    ],
)
def test_what_cannot_be_traced_raises_a_sentence(function: Any, sentence: str):
    with pytest.raises(TypeError, match=sentence):
        compiled(function)(np.ones(2))


def test_a_refused_call_leaves_nothing_for_the_next():
    function = compiled(lambda x, u: 2.0 * x + u[..., :1], axes=(1, 1))
    with pytest.raises(ValueError, match="broadcast"):
        function(np.ones((2, 3)), np.ones((4, 1)))
    np.testing.assert_array_equal(function(np.ones((2, 2)), np.ones((2, 1))), np.full((2, 2), 3.0))


def test_a_product_of_masks_is_true_where_both_are():
    x = np.array([[1.0, 1.0], [1.0, -1.0]])
    both = compiled(lambda x: 1.0 * ((x[..., :1] > 0.0) * (x[..., 1:] > 0.0)))
    np.testing.assert_array_equal(both(x), [[1.0], [0.0]])
