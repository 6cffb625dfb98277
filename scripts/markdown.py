"""Tables of the documentation in Markdown: numbers, means with their intervals, and where each stands."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
WITHOUT = "–"


def rows_of(page: Path) -> str:
    """The table alone of a report's page."""
    return "\n".join(line for line in page.read_text(encoding="utf-8").splitlines() if line.startswith("|"))


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """In Markdown."""
    return "\n".join("| " + " | ".join(line) + " |" for line in (heads, ["---"] * len(heads), *rows))


def shown(values: np.ndarray, decimals: int = 3) -> str:
    """The mean ``(seeds,)`` or ``(runs, seeds)`` with its 95 % interval."""
    from agents.statistics import crossed_interval

    interval = crossed_interval(np.atleast_2d(values))
    return WITHOUT if interval is None else f"{interval.mean:,.{decimals}f} ± {interval.half:.{decimals}f}"


def number(values: np.ndarray, decimals: int) -> str:
    """The mean over flights."""
    return f"{np.mean(values):.{decimals}f}"


def percent(share: float | None) -> str:
    """Of times; where there are none, that."""
    return WITHOUT if share is None else f"{100.0 * share:.0f} %"
