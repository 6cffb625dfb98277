"""The report of a study: one page that needs nothing but itself, and every word about numbers computed."""

from collections.abc import Iterable, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

import vessel_gym
from agents.cells import Cell
from agents.episodes import Episode
from agents.files import replacing
from agents.metrics import NEES, SCORE, UNHEALTHY, WITHOUT_COVARIANCE, Metric
from agents.page import Block, Bullets, Entry, Figure, Live, Page, Prose, Section, Table, entry, listed, number, write
from agents.plotting import data_uri
from agents.scores import metrics
from agents.statistics import Interval, probability_of_improvement
from agents.studies.answer import answer, summary
from agents.studies.examples import examples
from agents.studies.figures import (
    ALL,
    AXES,
    Row,
    cost_figure,
    dots,
    looks,
    pilot_looks,
    profile_figure,
    robustness_figure,
    transfer_figure,
    varied,
)
from agents.studies.plan import Flight
from agents.studies.results import Pilot, Place, Results
from agents.studies.settings import settings
from agents.studies.shares import ENDS, common, difference, kept, learners, margin, rankable, reference_pilot, ruled
from agents.studies.study import FEW_SEEDS, FLOOR, ORACLE, RAW
from agents.studies.wording import many, microseconds, sentence, share_entry, the
from agents.studies.worlds import system_of
from vessel_gym.extras import require


def page(results: Results, out: Path) -> Page:
    """The report as data.

    Args:
        results: Of a study, as far as it is flown.
        out: The folder, for the command that runs it again.
    """
    study = results.plan.study
    sections = [
        _ranking(results),
        _price(results),
        _learning(results),
        _consistency(results),
        _robustness(results),
        _cost(results),
        _episodes(results),
        _metrics(results),
        _missing(results),
        _limits(results),
        settings(results, out),
    ]
    return Page(
        study.title,
        f"vessel-gym {vessel_gym.__version__}: {many(len(study.environments), 'environment')}, "
        f"{many(len(study.estimators), 'estimator')}, {many(len(study.agents), 'agent')}, "
        f"{many(len(study.conditions), 'condition')}, {study.episodes} paired evaluation seeds"
        + (f", {many(study.training_seeds, 'training run')} of each learned agent" if study.learned else ""),
        answer(results),
        [section for section in sections if section.blocks],
        summary(results),
    )


