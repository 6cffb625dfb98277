"""Sequential search for the cheapest suite that keeps a share of a score, and its confirmation.

The two parts fly different seeds. The search may therefore look as often as it likes: no error of
the confirmation depends on what the search compared.

- Search: suites are looked at after 32, 64, 128 ... episodes, until a further look cannot change
  the answer. Intervals hold for all suites and all looks at once (Bonferroni), so the order in
  which suites are flown needs no correction.
- Confirmation: suites in an order that the search has fixed, the safest first, each cheaper than
  the one before. The first that is not confirmed ends it, and the answer is the last one confirmed.
  Such a fixed sequence needs no correction: a wrong suite can only be the answer if the first wrong
  one of the order passes its own test (Maurer, Hothorn & Lehmacher 1995; Goeman & Solari 2010, "The
  sequential rejection principle of familywise error control").
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from agents.statistics import Interval, normalise, skewed_interval

TRUTH = -1
"""Stands for the truth among the numbers of suites."""
FIRST_LOOK = 32
"""Episodes after which a suite is looked at first; their number doubles from look to look."""
ROUND = 16
"""Suites that are flown before the next choice."""
DOES, FAILS, OPEN, REFUSED = "keeps it", "keeps less", "not decided", "refused"
"""Verdicts of the search. Refused: the environment cannot fly the estimator on these sensors."""
CONFIRMED, NOT_CONFIRMED = "confirmed", "not confirmed"
"""Verdicts of the confirmation."""


Fly = Callable[[Sequence[int], int, int], list[Any]]
"""Scores of suites, or of the `TRUTH`, on some seeds: ``fly(suites, first, episodes)``.

They are ``(episodes,)`` each; None for a suite that the environment refuses.
"""


def share_kept(scores: np.ndarray, truth: np.ndarray, comparisons: int = 1) -> Interval:
    """Mean score over the truth's on the same seeds; its interval follows the skewness.

    Args:
        scores: ``(N,)``, N at least 2.
        truth: ``(N,)``, of positive mean.
        comparisons: As `agents.statistics.crossed_interval`.

    Raises:
        ValueError: if the truth scores nothing, so that there is no share of it.
    """
    interval = skewed_interval(normalise(scores[None], np.zeros(len(truth)), truth)[0], comparisons)
    assert interval is not None
    return interval


def looks(episodes: int) -> list[int]:
    """Numbers of episodes at which a suite is looked at: 32, 64, 128 ... and the last."""
    return sorted({min(FIRST_LOOK << i, episodes) for i in range(32)})


@dataclass(eq=False)
class Search:
    """A search over suites in order of their cost, the cheapest first, and its confirmation.

    Attributes:
        costs: Of the suites, ascending: prices, or whatever else has an order.
        ranks: ``(K, s)`` of their sensors, 0 for the best.
        keep: Share of the truth's score that is asked for.
        fly: Flies what is asked for.
        episodes: The most of a suite.
        scores: Flown so far, by suite and for the `TRUTH`.
        shares: Of each suite flown, with an interval that holds for all suites and looks at once.
        verdicts: Of each suite flown.
        confirmed: Shares on fresh seeds, in the order of the confirmation.
    """

    costs: Sequence[Any]
    ranks: np.ndarray
    keep: float
    fly: Fly
    episodes: int
    scores: dict[int, np.ndarray] = field(default_factory=dict)
    shares: dict[int, Interval] = field(default_factory=dict)
    verdicts: dict[int, str] = field(default_factory=dict)
    confirmed: dict[int, Interval] = field(default_factory=dict)

    def run(self, progress: Callable[[int, int], None]) -> None:
        """Fly until no further look may change the answer.

        Suites of each round are spread over the prices: one that keeps the share settles dearer
        ones, one that keeps less those that are no better in any sensor.

        Args:
            progress: Called with the number of suites that need no further look, and of all.
        """
        first = 0
        for end in looks(self.episodes):
            while left := self.undecided(end):
                progress(len(self.costs) - len(left), len(self.costs))
                self._look([TRUTH, *left[:: -(-len(left) // ROUND)]], first, end)
            first = end

    def undecided(self, end: int) -> list[int]:
        """Suites with fewer episodes of which a look may change the answer.

        A suite that is no better in any sensor than one that keeps less is flown no further. That
        it keeps less, too, is an assumption: no test relies on it, but a cheaper suite may be
        missed where it does not hold.
        """
        does, fails = (
            [i for i, found in self.verdicts.items() if found == word] for word in (DOES, FAILS)
        )
        return [
            i
            for i in range(min(does, default=len(self.costs)))
            if self.verdicts.get(i, OPEN) == OPEN
            and len(self.scores.get(i, ())) < end
            and not (self.ranks[i] >= self.ranks[fails]).all(-1).any()
        ]

    def _look(self, suites: Sequence[int], first: int, end: int) -> None:
        """Fly suites from one number of episodes to another, and decide on them."""
        comparisons = len(self.costs) * len(looks(self.episodes))
        for i, scores in zip(suites, self.fly(suites, first, end - first), strict=True):
            if scores is None:
                self.verdicts[i] = REFUSED
                continue
            self.scores[i] = np.append(self.scores.get(i, ())[:first], scores)
            if i != TRUTH:
                share = share_kept(self.scores[i], self.scores[TRUTH], comparisons)
                no = FAILS if share.high < self.keep else OPEN
                self.shares[i], self.verdicts[i] = share, DOES if share.low >= self.keep else no

    @property
    def sequence(self) -> list[int]:
        """Suites to confirm, in their order, each cheaper than those before.

        The order is that of the lower ends of their intervals, the highest first. Suites whose mean
        does not keep the share are left out. Of those that keep it for certain the two cheapest are
        enough, one of them for the case that the other is not confirmed.
        """
        found: list[int] = []
        good = (i for i, share in self.shares.items() if share.mean >= self.keep)
        for suite in sorted(good, key=lambda i: (-self.shares[i].low, i)):
            if not found or self.costs[suite] < self.costs[found[-1]]:
                found.append(suite)
        certain = sum(self.verdicts[i] == DOES for i in found)
        return found[max(certain - 2, 0) :]

    def confirm(self, first: int) -> int | None:
        """Confirm suites on fresh seeds in the order of `sequence`, up to the first that is not.

        Those whose 95 % interval is not below ``keep`` are confirmed. The probability that the last
        one confirmed keeps less is at most 2.5 %, however many are tried, since the order is fixed
        before these seeds are flown.

        Args:
            first: Number of the first fresh seed.

        Returns:
            The last suite that was confirmed, which is the cheapest of them; None if there is none.
        """
        answer = None
        for suite in self.sequence:
            fresh = self.fly((suite, TRUTH), first, self.episodes)
            share = self.confirmed[suite] = share_kept(*fresh)
            if share.low < self.keep:
                self.verdicts[suite] = NOT_CONFIRMED
                break
            self.verdicts[suite], answer = CONFIRMED, suite
        return answer
