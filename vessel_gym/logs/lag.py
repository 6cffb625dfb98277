"""Lag of a velocity behind the derivative of a position or a heading."""

import numpy as np
from scipy.signal import savgol_filter

from vessel_gym.logs.log import Log

_MOST, _PARTS = 3.0, 8
"""Largest lag that is looked for [s], and parts of the log from whose spread the interval follows."""


def lag(log: Log, name: str) -> tuple[float, float] | None:
    """Lag [s] of yaw rate, surge or sway, and half of its 95 % interval; None of a log that is too short or still.

    The lag is where the mean squared difference from the derivative of heading or position is least. It is estimated
    in eight parts of the log; the interval is that of their mean by Student's t.
    """
    needed = ("heading",) if name == "yaw rate" else ("x", "y", "heading")
    steps = np.diff(log[name].measured()[0])
    if len(steps) < 100:
        return None
    dt = float(np.median(steps))
    _, values, _ = log.sampled((name, *needed), dt)
    good = np.isfinite(values)
    if good.mean() < 0.5 or dt > 0.5 * _MOST:
        return None
    index = np.arange(len(values))
    filled = [np.interp(index, index[ok], column[ok]) for ok, column in zip(good.T, values.T, strict=True)]
    span = max(5, 2 * round(0.5 / dt) + 1)
    heading = np.interp(index, index[good[:, -1]], np.unwrap(values[good[:, -1], -1]))
    if name == "yaw rate":
        expected = savgol_filter(heading, span, 2, deriv=1, delta=dt)
    else:
        north, east = (savgol_filter(each, span, 2, deriv=1, delta=dt) for each in filled[1:3])
        cos, sin = np.cos(heading), np.sin(heading)
        expected = north * cos + east * sin if name == "surge" else east * cos - north * sin
    parts = zip(*(np.array_split(each, _PARTS) for each in (filled[0], expected)), strict=True)
    best = [_best(a, b, dt) for a, b in parts]
    found = np.array([each for each in best if each is not None])
    if len(found) < 4:
        return None
    from scipy.stats import t

    half = t.ppf(0.975, len(found) - 1) * np.std(found, ddof=1) / np.sqrt(len(found))
    return float(np.mean(found)), float(half)


def _best(measured: np.ndarray, expected: np.ndarray, dt: float) -> float | None:
    """Lag of least squared difference, by a parabola through the best shift and its neighbours; None at the edge."""
    most = round(_MOST / dt)
    if len(measured) < 4 * most or np.std(expected) == 0.0:
        return None
    shifts = np.arange(-most, most + 1)
    middle = slice(most, len(measured) - most)
    costs = np.array([np.mean((measured[middle] - np.roll(expected, k)[middle]) ** 2) for k in shifts])
    i = int(np.argmin(costs))
    if i in (0, len(costs) - 1):
        return None
    bend = costs[i - 1] - 2.0 * costs[i] + costs[i + 1]
    return float(dt * (shifts[i] + (0.5 * (costs[i - 1] - costs[i + 1]) / bend if bend > 0.0 else 0.0)))
