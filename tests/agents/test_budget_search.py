"""The search of the cheapest suite flies what decides, and errs as rarely as it says."""

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

from agents.budget.search import (
    CONFIRMED,
    DOES,
    FAILS,
    OPEN,
    REFUSED,
    TRUTH,
    Fly,
    Search,
    looks,
    share_kept,
)
from agents.budget.suites import Choice, price_list, suites_of
from agents.statistics import Interval

KEEP, FRESH = 0.95, 500_000
RARELY = 1e-3
"""Probability with which a test of a rate fails by chance; its seeds are fixed."""
RANKS = np.array(sorted(product(range(3), repeat=3), key=lambda ranks: -sum(ranks)))
"""Ranks of 27 suites, the cheapest first."""
COSTS = 6 - RANKS.sum(1)


def flights(shares: np.ndarray, seed: int, sd: float = 0.04, disaster: float = 0.0) -> Fly:
    """Flights of suites that keep shares of the truth's score; some are lost by chance."""

    def fly(suites: Sequence[int], first: int, episodes: int) -> list[Any]:
        found: list[Any] = []
        for suite in suites:
            truth = np.random.default_rng([seed, first]).beta(30.0, 5.0, episodes)
            own = np.random.default_rng([seed, first, suite + 2])
            noise = sd * own.normal(size=episodes)
            noise += 0.5 * (disaster - (own.random(episodes) < disaster))
            found.append(truth if suite == TRUTH else shares[suite] * truth + noise)
        return found

    return fly


def procedure(fly: Fly) -> tuple[Any, Search]:
    """Answer and search with some flights."""
    search = Search(COSTS, RANKS, KEEP, fly, 1024)
    search.run(lambda done, total: None)
    return search.confirm(FRESH), search


def confirmed(shares: np.ndarray, fly: Fly, episodes: int) -> tuple[list[int], int | None]:
    """Suites that are tried on fresh seeds, each cheaper and less safe than the last, and answer."""
    count = len(shares)
    found = {i: Interval(1.0, 1.0 - 0.01 * i, 1.0) for i in range(count)}
    search = Search(range(count, 0, -1), RANKS, KEEP, fly, episodes, shares=found)
    search.verdicts = dict.fromkeys(found, OPEN)
    answer = search.confirm(FRESH)
    return list(search.confirmed), answer


def rare(hits: int, trials: int, probability: float) -> bool:
    """True if so many hits are plausible for a probability of at most this one."""
    return hits <= binom.isf(RARELY, trials, probability)


# --- the statistics ------------------------------------------------------------------------------


@pytest.mark.parametrize("disaster", [0.0, 0.01])
def test_suite_at_border_is_confirmed_in_2_5_percent(disaster: float):
    trials, border = 1000, np.array([KEEP])
    hits = sum(
        confirmed(border, flights(border, i, disaster=disaster), 1024)[1] is not None
        for i in range(trials)
    )
    assert rare(hits, trials, 0.025)
    assert hits >= binom.ppf(RARELY, trials, 0.01)  # nor does it ask for more than it says


@pytest.mark.slow
@pytest.mark.parametrize("world", ["one suite does", "disasters", "better need not be better"])
def test_the_whole_procedure_rarely_errs(world: str):
    """All others keep a trifle too little, or any share whatever their grades are."""
    trials, wrong = 150, 0
    for seed in range(trials):
        shares = np.full(len(RANKS), KEEP - 1e-9)
        shares[-1] = 1.0
        if world == "better need not be better":
            shares = np.random.default_rng(seed).uniform(0.93, 0.97, len(RANKS))
        found, _ = procedure(flights(shares, seed, disaster=0.01 * (world == "disasters")))
        wrong += found is not None and shares[found] < KEEP
    assert rare(wrong, trials, 0.025)


@pytest.mark.slow
def test_all_intervals_of_a_search_hold_at_once():
    """The share is 0.965 with two steps and 0.945 with three, half a standard deviation less."""
    trials, misses, shares = 100, 0, 1.005 - 0.02 * RANKS.sum(1)
    for seed in range(trials):
        found, search = procedure(flights(shares, seed))
        assert COSTS[found] == 4
        misses += any(not s.low <= shares[i] <= s.high for i, s in search.shares.items())
    assert rare(misses, trials, 0.05)


def test_a_share_is_that_of_the_means():
    truth = np.array([0.5, 0.7, 0.9])
    share = share_kept(0.8 * truth, truth)
    assert (share.low, share.mean, share.high) == pytest.approx((0.8, 0.8, 0.8))
    assert share_kept(truth[::-1] ** 2, truth).mean == pytest.approx((truth**2).sum() / 2.1)


# --- the search ----------------------------------------------------------------------------------


def test_without_noise_the_answer_is_that_of_flying_everything():
    """Each step of a sensor has a loss and a price: better grades cost more and score more."""
    for seed in range(50):
        steps = np.random.default_rng(seed).uniform(0.001, 0.1, (2, 3, 3)) * [0, 1, 1]
        losses, prices = steps.cumsum(-1)[:, range(3), RANKS].sum(-1)
        order = np.argsort(-prices)
        search = Search(-prices[order], RANKS[order], KEEP, flights(1 - losses[order], 0, 0.0), 64)
        search.run(lambda done, total: None)
        assert search.confirm(FRESH) == np.flatnonzero(1 - losses[order] >= KEEP)[0]


