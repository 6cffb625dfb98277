"""Normalised scores of estimators and learned agents, with intervals.

A normalised score is 1 with perfect state knowledge (the estimator `ORACLE`) and 0 on dead
reckoning (`FLOOR`). All are means over training runs and evaluation seeds, with the one interval
of `agents.statistics`; conditions of an environment count alike, and so do environments.
"""

from functools import cached_property, lru_cache
from math import comb

import numpy as np
import pandas as pd

from agents.statistics import (
    Interval,
    crossed_interval,
    episodes_for,
    mean_interval,
    verdict,
)
from agents.studies.records import ENDS
from agents.studies.results import Results, at

ALL = "All"
"""Name of the ranking over all environments together."""


def normalised(results: Results, scales: pd.DataFrame, policy: str, estimator: str) -> pd.DataFrame:
    """Normalised score of a policy on an estimator, a row for each run and a column for each seed.

    Means over environments of means over their conditions, for some rows of `Results.scales`; runs
    that lack one of these are left out.
    """
    own = at(results.normalised, policy=policy, estimator=estimator)
    own = own[own.index.droplevel("run").isin(scales.index)]
    whole = own.groupby("run", sort=False).size() == len(scales)
    each = own.groupby(["environment", "run"], sort=False).mean()
    return each.groupby("run", sort=False).mean()[whole]


def interval(results: Results, policy: str, values: np.ndarray, comparisons: int = 1) -> Interval:
    """The mean of ``(runs, seeds)`` with its interval, which one training run does not have."""
    if policy in results.learned and len(values) == 1:
        return Interval(float(values.mean()), np.nan, np.nan)
    return crossed_interval(values, comparisons)


def policy_score(results: Results, environment: str, policy: str, estimator: str) -> Interval:
    """Normalised score of a policy on an estimator."""
    values = normalised(results, results.scales.loc[[environment]], policy, estimator)
    return interval(results, policy, values.to_numpy())


# --- estimators of the classical agent ------------------------------------------------------------


class Ranking:
    """Estimators of the classical agent that some places have in common, the best first.

    The ends of the scale have no place in it. Intervals of scores hold for all its estimators at
    once, because the best is selected in the same episodes.

    Attributes:
        scales: Rows of `Results.scales` of its places.
        environments: Environments of its places.
        scores: Normalised score by estimator, a row for each tuning and a column for each seed.
    """

    def __init__(self, results: Results, scales: pd.DataFrame) -> None:
        self.results, self.scales = results, scales
        self.environments = list(scales.index.unique("environment"))
        each = {
            name: normalised(results, scales, results.compared, name)
            for name in results.estimators()
            if name not in ENDS
        }
        found = [(name, runs) for name, runs in each.items() if len(runs)]
        self.scores = dict(sorted(found, key=lambda item: -item[1].to_numpy().mean()))

    @property
    def best(self) -> str:
        """The estimator with the highest normalised score."""
        return next(iter(self.scores))

    @property
    def reference(self) -> str:
        """The estimator that others are compared with."""
        names = [name for name in self.results.estimators() if name in self.scores]
        return self.results.reference(self.environments[0], names)

    def score(self, name: str) -> Interval:
        """Normalised score of one of its estimators."""
        return crossed_interval(self.scores[name].to_numpy(), len(self.scores))

    def differences(self, one: str, other: str) -> np.ndarray:
        """Differences ``(runs, seeds)`` of two estimators, in the tunings that both have."""
        return (self.scores[one] - self.scores[other]).dropna().to_numpy()

    @property
    def pairs(self) -> int:
        """Number of pairs, for all of which the intervals of differences hold at once.

        So where all estimators are equal, at most one study in twenty tells any two apart.
        """
        return comb(len(self.scores), 2)

    def gap(self, one: str, other: str) -> Interval:
        """Difference of the normalised scores of two estimators."""
        return crossed_interval(self.differences(one, other), self.pairs)

    @property
    def span(self) -> float:
        """Largest difference of normalised scores, as scores lie in [0, 1]."""
        return float((1.0 / self.scales.mean(axis=1)).mean())

    def verdict(self, one: str, other: str) -> str:
        """Verdict on an estimator against another one."""
        margin = self.results.plan.study.margin
        return verdict(self.differences(one, other), margin, self.span, self.pairs)

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
        gap = (self.scores[name].mean() - self.scores[self.best].mean()).to_numpy()
        margin, size = self.results.plan.study.margin, abs(gap.mean())
        needed = episodes_for(gap, max(size, margin - size), self.pairs)
        least = 3.0 * self.span / margin if size < margin - size else 0.0
        return max(np.ceil(max(needed, least)) - len(gap), 1.0)

    @property
    def tells(self) -> bool:
        """True if the episodes tell the best estimator's score.

        They do if the scale's interval excludes zero and that of the normalised score is no wider
        than the scale (Fieller 1954: a ratio whose denominator may be zero has no bounded
        interval).
        """
        return mean_interval(self.scales.mean()).low > 0.0 and self.score(self.best).half < 0.5


@lru_cache(1)
def rankings(results: Results) -> dict[str, Ranking]:
    """Rankings that each column of a table stands for, by its head.

    `ALL` is there if environments have several estimators in common; then each environment in
    which an estimator can be ranked. A report asks for them several times.
    """
    scales = results.scales
    names = scales.index.unique("environment")
    each = {name: Ranking(results, scales.loc[[name]]) for name in names}
    each = {name: ranking for name, ranking in each.items() if ranking.scores}
    together = Ranking(results, scales.loc[list(each)])
    return ({ALL: together} if len(each) > 1 < len(together.scores) else {}) | each
