"""The page on the PUNA paper: its paths and its ensemble filter, printed and ours."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from agents.page import Entry, Page, Table, entry, listed, number, words
from agents.reproduction.comparison import tally
from agents.reproduction.pages import puna_figures
from agents.reproduction.pages.comparison import comparison_table, geometric_ratio, mean_of
from agents.reproduction.pages.ensembles import slope
from agents.reproduction.pages.puna_results import (
    Results,
    comparisons,
    errors_of,
    errors_of_size,
    keeps_flying,
    runs,
)
from agents.reproduction.pages.template import fill
from agents.reproduction.puna import PLANE, bank, cell_name
from agents.reproduction.settings import puna as paper
from agents.statistics import Interval, paired_difference
from vessel_gym.guidance.dubins import WORDS

_TITLES = {name: level.title for name, level in paper.LEVELS.items()}


def page(results: Results) -> Page:
    """The page, from the values of every cell."""
    open_, obstructed, aircraft = (results[name] for name in ("open", "obstructed", "aircraft"))
    tallies = {level: tally(comparisons(results, level)) for level in paper.LEVELS}
    gains = [_gain(results, i) for i in range(len(paper.STATES))]
    abstract = {level: [gain.ratios[level, "constant"] for gain in gains] for level in paper.LEVELS}
    best = [_best_claim(results, control) for control in paper.CONTROLS]
    trend = slope(paper.MEMBERS, np.exp(_combined(results, "flight", "constant", "all")).T)
    seconds = np.asarray(results["time"]["seconds"])
    flying = keeps_flying(results, "sizes", "constant")
    shortest = {reading: min(found, key=found.get) for reading, found in open_["lengths"].items()}
    other_pair = np.asarray(results["sizes, scaled"]["rmse"])[-1].mean(0)
    slowest = {level: np.asarray(results[cell_name(level, "constant", "all")]["slowest"]) for level in paper.LEVELS}
    tables = _path_tables(results) | _ensemble_tables(results) | {"scales": _scales_table(results)}
    for level in paper.LEVELS:
        tables[f"errors-{level}"] = comparison_table("", "", comparisons(results, level), f"errors-{level}")
    figures = {
        "open": puna_figures.open_figure(open_), "obstacle": puna_figures.obstacle_figure(obstructed),
        "flight": puna_figures.flight_figure(results), "members": puna_figures.members_figure(results),
    }  # fmt: skip
    return fill(
        "puna", tables, figures, paper=paper, plane=PLANE, open=open_, obstructed=obstructed, aircraft=aircraft,
        everywhere=all(gain.low > 1.0 for level in abstract.values() for gain in level), gains=gains, best=best,
        times=[f"{listed([f'{g.mean:.2f}' for g in abstract[level]])} ({t})" for level, t in _TITLES.items()],
        sizes=[f"{claim.members} ({claim.control} angle): {claim.verdict}" for claim in best],
        levels={name: {"title": title, "tally": tallies[name]} for name, title in _TITLES.items()},
        open_verdict=_open_verdict(shortest), strings=obstructed["strings"], goal_y=obstructed["poses"][1][1],
        string_bank=np.rad2deg(obstructed["bank"]), sizes_D=[f"{v:g}" for v in paper.SIZES], runs=runs(results),
        shortest=[
            f"headings {reading}: " + ", ".join(
                f"{word} {number(found[word], 1)} m" for word in dict.fromkeys((shortest[reading], paper.OPEN.word))
            ) for reading, found in open_["lengths"].items()
        ],
        h_to_x=_h_to_x(results), trend=trend, trend_change=_percent(trend), cost=slope(paper.MEMBERS, seconds),
        other_pair=[f"{share:.2f}" for share in other_pair / [p.value for p in paper.PRINTED["constant"]]],
        milliseconds=[f"{1e3 * t:.0f}" for t in seconds.mean(0)], members=[str(n) for n in paper.MEMBERS],
        mended=slope(paper.MEMBERS, errors_of(results, "sizes", "constant", "all")[:, flying, 0].T),
        flying=int(flying.sum()), repetitions=len(seconds), alpha=np.rad2deg(aircraft["alpha"]),
        swing=np.rad2deg(paper.SWING),
        stalled=[f"{100 * np.mean(slowest[level] <= 0.0):.0f} % with the {t}" for level, t in _TITLES.items()],
    )  # fmt: skip


# --- paths ------------------------------------------------------------------------------------------


def _open_verdict(shortest: dict[str, str]) -> str:
    """Verdict on the printed word, from the shortest word under each reading of the headings."""
    agrees = [reading for reading, word in shortest.items() if word == paper.OPEN.word]
    if any(reading != "from the x axis" for reading in agrees):
        return "true"
    return f"false, as printed; true with headings {listed(agrees)}" if agrees else "false"


def _path_tables(results: Results) -> dict[str, Table]:
    found, obstructed = results["open"]["lengths"], results["obstructed"]
    rows = [(word, [_length(lengths.get(word), min(lengths.values())) for lengths in found.values()]) for word in WORDS]
    heads = [(reading, "m") for reading in paper.READINGS]
    tables = {"words": Table("", "", "word", heads, [("", rows)], "words"), "obstacle": _ways_table(obstructed)}
    tangent, ends = np.asarray(obstructed["tangent points"]), (paper.OBSTRUCTED.start, paper.OBSTRUCTED.goal)
    away = np.abs(tangent - ends)
    point_rows = []
    for (j, name), (k, axis) in ((end, axis) for end in enumerate(("start", "goal")) for axis in enumerate("xy")):
        values = ((ends[j][k], 4), (tangent[j, k], 6), (away[j, k], 6))
        same = "the same point" if away[j, k] <= paper.PRINT else "another point"
        point_rows.append((f"{name}, {axis}", [*(Entry(number(*value)) for value in values), Entry(same)]))
    heads = [("printed", "m"), ("tangent point", "m"), ("difference", "m"), ("verdict", "")]
    return tables | {"points": Table("", "", "printed as", heads, [("", point_rows)], "points")}


def _length(length: float | None, shortest_length: float) -> Entry:
    return Entry("–") if length is None else Entry(number(length, 1), strong=length == shortest_length)


def _ways_table(obstructed: Any) -> Table:
    strings, radius = obstructed["strings"], paper.OBSTRUCTED.obstacle[2]

    def way(length: float, clearance: float, kinks: str = "none", angle: float = bank(paper.RADIUS)) -> list[Entry]:
        values = (number(length, 3), number(clearance, 2), kinks, number(np.rad2deg(angle), 1))
        return [Entry(value) for value in values]

    taut = []
    for word, where in (("SRS", "above"), ("SLS", "below")):
        kinks = listed([number(kink, 1) for kink in np.rad2deg(obstructed["kinks"][word])])
        name = f"{word}, {where}" + (", the paper's" if word == paper.OBSTRUCTED.word else "")
        taut.append((name, way(strings[word], radius, kinks, obstructed["bank"])))
    planned = [
        (f"{obstructed['word']}, through the obstacle", way(obstructed["length"], obstructed["clearance"])),
        ("our plan, round it", way(obstructed["detour"], radius)),
    ]
    posed = [
        (f"{path['word']}, headings {reading}", way(path["length"], path["clearance"]))
        for reading, path in obstructed["as poses"].items()
    ]
    heads = [("length", "m"), ("passes the centre at", "m"), ("kinks", "deg"), ("bank", "deg")]
    sections = [
        ("strings of the printed radius of 30 m", taut),
        ("paths with turns of 100 m, from (−500, 100)", planned),
        ("paths with turns of 100 m, the printed points taken as poses", posed),
    ]
    return Table("", "", "way", heads, sections, "obstacle")


# --- estimation -------------------------------------------------------------------------------------


def _h_to_x(results: Results) -> dict[str, list[str]]:
    """The error of h over that of x: printed by control, ours by set of measurements at either noise level."""
    printed = [paper.PRINTED[control][3].value / paper.PRINTED[control][2].value for control in paper.CONTROLS]
    found = {"printed": [f"{share:.2f}" for share in printed]}
    for measured in paper.MEASURED:
        means = [errors_of_size(results, level, "constant", measured, 300).mean(0) for level in paper.LEVELS]
        found[measured] = [number(float(mean[3] / mean[2]), 2) for mean in means]
    return found


def _scales_table(results: Results) -> Table:
    printed = [Entry(p.printed, strong=True) for p in paper.PRINTED["constant"]]
    sections = [("printed, constant angle of attack", [("", printed)])]
    decimals = [len(p.printed.partition(".")[2]) for p in paper.PRINTED["constant"]]
    for level, title in _TITLES.items():
        found = results[f"{level}, scaled"]
        rows = []
        for (q, r), errors in zip(found["scales"], found["rmse"], strict=True):
            means = [entry(mean_of(e), places) for e, places in zip(np.asarray(errors).T, decimals, strict=True)]
            rows.append((f"Q × {number(q, 2)}, R × {number(r, 2)}", means))
        sections.append((title, rows))
    return Table("", "", "factors", [(state.symbol, state.unit) for state in paper.STATES], sections, "scales")


def _gain(results: Results, i: int) -> SimpleNamespace:
    """The claim that x alone is worse in a state than every state, with the best ensembles that the abstract names."""
    ratios = {}
    for level in paper.LEVELS:
        for control, members in paper.BEST_MEMBERS.items():
            worse, better = (errors_of_size(results, level, control, name, members)[:, i] for name in ("x", "all"))
            ratios[level, control] = geometric_ratio(worse, better)
    evidence = "; ".join(
        f"{title}: " + ", ".join(f"{_factor(ratios[level, control])} ({control} angle)" for control in paper.CONTROLS)
        for level, title in _TITLES.items()
    )
    pair = (errors_of_size(results, "flight", "constant", measured, 300)[:, i] for measured in ("x", "all"))
    return SimpleNamespace(
        state=paper.STATES[i], ratios=ratios, verdict=_gain_verdict(list(ratios.values())), evidence=evidence,
        difference=paired_difference(*pair),
    )  # fmt: skip


def _factor(gain: Interval) -> str:
    return f"{gain.mean:.2f} [{gain.low:.2f}, {gain.high:.2f}]"


def _gain_verdict(gains: list[Interval]) -> str:
    """Verdict on ratios above 1 everywhere, with the word "much" only from 1.5 on."""
    if all(gain.low > 1.0 for gain in gains):
        least, most = (100.0 * (pick(gain.mean for gain in gains) - 1.0) for pick in (min, max))
        return "true" if least >= 50.0 else f"true, but not much: by {least:.0f} to {most:.0f} %"
    return "false" if any(gain.high < 1.0 for gain in gains) else "undecided, not everywhere beyond doubt"


def _combined(results: Results, level: str, control: str, measured: str) -> np.ndarray:
    """The logarithm of the geometric mean of the four errors ``(sizes, runs)``."""
    return np.log(errors_of(results, level, control, measured)).mean(-1)


def _against_best(results: Results, level: str, control: str, measured: str) -> list[Interval | None]:
    """By how many percent errors differ from those of the size that the paper calls best, a number each size."""
    logs = 100.0 * _combined(results, level, control, measured)
    return [paired_difference(row, logs[paper.MEMBERS.index(paper.BEST_MEMBERS[control])]) for row in logs]


def _best_claim(results: Results, control: str) -> SimpleNamespace:
    best = paper.BEST_MEMBERS[control]
    gaps = zip(paper.MEMBERS, _against_best(results, "flight", control, "all"), strict=True)
    others = {size: gap for size, gap in gaps if size != best and gap is not None}
    better = [str(size) for size, gap in others.items() if gap.high < 0.0]
    level = [str(size) for size, gap in others.items() if not gap.excludes_zero]
    verdict = "true"
    if better:
        verdict = f"false, {listed(better)} are better"
    elif level:
        verdict = f"undecided, no detectable difference from {listed(level)}"
    said = [f"{size}: {words(gap, 2, True)} %" for size, gap in others.items()]
    return SimpleNamespace(members=best, control=control, verdict=verdict, gaps=said)


def _percent(trend: Interval | None) -> str:
    """Change of the error between the smallest and the largest ensemble by a power of N."""
    if trend is None:
        return "–"
    change = (paper.MEMBERS[-1] / paper.MEMBERS[0]) ** trend.mean - 1.0
    return f"{number(100.0 * change, 1, signed=True)} %"


def _ensemble_tables(results: Results) -> dict[str, Table]:
    gaps, slopes = [], []
    for level, title in _TITLES.items():
        gap_rows, slope_rows = [], []
        for control, best in paper.BEST_MEMBERS.items():
            for measured, label in paper.MEASURED.items():
                name = f"{label}, {control} angle"
                against = zip(paper.MEMBERS, _against_best(results, level, control, measured), strict=True)
                entries = [Entry("0") if size == best else entry(gap, 2, True) for size, gap in against]
                gap_rows.append((f"{name}, against {best}", entries))
                errors = errors_of(results, level, control, measured)
                trends = [entry(slope(paper.MEMBERS, errors[:, :, i].T), 4, True) for i in range(len(paper.STATES))]
                slope_rows.append((name, trends))
        gaps.append((title, gap_rows))
        slopes.append((title, slope_rows))
    seconds = 1e3 * np.asarray(results["time"]["seconds"])
    times = [(str(n), [entry(mean_of(t), 1)]) for n, t in zip(paper.MEMBERS, seconds.T, strict=True)]
    return {
        "sizes": Table("", "", "measured", [(str(size), "%") for size in paper.MEMBERS], gaps, "sizes"),
        "slopes": Table("", "", "measured", [(state.symbol, "") for state in paper.STATES], slopes, "slopes"),
        "time": Table("", "", "members", [("time", "ms")], [("", times)], "time"),
    }
