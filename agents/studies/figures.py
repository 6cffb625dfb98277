"""Figures of a report. An estimator has one colour and one mark in all panels."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from agents.plotting import PALETTE, styled
from agents.statistics import crossed_interval
from agents.studies.answer import ordered
from agents.studies.ranking import ALL, rankings
from agents.studies.records import ENDS
from agents.studies.results import Results

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH = 7.2
_MARKS = "os^vDP<>Xp*h"


def looks(results: Results) -> dict[str, dict[str, Any]]:
    """Colour and mark of every estimator of the classical agent, in the study's order.

    The ends of the scale are left out: they are 0 and 1 in every condition.
    """
    names = [name for name in results.estimators() if name not in ENDS]
    return {
        name: {
            "color": PALETTE[i % len(PALETTE)],
            "marker": _MARKS[i % len(_MARKS)],
            "markersize": 3.5,
            "linewidth": 0.9,
        }
        for i, name in enumerate(names)
    }


def _that_fit(names: Iterable[str]) -> int:
    """Number of names like the longest that stand beside each other in a figure, at least one."""
    return max(1, 90 // (max(map(len, names)) + 2))


def conditions_figure(results: Results) -> "Figure":
    """Normalised score of the classical agent in each condition, a panel an environment.

    Conditions that are `ordered` are joined by lines.
    """
    from matplotlib.figure import Figure

    environments, look = [name for name in rankings(results) if name != ALL], looks(results)
    with styled():
        ncols = min(5, _that_fit(look))
        size = (_WIDTH, 0.7 + 0.19 * -(-len(look) // ncols) + 2.3 * len(environments))
        figure = Figure(figsize=size, layout="constrained")
        axes = figure.subplots(len(environments), 1, squeeze=False)[:, 0]
        handles: dict[str, Any] = {}
        for panel, environment in zip(axes, environments, strict=True):
            handles |= _points(panel, results, environment, look)
            conditions = results.conditions(environment)
            rotation = 20 if len(conditions) > _that_fit(conditions) else 0
            ticks = {"rotation": rotation, "ha": "right" if rotation else "center"}
            panel.set_xticks(range(len(conditions)), conditions, **ticks)
            panel.set_ylabel("normalised score")
            panel.set_title(environment, loc="left")
            panel.grid(axis="y")
        if handles:
            place: Any = {"loc": "outside upper center", "ncols": ncols, "fontsize": 8.5}
            figure.legend(handles.values(), handles, **place)
    return figure


def _points(
    panel: "Axes", results: Results, environment: str, look: dict[str, dict[str, Any]]
) -> dict[str, Any]:
    """Points in each condition by estimator, beside each other so that intervals hide none."""
    handles, names = {}, results.conditions(environment)
    study = results.plan.study
    line = "-" if ordered([c for c in study.conditions if c.name in names]) else "none"
    for k, (name, style) in enumerate(look.items()):
        own = results.rows(results.normalised, name)
        scores = {
            i + 0.6 * ((k + 0.5) / len(look) - 0.5): crossed_interval(own.loc[[at]].to_numpy())
            for i, at in enumerate((environment, condition) for condition in names)
            if at in own.index
        }
        found = [(place, of.mean, of.half) for place, of in scores.items() if of]
        if found:
            places, means, halves = zip(*found, strict=True)
            handles[name] = panel.errorbar(
                places, means, halves, elinewidth=0.5, linestyle=line, **style
            )
    return handles


def learning_figure(curves: dict[str, list[list[list[float]]]]) -> "Figure":
    """Learning curves: mean and range over training runs of the return of training episodes.

    Args:
        curves: For each training, by name, the (steps, return) of each run.
    """
    import numpy as np
    from matplotlib.figure import Figure

    with styled():
        figure = Figure(figsize=(_WIDTH, 3.0), layout="constrained")
        axes = figure.subplots()
        for (name, runs), color in zip(curves.items(), PALETTE * len(curves), strict=False):
            length = min(map(len, runs))
            steps, returns = np.moveaxis(np.array([run[:length] for run in runs]), -1, 0)
            axes.plot(steps[0], returns.mean(0), color=color, label=name)
            axes.fill_between(steps[0], returns.min(0), returns.max(0), color=color, alpha=0.2)
        axes.set(xlabel="environment steps", ylabel="return of training episodes")
        axes.legend(loc="lower right", fontsize=8.5)
        axes.grid(axis="y")
    return figure
