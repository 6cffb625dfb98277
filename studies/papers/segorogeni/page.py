"""The page on Segorogeni's dive."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from agents.page import Table, entry, number, words
from agents.statistics import mean_interval, paired_difference
from studies.papers.measures import (
    Comparison,
    Report,
    comparison_table,
    falls,
    percent,
    rows,
    trend,
)
from studies.papers.segorogeni.experiment import (
    MEASUREMENT_SD,
    OWN_STEP,
    PROCESS_SD,
    QUANTITIES,
    REFERENCES,
)
from studies.papers.template import fill

_PLAN, _TRUE = REFERENCES


def report(settings: Mapping[str, Any], results: Mapping[str, Mapping[str, Any]]) -> Report:
    """Page and measures, from the values of every job."""
    members = settings["members"]
    fewest, most = members[0], members[-1]

    def joined(size: int, key: str) -> np.ndarray:
        return np.concatenate(
            [results[f"printed step, {size}, {seed}"][key] for seed in settings["seeds"]]
        )

    errors = {
        reference: {size: joined(size, reference) for size in members} for reference in REFERENCES
    }
    own = {
        size: {r: np.asarray(results[f"own step, {size}"][r]) for r in REFERENCES}
        for size in (*members, 0)
    }
    final = joined(most, "final")
    columns = {f"against the {r}": _comparisons(settings, errors[r], final) for r in REFERENCES}
    tables = {"published": comparison_table(columns), "own": _own_table(own)}
    ours = {reference: errors[reference][most].mean(0) for reference in REFERENCES}
    theirs = np.array([float(text) for text in settings["printed"][str(most)]])
    sizes = {r: np.stack([own[size][r] for size in members], -1) for r in REFERENCES}
    changes = {r: trend(members, np.exp(np.log(sizes[r]).mean(1))) for r in REFERENCES}
    best = [paired_difference(own[a][_PLAN][:, i], own[b][_PLAN][:, i])
            for i, (a, b) in enumerate(((300, 200), (300, 200), (200, 300)))]  # fmt: skip
    decided = {None if i is None or not i.excludes_zero else i.mean < 0.0 for i in best}
    page, opening = fill(
        Path(__file__).parent, tables, settings=settings, dives=len(final), most=most, fewest=fewest,
        ours={r: [number(value, 3) for value in values] for r, values in ours.items()},
        noise=settings["open"]["process_noise"]["believed"],
        believed=[number(value, 2) for value in np.mean(results["believed"][_PLAN], 0)],
        factors={r: theirs / values for r, values in ours.items()}, changes={r: percent(c) for r, c in changes.items()},
        falls=falls(changes[_PLAN]), planned=_PLAN, truth=_TRUE,
        angle_change=percent(trend(members, sizes[_PLAN][:, 3])),
        printed_change=100.0 * (theirs[0] / float(settings["printed"][str(fewest)][0]) - 1.0),
        best=[f"{q} {words(i, 5, True)} m" for q, i in zip("xyz", best, strict=True)],
        winner="true" if decided == {True} else "undecided, no significant difference" if None in decided else "false",
        spread=list(100.0 * errors[_PLAN][most].std(0, ddof=1) / ours[_PLAN]), own_step=OWN_STEP, process=PROCESS_SD,
        off=words(mean_interval(np.linalg.norm(final, axis=-1)), 2), measurement=MEASUREMENT_SD,
    )  # fmt: skip
    return Report(page, rows(settings["paper"], columns[f"against the {_PLAN}"]), opening)


def _comparisons(
    settings: Mapping[str, Any], errors: Mapping[int, np.ndarray], final: np.ndarray
) -> list[Comparison]:
    """Table III beside ours, with its computing times, and the distances that the text reads off one dive."""
    found, printed = [], settings["printed"]
    for i, size in enumerate(settings["members"]):
        for (name, unit), text, ours in zip(
            QUANTITIES.items(), printed[str(size)], errors[size].T, strict=True
        ):
            found.append(
                Comparison(
                    f"{size} members", name, unit, text, "Table III", ours, settings["averaged"]
                )
            )
        found.append(
            Comparison(
                f"{size} members",
                "time",
                "s",
                printed["time"][i],
                "Table III",
                None,
                reason="its machine",
            )
        )
    for name, text, ours in zip("xyz", printed["end"], final.T, strict=True):
        found.append(Comparison("end of the dive", name, "m", text, "sec. III D", ours))
    return found


def _own_table(own: Mapping[int, Mapping[str, np.ndarray]]) -> Table:
    """Errors at the vehicle's step by the number of members, 0 being the extended Kalman filter."""
    sections = [
        (f"against the {reference}", [
            (f"{size} members" if size else "none: ekf", [entry(mean_interval(e), 4) for e in errors[reference].T])
            for size, errors in own.items()
        ]) for reference in REFERENCES
    ]  # fmt: skip
    return Table("", "", "", list(QUANTITIES.items()), sections, "own")
