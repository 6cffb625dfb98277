"""The answer to a study, computed: the advice in a sentence, a small table, what else was found."""

from collections.abc import Collection, Iterator

import numpy as np

from agents.metrics import STEERING, metrics
from agents.page import Table, listed, number, words
from agents.statistics import EQUIVALENT, LOWER, UNDECIDED, WORSE, Interval
from agents.studies import shares
from agents.studies.ranking import beyond
from agents.studies.records import ORACLE
from agents.studies.results import Results
from agents.studies.wording import (
    amount,
    every,
    grouped,
    microseconds,
    named,
    note,
    percent,
    share_entry,
)
from agents.studies.worlds import system_of

BEST = 5
"""Number of estimators in the table at the head of a report."""


def answer(results: Results) -> list[str]:
    """Sentences that answer the question of a study, the advice first."""
    if not results.environments:
        return ["Nothing has a result yet."]
    environments, everywhere = shares.ruled(results), shares.common(results)
    if not environments:
        sentences = [note("no-ranking", results), *_scored(results)]
    elif everywhere:
        sentences = _advice(results, environments, everywhere)
    else:
        sentences = [
            line
            for e in environments
            for line in _advice(results, [e], shares.rankable(results, [e]))
        ]
    return [*sentences, *_learned(results), _measured(results)]


def summary(results: Results) -> Table | None:
    """Table of the best estimators for the classical agent, if one ranking holds for all environments."""
    environments = shares.ruled(results)
    ranked = (
        shares.rankable(results, environments) if len(environments) == 1 else shares.common(results)
    )
    if not ranked:
        return None
    places, who = results.scaled(environments), results.classical
    rows = [
        (name, [share_entry(shares.kept(results, environments, who, name, len(ranked))),
                share_entry(shares.loss(results, environments, name, len(ranked))),
                percent(results.completed(places, who, name)),
                share_entry(results.worst_decile(places, who, name))])
        for name in list(ranked)[:BEST]
    ]  # fmt: skip
    heads = [
        ("share kept", ""),
        (f"score lost against {ORACLE}", ""),
        ("completed", "%"),
        ("worst decile", "score"),
    ]
    return Table(f"The best estimators for {results.who}", "", "Estimator", heads, [("", rows)])


def _advice(results: Results, environments: list[str], ranked: dict[str, np.ndarray]) -> list[str]:
    """The estimator to fly in an environment, or in all: the cheapest of the best. How others stand, and its costs."""
    best, who, alone = next(iter(ranked)), results.classical, len(environments) == 1
    where = environments[0] if alone else every(environments)
    if enough := shares.episodes_to_tell(results, environments, ranked):
        return [note("too-few", results, where=where, best=best, enough=enough)]
    pick = shares.cheapest(results, environments, ranked)
    kept = amount(shares.kept(results, environments, who, pick, len(ranked)))
    lost = amount(shares.loss(results, environments, pick, len(ranked)))
    return [
        note(
            "advice", results, alone=alone, pick=pick, best=best, where=where, kept=kept, lost=lost
        ),
        *_standing(results, environments, ranked),
        *([] if alone else [_each_best(results, environments, pick)]),
        *(_steering(results, where, pick) if alone else []),
        *_prices_in_time(results, environments, pick),
    ]


def _scored(results: Results) -> Iterator[str]:
    """Mean scores in environments in which nothing can be ranked: on the ends of the scale, and on the best other."""
    for environment in results.environments:
        place, who = results.places([environment])[0], results.classical
        names = results.estimators(environment, who)
        means = {
            name: mean for name in names if (mean := results.mean(place, who, name)) is not None
        }
        others = sorted(means.keys() - set(shares.ENDS), key=lambda name: -means[name].mean)
        each = [
            f"{amount(means[name])} on {name}"
            for name in (*shares.ENDS, *others[:1])
            if name in means
        ]
        if each:
            yield note("scored", results, place=place, each=each)


def _standing(
    results: Results, environments: list[str], ranked: dict[str, np.ndarray]
) -> list[str]:
    """The verdicts on all others against the best."""
    best, margin = next(iter(ranked)), results.plan.study.margin
    found = grouped(
        (each, name) for name, each in shares.verdicts(results, environments, ranked).items()
    )
    if list(found) == [WORSE]:
        second = found[WORSE][0]
        return [
            f"Every other is worse; the next, {second}, keeps"
            f" {amount(shares.gap(ranked, best, second))} less."
        ]
    words = {
        EQUIVALENT: f"Equivalent to {best} (within ±{margin:g})",
        UNDECIDED: "Not decided",
        LOWER: f"Lower, perhaps by less than {margin:g}",
        WORSE: f"Worse, by more than {margin:g}",
    }
    return [f"{word}: {listed(found[each])}." for each, word in words.items() if each in found]


