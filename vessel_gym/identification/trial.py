"""A log as identification uses it: motion, control and wind on a common grid, held measurements left out."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import savgol_filter

from vessel_gym.vehicles.manoeuvring import AIR

_SMOOTHING, _GUST, _SLOW = 2.1, 1.0, 200.0
"""Spans [s]: of the polynomial that smooths positions, of the wind that a ship feels as one, of the wind that moves the
surface of the water."""
_HELD = 5
"""Position or heading repeated so often was held by the instrument: a moving ship's is never the same."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A measured voyage on a grid of ``dt``.

    Attributes:
        name: Of its log.
        dt: Time step [s].
        start: Time of the first step in the log [s].
        states: ``(T + 1, 6)`` measured state: positions smoothed over two seconds, velocities from them.
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

    @classmethod
    def of(cls, name: str, t: np.ndarray, columns: dict[str, np.ndarray], dt: float) -> "Trial":
        """The trial of measured columns.

        Args:
            name: Of the log.
            t: ``(N,)`` increasing times [s].
            columns: ``(N,)`` each: x, y [m], heading, yaw rate, rudder, revolutions; wind speed and wind direction
                where they were measured. NaN where a value is missing.
            dt: Time step of the grid [s].

        Raises:
            ValueError: if a column is missing, or has fewer than ten values.
        """
        missing = [each for each in ("x", "y", "heading", "yaw rate", "rudder", "revolutions") if each not in columns]
        if missing:
            raise ValueError(f"{name} has no {', '.join(missing)}, which identification needs")
        fine = dt / max(1, round(dt / max(float(np.median(np.diff(t))), 1e-3)))  # steps of the raw grid
        grid = np.arange(t[0], t[-1] + 0.5 * fine, fine)
        raw = {key: _filled(name, key, t, column, grid) for key, column in columns.items()}
        count, each = divmod(len(grid) - 1, round(dt / fine))[0], round(dt / fine)
        states = _states(raw, fine)[: count * each + 1 : each]

        def mean(column: np.ndarray) -> np.ndarray:
            return column[: count * each].reshape(count, each).mean(-1)

        air = np.zeros((count, len(AIR)))
        if "wind speed" in raw and "wind direction" in raw:
            for axis, function in enumerate((np.cos, np.sin)):
                wind = mean(raw["wind speed"] * function(raw["wind direction"]))
                air[:, axis] = gaussian_filter1d(wind, _GUST / dt)
                air[:, 2 + axis] = _slow(wind, dt)
        control = np.stack([mean(raw["rudder"]), mean(raw["revolutions"])], -1)
        return cls(name, dt, float(t[0]), states, control, air)


def _filled(name: str, key: str, t: np.ndarray, column: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """A column on the grid, missing and held values interpolated; angles unwrapped, controls and gusts held."""
    good = np.isfinite(column) & np.isfinite(t)
    if key in ("x", "y", "heading"):
        good &= ~_held(column)
    if good.sum() < 10:
        raise ValueError(f"{name}: {key} has {good.sum()} values, identification needs at least 10")
    at, values = t[good], column[good]
    if key in ("rudder", "revolutions"):
        return values[np.maximum(np.searchsorted(at, grid + 1e-9, side="right") - 1, 0)]
    if key in ("heading", "wind direction"):
        values = np.unwrap(values)
    return np.interp(grid, at, values)


def _held(column: np.ndarray) -> np.ndarray:
    """Values that repeat the one before, in runs of at least `_HELD`; the first of a run is a measurement."""
    same = np.concatenate([[False], np.diff(column) == 0.0])
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same.astype(int), [0]])))
    for first, last in edges.reshape(-1, 2):
        if last - first < _HELD:
            same[first:last] = False
    return same


def _states(raw: dict[str, np.ndarray], dt: float) -> np.ndarray:
    """States ``(N, 6)``: velocities are the derivative of the smoothed position, which no instrument delays."""
    span = min(max(5, 2 * round(0.5 * _SMOOTHING / dt) + 1), 2 * ((len(raw["x"]) - 1) // 2) + 1)
    x, y, vx, vy = (savgol_filter(raw[key], span, 2, deriv=order, delta=dt) for order in (0, 1) for key in ("x", "y"))
    cos, sin = np.cos(raw["heading"]), np.sin(raw["heading"])
    return np.stack([x, y, raw["heading"], vx * cos + vy * sin, vy * cos - vx * sin, raw["yaw rate"]], -1)


def _slow(wind: np.ndarray, dt: float) -> np.ndarray:
    """First-order low-pass filter, which begins at the mean of the first minute."""
    share, mean, result = dt / _SLOW, float(np.mean(wind[: max(1, round(60.0 / dt))])), np.empty_like(wind)
    for i, value in enumerate(wind):
        mean += share * (value - mean)
        result[i] = mean
    return result
