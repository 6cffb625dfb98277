"""A whole series at once: a filter's beliefs at every time, and the likelihood of the measurements.

::

    from estimators import run

    series = run(filter, prior, y)  # y (T, ..., p), NaN where no measurement came
    series.mean, series.cov, series.log_likelihood

Times come first, then rows, then components. `run` needs only ``init``, ``predict`` and ``update``
of a filter.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Generic, cast

import numpy as np
from numpy.typing import ArrayLike

from estimators.belief import Record, over_time
from estimators.checks import as_array, broadcast
from estimators.delayed import Delayed, DelayedBelief
from estimators.filter import Filter, Rng
from estimators.linalg import joined
from estimators.models import Gaussian, LinearModel
from estimators.randomness import RandomKeys, key


@dataclass(frozen=True, eq=False)
class Series(Generic[Record]):
    """Beliefs of a filter over a series of T measurements.

    Attributes:
        filter: The filter.
        predicted: Beliefs before each measurement, ``x(k|k-1)``; the first of a new series is the
            prior. Times lead every array.
        updated: Beliefs after each measurement, ``x(k|k)``.
        last: The belief after the last measurement, as the filter gave it: `run` continues from it.
    """

    filter: Filter[Record] | Delayed
    predicted: Record
    updated: Record
    last: Record | DelayedBelief

    @property
    def mean(self) -> np.ndarray:
        """``(T, ..., n)`` estimates after each measurement."""
        return self.updated.mean

    @property
    def cov(self) -> np.ndarray:
        """``(T, ..., n, n)`` their covariances."""
        return self.updated.cov

    @property
    def input_mean(self) -> np.ndarray | None:
        """``(T, ..., q)`` estimates of the unknown input, ``input_delay`` steps late, or None."""
        return self.updated.input_mean

    @cached_property
    def log_likelihoods(self) -> np.ndarray:
        """``(T, ...)`` log density of each measurement, given those before it; 0 where none came.

        ``filter.likelihood`` names the kind. "exact" is the density of a linear Gaussian model.
        "diffuse" is the density integrated over the unknown input, without a prior in the
        directions that measurements show. "approximate" is the Gaussian density with the filter's
        innovation covariance; `pf` gives an estimate from its particles.

        Raises:
            ValueError: for a `Delayed` filter.
        """
        return self.filter.log_likelihood(self.predicted, self.updated)

    @property
    def log_likelihood(self) -> np.ndarray:
        """``(...)`` log density of all measurements, the sum of `log_likelihoods` over time."""
        return self.log_likelihoods.sum(0)


def run(
    filter: Filter[Record] | Delayed, prior: Gaussian | Record | DelayedBelief, y: ArrayLike,
    u: ArrayLike | None = None, t: ArrayLike | None = None, available: ArrayLike | None = None,
    R: ArrayLike | None = None, rng: Rng | int = None, first: int = 0,
) -> Series[Record]:  # fmt: skip
    """Filter a series of measurements.

    The prior holds at the first measurement; each later measurement follows a prediction. To
    continue an earlier series, give the ``last`` of its result as the prior. The first measurement
    then follows a prediction, too, and the results are those of a single run.

    Args:
        filter: Any filter, also one of your own: an object with ``init``, ``predict`` and
            ``update`` that gives a `Belief`.
        prior: Prior of the state at the first measurement, with mean ``(n,)`` or ``(..., n)``; or
            the belief after an earlier measurement.
        y: ``(T, ..., p)`` measurements, one series or a batch; a value that is not finite counts as
            missing. For a `Delayed` filter ``(T, ..., ages, p)``: at each time the measurements
            that come then, by age in steps.
        u: ``(T, m)`` or ``(T, ..., m)`` known input at the time of each measurement, held over the
            step that follows. A measurement uses the input at its own time; the prediction before
            it uses the input at the previous measurement.
        t: ``(T,)`` or ``(T, ...)`` times of the measurements, if steps differ in length. `run` then
            appends the length of a step to the known input, and the model must use it (see
            `sampled`, or give functions of u). A prediction gets the length of its own step. A
            measurement gets the length of the step before it, 0 at the first. If the series
            continues from a belief, u and t have T + 1 entries: the first is at the belief's time.
        available: ``(T, ..., p)`` mask of the measurements that arrived; None: all that are finite.
        R: ``(T, ..., p, p)`` covariance of each measurement; None: the model's.
        rng: For filters that draw numbers: a seed, `RandomKeys` with a key a row, or a Generator.
        first: Number of earlier measurements; keys and seeds give the random numbers of the steps
            from there on.

    Raises:
        ValueError: if a shape does not fit, times go back, or the model does not use the length of
            a step.
    """
    y = as_array("y", y)
    if y.shape[:1] == (0,):
        raise ValueError(f"y has no measurements (shape {y.shape}): a series needs at least one")
    if y.ndim < 2:
        raise ValueError(f"y has shape {y.shape}, expected (T, ..., p): one channel has y[:, None]")
    T, batch = len(y), y.shape[1:-2] if isinstance(filter, Delayed) else y.shape[1:-1]
    continued = not isinstance(prior, Gaussian)
    if isinstance(prior, Gaussian):
        shape = *batch, prior.mean.shape[-1]
        prior = prior.about(broadcast("the prior's mean", prior.mean, shape))
    else:
        keyed = getattr(filter, "random", False) and not isinstance(rng, np.random.Generator)
        if keyed and first == 0:
            raise ValueError(
                "first must be how many measurements came before: their random numbers are used up"
            )
        if (rows := prior.mean.shape[:-1]) != batch:
            raise ValueError(f"the belief has rows {rows}, y has {batch}")
    masks, covariances = _over_time("available", available, T), _over_time("R", R, T)
    after, at = _known_inputs(getattr(filter, "model", None), u, t, T + continued, batch)
    if isinstance(rng, int | np.integer):
        rng = RandomKeys(key(int(rng))).of(np.arange(math.prod(batch)).reshape(batch))
    loop, belief, predicted, updated = cast(Any, filter), prior, [], []
    for k in range(T):
        i, now = k + continued, rng.at(first + k) if isinstance(rng, RandomKeys) else rng
        belief = loop.predict(belief, after[i - 1], rng=now) if i else loop.init(prior, rng=now)
        predicted.append(belief)
        given = {"available": masks[k], "R": covariances[k], "u": at[i]}
        belief = loop.update(belief, y[k], rng=now, **given)
        updated.append(belief)
    if isinstance(filter, Delayed):
        predicted, updated = ([each.now for each in found] for found in (predicted, updated))
    return Series(filter, over_time(predicted), over_time(updated), belief)


def _over_time(name: str, value: ArrayLike | None, T: int) -> Any:
    """An argument of `run` as T entries, each None if it is."""
    if value is None:
        return [None] * T
    array = as_array(name, value)
    if array.shape[:1] != (T,):
        raise ValueError(
            f"{name} has shape {array.shape}, expected ({T}, ...): one for each measurement of y,"
            " and before them one for a belief that is continued"
        )
    return array


def _known_inputs(
    model: Any, u: ArrayLike | None, t: ArrayLike | None, T: int, batch: tuple[int, ...]
) -> tuple[Any, Any]:
    """Known inputs ``(T, ..., m)`` over the steps that follow measurements, and at measurements.

    With times, the last component is the length of a step: of the one that follows, and of the one
    before the measurement.
    """
    known = _over_time("u", u, T)
    if u is not None and known.ndim == 2:
        known = known.reshape(T, *(1,) * len(batch), -1)
    if t is None:
        return known, known
    if isinstance(model, LinearModel) and not any(map(callable, vars(model).values())):
        raise ValueError(
            "this model is the same however long a step takes: make it with sampled, or leave out t"
        )
    times = _over_time("t", t, T)
    if not (np.isfinite(times).all() and (np.diff(times, axis=0) >= 0.0).all()):
        raise ValueError(
            "times t must be finite and not go back: sort the measurements by time, or use Delayed"
            " for those that come late"
        )
    times = times.reshape(times.shape + (1,) * (len(batch) + 1 - times.ndim))
    known = np.zeros((T, *(1,) * len(batch), 0)) if u is None else known
    last, first = times[-1:], times[:1]
    lengths = np.diff(times, axis=0, append=last), np.diff(times, axis=0, prepend=first)
    after, at = (
        joined([known[..., None, :], dt[..., None, None]], -1)[..., 0, :] for dt in lengths
    )
    return after, at
