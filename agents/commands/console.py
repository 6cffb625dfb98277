"""Shared parts of the commands: parsing, one-sentence errors, progress.

Whatever takes time to import is imported where it is used, here and in the commands: ``--help``
answers at once.
"""

from __future__ import annotations

import codecs
import functools
import io
import os
import re
import sys
import time
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, suppress
from datetime import datetime, timedelta
from itertools import count, pairwise
from typing import TYPE_CHECKING, Any

import tyro

from agents.refusal import Refusal

if TYPE_CHECKING:
    from agents.jobs import Status

MOST = 2**31 - 1
"""No number of anything that a command takes may be greater."""


def command(
    main: Callable[..., int | None], arguments: Sequence[str] | None = None, name: str | None = None
) -> int | None:
    """Run a command line: bad input ends in one sentence and exit status 2, never in a traceback.

    Bad input is what the parser or `asked` refuses, and what the machine has no room or no right
    for. Any other error is a mistake of ours and keeps its traceback. Arguments and name are those
    of this process if not given. Returns the exit status of the command, if it has one.
    """
    with one_sentence_errors():
        return _parsed(main, arguments, name)()


@contextmanager
def one_sentence_errors() -> Iterator[None]:
    """Around all that a command does: what the user or the machine cannot do ends in one sentence and exit status 2."""
    _open_output()
    try:
        try:
            yield
        finally:
            sys.stdout.flush()
    except ModuleNotFoundError as error:
        from vessel_gym.extras import missing

        sentence = missing(error.name)
        if sentence is None:
            raise
        sys.exit(complain(sentence))
    except BrokenPipeError:  # whoever read stdout has seen enough
        _discard_output()
        sys.exit(1)
    except (Refusal, OSError) as error:
        # if the disk is full, what is left in the buffer cannot be written at the end, either
        _discard_output()
        sys.exit(complain(str(error)))
    except MemoryError as error:
        sys.exit(
            complain(f"this machine has too little memory for that: {error or 'ask for less'}")
        )
    except KeyboardInterrupt as stop:
        print(f"interrupted{f': {stop}' if str(stop) else ''}", file=sys.stderr)
        sys.exit(130)


def _open_output() -> None:
    """Let stdout and stderr take every character, spelled out where their encoding lacks it; a closed one is void."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115, as open as the process lives
        elif isinstance(stream := getattr(sys, name), io.TextIOWrapper):
            stream.reconfigure(errors=_SPELLED)


def _discard_output() -> None:
    """Send what is still to be written to stdout nowhere."""
    with suppress(OSError, ValueError):  # of a stdout that is no file
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


_SPELLED = "vessel_gym.spelled"
"""Name under which Python knows `_spelled`."""


def _spelled(error: UnicodeError) -> tuple[str | bytes, int]:
    """Spell out characters that an encoding lacks: sigma, +-, lines of boxes; others as Python's escapes."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(map(_spelling, error.object[error.start : error.end])), error.end


def _spelling(character: str) -> str:
    """A character in ASCII."""
    name = unicodedata.name(character, "")
    if name.startswith("GREEK"):
        return name.rpartition(" ")[2].lower()
    if name.startswith("BOX DRAWINGS"):
        return "-" if name.endswith("HORIZONTAL") else "|" if name.endswith("VERTICAL") else "+"
    plain = (
        _ASCII.get(character)
        or unicodedata.normalize("NFKD", character).encode("ascii", "ignore").decode()
    )
    return plain or character.encode("ascii", "backslashreplace").decode()


_ASCII = {
    "±": "+-", "×": "x", "−": "-", "–": "-", "—": "-", "·": "*", "°": "deg", "≤": "<=", "≥": ">=", "≈": "~", "→": "->",
}  # fmt: skip
codecs.register_error(_SPELLED, _spelled)


