"""Faults and delays of measurements between sensors and filters."""

import numpy as np

from estimators import RandomKeys
from estimators.checks import numbers, short_repr
from vessel_gym.sensor_faults import SensorFault
from vessel_gym.sensors import Sensors, columns

Measurements = tuple[np.ndarray, np.ndarray]
"""Measurements and the mask of those that arrived, ``(B, p)`` each, or ``(B, ages, p)`` by age."""


class Faulty:
    """Faults of the sensors of B rows: their times in this episode, and values of stuck sensors."""

    def __init__(self, sensors: Sensors, rows: int) -> None:
        self.each, self._dt = sensors.faults, sensors.dt
        names = [sensor.name for sensor in sensors.each]
        self._sensor = [names.index(fault.sensor) for fault in self.each]
        self._own = [columns(np.flatnonzero(sensors.owner == i).tolist()) for i in self._sensor]
        self._keys = np.zeros((rows, len(self.each), 2), np.uint64)
        self._begin, self._end = np.zeros((2, rows, len(self.each)))  # s
        self._last, self._seen = (
            np.zeros((rows, sensors.size)),
            np.zeros((rows, sensors.size), bool),
        )

    def restart(self, rows: np.ndarray | slice, keys: np.ndarray) -> None:
        """Begin an episode of some rows, with keys ``(rows, sensors, 2)``."""
        self._seen[rows] = False
        for i, (fault, sensor) in enumerate(zip(self.each, self._sensor, strict=True)):
            drawn = RandomKeys(keys[:, sensor]).of("fault", i)
            self._keys[rows, i], share = drawn.keys, drawn.uniforms(2)
            for j, (name, kept) in enumerate((("begin", self._begin), ("end", self._end))):
                earliest, latest = fault.times(name)
                # infinity minus infinity is NaN
                later = share[:, j] * (latest - earliest) if earliest < latest else 0.0
                kept[rows, i] = earliest + later
            if fault.duration is not None:
                self._end[rows, i] = self._begin[rows, i] + fault.duration

    def on(self, steps: np.ndarray, rows: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Mask ``(rows, faults)`` of the active faults, ``steps (rows,)`` after the start."""
        now = (steps * self._dt)[:, None] + _ROUNDING
        return (self._begin[rows] <= now) & (now < self._end[rows])

    def faulted(
        self, measurements: Measurements, steps: np.ndarray, rows: np.ndarray | slice
    ) -> Measurements:
        """Measurements with faults, and their mask, ``steps (rows,)`` after the start."""
        y, available = measurements[0].copy(), measurements[1].copy()
        acting = self.on(steps, rows)
        for i, (fault, own) in enumerate(zip(self.each, self._own, strict=True)):
            on, read, came = acting[:, i, None], y[:, own], available[:, own]
            if fault.kind == "off":
                available[:, own] = came = came & ~on
            elif fault.kind == "stuck":
                last, seen = self._last[rows], self._seen[rows]
                held = np.where(seen[:, own], last[:, own], read)
                renewed = came & ~(on & seen[:, own])
                last[:, own], seen[:, own] = (
                    np.where(renewed, read, last[:, own]),
                    seen[:, own] | came,
                )
                self._last[rows], self._seen[rows] = last, seen
                read = np.where(on, held, read)
            else:
                with np.errstate(over="ignore"):
                    read = np.where(on, self._wrong(i, fault, read, steps, rows), read)
                available[:, own] = came = came & np.isfinite(read)
            y[:, own] = np.where(came, read, 0.0)
        return y, available

    def _wrong(
        self,
        i: int,
        fault: SensorFault,
        read: np.ndarray,
        steps: np.ndarray,
        rows: np.ndarray | slice,
    ) -> np.ndarray:
        """Measurements ``(rows, k)`` under the fault with the index i."""
        size = np.asarray(fault.size, float)
        if fault.kind == "garbage":
            return size * RandomKeys(self._keys[rows, i], steps).normals(read.shape[1], use=1)
        if fault.kind == "drift":
            size = size * (steps * self._dt - self._begin[rows, i])[:, None]
        return read * size if fault.kind == "scale" else read + size


class Transit:
    """Measurements of B rows between sampling and delivery."""

    def __init__(self, sensors: Sensors, rows: int) -> None:
        delay = sensors.delays[sensors.owner]
        self._due = delay == np.arange(sensors.horizon + 1)[:, None]  # (ages, p)
        self._ages = delay, np.arange(sensors.size)  # of each channel
        shape = sensors.horizon + 1, rows, sensors.size
        self._y, self._available = np.zeros(shape), np.zeros(shape, bool)  # by age

    def restart(self, rows: np.ndarray | slice) -> None:
        """Begin an episode of some rows, without measurements in transit."""
        self._available[:, rows] = False

    def carry(self, sampled: Measurements, rows: np.ndarray | slice) -> Measurements:
        """Take new samples, and return measurements by age ``(rows, ages, p)`` that arrive now."""
        y, available = (
            np.concatenate([now[None], before[:-1, rows]])
            for now, before in zip(sampled, (self._y, self._available), strict=True)
        )
        if isinstance(rows, slice):  # all
            self._y, self._available = y, available
        else:
            self._y[:, rows], self._available[:, rows] = y, available
        arrived = available & self._due[:, None]
        return np.where(arrived, y, 0.0).swapaxes(0, 1), arrived.swapaxes(0, 1)

    def youngest(self, delivered: Measurements) -> Measurements:
        """Delivered measurement of each channel; at most one is delivered in a step."""
        y, arrived = (each[:, *self._ages] for each in delivered)
        return y, arrived


def youngest(measurements: Measurements) -> Measurements:
    """Youngest measurement of each channel, from measurements by age."""
    y, arrived = measurements
    row, age, channel = (
        indices[::-1] for indices in np.nonzero(arrived)
    )  # reversed, so that the youngest value overwrites older ones
    values, available = np.zeros(y[:, 0].shape), np.zeros(y[:, 0].shape, bool)
    values[row, channel], available[row, channel] = y[row, age, channel], True
    return values, available


def of_now(measurements: Measurements, horizon: int) -> Measurements:
    """Measurements ``(rows, p)`` by age, all of age 0."""
    y, available = (
        np.zeros((len(one), horizon + 1, one.shape[1]), one.dtype) for one in measurements
    )
    y[:, 0], available[:, 0] = measurements
    return y, available


_ROUNDING = 1e-6
"""Tolerance [s], by which a fault that begins at 0.3 s begins in the third step of 0.1 s."""


def injected(measurements: Measurements, rows: int, sensors: Sensors) -> Measurements:
    """Injected measurements and mask, checked; values that are not finite read 0 and are masked."""
    pair = (
        measurements
        if isinstance(measurements, tuple | list) and len(measurements) == 2
        else (None, None)
    )
    y, mask = (numbers(part) for part in pair)
    if y is None or mask is None:
        raise TypeError(
            "measurements must be two arrays, values and the mask of those that came, got"
            f" {short_repr(measurements)}"
        )
    shapes = [(rows, sensors.size), (rows, sensors.horizon + 1, sensors.size)][
        : 2 if sensors.horizon else 1
    ]
    if y.shape != mask.shape or y.shape not in shapes:
        expected = " each, or by age ".join(map(str, shapes))
        raise ValueError(
            f"measurements have the shapes {y.shape} and {mask.shape}, expected {expected} each"
        )
    available = (mask != 0.0) & np.isfinite(y)
    return np.where(available, y, 0.0), available
