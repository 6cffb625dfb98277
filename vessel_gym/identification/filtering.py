"""Filters on a log: a measured ship with coloured accelerations as the model, and a gate for measurements.

The state of the filters is that of the ship, and what explains errors that last (each a Gauss-Markov process, but for
the gyro's scale error): an acceleration in each degree of freedom that the model does not have, offset and scale error
of the rate gyro, the age of position and heading, the error of the heading, and a drift of the water.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np

from estimators import NonlinearModel, make
from estimators.belief import Belief, over_time
from estimators.metrics import nis
from estimators.models import Gaussian
from estimators.randomness import RandomKeys, key
from vessel_gym.identification.trial import Trial, pace, trials, without_repeats
from vessel_gym.logs import Log
from vessel_gym.vehicles.manoeuvring import rates
from vessel_gym.vehicles.measured_ship import MeasuredShip

SENSORS = ("x", "y", "heading", "yaw rate")
WITHHELD = {"position": ("x", "y"), "heading": ("heading",), "yaw rate": ("yaw rate",)}
"""Sensors that are left out together, and pass the gate together."""
NOISE = (
    "position", "heading", "yaw rate", "surge", "sway", "yaw", "time constant", "growth", "manoeuvre", "gyro drift",
    "gyro scale", "age", "heading drift", "current", *(f"{sensor} outage" for sensor in WITHHELD),
)  # fmt: skip
"""Standard deviations of measurements [m, rad, rad/s] and of the unexplained accelerations [m/s2, rad/s2], their time
constant [s], their growth with the square of the revolutions and with changes of propeller and rudder forces, the drift
of the gyro's offset [rad/s in a second] and its scale error, the age of position and heading [s], the slow error of the
heading [rad], the drift of the water [m/s], and factors of the standard deviations in an outage of each sensor."""
_SHIP, _INPUTS, _SMOOTHED = 6, 6, 5
"""States of the ship, known inputs, and steps over which the positions are smoothed that a voyage starts from."""
_SCALE, _AGE, _HEADING, _CURRENT, STATES = 10, 11, 12, 13, 15
ENSEMBLES, _MEMBERS = ("enkf", "etkf", "enkf-sr"), 1000
"""Filters with members, and how many of them."""
_LASTING = {"gyro scale": 100.0, "age": 0.5, "heading drift": 40.0, "current": 100.0}
"""Time constants [s]."""
GATE, _REJECTED = 1e-7, 2
"""Probability that the gate rejects a sensor of a consistent filter, and measurements that it rejects in succession:
the next one is taken, so that a ship that did move is found again."""
_OUTAGE, _SPARSE = 15.0, 5.0
"""Steps of an outage after which most of its factor applies, and steps without a measurement that are none."""
_FACTORS, LARGEST = slice(_INPUTS + NOISE.index("position outage"), _INPUTS + len(NOISE)), 10.0
"""Place of the factors in an input, and the largest of them."""
_FOUND = {"position": ((0, 1), (3, 4)), "heading": ((2,), (5,)), "yaw rate": ((9,), (5,))}
"""States that are found again as the sensor shows them, and those of the ship that may be why they were lost: speeds,
or the yaw rate. A gyro shows its offset."""
_FROUDE, _TURNED = 0.2, 0.3
"""Standard deviations of an unknown speed, over the root of gravity times length, and of an unknown heading [rad], at
which sigma points stay within half a turn."""
MEMORY, _ASSUMED, _LEAST = 6.0, 10.0, 0.01
"""Steps over which levels of noise are averaged, degrees of freedom that the level 1 counts as, and the least level.

