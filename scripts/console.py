"""What the commands share: parsing, one-sentence errors, progress."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime, timedelta
from itertools import count

import gymnasium as gym
import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from agents.cells import Status


def command(main: Callable[..., int | None]) -> int | None:
    """Run a command line: bad input ends in one sentence and exit status 2, never in a traceback.

    Returns:
        What the command returns: its exit status, if it has one.
    """
    try:
        return tyro.cli(main)
    except (ValueError, TypeError, OSError, gym.error.Error) as error:
        sys.exit(_complain(error))
    except KeyboardInterrupt:
        sys.exit(130)


def _complain(error: Exception) -> int:
    Console(stderr=True, soft_wrap=True).print(f"error: {error}", style="red", markup=False, highlight=False)
    return 2


_PAUSE = 10.0
"""Seconds between two lines of progress, where they are not drawn over each other."""


class _Lines:
    """Progress in plain lines, for files and pipes: at the start and the end, at each tenth, and every ten seconds."""

    def __init__(self, title: str) -> None:
        self._title, self._said, self._tenth = title, 0.0, -1

    def __call__(self, done: int, total: int, text: str = "") -> None:
        """Say it, if it is time to."""
        tenth, now = 10 * done // max(total, 1), time.monotonic()
        if tenth > self._tenth or now >= self._said + _PAUSE:
            self._tenth, self._said = tenth, now
            print(f"{self._title}: {done}/{total}" + (f", {text}" if text else ""), file=sys.stderr, flush=True)


@contextmanager
def training_progress(title: str) -> Iterator[Callable[[int, int, float], None]]:
    """Progress for `agents.ppo.train`: steps, mean score of late episodes; a bar or, without a terminal, lines."""
    if not Console(stderr=True).is_terminal:
        lines = _Lines(title)
        yield lambda done, total, score: lines(done, max(done, total), f"score {score:.3f}")
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[score]}"), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(title, total=None, score="")

        def progress(done: int, total: int, score: float) -> None:
            text = f"score {score:.3f}" if score == score else ""
            bar.update(task, completed=done, total=max(done, total), score=text)

        yield progress


@contextmanager
def progress_bar(title: str, total: int) -> Iterator[Callable[[], None]]:
    """Progress over ``total`` equal pieces of work; call what it yields after each."""
    if not Console(stderr=True).is_terminal:
        lines, done = _Lines(title), count(1)
        yield lambda: lines(next(done), total)
        return
    with Progress(console=Console(stderr=True)) as bar:
        task = bar.add_task(title, total=total)
        yield lambda: bar.advance(task)


@contextmanager
def cell_progress(title: str) -> Iterator[Callable[[Status], None]]:
    """Progress for `agents.cells.run`: cells done and when all will be, in a bar or, without a terminal, in lines."""
    if not Console(stderr=True).is_terminal:
        lines = _Lines(title)
        yield lambda status: lines(status.done + status.failed, status.total, _end(status))
        return
    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[end]}"),
        TimeElapsedColumn(),
    )  # fmt: skip
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(title, total=None, end="")

        def progress(status: Status) -> None:
            bar.update(task, completed=status.done, total=status.total, end=_end(status))

        yield progress


def _end(status: Status) -> str:
    """When the work will be done, as a time of day: true also while nothing ends."""
    failed = f"{status.failed} failed, " if status.failed else ""
    if status.done + status.failed == status.total:
        return f"{failed}done"
    if status.seconds_left is None:
        return f"{failed}measuring how long it takes"
    end = datetime.now() + timedelta(seconds=status.seconds_left)
    return f"{failed}ends about {end:%H:%M:%S}, in {timedelta(seconds=round(status.seconds_left))}"
