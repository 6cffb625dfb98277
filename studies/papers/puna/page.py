"""Tables of the PUNA paper: its paths and its ensemble filter."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from studies.papers.measures import (
    Comparison,
    Report,
    Results,
    Table,
    between,
    by_members,
    comparison_table,
    geometric,
    rows,
)
from studies.papers.puna.experiment import CONTROLS, MEASURED, QUANTITIES
from vessel_gym.guidance.dubins import WORDS


def report(settings: Mapping[str, Any], results: Results) -> Report:
    """Tables and measures, from the values of every job."""
    members = settings["members"]
    flight, alone, sizes = (
        _comparisons(settings, results, level, measured)
        for level, measured in (("flight", "all"), ("flight", "x"), ("sizes", "all"))
    )
    columns = {
        "noise of a flight": flight,
        "with x alone": alone,
        "noise of the printed sizes": sizes,
    }
    units = [f"{name} [{unit}]" for name, unit in QUANTITIES.items()]
    own: Table = [("angle", "members", *units)]
    for control in CONTROLS:
        errors = _rmse(results, "flight", control, "all")
        own += by_members(control, dict(zip(members, errors, strict=True)))
        every, x = (
            np.log(_rmse(results, "flight", control, measured)[members.index(300)])
            for measured in MEASURED
        )
        gains = (between(geometric(each), 2) for each in (x - every).T)
        own.append((control, "300, x alone / every state", *gains))
    found = results["open"]["lengths"]
    lengths: Table = [("word", *(f"{interpretation} [m]" for interpretation in found))]
    for word in WORDS:
        cells = (f"{of[word]:.1f}" if word in of else "–" for of in found.values())
        lengths.append((word, *cells))
    tables = {"published": comparison_table(columns), "own": own, "words": lengths,
              "obstacle": _ways(settings["paths"], results["obstructed"])}  # fmt: skip
    return Report(tables, rows(settings["paper"], flight))


def _rmse(results: Results, level: str, control: str, measured: str) -> np.ndarray:
    """RMS errors ``(sizes, runs, 4)``."""
    return np.asarray(results[f"{level}, {control}, {measured}"]["rmse"])


def _comparisons(
    settings: Mapping[str, Any], results: Results, level: str, measured: str
) -> list[Comparison]:
    """The eight printed errors beside ours at a noise level."""
    reason = {"sizes": "Q and R were taken from it"}.get(level, "")
    found = []
    for control in CONTROLS:
        printed = settings["printed"][control]
        size, meant = printed["members"], printed.get("meant", {})
        ours = _rmse(results, level, control, measured)[settings["members"].index(size)]
        for i, (name, unit) in enumerate(QUANTITIES.items()):
            found.append(Comparison(
                f"{control} angle, {size} members", name, unit, printed["errors"][i],
                printed["where"], ours[:, i], meant=str(meant.get(name, "")), reason=reason,
            ))  # fmt: skip
    return found


def _ways(paths: Mapping[str, Any], found: Mapping[str, Any]) -> Table:
    """Ways past the obstacle: length, clearance of its centre, and kinks of the strings."""
    radius = paths["obstacle"][2]
    ways: Table = [("way", "length [m]", "passes the centre at [m]", "kinks [deg]")]
    for word, length in found["strings"].items():
        kinks = " and ".join(f"{kink:.1f}" for kink in found["kinks"][word])
        ways.append((f"{word}, string round it", f"{length:.3f}", f"{radius:.2f}", kinks))
    whole = f"{found['word']} from (−500, 100), through the obstacle"
    ways.append((whole, f"{found['length']:.3f}", f"{found['clearance']:.2f}", "none"))
    ways.append(
        ("our plan from there, round it", f"{found['detour']:.3f}", f"{radius:.2f}", "none")
    )
    for interpretation, each in found["as poses"].items():
        way = f"{each['word']}, printed points as poses, headings {interpretation}"
        ways.append((way, f"{each['length']:.3f}", f"{each['clearance']:.2f}", "none"))
    return ways
