"""Filters on logs: consistent where the model is true, judged where it is not, and the same from a pipe."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import t as student

from tests.vessel_gym.identification.voyages import SHIP, STEP, coefficients, trial, write
from vessel_gym.identification import filtering, tuning
from vessel_gym.identification.consistency import Verdict, _lag, judge, simulated, withheld_errors
from vessel_gym.identification.filtering import (
    NOISE,
    SENSORS,
    WITHHELD,
    Voyage,
    estimate,
    noise_of,
    start_noise,
    voyages,
)  # fmt: skip
from vessel_gym.identification.prediction import simulate
from vessel_gym.identification.stream import _Fresh, estimates
from vessel_gym.identification.trial import Trial, pace, without_repeats
from vessel_gym.identification.tuning import _outage, tune
from vessel_gym.logs import Columns, LogError, read
from vessel_gym.vehicles.measured_ship import MeasuredShip


def known(rng: np.random.Generator) -> MeasuredShip:
    """A ship whose coefficients are known."""
    ship = replace(MeasuredShip.assumed(SHIP), coefficients=coefficients(rng), revolutions=8.0)
    return replace(ship, noise=dict(zip(NOISE, map(float, start_noise(ship, 10.0)), strict=True)))


def voyage(rng: np.random.Generator, ship: MeasuredShip, noise: np.ndarray, steps: int = 400) -> Voyage:
    """A voyage drawn from the filter's own model."""
    each = trial(rng, ship.coefficients, steps * STEP).part(0, steps)
    u = np.concatenate([each.control, each.air], -1)
    plain = Voyage(each, np.zeros((steps, len(SENSORS))), u)
    return simulated(ship, plain, noise, int(rng.integers(2**31)))


def less(noise: np.ndarray, factor: float) -> np.ndarray:
    """Noise whose standard deviations are smaller; time constant and factors of growth are none."""
    kept = ("time constant", "growth", "manoeuvre", *(f"{sensor} outage" for sensor in WITHHELD))
    return noise / np.where(np.isin(NOISE, kept), 1.0, factor)


def test_a_filter_on_its_own_model_is_trusted() -> None:
    """Means of 12 voyages, within 4 standard deviations of them on 36 others.

    Those are .003 of the share of NIS, .004 of the ratio and .022 of the lag, about .02: of four sensors' correlations
    the largest magnitude is of either sign. A withheld sensor errs for minutes, so that a voyage says about as much as
    one measurement: .04.
    """
    rng = np.random.default_rng(0)
    ship = known(rng)
    noise = noise_of(ship)
    verdicts = [judge("ekf", ship, voyage(rng, ship, noise), noise)[1] for _ in range(12)]
    assert abs(np.mean([each.inside for each in verdicts]) - 0.95) < 0.013
    assert abs(np.mean([each.ratio for each in verdicts]) - 1.0) < 0.016
    assert abs(np.mean([each.lag for each in verdicts]) - 0.02) < 0.088
    for name in verdicts[0].withheld:
        assert np.mean([each.withheld[name] for each in verdicts]) > 0.95 - 0.16
    assert np.mean([each.trusted for each in verdicts]) > 0.5  # .86 ± .1 of 12, each as likely


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_lag_is_the_largest_of_either_sign(sign: float) -> None:
    """Innovations of one sensor that alternate, or stay, stand out of three white ones by four standard deviations."""
    rng = np.random.default_rng(15)
    innovation = rng.normal(size=(405, 4))
    innovation[:, 2] = 0.8**0.5 * sign ** np.arange(405) + 0.2**0.5 * innovation[:, 2]
    belief = SimpleNamespace(
        innovation=innovation, innovation_cov=np.broadcast_to(np.eye(4), (405, 4, 4)), available=np.ones((405, 4), bool)
    )
    assert abs(_lag(belief) - sign * 0.8) < 0.2