Tuning changes a standard deviation by a factor of 4.5 at most (`tuning`). Innovations below a tenth of the assumed
ones are those of a simulation without noise or of a sensor that repeats itself, and do not foretell the next manoeuvre.
"""
_LEVELLED = np.array([0, 0, 1, 0, 0, 2, 0, 0, 2, 2, 2, -1, 1, 0, 0])
"""Sensor, in the order of `WITHHELD`, that says most of each state: its level is that of the state's variance."""


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

    def part(self, first: int, last: int) -> "Voyage":
        """Steps ``first`` to ``last``."""
        return Voyage(self.trial.part(first, last), self.y[first:last], self.u[first:last])


def voyages(log: Log, dt: float) -> list[Voyage]:
    """The parts of a log without gaps, sampled at steps of ``dt`` [s].

    Raises:
        LogError: if a channel is missing, or every part is too short.
    """
    found = []
    for trial in trials(log, dt, _SMOOTHED):
        count = len(trial)
        y = np.full((count, len(SENSORS)), np.nan)
        for column, name in enumerate(SENSORS):
            times, values = without_repeats(*log[name].measured(), name)
            index = np.round((times - trial.start) / dt).astype(int)
            off = np.abs(times - trial.start - index * dt)
            nearest = np.argsort(-off, kind="stable")  # the nearest to a step is assigned last
            near = nearest[((index >= 0) & (index < count) & (off < 0.25 * dt))[nearest]]
            y[index[near], column] = values[near]
        found.append(Voyage(trial, y, np.concatenate([trial.control, trial.air], -1)))
    return found


def model(ship: MeasuredShip, dt: float) -> NonlinearModel:
    """The filter's model at steps of ``dt``; its input ends in the noise (`inputs`)."""
    return _model(tuple(map(float, ship.coefficients)), tuple(map(float, ship.particulars.vector())), float(dt))


@lru_cache(8)
def _model(c: tuple[float, ...], p: tuple[float, ...], dt: float) -> NonlinearModel:
    moving = partial(_transition, np.array(c), np.array(p), dt)
    noise: Any = partial(_process, dt)
    errors: Any = measurement_noise  # both follow the known input
    return NonlinearModel(
        moving, _measured, noise, errors, state_angles=(2,), measurement_angles=(2,), states=STATES,
        measurements=len(SENSORS),
    )  # fmt: skip


@lru_cache(32)
def _filter(name: str, used: NonlinearModel) -> Any:
    """A filter, which keeps its programs for the next voyage.

    Members correlate every state with the p measurements by chance, so that an update shrinks the variance of what is
    not measured by ``p / (N - 1)`` (Sacher & Bartello 2008, Monthly Weather Review 136). The inflation restores it:
    otherwise the uncertainty of a withheld position vanishes in some minutes.
    """
    if name not in ENSEMBLES:
        return make(name, used)
    inflation = float(np.sqrt(1.0 + len(SENSORS) / (_MEMBERS - 1)))
    return make(name, used, members=_MEMBERS, inflation=inflation, draws="independent")


