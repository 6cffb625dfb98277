"""The figures of the ablation report, as SVG."""

from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from agents.ablation import AGENTS, TOLD, Cell, Results
from agents.plotting import BELIEVED, INK, PALE, RAW, TRUE, data_uri, styled
from agents.statistics import Interval
from estimators import wrap
from vessel_gym.tasks.turning_circle import TurningCircle
from vessel_gym.tracks import believed_path, commanded_path, path

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MARKS = dict(zip(AGENTS, ((TRUE, "o", TRUE), (BELIEVED, "s", "white")), strict=True))
_LOSSES = (-0.01, 0.0, 0.01, 0.1, 0.5)
WINDOW = (100.0, 160.0)
"""Seconds of the example episode in which the unknown input is shown."""
TRACKS = ("kf-umv-ui", "kf", "measurement", "dead-reckoning")
"""Estimators whose tracks are shown."""
BANDS = ("kf-umv-ui", "kf", TOLD)
"""Estimators whose heading error is shown within what they claim."""


def score_figure(results: Results) -> str:
    """Score by estimator, and score lost against truth, one column a sea, as a data URI."""
    from matplotlib.figure import Figure

    study = results.study
    names = {0: study.estimators, 1: tuple(name for name in study.estimators if name != "truth")}
    with styled():
        figure = Figure(figsize=(7.2, 4.5), layout="constrained")
        heights = [len(rows) for rows in names.values()]
        panels = figure.subplots(2, len(study.seas), sharex="row", sharey="row", squeeze=False, height_ratios=heights)
        for (i, j), panel in np.ndenumerate(panels):
            sea, rows = study.seas[j], np.arange(len(names[i]))[::-1]
            for (row, name), agent in product(zip(rows, names[i], strict=True), AGENTS):
                cell = Cell(sea, agent, name)
                truth = cell._replace(estimator="truth")
                shown = results.mean(cell, "score") if i == 0 else results.difference(truth, cell, "score")
                if shown is not None:
                    _mark(panel, shown, row, agent)
            panel.set_yticks(rows, names[i])
            panel.set_ylim(-0.6, len(rows) - 0.4)
            panel.tick_params(axis="y", length=0)
            panel.grid()
            panel.set_axisbelow(True)
        for sea, score, lost in zip(study.seas, *panels, strict=True):
            score.set_title(f"{sea} sea", loc="left")
            score.set_xlabel("score")
            score.set_xlim(0.0, 1.0)
            score.set_xticks(np.linspace(0.2, 1.0, 5))
            lost.set_xlabel("score lost against truth (linear below 0.01)")
            lost.set_xscale("symlog", linthresh=0.01, linscale=0.6)
            lost.set_xticks(_LOSSES, [f"{tick:g}".replace("-", "−") for tick in _LOSSES])
            lost.axvline(0.0, color=INK, linewidth=0.6)
        panels[0, 0].legend(loc="lower left", handletextpad=0.2)
        return data_uri(figure)


def _mark(panel: "Axes", value: Interval, row: float, agent: str) -> None:
    """A mean and its interval at a height, in the agent's colour."""
    colour, marker, face = _MARKS[agent]
    height = row + (0.15 if agent == AGENTS[0] else -0.15)
    ends = [[value.mean - value.low], [value.high - value.mean]]
    panel.errorbar(
        value.mean, height, xerr=ends, color=colour, marker=marker, markersize=4.5, markerfacecolor=face,
        markeredgewidth=1.0, elinewidth=1.0, capsize=2.0, linestyle="none", label=agent if row == 0 else None,
    )  # fmt: skip