def _each_best(results: Results, environments: list[str], pick: str) -> str:
    """The environments in which the pick for all of them keeps less than their best, and by how much."""
    better, equal = [], []
    for environment in environments:
        ranked = shares.rankable(results, [environment])
        best = next(iter(ranked))
        verdicts = shares.verdicts(results, [environment], ranked)
        if verdicts.get(pick) in (LOWER, WORSE):
            level = [name for name, found in verdicts.items() if found == EQUIVALENT]
            tied = f" (equivalent: {listed(level)})" if level else ""
            more = amount(shares.gap(ranked, best, pick))
            better.append(f"in {environment} {best} keeps {more} more than {pick}{tied}")
        else:
            equal.append(environment)
    return note("best-by-environment", results, better=better, equal=equal, pick=pick)


def _steering(results: Results, environment: str, estimator: str) -> list[str]:
    """Steering on an estimator beyond that on the truth, in the first condition."""
    place, known = results.places([environment])[0], metrics(system_of(environment))
    found = []
    for metric in (m for m in STEERING[:2] if m in known):
        more = beyond(results, place, results.classical, estimator, metric)
        truth = results.mean(place, results.classical, ORACLE, metric)
        found += (
            [(words(more, 1, signed=True), number(truth.mean, 1))]
            if isinstance(more, Interval) and truth
            else []
        )
    if len(found) < 2:
        return []
    (travel, travel_on_truth), (turns, turns_on_truth) = found
    return [
        note(
            "steering", results, condition=place.condition, travel=travel, travel_on_truth=travel_on_truth, turns=turns,
            turns_on_truth=turns_on_truth,
        )
    ]  # fmt: skip


def _prices_in_time(results: Results, environments: list[str], estimator: str) -> list[str]:
    """CPU time of a step on an estimator, beside one on the truth that was flown in turns with it."""
    times = [found[0][1:] for e in environments if (found := results.step_times(e, estimator))]
    ends = [[microseconds(end(each)) for end in (min, max)] for each in zip(*times, strict=True)]
    spans = [low if low == high else f"{low} to {high}" for low, high in ends]
    return (
        [note("times", results, estimator=estimator, own=spans[0], truth=spans[1])] if spans else []
    )


def _learned(results: Results) -> list[str]:
    """Learned agents against the classical one, and filters against memory."""
    found = {
        (e, other): gap for e, other, gap in shares.learned_differences(results) if gap is not None
    }
    gaps = {e: gap for (e, other), gap in found.items() if other == str(results.classical)}
    reference, sentences = named(str(shares.reference_policy(results))), []
    if gaps:
        sure = any(not isinstance(gap, Interval) or gap.excludes_zero for gap in gaps.values())
        text = [
            f"{_more(gap) if sure else amount(gap, signed=True)} in {e}" for e, gap in gaps.items()
        ]
        sentences.append(note("learned", results, reference=reference, sure=sure, gaps=text))
    raw: dict[str, dict[str, Interval | float]] = {}
    for (environment, other), gap in found.items():
        if other != str(results.classical):
            raw.setdefault(environment, {})[other] = gap
    for environment, others in raw.items():
        more = listed([f"{_more(gap)} than {named(name)}" for name, gap in others.items()])
        verb = _verb(others.values())
        sentences.append(
            note(
                "filter-or-memory",
                results,
                environment=environment,
                verb=verb,
                reference=reference,
                more=more,
            )
        )
    return sentences


def _verb(gaps: Collection[Interval | float]) -> str:
    """The verb that fits all differences, if they agree."""
    sure = [gap for gap in gaps if isinstance(gap, Interval)]
    if len(sure) == len(gaps):
        if all(gap.low > 0.0 for gap in sure):
            return "beats"
        if all(gap.high < 0.0 for gap in sure):
            return "is beaten by"
        if not any(gap.excludes_zero for gap in sure):
            return "is not significantly different from"
    return "compares as follows with"


def _more(gap: Interval | float) -> str:
    """A difference in words: how much more, or less."""
    mean = gap.mean if isinstance(gap, Interval) else gap
    word = "less" if mean < 0.0 else "more"
    if not isinstance(gap, Interval):
        return f"{number(abs(gap), 3)} {word} (one run, no interval)"
    size = gap.times(-1.0) if mean < 0.0 else gap
    return f"{amount(size)} {word}" + ("" if size.excludes_zero else " (not significant)")


def _measured(results: Results) -> str:
    flights = results.plan.flights
    missing = sum(flight.job.key not in results.values for flight in flights)
    return note("means", results, missing=missing, flights=len(flights))
