"""A log as identification uses it: motion, control and wind on a common grid, held measurements left out."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import savgol_filter

from estimators.angles import wrap
from vessel_gym.logs import Log, LogError
from vessel_gym.logs.log import ANGLES
from vessel_gym.vehicles.manoeuvring import AIR, Particulars

_SMOOTHING = 25
"""Steps of the polynomial that smooths positions: a third of the time in which the ship sails her length."""
_GUST, SLOW = 1.0, 200.0
"""Spans [s]: of the wind that a ship feels as one, of the wind that moves the surface of the water."""
_NEEDED = ("x", "y", "heading", "yaw rate", "rudder", "revolutions")
_STEPS, _GAP, _LEAST = 75.0, 15.0, 50
_REPEATS, ROUNDING = 5, 1e-9
"""Position or heading repeated so often was held by the instrument: a moving ship's is never the same."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A measured voyage on a grid of ``dt``.

    Attributes:
        name: Of its log.
        dt: Time step [s].
        start: Time of the first step in the log [s].
        states: ``(T + 1, 6)`` measured state: smoothed positions, velocities from them.
        control: ``(T, 2)`` mean rudder [rad] and revolutions [1/s] over each step.
        air: ``(T, 4)`` mean wind over each step, and its slow mean; zeros where none was measured.
    """

    name: str
    dt: float
    start: float
    states: np.ndarray
    control: np.ndarray
    air: np.ndarray

    def __len__(self) -> int:
        return len(self.control)

    def part(self, first: int, last: int) -> "Trial":
        """Steps ``first`` to ``last``."""
        start = self.start + first * self.dt
        return Trial(
            self.name, self.dt, start, self.states[first : last + 1], self.control[first:last], self.air[first:last]
        )


def common_step(logs: Sequence[Log], particulars: Particulars) -> float:
    """Time step [s] for the trials of logs: 75 of them while the ship sails her length."""
    speeds = []
    for log in logs:
        _, values, available = log.sampled(("x", "y"), 1.0)
        moved = np.hypot(*np.diff(values, axis=0).T)[available[1:].all(-1) & available[:-1].all(-1)]
        speeds.append(moved)
    moved = np.concatenate(speeds)
    if moved.size == 0:
        raise LogError(f"{logs[0].name}: no two positions are a second apart")
    return float(f"{pace(particulars, moved) / _STEPS:.1g}")


def pace(particulars: Particulars, speeds: np.ndarray) -> float:
    """Time [s] in which a ship of these speeds [m/s] sails her length; speeds count up to five times their median."""
    squares = np.square(speeds)
    root = float(np.sqrt(np.mean(np.minimum(squares, 25.0 * np.median(squares)))))
    return particulars.length / max(root, 1e-3 * np.sqrt(9.81 * particulars.length))


def trials(log: Log, dt: float, smoothed: int = _SMOOTHING) -> list[Trial]:
    """The trials of a log: its parts without gaps in position, heading, yaw rate, rudder and revolutions.

    Args:
        log: With those channels, and wind speed and wind direction where they were measured.
        dt: Time step of the grid [s].
        smoothed: Steps over which positions are smoothed.

    Raises:
        LogError: if a channel is missing, or no part is longer than `_LEAST` steps.
    """
    channels = {name: log[name].measured() for name in _NEEDED}
    if "wind speed" in log and "wind direction" in log:
        channels |= {name: log[name].measured() for name in ("wind speed", "wind direction")}
    for name in ("x", "y", "heading"):
        channels[name] = without_repeats(*channels[name], name)
    if few := [name for name, (times, _) in channels.items() if len(times) < _LEAST]:
        raise LogError(f"{log.name}: {few[0]} has fewer than {_LEAST} measurements")
    first = max(times[0] for times, _ in channels.values())
    last = min(times[-1] for times, _ in channels.values())
    breaks = [first, last]
    for name in _NEEDED:
        times = channels[name][0]
        for i in np.flatnonzero(np.diff(times) > _GAP * dt):
            breaks += [times[i], times[i + 1]]
    found = []
    for begin, end in pairwise(sorted(each for each in breaks if first <= each <= last)):
        gap = any(
            np.any((times[:-1] <= begin) & (times[1:] >= end) & (np.diff(times) > _GAP * dt))
            for times in (channels[name][0] for name in _NEEDED)
        )
        if not gap and end - begin > _LEAST * dt:
            found.append(_trial(log.name, channels, begin, end, dt, smoothed))
    if not found:
        raise LogError(f"{log.name}: no part of {_LEAST * dt:.3g} s is without gaps")
    return found


def _trial(name: str, channels: dict[str, Any], begin: float, end: float, dt: float, smoothed: int) -> Trial:
    """One part of a log."""
    rate = float(np.median(np.diff(channels["x"][0])))
    each = max(1, round(dt / rate))  # samples of the raw grid in a step
    fine = dt / each
    count = int((end - begin) / dt + 1e-9)
    grid = begin + fine * np.arange(count * each + 1)
    raw = {key: _on(grid, key, *measured) for key, measured in channels.items()}
    states = _states(raw, fine, each * smoothed)[::each]

    def mean(column: np.ndarray) -> np.ndarray:
        return column[: count * each].reshape(count, each).mean(-1)

    air = np.zeros((count, len(AIR)))
    if "wind speed" in raw:
        for axis, function in enumerate((np.cos, np.sin)):
            wind = mean(raw["wind speed"] * function(raw["wind direction"]))
            air[:, axis] = gaussian_filter1d(wind, _GUST / dt)
            air[:, 2 + axis] = _slow(wind, dt)
    return Trial(name, dt, begin, states, np.stack([mean(raw["rudder"]), mean(raw["revolutions"])], -1), air)


def _on(grid: np.ndarray, key: str, times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """A channel on the grid: controls are held, angles unwrapped, others linear between measurements."""
    if key in ("rudder", "revolutions"):
        return values[np.maximum(np.searchsorted(times, grid + 1e-9, side="right") - 1, 0)]
    return np.interp(grid, times, np.unwrap(values) if key in ANGLES else values)


def without_repeats(times: np.ndarray, values: np.ndarray, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Times and values without those that the instrument held; a yaw rate may stay.

    Any repeated value was held if the resolution is fine (`fine`), otherwise runs of at least `_REPEATS`, but for the
    first of each.
    """
    if name == "yaw rate":
        return times, values
    same, bends = np.concatenate([[False], np.diff(values) == 0.0]), np.diff(values, 2)
    bends = np.abs(wrap(bends) if name in ANGLES else bends)
    if fine(bends[bends > ROUNDING * np.abs(values).max(initial=0.0)]):
        return times[~same], values[~same]
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same.astype(int), [0]])))
    for first, last in edges.reshape(-1, 2):
        if last - first < _REPEATS:
            same[first:last] = False
    return times[~same], values[~same]