def test_a_verdict_needs_enough_steps() -> None:
    """Of few steps nearly all filters have all inside, also one that errs in three of ten."""
    good = Verdict(1.0, 1.0, 0.0, 0.0, dict.fromkeys(WITHHELD, 0.95), dict.fromkeys(WITHHELD, 1.0), 29)
    assert good.doubts == ["too few steps"]
    assert not good.trusted
    assert replace(good, count=30).trusted
    rng = np.random.default_rng(0)
    ship = known(rng)
    each = voyage(rng, ship, noise_of(ship), 60)
    for steps in (7, 34, 35):
        _, verdict = judge("ekf", ship, each.part(0, steps), noise_of(ship))
        assert verdict.count == steps - 5
        assert ("too few steps" in verdict.doubts) == (steps < 35)
    with pytest.raises(ValueError, match=r"ekf on .*: no measurement comes after the first 5 steps"):
        judge("ekf", ship, each.part(0, 5), noise_of(ship))


def test_noise_is_tuned_on_a_voyage_at_least() -> None:
    with pytest.raises(ValueError, match="there is no voyage"):
        tune(known(np.random.default_rng(0)), [])


def test_the_level_of_all_noise_is_found() -> None:
    """A filter that assumes a third of every standard deviation finds levels of nine, and is as good as without.

    The mean of n squares of a sensor has the relative standard deviation sqrt(2 / n). The share of NIS inside has .011.
    Withheld sensors have the level of the others.
    """
    rng = np.random.default_rng(1)
    ship = known(rng)
    noise = noise_of(ship)
    each = voyage(rng, ship, noise)
    found, verdict = judge("ekf", ship, each, less(noise, 3.0))
    count = 300 * np.array([len(sensors) for sensors in WITHHELD.values()])
    assert np.all(np.abs(np.log(found.level[-300:].mean(0) / 9.0)) < 4.0 * np.sqrt(2.0 / count))
    assert abs(verdict.inside - 0.95) < 0.044
    expected = judge("ekf", ship, each, noise)[1].deviations
    for name, deviation in verdict.deviations.items():
        assert abs(np.log(deviation / expected[name])) < np.log(2.0)


def test_noise_of_which_each_innovation_is_too_large_is_found() -> None:
    """Measurements that are taken after rejections raise the level until others pass."""
    rng = np.random.default_rng(1)
    ship = known(rng)
    noise = noise_of(ship)
    found = estimate("ekf", ship, voyage(rng, ship, noise), less(noise, 30.0))
    count = 300 * np.array([len(sensors) for sensors in WITHHELD.values()])
    assert np.all(np.abs(np.log(found.level[-300:].mean(0) / 900.0)) < 4.0 * np.sqrt(2.0 / count))
    assert found.rejected.mean() < 0.03
    assert not found.rejected[30:].any()


def test_factors_of_outages_apply_while_a_sensor_is_missing() -> None:
    """Standard deviations of what it measures grow to threefold from the sixth step on, and no other does.

    Until then and after its return they are those without a factor.
    """
    rng = np.random.default_rng(3)
    ship = known(rng)
    noise, each = noise_of(ship), voyage(rng, ship, noise_of(ship), 200)
    factors = noise * np.where(np.array(NOISE) == "heading outage", 3.0, 1.0)
    y = each.y.copy()
    y[50:150, SENSORS.index("heading")] = np.nan
    found, plain = (estimate("ekf", ship, replace(each, y=y), used) for used in (factors, noise))
    grown = found.level / plain.level
    np.testing.assert_array_equal(grown[:56], 1.0)
    np.testing.assert_array_equal(grown[:, [0, 2]], 1.0)
    assert np.all(np.diff(grown[50:151, 1]) >= 0.0)
    assert 8.0 < grown[100, 1] < grown[150, 1] <= 9.0
    np.testing.assert_array_equal(found.mean[:150], plain.mean[:150])
    assert grown[151, 1] < 1.1


def test_a_factor_that_is_none_is_refused() -> None:
    ship = known(np.random.default_rng(3))
    for factor in (0.5, 11.0, np.inf):
        wrong = replace(ship, noise=ship.noise | {"heading outage": factor})
        with pytest.raises(ValueError, match=r"'heading outage' must be from 1 to 10, got"):
            noise_of(wrong)


