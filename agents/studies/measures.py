"""Sections of a report: consistency, robustness, cost, example episodes and everything else that is measured."""

from collections.abc import Iterable, Sequence
from itertools import product

import numpy as np

from agents.episodes import Episode
from agents.metrics import NEES, SCORE, UNHEALTHY, WITHOUT_COVARIANCE, Metric, metrics
from agents.page import Block, Entry, Live, Prose, Section, Table, entry, listed, number
from agents.studies.examples import examples
from agents.studies.figures import AXES, cost_figure, framed, robustness_figure, unitless, varied
from agents.studies.records import FLOOR, ORACLE
from agents.studies.results import Place, Results
from agents.studies.shares import ruled
from agents.studies.wording import capitalised, microseconds, note, the
from agents.studies.worlds import system_of


def consistency(results: Results) -> Section:
    """Claimed uncertainty of estimators beside the score."""
    sections = []
    for environment in results.environments:
        place = Place(environment, results.conditions[0])
        names = results.estimators(environment, results.classical)
        rows = [(name, _honesty(results, place, name)) for name in names]
        sections.append((environment, [row for row in rows if any(e.value != "–" for e in row[1])]))
    sections = [(title, rows) for title, rows in sections if rows]
    if not sections:
        return Section("Consistency beside task score", [])
    who, without = capitalised(the(results.classical)), listed(WITHOUT_COVARIANCE)
    title = f"What estimators claim, and what agents make of it ({results.conditions[0]})"
    text = note("consistency", Who=who, nees=NEES, unhealthy=UNHEALTHY, without=without)
    columns = ("Score", NEES.label, "NEES in band", "NIS in band", "Diverged", "Diverged, all conditions")
    heads = [*unitless(columns), (UNHEALTHY.label, UNHEALTHY.unit)]
    table = Table(title, text, "Estimator", heads, sections, "consistency")
    return Section("Consistency beside task score", [table])


def _honesty(results: Results, place: Place, name: str) -> list[Entry]:
    who = results.classical

    def share(key: str) -> Entry:
        value = results.value(place, who, name, key)
        return Entry("–" if value is None else number(float(value.mean()), 2))

    def diverged(places: Iterable[Place]) -> Entry:
        counts = [value for p in places if (value := results.value(p, who, name, "diverged")) is not None]
        if not counts or name in WITHOUT_COVARIANCE:
            return Entry("–")
        return Entry(f"{int(sum(c.sum() for c in counts))} of {sum(c.size for c in counts)}")

    return [
        entry(results.mean(place, who, name, SCORE), 3),
        entry(results.mean(place, who, name, NEES), 2),
        share("nees_in_band"),
        share("nis_in_band"),
        diverged([place]),
        diverged(results.places([place.environment])),
        entry(results.mean(place, who, name, UNHEALTHY), 1),
    ]


def robustness(results: Results) -> Section:
    """Shares kept over each axis that the conditions vary."""
    title = "Robustness"
    if not ruled(results):
        return Section(title, [])
    lacking = [AXES[axis] for axis in AXES if axis not in varied(results)]
    missing = f"The study varies no {listed(lacking)} on its own." if lacking else ""
    figure = robustness_figure(results)
    if figure is None:
        return Section(title, [Prose(missing)])
    who, first = capitalised(the(results.classical)), results.conditions[0]
    caption = note("robustness", Who=who, first=first, floor=FLOOR, oracle=ORACLE)
    block = framed(figure, "Share kept over what may go wrong", caption)
    return Section(title, [block, *([Prose(missing)] if missing else [])])


