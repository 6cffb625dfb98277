"""Consistency of filters on measured data, where there is no truth: innovations, and sensors withheld in turn."""

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from estimators.angles import difference
from estimators.metrics import nis
from vessel_gym.identification.filtering import (
    SENSORS,
    WITHHELD,
    Estimates,
    Voyage,
    degrees_of_freedom,
    estimate,
    inputs,
    measurement_noise,
    model,
    prior,
    sensor_levels,
)
from vessel_gym.vehicles.measured_ship import MeasuredShip

_BEGINNING, _DRAWS, _ENOUGH = 5, 100_000, 30
"""Steps that are not judged, draws of quantiles, and NIS values that a verdict needs.

Of 30 independent values, fewer than 85 % are inside in 2 % of cases if the filter is consistent. At least 85 % are in
3 % of cases if 70 % are on average (binomial distribution); of 10 values in 15 %, of 2 in 49 %.
"""


@dataclass(frozen=True)
class Verdict:
    """Consistency of a filter on measured data.

    Attributes:
        inside: Share of NIS within its central 95 % interval, of all measurements, those that the gate rejected too.
        ratio: Mean NIS over that of a consistent filter, of what the gate let through.
        rejected: Share of measured values that the gate rejected.
        lag: Correlation of successive innovations of the sensor where its magnitude is largest, signed; 0 for a
            consistent filter.
        withheld: Share of each sensor's measurements within two standard deviations of what a filter without that
            sensor foretells, measurement noise included; .954 for a consistent filter.
        deviations: Median of those standard deviations [m, rad, rad/s].
        count: Steps with a NIS.
    """

    inside: float
    ratio: float
    rejected: float
    lag: float
    withheld: dict[str, float]
    deviations: dict[str, float]
    count: int

    @property
    def doubts(self) -> list[str]:
        """Figures that are far from a consistent filter's: NIS inside, NIS ratio, withheld sensors; too few steps."""
        near = {"NIS inside": self.inside >= 0.85, "NIS ratio": 0.5 <= self.ratio <= 2.0}
        near |= {sensor: not share < 0.75 for sensor, share in self.withheld.items()}
        far = [figure for figure, good in near.items() if not good]
        return far if self.count >= _ENOUGH else ["too few steps", *far]

    @property
    def trusted(self) -> bool:
        """True if its standard deviations may be believed: in enough steps, near what a consistent filter has."""
        return not self.doubts


def simulated(ship: MeasuredShip, voyage: Voyage, noise: np.ndarray, rng: int = 0) -> Voyage:
    """A voyage with the same inputs whose motion and measurements are drawn from the filters' own model.

    Measurements that the log lacks are lacking here, too. A filter is as consistent on the log as here if the model
    holds at sea.
    """
    from estimators.consistency import simulate

    ships_states = voyage.trial.states.shape[-1]
    drawn = simulate(
        model(ship, voyage.trial.dt), prior(voyage.trial.states[0], noise), np.random.default_rng(rng), runs=2,
        steps=len(voyage.u), u=inputs(ship, voyage.u, noise)[:, None],
    )  # fmt: skip
    states = np.concatenate([drawn.x[:, 0], drawn.x[-1:, 0]])[:, :ships_states]
    y = np.where(np.isfinite(voyage.y), drawn.y[:, 0], np.nan)
    return Voyage(replace(voyage.trial, states=states), y, voyage.u)


