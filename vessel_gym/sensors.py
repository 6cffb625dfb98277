"""Sensors: what each reads, how well and how often, what its readings tell, and whether they arrive.

A sensor is one object, and nothing else knows of it: readings, raw observations, a filter's R, the localisation of
ensembles and what can be had without a filter follow from it. Yours is a `Sensor`: docs/own-sensor.md.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial, reduce
from operator import and_
from typing import Any

import numpy as np

from estimators.checks import shown
from estimators.engine import as_word, compiled
from estimators.engine.arrays import TracedArray
from estimators.factory import unknown
from estimators.threefry import normals, threefry, uniform
from estimators.varying import StateNoise
from vessel_gym.checks import check_names, check_numbers, function, instance, numbers
from vessel_gym.foreign import Call, copying, ours, refuse_not_finite, repeated
from vessel_gym.processes import Process, linear, product
from vessel_gym.sensor_faults import SensorFault

Known = Mapping[str, np.ndarray]
"""States by name, ``(...)`` each, that sensors before have given; what else they found may be there, too."""


@dataclass(frozen=True, eq=False)
class Bias:
    """A slowly moving error of a sensor's first channels, which a filter estimates as states of its own.

    Attributes:
        names: One a channel: what the filter's states are called.
        start: Standard deviations at the start.
        pace: Of the random walk: what a second adds; 0: constant, as far as anybody knows.
        slope: Of a drift [per s], constant and unknown, which has states of its own; 0: none.
        scale: Size that counts as 1 in an observation of standard deviations.
    """

    names: tuple[str, ...]
    start: tuple[float, ...]
    pace: tuple[float, ...] = ()
    slope: tuple[float, ...] = ()
    scale: float = 1.0

    def __post_init__(self) -> None:
        names: Any = self.names
        if not isinstance(names, tuple | list) or not names:  # a text's letters would pass for names
            raise ValueError(f"names of a bias must be a tuple of names, got {shown(names)}")
        check_names("names of a bias", names)
        object.__setattr__(self, "names", tuple(names))
        for name in ("start", "pace", "slope"):
            values = getattr(self, name)
            values = (0.0,) * len(names) if isinstance(values, tuple) and not values else values
            if not isinstance(values, tuple | list) or len(values) != len(names):
                wanted = f"a tuple of {len(names)} values of {name}"
                raise ValueError(f"the bias {self.names} needs {wanted}, got {shown(values)}")
            for value in values:
                check_numbers(f"the bias {self.names}", {name: value}, not_negative=name)
            object.__setattr__(self, name, tuple(map(float, values)))
        check_numbers(self, positive="scale")

    @property
    def states(self) -> tuple[str, ...]:
        """Names of its states: of the biases, then of those drifts that there are."""
        return self.names + (tuple(f"drift of {name}" for name in self.names) if any(self.slope) else ())

    def process(self, dt: float) -> Process:
        """Its process over a step of ``dt`` [s]."""
        slope = self.slope if any(self.slope) else ()
        walk = Process.walk(self.start + slope, self.pace + (0.0,) * len(slope), dt)
        return replace(walk, transition=walk.transition + dt * np.eye(walk.size, k=len(self.names)))


@dataclass(frozen=True, eq=False)
class Sensor:
    """One sensor. Its channels are read, lost and spoilt together.

    Attributes:
        name: What it is.
        channels: What each of its channels reads, with the unit.
        reads: What it would read without noise ``(..., k)``, a function that broadcasts of the vehicle's state
            ``(..., n)`` and forcing ``(..., f)``, see `vessel_gym.system.Vehicle`; faster if it is declared to be
            `vessel_gym.processes.linear` in both.
        sd: Standard deviation of each channel's white noise; or, where it depends on what is measured, a function that
            gives them ``(..., k)`` of the measurement without noise ``(..., k)``: the truth takes it at the true
            measurement, a filter's R at the one that it expects.
        rate: Readings a second [Hz], which must divide the steps a second; None: one every step.
        dropout: Probability that a reading is lost.
        outliers: Probability that it is an outlier,
        outlier_scale: whose noise is so many times as large.
        bias: What moves slowly on the first channels.
        range: For each channel the least and the greatest value that it can read; beyond, nothing arrives.
        angles: Which channels are angles [rad].
        scale: For each channel the size that counts as 1 in a raw observation; None: 1.
        gives: For each channel the state, or the part of the forcing, that it reads as such; None where it is none.
        inverse: What can be had of its readings ``(..., k)`` besides: a function of them and of the states that sensors
            before it have given, that returns states by name; None: what it ``gives``.
        informs: For each channel the states that it may correct in an ensemble; None: those on which its reading
            depends, at once or two steps on.
        latency: Seconds from a measurement to its arrival,
        jitter: and the most that may be added to them: each reading comes later by any whole number of steps up to
            that, so that one may overtake another.
        clock: The most by which its clock may be wrong [s]: its time stamps tell a whole number of steps, drawn in each
            episode, too much or too little; never a time to come.
    """

    name: str
    channels: tuple[str, ...]
    reads: Callable[[np.ndarray, np.ndarray], np.ndarray]
    sd: Any
    rate: float | None = None
    dropout: float = 0.0
    outliers: float = 0.0
    outlier_scale: float = 10.0
    bias: Bias | None = None
    range: tuple[tuple[float, float], ...] | None = None
    angles: tuple[int, ...] = ()
    scale: tuple[float, ...] | None = None
    gives: tuple[str | None, ...] | None = None
    inverse: Callable[[np.ndarray, Known], Known] | None = None
    informs: tuple[tuple[str, ...], ...] | None = None
    latency: float = 0.0
    jitter: float = 0.0
    clock: float = 0.0

    def __post_init__(self) -> None:
        instance("name of a sensor", self.name, str)
        title, channels = self.name, (self.channels,)
        if self.bias is not None:
            instance(f"bias of {title}", self.bias, Bias)
        function(f"inverse of {title}", self.inverse, "(readings, known)")
        tuples: tuple[tuple[str, Any], ...] = ("channels", channels), ("informs", self.informs)
        for name, listed in tuples:
            for entry in listed if isinstance(listed, tuple | list) else ():
                if isinstance(entry, str):  # whose letters would pass for names
                    raise ValueError(f"{name} of {title} must hold tuples of names, got {shown(entry)}")
        check_names(f"channels of {title}", self.channels)
        k = len(self.channels)
        if not k:
            raise ValueError(f"channels of {title} must be one or more names")
        for name in ("sd", "range", "scale", "gives", "informs"):
            values = getattr(self, name)
            if callable(values) if name == "sd" else values is None:
                continue
            several = isinstance(values, tuple | list) or (isinstance(values, np.ndarray) and values.ndim > 0)
            if not (several and len(values) == k):
                raise ValueError(f"{title} has {k} channels, so {name} must have {k} entries, got {shown(values)}")
        for name, kind in (("sd", "not_negative"), ("scale", "positive")):
            values = getattr(self, name)
            for value in () if values is None or callable(values) else values:
                check_numbers(title, {name: value}, **{kind: name})
        for ends in self.range or ():
            pair = numbers(ends)
            if pair is None or pair.shape != (2,) or not pair[0] < pair[1]:
                each = "(least, greatest) for each channel"
                raise ValueError(f"range of {title} must have {each}, got {shown(self.range)}")
        check_numbers(title, vars(self), share="dropout outliers", positive="rate?")
        check_numbers(title, vars(self), not_negative="outlier_scale latency jitter clock")
        if not callable(self.reads):
            raise ValueError(f"reads of {title} must be a function of (state, forcing), got {shown(self.reads)}")
        angles = self.angles if isinstance(self.angles, tuple | list) else (None,)
        if any(not isinstance(i, int | np.integer) or not 0 <= i < k for i in angles):
            raise ValueError(f"angles of {title} must be indices below {k}, got {shown(self.angles)}")
        if self.bias is not None and len(self.bias.names) > k:
            raise ValueError(f"{title} has {k} channels, but a bias on {len(self.bias.names)}")

    @property
    def informed(self) -> tuple[str, ...]:
        """All that its channels inform, if it says so."""
        return tuple(name for names in self.informs or () for name in names)

    def period(self, dt: float) -> int:
        """Steps of ``dt`` [s] from one reading to the next.

        Raises:
            ValueError: if its readings do not fall on steps.
        """
        if self.rate is None:
            return 1
        check_numbers("a sensor's period", {"dt": dt}, positive="dt")
        steps = 1.0 / (self.rate * dt)
        if steps < 0.5 or abs(steps - round(steps)) > 1e-6 * steps:
            raise ValueError(
                f"{self.name} reads at {self.rate:g} Hz, which does not divide the {1.0 / dt:g} steps a second: its "
                "readings would fall between steps"
            )
        return round(steps)

    def delays(self, dt: float) -> tuple[int, int, int]:
        """Latency, jitter and error of the clock in steps of ``dt`` [s].

        Raises:
            ValueError: if they are no whole numbers of steps, or too many together.
        """
        check_numbers("a sensor's delays", {"dt": dt}, positive="dt")
        counts = {name: getattr(self, name) / dt for name in ("latency", "jitter", "clock")}
        for name, steps in counts.items():
            if abs(steps - np.rint(steps)) > 1e-6 * max(steps, 1.0):
                raise ValueError(
                    f"{name} of {self.name} is {getattr(self, name):g} s, which is no whole number of steps of {dt:g} "
                    "s: its readings would arrive between steps"
                )
        if sum(counts.values()) > LONGEST:
            raise ValueError(
                f"latency, jitter and clock of {self.name} are {sum(counts.values()):g} steps together, of {LONGEST} "
                "at most"
            )
        latency, jitter, clock = map(round, counts.values())
        return latency, jitter, clock


LONGEST = 1000
"""How many steps a reading may be late: all that long everything is kept."""


@dataclass(frozen=True)
class SensorSuite:
    """A quality of sensors, relative to a vehicle's nominal ones."""

    noise: float  # standard deviation relative to nominal
    dropout: float = 0.0  # probability that a sensor's reading is lost, besides its own
    outliers: float = 0.0  # probability that it is an outlier
    outlier_scale: float = 10.0  # size of an outlier's noise relative to nominal
    lossless: bool = False  # no sensor loses a reading

    def __post_init__(self) -> None:
        check_numbers(self, not_negative="noise outlier_scale", share="dropout outliers")
        instance("lossless of SensorSuite", self.lossless, bool)

    def of(self, nominal: Sequence[Sensor]) -> tuple[Sensor, ...]:
        """A vehicle's sensors in this quality."""
        if not isinstance(nominal, tuple | list) or not all(isinstance(sensor, Sensor) for sensor in nominal):
            raise TypeError(f"nominal must be Sensor objects, got {shown(nominal)}")
        return tuple(
            replace(
                sensor,
                sd=_scaled(self.noise, sensor.sd),
                dropout=0.0 if self.lossless else min(sensor.dropout + self.dropout, 1.0),
                outliers=min(sensor.outliers + self.outliers, 1.0),
                outlier_scale=sensor.outlier_scale if sensor.outliers else self.outlier_scale,
            )
            for sensor in nominal
        )


