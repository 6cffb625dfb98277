"""The page on Segorogeni's dive: the tables and the figure of the EnKF paper beside ours."""

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from agents.page import Page, Table, number, words
from agents.plotting import BELIEVED, INK, PUBLISHED, TRUE, drawing
from agents.reproduction.comparison import Comparison, tally
from agents.reproduction.pages import ensembles
from agents.reproduction.pages.comparison import comparison_table
from agents.reproduction.pages.template import fill
from agents.reproduction.segorogeni import extended_name, own_name, printed_name
from agents.reproduction.settings import segorogeni as paper
from agents.statistics import Interval, mean_interval, paired_difference

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

_PRINTED, _OWN = f"ours, step {paper.DT} s", f"ours, step {paper.OWN_DT} s"
Errors = ensembles.Errors
_FEWEST, _MOST = min(paper.MEMBERS), max(paper.MEMBERS)


def page(results: Mapping[str, Mapping[str, Any]]) -> Page:
    """The page, from the values of every cell of `cells`."""
    printed, final = (
        {m: np.concatenate([results[printed_name(m, seed)][key] for seed in paper.SEEDS]) for m in paper.MEMBERS}
        for key in ("rmse", "final")
    )
    own = {members: np.asarray(results[own_name(members)]["rmse"]) for members in paper.MEMBERS}
    seconds, extended, doubled = (
        np.asarray(results[name][key]) for name, key in (("time", "seconds"), ("extended", "rmse"), ("doubled", "rmse"))
    )
    extended_printed = np.concatenate([results[extended_name(seed)]["rmse"] for seed in paper.SEEDS])
    times = ensembles.time_comparisons(paper.PUBLISHED, "time", seconds)
    rows = ensembles.comparisons(paper.PUBLISHED, printed, {})
    for distances, (name, published) in zip(final[_MOST].T, paper.FINAL.items(), strict=True):
        ours, why = mean_interval(distances), _end_reason(name, distances)
        rows.append(Comparison("end of the dive", name, published, ours, above=why))
    labels = {_PRINTED: printed, _OWN: own}
    tables = {
        "published": comparison_table("", "", rows, "published"),
        "time": comparison_table("", "", times, "time"),
        "own": _own_table(own, extended, doubled, extended_printed),
        "exponents": ensembles.growth_table("", "", paper.PUBLISHED, labels),
    }
    figures = {
        "path": _path_figure(results[printed_name(_MOST, paper.SEEDS[0])]),
        "members": ensembles.members_figure(paper.PUBLISHED, paper.QUANTITIES, labels, {_PRINTED: seconds}),
    }
    *each, trend = ensembles.slopes(own)
    angle, x = ([row[name] for row in paper.PUBLISHED.values()] for name in ("angle", "x"))
    off = mean_interval(np.linalg.norm(final[_MOST], axis=-1))
    best = {name: _better(own, name, size) for name, size in paper.BEST.items()}
    per_member, fixed = np.polyfit(paper.MEMBERS, seconds.mean(0) / round(paper.DURATION / paper.DT), 1)
    mean = own[_MOST].mean(0)
    return fill(
        "segorogeni", tables, figures, paper=paper, fewest=_FEWEST, most=_MOST, sampling="", tally=tally(rows + times),
        dives=len(printed[_MOST]), trend=trend, printed_change=100.0 * (x[-1].value / x[0].value - 1.0),
        excess=[number(100.0 * share, 1) for share in own[_FEWEST].mean(0) / extended.mean(0) - 1.0],
        doubling=doubled.mean(0) / mean,
        factors=[paper.PUBLISHED[_MOST][name].value / ours for name, ours in zip(paper.QUANTITIES, mean, strict=True)],
        changes=ensembles.changes(paper.QUANTITIES, each, _FEWEST, _MOST), winner=_winner(list(best.values())),
        best=[f"{name} {words(i, 5, True)} m" for name, i in best.items()],
        spread=list(100.0 * own[_MOST].std(0, ddof=1) / mean), time_trend=ensembles.slope(paper.MEMBERS, seconds),
        printed_time_trend=ensembles.printed_slopes(paper.PUBLISHED)["time"], fixed=1e6 * fixed, each=1e9 * per_member,
        angles=[published.printed for published in angle], angle=mean_interval(own[_MOST][:, 3]),
        angle_change=abs(100.0 * (own[_FEWEST][:, 3].mean() / mean[3] - 1.0)), off=off,
        meets="true, of ours" if off is not None and off.high < paper.VEHICLE.body.length else "undecided",
        negative=np.sum(np.linalg.eigvals(np.linalg.inv(paper.INVERSE_INERTIA)).real < 0.0),
    )  # fmt: skip


