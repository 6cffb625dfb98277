"""Printed numbers beside ours: how close they are, for each number, each experiment and each paper."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from agents.page import Entry, Page, Table, markdown_table, number
from agents.statistics import Interval, mean_interval

AGREES, BETTER, WORSE, INCOMPARABLE = "agrees", "better", "worse", "not comparable"
EXPLORATORY = "exploratory"
"""Part of the name of a way that was found by a search over the printed numbers."""
NEAR = 1.25
"""Factor within which two numbers are called near."""


@dataclass(frozen=True)
class Comparison:
    """A number that a paper prints, and ours.

    Attributes:
        experiment: Setting that the paper ran; repetitions of it are one experiment.
        quantity: What the number measures.
        unit: Of the number.
        printed: To the digit.
        where: Place in the paper: table, equation or section.
        ours: Errors of our runs ``(runs,)``; None if there is none.
        averaged: Runs behind the printed number.
        meant: The number without its misprint.
        reason: Why the two are not comparable; empty where they are.
    """

    experiment: str
    quantity: str
    unit: str
    printed: str
    where: str
    ours: np.ndarray | None
    averaged: int = 1
    meant: float | None = None
    reason: str = ""

    @property
    def value(self) -> float:
        """The printed number."""
        return float(self.printed) if self.meant is None else self.meant

    @property
    def interval(self) -> Interval:
        """Our mean with its 95 % interval."""
        interval = None if self.ours is None else mean_interval(self.ours)
        assert interval is not None
        return interval

    @property
    def ratio(self) -> Interval:
        """Ours over the printed number; its logarithm has the same interval."""
        return Interval(
            *(
                float(end) / self.value
                for end in (self.interval.mean, self.interval.low, self.interval.high)
            )
        )

    @property
    def verdict(self) -> str:
        """`AGREES` within rounding and our 95 % interval, else `BETTER` (smaller) or `WORSE`; `INCOMPARABLE`."""
        if self.ours is None or self.reason:
            return INCOMPARABLE
        difference = self.interval.mean - self.value
        return (
            AGREES
            if abs(difference) <= self._rounding + self.interval.half
            else BETTER
            if difference < 0
            else WORSE
        )

    @property
    def words(self) -> str:
        """The verdict with its reason, and whether the scatter of as few runs as the paper's explains it."""
        if self.reason or self.ours is None or self.verdict == AGREES:
            return f"{self.verdict}: {self.reason}" if self.reason else self.verdict
        half = self.interval.half * np.sqrt(
            1.0 + len(self.ours) / self.averaged
        )  # of a 95 % prediction interval
        chance = abs(self.interval.mean - self.value) <= self._rounding + half
        return f"{self.verdict}, within the scatter of {self.averaged}" if chance else self.verdict

    @property
    def _rounding(self) -> float:
        printed = self.printed if self.meant is None else str(self.meant)
        return 0.5 * 10.0 ** -len(printed.partition(".")[2])  # half a unit of the last digit


class Row(NamedTuple):
    """An experiment in the measures of closeness; ``factor`` is exp of the mean absolute log ratio, 0 without one."""

    paper: str
    experiment: str
    numbers: int
    agree: int
    better: int
    worse: int
    incomparable: int
    near: int
    factor: float

    @property
    def texts(self) -> list[str]:
        """The fields as they are shown."""
        *counts, factor = self[2:]
        return [self.paper, self.experiment, *map(str, counts), f"{factor:.2f}" if factor else "–"]


HEAD = (
    "paper",
    "experiment",
    "numbers",
    "agree",
    "better",
    "worse",
    "not comparable",
    "within 25 %",
    "typical factor",
)


class Report(NamedTuple):
    """Page of a paper, a row for each of its experiments, and its opening."""

    page: Page
    rows: list[Row]
    opening: str


def row(paper: str, experiment: str, comparisons: Iterable[Comparison]) -> Row:
    """The measures of an experiment."""
    found = list(comparisons)
    verdicts = [c.verdict for c in found]
    logs = np.array([np.log(c.ratio.mean) for c in found if c.verdict != INCOMPARABLE])
    near = int((np.abs(logs) <= np.log(NEAR)).sum())
    factor = float(np.exp(np.abs(logs).mean())) if len(logs) else 0.0
    agree, better, worse, incomparable = (
        verdicts.count(v) for v in (AGREES, BETTER, WORSE, INCOMPARABLE)
    )
    return Row(paper, experiment, len(found), agree, better, worse, incomparable, near, factor)


def rows(paper: str, comparisons: Sequence[Comparison]) -> list[Row]:
    """A row for each experiment, in the order of the comparisons."""
    names = dict.fromkeys(c.experiment for c in comparisons)
    return [row(paper, name, (c for c in comparisons if c.experiment == name)) for name in names]


