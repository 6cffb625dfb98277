"""Monitors of faults: rates of false alarms, delays and whom they accuse, against theory.

Bands are for one number and hold with probability 0.999 if the theory is right; seeds are fixed.
"""

import numpy as np
import pytest
from scipy.stats import binom, chi2, ncx2, norm

from estimators import (
    Belief,
    ChiSquareMonitor,
    CusumMonitor,
    Delayed,
    Gaussian,
    LinearModel,
    Watch,
    make,
    nis,
)
from estimators.faults import cusum_run_length
from tests.estimators.cases import (
    kalman_system,
    random_covariance,
    simulate,
    some_measurements,
    unknown_input_system,
)

KINDS = (ChiSquareMonitor, CusumMonitor)


def read(e: np.ndarray, S: np.ndarray, available: np.ndarray | None = None) -> Belief:
    """A belief that an update with these innovations has left."""
    available = np.ones(e.shape, bool) if available is None else available
    S = np.broadcast_to(S, e.shape + e.shape[-1:])
    pairs = available[..., None] & available[..., None, :]
    nothing = np.zeros((*e.shape[:-1], 1))
    return Belief(
        nothing, nothing[..., None], nothing, nothing[..., None], np.zeros(e.shape[:-1], np.int8), None,
        np.where(available, e, 0.0), np.where(pairs, S, np.eye(e.shape[-1])), available,
    )  # fmt: skip


def drawn(rng: np.random.Generator, S: np.ndarray, *shape: int) -> np.ndarray:
    return np.matvec(np.linalg.cholesky(S), rng.normal(size=(*shape, S.shape[-1])))


def assert_share(hits: np.ndarray, probability: float) -> None:
    low, high = binom.interval(0.999, hits.size, probability)
    assert low <= hits.sum() <= high, (hits.sum(), low, high)


def first_alarms(
    monitor: CusumMonitor, rng: np.random.Generator, rows: int, S: np.ndarray, mean: np.ndarray
):
    """Steps until the first alarm, and whom it accused, of rows of white innovations."""
    state, after, accused = monitor.start(rows), np.zeros(rows, int), np.full(rows, -1)
    for k in range(1, 20_000):
        state = monitor.watch(state, read(mean + drawn(rng, S, rows), S))
        new = state.alarm & (after == 0)
        after[new], accused[new] = k, state.accused[new]
        if after.all():
            return after, accused
    raise AssertionError("a row raised no alarm")


def assert_mean(values: np.ndarray, expected: float) -> None:
    assert abs(values.mean() - expected) < norm.isf(0.0005) * values.std() / np.sqrt(values.size)


# --- run lengths ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("h", "mean", "two_sided"),
    [(4, 0, 168), (4, 0.5, 26.6), (4, 1, 8.38), (4, 2, 3.34), (5, 0, 465), (5, 1, 10.4)],
)
def test_run_lengths_are_those_printed(h: float, mean: float, two_sided: float):
    """Lucas & Crosier (1982), Technometrics 24: k = 1/2, no head start."""
    rates = [1.0 / cusum_run_length(h, 0.5, side * mean) for side in (1, -1)]
    assert f"{1.0 / sum(rates):.3g}" == f"{two_sided:.3g}"


@pytest.mark.parametrize(
    ("h", "drift", "mean"), [(0.7, 1.0, 0.0), (3.0, 0.25, 0.0), (6.0, 0.5, 0.3), (12.0, 0.2, 0.0)]
)
def test_run_lengths_are_those_of_a_markov_chain(h: float, drift: float, mean: float):
    """Brook & Evans (1972): the sum in cells of equal width, whose error falls as the square of the width."""
    lengths = []
    for cells in (200, 400):
        width = h / (cells - 0.5)
        at = width * np.arange(cells)
        edges = np.append(-np.inf, at + 0.5 * width)
        moves = np.diff(norm.cdf(edges - at[:, None] + drift - mean), axis=1)
        lengths.append(np.linalg.solve(np.eye(cells) - moves, np.ones(cells))[0])
    extrapolated = lengths[1] + (lengths[1] - lengths[0]) / 3.0
    assert cusum_run_length(h, drift, mean) == pytest.approx(extrapolated, rel=1e-4)


