"""Section of a report: shares kept over each axis along which the conditions vary."""

from itertools import product
from typing import TYPE_CHECKING, Any

from agents.page import Prose, Section, listed
from agents.statistics import crossed_interval
from agents.studies.figures import Look, ends, framed, grid, legend, looks
from agents.studies.records import Condition
from agents.studies.results import Place, Results
from agents.studies.shares import ENDS, ruled
from vessel_gym.sensors import SUITE_NAMES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

AXES = {
    "disturbance": "disturbance", "sensors": "sensor suite", "mismatch": "mismatch of the model", "latency": "latency",
    "faults": "faults of sensors",
}  # fmt: skip
"""Axes along which conditions differ, with their labels."""
_ORDER = {"disturbance": ("calm", "moderate", "rough"), "sensors": SUITE_NAMES}


def robustness(results: Results) -> Section:
    """Shares kept over each axis that the conditions vary."""
    drawn = varied(results)
    if not ruled(results):
        return Section("Robustness", [])
    lacking = [label for axis, label in AXES.items() if axis not in drawn]
    missing = [Prose(f"The study varies no {listed(lacking)} on its own.")] if lacking else []
    if not drawn:
        return Section("Robustness", [*missing])
    return Section(
        "Robustness", [framed(robustness_figure(results, drawn), "robustness", results), *missing]
    )


def varied(results: Results) -> dict[str, list[Condition]]:
    """Conditions `along` each axis that is varied alone."""
    return {axis: conditions for axis in AXES if len(conditions := along(results, axis)) > 1}


def along(results: Results, axis: str) -> list[Condition]:
    """The conditions that differ from the first in one axis alone, the first among them, in the axis' order."""
    first, *others = results.plan.study.conditions
    found: dict[Any, Condition] = {_value(first, axis): first}
    for other in others:
        if {name for name in AXES if getattr(other, name) != getattr(first, name)} == {axis}:
            found.setdefault(_value(other, axis), other)
    order = _ORDER.get(axis)
    return [
        found[value]
        for value in sorted(found, key=order.index if order and set(found) <= set(order) else None)
    ]


def robustness_figure(results: Results, drawn: dict[str, list[Condition]]) -> "Figure":
    """Share kept by the classical agent over each axis of the conditions, a row an environment.

    The ends of the scale are left out: they are 0 and 1 in every condition.
    """
    look = {name: each for name, each in looks(results).items() if name not in ENDS}
    rows = results.environments
    height = 0.5 + 0.19 * -(-len(look) // 6) + 1.62 * len(rows)
    with grid(height, len(rows), len(drawn), sharey="row") as (figure, axes):
        for (i, environment), (j, (axis, conditions)) in product(
            enumerate(rows), enumerate(drawn.items())
        ):
            panel = axes[i, j]
            names = [
                name for name in results.estimators(environment, results.classical) if name in look
            ]
            for k, name in enumerate(names):
                shift = 0.16 * (k / max(len(names) - 1, 1) - 0.5)
                _curve(panel, results, environment, name, conditions, shift, look[name])
            panel.set_xticks(range(len(conditions)), [_level(c, axis) for c in conditions])
            panel.set_xlim(-0.2, len(conditions) - 0.8)
            panel.grid(axis="y")
            if i == len(rows) - 1:
                panel.set_xlabel(AXES[axis])
            if j == 0:
                panel.set_ylabel("share kept")
                panel.set_title(environment, loc="left")
        legend(figure, axes.flat, 6)
    return figure


def _curve(
    panel: "Axes",
    results: Results,
    environment: str,
    name: str,
    conditions: list[Condition],
    shift: float,
    look: Look,
) -> None:
    """Share kept over conditions, shifted a little so that intervals do not hide each other."""
    kept = [results.kept(Place(environment, c.name), results.classical, name) for c in conditions]
    each = [None if values is None else crossed_interval(values) for values in kept]
    there = {i + shift: value for i, value in enumerate(each) if value is not None}
    if there:
        panel.errorbar(
            list(there), [value.mean for value in there.values()], yerr=ends(list(there.values())),
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
