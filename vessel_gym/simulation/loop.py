"""The loop: measurements are delivered with faults and delays, and a filter's belief follows."""

from collections.abc import Callable

import numpy as np

from estimators import Gaussian, RandomKeys
from vessel_gym.models.estimation import Estimation
from vessel_gym.sensor_faults import SensorFault
from vessel_gym.sensors import Sensors
from vessel_gym.simulation.state import State

_ROUNDING = 1e-6
"""Tolerance [s], by which a fault that begins at 0.3 s begins in the third step of 0.1 s."""


class Delivery:
    """Faults and delays of sensors: functions of the record, which holds all that changes.

    In the record, ``faults`` is ``(times, held)``: begin and end of each fault ``(B, faults, 2)``
    [s], and for each channel the value ``(B, p)`` that a stuck sensor repeats, NaN without one.
    ``transit`` is the sampled measurements by age ``(B, ages, p)``, and their mask.

    Args:
        sensors: Sensors, with their faults and delays.
    """

    def __init__(self, sensors: Sensors) -> None:
        self.sensors, self.ages = sensors, sensors.horizon + 1
        names = [sensor.name for sensor in sensors.each]
        self._sensor_index = [names.index(fault.sensor) for fault in sensors.faults]
        self._channels = [sensors.own[i] for i in self._sensor_index]  # of each fault
        self._due = sensors.delays[sensors.owner] == np.arange(self.ages)[:, None]  # (ages, p)

    def begin(self, now: State) -> None:
        """Draw the times of faults; no measurement is in transit."""
        shape = len(now.steps), self.ages, self.sensors.size
        if faults := self.sensors.faults:
            times = np.zeros((len(now.steps), len(faults), 2))
            for i, fault in enumerate(faults):
                earliest, latest = fault.begins
                begin = earliest + self._keys(now, i).uniforms(1)[:, 0] * (latest - earliest)
                times[:, i] = np.stack([begin, begin + fault.duration], -1)
            now.faults = times, np.full(shape[::2], np.nan)
        if self.ages > 1:
            now.transit = np.zeros(shape), np.zeros(shape, bool)

    def _keys(self, now: State, i: int) -> RandomKeys:
        """Keys of the random numbers of the fault with the index i."""
        return RandomKeys(now.sensing[:, self._sensor_index[i]]).of("fault", i)

    def __call__(self, now: State) -> None:
        """Deliver the sampled measurements: put new ones in transit, and find those that arrive."""
        if self.sensors.faults:
            self._corrupt(now)
        if self.ages > 1:
            now.transit = y, available = tuple(
                np.concatenate([new[:, None], old[:, :-1]], 1)
                for new, old in zip((now.y, now.available), now.transit, strict=True)
            )
            arrived = available & self._due
            now.arrived = np.where(arrived, y, 0.0), arrived
            now.y, now.available = youngest(now.arrived)

    def active(self, now: State) -> np.ndarray:
        """Mask ``(B, faults)`` of the active faults."""
        time = (now.steps * self.sensors.dt)[:, None] + _ROUNDING
        times = now.faults[0]
        return (times[..., 0] <= time) & (time < times[..., 1])

    def _corrupt(self, now: State) -> None:
        """Apply the active faults to the sampled measurements."""
        y, available, acting = now.y.copy(), now.available.copy(), self.active(now)
        times, held = now.faults
        held = held.copy()
        for i, (fault, own) in enumerate(zip(self.sensors.faults, self._channels, strict=True)):
            on, read, came = acting[:, i, None], y[:, own], available[:, own]
            if fault.kind == "off":
                available[:, own] = came = came & ~on
            elif fault.kind == "stuck":
                renewed = came & ~(on & np.isfinite(held[:, own]))
                held[:, own] = np.where(renewed, read, held[:, own])
                read = np.where(on, held[:, own], read)
            else:
                with np.errstate(over="ignore"):
                    read = np.where(on, self._wrong(i, fault, read, now), read)
                available[:, own] = came = came & np.isfinite(read)
            y[:, own] = np.where(came, read, 0.0)
        now.y, now.available, now.faults = y, available, (times, held)

    def _wrong(self, i: int, fault: SensorFault, read: np.ndarray, now: State) -> np.ndarray:
        """Measurements ``(B, k)`` under the fault with the index i."""
        size = np.asarray(fault.size, float)
        if fault.kind == "garbage":
            keys = self._keys(now, i).keys
            return size * RandomKeys(keys, now.steps).normals(read.shape[1], use=1)
        if fault.kind == "drift":
            size = size * (now.steps * self.sensors.dt - now.faults[0][:, i, 0])[:, None]
        return read * size if fault.kind == "scale" else read + size


def youngest(measurements: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Youngest measurement of each channel and its mask ``(B, p)``, from all that arrived.

    The argument is measurements by age and the mask of those that arrived, ``(B, ages, p)`` each.
    """
    y, arrived = measurements
    newest = np.take_along_axis(y, arrived.argmax(1)[:, None], 1)[:, 0]
    available = np.logical_or.reduce(arrived, 1)
    return np.where(available, newest, 0.0), available


class Estimator:
    """A filter whose belief is in the record.

    Args:
        estimation: Filter and model.
        field: Field of the record with the belief, ``"belief"`` or ``"raw"``.
        truth: Function of the record that returns the measurement of the oracle.

    Attributes:
        parameters: ``(B, k)`` of a filter with parameters by rows; None: the filter's own.
    """

    def __init__(
        self, estimation: Estimation, field: str, truth: Callable[[State], np.ndarray]
    ) -> None:
        self.estimation, self.field = estimation, field
        self.filter, self._random = estimation.delayed, estimation.filter.random
        self._truth = truth if estimation.tells_truth else None
        self.parameters: np.ndarray | None = None

    def begin(self, now: State, prior: Gaussian) -> None:
        """Belief after the first measurements; the prior is that of the filter's state."""
        rng = RandomKeys(now.filtering) if self._random else None
        y, available = self._measured(now)
        initial = self.filter.init(prior, rng=rng)
        if self.parameters is not None:
            initial = initial.replace(parameters=self.parameters)
        belief = self.filter.update(initial, y, rng=rng, available=available, u=now.u)
        setattr(now, self.field, belief)

    def step(self, now: State) -> None:
        """Belief a step later: predict, then update."""
        rng = RandomKeys(now.filtering, now.steps) if self._random else None
        y, available = self._measured(now)
        before = getattr(now, self.field)
        setattr(now, self.field, self.filter.step(before, y, now.u, rng=rng, available=available))

    def _measured(self, now: State) -> tuple[np.ndarray, np.ndarray | None]:
        """Measurements and their mask in the form for the filter."""
        if self._truth is not None:
            return np.ascontiguousarray(self._truth(now)), None
        if now.arrived is None:
            return now.y, now.available
        y, available = now.arrived
        if self.estimation.fuses:
            return y, available
        if self.estimation.late == "as new":
            return youngest(now.arrived)
        return y[:, 0], available[:, 0]