def test_without_a_threshold_a_sum_waits_for_one_number():
    assert cusum_run_length(1e-12, 1.3) == pytest.approx(1.0 / norm.sf(1.3))


# --- false alarms ---------------------------------------------------------------------------------


@pytest.mark.parametrize("window", [1, 7])
def test_chi_square_alarms_are_as_frequent_as_stated(window: int):
    """With measurements missing, and before the window is full, too."""
    rng, rows, rate = np.random.default_rng(window), 20_000, 0.01
    S, monitor = random_covariance(rng, 3), ChiSquareMonitor(3, rate, window)
    state = monitor.start(rows)
    for k in range(2 * window):
        available = rng.random((rows, 3)) < 0.7
        if k == 0:
            available[:, 0] = True  # a window without a measurement has no alarm
        state = monitor.watch(state, read(drawn(rng, S, rows), S, available))
        if k in (0, 2, 2 * window - 1) and window == 7:
            assert_share(state.alarm, rate)
    if window == 1:
        some = available.any(-1)
        assert_share(state.alarm[some], rate)
        assert not state.alarm[~some].any()


def test_a_cusum_of_one_channel_has_the_stated_time_between_false_alarms():
    rng = np.random.default_rng(1)
    after, _ = first_alarms(CusumMonitor(1, 0.01, 1.5), rng, 1500, np.array([[2.0]]), np.zeros(1))
    assert_mean(after, 100.0)


@pytest.mark.parametrize(
    "correlation", [0.6, *(pytest.param(c, marks=pytest.mark.nightly) for c in (0.0, -0.9))]
)
def test_cusums_of_several_channels_raise_no_more_false_alarms_than_stated(correlation: float):
    rng = np.random.default_rng(2)
    S = (1.0 - abs(correlation)) * np.eye(3)
    S[:2, :2] += abs(correlation) * np.outer([1, np.sign(correlation)], [1, np.sign(correlation)])
    S[2, 2] = 1.0
    after, accused = first_alarms(CusumMonitor(3, 0.01), rng, 800, S, np.zeros(3))
    assert after.mean() > 100.0 - norm.isf(0.001) * after.std() / np.sqrt(after.size)
    assert after.mean() < 150.0  # and not much less often: the start from 0 and what channels share
    assert (np.bincount(accused, minlength=3) > 0.2 * after.size).all()


@pytest.mark.parametrize("kind", KINDS)
def test_a_filter_of_a_true_model_raises_as_many_false_alarms_as_stated(kind: type):
    system, rows, steps, rate = kalman_system(3), 3000, 30, 0.01
    record = simulate(system, 3, rows, steps)
    available = some_measurements(np.random.default_rng(3), 3, steps, rows)
    filter, monitor = make("kf", system.model), kind(3, rate)
    belief, state, alarms = filter.init(system.rows(rows)), monitor.start(rows), 0
    for k, y in enumerate(record.y):
        belief = filter.predict(belief, record.u[k - 1]) if k else belief
        belief = filter.update(belief, y, available=available[k])
        state = monitor.watch(state, belief)
        alarms += state.alarm.sum()
    if kind is ChiSquareMonitor:
        assert_share(state.alarm, rate)
    else:
        assert 0.3 * rate * rows * steps < alarms < binom.isf(0.001, rows * steps, rate)


# --- detection ------------------------------------------------------------------------------------


