"""The page on Segorogeni's dive: the tables and the figure of the EnKF paper beside ours."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from agents.page import Bullets, Claim, Claims, Entry, Facts, Figure, Page, Section, Table, entry, listed, number, words
from agents.plotting import BELIEVED, INK, PUBLISHED, TRUE, data_uri, styled
from agents.reproduction.comparison import Comparison, tally
from agents.reproduction.pages.comparison import comparison_table
from agents.reproduction.pages.ensembles import (
    Errors,
    change,
    comparisons,
    growth_table,
    members_figure,
    printed_slopes,
    slope,
    slopes,
    time_comparisons,
    time_table,
    verdict,
)
from agents.reproduction.segorogeni import extended_name, own_name, printed_name
from agents.reproduction.settings import segorogeni as paper
from agents.statistics import Interval, mean_interval, paired_difference

Results = Mapping[str, Mapping[str, Any]]


def page(results: Results) -> Page:
    """The page, from the values of every cell of `cells`."""
    printed = {
        members: np.concatenate([results[printed_name(members, seed)]["rmse"] for seed in paper.SEEDS])
        for members in paper.MEMBERS
    }
    own = {members: np.asarray(results[own_name(members)]["rmse"]) for members in paper.MEMBERS}
    seconds = np.asarray(results["time"]["seconds"])
    labels = {_PRINTED_LABEL: printed, _OWN_LABEL: own}
    most, fewest = max(paper.MEMBERS), min(paper.MEMBERS)

    final = np.concatenate([results[printed_name(most, seed)]["final"] for seed in paper.SEEDS])
    times = time_comparisons(paper.PUBLISHED, "time", seconds)
    rows = comparisons(paper.PUBLISHED, printed, {})
    rows += [
        Comparison("end of the dive", name, published, mean_interval(final[:, i]), above=_end_reason(name, final[:, i]))
        for i, (name, published) in enumerate(paper.FINAL.items())
    ]
    trends = slopes(own)
    extended, doubled = np.asarray(results["extended"]["rmse"]), np.asarray(results["doubled"]["rmse"])
    extended_printed = np.concatenate([results[extended_name(seed)]["rmse"] for seed in paper.SEEDS])
    excess = 100.0 * (own[fewest].mean(0) / extended.mean(0) - 1.0)
    doubling = doubled.mean(0) / own[most].mean(0)
    factors = [paper.PUBLISHED[most][name].value / own[most][:, i].mean() for i, name in enumerate(paper.QUANTITIES)]
    spread = [100.0 * own[most][:, i].std(ddof=1) / own[most][:, i].mean() for i in range(len(paper.QUANTITIES))]
    fall = 100.0 * (1.0 - paper.PUBLISHED[most]["x"].value / paper.PUBLISHED[fewest]["x"].value)

    answer = [
        f"{tally([*rows, *times])}.",
        f"From {fewest} to {most} members our error changes by {change(trends[-1], fewest, most)}, the printed one in "
        f"x by {number(-fall, 1, True)} %; {fewest} members have {_percents(excess)} more error in x, y, z and angle "
        "than a filter that needs none, ekf.",
        "That ours is lower proves little, because the paper prints no noise: with twice ours our errors are "
        f"{min(doubling):.2f} to {max(doubling):.2f} times as large, and {min(factors):.0f} to {max(factors):.0f} "
        "times ours would give the paper's.",
    ]
    return Page(
        "Segorogeni: an EnKF in three dimensions",
        f"Table III and Figure 2 of the paper, with {len(paper.SEEDS) * paper.RUNS} dives at its step of {paper.DT} s "
        f"and {paper.OWN_RUNS} at ours of {paper.OWN_DT} s",
        answer,
        [
            Section(
                "Published and ours",
                [
                    comparison_table(
                        "Published (Table III and section III.D) and ours",
                        f"Forward Euler at {paper.DT} s, mean and 95 % interval over {len(printed[most])} dives "
                        f"(published: {paper.AVERAGED}); the end with {most} members.",
                        rows,
                        "published",
                    ),
                    time_table(paper.DURATION, times),
                    Figure(
                        _path_figure(results[printed_name(most, paper.SEEDS[0])]),
                        "A dive, true and estimated, as the paper's Figure 2",
                        f"{most} members, step {paper.DT} s. Right: estimate less truth; dashed, in red: the published "
                        "RMSE of Table III on both sides of zero; cross: the published distance at the end.",
                    ),
                ],
            ),
            Section(
                "What members are worth",
                [
                    _own_table(own, extended, doubled, extended_printed),
                    growth_table(
                        "Exponents of error over the number of members",
                        "a in error ~ N^a, fitted to every run by itself, in which all sizes see the same truth and "
                        "readings; mean and 95 % interval over the runs, bold where it excludes zero. All: geometric "
                        "mean of the four errors.",
                        paper.PUBLISHED, labels,
                    ),
                    Figure(
                        members_figure(paper.PUBLISHED, paper.QUANTITIES, labels, {_PRINTED_LABEL: seconds}),
                        "Errors and computing time over the number of members",
                        "Means and 95 % intervals.",
                    ),
                    Claims(_claims(own, trends, seconds, spread, mean_interval(np.linalg.norm(final, axis=-1)))),
                ],
            ),
            Section("Assumptions", [Facts("What the paper does not print", paper.ASSUMPTIONS)]),
            Section("Misprints and what does not fit", [Bullets([*paper.MISPRINTS, _inertia_note()])]),
        ],
    )  # fmt: skip


_PRINTED_LABEL, _OWN_LABEL = f"ours, step {paper.DT} s", f"ours, step {paper.OWN_DT} s"


def _percents(values: np.ndarray) -> str:
    return listed([number(value, 1) for value in values]) + " %"


def _end_reason(name: str, distances: np.ndarray) -> str:
    """Why our distance at the end may be above the one that the paper reads off one figure."""
    most = max(paper.MEMBERS)
    ratio = paper.PUBLISHED[most][name].value / paper.FINAL[name].value
    share = 100.0 * np.mean(distances <= paper.FINAL[name].value)
    return f"the paper's is one dive's, {ratio:.0f} times below its own RMSE; {share:.0f} % of our dives end as close"


def _own_table(own: Errors, extended: np.ndarray, doubled: np.ndarray, extended_printed: np.ndarray) -> Table:
    """The errors at our step, with the filter without members, also at the paper's step, and with twice the noise."""
    decimals = (4, 4, 4, 5)

    def line(errors: np.ndarray) -> list[Entry]:
        return [entry(mean_interval(errors[:, i]), places) for i, places in enumerate(decimals)]

    rows = [(f"{members} members", line(errors)) for members, errors in own.items()]
    rows.append(("none: ekf", line(extended)))
    rows.append((f"{max(own)} members, all noise doubled", line(doubled)))
    sections = [
        (f"Runge-Kutta at {paper.OWN_DT} s, {paper.OWN_RUNS} dives", rows),
        (f"forward Euler at {paper.DT} s, {len(extended_printed)} dives", [("none: ekf", line(extended_printed))]),
    ]
    return Table(
        "RMSE at our own step",
        "The rows above see the same dives; the doubled noise is the same numbers times two. At the paper's step a "
        "filter without members is cheap enough for more dives, and shows how much of the difference between the first "
        "table and this one is the step, and how much the few dives.",
        "", list(paper.QUANTITIES.items()), sections, "own",
    )  # fmt: skip


