"""The search of the cheapest suite: it flies what decides, and its answer is wrong as rarely as it says."""

from collections.abc import Sequence
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom

from agents.budget.search import (
    DOES,
    FAILS,
    OPEN,
    TRUTH,
    Fly,
    Request,
    Search,
    answer,
    confirm,
    looks,
    share_kept,
)
from agents.budget.suites import Choice, levels, suites_of

KEEP, FRESH = 0.95, 500_000
RARELY = 1e-3
"""Probability with which a test of a rate fails by chance; its seeds are fixed."""
LEVELS = np.array(list(product(range(3), repeat=3)))
LEVELS = LEVELS[np.argsort(-LEVELS.sum(1), kind="stable")]
"""Ranks of 27 suites, the cheapest first."""
COSTS = (6 - LEVELS.sum(1)).astype(float)


def flights(shares: np.ndarray, seed: int, sd: float = 0.04, disaster: float = 0.0) -> Fly:
    """Flights of suites that keep shares of the truth's score; with this probability an episode of theirs is lost."""

    def fly(requests: Sequence[Request]) -> list[np.ndarray | None]:
        found: list[np.ndarray | None] = []
        for suite, first, episodes in requests:
            truth = np.random.default_rng([seed, first]).beta(30.0, 5.0, episodes)
            own = np.random.default_rng([seed, first, suite + 2])
            noise = sd * own.normal(size=episodes) + 0.5 * (
                disaster - (own.random(episodes) < disaster)
            )
            found.append(truth if suite == TRUTH else shares[suite] * truth + noise)
        return found

    return fly


def procedure(shares: np.ndarray, seed: int, **noise: float) -> tuple[int | None, Search]:
    """Answer and search in a world of these shares."""
    fly = flights(shares, seed, **noise)
    search = Search(COSTS, LEVELS, KEEP, fly, 1024)
    search.run()
    return answer(confirm(search.sequence, KEEP, fly, FRESH, 1024), KEEP), search


def rare(hits: int, trials: int, probability: float) -> bool:
    """True if so many hits are plausible for a probability of at most this one: false in one of 1 / `RARELY` cases."""
    return hits <= binom.isf(RARELY, trials, probability)


# --- the statistics ------------------------------------------------------------------------------


@pytest.mark.parametrize("disaster", [0.0, 0.01])
def test_a_suite_at_the_border_is_confirmed_by_chance_in_2_5_percent_of_cases(disaster: float):
    """With a symmetric error, and with one that is a disaster in an episode of a hundred."""
    trials = 1000
    found = [
        confirm([0], KEEP, flights(np.array([KEEP]), i, disaster=disaster), FRESH, 1024)
        for i in range(trials)
    ]
    hits = sum(answer(each, KEEP) is not None for each in found)
    assert rare(hits, trials, 0.025)
    assert hits >= binom.ppf(RARELY, trials, 0.01)  # nor does it ask for more than it says


@pytest.mark.slow
def test_all_intervals_of_a_search_hold_at_once_in_95_percent_of_searches():
    trials, misses = 150, 0
    for seed in range(trials):
        shares = 1.0 - 0.03 * LEVELS.sum(1) + 0.01 * LEVELS[:, 0]
        _, search = procedure(shares, seed)
        misses += any(
            not share.low <= shares[i] <= share.high for i, share in search.shares.items()
        )
    assert rare(misses, trials, 0.05)


@pytest.mark.slow
@pytest.mark.parametrize("disaster", [0.0, 0.01])
def test_the_whole_procedure_rarely_errs_where_all_but_one_suite_keep_a_trifle_too_little(
    disaster: float,
):
    trials, wrong = 150, 0
    shares = np.full(len(LEVELS), KEEP - 1e-9)
    shares[-1] = 1.0
    for seed in range(trials):
        found, _ = procedure(shares, seed, disaster=disaster)
        wrong += found is not None and found != len(shares) - 1
    assert rare(wrong, trials, 0.025)


@pytest.mark.slow
def test_the_share_kept_does_not_depend_on_better_sensors_scoring_more():
    """In worlds where suites keep any share, however their grades are."""
    trials, wrong = 150, 0
    for seed in range(trials):
        shares = np.random.default_rng(seed).uniform(0.93, 0.97, len(LEVELS))
        found, _ = procedure(shares, seed)
        wrong += found is not None and shares[found] < KEEP
    assert rare(wrong, trials, 0.025)