@pytest.mark.parametrize("window", [3, 10])
def test_the_chance_to_see_a_bias_is_that_of_noncentral_chi_square(window: int):
    """A bias' effect on the innovations of a filter follows from the filter alone, as exact measurements show."""
    system, rows, steps = kalman_system(4), 4000, 15
    model, filter, monitor = (
        system.model,
        make("kf", system.model),
        ChiSquareMonitor(3, 1e-3, window),
    )
    bias = 4.0 * np.sqrt(model.R[1, 1]) * np.eye(3)[1]
    record = simulate(system, 4, rows, steps)
    still = filter.init(Gaussian(np.zeros(4), system.cov))
    belief, state = filter.init(system.rows(rows)), monitor.start(rows)
    shown = []
    for k, y in enumerate(record.y):
        if k:
            belief, still = (
                filter.predict(belief, record.u[k - 1]),
                filter.predict(still, np.zeros(2)),
            )
        wrong = bias if k >= 5 else 0.0 * bias
        belief, still = filter.update(belief, y + wrong), filter.update(still, wrong)
        state = monitor.watch(state, belief)
        shown.append(nis(still.innovation, still.innovation_cov))
    threshold = chi2.isf(1e-3, 3 * window)
    expected = ncx2.sf(threshold, 3 * window, sum(shown[-window:]))
    assert 0.05 < expected < 0.999
    assert_share(state.alarm, expected)


@pytest.mark.parametrize("mean", [0.5, -1.0, 2.0])
def test_the_delay_of_a_cusum_is_its_run_length_under_the_bias(mean: float):
    rng = np.random.default_rng(6)
    monitor = CusumMonitor(1, 1e-3, 1.0)
    after, _ = first_alarms(monitor, rng, 4000, np.array([[9.0]]), np.array([3.0 * mean]))
    rates = [1.0 / cusum_run_length(monitor.threshold, 0.5, side * mean) for side in (1, -1)]
    assert_mean(after, 1.0 / sum(rates))


# --- whom is accused ------------------------------------------------------------------------------


@pytest.mark.parametrize("correlation", [0.0, 0.5, -0.95])
def test_the_accused_of_two_channels_is_the_faulty_one_as_often_as_theory_says(correlation: float):
    """``z1^2 > z2^2`` where ``(z1 - z2) (z1 + z2) > 0``, and these two are independent."""
    rng, rows, bias = np.random.default_rng(7), 20_000, 1.2
    S = np.array([[1.0, correlation], [correlation, 1.0]])
    monitor = ChiSquareMonitor(2, window=1)
    state = monitor.watch(monitor.start(rows), read(drawn(rng, S, rows) + [bias, 0.0], S))
    mean = bias / np.sqrt(1.0 - correlation**2)
    less, more = (
        mean * (1 + s * correlation) / np.sqrt(2 * (1 + s * correlation)) for s in (1, -1)
    )
    right = norm.cdf(less) * norm.cdf(more) + norm.sf(less) * norm.sf(more)
    assert_share(state.suspicion.argmax(-1) == 0, right)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("faulty", range(3))
def test_a_channel_that_is_correlated_with_the_faulty_one_is_not_accused(kind: type, faulty: int):
    """Innovations alone would accuse all three alike: what is common to them is large."""
    rng, rows = np.random.default_rng(8), 500
    S = 20.0 + np.diag([1.0, 2.0, 3.0])
    monitor = kind(3, 1e-3)
    accused, state = np.full(rows, -1), monitor.start(rows)
    for _ in range(15):
        state = monitor.watch(
            state, read(drawn(rng, S, rows) + 4.0 * np.eye(3)[faulty] * np.sqrt(1.0 + faulty), S)
        )
        accused = np.where(accused < 0, state.accused, accused)
    assert (accused == faulty).mean() > 0.9
    assert np.array_equal(state.accused >= 0, state.alarm)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("size", [1e90, 1e160, -1e200, 1e306])
def test_a_measurement_that_is_absurd_is_accused_and_forgotten_like_any_other(
    kind: type, size: float
):
    rng, monitor = np.random.default_rng(14), kind(3)
    S = 1e-3 * random_covariance(rng, 3)
    e = 1e-3 * rng.normal(size=(12, 3, 3))
    e[0] += size * np.eye(3)
    states = monitor.run(read(e, S))
    np.testing.assert_array_equal(states.accused[0], [0, 1, 2])
    for name in Watch.__dataclass_fields__:
        assert np.isfinite(getattr(states, name)).all(), name
    assert not states.alarm[10:].any()


