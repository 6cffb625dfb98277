"""Sensors spoil measurements as much as they say.

Statistical tests have fixed seeds and bands with the false-alarm rate 1e-6.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from contract import make_core, single_class
from scipy.stats import binom, chi2

from estimators import RandomKeys
from vessel_gym.processes import Process
from vessel_gym.sensors import SUITES, Bias, Sensor, Sensors, in_quality, plain

FALSE_ALARM = 1e-6
SD = np.array([2e-3, 0.5, 3.0])
APART = tuple(Sensor(str(i), ("",), plain((i,)), (sd,)) for i, sd in enumerate(SD))
STATES, DT = tuple("abcdef"), 0.1


def made(sensors: Sequence[Sensor], dt: float = DT) -> Sensors:
    """Sensors of a vehicle that has states called a to f, and one force."""
    return Sensors(sensors, STATES, ("force",), dt)


def numbers(sensors: Sensors, seed: int, rows: int) -> RandomKeys:
    """Those of every row and sensor ``(rows, sensors)``."""
    episodes = RandomKeys.seeded([seed]).of(np.arange(rows))
    return RandomKeys(episodes.keys[:, None]).of(np.arange(len(sensors.each)))


def read(
    sensors: Sensors, exact: np.ndarray, steps: np.ndarray, drawn: RandomKeys
) -> tuple[np.ndarray, np.ndarray]:
    """Measurements of sensors that read the first states as they are, ``exact (n, p)``."""
    state, nothing = np.zeros((len(exact), len(STATES))), np.zeros((len(exact), 1))
    state[:, : exact.shape[1]] = exact
    return sensors.read(state, nothing, nothing[:, :0], np.array(steps), drawn.keys)


def corrupted(
    suite: dict[str, Any], seed: int, n: int = 20_000, exact: float = 0.0, nominal=APART, steps=0
):
    """Measurements, their mask and the normals in them: n at one step, or as many as ``steps`` says."""
    sensors = made(in_quality(nominal, **suite))
    drawn = numbers(sensors, seed, n)
    normals = [drawn[:, i].normals(len(sensor.channels)) for i, sensor in enumerate(sensors.each)]
    steps = np.broadcast_to(steps, n)
    return *read(sensors, np.full((n, sensors.size), exact), steps, drawn), np.concatenate(
        normals, -1
    )


def assert_variance(samples: np.ndarray, variance: float):
    low, high = chi2.ppf([FALSE_ALARM / 2, 1 - FALSE_ALARM / 2], samples.size) / samples.size
    assert low * variance < np.mean(samples**2) < high * variance


def assert_rate(events: np.ndarray, rate: float):
    low, high = binom.ppf([FALSE_ALARM / 2, 1 - FALSE_ALARM / 2], events.size, rate)
    assert low <= events.sum() <= high


# --- sensors --------------------------------------------------------------------------------------


def test_only_worst_of_three_suites_loses_measurements():
    clean, nominal, degraded = (in_quality(TOGETHER, **suite)[1] for suite in SUITES.values())
    assert max(clean.sd) < max(nominal.sd) == max(degraded.sd)
    assert clean.dropout == nominal.dropout == 0.0 < degraded.dropout


def test_measurements_are_the_exact_ones_plus_scaled_normals():
    measurements, _, normals = corrupted({"noise": 0.7}, seed=1, exact=-2.0)
    np.testing.assert_allclose(measurements, -2.0 + 0.7 * SD * normals, rtol=1e-14)


def test_drop_outs_and_outliers_are_independent_at_their_rates():
    suite = {"dropout": 0.2, "outliers": 0.05}
    measurements, available, normals = corrupted(suite, seed=4)
    outlier = np.abs(measurements / (SD * normals)) > 5.0
    for channel in range(3):
        assert_rate(~available[:, channel], 0.2)
        assert_rate(outlier[available[:, channel], channel], 0.05)
    both = available[:, 0] & available[:, 1]
    assert_rate(both, 0.8**2)
    assert_rate((outlier[:, 0] & outlier[:, 1])[both], 0.05**2)
    expected = np.where(outlier, 10.0, 1.0) * SD * normals
    np.testing.assert_allclose(measurements, np.where(available, expected, 0.0), rtol=1e-13)


def test_suites_are_paired_where_they_do_not_differ():
    nominal, _, _ = corrupted(SUITES["nominal"], seed=6)
    degraded, available, _ = corrupted(SUITES["degraded"], seed=6)
    same = degraded == nominal
    assert_rate(
        same, 0.9 * 0.95
    )  # neither dropped nor an outlier: to the bit as in the nominal suite
    assert available[same].all()


TOGETHER = (
    Sensor("log", ("surge", "sway"), plain((0, 1)), (0.1, 0.1), dropout=0.15),
    Sensor("fix", ("x", "y", "z"), plain((2, 3, 4)), (1.0, 1.0, 2.0), rate=0.5),
)


def test_the_channels_of_a_sensor_are_lost_and_spoilt_together():
    suite = {"dropout": 0.10, "outliers": 0.05}
    measurements, available, normals = corrupted(suite, seed=8, nominal=TOGETHER)
    assert_rate(~available[:, 0], 0.25)  # its own losses and the suite's
    assert_rate(~available[:, 2], 0.10)
    outlier = np.abs(measurements / (made(TOGETHER).sd * normals)) > 5.0
    for one, other in ((0, 1), (2, 4)):
        np.testing.assert_array_equal(available[:, one], available[:, other])
        np.testing.assert_array_equal(outlier[:, one], outlier[:, other])


def test_a_suite_changes_the_quality_of_sensors_and_nothing_else():
    log, fix = in_quality(TOGETHER, 2.0, 0.10, 0.05)
    assert (log.sd, log.dropout, log.outliers) == ((0.2, 0.2), 0.25, 0.05)
    for one, other in zip((log, fix), TOGETHER, strict=True):
        for field in fields(Sensor):
            if field.name not in ("sd", "dropout", "outliers"):
                assert getattr(one, field.name) is getattr(other, field.name), field.name
    assert in_quality(TOGETHER, **SUITES["clean"])[0].dropout == 0.0
    assert in_quality(TOGETHER, dropout=0.95)[0].dropout == 1.0


# --- rates ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("rate", "dt", "period"), [(None, 0.1, 1), (10.0, 0.1, 1), (0.5, 0.1, 20), (1.0, 0.5, 2),
                                                    (2.5, 0.1, 4), (1.0 / 3.0, 0.1, 30)])  # fmt: skip
def test_a_rate_that_divides_the_steps_is_kept(rate: float | None, dt: float, period: int):
    sensors, steps = (
        made([Sensor("fix", ("x",), plain((0,)), (1.0,), rate=rate)], dt),
        np.arange(100),
    )
    _, available = read(sensors, np.ones((100, 1)), steps, numbers(sensors, 0, 100))
    np.testing.assert_array_equal(available[:, 0], steps % period == 0)


@pytest.mark.parametrize("rate", [3.0, 20.0, 15.0, 0.3, 4.0, 1e9])
def test_rate_that_does_not_divide_steps_is_refused(rate: float):
    sentence = (
        rf"^fix reads at {re.escape(f'{rate:g}')} Hz, which does not divide the 10 steps a second:"
        r" its measurements "
    )
    with pytest.raises(ValueError, match=sentence + "would fall between steps$"):
        made([Sensor("fix", ("x",), plain((0,)), (1.0,), rate=rate)])


# --- ranges ---------------------------------------------------------------------------------------


def test_sensor_reads_within_its_range_alone():
    """What counts is what is true, not the noise: the range is the sensor's reach."""
    sonar = Sensor(
        "sonar", ("range", "bearing"), plain((0, 1)), (0.1, 0.1), range=((0.5, 50.0), (-1.0, 1.0))
    )
    sensors = made([sonar, Sensor("depth", ("z",), plain((2,)), (0.1,))])
    exact = np.array(
        [
            [0.5, 0, 9],
            [50, 1, 9],
            [0.4999, 0, 9],
            [50.0001, 0, 9],
            [9, 1.01, 9],
            [9, -1.01, 9],
            [9, -1, 9],
        ]
    )
    n = len(exact)
    for seed in range(50):
        drawn = numbers(sensors, seed, n)
        noise = np.concatenate([drawn[:, 0].normals(2), drawn[:, 1].normals(1)], -1)
        measurements, available = read(sensors, exact, np.zeros(n, int), drawn)
        there = np.array([1, 1, 0, 0, 0, 0, 1], bool)
        np.testing.assert_array_equal(available, np.stack([there, there, there | True], -1))
        np.testing.assert_array_equal(measurements[~available], 0.0)
        np.testing.assert_allclose(measurements[available], (exact + 0.1 * noise)[available])


