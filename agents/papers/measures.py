"""Printed numbers beside ours: closeness for each number, each experiment and each paper.

The report of a paper is ``{"tables": ..., "figures": ..., "rows": ...}``: tables by name, the
heading first, figures as in `agents.papers.figures`, and a `Row` for each experiment.
"""

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from typing import NamedTuple

import numpy as np

from agents.page import markdown_table, mean_and_half, text
from agents.statistics import Interval, mean_interval

AGREES, BETTER, WORSE, INCOMPARABLE = "agrees", "better", "worse", "not comparable"
EXPLORATORY = "exploratory"
"""Part of the name of a way that was found by a search over the printed numbers."""
NEAR = 1.25
"""Factor within which two numbers are called near."""
Table = list[Sequence[str]]
"""Rows of a table, the heading first."""


def geometric(logs: np.ndarray) -> Interval:
    """Geometric mean of the values with these logarithms ``(N,)``, with its 95 % interval."""
    of = mean_interval(logs)
    return Interval(*np.exp(astuple(of)).tolist())


def trend(members: Sequence[int], errors: np.ndarray) -> str:
    """Change [%] of errors ``(runs, sizes)`` from the fewest to the most members, by a power of N.

    The power is fitted to every run by itself: all sizes see the same truth and measurements.
    """
    x, y = np.log(members) - np.mean(np.log(members)), np.log(errors)
    logs = np.log(max(members) / min(members)) * ((y - y.mean(-1, keepdims=True)) @ x / (x @ x))
    of = geometric(logs)
    return text(Interval(*(100.0 * (end - 1.0) for end in astuple(of))), 1)


def means(errors: np.ndarray, decimals: int = 5) -> list[str]:
    """Means over the runs of errors ``(runs, quantities)``, with their 95 % intervals."""
    return [mean_and_half(of, decimals) for of in errors.T]


def with_units(quantities: Mapping[str, str]) -> list[str]:
    """Quantities with their units, as heads of columns and labels of axes."""
    return [f"{name} [{unit}]" for name, unit in quantities.items()]


def by_members(label: str, errors: Mapping[int, np.ndarray]) -> Table:
    """Rows of errors ``(runs, quantities)`` by members, and the change from fewest to most."""
    sizes = np.stack([*errors.values()], -1)
    changes = (trend([*errors], of) for of in sizes.swapaxes(0, 1))
    return [
        *((label, str(n), *means(of)) for n, of in errors.items()),
        (label, f"{min(errors)} to {max(errors)} [%]", *changes),
    ]


@dataclass(frozen=True)
class Comparison:
    """A number that a paper prints, and ours.

    Attributes:
        experiment: Setting that the paper ran; repetitions of it are one experiment.
        quantity: What the number measures.
        unit: Of the number.
        printed: To the digit.
        where: Place in the paper: table, equation or section.
        ours: Errors of our runs ``(runs,)``; empty if there is none.
        averaged: Runs behind the printed number.
        meant: The number without its misprint.
        reason: Why the two are not comparable; empty where they are.
    """

    experiment: str
    quantity: str
    unit: str
    printed: str
    where: str
    ours: np.ndarray
    averaged: int = 1
    meant: str = ""
    reason: str = ""

    @property
    def number(self) -> str:
        """The printed number without its misprint."""
        return self.meant or self.printed

    @property
    def mean(self) -> Interval:
        """Our mean over the runs with its 95 % interval."""
        return mean_interval(self.ours)

    @property
    def ratio(self) -> float:
        """Our mean over the printed number."""
        return self.mean.mean / float(self.number)

    @property
    def decimals(self) -> int:
        """Decimals of the printed number."""
        return len(self.number.partition(".")[2])

    def within(self, half: float) -> bool:
        """True if the difference is at most half a unit of the last digit and so much more."""
        return abs(self.mean.mean - float(self.number)) <= 0.5 * 10.0**-self.decimals + half

    @property
    def verdict(self) -> str:
        """`AGREES` within rounding and our interval, `BETTER` if ours is smaller, or another."""
        if self.reason:
            return INCOMPARABLE
        return AGREES if self.within(self.mean.half) else BETTER if self.ratio < 1 else WORSE

    @property
    def words(self) -> str:
        """The verdict with its reason, or with the scatter of the paper's runs if that suffices."""
        if self.verdict in (AGREES, INCOMPARABLE):
            return f"{self.verdict}{f': {self.reason}' if self.reason else ''}"
        # of a prediction
        half = self.mean.half * np.sqrt(1.0 + len(self.ours) / self.averaged)
        scatter = f", within the scatter of {self.averaged}" if self.within(half) else ""
        return self.verdict + scatter