def _scaled(factor: float, sd: Any) -> Any:
    if not callable(sd):
        return tuple(factor * each for each in sd)
    return sd if factor == 1.0 else partial(_scaled_at, factor, copying(sd))


def _scaled_at(factor: float, sd: Callable[[np.ndarray], np.ndarray], y: np.ndarray) -> np.ndarray:
    return factor * np.asarray(sd(y))


SUITES = {
    "clean": SensorSuite(noise=0.05, lossless=True),
    "nominal": SensorSuite(noise=1.0),
    "degraded": SensorSuite(noise=1.0, dropout=0.10, outliers=0.05),
}


class Sensors:
    """Several sensors, whose channels stand beside each other.

    Args:
        sensors: In the order of the readings.
        states: Names of the components of the vehicle's state.
        forcing: Of its forcing.
        dt: Time step [s].
        faults: What goes wrong with them, and when.

    Attributes:
        size: p, the number of channels.
        delays: ``(sensors, 3)`` latency, jitter and error of the clock of each, in steps.
        horizon: How many steps late a reading may be, or be said to be.
        bias: How all biases move.
        bias_shown: ``(p, k)`` how their states show in the readings.

    Raises:
        TypeError: for what is no sensor, or no fault of one.
        ValueError: for none, two of a name, a bias that is called as something else, a rate that does not divide the
            steps', a delay of no whole steps, a function ``reads`` or ``sd`` that does not give a value for each
            channel, does not broadcast or does not repeat itself, or the fault of a sensor that there is not, or has
            another number of channels.
    """

    def __init__(
        self,
        sensors: Sequence[Sensor],
        states: tuple[str, ...],
        forcing: tuple[str, ...],
        dt: float,
        faults: Sequence[SensorFault] = (),
    ) -> None:
        self.each = tuple(sensors) if isinstance(sensors, tuple | list) else ()
        if not self.each or not all(isinstance(sensor, Sensor) for sensor in self.each):
            raise TypeError(f"sensors must be Sensor objects, one at least, got {shown(sensors)}")
        names = [sensor.name for sensor in self.each]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"two sensors are called {name!r}: give each a name of its own")
        check_names("states of Sensors", states)
        check_names("forcing of Sensors", forcing)
        check_numbers("Sensors", {"dt": dt}, positive="dt")
        self.state_names, self.forcing_names, self.dt = states, forcing, dt
        sizes = [len(sensor.channels) for sensor in self.each]
        self.owner = np.repeat(np.arange(len(self.each)), sizes)  # which sensor a channel belongs to
        self.size = len(self.owner)
        self._own = [slice(end - size, end) for size, end in zip(sizes, np.cumsum(sizes).tolist(), strict=True)]
        self._sd = np.array([
            sd for sensor, k in zip(self.each, sizes, strict=True)
            for sd in ((np.nan,) * k if callable(sensor.sd) else sensor.sd)
        ], float)  # fmt: skip
        ranges = [r for sensor in self.each for r in (sensor.range or ((-np.inf, np.inf),) * len(sensor.channels))]
        self._ranges = np.array(ranges, float).T
        self._periods = [sensor.period(dt) for sensor in self.each]
        self.delays = np.array([sensor.delays(dt) for sensor in self.each])
        self.horizon = int(self.delays.sum(1).max())
        self.faults = self._checked_faults(faults, names)
        self.angles = tuple(own.start + i for s, own in self._owning for i in s.angles)
        self.scale = np.array([x for s in self.each for x in (s.scale or (1.0,) * len(s.channels))])
        self.channels = tuple(channel for sensor in self.each for channel in sensor.channels)
        biased = [sensor.bias for sensor in self.each if sensor.bias is not None]
        self.bias = Process.joined(*(bias.process(dt) for bias in biased))
        self.bias_names = tuple(name for bias in biased for name in bias.states)
        for name in self.bias_names:
            if name in states or self.bias_names.count(name) > 1:
                raise ValueError(f"a bias is called {name!r}, as another component is: give it a name of its own")
        self.bias_shown = np.zeros((self.size, self.bias.size))
        for sensor, own in self._owning:
            if sensor.bias is not None:
                k, first = len(sensor.bias.names), self.bias_names.index(sensor.bias.names[0])
                self.bias_shown[own.start : own.start + k, first : first + k] = np.eye(k)
        self.bias_scale = np.array([bias.scale for bias in biased for _ in bias.states])
        self._check()
        n, units = len(states), np.eye(len(states) + len(forcing))
        self._gains = np.zeros((self.size, len(units) + self.bias.size))  # of state, forcing and biases
        self._gains[:, len(units) :] = self.bias_shown
        self.called = []  # which channels, and what is asked at every step
        for (sensor, own), reads in zip(self._owning, self._reads, strict=True):
            if getattr(sensor.reads, "linear", False) and not callable(sensor.sd):
                self._gains[own, : len(units)] = reads(units[:, :n], units[:, n:]).T
            else:
                self.called.append((own, compiled(reads) if ours(sensor.reads) else reads))

    def __reduce__(self) -> tuple[Any, ...]:
        return Sensors, (self.each, self.state_names, self.forcing_names, self.dt, self.faults)

    @cached_property
    def _reads(self) -> list[Callable[[np.ndarray, np.ndarray], np.ndarray]]:
        """Functions of state and forcing, one a sensor, that cannot write into what they are handed."""
        return [copying(sensor.reads) for sensor in self.each]

    @property
    def ours(self) -> bool:
        """Are all functions of them part of this package?"""
        return not self._varying and all(ours(sensor.reads) for sensor in self.each)

    @cached_property
    def _varying(self) -> list[tuple[str, slice, Callable[[np.ndarray], np.ndarray]]]:
        """Sensors whose noise depends on what is measured: name, channels, and the function."""
        return [(sensor.name, own, copying(sensor.sd)) for sensor, own in self._owning if callable(sensor.sd)]

    def of_channel(self, channel: Any) -> Sensor:
        """The sensor to which a channel belongs."""
        return self.each[self.owner[channel]]

    @property
    def _owning(self) -> Iterator[tuple[Sensor, slice]]:
        """Sensors and their channels."""
        return zip(self.each, self._own, strict=True)

    def _check(self) -> None:
        state, forcing = (np.zeros((2, 3, len(names))) for names in (self.state_names, self.forcing_names))
        for sensor in self.each:
            expected = (2, 3, len(sensor.channels))
            check_values(f"reads of {sensor.name}", "states", expected, sensor.reads, state, forcing)
            if callable(sensor.sd):
                check_values(f"sd of {sensor.name}", "measurements", expected, sensor.sd, np.ones(expected))
            for name in sensor.gives or ():
                if name is not None and name not in self.state_names + self.forcing_names:
                    raise ValueError(unknown(f"state that {sensor.name} gives", name, self.state_names))

    def _checked_faults(self, faults: Any, names: list[str]) -> tuple[SensorFault, ...]:
        listed = isinstance(faults, list | tuple) and all(isinstance(fault, SensorFault) for fault in faults)
        if not listed:
            raise TypeError(f"sensor_faults must be a list of SensorFault objects, got {shown(faults)}")
        for fault in faults:
            if fault.sensor not in names:
                raise ValueError(unknown("sensor of sensor_faults", fault.sensor, names))
            channels = len(self.each[names.index(fault.sensor)].channels)
            if np.size(fault.size) not in (1, channels):
                raise ValueError(f"{fault.sensor} has {channels} channels, so size of {fault} must be one number or "
                                 f"{channels}, got {shown(fault.size)}")  # fmt: skip
        return tuple(faults)

    def exact(self, state: np.ndarray, forcing: np.ndarray, bias: np.ndarray | None = None) -> np.ndarray:
        """Measurements without noise ``(..., p)``, laid out in memory as the state is.

        Args:
            state: ``(..., n)`` of the vehicle.
            forcing: ``(..., f)`` on it.
            bias: ``(..., k)`` states of the biases; None: they have none.
        """
        exact = np.concatenate([reads(state, forcing) for reads in self._reads], -1)
        return exact if bias is None else product(self.bias_shown, bias, exact)

    def read(
        self, state: np.ndarray, forcing: np.ndarray, bias: np.ndarray, steps: np.ndarray, keys: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Noisy readings and the mask of those that arrived.

        Args:
            state: ``(B, n)`` of the vehicle.
            forcing: ``(B, f)`` on it.
            bias: ``(B, k)`` states of the biases.
            steps: ``(B,)`` steps since the episode's start, at which every sensor reads.
            keys: ``(B, sensors, 2)`` of the random numbers of each.

        Returns:
            Readings ``(B, p)``, 0 where missing, and the mask ``(B, p)``.
        """
        exact = self.measured(state, forcing, bias)
        sd = self.sd_at(exact)
        if self._varying and not isinstance(state, TracedArray):
            self._refuse_sd(sd, exact, steps)
        return self.corrupted(exact, sd, steps, keys)

    def sound(self, state: np.ndarray, forcing: np.ndarray, bias: np.ndarray) -> Any:
        """Are all standard deviations 0 or more, of true measurements within their ranges? ``(...)``."""
        if not self._varying:
            return np.ones(state.shape[:-1], bool)
        exact = self.measured(state, forcing, bias)
        beyond = (exact < self._ranges[0]) | (self._ranges[1] < exact)
        return ((self.sd_at(exact) >= 0.0) | beyond).all(-1)

    def users(self, state: np.ndarray, forcing: np.ndarray, bias: np.ndarray) -> Iterator[Call]:
        """Users' functions that `read` calls."""
        for own, _ in self.called:
            reads = self.each[self.owner[own.start]].reads
            if not ours(reads):
                yield reads, (state, forcing), [(own.stop - own.start,)]
        for _, own, spread in self._varying:
            yield spread, (self.measured(state, forcing, bias)[..., own],), [(own.stop - own.start,)]

    def measured(self, state: np.ndarray, forcing: np.ndarray, bias: np.ndarray) -> np.ndarray:
        """True measurements without noise ``(..., p)``: as `exact`, what is linear by its matrix."""
        called = {own.start: reads for own, reads in self.called}
        zeros = np.zeros((*state.shape[:-1], self.size))
        parts = [called[own.start](state, forcing) if own.start in called else zeros[..., own] for own in self._own]
        return product(self._gains, np.concatenate([state, forcing, bias], -1), np.concatenate(parts, -1))

    @compiled(axes=(1, 1, 0, 2))
    def corrupted(
        self, exact: np.ndarray, sd: np.ndarray, steps: np.ndarray, keys: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Measurements with their noise and outliers, 0 where missing, and the mask of those available.

        Args:
            exact: ``(..., p)`` without noise.
            sd: ``(..., p)`` standard deviations.
            steps: ``(...)`` since the episode's start.
            keys: ``(..., sensors, 2)`` of the random numbers of each.
        """
        values, available, word = [], [], as_word(steps)
        for i, (sensor, own) in enumerate(self._owning):
            key, channels = keys[..., i, :], range(own.start, own.stop)
            size: np.ndarray | float = 1.0
            bounds = [(*self._ranges[:, j], exact[..., j]) for j in channels]
            arrives = reduce(and_, [(least <= y) & (y <= greatest) for least, greatest, y in bounds])
            if self._periods[i] > 1:
                periods = steps / self._periods[i]
                arrives = arrives & (periods == np.floor(periods))
            if sensor.dropout > 0.0 or sensor.outliers > 0.0:
                lost, far = threefry(np.uint64(0), (word << 16) | 1, key[..., 0], key[..., 1])
                arrives = arrives & (uniform(lost) >= sensor.dropout)
                size = np.where(uniform(far) < sensor.outliers, sensor.outlier_scale, 1.0)
            for j, normal in zip(channels, normals(key, word, len(channels)), strict=True):
                value = exact[..., j] + sd[..., j] * size * normal
                available.append(arrives & np.isfinite(value))
                values.append(np.where(available[-1], value, 0.0))
        return np.stack(values, -1), np.stack(available, -1)

    def _refuse_sd(self, sd: np.ndarray, exact: np.ndarray, steps: np.ndarray) -> None:
        """Refuse standard deviations ``(B, p)`` of measurements ``(B, p)``.

        Raises:
            ValueError: for one that is negative or NaN, of a measurement within its sensor's range.
        """
        within = ((self._ranges[0] <= exact) & (exact <= self._ranges[1])).T
        for name, own, _ in self._varying:
            refuse_not_finite(
                f"sd of {name}", sd[:, own], steps, ~within[own].all(0), exact[:, own],
                sound=partial(np.less_equal, 0.0), wanted="0 or more for every measurement",
            )  # fmt: skip

    def sd_at(self, exact: np.ndarray) -> np.ndarray:
        """Standard deviations ``(..., p)`` of measurements that are ``exact (..., p)`` without noise."""
        known = np.broadcast_to(self.sd, exact.shape)
        if not self._varying:
            return known
        varying = {own.start: spread for _, own, spread in self._varying}
        parts = ((varying.get(own.start), own) for own in self._own)
        return np.concatenate([spread(exact[..., own]) if spread else known[..., own] for spread, own in parts], -1)

    @property
    def sd(self) -> np.ndarray:
        """Standard deviations ``(p,)``; NaN where they depend on what is measured."""
        return self._sd

    def noise(
        self, expected: Callable[[np.ndarray, np.ndarray | None], np.ndarray], x: np.ndarray, u: np.ndarray | None
    ) -> np.ndarray | StateNoise:
        """R of a filter, which follows what it expects if a deviation does.

        Args:
            expected: The expected measurements ``(..., p)``, a function of a filter's states and known inputs.
            x: A state ``(n,)`` for where none is at hand,
            u: and a known input.

        Raises:
            ValueError: for a deviation that is negative or NaN there.
        """
        if not self._varying:
            return np.diag(self.sd**2)
        y = expected(x, u)
        sd = self.sd_at(y)
        for name, own, _ in self._varying:
            if not (sd[own] >= 0.0).all():
                got = f"{shown(sd[own].tolist())} for the measurement {shown(y[own].tolist())}"
                raise ValueError(f"sd of {name} gave {got}: it must give 0 or more for every measurement")
        return StateNoise(partial(_noise_at, self, expected), np.nan_to_num(np.diag(sd**2)))

    # --- what readings tell -----------------------------------------------------------------------

    @cached_property
    def gives(self) -> tuple[str | None, ...]:
        """For each channel the state, or the part of the forcing, that it reads as such."""
        return tuple(name for s in self.each for name in (s.gives or (None,) * len(s.channels)))

    def states_from(self, readings: np.ndarray) -> dict[str, np.ndarray]:
        """States, and parts of the forcing, that are to be had from readings ``(..., p)`` alone, ``(...)`` by name."""
        known: dict[str, np.ndarray] = {}
        for sensor, own in self._owning:
            known.update((name, readings[..., i]) for i, name in enumerate(sensor.gives or (), own.start) if name)
            if sensor.inverse is not None:
                known.update(copying(sensor.inverse)(readings[..., own], known))
        return known

    def check_informs(self, others: Iterable[str]) -> None:
        """Refuse a sensor that informs what there is not.

        Args:
            others: What may be named besides the vehicle's state and the biases.

        Raises:
            ValueError: naming the nearest.
        """
        known = dict.fromkeys((*self.state_names, *self.bias_names, *others))
        for sensor in self.each:
            for name in sensor.informed:
                if name not in known:
                    raise ValueError(unknown(f"state that {sensor.name} informs", name, known))

    def informed(self, names: tuple[str, ...], depends: Callable[[], np.ndarray]) -> np.ndarray:
        """Mask ``(n, p)`` of the states of an ensemble that each measurement may correct.

        Args:
            names: The filter's states.
            depends: Gives the mask ``(n, p)`` of the states on which a reading depends.

        Raises:
            ValueError: if a sensor informs none of them.
        """
        mask = np.zeros((len(names), self.size))
        for sensor, own in self._owning:
            if sensor.informs is None:
                mask[:, own] = depends()[:, own]
                continue
            mask[:, own] = [[float(name in informed) for informed in sensor.informs] for name in names]
            if not mask[:, own].any():
                raise ValueError(
                    f"{sensor.name} informs nothing that this filter estimates: name some of {', '.join(names)}"
                )
        named = {name for sensor in self.each for name in sensor.informed}
        unnamed = [i for i, name in enumerate(names) if name not in named and not mask[i].any()]
        if unnamed:  # what somebody has added, and no sensor has heard of, would never be corrected
            mask[unnamed] = depends()[unnamed]
        return mask


def check_values(
    who: str, what: str, expected: tuple[int, ...], function: Callable[..., Any], *arguments: np.ndarray
) -> Any:
    """Value of a user's function, which is called twice.

    Raises:
        ValueError: for one that fails, does not repeat itself, or gives no numbers or another shape than ``expected``.
    """
    shape = arguments[0].shape
    try:
        values = repeated(who, function, *arguments)
        got = np.asarray(values).shape
    except Exception as error:
        if str(error).startswith(who):
            raise
        raise ValueError(f"{who} failed on {what} of shape {shape}: {shown(str(error))}") from error
    if numbers(values) is None:
        raise ValueError(f"{who} must give real numbers, got {shown(values)}")
    if got != expected:
        each = f"{expected[-1]} values for each {what.removesuffix('s')}"
        raise ValueError(f"{who} must give {each}: {shape} gave {got}, expected {expected}")
    return values


def _noise_at(
    sensors: Sensors, expected: Callable[[np.ndarray, np.ndarray | None], np.ndarray], x: np.ndarray,
    u: np.ndarray | None,
) -> np.ndarray:  # fmt: skip
    variance = sensors.sd_at(expected(x, u)) ** 2
    return variance[..., None] * np.eye(sensors.size)


def columns(indices: Sequence[int]) -> Any:
    """Indices of components: a slice where they are neighbours, which gives a view."""
    chosen = list(indices)
    if chosen and chosen == list(range(chosen[0], chosen[-1] + 1)):
        return slice(chosen[0], chosen[-1] + 1)
    return chosen


def plain(components: Sequence[int]) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Function ``reads`` of a sensor that reads components of the state as they are."""
    return linear(partial(_columns, columns(components)))


def _columns(chosen: Any, state: np.ndarray, forcing: np.ndarray) -> np.ndarray:
    return state[..., chosen]
