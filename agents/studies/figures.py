"""Figures of a report. An estimator has one colour and one mark in all of them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from agents.plotting import INK, PALETTE, styled
from agents.statistics import Interval, crossed_interval
from agents.studies.answer import groups
from agents.studies.records import FLOOR, ORACLE
from agents.studies.results import Results
from agents.studies.shares import ENDS, kept, rankable, ruled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH = 7.2
_MARKS = "os^vDP<>Xp*h"
_LINES = ("-", "--", "-.", ":")


@dataclass(frozen=True)
class Look:
    """Colour, mark and line of an estimator."""

    colour: str
    mark: str
    line: str = "-"


def looks(results: Results) -> dict[str, Look]:
    """The look of every estimator of the classical agent, in the order of the study."""
    found = {ORACLE: Look(INK, "|", "--"), FLOOR: Look("#8a8f96", "|", ":")}
    names = [name for name in results.estimators() if name not in ENDS]
    for i, name in enumerate(names):
        line = _LINES[i // len(PALETTE) % len(_LINES)]
        found[name] = Look(PALETTE[i % len(PALETTE)], _MARKS[i % len(_MARKS)], line)
    return found


def shares_figure(results: Results) -> "Figure":
    """Share kept on each estimator with its interval, the best on top, a panel an environment."""
    from matplotlib.figure import Figure

    columns, look = groups(results), looks(results)
    ranked = {head: rankable(results, column) for head, column in columns.items()}
    names = list(dict.fromkeys(n for each in ranked.values() for n in each)) + list(ENDS)
    height = dict(zip(names, range(len(names))[::-1], strict=True))
    with styled():
        across = min(len(columns), _that_fit(columns))
        down = -(-len(columns) // across)
        size = (_WIDTH, 0.5 + (0.4 + 0.19 * len(names)) * down)
        figure = Figure(figsize=size, layout="constrained")
        grid = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True)
        axes = list(grid.flat)
        while len(axes) > len(columns):
            axes.pop().remove()
        for panel, (head, column) in zip(axes, columns.items(), strict=True):
            for name in (*ranked[head], *ENDS):
                among = max(len(ranked[head]), 1)
                share = kept(results, column, results.classical, name, among)
                _point(panel, share, height[name], look[name])
            panel.set_title(head, loc="left", fontsize=9)
            panel.grid(axis="x")
            panel.tick_params(labelbottom=True)
            panel.locator_params(axis="x", nbins=4)
        axes[0].set_yticks(list(height.values()), list(height))
        figure.supxlabel("share of the oracle's performance kept", fontsize=10)
    return figure


def _that_fit(names: Iterable[str]) -> int:
    """Number of names like the longest that stand beside each other in a figure, at least one."""
    return max(1, 90 // (max(map(len, names)) + 2))


def _point(panel: "Axes", value: Interval | float | None, height: float, look: Look) -> None:
    if isinstance(value, Interval):
        panel.errorbar(
            value.mean,
            height,
            xerr=_ends([value]),
            color=look.colour,
            marker=look.mark,
            markersize=8 if look.mark == "|" else 3.5,
            capsize=2.2,
            linestyle="none",
        )


def _ends(intervals: Sequence[Interval]) -> np.ndarray:
    """Distances of the ends of intervals from their means, ``(2, k)``."""
    below, above = ([i.mean - i.low for i in intervals], [i.high - i.mean for i in intervals])
    return np.maximum([below, above], 0.0)


def robustness_figure(results: Results) -> "Figure":
    """Share kept by the classical agent in each condition, by name, a panel an environment.

    The ends of the scale are left out: they are 0 and 1 in every condition.
    """
    from matplotlib.figure import Figure

    environments = ruled(results)
    look = {name: each for name, each in looks(results).items() if name not in ENDS}
    with styled():
        ncols = min(5, _that_fit(look))
        size = (_WIDTH, 0.7 + 0.19 * -(-len(look) // ncols) + 2.3 * len(environments))
        figure = Figure(figsize=size, layout="constrained")
        axes = figure.subplots(len(environments), 1, squeeze=False)[:, 0]
        handles: dict[str, Any] = {}
        for panel, environment in zip(axes, environments, strict=True):
            conditions = results.conditions(environment)
            for k, name in enumerate(results.estimators(environment)):
                if name in look:
                    shift = 0.3 * (k / len(look) - 0.5)
                    where = environment, name
                    if curve := _curve(panel, results, where, conditions, shift, look[name]):
                        handles[name] = curve
            rotation = 20 if len(conditions) > _that_fit(conditions) else 0
            ticks = {"rotation": rotation, "ha": "right" if rotation else "center"}
            panel.set_xticks(range(len(conditions)), conditions, **ticks)
            panel.set_ylabel("share kept")
            panel.set_title(environment, loc="left")
            panel.grid(axis="y")
        if handles:
            figure.legend(
                handles.values(), handles, loc="outside upper center", ncols=ncols, fontsize=8.5
            )
    return figure


def _curve(
    panel: "Axes",
    results: Results,
    where: tuple[str, str],
    conditions: Sequence[str],
    shift: float,
    look: Look,
) -> Any:
    """Share kept over conditions, shifted a little so that intervals do not hide each other."""
    environment, name = where
    rows = [results.flight(results.kept, environment, c, name) for c in conditions]
    found = [None if row is None else crossed_interval(row) for row in rows]
    each = [(i, value) for i, value in enumerate(found) if value]
    return each and (
        panel.errorbar(
            [i + shift for i, _ in each],
            [value.mean for _, value in each],
            yerr=_ends([value for _, value in each]),
            color=look.colour,
            linestyle=look.line,
            marker=look.mark,
            markersize=3.2,
            linewidth=0.9,
            elinewidth=0.5,
        )
    )
