"""Filters on a log: a measured ship with coloured accelerations as the model, noise tuned on the log, and verdicts.

The state of the filters is that of the ship, an acceleration in each degree of freedom that the model does not explain
(a Gauss-Markov process, stronger at more revolutions), and offset and scale error of the rate gyro.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np

from estimators import NonlinearModel, make, run
from estimators.angles import difference
from estimators.metrics import nis
from estimators.models import Gaussian
from estimators.series import Series
from vessel_gym.identification.trial import Trial, pace, trials, without_repeats
from vessel_gym.logs import Log
from vessel_gym.vehicles.manoeuvring import rates
from vessel_gym.vehicles.measured_ship import MeasuredShip

SENSORS = ("x", "y", "heading", "yaw rate")
NOISE = (
    "position", "heading", "yaw rate", "surge", "sway", "yaw", "time constant", "growth", "gyro drift",
)  # fmt: skip
"""Standard deviations of measurements [m, rad, rad/s] and of the unexplained accelerations [m/s2, rad/s2], their time
constant [s], their growth with the square of the revolutions, the drift of the gyro's offset [rad/s in a second]."""
_SHIP, _INPUTS, _SCALE = 6, 6, 0.01
"""States of the ship, known inputs, and the standard deviation of the gyro's scale error."""


@dataclass(frozen=True, eq=False)
class Voyage:
    """A log as filters take it.

    Attributes:
        trial: Its motion and inputs on the grid.
        y: ``(T, 4)`` measurements in the order of `SENSORS`; NaN where none was taken.
        u: ``(T, 6)`` control and air at each time, held over the step that follows.
    """

    trial: Trial
    y: np.ndarray
    u: np.ndarray


def voyages(log: Log, dt: float) -> list[Voyage]:
    """The parts of a log without gaps, sampled at steps of ``dt`` [s].

    Raises:
        LogError: if a channel is missing, or every part is too short.
    """
    found = []
    for trial in trials(log, dt):
        count = len(trial)
        y = np.full((count, len(SENSORS)), np.nan)
        for column, name in enumerate(SENSORS):
            times, values = without_repeats(*log[name].measured(), name)
            index = np.round((times - trial.start) / dt).astype(int)
            near = (index >= 0) & (index < count) & (np.abs(times - trial.start - index * dt) < 0.25 * dt)
            y[index[near], column] = values[near]
        found.append(Voyage(trial, y, np.concatenate([trial.control, trial.air], -1)))
    return found


def model(ship: MeasuredShip, dt: float) -> NonlinearModel:
    """The filter's model at steps of ``dt``; its input ends in the noise (`inputs`)."""
    c, p = tuple(map(float, ship.coefficients)), tuple(map(float, ship.particulars.vector()))
    return _model(c, p, float(dt))


@lru_cache(8)
def _model(c: tuple[float, ...], p: tuple[float, ...], dt: float) -> NonlinearModel:
    moving = partial(_transition, np.array(c), np.array(p), dt)
    noise: Any = partial(_process, dt)
    errors: Any = _errors  # both follow the known input
    return NonlinearModel(
        moving, _measured, noise, errors, state_angles=(2,), measurement_angles=(2,), states=11,
        measurements=4,
    )  # fmt: skip


