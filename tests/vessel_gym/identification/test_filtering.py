"""Filters on logs: consistent where the model is true, judged where it is not, and the same from a pipe."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from estimators import make
from tests.vessel_gym.identification.voyages import SHIP, STEP, coefficients, trial, write
from vessel_gym.identification.filtering import (
    NOISE,
    SENSORS,
    Voyage,
    estimate,
    judge,
    model,
    noise_of,
    simulated,
    start_noise,
    tune,
    voyages,
)  # fmt: skip
from vessel_gym.identification.stream import estimates
from vessel_gym.logs import Columns, LogError, read
from vessel_gym.vehicles.measured_ship import MeasuredShip


def known(rng: np.random.Generator) -> MeasuredShip:
    """A ship whose coefficients are known."""
    ship = replace(MeasuredShip.assumed(SHIP), coefficients=coefficients(rng))
    return replace(ship, noise=dict(zip(NOISE, map(float, start_noise(ship, 10.0)), strict=True)))


def voyage(rng: np.random.Generator, ship: MeasuredShip, noise: np.ndarray, steps: int = 400) -> Voyage:
    """A voyage drawn from the filter's own model."""
    each = trial(rng, ship.coefficients, steps * STEP).part(0, steps)
    u = np.concatenate([each.control, each.air], -1)
    plain = Voyage(each, np.zeros((steps, len(SENSORS))), u)
    return simulated(ship, plain, noise, int(rng.integers(2**31)))


def test_a_filter_on_its_own_model_is_trusted() -> None:
    """Means of 12 voyages: on 60 others a mean of 12 has standard deviations of .003, .008, .010, and .031 at most."""
    rng = np.random.default_rng(0)
    ship = known(rng)
    noise = noise_of(ship)
    verdicts = [judge("ekf", ship, voyage(rng, ship, noise), noise)[1] for _ in range(12)]
    assert abs(np.mean([each.inside for each in verdicts]) - 0.95) < 0.02
    assert abs(np.mean([each.ratio for each in verdicts]) - 1.0) < 0.05
    assert np.mean([each.lag for each in verdicts]) < 0.15
    for name in verdicts[0].withheld:
        assert 0.88 < np.mean([each.withheld[name] for each in verdicts]) <= 1.0
    assert np.mean([each.trusted for each in verdicts]) > 0.7


def test_a_filter_that_assumes_a_tenth_of_the_noise_is_not_trusted() -> None:
    rng = np.random.default_rng(1)
    ship = known(rng)
    noise = noise_of(ship)
    small = noise * np.where(np.isin(NOISE, ("time constant", "growth")), 1.0, 0.1)
    _, verdict = judge("ekf", ship, voyage(rng, ship, noise), small)
    assert not verdict.trusted
    assert verdict.inside < 0.2


@pytest.mark.slow
def test_noise_is_recovered() -> None:
    rng = np.random.default_rng(2)
    ship = known(rng)
    noise = noise_of(ship) * (2.0, 0.5, 2.0, 1.5, 1.5, 1.5, 0.7, 1.0, 1.0)
    found = tune(ship, [voyage(rng, ship, noise, 600) for _ in range(6)])
    np.testing.assert_allclose(found[:3], noise[:3], rtol=0.1)
    # Power of the accelerations: variance times time constant, for what they do in many steps.
    np.testing.assert_allclose(found[3:6] ** 2 * found[6], noise[3:6] ** 2 * noise[6], rtol=0.6)


def test_a_withheld_sensor_changes_nothing_but_what_is_measured() -> None:
    rng = np.random.default_rng(3)
    ship = known(rng)
    noise = noise_of(ship)
    each = voyage(rng, ship, noise, 60)
    altered = replace(each, y=np.where(np.arange(60)[:, None] > 0, each.y + (0, 0, 0.5, 0), each.y))
    first, second = (estimate("ekf", ship, one, noise, ("heading",)) for one in (each, altered))
    np.testing.assert_array_equal(first.mean, second.mean)


def test_a_pipe_gives_the_estimates_of_the_file(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    ship = known(rng)
    sailed = trial(rng, ship.coefficients, 80.0)
    write(tmp_path / "log.csv", replace(sailed, air=0.0 * sailed.air))
    (each,) = voyages(read(tmp_path / "log.csv"), 1.0)
    expected = estimate("ekf", ship, each, noise_of(ship))
    with (tmp_path / "log.csv").open() as lines:
        found = list(estimates(lines, Columns({}), ship, "ekf"))
    times = np.array([time for time, _, _ in found])
    assert np.all(np.diff(times) == 1.0)
    late = np.array([mean[:2] for _, mean, _ in found])[20:70]
    sailed_at = np.interp(times[20:70], each.trial.start + np.arange(len(each.u)), expected.mean[:, 0])
    assert np.sqrt(np.mean((late[:, 0] - sailed_at) ** 2)) < 0.1  # the pipe's step ends up to one row earlier


def test_a_pipe_without_a_sensor_is_refused() -> None:
    with pytest.raises(LogError, match="no column is the heading"):
        next(estimates(["t,x,y\n"], Columns({}), known(np.random.default_rng(5)), "ekf"))


def test_a_vessel_without_noise_is_refused() -> None:
    with pytest.raises(ValueError, match="no 'position': identify the ship"):
        noise_of(MeasuredShip.assumed(SHIP))


@pytest.mark.parametrize("name", ["ukf", "enkf"])
def test_other_filters_agree_with_the_ekf(name: str) -> None:
    rng = np.random.default_rng(6)
    ship = known(rng)
    noise = noise_of(ship)
    each = voyage(rng, ship, noise, 100)
    ekf = estimate("ekf", ship, each, noise)
    other = estimate(name, ship, each, noise, rng=1)
    sd = np.sqrt(np.einsum("tii->ti", ekf.cov))[:, :6]
    assert np.sqrt(np.mean(((other.mean - ekf.mean)[:, :6] / sd) ** 2)) < (0.1 if name == "ukf" else 1.0)
    assert make(name, model(ship, STEP)).model.p == len(SENSORS)
