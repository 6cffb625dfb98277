"""Parts of the figures of a report. An estimator has one colour and one mark in all of them."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from agents.page import Entry
from agents.page import Figure as Picture
from agents.plotting import INK, PALETTE, RAW, data_uri, styled
from agents.statistics import Interval
from agents.studies.records import FLOOR, ORACLE
from agents.studies.results import Policy, Results
from agents.studies.shares import ALL
from agents.studies.wording import paragraphs, share_entry

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH = 7.2
"""Inches."""
_MARKS = "os^vDP<>Xp*h"
_LINES = ("-", "--", "-.", ":")


@dataclass(frozen=True)
class Look:
    """Colour, mark and line of an estimator."""

    colour: str
    mark: str
    line: str = "-"


def looks(results: Results) -> dict[str, Look]:
    """The look of every estimator that was flown anywhere, in the order of the study."""
    names = results.flown_on()
    found = {ORACLE: Look(INK, "|", "--"), FLOOR: Look(RAW, "|", ":")}
    for i, name in enumerate(name for name in names if name not in (ORACLE, FLOOR)):
        found[name] = _look(i, i // len(PALETTE))
    return {name: found[name] for name in names}


def policy_looks(results: Results) -> dict[Policy, Look]:
    """The look of everybody of `Results.schools`: a colour each, a line for each agent."""
    agents = [agent.name for agent in results.plan.study.agents]
    return {
        policy: _look(i, agents.index(policy.agent)) for i, policy in enumerate(results.schools())
    }


def _look(i: int, line: int) -> Look:
    return Look(PALETTE[i % len(PALETTE)], _MARKS[i % len(_MARKS)], _LINES[line % len(_LINES)])


@contextmanager
def grid(
    height: float, rows: int, columns: int, **options: Any
) -> "Iterator[tuple[Figure, np.ndarray]]":
    """A figure of this height [in] with its panels ``(rows, columns)``, and the context in which it is drawn."""
    from matplotlib.figure import Figure

    with styled():
        figure = Figure(figsize=(WIDTH, height), layout="constrained")
        yield figure, figure.subplots(rows, columns, squeeze=False, **options)


@contextmanager
def panels(
    environments: Sequence[str], above: float, height: float, **options: Any
) -> "Iterator[tuple[Figure, list[Axes]]]":
    """`grid` of a panel for each environment in up to two columns, with room above them [in]."""
    columns = min(len(environments), 2)
    rows = -(-len(environments) // columns)
    with grid(above + height * rows, rows, columns, **options) as (figure, axes):
        for panel in axes.flat[len(environments) :]:
            panel.set_axis_off()
        for panel, environment in zip(axes.flat, environments, strict=False):
            panel.set_title(environment, loc="left")
            panel.grid()
        yield figure, list(axes.flat[: len(environments)])


@dataclass(frozen=True)
class Row:
    """A line of a dot plot: its name, look, and values by panel; None where there is none."""

    name: str
    look: Look
    values: Sequence[Interval | float | None]


def dots(
    rows: Sequence[Row], heads: Sequence[str], label: str, marks: Sequence[float] = (0.0, 1.0)
) -> "Figure":
    """Values with their intervals, a line each, the first on top; a number without an interval is hollow.

    Heads say what the panels show: environments, or `ALL`, which is set in a tint. At each of
    ``marks`` a line is drawn, in sight in every panel.
    """
    with grid(0.9 + 0.19 * len(rows), 1, len(heads), sharey=True, sharex=True) as (figure, (axes,)):
        heights = np.arange(len(rows))[::-1]
        for j, (panel, head) in enumerate(zip(axes, heads, strict=True)):
            if head == ALL:
                panel.set_facecolor("#f5f6f8")
            for height, row in zip(heights, rows, strict=True):
                _dot(panel, row.values[j], height, row.look)
            for mark in marks:
                panel.axvline(mark, color=INK, linewidth=0.6, zorder=0.5)
            panel.set_title("All environments" if head == ALL else head, loc="left", fontsize=9)
            panel.grid(axis="x")
            panel.tick_params(axis="y", length=0)
            panel.locator_params(axis="x", nbins=4)
        axes[0].set_yticks(heights, [row.name for row in rows])
        axes[0].set_ylim(-0.6, len(rows) - 0.4)
        figure.supxlabel(label, fontsize=10)
    return figure


def _dot(panel: "Axes", value: Interval | float | None, height: float, look: Look) -> None:
    if value is None:
        return
    mean, error = (value, None) if isinstance(value, int | float) else (value.mean, ends([value]))
    panel.errorbar(
        mean, height, xerr=error, color=look.colour, marker=look.mark, markersize=3.5 if look.mark != "|" else 8,
        markerfacecolor="white" if error is None else look.colour, elinewidth=1.0, capsize=2.2, linestyle="none",
    )  # fmt: skip


def ends(intervals: Sequence[Interval]) -> np.ndarray:
    """Distances of the ends of intervals from their means, ``(2, k)``."""
    return np.maximum(
        [[i.mean - i.low for i in intervals], [i.high - i.mean for i in intervals]], 0.0
    )


def legend(figure: "Figure", panels: Iterable["Axes"], columns: int) -> None:
    """One legend above all panels, each name once."""
    found: dict[str, Any] = {}
    for panel in panels:
        for handle, name in zip(*panel.get_legend_handles_labels(), strict=True):
            found.setdefault(name, handle)
    if found:
        figure.legend(
            found.values(), found.keys(), loc="outside upper center", ncols=columns, fontsize=8.5
        )


def share_rows(rows: Iterable[Row]) -> list[tuple[str, list[Entry]]]:
    """The rows of a dot plot as those of a table."""
    return [(row.name, [share_entry(value) for value in row.values]) for row in rows]


def framed(figure: "Figure", name: str, results: Results, **values: Any) -> Picture:
    """A figure on a page, with title and caption of a note."""
    return Picture(data_uri(figure), *paragraphs(name, results, **values))
