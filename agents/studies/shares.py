"""Shares of the oracle's performance that estimators and learned agents keep, with intervals.

Everything is a mean over training runs and evaluation seeds, with the one interval of
`agents.statistics`; conditions of an environment count alike, and so do environments.
"""

from collections.abc import Mapping, Sequence
from math import comb

import numpy as np
import pandas as pd

from agents.statistics import (
    EQUIVALENT,
    Interval,
    crossed_interval,
    mean_interval,
    paired_difference,
    share_interval,
    skewed_interval,
    verdict,
)
from agents.studies.records import DEFAULT, FLOOR, ORACLE
from agents.studies.results import Results

ENDS = (ORACLE, FLOOR)
"""Estimators whose share is 1 and 0 by definition."""

Ranked = Mapping[str, np.ndarray]
"""Share kept at each evaluation seed ``(seeds,)`` by estimator, the best first."""


def shares(
    results: Results, environments: Sequence[str], policy: str, estimator: str | None = None
) -> np.ndarray | None:
    """Share kept ``(runs, seeds)`` on an estimator, or (None) on the home estimators of a policy.

    None if no run has all environments in all conditions that have a scale.
    """
    found = _shares(results, environments, policy, estimator)
    return found.to_numpy() if len(found) else None


def _shares(
    results: Results, environments: Sequence[str], policy: str, estimator: str | None
) -> pd.DataFrame:
    """Means over environments of `Results.shares`, a row for each run that has all of them."""
    keys = [(e, policy, estimator or results.home(e, policy)) for e in environments]
    if not all(key in results.shares for key in keys):
        return pd.DataFrame()
    each = pd.concat([results.shares[key] for key in keys]).groupby(level=0, sort=False)
    return each.mean()[each.size() == len(keys)]


def paired_shares(
    results: Results,
    environments: Sequence[str],
    one: tuple[str, str | None],
    other: tuple[str, str | None],
) -> np.ndarray | None:
    """Shares of one policy minus those of another, each on an estimator ``(runs, seeds)``.

    Runs of one training seed are paired, and the classical agent is paired with each. None if
    nothing pairs.
    """
    ours, theirs = (_shares(results, environments, *each) for each in (one, other))
    if other[0] == results.classical and len(theirs):
        return ours.to_numpy() - theirs.to_numpy() if len(ours) else None
    both = [run for run in ours.index if run in theirs.index]
    return (ours.loc[both] - theirs.loc[both]).to_numpy() if both else None


def interval(
    results: Results, policy: str, values: np.ndarray, comparisons: int = 1
) -> Interval | float | None:
    """The mean of ``(runs, seeds)`` with its interval; a number for one training run."""
    if policy in results.learned and len(values) == 1:
        return float(values.mean())
    return crossed_interval(values, comparisons)


def kept(
    results: Results,
    environments: Sequence[str],
    policy: str,
    estimator: str | None,
    among: int = 1,
) -> Interval | float | None:
    """Share that a policy keeps; a number where one training run has no interval.

    The interval of the best of several holds only if theirs hold all at once: ``among`` is their
    number.
    """
    found = shares(results, environments, policy, estimator)
    return None if found is None else interval(results, policy, found, among)


# --- estimators of the classical agent ------------------------------------------------------------


def rankable(results: Results, environments: Sequence[str]) -> dict[str, np.ndarray]:
    """Share kept by the classical agent at each seed ``(seeds,)``, by estimator that all have.

    The best first, without the ends.
    """
    names = (name for name in results.estimators() if name not in ENDS)
    each = {name: shares(results, environments, results.classical, name) for name in names}
    found = {name: values[0] for name, values in each.items() if values is not None}
    return dict(sorted(found.items(), key=lambda item: -float(item[1].mean())))


def ruled(results: Results) -> list[str]:
    """The environments in which shares can be told of some estimator."""
    scaled = results.scales.index.unique("environment") if len(results.scales) else ()
    return [e for e in results.environments if e in scaled and rankable(results, [e])]


def common(results: Results) -> dict[str, np.ndarray]:
    """Shares that are `rankable` over all `ruled` environments; empty for fewer than two."""
    environments = ruled(results)
    ranked = rankable(results, environments) if len(environments) > 1 else {}
    return ranked if len(ranked) > 1 else {}


def price(
    results: Results, environments: Sequence[str], policy: str, estimator: str, among: int = 1
) -> Interval | float | None:
    """Score lost against the truth at the same seed, a mean over all places that have a scale.

    Of an agent that does not learn the interval follows the skewness: most episodes cost little,
    and some much.
    """
    scores, places = results.wide("score"), results.scales.index
    places = places[places.get_level_values("environment").isin(list(environments))]
    found = []
    for name in (ORACLE, estimator):
        own = scores[(scores.index.get_level_values("estimator") == name)
                     & (scores.index.get_level_values("policy") == policy)]  # fmt: skip
        found.append(own.droplevel(["policy", "estimator"]))
    truth, ours = found
    lost = (truth - ours).dropna()
    each = lost[lost.index.droplevel("run").isin(places)].groupby("run", sort=False)
    lost = each.mean()[each.size() == len(places)]
    if not len(lost) or not len(places):
        return None
    if policy not in results.learned:
        return skewed_interval(lost.to_numpy()[0], among)
    return interval(results, policy, lost.to_numpy(), among)


