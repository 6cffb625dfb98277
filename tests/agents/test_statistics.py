import numpy as np
import pytest
from scipy import stats

from agents.statistics import Interval, mean_interval, paired_difference


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
