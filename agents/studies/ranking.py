"""Normalised scores of estimators and learned agents, with intervals.

A normalised score is 1 with perfect state knowledge (the estimator `ORACLE`) and 0 on dead
reckoning (`FLOOR`). All are means over training runs and evaluation seeds, with the one interval
of `agents.statistics`; conditions of an environment count alike, and so do environments.
"""

from collections.abc import Sequence
from functools import cached_property, lru_cache
from math import comb

import numpy as np
import pandas as pd

from agents.statistics import (
    Interval,
    crossed_interval,
    episodes_for,
    mean_interval,
    share_interval,
    skewed_interval,
    verdict,
)
from agents.studies.records import ENDS, ORACLE
from agents.studies.results import Results

ALL = "All"
"""Name of the ranking over all environments together."""


def normalised(
    results: Results, environments: Sequence[str], policy: str, estimator: str
) -> pd.DataFrame:
    """Normalised score of a policy on an estimator, a row for each run and a column for each seed.

    Means over environments of means over their conditions that have a scale; runs that lack one of
    these are left out.
    """
    own = results.rows(results.normalised, estimator, policy)
    own = own[own.index.get_level_values("environment").isin(environments)]
    whole = own.groupby("run", sort=False).size() == len(results.scales.loc[list(environments)])
    each = own.groupby(["environment", "run"], sort=False).mean()
    return each.groupby("run", sort=False).mean()[whole]


def interval(
    results: Results, policy: str, values: np.ndarray, comparisons: int = 1
) -> Interval | float | None:
    """The mean of ``(runs, seeds)`` with its interval; one training run has none: a number."""
    if policy in results.learned and len(values) == 1:
        return float(values.mean())
    return crossed_interval(values, comparisons) if len(values) else None


def policy_score(
    results: Results, environment: str, policy: str, estimator: str | None = None
) -> Interval | float | None:
    """Normalised score of a policy on an estimator, or (None) on that of its training."""
    there = estimator or results.home(environment, policy)
    return interval(results, policy, normalised(results, [environment], policy, there).to_numpy())


# --- estimators of the classical agent ------------------------------------------------------------


