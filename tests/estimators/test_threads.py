"""Threads that share the rows of a batch."""

import threading
import time
from pathlib import Path

import numpy as np
import pytest

from estimators.engine import compiled, machine, repeat, trace
from estimators.engine.function import Argument
from estimators.engine.matching import described, matcher
from estimators.threads import WORTH, each, shares

PARTS = tuple(slice(i, i + 1) for i in range(7))


@pytest.mark.parametrize("operations", [10, 5000, 2 * WORTH])
@pytest.mark.parametrize("threads", [1, 2, 3, 5000])
@pytest.mark.parametrize("rows", [0, 1, 65, 511, 512, 800, 1024, 5000])
def test_every_row_is_in_one_part(rows: int, threads: int, operations: int):
    parts = shares(rows, threads, operations, 8)
    assert [row for part in parts for row in range(rows)[part]] == list(range(rows))
    assert 1 <= len(parts) <= threads
    callers, *others = (part.stop - part.start for part in parts)
    ahead = WORTH // 2 // operations if others else 0
    assert all(size > 0 and abs(callers - ahead - size) <= 16 for size in others)
    assert len(parts) == 1 or len(parts) * WORTH <= rows * operations
    assert len(parts) >= min(threads, rows * operations // WORTH, rows // 8)
    assert all(part.start % 8 == 0 for part in parts)


def test_operations_of_a_row_count_entries_and_passes():
    assert trace(lambda a: a * a + a, [Argument((3,))])[0].operations == 3 + 6
    small, large = (trace(lambda a, b: a @ b, [Argument((n, n))] * 2, matrices=True)[0].operations for n in (4, 8))
    assert large - 2 * 64 == 8 * (small - 2 * 16) == 512
    once, often = (
        trace(lambda a, n=n: repeat(n, lambda x: (x * x,), a)[0], [Argument((1,))])[0].operations for n in (1, 50)
    )
    assert often - once == 49


@pytest.mark.parametrize("threads", [1, 2, 3, 9])
def test_results_come_in_the_order_of_the_parts(threads: int):
    def work(part: slice) -> int:
        time.sleep(0.001 * (7 - part.start))
        return part.start

    assert each(work, PARTS, threads) == list(range(7))


def test_the_parts_are_worked_on_at_once_and_the_caller_works_too():
    together = threading.Barrier(3, timeout=60)

    def work(part: slice) -> int:
        together.wait()
        return threading.get_ident()

    who = each(work, PARTS[:3], 3)
    assert len(set(who)) == 3
    assert who[0] == threading.get_ident()


def test_the_caller_does_what_nobody_has_begun():
    caller, begun, left = threading.get_ident(), threading.Event(), threading.Event()

    def work(part: slice) -> int:
        if threading.get_ident() != caller:
            begun.set()
            left.wait(60)
        elif part.start == 0:
            begun.wait(60)
        elif part.start == 2:  # all but what the other thread holds
            left.set()
        return threading.get_ident()

    assert [ident == caller for ident in each(work, PARTS, 2)] == [True, False, *[True] * 5]


def test_what_a_thread_raises_reaches_the_caller_and_numpy_warns_as_the_caller_wants():
    caller, together = threading.get_ident(), threading.Barrier(2, timeout=60)

    def work(part: slice) -> None:
        together.wait()
        if threading.get_ident() != caller:
            np.log(np.zeros(1))

    with np.errstate(divide="ignore"):
        each(work, PARTS[:2], 2)
    with np.errstate(divide="raise"), pytest.raises(FloatingPointError):
        each(work, PARTS[:2], 2)


def test_threads_that_call_an_equation_first_compile_it_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    matcher()  # which all compiled functions share
    monkeypatch.setattr(machine, "folder", lambda: tmp_path)
    compiling, own = [], machine._object
    monkeypatch.setattr(machine, "_object", lambda text: compiling.append(text) or own(text))

    @compiled(axes=(0,))
    def tripled(number: np.ndarray) -> np.ndarray:
        return 3.0 * number

    together = threading.Barrier(3, timeout=60)

    def work(part: slice) -> float:
        together.wait()
        return float(tripled(np.array([float(part.start)]))[0])

    assert each(work, PARTS[:3], 3) == [0.0, 3.0, 6.0]
    assert len(compiling) == 1


@pytest.mark.parametrize("batch", [(48,), (3, 16), (1, 48), (2, 3, 8)])
def test_threads_share_rows_of_any_batch(batch: tuple[int, ...], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("estimators.threads.WORTH", 1)
    product = compiled(lambda A, x, b: (A @ x, (x * b).sum(-1) > 0.0), axes=(2, 1, 1), matrices=False)
    rng = np.random.default_rng(0)
    A, x, b = rng.normal(size=(*batch, 3, 3)), rng.normal(size=(*batch, 3)), rng.normal(size=3)
    for _ in range(3):  # the third call repeats the second
        for shared, alone in zip(product(A, x, b, threads=3), product(A, x, b), strict=True):
            np.testing.assert_array_equal(shared, alone)
        np.testing.assert_allclose(shared, (x * b).sum(-1) > 0.0)


def test_arrays_out_of_line_are_copied():
    """Machine code may load numbers as if they began at multiples of eight bytes."""
    doubled = compiled(lambda x: 2.0 * x)
    for _ in range(3):
        np.testing.assert_array_equal(doubled(np.ones((4, 3))), np.full((4, 3), 2.0))
    raw = np.zeros(97, np.uint8)[1:].view(float).reshape(4, 3)
    raw[...] = np.arange(12.0).reshape(4, 3)
    assert not raw.flags.aligned
    assert matcher()(described([np.ones((4, 3))]), raw) is None
    np.testing.assert_array_equal(doubled(raw), 2.0 * raw)