def test_a_factor_allows_for_few_voyages_and_lost_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """On its own model a factor of one voyage is that of Student's t with two degrees of freedom, as of three."""
    rng = np.random.default_rng(5)
    ship = known(rng)
    noise = noise_of(ship)
    one = voyage(rng, ship, noise, 100)
    ratios = np.abs(np.divide(*withheld_errors(("yaw rate",), "ekf", ship, one, noise))) / 2.0
    expected = student.ppf(0.97725, 2) / 2.0 * np.quantile(ratios, 0.9545)
    assert _outage(("yaw rate",), ship, [one], noise) == pytest.approx(max(1.0, expected))
    assert _outage(("yaw rate",), ship, [one, one.part(0, 20)], noise) == pytest.approx(max(1.0, expected))
    monkeypatch.setattr(tuning, "withheld_errors", lambda *_: (np.full(95, np.nan), np.ones(95)))
    assert _outage(("yaw rate",), ship, [one], noise) == 10.0


@pytest.mark.slow
def test_factors_of_outages_make_good_what_lasts() -> None:
    """The ship drifts four times as fast as assumed: positions are within two deviations on the voyages tuned on.

    There the factor is the quantile or, for four voyages only, somewhat more. On four others it helps, which is less:
    one voyage says about as much as one measurement.
    """
    rng = np.random.default_rng(4)
    ship = known(rng)
    drifting = noise_of(ship) * np.where(np.isin(NOISE, ("current", "sway", "surge")), 4.0, 1.0)
    own, others = ([voyage(rng, ship, drifting, 200) for _ in range(4)] for _ in range(2))
    found = tune(ship, own)
    plain = np.where(np.char.endswith(NOISE, "outage"), 1.0, found)

    def share(among: list[Voyage], noise: np.ndarray) -> float:
        ratios = [np.divide(*withheld_errors(("x", "y"), "ekf", ship, each, noise)) for each in among]
        return float((np.abs(np.concatenate(ratios)) < 2.0).mean())

    assert share(own, plain) < 0.9 < 0.95 < share(own, found)
    assert share(others, found) > share(others, plain) + 0.1


def test_a_filter_with_wrong_ratios_of_noise_is_not_trusted() -> None:
    """Levels make good what innovations show, not what a filter foretells of a sensor that it does not get."""
    rng = np.random.default_rng(1)
    ship = known(rng)
    noise = noise_of(ship)
    wrong = noise * np.where(np.isin(NOISE, ("surge", "sway", "yaw", "current", "gyro drift")), 0.05, 1.0)
    verdicts = [judge("ekf", ship, voyage(rng, ship, noise), wrong)[1] for _ in range(3)]
    assert not any(each.trusted for each in verdicts)
    assert max(min(each.withheld.values()) for each in verdicts) < 0.75


