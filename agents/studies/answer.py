"""The answer to a study, computed: the advice in a sentence, a small table, what else was found."""

import numpy as np

from agents.page import Table, listed, number
from agents.statistics import EQUIVALENT, UNDECIDED, WORSE, Interval
from agents.studies import shares
from agents.studies.confirmation import CONFIRMED, FAILED, OPEN, Confirmed, confirmed
from agents.studies.records import FEW_SEEDS, FLOOR, ORACLE
from agents.studies.results import Policy, Results
from agents.studies.wording import amount, capitalised, every, many, microseconds, named, percent, share_entry, the

BEST = 5
"""Number of estimators in the table at the head of a report."""


def answer(results: Results, fresh: Results | None = None) -> list[str]:
    """Sentences that answer the question of a study, the advice first.

    Args:
        results: Of a study.
        fresh: The same on the seeds of its confirmation.
    """
    if not results.environments:
        return ["Nothing has a result yet."]
    environments = shares.ruled(results)
    if not environments:
        sentences = [
            f"No estimator can be ranked: for that {the(results.classical)} has to fly {ORACLE}, {FLOOR} and an "
            f"estimator between them, and score higher on {ORACLE}."
        ]
    elif shares.common(results):
        sentences = _advice_for_all(results, environments)
    else:
        sentences = [line for environment in environments for line in _advice_for_one(results, environment)]
    sentences += _answer_of_learning(results)
    return [*sentences, *([] if fresh is None else _confirmation(confirmed(results, fresh))), _measured(results)]