@pytest.mark.slow
def test_the_cheapest_suite_is_found_where_it_is_better_by_half_a_standard_deviation_of_a_difference():
    shares = 1.0 - 0.02 * LEVELS.sum(1) + 0.005  # 0.965 with two steps, 0.945 with three
    found = [procedure(shares, seed)[0] for seed in range(50)]
    assert all(each is not None and COSTS[each] == 4.0 for each in found)


def test_a_share_is_that_of_the_means_and_has_no_width_where_the_scores_are_in_proportion():
    truth = np.array([0.5, 0.7, 0.9])
    share = share_kept(0.8 * truth, truth)
    assert (share.low, share.mean, share.high) == pytest.approx((0.8, 0.8, 0.8))
    assert share_kept(np.array([0.2, 0.9, 0.1]), truth).mean == pytest.approx(1.2 / 2.1)
    with pytest.raises(ValueError, match="ceiling"):
        share_kept(truth, np.zeros(3))


# --- the search ----------------------------------------------------------------------------------


@given(
    st.lists(st.floats(0.001, 0.1), min_size=6, max_size=6),
    st.lists(st.integers(0, 100), min_size=6, max_size=6),
)
def test_without_noise_the_answer_is_that_of_flying_everything(
    losses: list[float], prices: list[int]
):
    """Losses and prices are those of a step of each sensor, so better grades cost more and score more."""
    loss, price = (
        np.cumsum(np.pad(np.reshape(each, (3, 2)), ((0, 0), (1, 0))), 1)
        for each in (losses, prices)
    )
    shares = 1.0 - loss[np.arange(3), LEVELS].sum(1)
    costs = -price[np.arange(3), LEVELS].sum(1)
    order = np.argsort(costs, kind="stable")
    fly = flights(shares[order], 0, sd=0.0)
    search = Search(costs[order], LEVELS[order], KEEP, fly, 64)
    search.run()
    found = answer(confirm(search.sequence, KEEP, fly, FRESH, 64), KEEP)
    good = costs[shares >= KEEP]
    assert found is not None
    assert costs[order][found] == good.min()
    assert shares[order][found] >= KEEP


def test_nothing_is_flown_that_cannot_change_the_answer():
    shares = 1.0 - 0.02 * LEVELS.sum(1) + 0.005
    fly, rounds = flights(shares, 0), []

    def watched(requests: Sequence[Request]) -> list[np.ndarray | None]:
        good, failed = search.where(DOES), search.where(FAILS)
        for request in requests:
            if request.suite != TRUTH:
                assert search.verdicts.get(request.suite, OPEN) == OPEN
                assert not good or COSTS[request.suite] < COSTS[good[0]]
                worse = any((LEVELS[request.suite] >= LEVELS[i]).all() for i in failed)
                assert request.suite in search.scores or not worse
        rounds.append(len(requests))
        return fly(requests)

    search = Search(COSTS, LEVELS, KEEP, watched, 1024)
    search.run()
    assert len(rounds) > 1
    flown = sum(len(scores) for i, scores in search.scores.items() if i != TRUTH)
    assert flown < 0.3 * 1024 * len(LEVELS)


def test_a_suite_that_the_environment_refuses_is_left_out():
    shares = np.ones(len(LEVELS))
    plain = flights(shares, 0)

    def fly(requests: Sequence[Request]) -> list[np.ndarray | None]:
        return [
            None if each.suite == 0 else scores
            for each, scores in zip(requests, plain(requests), strict=True)
        ]

    search = Search(COSTS, LEVELS, KEEP, fly, 128)
    search.run()
    assert 0 not in search.sequence
    assert COSTS[search.sequence[-1]] == 1.0


def test_suites_are_confirmed_from_the_safest_to_the_cheapest():
    shares = 1.0 - 0.0125 * LEVELS.sum(1)  # 0.95 with four steps
    for seed in range(10):
        _, search = procedure(shares, seed)
        order = search.sequence
        assert list(COSTS[order]) == sorted(set(COSTS[order]), reverse=True)
        assert [search.shares[i].low for i in order] == sorted(
            (search.shares[i].low for i in order), reverse=True
        )
        assert sum(search.verdicts[i] == DOES for i in order) <= 2


