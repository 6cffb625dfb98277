"""All figures of the papers' pages: panels of curves, and ratios to print."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from agents.plotting import BELIEVED, INK, PALE, PALETTE, PUBLISHED, TRUE, data_uri, styled
from studies.papers.measures import NEAR, Comparison

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = (TRUE, BELIEVED, *PALETTE[2:])


@dataclass(frozen=True)
class Curve:
    """Points ``(k,)``, joined by a line or marked; ``half`` is half of an interval, ``fill`` a lower bound."""

    x: Any
    y: Any
    label: str = ""
    color: str = TRUE
    line: str = "-"
    marker: str = ""
    half: Any = None
    fill: Any = None
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Panel:
    """Curves with their axes; ``levels`` are dashed red lines, ``one`` a line at 1, ``options`` go to ``Axes.set``."""

    curves: Sequence[Curve]
    x: str = ""
    y: str = ""
    title: str = ""
    levels: Sequence[float] = ()
    one: bool = False
    equal: bool = False
    options: Mapping[str, Any] = field(default_factory=dict)

    def draw(self, axes: "Axes") -> None:
        """Draw on axes."""
        for c in self.curves:
            look: dict[str, Any] = {"color": c.color, "marker": c.marker or None, "markersize": 4, **c.options}
            if c.fill is not None:
                axes.fill_between(c.x, c.fill, c.y, color=c.color, alpha=0.2, linewidth=0.0)
            axes.errorbar(
                c.x, c.y, c.half, linestyle=c.line or "none", capsize=1.5, elinewidth=0.8, label=c.label or None, **look
            )
        for level in self.levels:
            axes.axhline(level, color=PUBLISHED, linewidth=0.8, linestyle="--")
        if self.one:
            axes.axhline(1.0, color=INK, linewidth=0.9)
        axes.set(xlabel=self.x, ylabel=self.y, **self.options)
        axes.set_title(self.title, loc="left", fontsize=9)
        if self.equal:
            axes.set_aspect("equal")
        _plain_ticks(axes)
        axes.grid()


def _plain_ticks(axes: "Axes") -> None:
    """Logarithmic axes with numbers such as 0.5 instead of powers of ten."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    for axis in (axes.xaxis, axes.yaxis):
        if axis.get_scale() == "log":
            low, high = axis.get_view_interval()
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high / low < 300.0 else (1.0,)))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axis.set_minor_formatter(NullFormatter())


def _drawn(width: float, height: float, draw: Callable[..., None], *arguments: Any) -> str:
    """A new figure of this size [in], drawn by a function, as a data URI."""
    from matplotlib.figure import Figure

    with styled():
        figure = Figure(figsize=(width, height), layout="constrained")
        draw(figure, *arguments)
        return data_uri(figure)


def panels(
    grid: Sequence[Sequence[Panel]], width: float, height: float, sharex: Any = True, sharey: Any = False
) -> str:
    """Figure of panels in rows, with one legend for all."""
    return _drawn(width, height, _panels, grid, sharex, sharey)


def _panels(figure: "Figure", grid: Sequence[Sequence[Panel]], sharex: Any, sharey: Any) -> None:
    handles: dict[str, Any] = {}
    for row, line in zip(
        figure.subplots(len(grid), len(grid[0]), sharex=sharex, sharey=sharey, squeeze=False), grid, strict=True
    ):
        for axes, panel in zip(row, line, strict=True):
            panel.draw(axes)
            found, labels = axes.get_legend_handles_labels()
            handles |= dict(zip(labels, found, strict=True))
    figure.align_ylabels()
    if handles:
        figure.legend(handles.values(), handles.keys(), loc="outside upper right", ncols=min(len(handles), 4))


def ratios(columns: Mapping[str, Sequence[Comparison]]) -> str:
    """Ours over every printed number with 95 % intervals; band: a factor of `NEAR`; a hollow mark does not count."""
    rows = len(next(iter(columns.values())))
    return _drawn(7.2, 1.1 + 0.2 * rows, _ratios, columns)


def _ratios(figure: "Figure", columns: Mapping[str, Sequence[Comparison]]) -> None:
    axes = figure.subplots()
    axes.axvspan(1.0 / NEAR, NEAR, color=PALE, alpha=0.5, linewidth=0.0)
    axes.axvline(1.0, color=INK, linewidth=0.8)
    first = next(iter(columns.values()))
    for i, (label, comparisons) in enumerate(columns.items()):
        for j, c in enumerate(comparisons):
            ratio, shift = c.ratio, 0.16 * (i - 0.5 * (len(columns) - 1))
            ends = [[ratio.mean - ratio.low], [ratio.high - ratio.mean]]
            axes.errorbar(
                ratio.mean, j + shift, xerr=ends, color=COLOURS[i], marker="os^"[i % 3], markersize=4, linestyle="none",
                capsize=1.5, markerfacecolor="white" if c.reason else COLOURS[i], label=None if j else label or "ours",
            )  # fmt: skip
    axes.set_yticks(range(len(first)), [f"{c.experiment}: {c.quantity}" for c in first])
    axes.set(ylim=(len(first) - 0.5, -0.5), xscale="log", xlabel="ours / printed")
    _plain_ticks(axes)
    axes.grid(axis="x")
    if len(columns) > 1:
        figure.legend(loc="outside upper right", ncols=len(columns))


def ends(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means and half-widths of 95 % intervals over the last axis, for `Curve`."""
    from agents.statistics import mean_interval

    found = [mean_interval(each) for each in values.reshape(-1, values.shape[-1])]
    shape = values.shape[:-1]
    means = np.reshape([i.mean for i in found if i is not None], shape)
    return means, np.reshape([i.half for i in found if i is not None], shape)
