"""Sections of a report: who keeps how much, by how much others are behind, and what estimates cost in score."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from agents.metrics import SCORE, Metric, metrics
from agents.page import Block, Entry, Prose, Section, Table, entry, number
from agents.statistics import WORSE, Interval
from agents.studies.figures import Row, dots, framed, looks, share_rows
from agents.studies.records import FLOOR, ORACLE, RAW
from agents.studies.results import Place, Policy, Results
from agents.studies.shares import (
    ENDS,
    columns,
    common,
    gap,
    kept,
    learners,
    rankable,
    ruled,
    verdicts,
)
from agents.studies.wording import (
    file_name,
    grouped,
    note,
    paragraphs,
    percent,
    share_entry,
    tabled,
)
from agents.studies.worlds import system_of


def ranking(results: Results) -> Section:
    """Shares kept on estimators, and their differences from the best."""
    title = "Which estimator to fly"
    environments = ruled(results)
    blocks: list[Block] = [Prose(note("scale", results))]
    if results.environments:
        blocks += [Prose(text) for text in (note("ruler", results), *_rulers(results))]
    if not environments:
        return Section(title, blocks if results.environments else [])
    together = bool(common(results))
    by_head = columns(environments, together)
    heads = list(by_head)
    names = ranked_names(results, environments)
    look = looks(results)
    best = {head: rankable(results, column) for head, column in by_head.items()}

    def shares(name: str) -> list[Interval | float | None]:
        return [
            kept(results, by_head[head], results.classical, name, max(len(best[head]), 1))
            for head in by_head
        ]

    rows = [Row(name, look[name], shares(name)) for name in (*names, *ENDS)]
    figure = dots(rows, heads, "share of the oracle's performance kept")
    (heading, text), pairs = (
        paragraphs("ranking", results, together=together),
        [(head, "") for head in heads],
    )
    blocks += [
        framed(figure, "shares-figure", results, together=together),
        Table(heading, text, "Estimator", pairs, [("", share_rows(rows))], "ranking"),
        _differences(results, names, by_head, best),
    ]
    return Section(title, blocks + _learned_ranking(results, by_head, names))


def _differences(
    results: Results,
    names: list[str],
    by_head: Mapping[str, Sequence[str]],
    best: Mapping[str, dict[str, np.ndarray]],
) -> Table:
    """The estimators against the best of each column."""
    found = {head: verdicts(results, by_head[head], ranked) for head, ranked in best.items()}
    behind = [
        (name, [_behind(ranked, found[head], name) for head, ranked in best.items()])
        for name in names
    ]
    (title, text), pairs = paragraphs("behind-the-best", results), [(head, "") for head in best]
    return Table(title, text, "Estimator", pairs, [("", behind)], "behind-the-best")


def _learned_ranking(
    results: Results, by_head: Mapping[str, Sequence[str]], names: list[str]
) -> list[Block]:
    """The same for agents that learned: everybody on every estimator."""
    sections = {
        str(policy): [
            (
                name,
                [share_entry(kept(results, column, policy, name)) for column in by_head.values()],
            )
            for name in (*names, *ENDS)
        ]
        for policy in (p for p in learners(results) if not results.agent(p).raw)
    }
    return tabled("ranking-learned", results, list(by_head), sections, "Flown on")


def ranked_names(results: Results, environments: list[str]) -> list[str]:
    """Every estimator but the ends: those that flew everywhere first, by what they keep; last what has no share."""
    everywhere = list(common(results))
    each = (rankable(results, [environment]) for environment in environments)
    means = grouped(
        (name, float(values.mean())) for ranked in each for name, values in ranked.items()
    )
    others = sorted(
        (n for n in means if n not in everywhere), key=lambda n: -float(np.mean(means[n]))
    )
    flown = (name for e in environments for name in results.estimators(e, results.classical))
    return list(
        dict.fromkeys([*everywhere, *others, *(name for name in flown if name not in ENDS)])
    )


def _behind(ranked: dict[str, np.ndarray], verdicts: Mapping[str, str], name: str) -> Entry:
    if name not in ranked:
        return Entry("–")
    best = next(iter(ranked))
    if name == best:
        return Entry("best")
    difference = gap(ranked, name, best)
    found, share = verdicts[name], share_entry(difference, signed=True)
    return Entry(f"{share}, {found}" if difference is not None else "–", strong=found == WORSE)


def _rulers(results: Results) -> list[str]:
    """Places without a scale, and those whose scale may be chance."""
    none, doubtful = [], []
    for place in results.places():
        worth = results.price([place], results.classical, FLOOR)
        where = f"{place.environment}, {place.condition}"
        if results.scale(place) is None:
            none.append(where)
        elif isinstance(worth, Interval) and not worth.excludes_zero:
            doubtful.append(where)
    texts = {"no-scale": none, "doubtful-scale": doubtful}
    return [note(name, results, places="; ".join(of)) for name, of in texts.items() if of]


def price(results: Results) -> Section:
    """Score lost against the truth."""
    sections = {}
    for environment in results.environments:
        places, flown = results.places([environment]), _flown(results, environment, (RAW, ORACLE))
        each = [Place(environment, condition) for condition in results.conditions]
        sections[environment] = [
            (
                label,
                [
                    share_entry(results.price([at], who, on) if at in places else None, signed=True)
                    for at in each
                ],
            )
            for label, who, on in flown
            if on != ORACLE
        ]
    table = tabled("price", results, results.conditions, sections, learned=learners(results))
    return Section("The price of estimation", [*_price_figure(results), *table] if table else [])


def costs(results: Results) -> Section:
    """Costs of the vehicle's owner beyond those of the classical agent on the truth."""
    blocks: list[Block] = []
    for environment in results.environments:
        place = results.places([environment])[0]
        chosen = [SCORE, *(m for m in metrics(system_of(environment)) if m.cost)]
        on_truth = [
            entry(results.mean(place, results.classical, ORACLE, m), m.decimals) for m in chosen
        ]
        rows = [
            (label, [_difference(beyond(results, place, who, on, m), m.decimals) for m in chosen])
            for label, who, on in _flown(results, environment)
            if (who, on) != (results.classical, ORACLE)
        ]
        sections = {f"On the {ORACLE}": [(ORACLE, on_truth)], f"More than on the {ORACLE}": rows}
        values: dict[str, Any] = {"place": place, "metrics": chosen, "learned": learners(results)}
        heads, file = [(m.label, m.unit) for m in chosen], file_name("costs", environment)
        blocks += tabled("costs", results, heads, sections, file=file, **values)
    return Section("What the owner pays", blocks)


