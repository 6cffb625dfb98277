import re
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from agents.statistics import (
    Interval,
    iqm,
    mean_interval,
    normalise,
    paired_bootstrap,
    paired_difference,
    performance_profile,
    probability_of_improvement,
    stratified_bootstrap,
)


def test_a_paired_difference_is_scipys_paired_t_test():
    rng = np.random.default_rng(1)
    a = rng.normal(1.0, 2.0, 40)
    b = a + rng.normal(0.3, 0.5, 40)
    ours = paired_difference(a, b)
    test = stats.ttest_rel(a, b)
    expected = test.confidence_interval(0.95)
    np.testing.assert_allclose([ours.mean, ours.low, ours.high], [np.mean(a - b), expected.low, expected.high])
    assert ours.excludes_zero == (test.pvalue < 0.05)


def test_a_mean_interval_is_scipys_t_interval():
    values = np.random.default_rng(2).normal(size=12)
    ours = mean_interval(values)
    expected = stats.ttest_1samp(values, 0.0).confidence_interval(0.95)
    np.testing.assert_allclose([ours.low, ours.high], [expected.low, expected.high])
    assert ours.half == pytest.approx(0.5 * (expected.high - expected.low))


def test_equal_values_have_an_interval_without_width():
    assert mean_interval(np.full(5, 0.25)) == Interval(0.25, 0.25, 0.25)


def test_values_that_are_missing_do_not_count():
    values = np.array([1.0, np.nan, 2.0, 4.0])
    assert mean_interval(values) == mean_interval(values[[0, 2, 3]])


def test_a_pair_counts_only_where_both_values_are_there():
    a, b = np.array([1.0, np.nan, 2.0, 5.0]), np.array([0.5, 1.0, np.nan, 1.0])
    assert paired_difference(a, b) == mean_interval(np.array([0.5, 4.0]))


@pytest.mark.parametrize("values", [[], [1.0], [np.nan, 3.0, np.nan]])
def test_fewer_than_two_values_have_no_interval(values):
    assert mean_interval(np.array(values)) is None


def test_values_that_do_not_pair_are_refused():
    with pytest.raises(ValueError, match="3 values do not pair with 2"):
        paired_difference(np.zeros(3), np.zeros(2))


def mean(scores):
    """Of all runs and tasks; what a bootstrap of has a known answer."""
    return np.mean(scores, axis=(-2, -1))


def ends(interval):
    return np.array([interval.mean, interval.low, interval.high])


@pytest.fixture
def scores():
    return np.random.default_rng(3).normal([0.2, 0.5, 0.9], [0.1, 0.3, 0.02], (10, 3))


def test_the_dead_reckoners_score_is_zero_the_truths_one_and_what_lies_beyond_is_not_clipped():
    np.testing.assert_allclose(normalise([0.4, 0.5, 0.6, 0.8, 0.9], 0.4, 0.8), [0.0, 0.25, 0.5, 1.0, 1.25])
    np.testing.assert_allclose(
        normalise([[0.3, 3.0], [0.5, 1.0]], [0.4, 2.0], [0.8, 4.0]), [[-0.25, 0.5], [0.25, -0.5]]
    )


@pytest.mark.parametrize(("floor", "ceiling"), [(0.5, 0.5), (0.8, 0.4), ([0.1, 0.5], [0.9, 0.3]), (np.nan, 1.0)])
def test_a_ceiling_that_is_not_above_its_floor_is_refused(floor, ceiling):
    with pytest.raises(ValueError, match="must be above the floor"):
        normalise(np.zeros(2), floor, ceiling)


def test_the_iqm_of_eight_scores_is_the_mean_of_the_middle_four():
    assert iqm(np.array([[100.0, 2.0], [5.0, -90.0], [1.0, 4.0], [3.0, 6.0]])) == np.mean([2.0, 3.0, 4.0, 5.0])


