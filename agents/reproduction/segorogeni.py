"""Segorogeni's dive in three dimensions with ensembles of 50 to 300 members, after the EnKF paper."""

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
from scipy.optimize import root

from agents.cells import Cell
from agents.page import Bullets, Claim, Claims, Entry, Facts, Figure, Page, Section, Table, entry, listed, number, words
from agents.plotting import BELIEVED, INK, PUBLISHED, TRUE, data_uri, styled
from agents.reproduction.comparison import Comparison, comparison_table, tally
from agents.reproduction.ensembles import (
    Errors,
    Experiment,
    change,
    comparisons,
    growth_table,
    members_figure,
    printed_slopes,
    rms,
    seconds_a_step,
    slope,
    slopes,
    thinned,
    time_comparisons,
    time_table,
    verdict,
)
from agents.reproduction.settings import segorogeni as paper
from agents.statistics import Interval, mean_interval, paired_difference
from estimators import Filter, make
from vessel_gym.vehicles.segorogeni import TRUTH, segorogeni_derivative

Results = Mapping[str, Mapping[str, Any]]

_ESTIMATED = [TRUTH.index(name) for name in ("u", "v", "w", "p", "q", "r")]
_MEASURED = [TRUTH.index(name) for name in ("u", "v", "w", "r")]
_PLACE = [TRUTH.index(name) for name in ("x", "y", "z", "psi")]
_YAW = TRUTH.index("psi")
_COEFFICIENTS = paper.VEHICLE.body.vector()


def cells() -> dict[str, Cell]:
    """Everything to compute, by name."""
    found = {}
    for members in paper.MEMBERS:
        for seed in paper.SEEDS:
            found[_printed(members, seed)] = _cell("printed", members, paper.RUNS, seed)
        found[_own(members)] = _cell("own", members, paper.OWN_RUNS, 0)
    most = max(paper.MEMBERS)
    for seed in paper.SEEDS:
        found[_extended(seed)] = _cell("printed", 0, paper.EXTENDED_RUNS, seed, estimator="ekf")
    found["extended"] = _cell("own", 0, paper.OWN_RUNS, 0, estimator="ekf")
    found["doubled"] = _cell("own", most, paper.OWN_RUNS, 0, noise=paper.DOUBLED)
    timed = {"steps": 100, "repeats": 50, "seed": 0}
    found["time"] = Cell(f"{__name__}:computing_time", timed, "segorogeni, computing time")
    return found


def _cell(scheme: str, members: int, runs: int, seed: int, **options: Any) -> Cell:
    arguments = {"scheme": scheme, "members": members, "runs": runs, "seed": seed} | options
    return Cell(f"{__name__}:estimate", arguments, f"segorogeni, {scheme} step, {members} members")


def _printed(members: int, seed: int) -> str:
    return f"printed step, {members} members, seed {seed}"


def _own(members: int) -> str:
    return f"own step, {members} members"


def _extended(seed: int) -> str:
    return f"printed step, ekf, seed {seed}"


# --- the experiment ---------------------------------------------------------------------------------


def estimate(
    scheme: str, members: int, runs: int, seed: int, estimator: str = "enkf", noise: float = 1.0
) -> dict[str, np.ndarray]:
    """Errors of the position in some runs of the dive; truth and readings depend on the seed alone.

    Args:
        scheme: "printed" (forward Euler at the paper's step) or "own" (Runge-Kutta at the vehicle's).
        members: N; what a filter without members does not need.
        runs: Dives.
        seed: Of truth, readings and filter.
        estimator: "enkf", or "ekf" for the filter that has no members.
        noise: Factor on all standard deviations.

    Returns:
        ``rmse (runs, 4)`` of x, y, z [m] and yaw [rad], ``final (runs, 3)`` distances at the end [m], and of the first
        run ``time [s]``, ``truth`` and ``estimate (k, 4)``.
    """
    experiment = dive(scheme, noise)
    flights = experiment.fly(runs, np.random.default_rng([seed, 0]))
    filter_ = make(estimator, experiment.model, **({"members": members} if estimator == "enkf" else {}))
    believed = experiment.estimates(filter_, flights.readings, np.random.default_rng([seed, members]))
    places = positions(experiment, believed)
    truth = flights.truth[..., _PLACE]
    errors = places - truth
    example = np.stack([truth[:, 0], places[:, 0]])
    return {
        "rmse": rms(errors[1:]),
        "final": np.abs(errors[-1, :, :3]),
        "time": thinned(np.linspace(0.0, paper.DURATION, len(truth))),
        "truth": thinned(example[0]),
        "estimate": thinned(example[1]),
    }


