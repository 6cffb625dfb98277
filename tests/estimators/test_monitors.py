"""Monitors of faults: rates of false alarms, delays and whom they accuse, against theory.

Bands are for one number and hold with probability 0.999 if the theory is right; seeds are fixed.
"""

import numpy as np
import pytest
from scipy.stats import binom, chi2, norm

from estimators import (
    Belief,
    ChiSquareMonitor,
    CusumMonitor,
    FaultMonitor,
    Gaussian,
    LinearModel,
    make,
    nis,
)
from estimators.faults import cusum_run_length
from tests.estimators.cases import (
    random_covariance,
    unknown_input_system,
)

KINDS = (ChiSquareMonitor, CusumMonitor)
_KF = make("kf", LinearModel([[1.0]], [[1.0]], [[1.0]], [[1.0]]))


def read(e: np.ndarray, S: np.ndarray, available: np.ndarray | None = None) -> Belief:
    """A belief that an update with these innovations has left."""
    available = np.ones(e.shape, bool) if available is None else available
    S = np.broadcast_to(S, e.shape + e.shape[-1:])
    pairs = available[..., None] & available[..., None, :]
    return _KF.init(Gaussian(np.zeros((*e.shape[:-1], 1)), np.eye(1))).replace(
        innovation=np.where(available, e, 0.0),
        innovation_cov=np.where(pairs, S, np.eye(e.shape[-1])),
        available=available,
    )


def drawn(rng: np.random.Generator, S: np.ndarray, *shape: int) -> np.ndarray:
    return np.matvec(np.linalg.cholesky(S), rng.normal(size=(*shape, S.shape[-1])))


def assert_share(hits: np.ndarray, probability: float) -> None:
    low, high = binom.interval(0.999, hits.size, probability)
    assert low <= hits.sum() <= high, (hits.sum(), low, high)