@pytest.mark.parametrize("shape", [(1, 1), (2, 1), (3, 1), (5, 1), (10, 1), (10, 4), (7, 3), (20, 2)])
def test_the_iqm_is_rliables(shape):
    values = np.random.default_rng(4).normal(size=(6, *shape))
    expected = [stats.trim_mean(one, proportiontocut=0.25, axis=None) for one in values]
    np.testing.assert_allclose(iqm(values), expected, rtol=0.0, atol=1e-12)


def test_two_runs_of_zero_and_one_are_worth_a_half_between_zero_and_one():
    # One degree of freedom: Student's quantile is 12.7, so the limits are the least and the greatest possible mean.
    assert stratified_bootstrap(np.array([[0.0], [1.0]]), mean) == Interval(0.5, 0.0, 1.0)


def test_runs_are_redrawn_in_each_task_on_its_own_and_tasks_are_not():
    assert stratified_bootstrap(np.array([[0.0, 1.0], [1.0, 0.0]]), mean) == Interval(0.5, 0.0, 1.0)
    assert stratified_bootstrap(np.array([[0.0, 1.0], [0.0, 1.0]]), mean) == Interval(0.5, 0.5, 0.5)


@pytest.mark.parametrize(("runs", "tasks"), [(10, 1), (20, 1), (10, 4), (20, 4), (6, 6)])
def test_the_bootstrap_of_a_mean_is_students_interval(runs, tasks):
    """In width, on average over 50 samples: its scatter there is below 1 %, its third-order terms below 5 %."""
    rng = np.random.default_rng(5)
    ratios = []
    for seed in range(50):
        sample = rng.normal(size=(runs, tasks))
        error = np.sqrt(sample.var(axis=0, ddof=1).sum() / runs) / tasks
        width = stratified_bootstrap(sample, mean, seed, 4000).half
        ratios.append(width / (stats.t.ppf(0.975, tasks * (runs - 1)) * error))
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.05)


def test_runs_of_one_seed_are_redrawn_together(scores):
    better = scores + 0.25
    np.testing.assert_allclose(ends(paired_bootstrap(better, scores)), 0.25, atol=1e-12)
    assert stratified_bootstrap(scores).half > 0.01


def test_a_paired_bootstrap_turns_its_sign_with_the_order(scores):
    other = scores + np.random.default_rng(6).normal(0.05, 0.1, scores.shape)
    forth, back = paired_bootstrap(other, scores), paired_bootstrap(scores, other)
    np.testing.assert_allclose(ends(forth), -ends(back)[[0, 2, 1]], atol=1e-12)
    assert forth.mean == pytest.approx(iqm(other) - iqm(scores), abs=1e-12)


def test_a_run_beats_another_by_the_pairs_it_wins_and_half_of_the_ties():
    # 3 beats 2 and 1, 1 loses to 2 and ties with 1.
    assert probability_of_improvement([[3.0], [1.0]], [[2.0], [1.0]]).mean == 2.5 / 4.0


@pytest.mark.parametrize("other_runs", [10, 4, 17])
def test_the_probability_of_improvement_is_rliables(other_runs):
    rng = np.random.default_rng(7)
    x, y = rng.integers(0, 6, (10, 3)), rng.integers(1, 6, (other_runs, 3))  # integers tie
    won = [stats.mannwhitneyu(x[:, k], y[:, k], alternative="greater").statistic / (10 * other_runs) for k in range(3)]
    assert probability_of_improvement(x, y).mean == pytest.approx(np.mean(won), abs=1e-12)


def test_two_agents_probabilities_of_improvement_sum_to_one_and_an_agents_over_itself_is_a_half(scores):
    other = np.random.default_rng(8).normal(0.5, 0.3, (6, 3))
    forth, back = probability_of_improvement(scores, other), probability_of_improvement(other, scores)
    assert forth.mean + back.mean == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose([forth.low, forth.high], [1.0 - back.high, 1.0 - back.low], atol=1e-12)
    assert 0.0 < forth.low < forth.mean < forth.high < 1.0
    assert probability_of_improvement(scores, scores).mean == pytest.approx(0.5, abs=1e-12)


