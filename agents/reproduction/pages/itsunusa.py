"""The page on ITSUNUSA's dive: the tables of the EnKF-SR paper beside ours."""

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from agents.page import Page, Table, words
from agents.plotting import BELIEVED, PUBLISHED, TRUE, drawing
from agents.reproduction.comparison import Comparison, tally
from agents.reproduction.itsunusa import cell_name, recorded_controls
from agents.reproduction.pages import ensembles
from agents.reproduction.pages.comparison import comparison_table
from agents.reproduction.pages.template import fill
from agents.reproduction.settings import itsunusa as paper
from agents.statistics import Interval, mean_interval

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

FORMS = {"evensen2004": "as printed", "symmetric": "in its symmetric form"}
Errors = ensembles.Errors
_FEWEST, _MOST = min(paper.MEMBERS), max(paper.MEMBERS)


def page(results: Mapping[str, Mapping[str, Any]]) -> Page:
    """The page, from the values of every cell of `cells`."""
    errors = {
        variant: {members: np.asarray(results[cell_name(variant, members)]["rmse"]) for members in paper.MEMBERS}
        for variant in paper.VARIANTS
    }
    seconds = {variant: np.asarray(results[f"time, {variant}"]["seconds"]) for variant in paper.VARIANTS}
    extended, doubled, pitch = (np.asarray(results[name]["rmse"]) for name in ("extended", "doubled", "pitch measured"))
    depth = mean_interval(pitch[:, -1])
    reason = f"depth is integrated, and pitch not measured; with an inclinometer it is {words(depth, 4)} m ({_MOST})"
    labels = {f"ours, {label}": errors[variant] for variant, label in paper.VARIANTS.items()}
    timed = {f"ours, {label}": seconds[variant] for variant, label in paper.VARIANTS.items()}
    tables = {
        "checks": _checks_table(errors, extended, doubled, pitch),
        "exponents": ensembles.growth_table("", "", paper.PUBLISHED, labels),
    }
    figures = {
        "dive": _dive_figure(results[cell_name("evensen2004", _MOST)]),
        "members": ensembles.members_figure(paper.PUBLISHED, paper.QUANTITIES, labels, timed),
    }
    theirs = ensembles.printed_slopes(paper.PUBLISHED)
    forms, trends, all_times = [], {}, list[Comparison]()
    for variant, name in FORMS.items():
        rows = ensembles.comparisons(paper.PUBLISHED, errors[variant], {"position": reason})
        times = ensembles.time_comparisons(paper.PUBLISHED, f"time, {name}", seconds[variant])
        tables[variant], all_times = comparison_table("", "", rows, variant), all_times + times
        trends[variant] = dict(zip(paper.QUANTITIES, ensembles.slopes(errors[variant])[:-1], strict=True))
        motions = {members: values[:, :-1] for members, values in errors[variant].items()}  # without the depth
        forms.append({
            "variant": variant, "name": name, "tally": tally(rows + times), "motions": ensembles.slopes(motions)[-1],
            "changes": ensembles.changes(paper.QUANTITIES, trends[variant].values(), _FEWEST, _MOST),
            "time_trend": ensembles.slope(paper.MEMBERS, seconds[variant]),
        })  # fmt: skip
    tables["time"] = comparison_table("", "", all_times, "time")
    falls = {
        name: 100.0 * (1.0 - paper.PUBLISHED[_MOST][name].value / paper.PUBLISHED[_FEWEST][name].value)
        for name in paper.QUANTITIES
    }
    sampling = 100.0 * (1.0 - (_MOST / _FEWEST) ** -0.5)  # % by which sampling noise falls
    position = mean_interval(errors["evensen2004"][_MOST][:, -1])
    assert position is not None
    percent = 100.0 / paper.DEPTH
    return fill(
        "itsunusa", tables, figures, paper=paper, fewest=_FEWEST, most=_MOST, forms=forms, falls=falls,
        fallen=[f"{name} {fall:.0f} %" for name, fall in falls.items()], sampling_fall=sampling,
        steep=sum(fall > sampling for fall in falls.values()), sampling=" Sampling noise alone has −0.5.", depth=depth,
        doubling=doubled.mean(0) / errors["symmetric"][_MOST].mean(0), duration=len(recorded_controls()) * paper.DT,
        flatter=all(
            trend is not None and trend.low > theirs[name] for form in trends.values() for name, trend in form.items()
        ),
        steepest=min(theirs[name] for name in paper.QUANTITIES), exact=1e4 * _exact_square(),
        printed_time_trend=theirs["time"], stated=percent * paper.POSITION.value,
        relative=Interval(percent * position.mean, percent * position.low, percent * position.high),
    )  # fmt: skip


def _checks_table(errors: Mapping[str, Errors], extended: np.ndarray, doubled: np.ndarray, pitch: np.ndarray) -> Table:
    """Ours at the most members beside the filter without members, twice the noise and a measured pitch."""
    line = partial(ensembles.means, decimals=(5, 5, 6, 4))
    rows = [
        *((f"{_MOST} members, {label}", line(errors[variant][_MOST])) for variant, label in paper.VARIANTS.items()),
        ("none: ekf", line(extended)),
        (f"{_MOST} members, symmetric, all noise doubled", line(doubled)),
        (f"{_MOST} members, symmetric, pitch measured", line(pitch)),
    ]
    return Table("", "", "", list(paper.QUANTITIES.items()), [("", rows)], "checks")


def _exact_square() -> float:
    """exact² in error² = exact² + b/N through the printed surge errors with the fewest and the most members."""
    high, low = (paper.PUBLISHED[members]["surge"].value ** 2 for members in (_FEWEST, _MOST))
    return low - (high - low) / (1.0 / _FEWEST - 1.0 / _MOST) / _MOST


@drawing(7.2, 6.6)
def _dive_figure(figure: "Canvas", found: Mapping[str, Any]) -> None:
    """Motions and depth over time on the left, their errors on the right."""
    time, truth, estimate_ = (np.asarray(found[key]) for key in ("time", "truth", "estimate"))
    panels = figure.subplots(4, 2, sharex=True, width_ratios=(1.15, 1.0))
    for i, (name, unit) in enumerate(paper.QUANTITIES.items()):
        left, right = panels[i]
        left.plot(time, truth[:, i], color=TRUE, lw=1.8, label="true")
        left.plot(time, estimate_[:, i], color=BELIEVED, lw=0.9, ls="--", label="estimate")
        right.plot(time, (estimate_ - truth)[:, i], color=BELIEVED, lw=0.8)
        for sign in (-1.0, 1.0):
            published = paper.PUBLISHED[_MOST][name].value
            right.axhline(sign * published, color=PUBLISHED, lw=0.9, ls="--", label="published RMSE")
        left.set_ylabel(f"{'depth' if name == 'position' else name} [{unit}]")
        right.set_ylabel(f"error [{unit}]")
    panels[3, 0].invert_yaxis()
    for axes, count in zip(panels[0], (2, 1), strict=True):
        handles, names = axes.get_legend_handles_labels()
        axes.legend(handles[:count], names[:count], loc="lower right", bbox_to_anchor=(1.0, 1.0), ncol=count)
    panels[0, 0].set_xlim(0.0, time[-1])
    for axes in panels[3]:
        axes.set_xlabel("time [s]")
