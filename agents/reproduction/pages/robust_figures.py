"""The figures of the page on the robust filters."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from agents.plotting import BELIEVED, INK, PALETTE, RAW, TRUE, drawing
from agents.reproduction.pages.robust_results import (
    MODEL_ERRORS,
    OTHERS,
    ROBUST,
    SHOWN,
    SHOWN_TITLES,
    WHERE,
    Results,
    mean_ratio,
    percent,
    system_traits,
    unit_ratios,
)
from agents.reproduction.settings import robust as settings
from agents.reproduction.settings.robust import Condition

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLOURS = dict(zip(("kf", *OTHERS), (INK, BELIEVED, PALETTE[5], TRUE), strict=True))
_MARKERS = dict(zip(("kf", *OTHERS), ("", "s", "^", "o"), strict=True))
_TICKS = (0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.2, 1.5, 2.0)


def _ratio_axis(panel: "Axes", ticks: Sequence[float] = _TICKS) -> None:
    """A logarithmic axis of ratios with 1 drawn."""
    from matplotlib.ticker import NullFormatter, NullLocator

    panel.set_yscale("log")
    panel.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    panel.yaxis.set_minor_locator(NullLocator())
    panel.yaxis.set_minor_formatter(NullFormatter())
    panel.axhline(1.0, color=INK, linewidth=0.9)
    panel.grid()


def _sweep(panel: "Axes", results: Results, conditions: Sequence[Condition], labels: Sequence[str]) -> None:
    """Ratios with bands over a sweep, its conditions side by side; the single system as open markers."""
    places = np.arange(len(conditions))
    for name in OTHERS:
        ratios = [mean_ratio(results, settings.RANDOM, condition, name) for condition in conditions]
        low, mean, high = (np.array([getattr(ratio, end) for ratio in ratios]) for end in ("low", "mean", "high"))
        panel.fill_between(places, low, high, color=_COLOURS[name], alpha=0.22, linewidth=0.0)
        panel.plot(places, mean, color=_COLOURS[name], marker=_MARKERS[name], markersize=4, label=name)
        single = [mean_ratio(results, settings.PAPER, condition, name).mean for condition in conditions]
        panel.plot(
            places, single, color=_COLOURS[name], marker=_MARKERS[name], markersize=4, markerfacecolor="white",
            linestyle=":", linewidth=0.8,
        )  # fmt: skip
    panel.set_xticks(places, labels)
    _ratio_axis(panel)


@drawing(7.2, 5.6)
def sweep_figure(canvas: "Figure", results: Results) -> None:
    """Ratios to the KF over every sweep of one disturbance."""
    axes: tuple[tuple[str, str, Callable[[float], str]], ...] = (
        ("rate", f"outliers of {settings.OUTLIERS.size:g} σ [% of readings]", lambda v: f"{100 * v:g}"),
        ("size", f"size of {percent(settings.OUTLIERS.rate)} outliers [σ]", "{:g}".format),
        ("tolerance", "tolerance c of the least-favourable model", "{:g}".format),
        ("parameters", "error of A [% of |A|]", lambda v: f"{100 * v:g}"),
    )
    panels = canvas.subplots(2, 2, sharey="row")
    for panel, (key, label, form), title in zip(
        panels.flat, axes, ("(a) how many outliers", "(b) how large", "(c) worst noise", "(d) wrong A"), strict=True
    ):
        conditions = settings.SWEEPS[key]
        _sweep(panel, results, conditions, [form(getattr(c, key)) for c in conditions])
        panel.set_xlabel(label)
        panel.set_title(title, loc="left")
    for row in panels:
        row[0].set_ylabel("RMSE / RMSE of the KF")
    panels[0, 0].set_ylim(0.18, 2.05)
    panels[1, 0].set_ylim(0.94, 1.32)
    for panel in panels[1]:
        _ratio_axis(panel, (0.95, 1.0, 1.05, 1.1, 1.2, 1.3))
    canvas.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=3)


@drawing(7.2, 3.2)
def crossed_figure(canvas: "Figure", results: Results) -> None:
    """Ratios to the KF over outliers, under either model error."""
    panels = canvas.subplots(1, len(settings.CROSSED), sharey=True)
    for panel, (name, conditions) in zip(panels, settings.CROSSED.items(), strict=True):
        _sweep(panel, results, conditions, [f"{100 * c.rate:g}" for c in conditions])
        panel.set_title(MODEL_ERRORS[name], loc="left")
        panel.set_xlabel(f"outliers of {settings.OUTLIERS.size:g} σ [% of readings]")
    panels[0].set_ylabel("RMSE / RMSE of the KF")
    canvas.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=3)


@drawing(7.2, 2.9)
def systems_figure(canvas: "Figure", results: Results) -> None:
    """Every random system's ratio to the KF, in the conditions shown."""
    panels = canvas.subplots(1, len(SHOWN), sharey=True)
    for panel, condition, title in zip(panels, SHOWN, SHOWN_TITLES, strict=True):
        for name in OTHERS:
            ratios = np.sort(unit_ratios(results, condition, name))
            panel.plot(100.0 * (np.arange(len(ratios)) + 0.5) / len(ratios), ratios, color=_COLOURS[name], label=name)
        _ratio_axis(panel, (0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0))
        panel.set_ylim(0.3, 5.0)
        panel.set_xticks((0, 50, 100))
        panel.set_title(title, loc="left", fontsize=9)
    panels[0].set_ylabel("RMSE / RMSE of the KF")
    canvas.supxlabel("share of systems with at most this ratio [%]", fontsize=10)
    canvas.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=3)


