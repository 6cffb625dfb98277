"""Rows of a batch in several threads: what is compiled, and the loops of NumPy, then run side by side."""

import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from contextvars import copy_context
from functools import cache, partial
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any, TypeVar

Result = TypeVar("Result")
_FEWEST = 256
"""Rows that are worth a thread: waking it costs some 20 us."""
_LANES = 64
"""Rows that stand side by side in `estimators.sentences`."""


@cache
def shares(rows: int, threads: int) -> tuple[slice, ...]:
    """Slices of the rows, about as many in each: one a thread, or fewer of few rows."""
    count = max(1, min(threads, rows // _FEWEST))
    cuts = [*(rows * i // count // _LANES * _LANES for i in range(count)), rows]
    return tuple(map(slice, cuts[:-1], cuts[1:]))


def each(work: Callable[[slice], Result], parts: Sequence[slice], threads: int) -> list[Result]:
    """What ``work`` gives for each of the parts, in their order.

    The caller is one of the threads, and does what no other has begun: a busy machine makes nobody wait.
    """
    if threads == 1 or len(parts) == 1:
        return [work(part) for part in parts]
    asked, done = _asked(os.getpid(), threads - 1), SimpleQueue[tuple[int, Any, BaseException | None]]()

    def finish(i: int) -> None:
        try:
            done.put((i, work(parts[i]), None))
        except BaseException as error:
            done.put((i, None, error))

    for i in range(1, len(parts)):
        asked.put(partial(copy_context().run, finish, i))
    finish(0)
    with suppress(Empty):
        while True:
            asked.get_nowait()()
    results: list[Any] = [None] * len(parts)
    for _ in parts:
        i, results[i], error = done.get()
        if error is not None:
            raise error
    return results


@cache
def _asked(process: int, threads: int) -> SimpleQueue[Callable[[], None]]:
    """What some threads of a process are asked to do: half the price of the library's pool, which wants a lock each.

    A process that is forked has none of its parent's threads, hence its number.
    """
    asked = SimpleQueue[Callable[[], None]]()
    for _ in range(threads):
        Thread(target=_serve, args=(asked,), name="vessel-gym", daemon=True).start()
    return asked


def _serve(asked: SimpleQueue[Callable[[], None]]) -> None:
    while True:
        asked.get()()
