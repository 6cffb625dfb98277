"""Scale error of a rate gyro: how much faster the heading turns than the yaw rate says."""

import numpy as np

from vessel_gym.logs.log import Log

_PARTS, _WINDOWS, _SHORTEST = 8, 8, 2.0
"""Parts of a log, from whose spread the interval follows, windows in each, and the shortest window [s]."""
_GAP = 3.5
"""Steps without a measurement beyond which a window is left out."""


def scale(log: Log) -> tuple[float, float] | None:
    """Share by which the heading turns faster than the gyro, and half of its 95 % interval; None of a short log.

    The change of heading over each window is the integral of the yaw rate times 1 + scale, plus the gyro's offset times
    the duration, by least squares: the integral has little noise, whatever the heading has. The yaw rate is taken as
    much later as it lags. The interval is that of the jackknife over parts of the log (Efron & Tibshirani 1993, chapter
    11) by Student's t.
    """
    from vessel_gym.logs.lag import lag

    late = lag(log, "yaw rate")
    (at, heading), (times, rate) = log["heading"].measured(), log["yaw rate"].measured()
    if len(at) < 100 or len(times) < 100:
        return None
    times = times - (late[0] if late is not None and late[0] > late[1] else 0.0)
    first, last = max(at[0], times[0]), min(at[-1], times[-1])
    count = min(_PARTS * _WINDOWS, int((last - first) / _SHORTEST))
    if count < 2 * _PARTS:
        return None
    ends = np.linspace(first, last, count + 1)
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(times))])
    turned, integral = (np.diff(np.interp(ends, t, v)) for t, v in ((at, np.unwrap(heading)), (times, angle)))
    whole = ~(_broken(ends, at) | _broken(ends, times))
    parts = np.repeat(np.arange(_PARTS), -(-count // _PARTS))[:count]
    terms = np.stack([integral, np.diff(ends)], -1)
    without = np.array([_slope(terms[used], turned[used]) for used in (whole & (parts != k) for k in range(_PARTS))])
    found = _slope(terms[whole], turned[whole])
    if not np.isfinite([found, *without]).all():
        return None
    from scipy.stats import t

    spread = np.sqrt((_PARTS - 1) / _PARTS * np.square(without - without.mean()).sum())
    return float(found - 1.0), float(t.ppf(0.975, _PARTS - 1) * spread)


def _slope(terms: np.ndarray, values: np.ndarray) -> float:
    """First coefficient of a regression; NaN if the terms do not determine it."""
    found, _, rank, _ = np.linalg.lstsq(terms, values, rcond=1e-8)
    return float(found[0]) if rank == terms.shape[1] else np.nan


def _broken(ends: np.ndarray, times: np.ndarray) -> np.ndarray:
    """True of each window in which a gap of measurements lies."""
    steps = np.diff(times)
    wide = np.flatnonzero(steps > max(_GAP * np.median(steps), 1e-9))
    broken = np.zeros(len(ends) - 1, bool)
    for begin, end in zip(times[wide], times[wide + 1], strict=True):
        broken |= (ends[:-1] < end) & (ends[1:] > begin)
    return broken
