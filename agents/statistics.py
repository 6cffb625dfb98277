"""Means, normalised scores and comparisons, with their 95 % intervals.

For the reasons see docs/statistics.md.

`crossed_interval` and `normalise` take an array ``(runs, seeds)``, with a row for each training run
and a column for each evaluation seed. An agent that does not learn has one row. All agents and
estimators meet the same evaluation seeds. Another study would train again and use other seeds, so
an interval covers the scatter of both.

Sources: Hillis (2007), "A comparison of denominator degrees of freedom methods for multiple
observer ROC analysis", for intervals over two crossed factors; Hall (1992), "On the removal of
skewness by transformation", for skewed values; Schuirmann (1987), "A comparison of the two
one-sided tests procedure", for equivalence; Hanley, Lippman-Hand (1983), "If nothing goes wrong, is
everything all right?", for the rule of three; Clopper & Pearson (1934), Biometrika 26, for shares
of trials.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Interval:
    """A mean, a difference or a share of trials, and the ends of its 95 % interval.

    The ends are NaN where there is no interval, and so is the mean of no values.
    """

    mean: float
    low: float
    high: float

    @property
    def half(self) -> float:
        """Half of the interval's width."""
        return 0.5 * (self.high - self.low)

    @property
    def even(self) -> bool:
        """True if the mean is the middle of the interval, so that "mean ± half" is complete."""
        skew = self.high + self.low - 2.0 * self.mean
        return abs(skew) <= 1e-9 * max(abs(self.low), abs(self.high))

    @property
    def excludes_zero(self) -> bool:
        """True if the interval does not contain zero."""
        return self.low > 0.0 or self.high < 0.0

    def times(self, factor: float) -> "Interval":
        """The interval of the quantity times ``factor``."""
        low, high = sorted((factor * self.low, factor * self.high))
        return Interval(factor * self.mean, low, high)


EQUIVALENT, UNDECIDED = "equivalent", "undecided"
"""A result of `verdict`, which defines when it is given."""
CLEARLY_BETTER, SLIGHTLY_BETTER = "clearly better", "slightly better"
"""A result of `verdict`, which defines when it is given."""
SLIGHTLY_WORSE, CLEARLY_WORSE = "slightly worse", "clearly worse"
"""A result of `verdict`, which defines when it is given."""


def verdict(differences: np.ndarray, margin: float, span: float, comparisons: int = 1) -> str:
    """The verdict on the mean of paired differences; positive differences are better.

    `EQUIVALENT` if three conditions hold:

    - the 95 % interval of the mean lies between -margin and margin;
    - it would still do so after one more episode that differs by the whole span, up or down;
    - N is at least 3 span / margin. A disaster that happens in none of N episodes may happen in up
      to 3 / N of all episodes (rule of three), which changes the mean by up to 3 span / N.

    Otherwise `CLEARLY_BETTER` or `CLEARLY_WORSE` if the interval lies beyond the margin,
    `SLIGHTLY_BETTER` or `SLIGHTLY_WORSE` if it excludes zero, and `UNDECIDED` if it contains zero.

    Args:
        differences: ``(N,)`` or ``(runs, N)`` finite numbers, see `crossed_interval`.
        margin: Least difference that matters.
        span: Largest possible difference of two episodes, such as 1 for scores in [0, 1].
        comparisons: Number of intervals that hold at once, see `crossed_interval`.
    """
    values = np.atleast_2d(differences)
    found = crossed_interval(values, comparisons)
    if values.shape[1] * margin >= 3.0 * span:
        more = (np.full((len(values), 1), end) for end in (-span, span))
        intervals = (
            found,
            *(crossed_interval(np.hstack([values, each]), comparisons) for each in more),
        )
        if all(-margin < each.low and each.high < margin for each in intervals):
            return EQUIVALENT
    if found.low > 0.0:
        return CLEARLY_BETTER if found.low > margin else SLIGHTLY_BETTER
    if found.high < 0.0:
        return CLEARLY_WORSE if found.high < -margin else SLIGHTLY_WORSE
    return UNDECIDED


def crossed_interval(values: np.ndarray, comparisons: int = 1) -> Interval:
    """The mean of ``(runs, seeds)`` with its 95 % interval for other runs on other seeds.

    The variance of the mean is that of a two-way layout without replication, with runs and seeds as
    random factors: a sum of mean squares, divided by the number of values. The sum is the mean
    square between runs plus the excess of that between seeds over the residual. A mean square of
    few runs is uncertain, so the quantile is Student's with Satterthwaite's degrees of freedom
    (Hillis 2007). For one run the result is Student's interval over its seeds.

    Args:
        values: Finite numbers for every run on every seed.
        comparisons: Number of intervals that hold at once with 95 % probability (Bonferroni).

    Returns:
        The interval; its ends are NaN for fewer than two seeds, because one value has no spread.

    Raises:
        ValueError: if values are not a matrix of finite numbers.
    """
    from scipy.special import stdtrit

    values = np.asarray(values, float)
    if values.ndim != 2 or not np.isfinite(values).all():
        raise ValueError(
            "values must be a finite matrix with runs for its rows: leave out what is missing"
        )
    runs, seeds = values.shape
    if seeds < 2 or not runs:
        return Interval(float(values.mean()) if values.size else np.nan, np.nan, np.nan)
    mean, of_runs, of_seeds = values.mean(), values.mean(axis=1), values.mean(axis=0)
    between_seeds = runs * of_seeds.var(ddof=1)
    between_runs = 0.0
    if runs > 1:
        between_runs = seeds * of_runs.var(ddof=1)
        rest = values - of_runs[:, None] - of_seeds + mean
        between_seeds = max(between_seeds - (rest**2).sum() / ((runs - 1) * (seeds - 1)), 0.0)
    total = between_runs + between_seeds
    half = 0.0
    if total > 0.0:
        freedom = 1.0 / (
            (between_runs / total) ** 2 / max(runs - 1, 1)
            + (between_seeds / total) ** 2 / (seeds - 1)
        )
        quantile = stdtrit(freedom, 1.0 - 0.5 * (1.0 - CONFIDENCE) / comparisons)
        half = float(quantile * np.sqrt(total / values.size))
    return Interval(float(mean), float(mean) - half, float(mean) + half)