def _claims(
    own: Errors, trends: list[Interval | None], seconds: np.ndarray, spread: list[float], off: Interval | None
) -> list[Claim]:
    """What the paper says of ensembles, and what our runs say of that."""
    time_trend, theirs = slope(paper.MEMBERS, seconds), printed_slopes(paper.PUBLISHED)
    fewest, most = min(paper.MEMBERS), max(paper.MEMBERS)
    best = [_better(own, name, size) for name, size in paper.BEST.items()]
    decided = [interval for interval in best if interval is not None and interval.excludes_zero]
    winner = "undecided, no detectable difference"
    if decided:
        winner = "true" if len(decided) == len(best) and all(i.mean < 0.0 for i in decided) else "false"
    each, fixed = np.polyfit(paper.MEMBERS, seconds.mean(0) / round(paper.DURATION / paper.DT), 1)
    angles = [row["angle"].printed for row in paper.PUBLISHED.values()]
    return [
        Claim(
            "More members reduce the error.",
            verdict(trends[-1], -1),
            f"From {fewest} to {most}, over {paper.OWN_RUNS} paired dives: {change(trends[-1], fewest, most)} in all; "
            + "; ".join(
                f"{name} {change(trend, fewest, most)}"
                for name, trend in zip(paper.QUANTITIES, trends[:-1], strict=True)
            )
            + ". An ensemble filter that works loses a share of order 1/N to sampling and no more.",
        ),
        Claim(
            "300 members are best for x and y, 200 for z.",
            winner,
            "Best less the other of 200 and 300, paired: "
            + listed([f"{name} {words(i, 5, True)} m" for name, i in zip(paper.BEST, best, strict=True)])
            + f". One dive's error differs from the mean by {min(spread):.0f} to {max(spread):.0f} % here (standard "
            f"deviation), the mean of {paper.AVERAGED} by {min(spread) / paper.AVERAGED**0.5:.0f} to "
            f"{max(spread) / paper.AVERAGED**0.5:.0f} %: the printed differences, below 2 %, cannot be told from "
            "chance unless the runs were paired.",
        ),
        Claim(
            "More members cost more time.",
            verdict(time_trend, 1),
            f"Exponent {words(time_trend, 3)} (published {number(theirs['time'], 3)}). A step of one run takes us "
            f"{1e6 * fixed:.0f} µs whatever the ensemble, and {1e9 * each:.0f} ns a member.",
        ),
        Claim(
            f"The error of the angle is {angles[0]} rad whatever the number of members.",
            "undecided, the paper does not say what it is relative to",
            f"Four means of {paper.AVERAGED} runs agree to four digits ({', '.join(angles)}). Ours, "
            f"{words(mean_interval(own[most][:, 3]), 5)} rad against the true vehicle, changes by "
            f"{abs(100.0 * (own[fewest][:, 3].mean() / own[most][:, 3].mean() - 1.0)):.1f} % from {fewest} to {most} "
            "members even in the same dives. An error that neither noise nor members move is a fixed difference, of "
            "the planned path from what the filter was told, say.",
        ),
        Claim(
            "The estimate nearly meets the path at the end of the dive.",
            "true, of ours" if off is not None and off.high < paper.VEHICLE.body.length else "undecided",
            f"{words(off, 3)} m between the true and the estimated end, with {most} members at the paper's step; the "
            f"vehicle is {paper.VEHICLE.body.length} m long.",
        ),
    ]


