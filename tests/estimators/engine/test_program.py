"""Programs of traced functions: shared, folded and dead instructions, kinds of numbers, tables, loops and batches."""

import copy
import pickle
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pytest

from estimators.engine import (
    NotTraceable,
    along,
    as_float,
    as_integer,
    as_word,
    bits_float,
    compiled,
    float_bits,
    jacobian,
    lookup,
    machine,
    repeat,
    sincos,
)
from estimators.engine.compiled import trace
from estimators.engine.function import Argument

LOWEST, HIGHEST = np.iinfo(np.int64).min, np.iinfo(np.int64).max


@pytest.fixture(autouse=True)
def _cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = tmp_path_factory.getbasetemp() / "objects"
    kept.mkdir(exist_ok=True)
    monkeypatch.setattr(machine, "folder", lambda: kept)


def opcodes(function: Any, *rows: Argument) -> list[str]:
    """Those of a function's instructions, inputs left out."""
    return [
        each.opcode
        for each in trace(function, rows or [Argument((3,))])[0].instructions
        if each.opcode != "input"
    ]


# --- instructions ---------------------------------------------------------------------------------


def test_the_same_operation_is_one_instruction():
    assert opcodes(lambda x: (x[..., 0] + x[..., 1]) * (x[..., 0] + x[..., 1])) == [
        "add",
        "multiply",
    ]
    both = opcodes(lambda x: np.sin(x[..., 0]) + np.sin(x[..., 0]) * np.cos(x[..., 0]))
    assert sorted(both) == ["add", "cos", "multiply", "sin"]


def test_what_no_result_needs_is_left_out():
    def function(x: Any) -> Any:
        np.exp(x)
        return x[..., 0] + 1.0

    assert opcodes(function) == ["add"]


def test_constants_are_computed_at_once_and_identities_cost_nothing():
    assert opcodes(lambda x: x[..., 0] * (np.sqrt(2.0) + 3.0) * 1.0 / 1.0 - 0.0) == ["multiply"]
    assert opcodes(lambda x: x[..., 0] + 0.0) == ["add"]  # of -0.0 it is 0.0
    assert opcodes(lambda x: x[..., 0] + -0.0) == []
    assert opcodes(lambda x: np.where(np.isfinite(0.0 * x[..., 0] + np.nan) | True, x[..., 0], 5.0)) == [
        "multiply", "add", "isfinite", "or", "where"]  # fmt: skip
    assert opcodes(lambda x: np.where((x[..., 0] > 0.0) & True, x[..., 1], x[..., 1])) == []


def test_zeros_of_either_sign_are_two_constants():
    found = compiled(
        lambda x: np.stack([np.copysign(x[..., 0], 0.0), np.copysign(x[..., 0], -0.0)], -1)
    )(np.ones(1))
    np.testing.assert_array_equal(found, [1.0, -1.0])


def test_powers_are_products():
    assert opcodes(lambda x: x[..., 0] ** 2) == ["multiply"]
    assert opcodes(lambda x: x[..., 0] ** 8) == ["multiply"] * 3
    assert opcodes(lambda x: x[..., 0] ** 0.5) == ["sqrt"]
    assert opcodes(lambda x: x[..., 0] ** -1) == ["divide"]
    np.testing.assert_array_equal(compiled(lambda x: x**0)(np.array([np.nan, 0.0])), [1.0, 1.0])


# --- kinds ----------------------------------------------------------------------------------------


