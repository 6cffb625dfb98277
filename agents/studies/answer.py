"""The answer to a study in computed sentences."""

import re
from collections.abc import Sequence
from itertools import pairwise

from agents.page import listed, words
from agents.statistics import (
    CLEARLY_WORSE,
    EQUIVALENT,
    SLIGHTLY_WORSE,
    UNDECIDED,
    Interval,
    mean_interval,
)
from agents.studies.effects import AGENT, effects, interactions, mean, significant
from agents.studies.ranking import ALL, Ranking, rankings
from agents.studies.records import Condition, beyond_the_truth
from agents.studies.results import Results


def answer(results: Results) -> list[str]:
    """Sentences that answer the question of a study, the most important first.

    They say what moves the score, which estimator to use and how ordered conditions change its
    score. The last say what is missing.
    """
    if not results.environments:
        return ["Nothing has a result yet.", *_missing(results)]
    found = dict(rankings(results))
    together = found.pop(ALL, None)
    first, *others = _effects(results) or [""]
    sentences = [first, " ".join(others)]
    sentences += [
        _trend(each) or _advice(each) for each in ([together] if together else found.values())
    ]
    if rest := [e for e in results.plan.study.environments if e not in found]:
        sentences.append(
            f"No estimator can be ranked in {listed(rest)}: for that {results.who} needs results on"
            " the truth, on dead reckoning and on an estimator between them, and a higher score on"
            " the truth."
        )
    suspicious = [
        f"{name} in {environment} ({amount(score)})"
        for environment, ranking in found.items()
        for name in ranking.scores
        if (score := ranking.score(name)) and score.low > 1.0
    ]
    sentences += [beyond_the_truth(suspicious, results.who)] if suspicious else []
    return [*filter(None, sentences), *_missing(results)]


# --- factors --------------------------------------------------------------------------------------


def _effects(results: Results) -> list[str]:
    """Sentences on levels that score more or less than their reference, and on the others."""
    found, who = effects(results), results.who
    gains = [e for e in found if significant(e.gain)]
    sentences = []
    for effect in gains:
        most = effect is found[0] and (len(found) == 1 or _exceeds(effect.gain, found[1].gain))
        start = "The greatest gain is" if most else "There is a gain"
        best, scores = effect.best, f"scores {amount(effect.gain)} more than"
        agent = effect.factor == AGENT
        does = f"{best} {scores}" if agent else f"with {best} {who} {scores} with"
        sentences.append(f"{start} from the {effect.factor}: {does} {effect.reference}.")
    if found and not gains:
        sentences.append("No level of any factor scores significantly more than its reference.")
    losses = [
        f"{e.worst} ({e.factor}: {amount(e.loss, True)})" for e in found if significant(e.loss)
    ]
    if losses:
        sentences.append(f"Score is lost with {listed(losses)}.")
    still = [
        f"{e.factor} ({amount(max(e.gain, e.loss, key=lambda v: abs(mean(v))), True)})"
        for e in found
        if not significant(e.gain) and not significant(e.loss)
    ]
    if still:
        sentences.append(f"No significant effect: {listed(still)}.")
    for one in interactions(results)[:1]:
        sentences.append(
            f"In {one.environment} the effect of the {one.factor} depends on the"
            f" {one.other}: with {one.at} the difference that {one.level} makes changes by"
            f" {amount(one.change, True)}."
        )
    return sentences


def _exceeds(one: Interval | float | None, other: Interval | float | None) -> bool:
    """True if a gain exceeds the next one by more than their intervals."""
    halves = [value.half for value in (one, other) if isinstance(value, Interval)]
    return mean(one) - mean(other) > sum(halves)


# --- estimators -----------------------------------------------------------------------------------


def _advice(ranking: Ranking) -> str:
    """The estimator to use: the best, with its score and the others' verdicts."""
    best, where, who = ranking.best, _where(ranking.environments), ranking.results.who
    if enough := ranking.episodes_to_tell():
        more = f" By their scatter, at least {enough:.0f} are needed." if enough > 0 else ""
        return (
            f"{ranking.results.plan.study.episodes} episodes cannot tell which estimator to use in"
            f" {where}. So far {best} has the highest normalised score.{more}"
        )
    score = ranking.score(best)
    percent = f"{100.0 * score.mean:.0f} %" if score else "–"
    return (
        f"Use {best} in {where}: with it {who} reaches {percent} of the way from dead reckoning to"
        f" perfect state knowledge (normalised score {amount(score)}), and scores"
        f" {amount(ranking.loss(best))} less than with the truth. {_standing(ranking)}"
    )