def test_the_first_suite_that_is_not_confirmed_ends_the_confirmation():
    fly = flights(np.array([0.97, 0.80, 0.99]), 0)
    found = confirm([0, 1, 2], KEEP, fly, FRESH, 256)
    assert list(found) == [0, 1]
    assert answer(found, KEEP) == 0
    assert answer(confirm([1, 0], KEEP, fly, FRESH, 256), KEEP) is None


def test_looks_double_up_to_the_last():
    assert looks(1024) == [32, 64, 128, 256, 512, 1024]
    assert looks(100) == [32, 64, 100]
    assert looks(32) == [32]


# --- suites --------------------------------------------------------------------------------------

CHOICES = {
    "receiver": [
        Choice("good", None, (0, 0)),
        Choice("good", 0.5, (0, 1)),
        Choice("bad", None, (1, 0)),
    ],
    "compass": [Choice("gyro", None, (0, 0)), Choice("magnetic", None, (1, 0))],
}
PRICES = {"receiver": {"good": 100, "bad": 10.5}, "compass": {"gyro": 1000, "magnetic": 0}}


def test_suites_stand_in_the_order_of_their_prices_and_of_one_price_in_that_of_their_rates():
    found = suites_of(CHOICES, PRICES)
    assert [suite.price for suite in found] == [10.5, 100.0, 100.0, 1010.5, 1100.0, 1100.0]
    assert str(found[1]) == "receiver good at 0.5 Hz, compass magnetic"
    assert list(levels(found)) == [0, 1, 2, 3, 4, 5]
    cheap = {
        "receiver": {"good": 100, "good at 0.5 Hz": 1, "bad": 10.5},
        "compass": {"gyro": 1000, "magnetic": 0},
    }
    assert str(suites_of(CHOICES, cheap)[0]) == "receiver good at 0.5 Hz, compass magnetic"


def test_without_prices_steps_to_better_grades_count():
    found = suites_of(CHOICES)
    assert [suite.price for suite in found] == [0.0, 1.0, 1.0, 1.0, 2.0, 2.0]
    assert str(found[0]) == "receiver bad, compass magnetic"


@pytest.mark.parametrize(
    ("prices", "sentence"),
    [
        ({"receivr": {}}, "unknown sensor in the prices 'receivr' (did you mean 'receiver'?)"),
        ({"receiver": 3}, "prices of receiver must be a table of numbers by grade, got 3"),
        (
            {"receiver": {"godo": 1}},
            "unknown grade of receiver in the prices 'godo' (did you mean 'good'?)",
        ),
        (
            {"receiver": {"good": -1}},
            "the price of receiver, good, must be a number from 0 to 1e+12, got -1",
        ),
        ({"receiver": {"good": True}}, "must be a number from 0 to 1e+12, got True"),
        ({"receiver": {"good": float("inf")}}, "must be a number from 0 to 1e+12, got inf"),
        ({"receiver": {"good": 10**400}}, "must be a number from 0 to 1e+12, got 1000"),
        ({"receiver": {"good": "1"}}, "must be a number from 0 to 1e+12, got '1'"),
        (
            {"receiver": PRICES["receiver"], "compass": {"gyro": 1}},
            "the prices lack the grade 'magnetic' of compass",
        ),
        ({"receiver": PRICES["receiver"]}, "the prices lack the grade 'gyro' of compass"),
    ],
)
def test_a_price_that_makes_no_sense_is_refused(prices: dict[str, object], sentence: str):
    with pytest.raises(ValueError, match=r"^[^\n]*$") as refused:
        suites_of(CHOICES, prices)  # type: ignore[arg-type]
    assert sentence in str(refused.value)


def test_too_many_suites_are_refused():
    many = {str(i): [Choice(str(j), None, (j, 0)) for j in range(4)] for i in range(6)}
    with pytest.raises(
        ValueError, match="there are 4096 suites to choose from, and at most 2000 are searched"
    ):
        suites_of(many)
