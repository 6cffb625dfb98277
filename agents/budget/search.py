"""Sequential search for the cheapest suite that suffices, and its confirmation.

The two parts simulate different seeds. The search may therefore look as often as it likes: no error
of the confirmation depends on what the search compared.

- Search: suites are looked at after 32, 64, 128 ... episodes, until a further look cannot change
  the answer. Intervals hold for all suites and all looks at once (Bonferroni), so the order in
  which suites are simulated needs no correction.
- Confirmation: suites in an order that the search has fixed, the safest first, each cheaper than
  the one before. The first that is not confirmed ends it; the answer is the last one confirmed.
  Such a fixed sequence needs no correction: a wrong suite can only be the answer if the first wrong
  one of the order passes its own test (Maurer, Hothorn & Lehmacher 1995; Goeman & Solari 2010, "The
  sequential rejection principle of familywise error control").
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import permutations
from typing import Any

import numpy as np

from agents.statistics import (
    Interval,
    episodes_for,
    normalise,
    paired_difference,
    skewed_interval,
)

TRUTH = -1
"""Stands for the truth among the numbers of suites."""
FIRST_LOOK = 32
"""Episodes after which a suite is looked at first; their number doubles from look to look."""
ROUND = 16
"""Suites that are simulated before the next choice."""
DOES, FAILS, OPEN, REFUSED = "suffices", "falls short", "undecided", "refused"
"""Verdicts of the search. Refused: the environment cannot run the estimator on these sensors."""
CONFIRMED, NOT_CONFIRMED = "confirmed", "not confirmed"
"""Verdicts of the confirmation."""


Fly = Callable[[Sequence[int], int, int], list[Any]]
"""Scores of suites, or of the `TRUTH`, on some seeds: ``fly(suites, first, episodes)``.

They are ``(episodes,)`` each; None for a suite that the environment refuses.
"""


def relative_scores(scores: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Scores ``(N,)`` over the mean of the reference scores of the same seeds, as `normalise`.

    Args:
        scores: ``(N,)``.
        truth: ``(N,)`` reference scores, of positive mean.

    Raises:
        ValueError: if the truth scores nothing, so that there is no share of it.
    """
    return normalise(scores[None], np.zeros(len(truth)), truth)[0]


def relative_score(scores: np.ndarray, truth: np.ndarray, comparisons: int = 1) -> Interval:
    """Mean of `relative_scores` with an interval that follows the skewness.

    Args:
        scores: ``(N,)``, N at least 2.
        truth: ``(N,)`` reference scores, of positive mean.
        comparisons: As `agents.statistics.crossed_interval`.

    Raises:
        ValueError: if the truth scores nothing, so that there is no share of it.
    """
    return skewed_interval(relative_scores(scores, truth), comparisons)


def looks(episodes: int) -> list[int]:
    """Numbers of episodes at which a suite is looked at: 32, 64, 128 ... and the last."""
    return sorted({min(FIRST_LOOK << i, episodes) for i in range(32)})


