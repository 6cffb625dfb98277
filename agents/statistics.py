"""Means, interquartile means and comparisons with their 95 % intervals; `docs/statistics.md` gives the reasons.

The scores of trained agents are arrays ``(runs, tasks)``. A run is one training from its own seed, and its score on a
task is the mean over episodes. A task is something that was trained for separately.

Sources: Agarwal et al. (2021), "Deep reinforcement learning at the edge of the statistical precipice", for what is
estimated; Hesterberg (2015), "What teachers should know about the bootstrap", for the bootstrap intervals.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

CONFIDENCE = 0.95
REPETITIONS = 10_000
"""Bootstrap draws: at five runs the limits are quantiles at one in a thousand, which needs about that many."""


@dataclass(frozen=True)
class Interval:
    """A mean (plain, interquartile or of yes and no) or a difference of means, and the ends of its 95 % interval."""

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


def normalise(score: np.ndarray, floor: np.ndarray | float, ceiling: np.ndarray | float) -> np.ndarray:
    """``score`` on the scale on which ``floor`` is 0 and ``ceiling`` is 1; beyond the two it goes on, unclipped.

    Args:
        score: ``(..., tasks)``, in any unit in which more is better.
        floor: ``(tasks,)``, what the classical agent scores on dead reckoning.
        ceiling: ``(tasks,)``, what the same agent scores on the truth, in the same episodes.

    Raises:
        ValueError: if a ceiling is not above its floor, so that there is no such scale.
    """
    floor, ceiling = np.asarray(floor, float), np.asarray(ceiling, float)
    if not np.all(ceiling > floor):
        raise ValueError(f"the ceiling ({ceiling}) must be above the floor ({floor}) to normalise with them")
    return (np.asarray(score, float) - floor) / (ceiling - floor)


def iqm(scores: np.ndarray) -> np.ndarray:
    """The mean of the middle half of all scores ``(..., runs, tasks)``; ``(...)``.

    A quarter of the ``runs * tasks`` scores, rounded down, is cut at either end.
    """
    scores = np.asarray(scores, float)
    pooled = np.sort(scores.reshape(*scores.shape[:-2], -1), axis=-1)
    cut = pooled.shape[-1] // 4
    return pooled[..., cut : pooled.shape[-1] - cut].mean(axis=-1)


def stratified_bootstrap(
    scores: np.ndarray,
    statistic: Callable[[np.ndarray], np.ndarray] = iqm,
    seed: int = 0,
    repetitions: int = REPETITIONS,
) -> Interval | None:
    """A statistic of ``scores`` with its bootstrap interval: runs are redrawn within each task, tasks stay.

    Args:
        scores: ``(runs, tasks)``.
        statistic: from ``(..., runs, tasks)`` to ``(...)``.
        seed: of the draws.
        repetitions: how many draws.

    Returns:
        The interval; None where there are fewer than two runs.

    Raises:
        ValueError: if scores are not finite or not a matrix.
    """
    scores = _matrix(scores)
    if len(scores) < 2:
        return None
    draws = _redrawn(scores, np.random.default_rng(seed), repetitions)
    return _expanded_percentile(statistic(scores), statistic(draws), *scores.shape)


def paired_bootstrap(
    x: np.ndarray,
    y: np.ndarray,
    statistic: Callable[[np.ndarray], np.ndarray] = iqm,
    seed: int = 0,
    repetitions: int = REPETITIONS,
) -> Interval | None:
    """``statistic(x) - statistic(y)`` with its interval, run i of one agent drawn along with run i of the other.

    Args:
        x: ``(runs, tasks)``.
        y: ``(runs, tasks)``; run i shares its training seed with run i of ``x``.
        statistic: from ``(..., runs, tasks)`` to ``(...)``.
        seed: of the draws.
        repetitions: how many draws.

    Returns:
        The interval; None where there are fewer than two runs.

    Raises:
        ValueError: if scores are not finite or not a matrix, or if the two do not pair.
    """
    x, y = _matrix(x), _matrix(y)
    if x.shape != y.shape:
        raise ValueError(f"scores {x.shape} do not pair with scores {y.shape}")
    if len(x) < 2:
        return None
    draws = _redrawn(np.stack([x, y], axis=-1), np.random.default_rng(seed), repetitions)
    difference = statistic(draws[..., 0]) - statistic(draws[..., 1])
    return _expanded_percentile(statistic(x) - statistic(y), difference, *x.shape)


def probability_of_improvement(x: np.ndarray, y: np.ndarray) -> Interval:
    """How probably a run of one agent beats a run of another on the same task, averaged over tasks.

    For each task this is Mann and Whitney's U over the number of pairs, a tie counting half. The interval is that of a
    share of as many trials as the agent with fewer runs has: U varies most where the runs of one agent are all alike,
    and then only the other's count (Birnbaum and Klose 1957).

    Args:
        x: ``(runs, tasks)`` of the one.
        y: ``(other runs, tasks)`` of the other.

    Raises:
        ValueError: if scores are not finite or not a matrix, or if the tasks differ in number.
    """
    x, y = _matrix(x), _matrix(y)
    if x.shape[1] != y.shape[1]:
        raise ValueError(f"{x.shape[1]} tasks cannot be compared with {y.shape[1]}")
    wins = (x[:, None] > y) + 0.5 * (x[:, None] == y)
    return _share(wins.mean(), min(x.size, y.size))


def performance_profile(scores: np.ndarray, thresholds: np.ndarray) -> list[Interval]:
    """The share of runs that score above each threshold, averaged over tasks, with pointwise intervals.

    Args:
        scores: ``(runs, tasks)``.
        thresholds: ``(K,)``, in the unit of the scores.

    Returns:
        K intervals.

    Raises:
        ValueError: if scores are not finite or not a matrix.
    """
    scores = _matrix(scores)
    return [_share(np.mean(scores > threshold), scores.size) for threshold in thresholds]


def _matrix(scores: np.ndarray) -> np.ndarray:
    """Scores ``(runs, tasks)`` as floats, checked."""
    scores = np.asarray(scores, float)
    if scores.ndim != 2 or scores.size == 0:
        raise ValueError(f"scores must have the shape (runs, tasks), got {scores.shape}")
    if not np.isfinite(scores).all():
        raise ValueError("scores must be finite: a run that is missing has no score to redraw")
    return scores


def _redrawn(scores: np.ndarray, rng: np.random.Generator, repetitions: int) -> np.ndarray:
    """Scores ``(repetitions, runs, tasks, ...)``, the runs drawn with replacement within each task of its own."""
    runs, tasks = scores.shape[:2]
    return scores[rng.integers(runs, size=(repetitions, runs, tasks)), np.arange(tasks)]


def _expanded_percentile(estimate: np.ndarray, draws: np.ndarray, runs: int, tasks: int) -> Interval:
    """The expanded percentile interval of draws ``(repetitions,)`` (Hesterberg 2015).

    The percentile interval of a mean is too short for two reasons: the draws have the variance of the runs with divisor
    n, not n - 1, and their quantiles are the normal ones, not Student's. Levels further out make up for both.
    """
    from scipy.stats import norm, t

    level = norm.cdf(np.sqrt(runs / (runs - 1)) * t.ppf(0.5 - 0.5 * CONFIDENCE, tasks * (runs - 1)))
    low, high = np.quantile(draws, [level, 1.0 - level])
    return Interval(float(estimate), float(low), float(high))


def _share(share: float, trials: int) -> Interval:
    """A share of independent trials with Clopper and Pearson's (1934) interval; it has a width at 0 and at 1 too.

    It holds for trials of several tasks: their mean share varies less than if all had that share (Hoeffding 1956).
    """
    from scipy.stats import beta

    hits, tail = share * trials, 0.5 - 0.5 * CONFIDENCE
    low = beta.ppf(tail, hits, trials - hits + 1.0) if share > 0.0 else 0.0
    high = beta.ppf(1.0 - tail, hits + 1.0, trials - hits) if share < 1.0 else 1.0
    return Interval(float(share), float(low), float(high))
