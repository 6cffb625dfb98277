"""Effects of the factors of a study on the score.

A factor is something in which conditions differ (sensors, their rate, the disturbance, the model
error, latency, faults), the estimator, the tuning or the agent. Effects are differences of the
score from that at the factor's reference level, all other factors being equal. They are means with
equal weights over complete cells: combinations of the other factors in which every level has a
result. Raw measurements and the ends of the scale are no levels of the estimator.
"""

from collections.abc import Sequence
from functools import reduce
from math import prod
from typing import Any, NamedTuple

import pandas as pd

from agents.statistics import Interval, mean_interval
from agents.studies.ranking import interval
from agents.studies.records import Condition
from agents.studies.results import Results
from agents.studies.worlds import AT_RATE
from vessel_gym.sensors.grades import NOMINAL

ESTIMATOR, AGENT, TUNED = "estimator", "agent", "tuned"


class Effect(NamedTuple):
    """A factor with its reference level and its best and worst levels.

    ``gain`` and ``loss`` are the scores at the last two minus that at the reference. Their
    intervals hold for all levels at once, because the best is selected in the same episodes.
    """

    factor: str
    reference: str
    best: str
    gain: Interval | float | None
    worst: str
    loss: Interval | float | None


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


def mean(value: Interval | float | None) -> float:
    """The mean of an interval; 0 for no value."""
    return value.mean if isinstance(value, Interval) else value or 0.0


def significant(value: Interval | float | None) -> bool:
    """True for an interval without zero."""
    return isinstance(value, Interval) and value.excludes_zero


def levels(condition: Condition) -> dict[str, str]:
    """Level of each factor in a condition."""
    sensors, rates = condition.sensors, {}
    if isinstance(sensors, dict):
        found = {name: AT_RATE.fullmatch(words) for name, words in sensors.items()}
        rates = {name: f"{rate[2]} Hz" for name, rate in found.items() if rate}
        grades = {name: rate[1] if rate else sensors[name] for name, rate in found.items()}
        sensors = _listed({name: words for name, words in grades.items() if words != NOMINAL})
    return {
        "sensors": sensors or NOMINAL,
        "sensor rate": _listed(rates) or "its own",
        "disturbance": condition.disturbance,
        "model error": f"{100 * condition.mismatch:g} %",
        "latency": _listed({name: f"{delay:g} s" for name, delay in condition.latency.items()})
        or "none",
        "faults": ", ".join(f"{f['sensor']} {f['kind']}" for f in condition.faults) or "none",
    }


def _listed(each: dict[str, str]) -> str:
    return ", ".join(f"{name} {words}" for name, words in each.items())


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
    """Scores of the classical agent on filters, a row for each cell, a column for each seed."""
    study, table = results.plan.study, results.table
    factors = _varying([c for c in study.conditions if c.is_in(environment)])
    own = table[(table.environment == environment) & (table.policy == results.compared)]
    own = own[own.estimator.isin(results.filters(environment))].join(factors, on="condition")
    keys = ["environment", *factors, ESTIMATOR, "seed"]
    return own.groupby(keys, sort=False).score.mean().unstack("seed", sort=False)


def contrasts(table: pd.DataFrame, factor: str, reference: str) -> dict[str, pd.DataFrame]:
    """Differences of `cells` from those at the reference, by level, over the complete cells.

    Levels that leave no complete cell are left out, those with the fewest cells first.
    """
    each = {str(k): rows.droplevel(factor) for k, rows in table.groupby(level=factor, sort=False)}
    if reference not in each:
        return {}
    base = each.pop(reference)
    while each:
        complete = reduce(pd.Index.intersection, (rows.index for rows in each.values()), base.index)
        if len(complete):
            return {k: rows.loc[complete] - base.loc[complete] for k, rows in each.items()}
        del each[min(each, key=lambda k: len(each[k].index.intersection(base.index)))]
    return {}


def _by_cell(results: Results, environment: str) -> dict[str, tuple[str, dict[str, pd.DataFrame]]]:
    """Reference and `contrasts` of each factor of the classical agent."""
    table, found = cells(results, environment), {}
    for factor in table.index.names[1:] if len(table) else ():
        names = [str(name) for name in table.index.unique(factor)]
        first = results.reference(environment, names) if factor == ESTIMATOR else names[0]
        if each := contrasts(table, factor, first):
            found[factor] = first, each
    return found


