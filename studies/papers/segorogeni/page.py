"""Tables of Segorogeni's dive."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from agents.statistics import paired_difference
from studies.papers.measures import (
    Comparison,
    Report,
    Results,
    Table,
    against_table,
    by_members,
    comparison_table,
    rows,
    spread,
)
from studies.papers.segorogeni.experiment import QUANTITIES, REFERENCES


def report(settings: Mapping[str, Any], results: Results) -> Report:
    """Tables and measures, from the values of every job."""
    members, seeds = settings["members"], settings["seeds"]

    def joined(size: int, key: str) -> np.ndarray:
        return np.concatenate([results[f"printed step, {size}, {seed}"][key] for seed in seeds])

    printed, columns = settings["printed"], {}
    for of in REFERENCES:
        times = zip(members, printed["time"], strict=False)
        lines = {str(n): [*printed[str(n)], time] for n, time in times}
        errors = {n: joined(n, of) for n in members}
        found = against_table("Table III", lines, QUANTITIES, errors, settings["averaged"])
        final = zip("xyz", printed["end"], joined(members[-1], "final").T, strict=True)
        found += [
            Comparison("end of the dive", name, "m", text, "sec. III D", ours)
            for name, text, ours in final
        ]
        columns[f"against the {of}"] = found
    units = [f"{name} [{unit}]" for name, unit in QUANTITIES.items()]
    tables: dict[str, Table] = {
        "published": comparison_table(columns), "own": [("reference", "members", *units)],
        "believed": [("reference", *units)],
    }  # fmt: skip
    for of in REFERENCES:
        own = {n: np.asarray(results[f"own step, {n}"][of]) for n in members}
        tables["own"] += by_members(of, own)
        exact = (spread(each, 5) for each in np.transpose(results["own step, 0"][of]))
        tables["own"].append((of, "none: ekf", *exact))
        gap = [paired_difference(*pair) for pair in zip(own[300].T, own[200].T, strict=True)]
        cells = ("–" if each is None else f"{each.mean:.5f} ± {each.half:.5f}" for each in gap)
        tables["own"].append((of, "300 less 200", *cells))
        believed = (spread(each, 3) for each in np.transpose(results["believed"][of]))
        tables["believed"].append((of, *believed))
    return Report(tables, rows(settings["paper"], columns[f"against the {REFERENCES[0]}"]))
