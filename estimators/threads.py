"""Rows of a batch in several threads: what is compiled, and the loops of NumPy, then run side by side."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from functools import cache
from typing import TypeVar

from estimators.engine.function import LANES

Result = TypeVar("Result")
FEWEST = 256
"""Rows that are worth a thread: waking it costs some 20 us."""


@cache
def shares(rows: int, threads: int, fewest: int = FEWEST) -> tuple[slice, ...]:
    """Slices of the rows, whole vectors of the engine, about as many in each: one a thread, or fewer of few rows."""
    count = max(1, min(threads, rows // fewest))
    cuts = [*(rows * i // count // LANES * LANES for i in range(count)), rows]
    return tuple(map(slice, cuts[:-1], cuts[1:]))


def each(work: Callable[[slice], Result], parts: Sequence[slice], threads: int) -> list[Result]:
    """What ``work`` gives for each of the parts, in their order.

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