def fine(bends: np.ndarray) -> bool:
    """True if a moving ship's values repeat by chance in about one of a hundred cases at most.

    Args:
        bends: Magnitudes of second differences of the values, of angles the short way round, none of them 0. The
            smallest is the resolution of an instrument, and the median what the ship does; outliers do not move it.
    """
    return bends.size > 0 and bool(bends.min() < 0.01 * np.median(bends))


def _states(raw: dict[str, np.ndarray], dt: float, steps: int) -> np.ndarray:
    """States ``(N, 6)``: velocities are the derivative of the smoothed position, which no instrument delays."""
    span = min(2 * (steps // 2) + 1, 2 * ((len(raw["x"]) - 1) // 2) + 1)
    x, y, vx, vy = (savgol_filter(raw[key], span, 2, deriv=order, delta=dt) for order in (0, 1) for key in ("x", "y"))
    cos, sin = np.cos(raw["heading"]), np.sin(raw["heading"])
    return np.stack([x, y, raw["heading"], vx * cos + vy * sin, vy * cos - vx * sin, raw["yaw rate"]], -1)


def _slow(wind: np.ndarray, dt: float) -> np.ndarray:
    """First-order low-pass filter, which begins at the mean of the first minute."""
    share, mean, result = dt / SLOW, float(np.mean(wind[: max(1, round(60.0 / dt))])), np.empty_like(wind)
    for i, value in enumerate(wind):
        mean += share * (value - mean)
        result[i] = mean
    return result
