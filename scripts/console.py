"""What the commands share: parsing, one-sentence errors, progress."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime, timedelta

import gymnasium as gym
import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from agents.cells import Status
from vessel_gym.extras import missing


def command(main: Callable[..., int | None]) -> int | None:
    """Run a command line: bad input ends in one sentence and exit status 2, never in a traceback.

    Returns:
        What the command returns: its exit status, if it has one.
    """
    try:
        return tyro.cli(main)
    except (ValueError, TypeError, OSError, gym.error.Error) as error:
        sys.exit(_complain(error))
    except ModuleNotFoundError as error:
        if missing(error.name) is None:
            raise
        sys.exit(_complain(ModuleNotFoundError(missing(error.name))))
    except KeyboardInterrupt:
        sys.exit(130)


def _complain(error: Exception) -> int:
    Console(stderr=True, soft_wrap=True).print(f"error: {error}", style="red", markup=False, highlight=False)
    return 2


@contextmanager
def training_progress(title: str) -> Iterator[Callable[[int, int, float], None]]:
    """A progress bar for `agents.ppo.train`: steps, time left, mean score of late episodes."""
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[score]}"), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(title, total=None, score="")

        def progress(done: int, total: int, score: float) -> None:
            text = f"score {score:.3f}" if score == score else ""
            bar.update(task, completed=done, total=max(done, total), score=text)

        yield progress


@contextmanager
def progress_bar(title: str, total: int) -> Iterator[Callable[[], None]]:
    """A progress bar over ``total`` equal pieces of work; call what it yields after each."""
    with Progress(console=Console(stderr=True)) as bar:
        task = bar.add_task(title, total=total)
        yield lambda: bar.advance(task)


@contextmanager
def cell_progress(title: str) -> Iterator[Callable[[Status], None]]:
    """A progress bar for `agents.cells.run`: cells done, what ended last, and when all will be."""
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