def summary(results: Results) -> Table | None:
    """Table of the best estimators for the classical agent, if one ranking holds for all environments."""
    environments = shares.ruled(results)
    ranked = (
        shares.common(results)
        if len(environments) > 1
        else shares.rankable(results, environments)
        if environments
        else {}
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
    heads = [("share kept", ""), (f"score lost against {ORACLE}", ""), ("completed", "%"), ("worst decile", "score")]
    return Table(f"The best estimators for {the(results.classical)}", "", "Estimator", heads, [("", rows)])


def _advice_for_one(results: Results, environment: str) -> list[str]:
    ranked = shares.rankable(results, [environment])
    best = next(iter(ranked))
    return [
        f"Fly {best} in {environment}: {_worth(results, [environment], best, ranked)}.",
        *_standing(results, ranked, best),
        *_prices_in_time(results, [environment], best),
    ]


def _advice_for_all(results: Results, environments: list[str]) -> list[str]:
    everywhere = shares.common(results)
    pick = next(iter(everywhere))
    worth = _worth(results, environments, pick, everywhere)
    return [
        f"If one estimator is to fly in {every(environments)}, take {pick}: {worth}.",
        *_standing(results, everywhere, pick),
        _each_best(results, environments, pick),
        *_prices_in_time(results, environments, pick),
    ]


def _worth(results: Results, environments: list[str], best: str, ranked: dict[str, np.ndarray]) -> str:
    share = shares.kept(results, environments, results.classical, best, len(ranked))
    return (
        f"on it {the(results.classical)} keeps {amount(share)} of what knowing the truth is worth over dead reckoning, "
        f"and loses {amount(shares.loss(results, environments, best, len(ranked)))} of score against the truth"
    )


def _standing(results: Results, ranked: dict[str, np.ndarray], best: str) -> list[str]:
    """The verdicts on all others against the best."""
    found, margin = shares.verdicts(results, ranked, best), results.plan.study.margin
    if list(found) == [WORSE]:
        second = found[WORSE][0]
        return [f"Every other is worse; the next, {second}, keeps {_more_than(ranked, best, second)} less."]
    words = {EQUIVALENT: f"Equivalent to it (within ±{margin:g})", UNDECIDED: "Not decided", WORSE: "Worse"}
    return [f"{word}: {listed(found[each])}." for each, word in words.items() if each in found]


def _more_than(ranked: dict[str, np.ndarray], best: str, other: str) -> str:
    return amount(shares.gap(ranked, best, other))


def _each_best(results: Results, environments: list[str], pick: str) -> str:
    """The environments in which the pick for all of them is worse than their best, and by how much."""
    better, equal = [], []
    for environment in environments:
        ranked = shares.rankable(results, [environment])
        best = next(iter(ranked))
        if pick != best and pick in shares.verdicts(results, ranked, best).get(WORSE, ()):
            level = [n for n in shares.verdicts(results, ranked, best).get(EQUIVALENT, ()) if n != pick]
            tied = f" (equivalent: {listed(level)})" if level else ""
            better.append(f"in {environment} {best} keeps {_more_than(ranked, best, pick)} more than {pick}{tied}")
        else:
            equal.append(environment)
    text = "; ".join(better)
    if equal:
        text += ("; " if better else "") + f"in {listed(equal)} nothing is shown to be better than {pick}"
    text += "."
    return f"By environment the best differs: {text}" if better else capitalised(text)


def _confirmation(found: Confirmed) -> list[str]:
    """Claims of the first pass on the fresh seeds."""
    claims, seeds = found.claims, f"{found.episodes} fresh evaluation seeds"
    sentences = [f"On {seeds}, opened once, {found.best} keeps {amount(found.kept)}."] if found.best else []
    names = {word: [str(c) for c in claims if c.outcome == word] for word in (CONFIRMED, OPEN, FAILED)}
    total = sum(map(len, names.values()))
    if not total:
        return sentences
    text = [f"{word}: {listed(names[word])}" for word in (OPEN, FAILED) if names[word]]
    verb = "is" if total == 1 else "are"
    first = f"{len(names[CONFIRMED])} of {many(total, 'claim')} of the first seeds {verb} confirmed"
    return [*sentences, "; ".join([first, *text]) + "."]


def _prices_in_time(results: Results, environments: list[str], estimator: str) -> list[str]:
    """CPU time of a step on an estimator, beside one on the truth that was flown in turns with it."""
    times = [found[0][1:] for e in environments if (found := results.step_times(e, estimator))]
    if not times:
        return []
    spans = []
    for each in zip(*times, strict=True):
        low, high = (microseconds(value) for value in (min(each), max(each)))
        spans.append(low if low == high else f"{low} to {high}")
    return [
        f"A step on {estimator} takes {spans[0]} µs of CPU in a batch, vehicle and agent included; on the truth "
        f"{spans[1]} µs."
    ]


def _answer_of_learning(results: Results) -> list[str]:
    """Learned agents against the classical one, filters against memory, and the cost of crossing estimators."""
    reference, sentences = shares.reference_policy(results), []
    if reference is not None:
        each = {e: shares.against_classical(results, e, reference) for e in shares.shared(results, reference)}
        gaps = {e: gap for e, gap in each.items() if gap is not None}
        if gaps:
            who = f"{named(reference)}, flying the estimator of its training,"
            same = f"{the(results.classical)} on the same"
            if any(not isinstance(gap, Interval) or gap.excludes_zero for gap in gaps.values()):
                text = [f"{_more(gap)} in {e}" for e, gap in gaps.items()]
                sentences.append(f"{who} keeps {listed(text)} than {same}.")
            else:
                text = [f"{amount(gap, signed=True)} in {e}" for e, gap in gaps.items()]
                sentences.append(f"{who} is not significantly different from {same}: {listed(text)}.")
        sentences += _filter_or_memory(results, reference)
    return sentences + _crossings(results)


def _filter_or_memory(results: Results, reference: Policy) -> list[str]:
    """Learning on a filter against learning on measurements, with or without memory, in each environment."""
    raw, sentences = [policy for policy in shares.learners(results) if results.agent(policy).raw], []
    for environment in shares.shared(results, reference):
        each = {policy: shares.difference(results, [environment], reference, policy, len(raw)) for policy in raw}
        gaps = {policy: gap for policy, gap in each.items() if gap is not None}
        if gaps:
            text = [f"{_more(gap)} than {named(policy)}" for policy, gap in gaps.items()]
            sentences.append(
                f"In {environment} a filter in the loop {_verdict(list(gaps.values()))} learning on raw measurements: "
                f"{named(reference)} keeps {listed(text)}."
            )
    return sentences


def _verdict(gaps: list[Interval | float]) -> str:
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


def _crossings(results: Results) -> list[str]:
    """Cost of flying on an estimator that the policy was not trained on."""
    found = [(e, cost) for e in results.environments if (cost := shares.crossing(results, e)) is not None]
    if found:
        text = listed([f"{_less(cost)} in {e}" for e, cost in found])
        return [f"On an estimator that another policy was trained on, a policy keeps {text} than that one."]
    return []


def _more(gap: Interval | float) -> str:
    """A difference in words: how much more, or less."""
    if not isinstance(gap, Interval):
        return f"{number(abs(gap), 3)} {'less' if gap < 0.0 else 'more'} (one run, no interval)"
    size = amount(_turned(gap) if gap.mean < 0.0 else gap)
    return f"{size} {'less' if gap.mean < 0.0 else 'more'}" + ("" if gap.excludes_zero else " (not significant)")


def _less(gap: Interval | float) -> str:
    return _more(_turned(gap) if isinstance(gap, Interval) else -gap)


def _turned(gap: Interval) -> Interval:
    """The same difference the other way round."""
    return Interval(-gap.mean, -gap.high, -gap.low)


def _measured(results: Results) -> str:
    study = results.plan.study
    words = (
        f"(Means over {study.episodes} evaluation seeds, the same for everybody, in "
        f"{many(len(study.conditions), 'condition')}, with 95 % intervals for other seeds; those of estimators "
        "and their verdicts hold for all estimators at once"
    )
    if study.learned:
        words += f"; learned agents: means over {many(study.training_seeds, 'training run')}, for other runs, too"
        words += ", too few to say what another training would give" if study.training_seeds < FEW_SEEDS else ""
    missing = len(results.plan.flights) - sum(f.job.key in results.values for f in results.plan.flights)
    return words + (f"; {missing} of {len(results.plan.flights)} flights have no result" if missing else "") + ".)"
