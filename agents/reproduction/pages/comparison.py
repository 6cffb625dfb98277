"""Printed numbers beside ours, as a table; means and ratios with their intervals."""

import numpy as np

from agents.page import Entry, Table, number
from agents.reproduction.comparison import Comparison
from agents.statistics import Interval, mean_interval


def mean_of(values: np.ndarray) -> Interval:
    """Mean with its 95 % interval."""
    interval = mean_interval(values)
    assert interval is not None  # every cell has its runs
    return interval


def geometric_ratio(errors: np.ndarray, others: np.ndarray) -> Interval:
    """The geometric mean ratio of paired errors ``(runs,)`` with its 95 % interval."""
    logs = mean_of(np.log(errors) - np.log(others))
    return Interval(*(float(np.exp(end)) for end in (logs.mean, logs.low, logs.high)))


def comparison_table(title: str, note: str, comparisons: list[Comparison], name: str = "") -> Table:
    """Published, ours and verdict, a line each; a section for each row of the published table."""
    sections: dict[str, list[tuple[str, list[Entry]]]] = {}
    for c in comparisons:
        printed = c.published.printed + (f" (meant: {c.published.value:g})" if c.published.meant is not None else "")
        line = [Entry(printed), _ours(c), Entry(c.published.unit), Entry(c.verdict)]
        sections.setdefault(c.row, []).append((c.column, line))
    head = [("published", ""), ("ours", ""), ("unit", ""), ("verdict", "")]
    return Table(title, note, "", head, list(sections.items()), name)


def _ours(comparison: Comparison) -> Entry:
    """Our mean and interval, with a digit more than the published number has."""
    ours = comparison.ours
    if ours is None:
        return Entry("–")
    published = comparison.published
    shown = published.printed if published.meant is None else str(published.meant)
    decimals = len(shown.partition(".")[2]) + 1
    return Entry(number(ours.mean, decimals), number(ours.half, decimals))