def nis_of(estimates: Estimates, passed: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """NIS ``(T,)`` and its degrees of freedom ``(T,)``: of all measurements that came, or of those that passed."""
    belief: Any = estimates.updated if passed else estimates.tried
    return nis(belief.innovation, belief.innovation_cov), np.asarray(belief.available).sum(-1)


def nis_band(estimates: Estimates, passed: bool = False) -> np.ndarray:
    """Limits of the central 95 % interval of a consistent filter's NIS, and its mean, ``(T, 3)``.

    Each sensor's square is relative to an estimated level, and has an F distribution instead of chi-squared.

    Args:
        estimates: Over T steps.
        passed: True for the measurements ``(T, 4)`` that passed the gate; False for all that came.

    Returns:
        ``(T, 3)`` lower limit, upper limit and mean; zeros where no measurement came.
    """
    belief: Any = estimates.updated if passed else estimates.tried
    came = np.asarray(belief.available)
    columns = [[SENSORS.index(each) for each in sensors] for sensors in WITHHELD.values()]
    counts = np.stack([came[:, each].sum(-1) for each in columns], -1)
    return np.array([_band(tuple(each)) for each in counts.tolist()])


@lru_cache(64)
def _band(counts: tuple[int, ...]) -> tuple[float, float, float]:
    """Quantiles and mean of a sum of F distributions, each times its degrees of freedom, by simulation."""
    rng = np.random.default_rng(0)
    squares = sum(n * rng.f(n, degrees_of_freedom(n), _DRAWS) if n else np.zeros(_DRAWS) for n in counts)
    return float(np.quantile(squares, 0.025)), float(np.quantile(squares, 0.975)), float(np.mean(squares))


def consistency(found: Estimates) -> tuple[float, float, float, float]:
    """Share of NIS inside, NIS ratio, share rejected and lag, as in `Verdict`.

    Raises:
        ValueError: if no measurement came after the beginning, or the estimates are lost.
    """
    square, count = (each[_BEGINNING:] for each in nis_of(found))
    used = count > 0
    if not used.any():
        raise ValueError(f"no measurement comes after the first {_BEGINNING} steps")
    if not np.isfinite(square[used]).all():
        raise ValueError("the estimates are lost")
    low, high, _ = nis_band(found)[_BEGINNING:][used].T
    inside = float(((square[used] > low) & (square[used] < high)).mean())
    square, _ = (each[_BEGINNING:] for each in nis_of(found, passed=True))
    expected = float(nis_band(found, passed=True)[_BEGINNING:, 2].sum())
    rejected = float(found.rejected[_BEGINNING:].sum() / count.sum())
    return inside, float(square.sum()) / max(1.0, expected), rejected, _lag(found.updated)


def filtered(
    name: str, ship: MeasuredShip, voyage: Voyage, noise: np.ndarray, rng: int = 0
) -> tuple[Estimates, tuple[float, float, float, float]]:
    """A filter over a voyage, and its `consistency`.

    Raises:
        ValueError: if the filter cannot work with the model, no measurement came after the first steps, or the
            estimates are lost.
    """
    found = estimate(name, ship, voyage, noise, rng=rng)
    try:
        return found, consistency(found)
    except ValueError as error:
        raise ValueError(f"{name} on {voyage.trial.name}: {error}") from None


def judge(name: str, ship: MeasuredShip, voyage: Voyage, noise: np.ndarray, rng: int = 0) -> tuple[Estimates, Verdict]:
    """A filter over a voyage, and how consistent it is with all sensors and without each.

    Raises:
        ValueError: as `filtered`.
    """
    found, numbers = filtered(name, ship, voyage, noise, rng)
    shares, deviations = {}, {}
    for label, sensors in WITHHELD.items():
        error, deviation = withheld_errors(sensors, name, ship, voyage, noise, rng)
        known = error.size > 0
        shares[label] = float((np.abs(error) < 2.0 * deviation).mean()) if known else np.nan
        deviations[label] = float(np.median(deviation)) if known else np.nan
    count = int((nis_of(found)[1][_BEGINNING:] > 0).sum())
    return found, Verdict(*numbers, shares, deviations, count)


def _lag(belief: Any) -> float:
    """Correlation of successive innovations, that of the sensor where its magnitude is largest, signed."""
    deviations = np.sqrt(np.einsum("tii->ti", np.asarray(belief.innovation_cov)))
    white = np.where(belief.available, np.asarray(belief.innovation) / deviations, 0.0)[_BEGINNING:]
    correlation = (white[1:] * white[:-1]).sum(0) / np.maximum((white**2).sum(0), 1e-12)
    return float(correlation[np.argmax(np.abs(correlation))])


def withheld_errors(
    sensors: Collection[str], name: str, ship: MeasuredShip, voyage: Voyage, noise: np.ndarray, rng: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the measurements that a filter without these sensors foretells, and their standard deviations.

    Both are ``(n,)``, of all measurements of theirs after the beginning, measurement noise included.

    Raises:
        ValueError: as `estimate`.
    """
    found = estimate(name, ship, voyage, noise, sensors, rng)
    known, columns = inputs(ship, voyage.u, noise), [SENSORS.index(each) for each in sensors]
    used, mean, cov = model(ship, voyage.trial.dt), np.asarray(found.predicted.mean), np.asarray(found.predicted.cov)
    expected, H = used.linearise_measurement(mean, known)[:2]
    error = difference(voyage.y, expected, used.measurement_angles)[:, columns]
    # The covariance of the prediction is at the level of noise already, that of the measurement is not.
    added = sensor_levels(found.level) * np.einsum("...ii->...i", measurement_noise(known))
    deviation = np.sqrt(np.einsum("...ij,...jk,...ik->...i", H, cov, H) + added)[:, columns]
    measured = np.isfinite(error) & (np.arange(len(error)) >= _BEGINNING)[:, None]
    return error[measured], deviation[measured]