def test_results_have_the_types_that_numpy_gives():
    x, n, w, m = (
        np.array([1.5, -2.5]),
        np.array([3, -4]),
        np.array([3, 2**63 + 1], np.uint64),
        np.array([True, False]),
    )
    for function in (
        lambda x, n, w, m: x > 0.0,
        lambda x, n, w, m: (x > 0.0).sum(-1),
        lambda x, n, w, m: n + m,
        lambda x, n, w, m: n * n - 2,
        lambda x, n, w, m: n / 2,
        lambda x, n, w, m: n + x,
        lambda x, n, w, m: w + np.uint64(5),
        lambda x, n, w, m: w >> 3,
        lambda x, n, w, m: (w ^ (w << 7)) * np.uint64(0x9E3779B97F4A7C15),
        lambda x, n, w, m: n & 6 | 1,
        lambda x, n, w, m: ~n,
        lambda x, n, w, m: n % 3,
        lambda x, n, w, m: n % -3,
        lambda x, n, w, m: w % np.uint64(3),
        lambda x, n, w, m: np.abs(n) + -n,
        lambda x, n, w, m: np.maximum(n, 0),
        lambda x, n, w, m: np.minimum(w, np.uint64(9)),
        lambda x, n, w, m: (n > 0) & m | ~m,
        lambda x, n, w, m: w > np.uint64(3),
        lambda x, n, w, m: np.where(m, n, 0),
        lambda x, n, w, m: np.where(m, n, 0.5),
        lambda x, n, w, m: x.astype(int),
        lambda x, n, w, m: n.astype(float),
        lambda x, n, w, m: w.astype(float),
        lambda x, n, w, m: m.astype(np.int64),
        lambda x, n, w, m: x.astype(bool),
        lambda x, n, w, m: m * x,
        lambda x, n, w, m: 1 - m,
        lambda x, n, w, m: np.cumsum(m, axis=-1),
        lambda x, n, w, m: np.mean(m, axis=-1),
        lambda x, n, w, m: m == (x > 0.0),
        lambda x, n, w, m: n != 3,
    ):
        expected, found = function(x, n, w, m), compiled(function)(x, n, w, m)
        assert found.dtype == np.asarray(expected).dtype
        np.testing.assert_array_equal(found, expected)
        many = compiled(function)(*(np.stack([each] * 9) for each in (x, n, w, m)))
        np.testing.assert_array_equal(many, np.stack([expected] * 9))


def test_other_types_are_taken_as_those_of_their_kind():
    double = compiled(lambda x: 2 * x)
    for dtype, result in (
        (np.float32, float),
        (np.int8, np.int64),
        (np.uint8, np.uint64),
        (">f8", float),
        (int, int),
    ):
        found = double(np.arange(3).astype(dtype))
        assert found.dtype == result
        np.testing.assert_array_equal(found, [0, 2, 4])
    for value in (np.array(["a"]), np.array([1j]), np.array([None])):
        with pytest.raises(NotTraceable, match="takes numbers"):
            double(value)


def test_the_worst_whole_numbers_do_no_harm():
    n = np.array([LOWEST, HIGHEST, LOWEST, 5, 0, 7, -7, -1])
    d = np.array([-1, -1, 0, 0, 0, -3, 3, LOWEST])
    with np.errstate(all="ignore"):
        expected = np.remainder(n, d)
    found = compiled(lambda n, d: n % d, axes=(0, 0))
    np.testing.assert_array_equal(found(n, d), expected)
    for a, b, c in zip(n, d, expected, strict=True):
        assert found(a, b) == c
    np.testing.assert_array_equal(compiled(lambda n: n + n)(n), n + n)
    found = compiled(lambda x: x.astype(int))(np.array([1e300, -1e300, np.inf, np.nan, 2.9, -2.9]))
    np.testing.assert_array_equal(found[-2:], [2, -2])


@pytest.mark.parametrize("places", [64, -1, 1000])
def test_shifts_beyond_a_word_are_refused(places: int):
    with pytest.raises(NotTraceable, match="from 0 to 63"):
        compiled(lambda w: w << places)(np.ones(2, np.uint64))
    with pytest.raises(NotTraceable, match="from 0 to 63"):
        compiled(lambda w: w << w)(np.ones(2, np.uint64))


def test_words_and_floats_share_their_bits():
    x = np.array([1.0, -0.0, np.inf, 5e-324, np.nan, -2.5])
    assert compiled(float_bits)(x).dtype == np.uint64
    np.testing.assert_array_equal(compiled(float_bits)(x), x.view(np.uint64))
    np.testing.assert_array_equal(
        compiled(lambda x: bits_float(float_bits(x)))(x).view(np.uint64), x.view(np.uint64)
    )
    w = np.array([0, 1, 2**63, 2**64 - 1], np.uint64)
    np.testing.assert_array_equal(compiled(as_integer)(w), w.astype(np.int64))
    np.testing.assert_array_equal(compiled(as_word)(w.astype(np.int64)), w)
    np.testing.assert_array_equal(compiled(as_float)(w), w.astype(float))