def write_report(results: Results, out: Path) -> Path:
    """Write ``report.html``, ``episodes.csv`` and ``tables/``, each file whole or not at all.

    Args:
        results: Of a study, as far as it is flown.
        out: The folder.

    Returns:
        The page.

    Raises:
        OSError: if a file cannot be written.
        ModuleNotFoundError: without Matplotlib or Jinja.
    """
    require("matplotlib", "jinja2")
    report = page(results, out)
    files = {out / "episodes.csv": results.episodes_csv()}
    for table in report.tables:
        if table.name:
            forms = {".csv": table.csv(), ".md": table.markdown(), ".tex": table.latex()}
            files |= {out / "tables" / f"{table.name}{suffix}": text for suffix, text in forms.items()}
    for path, text in files.items():
        with replacing(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return write(report, out / "report.html")


# --- 2. ranking --------------------------------------------------------------------------------------


def _ranking(results: Results) -> Section:
    title = "Which estimator to fly"
    environments = ruled(results)
    blocks: list[Block] = [
        Prose(
            f"The scale: in each environment and condition, what {the(results.classical)} scores on {FLOOR} is 0 and "
            f"what it scores on {ORACLE} is 1, in the same episodes. A share kept of 0.6 is 60 % of what knowing the "
            "truth is worth. The ends are marks, not limits: values beyond them are shown as they are."
        )
    ]
    if results.environments:
        blocks += [Prose(text) for text in _rulers(results)]
    if not environments:
        return Section(title, blocks if results.environments else [])
    together = bool(common(results))
    heads, columns = _columns(environments, together)
    overall = f" {ALL}: only the estimators that were flown in every environment." if together else ""
    names = _ranked_names(results, environments)
    look = looks(results)
    rows = [
        Row(name, look[name], [kept(results, column, results.classical, name) for column in columns])
        for name in (*names, *ENDS)
    ]
    blocks.append(
        _figure(
            dots(rows, heads, "share of the oracle's performance kept"),
            "Share of the oracle's performance that is kept",
            f"{sentence(the(results.classical))} on each estimator, means over conditions and evaluation seeds with "
            f"95 % intervals.{overall}",
        )
    )
    best = [rankable(results, column) for column in columns]
    blocks.append(
        Table(
            "Share of the oracle's performance kept, by estimator",
            f"{sentence(the(results.classical))}, mean over {many(len(results.conditions), 'condition')} and "
            f"{results.plan.study.episodes} evaluation seeds with its 95 % interval for other seeds, the error of the "
            f"scale included.{overall} A dash: not flown there, or not in every condition.",
            "Estimator",
            [(head, "") for head in heads],
            [("", [(row.name, [share_entry(value) for value in row.values]) for row in rows])],
            "ranking",
        )
    )
    behind = [
        (name, [_behind(ranked, name) for ranked in best])
        for name in names
    ]  # fmt: skip
    blocks.append(
        Table(
            "How far behind the best",
            "Share kept minus that on the best estimator of the column, paired by evaluation seed; bold where the "
            "interval excludes zero, so that what is not bold is within chance of the best. The best is chosen on the "
            "same episodes: the 95 % hold for all pairs of a column at once (Bonferroni), and where all are equal at "
            "most one study in twenty has a bold number.",
            "Estimator",
            [(head, "") for head in heads],
            [("", behind)],
            "behind-the-best",
        )
    )
    return Section(title, blocks + _learned_ranking(results, environments, columns, heads, names))


def _learned_ranking(
    results: Results, environments: list[str], columns: list[Sequence[str]], heads: list[str], names: list[str]
) -> list[Block]:
    """The same for agents that learned: everybody on every estimator."""
    sections = []
    for pilot in (p for p in learners(results) if not results.agent(p).raw):
        rows = [(name, [share_entry(kept(results, c, pilot, name)) for c in columns]) for name in (*names, *ENDS)]
        sections.append((str(pilot), [row for row in rows if any(e.value != "–" for e in row[1])]))
    sections = [(title, rows) for title, rows in sections if rows]
    if not sections:
        return []
    return [
        Table(
            "Share of the oracle's performance kept by learned agents, by the estimator flown on",
            f"Mean over {many(results.plan.study.training_seeds, 'training run')}, conditions and evaluation seeds "
            "with its 95 % interval for other runs on other seeds, on the scale of the classical agent. The policies "
            "are not trained again for what they fly on.",
            "Flown on",
            [(head, "") for head in heads],
            sections,
            "ranking-learned",
        )
    ]


def _ranked_names(results: Results, environments: list[str]) -> list[str]:
    """Every estimator but the ends: those that flew everywhere first, by what they keep; last what has no share."""
    everywhere = list(common(results))
    means: dict[str, list[float]] = {}
    for environment in environments:
        for name, values in rankable(results, [environment]).items():
            means.setdefault(name, []).append(float(values.mean()))
    others = sorted((n for n in means if n not in everywhere), key=lambda n: -float(np.mean(means[n])))
    flown = (name for e in environments for name in results.estimators(e, results.classical))
    return list(dict.fromkeys([*everywhere, *others, *(name for name in flown if name not in ENDS)]))


def _behind(ranked: dict[str, np.ndarray], name: str) -> Entry:
    if name not in ranked:
        return Entry("–")
    best = next(iter(ranked))
    return Entry("best") if name == best else entry(margin(ranked, name, best), 3, signed=True)


def _rulers(results: Results) -> list[str]:
    """Where the scale cannot be told from nothing, or does not exist."""
    none, doubtful = [], []
    for place in results.places():
        gap = results.price([place], results.classical, FLOOR)
        where = f"{place.environment}, {place.condition}"
        if results.scale(place) is None:
            none.append(where)
        elif isinstance(gap, Interval) and not gap.excludes_zero:
            doubtful.append(where)
    texts = []
    if none:
        texts.append(
            f"No scale, because an end was not flown or {ORACLE} scores no higher than {FLOOR}; left out of every "
            f"share: {'; '.join(none)}."
        )
    if doubtful:
        texts.append(f"The scale may be chance, {ORACLE} being within chance of {FLOOR}: {'; '.join(doubtful)}.")
    return texts


# --- 3. price ----------------------------------------------------------------------------------------


def _price(results: Results) -> Section:
    sections = []
    for environment in results.environments:
        places = results.places([environment])
        names = [name for name in results.estimators(environment, results.classical) if name != ORACLE]
        rows = [(name, [_lost(results, place, results.classical, name) for place in places]) for name in names]
        for pilot in results.pilots(environment):
            own = results.own(environment, pilot)
            if results.agent(pilot).learned and own != RAW and own != ORACLE:
                rows.append((f"{pilot}, on {own}", [_lost(results, place, pilot, own) for place in places]))
        if rows:
            sections.append((environment, rows))
    if not sections:
        return Section("The price of estimation", [])
    table = Table(
        "Score lost against the truth",
        f"Score on the truth minus score on the estimator at the same seed, with its 95 % interval; bold where it "
        f"excludes zero, each for itself: of twenty true zeros one is bold. {sentence(the(results.classical))}"
        + ("; learned agents, on the estimator of their training." if learners(results) else "."),
        "Estimator",
        [(condition, "") for condition in results.conditions],
        sections,
        "price",
    )
    return Section("The price of estimation", [*_price_figure(results), table])


def _price_figure(results: Results) -> list[Block]:
    """What is lost on each estimator but the ends: beside dead reckoning the others could not be told apart."""
    environments, look = ruled(results), looks(results)
    names = _ranked_names(results, environments)
    lost = {name: [results.price(results.scaled([e]), results.classical, name) for e in environments] for name in names}
    rows = [Row(name, look[name], values) for name, values in lost.items() if any(v is not None for v in values)]
    if not rows:
        return []
    caption = (
        f"{sentence(the(results.classical))}, means over conditions and evaluation seeds with 95 % intervals; the line "
        f"is the truth, and {FLOOR} is beyond the axis."
    )
    figure = dots(rows, environments, "score lost against the truth", (0.0,))
    return [_figure(figure, "Score lost against the truth", caption)]


def _lost(results: Results, place: Place, pilot: Pilot, estimator: str) -> Entry:
    return share_entry(results.price([place], pilot, estimator), signed=True)


# --- 4. learning -------------------------------------------------------------------------------------


def _learning(results: Results) -> Section:
    title = "Learned agents"
    learned = learners(results)
    environments = [e for e in results.environments if any(results.runs([e], p) is not None for p in learned)]
    if not learned or not environments:
        return Section(title, [])
    seeds = results.plan.study.training_seeds
    blocks: list[Block] = []
    if seeds < FEW_SEEDS:
        blocks.append(
            Prose(
                f"Warning: {many(seeds, 'training run')} of each agent. What is said of learning here is of these "
                f"policies; with fewer than {FEW_SEEDS} runs an interval says little of what another training would "
                "give."
            )
        )
    heads, columns = _columns(environments, len(environments) > 1)
    look = pilot_looks(results)
    rows = [
        Row(str(pilot), look[pilot], [kept(results, column, pilot, None) for column in columns])
        for pilot in results.schools()
    ]
    at_home = (
        "Everybody at home: learned agents on what they were trained on, others on the environment's default "
        f"estimator. Means over conditions, evaluation seeds and, of learned agents, {many(seeds, 'training run')}, "
        "with 95 % intervals for other seeds and other runs. All conditions, though learned agents know the first "
        "alone."
    )
    blocks += [
        _figure(
            dots(rows, heads, "share of the oracle's performance kept"),
            "Share kept by each agent",
            at_home + " Hollow: one run, no interval.",
        ),
        Table(
            "Share of the oracle's performance kept, by agent",
            at_home,
            "Agent",
            [(head, "") for head in heads],
            [("", [(row.name, [share_entry(value) for value in row.values]) for row in rows])],
            "agents",
        ),
    ]
    reference = reference_pilot(results)
    if reference is not None:
        others = [pilot for pilot in learned if pilot != reference]
        blocks += _improvement(results, reference, others, columns, heads) + _without_filter(
            results, reference, others, columns, heads
        )
    blocks.append(
        _figure(
            profile_figure(results),
            "Performance profiles",
            "Share of the training runs that keep more than a share of the oracle's performance, each agent at home, "
            "with pointwise 95 % bands (Clopper and Pearson) for other runs on these evaluation seeds, where runs lie.",
        )
    )
    for agent in (a for a in results.plan.study.agents if a.learned and not a.raw):
        figure = transfer_figure(results, agent.name)
        if figure is not None:
            blocks.append(
                _figure(
                    figure,
                    f"{agent.name}: trained on one estimator, flown on another",
                    "Mean share kept over training runs, conditions and seeds; framed: the estimator of the training.",
                )
            )
    return Section(title, blocks)


def _improvement(
    results: Results, reference: Pilot, others: list[Pilot], columns: list[Sequence[str]], heads: list[str]
) -> list[Block]:
    def better(pilot: Pilot, column: Sequence[str]) -> Entry:
        ours, theirs = (results.runs(column, p) for p in (pilot, reference))
        return Entry("–") if ours is None or theirs is None else entry(probability_of_improvement(ours, theirs), 2)

    rows = [(str(pilot), [better(pilot, column) for column in columns]) for pilot in others]
    return _unless_empty(
        Table(
            f"Probability of improvement over {reference}",
            f"How probably a training run of the agent keeps more than one of {reference}, each at home, with its 95 % "
            "interval (Clopper and Pearson) for other runs on these evaluation seeds; 0.5: as good.",
            "Agent",
            [(head, "") for head in heads],
            [("", rows)],
            "improvement",
        )
    )


def _without_filter(
    results: Results, reference: Pilot, others: list[Pilot], columns: list[Sequence[str]], heads: list[str]
) -> list[Block]:
    """Raw readings, with and without memory, beside learning on estimates."""
    raw = [pilot for pilot in others if results.agent(pilot).raw]

    def gain(pilot: Pilot, column: Sequence[str]) -> Entry:
        return share_entry(difference(results, column, pilot, reference, len(raw)), signed=True)

    rows = [(str(pilot), [gain(pilot, column) for column in columns]) for pilot in raw]
    return _unless_empty(
        Table(
            "Learning without a filter",
            f"Share kept on raw readings minus share kept by {reference}, paired by training and evaluation seed; "
            "the 95 % hold for all rows of a column at once (Bonferroni); bold where zero is excluded. Negative: the "
            "filter is worth it.",
            "Agent",
            [(head, "") for head in heads],
            [("", rows)],
            "without-filter",
        )
    )


def _unless_empty(table: Table) -> list[Block]:
    entries = [entry for _, rows in table.sections for _, row in rows for entry in row]
    return [table] if any(entry.value != "–" for entry in entries) else []


# --- 5. consistency ----------------------------------------------------------------------------------


def _consistency(results: Results) -> Section:
    sections = []
    for environment in results.environments:
        place = Place(environment, results.conditions[0])
        names = results.estimators(environment, results.classical)
        rows = [(name, _honesty(results, place, name)) for name in names]
        sections.append((environment, [row for row in rows if any(e.value != "–" for e in row[1])]))
    sections = [(title, rows) for title, rows in sections if rows]
    if not sections:
        return Section("Consistency beside task score", [])
    table = Table(
        f"What estimators claim, and what agents make of it ({results.conditions[0]})",
        f"{sentence(the(results.classical))}; mean over evaluation seeds with its 95 % interval. {NEES.label}: "
        f"{NEES.meaning} In band: share of times at which NEES (mean over seeds) and NIS (sum over seeds) lie in their "
        "95 % chi-square bands; 0.95 for a filter that is as good as it says, less for a cautious one, too. Diverged: "
        "episodes in which the truth was for half of the time outside of what the filter held for possible (NEES "
        f"beyond its 99.9999 % quantile). {UNHEALTHY.label}: {UNHEALTHY.meaning} A dash: {listed(WITHOUT_COVARIANCE)} "
        "claim no covariance of their own; without innovations there is no NIS. Where an unknown input reaches the "
        "readings, every innovation contains it and no covariance does: no NIS there is in its band.",
        "Estimator",
        [
            ("Score", ""),
            (NEES.label, ""),
            ("NEES in band", ""),
            ("NIS in band", ""),
            ("Diverged", ""),
            ("Diverged, all conditions", ""),
            (UNHEALTHY.label, UNHEALTHY.unit),
        ],
        sections,
        "consistency",
    )
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


# --- 6. robustness, 7. cost, 8. examples, 9. metrics --------------------------------------------------


def _robustness(results: Results) -> Section:
    title = "Robustness"
    if not ruled(results):
        return Section(title, [])
    lacking = [AXES[axis] for axis in AXES if axis not in varied(results)]
    missing = f"The study varies no {listed(lacking)} on its own." if lacking else ""
    figure = robustness_figure(results)
    if figure is None:
        return Section(title, [Prose(missing)])
    caption = (
        f"{sentence(the(results.classical))}; each axis is varied alone, the others as in {results.conditions[0]!r}. "
        "Means and 95 % intervals over evaluation seeds, side by side for legibility. The scale is that of each "
        f"condition: {FLOOR} 0, {ORACLE} 1."
    )
    block = _figure(figure, "Share kept over what may go wrong", caption)
    return Section(title, [block, *([Prose(missing)] if missing else [])])


def _cost(results: Results) -> Section:
    title = "Cost"
    figure = cost_figure(results)
    if figure is None:
        return Section(title, [])
    names = [
        name
        for name in results.flown_on()
        if any(results.cost(e, results.classical, name) for e in results.environments)
    ]
    costs = [
        (name, [Entry(microseconds(results.cost(e, results.classical, name))) for e in results.environments])
        for name in names
    ]
    return Section(
        title,
        [
            _figure(
                figure,
                f"Score over CPU time ({results.conditions[0]})",
                f"{sentence(the(results.classical))}. CPU time of one step of one vehicle in a batch of "
                f"{results.plan.study.episodes}: physics, sensors, estimator and agent; the difference from {ORACLE} "
                "is the estimator's. Median over conditions; it holds for the machine that computed, and its load.",
            ),
            Table(
                "CPU time of a step, by estimator",
                "Median over conditions, physics and agent included.",
                "Estimator",
                [(environment, "µs") for environment in results.environments],
                [("", costs)],
                "cost",
            ),
        ],
    )


def _episodes(results: Results) -> Section:
    blocks: list[Block] = []
    for environment, cell in examples(results.plan).items():
        if cell.key in results.values:
            shown = Episode(results.values[cell.key])
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
                    f"{sentence(the(results.classical))} at {shown.page['conditions'][-1]}, whose scores lie nearest "
                    f"to their means over all evaluation seeds. Score and end: {', '.join(ends)}.{varies}",
                )
            )
    return Section("Example episodes", blocks)