def test_what_speaks_against_a_sensor_is_what_the_innovation_has_less_without_it():
    """The normalised innovation squared, less that of the other channels alone: as its standard normal deviate."""
    rng = np.random.default_rng(10)
    S, e = random_covariance(rng, 4), 1.2 * rng.normal(size=(50, 4))
    monitor = ChiSquareMonitor({"a": (0, 2), "b": 1, "c": [3]}, window=1)
    state = monitor.watch(monitor.start(50), read(e, S))
    np.testing.assert_allclose(state.statistic, nis(e, S) / chi2.isf(1e-3, 4), rtol=1e-12)
    for sensor, channels in enumerate([(0, 2), (1,), (3,)]):
        rest = [j for j in range(4) if j not in channels]
        share = nis(e, S) - nis(e[:, rest], S[np.ix_(rest, rest)])
        deviate = norm.isf(chi2.sf(share, len(channels)))
        usual = (deviate > -1.0) & (
            deviate < 3.0
        )  # where they are good, how good Wilson & Hilferty are
        assert usual.sum() > 25
        np.testing.assert_allclose(
            state.suspicion[usual, sensor], deviate[usual], rtol=0, atol=0.15
        )


# --- missing measurements, rows, series -----------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_a_sensor_that_is_lost_counts_for_nothing(kind: type):
    """As if it were not there, whatever is said of it; and with nothing left no alarm is raised."""
    rng = np.random.default_rng(11)
    S, e = random_covariance(rng, 3), 1.5 * rng.normal(size=(40, 5, 3))
    lost = np.broadcast_to([True, False, True], e.shape)
    with_it, without = kind(3, 1e-2), kind(2, 2e-2 / 3 if kind is CusumMonitor else 1e-2)
    one = with_it.run(read(e, S, lost))
    other = without.run(read(e[..., [0, 2]], S[np.ix_([0, 2], [0, 2])]))
    assert other.alarm.any()
    np.testing.assert_array_equal(one.alarm, other.alarm)
    np.testing.assert_allclose(one.statistic, other.statistic, rtol=1e-12)
    np.testing.assert_array_equal(one.accused, np.array([-1, 0, 2])[other.accused + 1])
    silent = with_it.run(read(100.0 * e, S, np.zeros(e.shape, bool)))
    assert not silent.alarm.any()
    assert np.isfinite(silent.statistic).all()


@pytest.mark.parametrize("kind", KINDS)
def test_a_cusum_begins_again_after_an_alarm_and_a_window_forgets(kind: type):
    monitor, S = kind(1, 1e-3), np.eye(1)
    state = monitor.watch(monitor.start(), read(np.array([50.0]), S))
    assert state.alarm
    assert state.accused == 0
    ordinary = [monitor.watch(state, read(np.array([0.1]), S))]
    for _ in range(10):
        ordinary.append(monitor.watch(ordinary[-1], read(np.array([0.1]), S)))
    assert [bool(s.alarm) for s in ordinary] == [kind is ChiSquareMonitor] * 9 + [False] * 2


@pytest.mark.parametrize("kind", KINDS)
def test_a_series_a_row_and_a_loop_are_one_and_the_same(kind: type):
    rng = np.random.default_rng(12)
    S, e = random_covariance(rng, 3), 1.7 * rng.normal(size=(30, 4, 2, 3))
    available = rng.random(e.shape) < 0.8
    monitor = kind({"a": (0, 1), "b": 2}, 0.01)
    beliefs = read(e, S, available)
    whole, state = monitor.run(beliefs), monitor.start((4, 2))
    assert whole.alarm.any()
    assert whole.suspicion.shape == (30, 4, 2, 2)
    for k in range(30):
        state = monitor.watch(state, beliefs[k])
        alone = monitor.run(beliefs[: k + 1, 1, 1])[-1]
        for name in Watch.__dataclass_fields__:
            np.testing.assert_array_equal(getattr(whole, name)[k], getattr(state, name))
            np.testing.assert_allclose(
                getattr(alone, name), getattr(state, name)[1, 1], rtol=1e-12, atol=1e-12
            )