def _policies(results: Results, environment: str) -> dict[str, tuple[str, dict[str, pd.DataFrame]]]:
    """References of tuning and agent, and differences ``(runs, seeds)`` of other policies.

    A tuned agent is compared on every filter, any other one on its home estimator.
    """
    score = results.wide("score").loc[[environment]]
    found: dict[str, tuple[str, dict[str, pd.DataFrame]]] = {}
    for policy in score.index.unique("policy").drop(results.classical, errors="ignore"):
        tuned = policy == f"{results.classical}, {TUNED}"
        each = []
        for name in results.filters(environment) if tuned else [results.home(environment, policy)]:
            ours, theirs = (results.rows(score, name, p) for p in (policy, results.classical))
            base = theirs.droplevel("run").reindex(ours.index.droplevel("run"))
            each.append((ours - base.to_numpy()).dropna())
        runs = pd.concat(each).groupby("run", sort=False)
        gaps = runs.mean()[runs.size() == runs.size().max()]  # those without a missing cell
        if len(gaps):
            of = ("tuning", "delivered", TUNED) if tuned else (AGENT, results.classical, policy)
            found.setdefault(of[0], (of[1], {}))[1][of[2]] = gaps
    return found


def effects(results: Results) -> list[Effect]:
    """The effect of each factor, a mean over environments.

    The greatest significant gain comes first, and after the gains the greatest change. Each
    environment has its own best and worst levels.
    """
    found, each = [], [
        {
            factor: (first, {k: rows.mean().to_frame().T for k, rows in of.items()})
            for factor, (first, of) in _by_cell(results, environment).items()
        }
        | _policies(results, environment)
        for environment in results.environments
    ]  # fmt: skip
    for factor in dict.fromkeys(name for own in each for name in own):
        places = [own[factor] for own in each if factor in own]
        among = prod(len(of) for _, of in places)
        ends: list[Any] = [_one([first for first, _ in places], "first")]
        for sign, word in ((1.0, "best"), (-1.0, "worst")):
            names, gaps = zip(*(_extreme(*place, sign) for place in places), strict=True)
            values = reduce(pd.DataFrame.add, gaps).dropna().to_numpy() / len(gaps)
            change = interval(results, names[0], values, among) if values.any() else None
            ends += [_one(names, word), change]
        found.append(Effect(factor, *ends))
    return sorted(
        found,
        key=lambda e: (-mean(e.gain) * significant(e.gain), -max(mean(e.gain), -mean(e.loss))),
    )


def _one(names: Sequence[str], word: str) -> str:
    """The name of a level, if environments agree on it."""
    return names[0] if len(set(names)) == 1 else f"each environment's {word}"


def _extreme(
    reference: str, gaps: dict[str, pd.DataFrame], sign: float
) -> tuple[str, pd.DataFrame]:
    """The level with the highest score, or with a negative sign the lowest, and its difference."""
    level = max(gaps, key=lambda name: sign * gaps[name].to_numpy().mean())
    beyond = sign * gaps[level].to_numpy().mean() > 0.0
    return (level, gaps[level]) if beyond else (reference, 0.0 * gaps[level])


def interactions(results: Results) -> list[Interaction]:
    """Interactions that are larger than the main effect, beyond chance, the largest first.

    Of the two views of an interaction, the one with the smaller main effect comes first.
    """
    tried = [
        ((environment, factor, level, other, str(at)), by.loc[at] - by.iloc[0], rows)
        for environment in results.environments
        for factor, (_, each) in _by_cell(results, environment).items()
        for level, rows in each.items()
        for other in rows.index.names[1:]
        for by in [rows.groupby(level=other, sort=False).mean()]
        for at in by.index[1:]
    ]
    found = []
    for names, change, rows in tried:
        value, main = mean_interval(change.to_numpy(), len(tried)), abs(rows.to_numpy().mean())
        if value and value.excludes_zero and abs(value.mean) > main:
            found.append((-round(abs(value.mean), 9), main, Interaction(*names, value)))
    return [each for *_, each in sorted(found, key=lambda item: item[:2])]
