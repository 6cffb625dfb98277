"""Tables and texts of pages in Markdown, and their places between marks."""

import re
import subprocess
from collections.abc import Callable, Sequence
from datetime import date
from pathlib import Path

from agents.page import markdown_table
from agents.refusal import Refusal

ROOT = Path(__file__).parents[1]
NONE = "–"


def around(page: Path, mark: str) -> tuple[str, str]:
    """A page up to its line ``<!-- mark -->``, and from the next line ``<!-- end -->``.

    Raises:
        Refusal: if the page has no such lines, or several for this mark.
    """
    line = f"(?m)^(<!-- {re.escape(mark)} -->\n)"
    before, *inside = re.split(line, page.read_text(encoding="utf-8"))
    if len(inside) != 2 or "\n<!-- end -->" not in inside[1]:
        raise Refusal(f"{page} needs one line <!-- {mark} --> and a line <!-- end --> below it")
    return before + inside[0], inside[1][inside[1].index("<!-- end -->") :]


def put(page: Path, mark: str, text: str) -> None:
    """Write a text into a page, in place of what stands between the lines of its mark."""
    before, after = around(page, mark)
    page.write_text(f"{before}\n{text.strip()}\n\n{after}", encoding="utf-8")


def publish(report: Callable[[], str], page: Path | None, mark: str) -> None:
    """Print a report, and write it into a page, if one is given, between the lines of its mark.

    Raises:
        Refusal: before anything is measured, if the page has no such lines.
    """
    if page is not None:
        around(page, mark)
    text = report()
    print(text)
    if page is not None:
        put(page, mark, text)


def measured_on() -> str:
    """The day, the commit and the processor of a measurement, in a sentence."""
    git = ("git", "rev-parse", "--short", "HEAD")
    commit = subprocess.run(git, cwd=ROOT, capture_output=True, text=True).stdout.strip()
    processors = re.findall(r"model name\s*: (.+)", Path("/proc/cpuinfo").read_text())
    day = f"{date.today():%d %B %Y}".lstrip("0")
    return f"Measured on {day} (commit {commit}) on one core of {processors[0]}."


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown."""
    return markdown_table(heads, rows, len(heads))