# --- tables and loops -----------------------------------------------------------------------------


def test_a_table_is_looked_up_as_in_numpy():
    table, matrix = np.array([3.0, 1.0, 2.0, -5.0]), np.arange(12.0).reshape(4, 3)
    x = np.array([0.0, 0.99, 1.0, 2.5, 3.0, 4.0, 1e300, -1.0, -1e300, np.nan, np.inf, -np.inf])
    for entries in (table, matrix):
        function = compiled(lambda x, entries=entries: lookup(entries, x), axes=(0,))
        np.testing.assert_array_equal(function(x), lookup(entries, x))
        for value in x:
            np.testing.assert_array_equal(function(value), lookup(entries, value))
    n = np.array([LOWEST, -1, 0, 3, 4, HIGHEST])
    np.testing.assert_array_equal(
        compiled(lambda n: lookup(table, n), axes=(0,))(n), table[[0, 0, 0, 3, 3, 3]]
    )
    np.testing.assert_array_equal(
        compiled(lambda x: lookup(table, x))(np.array([1.0, 3.0])), [1.0, -5.0]
    )


def test_interpolation_is_numpys():
    xp, fp = np.array([-1.0, 0.0, 0.5, 4.0]), np.array([2.0, -1.0, 3.0, 3.5])
    x = np.concatenate([np.linspace(-3.0, 6.0, 301), xp, [np.nan, np.inf, -np.inf, 1e308]])
    found = compiled(lambda x: np.interp(x, xp, fp), axes=(0,))(x)
    np.testing.assert_array_equal(found, np.interp(x, xp, fp))


def test_a_loop_repeats_its_body():
    def collatz(n: Any) -> Any:
        def body(n: Any, steps: Any) -> Any:
            going = n > 1
            odd = n % 2 == 1
            return np.where(going, np.where(odd, 3 * n + 1, n >> 1), n), steps + 1 * going

        return repeat(200, body, n, 0 * n)[1]

    n = np.arange(1, 40)
    np.testing.assert_array_equal(compiled(collatz, axes=(0,))(n), collatz(n))
    assert collatz(27) == 111
    assert opcodes(collatz, Argument((), "i")).count("repeat") == 1


def test_loops_in_loops_read_what_is_outside():
    def function(x: Any) -> Any:
        def outer(total: Any, k: Any) -> Any:
            inner = repeat(4, lambda t: (t * 0.5 + x[..., 1] + k,), total)
            return inner[0] + x[..., 0], k + 1.0

        return repeat(3, outer, x[..., 0], 0.0 * x[..., 0])[0]

    x = np.random.default_rng(0).normal(size=(11, 2))
    np.testing.assert_array_equal(compiled(function)(x), function(x))


@pytest.mark.parametrize("rows", [1, 11, 40])
def test_a_loop_ends_when_no_row_needs_another_pass(rows: int):
    def collatz(n: Any) -> Any:
        return repeat(10**12, lambda n, steps: (np.where(n % 2 == 1, 3 * n + 1, n >> 1), steps + 1), n, 0 * n,
                      active=lambda n, steps: n > 1)[1]  # fmt: skip

    n = np.arange(1, rows + 1)
    found = compiled(collatz, axes=(0,))(n)
    np.testing.assert_array_equal(found, collatz(n))
    assert found[0] == 0
    assert rows < 27 or found[26] == 111


def test_rows_that_need_no_pass_keep_their_vectors():
    def decayed(x: Any) -> Any:
        return repeat(7, lambda x: (0.5 * x,), x, active=lambda x: abs(x[..., 0]) > 1.0)[0]

    x = 4.0 * np.random.default_rng(0).normal(size=(23, 3))
    np.testing.assert_array_equal(compiled(decayed)(x), decayed(x))
    for row in x[:5]:
        np.testing.assert_array_equal(compiled(decayed)(row), decayed(row))


