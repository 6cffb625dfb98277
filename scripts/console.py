"""What the commands share: parsing, one-sentence errors, progress."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import gymnasium as gym
import tyro
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn


def command(main: Callable[..., Any]) -> None:
    """Run a command line: bad input ends in one sentence and exit status 2, never in a traceback."""
    try:
        tyro.cli(main)
    except (ValueError, TypeError, OSError, gym.error.Error) as error:
        sys.exit(_complain(error))
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