def _where(environments: Sequence[str]) -> str:
    few = {1: environments[0], 2: "both environments"}
    return few.get(len(environments), f"all {len(environments)} environments")


def _standing(ranking: Ranking) -> str:
    """Verdicts on the other estimators against the best."""
    found = ranking.verdicts
    if not found:
        return "No other estimator was compared."
    sentences = []
    for word in (EQUIVALENT, UNDECIDED, SLIGHTLY_WORSE):
        if names := [name for name in found if found[name] == word]:
            more = max(map(ranking.episodes_to_decide, names))
            needed = f" (at most about {more:.0f} more episodes needed)" * (word == UNDECIDED)
            sentences.append(f"{word.capitalize()}: {listed(names)}{needed}.")
    if CLEARLY_WORSE in found.values():
        sentences.append("All other estimators are clearly worse.")
    return " ".join(sentences)


# --- conditions that are numbers ------------------------------------------------------------------


def ordered(conditions: Sequence[Condition]) -> bool:
    """True for conditions whose names are numbers that only rise or only fall: 10 Hz, 5 Hz, 1 Hz.

    The first may have another name.
    """
    names = [c.name for c in conditions]
    steps = [b - a for a, b in pairwise(_numbers(names) or _numbers(names[1:]))]
    return bool(steps) and (min(steps) > 0.0 or max(steps) < 0.0)


def _numbers(names: Sequence[str]) -> list[float]:
    """The numbers in names that differ in one number alone; none for other names."""
    number = r"\d*\.?\d+"
    if len({re.sub(number, "", name) for name in names}) != 1:
        return []
    each = zip(*(re.findall(number, name) for name in names), strict=True)
    varying = [values for values in each if len(set(values)) > 1]
    return [float(value) for value in varying[0]] if len(varying) == 1 else []


def _trend(ranking: Ranking) -> str | None:
    """The best estimator's score over `ordered` conditions that all environments have, or None.

    Changes from the first condition are paired by seed; their intervals hold for all estimators at
    once. Then comes the first condition with a significant loss.
    """
    results, environments, pick = ranking.results, ranking.environments, ranking.best
    conditions = [c for c in results.plan.study.conditions if all(map(c.is_in, environments))]
    places = [[(e, c.name) for e in environments] for c in conditions]
    if not ordered(conditions) or not all(p in results.scales.index for at in places for p in at):
        return None
    own = results.rows(results.normalised, pick)
    first, *others = [own.loc[at].mean().to_numpy() for at in places]
    names = [
        c.name if re.fullmatch(r"[\d.]+ ?\S*", c.name) else f'"{c.name}"'  # a number and a unit
        for c in conditions
    ]
    comparisons = len(ranking.scores) * len(others)
    found = [mean_interval(scores - first, comparisons) for scores in others]
    each = [
        f"{amount(change, signed=True)} at {name}"
        for name, change in zip(names[1:], found, strict=True)
    ]
    lost = [name for name, of in zip(names[1:], found, strict=True) if of and of.high < 0.0]
    last = f"The first significant loss is at {lost[0]}." if lost else "No loss is significant."
    return (
        f"In {_where(environments)}, {pick} is best over all conditions. At {names[0]} its"
        f" normalised score is {amount(mean_interval(first))}, and from there it changes by"
        f" {listed(each)}. {last}"
    )


# --- what is missing, and numbers -----------------------------------------------------------------


def _missing(results: Results) -> list[str]:
    missing, flights = results.missing, results.plan.flights
    if not missing:
        return []
    failed = [f.job.label for f in missing if f.job.key in results.outcome.failures]
    why = f"; {len(failed)} failed, the first: {failed[0]}" if failed else ""
    return [f"{len(missing)} of {len(flights)} results are missing{why}. Run the study again."]


def amount(value: Interval | float | None, signed: bool = False) -> str:
    """A score in a sentence, with a digit more where its interval is small."""
    wide = isinstance(value, Interval) and value.half >= 0.095
    return words(value, 2 if wide else 3, signed)
