"""Sequential search for the cheapest suite that keeps a share of a score, and its confirmation.

The two parts fly different seeds. The search may therefore look as often as it likes: no error of
the confirmation depends on what the search compared.

- Search: each suite is looked at after 32, 64, 128 ... episodes. Its interval holds for all suites
  and all looks at once (Bonferroni), so the order in which suites are flown needs no correction.
- Confirmation: suites in an order that the search has fixed, the safest first, each cheaper than
  the one before. The first that is not confirmed ends it, and the answer is the last one confirmed.
  Such a fixed sequence needs no correction: a wrong suite can only be the answer if the first wrong
  one of the order passes its own test (Maurer, Hothorn & Lehmacher 1995; Goeman & Solari 2010, "The
  sequential rejection principle of familywise error control").
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from agents.statistics import Interval, normalise, skewed_interval

TRUTH = -1
"""Stands for the truth among the numbers of suites."""
FIRST_LOOK = 32
"""Episodes after which a suite is looked at first; their number doubles from look to look."""
ROUND = 16
"""Suites that are flown before the next choice, whatever the number of processes."""
DOES, FAILS, OPEN, REFUSED = "keeps it", "keeps less", "not decided", "refused"
"""Verdicts of the search. Refused: the environment cannot fly the estimator on these sensors."""
CONFIRMED, NOT_CONFIRMED = "confirmed", "not confirmed"
"""Verdicts of the confirmation."""


class Request(NamedTuple):
    """Episodes of a suite, or of the `TRUTH`, on the seeds from number ``first`` on."""

    suite: int
    first: int
    episodes: int


Fly = Callable[[Sequence[Request]], list[Any]]
"""Scores ``(episodes,)`` of each request; None for a suite that the environment refuses."""


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

        Every suite cheaper than the cheapest one that keeps the share is then decided, is no better
        than one that fails, or has all episodes.

        Args:
            progress: Called with the number of suites that are decided or need no flight, and with
                the number of all.
        """
        count = len(self.ranks)
        while len(undecided := self.undecided()):
            progress(count - len(undecided), count)
            self.look(self.worthwhile(undecided)[:ROUND].tolist())
        progress(count, count)

    def undecided(self) -> np.ndarray:
        """Suites of which a further look may change the answer.

        A suite that is no better in any sensor than one that fails is not flown. That it fails,
        too, is an assumption: no test relies on it, but a cheaper suite may be missed where it does
        not hold.
        """
        failed = self.ranks[self.where(FAILS)]
        return np.array([
            i for i in range(min(self.where(DOES), default=len(self.ranks)))
            if self.verdicts.get(i, OPEN) == OPEN and self.flown(i) < self.episodes
            and (self.flown(i) or not (self.ranks[i] >= failed).all(-1).any())
        ], int)  # fmt: skip

    def where(self, verdict: str) -> list[int]:
        """Suites with a verdict."""
        return [i for i, found in self.verdicts.items() if found == verdict]

    def flown(self, suite: int) -> int:
        """Episodes of a suite so far."""
        return len(self.scores.get(suite, ()))

    def next_look(self, suite: int) -> int:
        """Episodes of a suite at its next look."""
        return min(max(FIRST_LOOK, 2 * self.flown(suite)), self.episodes)

    def worthwhile(self, undecided: np.ndarray) -> np.ndarray:
        """Undecided suites by what their next look settles an episode, the most first.

        A suite that fails settles those that are no better in any sensor; one that keeps the share,
        those that cost more. Of the two, the smaller number counts.
        """
        ranks = self.ranks[undecided]
        if_fails = (ranks >= ranks[:, None]).all(-1).sum(1)
        if_does = np.arange(len(undecided), 0, -1)
        price = [self.next_look(i) - self.flown(i) for i in undecided]
        return undecided[np.argsort(-np.minimum(if_fails, if_does) / price, kind="stable")]

    def look(self, suites: Sequence[int]) -> None:
        """Fly suites up to their next look, the truth as far, and decide on them.

        A suite's interval holds together with those of all suites at all looks, flown or not.
        """
        ends = {TRUTH: 0} | {i: self.next_look(i) for i in suites}
        ends[TRUTH] = max(ends.values())
        requests = [Request(i, n, end - n) for i, end in ends.items() if end > (n := self.flown(i))]
        for (i, *_), scores in zip(requests, self.fly(requests), strict=True):
            if scores is None:
                self.verdicts[i] = REFUSED
                continue
            self.scores[i] = np.append(self.scores.get(i, ()), scores)
            if i != TRUTH:
                truth = self.scores[TRUTH][: self.flown(i)]
                comparisons = len(self.ranks) * len(looks(self.episodes))
                share = self.shares[i] = share_kept(self.scores[i], truth, comparisons)
                no = FAILS if share.high < self.keep else OPEN
                self.verdicts[i] = DOES if share.low >= self.keep else no

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
            fresh = self.fly([Request(i, first, self.episodes) for i in (suite, TRUTH)])
            share = self.confirmed[suite] = share_kept(*fresh)
            if share.low < self.keep:
                self.verdicts[suite] = NOT_CONFIRMED
                break
            self.verdicts[suite], answer = CONFIRMED, suite
        return answer
