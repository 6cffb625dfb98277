"""What the papers on ensemble filters share: a vehicle that a filter watches, and how results change with N.

A filter estimates some components of the vehicle's state; the position follows by integrating the kinematics over what
it estimates, as the papers do.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from agents.page import Entry, Table, entry, number
from agents.plotting import BELIEVED, PUBLISHED, TRUE, data_uri, styled
from agents.reproduction.comparison import Comparison, Published, comparison_table
from agents.statistics import Interval, mean_interval
from estimators import Filter, Gaussian, NonlinearModel
from vessel_gym.sensors import Instrument

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Advance = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""States ``(..., n)`` one step later under a control ``(..., m)``."""


class Flights(NamedTuple):
    """Runs of a vehicle.

    Attributes:
        truth: ``(T + 1, B, n)``.
        readings: ``(T, B, p)``, after each step.
    """

    truth: np.ndarray
    readings: np.ndarray


@dataclass(frozen=True, eq=False)
class Experiment:
    """A vehicle under a recorded control, kicked at every step, and what a filter is told of it.

    Attributes:
        advance: The vehicle's equations over a step.
        start: State ``(n,)`` at the beginning.
        controls: ``(T, m)``.
        estimated: The components of the state that a filter estimates, k of them; they suffice for their own equations.
        measured: Which of those are measured, p of them.
        kick_sd: ``(k,)`` process noise of a step.
        reading_sd: ``(p,)``.
        prior_sd: ``(k,)`` of the first belief about the start.
    """

    advance: Advance
    start: np.ndarray
    controls: np.ndarray
    estimated: list[int]
    measured: list[int]
    kick_sd: np.ndarray
    reading_sd: np.ndarray
    prior_sd: np.ndarray

    @cached_property
    def model(self) -> NonlinearModel:
        """The filter's model: the same equations, noise and readings."""

        def transition(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
            assert u is not None
            return self.advance(self.state(x), u)[..., self.estimated]

        def measurement(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
            return x[..., self.measured]

        return NonlinearModel(transition, measurement, np.diag(self.kick_sd**2), np.diag(self.reading_sd**2))

    def state(self, estimates: np.ndarray) -> np.ndarray:
        """Vehicle states ``(..., n)`` from estimates ``(..., k)``, the other components 0."""
        state = np.zeros(estimates.shape[:-1] + self.start.shape)
        state[..., self.estimated] = estimates
        return state

    def fly(self, runs: int, rng: np.random.Generator) -> Flights:
        """Runs of the vehicle and their readings: the same for every filter, so that filters are compared in pairs."""
        steps = len(self.controls)
        truth = np.empty((steps + 1, runs, len(self.start)))
        truth[0] = self.start
        kicks = self.kick_sd * rng.standard_normal((steps, runs, len(self.kick_sd)))
        for k, control in enumerate(self.controls):
            truth[k + 1] = self.advance(truth[k], control)
            truth[k + 1][:, self.estimated] += kicks[k]
        exact = truth[1:][..., self.estimated][..., self.measured]
        return Flights(truth, exact + self.reading_sd * rng.standard_normal(exact.shape))

    def estimates(self, estimator: Filter, readings: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """What a filter believes after each reading, ``(T + 1, B, k)``; the first is where it begins."""
        runs = readings.shape[1]
        mean = np.tile(self.start[self.estimated], (runs, 1))
        belief = estimator.init(Gaussian(mean, np.diag(self.prior_sd**2)), rng)
        believed = [belief.mean]
        for control, reading in zip(self.controls, readings, strict=False):
            belief = estimator.update(estimator.predict(belief, control, rng), reading, rng)
            believed.append(belief.mean)
        return np.stack(believed)


def channel_sd(instruments: tuple[Instrument, ...], channels: Sequence[str]) -> np.ndarray:
    """Nominal standard deviations of some channels of a vehicle's instruments ``(p,)``."""
    sd = {channel: sd for i in instruments for channel, sd in zip(i.channels, i.sd, strict=True)}
    return np.array([sd[channel] for channel in channels])


def rms(errors: np.ndarray) -> np.ndarray:
    """Root mean square over the steps: ``(T, B, k)`` to ``(B, k)``."""
    return np.sqrt(np.mean(errors**2, 0))


def thinned(history: np.ndarray, points: int = 400) -> np.ndarray:
    """At most so many rows of a history ``(T, ...)``, evenly spaced, the first and the last among them."""
    return history[np.linspace(0, len(history) - 1, min(points, len(history))).round().astype(int)]


def seconds_a_step(
    experiment: Experiment, make: Callable[[int], Filter], members: Sequence[int], steps: int, repeats: int, seed: int
) -> np.ndarray:
    """Measured time of a step of one run ``(repeats, len(members))`` [s]; sizes take turns, so that load hits all.

    Args:
        experiment: What is estimated.
        make: A filter with so many members.
        members: Sizes.
        steps: How many steps are timed together.
        repeats: How often.
        seed: Of the run and of the filter.
    """
    rng = np.random.default_rng(seed)
    readings = experiment.fly(1, rng).readings[:steps]
    filters = [make(size) for size in members]
    seconds = np.empty((repeats, len(members)))
    for estimator in filters:  # load and compile
        experiment.estimates(estimator, readings[:2], rng)
    for row in seconds:
        for i, estimator in enumerate(filters):
            begin = time.perf_counter()
            experiment.estimates(estimator, readings, rng)
            row[i] = (time.perf_counter() - begin) / len(readings)
    return seconds


# --- how results change with the number of members ----------------------------------------------------

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
    """Whether values rise (``sign`` 1) or fall (-1) with N beyond doubt."""
    if trend is None or not trend.excludes_zero:
        return "undecided, no detectable difference"
    return "true" if trend.mean * sign > 0.0 else "false"


def change(trend: Interval | None, first: int, last: int) -> str:
    """What an exponent makes of a value between two sizes, in words: "−1.2 % (−2.0 to −0.4 %)"."""
    if trend is None:
        return "–"
    mean, low, high = (100.0 * ((last / first) ** a - 1.0) for a in (trend.mean, trend.low, trend.high))
    return f"{number(mean, 1, True)} % ({number(low, 1, True)} to {number(high, 1, True)} %)"


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


def time_table(duration: float, rows: Sequence[Comparison]) -> Table:
    """Computing times, published and ours: the one table that is never the same twice."""
    return comparison_table(
        "Computing time, published and ours",
        f"One dive of {duration:.0f} s, one run at a time. Measured: these times alone differ from run to run.",
        list(rows),
        "time",
    )


def growth_table(title: str, note: str, printed: Printed, ours: Mapping[str, Errors]) -> Table:
    """Exponents of error over the number of members, published and ours."""
    theirs = printed_slopes(printed)
    *quantities, _ = theirs
    head = [(name, "") for name in (*quantities, "all")]
    rows = [("published", [*(Entry(number(theirs[name], 3, True)) for name in quantities), Entry("–")])]
    rows += [(label, [entry(each, 3, True) for each in slopes(errors)]) for label, errors in ours.items()]
    return Table(title, note, "exponent of", head, [("", rows)], "exponents")


def members_figure(
    printed: Printed, units: Mapping[str, str], ours: Mapping[str, Errors], seconds: Mapping[str, np.ndarray]
) -> str:
    """Error and computing time over the number of members, published and ours, both axes logarithmic, as a data URI."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

    members = list(printed)
    with styled():
        figure = Figure(figsize=(7.2, 4.4), layout="constrained")
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
        return data_uri(figure)


def _points(
    axes: "Axes", members: Sequence[int], values: Sequence[np.ndarray], color: str, marker: str, label: str
) -> None:
    means = [float(np.mean(each)) for each in values]
    halves = [0.0 if (interval := mean_interval(each)) is None else interval.half for each in values]
    axes.errorbar(members, means, halves, color=color, marker=marker, ms=4, capsize=2, label=label)
