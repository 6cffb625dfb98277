"""Section of a report: CPU time of a step."""

from typing import TYPE_CHECKING

from agents.page import Entry, Section
from agents.statistics import Interval
from agents.studies.figures import ends, framed, legend, looks, panels
from agents.studies.records import ORACLE
from agents.studies.results import Place, Results
from agents.studies.wording import microseconds, tabled

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def cost(results: Results) -> Section:
    """CPU time of a step."""
    figure = cost_figure(results)
    if figure is None:
        return Section("CPU time", [])
    timed = {
        e: {name: results.step_times(e, name) for name in results.estimators(e)}
        for e in results.environments
    }
    sections = {
        e: [(n, _times(t, n == ORACLE)) for n, t in times.items() if t]
        for e, times in timed.items()
    }
    batch = f"batch of {results.plan.study.episodes}"
    heads = [
        (batch, "µs"),
        ("beyond the truth", "µs"),
        ("one vehicle", "µs"),
        ("beyond the truth", "µs"),
    ]
    return Section(
        "CPU time",
        [framed(figure, "cost-figure", results), *tabled("cost", results, heads, sections)],
    )


def _times(times: list[tuple[int, float, float]], is_truth: bool) -> list[Entry]:
    """A row of the table of costs: in a batch, and one vehicle alone."""
    pairs = [(own, None if is_truth else own - truth) for _, own, truth in (times[0], times[-1])]
    return [Entry(microseconds(value)) for pair in pairs for value in pair]


def cost_figure(results: Results) -> "Figure | None":
    """Score in the first condition over CPU time of a step, a panel an environment; None if no times are known."""
    from matplotlib.ticker import LogLocator

    look, who, first = looks(results), results.classical, results.conditions[0]
    points: dict[str, dict[str, tuple[float, Interval]]] = {}
    for environment in results.environments:
        for name in results.estimators(environment, who):
            times, mean = (
                results.step_times(environment, name),
                results.mean(Place(environment, first), who, name),
            )
            if times and mean is not None:
                points.setdefault(environment, {})[name] = (times[0][1], mean)
    if not points:
        return None
    with panels(list(points), 0.5 + 0.19 * -(-len(look) // 6), 2.2) as (figure, axes):
        for panel, found in zip(axes, points.values(), strict=True):
            for name, (x, y) in found.items():
                mark = look[name].mark if look[name].mark != "|" else "o"
                panel.errorbar(
                    x, y.mean, yerr=ends([y]), color=look[name].colour, linestyle="none", marker=mark, markersize=4,
                    elinewidth=0.6, label=name,
                )  # fmt: skip
            panel.set_xscale("log")
            panel.set_xlim(
                min(x for x, _ in found.values()) / 1.5, max(x for x, _ in found.values()) * 1.5
            )
            panel.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            panel.xaxis.set_major_formatter("{x:g}")
            panel.minorticks_off()
            panel.set_xlabel("CPU time of a step [µs]")
            panel.set_ylabel("score")
        legend(figure, axes, 6)
    return figure