def _metrics(results: Results) -> Section:
    """Everything that is measured, in tables narrow enough to read."""
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
                        f"{sentence(the(results.classical))}; mean over evaluation seeds with its 95 % interval "
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
    """Where a figure exists for some episodes only, say for how many."""
    notes = []
    for name, m in product(results.estimators(place.environment, results.classical), chosen):
        values = results.figure(place, results.classical, name, m.key)
        count = 0 if values is None else int(np.isfinite(values).sum())
        if values is not None and 0 < count < values.size:
            notes.append(f"{m.label.lower()} on {name} {count}")
    return f" Episodes that have the figure, where not all do: {', '.join(notes)}." if notes else ""


# --- 10. missing -------------------------------------------------------------------------------------


def _missing(results: Results) -> Section:
    by_reason: dict[str, dict[str, list[str]]] = {}
    for skipped in results.plan.skipped:
        by_reason.setdefault(skipped.reason, {}).setdefault(skipped.environment, []).append(skipped.what)
    left_out = []
    for reason, where in by_reason.items():
        same: dict[str, list[str]] = {}
        for environment, names in where.items():
            same.setdefault(listed(names), []).append(environment)
        left_out += [f"{names} in {listed(places)}: {reason}." for names, places in same.items()]
    labels = _labels([*results.plan.cells, *examples(results.plan).values()])
    failed: dict[str, list[str]] = {}
    for key, why in results.failures.items():
        failed.setdefault((why.strip().splitlines() or ["no reason given"])[-1], []).append(labels.get(key, key))
    lost = [f"{_tally(names)}: {why}" for why, names in failed.items()]
    absent = [f for f in results.plan.flights if f.cell.key not in {*results.values, *results.failures}]
    blocks: list[Block] = []
    for title, items in (
        ("Left out, because the environment refuses it:", left_out),
        (
            "Failed (last line of the traceback; the rest is in the folder failed/), to be tried again in the next "
            "run:",
            lost,
        ),
        ("Not computed yet:", [_tally([_flown(f) for f in absent])] if absent else []),
        ("Notes:", results.notes),
    ):
        if items:
            blocks += [Prose(title), Bullets(list(items))]
    return Section("Left out and failed", blocks)