# --- biases ---------------------------------------------------------------------------------------

BIASES = {
    "constant": Bias(("b", "c"), start=(0.2, 3.0)),
    "walking": Bias(("b", "c"), start=(0.2, 0.0), pace=(0.05, 2.0)),
    "correlated": Bias(("b", "c"), start=(0.2, 3.0), time=2.0),
    "correlated beside a constant": Bias(
        ("b", "c"), start=(0.2, 3.0), time=2.0, constant=(0.5, 0.0)
    ),
}
every_bias = pytest.mark.parametrize("bias", BIASES.values(), ids=BIASES)


def variance_of(bias: Bias, seconds: float) -> np.ndarray:
    """Of each channel's bias, so long after the start: constant + walk."""
    return np.square(bias.start) + np.square(bias.pace) * seconds


def moments(process: Process, steps: int) -> np.ndarray:
    """The covariance after so many steps."""
    cov = process.start_cov
    for _ in range(steps):
        cov = process.transition @ cov @ process.transition.T + process.root @ process.root.T
    return cov


@every_bias
def test_a_bias_has_the_variance_that_it_says_at_every_time(bias: Bias):
    for dt in (0.1, 0.5):
        for steps in (0, 1, 40):
            cov = moments(bias.process(dt), steps)
            np.testing.assert_allclose(np.diag(cov)[:2], variance_of(bias, steps * dt), rtol=1e-12)
            assert cov[0, 1] == 0.0
    constants = ("constant b", "constant c") if any(bias.constant) else ()
    assert bias.states == ("b", "c", *constants)
    assert bias.process(0.1).size == len(bias.states)