def print_table(
    title: str, header: Sequence[str], sections: Iterable[Iterable[Sequence[str]]]
) -> None:
    """Print a table of text, with numbers in all columns but the first; as wide as it needs to be in a file or pipe."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    def written(text: str) -> str:  # as wide as it will be
        return escape(
            text.encode(sys.stdout.encoding or "utf-8", _SPELLED).decode(
                sys.stdout.encoding or "utf-8"
            )
        )

    console, table = (
        Console(width=None if sys.stdout.isatty() else 1000),
        Table(title=written(title)),
    )
    sections = [[[*map(written, row)] for row in rows] for rows in sections]
    columns = [*zip(header, *(row for rows in sections for row in rows), strict=True)][1:]
    whole = (
        15 + sum(3 + max(map(len, column)) for column in columns) < console.width
    )  # the first column makes room
    for label in header:
        numbers = bool(table.columns)
        justify: Any = "right" if numbers else "left"
        table.add_column(
            written(label), justify=justify, no_wrap=whole and numbers, overflow="fold"
        )
    for rows in sections:
        for row in rows:
            table.add_row(*row)
        table.add_section()
    console.print(table)


@contextmanager
def asked() -> Iterator[None]:
    """Around what is built from the user's words: whatever is refused there is the user's mistake."""
    import gymnasium as gym

    try:
        yield
    except (ValueError, TypeError, gym.error.Error) as error:
        raise Refusal(str(error)) from error


def in_range(name: str, number: int, least: int, most: int = MOST) -> None:
    """Refuse a number that is too small or too great.

    Raises:
        ValueError: naming what must be in the range.
    """
    if number < least:
        raise ValueError(f"{name} must be at least {least}, got {number}")
    if number > most:
        raise ValueError(f"{name} must be at most {most}, got {number}")


def _parsed(
    main: Callable[..., int | None], arguments: Sequence[str] | None, name: str | None
) -> Callable[[], int | None]:
    """The call of a command that a command line asks for.

    Raises:
        Refusal: if it asks for none.
    """

    @functools.wraps(main)
    def call(*positional: Any, **named: Any) -> Any:
        return functools.partial(main, *positional, **named)

    given = sys.argv[1:] if arguments is None else list(arguments)
    if any(re.match(r"[A-Za-z_][\w.]*:", word) for word in given) and os.getcwd() not in sys.path:
        sys.path.append(
            os.getcwd()
        )  # where a module:object of the user's own lies; behind our packages
    for before, word in pairwise(["", *given]):
        if not word:  # which would be taken for a path: that of the present folder
            raise Refusal(
                f"the argument after {before!r} is empty"
                if before
                else "the first argument is empty"
            )
        if word.startswith("--") and word.endswith("="):
            raise Refusal(f"{word[:-1]} is given an empty word")
    box = io.StringIO()
    try:
        with redirect_stderr(box):
            return tyro.cli(call, args=arguments, prog=name)
    except SystemExit as stop:
        if stop.code != 2:
            raise
        raise Refusal(_boxed(box.getvalue())) from None
    except AssertionError as error:  # tyro's own, about a shell that it has no completion for
        raise Refusal(str(error)) from None


def _boxed(text: str) -> str:
    """The sentence in a box that tyro draws, and the option that may be meant.

    A title, then a rule where the terminal has no lines to draw with; what follows, up to the next
    rule, is it.
    """
    lines = [line.strip("│╰╯ ") for line in re.sub(r"\x1b\[[0-9;]*m", "", text).splitlines()[1:]]
    ruled = [bool(line) and not line.strip("─-") for line in lines]
    start = int(ruled[:1] == [True])
    end = ruled.index(True, start) if True in ruled[start:] else len(lines)
    sentence = " ".join(line for line in lines[start:end] if line)
    meant = re.search(r"Perhaps you meant:\s+(--[\w-]+)", "\n".join(lines))
    return (
        f"{sentence.rstrip('.')}{f' (did you mean {meant[1]}?)' if meant else ''}; --help tells"
        " what there is"
    )


def complain(text: str) -> int:
    """Print in red what is wrong, and return the exit status of a refusal."""
    from rich.console import Console

    paragraph = "\n".join(line for line in text.splitlines() if line.strip())
    Console(stderr=True, soft_wrap=True).print(
        f"error: {paragraph}", style="red", markup=False, highlight=False
    )
    return 2


_PAUSE = 10.0
"""Seconds between two lines of progress, where they are not drawn over each other."""


class _Lines:
    """Progress in plain lines, for files and pipes: at the start and the end, at each tenth, and every ten seconds.

    Work that is ``even``, each piece as long as another, gets the time that is left.
    """

    def __init__(self, title: str, even: bool) -> None:
        self._title, self._even, self._said, self._tenth = title, even, 0.0, -1
        self._first: tuple[int, float] | None = None

    def __call__(self, done: int, total: int, text: str = "") -> None:
        """Say it, if it is time to."""
        tenth, now = 10 * done // max(total, 1), time.monotonic()
        first, start = self._first = self._first or (done, now)
        if tenth > self._tenth or now >= self._said + _PAUSE:
            self._tenth, self._said = tenth, now
            timed = self._even and first < done < total
            left = (
                f"{timedelta(seconds=round((now - start) * (total - done) / (done - first)))} left"
                if timed
                else ""
            )
            print(
                ", ".join(filter(None, (f"{self._title}: {done}/{total}", text, left))),
                file=sys.stderr,
                flush=True,
            )


@contextmanager
def progress(
    title: str, total: int | None = None, counted: bool = False
) -> Iterator[Callable[..., None]]:
    """Progress by calls with (done, total, text): a bar with the time that is left or, without a terminal, lines."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )  # fmt: skip

    if (
        not Console(stderr=True).is_terminal or "JPY_PARENT_PID" in os.environ
    ):  # a notebook keeps every frame
        yield _Lines(title, even=not counted)
        return
    numbers = (MofNCompleteColumn(), TimeElapsedColumn()) if counted else (TimeRemainingColumn(),)
    texts = TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[text]}")
    with Progress(*texts, *numbers, console=Console(stderr=True)) as bar:
        task = bar.add_task(title, total=total, text="")
        yield lambda done, total, text="": bar.update(task, completed=done, total=total, text=text)


