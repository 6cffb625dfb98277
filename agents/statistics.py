"""Means and paired differences with their 95 % intervals."""

from dataclasses import dataclass

import numpy as np

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Interval:
    """A mean and the ends of its 95 % confidence interval, all in the unit of the values."""

    mean: float
    low: float
    high: float

    @property
    def half(self) -> float:
        """Half of the interval's width."""
        return 0.5 * (self.high - self.low)

    @property
    def excludes_zero(self) -> bool:
        """Whether the sign of the mean is beyond doubt at this confidence."""
        return self.low > 0.0 or self.high < 0.0


def mean_interval(values: np.ndarray) -> Interval | None:
    """The mean of independent values ``(N,)`` with Student's 95 % interval.

    Values that are not finite count as missing.

    Returns:
        The interval; None where fewer than two values remain, because one value has no spread.
    """
    from scipy.stats import t

    values = np.asarray(values, float)
    values = values[np.isfinite(values)]
    count = len(values)
    if count < 2:
        return None
    mean = float(values.mean())
    half = float(t.ppf(0.5 + 0.5 * CONFIDENCE, count - 1) * values.std(ddof=1) / np.sqrt(count))
    return Interval(mean, mean - half, mean + half)


def paired_difference(a: np.ndarray, b: np.ndarray) -> Interval | None:
    """The mean of ``a - b`` over pairs ``(N,)`` with Student's 95 % interval, as `mean_interval`.

    Raises:
        ValueError: if the two do not pair.
    """
    a, b = np.asarray(a, float), np.asarray(b, float)
    if a.shape != b.shape:
        raise ValueError(f"{len(a)} values do not pair with {len(b)}")
    return mean_interval(a - b)
