"""Sections of a report: consistency, example episodes and everything else that is measured."""

from collections.abc import Iterable, Sequence
from itertools import product
from typing import Any

import numpy as np

from agents.episodes import Episode
from agents.metrics import NEES, SCORE, UNHEALTHY, WITHOUT_COVARIANCE, Metric, metrics
from agents.page import Block, Entry, Live, Section, entry, listed, number
from agents.studies.examples import examples
from agents.studies.results import Place, Results
from agents.studies.wording import file_name, note, tabled
from agents.studies.worlds import system_of


def consistency(results: Results) -> Section:
    """Claimed uncertainty of estimators beside the score."""
    first = results.conditions[0]
    sections = {
        e: [
            (name, _honesty(results, Place(e, first), name))
            for name in results.estimators(e, results.classical)
        ]
        for e in results.environments
    }
    values: dict[str, Any] = {
        "nees": NEES,
        "unhealthy": UNHEALTHY,
        "without": listed(WITHOUT_COVARIANCE),
    }
    heads = (
        "Score",
        NEES.label,
        "NEES in band",
        "NIS in band",
        "Diverged",
        "Diverged, all conditions",
    )
    units = (*heads, (UNHEALTHY.label, UNHEALTHY.unit))
    return Section(
        "Consistency beside task score", tabled("consistency", results, units, sections, **values)
    )


def _honesty(results: Results, place: Place, name: str) -> list[Entry]:
    who = results.classical

    def share(key: str) -> Entry:
        found = [values[key] for values in results.runs_of(place, who, name).values()]
        return Entry(number(float(np.mean(np.array(found, float))), 2) if found else "–")

    def diverged(places: Iterable[Place]) -> Entry:
        runs = np.array(
            [
                values["diverged"]
                for p in places
                for values in results.runs_of(p, who, name).values()
            ]
        )
        counted = runs.size and name not in WITHOUT_COVARIANCE
        return Entry(f"{np.count_nonzero(runs)} of {runs.size}" if counted else "–")

    return [
        entry(results.mean(place, who, name, SCORE), 3),
        entry(results.mean(place, who, name, NEES), 2),
        share("nees_in_band"),
        share("nis_in_band"),
        diverged([place]),
        diverged(results.places([place.environment])),
        entry(results.mean(place, who, name, UNHEALTHY), 1),
    ]


def episodes(results: Results) -> Section:
    """The example episodes."""
    blocks: list[Block] = []
    for environment, job in examples(results.plan).items():
        if job.key not in results.values:
            continue
        episode = Episode(results.values[job.key])
        flights, spread = (
            episode.page["flights"],
            [number(sd, 2) for sd in episode.page["spread"] or ()],
        )
        ends = (f" ({flight['end']})" if flight["end"] else "" for flight in flights)
        scores = [
            f"{f['estimator']} {number(f['score'], 2)}{end}"
            for f, end in zip(flights, ends, strict=True)
        ]
        seed = episode.page["conditions"][-1]
        text = note(
            "example", results, seed=seed, scores=", ".join(scores), spread=", ".join(spread)
        )
        blocks.append(Live(episode.html(), f"{environment}, {results.conditions[0]}", text.strip()))
    return Section("Example episodes", blocks)


def measures(results: Results) -> Section:
    """All metrics, in tables narrow enough to read."""
    blocks: list[Block] = []
    elsewhere = {NEES.key, UNHEALTHY.key, "return"}
    for environment in results.environments:
        known = [m for m in metrics(system_of(environment)) if m.key not in elsewhere]
        estimated = [m for m in known if m.key.endswith(("_rmse", "_nees"))]
        for kind, file, chosen in (
            (
                "How the vehicle was steered",
                "steering",
                [m for m in known if m not in estimated and not m.cost],
            ),
            ("Costs on each estimator", "costs-on-each", [m for m in known if m.cost]),
            ("How well the state was estimated", "estimation", estimated),
        ):
            values = {"kind": kind, "metrics": chosen, "estimates": chosen is estimated}
            blocks += _table(results, environment, file, values)
    return Section("Steering and estimation in figures", blocks)


def _table(results: Results, environment: str, file: str, values: dict[str, Any]) -> list[Block]:
    """Table of metrics of the classical agent in the first condition, an estimator a row."""
    place, who, chosen = results.places([environment])[0], results.classical, values["metrics"]
    flown = [
        n for n in results.estimators(environment, who) if results.figure(place, who, n) is not None
    ]
    rows = [
        (on, [entry(results.mean(place, who, on, m), m.decimals) for m in chosen]) for on in flown
    ]
    heads, values = (
        [(m.label, m.unit) for m in chosen],
        values | {"partly": _partly(results, place, chosen)},
    )
    return tabled(
        "measures",
        results,
        heads,
        {"": rows},
        file=file_name(file, environment),
        place=place,
        **values,
    )


def _partly(results: Results, place: Place, chosen: Sequence[Metric]) -> list[str]:
    """Numbers of episodes with a metric that only some episodes have."""
    notes = []
    for name, m in product(results.estimators(place.environment, results.classical), chosen):
        values = results.figure(place, results.classical, name, m.key)
        count = 0 if values is None else int(np.isfinite(values).sum())
        if values is not None and 0 < count < values.size:
            notes.append(f"{m.label.lower()} on {name} {count}")
    return notes
