"""Effects of the factors of a study on the score.

A factor is something in which conditions differ (sensors, their rate, the disturbance, the model
error, latency, faults), the estimator, the tuning or the agent. Effects are differences of the
score from that at the factor's reference level, all other factors being equal. They are means with
equal weights over complete cells: combinations of the other factors in which both levels have a
result. Raw measurements and the ends of the scale are no levels of the estimator. Where arms are
tuned several times, intervals are for other tunings, too.
"""

import re
from collections.abc import Sequence
from itertools import pairwise
from math import prod
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from agents.page import named
from agents.statistics import Interval
from agents.studies.ranking import interval
from agents.studies.records import Condition
from agents.studies.results import Results, at
from agents.studies.worlds import AT_RATE
from vessel_gym.sensors.grades import NOMINAL

ESTIMATOR, AGENT, RUN = "estimator", "agent", "run"
_TUNING = "tuning", "delivered parameters", "tuned parameters"
"""The factor, its reference and its other level."""
_NO_CHANGE = Interval(0.0, 0.0, 0.0)
_NUMBER = re.compile(r"(\d+(?:\.\d+)?(?:e[+-]\d+)?) (?:%|s\b|Hz\b)")
"""Pattern of a number with its unit in the name of a level."""


class Effect(NamedTuple):
    """A factor with its reference level and its best and worst levels.

    ``gain`` and ``loss`` are the scores at the last two minus that at the reference. Their
    intervals hold for all levels at once, because the best is selected in the same episodes.
    ``trend`` are the steps from level to level with each of which the score moves one way, if any.
    """

    factor: str
    reference: str
    best: str
    gain: Interval
    worst: str
    loss: Interval
    trend: list[Interval]


class Interaction(NamedTuple):
    """A change of the difference of a level from its reference, ``at`` a level of another factor.

    The change is from that difference at the first level of the ``other`` factor.
    """

    environment: str
    factor: str
    level: str
    other: str
    at: str
    change: Interval


def levels(condition: Condition) -> dict[str, str]:
    """Level of each factor in a condition."""
    sensors, rates = condition.sensors, {}
    if isinstance(sensors, dict):
        found = {name: AT_RATE.fullmatch(words) for name, words in sensors.items()}
        rates = {name: f"{rate[2]} Hz" for name, rate in found.items() if rate}
        grades = {name: rate[1] if rate else sensors[name] for name, rate in found.items()}
        sensors = named({name: words for name, words in grades.items() if words != NOMINAL})
    return {
        "sensors": sensors or NOMINAL,
        "sensor rate": named(rates) or "its own",
        "disturbance": condition.disturbance,
        "model error": f"{100 * condition.mismatch:g} %",
        "latency": named({name: f"{delay:g} s" for name, delay in condition.latency.items()})
        or "none",
        "faults": ", ".join(f"{f['sensor']}: {f['kind']}" for f in condition.faults) or "none",
    }


def _varying(conditions: list[Condition]) -> pd.DataFrame:
    """Levels of the factors that vary, by condition; those that change together are one factor."""
    table = pd.DataFrame([levels(c) for c in conditions], index=[c.name for c in conditions])
    groups: dict[tuple[int, ...], list[str]] = {}
    for name in table:
        if table[name].nunique() > 1:
            groups.setdefault(tuple(pd.factorize(table[name])[0]), []).append(name)
    joined = {" and ".join(g): table[g].agg(", ".join, axis=1) for g in groups.values()}
    return pd.DataFrame(joined, index=table.index)


def cells(results: Results, environment: str) -> pd.DataFrame:
    """Scores of the classical agent on filters, a row for each cell and run, a column a seed."""
    factors = _varying([c for c in results.plan.study.conditions if c.is_in(environment)])
    own = at(results.score, environment=environment, policy=results.compared)
    own = own[own.index.get_level_values(ESTIMATOR).isin(results.filters(environment))]
    keys = [*factors, ESTIMATOR, RUN]
    return own.join(factors, on="condition").groupby(keys, sort=False).mean()


def contrasts(table: pd.DataFrame, factor: str, reference: str) -> dict[str, pd.DataFrame]:
    """Differences of `cells` from those at the reference, by level, where both have a result."""
    base, found = at(table, **{factor: reference}), {}
    for level in table.index.unique(factor).drop(reference, errors="ignore"):
        rows = at(table, **{factor: level})
        if len(gaps := (rows - base.reindex(rows.index)).dropna()):
            found[level] = gaps
    return found


Contrasts = dict[str, tuple[str, dict[str, pd.DataFrame]]]
"""Reference of each factor, and differences of its other levels, a row for each cell and run."""
Place = dict[str, pd.DataFrame]
"""Differences from the reference in an environment by level, a row for each run."""


def _by_cell(results: Results, environment: str) -> Contrasts:
    """Contrasts of the conditions and of the estimators of the classical agent."""
    table, found = cells(results, environment), {}
    for factor in table.index.names[:-1] if len(table) else ():
        names = [str(name) for name in table.index.unique(factor)]
        first = results.reference(environment, names) if factor == ESTIMATOR else names[0]
        if each := contrasts(table, factor, first):
            found[factor] = first, each
    return found