def _labels(cells: Iterable[Cell]) -> dict[str, str]:
    """What cells and those that they need are, by key."""
    found: dict[str, str] = {}
    for cell in cells:
        condition = cell.arguments.get("options", {})
        world = ", ".join(str(condition[name]) for name in AXES if name in condition)
        found[cell.key] = f"{cell.label} ({world})" if world else cell.label
        found |= _labels(cell.needs)
    return found


def _flown(flight: Flight) -> str:
    return f"{flight.agent} on {flight.flown_on} in {flight.environment}, {flight.condition}"


def _tally(names: Sequence[str]) -> str:
    """Names, or how many there are of them beside the first."""
    unique = list(dict.fromkeys(names))
    return listed(unique) if len(names) <= 3 else f"{names[0]} and {len(names) - 1} more"


# --- 11. limits ------------------------------------------------------------------------------------


def _limits(results: Results) -> Section:
    study = results.plan.study
    items = [
        "Intervals are for another study: other evaluation seeds and, of learned agents, other training runs. Seeds "
        "are the same for everybody, so that differences are paired, and both ends of a scale are drawn with them.",
        "Who is behind the best, and whether raw readings beat a filter, is corrected for the number of comparisons "
        "within a column. Other intervals stand each for itself: of twenty one misses, and none is corrected for the "
        "number of columns.",
        "All environments and conditions count alike in what is said of all of them.",
        "The truth is what the state is, not what the disturbance will do next: a ceiling for estimators, not for "
        "agents. An agent may keep more than 1.",
        "Estimators are tuned by their environments' authors, for each disturbance (see the settings below): they know "
        "its statistics. What is compared is an estimator with its tuning.",
        f"{FLOOR} runs the model on the known inputs and looks at no reading; measurement holds the last reading of "
        "each sensor and knows no model.",
        "Estimation errors are along the tracks that were flown on that estimator: the disturbance and the sensor "
        "noise are the same, the tracks are not.",
        "Everything is simulated: vehicles of published and assumed particulars. Nothing here was measured in the "
        "world.",
    ]
    if any(condition.mismatch for condition in study.conditions):
        items.append(
            "Mismatch spreads the truth's coefficients around the filters', drawn anew in each episode. The "
            "package's classical controllers are designed on the filters' coefficients, too: on the truth they know "
            "the state, not the vehicle."
        )
    else:
        items.append("There is no mismatch: the filters' coefficients are the vehicle's.")
    if study.learned:
        items += [
            "Training runs that differ in the agent alone share their seeds, and are compared in pairs. What five "
            "runs do not show, such as a failure in one training of twenty, no interval over them contains.",
            f"Agents learn in the first condition ({results.conditions[0]}) and fly the others as they are.",
            "Settings of PPO were tuned on an environment's default estimator (agents/ppo.toml), not for each "
            "estimator.",
            "What crossing estimators costs contains all that changes in what a policy sees, not the error alone: an "
            "unknown input that is no longer estimated, a noisier rate.",
        ]
    return Section("Assumptions and limits", [Bullets(items)])


# --- pieces ----------------------------------------------------------------------------------------


def _columns(environments: Sequence[str], together: bool) -> tuple[list[str], list[Sequence[str]]]:
    """Headings, and the environments that each stands for: every one, and before them perhaps all together."""
    each: list[Sequence[str]] = [[e] for e in environments]
    return ([ALL, *environments], [environments, *each]) if together else (list(environments), each)


def _figure(figure: Any, title: str, caption: str) -> Figure:
    return Figure(data_uri(figure), title, caption)
