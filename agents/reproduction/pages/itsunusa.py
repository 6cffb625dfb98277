"""The page on ITSUNUSA's dive: the tables of the EnKF-SR paper beside ours."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from agents.page import Bullets, Claim, Claims, Entry, Facts, Figure, Page, Section, Table, entry, listed, number, words
from agents.plotting import BELIEVED, PUBLISHED, TRUE, data_uri, styled
from agents.reproduction.comparison import tally
from agents.reproduction.itsunusa import cell_name, recorded_controls
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
from agents.reproduction.settings import itsunusa as paper
from agents.statistics import Interval, mean_interval

Results = Mapping[str, Mapping[str, Any]]


def page(results: Results) -> Page:
    """The page, from the values of every cell of `cells`."""
    errors = {
        variant: {members: np.asarray(results[cell_name(variant, members)]["rmse"]) for members in paper.MEMBERS}
        for variant in paper.VARIANTS
    }
    seconds = {variant: np.asarray(results[f"time, {variant}"]["seconds"]) for variant in paper.VARIANTS}
    extended, doubled, pitch = (np.asarray(results[name]["rmse"]) for name in ("extended", "doubled", "pitch measured"))
    fewest, most = min(paper.MEMBERS), max(paper.MEMBERS)
    doubling = doubled.mean(0) / errors["symmetric"][most].mean(0)
    above = {"position": _position_reason(pitch)}
    rows = {variant: comparisons(paper.PUBLISHED, errors[variant], above) for variant in paper.VARIANTS}
    times = {
        variant: time_comparisons(paper.PUBLISHED, f"time, {words_}", seconds[variant])
        for variant, words_ in FORMS.items()
    }
    trends = {variant: slopes(errors[variant]) for variant in paper.VARIANTS}
    theirs = printed_slopes(paper.PUBLISHED)
    labels = {f"ours, {words_}": errors[variant] for variant, words_ in paper.VARIANTS.items()}
    timed = {f"ours, {words_}": seconds[variant] for variant, words_ in paper.VARIANTS.items()}
    falls = [_fall(name) for name in paper.QUANTITIES]

    answer = [
        *(
            f"With the algorithm {words_}, {tally([*rows[variant], *times[variant]])}."
            for variant, words_ in FORMS.items()
        ),
        f"From {fewest} to {most} members the errors of the motions change by "
        f"{change(slopes(_motions(errors['evensen2004']))[-1], fewest, most)} as printed and by "
        f"{change(slopes(_motions(errors['symmetric']))[-1], fewest, most)} in the symmetric form.",
        f"The paper's fall by {min(falls):.0f} to {max(falls):.0f} %, {np.sum(np.array(falls) > _SAMPLING)} of the "
        f"{len(falls)} by more than the {_SAMPLING:.0f} % of an error that is nothing but sampling noise: more than "
        "the number of members alone explains.",
        "Little is proved by the agreement or its lack, because the paper prints neither noise nor what is measured: "
        f"with twice our noise the errors are {min(doubling):.2f} to {max(doubling):.2f} times as large, and with "
        f"pitch measured that of the depth is {words(mean_interval(pitch[:, -1]), 4)} m.",
    ]
    return Page(
        "ITSUNUSA: an EnKF-SR dives to 20 m",
        f"Table 2 and Figures 3 to 6 of the paper, over {paper.RUNS} dives, with the update as printed and with its "
        "symmetric form",
        answer,
        [
            Section(
                "Published and ours",
                [
                    *(
                        comparison_table(
                            f"Published (Table 2) and ours, the algorithm {words_}",
                            f"Mean and 95 % interval over {paper.RUNS} dives, the same for all sizes.",
                            rows[variant],
                            variant,
                        )
                        for variant, words_ in FORMS.items()
                    ),
                    time_table(_duration(), [c for each in times.values() for c in each]),
                    Figure(
                        _dive_figure(results[cell_name("evensen2004", most)]),
                        "A dive, true and estimated, as the paper's Figures 3 to 6",
                        f"The algorithm as printed, {most} members. Right: estimate less truth; dashed, in red: the "
                        "published RMSE on both sides of zero.",
                    ),
                ],
            ),
            Section(
                "What members are worth",
                [
                    _checks_table(errors, extended, doubled, pitch),
                    growth_table(
                        "Exponents of error over the number of members",
                        "a in error ~ N^a, fitted to every run by itself, in which all sizes see the same truth and "
                        "readings; mean and 95 % interval over the runs, bold where it excludes zero. All: geometric "
                        "mean of the four errors. Sampling noise alone has −0.5.",
                        paper.PUBLISHED, labels,
                    ),
                    Figure(
                        members_figure(paper.PUBLISHED, paper.QUANTITIES, labels, timed),
                        "Errors and computing time over the number of members",
                        "Means and 95 % intervals.",
                    ),
                    Claims(_claims(errors, seconds, trends, theirs)),
                ],
            ),
            Section("Assumptions", [Facts("What the paper does not print", paper.ASSUMPTIONS)]),
            Section("Misprints and what does not fit", [Bullets(paper.MISPRINTS)]),
        ],
    )  # fmt: skip


FORMS = {"evensen2004": "as printed", "symmetric": "in its symmetric form"}
_SAMPLING = 100.0 * (1.0 - (max(paper.MEMBERS) / min(paper.MEMBERS)) ** -0.5)
"""By how many per cent sampling noise falls from the fewest to the most members."""


def _duration() -> float:
    return len(recorded_controls()) * paper.DT


def _fall(name: str) -> float:
    """By how many per cent a published error falls from the fewest to the most members."""
    first, last = (paper.PUBLISHED[members][name].value for members in (min(paper.MEMBERS), max(paper.MEMBERS)))
    return 100.0 * (1.0 - last / first)


def _motions(errors: Errors) -> Errors:
    """The errors of surge, heave and pitch rate, without the depth."""
    return {members: values[:, :-1] for members, values in errors.items()}


def _position_reason(pitch: np.ndarray) -> str:
    found = words(mean_interval(pitch[:, -1]), 4)
    return f"depth is integrated, and pitch not measured; with an inclinometer it is {found} m ({max(paper.MEMBERS)})"


def _checks_table(errors: Mapping[str, Errors], extended: np.ndarray, doubled: np.ndarray, pitch: np.ndarray) -> Table:
    """Ours at the most members beside the filter without members, twice the noise and a measured pitch."""
    most = max(paper.MEMBERS)

    def line(values: np.ndarray) -> list[Entry]:
        return [entry(mean_interval(values[:, i]), places) for i, places in enumerate((5, 5, 6, 4))]

    rows = [
        *((f"{most} members, {label}", line(errors[variant][most])) for variant, label in paper.VARIANTS.items()),
        ("none: ekf", line(extended)),
        (f"{most} members, symmetric, all noise doubled", line(doubled)),
        (f"{most} members, symmetric, pitch measured", line(pitch)),
    ]
    note = "RMSE over the same dives; the last row has readings of pitch (0.01 rad) besides, and noise of its own."
    return Table("What the errors hang on", note, "", list(paper.QUANTITIES.items()), [("", rows)], "checks")


def _claims(
    errors: Mapping[str, Errors], seconds: Mapping[str, np.ndarray], trends: Mapping[str, list[Interval | None]],
    theirs: Mapping[str, float],
) -> list[Claim]:  # fmt: skip
    fewest, most = min(paper.MEMBERS), max(paper.MEMBERS)
    found = []
    for variant, form in FORMS.items():
        motions = slopes(_motions(errors[variant]))[-1]
        each = "; ".join(
            f"{name} {change(trend, fewest, most)}"
            for name, trend in zip(paper.QUANTITIES, trends[variant][:-1], strict=True)
        )
        found.append(
            Claim(
                f"More members reduce the error ({form}).",
                verdict(motions, -1),
                f"The motions, from {fewest} to {most}, over {paper.RUNS} paired dives: "
                f"{change(motions, fewest, most)}; one by one: {each}.",
            )
        )
    steepest = min(theirs[name] for name in paper.QUANTITIES)
    flatter = all(
        trend is not None and trend.low > theirs[name]
        for each in trends.values()
        for name, trend in zip(paper.QUANTITIES, each[:-1], strict=True)
    )
    falls = listed([f"{name} {_fall(name):.0f} %" for name in paper.QUANTITIES])
    found.append(
        Claim(
            f"From {fewest} to {most} members the errors fall by a quarter to a half ({falls}).",
            "false" if flatter else "undecided",
            ("Each of our exponents is above the printed one beyond doubt, in both forms. " if flatter else "")
            + f"The steepest printed one is {number(steepest, 2)}. Sampling noise alone has −0.5, and a filter's error "
            "is that of the exact filter and a little sampling noise: error² ≈ exact² (1 + c/N), which with N in the "
            "hundreds and four states is next to flat. Through the printed surge errors exact² would be negative "
            f"({number(1e4 * _negative(), 1)} × 10⁻⁴ m²/s²).",
        )
    )
    for variant, form in FORMS.items():
        trend = slope(paper.MEMBERS, seconds[variant])
        found.append(
            Claim(
                f"More members cost more time ({form}).",
                verdict(trend, 1),
                f"Exponent {words(trend, 3)} (published {number(theirs['time'], 3)})."
                + (" It forms an N × N matrix in every step." if variant == "evensen2004" else ""),
            )
        )
    position = mean_interval(errors["evensen2004"][most][:, -1])
    assert position is not None
    relative = 100.0 / paper.DEPTH
    stated = relative * paper.POSITION.value
    found.append(
        Claim(
            f"The error of the position, {paper.POSITION.printed} m of {paper.DEPTH:.0f} m, is "
            f"{paper.RELATIVE.printed} %.",
            "true" if np.isclose(stated, float(paper.RELATIVE.printed)) else "false, a misprint",
            f"{paper.POSITION.printed} m are {stated:g} %.",
        )
    )
    found.append(
        Claim(
            f"The error of the position is below {paper.BOUND.printed} %.",
            "true, of ours" if relative * position.high < paper.BOUND.value else "false, of ours",
            f"{number(relative * position.mean, 2)} ± {number(relative * position.half, 2)} % of {paper.DEPTH:.0f} m.",
        )
    )
    return found


def _negative() -> float:
    """exact² in error² = exact² + b/N through the printed surge errors with the fewest and the most members."""
    first, last = min(paper.MEMBERS), max(paper.MEMBERS)
    high, low = (paper.PUBLISHED[members]["surge"].value ** 2 for members in (first, last))
    return low - (high - low) / (1.0 / first - 1.0 / last) / last


def _dive_figure(found: Mapping[str, Any]) -> str:
    """Motions and depth over time on the left, their errors on the right, as a data URI."""
    from matplotlib.figure import Figure as Canvas

    time, truth, estimate_ = (np.asarray(found[key]) for key in ("time", "truth", "estimate"))
    with styled():
        figure = Canvas(figsize=(7.2, 6.6), layout="constrained")
        panels = figure.subplots(4, 2, sharex=True, width_ratios=(1.15, 1.0))
        for i, (name, unit) in enumerate(paper.QUANTITIES.items()):
            left, right = panels[i]
            left.plot(time, truth[:, i], color=TRUE, lw=1.8, label="true")
            left.plot(time, estimate_[:, i], color=BELIEVED, lw=0.9, ls="--", label="estimate")
            right.plot(time, (estimate_ - truth)[:, i], color=BELIEVED, lw=0.8)
            for sign in (-1.0, 1.0):
                published = paper.PUBLISHED[max(paper.MEMBERS)][name].value
                right.axhline(sign * published, color=PUBLISHED, lw=0.9, ls="--", label="published RMSE")
            label = "depth" if name == "position" else name
            left.set_ylabel(f"{label} [{unit}]")
            right.set_ylabel(f"error [{unit}]")
        panels[3, 0].invert_yaxis()
        for axes, count in zip(panels[0], (2, 1), strict=True):
            handles, names = axes.get_legend_handles_labels()
            axes.legend(handles[:count], names[:count], loc="lower right", bbox_to_anchor=(1.0, 1.0), ncol=count)
        panels[0, 0].set_xlim(0.0, time[-1])
        for axes in panels[3]:
            axes.set_xlabel("time [s]")
        return data_uri(figure)