def _policies(results: Results, environment: str) -> Contrasts:
    """Contrasts of the tuning and of other agents.

    A tuned agent is compared on every filter, any other one on its home estimator.
    """
    score, classical = at(results.score, environment=environment), results.classical
    found: Contrasts = {}
    for policy in score.index.unique("policy").drop(classical, errors="ignore"):
        tuned = policy == results.compared
        names = results.filters(environment) if tuned else [results.home(environment, policy)]
        own = score[score.index.get_level_values(ESTIMATOR).isin(names)]
        ours, theirs = (at(own, policy=name) for name in (policy, classical))
        base = theirs.droplevel(RUN).reindex(ours.index.droplevel(RUN)).to_numpy()
        if len(gaps := (ours - base).dropna()):
            factor, first, level = _TUNING if tuned else (AGENT, classical, policy)
            found.setdefault(factor, (first, {}))[1][level] = gaps
    return found


def _by_run(reference: str, gaps: dict[str, pd.DataFrame]) -> Place:
    """Means of differences over the cells of each run that lacks none; of the reference 0."""
    runs = {level: rows.groupby(RUN, sort=False) for level, rows in gaps.items()}
    found = {level: of.mean()[of.size() == of.size().max()] for level, of in runs.items()}
    return {reference: 0.0 * next(iter(found.values()))} | found


def effects(results: Results) -> list[Effect]:
    """The effect of each factor, a mean over environments.

    The greatest significant gain comes first, and after the gains the greatest change. Each
    environment has its own best and worst levels.
    """
    each = [_by_cell(results, e) | _policies(results, e) for e in results.environments]
    found = []
    for factor in dict.fromkeys(name for own in each for name in own):
        places = [_by_run(*own[factor]) for own in each if factor in own]
        among = prod(len(place) - 1 for place in places)
        ends: list[Any] = [_one([next(iter(place)) for place in places], "first")]
        for sign, word in ((1.0, "best"), (-1.0, "worst")):
            names = [_extreme(place, sign) for place in places]
            values = _mean(places, names).to_numpy()
            change = interval(results, names[0], values, among) if values.any() else _NO_CHANGE
            ends += [_one(names, word), change]
        ends.append(_trend(results, places))
        found.append(Effect(factor, *ends))
    return sorted(
        found,
        key=lambda e: (-e.gain.mean * e.gain.excludes_zero, -max(e.gain.mean, -e.loss.mean)),
    )


def _mean(places: Sequence[Place], names: Sequence[str]) -> pd.DataFrame:
    """Mean of a level's differences over environments, in the runs that every environment has."""
    first, *others = (place[name] for place, name in zip(places, names, strict=True))
    return sum(others, first).dropna() / len(places)


def _one(names: Sequence[str], word: str) -> str:
    """The name of a level, if environments agree on it."""
    return names[0] if len(set(names)) == 1 else f"each environment's {word}"


def _extreme(place: Place, sign: float) -> str:
    """The level with the highest score, or with a negative sign the lowest."""
    return max(place, key=lambda name: sign * place[name].to_numpy().mean())


def _trend(results: Results, places: Sequence[Place]) -> list[Interval]:
    """Differences of the score between successive levels of a factor; empty without a trend.

    The levels of such a factor have numbers, such as rates, and are in the study's order. All
    differences are significant and have one sign. A trend needs all of them, so their intervals
    need no correction for several comparisons (intersection-union test, Berger 1982).
    """
    orders = {tuple(place) for place in places}
    if len(orders) > 1 or not _numbered(*orders):
        return []
    gaps = [_mean(places, [name] * len(places)) for name in places[0]]
    changes = (after - before for before, after in pairwise(gaps))
    steps = [interval(results, results.compared, c.dropna().to_numpy()) for c in changes]
    one_way = len({step.mean > 0.0 for step in steps}) == 1
    return steps if one_way and all(step.excludes_zero for step in steps) else []


def _numbered(levels: Sequence[str]) -> bool:
    """Are there three levels or more of one quantity, whose numbers only rise or only fall?

    The first level, the reference, may have no number.
    """
    numbers = [{*_NUMBER.findall(level)} for level in levels]
    quantities = {_NUMBER.sub("", level) for level in levels[1:]}
    one_each = len(numbers[0]) < 2 and all(len(each) == 1 for each in numbers[1:])
    if len(levels) < 3 or len(quantities) > 1 or not one_each:
        return False
    steps = np.diff([float(text) for each in numbers for text in each])
    return bool((steps > 0.0).all() or (steps < 0.0).all())


def interactions(results: Results) -> list[Interaction]:
    """Interactions that are larger than the main effect, beyond chance, the largest first.

    Of the two views of an interaction, the one with the smaller main effect comes first.
    """
    tried = [
        ((environment, factor, level, other, str(at)), by.loc[at] - by.loc[first], rows)
        for environment in results.environments
        for factor, (_, each) in _by_cell(results, environment).items()
        for level, rows in each.items()
        for other in rows.index.names[:-1]
        for by in [rows.groupby(level=[other, RUN], sort=False).mean()]
        for first, *others in [by.index.unique(other)]
        for at in others
    ]
    found = []
    for names, change, rows in tried:
        values, main = change.dropna().to_numpy(), abs(rows.to_numpy().mean())
        value = interval(results, results.compared, values, len(tried))
        if value.excludes_zero and abs(value.mean) > main:
            found.append((-round(abs(value.mean), 9), main, Interaction(*names, value)))
    return [each for *_, each in sorted(found, key=lambda item: item[:2])]
