"""Figures of a report. An estimator has one colour and one mark in all of them."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from agents.plotting import INK, PALETTE, styled
from agents.statistics import crossed_interval
from agents.studies.records import FLOOR, ORACLE
from agents.studies.results import Results
from agents.studies.shares import ALL, ENDS, rankings

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH = 7.2
_MARKS = "os^vDP<>Xp*h"


def looks(results: Results) -> dict[str, dict[str, Any]]:
    """Colour and mark of every estimator of the classical agent, in the study's order."""
    found: dict[str, dict[str, Any]] = {
        name: {"color": color, "marker": "|", "markersize": 8}
        for name, color in ((ORACLE, INK), (FLOOR, "#8a8f96"))
    }
    for i, name in enumerate(name for name in results.estimators() if name not in ENDS):
        found[name] = {"color": PALETTE[i % len(PALETTE)], "linewidth": 0.9}
        found[name] |= {"marker": _MARKS[i % len(_MARKS)], "markersize": 3.5}
    return found


def shares_figure(results: Results) -> "Figure":
    """Share kept on each estimator with its interval, the best on top, a panel an environment."""
    from matplotlib.figure import Figure

    columns, look = rankings(results), looks(results)
    names = [*dict.fromkeys(n for ranking in columns.values() for n in ranking.shares), *ENDS]
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
        for panel, (head, ranking) in zip(axes, columns.items(), strict=True):
            for name in (*ranking.shares, *ENDS):
                if share := ranking.kept(name):
                    ends = [[share.mean - share.low], [share.high - share.mean]]
                    panel.errorbar(share.mean, height[name], xerr=ends, **look[name])
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


def robustness_figure(results: Results) -> "Figure":
    """Share kept by the classical agent in each condition, by name, a panel an environment.

    The ends of the scale are left out: they are 0 and 1 in every condition.
    """
    from matplotlib.figure import Figure

    environments = [name for name in rankings(results) if name != ALL]
    look = {name: each for name, each in looks(results).items() if name not in ENDS}
    with styled():
        ncols = min(5, _that_fit(look))
        size = (_WIDTH, 0.7 + 0.19 * -(-len(look) // ncols) + 2.3 * len(environments))
        figure = Figure(figsize=size, layout="constrained")
        axes = figure.subplots(len(environments), 1, squeeze=False)[:, 0]
        handles: dict[str, Any] = {}
        for panel, environment in zip(axes, environments, strict=True):
            handles |= _curves(panel, results, environment, look)
            conditions = results.conditions(environment)
            rotation = 20 if len(conditions) > _that_fit(conditions) else 0
            ticks = {"rotation": rotation, "ha": "right" if rotation else "center"}
            panel.set_xticks(range(len(conditions)), conditions, **ticks)
            panel.set_ylabel("share kept")
            panel.set_title(environment, loc="left")
            panel.grid(axis="y")
        if handles:
            place: Any = {"loc": "outside upper center", "ncols": ncols, "fontsize": 8.5}
            figure.legend(handles.values(), handles, **place)
    return figure


def _curves(
    panel: "Axes", results: Results, environment: str, look: dict[str, dict[str, Any]]
) -> dict[str, Any]:
    """Curves over conditions by estimator, moved a little so that intervals hide no other."""
    handles = {}
    for k, name in enumerate(results.estimators(environment)):
        own, found = results.rows(results.kept, name), []
        for i, condition in enumerate(results.conditions(environment)):
            row = own[own.index == (environment, condition)].to_numpy()
            if len(row) and (value := crossed_interval(row)):
                found.append((i + 0.3 * (k / len(look) - 0.5), value.mean, value.half))
        if name in look and found:
            places, means, halves = zip(*found, strict=True)
            handles[name] = panel.errorbar(places, means, halves, elinewidth=0.5, **look[name])
    return handles