def cost(results: Results) -> Section:
    """CPU time of a step."""
    title = "Cost"
    figure = cost_figure(results)
    if figure is None:
        return Section(title, [])
    sections = []
    for environment in results.environments:
        timed = {name: results.step_times(environment, name) for name in results.estimators(environment)}
        rows = [(name, _times(times, name == ORACLE)) for name, times in timed.items() if times]
        if rows:
            sections.append((environment, rows))
    batch = f"batch of {results.plan.study.episodes}"
    who = capitalised(the(results.classical))
    heads = [(batch, "µs"), ("beyond the truth", "µs"), ("one vehicle", "µs"), ("beyond the truth", "µs")]
    first = results.conditions[0]
    picture = framed(figure, f"Score over CPU time ({first})", note("cost-figure", Who=who, batch=batch))
    text = note("cost", Who=who, first=first, floor=FLOOR)
    table = Table("CPU time of a step, by estimator", text, "Estimator", heads, sections, "cost")
    return Section(title, [picture, table])


def _times(times: list[tuple[int, float, float]], is_truth: bool) -> list[Entry]:
    """A row of the table of costs: in a batch, and one vehicle alone."""
    pairs = [(own, None if is_truth else own - truth) for _, own, truth in (times[0], times[-1])]
    return [Entry(microseconds(value)) for pair in pairs for value in pair]


def episodes(results: Results) -> Section:
    """The example episodes."""
    blocks: list[Block] = []
    for environment, job in examples(results.plan).items():
        if job.key in results.values:
            shown = Episode(results.values[job.key])
            flights, spread = shown.page["flights"], shown.page["spread"]
            ends = [
                f"{flight['estimator']} {number(flight['score'], 2)}{f' ({end})' if (end := flight['end']) else ''}"
                for flight in flights
            ]
            varies = (
                f" Over all seeds a score has a standard deviation of {', '.join(number(sd, 2) for sd in spread)}: one "
                "episode does not show which estimator is better."
                if spread
                else ""
            )
            blocks.append(
                Live(
                    shown.html(),
                    f"{environment}, {results.conditions[0]}",
                    f"{capitalised(the(results.classical))} at {shown.page['conditions'][-1]}, whose scores lie "
                    f"nearest to their means over all evaluation seeds. Score and end: {', '.join(ends)}.{varies}",
                )
            )
    return Section("Example episodes", blocks)


def measures(results: Results) -> Section:
    """All metrics, in tables narrow enough to read."""
    blocks: list[Block] = []
    first = results.conditions[0]
    told = {NEES.key, UNHEALTHY.key, "return"}
    for environment in results.environments:
        place = Place(environment, first)
        known = [m for m in metrics(system_of(environment)) if m.key not in told]
        estimated = [m for m in known if m.key.endswith(("_rmse", "_nees"))]
        steered = [m for m in known if m not in estimated]
        for kind, chosen, name in (
            ("How the vehicle was steered", steered, "steering"),
            ("How well the state was estimated", estimated, "estimation"),
        ):
            rows = [
                (on, [entry(results.mean(place, results.classical, on, m), m.decimals) for m in chosen])
                for on in results.estimators(environment, results.classical)
                if results.figure(place, results.classical, on) is not None
            ]
            if chosen and rows:
                blocks.append(
                    Table(
                        f"{kind}: {environment}, {first}",
                        f"{capitalised(the(results.classical))}; mean over evaluation seeds with its 95 % interval "
                        "(Clopper and Pearson's for yes or no). "
                        + " ".join(f"{m.label}: {m.meaning}" for m in chosen)
                        + (" Along the track that was flown on that estimator." if chosen is estimated else "")
                        + _partly(results, place, chosen),
                        "Estimator",
                        [(m.label, m.unit) for m in chosen],
                        [("", rows)],
                        f"{name}-{environment}".lower().replace(":", "-"),
                    )
                )
    return Section("Steering and estimation in figures", blocks)


def _partly(results: Results, place: Place, chosen: Sequence[Metric]) -> str:
    """Numbers of episodes with a metric that only some episodes have."""
    notes = []
    for name, m in product(results.estimators(place.environment, results.classical), chosen):
        values = results.figure(place, results.classical, name, m.key)
        count = 0 if values is None else int(np.isfinite(values).sum())
        if values is not None and 0 < count < values.size:
            notes.append(f"{m.label.lower()} on {name} {count}")
    return f" Episodes that have the figure, where not all do: {', '.join(notes)}." if notes else ""