def test_only_the_order_of_scores_matters_to_the_probability_of_improvement(scores):
    other = np.random.default_rng(9).normal(0.5, 0.3, (6, 3))
    assert probability_of_improvement(np.exp(scores), np.exp(other)) == probability_of_improvement(scores, other)


def test_a_profile_is_the_share_of_scores_strictly_above_each_threshold():
    profile = performance_profile(np.array([[0.2, 0.9], [0.4, 0.6]]), [0.0, 0.2, 0.6, 0.9])
    assert [point.mean for point in profile] == [1.0, 0.75, 0.25, 0.0]


def test_a_profile_and_its_band_fall_from_one_to_zero(scores):
    thresholds = np.linspace(-1.0, 2.0, 31)
    profile = np.array([ends(point) for point in performance_profile(scores, thresholds)])
    np.testing.assert_allclose(profile[:, 0], [np.mean(scores > tau) for tau in thresholds], atol=1e-12)  # rliable
    assert np.all(np.diff(profile, axis=0) <= 0.0)
    assert np.all((profile[:, 1] <= profile[:, 0]) & (profile[:, 0] <= profile[:, 2]))
    assert profile[0, 0] == profile[0, 2] == 1.0
    assert profile[-1, 0] == profile[-1, 1] == 0.0


@pytest.mark.parametrize("hits", range(6))
def test_the_band_of_a_profile_is_the_exact_interval_of_a_binomial_share(hits):
    scores = np.array([[float(i < hits)] for i in range(5)])
    exact = stats.binomtest(hits, 5).proportion_ci(0.95, method="exact")
    [ours] = performance_profile(scores, [0.5])
    np.testing.assert_allclose([ours.low, ours.high], [exact.low, exact.high], atol=1e-9)


def test_five_runs_that_all_win_may_still_lose_every_second_time():
    """A winner that fails in 52 % of its runs shows five good ones with probability 0.025."""
    won = probability_of_improvement(np.ones((5, 1)), np.zeros((5, 1)))
    np.testing.assert_allclose(ends(won), [1.0, 0.025 ** (1 / 5), 1.0])


def test_which_run_is_called_the_first_does_not_matter(scores):
    rng = np.random.default_rng(10)
    shuffled = rng.permuted(scores, axis=0)
    other = rng.normal(0.5, 0.3, scores.shape)
    assert iqm(shuffled) == pytest.approx(iqm(scores), abs=1e-12)
    np.testing.assert_allclose(  # the draws differ, their distribution does not
        ends(stratified_bootstrap(shuffled)), ends(stratified_bootstrap(scores)), atol=0.01
    )
    assert probability_of_improvement(shuffled, other).mean == pytest.approx(
        probability_of_improvement(scores, other).mean, abs=1e-12
    )


def test_the_iqm_and_its_interval_follow_a_change_of_scale(scores):
    ours = ends(stratified_bootstrap(scores))
    np.testing.assert_allclose(ends(stratified_bootstrap(3.0 * scores - 7.0)), 3.0 * ours - 7.0, atol=1e-12)
    np.testing.assert_allclose(ends(stratified_bootstrap(-scores)), -ours[[0, 2, 1]], atol=1e-12)


def test_an_interval_contains_its_estimate_and_stays_within_the_scores():
    rng = np.random.default_rng(11)
    for runs, tasks in [(2, 1), (3, 1), (5, 1), (5, 4), (10, 2)]:
        sample = rng.beta(4.0, 1.0, (runs, tasks))
        interval = stratified_bootstrap(sample)
        within = [sample.min(), interval.low, interval.mean, interval.high, sample.max()]
        assert np.all(np.diff(within) >= -1e-12)


def test_equal_seeds_give_equal_intervals_and_others_nearly_so(scores):
    one, same, other = (stratified_bootstrap(scores, seed=seed) for seed in (1, 1, 2))
    assert one == same != other
    np.testing.assert_allclose(ends(one), ends(other), atol=0.1 * one.half)