def test_a_bias_is_in_the_first_channels_and_in_no_other():
    both = Bias(("bias u",), start=(1.0,), constant=(1.0,))
    biased = Sensor("log", ("u", "v"), plain((0, 1)), (0.1, 0.1), bias=both)
    constant = Bias(("bias x", "bias y"), start=(1.0, 1.0))
    other = Sensor("fix", ("x", "y"), plain((2, 3)), (0.1, 0.1), bias=constant)
    sensors = made([APART[0], biased, other])
    assert sensors.bias_names == ("bias u", "constant bias u", "bias x", "bias y")
    read = sensors.exact(np.arange(6.0), np.zeros(1), np.array([0.1, 9.0, 0.3, 0.4]))
    np.testing.assert_allclose(read, [0.0, 9.1, 1.0, 2.3, 3.4])
    np.testing.assert_array_equal(sensors.exact(np.arange(6.0), np.zeros(1)), [0, 0, 1, 2, 3])


@pytest.mark.parametrize("pace", [(), (0.3, 0.1)], ids=["still", "walking"])
def test_constant_error_adds_to_moving_bias_and_never_changes(pace: tuple[float, ...]):
    bias = Bias(("bias u", "bias v"), start=(1.0, 2.0), pace=pace, constant=(0.5, 3.0))
    process, n = bias.process(0.5), len(bias.states)
    assert not process.root[n - 2 :].any()
    np.testing.assert_allclose(moments(process, 40)[-2:, -2:], np.diag([0.25, 9.0]), rtol=1e-15)
    sensors = made([Sensor("log", ("u", "v"), plain((0, 1)), (0.1, 0.1), bias=bias)])
    parts = np.arange(1.0, n + 1.0)
    read = sensors.exact(np.zeros(6), np.zeros(1), parts)
    np.testing.assert_allclose(read, parts[:2] + parts[n - 2 :], rtol=1e-15)


# --- noise that depends on what is measured -------------------------------------------------------


def growing(y: np.ndarray) -> np.ndarray:
    """A centimetre and a tenth of what is measured."""
    return 0.01 + 0.1 * np.abs(y)


GROWING = Sensor(
    "range", ("x", "y"), plain((0, 1)), growing, outliers=0.1, bias=Bias(("error",), start=(1.0,))
)


def test_noise_follows_the_true_measurement_and_its_bias():
    """The same normals as of constant noise, times the function's value; its variance within a band of chi-square."""
    rows = 20_000
    sensors = made([replace(GROWING, outliers=0.0)])
    state, bias = np.zeros((rows, len(STATES))), np.full((rows, 1), 2.0)
    state[:, 0], state[:, 1] = np.linspace(-5.0, 5.0, rows), 7.0
    drawn, steps = numbers(sensors, 1, rows), np.zeros(rows, int)
    exact = state[:, :2] + np.array([2.0, 0.0])
    y, available = sensors.read(state, np.zeros((rows, 1)), bias, steps, drawn.keys)
    assert available.all()
    for channel in (0, 1):
        assert_variance((y - exact)[:, channel] / growing(exact[:, channel]), 1.0)
    np.testing.assert_allclose(y, exact + growing(exact) * drawn[:, 0].normals(2), rtol=1e-14)


