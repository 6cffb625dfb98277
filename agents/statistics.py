"""Means, shares kept and comparisons with their 95 % intervals.

`docs/statistics.md` gives the reasons.

A figure is an array ``(runs, seeds)``: training runs, one for an agent that does not learn, by
evaluation seeds, which are the same for everybody. Another study would train again and fly other
seeds, so an interval is over both.

Sources: Hillis (2007), "A comparison of denominator degrees of freedom methods for multiple
observer ROC analysis", for intervals over two crossed factors; Hall (1992), "On the removal of
skewness by transformation", for prices; Schuirmann (1987), "A comparison of the two one-sided tests
procedure", for equivalence; Hanley, Lippman-Hand (1983), "If nothing goes wrong, is everything all
right?", for the rule of three; Clopper and Pearson (1934) for shares of yes and no.
"""

from dataclasses import dataclass

import numpy as np

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Interval:
    """A mean, a share of yes and no or a difference, and the ends of its 95 % interval."""

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
        """The interval of what is so many times as great."""
        low, high = sorted((factor * self.low, factor * self.high))
        return Interval(factor * self.mean, low, high)


EQUIVALENT, UNDECIDED = "equivalent", "not decided"
BETTER, HIGHER, LOWER, WORSE = "better", "higher", "lower", "worse"
"""Verdicts on a difference; exactly one holds."""


def verdict(differences: np.ndarray, margin: float, span: float, comparisons: int = 1) -> str:
    """The verdict on paired differences ``(N,)``, more being better.

    `EQUIVALENT` if the 95 % interval of the mean lies within the margin, and would do so after one
    more episode that differs by the whole span: a disaster that is in none of N episodes may be in
    3 / N of all (rule of three), so this takes at least 3 span / margin episodes. Else `BETTER` or
    `WORSE` if the interval is beyond the margin, `HIGHER` or `LOWER` if it excludes zero, and
    `UNDECIDED` if it does not.

    Args:
        differences: Finite.
        margin: Below this a difference does not matter.
        span: By how much two episodes can differ, as 1 for scores in [0, 1].
        comparisons: As `crossed_interval`.
    """
    found = mean_interval(differences, comparisons)
    if found is None:
        return UNDECIDED
    if len(differences) * margin >= 3.0 * span:
        intervals = (
            found,
            *(mean_interval(np.append(differences, end), comparisons) for end in (-span, span)),
        )
        if all(each and -margin < each.low and each.high < margin for each in intervals):
            return EQUIVALENT
    if found.low > 0.0:
        return BETTER if found.low > margin else HIGHER
    if found.high < 0.0:
        return WORSE if found.high < -margin else LOWER
    return UNDECIDED


def crossed_interval(values: np.ndarray, comparisons: int = 1) -> Interval | None:
    """The mean of ``(runs, seeds)`` with its 95 % interval for other runs on other seeds.

    The variance of the mean is that of a two-way layout without replication, of which both factors
    are drawn anew: what the means of runs show, and what the means of seeds show beyond the rest. A
    mean square that comes of few runs is known badly, so the quantile is Student's with
    Satterthwaite's degrees of freedom (Hillis 2007). For one run this is Student's interval over
    its seeds.

    Args:
        values: Finite, every run on every seed.
        comparisons: How many intervals are to hold at once, at 95 % (Bonferroni).

    Returns:
        The interval; None for fewer than two seeds, because one value has no spread.

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
    if seeds < 2:
        return None
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


def mean_interval(values: np.ndarray, comparisons: int = 1) -> Interval | None:
    """The mean of independent values ``(N,)`` with Student's 95 % interval.

    Values that are not finite count as missing; ``comparisons`` are those of `crossed_interval`.
    None for fewer than two values.
    """
    values = np.asarray(values, float)
    return crossed_interval(values[np.isfinite(values)][None], comparisons)


def paired_difference(a: np.ndarray, b: np.ndarray, *, comparisons: int = 1) -> Interval | None:
    """The mean of ``a - b`` over pairs ``(N,)`` with Student's 95 % interval, as `mean_interval`.

    Raises:
        ValueError: if the two do not pair.
    """
    a, b = np.asarray(a, float), np.asarray(b, float)
    if a.shape != b.shape:
        raise ValueError(f"{a.size} values do not pair with {b.size}")
    return mean_interval(a - b, comparisons)


def skewed_interval(values: np.ndarray, comparisons: int = 1) -> Interval | None:
    """The mean of finite, independent values ``(N,)`` with an interval that follows their skewness.

    Student's t is transformed by Hall's (1992) cubic, which removes its skewness; the interval
    reaches further towards the long tail. What no value shows, such as a disaster in one episode of
    a hundred, is in no such interval. See `crossed_interval` for ``comparisons``.
    """
    plain = crossed_interval(values[None], comparisons)
    if plain is None or np.ptp(values) == 0.0:
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

    Hits may be the mean over several tasks: their mean share varies less than if all had that share
    (Hoeffding 1956).
    """
    from scipy.stats import beta

    share, tail = hits / trials, 0.5 - 0.5 * CONFIDENCE
    low = beta.ppf(tail, hits, trials - hits + 1.0) if share > 0.0 else 0.0
    high = beta.ppf(1.0 - tail, hits + 1.0, trials - hits) if share < 1.0 else 1.0
    return Interval(float(share), float(low), float(high))


def normalise(scores: np.ndarray, floor: np.ndarray, ceiling: np.ndarray) -> np.ndarray:
    """Share kept ``(runs, seeds)``: ``floor`` is 0 and ``ceiling`` 1; nothing is clipped.

    A row's mean is the run's ``(mean score - mean floor) / (mean ceiling - mean floor)``. Its
    values by seed are that ratio's linearisation: they scatter as it does when seeds are drawn anew
    for score, floor and ceiling together, so that an interval over them contains the error of the
    scale.

    Args:
        scores: ``(runs, seeds)``, in any unit in which more is better.
        floor: ``(seeds,)``, what the classical agent scores on dead reckoning at the same seeds.
        ceiling: ``(seeds,)``, what it scores there on the truth.

    Raises:
        ValueError: if the ceiling is not above the floor, so that there is no such scale.
    """
    low, high = floor.mean(), ceiling.mean()
    if not high > low:
        raise ValueError(
            f"the ceiling ({high:g}) must be above the floor ({low:g}) to normalise with them"
        )
    share = (scores.mean() - low) / (high - low)
    return share + (scores - floor - share * (ceiling - floor)) / (high - low)