@pytest.mark.slow
def test_noise_is_recovered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Within 4 standard deviations of 6 draws with other seeds: .03 of the logarithm and, of the yaw rate, .15.

    The noise of the gyro is confounded with accelerations of a step. The tuning begins at a distance of log 2.
    """
    rng = np.random.default_rng(2)
    ship = known(rng)
    noise = noise_of(ship) * np.array([2.0, 0.5, 2.0, 1.0, 1.0, 1.5, *[1.0] * 11])
    monkeypatch.setattr(tuning, "_outage", lambda *_: 1.0)  # found afterwards, in a quarter of the time
    found = tune(ship, [voyage(rng, ship, noise, 600) for _ in range(4)])
    assert np.all(np.abs(np.log(found[:3] / noise[:3])) < (0.15, 0.15, 0.6))


def test_a_withheld_sensor_changes_nothing_but_what_is_measured() -> None:
    rng = np.random.default_rng(3)
    ship = known(rng)
    noise = noise_of(ship)
    each = voyage(rng, ship, noise, 60)
    altered = replace(each, y=np.where(np.arange(60)[:, None] > 0, each.y + (0, 0, 0.5, 0), each.y))
    first, second = (estimate("ekf", ship, one, noise, ("heading",)) for one in (each, altered))
    np.testing.assert_array_equal(first.mean, second.mean)


@pytest.mark.parametrize("rate", [pytest.param(filtering.GATE, marks=pytest.mark.nightly), 2e-2])
def test_the_gate_rejects_at_its_rate(rate: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """On its own model, within 4 standard deviations of the binomial distribution, false alarm 1e-4.

    Rejections make the level, which has an error of its own, too small: of independent normal innovations, too, the
    gate rejects .025 of single ones and .023 of pairs at .02 (4,000 steps of 400 series). So a quarter is allowed for.
    """
    monkeypatch.setattr(filtering, "GATE", rate)
    rng = np.random.default_rng(7)
    ship = known(rng)
    noise = noise_of(ship)
    found = np.concatenate([estimate("ekf", ship, voyage(rng, ship, noise), noise).rejected for _ in range(8)])
    each = found[:, [SENSORS.index(sensors[0]) for sensors in WITHHELD.values()]]
    assert each.mean() - 1.25 * rate < 4.0 * np.sqrt(1.25 * rate / each.size) + 1.0 / each.size
    assert each.mean() - rate > -4.0 * np.sqrt(rate / each.size)


@pytest.mark.parametrize(("sensor", "size"), [("x", 0.5), ("heading", 0.5), ("yaw rate", 0.3)])
def test_jumps_of_a_measurement_are_rejected(sensor: str, size: float) -> None:
    """Every 40th value jumps; 19 of 20 are rejected, and estimates are those without the jumps."""
    rng = np.random.default_rng(8)
    ship = known(rng)
    noise = noise_of(ship)
    clean = voyage(rng, ship, noise, 800)
    jumps = np.arange(50, 800, 40)
    damaged, missing = clean.y.copy(), clean.y.copy()
    columns = [SENSORS.index(each) for each in next(each for each in WITHHELD.values() if sensor in each)]
    damaged[jumps, SENSORS.index(sensor)] += size
    missing[jumps[:, None], columns] = np.nan
    found = estimate("ekf", ship, replace(clean, y=damaged), noise)
    expected = estimate("ekf", ship, replace(clean, y=missing), noise)
    assert found.rejected[jumps, columns[0]].mean() >= 0.95
    if found.rejected[jumps, columns[0]].all() and found.rejected.sum() == len(jumps) * len(columns):
        np.testing.assert_allclose(found.mean, expected.mean, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", ["ekf", "ukf", "huber-kf"])
@pytest.mark.parametrize(
    ("sensor", "size"),
    [*(("x", size) for size in (3.0, 10.0, 100.0, 1e4, 2e5)), *(("heading", size) for size in (0.2, np.pi / 2, 3.0))],
)
@pytest.mark.filterwarnings("error")
def test_what_a_sensor_shows_is_found_again_and_nothing_else_moves(name: str, sensor: str, size: float) -> None:
    """Position, heading and yaw rate are those of a log without the jump, and about as certain 20 steps later.

    A jump of any size tells nothing of the other states: they move by less than a standard deviation. A new heading
    turns the speed over the ground, too, so that the next position errs by some.
    """
    rng = np.random.default_rng(9)
    ship = known(rng)
    noise = noise_of(ship)
    clean = voyage(rng, ship, noise, 160)
    jump = np.where((np.arange(160)[:, None] >= 100) & (np.array(SENSORS) == sensor), size, 0.0)
    found = estimate(name, ship, replace(clean, y=clean.y + jump), noise)
    expected = estimate(name, ship, clean, noise).mean[:, [0, 1, 2, 5]] + jump
    assert found.rejected[100:102, SENSORS.index(sensor)].all()
    assert not found.rejected[102:].any()
    sd = np.sqrt(np.einsum("tii->ti", found.cov))[:, [0, 1, 2, 5]]
    off = np.abs((found.mean[:, [0, 1, 2, 5]] - expected) / sd)[102:]
    assert off.max() < 5.0
    assert off[:, 2:].max() < 1.0
    assert np.all(sd[120] < 3.0 * sd[99])


def test_a_ship_whose_speed_changed_is_found_again() -> None:
    """A tug moves her at 0.5 m/s, as fast as she sails: the third fix says how fast, and no more are rejected."""
    rng = np.random.default_rng(9)
    ship = known(rng)
    noise = noise_of(ship)
    clean = voyage(rng, ship, noise, 160)
    towed = 0.5 * np.maximum(0.0, np.arange(160.0) - 100.0)[:, None] * (1.0, 0.0, 0.0, 0.0)
    found = estimate("ekf", ship, replace(clean, y=clean.y + towed), noise)
    assert found.rejected[100:, 0].sum() <= 4
    sd = np.sqrt(found.cov[106:, 0, 0])
    assert np.abs((found.mean - clean.y[:, :1] - towed[:, :1])[106:, 0] / sd).max() < 6.0


def test_the_filter_of_a_log_without_noise_foretells_the_next_manoeuvre() -> None:
    """Innovations that vanish do not make a level vanish: the turn after a straight course is believed."""
    rng = np.random.default_rng(1)
    ship = replace(known(rng), coefficients=coefficients(rng, 0.3))
    steps = 150
    control, air = np.zeros((5 * steps, 2)), np.zeros((5 * steps, 4))
    control[:, 1], control[5 * 75 :, 0] = 8.0, 0.5
    states = simulate(np.array([0.0, 0.0, 0.3, 0.5, 0.0, 0.0]), control, air, ship.coefficients, SHIP.vector(), STEP)
    u = np.concatenate([control, air], -1)[::5]
    sailed = Trial("straight, then a turn", 5 * STEP, 0.0, states[::5], u[:, :2], u[:, 2:])
    found = estimate("ekf", ship, Voyage(sailed, states[::5][:steps, [0, 1, 2, 5]], u), noise_of(ship))
    assert found.level.min() == pytest.approx(0.01)
    assert not found.rejected.any()


def test_a_ship_that_did_move_is_found_again() -> None:
    """A tug moves her by 3 m within a step: her position is believed after the rejections that the gate allows."""
    rng = np.random.default_rng(9)
    ship = known(rng)
    noise = noise_of(ship)
    clean = voyage(rng, ship, noise, 200)
    moved = clean.y + np.where(np.arange(200)[:, None] >= 100, (3.0, 0.0, 0.0, 0.0), 0.0)
    found = estimate("ekf", ship, replace(clean, y=moved), noise)
    assert found.rejected[100:102, 0].all()
    assert not found.rejected[102, 0]
    error = np.abs(found.mean[:, 0] - moved[:, 0])
    assert error[101] > 2.0
    assert error[150:].max() < 0.5


def test_a_held_sensor_is_missing_and_the_uncertainty_grows(tmp_path: Path) -> None:
    rng = np.random.default_rng(10)
    ship = known(rng)
    sailed = trial(rng, ship.coefficients, 80.0)
    states = sailed.states.copy()
    states[200:240, :2] = states[200, :2]  # 8 s
    write(tmp_path / "held.csv", replace(sailed, states=states))
    (each,) = voyages(read(tmp_path / "held.csv"), 1.0)
    assert np.isnan(each.y[41:48, :2]).all()
    assert np.isfinite(each.y[41:48, 2:]).all()
    found = estimate("ekf", ship, each, noise_of(ship))
    sd = np.sqrt(found.cov[:, 0, 0])
    assert np.all(np.diff(sd[41:48]) > 0.0)
    assert not found.rejected[40:50].any()


def test_repeats_are_held_where_the_resolution_is_fine() -> None:
    rng = np.random.default_rng(11)
    values = np.cumsum(rng.uniform(0.5, 1.5, 1000))
    held = values.copy()
    held[500:502] = held[499]
    times = np.arange(1000.0)
    np.testing.assert_array_equal(without_repeats(times, held, "x")[0], np.delete(times, [500, 501]))
    rounded = np.round(0.4 * values)  # two of five values change: the instrument's resolution
    assert len(without_repeats(times[:20], rounded[:20], "x")[0]) == 20


def judged_fresh(values: np.ndarray, name: str) -> tuple[int, int]:
    """Repeats that a log and a pipe leave out."""
    fresh = _Fresh(name == "heading")
    kept, _ = without_repeats(np.arange(float(len(values))), values, name)
    return len(values) - len(kept), sum(not fresh(each) for each in values.tolist())


def test_a_coarse_compass_stays_coarse_at_north() -> None:
    """It shows whole degrees, and crosses north in every third step: none of its repeats was held."""
    rng = np.random.default_rng(12)
    degrees = np.round(2.0 * np.sin(2.1 * np.arange(400)) + rng.normal(size=400)) % 360.0
    assert np.any(np.diff(degrees) == 0.0)
    assert np.mean(np.abs(np.diff(degrees)) > 180.0) > 0.25
    assert judged_fresh(np.deg2rad(degrees), "heading") == (0, 0)


def test_a_fine_compass_stays_fine_at_north() -> None:
    rng = np.random.default_rng(13)
    degrees = rng.normal(0.0, 0.8, 400) % 360.0
    degrees[300:302] = degrees[299]
    assert judged_fresh(np.deg2rad(degrees), "heading") == (2, 2)


@pytest.mark.parametrize("far", [1e3, 2e5])
def test_outliers_do_not_make_coarse_fixes_fine(far: float) -> None:
    """Fixes of whole metres of a slow ship repeat; one is wrong by up to 200 km."""
    rng = np.random.default_rng(14)
    values = np.round(np.cumsum(rng.uniform(0.4, 1.0, 400)))
    assert np.any(np.diff(values) == 0.0)
    values[50] += far
    assert judged_fresh(values, "x") == (0, 0)


def test_a_jump_does_not_set_the_time_step() -> None:
    """One speed of 1 km/s among 200 counts as five times the median: at most 6 % more than without."""
    speeds = np.full(200, 0.5)
    speeds[100] = 1e3
    assert 1.0 <= pace(SHIP, np.full(200, 0.5)) / pace(SHIP, speeds) < 1.06 + 1e-9


def test_a_pipe_gives_the_estimates_of_the_file(tmp_path: Path) -> None:
    """Its speed is unknown in the beginning, so that they agree after a while."""
    rng = np.random.default_rng(4)
    ship = known(rng)
    sailed = trial(rng, ship.coefficients, 260.0)
    write(tmp_path / "all.csv", replace(sailed, air=0.0 * sailed.air))
    header, *lines = (tmp_path / "all.csv").read_text().splitlines()
    (tmp_path / "log.csv").write_text("\n".join([header, *lines[:: round(1.0 / STEP)]]) + "\n")
    (each,) = voyages(read(tmp_path / "log.csv"), 1.0)
    expected = estimate("ekf", ship, each, noise_of(ship))
    with (tmp_path / "log.csv").open() as log:
        found = list(estimates(log, Columns({}), ship, "ekf"))
    assert np.all(np.diff([time for time, _, _ in found]) == 1.0)
    off = np.array([mean for _, mean, _ in found])[200:250] - expected.mean[200:250]
    sd = np.sqrt(np.einsum("tii->ti", expected.cov[200:250]))
    assert np.abs(off / sd)[:, :6].max() < 0.05


def test_a_pipe_without_a_sensor_is_refused() -> None:
    with pytest.raises(LogError, match="no column is the heading"):
        next(estimates(["t,x,y\n"], Columns({}), known(np.random.default_rng(5)), "ekf"))


def test_a_vessel_without_noise_is_refused() -> None:
    with pytest.raises(ValueError, match="no 'position': identify the ship"):
        noise_of(MeasuredShip.assumed(SHIP))


def apart(name: str, factor: float) -> float:
    """RMS difference of a filter's estimates from those of the ekf, in its standard deviations, at less noise."""
    rng = np.random.default_rng(6)
    ship = known(rng)
    noise = less(noise_of(ship), factor)
    each = voyage(rng, ship, noise, 100)
    ekf, other = estimate("ekf", ship, each, noise), estimate(name, ship, each, noise, rng=1)
    sd = np.sqrt(np.einsum("tii->ti", ekf.cov))[:, :6]
    return float(np.sqrt(np.mean(((other.mean - ekf.mean)[:, :6] / sd) ** 2)))


def test_the_ukf_agrees_with_the_ekf_where_noise_vanishes() -> None:
    """They differ by what is quadratic in the errors, which in standard deviations is proportional to the noise.

    At a tenth of the noise it is a tenth, cubic terms aside: less than a fifth.
    """
    large, small = apart("ukf", 3.0), apart("ukf", 30.0)
    assert large < 0.2
    assert small < 0.2 * large


def test_the_enkf_agrees_with_the_ekf_as_members_become_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sampling errors are as the inverse root of the number of members: 16 times as many halve it twice.

    The two ensembles are independent, and each error is of hundreds of estimates in dependent steps: half as much
    again.
    """
    errors = []
    for members in (400, 6400):
        monkeypatch.setattr(filtering, "_MEMBERS", members)
        filtering._filter.cache_clear()
        errors.append(apart("enkf", 30.0))
    filtering._filter.cache_clear()
    assert 0.25 / 1.5 < errors[1] / errors[0] < 0.25 * 1.5