def against_table(
    where: str,
    printed: Mapping[str, Sequence[str]],
    quantities: Mapping[str, str],
    errors: Mapping[int, np.ndarray],
    averaged: int = 1,
) -> list[Comparison]:
    """Errors by members beside a printed table, whose last column is a computing time."""
    found = []
    for size, values in errors.items():
        of, (*texts, time) = f"{size} members", printed[str(size)]
        for (name, unit), number, ours in zip(quantities.items(), texts, values.T, strict=True):
            found.append(Comparison(of, name, unit, number, where, ours, averaged))
        found.append(Comparison(of, "time", "s", time, where, np.empty(0), reason="its machine"))
    return found


class Row(NamedTuple):
    """Closeness of an experiment; ``factor`` is exp of the mean absolute log ratio."""

    paper: str
    experiment: str
    numbers: int = 0
    agree: int = 0
    better: int = 0
    worse: int = 0
    incomparable: int = 0
    near: int = 0
    factor: float = 0.0


def row(paper: str, experiment: str, found: Sequence[Comparison]) -> Row:
    """The measures of an experiment."""
    verdicts = [each.verdict for each in found]
    logs = np.array([abs(np.log(each.ratio)) for each in found if each.verdict != INCOMPARABLE])
    agree, better, worse, no = map(verdicts.count, (AGREES, BETTER, WORSE, INCOMPARABLE))
    near, factor = int((logs <= np.log(NEAR)).sum()), np.exp(logs.mean()) if len(logs) else 0.0
    return Row(paper, experiment, len(found), agree, better, worse, no, near, float(factor))


def rows(paper: str, comparisons: Sequence[Comparison]) -> list[Row]:
    """A row for each experiment, in the order of the comparisons."""
    names = dict.fromkeys(each.experiment for each in comparisons)
    return [row(paper, name, [c for c in comparisons if c.experiment == name]) for name in names]


def comparison_table(columns: Mapping[str, Sequence[Comparison]]) -> Table:
    """Printed numbers with their places, and mean, ratio and verdict for each column of ours."""
    heads = (head for label in columns for head in (label, "ours / printed", "verdict"))
    found: Table = [["experiment", "quantity", "printed", "where", *heads]]
    for group in zip(*columns.values(), strict=True):
        first = group[0]
        printed = f"{first.printed} ({first.meant} meant)" if first.meant else first.printed
        cells = [first.experiment, first.quantity, f"{printed} {first.unit}".strip(), first.where]
        for each in group:
            numbers = ["–", "–"]
            if each.ours.size:
                numbers = [mean_and_half(each.ours, each.decimals + 1), f"{each.ratio:.2f}"]
            cells += [*numbers, each.words]
        found.append(cells)
    return found


def summary_table(found: Sequence[Row]) -> str:
    """The rows as a Markdown table."""
    head = ("paper", "experiment", "numbers", "agree", "better", "worse", "not comparable",
            "within 25 %", "typical factor")  # fmt: skip
    lines = ([*map(str, of[:-1]), f"{of.factor:.2f}" if of.factor else "–"] for of in found)
    return markdown_table(head, lines, 2)
