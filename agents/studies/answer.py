"""The answer to a study in computed sentences."""

from agents.page import listed, text
from agents.statistics import CLEARLY_WORSE, EQUIVALENT, SLIGHTLY_WORSE, UNDECIDED
from agents.studies.effects import AGENT, effects, interactions
from agents.studies.ranking import ALL, Ranking, rankings
from agents.studies.records import ENDS, beyond_the_truth
from agents.studies.results import Results


def answer(results: Results) -> list[str]:
    """Sentences that answer the question of a study, the most important first.

    They say what moves the score and which estimator to use. The last say what is missing.
    """
    if not results.environments:
        return ["Nothing has a result yet.", *_missing(results)]
    found = dict(rankings(results))
    together = found.pop(ALL, None)
    first, *others = _effects(results) or [""]
    sentences = [first, " ".join(others)]
    sentences += map(_advice, [together] if together else found.values())
    if rest := [e for e in results.plan.study.environments if e not in found]:
        sentences.append(
            f"No estimator can be ranked in {listed(rest)}: for that {results.who} needs results on"
            " the truth, on dead reckoning and on an estimator between them, and a higher score on"
            " the truth."
        )
    suspicious = [
        f"{name} in {environment} ({text(score)})"
        for environment, ranking in found.items()
        for name in ranking.scores
        if (score := ranking.score(name)).low > 1.0
    ]
    sentences += [beyond_the_truth(suspicious, results.who)] if suspicious else []
    return [*filter(None, sentences), *_missing(results)]


# --- factors --------------------------------------------------------------------------------------


def _effects(results: Results) -> list[str]:
    """Sentences on levels that score more or less than their reference, and on the others."""
    found, who = effects(results), results.who
    gains = [e for e in found if e.gain.excludes_zero]
    sentences = []
    for effect in gains:
        best, scores = effect.best, f"scores {text(effect.gain)} more than"
        agent = effect.factor == AGENT
        does = f"{best} {scores}" if agent else f"with {best} {who} {scores} with"
        sentences.append(f"There is a gain from the {effect.factor}: {does} {effect.reference}.")
    if found and not gains:
        sentences.append("No level of any factor scores significantly more than its reference.")
    losses = [
        f"{e.worst} ({e.factor}: {text(e.loss, signed=True)})"
        for e in found
        if e.loss.excludes_zero
    ]
    if losses:
        sentences.append(f"Score is lost with {listed(losses)}.")
    for effect in (e for e in found if e.trend):
        moves = "rises" if effect.trend[0].mean > 0.0 else "falls"
        steps = listed([text(step, signed=True) for step in effect.trend])
        sentences.append(f"The score {moves} with each step of the {effect.factor}: {steps}.")
    still = [
        f"{e.factor} ({text(max(e.gain, e.loss, key=lambda v: abs(v.mean)), signed=True)})"
        for e in found
        if not e.gain.excludes_zero and not e.loss.excludes_zero
    ]
    if still:
        sentences.append(f"No significant effect: {listed(still)}.")
    for one in interactions(results)[:1]:
        sentences.append(
            f"In {one.environment} the effect of the {one.factor} depends on the"
            f" {one.other}: with {one.at} the difference that {one.level} makes changes by"
            f" {text(one.change, signed=True)}."
        )
    return sentences


# --- estimators -----------------------------------------------------------------------------------


def _advice(ranking: Ranking) -> str:
    """The estimator to use: the best, with its score and the others' verdicts."""
    best, where, who = ranking.best, listed(ranking.environments), ranking.results.who
    if not ranking.tells:
        return (
            f"{ranking.results.plan.study.episodes} episodes cannot tell which estimator to use in"
            f" {where}: more are needed. So far {best} has the highest normalised score."
        )
    score = ranking.score(best)
    return (
        f"Use {best} in {where}: with it {who} reaches {100.0 * score.mean:.0f} % of the way from"
        f" dead reckoning to perfect state knowledge (normalised score {text(score)})."
        f" {_standing(ranking)}"
    )


def _standing(ranking: Ranking) -> str:
    """Verdicts on the other estimators against the best."""
    found = ranking.verdicts
    if not found:
        return "No other estimator was compared."
    sentences = []
    for word in (EQUIVALENT, UNDECIDED, SLIGHTLY_WORSE, CLEARLY_WORSE):
        if names := [name for name in found if found[name] == word]:
            more = max(map(ranking.episodes_to_decide, names))
            needed = f" (at most about {more:.0f} more episodes needed)" * (word == UNDECIDED)
            sentences.append(f"{word.capitalize()}: {listed(names)}{needed}.")
    if partial := [*set(ranking.results.estimators()).difference(ranking.scores, ENDS)]:
        sentences.append(f"Not used in all environments: {listed(sorted(partial))}.")
    return " ".join(sentences)


# --- what is missing ------------------------------------------------------------------------------


def _missing(results: Results) -> list[str]:
    missing, flights = results.missing, results.plan.flights
    if not missing:
        return []
    failed = [f.job.label for f in missing if f.job.key in results.outcome.failures]
    why = f"; {len(failed)} failed, the first: {failed[0]}" if failed else ""
    return [f"{len(missing)} of {len(flights)} results are missing{why}. Run the study again."]
