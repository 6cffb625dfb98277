"""The page on the PUNA paper: its paths and its ensemble filter."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from agents.page import Entry, Table, listed, number, words
from agents.statistics import paired_difference
from studies.papers.measures import (
    Comparison,
    Report,
    comparison_table,
    exponential,
    falls,
    percent,
    rows,
    trend,
)
from studies.papers.puna.experiment import CONTROLS, MEASURED, PLANE, QUANTITIES, bank, controls
from studies.papers.template import fill
from vessel_gym.guidance.dubins import WORDS

Results = Mapping[str, Mapping[str, Any]]
_CIRCULAR = "Q and R were taken from it"


def report(settings: Mapping[str, Any], results: Results) -> Report:
    """Page and measures, from the values of every job."""
    members, paths = settings["members"], settings["paths"]
    at_300 = members.index(300)
    names = {"flight": "noise of a flight", "sizes": "noise of the printed sizes"}
    columns = {name: _comparisons(settings, results, level, "all") for level, name in names.items()}
    opened, obstructed = results["open"], results["obstructed"]
    shortest = {
        interpretation: min(found, key=found.get)
        for interpretation, found in opened["lengths"].items()
    }
    all_, alone = (_rmse(results, "flight", "constant", measured) for measured in MEASURED)
    gains = {
        q: exponential(np.log(alone[at_300, :, i]) - np.log(all_[at_300, :, i]))
        for i, q in enumerate(QUANTITIES)
    }
    change = trend(members, np.exp(np.log(all_).mean(-1)).T)
    tables = {
        "published": comparison_table(columns), "words": _words(opened), "obstacle": _ways(paths, obstructed),
    }  # fmt: skip
    ends = [paths["obstructed"][end] for end in ("start", "goal")]
    page, opening = fill(
        Path(__file__).parent, tables, settings=settings, open=opened, obstructed=obstructed,
        trim=controls("constant", 1, 0.0, 1.0)[0], shortest=shortest, plane=PLANE,
        agree=[interpretation for interpretation, word in shortest.items() if word == paths["open"]["word"]],
        gains={q: f"{g.mean:.2f} [{g.low:.2f}, {g.high:.2f}]" for q, g in gains.items()}, falls=falls(change),
        least=min(g.mean for g in gains.values()), better=all(g.low > 1.0 for g in gains.values()),
        best={c: _best(settings, results, c) for c in CONTROLS}, change=percent(change),
        away=np.abs(np.asarray(obstructed["tangent points"]) - ends).max(),
        stalled=100.0 * np.mean(np.asarray(results["sizes, constant, all"]["slowest"]) <= 0.0),
        alone=[f"{c.ratio.mean:.2f}" for c in _comparisons(settings, results, "flight", "x")[:4]],
    )  # fmt: skip
    return Report(page, rows(settings["paper"], columns[names["flight"]]), opening)


def _rmse(results: Results, level: str, control: str, measured: str) -> np.ndarray:
    """RMS errors ``(sizes, runs, 4)``."""
    return np.asarray(results[f"{level}, {control}, {measured}"]["rmse"])


def _comparisons(
    settings: Mapping[str, Any], results: Results, level: str, measured: str
) -> list[Comparison]:
    """The eight printed errors beside ours at a noise level."""
    found = []
    for control in CONTROLS:
        printed = settings["printed"][control]
        ours = _rmse(results, level, control, measured)[
            settings["members"].index(printed["members"])
        ]
        for i, (quantity, unit) in enumerate(QUANTITIES.items()):
            found.append(Comparison(
                f"{control} angle, {printed['members']} members", quantity, unit, printed["errors"][i],
                printed["where"], ours[:, i],
                meant=printed.get("meant", {}).get(quantity), reason=_CIRCULAR if level == "sizes" else "",
            ))  # fmt: skip
    return found


def _best(settings: Mapping[str, Any], results: Results, control: str) -> dict[str, str]:
    """The claim that a size is the best, by the geometric mean of the four errors, paired."""
    members, best = settings["members"], settings["printed"][control]["best"]
    logs = 100.0 * np.log(_rmse(results, "flight", control, "all")).mean(-1)
    gaps = {
        size: paired_difference(logs[i], logs[members.index(best)])
        for i, size in enumerate(members)
        if size != best
    }
    better = [str(size) for size, gap in gaps.items() if gap is not None and gap.high < 0.0]
    level = [str(size) for size, gap in gaps.items() if gap is None or not gap.excludes_zero]
    verdict = f"false, {listed(better)} are better" if better else "true"
    if level and not better:
        verdict = f"undecided, no significant difference from {listed(level)}"
    return {
        "verdict": verdict,
        "gaps": ", ".join(f"{size}: {words(gap, 2, True)} %" for size, gap in gaps.items()),
    }


# --- tables -----------------------------------------------------------------------------


def _words(opened: Mapping[str, Any]) -> Table:
    """The length of every word in the case without an obstacle, the shortest bold."""
    found = opened["lengths"]
    rows_ = [
        (word, [Entry(number(each[word], 1), strong=each[word] == min(each.values())) if word in each else Entry("–")
                for each in found.values()])
        for word in WORDS
    ]  # fmt: skip
    return Table(
        "", "", "word", [(interpretation, "m") for interpretation in found], [("", rows_)], "words"
    )


def _ways(paths: Mapping[str, Any], found: Mapping[str, Any]) -> Table:
    """Ways past the obstacle: length, clearance of its centre, kinks and bank."""
    radius, turn = paths["obstacle"][2], bank(paths["speed"], paths["radius"])

    def way(
        length: float, clearance: float, kinks: str = "none", angle: float = turn
    ) -> list[Entry]:
        return [
            Entry(v) for v in (number(length, 3), number(clearance, 2), kinks, number(angle, 1))
        ]

    lines = []
    for word in ("SRS", "SLS"):
        kinks = listed([number(kink, 1) for kink in found["kinks"][word]])
        lines.append(
            (f"{word}, string round it", way(found["strings"][word], radius, kinks, found["bank"]))
        )
    lines.append(
        (
            f"{found['word']} from (−500, 100), through the obstacle",
            way(found["length"], found["clearance"]),
        )
    )
    lines.append(("our plan from there, round it", way(found["detour"], radius)))
    lines += [
        (
            f"{each['word']}, printed points as poses, headings {interpretation}",
            way(each["length"], each["clearance"]),
        )
        for interpretation, each in found["as poses"].items()
    ]
    head = [("length", "m"), ("passes the centre at", "m"), ("kinks", "deg"), ("bank", "deg")]
    return Table("", "", "way", head, [("", lines)], "obstacle")
