"""The page on the robust filters."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from agents.page import Entry, Table, entry, number, words
from agents.statistics import Interval
from studies.papers.measures import Report, Row, exponential
from studies.papers.robust.experiment import (
    PRIOR_VARIANCE,
    STATES,
    STEP,
    Condition,
    job_name,
    sweeps,
)
from studies.papers.template import fill

Results = Mapping[str, Mapping[str, Any]]
_TITLES = {
    "rate": "how many outliers [%]", "size": "how large the outliers [σ]", "tolerance": "c of the worst noise",
    "parameters": "error of A [%]", "least_favourable, outliers": "outliers [%], worst noise of c = 0.1",
    "parameters, outliers": "outliers [%], A off by 40 %",
}  # fmt: skip


def report(settings: Mapping[str, Any], results: Results) -> Report:
    """Page and measures, from the values of every job; the paper prints no number."""
    groups, example = sweeps(settings), results["example"]
    huber, *minimax = others = [name for name in settings["filters"] if name != "kf"]
    hit, example_rmse = Condition(**settings["outliers"]), np.asarray(example["rmse"])

    def to_kf(condition: Condition, name: str) -> Interval:
        return ratio(results, "random", condition, name)

    model_errors = [
        c for key in ("tolerance", "parameters") for c in groups[key] if getattr(c, key)
    ]
    outliers = list(dict.fromkeys(c for key in ("rate", "size") for c in groups[key] if c.rate))
    tables = {
        "outliers": _table(results, groups, ["rate", "size"], others), "systems": _systems(results, settings, others),
        "model-error": _table(results, groups, ["tolerance", "parameters"], others),
        "both": _table(results, groups, list(_TITLES)[4:], others),
    }  # fmt: skip
    settled = float(np.sqrt(np.mean(example_rmse[settings["skipped"] :] ** 2)))
    variance = np.asarray(example["variance"])
    own = [Condition(**settings[error]) for error in ("least_favourable", "parameters")]
    grounds = [(huber, hit), *((name, condition) for name in minimax for condition in own)]
    shares = [
        f"{name} {100.0 * np.mean(_units(results, c, name) < 1.0):.0f} %" for name, c in grounds
    ]
    page, opening = fill(
        Path(__file__).parent, tables, settings=settings, example=example, hit=to_kf(hit, huber),
        random=settings["populations"]["random"], free={n: to_kf(Condition(), n) for n in others},
        struck={n: to_kf(hit, n) for n in minimax}, minimax=minimax,
        gains={n: _balance(results, model_errors, n) for n in minimax},
        losses={n: _balance(results, outliers, n) for n in minimax}, every=_balance(results, outliers, huber),
        errors=example_rmse, start=float(np.sqrt(PRIOR_VARIANCE * STATES)), settled=settled, gain=example["gain"],
        falls=bool((variance[-1] < variance[0]).all()), shares=shares, step=STEP,
        affected={n: words(ratio(results, "paper", hit, n, Condition()), 2) for n in settings["filters"]},
    )  # fmt: skip
    return Report(
        page, [Row(settings["paper"], "no number is printed", 0, 0, 0, 0, 0, 0, 0.0)], opening
    )


def _rmse(results: Results, population: str, condition: Condition, name: str) -> np.ndarray:
    """RMSE of each unit of an interval: of every system over its runs, or of every run of the single system."""
    values = np.asarray(results[job_name(population, condition)][name])
    return values[0] if len(values) == 1 else np.sqrt(np.mean(values**2, axis=1))


def ratio(
    results: Results,
    population: str,
    condition: Condition,
    name: str,
    without: Condition | None = None,
) -> Interval:
    """Geometric mean of a filter's RMSE over that of the KF, or over its own under the condition ``without``."""
    ours = _rmse(results, population, condition, name)
    other = _rmse(results, population, without or condition, name if without else "kf")
    return exponential(np.log(ours) - np.log(other))


def _units(results: Results, condition: Condition, name: str) -> np.ndarray:
    """Every random system's RMSE over that of the KF."""
    return _rmse(results, "random", condition, name) / _rmse(results, "random", condition, "kf")


def _balance(results: Results, conditions: Sequence[Condition], name: str) -> str:
    """Counts of conditions in which a filter gains on the KF or loses, with shares of the error."""
    ratios, found = [ratio(results, "random", condition, name) for condition in conditions], []
    gained, lost = (
        [1.0 - r.mean for r in ratios if r.high < 1.0],
        [r.mean - 1.0 for r in ratios if r.low > 1.0],
    )
    for verb, changes in (("gains", gained), ("loses", lost)):
        if changes:
            sizes = dict.fromkeys(number(100.0 * pick(changes), 1) for pick in (min, max))
            found.append(f"{verb} {' to '.join(sizes)} % in {len(changes)}")
    return (
        f"{' and '.join(found) or 'neither gains nor loses significantly in any'} of {len(ratios)}"
    )


def _label(key: str, condition: Condition) -> str:
    attribute = "rate" if "outliers" in key else key
    value = getattr(condition, attribute)
    return f"{100 * value:g}" if attribute in ("rate", "parameters") else f"{value:g}"


def _table(
    results: Results,
    groups: Mapping[str, Sequence[Condition]],
    keys: Sequence[str],
    others: Sequence[str],
) -> Table:
    """RMSE of the KF and ratios to it over the random systems, bold where the interval excludes 1."""

    def line(condition: Condition) -> list[Entry]:
        kf = float(np.exp(np.log(_rmse(results, "random", condition, "kf")).mean()))
        ratios = [ratio(results, "random", condition, name) for name in others]
        return [
            Entry(number(kf, 2)),
            *(replace(entry(r, 3), strong=r.high < 1.0 or r.low > 1.0) for r in ratios),
        ]

    sections = [(_TITLES[key], [(_label(key, c), line(c)) for c in groups[key]]) for key in keys]
    return Table(
        "", "", "condition", [("KF, RMSE", ""), *((f"{n} / KF", "") for n in others)], sections
    )


def _systems(results: Results, settings: Mapping[str, Any], others: Sequence[str]) -> Table:
    """Quantiles of the ratio to the KF over the random systems."""
    sections = []
    shown = {"nothing wrong": "", "10 % outliers of 10 σ": "outliers", "worst noise, c = 0.1": "least_favourable",
             "A off by 40 %": "parameters"}  # fmt: skip
    for title, key in shown.items():
        lines = []
        for name in others:
            ratios = _units(results, Condition(**settings[key]) if key else Condition(), name)
            quantiles = [
                number(float(q), 2) for q in np.quantile(ratios, (0.0, 0.1, 0.5, 0.9, 1.0))
            ]
            lines.append(
                (
                    name,
                    [
                        Entry(v)
                        for v in (number(100.0 * float((ratios < 1.0).mean()), 0), *quantiles)
                    ],
                )
            )
        sections.append((title, lines))
    head = [
        ("systems below the KF", "%"),
        *((label, "") for label in ("best", "10 %", "median", "90 %", "worst")),
    ]
    return Table("", "", "filter", head, sections, "systems")
