"""Which cells come when, in which part of a job array, and how long they take."""

import heapq
import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from agents.cells.cell import Cell


def with_needs(cells: Iterable[Cell]) -> dict[str, Cell]:
    """The cells and all that they need, by key, needs first."""
    found: dict[str, Cell] = {}
    for cell in cells:
        found |= with_needs(cell.needs)
        found[cell.key] = cell
    return found


def part(cells: Mapping[str, Cell], i: int, n: int) -> dict[str, Cell]:
    """The i-th of n parts, each with all that it needs; what needs the same cell first goes together."""
    if not 1 <= i <= n:
        raise ValueError(f"a shard is i/n with 1 <= i <= n, got {i}/{n}")

    def root(cell: Cell) -> str:
        return root(cell.needs[0]) if cell.needs else cell.key

    needed = {need.key for cell in cells.values() for need in cell.needs}
    last = [cell for key, cell in cells.items() if key not in needed]
    parts = {key: number % n for number, key in enumerate(sorted({root(cell) for cell in last}))}
    return with_needs(cell for cell in last if parts[root(cell)] == i - 1)


def waves(cells: Mapping[str, Cell]) -> list[list[Cell]]:
    """What can be computed at once, then what needs that, and so on."""
    left, found = dict(cells), []
    while left:
        ready = {key: cell for key, cell in left.items() if not any(need.key in left for need in cell.needs)}
        left = {key: cell for key, cell in left.items() if key not in ready}
        found.append(list(ready.values()))
    return found


class Clock:
    """How long cells take: equal labels alike, else the mean of the same function."""

    def __init__(self, lines: Iterable[Mapping[str, Any]]) -> None:
        self._times: dict[str, tuple[int, float]] = {}
        for line in lines:
            self.add(line["label"], line["function"], line["seconds"])

    def add(self, label: str, function: str, seconds: float) -> None:
        """Take in one cell's time."""
        for name in {label, function}:
            count, total = self._times.get(name, (0, 0.0))
            self._times[name] = count + 1, total + seconds

    def expected(self, cell: Cell) -> float | None:
        """Seconds that a cell will take; None if its function was never timed."""
        count, total = self._times.get(cell.label or cell.function) or self._times.get(cell.function) or (0, 0.0)
        return total / count if count else None

    def longest_first(self, cells: Sequence[Cell]) -> list[Cell]:
        """An order that keeps all processes busy to the end; what was never timed comes first."""

        def expected(cell: Cell) -> float:
            seconds = self.expected(cell)
            return np.inf if seconds is None else seconds

        return sorted(cells, key=expected, reverse=True)


class Forecast:
    """How long a run will take, known at any moment.

    To ask every cell that is left takes longer the more there are, so that is done only as often as it takes a
    hundredth of the time; in between the time that passed is taken off.
    """

    def __init__(self, clock: Clock, left: Sequence[Mapping[str, Cell]]) -> None:
        """For waves of cells by key, of which the caller removes what has ended."""
        self._clock, self._left = clock, left
        self._seconds: float | None = None
        self._made, self._due = 0.0, 0.0

    def seconds_left(self, workers: int) -> float | None:
        """See `seconds_left`."""
        now = time.monotonic()
        if now >= self._due or not any(self._left):
            waves = [[self._clock.expected(cell) for cell in wave.values()] for wave in self._left]
            self._seconds, self._made = seconds_left(waves, workers), now
            self._due = now + 100.0 * (time.monotonic() - now)
        return None if self._seconds is None else max(self._seconds - (now - self._made), 0.0)


def seconds_left(waves: Sequence[Sequence[float | None]], workers: int) -> float | None:
    """Seconds that workers take for waves of cells, each wave longest first, if cells take as long as expected.

    A wave begins when the one before has ended. None if a cell's time is not known.
    """
    total = 0.0
    for wave in waves:
        known = [seconds for seconds in wave if seconds is not None]
        if len(known) < len(wave):
            return None
        busy = [0.0] * workers
        for seconds in sorted(known, reverse=True):
            heapq.heapreplace(busy, busy[0] + seconds)
        total += max(busy)
    return total