def beyond(
    results: Results, place: Place, who: Policy, on: str, metric: Metric
) -> Interval | float | None:
    """Mean difference of a metric from that of the classical agent on the truth at the same seeds.

    Seeds that lack it in a run are left out; None where either was not flown, a number for one
    training run.
    """
    ours, truth = (
        results.figure(place, *each, metric.key)
        for each in ((who, on), (results.classical, ORACLE))
    )
    if ours is None or truth is None:
        return None
    more = ours - truth
    more = more[:, np.isfinite(more).all(axis=0)]
    return results.interval(who, more) if more.size else None


def _difference(value: Interval | float | None, decimals: int) -> Entry:
    return (
        Entry(number(value, decimals, True))
        if isinstance(value, float)
        else entry(value, decimals, signed=True)
    )


def _flown(
    results: Results, environment: str, without: tuple[str, ...] = ()
) -> list[tuple[str, Policy, str]]:
    """Label, policy and estimator: the classical agent on every one, learned agents at home, but on those left out."""
    names = results.estimators(environment, results.classical)
    found = [(name, results.classical, name) for name in names]
    for policy in (p for p in results.policies(environment) if results.agent(p).learned):
        own = results.own(environment, policy)
        if own not in without:
            found.append((str(policy) if own == RAW else f"{policy}, on {own}", policy, own))
    return found


def _price_figure(results: Results) -> list[Block]:
    """Score lost on each estimator but the ends, beside which the others could not be told apart."""
    environments, look = ruled(results), looks(results)
    names = ranked_names(results, environments)
    lost = {
        name: [results.price(results.scaled([e]), results.classical, name) for e in environments]
        for name in names
    }
    rows = [
        Row(name, look[name], values)
        for name, values in lost.items()
        if any(v is not None for v in values)
    ]
    if not rows:
        return []
    figure = dots(rows, environments, "score lost against the truth", (0.0,))
    return [framed(figure, "price-figure", results)]


# --- tails ----------------------------------------------------------------------------------------


def tails(results: Results) -> Section:
    """Tails beside means: completed episodes, and the worst tenth."""
    sections = {
        e: [
            (label, _tail(results, results.places([e]), who, on))
            for label, who, on in _flown(results, e)
        ]
        for e in results.environments
    }
    heads = "Score", ("Completed", "%"), ("Worst decile", "score")
    return Section("Tails", tabled("tails", results, heads, sections))


def _tail(results: Results, places: Sequence[Place], who: Policy, on: str) -> list[Entry]:
    found = (results.figure(place, who, on) for place in places)
    flown = [scores for scores in found if scores is not None]
    alike = len({scores.shape for scores in flown}) == 1
    score = results.interval(who, np.mean(np.array(flown), axis=0)) if alike else None
    return [
        share_entry(score),
        percent(results.completed(places, who, on)),
        share_entry(results.worst_decile(places, who, on)),
    ]
