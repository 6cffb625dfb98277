"""The figures of the PUNA page."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from agents.plotting import BELIEVED, INK, PALETTE, PUBLISHED, RAW, TRUE, drawing
from agents.reproduction.pages.comparison import mean_of
from agents.reproduction.pages.puna_results import Results, errors_of
from agents.reproduction.puna import PLANE, cell_name
from agents.reproduction.settings import puna as paper

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@drawing(7.2, 2.8)
def open_figure(figure: "Figure", found: Mapping[str, Any]) -> None:
    """The paths without an obstacle under two readings of the headings."""
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    for panel, reading in zip(panels, ("from the x axis", "from the y axis, clockwise"), strict=True):
        lengths_ = found["lengths"][reading]
        best = min(lengths_, key=lengths_.get)
        for word, track in found["tracks"][reading].items():
            colour, width = (TRUE, 1.8) if word == best else (PUBLISHED, 1.1) if word == paper.OPEN.word else (RAW, 0.6)
            x, y = np.transpose(track)
            label = f"{word} {lengths_[word]:.1f} m" if colour != RAW else None
            line = "--" if colour == PUBLISHED else "-"
            panel.plot(x, y, color=colour, linewidth=width, linestyle=line, label=label, zorder=3 if width > 1 else 2)
        _arrows(panel, np.asarray(found["poses"][reading]))
        panel.set_title(f"headings {reading}", loc="left")
        panel.legend(loc="lower left")
        _map(panel)
    panels[0].set(ylim=(-160.0, 420.0), ylabel="y [m]")


@drawing(7.2, 2.5)
def obstacle_figure(figure: "Figure", found: Mapping[str, Any]) -> None:
    """The paths with an obstacle."""
    from matplotlib.patches import Circle

    x, y, radius = paper.OBSTRUCTED.obstacle
    strings = found["strings"]
    drawn = {
        "whole": (BELIEVED, "-", f"{found['word']}, {found['length']:.1f} m, through the obstacle"),
        "detour": (TRUE, "-", f"our plan, {found['detour']:.1f} m"),
        "SRS": (PUBLISHED, "--", f"SRS, {strings['SRS']:.1f} m, the paper's"),
        "SLS": (PALETTE[2], "--", f"SLS, {strings['SLS']:.1f} m"),
    }
    panel = figure.subplots()
    panel.add_patch(Circle((x, y), radius, facecolor="#dfe2e6", edgecolor=INK, linewidth=0.6))
    for name, (colour, line, label) in drawn.items():
        panel.plot(*np.transpose(found["tracks"][name]), color=colour, linestyle=line, linewidth=1.4, label=label)
    printed = np.array([paper.OBSTRUCTED.start, paper.OBSTRUCTED.goal])
    panel.plot(*printed.T, "D", color=PUBLISHED, markersize=5, zorder=5, label="printed points")
    _arrows(panel, np.asarray(found["poses"]), printed=False)
    panel.set(xlim=(-520.0, 45.0), ylim=(85.0, 195.0), ylabel="y [m]")
    _map(panel)
    figure.legend(loc="outside lower center", ncols=3)


def _arrows(panel: "Axes", ends: np.ndarray, printed: bool = True) -> None:
    """Poses ``(2, 3)`` as points with arrows."""
    x, y, heading = ends.T
    inches: Any = {"units": "inches", "width": 0.022, "scale_units": "inches", "scale": 3.2}
    panel.quiver(x, y, np.cos(heading), np.sin(heading), color=INK, zorder=4, **inches)
    panel.plot(
        x, y, "D" if printed else "o", color=PUBLISHED if printed else INK, markersize=5 if printed else 3, zorder=5
    )


def _map(panel: "Axes") -> None:
    panel.set_aspect("equal")
    panel.set_xlabel("x [m]")
    panel.grid()


@drawing(7.2, 7.0)
def flight_figure(figure: "Figure", results: Results) -> None:
    """The first flight under either control, true and estimated."""
    time = PLANE.dt * np.arange(1, paper.STEPS + 1)
    level = np.zeros((paper.STEPS, 4))
    level[:, 2] = paper.SPEED * time
    panels = figure.subplots(4, 2, sharex=True, sharey="row")
    for j, control in enumerate(paper.CONTROLS):
        column = panels[:, j]
        cases = {measured: results[cell_name("flight", control, measured)] for measured in paper.MEASURED}
        truth = np.asarray(cases["all"]["truth"]) - level
        for i, (panel, state) in enumerate(zip(column, paper.STATES, strict=True)):
            panel.plot(time, truth[:, i], color=TRUE, linewidth=1.5, label="true")
            for measured, (colour, line) in {"all": (BELIEVED, "-"), "x": (PALETTE[2], "--")}.items():
                mean = np.asarray(cases[measured]["estimate"]) - level
                label = f"estimated, {paper.MEASURED[measured]} measured"
                panel.plot(time, mean[:, i], color=colour, linestyle=line, linewidth=1.0, label=label)
            panel.grid()
            panel.margins(x=0.01)
            if j == 0:
                panel.set_ylabel(("x − 20 t" if state.symbol == "x" else state.symbol) + f" [{state.unit}]")
        column[0].set_title(f"{control} angle of attack, {paper.PRINTED_MEMBERS[control]} members", loc="left")
        column[-1].set_xlabel("time [s]")
    figure.align_ylabels()
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=3)


@drawing(7.2, 7.6)
def members_figure(figure: "Figure", results: Results) -> None:
    """RMS errors over the number of members with the printed ones."""
    from matplotlib.ticker import LogLocator

    looks = {"all": (TRUE, "o"), "x": (BELIEVED, "s")}
    panels = figure.subplots(4, 2, sharex=True, sharey="row")
    for j, (level, chosen) in enumerate(paper.LEVELS.items()):
        column = panels[:, j]
        for i, (panel, state) in enumerate(zip(column, paper.STATES, strict=True)):
            for measured, (colour, marker) in looks.items():
                for control in paper.CONTROLS:
                    constant = control == "constant"
                    errors = [mean_of(values) for values in errors_of(results, level, control, measured)[:, :, i]]
                    panel.errorbar(
                        np.array(paper.MEMBERS) + (-4 if constant else 4), [e.mean for e in errors],
                        yerr=[e.half for e in errors], color=colour, marker=marker, markersize=4,
                        markerfacecolor=colour if constant else "white", linestyle="-" if constant else ":",
                        linewidth=0.8, elinewidth=0.8, capsize=1.5,
                        label=f"{paper.MEASURED[measured]}, {control} angle",
                    )  # fmt: skip
            for control in paper.CONTROLS:
                panel.plot(
                    paper.PRINTED_MEMBERS[control], paper.PRINTED[control][i].value, "D", color=PUBLISHED,
                    markerfacecolor=PUBLISHED if control == "constant" else "white", markersize=6, zorder=5,
                    linestyle="none", label=f"printed, {control} angle",
                )  # fmt: skip
            panel.set_yscale("log")
            panel.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            panel.yaxis.set_major_formatter("{x:g}")
            panel.minorticks_off()
            panel.margins(y=0.2)
            panel.grid()
            if j == 0:
                panel.set_ylabel(f"RMS error of {state.symbol} [{state.unit}]")
        column[0].set_title(chosen.title, loc="left")
        column[-1].set_xticks(paper.MEMBERS)
        column[-1].set_xlabel("members")
    figure.align_ylabels()
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