def ranging(sd: Any) -> list[Sensor]:
    """AUV's sensors with a range to a beacon far ahead instead of a fix."""
    nominal = [
        s
        for s in single_class("ItsunusaAUV-v0").system.vehicle.sensors
        if s.name != "acoustic position"
    ]

    def distance(state: np.ndarray, exogenous: np.ndarray) -> np.ndarray:
        return np.hypot(state[..., 3:4] - 60.0, state[..., 4:5])

    return [
        *nominal,
        Sensor("beacon", ("range [m]",), distance, sd, bias=Bias(("clock",), start=(0.5,))),
    ]


def test_filter_R_follows_predicted_measurement_in_each_row():
    """In a row alone to the last bit as in a batch."""
    flown = []
    for rows in (3, 1):
        core = make_core("ItsunusaAUV-v0", rows, sensors=ranging(growing), estimator="ekf")
        core.start(5)
        for _ in range(4):
            core.step(np.full(core.action_shape, 0.2))
        filter, belief = core.config.estimation.filter, core.now.belief
        R, expected = (
            filter.expect(belief, belief.u)[2],
            filter.model.measurement(belief.mean, belief.u),
        )
        np.testing.assert_allclose(R[:, -1, -1], growing(expected[:, -1]) ** 2, rtol=1e-12)
        assert (R[:, 0, 0] == core.config.sensors.sd[0] ** 2).all()
        flown.append(core.info())
    for name in ("truth", "measurement", "available", "estimate", "covariance"):
        np.testing.assert_array_equal(flown[1][name], flown[0][name][:1], name)


# --- what is misdeclared --------------------------------------------------------------------------


def fix(**changed: Any) -> Callable[[], Sensor]:
    options = {"name": "fix", "channels": ("x", "y"), "reads": plain((0, 1)), "sd": (1.0, 2.0)}
    return lambda: Sensor(**(options | changed))


def of(*sensors: Any) -> Callable[[], Sensors]:
    return lambda: made([sensor() if callable(sensor) else sensor for sensor in sensors])


MISDECLARED = [
    (fix(sd=(0.1,)), ValueError, r"sd of fix must have 2 entries, got \(0\.1,\)"),
    (fix(range=((0.0, 1.0), (2.0, 1.0))), ValueError, r"range of fix must have \(least, greatest\) for each .*"),
    (fix(channels="xy"), TypeError, r"channels of fix must be a tuple of names, got 'xy'"),
    (fix(dropout=1.1), ValueError, r"dropout of fix must be a number from 0 to 1, got 1\.1"),
    (fix(reads=np.zeros(2)), ValueError, r"reads of fix must be a function of \(state, exogenous\), got array.*"),
    (fix(angles=(2,)), ValueError, r"angles of fix must be indices below 2, got \(2,\)"),
    (fix(bias=Bias(("b", "c", "d"), start=(1.0,) * 3)), ValueError, r"fix has 2 channels, but a bias on 3"),
    (of(fix(gives=("a", "longitude"))), ValueError, r"unknown state that fix gives 'longitude': choose from a, b, .*"),
    (of(fix(), fix()), ValueError, r"two sensors are called 'fix': give each a name of its own"),
    (of(), TypeError, r"sensors must be .* Sensor objects, one at least, got \[\]"),
    (of(fix(reads=plain((0,)))), ValueError, r"reads of fix must give 2 values for each state: \(2, 3, 6\) gave "
                                             r"\(2, 3, 1\), expected \(2, 3, 2\)"),
    (lambda: Bias(("b",), (1.0,), time=10.0, pace=(0.1,)), ValueError, r"the bias .* is stationary: give it no .*"),
    (lambda: Bias(("b",), start=(1.0, 2.0)), ValueError, r"start of the bias .* must have 1 entries, got .*"),
]  # fmt: skip


@pytest.mark.parametrize(("make", "kind", "sentence"), MISDECLARED, ids=range(len(MISDECLARED)))
def test_what_is_misdeclared_is_refused_in_one_sentence(
    make: Callable, kind: type[Exception], sentence: str
):
    with pytest.raises(kind, match=f"^{sentence}$") as why:
        make()
    assert "\n" not in str(why.value)
    assert len(str(why.value)) < 300