def test_a_loop_ends_by_a_mask():
    with pytest.raises(TypeError, match="ends by a mask"):
        compiled(lambda x: repeat(3, lambda x: (0.5 * x,), x[..., 0], active=lambda x: x - 1.0)[0])(
            np.ones(2)
        )


def test_a_loop_of_no_passes_gives_what_it_got():
    x = np.array([2.0, 3.0])
    np.testing.assert_array_equal(
        compiled(lambda x: repeat(0, lambda a: (a + 1.0,), x[..., 0])[0])(x), 2.0
    )


def waves(x: Any) -> tuple[Any, ...]:
    """Of pairs ``(..., 2 k)`` and numbers that all pairs share, in a table's entries, too."""
    first, last, k = x[..., 0], x[..., -1], x.shape[-1] // 2

    def each(a: Any, b: Any) -> list[Any]:
        sine, cosine = sincos(a * first - b)
        return [np.where(a > b, sine, last * cosine), lookup(np.array([3.0, 1.0, 2.0]), a) + b]

    return along(each, x[..., :k], x[..., k:] + last[..., None])


@pytest.mark.parametrize("entries", [1, 3, 8, 13, 24])
def test_a_function_along_rows_is_that_of_each_entry(entries: int):
    x = 2.0 * np.random.default_rng(entries).normal(size=(21, 2 * entries))
    function = compiled(waves)
    for found, expected in zip(function(x), waves(x), strict=True):
        np.testing.assert_array_equal(found, expected)
    for row, *expected in zip(x, *function(x), strict=True):
        np.testing.assert_array_equal(function(row), expected)


def test_a_function_along_rows_has_its_instructions_once():
    few, many = (trace(waves, [Argument((2 * k,))])[0].instructions for k in (3, 24))
    short, long = ([each for each in found if each.opcode == "columns"] for found in (few, many))
    assert len(short) == len(long) == 1
    assert len(short[0].attributes[0].body) == len(long[0].attributes[0].body) > 3


def test_a_function_along_rows_is_refused_where_it_would_be_wrong():
    def shared(x: Any) -> Any:
        return along(
            lambda a: [a * x[..., 0]], np.linspace(0.0, 1.0, 5) + 0.0 * as_float(x[..., :1] > 0.0)
        )[0]

    for function in (lambda x: along(lambda a: [a * a], x)[0], shared):
        with pytest.raises(NotTraceable, match="no derivative"):
            compiled(lambda x, function=function: jacobian(function(x), x))(np.ones(5))
    with pytest.raises(TypeError, match="no matrices"):
        compiled(lambda x: repeat(2, lambda y: along(lambda a: [2.0 * a], y), x)[0])(np.ones(5))


# --- batches --------------------------------------------------------------------------------------


@compiled(axes=(1, 0, 2))
def moved(x: np.ndarray, dt: np.ndarray, A: np.ndarray) -> np.ndarray:
    return x + dt[..., None] * (A @ x[..., None])[..., 0]


@pytest.mark.parametrize("batch", [(), (1,), (3,), (8,), (17,), (2, 5), (0,), (4, 0)])
def test_arguments_have_the_batch_or_are_shared(batch: tuple[int, ...]):
    rng = np.random.default_rng(0)
    x, dt, A = rng.normal(size=(*batch, 2)), rng.normal(size=batch), rng.normal(size=(*batch, 2, 2))
    for arguments in (
        (x, dt, A),
        (x, np.array(0.1), A[(0,) * len(batch)] if x.size else np.eye(2)),
        (x, 0.1, np.eye(2)),
    ):
        found = moved(*arguments)
        assert found.shape == x.shape
        np.testing.assert_allclose(
            found, moved.function(*map(np.asarray, arguments)), rtol=1e-15, atol=1e-15
        )


def test_batches_are_broadcast():
    rng = np.random.default_rng(0)
    x, dt, A = rng.normal(size=(5, 1, 2)), rng.normal(size=(4,)), np.eye(2)
    found = moved(x, dt, A)
    assert found.shape == (5, 4, 2)
    np.testing.assert_allclose(found, moved.function(x, dt, A), rtol=1e-15)
    with pytest.raises(ValueError, match="broadcast"):
        moved(np.ones((5, 2)), np.ones(3), A)


