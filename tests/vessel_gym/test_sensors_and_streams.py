"""Sensors spoil readings as much as they say; streams give an environment its numbers whatever its neighbours do.

Statistical tests have fixed seeds and bands with the false-alarm rate 1e-6.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom, chi2, kstest

from vessel_gym.sensors import SUITES, Instrument, Sensors, SensorSuite, nominal_sd
from vessel_gym.streams import Draws, Purpose, entropy, stream

FALSE_ALARM = 1e-6
SD = np.array([2e-3, 0.5, 3.0])
APART = tuple(Instrument(str(i), ("",), (sd,)) for i, sd in enumerate(SD))


def corrupted(suite: SensorSuite, seed: int, n: int = 20_000, exact: float = 0.0, instruments=APART, steps=0):
    """Readings, their mask and the normals in them: n at one step, or as many as ``steps`` says."""
    rng = np.random.default_rng(seed)
    sensors = Sensors(instruments, suite)
    normals, uniforms = rng.standard_normal((n, sensors.size)), rng.random((n, sensors.uniforms))
    steps = np.broadcast_to(steps, n)
    return *sensors.read(np.full((n, sensors.size), exact), steps, normals, uniforms), normals


def assert_variance(samples: np.ndarray, variance: float):
    low, high = chi2.ppf([FALSE_ALARM / 2, 1 - FALSE_ALARM / 2], samples.size) / samples.size
    assert low * variance < np.mean(samples**2) < high * variance


def assert_rate(events: np.ndarray, rate: float):
    low, high = binom.ppf([FALSE_ALARM / 2, 1 - FALSE_ALARM / 2], events.size, rate)
    assert low <= events.sum() <= high


# --- sensors ----------------------------------------------------------------------------------------


def test_there_are_three_suites_and_only_the_worst_loses_readings():
    assert list(SUITES) == ["clean", "nominal", "degraded"]
    assert SUITES["clean"].noise < SUITES["nominal"].noise == SUITES["degraded"].noise == 1.0
    assert [suite.dropout > 0.0 for suite in SUITES.values()] == [False, False, True]


@pytest.mark.parametrize("name", ["clean", "nominal"])
def test_noise_has_the_suite_s_share_of_each_channel_s_deviation(name):
    readings, available, _ = corrupted(SUITES[name], seed=0, exact=7.0)
    assert available.all()
    for channel in range(3):
        assert_variance(readings[:, channel] - 7.0, (SUITES[name].noise * SD[channel]) ** 2)


def test_readings_are_the_exact_ones_plus_scaled_normals():
    readings, _, normals = corrupted(SensorSuite(noise=0.7), seed=1, exact=-2.0)
    np.testing.assert_allclose(readings, -2.0 + 0.7 * SD * normals, rtol=1e-14)


def test_each_instrument_drops_out_at_its_rate_by_itself():
    _, available, _ = corrupted(SUITES["degraded"], seed=2)
    for channel in range(3):
        assert_rate(~available[:, channel], 0.10)
    assert_rate(~available[:, 0] & ~available[:, 1], 0.01)  # independent of its neighbour


def test_a_missing_reading_is_zero_and_its_mask_is_false():
    readings, available, _ = corrupted(SUITES["degraded"], seed=3, exact=7.0)
    np.testing.assert_array_equal(readings[~available], 0.0)
    assert (readings[available] != 0.0).all()


def test_outliers_come_at_their_rate_with_their_size():
    suite = SensorSuite(noise=1.0, outliers=0.05)
    readings, _, normals = corrupted(suite, seed=4)
    outlier = np.abs(readings / (SD * normals)) > 5.0
    assert_rate(outlier, 0.05)
    assert_rate(outlier[:, 0] & outlier[:, 1], 0.05**2)
    np.testing.assert_allclose(readings[outlier], (10.0 * SD * normals)[outlier], rtol=1e-13)
    np.testing.assert_allclose(readings[~outlier], (SD * normals)[~outlier], rtol=1e-13)


def test_drop_outs_and_outliers_are_independent():
    suite = SensorSuite(noise=1.0, dropout=0.2, outliers=0.2)
    readings, available, normals = corrupted(suite, seed=5)
    assert_rate(np.abs(readings / (SD * normals))[available] > 5.0, 0.2)


def test_suites_are_paired_where_they_do_not_differ():
    nominal, _, _ = corrupted(SUITES["nominal"], seed=6)
    degraded, available, _ = corrupted(SUITES["degraded"], seed=6)
    same = degraded == nominal
    assert_rate(same, 0.9 * 0.95)  # neither dropped nor an outlier: to the bit as in the nominal suite
    assert available[same].all()


@pytest.mark.parametrize("suite", SUITES.values(), ids=SUITES)
def test_sensors_leave_the_truth_alone(suite):
    rng = np.random.default_rng(7)
    arrays = rng.normal(size=(9, 3)), np.arange(9), rng.normal(size=(9, 3)), rng.random((9, 6))
    copies = [a.copy() for a in arrays]
    Sensors(APART, suite).read(*arrays)
    for a, b in zip(arrays, copies, strict=True):
        np.testing.assert_array_equal(a, b)


TOGETHER = (
    Instrument("log", ("surge", "sway"), (0.1, 0.1), dropout=0.15),
    Instrument("fix", ("x", "y", "z"), (1.0, 1.0, 2.0), period=20),
)


def test_the_channels_of_an_instrument_are_lost_and_spoilt_together():
    suite = SensorSuite(noise=1.0, dropout=0.10, outliers=0.05)
    readings, available, normals = corrupted(suite, seed=8, instruments=TOGETHER)
    np.testing.assert_array_equal(available[:, 0], available[:, 1])
    np.testing.assert_array_equal(available[:, 2], available[:, 4])
    assert_rate(~available[:, 0], 0.25)  # its own losses and the suite's
    assert_rate(~available[:, 2], 0.10)
    with np.errstate(divide="ignore"):
        outlier = np.abs(readings / (nominal_sd(TOGETHER) * normals)) > 5.0
    there = available[:, 0] & available[:, 2]
    assert_rate(outlier[there, 0], 0.05)
    np.testing.assert_array_equal(outlier[there, 0], outlier[there, 1])
    np.testing.assert_array_equal(outlier[there, 2], outlier[there, 4])
    assert_rate(outlier[there, 0] & outlier[there, 2], 0.05**2)


def test_an_instrument_reads_at_the_start_and_then_once_a_period():
    steps = np.arange(20_000) % 500
    _, available, _ = corrupted(SUITES["nominal"], seed=9, instruments=TOGETHER, steps=steps)
    np.testing.assert_array_equal(available[:, 2], steps % 20 == 0)
    assert_rate(~available[:, 0], 0.15)


def test_clean_instruments_lose_nothing_but_keep_their_period():
    steps = np.arange(20_000)
    _, available, _ = corrupted(SUITES["clean"], seed=10, instruments=TOGETHER, steps=steps)
    assert available[:, :2].all()
    np.testing.assert_array_equal(available[:, 3], steps % 20 == 0)


def test_an_instrument_needs_a_deviation_for_each_channel():
    with pytest.raises(ValueError, match="log has 2 channels and 1 standard deviations"):
        Instrument("log", ("surge", "sway"), (0.1,))


# --- streams ----------------------------------------------------------------------------------------


def test_a_stream_can_be_had_again():
    np.testing.assert_array_equal(stream(3, 2, Purpose.SENSORS).random(9), stream(3, 2, Purpose.SENSORS).random(9))


def test_seeds_episodes_and_purposes_have_streams_of_their_own():
    keys = [(seed, episode, purpose) for seed in (0, 1, 2**40) for episode in range(5) for purpose in Purpose]
    firsts = {stream(*key).random() for key in keys}
    assert len(firsts) == len(keys) == 60


NUMBERS = st.one_of(st.integers(0, 9), st.integers(2**32 - 3, 2**32 + 9), st.integers(0, 2**70), st.integers(0, 2**200))
KEYS = st.tuples(NUMBERS, NUMBERS, st.sampled_from(Purpose))


def split(*numbers: int) -> list[int]:
    """The 32-bit words that NumPy makes of numbers, one after the other."""
    words = []
    for number in numbers:
        words.append(number % 2**32)
        while number := number // 2**32:
            words.append(number % 2**32)
    return words


def grown(words: tuple[int, ...]) -> tuple[int, ...]:
    """What NumPy grows a stream from: words beyond the last are 0 up to the fourth."""
    return *words, *(0 for _ in range(4 - len(words)))


@given(KEYS, KEYS)
def test_no_two_keys_grow_the_same_stream(one: tuple[int, int, Purpose], other: tuple[int, int, Purpose]):
    assert (grown(entropy(*one)) == grown(entropy(*other))) == (one == other)
    assert all(0 <= word < 2**32 for word in entropy(*one))


@given(st.lists(st.integers(0, 3) | st.integers(0, 2**32 - 1), min_size=4, max_size=7))
def test_no_key_grows_the_stream_of_another_that_splits_into_the_same_words(words: list[int]):
    """Every way to read a row of words as a seed, an episode and a purpose: to NumPy alone these are one key."""
    number = [sum(word << 32 * i for i, word in enumerate(words[:k])) for k in range(len(words))]
    rest = [sum(word << 32 * i for i, word in enumerate(words[k:-1])) for k in range(len(words))]
    keys = {(number[k], rest[k], Purpose(words[-1] % 4)) for k in range(1, len(words) - 1)}
    assert len({grown(entropy(*key)) for key in keys}) == len(keys)


def test_the_streams_of_two_keys_that_split_alike_differ():
    one, other = (2**32 + 5, 2, Purpose.RESET), (5, 1, Purpose.SENSORS)
    assert split(*one)[:3] == split(*other)
    assert stream(*one).random() != stream(*other).random()


@given(st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1), st.sampled_from(Purpose))
def test_smaller_seeds_keep_the_stream_that_they_have_always_had(seed: int, episode: int, purpose: Purpose):
    always = np.random.default_rng(np.random.SeedSequence((seed, episode, int(purpose))))
    assert stream(seed, episode, purpose).random() == always.random()


def test_the_order_of_a_key_matters():
    assert stream(1, 2, Purpose.RESET).random() != stream(2, 1, Purpose.RESET).random()
    assert stream(0, 1, Purpose.RESET).random() != stream(1, 0, Purpose.RESET).random()
    assert stream(5, 1, Purpose.FILTER).random() != stream(5, 3, Purpose.DISTURBANCE).random()


def test_neighbouring_streams_are_not_correlated():
    n = 5000
    a, b = stream(7, 0, Purpose.SENSORS).standard_normal(n), stream(8, 0, Purpose.SENSORS).standard_normal(n)
    assert abs(np.corrcoef(a, b)[0, 1]) < 4.9 / np.sqrt(n)  # two-sided 1e-6
    c = stream(7, 1, Purpose.SENSORS).standard_normal(n)
    assert abs(np.corrcoef(a, c)[0, 1]) < 4.9 / np.sqrt(n)


def drawn(draws: Draws, steps: int, rows: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    normals, uniforms = [], []
    for _ in range(steps):
        for record, numbers in zip((normals, uniforms), draws.next(rows), strict=True):
            record.append(numbers.copy())
    return np.array(normals), np.array(uniforms)


def started(num_envs: int, seeds, normals: int = 3, uniforms: int = 2, block: int = 64) -> Draws:
    draws = Draws(num_envs, normals, uniforms, block)
    draws.restart(np.arange(num_envs), [stream(seed, 0, Purpose.SENSORS) for seed in seeds])
    return draws


def test_a_row_draws_the_same_numbers_in_any_batch_and_any_order():
    alone = [drawn(started(1, [seed]), 150) for seed in (5, 6, 7)]  # more than two blocks
    together = drawn(started(3, [5, 6, 7]), 150)
    reordered = drawn(started(4, [7, 9, 5, 6]), 150)
    for kind in (0, 1):
        for i, j in ((0, 2), (1, 3), (2, 0)):
            np.testing.assert_array_equal(together[kind][:, i], alone[i][kind][:, 0])
            np.testing.assert_array_equal(reordered[kind][:, j], alone[i][kind][:, 0])


def test_rows_that_are_not_asked_stay_where_they_are():
    whole = drawn(started(3, [5, 6, 7]), 160)
    draws = started(3, [5, 6, 7])
    first = drawn(draws, 50)  # all rows
    some = drawn(draws, 60, np.array([2, 0]))  # two of them, past the end of the block, in another order
    rest = drawn(draws, 40)  # all again, from three different places
    for kind in (0, 1):
        np.testing.assert_array_equal(first[kind], whole[kind][:50])
        np.testing.assert_array_equal(some[kind][:, 0], whole[kind][50:110, 2])
        np.testing.assert_array_equal(some[kind][:, 1], whole[kind][50:110, 0])
        np.testing.assert_array_equal(rest[kind][:, 1], whole[kind][50:90, 1])
        np.testing.assert_array_equal(rest[kind][:, [0, 2]], whole[kind][110:150, [0, 2]])


@pytest.mark.parametrize("after", [0, 1, 63, 64, 65, 100])
def test_a_restarted_row_begins_its_new_stream_wherever_its_block_was(after):
    fresh = drawn(started(1, [9]), 70)
    draws = started(2, [5, 6])
    undisturbed = drawn(started(2, [5, 6]), after + 70)
    if after:
        drawn(draws, after)
    draws.restart(np.array([1]), [stream(9, 0, Purpose.SENSORS)])
    later = drawn(draws, 70)
    for kind in (0, 1):
        np.testing.assert_array_equal(later[kind][:, 1], fresh[kind][:, 0])
        np.testing.assert_array_equal(later[kind][:, 0], undisturbed[kind][after:, 0])  # its neighbour goes on


def test_the_size_of_the_block_does_not_matter_to_a_stream_of_one_kind():
    for normals, uniforms in ((3, 0), (0, 3)):
        reference = drawn(started(2, [5, 6], normals, uniforms, block=64), 130)
        for block in (1, 7, 200):
            other = drawn(started(2, [5, 6], normals, uniforms, block), 130)
            for kind in (0, 1):
                np.testing.assert_array_equal(other[kind], reference[kind])


def test_draws_are_standard_normal_and_uniform():
    normals, uniforms = drawn(started(20, range(20)), 640)
    assert normals.shape == (640, 20, 3)
    assert uniforms.shape == (640, 20, 2)
    assert kstest(normals.ravel(), "norm").pvalue > FALSE_ALARM
    assert kstest(uniforms.ravel(), "uniform").pvalue > FALSE_ALARM
    assert len(np.unique(normals)) == normals.size  # no number comes twice


def test_a_row_without_a_stream_does_not_draw():
    draws = Draws(2, 1)
    draws.restart(np.array([0]), [stream(0, 0, Purpose.SENSORS)])
    with pytest.raises(KeyError):
        draws.next()