def mean_interval(values: ArrayLike, comparisons: int = 1) -> Interval:
    """The mean of independent values ``(N,)`` with Student's 95 % interval.

    Values that are not finite count as missing; ``comparisons`` are those of `crossed_interval`.
    The ends are NaN for fewer than two values.
    """
    values = np.asarray(values, float)
    return crossed_interval(values[np.isfinite(values)][None], comparisons)


def paired_difference(a: ArrayLike, b: ArrayLike, *, comparisons: int = 1) -> Interval:
    """The mean of ``a - b`` over pairs ``(N,)`` with Student's 95 % interval, as `mean_interval`.

    Raises:
        ValueError: if the two do not pair.
    """
    a, b = np.asarray(a, float), np.asarray(b, float)
    if a.shape != b.shape:
        raise ValueError(f"{a.size} values do not pair with {b.size}")
    return mean_interval(a - b, comparisons)


def episodes_for(values: np.ndarray, half: float, comparisons: int = 1) -> float:
    """Number of episodes at which the interval of a mean has a half-width, by the values' spread.

    Args:
        values: ``(N,)``, N at least 2.
        half: The half-width.
        comparisons: Those of `crossed_interval`.

    Returns:
        The number; infinite for a half-width of 0.
    """
    from scipy.special import ndtri

    quantile = float(ndtri(1.0 - 0.5 * (1.0 - CONFIDENCE) / comparisons))
    return (quantile * float(values.std(ddof=1)) / half) ** 2 if half else np.inf


def skewed_interval(values: np.ndarray, comparisons: int = 1) -> Interval:
    """The mean of finite, independent values ``(N,)`` with an interval that follows their skewness.

    Student's t is transformed by Hall's (1992) cubic, which removes its skewness; the interval
    reaches further towards the long tail. The interval cannot account for a rare event that the
    values lack, such as a disaster that one episode of a hundred has. See `crossed_interval` for
    ``comparisons``.
    """
    plain = crossed_interval(values[None], comparisons)
    if np.ptp(values) == 0.0:
        return plain
    deviations, n = values - plain.mean, len(values)
    bend = (deviations**3).mean() / (deviations**2).mean() ** 1.5 / np.sqrt(n) / 3.0
    if abs(bend) < 1e-9:  # the limit
        return plain
    error = deviations.std(ddof=1) / np.sqrt(n)
    quantile = plain.half / error
    low, high = (
        (np.cbrt(1.0 + 3.0 * bend * (t - 0.5 * bend)) - 1.0) / bend for t in (quantile, -quantile)
    )
    return Interval(plain.mean, float(plain.mean - error * low), float(plain.mean - error * high))


def share_interval(hits: float, trials: int) -> Interval:
    """A share of trials with Clopper and Pearson's 95 % interval, which has a width at 0 and 1.

    ``hits`` may be the mean over several tasks. If the shares of the tasks differ, the interval is
    at least as wide as needed (Hoeffding 1956).
    """
    from scipy.stats import beta

    share, tail = hits / trials, 0.5 - 0.5 * CONFIDENCE
    low = beta.ppf(tail, hits, trials - hits + 1.0) if share > 0.0 else 0.0
    high = beta.ppf(1.0 - tail, hits + 1.0, trials - hits) if share < 1.0 else 1.0
    return Interval(float(share), float(low), float(high))


def normalise(scores: np.ndarray, floor: np.ndarray, ceiling: np.ndarray) -> np.ndarray:
    """Normalised scores ``(runs, seeds)``: ``floor`` is 0 and ``ceiling`` 1; nothing is clipped.

    The mean of a row is the run's ``(mean score - mean floor) / (mean ceiling - mean floor)``. The
    value at a seed is a linearisation of this ratio in the score, floor and ceiling at that seed.
    An interval over the row therefore includes the errors of floor and ceiling.

    Args:
        scores: ``(runs, seeds)``, in any unit in which more is better.
        floor: ``(seeds,)`` scores of the study's controller on dead reckoning at the same seeds.
        ceiling: ``(seeds,)`` scores of the study's controller on the truth at the same seeds.

    Raises:
        ValueError: if the mean ceiling is not above the mean floor.
    """
    low, high = floor.mean(), ceiling.mean()
    if not high > low:
        raise ValueError(
            f"the ceiling ({high:g}) must be above the floor ({low:g}) to normalise with them"
        )
    share = (scores.mean() - low) / (high - low)
    return share + (scores - floor - share * (ceiling - floor)) / (high - low)
