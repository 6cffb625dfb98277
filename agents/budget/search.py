"""Sequential search for the cheapest suite that keeps a share of the truth's score, and its confirmation.

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
from typing import NamedTuple

import numpy as np

from agents.statistics import Interval, normalise, skewed_interval

TRUTH = -1
"""Stands for the truth among the numbers of suites."""
FIRST_LOOK = 32
"""Episodes after which a suite is looked at first; their number doubles from look to look."""
ROUND = 16
"""Suites that are flown before the next choice. A constant, so that no result depends on the number of processes."""
DOES, FAILS, OPEN, REFUSED = "keeps it", "keeps less", "not decided", "refused"
"""Verdicts on a suite. Refused: the environment cannot fly the estimator on these sensors."""


class Request(NamedTuple):
    """Episodes of a suite, or of the `TRUTH`, on the seeds from number ``first`` on."""

    suite: int
    first: int
    episodes: int


Fly = Callable[[Sequence[Request]], list[np.ndarray | None]]
"""Scores ``(episodes,)`` of each request; None for a suite that the environment refuses."""
Progress = Callable[[int, int], None]
"""Called with the number of suites that are decided or need no flight, and with the number of all."""


def share_kept(scores: np.ndarray, truth: np.ndarray, comparisons: int = 1) -> Interval:
    """Mean score over the truth's on the same seeds, with an interval that follows the skewness of the differences.

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
    count = max(int(np.ceil(np.log2(episodes / FIRST_LOOK))), 0)
    return [*(FIRST_LOOK << i for i in range(count)), episodes]