@pytest.mark.parametrize("kind", KINDS)
def test_rows_begin_again_by_mask_and_nothing_handed_in_is_changed(kind: type):
    rng = np.random.default_rng(13)
    monitor, S, done = kind(2), np.eye(2), np.array([True, False, True])
    e = 3.0 * rng.normal(size=(2, 3, 2))
    before = monitor.watch(monitor.start(3), read(e[0], S))
    kept = {name: np.array(getattr(before, name)) for name in Watch.__dataclass_fields__}
    state = monitor.watch(before.with_rows(done, monitor.start(2)), read(e[1], S))
    fresh, on = monitor.watch(monitor.start(3), read(e[1], S)), monitor.watch(before, read(e[1], S))
    for name in kept:
        expected = np.where(
            done.reshape(3, *[1] * (getattr(on, name).ndim - 1)),
            getattr(fresh, name),
            getattr(on, name),
        )
        np.testing.assert_array_equal(getattr(state, name), expected)
        np.testing.assert_array_equal(getattr(before, name), kept[name])


@pytest.mark.parametrize("kind", KINDS)
def test_a_measurement_that_only_a_pseudo_inverse_could_take_in_counts_for_nothing(kind: type):
    model = LinearModel(np.eye(1), np.ones((2, 1)), np.eye(1), np.zeros((2, 2)))
    filter, monitor = make("kf", model), kind(2)
    belief = filter.update(filter.init(Gaussian([0.0], [[1.0]])), [10.0, 10.0])
    assert not belief.healthy
    state = monitor.watch(monitor.start(), belief)
    assert not state.alarm
    assert not state.memory.any()


def test_the_filter_that_is_told_of_an_input_as_noise_can_be_watched():
    system = unknown_input_system(0, True)
    told = make("kf", system.model, input_cov=1.0)
    belief = told.update(told.init(system.prior), np.zeros(3))
    assert ChiSquareMonitor(3).watch(ChiSquareMonitor(3).start(), belief).alarm in (True, False)


# --- what is refused ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sensors", "options", "sentence"),
    [
        (0, {}, "sensors must be a whole number of at least 1"),
        ({"a": (0, 2)}, {}, "every channel, from 0, in exactly one"),
        ({"a": 0, "b": (0, 1)}, {}, "every channel, from 0, in exactly one"),
        ({"a": 0, "b": ()}, {}, "every channel, from 0, in exactly one"),
        ({"a": "0"}, {}, "every channel, from 0, in exactly one"),
        ({"a": True, "b": False}, {}, "every channel, from 0, in exactly one"),
        ({"a": 0.5}, {}, "every channel, from 0, in exactly one"),
        ({}, {}, "every channel, from 0, in exactly one"),
        (2, {"false_alarms": 0.0}, "a rate of false alarms a step"),
        (2, {"false_alarms": "few"}, "a rate of false alarms a step"),
    ],
)
@pytest.mark.parametrize("kind", KINDS)
def test_what_makes_no_monitor_is_refused(
    kind: type, sensors: object, options: dict, sentence: str
):
    with pytest.raises(ValueError, match=sentence):
        kind(sensors, **options)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("batch", [-1, 3.0, (2, -1), "3"])
def test_a_batch_that_is_none_is_refused(kind: type, batch: object):
    with pytest.raises(ValueError, match="batch must be a whole number of at least 0"):
        kind(2).start(batch)