def dive(scheme: str, noise: float = 1.0) -> Experiment:
    """The dive from rest under the held controls, and what the filter is told of it.

    Args:
        scheme: "printed" or "own".
        noise: Factor on all standard deviations.
    """
    own = scheme == "own"
    dt = paper.OWN_DT if own else paper.DT
    share = paper.OWN_DT / dt  # steps to one of ours, for which the noise is stated
    return Experiment(
        advance=_own_step if own else _euler_step,
        start=np.zeros(len(TRUTH)),
        controls=_own_controls(held_controls()) if own else _euler_controls(held_controls()),
        estimated=_ESTIMATED,
        measured=[_ESTIMATED.index(i) for i in _MEASURED],
        kick_sd=noise * paper.KICK_SD / np.sqrt(share),
        reading_sd=noise * paper.READING_SD * np.sqrt(share),
        prior_sd=noise * paper.PRIOR_SD,
    )


def positions(experiment: Experiment, estimates: np.ndarray) -> np.ndarray:
    """x, y, z [m] and yaw [rad] by the printed kinematics (eqs. 1-4) from estimates ``(T + 1, B, 6)``, alike."""
    controls = experiment.controls[:, None]
    states = experiment.state(estimates[:-1])
    places = np.zeros(estimates.shape[:-1] + (len(_PLACE),))
    yaw = np.cumsum(experiment.advance(states, controls)[..., _YAW], 0)
    states[1:, :, _YAW] = yaw[:-1]
    moved = (experiment.advance(states, controls) - states)[..., _PLACE]
    np.cumsum(moved, 0, out=places[1:])
    return places


@cache
def held_controls() -> np.ndarray:
    """Rudder, stern plane [rad] and thrust [N] that end the undisturbed dive at the goal, ``(3,)``.

    Raises:
        RuntimeError: if there are none.
    """

    def miss(held: np.ndarray) -> np.ndarray:
        state = np.zeros(len(TRUTH))
        for control in _own_controls(held):
            state = _own_step(state, control)
        return state[_PLACE[:3]] - paper.GOAL

    found = root(miss, [0.4 * paper.RUDDER, 0.0, paper.VEHICLE.body.cruise_thrust], tol=1e-10)
    if not found.success:
        raise RuntimeError("no held controls lead to the goal")
    return found.x


def _own_controls(held: np.ndarray) -> np.ndarray:
    """Actuators before and after each of our steps ``(T, 6)``."""
    after = np.tile(held, (round(paper.DURATION / paper.OWN_DT), 1))
    before = after.copy()
    before[0, 0] = paper.RUDDER
    return np.concatenate([before, after], -1)


def _euler_controls(held: np.ndarray) -> np.ndarray:
    """The same actuators at the beginning of each of the paper's steps ``(T, 3)``."""
    times = paper.DT * np.arange(round(paper.DURATION / paper.DT))
    controls = np.tile(held, (len(times), 1))
    controls[:, 0] = np.interp(times, [0.0, paper.OWN_DT], [paper.RUDDER, held[0]])
    return controls


def _own_step(states: np.ndarray, control: np.ndarray) -> np.ndarray:
    return paper.VEHICLE.advance(states, control, _COEFFICIENTS)


def _euler_step(states: np.ndarray, control: np.ndarray) -> np.ndarray:
    return states + paper.DT * segorogeni_derivative(states, control, _COEFFICIENTS)


def computing_time(steps: int, repeats: int, seed: int) -> dict[str, np.ndarray]:
    """Measured time of one dive at the paper's step by the number of members: ``seconds (repeats, sizes)``."""
    experiment = dive("printed")

    def sized(members: int) -> Filter:
        return make("enkf", experiment.model, members=members)

    seconds = seconds_a_step(experiment, sized, paper.MEMBERS, steps, repeats, seed)
    return {"seconds": seconds * len(experiment.controls)}


# --- the page ---------------------------------------------------------------------------------------


def page(results: Results) -> Page:
    """The page, from the values of every cell of `cells`."""
    printed = {
        members: np.concatenate([results[_printed(members, seed)]["rmse"] for seed in paper.SEEDS])
        for members in paper.MEMBERS
    }
    own = {members: np.asarray(results[_own(members)]["rmse"]) for members in paper.MEMBERS}
    seconds = np.asarray(results["time"]["seconds"])
    labels = {_PRINTED_LABEL: printed, _OWN_LABEL: own}
    most, fewest = max(paper.MEMBERS), min(paper.MEMBERS)

    final = np.concatenate([results[_printed(most, seed)]["final"] for seed in paper.SEEDS])
    times = time_comparisons(paper.PUBLISHED, "time", seconds)
    rows = comparisons(paper.PUBLISHED, printed, {})
    rows += [
        Comparison("end of the dive", name, published, mean_interval(final[:, i]), above=_end_reason(name, final[:, i]))
        for i, (name, published) in enumerate(paper.FINAL.items())
    ]
    trends = slopes(own)
    extended, doubled = np.asarray(results["extended"]["rmse"]), np.asarray(results["doubled"]["rmse"])
    extended_printed = np.concatenate([results[_extended(seed)]["rmse"] for seed in paper.SEEDS])
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
                        _path_figure(results[_printed(most, paper.SEEDS[0])]),
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
