"""Shared parts of the commands: parsing, one-sentence errors, progress.

Whatever takes time to import is imported where it is used, here and in the commands: ``--help``
answers at once.
"""

from __future__ import annotations

import io
import os
import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import timedelta
from typing import Any

from agents.commands.options import parsed
from agents.refusal import Refusal


def command(
    main: Callable[..., int | None], arguments: Sequence[str] | None = None, name: str | None = None
) -> int | None:
    """Run a command line: bad input ends in one sentence and exit status 2, never in a traceback.

    Bad input is what the parser or `asked` refuses, and what the machine has no room or no right
    for. Any other error is a mistake of ours and keeps its traceback. Arguments and name are those
    of this process if not given. Returns the exit status of the command, if it has one.
    """
    with one_sentence_errors():
        return parsed(main, arguments, name)()


@contextmanager
def one_sentence_errors() -> Iterator[None]:
    """Context of all that a command does.

    What the user or the machine cannot do ends in one sentence and exit status 2.
    """
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
        reason = f"this machine has too little memory for that: {error or 'ask for less'}"
        sys.exit(complain(reason))
    except KeyboardInterrupt as stop:
        print(f"interrupted{f': {stop}' if str(stop) else ''}", file=sys.stderr)
        sys.exit(130)


def _open_output() -> None:
    """Let stdout and stderr take every character, whatever their encoding; a closed one is void."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # and opened for as long as the process lives
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
        elif isinstance(stream := getattr(sys, name), io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _discard_output() -> None:
    """Send what is still to be written to stdout nowhere."""
    with suppress(OSError, ValueError):  # of a stdout that is no file
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


WIDTH = 100
"""Columns of a terminal that are used at most."""
_WHOLE = 10_000
"""Columns of a file or pipe, in which values stand whole."""


def _console() -> Any:
    """Console that wraps between words; a file or pipe has no width, unless ``COLUMNS`` says so."""
    from rich.console import Console

    bounded = sys.stdout.isatty() or "COLUMNS" in os.environ
    width = min(Console().width, WIDTH) if bounded else _WHOLE
    return Console(width=width, markup=False, emoji=False, highlight=False)


def print_table(title: str, header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table of text: columns of words to the left, of numbers to the right.

    Columns that do not fit beside the others stand below, after the first column again. In a file
    or pipe the table has no lines, and its values stand whole.
    """
    from rich.table import Table

    console, texts = _console(), [list(column) for column in zip(header, *rows, strict=True)]
    whole = [re.split(r"(?<!±) (?!±)", " ".join(each)) for each in texts]  # an interval is a word
    least, most = ([max(map(len, each)) for each in of] for of in (whole, texts))
    blocks = [[0]]
    for i in range(1, len(header)):
        if len(blocks[-1]) > 1 and sum(least[j] + 3 for j in (*blocks[-1], i)) >= console.width:
            blocks.append([0])
        blocks[-1].append(i)
    lines: Any = {} if sys.stdout.isatty() else {"box": None, "padding": (0, 2, 0, 0)}
    for columns in blocks:
        widths = {i: least[i] for i in columns}
        room = console.width - 1 - sum(width + 3 for width in widths.values())
        for _ in range(min(room, sum(most))):  # where it is needed most
            i = max(columns, key=lambda i: most[i] - widths[i])
            widths[i] += widths[i] < most[i]
        table = Table(**lines)
        for i, width in widths.items():
            words = all(cell[:1].isalpha() for cell in texts[i][1:] if cell)
            side: Any = "left" if words else "right"
            table.add_column(texts[i][0], justify=side, overflow="fold", width=width)
        for row in list(zip(*(texts[i] for i in columns), strict=True))[1:]:
            table.add_row(*row)
        console.print(title, table, sep="\n")


def print_answer(sentences: Sequence[str]) -> None:
    """Print the answer of a command, in a terminal its first sentences bold."""
    console, (first, *others) = _console(), sentences
    console.print(first, style="bold")
    for sentence in others:
        console.print(sentence)


@contextmanager
def asked() -> Iterator[None]:
    """Context of what is built from the user's words: all that is refused in it is a `Refusal`."""
    import gymnasium as gym

    try:
        yield
    except (ValueError, TypeError, gym.error.Error) as error:
        raise Refusal(str(error)) from error


def complain(text: str) -> int:
    """Print what is wrong, and return the exit status of a refusal."""
    paragraph = "\n".join(line for line in text.splitlines() if line.strip())
    print(f"error: {paragraph}", file=sys.stderr)
    return 2


@contextmanager
def progress(title: str, slow: float = 0) -> Iterator[Callable[..., None]]:
    """Progress by calls with (done, total, text), in a line that changes.

    In a file or pipe a line is written at each tenth, and every ten seconds. From the first tenth
    or minute on, the time that is left is shown, by the pieces of work after the first ``slow``
    ones of this run; none where that is infinite, for pieces of different lengths.
    """
    live = sys.stderr.isatty()
    said, tenth, began, first = 0.0, -1, None, (0, 0.0)

    def show(done: int, total: int, text: str = "") -> None:
        nonlocal said, tenth, began, first
        now, reached = time.monotonic(), 10 * done // max(total, 1)
        began = done if began is None else began
        before, start = first = (done, now) if done <= began + slow else first
        if reached <= tenth and now < said + (0.1 if live else 10.0):
            return
        said, tenth = now, reached
        words = [f"{title}: {done}/{total}", text]
        soon = total - before <= 10 * (done - before) or now - start > 60.0
        if soon and before < done < total:
            left = (now - start) * (total - done) / (done - before)
            words.append(f"{timedelta(seconds=round(left))} left")
        line = ", ".join(filter(None, words))
        print(f"\r{line:79}" if live else line, end="\n"[live:], file=sys.stderr, flush=True)

    try:
        yield show
    finally:
        if live:
            print(file=sys.stderr)


@contextmanager
def job_progress(title: str, processes: int) -> Iterator[Callable[[int, int, int], None]]:
    """Progress for `agents.jobs.run`: jobs that have ended, those that failed included."""
    kept, text = "", "the first jobs take longer, because they compile"

    def report(done: int, failed: int, total: int) -> None:
        nonlocal kept, text
        if done and not kept:
            print(f"resuming: {done} of {total} results found", file=sys.stderr)
        kept = f"{done} of {total} results are kept, and the same command goes on from there"
        show(done + failed, total, f"{failed} failed" if failed else text * (done < total))
        text = ""

    try:
        with progress(title, slow=processes) as show:
            yield report
    except KeyboardInterrupt:
        raise KeyboardInterrupt(kept) from None