class Ranking:
    """Estimators of the classical agent that some environments have in common, the best first.

    The ends of the scale have no place in it. Intervals of scores hold for all its estimators at
    once, because the best is selected in the same episodes.

    Attributes:
        scores: Normalised score at each evaluation seed ``(seeds,)`` by estimator, a mean over
            tunings.
    """

    def __init__(self, results: Results, environments: Sequence[str]) -> None:
        self.results, self.environments = results, list(environments)
        each = {name: self._scores(name) for name in results.estimators() if name not in ENDS}
        found = [(name, runs.to_numpy().mean(0)) for name, runs in each.items() if len(runs)]
        self.scores = dict(sorted(found, key=lambda item: -float(item[1].mean())))

    def _scores(self, name: str) -> pd.DataFrame:
        """Normalised score with an estimator, a row for each tuning and a column for each seed."""
        return normalised(self.results, self.environments, self.results.compared, name)

    def _differences(self, one: str, other: str) -> np.ndarray:
        """Differences ``(runs, seeds)`` of two estimators, in the tunings that both have."""
        return (self._scores(one) - self._scores(other)).dropna().to_numpy()

    @property
    def best(self) -> str:
        """The estimator with the highest normalised score."""
        return next(iter(self.scores))

    @property
    def reference(self) -> str:
        """The estimator that others are compared with."""
        names = [name for name in self.results.estimators() if name in self.scores]
        return self.results.reference(self.environments[0], names)

    @property
    def scales(self) -> pd.DataFrame:
        """Rows of `Results.scales` of its environments."""
        return self.results.scales.loc[self.environments]

    def score(self, name: str) -> Interval | None:
        """Normalised score of one of its estimators, or of an end of the scale."""
        return crossed_interval(self._scores(name).to_numpy(), max(len(self.scores), 1))

    def loss(self, name: str) -> Interval | None:
        """Reference score minus score at the same seed, a mean over all places with a scale.

        The interval follows the skewness: most episodes cost little, and some much.
        """
        score, compared = self.results.wide("score"), self.results.compared
        truth, ours = (self.results.rows(score, each, compared) for each in (ORACLE, name))
        lost = (
            (truth - ours)
            .groupby(["environment", "condition"], sort=False)
            .mean()
            .loc[self.scales.index]
        )
        return skewed_interval(lost.mean().to_numpy(), len(self.scores))

    def episodes(self, name: str) -> pd.DataFrame:
        """Episodes of the classical agent on an estimator."""
        table = self.results.table
        own = (table.policy == self.results.compared) & (table.estimator == name)
        return table[own & table.environment.isin(self.environments)]

    def completed(self, name: str) -> Interval:
        """Share [%] of episodes that end as the task asks."""
        hits = self.episodes(name).groupby("seed").completed.mean()
        return share_interval(float(hits.sum()), len(hits)).times(100.0)

    def worst_decile(self, name: str) -> float:
        """Mean score of the worst tenth of the episodes."""
        scores = self.episodes(name).score
        return float(scores.nsmallest(-(-len(scores) // 10)).mean())

    @property
    def pairs(self) -> int:
        """Number of pairs, for all of which the intervals of differences hold at once.

        So where all estimators are equal, at most one study in twenty tells any two apart.
        """
        return comb(len(self.scores), 2)

    def gap(self, one: str, other: str) -> Interval | None:
        """Difference of the normalised scores of two estimators."""
        values = self._differences(one, other)
        return crossed_interval(values, self.pairs) if len(values) else None

    @property
    def span(self) -> float:
        """Largest difference of normalised scores, as scores lie in [0, 1]."""
        return float((1.0 / self.scales.mean(axis=1)).mean())

    def verdict(self, one: str, other: str) -> str:
        """Verdict on an estimator against another one."""
        margin = self.results.plan.study.margin
        return verdict(self._differences(one, other), margin, self.span, self.pairs)

    @cached_property
    def verdicts(self) -> dict[str, str]:
        """Verdict on each estimator but the best against the best, in their order."""
        best, *others = self.scores
        return {name: self.verdict(name, best) for name in others}

    def episodes_to_decide(self, name: str) -> float:
        """About how many more episodes decide between an estimator and the best, by their scatter.

        They show that the estimators differ, or that they are equivalent, which takes a least
        number of episodes (`verdict`).
        """
        gap, margin = self.scores[name] - self.scores[self.best], self.results.plan.study.margin
        size = abs(gap.mean())
        needed = episodes_for(gap, max(size, margin - size), self.pairs)
        least = 3.0 * self.span / margin if size < margin - size else 0.0
        return max(np.ceil(max(needed, least)) - len(gap), 1.0)

    def episodes_to_tell(self) -> float:
        """Number of seeds that would tell the best estimator's score; 0 if those there are do.

        They do if the scale's interval excludes zero and that of the normalised score is no wider
        than the scale (Fieller 1954: a ratio whose denominator may be zero has no bounded
        interval). So many as make both half as wide, by their spread, and more than there are; NaN
        of one seed.
        """
        scale, best = self.scales.to_numpy().mean(axis=0), self.scores[self.best]
        if len(best) < 2:
            return float("nan")
        wanted = (scale, scale.mean(), 1), (best, 0.5, len(self.scores))
        found = [mean_interval(values, among) for values, _, among in wanted]
        if all(each and each.half < half for each, (_, half, _) in zip(found, wanted, strict=True)):
            return 0.0
        needed = (episodes_for(values, 0.5 * half, among) for values, half, among in wanted)
        return float(max(*map(np.ceil, needed), len(best) + 1))


@lru_cache(1)
def rankings(results: Results) -> dict[str, Ranking]:
    """Rankings that each column of a table stands for, by its head.

    `ALL` is there if environments have several estimators in common; then each environment in
    which an estimator can be ranked. A report asks for them several times.
    """
    scaled = results.scales.index.unique("environment")
    each = {name: Ranking(results, [name]) for name in results.environments if name in scaled}
    each = {name: ranking for name, ranking in each.items() if ranking.scores}
    together = Ranking(results, list(each))
    return ({ALL: together} if len(each) > 1 < len(together.scores) else {}) | each
