"""Order of jobs, parts of job arrays, and forecasts of their time."""

import heapq
import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from agents.jobs.job import Job


def with_needs(jobs: Iterable[Job]) -> dict[str, Job]:
    """The jobs and all that they need, by key, needs first."""
    found: dict[str, Job] = {}
    for job in jobs:
        found |= with_needs(job.needs)
        found[job.key] = job
    return found


def part(jobs: Mapping[str, Job], i: int, n: int) -> dict[str, Job]:
    """The i-th of n parts, each with all that it needs; what needs the same job first goes together."""
    if not 1 <= i <= n:
        raise ValueError(f"a shard is i/n with 1 <= i <= n, got {i}/{n}")

    def root(job: Job) -> str:
        return root(job.needs[0]) if job.needs else job.key

    needed = {need.key for job in jobs.values() for need in job.needs}
    last = [job for key, job in jobs.items() if key not in needed]
    parts = {key: number % n for number, key in enumerate(sorted({root(job) for job in last}))}
    return with_needs(job for job in last if parts[root(job)] == i - 1)


def waves(jobs: Mapping[str, Job]) -> list[list[Job]]:
    """Topological generations: jobs without open needs, then those that need them, and so on."""
    left, found = dict(jobs), []
    while left:
        ready = {
            key: job for key, job in left.items() if not any(need.key in left for need in job.needs)
        }
        left = {key: job for key, job in left.items() if key not in ready}
        found.append(list(ready.values()))
    return found


class Clock:
    """Mean times of jobs by label, or else by function."""

    def __init__(self, lines: Iterable[Mapping[str, Any]]) -> None:
        self._times: dict[str, tuple[int, float]] = {}
        for line in lines:
            self.add(line["label"], line["function"], line["seconds"])

    def add(self, label: str, function: str, seconds: float) -> None:
        """Take in one job's time."""
        for name in {label, function}:
            count, total = self._times.get(name, (0, 0.0))
            self._times[name] = count + 1, total + seconds

    def expected(self, job: Job) -> float | None:
        """Seconds that a job will take; None if its function was never timed."""
        count, total = (
            self._times.get(job.label or job.function) or self._times.get(job.function) or (0, 0.0)
        )
        return total / count if count else None

    def longest_first(self, jobs: Sequence[Job]) -> list[Job]:
        """An order that keeps all processes busy to the end; what was never timed comes first."""

        def expected(job: Job) -> float:
            seconds = self.expected(job)
            return np.inf if seconds is None else seconds

        return sorted(jobs, key=expected, reverse=True)


class Forecast:
    """Forecast of the seconds that a run will take.

    To ask every job that is left takes longer the more there are, so that is done only as often as
    it takes a hundredth of the time; in between the time that passed is taken off.
    """

    def __init__(self, clock: Clock, left: Sequence[Mapping[str, Job]]) -> None:
        """For waves of jobs by key, of which the caller removes what has ended."""
        self._clock, self._left = clock, left
        self._seconds: float | None = None
        self._made, self._due = 0.0, 0.0

    def seconds_left(self, workers: int) -> float | None:
        """See `seconds_left`."""
        now = time.monotonic()
        if now >= self._due or not any(self._left):
            waves = [[self._clock.expected(job) for job in wave.values()] for wave in self._left]
            self._seconds, self._made = seconds_left(waves, workers), now
            self._due = now + 100.0 * (time.monotonic() - now)
        return None if self._seconds is None else max(self._seconds - (now - self._made), 0.0)


def seconds_left(waves: Sequence[Sequence[float | None]], workers: int) -> float | None:
    """Seconds that workers take for waves of jobs, each wave longest first, if jobs take as long as expected.

    A wave begins when the one before has ended. None if a job's time is not known.
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