def comparison_table(columns: Mapping[str, Sequence[Comparison]], name: str = "published") -> Table:
    """Printed numbers with their places, and for each column of ours the mean, the ratio to print and the verdict."""
    sections: dict[str, list[tuple[str, list[Entry]]]] = {}
    for group in zip(*columns.values(), strict=True):
        first = group[0]
        printed = (
            first.printed if first.meant is None else f"{first.printed} ({first.meant:g} meant)"
        )
        entries = [Entry(f"{printed} {first.unit}".strip()), Entry(first.where)]
        for c in group:
            entries += _ours(c)
        sections.setdefault(first.experiment, []).append((first.quantity, entries))
    head = [("printed", ""), ("where", "")]
    for label in columns:
        head += [(label or "ours", ""), ("ours / printed", ""), ("verdict", "")]
    return Table("", "", "", head, list(sections.items()), name)


def _ours(c: Comparison) -> list[Entry]:
    if c.ours is None:
        return [Entry("–"), Entry("–"), Entry(c.words)]
    shown = c.printed if c.meant is None else str(c.meant)
    decimals = len(shown.partition(".")[2]) + 1
    ratio = c.ratio
    low, high = (number(end, 2) for end in (ratio.low, ratio.high))
    return [
        Entry(number(c.interval.mean, decimals), number(c.interval.half, decimals)),
        Entry(f"{number(ratio.mean, 2)} [{low}, {high}]"),
        Entry(c.words),
    ]


def summary_table(found: Sequence[Row]) -> str:
    """The rows as a Markdown table."""
    return markdown_table(HEAD, [each.texts for each in found], 2)


def counts(found: Sequence[Row]) -> list[int]:
    """Counts of numbers that agree, lie within 25 %, are better, worse and not comparable."""
    return [
        sum(getattr(row, name) for row in found)
        for name in ("agree", "near", "better", "worse", "incomparable")
    ]


def papers_page(summary: Mapping[str, Any]) -> str:
    """The text of docs/papers.md from the stored results: a line for each way of a paper, and the openings."""
    ways: dict[str, list[Row]] = {}
    for each in summary.values():
        for values in each["rows"]:
            ways.setdefault(values[0], []).append(Row(*values))
    head, lines = (
        ("Paper", "agree", "within 25 %", "better, worse", "not comparable", "typical factor"),
        [],
    )
    for paper, found in ways.items():
        agree, near, better, worse, incomparable = counts(found)
        scored = np.array([row.numbers - row.incomparable for row in found])
        logs = np.log([row.factor or 1.0 for row in found])
        factor = f"{np.exp(scored @ logs / scored.sum()):.1f}" if scored.sum() else "–"
        lines.append(
            [paper, str(agree), str(near), f"{better}, {worse}", str(incomparable), factor]
        )
    openings = [f"**{name.title()}.** {each['opening']}" for name, each in summary.items()]
    return "\n\n".join([markdown_table(head, lines, 1), *openings])


def readme_line(summary: Mapping[str, Any]) -> str:
    """The sentence of README.md from the stored results, what was found by a search left out."""
    found = [
        Row(*values)
        for each in summary.values()
        for values in each["rows"]
        if EXPLORATORY not in values[0]
    ]
    agree, near, better, worse, _ = counts(found)
    return (
        "The experiments of the five source papers are [run"
        " again](https://github.com/vessel-gym/vessel-gym/blob/main/docs/papers.md): of"
        f" {agree + better + worse} comparable\nprinted errors ours equal {agree}, are smaller than"
        f" {better} and larger than {worse}; {near} lies within 25 %."
    )


def trend(members: Sequence[int], errors: np.ndarray) -> Interval:
    """Change [%] of errors ``(runs, sizes)`` from the fewest to the most members, paired, by a power of N.

    The power is fitted to every run by itself: all sizes see the same truth and measurements.
    """
    x = np.log(members) - np.mean(np.log(members))
    y = np.log(errors)
    interval = mean_interval((y - y.mean(-1, keepdims=True)) @ x / (x @ x))
    assert interval is not None
    ratio = max(members) / min(members)
    return Interval(
        *(100.0 * (ratio**a - 1.0) for a in (interval.mean, interval.low, interval.high))
    )


def exponential(logs: np.ndarray) -> Interval:
    """Geometric mean of what these are the logarithms of ``(N,)``, with its 95 % interval."""
    interval = mean_interval(logs)
    assert interval is not None
    return Interval(*(float(np.exp(end)) for end in (interval.mean, interval.low, interval.high)))


def falls(change: Interval) -> str:
    """Verdict on the claim that errors fall."""
    if not change.excludes_zero:
        return "undecided, no significant difference"
    return "true" if change.high < 0.0 else "false"


def percent(change: Interval) -> str:
    """A change in words: "−1.2 % (−2.0 to −0.4 %)"."""
    mean, low, high = (number(value, 1, True) for value in (change.mean, change.low, change.high))
    return f"{mean} % ({low} to {high} %)"