def _end_reason(name: str, distances: np.ndarray) -> str:
    """Why our distance at the end may be above the one that the paper reads off one figure."""
    ratio = paper.PUBLISHED[_MOST][name].value / paper.FINAL[name].value
    share = 100.0 * np.mean(distances <= paper.FINAL[name].value)
    return f"the paper's is one dive's, {ratio:.0f} times below its own RMSE; {share:.0f} % of our dives end as close"


def _own_table(own: Errors, extended: np.ndarray, doubled: np.ndarray, extended_printed: np.ndarray) -> Table:
    """The errors at our step, with the filter without members, also at the paper's step, and with twice the noise."""
    line = partial(ensembles.means, decimals=(4, 4, 4, 5))
    rows = [(f"{members} members", line(errors)) for members, errors in own.items()]
    rows += [("none: ekf", line(extended)), (f"{_MOST} members, all noise doubled", line(doubled))]
    sections = [
        (f"Runge-Kutta at {paper.OWN_DT} s, {paper.OWN_RUNS} dives", rows),
        (f"forward Euler at {paper.DT} s, {len(extended_printed)} dives", [("none: ekf", line(extended_printed))]),
    ]
    return Table("", "", "", list(paper.QUANTITIES.items()), sections, "own")


def _better(own: Errors, name: str, best: int) -> Interval | None:
    """Error with the members called best less that with the other of the two largest ensembles, paired."""
    i = list(paper.QUANTITIES).index(name)
    other = next(size for size in paper.MEMBERS[-2:] if size != best)
    return paired_difference(own[best][:, i], own[other][:, i])


def _winner(best: list[Interval | None]) -> str:
    """The verdict on the sizes called best, from their errors less those of the others."""
    decided = [interval for interval in best if interval is not None and interval.excludes_zero]
    if not decided:
        return "undecided, no detectable difference"
    return "true" if len(decided) == len(best) and all(i.mean < 0.0 for i in decided) else "false"


@drawing(7.2, 4.2)
def _path_figure(figure: "Canvas", found: Mapping[str, Any]) -> None:
    """The path in three dimensions, and the errors over time."""
    figure.set_layout_engine("none")
    time, truth, estimate_ = (np.asarray(found[key]) for key in ("time", "truth", "estimate"))
    axes: Any = figure.add_axes((0.02, 0.0, 0.55, 0.95), projection="3d")
    axes.plot(*truth[:, :3].T, color=TRUE, lw=2.2, label="true path")
    axes.plot(*estimate_[:, :3].T, color=BELIEVED, lw=1.2, ls="--", label="estimate")
    axes.scatter(*paper.GOAL, color=INK, marker="+", s=50, label="planned end")
    axes.set(xlabel="x, north [m]", ylabel="y, east [m]", zlabel="z, down [m]")
    axes.set(xticks=range(0, 13, 4), yticks=range(0, 19, 6), zticks=range(0, 7, 2))
    axes.set_box_aspect((12.0, 18.0, 9.0), zoom=0.87)
    axes.invert_zaxis()
    axes.view_init(elev=28.0, azim=-28.0)
    axes.legend(loc="upper left")
    for i, (name, unit) in enumerate(paper.QUANTITIES.items()):
        side = figure.add_axes((0.70, 0.74 - 0.21 * i, 0.28, 0.17))
        side.plot(time, (estimate_ - truth)[:, i], color=BELIEVED)
        for sign in (-1.0, 1.0):
            bound = side.axhline(sign * paper.PUBLISHED[_MOST][name].value, color=PUBLISHED, lw=0.8, ls="--")
        if name in paper.FINAL:
            end = paper.FINAL[name].value
            (cross,) = side.plot(time[-1], end, color=PUBLISHED, marker="x", ls="", clip_on=False)
        side.set(ylabel=f"{name} [{unit}]", xlim=(0.0, time[-1]))
        if i + 1 < len(paper.QUANTITIES):
            side.set_xticklabels([])
    side.set_xlabel("time [s]")
    figure.align_ylabels(figure.axes[1:])
    figure.legend(
        [bound, cross], ["published RMSE", "and at the end"], loc="upper right", ncol=2, borderpad=0.0,
        columnspacing=1.0, handletextpad=0.4,
    )  # fmt: skip