def completed(results: Results, environments: Sequence[str], estimator: str) -> Interval | None:
    """Share [%] of episodes of the classical agent that end as the task asks; None without any."""
    rows = _episodes(results, environments, estimator)
    if not len(rows):
        return None
    hits = rows.groupby("seed").completed.mean()
    return share_interval(float(hits.sum()), len(hits)).times(100.0)


def worst_decile(results: Results, environments: Sequence[str], estimator: str) -> float:
    """Mean score of the worst tenth of the episodes of the classical agent; NaN without any."""
    scores = np.sort(_episodes(results, environments, estimator).score.to_numpy(float))
    return float(scores[: -(-len(scores) // 10)].mean()) if len(scores) else np.nan


def _episodes(results: Results, environments: Sequence[str], estimator: str) -> pd.DataFrame:
    table = results.table
    own = (table.policy == results.classical) & (table.estimator == estimator)
    return table[own & table.environment.isin(list(environments))]


def gap(ranked: Ranked, one: str, other: str) -> Interval | None:
    """Difference of the shares kept on two estimators.

    The 95 % hold for all pairs of the ranked at once, because which of them is the best is seen in
    the same episodes: where all are equal, at most one study in twenty tells any two apart.
    """
    return paired_difference(ranked[one], ranked[other], comparisons=comb(len(ranked), 2))


def _scales(results: Results, environments: Sequence[str]) -> np.ndarray:
    """Score on the truth minus that on dead reckoning ``(places, seeds)``."""
    return results.scales.loc[list(environments)].to_numpy()


def verdicts(results: Results, environments: Sequence[str], ranked: Ranked) -> dict[str, str]:
    """Verdict on each estimator but the best against the best, in their order.

    Scores lie in [0, 1], so that shares differ by at most the inverse of the mean scale.
    """
    best, *others = ranked
    span = float(np.mean(1.0 / _scales(results, environments).mean(axis=1)))
    pairs = comb(len(ranked), 2)
    margin = results.plan.study.margin
    return {n: verdict(ranked[n] - ranked[best], margin, span, pairs) for n in others}


def cheapest(results: Results, environments: Sequence[str], ranked: Ranked) -> str:
    """The best estimator, or one equivalent to it whose step takes least CPU time.

    That is less by a tenth, beyond the noise. A time counts as a multiple of that on the truth,
    measured in turns with it: jobs may run on several machines.
    """
    best, times = next(iter(ranked)), {}
    found = verdicts(results, environments, ranked)
    for name in (best, *(name for name in found if found[name] == EQUIVALENT)):
        each = [results.timings[e, name][0] for e in environments if (e, name) in results.timings]
        if len(each) < len(environments):
            return best
        times[name] = sum(own / truth for _, own, truth in each)
    least = min(times, key=lambda name: times[name])
    return least if times[least] < 0.9 * times[best] else best


def episodes_to_tell(results: Results, environments: Sequence[str], ranked: Ranked) -> float:
    """Number of seeds that would tell what the best estimator keeps; 0 if those there are do.

    They do if the scale's interval excludes zero and that of the share kept is no wider than the
    scale (Fieller 1954: a ratio whose denominator may be zero has no bounded interval). So many as
    make both half as wide, by their spread, and more than there are; NaN of one seed.
    """
    from scipy.special import ndtri

    worth, best = _scales(results, environments).mean(axis=0), next(iter(ranked.values()))
    if len(best) < 2:
        return float("nan")
    needed, enough = 0.0, True
    for values, half, among in ((worth, worth.mean(), 1), (best, 0.5, len(ranked))):
        found = mean_interval(values, among)
        enough &= found is not None and found.half < half
        needed = max(needed, (2.0 * ndtri(1.0 - 0.025 / among) * values.std(ddof=1) / half) ** 2)
    return 0.0 if enough else float(max(np.ceil(needed), len(best) + 1))


# --- learned policies -----------------------------------------------------------------------------


def learned_differences(
    results: Results, environment: str
) -> dict[tuple[str, str], Interval | float | None]:
    """Shares that learned policies keep at home beyond others, by both names.

    Each that sees estimates is compared with the classical agent on the same estimator. The first
    of them that remembers nothing is compared with those that learned on measurements, in runs of
    the same training seeds; these differences hold for all of them at once.
    """
    agents = {name: agent for agent in results.plan.study.agents for name in agent.policies}
    raw = [name for name in results.learned if agents[name].raw]
    seeing = [name for name in results.learned if name not in raw]
    found: dict[tuple[str, str], Interval | float | None] = {}
    for name in seeing:
        home = results.home(environment, name)
        others: dict[str, tuple[str | None, int]] = {results.classical: (home, 1)}
        if name == reference_policy(results):
            others |= {other: (None, len(raw)) for other in raw}
        for other, (estimator, comparisons) in others.items():
            gaps = paired_shares(results, [environment], (name, home), (other, estimator))
            if gaps is not None:
                found[name, other] = interval(results, name, gaps, comparisons)
    return found


def reference_policy(results: Results) -> str | None:
    """The policy that learning on measurements is compared with.

    It sees estimates, remembers nothing, and was trained on the default estimator if one was.
    """
    agents = [a for a in results.plan.study.agents if not a.raw and a.memory == "none"]
    plain = [(a.policy(DEFAULT) != name, name) for a in agents for name in a.policies]
    there = [(other, name) for other, name in plain if name in results.learned]
    return min(there, key=lambda each: each[0])[1] if there else None