def test_views_of_any_kind_are_read():
    x = np.random.default_rng(0).normal(size=(6, 4))
    double = compiled(lambda x: 2.0 * x)
    for view in (
        x.T,
        x[::2, ::-1],
        x[:, 1:3],
        np.asfortranarray(x),
        np.broadcast_to(x[0], (3, 4)),
        x[0, 0],
        x.tolist(),
    ):
        axes = (min(1, np.ndim(view)),)
        np.testing.assert_array_equal(
            compiled(double.function, axes=axes)(view), 2.0 * np.asarray(view)
        )


def test_results_are_new_arrays():
    x = np.ones((3, 2))
    found = compiled(lambda x: x)(x)
    found[:] = 5.0
    assert (x == 1.0).all()


def test_threads_compute_side_by_side():
    function = compiled(lambda x: np.sin(x) * np.exp(-x * x) + x @ np.eye(6)[::-1])
    parts = [np.random.default_rng(i).normal(size=(i % 13 + 1, 6)) for i in range(64)]
    barrier = threading.Barrier(4)

    def work(first: int) -> list[np.ndarray]:
        barrier.wait()
        return [function(part) for part in parts[first::4]]

    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(work, range(4)))
    for first, results in enumerate(found):
        for part, result in zip(parts[first::4], results, strict=True):
            np.testing.assert_array_equal(result, function(part))


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


def test_methods_are_compiled_for_their_object():
    x = np.ones((2, 3))
    soft, hard = Spring(1.0), Spring(5.0)
    np.testing.assert_array_equal(soft.force(x), -x)
    np.testing.assert_array_equal(hard.force(x), -5.0 * x)
    np.testing.assert_array_equal(hard.energy(x), [7.5, 7.5])
    for again in (pickle.loads(pickle.dumps(hard)), copy.copy(hard), copy.deepcopy(hard)):
        np.testing.assert_array_equal(again.energy(x), [7.5, 7.5])
    method = pickle.loads(pickle.dumps(hard.force))
    np.testing.assert_array_equal(method(x), -5.0 * x)
    np.testing.assert_array_equal(Spring.force(soft, x), -x)
    assert pickle.loads(pickle.dumps(moved)) is moved


def test_named_arguments_are_constants():
    x = np.ones(2)
    spring = Spring(2.0)
    np.testing.assert_array_equal(spring.force(x, sign=1.0), 2.0 * x)
    np.testing.assert_array_equal(spring.force(x, sign=3.0), 6.0 * x)
    np.testing.assert_array_equal(spring.force(x), -2.0 * x)


def test_a_function_that_is_called_with_tracers_is_part_of_its_caller():
    inner = compiled(lambda x: x + 1.0)
    assert opcodes(lambda x: inner(x)[..., 0] * 2.0) == ["add", "multiply"]


def test_what_cannot_be_traced_raises_a_sentence():
    for function, sentence in (
        (lambda x: x if x[0] > 0.0 else -x, "cannot branch on values"),
        (lambda x: float(x[0]), "NumPy's functions"),
        (lambda x: np.fft.fft(x), r"cannot have np\.fft in it"),
        (lambda x: x ** x, "constant exponents"),
        (lambda x: x - x[..., 0].sum(), "over the batch"),
        (lambda x: x & 1, "masks or whole numbers"),
        (lambda x: ~x, "masks or whole numbers"),
        (lambda x: (x > 0.0) - (x < 0.0), "two masks"),
        (lambda x: x[x > 0.0], r"np\.where"),
        (lambda x: x * np.ma.array([1.0, 2.0]), "real numbers and masks"),
    ):  # fmt: skip
        with pytest.raises(TypeError, match=sentence):
            compiled(function)(np.ones(2))


def _scaled(factor: float, x: np.ndarray) -> np.ndarray:
    return factor * x


def test_a_compiled_function_without_a_name_is_copied_and_pickled():
    function, x = compiled(partial(_scaled, 2.5)), np.arange(6.0).reshape(2, 3)
    for again in (copy.deepcopy(function), pickle.loads(pickle.dumps(function))):
        np.testing.assert_array_equal(again(x), function(x))
