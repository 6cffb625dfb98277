"""The figures of a study's report. An estimator has one colour and one mark in all of them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from agents.page import Entry
from agents.page import Figure as Picture
from agents.plotting import INK, PALETTE, RAW, data_uri, styled
from agents.statistics import Interval, crossed_interval, performance_profile
from agents.studies.records import FLOOR, ORACLE, Condition
from agents.studies.records import RAW as MEASUREMENTS
from agents.studies.results import Place, Policy, Results
from agents.studies.wording import share_entry

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH = 7.2
"""Inches."""
ALL = "All"
"""Heading of what holds for all environments together."""
_MARKS = "os^vDP<>Xp*h"
_LINES = ("-", "--", "-.", ":")
AXES = {
    "disturbance": "disturbance", "sensors": "sensor suite", "mismatch": "mismatch of the model", "latency": "latency",
    "faults": "faults of sensors",
}  # fmt: skip
"""Axes along which conditions differ, with their labels."""
_ORDER = {"disturbance": ("calm", "moderate", "rough"), "sensors": ("clean", "nominal", "degraded")}


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
    free = (name for name in names if name not in found)
    for i, name in enumerate(free):
        found[name] = Look(PALETTE[i % len(PALETTE)], _MARKS[i % len(_MARKS)], _LINES[i // len(PALETTE) % len(_LINES)])
    return {name: found[name] for name in names}


# --- who keeps how much -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Row:
    """A line of a dot plot: its name, look, and values by panel; None where there is none."""

    name: str
    look: Look
    values: Sequence[Interval | float | None]


def dots(rows: Sequence[Row], heads: Sequence[str], label: str, marks: Sequence[float] = (0.0, 1.0)) -> "Figure":
    """Values with their intervals, a line each, the first on top; a number without an interval is hollow.

    Heads say what the panels show: environments, or `ALL`, which is set in a tint. At each of ``marks`` a line is
    drawn, in sight in every panel.
    """
    from matplotlib.figure import Figure

    with styled():
        figure = Figure(figsize=(WIDTH, 0.9 + 0.19 * len(rows)), layout="constrained")
        axes = figure.subplots(1, len(heads), sharey=True, sharex=True, squeeze=False)[0]
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
    mean, ends = (value, None) if isinstance(value, int | float) else (value.mean, _ends([value]))
    panel.errorbar(
        mean, height, xerr=ends, color=look.colour, marker=look.mark, markersize=3.5 if look.mark != "|" else 8,
        markerfacecolor="white" if ends is None else look.colour, elinewidth=1.0, capsize=2.2, linestyle="none",
    )  # fmt: skip


def _ends(intervals: Sequence[Interval]) -> np.ndarray:
    """Distances of the ends of intervals from their means, ``(2, k)``."""
    return np.maximum([[i.mean - i.low for i in intervals], [i.high - i.mean for i in intervals]], 0.0)


# --- learned agents ---------------------------------------------------------------------------------


def policy_looks(results: Results) -> dict[Policy, Look]:
    """The look of everybody of `Results.schools`: a colour each, a line for each agent."""
    agents = [agent.name for agent in results.plan.study.agents]
    return {
        policy: Look(PALETTE[i % len(PALETTE)], _MARKS[i % len(_MARKS)], _LINES[agents.index(policy.agent) % 4])
        for i, policy in enumerate(results.schools())
    }


def _panels(count: int, above: float, height: float, sharey: bool = False) -> "tuple[Figure, list[Axes]]":
    """A figure of panels in up to two columns, with room above them [in]."""
    from matplotlib.figure import Figure

    columns = min(count, 2)
    lines = -(-count // columns)
    figure = Figure(figsize=(WIDTH, above + height * lines), layout="constrained")
    axes = list(figure.subplots(lines, columns, squeeze=False, sharey=sharey).flat)
    for panel in axes[count:]:
        panel.set_axis_off()
    return figure, axes[:count]


def profile_figure(results: Results) -> "Figure":
    """Share of training runs that keep more than some share of the oracle's performance, a panel an environment.

    The pointwise bands are drawn where runs lie; beyond them they go on, and would hide each other.
    """
    look = policy_looks(results)
    learned = [policy for policy in look if results.agent(policy).learned]
    each = {e: {p: runs for p in learned if (runs := results.runs([e], p)) is not None} for e in results.environments}
    drawn = {environment: flown for environment, flown in each.items() if flown}
    with styled():
        figure, axes = _panels(len(drawn), 0.6 + 0.2 * -(-len(learned) // 3), 1.9, sharey=True)
        for panel, (environment, flown) in zip(axes, drawn.items(), strict=True):
            every = np.concatenate([runs.ravel() for runs in flown.values()])
            margin = 0.08 * max(float(np.ptp(every)), 0.05)
            thresholds = np.linspace(every.min() - margin, every.max() + margin, 201)
            for policy, runs in flown.items():
                profile = performance_profile(runs, thresholds)
                low, mean, high = np.array([(share.low, share.mean, share.high) for share in profile]).T
                colour, near = look[policy].colour, 0.5 * margin
                there = (thresholds > runs.min() - near) & (thresholds < runs.max() + near)
                panel.fill_between(thresholds, low, high, where=there, color=colour, alpha=0.15, linewidth=0.0)
                panel.plot(thresholds, mean, color=colour, linestyle=look[policy].line, label=str(policy))
            panel.set_title(environment, loc="left")
            panel.set_xlabel("share kept")
            panel.set_ylim(-0.03, 1.03)
            panel.grid()
        figure.supylabel("share of runs above", fontsize=10)
        _legend(figure, axes, 3)
        return figure


def transfer_figure(results: Results, agent: str) -> "Figure | None":
    """Share kept by policies trained on one estimator and flown on another; None if nothing was trained.

    Args:
        results: Of a study.
        agent: Name of one that learns and flies on estimates.
    """
    from matplotlib.figure import Figure

    tables = {}
    for environment in results.environments:
        policies = [p for p in results.policies(environment) if p.agent == agent]
        on = [name for name in results.estimators(environment) if name != MEASUREMENTS]
        shares = np.array([[_transfer(results, environment, policy, name) for name in on] for policy in policies])
        if np.isfinite(shares).any():
            tables[environment] = ([p.trained_on for p in policies], on, shares)
    if not tables:
        return None
    with styled():
        heights = [0.25 * len(rows) + 1.05 for rows, _, _ in tables.values()]
        figure = Figure(figsize=(WIDTH, sum(heights)), layout="constrained")
        axes = figure.subplots(len(tables), 1, squeeze=False, height_ratios=heights)[:, 0]
        for panel, (environment, (rows, on, shares)) in zip(axes, tables.items(), strict=True):
            panel.imshow(np.clip(shares, 0.0, 1.0), cmap="Blues", vmin=0.0, vmax=1.4, aspect="auto")
            for (i, j), share in np.ndenumerate(shares):
                text = f"{share:.2f}".replace("-", "−") if np.isfinite(share) else "–"
                own = rows[i] == on[j]
                panel.text(j, i, text, ha="center", va="center", fontsize=8.5, weight="bold" if own else "normal")
                if own:
                    panel.add_patch(_box(j, i))
            panel.set_xticks(range(len(on)), on, rotation=35, ha="right", rotation_mode="anchor", fontsize=8.5)
            panel.set_yticks(range(len(rows)), rows)
            panel.tick_params(length=0)
            for spine in panel.spines.values():
                spine.set_visible(False)
            panel.set_title(environment, loc="left")
            panel.set_ylabel("trained on")
        axes[-1].set_xlabel("flown on")
        return figure


def _transfer(results: Results, environment: str, policy: Policy, estimator: str) -> float:
    runs = results.runs([environment], policy, estimator)
    return float("nan") if runs is None else float(runs.mean())


def _box(column: int, row: int) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((column - 0.5, row - 0.5), 1.0, 1.0, fill=False, edgecolor=INK, linewidth=1.2, clip_on=False)


# --- robustness and cost ----------------------------------------------------------------------------


def along(results: Results, axis: str) -> list[Condition]:
    """The conditions that differ from the first in one axis alone, the first among them, in the axis' order."""
    first, *others = results.plan.study.conditions
    found: dict[Any, Condition] = {_value(first, axis): first}
    for other in others:
        if {name for name in AXES if getattr(other, name) != getattr(first, name)} == {axis}:
            found.setdefault(_value(other, axis), other)
    order = _ORDER.get(axis)
    return [found[value] for value in sorted(found, key=order.index if order and set(found) <= set(order) else None)]