def test_one_run_has_no_bootstrap():
    one = np.array([[0.3, 0.4]])
    assert stratified_bootstrap(one) is None
    assert paired_bootstrap(one, one) is None


@pytest.mark.parametrize("wrong", [np.zeros(5), np.zeros((0, 2)), np.array([[0.0], [np.nan]]), np.zeros((3, 2, 100))])
def test_scores_that_are_not_a_matrix_of_numbers_are_refused(wrong):
    with pytest.raises(ValueError, match="scores must"):
        stratified_bootstrap(wrong)


def test_agents_that_cannot_be_compared_are_refused():
    with pytest.raises(ValueError, match="do not pair"):
        paired_bootstrap(np.zeros((5, 2)), np.zeros((6, 2)))
    with pytest.raises(ValueError, match="2 tasks cannot be compared with 3"):
        probability_of_improvement(np.zeros((5, 2)), np.zeros((5, 3)))


def normal(rng, size):
    return rng.normal(size=size)


def skewed(rng, size):
    return rng.lognormal(size=size)


def bounded(rng, size):
    return rng.beta(4.0, 1.0, size)


def collapsing(rng, size):
    """One training in five fails."""
    return np.where(rng.random(size) < 0.2, rng.normal(0.2, 0.05, size), rng.normal(0.9, 0.03, size))


@pytest.mark.parametrize(("draw", "tasks"), [(normal, 1), (skewed, 2), (bounded, 4), (collapsing, 1)])
def test_the_interval_of_an_iqm_at_ten_runs_holds_the_truth_nine_times_in_ten(draw, tasks):
    """400 studies each. At a true coverage of 95 % this would fail once in 70,000 times, at 87 % in 96 of 100."""
    rng = np.random.default_rng(12)
    truth = iqm(draw(rng, (400_000, 1)))
    intervals = [stratified_bootstrap(draw(rng, (10, tasks)), seed=seed, repetitions=2000) for seed in range(400)]
    assert np.mean([interval.low <= truth <= interval.high for interval in intervals]) >= 0.9


@pytest.mark.parametrize("runs", [5, 10])
@pytest.mark.parametrize("rival", [bounded, lambda rng, size: rng.normal(0.6, 0.02, size)], ids=["bounded", "between"])
def test_the_interval_of_a_probability_of_improvement_holds_the_truth_nine_times_in_ten(runs, rival):
    """400 studies each, as above; a rival whose runs are all alike and lie between success and failure is the worst."""
    rng = np.random.default_rng(14)
    truth = stats.mannwhitneyu(collapsing(rng, 100_000), rival(rng, 100_000)).statistic / 1e10
    studies = [(collapsing(rng, (runs, 1)), rival(rng, (runs, 1))) for _ in range(400)]
    intervals = [probability_of_improvement(x, y) for x, y in studies]
    assert np.mean([interval.low <= truth <= interval.high for interval in intervals]) >= 0.9


def test_episodes_are_not_the_unit():
    """Runs differ by 0.1, episodes by 0.2: an interval over all episodes misses mostly, one over runs seldom.

    200 studies each; at its nominal 5 % the second would miss 20 times or more once in 400 times.
    """
    rng = np.random.default_rng(13)
    missed = np.zeros(2)
    for seed in range(200):
        episodes = rng.normal(0.0, 0.1, (10, 1)) + rng.normal(0.0, 0.2, (10, 100))
        over_runs = stratified_bootstrap(episodes.mean(axis=1, keepdims=True), mean, seed, 2000)
        for i, interval in enumerate([mean_interval(episodes.ravel()), over_runs]):
            missed[i] += not interval.low <= 0.0 <= interval.high
    assert missed[0] > 100
    assert missed[1] < 20


def test_the_example_of_the_page_runs():
    page = (Path(__file__).parents[2] / "docs" / "statistics.md").read_text(encoding="utf-8")
    [code] = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    exec(compile(code, "docs/statistics.md", "exec"), {"__name__": "page"})