@contextmanager
def training_progress(title: str) -> Iterator[Callable[[int, int, float], None]]:
    """Progress of a training: steps, score of the last evaluation on tuning seeds."""
    with progress(title) as show:
        yield lambda done, total, score: show(
            done, total, f"evaluation {score:.3f}" if score == score else ""
        )


@contextmanager
def progress_bar(title: str, total: int) -> Iterator[Callable[[], None]]:
    """Progress over ``total`` equal pieces of work; call what it yields after each."""
    done = count(1)
    with progress(title, total) as show:
        yield lambda: show(next(done), total)


@contextmanager
def job_progress(title: str) -> Iterator[Callable[[Status], None]]:
    """Progress for `agents.jobs.run`: jobs that have ended, and the time of day at which all will have."""
    done = total = 0

    def report(status: Status) -> None:
        nonlocal done, total
        if not total and status.done:
            print(f"goes on: {status.done} of {status.total} results are there", file=sys.stderr)
        done, total = status.done, status.total
        show(status.done + status.failed, status.total, _end(status))

    try:
        with progress(title, counted=True) as show:
            yield report
    except KeyboardInterrupt:
        kept = (
            f"{done} of {total} results are kept, and the same command goes on from there"
            if total
            else ""
        )
        raise KeyboardInterrupt(kept) from None


def _end(status: Status) -> str:
    """Time of day at which the work will be done, which stays true while no job ends."""
    failed = f"{status.failed} failed, " if status.failed else ""
    if status.done + status.failed == status.total:
        return f"{failed}done"
    if status.seconds_left is None:
        return f"{failed}measuring how long it takes"
    end = datetime.now() + timedelta(seconds=status.seconds_left)
    return f"{failed}ends about {end:%H:%M:%S}, in {timedelta(seconds=round(status.seconds_left))}"
