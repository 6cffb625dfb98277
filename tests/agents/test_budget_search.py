"""The search of the cheapest suite simulates what decides, and errs as rarely as it says."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations, product
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
    relative_score,
)
from agents.budget.sensors import no_worse
from agents.budget.suites import Choice, no_better, price_list, suites_of, worthwhile
from agents.statistics import Interval
from vessel_gym.sensors import Bias, Sensor, plain

KEEP, FRESH = 0.95, 500_000
RARELY = 1e-3
"""Probability with which a test of a rate fails by chance; its seeds are fixed."""
RANKS = np.array(sorted(product(range(3), repeat=3), key=lambda ranks: -sum(ranks)))
"""Ranks of 27 suites, the cheapest first."""
NO_BETTER = (RANKS[:, None] >= RANKS).all(-1)
COSTS = 6 - RANKS.sum(1)


def flights(shares: np.ndarray, seed: int, sd: float = 0.04, disaster: float = 0.0) -> Fly:
    """Simulations of suites that reach shares of the reference score; some are lost by chance."""

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
    search = Search(COSTS, NO_BETTER, KEEP, fly, 1024)
    search.run(lambda done, total: None)
    search.confirm(FRESH)
    return search.answer, search


def confirmed(shares: np.ndarray, fly: Fly, episodes: int) -> tuple[list[int], int | None]:
    """Suites that are tried on fresh seeds, each cheaper and less safe than the last, and answer."""
    count = len(shares)
    found = {i: Interval(1.0, 1.0 - 0.01 * i, 1.0) for i in range(count)}
    search = Search(range(count, 0, -1), NO_BETTER, KEEP, fly, episodes, shares=found)
    search.verdicts = dict.fromkeys(found, OPEN)
    search.confirm(FRESH)
    return list(search.confirmed), search.answer


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


@pytest.mark.nightly
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


def test_a_share_is_that_of_the_means():
    truth = np.array([0.5, 0.7, 0.9])
    share = relative_score(0.8 * truth, truth)
    assert (share.low, share.mean, share.high) == pytest.approx((0.8, 0.8, 0.8))
    assert relative_score(truth[::-1] ** 2, truth).mean == pytest.approx((truth**2).sum() / 2.1)


# --- the search ----------------------------------------------------------------------------------


def test_without_noise_the_answer_is_that_of_flying_everything():
    """Each step of a sensor has a loss and a price: better grades cost more and score more."""
    for seed in range(50):
        steps = np.random.default_rng(seed).uniform(0.001, 0.1, (2, 3, 3)) * [0, 1, 1]
        losses, prices = steps.cumsum(-1)[:, range(3), RANKS].sum(-1)
        order = np.argsort(-prices)
        no_better = NO_BETTER[np.ix_(order, order)]
        search = Search(-prices[order], no_better, KEEP, flights(1 - losses[order], 0, 0.0), 64)
        search.run(lambda done, total: None)
        search.confirm(FRESH)
        assert search.answer == np.flatnonzero(1 - losses[order] >= KEEP)[0]


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

    search = Search(COSTS, NO_BETTER, KEEP, watched, 1024)
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


# --- what is said of the search -------------------------------------------------------------------


def test_worse_sensors_that_score_more_are_found_and_seldom_else():
    """Of 40 searches with equal shares, at most 5 name a pair: 2.5 % do, once in a thousand 6."""
    named = 0
    for seed in range(40):
        search = Search(COSTS, NO_BETTER, KEEP, flights(np.ones(len(RANKS)), seed), 64)
        search._look([TRUTH, *range(0, 27, 2)], 0, 64)
        named += bool(search.contradictions())
    assert named <= binom.isf(RARELY, 40, 0.025)
    shares = np.where(RANKS[:, 0] == 2, 1.1, 0.9)  # the worst grade of the first sensor is best
    search = Search(COSTS, NO_BETTER, KEEP, flights(shares, 0), 64)
    search._look([TRUTH, *range(27)], 0, 64)
    found = search.contradictions()
    assert found
    for worse, better in found:
        assert NO_BETTER[worse, better]
        assert RANKS[worse, 0] == 2 > RANKS[better, 0]


# --- suites --------------------------------------------------------------------------------------


def sensor(sd: float, rate: float = 1.0, **bias: Any) -> Sensor:
    """A sensor of one channel."""
    given = {key: value if key == "time" else (value,) for key, value in bias.items()}
    slow = Bias(("bias",), **given) if bias else None
    return Sensor("s", ("s",), plain((0,)), (sd,), rate=rate, bias=slow)


CHOICES = {
    "receiver": [
        Choice("good", "good", sensor(1.0)),
        Choice("good at 0.5 Hz", "good", sensor(1.0, 0.5)),
        Choice("bad", "bad", sensor(3.0)),
    ],
    "compass": [
        Choice("gyro", "gyro", sensor(0.1)),
        Choice("magnetic", "magnetic", sensor(0.1, start=0.2)),
    ],
}
PRICES = {"receiver": {"good": 100, "bad": 10.5}, "compass": {"gyro": 1000, "magnetic": 0}}


@pytest.mark.parametrize(
    ("one", "other", "forth", "back"),
    [
        (sensor(1.0), sensor(1.0), True, True),
        (sensor(1.0), sensor(2.0), True, False),
        (sensor(1.0, 2.0), sensor(1.0, 1.0), True, False),
        (sensor(1.0), sensor(0.5, start=0.1), False, False),
        (sensor(1.0), sensor(1.0, start=0.1, time=60.0), True, False),
        (sensor(1.0, start=0.1, time=30.0), sensor(2.0, start=0.2, time=60.0), False, False),
        (sensor(1.0, start=0.1), sensor(1.0, start=0.1, constant=0.1), True, False),
        (replace(sensor(1.0), latency=1.0), sensor(1.0), False, True),
        (replace(sensor(1.0), dropout=0.1), replace(sensor(1.0), outliers=0.1), False, False),
    ],
)
def test_order_of_sensors_is_that_of_every_error(one, other, forth, back):
    assert (no_worse(one, other), no_worse(other, one)) == (forth, back)


@pytest.mark.parametrize("order", list(permutations(range(3))))
def test_order_of_a_grades_file_changes_nothing(order):
    grades = [("a", sensor(1.0), 30), ("b", sensor(2.0), 20), ("c", sensor(3.0), 10)]
    choices = {"s": [Choice(grades[i][0], *grades[i][:2]) for i in order]}
    for prices in (None, {"s": {name: price for name, _, price in grades}}):
        costs = price_list(choices, prices)
        suites = suites_of(*worthwhile(choices, costs)[:1], costs)
        assert [str(suite) for suite in suites] == ["s: c", "s: b", "s: a"]
        assert (no_better(suites) == np.triu(np.ones((3, 3)))).all()
    assert costs["s"] == {"a": 30.0, "b": 20.0, "c": 10.0}
    assert price_list(choices, None)["s"] == {"a": 2.0, "b": 1.0, "c": 0.0}


@pytest.mark.parametrize(
    ("prices", "kept", "instead"),
    [
        ({"good": 10, "bad": 20}, ["good", "good at 0.5 Hz"], "good"),
        ({"good": 10, "bad": 10}, ["good", "good at 0.5 Hz"], "good"),
        ({"good": 20, "good at 0.5 Hz": 5, "bad": 10}, ["good at 0.5 Hz", "bad", "good"], None),
        ({"good": 20, "good at 0.5 Hz": 30, "bad": 10}, ["bad", "good"], "good"),
    ],
)
def test_a_grade_is_left_out_if_one_as_cheap_is_no_worse(prices, kept, instead):
    choices = {"receiver": CHOICES["receiver"]}
    found, dropped = worthwhile(choices, price_list(choices, {"receiver": prices}))
    assert sorted(c.words for c in found["receiver"]) == sorted(kept)
    assert len(dropped) == 3 - len(kept)
    assert all(f"because {instead} costs no more and is worse in no error" in s for s in dropped)


def test_noise_that_depends_on_measurement_needs_prices():
    choices = {"s": [Choice("far", "far", replace(sensor(1.0), sd=lambda y: y))]}
    with pytest.raises(ValueError, match="so its grades have no order: give their prices with"):
        price_list(choices, None)
    assert price_list(choices, {"s": {"far": 3}}) == {"s": {"far": 3.0}}


def test_suites_are_sorted_by_price_then_rate():
    found = suites_of(CHOICES, price_list(CHOICES, PRICES))
    assert [suite.cost[0] for suite in found] == [10.5, 100.0, 100.0, 1010.5, 1100.0, 1100.0]
    assert str(found[1]) == "receiver: good at 0.5 Hz, compass: magnetic"
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
