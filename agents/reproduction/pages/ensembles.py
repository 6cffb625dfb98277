"""Shared by the pages on ensemble filters: changes of results with the number of members."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from agents.page import Entry, Table, entry, number
from agents.plotting import BELIEVED, PUBLISHED, TRUE, drawing
from agents.reproduction.comparison import Comparison, Published
from agents.statistics import Interval, mean_interval

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Errors = Mapping[int, np.ndarray]
"""Errors of some quantities ``(runs, q)`` by the number of members, in the same runs for all."""
Printed = Mapping[int, Mapping[str, Published]]
"""A published table by the number of members, then by quantity; "time" is the computing time."""


def exponents(members: Sequence[int], values: np.ndarray) -> np.ndarray:
    """The least-squares a of ``value ~ N^a`` for every row of ``(..., len(members))``, ``(...)``."""
    x, y = np.log(members), np.log(values)
    x -= x.mean()
    return (y - y.mean(-1, keepdims=True)) @ x / (x @ x)


def slope(members: Sequence[int], values: np.ndarray) -> Interval | None:
    """The exponent a of ``value ~ N^a`` with its 95 % interval, from values ``(runs, len(members))``.

    A run is fitted on its own, over the sizes that all saw the same truth and readings: the fit is paired.
    """
    return mean_interval(exponents(members, values))


def slopes(errors: Errors) -> list[Interval | None]:
    """The exponent of every quantity, and last that of their geometric mean: one answer for all of them."""
    values = np.stack(list(errors.values()), -1)  # runs, quantities, sizes
    each = [slope(list(errors), values[:, i]) for i in range(values.shape[1])]
    return [*each, slope(list(errors), np.exp(np.log(values).mean(1)))]


def printed_slopes(printed: Printed) -> dict[str, float]:
    """The exponents of a published table's columns."""
    columns = {name: [row[name].value for row in printed.values()] for name in next(iter(printed.values()))}
    return {name: float(exponents(list(printed), np.array(values))) for name, values in columns.items()}


def verdict(trend: Interval | None, sign: int) -> str:
    """Verdict on a rise (``sign`` 1) or fall (-1) with N."""
    if trend is None or not trend.excludes_zero:
        return "undecided, no detectable difference"
    return "true" if trend.mean * sign > 0.0 else "false"


def change(trend: Interval | None, first: int, last: int) -> str:
    """Change of a value between two sizes by an exponent, in words: "−1.2 % (−2.0 to −0.4 %)"."""
    if trend is None:
        return "–"
    mean, low, high = (100.0 * ((last / first) ** a - 1.0) for a in (trend.mean, trend.low, trend.high))
    return f"{number(mean, 1, True)} % ({number(low, 1, True)} to {number(high, 1, True)} %)"


def changes(names: Iterable[str], trends: Iterable[Interval | None], first: int, last: int) -> str:
    """The changes of several quantities between two sizes."""
    return "; ".join(f"{name} {change(trend, first, last)}" for name, trend in zip(names, trends, strict=True))


def means(errors: np.ndarray, decimals: Sequence[int]) -> list[Entry]:
    """The mean of each column of ``(runs, q)`` in a table."""
    return [entry(mean_interval(column), places) for column, places in zip(errors.T, decimals, strict=True)]


def comparisons(printed: Printed, errors: Errors, above: Mapping[str, str]) -> list[Comparison]:
    """Every error of a published table beside ours.

    Args:
        printed: The table, "time" its last column.
        errors: Ours, quantities in the table's order.
        above: By quantity, why ours is above where it is.
    """
    found = []
    for members, row in printed.items():
        *quantities, _ = row
        for j, name in enumerate(quantities):
            ours = mean_interval(errors[members][:, j])
            found.append(Comparison(f"{members} members", name, row[name], ours, above.get(name, "")))
    return found


def time_comparisons(printed: Printed, label: str, seconds: np.ndarray) -> list[Comparison]:
    """Every computing time of a published table beside ours ``(repeats, sizes)``."""
    found = []
    for (members, row), took in zip(printed.items(), seconds.T, strict=True):
        share = took.mean() / row["time"].value
        reason = f"another machine and language; ours takes {share:.2g} of the time"
        found.append(Comparison(f"{members} members", label, row["time"], mean_interval(took), incomparable=reason))
    return found


def growth_table(title: str, note: str, printed: Printed, ours: Mapping[str, Errors]) -> Table:
    """Exponents of error over the number of members, published and ours."""
    theirs = printed_slopes(printed)
    *quantities, _ = theirs
    head = [(name, "") for name in (*quantities, "all")]
    rows = [("published", [*(Entry(number(theirs[name], 3, True)) for name in quantities), Entry("–")])]
    rows += [(label, [entry(each, 3, True) for each in slopes(errors)]) for label, errors in ours.items()]
    return Table(title, note, "exponent of", head, [("", rows)], "exponents")


@drawing(7.2, 4.4)
def members_figure(
    figure: "Figure",
    printed: Printed,
    units: Mapping[str, str],
    ours: Mapping[str, Errors],
    seconds: Mapping[str, np.ndarray],
) -> None:
    """Error and computing time over the number of members, published and ours, both axes logarithmic."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

    members = list(printed)
    panels = figure.subplots(2, 3)
    for j, (name, axes) in enumerate(zip((*units, "time"), panels.flat, strict=False)):
        axes.plot(
            members, [row[name].value for row in printed.values()], color=PUBLISHED, marker="x", ls=":",
            label="published",
        )  # fmt: skip
        for (label, errors), (color, marker) in zip(ours.items(), ((TRUE, "o"), (BELIEVED, "s")), strict=False):
            if name != "time":
                _points(axes, members, [errors[size][:, j] for size in members], color, marker, label)
            elif label in seconds:
                _points(axes, members, list(seconds[label].T), color, marker, label)
        axes.set(xscale="log", yscale="log", title=name, xticks=members, xticklabels=members)
        axes.set_ylabel(f"RMSE [{units[name]}]" if name in units else "a dive [s]")
        axes.xaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.grid(True, axis="y")
    for axes in panels[1]:
        axes.set_xlabel("members")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    panels[1, 2].axis("off")
    panels[1, 2].legend(handles, labels, loc="center")


def _points(
    axes: "Axes", members: Sequence[int], values: Sequence[np.ndarray], color: str, marker: str, label: str
) -> None:
    means = [float(np.mean(each)) for each in values]
    halves = [0.0 if (interval := mean_interval(each)) is None else interval.half for each in values]
    axes.errorbar(members, means, halves, color=color, marker=marker, ms=4, capsize=2, label=label)