def test_the_state_of_another_monitor_is_refused():
    S, e = np.eye(2), np.ones((3, 2))
    long, short, cusum = (
        ChiSquareMonitor(2, window=10),
        ChiSquareMonitor(2, window=5),
        CusumMonitor(2),
    )
    one = ChiSquareMonitor({"both": (0, 1)}, window=5)
    for mine, other in ((short, long), (long, short), (short, cusum), (cusum, long), (one, short)):
        with pytest.raises(
            ValueError, match=r"the state is of another monitor: it remembers .* of \d sensors"
        ):
            mine.watch(other.start(3), read(e, S))
        with pytest.raises(ValueError, match="the state is of another monitor: it remembers"):
            mine.start(3).with_rows(np.ones(3, bool), other.start(3))


def test_a_window_and_a_shift_that_are_none_are_refused():
    with pytest.raises(ValueError, match="window must be a whole number"):
        ChiSquareMonitor(2, window=0)
    with pytest.raises(ValueError, match="shift must be a number of standard deviations above"):
        CusumMonitor(2, shift=0.0)
    with pytest.raises(
        ValueError, match=r"shift must be below 4.65.* a ChiSquareMonitor with a window of 1"
    ):
        CusumMonitor(1, 0.02, shift=6.0)


def test_beliefs_that_cannot_be_watched_are_refused():
    system = kalman_system(0)
    filter, monitor = make("kf", system.model), CusumMonitor(3)
    begun = filter.init(system.rows(2))
    with pytest.raises(
        ValueError, match="no innovation with its covariance: watch it after an update"
    ):
        monitor.watch(monitor.start(2), begun)
    belief = filter.update(begun, np.zeros((2, 3)))
    with pytest.raises(ValueError, match=r"watches rows \(3,\), the belief has rows \(2,\)"):
        monitor.watch(monitor.start(3), belief)
    with pytest.raises(ValueError, match="have 2 channels, the measurements 3"):
        CusumMonitor(2).watch(CusumMonitor(2).start(2), belief)
    with pytest.raises(ValueError, match="stacked, times first"):
        monitor.run(belief[0])
    unknown = unknown_input_system(0, True)
    umv = make("kf-umv-ui", unknown.model)
    with pytest.raises(TypeError, match="carry its unknown input"):
        monitor.watch(monitor.start(), umv.update(umv.init(unknown.prior), np.zeros(3)))


@pytest.mark.parametrize("kind", KINDS)
def test_a_filter_to_which_measurements_come_late_is_watched_as_any_other(kind: type):
    system = kalman_system(0)
    delayed, plain, monitor = (
        Delayed(make("kf", system.model), 2),
        make("kf", system.model),
        kind(3),
    )
    beliefs = [f.init(system.rows(2)) for f in (delayed, plain)]
    states = [monitor.start(2), monitor.start(2)]
    for y in simulate(system, 0, 2, 5).y:
        beliefs = [delayed.update(beliefs[0], y[:, None]), plain.update(beliefs[1], y)]
        states = [
            monitor.watch(state, belief) for state, belief in zip(states, beliefs, strict=True)
        ]
        beliefs = [
            f.predict(belief, np.zeros(2))
            for f, belief in zip((delayed, plain), beliefs, strict=True)
        ]
    np.testing.assert_array_equal(states[0].statistic, states[1].statistic)


@pytest.mark.parametrize("size", [4.0, 10.0, 100.0, 1e6])
def test_of_correlated_channels_a_chi_square_accuses_the_sensor_that_moved_however_far(size: float):
    """One channel of three that are correlated: the two others, together a sensor, have more channels, and no fault."""
    S = np.full((3, 3), 0.9) + 0.1 * np.eye(3)
    model = LinearModel(1e-6 * np.eye(3), np.eye(3), 1e-9 * np.eye(3), S)
    filter, monitor = make("kf", model), ChiSquareMonitor({"pair": (1, 2), "one": 0}, window=1)
    belief = filter.predict(filter.init(Gaussian(np.zeros((1, 3)), 1e-9 * np.eye(3))))
    state = monitor.watch(monitor.start(1), filter.update(belief, [[size, 0.0, 0.0]]))
    assert state.alarm.all()
    assert monitor.names[int(state.accused[0])] == "one"