@dataclass(eq=False)
class Search:
    """A search over suites in order of their cost, the cheapest first, and its confirmation.

    Attributes:
        costs: Of the suites, ascending: prices, or whatever else has an order.
        no_better: Matrix ``(K, K)``, True in a row where a suite is better in no sensor than the
            suite of a column.
        keep: Share of the reference score that is asked for.
        fly: Simulates what is asked for.
        episodes: The most of a suite.
        scores: Of all episodes so far, by suite and for the `TRUTH`.
        shares: Relative score of each suite simulated, with an interval that holds for all suites
            and looks at once.
        verdicts: Of each suite simulated.
        confirmed: Relative scores on fresh seeds, in the order of the confirmation.
        answer: The last suite confirmed, which is the cheapest of them; None if there is none.
    """

    costs: Sequence[Any]
    no_better: np.ndarray
    keep: float
    fly: Fly
    episodes: int
    scores: dict[int, np.ndarray] = field(default_factory=dict)
    shares: dict[int, Interval] = field(default_factory=dict)
    verdicts: dict[int, str] = field(default_factory=dict)
    confirmed: dict[int, Interval] = field(default_factory=dict)
    answer: int | None = None

    def run(self, progress: Callable[[int, int], None]) -> None:
        """Simulate until no further look may change the answer.

        Suites of each round are spread over the prices: one that suffices settles dearer ones, one
        that falls short those that are better in no sensor.

        Args:
            progress: Called with the number of suites that need no further look, and of all.

        Raises:
            ValueError: if the truth scores nothing, so that there is no share of it.
        """
        first = 0
        for end in looks(self.episodes):
            while left := self.undecided(end):
                progress(len(self.costs) - len(left), len(self.costs))
                self._look([TRUTH, *left[:: -(-len(left) // ROUND)]], first, end)
            first = end

    def undecided(self, end: int) -> list[int]:
        """Suites with fewer episodes of which a look may change the answer.

        A suite that is better in no sensor than one that falls short is simulated no further. That
        it falls short, too, is an assumption: no test of a suite relies on it, but a cheaper suite
        may be missed where it does not hold (`contradictions`).
        """
        does, fails = (
            [i for i, found in self.verdicts.items() if found == word] for word in (DOES, FAILS)
        )
        return [
            i
            for i in range(min(does, default=len(self.costs)))
            if self.verdicts.get(i, OPEN) == OPEN
            and len(self.scores.get(i, ())) < end
            and not self.no_better[i, fails].any()
        ]

    @property
    def comparisons(self) -> int:
        """Number of intervals of the search, which hold at once."""
        return len(self.costs) * len(looks(self.episodes))

    def episodes_to_decide(self, suite: int) -> float:
        """About how many more episodes decide on a suite, by the scatter of its relative score."""
        values = relative_scores(self.scores[suite], self.scores[TRUTH][: len(self.scores[suite])])
        distance = abs(values.mean() - self.keep)
        return max(episodes_for(values, distance, self.comparisons) - len(values), 1.0)

    def pairs(self) -> list[tuple[int, int]]:
        """Suites simulated of which the second is better in some sensor, and worse in none."""
        every = permutations(sorted(self.shares), 2)
        return [(i, j) for i, j in every if self.no_better[i, j] and not self.no_better[j, i]]

    def contradictions(self) -> dict[tuple[int, int], Interval]:
        """Pairs whose suite with the worse sensors scores significantly more, and how much more.

        Differences are paired by seed, and their intervals hold for all pairs and looks at once.
        """
        found, pairs = {}, self.pairs()
        for i, j in pairs:
            n = min(len(self.scores[i]), len(self.scores[j]))
            comparisons = len(pairs) * len(looks(self.episodes))
            gap = paired_difference(self.scores[i][:n], self.scores[j][:n], comparisons=comparisons)
            if gap.low > 0.0:
                found[i, j] = gap
        return found

    def _look(self, suites: Sequence[int], first: int, end: int) -> None:
        """Simulate suites from one number of episodes to another, and decide on them."""
        for i, scores in zip(suites, self.fly(suites, first, end - first), strict=True):
            if scores is None:
                self.verdicts[i] = REFUSED
                continue
            self.scores[i] = np.append(self.scores.get(i, ())[:first], scores)
            if i != TRUTH:
                share = relative_score(self.scores[i], self.scores[TRUTH], self.comparisons)
                no = FAILS if share.high < self.keep else OPEN
                self.shares[i], self.verdicts[i] = share, DOES if share.low >= self.keep else no

    @property
    def sequence(self) -> list[int]:
        """Suites to confirm, in their order, each cheaper than those before.

        The order is that of the lower ends of their intervals, the highest first. Suites whose mean
        falls short are left out. Of those that suffice for certain the two cheapest are enough, one
        of them for the case that the other is not confirmed.
        """
        found: list[int] = []
        good = (i for i, share in self.shares.items() if share.mean >= self.keep)
        for suite in sorted(good, key=lambda i: (-self.shares[i].low, i)):
            if not found or self.costs[suite] < self.costs[found[-1]]:
                found.append(suite)
        certain = sum(self.verdicts[i] == DOES for i in found)
        return found[max(certain - 2, 0) :]

    def confirm(self, first: int) -> None:
        """Confirm suites on fresh seeds in the order of `sequence`, up to the first that is not.

        Those whose 95 % interval is not below ``keep`` are confirmed. The probability that the last
        one confirmed falls short is at most 2.5 %, however many are tried, since the order is fixed
        before these seeds are simulated.

        Args:
            first: Number of the first fresh seed.
        """
        for suite in self.sequence:
            fresh = self.fly((suite, TRUTH), first, self.episodes)
            share = self.confirmed[suite] = relative_score(*fresh)
            if share.low < self.keep:
                self.verdicts[suite] = NOT_CONFIRMED
                break
            self.verdicts[suite], self.answer = CONFIRMED, suite