@drawing(7.2, 2.9)
def traits_figure(canvas: "Figure", results: Results) -> None:
    """Ratios over the trait of the system that explains them."""
    traits = system_traits()
    panels = canvas.subplots(1, 2)
    for panel, (name, condition, trait, label) in zip(panels, WHERE, strict=True):
        ratios = unit_ratios(results, condition, name)
        panel.scatter(traits[trait], ratios, s=9, color=_COLOURS[name], alpha=0.6, linewidths=0.0)
        panel.set_xscale("log")
        _ratio_axis(panel, (0.3, 0.4, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0))
        panel.set(ylim=(0.9 * ratios.min(), 1.1 * ratios.max()), xlabel=label)
        panel.set_title(f"{name}: {SHOWN_TITLES[SHOWN.index(condition)]}", loc="left")
    panels[0].set_ylabel("RMSE / RMSE of the KF")


_DRAWN = ("kf", "huber-kf", ROBUST[1])
"""Filters in the figures of the single system."""


def _time() -> np.ndarray:
    return settings.STEP * np.arange(settings.STEPS)


@drawing(7.2, 3.4)
def estimates_figure(canvas: "Figure", results: Results, truth: bool = False) -> None:
    """The paper's figure 1, or with the true states its figure 2."""
    example, t = results["example"], _time()
    x = np.asarray(example["x"])
    panels = canvas.subplots(settings.STATES, 1, sharex=True)
    for i, panel in enumerate(panels):
        if truth:
            panel.plot(t, x[:, i], color=RAW, linewidth=2.6, label="true")
        for name, line in zip(_DRAWN, ("-", "--", "-."), strict=True):
            panel.plot(
                t, np.asarray(example[name]["clean"])[:, i], line, color=_COLOURS[name], linewidth=0.9, label=name
            )
        panel.set_ylabel(f"$x_{i + 1}$")
        panel.set_title(f"({'ab'[i]})", loc="left")
        panel.margins(x=0.01)
        panel.grid()
    panels[-1].set_xlabel("time [s]")
    canvas.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=4)


@drawing(7.2, 3.0)
def gain_figure(canvas: "Figure", results: Results) -> None:
    """The paper's figure 3."""
    example, t = results["example"], _time()
    panel = canvas.subplots()
    for name in ("kf", ROBUST[1]):
        gain = np.asarray(example[name]["gain"])
        panel.fill_between(t, gain[:, 1], gain[:, 0], color=_COLOURS[name], alpha=0.15, linewidth=0.0)
        panel.plot(t, gain[:, 0], color=_COLOURS[name], label=name)
        panel.plot(t, gain[:, 1], color=_COLOURS[name])
    moved, outlier = (np.asarray(values) for values in (example["huber-kf"]["correction"], example["outlier"]))
    hit = outlier > 0.0
    panel.plot(t[~hit], moved[~hit], "s", color=_COLOURS["huber-kf"], markersize=2.5, label="huber-kf, |K e| / |e|")
    panel.plot(t[hit], moved[hit], "x", color=PALETTE[6], markersize=5, label="huber-kf, at an outlier")
    panel.set(yscale="log", xlabel="time [s]", ylabel="gain [state / reading]")
    panel.margins(x=0.01)
    panel.grid()
    canvas.legend(*panel.get_legend_handles_labels(), loc="outside upper right", ncols=4)


@drawing(7.2, 2.7)
def covariance_figure(canvas: "Figure", results: Results) -> None:
    """The paper's figure 4."""
    example, t = results["example"], _time()
    panels = canvas.subplots(1, settings.STATES, sharey=True)
    for i, panel in enumerate(panels):
        for name in reversed(_DRAWN):
            panel.plot(t, np.asarray(example[name]["variance"])[:, i], color=_COLOURS[name], label=name)
        panel.set_yscale("log")
        panel.set_yticks((0.2, 0.5, 1.0, 2.0, 5.0), ["0.2", "0.5", "1", "2", "5"])
        panel.minorticks_off()
        panel.set_title(f"variance of $x_{i + 1}$", loc="left")
        panel.set_xlabel("time [s]")
        panel.grid()
    panels[0].set_ylabel("P after the reading [state²]")
    canvas.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=3)


@drawing(7.2, 4.4)
def disturbance_figure(canvas: "Figure", results: Results) -> None:
    """The paper's figure 5."""
    example, t = results["example"], _time()
    x, hit = np.asarray(example["x"])[:, 0], np.asarray(example["outlier"]) > 0.0
    panels = canvas.subplots(len(_DRAWN), 1, sharex=True, sharey=True)
    for panel, name in zip(panels, _DRAWN, strict=True):
        panel.plot(t, x, color=RAW, linewidth=2.2, label="true")
        panel.plot(t, np.asarray(example[name]["clean"])[:, 0], color=TRUE, label="estimate without disturbance")
        panel.plot(t, np.asarray(example[name]["disturbed"])[:, 0], color=BELIEVED, label="estimate with disturbance")
        panel.set_title(name, loc="left")
        panel.set_ylabel("$x_1$")
        panel.margins(x=0.01)
        panel.grid()
        floor = panel.get_ylim()[0]
        panel.plot(t[hit], np.full(hit.sum(), floor), "|", color=INK, markersize=7, clip_on=False, label="outlier")
    panels[-1].set_xlabel("time [s]")
    canvas.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=4)


def figures(results: Results) -> dict[str, str]:
    """Every figure of the page by its name in the template."""
    drawn = (
        sweep_figure, crossed_figure, systems_figure, traits_figure, estimates_figure, gain_figure, covariance_figure,
        disturbance_figure,
    )  # fmt: skip
    found = {draw.__name__.removesuffix("_figure"): draw(results) for draw in drawn}
    return found | {"truth": estimates_figure(results, truth=True)}
