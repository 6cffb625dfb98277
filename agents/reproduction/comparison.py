"""Printed numbers beside ours, each with a verdict in words."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from agents.statistics import Interval


@dataclass(frozen=True)
class Published:
    """A number that a paper prints.

    Attributes:
        printed: To the digit.
        unit: Of the number.
        where: Table, figure or page.
        meant: The number without its misprint.
    """

    printed: str
    unit: str
    where: str
    meant: float | None = None

    @property
    def value(self) -> float:
        """The number."""
        return float(self.printed) if self.meant is None else self.meant


def published_table(
    rows: Mapping[int, Sequence[str]], units: Mapping[str, str], where: str
) -> dict[int, dict[str, Published]]:
    """A printed table by its rows, then by quantity, the columns in the order of the units."""
    return {
        row: {name: Published(text, unit, where) for (name, unit), text in zip(units.items(), texts, strict=True)}
        for row, texts in rows.items()
    }


@dataclass(frozen=True)
class Comparison:
    """A published error and ours.

    Attributes:
        row: The row of the published table.
        column: Its column.
        published: The printed number.
        ours: Our mean with its 95 % interval; None where there is none.
        above: Why ours is above, where it is.
        incomparable: Why the two do not compare, where they do not.

    Raises:
        ValueError: if ours is above the published value and nobody says why.
    """

    row: str
    column: str
    published: Published
    ours: Interval | None
    above: str = ""
    incomparable: str = ""

    def __post_init__(self) -> None:
        if self.ours is None and not self.incomparable:
            raise ValueError(f"{self.row}, {self.column}: a number of ours, or why there is none")
        if self.kind == "above" and not self.above:
            raise ValueError(f"{self.row}, {self.column}: ours is above the published value; say why")

    @property
    def kind(self) -> str:
        """In a word or two: "at or below" (by our mean), "above" or "not comparable"."""
        if self.incomparable or self.ours is None:
            return "not comparable"
        return "at or below" if self.ours.mean <= self.published.value else "above"

    @property
    def verdict(self) -> str:
        """The verdict in words, with its reason."""
        reason = {"above": self.above, "not comparable": self.incomparable}.get(self.kind)
        return f"{self.kind}: {reason}" if reason else self.kind


def tally(comparisons: list[Comparison]) -> str:
    """How many of the published numbers ours are at or below, in words."""
    kinds = [c.kind for c in comparisons]
    low, above, incomparable = (kinds.count(kind) for kind in ("at or below", "above", "not comparable"))
    words = f"{low} of {len(kinds)} numbers at or below the published one, {above} above"
    return words + (f", {incomparable} not comparable" if incomparable else "")
