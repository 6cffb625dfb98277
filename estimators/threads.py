"""Rows of a batch in several threads: what is compiled, and the loops of NumPy, then run side by side."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from functools import cache
from typing import TypeVar

Result = TypeVar("Result")
WORTH = 1_000_000
"""Operations that are worth a thread: they take some 40 us. A thread starts some 20 us after the caller."""


def shares(rows: int, threads: int, operations: int, lanes: int = 1) -> list[slice]:
    """Slices of the rows, one a thread, or fewer where little is computed.

    The first is the caller's. It has more rows by what the caller computes while the others wake: half of `WORTH`.

    Args:
        rows: How many.
        threads: At most so many slices.
        operations: That a row takes.
        lanes: Slices begin at multiples of this number.
    """
    count = max(1, min(threads, rows * operations // WORTH, rows // lanes))
    ahead = WORTH // max(2 * operations, 1)  # rows
    cuts = [0, *((ahead + (rows - ahead) * i // count) // lanes * lanes for i in range(1, count)), rows]
    return list(map(slice, cuts[:-1], cuts[1:]))


def each(work: Callable[[slice], Result], parts: Sequence[slice], threads: int) -> list[Result]:
    """Results of ``work`` for each of the parts, in their order.

    The caller is one of the threads, and does what no other has begun: a busy machine makes nobody wait.
    """
    if threads == 1 or len(parts) == 1:
        return [work(part) for part in parts]
    submit = _pool(os.getpid(), threads - 1).submit
    asked = {part.start: submit(copy_context().run, work, part) for part in parts[1:]}
    results = {parts[0].start: work(parts[0])}
    results |= {part.start: work(part) for part in parts[1:] if asked[part.start].cancel()}
    return [results[part.start] if part.start in results else asked[part.start].result() for part in parts]


@cache
def _pool(process: int, threads: int) -> ThreadPoolExecutor:
    """Threads of a process, by its number: one that is forked has none of its parent's."""
    return ThreadPoolExecutor(threads, "vessel-gym")
