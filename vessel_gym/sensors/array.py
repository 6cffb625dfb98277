"""Several sensors, whose channels form one vector of measurements."""

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property, partial, reduce
from operator import and_
from typing import Any

import numpy as np

from estimators.checks import short_repr
from estimators.engine import as_word, compiled
from estimators.factory import unknown
from estimators.randomness import normals, threefry, uniform
from estimators.varying import StateNoise
from vessel_gym.checks import all_are, check_names, check_numbers, is_compiled
from vessel_gym.processes import Process, product
from vessel_gym.sensor_faults import SensorFault
from vessel_gym.sensors.sensor import Sensor


class Sensors:
    """Several sensors, whose channels form one vector of measurements.

    Args:
        sensors: Sensors in the order of the measurements.
        states: Names of the components of the vehicle's state.
        exogenous: Names of the components of the vehicle's exogenous input.
        dt: Time step [s].
        faults: Faults of the sensors, with their times.

    Attributes:
        size: p, the number of channels.
        own: Channels of each sensor, as a slice.
        periods: Steps from one measurement of each sensor to the next.
        delays: Latency of each sensor in steps ``(sensors,)``.
        horizon: Largest of these delays.
        gives: State or component of the exogenous input that each channel measures directly.
        bias: Joint process of all biases.

    Raises:
        TypeError: for objects that are no sensors, or no faults of sensors.
        ValueError: for an empty list, for two sensors or biases with one name, for a rate that does
            not divide the number of steps per second, or for a delay of no whole number of steps.
            Also for a fault of an unknown sensor or with a wrong number of channels, and for a
            function ``reads`` that does not return one value for each channel.
    """

    def __init__(
        self,
        sensors: Sequence[Sensor],
        states: tuple[str, ...],
        exogenous: tuple[str, ...],
        dt: float,
        faults: Sequence[SensorFault] = (),
    ) -> None:
        self.each = _checked_sensors(sensors)
        check_names("states of Sensors", states)
        check_names("exogenous of Sensors", exogenous)
        check_numbers("Sensors", {"dt": dt}, positive="dt")
        self.state_names, self.exogenous_names, self.dt = states, exogenous, dt
        sizes = [len(sensor.channels) for sensor in self.each]
        self.owner = np.repeat(np.arange(len(self.each)), sizes)  # index of each channel's sensor
        self.size = len(self.owner)
        ends = np.cumsum(sizes).tolist()
        self.own = [slice(end - k, end) for k, end in zip(sizes, ends, strict=True)]
        self.periods = [sensor.period(dt) for sensor in self.each]
        self.delays = np.array([sensor.delay(dt) for sensor in self.each])
        self.horizon = int(self.delays.max())
        self.faults = self._checked_faults(faults)
        self.angles = tuple(own.start + i for s, own in self._owning for i in s.angles)
        self.scale = np.array(self._entries("scale", 1.0))
        self.gives = tuple(self._entries("gives", None))
        self.channels = tuple(self._entries("channels", ""))
        biases = [sensor.bias for sensor in self.each if sensor.bias is not None]
        self.bias = Process.joined(*(bias.process(dt) for bias in biases))
        self.bias_names = tuple(name for bias in biases for name in bias.states)
        for name in self.bias_names:
            if name in states or self.bias_names.count(name) > 1:
                raise ValueError(
                    f"a bias is called {name!r}, as another component is: give it a name of its own"
                )
        self.bias_scale = np.array([bias.scale for bias in biases for _ in bias.states])
        self._check()

    def _entries(self, name: str, default: Any) -> list[Any]:
        """An attribute of the sensors, one entry for each channel; ``default`` without one."""
        return [x for s in self.each for x in getattr(s, name) or (default,) * len(s.channels)]

    @cached_property
    def sd(self) -> np.ndarray:
        """Standard deviations ``(p,)``; NaN where they depend on the measurement."""
        sizes = [(np.nan,) * len(s.channels) if callable(s.sd) else s.sd for s in self.each]
        return np.concatenate(sizes, dtype=float)

    @cached_property
    def _ranges(self) -> np.ndarray:
        """Least and greatest value ``(2, p)`` of each channel."""
        return np.array(self._entries("range", (-np.inf, np.inf)), float).T

    @cached_property
    def bias_gain(self) -> np.ndarray:
        """Effect ``(p, k)`` of the biases' states on the measurements."""
        gain = np.zeros((self.size, self.bias.size))
        for sensor, own in self._owning:
            if sensor.bias is not None:
                k, states = sensor.bias.gain.shape
                first = self.bias_names.index(sensor.bias.names[0])
                gain[own.start : own.start + k, first : first + states] = sensor.bias.gain
        return gain

    @property
    def reads_compiled(self) -> bool:
        """Are all functions ``reads`` compiled, and is all noise constant?"""
        return not self._varying and all(is_compiled(sensor.reads) for sensor in self.each)

    @cached_property
    def _varying(self) -> list[tuple[slice, Callable[[np.ndarray], np.ndarray]]]:
        """Channels whose noise depends on the measurement, and its function."""
        return [(own, sensor.sd) for sensor, own in self._owning if callable(sensor.sd)]

    def of_channel(self, channel: Any) -> Sensor:
        """Sensor to which a channel belongs."""
        return self.each[self.owner[channel]]

    @property
    def _owning(self) -> Iterator[tuple[Sensor, slice]]:
        """Sensors and their channels."""
        return zip(self.each, self.own, strict=True)

    def _check(self) -> None:
        state = np.zeros((2, 3, len(self.state_names)))
        exogenous = np.zeros((2, 3, len(self.exogenous_names)))
        for sensor in self.each:
            with np.errstate(all="ignore"):  # it may have no value at rest
                shape, k = np.shape(sensor.reads(state, exogenous)), len(sensor.channels)
            if shape != (2, 3, k):
                raise ValueError(
                    f"reads of {sensor.name} must give {k} values for each state: {state.shape}"
                    f" gave {shape}, expected {(2, 3, k)}"
                )
            for name in sensor.gives or ():
                if name not in (None, *self.state_names, *self.exogenous_names):
                    what = f"state that {sensor.name} gives"
                    raise ValueError(unknown(what, name, self.state_names))

    def _checked_faults(self, faults: Any) -> tuple[SensorFault, ...]:
        channels = {sensor.name: len(sensor.channels) for sensor in self.each}
        if not all_are(SensorFault, faults):
            raise TypeError(
                f"sensor_faults must be a list of SensorFault objects, got {short_repr(faults)}"
            )
        for fault in faults:
            if fault.sensor not in channels:
                raise ValueError(unknown("sensor of sensor_faults", fault.sensor, channels))
            k = channels[fault.sensor]
            if np.size(fault.size) not in (1, k):
                raise ValueError(
                    f"{fault.sensor} has {k} channels, so size of {fault} must be one number"
                    f" or {k}, got {short_repr(fault.size)}"
                )
        return tuple(faults)

    def exact(
        self, state: np.ndarray, exogenous: np.ndarray, bias: np.ndarray | None = None
    ) -> np.ndarray:
        """Measurements without noise ``(..., p)``, from the sensors' functions ``reads``.

        Args:
            state: ``(..., n)`` of the vehicle.
            exogenous: ``(..., f)`` exogenous input.
            bias: ``(..., k)`` states of the biases; None for no biases.
        """
        exact = np.concatenate([sensor.reads(state, exogenous) for sensor in self.each], -1)
        return exact if bias is None else product(self.bias_gain, bias, exact)

    def read(
        self,
        state: np.ndarray,
        exogenous: np.ndarray,
        bias: np.ndarray,
        steps: np.ndarray,
        keys: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Noisy measurements, and the mask of those that arrived.

        Args:
            state: ``(B, n)`` of the vehicle.
            exogenous: ``(B, f)`` exogenous input.
            bias: ``(B, k)`` states of the biases.
            steps: ``(B,)`` steps since the episode's start; at step 0 every sensor measures.
            keys: ``(B, sensors, 2)`` of each sensor's random numbers.

        Returns:
            Measurements ``(B, p)``, 0 where missing, and the mask ``(B, p)``.
        """
        exact = self.exact(state, exogenous, bias)
        return self.corrupted(exact, self.sd_at(exact), steps, keys)

    @compiled(axes=(1, 1, 0, 2))
    def corrupted(
        self, exact: np.ndarray, sd: np.ndarray, steps: np.ndarray, keys: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Measurements with noise and outliers, 0 where missing, and the mask of those available.

        Args:
            exact: ``(..., p)`` measurements without noise.
            sd: ``(..., p)`` standard deviations.
            steps: ``(...)`` since the episode's start.
            keys: ``(..., sensors, 2)`` of each sensor's random numbers.
        """
        values, available, word = [], [], as_word(steps)
        for i, (sensor, own) in enumerate(self._owning):
            key, channels = keys[..., i, :], range(own.start, own.stop)
            size: np.ndarray | float = 1.0
            least, greatest = self._ranges
            within = [
                (least[j] <= exact[..., j]) & (exact[..., j] <= greatest[j]) for j in channels
            ]
            arrives = reduce(and_, within)
            if self.periods[i] > 1:
                periods = steps / self.periods[i]
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

    def sd_at(self, exact: np.ndarray) -> np.ndarray:
        """Standard deviations ``(..., p)`` at the noise-free measurements ``exact (..., p)``."""
        sd = np.broadcast_to(self.sd, exact.shape)
        for own, spread in self._varying:
            parts = sd[..., : own.start], spread(exact[..., own]), sd[..., own.stop :]
            sd = np.concatenate(parts, -1)
        return sd

    def noise(
        self,
        expected: Callable[[np.ndarray, np.ndarray | None], np.ndarray],
        x: np.ndarray,
        u: np.ndarray | None,
    ) -> np.ndarray | StateNoise:
        """R of a filter; it depends on the expected measurements if any standard deviation does.

        Args:
            expected: Function from a filter's states and known inputs to expected measurements
                ``(..., p)``.
            x: A state ``(n,)``. If R varies, code that has no state takes R at this one.
            u: Known input that belongs to ``x``.
        """
        if not self._varying:
            return np.diag(self.sd**2)
        here = np.nan_to_num(np.diag(self.sd_at(expected(x, u)) ** 2))
        return StateNoise(partial(self._noise_at, expected), here)

    def _noise_at(
        self, expected: Callable[..., np.ndarray], x: np.ndarray, u: np.ndarray | None
    ) -> np.ndarray:
        """R ``(..., p, p)`` for the expected measurements in states ``(..., n)``."""
        return self.sd_at(expected(x, u))[..., None] ** 2 * np.eye(self.size)

    # --- what measurements tell -------------------------------------------------------------------

    def states_from(self, measurements: np.ndarray) -> dict[str, np.ndarray]:
        """States and exogenous inputs ``(...)`` by name, from measurements ``(..., p)``."""
        known: dict[str, np.ndarray] = {}
        for sensor, own in self._owning:
            given = enumerate(sensor.gives or (), own.start)
            known |= {name: measurements[..., i] for i, name in given if name}
            if sensor.inverse is not None:
                known |= sensor.inverse(measurements[..., own], known)
        return known


def _checked_sensors(sensors: Any) -> tuple[Sensor, ...]:
    """One or more sensors, each with a name of its own.

    Raises:
        TypeError: for objects that are no sensors.
        ValueError: for two sensors with one name.
    """
    if not all_are(Sensor, sensors) or not sensors:
        named = "the name of a suite, or Sensor objects, one at least"
        raise TypeError(f"sensors must be {named}, got {short_repr(sensors)}")
    names = [sensor.name for sensor in sensors]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"two sensors are called {name!r}: give each a name of its own")
    return tuple(sensors)