def varied(results: Results) -> dict[str, list[Condition]]:
    """Conditions `along` each axis that is varied alone."""
    return {axis: conditions for axis in AXES if len(conditions := along(results, axis)) > 1}


def robustness_figure(results: Results) -> "Figure | None":
    """Share kept by the classical agent over each axis of the conditions, a row an environment; None without an axis.

    The ends of the scale are left out: they are 0 and 1 in every condition.
    """
    from matplotlib.figure import Figure

    drawn = varied(results)
    if not drawn:
        return None
    look = {name: each for name, each in looks(results).items() if name not in (ORACLE, FLOOR)}
    rows = results.environments
    with styled():
        legend = 0.19 * -(-len(look) // 6)
        figure = Figure(figsize=(WIDTH, 0.5 + legend + 1.62 * len(rows)), layout="constrained")
        axes = figure.subplots(len(rows), len(drawn), sharey="row", squeeze=False)
        for (i, environment), (j, (axis, conditions)) in product(enumerate(rows), enumerate(drawn.items())):
            panel = axes[i, j]
            names = [name for name in results.estimators(environment, results.classical) if name in look]
            for k, name in enumerate(names):
                _curve(
                    panel, results, environment, name, conditions, 0.16 * (k / max(len(names) - 1, 1) - 0.5), look[name]
                )
            panel.set_xticks(range(len(conditions)), [_level(c, axis) for c in conditions])
            panel.set_xlim(-0.2, len(conditions) - 0.8)
            panel.grid(axis="y")
            if i == len(rows) - 1:
                panel.set_xlabel(AXES[axis])
            if j == 0:
                panel.set_ylabel("share kept")
                panel.set_title(environment, loc="left")
        _legend(figure, axes.flat, 6)
        return figure


def _curve(
    panel: "Axes", results: Results, environment: str, name: str, conditions: list[Condition], shift: float, look: Look
) -> None:
    """Share kept over conditions, shifted a little so that intervals do not hide each other."""
    kept = [results.kept(Place(environment, c.name), results.classical, name) for c in conditions]
    each = [None if values is None else crossed_interval(values) for values in kept]
    there = [(i, value) for i, value in enumerate(each) if value is not None]
    if there:
        panel.errorbar(
            [i + shift for i, _ in there], [value.mean for _, value in there], yerr=_ends([v for _, v in there]),
            color=look.colour, linestyle=look.line, marker=look.mark, markersize=3.2, linewidth=0.9, elinewidth=0.5,
            label=name,
        )  # fmt: skip


def _value(condition: Condition, axis: str) -> Any:
    """Value of a condition on an axis: the longest latency, the name of a condition with faults."""
    if axis == "latency":
        return max(condition.latency.values(), default=0.0)
    if axis == "faults":
        return condition.name if condition.faults else ""
    return getattr(condition, axis)


def _level(condition: Condition, axis: str) -> str:
    value = _value(condition, axis)
    if axis in ("mismatch", "latency"):
        return f"{100 * value:g} %" if axis == "mismatch" else f"{value:g} s"
    return value or "none"


def cost_figure(results: Results) -> "Figure | None":
    """Score in the first condition over CPU time of a step, a panel an environment; None if no times are known."""
    look = looks(results)
    points: dict[str, dict[str, tuple[float, Interval]]] = {}
    for environment in results.environments:
        place = Place(environment, results.conditions[0])
        for name in results.estimators(environment, results.classical):
            times = results.step_times(environment, name)
            mean = results.mean(place, results.classical, name)
            if times and mean is not None:
                points.setdefault(environment, {})[name] = (times[0][1], mean)
    if not points:
        return None
    with styled():
        figure, axes = _panels(len(points), 0.3, 2.6)
        for panel, (environment, found) in zip(axes, points.items(), strict=True):
            for name, (x, y) in found.items():
                panel.errorbar(
                    x, y.mean, yerr=_ends([y]), color=look[name].colour, linestyle="none",
                    marker=look[name].mark if look[name].mark != "|" else "o", markersize=4, elinewidth=0.6,
                )  # fmt: skip
            panel.set_xscale("log")
            panel.set_title(environment, loc="left")
            panel.set_xlabel("CPU time of a step [µs]")
            panel.set_ylabel("score")
            panel.grid()
            _ticks(panel, [cost for cost, _ in found.values()])
        figure.draw_without_rendering()
        for panel, found in zip(axes, points.values(), strict=True):
            _labelled(panel, {name: (c, s.mean, look[name].colour) for name, (c, s) in found.items()})
        return figure


def _ticks(panel: "Axes", costs: Sequence[float]) -> None:
    """Round numbers on a logarithmic axis, which has few of its own in a range so short."""
    from matplotlib.ticker import NullFormatter, NullLocator

    low, high = min(costs) / 1.5, max(costs) * 1.9
    steps = [a * 10.0**b for b in range(-1, 6) for a in (1, 2, 5)]
    ticks = [step for step in steps if low <= step <= high]
    panel.set_xlim(low, high)
    panel.xaxis.set_minor_locator(NullLocator())
    panel.xaxis.set_minor_formatter(NullFormatter())
    panel.set_xticks(ticks, [f"{tick:g}" for tick in ticks])


def _labelled(panel: "Axes", points: Mapping[str, tuple[float, float, str]]) -> None:
    """Names beside points ``(x, y, colour)``, each at the nearest place where it covers no name and no point."""
    scale = panel.figure.dpi / 72.0
    at = {name: panel.transData.transform((x, y)) for name, (x, y, _) in points.items()}
    frame = panel.get_window_extent()
    taken = [_around(place, np.full(2, 3.0 * scale)) for place in at.values()]
    for name, place in sorted(at.items(), key=lambda item: -item[1][1]):
        text = panel.annotate(
            name, points[name][:2], textcoords="offset points", xytext=(0, 0), fontsize=8, color=points[name][2],
            va="center", ha="center",
        )  # fmt: skip
        size = text.get_window_extent()
        half = 0.5 * np.array([size.width, size.height]) + 0.5 * scale
        best, least = None, np.inf
        for distance, angle in product((0.0, 6.0, 13.0, 21.0, 30.0, 40.0, 52.0), np.arange(16) * np.pi / 8.0):
            away = np.array([np.cos(angle), np.sin(angle)])
            shift = away * (half + (4.5 + distance) * scale)
            box = _around(place + shift, half)
            out = sum(max(0.0, over) for over in (
                frame.x0 - box[0], frame.y0 - box[1], box[2] - frame.x1, box[3] - frame.y1
            ))  # fmt: skip
            cost = distance * scale + 1e3 * out + 1e2 * sum(_overlap(box, other) for other in taken)
            if cost < least:
                best, least = (shift, box, distance), cost
        assert best is not None
        shift, box, distance = best
        text.set_position(tuple(shift / scale))
        taken.append(box)
        if distance >= 6.0:
            panel.annotate(
                "", points[name][:2], textcoords="offset points", xytext=tuple(shift / scale),
                arrowprops={"arrowstyle": "-", "color": points[name][2], "linewidth": 0.4, "shrinkA": 6, "shrinkB": 2},
            )  # fmt: skip


def _around(centre: np.ndarray, half: np.ndarray) -> tuple[float, ...]:
    """A box: left, bottom, right, top."""
    return (*(centre - half), *(centre + half))


def _overlap(a: tuple[float, ...], b: tuple[float, ...]) -> float:
    """Area that two boxes share."""
    return max(0.0, min(a[2], b[2]) - max(a[0], b[0])) * max(0.0, min(a[3], b[3]) - max(a[1], b[1]))


# --- pieces -----------------------------------------------------------------------------------------


def _legend(figure: "Figure", panels: Any, columns: int) -> None:
    """One legend above all panels, each name once."""
    found: dict[str, Any] = {}
    for panel in panels:
        for handle, name in zip(*panel.get_legend_handles_labels(), strict=True):
            found.setdefault(name, handle)
    if found:
        figure.legend(found.values(), found.keys(), loc="outside upper center", ncols=columns, fontsize=8.5)


def columns_of(environments: Sequence[str], together: bool) -> tuple[list[str], list[Sequence[str]]]:
    """Headings, and the environments that each stands for: every one, and before them perhaps all together."""
    each: list[Sequence[str]] = [[e] for e in environments]
    return ([ALL, *environments], [environments, *each]) if together else (list(environments), each)


def unitless(heads: Iterable[str]) -> list[tuple[str, str]]:
    """The head of a table of these columns, which have no units."""
    return [(head, "") for head in heads]


def share_rows(rows: Iterable[Row]) -> list[tuple[str, list[Entry]]]:
    """The rows of a dot plot as those of a table."""
    return [(row.name, [share_entry(value) for value in row.values]) for row in rows]


def framed(figure: "Figure", title: str, caption: str) -> Picture:
    """A figure on a page."""
    return Picture(data_uri(figure), title, caption)