def inputs(u: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Known inputs ``(..., 6)``, the noise ``(..., 9)`` in the order of `NOISE`, and relative revolutions squared."""
    square = u[..., 1:2] ** 2
    load = square / max(float(square.mean()), 1e-12)
    shape = np.broadcast_shapes(u.shape[:-1], noise.shape[:-1])
    return np.concatenate([np.broadcast_to(a, (*shape, a.shape[-1])) for a in (u, noise, load)], -1)


def _transition(c: np.ndarray, p: np.ndarray, dt: float, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    state, extra, gyro = x[..., :_SHIP], x[..., _SHIP : _SHIP + 3], x[..., _SHIP + 3 :]
    control, air, constant = u[..., :2], u[..., 2:6], u[..., 12:13]
    pushed = np.concatenate([0.0 * extra, extra], -1)
    h = 0.5 * dt
    for _ in range(2):
        middle = state + 0.5 * h * (rates(state, control, air, c, p) + pushed)
        state = state + h * (rates(middle, control, air, c, p) + pushed)
    return np.concatenate([state, np.exp(-dt / constant) * extra, gyro], -1)


def _measured(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
    """Position, heading, and the yaw rate with the gyro's offset and scale error."""
    return np.stack([x[..., 0], x[..., 1], x[..., 2], x[..., 5] * (1.0 + x[..., 10]) + x[..., 9]], -1)


def _process(dt: float, u: np.ndarray) -> np.ndarray:
    """Covariance of the process noise ``(..., 11, 11)``."""
    _, _, _, surge, sway, yaw, constant, growth, drift, load = np.moveaxis(u[..., _INPUTS:], -1, 0)
    changed = (1.0 - np.exp(-2.0 * dt / constant)) * (1.0 + growth * load) ** 2
    none = 0.0 * surge + 1e-12
    variances = (*(none,) * _SHIP, *(changed * each**2 for each in (surge, sway, yaw)), dt * drift**2, none)
    return np.stack(variances, -1)[..., None] * np.eye(_SHIP + 5)


def _errors(u: np.ndarray) -> np.ndarray:
    """Covariance of the measurement noise ``(..., 4, 4)``."""
    position, heading, rate = np.moveaxis(u[..., _INPUTS : _INPUTS + 3], -1, 0)
    return np.stack([position**2, position**2, heading**2, rate**2], -1)[..., None] * np.eye(len(SENSORS))


def prior(first: np.ndarray, noise: np.ndarray) -> Gaussian:
    """About the first measured states ``(..., 6)``, two measurement errors wide, for noise ``(..., 9)``."""
    position, heading, rate, surge, sway, yaw, *_ = np.moveaxis(noise, -1, 0)
    sd = (
        position,
        position,
        heading,
        4.0 * position,
        4.0 * position,
        rate,
        surge,
        sway,
        yaw,
        rate,
        0.0 * rate + _SCALE,
    )
    variances = np.square(np.stack(sd, -1)) * np.array([4.0] * 10 + [1.0])
    mean = np.concatenate([first, np.zeros((*first.shape[:-1], 5))], -1)
    return Gaussian(mean, variances[..., None] * np.eye(_SHIP + 5))


def sampling(found: Sequence[Trial], ship: MeasuredShip) -> float:
    """Time step [s] of filters: 15 of them while the ship sails her length."""
    return float(f"{_pace(found, ship) / 15.0:.1g}")


def _pace(found: Sequence[Trial], ship: MeasuredShip) -> float:
    return pace(ship.particulars, np.concatenate([trial.states[:, 3] for trial in found]))


def start_noise(ship: MeasuredShip, pace: float) -> np.ndarray:
    """Noise ``(9,)`` to begin with, for a ship that sails her length in ``pace`` seconds."""
    length = ship.particulars.length
    pushed = 0.02 * length / pace**2
    return np.array(
        [3e-3 * length, 0.01, 0.02 / pace, pushed, pushed, 0.05 / pace**2, pace, 0.5, 2e-4 / pace**1.5]
    )  # fmt: skip


def tune(ship: MeasuredShip, found: Sequence[Voyage], steps: int = 60) -> np.ndarray:
    """Noise ``(9,)`` with the largest likelihood of an ``ekf`` on windows of voyages, each of ``steps``.

    All changed parameters of a gradient are rows of one run.
    """
    from scipy.optimize import minimize

    steps = min(steps, max(len(each.u) for each in found))
    start = start_noise(ship, _pace([each.trial for each in found], ship))
    parts = [(each, first) for each in found for first in range(0, len(each.u) - steps + 1, steps)]
    y = np.stack([each.y[first : first + steps] for each, first in parts], 1)[:, None]
    u = np.stack([each.u[first : first + steps] for each, first in parts], 1)[:, None]
    first = np.stack([each.trial.states[first] for each, first in parts])
    filter, h, k = make("ekf", model(ship, found[0].trial.dt)), 1e-3, len(start)

    def value(z: np.ndarray) -> tuple[float, np.ndarray]:
        points = z + np.concatenate([np.zeros((1, k)), h * np.eye(k)])
        noise = start * np.exp(points)[:, None]
        rows = np.broadcast_to(y, (steps, k + 1, *y.shape[2:]))
        priors = prior(np.broadcast_to(first, (k + 1, *first.shape)), np.broadcast_to(noise, (k + 1, len(first), k)))
        series = run(filter, priors, rows, inputs(u, noise))
        # Outliers would tell of themselves alone: a measurement counts at most as one that is 5 deviations off.
        costs = -np.maximum(series.log_likelihoods, np.median(series.log_likelihoods[:, :1]) - 12.5).sum((0, 2))
        costs = costs + 0.5 * (points**2 / 9.0).sum(-1)
        return float(costs[0]), (costs[1:] - costs[0]) / h

    found_at = minimize(
        value, np.zeros(k), jac=True, method="L-BFGS-B", bounds=[(-6.0, 6.0)] * k, options={"maxiter": 60}
    )
    return start * np.exp(found_at.x)


def estimate(
    name: str, ship: MeasuredShip, voyage: Voyage, noise: np.ndarray, withheld: Collection[str] = (), rng: int = 0
) -> Series:
    """A filter over a voyage.

    Args:
        name: Of the filter (`estimators.names`).
        ship: The model.
        voyage: The measurements.
        noise: ``(9,)`` in the order of `NOISE`.
        withheld: Sensors that the filter does not get after the first measurement.
        rng: Seed of filters that draw numbers.
    """
    available = np.isfinite(voyage.y)
    available[1:, [SENSORS.index(each) for each in withheld]] = False
    filter = make(name, model(ship, voyage.trial.dt))
    start = prior(voyage.trial.states[0], noise)
    return run(filter, start, voyage.y, inputs(voyage.u, noise), available=available, rng=rng)


@dataclass(frozen=True)
class Verdict:
    """Consistency of a filter on measured data, where there is no truth.

    Attributes:
        inside: Share of NIS within its central 95 % interval.
        ratio: Mean NIS over its degrees of freedom, 1 for a consistent filter.
        lag: Correlation of successive innovations, the largest of the sensors'; 0 for a consistent filter.
        withheld: Share of each sensor's measurements within two standard deviations of what a filter without that
            sensor foretells, measurement noise included; .954 for a consistent filter.
    """

    inside: float
    ratio: float
    lag: float
    withheld: dict[str, float]

    @property
    def trusted(self) -> bool:
        """True if its standard deviations may be believed: near what a consistent filter has."""
        return self.inside >= 0.85 and 0.5 <= self.ratio <= 2.0 and min(self.withheld.values()) >= 0.75


def simulated(ship: MeasuredShip, voyage: Voyage, noise: np.ndarray, rng: int = 0) -> Voyage:
    """A voyage with the same inputs whose motion and measurements are drawn from the filters' own model.

    Measurements that the log lacks are lacking here, too. A filter is as consistent on the log as here if the model
    holds at sea.
    """
    from estimators.consistency import simulate

    drawn = simulate(
        model(ship, voyage.trial.dt), prior(voyage.trial.states[0], noise), np.random.default_rng(rng), runs=2,
        steps=len(voyage.u), u=inputs(voyage.u, noise)[:, None],
    )  # fmt: skip
    states = np.concatenate([drawn.x[:, 0, :_SHIP], drawn.x[-1:, 0, :_SHIP]])
    y = np.where(np.isfinite(voyage.y), drawn.y[:, 0], np.nan)
    return Voyage(replace(voyage.trial, states=states), y, voyage.u)


WITHHELD = {"position": ("x", "y"), "heading": ("heading",), "yaw rate": ("yaw rate",)}
"""Sensors that are left out together."""
_BEGINNING = 5


def nis_of(series: Series) -> tuple[np.ndarray, np.ndarray]:
    """NIS ``(T,)`` and its degrees of freedom ``(T,)``: the measurements that came."""
    belief: Any = series.updated
    count = np.asarray(belief.available).sum(-1)
    return nis(belief.innovation, belief.innovation_cov), count


def consistency(series: Series) -> tuple[float, float, float]:
    """Share of NIS within its central 95 % interval, NIS ratio and lag, as in `Verdict`.

    Raises:
        ValueError: if there are no estimates, or they are lost.
    """
    from scipy.stats import chi2

    belief: Any = series.updated
    square, count = (each[_BEGINNING:] for each in nis_of(series))
    used = count > 0
    if not used.any() or not np.isfinite(square[used]).all():
        raise ValueError("the estimates are lost")
    low, high = chi2.ppf(0.025, count[used]), chi2.ppf(0.975, count[used])
    inside = float(((square[used] > low) & (square[used] < high)).mean())
    deviations = np.sqrt(np.einsum("tii->ti", np.asarray(belief.innovation_cov)))
    white = np.where(belief.available, np.asarray(belief.innovation) / deviations, 0.0)[_BEGINNING:]
    lag = float(np.max((white[1:] * white[:-1]).sum(0) / np.maximum((white**2).sum(0), 1e-12)))
    return inside, float(square[used].sum() / count[used].sum()), lag


def judge(name: str, ship: MeasuredShip, voyage: Voyage, noise: np.ndarray, rng: int = 0) -> tuple[Series, Verdict]:
    """A filter over a voyage, and how consistent it is.

    Raises:
        ValueError: if the filter cannot work with the model, or its estimates are lost.
    """
    series = estimate(name, ship, voyage, noise, rng=rng)
    try:
        found = consistency(series)
    except ValueError:
        raise ValueError(f"{name} loses its estimates on {voyage.trial.name}") from None
    withheld = {
        label: _foretold(estimate(name, ship, voyage, noise, sensors, rng), ship, voyage, noise, sensors)
        for label, sensors in WITHHELD.items()
    }
    return series, Verdict(*found, withheld)


def _foretold(series: Series, ship: MeasuredShip, voyage: Voyage, noise: np.ndarray, sensors: Collection[str]) -> float:
    """Share of withheld measurements within two standard deviations of those that are foretold."""
    used, u = model(ship, voyage.trial.dt), inputs(voyage.u, noise)
    mean, cov = np.asarray(series.predicted.mean), np.asarray(series.predicted.cov)
    foretold, H = used.linearise_measurement(mean, u)[:2]
    error = difference(voyage.y, foretold, used.measurement_angles)
    spread = np.einsum("tij,tjk,tik->ti", H, cov, H) + np.einsum("tii->ti", _errors(u))
    columns = [SENSORS.index(each) for each in sensors]
    error, deviation = error[_BEGINNING:, columns], np.sqrt(spread)[_BEGINNING:, columns]
    measured = np.isfinite(error)
    return float((np.abs(error[measured]) < 2.0 * deviation[measured]).mean()) if measured.any() else np.nan


def noise_of(ship: MeasuredShip) -> np.ndarray:
    """Noise ``(9,)`` of a vessel file.

    Raises:
        ValueError: if the file has none.
    """
    missing = [name for name in NOISE if name not in ship.noise]
    if missing:
        raise ValueError(f"the vessel file's [noise] has no {missing[0]!r}: identify the ship, or tune the noise")
    return np.array([ship.noise[name] for name in NOISE])
