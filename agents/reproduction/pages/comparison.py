"""Printed numbers beside ours, as a table."""

from agents.page import Entry, Table, number
from agents.reproduction.comparison import Comparison


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
