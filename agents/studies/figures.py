"""Figures of a report."""

from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from agents.plotting import PALETTE, WIDTH, styled
from agents.statistics import crossed_interval
from agents.studies.ranking import ALL, rankings
from agents.studies.records import ENDS
from agents.studies.results import Results, at

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MARKS = "os^vDP<>Xp*h"
_COLUMNS = 2
"""Columns of the legend, in which long names have room."""


def conditions_figure(results: Results) -> "Figure":
    """Normalised score of `Results.compared` in each condition, a panel an environment.

    The ends of the scale are left out: they are 0 and 1 in every condition.
    """
    from matplotlib.figure import Figure

    environments = [name for name in rankings(results) if name != ALL]
    names = [name for name in results.estimators() if name not in ENDS]
    legend = 0.19 * -(-len(names) // _COLUMNS)
    handles: dict[str, Any] = {}
    with styled():
        size = WIDTH, 0.7 + legend + 2.5 * len(environments)
        figure = Figure(figsize=size, layout="constrained")
        axes = figure.subplots(len(environments), 1, squeeze=False)[:, 0]
        for panel, environment in zip(axes, environments, strict=True):
            handles |= _points(panel, results, environment, names)
            conditions = results.conditions(environment)
            panel.set_xticks(range(len(conditions)), conditions, rotation=20, ha="right")
            panel.set_ylabel("normalised score")
            panel.set_title(environment, loc="left")
            panel.grid(axis="y")
        figure.legend(handles.values(), handles, loc="outside upper center", ncols=_COLUMNS)
    return figure


def _points(panel: "Axes", results: Results, environment: str, names: list[str]) -> dict[str, Any]:
    """Points of each estimator in each condition, beside those of others so that none is hidden.

    An estimator has one colour and one mark in all panels.
    """
    conditions, handles = results.conditions(environment), {}
    for k, (name, colour, mark) in enumerate(zip(names, cycle(PALETTE), cycle(_MARKS))):
        own = at(
            results.normalised, environment=environment, policy=results.compared, estimator=name
        )
        scores = [crossed_interval(at(own, condition=each).to_numpy()) for each in conditions]
        ends = np.array([(score.mean, score.half) for score in scores])
        places = np.arange(len(conditions)) + 0.6 * ((k + 0.5) / len(names) - 0.5)
        handles[name] = panel.errorbar(
            places, *ends.T, linestyle="none", color=colour, marker=mark, markersize=3.5,
            elinewidth=0.5,
        )  # fmt: skip
    return handles