def track_figure(results: Results) -> str:
    """True, believed and commanded tracks of the example episode, one panel an estimator, as a data URI."""
    from matplotlib.figure import Figure

    task = results.system.task
    assert isinstance(task, TurningCircle)
    shown = [name for name in TRACKS if name in results.examples]
    with styled():
        figure = Figure(figsize=(7.2, 2.5), layout="compressed")
        panels = figure.subplots(1, len(shown), sharex=True, sharey=True, squeeze=False)[0]
        for panel, name in zip(panels, shown, strict=True):
            h = results.examples[name]
            _, _, heading, surge, sway, _ = h["truth"].T
            tracks = {
                "commanded": (commanded_path(task, h["reference"][0, [0, 3]]), RAW, ":", 1.4),
                "true": (path(heading, surge, sway, task.dt), TRUE, "-", 1.4),
                "believed": (believed_path(h["estimate"], task.ship, task.dt), BELIEVED, "--", 1.1),
            }
            for label, (track, colour, line, width) in tracks.items():
                panel.plot(track[:, 1], track[:, 0], color=colour, linestyle=line, linewidth=width, label=label)
            panel.plot(0.0, 0.0, color=TRUE, marker="o", markersize=3.5)
            panel.set_title(name, loc="left")
            panel.set_aspect("equal")
            panel.set_xlabel("east [m]")
            panel.grid()
            panel.locator_params(nbins=4)
        panels[0].set_ylabel("north [m]")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
        return data_uri(figure)


def input_figure(results: Results) -> str:
    """The unknown input over a minute: true, estimated, and as the raw channel reads it, as a data URI."""
    from matplotlib.figure import Figure

    h = results.examples[results.study.trained_on]
    time = np.arange(len(h["truth"])) * results.system.vehicle.dt
    window = (time >= WINDOW[0]) & (time <= WINDOW[1])
    time = time[window]
    true, estimated, raw = (
        1e3 * values[window] for values in (h["unknown_input"][:, 0], h["input_estimate"][:, 0], h["measurement"][:, 1])
    )
    with styled():
        figure = Figure(figsize=(7.2, 3.4), layout="constrained")
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        upper.plot(time, true, color=TRUE, label="true")
        upper.plot(time, raw, color=RAW, marker="x", markersize=4, linestyle="none", label="raw channel")
        upper.plot(
            time, estimated, color=BELIEVED, marker="o", markersize=3, linestyle="none",
            label=f"{results.study.trained_on} estimate",
        )  # fmt: skip
        upper.set_ylabel("unknown input d [mrad]")
        figure.legend(*upper.get_legend_handles_labels(), loc="outside upper right", ncols=3)
        lower.axhline(0.0, color=INK, linewidth=0.6)
        lower.plot(time, raw - true, color=RAW, marker="x", markersize=4, linewidth=0.6)
        lower.plot(time, estimated - true, color=BELIEVED, marker="o", markersize=3, linewidth=0.6)
        lower.set_ylabel("error [mrad]")
        lower.set_xlabel("time [s]")
        lower.margins(x=0.01)
        for panel in (upper, lower):
            panel.grid()
        figure.align_ylabels()
        return data_uri(figure)


def heading_figure(results: Results) -> str:
    """Heading estimation error of the example episode within its claimed two standard deviations, as a data URI."""
    from matplotlib.figure import Figure

    shown = [name for name in BANDS if name in results.examples]
    with styled():
        figure = Figure(figsize=(7.2, 1.2 + 1.15 * len(shown)), layout="constrained")
        panels = figure.subplots(len(shown), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        for panel, name in zip(panels, shown, strict=True):
            h = results.examples[name]
            time = np.arange(len(h["truth"])) * results.system.vehicle.dt
            error = 1e3 * wrap(h["estimate"][:, 2] - h["truth"][:, 2])
            band = 2e3 * np.sqrt(h["covariance"][:, 2, 2])
            panel.fill_between(time, -band, band, color=PALE, linewidth=0.0, label="±2σ claimed")
            panel.plot(time, error, color=TRUE, linewidth=0.7, label="error")
            panel.set_title(name, loc="left")
            panel.margins(x=0.01)
            panel.grid()
            panel.set_axisbelow(True)
        panels[-1].set_xlabel("time [s]")
        figure.supylabel("heading: estimated − true [mrad]", fontsize=10)
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
        return data_uri(figure)