@dataclass
class Search:
    """A search over suites in order of their cost, the cheapest first.

    Attributes:
        costs: ``(K,)`` of the suites, ascending.
        ranks: ``(K, s)`` of their sensors, 0 for the best.
        keep: Share of the truth's score that is asked for.
        fly: Flies what is asked for.
        episodes: The most of a suite.
        scores: Flown so far, by suite and for the `TRUTH`.
        shares: Of each suite flown, with an interval that holds for all suites and looks at once.
        verdicts: Of each suite flown.
    """

    costs: np.ndarray
    ranks: np.ndarray
    keep: float
    fly: Fly
    episodes: int
    scores: dict[int, np.ndarray] = field(default_factory=dict)
    shares: dict[int, Interval] = field(default_factory=dict)
    verdicts: dict[int, str] = field(default_factory=dict)

    @property
    def comparisons(self) -> int:
        """Number of intervals that hold at once: those of all suites at all looks, flown or not."""
        return len(self.ranks) * len(looks(self.episodes))

    def run(self, progress: Progress | None = None) -> None:
        """Fly until every suite cheaper than the cheapest one that keeps the share is decided, or has all episodes.

        A suite that is no better in any sensor than one that fails is not flown. That it fails,
        too, is an assumption: no test relies on it, but a cheaper suite may be missed where it does
        not hold.
        """
        undecided = self.undecided()
        while len(undecided):
            if progress is not None:
                progress(len(self.ranks) - len(undecided), len(self.ranks))
            self.look(self.worthwhile(undecided)[:ROUND].tolist())
            undecided = self.undecided()
        if progress is not None:
            progress(len(self.ranks), len(self.ranks))

    def undecided(self) -> np.ndarray:
        """Suites of which a further look may change the answer."""
        cheapest = min(self.where(DOES), default=len(self.ranks))
        candidates = [
            i for i in range(cheapest)
            if self.verdicts.get(i, OPEN) == OPEN and len(self.scores.get(i, ())) < self.episodes
        ]  # fmt: skip
        skipped = self.skipped(candidates)
        return np.array([i for i in candidates if i not in skipped], int)

    def cheaper(self, suite: int) -> range:
        """Suites that cost less than one."""
        return range(int(np.searchsorted(self.costs, self.costs[suite])))

    def skipped(self, suites: Sequence[int]) -> set[int]:
        """Those of some suites that were not flown and are no better in any sensor than one that fails."""
        failed = self.ranks[self.where(FAILS)]
        return {
            i for i in suites if i not in self.verdicts and (self.ranks[i] >= failed).all(-1).any()
        }

    def where(self, verdict: str) -> list[int]:
        """Suites with a verdict, the cheapest first."""
        return sorted(i for i, found in self.verdicts.items() if found == verdict)

    def worthwhile(self, undecided: np.ndarray) -> np.ndarray:
        """Undecided suites by what their next look settles an episode, whichever way it ends, the most first.

        A suite that fails settles those that are no better in any sensor; one that keeps the share,
        the dearer ones.
        """
        ranks = self.ranks[undecided]
        if_fails = np.array([(ranks >= one).all(-1).sum() for one in ranks])
        costs = self.costs[undecided]
        if_does = len(costs) - np.searchsorted(costs, costs)
        price = np.array([self.next_look(i) - len(self.scores.get(i, ())) for i in undecided])
        return undecided[np.argsort(-np.minimum(if_fails, if_does) / price, kind="stable")]

    def next_look(self, suite: int) -> int:
        """Episodes of a suite at its next look."""
        return next(look for look in looks(self.episodes) if look > len(self.scores.get(suite, ())))

    def look(self, suites: Sequence[int]) -> None:
        """Fly suites up to their next look, and decide on them."""
        ends = {i: self.next_look(i) for i in suites}
        ends = {TRUTH: max(len(self.scores.get(TRUTH, ())), *ends.values())} | ends
        self.extend(ends)
        for i in suites:
            if self.verdicts.get(i) != REFUSED:
                self.judge(i)

    def extend(self, ends: dict[int, int]) -> None:
        """Fly suites up to numbers of episodes."""
        start = {i: len(self.scores.get(i, ())) for i in ends}
        requests = [
            Request(i, start[i], end - start[i]) for i, end in ends.items() if end > start[i]
        ]
        for request, flown in zip(requests, self.fly(requests), strict=True):
            if flown is None:
                self.verdicts[request.suite] = REFUSED
            else:
                self.scores[request.suite] = np.append(self.scores.get(request.suite, ()), flown)

    def judge(self, suite: int) -> None:
        """Compute the share that a suite keeps, and decide on it if its interval is on one side of what is asked."""
        scores = self.scores[suite]
        share = self.shares[suite] = share_kept(
            scores, self.scores[TRUTH][: len(scores)], self.comparisons
        )
        self.verdicts[suite] = (
            DOES if share.low >= self.keep else FAILS if share.high < self.keep else OPEN
        )

    @property
    def sequence(self) -> list[int]:
        """Suites to confirm, in their order: by the lower end of their interval, each cheaper than those before.

        Suites whose mean does not keep the share are left out. Of those that keep it for certain
        the two cheapest are enough, one of them for the case that the other is not confirmed.
        """
        found: list[int] = []
        good = (i for i, share in self.shares.items() if share.mean >= self.keep)
        for suite in sorted(good, key=lambda i: (-self.shares[i].low, i)):
            if not found or self.costs[suite] < self.costs[found[-1]]:
                found.append(suite)
        certain = sum(self.verdicts[i] == DOES for i in found)
        return found[max(certain - 2, 0) :]


def confirm(
    sequence: Sequence[int], keep: float, fly: Fly, first: int, episodes: int
) -> dict[int, Interval]:
    """Shares with 95 % intervals on fresh seeds of suites in their order, up to the first that is not confirmed.

    Those whose interval is not below ``keep`` are confirmed. The probability that the last one
    confirmed keeps less is at most 2.5 %, however many are tried, since the order is fixed before
    these seeds are flown.

    Args:
        sequence: See `Search.sequence`.
        keep: Share of the truth's score that is asked for.
        fly: Flies what is asked for.
        first: Number of the first fresh seed.
        episodes: Number of them.
    """
    found: dict[int, Interval] = {}
    truth = None
    for suite in sequence:
        who = [suite] if truth is not None else [TRUTH, suite]
        *new, scores = fly([Request(i, first, episodes) for i in who])
        truth = new[0] if new else truth
        assert truth is not None
        assert scores is not None
        found[suite] = share_kept(scores, truth)
        if found[suite].low < keep:
            break
    return found


def answer(confirmed: dict[int, Interval], keep: float) -> int | None:
    """The last suite that was confirmed, which is the cheapest of them; None if there is none."""
    return next((suite for suite in reversed(confirmed) if confirmed[suite].low >= keep), None)