def _better(own: Errors, name: str, best: int) -> Interval | None:
    """Error with the members called best less that with the other of the two largest ensembles, paired."""
    i = list(paper.QUANTITIES).index(name)
    other = next(size for size in paper.MEMBERS[-2:] if size != best)
    return paired_difference(own[best][:, i], own[other][:, i])


def _inertia_note() -> str:
    """What the printed inverse inertia is worth."""
    values = np.linalg.eigvals(np.linalg.inv(paper.INVERSE_INERTIA)).real
    return (
        f"The matrix printed after eq. (19), inverted, has {np.sum(values < 0.0)} negative eigenvalues of {len(values)}"
        ": it is no inertia, and the equations with it have no bounded energy. We do not use it."
    )


def _path_figure(found: Mapping[str, Any]) -> str:
    """The path in three dimensions, and the errors over time, as a data URI."""
    from matplotlib.figure import Figure as Canvas

    time, truth, estimate_ = (np.asarray(found[key]) for key in ("time", "truth", "estimate"))
    most = max(paper.MEMBERS)
    with styled():
        figure = Canvas(figsize=(7.2, 4.2))
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
                bound = side.axhline(sign * paper.PUBLISHED[most][name].value, color=PUBLISHED, lw=0.8, ls="--")
            if name in paper.FINAL:
                end = paper.FINAL[name].value
                (cross,) = side.plot(time[-1], end, color=PUBLISHED, marker="x", ls="", clip_on=False)
            side.set_ylabel(f"{name} [{unit}]")
            side.set_xlim(0.0, time[-1])
            if i + 1 < len(paper.QUANTITIES):
                side.set_xticklabels([])
        side.set_xlabel("time [s]")
        figure.align_ylabels(figure.axes[1:])
        figure.legend(
            [bound, cross], ["published RMSE", "and at the end"], loc="upper right", ncol=2, borderpad=0.0,
            columnspacing=1.0, handletextpad=0.4,
        )  # fmt: skip
        return data_uri(figure)
