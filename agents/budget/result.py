"""The cheapest suite that keeps a share of the truth's score: searched, confirmed, and what lies round it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from agents.budget.flights import Flights, World
from agents.budget.search import DOES, OPEN, TRUTH, Progress, Search, answer, confirm, looks
from agents.budget.suites import Suite, levels
from agents.statistics import Interval

FRESH = 500_000
"""Number of seeds from the first one of the search to the first one of the confirmation."""
AROUND = 128
"""Episodes of the suites that a picture shows round the answer."""
SENSORS = 3
"""The most sensors of a picture: those of which the grades differ most in price."""


@dataclass(frozen=True, eq=False)
class Budget:
    """A search with its confirmation.

    Attributes:
        world: Flown in.
        suites: The cheapest first; other attributes name them by their numbers.
        keep: Share of the truth's score that is asked for.
        search: As it ended.
        confirmed: Shares on fresh seeds, in the order of the confirmation.
        around: The search, with suites round the answer that it did not need.
        refusals: Reasons of the environment against suites.
    """

    world: World
    suites: Sequence[Suite]
    keep: float
    search: Search
    confirmed: dict[int, Interval]
    around: Search
    refusals: dict[int, str]

    @property
    def answer(self) -> int | None:
        """The cheapest suite that is confirmed; None if there is none."""
        return answer(self.confirmed, self.keep)

    @property
    def centre(self) -> int:
        """The answer; else the suite that was nearest to one, or the best."""
        if self.answer is not None:
            return self.answer
        tried = list(self.confirmed) or sorted(
            self.search.shares, key=lambda i: -self.search.shares[i].low
        )
        return tried[0] if tried else len(self.suites) - 1

    @property
    def cheaper(self) -> range:
        """Suites that cost less than the answer; all without one."""
        return range(len(self.suites)) if self.answer is None else self.search.cheaper(self.answer)

    @property
    def undecided(self) -> list[int]:
        """Suites cheaper than the answer that may keep the share, too: flown to the end, or not confirmed."""
        may = [i for i in self.cheaper if self.search.verdicts.get(i) in (OPEN, DOES)]
        return [i for i in may if i not in self.confirmed or self.confirmed[i].high >= self.keep]

    @property
    def surprises(self) -> list[int]:
        """Suites cheaper than the answer that were skipped as no better than one that fails, and yet keep the share."""
        flown = [i for i in self.cheaper if i not in self.search.scores]
        return [i for i in flown if self.around.verdicts.get(i) == DOES]

    def sensors(self, suite: int) -> list[str]:
        """Sensors of which there is a choice, those that differ most in price first, up to `SENSORS`."""
        chosen = self.suites[suite].choices
        found = {
            sensor: [
                other.price for other in map(self.suites.__getitem__, self.line(suite, sensor))
            ]
            for sensor in chosen
        }
        found = {sensor: prices for sensor, prices in found.items() if len(prices) > 1}
        return sorted(found, key=lambda sensor: min(found[sensor]) - max(found[sensor]))[:SENSORS]

    def line(self, suite: int, *sensors: str) -> list[int]:
        """Suites that differ from one in some sensors at most, the best first."""
        chosen = self.suites[suite].choices
        same = [
            i for i, other in enumerate(self.suites)
            if all(other.choices[name] == chosen[name] for name in chosen if name not in sensors)
        ]  # fmt: skip
        return sorted(same, key=lambda i: self.suites[i].ranks)

    def neighbours(self, suite: int) -> list[int]:
        """Suites with one sensor a choice worse."""
        found = []
        for sensor in self.suites[suite].choices:
            line = self.line(suite, sensor)
            found += line[line.index(suite) + 1 :][:1]
        return found


def cheapest(
    flights: Flights, keep: float, episodes: int, progress: Progress | None = None
) -> Budget:
    """Search the cheapest suite that keeps a share of the truth's score, and confirm it on fresh seeds.

    Args:
        flights: Of all suites.
        keep: The share, above 0 and at most 1.
        episodes: The most of a suite in the search, and their number in the confirmation.
        progress: Called as the search goes on.

    Raises:
        ValueError: if the truth scores nothing, so that there is no share of it.
        RuntimeError: if a flight failed.
        OSError: if the results cannot be written.
    """
    ranks = np.array([suite.ranks for suite in flights.suites])
    search = Search(levels(flights.suites), ranks, keep, flights, episodes)
    search.run(progress)
    confirmed = confirm(search.sequence, keep, flights, FRESH, episodes)
    around = replace(
        search,
        scores=dict(search.scores),
        shares=dict(search.shares),
        verdicts=dict(search.verdicts),
    )
    found = Budget(flights.world, flights.suites, keep, search, confirmed, around, flights.refusals)
    look_around(found)
    return found


def look_around(budget: Budget) -> None:
    """Fly the suites that a picture shows, and the neighbours of the answer, as far as they are not flown."""
    centre, around = budget.centre, budget.around
    pairs = combinations(budget.sensors(centre), 2)
    needed = {
        centre,
        *budget.neighbours(centre),
        *(i for pair in pairs for i in budget.line(centre, *pair)),
    }
    least = next((look for look in looks(around.episodes) if look >= AROUND), around.episodes)
    few = {
        i: least
        for i in sorted(needed)
        if len(around.scores.get(i, ())) < least and i not in budget.refusals
    }
    if few:
        around.extend({TRUTH: max(least, len(around.scores.get(TRUTH, ())))} | few)
        for i in few:
            if i in around.scores:
                around.judge(i)