def test_nothing_is_flown_that_cannot_change_the_answer():
    plain, flown = flights(1.005 - 0.03 * RANKS.sum(1), 0), []

    def watched(suites: Sequence[int], first: int, episodes: int) -> list[Any]:
        flown.extend([episodes] * (len(suites) - 1))
        cheapest = min((i for i, found in search.verdicts.items() if found == DOES), default=99)
        for suite in set(suites) - {TRUTH}:
            assert search.verdicts.get(suite, OPEN) == OPEN
            assert suite < cheapest
            assert first == len(search.scores.get(suite, ()))
            failed = RANKS[[i for i, found in search.verdicts.items() if found == FAILS]]
            assert not (RANKS[suite] >= failed).all(-1).any()
        return plain(suites, first, episodes)

    search = Search(COSTS, RANKS, KEEP, watched, 1024)
    search.run(lambda done, total: None)
    assert sum(flown) == sum(len(own) for i, own in search.scores.items() if i != TRUTH)
    assert sum(flown) < 0.3 * 1024 * len(RANKS)
    assert looks(100) == [32, 64, 100]


def test_a_suite_that_the_environment_refuses_is_left_out():
    plain = flights(np.ones(len(RANKS)), 0)

    def fly(suites: Sequence[int], *seeds: int) -> list[Any]:
        return [None if i == 0 else plain([i], *seeds)[0] for i in suites]

    answer, search = procedure(fly)
    assert search.verdicts[0] == REFUSED
    assert search.verdicts[answer] == CONFIRMED
    assert COSTS[search.sequence[-1]] == 1


def test_suites_are_confirmed_from_safest_to_cheapest():
    for seed in range(10):
        noise = 0.04 * (seed % 2)
        _, search = procedure(flights(1.0 - 0.0125 * RANKS.sum(1), seed, noise))
        order = search.sequence
        low = [search.shares[i].low for i in order]
        assert (sorted(low), sorted(set(COSTS[order]))) == (low[::-1], list(COSTS[order][::-1]))
        assert sum(search.verdicts[i] == DOES for i in order) <= 2
    true = np.array([0.97, 0.80, 0.99])
    assert confirmed(true, flights(true, 0), 256) == ([0, 1], 0)


# --- suites --------------------------------------------------------------------------------------

CHOICES = {
    "receiver": [
        Choice("good", "good", (0, 0)),
        Choice("good at 0.5 Hz", "good", (0, 1)),
        Choice("bad", "bad", (1, 0)),
    ],
    "compass": [Choice("gyro", "gyro", (0, 0)), Choice("magnetic", "magnetic", (1, 0))],
}
PRICES = {"receiver": {"good": 100, "bad": 10.5}, "compass": {"gyro": 1000, "magnetic": 0}}


def test_suites_are_sorted_by_price_then_rate():
    found = suites_of(CHOICES, price_list(CHOICES, PRICES))
    assert [suite.cost[0] for suite in found] == [10.5, 100.0, 100.0, 1010.5, 1100.0, 1100.0]
    assert str(found[1]) == "receiver good at 0.5 Hz, compass magnetic"
    cheap = PRICES | {"receiver": {"good": 100, "good at 0.5 Hz": 1, "bad": 10.5}}
    assert str(suites_of(CHOICES, price_list(CHOICES, cheap))[0]) == str(found[1])
    steps = suites_of(CHOICES, price_list(CHOICES, None))
    assert [suite.cost[0] for suite in steps] == [0.0, 1.0, 1.0, 1.0, 2.0, 2.0]


@pytest.mark.parametrize(
    ("prices", "sentence"),
    [
        ({"receivr": {}}, "unknown sensor in the prices 'receivr' (did you mean 'receiver'?)"),
        ({"receiver": 3}, "prices of receiver must be a table of numbers by grade, got 3"),
        ({"receiver": {"godo": 1}}, "unknown grade of receiver in the prices 'godo' (did you"),
        ({"receiver": {"good": -1}}, "the price of receiver, good, must be a number from 0 to 1e+12, got -1"),
        ({"receiver": {"good": True}}, "must be a number from 0 to 1e+12, got True"),
        ({"receiver": {"good": float("nan")}}, "must be a number from 0 to 1e+12, got nan"),
        ({"receiver": {"good": 10**400}}, "must be a number from 0 to 1e+12, got 1000"),
        ({"receiver": PRICES["receiver"]}, "the prices lack the grade 'gyro' of compass"),
    ],
)  # fmt: skip
def test_a_price_that_makes_no_sense_is_refused(prices: dict[str, object], sentence: str):
    with pytest.raises(ValueError, match=r"^[^\n]*$") as refused:
        price_list(CHOICES, prices)
    assert sentence in str(refused.value)


def test_too_many_suites_are_refused():
    many = {str(i): CHOICES["receiver"] for i in range(7)}
    with pytest.raises(ValueError, match="there are 2187 suites to choose from, and at most 2000"):
        suites_of(many, {})