def inputs(ship: MeasuredShip, u: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Known inputs ``(T, ..., 6)``, the noise ``(..., K)`` in the order of `NOISE`, and what accelerations grow with.

    That is the square of the revolutions relative to those of service, and the change of propeller and rudder forces,
    in proportion to it, over two steps: the rudder follows its order late, and the flow about the hull both.
    """
    square = u[..., 1] * np.abs(u[..., 1]) / ship.revolutions**2 if ship.revolutions else 0.0 * u[..., 1]
    forces = np.stack([square, square * u[..., 0]])
    before = np.concatenate([forces[:, :1], forces[:, :1], forces[:, :-1]], 1)
    changed = np.abs(forces - before[:, 1:]) + np.abs(before[:, 1:] - before[:, :-1])
    load = np.stack([np.abs(square), changed.sum(0)], -1)
    shape = np.broadcast_shapes(u.shape[:-1], noise.shape[:-1])
    return np.concatenate([np.broadcast_to(a, (*shape, a.shape[-1])) for a in (u, noise, load)], -1)


def _transition(c: np.ndarray, p: np.ndarray, dt: float, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    state, extra, current = x[..., :_SHIP], x[..., _SHIP : _SHIP + 3], x[..., _CURRENT:]
    control, air, constant = u[..., :2], u[..., 2:6], u[..., 12:13]
    pushed = np.concatenate([current, 0.0 * extra[..., :1], extra], -1)
    h = 0.5 * dt
    for _ in range(2):
        middle = state + 0.5 * h * (rates(state, control, air, c, p) + pushed)
        state = state + h * (rates(middle, control, air, c, p) + pushed)
    kept = np.exp(-dt / np.array([*_LASTING.values(), _LASTING["current"]]))
    return np.concatenate(
        [state, np.exp(-dt / constant) * extra, x[..., _SCALE - 1 : _SCALE], kept * x[..., _SCALE:]], -1
    )


def _measured(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
    """Position and heading of some time ago, and the yaw rate with the gyro's offset and scale error."""
    psi, surge, sway, rate, age = x[..., 2], x[..., 3], x[..., 4], x[..., 5], x[..., _AGE]
    north, east = surge * np.cos(psi) - sway * np.sin(psi), surge * np.sin(psi) + sway * np.cos(psi)
    return np.stack(
        [
            x[..., 0] - age * north,
            x[..., 1] - age * east,
            psi - age * rate + x[..., _HEADING],
            rate * (1.0 + x[..., _SCALE]) + x[..., _SCALE - 1],
        ],
        -1,
    )


def _process(dt: float, u: np.ndarray) -> np.ndarray:
    """Covariance of the process noise ``(..., 15, 15)``; accelerations act over half of the step of their change."""
    noise = dict(zip((*NOISE, "load", "changed"), np.moveaxis(u[..., _INPUTS:], -1, 0), strict=True))
    grown = 1.0 + noise["growth"] * noise["load"] + noise["manoeuvre"] * noise["changed"]
    renewed = {name: 1.0 - np.exp(-2.0 * dt / each) for name, each in _LASTING.items()}
    accelerations = (1.0 - np.exp(-2.0 * dt / noise["time constant"])) * grown**2
    none = 0.0 * grown + 1e-12
    variances = [none] * _SHIP + [accelerations * noise[name] ** 2 for name in ("surge", "sway", "yaw")]
    variances += [dt * noise["gyro drift"] ** 2]
    variances += [renewed[name] * noise[name] ** 2 for name in (*_LASTING, "current")]
    acting = np.eye(STATES) + 0.5 * dt * np.eye(STATES, k=3) * (np.arange(STATES) // 3 == 1)[:, None]
    return acting @ (np.stack(variances, -1)[..., None] * np.eye(STATES)) @ acting.T


def measurement_noise(u: np.ndarray) -> np.ndarray:
    """Covariance of the measurement noise ``(..., 4, 4)`` at known inputs of `inputs`."""
    position, heading, rate = np.moveaxis(u[..., _INPUTS : _INPUTS + 3], -1, 0)
    return np.stack([position**2, position**2, heading**2, rate**2], -1)[..., None] * np.eye(len(SENSORS))


def prior(first: np.ndarray, noise: np.ndarray) -> Gaussian:
    """About the first measured states ``(..., 6)``, two standard deviations wide, for noise ``(..., K)``."""
    sd = dict(zip(NOISE, np.moveaxis(noise, -1, 0), strict=True))
    position, heading, rate = sd["position"], np.hypot(sd["heading"], sd["heading drift"]), sd["yaw rate"]
    speed = 4.0 * position + sd["current"]
    wide = (position, position, heading, speed, speed, rate, sd["surge"], sd["sway"], sd["yaw"], rate)
    stationary = (sd["gyro scale"], sd["age"], sd["heading drift"], sd["current"], sd["current"])
    variances = np.square(np.stack([*(2.0 * each for each in wide), *stationary], -1))
    mean = np.concatenate([first, np.zeros((*first.shape[:-1], STATES - _SHIP))], -1)
    return Gaussian(mean, variances[..., None] * np.eye(STATES))


def sampling(found: Sequence[Trial], ship: MeasuredShip) -> float:
    """Time step [s] of filters: 15 of them while the ship sails her length."""
    return float(f"{mean_pace(found, ship) / 15.0:.1g}")


def mean_pace(found: Sequence[Trial], ship: MeasuredShip) -> float:
    """Time [s] in which the ship sails her length in these trials."""
    return pace(ship.particulars, np.concatenate([trial.states[:, 3] for trial in found]))


def start_noise(ship: MeasuredShip, pace: float) -> np.ndarray:
    """Noise ``(K,)`` to begin with, for a ship that sails her length in ``pace`` seconds."""
    length = ship.particulars.length
    pushed = 0.03 * length / pace**2
    return np.array([
        2e-3 * length, 2e-3, 2e-3 / pace, pushed, pushed, 0.12 / pace**2, 0.1 * pace, 0.3, 5.0, 2e-3 / pace**1.5,
        0.03, 0.03, 0.02, 0.05 * length / pace, *np.ones(len(WITHHELD)),
    ])  # fmt: skip


def noise_of(ship: MeasuredShip) -> np.ndarray:
    """Noise ``(K,)`` of a vessel file.

    Raises:
        ValueError: if the file has none, or a factor below 1 or above `LARGEST`.
    """
    missing = [name for name in NOISE if name not in ship.noise]
    if missing:
        raise ValueError(f"the vessel file's [noise] has no {missing[0]!r}: identify the ship, or tune the noise")
    noise = np.array([ship.noise[name] for name in NOISE])
    for name, factor in zip(WITHHELD, noise[-len(WITHHELD) :], strict=True):
        if not 1.0 <= factor <= LARGEST:
            raise ValueError(f"the vessel file's '{name} outage' must be from 1 to {LARGEST:g}, got {factor:g}")
    return noise


@dataclass(frozen=True, eq=False)
class Step:
    """A time step of a filter behind a gate; covariances are at the levels of noise that were found so far.

    Attributes:
        predicted: The belief before the measurement.
        tried: That after all of the measurement, whose innovation the gate has seen.
        updated: That after what the gate let through.
        rejected: ``(4,)`` mask of the sensors that it did not.
        level: ``(3,)`` factors of variances before the measurement, in the order of `WITHHELD`.
    """

    predicted: Belief
    tried: Belief
    updated: Belief
    rejected: np.ndarray
    level: np.ndarray


class Gated:
    """A filter that finds the level of each sensor's noise, behind a gate.

    A level is the mean of the squared innovation over what the filter expects of it, old ones forgotten (Mehra 1970,
    IEEE Transactions on Automatic Control 15; West & Harrison 1997, Bayesian Forecasting and Dynamic Models, sec.
    10.8). Gains stay those of the assumed noise. At these levels the square of a consistent filter has an F
    distribution (`degrees_of_freedom`). A measurement is rejected if its square is one of the largest `GATE`
    (Bar-Shalom, Li & Kirubarajan 2001, sec. 5.7). Squares below that limit have a smaller mean, which the levels allow
    for.

    After some rejections in succession the next measurement is taken. The prediction's error in the states that the
    sensor shows is then as large as the innovation, and independent of all other errors. Speeds or the yaw rate are as
    uncertain as would explain the innovation, up to those of ships. So a jump of the position leaves the heading as it
    is. The level counts its square as the largest that passes, so that noise that did grow is found, too.
    """

    def __init__(self, name: str, ship: MeasuredShip, dt: float, rng: int = 0) -> None:
        from scipy.stats import chi2, f

        self._filter = _filter(name, model(ship, dt))
        self._dt, self._length = dt, ship.length
        self._limits = {n: float(n * f.isf(GATE, n, degrees_of_freedom(n))) for n in (1, 2)}
        self._means = {n: n * float(chi2.cdf(far, n + 2) / chi2.cdf(far, n)) for n, far in self._limits.items()}
        self._misses, self._missing = dict.fromkeys(WITHHELD, 0), np.zeros(len(WITHHELD))
        self._level, self._weight = np.ones(len(WITHHELD)), np.full(len(WITHHELD), _ASSUMED)
        self._keys, self._count = RandomKeys(key(rng)), 0
        self._last: tuple[Any, np.ndarray] | None = None

    def step(self, start: Gaussian, y: np.ndarray, known: np.ndarray, available: np.ndarray | None = None) -> Step:
        """The next step.

        Args:
            start: Belief before the first measurement; not used later.
            y: ``(4,)`` measurements.
            known: Input of `inputs` at this time.
            available: ``(4,)`` mask of measurements that the filter gets; None: all that are finite.
        """
        keys, last, level = self._keys.at(self._count), self._last, self._levels(known)
        if last is None:
            predicted = self._filter.init(start, rng=keys)
        else:
            predicted = self._filter.predict(last[0], last[1], rng=keys)
        updated = tried = self._filter.update(predicted, y, rng=keys, available=available, u=known)
        rejected, lost = self._gate(tried, level)
        if lost or rejected.any():
            passed = ~rejected if available is None else available & ~rejected
            unsure = self._filter.init(self._unsure(predicted, lost), rng=keys) if lost else predicted
            updated = self._filter.update(unsure, y, rng=keys, available=passed, u=known)
        self._count, self._last = self._count + 1, (updated, known)
        beliefs = _at_level(predicted, level), _at_level(tried, level), _at_level(updated, level, self._levels(known))
        return Step(*beliefs, rejected, level)

    def _levels(self, known: np.ndarray) -> np.ndarray:
        """Levels ``(3,)`` of the covariances; those of sensors that are missing grow to the square of their factor."""
        grown = 1.0 - np.exp(-np.maximum(0.0, self._missing - _SPARSE) / _OUTAGE)
        return self._level * (1.0 + (known[_FACTORS] - 1.0) * grown) ** 2

    def _gate(self, belief: Any, levels: np.ndarray) -> tuple[np.ndarray, dict[str, float]]:
        """Sensors that the gate rejects ``(4,)``, and squared innovations of those taken after rejections.

        Levels learn from the others.
        """
        rejected, came, lost = np.zeros(len(SENSORS), bool), np.asarray(belief.available), {}
        for i, (label, sensors) in enumerate(WITHHELD.items()):
            columns = [column for column in map(SENSORS.index, sensors) if came[column]]
            if not columns:  # its level approaches the mean of the others'
                others = np.delete(self._level, i)
                self._level[i] += (np.average(others, weights=np.delete(self._weight, i)) - self._level[i]) / MEMORY
                self._missing[i] += 1.0
                continue
            n, level = len(columns), levels[i]
            square = float(nis(belief.innovation[columns], belief.innovation_cov[np.ix_(columns, columns)])) / level
            far = square > self._limits[n]
            if far and self._misses[label] < _REJECTED:
                self._misses[label], rejected[columns] = self._misses[label] + 1, True
                self._missing[i] += 1.0
                continue
            self._missing[i] = 0.0
            if far:
                lost[label] = float(np.square(belief.innovation[columns]).sum()) / level
            else:
                self._misses[label] = 0
            if np.isfinite(square):
                kept = (1.0 - 1.0 / MEMORY) * self._weight[i]
                share = min(square, self._limits[n]) / self._means[n]
                self._level[i] = max(_LEAST, self._level[i] * (kept + n * share) / (kept + n))
                self._weight[i] = kept + n
        return rejected, lost

    def _unsure(self, predicted: Any, lost: dict[str, float]) -> Gaussian:
        """The prediction with larger variances of what some sensors show, by their squared innovations."""
        cov, speed = np.array(predicted.cov), unknown_speed(self._length)
        for label, square in lost.items():
            states, slopes = (list(each) for each in _FOUND[label])
            span = 1.0 if label == "yaw rate" else (1 + self._misses[label]) * self._dt
            slope = min(square / span**2, speed if label == "position" else speed / self._length**2)
            own = np.diag(cov)[states] + (min(square, _TURNED**2) if label == "heading" else square)
            cov[states], cov[:, states] = 0.0, 0.0
            cov[states, states] = own
            cov[slopes, slopes] += slope
            if label == "heading":  # the velocity over the ground stays, and turns in the ship's frame
                cov[[3, 4], [3, 4]] += min(square, 4.0) * float(np.square(predicted.mean[[3, 4]]).sum())
            self._misses[label] = 0
        return Gaussian(np.array(predicted.mean), cov)


def unknown_speed(length: float) -> float:
    """Variance [m2/s2] of a speed of which nothing is known but that a ship of this length [m] can have it."""
    return _FROUDE**2 * 9.81 * length


def degrees_of_freedom(count: int) -> float:
    """Degrees of freedom of the level of ``count`` values a step, a weighted mean (Satterthwaite 1946, Biometrics)."""
    return count * (2.0 * MEMORY - 1.0)


def sensor_levels(level: np.ndarray) -> np.ndarray:
    """Factors ``(..., 4)`` of the variance of each measurement, of those of ``level (..., 3)``."""
    return np.repeat(level, [len(sensors) for sensors in WITHHELD.values()], -1)


def _at_level(belief: Belief, level: np.ndarray, after: np.ndarray | None = None) -> Belief:
    """A belief whose covariances, that of the innovation first, are at other levels of noise."""
    states = np.sqrt(np.append(level if after is None else after, 1.0)[_LEVELLED])
    changes = {"cov": states[:, None] * belief.cov * states}
    if belief.innovation_cov is not None:
        channels = np.where(np.asarray(belief.available), np.sqrt(sensor_levels(level)), 1.0)
        changes["innovation_cov"] = channels[:, None] * belief.innovation_cov * channels
    return Belief.replace(belief, **changes)


@dataclass(frozen=True, eq=False)
class Estimates(Step):
    """A filter over a voyage: times lead every array of `Step`."""

    @property
    def mean(self) -> np.ndarray:
        """``(T, 15)`` estimates."""
        return self.updated.mean

    @property
    def cov(self) -> np.ndarray:
        """``(T, 15, 15)`` their covariances."""
        return self.updated.cov


def estimate(
    name: str, ship: MeasuredShip, voyage: Voyage, noise: np.ndarray, withheld: Collection[str] = (), rng: int = 0
) -> Estimates:
    """A filter over a voyage.

    Args:
        name: Of the filter (`estimators.names`).
        ship: The model.
        voyage: The measurements, ``(T, 4)``.
        noise: ``(K,)`` in the order of `NOISE`.
        withheld: Sensors that the filter does not get after the first measurement.
        rng: Seed of filters that draw numbers.

    Returns:
        Beliefs with T rows, ``rejected`` ``(T, 4)`` and ``level`` ``(T, 3)``.

    Raises:
        ValueError: if no filter has this name, it cannot work with the model, or a withheld sensor is not in `SENSORS`.
    """
    available = np.isfinite(voyage.y)
    available[1:, [SENSORS.index(each) for each in withheld]] = False
    gated, known = Gated(name, ship, voyage.trial.dt, rng), inputs(ship, voyage.u, noise)
    start = prior(voyage.trial.states[0], noise)
    found = [gated.step(start, y, known[k], available[k]) for k, y in enumerate(voyage.y)]
    beliefs = (over_time([getattr(each, part) for each in found]) for part in ("predicted", "tried", "updated"))
    arrays = (np.stack([getattr(each, part) for each in found]) for part in ("rejected", "level"))
    return Estimates(*beliefs, *arrays)
