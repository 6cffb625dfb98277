"""Tables of Hermawan's five simulations."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from agents.statistics import paired_difference
from studies.papers.corvette.experiment import MODELS, QUANTITIES, explain
from studies.papers.measures import (
    EXPLORATORY,
    Comparison,
    Report,
    Results,
    Table,
    comparison_table,
    row,
    rows,
    spread,
)
from vessel_gym.vehicles.corvette_thesis import SIMULATIONS


def report(settings: Mapping[str, Any], results: Results) -> Report:
    """Tables and measures, from the values of every job."""
    open_, printed = settings["open"], settings["printed"]
    rmse = {
        model: {s: np.asarray(results[f"{s}, {model}"]["rmse"]) for s in SIMULATIONS}
        for model in MODELS
    }
    first = rmse[MODELS[0]]
    choices = {name: choice["believed"] for name, choice in open_.items()}
    believed = explain(choices, settings["runs"], settings["seed"])
    before, after = _comparisons(printed, first, circular=True), _comparisons(printed, believed)
    tables: dict[str, Table] = {
        "published": comparison_table({"before the search": before, "believed": after}),
        "choices": [("choice", "before the search", "believed", "where")],
        "models": [
            ("simulation", *(f"{q}, {model} [rad]" for model in MODELS for q in QUANTITIES))
        ],
        "changes": [("simulations", *(f"{q}, second less first [mrad]" for q in QUANTITIES))],
    }
    for name, choice in open_.items():
        told = (str(choice[key]) for key in ("first", "believed", "where"))
        tables["choices"].append((name.replace("_", " "), *told))
    for s in SIMULATIONS:
        cells = (spread(rmse[model][s][i], 5) for model in MODELS for i in range(2))
        tables["models"].append((s, *cells))
    changes = {f"I, {s}": zip(first["I"], first[s], strict=True) for s in [*SIMULATIONS][1:]}
    for name in ("I", "V"):  # d drives the heading, too
        changes[f"driven, {name}"] = zip(
            first[name], results[f"driven, {name}"]["rmse"], strict=True
        )
    for pair, errors in changes.items():
        gaps = (paired_difference(1e3 * np.asarray(b), 1e3 * a) for a, b in errors)
        cells = ("0" if gap is None else f"{gap.mean:.3f} ± {gap.half:.3f}" for gap in gaps)
        tables["changes"].append((pair, *cells))
    way = (
        f"{settings['paper']}, believed ({EXPLORATORY}, of {settings['search']['combinations']:,})"
    )
    return Report(tables, [*rows(settings["paper"], before), row(way, "simulations I to V", after)])


def _comparisons(
    printed: Mapping[str, Any], ours: Mapping[str, np.ndarray], circular: bool = False
) -> list[Comparison]:
    """The ten means of Table 4.9 beside ours ``(2, runs)``; the d of II gave the noise."""
    return [
        Comparison(
            f"simulation {s}", quantity, "rad", printed[s]["means"][i], printed[s]["where"],
            ours[s][i], averaged=3,
            reason="the noise was taken from it" if circular and (s, i) == ("II", 1) else "",
        )
        for s in SIMULATIONS for i, quantity in enumerate(QUANTITIES)
    ]  # fmt: skip