def first_alarms(
    monitor: FaultMonitor, rng: np.random.Generator, rows: int, S: np.ndarray, mean: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Steps until the first alarm, and whom it accused, of rows of white innovations."""
    state, after, accused = monitor.start(rows), np.zeros(rows, int), np.full(rows, -1)
    for k in range(1, 20_000):
        state = monitor.watch(state, read(mean + drawn(rng, S, rows), S))
        new = state.alarm & (after == 0)
        after[new], accused[new] = k, state.accused[new]
        if after.all():
            return after, accused
    raise AssertionError("a row raised no alarm")


# --- false alarms and detection -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("h", "mean", "two_sided"),
    [(4, 0, 168), (4, 0.5, 26.6), (4, 1, 8.38), (4, 2, 3.34), (5, 0, 465), (5, 1, 10.4)],
)
def test_run_lengths_are_those_printed(h: float, mean: float, two_sided: float):
    """Lucas & Crosier (1982), Technometrics 24: k = 1/2, no head start."""
    rates = [1.0 / cusum_run_length(h, 0.5, side * mean) for side in (1, -1)]
    assert f"{1.0 / sum(rates):.3g}" == f"{two_sided:.3g}"


@pytest.mark.parametrize("window", [1, 7])
def test_chi_square_alarms_are_as_frequent_as_stated(window: int):
    """With measurements missing, and before the window is full, too."""
    rng, rows, rate = np.random.default_rng(window), 20_000, 0.01
    S, monitor = random_covariance(rng, 3), ChiSquareMonitor(3, rate, window)
    state, some = monitor.start(rows), np.zeros(rows, bool)
    for _ in range(2 * window):
        available = rng.random((rows, 3)) < 0.7
        some = available.any(-1) | (some & (window > 1))  # nearly always so in a window of 7
        state = monitor.watch(state, read(drawn(rng, S, rows), S, available))
        assert_share(state.alarm[some], rate)
        assert not state.alarm[~some].any()


@pytest.mark.parametrize("mean", [0.0, -1.0])
def test_the_delay_of_a_cusum_is_its_run_length(mean: float):
    """Without a bias it is the time between false alarms, as stated."""
    monitor, rng = CusumMonitor(1, 0.01, 1.5), np.random.default_rng(1)
    after, _ = first_alarms(monitor, rng, 3000, np.array([[9.0]]), np.array([3.0 * mean]))
    rates = [1.0 / cusum_run_length(monitor.threshold, 0.75, side * mean) for side in (1, -1)]
    assert mean or sum(rates) == pytest.approx(0.01)
    assert abs(after.mean() - 1.0 / sum(rates)) < norm.isf(0.0005) * after.std() / np.sqrt(3000)


def test_false_alarms_of_several_cusums_are_as_stated():
    rng, S = np.random.default_rng(2), np.array([[1.0, 0.6, 0.0], [0.6, 1.0, 0.0], [0.0, 0.0, 1.0]])
    after, accused = first_alarms(CusumMonitor(3, 0.01), rng, 800, S, np.zeros(3))
    assert after.mean() > 100.0 - norm.isf(0.001) * after.std() / np.sqrt(after.size)
    assert after.mean() < 150.0  # and not much less often: the start from 0 and what channels share
    assert (np.bincount(accused, minlength=3) > 0.2 * after.size).all()


# --- whom is accused ------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_a_channel_correlated_with_the_fault_is_not_accused(kind: type):
    """Innovations alone would accuse all three alike: what is common to them is large."""
    rng, S, faulty = np.random.default_rng(8), 20.0 + np.diag([1.0, 2.0, 3.0]), 2
    _, accused = first_alarms(kind(3, 1e-3), rng, 500, S, 4.0 * np.sqrt(3.0) * np.eye(3)[faulty])
    assert (accused == faulty).mean() > 0.9


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("kind", KINDS)
def test_an_absurd_measurement_is_accused_and_forgotten(kind: type):
    rng = np.random.default_rng(14)
    e = 1e-3 * rng.normal(size=(12, 3, 3))
    e[0] += np.diag([1e90, -1e306, 1e306])
    states = kind(3).run(read(e, 1e-3 * random_covariance(rng, 3)))
    np.testing.assert_array_equal(states.accused[0], [0, 1, 2])
    assert all(np.isfinite(array).all() for array in states)
    assert not states.alarm[10:].any()


def test_suspicion_is_the_nis_that_a_sensor_adds():
    """The normalised innovation squared, less that of the other channels, as a normal deviate."""
    rng = np.random.default_rng(10)
    S, e = random_covariance(rng, 4), 3.0 * rng.normal(size=(50, 4))
    monitor = ChiSquareMonitor({"a": (0, 2), "b": 1, "c": [3]}, window=1)
    state = monitor.watch(monitor.start(50), read(e, S))
    np.testing.assert_allclose(state.statistic, nis(e, S) / chi2.isf(1e-3, 4), rtol=1e-12)
    for sensor, channels in enumerate([(0, 2), (1,), (3,)]):
        rest = [j for j in range(4) if j not in channels]
        share = nis(e, S) - nis(e[:, rest], S[np.ix_(rest, rest)])
        deviate = norm.isf(chi2.sf(share, len(channels)))
        np.testing.assert_allclose(state.suspicion[:, sensor], deviate, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("size", [4.0, 10.0, 100.0, 1e6])
def test_the_sensor_that_moved_is_accused_however_far(size: float):
    """The two other channels, together a sensor, have more degrees of freedom, and no fault."""
    monitor = ChiSquareMonitor({"pair": (1, 2), "one": 0}, window=1)
    belief = read(np.array([size, 0.0, 0.0]), 0.9 + 0.1 * np.eye(3))
    state = monitor.watch(monitor.start(), belief)
    assert state.accused == 1
    deviation = np.sqrt(
        1.0 / np.linalg.inv(0.9 + 0.1 * np.eye(3))[0, 0]
    )  # given the others; two sides count
    assert state.suspicion[1] == pytest.approx(size / deviation, rel=0.01)


# --- missing measurements, rows, series -----------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_a_sensor_that_is_lost_counts_for_nothing(kind: type):
    """As if it were not there; and with nothing left no alarm is raised."""
    rng = np.random.default_rng(11)
    S, e = random_covariance(rng, 3), 1.5 * rng.normal(size=(40, 5, 3))
    lost = np.broadcast_to([True, False, True], e.shape)
    with_it, without = kind(3, 1e-2), kind(2, 2e-2 / 3 if kind is CusumMonitor else 1e-2)
    one = with_it.run(read(e, S, lost))
    other = without.run(read(e[..., [0, 2]], S[np.ix_([0, 2], [0, 2])]))
    assert other.alarm.any()
    np.testing.assert_allclose(one.statistic, other.statistic, rtol=1e-12)
    np.testing.assert_array_equal(one.accused, np.array([-1, 0, 2])[other.accused + 1])
    assert not with_it.run(read(100.0 * e, S, np.zeros(e.shape, bool))).alarm.any()


@pytest.mark.parametrize("kind", KINDS)
def test_a_cusum_restarts_after_an_alarm_and_a_window_forgets(kind: type):
    states = kind(1, 1e-3).run(read(np.array([50.0, *[0.1] * 11])[:, None], np.eye(1)))
    still = 9 if kind is ChiSquareMonitor else 0
    assert states.alarm.tolist() == [True] * (1 + still) + [False] * (11 - still)


@pytest.mark.parametrize("kind", KINDS)
def test_a_series_is_a_loop_whose_rows_begin_again_by_mask(kind: type):
    rng, done = np.random.default_rng(12), np.arange(4) % 2 == 0
    S, e = random_covariance(rng, 3), 1.7 * rng.normal(size=(30, 4, 3))
    monitor = kind({"a": (0, 1), "b": 2}, 0.01)
    beliefs = read(e, S, rng.random(e.shape) < 0.8)
    whole, alone, fresh = (monitor.run(b) for b in (beliefs, beliefs[:, 1], beliefs[28:]))
    assert whole.alarm.any()
    state = monitor.start(4)
    for k in range(28):
        state = monitor.watch(state, beliefs[k])
    again = state.with_rows(done, monitor.start(2))
    for k in (28, 29):
        state, again = (monitor.watch(each, beliefs[k]) for each in (state, again))
    for i, array in enumerate(state):
        np.testing.assert_array_equal(whole[i][-1], array)
        np.testing.assert_allclose(alone[i][-1], array[1], rtol=1e-12, atol=1e-12)
        np.testing.assert_array_equal(again[i][~done], array[~done])
        np.testing.assert_array_equal(again[i][done], fresh[i][-1][done])


@pytest.mark.parametrize("kind", KINDS)
def test_an_update_by_pseudo_inverse_counts_for_nothing(kind: type):
    model = LinearModel(np.eye(1), np.ones((2, 1)), np.eye(1), np.zeros((2, 2)))
    filter, monitor = make("kf", model), kind(2)
    belief = filter.update(filter.init(Gaussian([0.0], [[1.0]])), [10.0, 10.0])
    assert not belief.healthy
    state = monitor.watch(monitor.start(), belief)
    assert not state.alarm
    assert not state.memory.any()


# --- what is refused ------------------------------------------------------------------------------


@pytest.mark.parametrize("sensors", [{"a": (0, 2)}, {"a": 0, "b": (0, 1)}, {"a": 0, "b": ()}, {}])
def test_every_channel_is_in_one_sensor(sensors: dict):
    with pytest.raises(ValueError, match="every channel, from 0, in exactly one"):
        CusumMonitor(sensors)


@pytest.mark.parametrize("options", [{"false_alarms": 0.0}, {"shift": 9.0}])
def test_rates_and_shifts_have_bounds(options: dict):
    with pytest.raises(ValueError, match=r"must be a .* between"):
        CusumMonitor(2, **options)


def test_innovations_with_an_unknown_input_are_refused():
    system, monitor = unknown_input_system(0, True), ChiSquareMonitor(3)
    told = make("kf", system.model, input_cov=1.0)
    belief = told.update(told.init(system.prior), np.full(3, 1e3))
    assert monitor.watch(monitor.start(), belief).alarm
    umv = make("kf-umv-ui", system.model)
    with pytest.raises(TypeError, match="carry its unknown input"):
        monitor.watch(monitor.start(), umv.update(umv.init(system.prior), np.zeros(3)))
