"""Tables of the documentation in Markdown: means with their intervals, written between the marks of a page."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from agents.page import markdown_table
from agents.refusal import Refusal
from agents.statistics import crossed_interval

ROOT = Path(__file__).parents[2]
WITHOUT = "–"


def rows_of(page: Path) -> str:
    """The table alone of a report's page."""
    return "\n".join(
        line for line in page.read_text(encoding="utf-8").splitlines() if line.startswith("|")
    )


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """In Markdown."""
    return markdown_table(heads, rows, len(heads))


def shown(values: np.ndarray, decimals: int = 3) -> str:
    """The mean ``(seeds,)`` or ``(runs, seeds)`` with its 95 % interval."""
    return interval(crossed_interval(np.atleast_2d(values)), decimals)


def interval(of: Any, decimals: int = 3) -> str:
    """A mean and half of its interval; a dash without an interval."""
    return WITHOUT if of is None else f"{of.mean:,.{decimals}f} ± {of.half:.{decimals}f}"


def number(values: np.ndarray, decimals: int) -> str:
    """The mean over flights."""
    return f"{np.mean(values):.{decimals}f}"


def percent(share: float | None) -> str:
    """Share of times in percent; a dash without any."""
    return WITHOUT if share is None else f"{100.0 * share:.0f} %"


def put(page: Path, mark: str, text: str) -> None:
    """Write a text into a page, in place of what stands between its lines ``<!-- mark -->`` and ``<!-- end -->``.

    Raises:
        Refusal: as for `around`.
    """
    before, after = around(page, mark)
    page.write_text(f"{before}\n{text.strip()}\n\n{after}", encoding="utf-8")


def around(page: Path, mark: str) -> tuple[str, str]:
    """A page up to its line ``<!-- mark -->``, and from the next line ``<!-- end -->``.

    Raises:
        Refusal: if the page has no such lines, or several for this mark.
    """
    before, *inside = re.split(
        f"(?m)^(<!-- {re.escape(mark)} -->\n)", page.read_text(encoding="utf-8")
    )
    if len(inside) != 2 or "\n<!-- end -->" not in inside[1]:
        raise Refusal(f"{page} needs one line <!-- {mark} --> and a line <!-- end --> below it")
    return before + inside[0], inside[1][inside[1].index("<!-- end -->") :]
