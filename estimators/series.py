"""A whole series at once: a filter's beliefs at every time, and the likelihood of the measurements.

::

    from estimators import run

    series = run(filter, prior, y)  # y (T, ..., p), NaN where no measurement came
    series.mean, series.cov, series.log_likelihood

Times come first, then rows, then components. `run` needs nothing of a filter but ``init``,
``predict`` and ``update``.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Generic, cast

import numpy as np

from estimators.belief import Belief, Record, over_time
from estimators.checks import as_array, as_mask, integer, short_repr
from estimators.delayed import Delayed, DelayedBelief
from estimators.filter import Filter, Rng
from estimators.models import Gaussian, LinearModel
from estimators.randomness import RandomKeys, key


@dataclass(frozen=True, eq=False)
class Series(Generic[Record]):
    """Beliefs of a filter over a series of T measurements.

    Attributes:
        filter: Which filter.
        predicted: Beliefs before each measurement, ``x(k|k-1)``; the first is the prior. Times lead
            every array.
        updated: Beliefs after each measurement, ``x(k|k)``.
        last: The belief after the last measurement, as the filter gave it: `run` continues from it.
    """

    filter: Filter[Record] | Delayed[Record]
    predicted: Record
    updated: Record
    last: Record | DelayedBelief[Record]

    def __len__(self) -> int:
        return len(self.updated.mean)

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
        """``(T, ..., q)`` estimates of the unknown input, ``input_delay`` steps late; None: the filter has none."""
        return self.updated.input_mean

    @cached_property
    def log_likelihoods(self) -> np.ndarray:
        """``(T, ...)`` log density of each measurement, given those before it; 0 where none came.

        ``filter.likelihood`` says what it is: "exact"; "diffuse", of the part of the measurements
        that the unknown input cannot explain, in the directions in which nothing is supposed of it;
        or "approximate", of the Gaussian with the filter's own innovation covariance.

        Raises:
            ValueError: if the filter gives no innovation covariance.
        """
        own = getattr(self.filter, "log_likelihood", None)
        if own is None:
            raise ValueError(
                f"{type(self.filter).__name__} has no log_likelihood: make it a Filter, or compare"
                " errors"
            )
        return own(self.predicted, self.updated)

    @property
    def log_likelihood(self) -> np.ndarray:
        """``(...)`` log density of all measurements of a row: the sum of `log_likelihoods` over time."""
        return self.log_likelihoods.sum(0)


def run(
    filter: Filter[Record] | Delayed[Record],
    prior: Gaussian | Record | DelayedBelief[Record],
    y: np.ndarray,
    u: np.ndarray | None = None,
    t: np.ndarray | None = None,
    available: np.ndarray | None = None,
    R: np.ndarray | None = None,
    rng: Rng | int = None,
    first: int = 0,
) -> Series[Record]:
    """Filter a series of measurements.

    The prior is at the first measurement; before every other one there is a prediction. A series
    continues from a belief, ``series.last``, with a prediction before its first measurement, too:
    the results are those of one run.

    Args:
        filter: Any filter, one of your own too: what has ``init``, ``predict`` and ``update``, and
            gives a `Belief`.
        prior: Of the state at the first measurement: mean ``(n,)`` or ``(..., n)``. Or the belief
            after an earlier measurement.
        y: ``(T, ..., p)`` measurements, one series or a batch; a value that is not finite counts as
            missing. For a `Delayed` filter ``(T, ..., ages, p)``, as they come.
        u: ``(T, m)`` or ``(T, ..., m)`` known input at the time of each measurement, held over the
            step that follows. The measurement gets the input at its own time, the prediction that
            of the measurement before.
        t: ``(T,)`` or ``(T, ...)`` times of the measurements, where steps are not all alike. The
            last component of the known input is then the length of the step, which the model
            follows (`sampled`; a function of u); that of a measurement is the step that led to it,
            0 at the first. From a belief, u and t begin with its own: T + 1.
        available: ``(T, ..., p)`` mask of the measurements that arrived; None: all that are finite.
        R: ``(T, ..., p, p)`` covariance of each measurement; None: the model's.
        rng: For filters that draw numbers: a seed, `RandomKeys` with a key a row, or a Generator.
        first: How many measurements there were before: keys and seeds go on with the numbers of
            this step.

    Raises:
        TypeError: if ``filter`` is none.
        ValueError: if a shape does not fit, times go back, or the model does not follow them.
    """
    if isinstance(filter, type) or not all(
        hasattr(filter, name) for name in ("init", "predict", "update")
    ):
        raise TypeError(
            f"filter must be a filter, as estimators.make gives one, got {short_repr(filter)}"
        )
    y, available, R = _measured(y, available, R)
    T, batch = len(y), y.shape[1:-2] if isinstance(filter, Delayed) else y.shape[1:-1]
    _check_timed(filter, t)
    prior, continued = _prior(prior, batch)
    after, at = _known_inputs(u, t, T + continued, batch, continued)
    rng = _numbers(rng, batch)
    _check_first(first, filter, rng, continued)
    loop, belief, predicted, updated = cast(Any, filter), prior, [], []
    for k in range(T):
        now = rng.at(first + k) if isinstance(rng, RandomKeys) else rng
        before = None if after is None else after[k + continued - 1]
        belief = (
            loop.predict(belief, before, rng=now) if k or continued else loop.init(prior, rng=now)
        )
        predicted.append(belief)
        known, mask, cov = (
            None if a is None else a[i] for a, i in ((at, k + continued), (available, k), (R, k))
        )
        belief = loop.update(belief, y[k], rng=now, available=mask, R=cov, u=known)
        updated.append(belief)
    if isinstance(filter, Delayed):
        predicted, updated = (
            [belief.now for belief in beliefs] for beliefs in (predicted, updated)
        )
    if at is not None and not continued:  # of which the prior is told, too
        predicted[0] = predicted[0].replace(u=updated[0].u)
    return Series(filter, over_time(predicted), over_time(updated), belief)


def _measured(
    y: np.ndarray, available: np.ndarray | None, R: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
    """The measurements of a series, checked to have times first."""
    y = as_array("y", y)
    if y.ndim < 2 or len(y) == 0:
        hint = ": one channel has y[:, None]" if y.ndim == 1 else ""
        raise ValueError(f"y has shape {y.shape}, expected (T, ..., p), times first{hint}")
    available = None if available is None else as_mask("available", available)
    R = None if R is None else as_array("R", R)
    for name, array in (("available", available), ("R", R)):
        if array is not None and array.shape[:1] != y.shape[:1]:
            raise ValueError(
                f"{name} has shape {array.shape}, expected one for each of the {len(y)}"
                " measurements of y"
            )
    return y, available, R


def _check_timed(filter: Any, t: np.ndarray | None) -> None:
    """Refuse times for models that do not follow the length of a step."""
    models = [getattr(mode, "model", None) for mode in getattr(filter, "filters", (filter,))]
    constant = [
        isinstance(model, LinearModel) and not any(map(callable, vars(model).values()))
        for model in models
    ]
    if t is not None and all(constant):
        raise ValueError(
            "this model is the same however long a step takes: make it with sampled, or leave out t"
        )


def _check_first(first: int, filter: Any, rng: Rng, continued: bool) -> None:
    """Refuse to use random numbers a second time."""
    keyed = isinstance(rng, RandomKeys) and getattr(filter, "random", False)
    if integer("first", first, 0) == 0 and continued and keyed:
        raise ValueError(
            "first must be how many measurements came before the belief: their random numbers are"
            " used up"
        )


def _numbers(rng: Rng | int, batch: tuple[int, ...]) -> Rng:
    """Random numbers of a seed, one key a row; others as they are."""
    if not isinstance(rng, int | np.integer):
        return rng
    rows = np.arange(int(np.prod(batch))).reshape(batch)
    return RandomKeys(np.broadcast_to(key(integer("rng", rng, 0)), (*batch, 2))).of(rows)


def _prior(prior: Any, batch: tuple[int, ...]) -> tuple[Any, bool]:
    """The prior of a batch, and whether it is a belief after an earlier measurement.

    Raises:
        ValueError: if its rows are not those of y.
    """
    continued = isinstance(prior, Belief | DelayedBelief)
    rows = {"mean": prior.mean.shape[:-1]} if continued or isinstance(prior, Gaussian) else {}
    if isinstance(prior, Gaussian):
        rows["cov"] = prior.cov.shape[:-2]
    for name, own in rows.items():
        if own != batch and (continued or own != ()):
            raise ValueError(
                f"the prior's {name} has rows {own}, y has {batch}: give one, or one for each row"
                " of y"
            )
    if isinstance(prior, Gaussian):
        prior = type(prior)(np.broadcast_to(prior.mean, batch + prior.mean.shape[-1:]), prior.cov)
    return prior, continued


def _known_inputs(
    u: np.ndarray | None, t: np.ndarray | None, T: int, batch: tuple[int, ...], continued: bool
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """The known inputs ``(T, ..., m)`` over the steps that follow measurements, and at the measurements themselves.

    Where times are given the last component is the length of the step: that follows, and that led
    to the measurement.
    """
    more = ", and before them one for that of the belief" if continued else ""
    if u is not None:
        u = as_array("u", u)
        if u.ndim < 2 or len(u) != T:
            raise ValueError(
                f"u has shape {u.shape}, expected ({T}, ..., m): one for each measurement of"
                f" y{more}"
            )
        if u.ndim == 2:
            u = u.reshape(T, *(1,) * len(batch), -1)
    if t is None:
        return u, u
    t = as_array("t", t)
    if t.shape not in ((T,), (T, *batch)):
        raise ValueError(
            f"t has shape {t.shape}, expected ({T},) or {(T, *batch)}: one time for each"
            f" measurement of y{more}"
        )
    if not np.isfinite(t).all() or (np.diff(t, axis=0) < 0.0).any():
        wrong = "hold a time that is not finite" if not np.isfinite(t).all() else "go back"
        raise ValueError(
            f"times t {wrong}: sort the measurements by time, or use Delayed for those that come"
            " late"
        )
    following, leading = np.diff(t, axis=0, append=t[-1:]), np.diff(t, axis=0, prepend=t[:1])
    return _with_lengths(u, following, batch), _with_lengths(u, leading, batch)


def _with_lengths(u: np.ndarray | None, lengths: np.ndarray, batch: tuple[int, ...]) -> np.ndarray:
    """Known inputs ``(T, ..., m)`` and the lengths of steps ``(T, ...)`` beside them."""
    lengths = lengths.reshape(lengths.shape + (1,) * (len(batch) + 2 - lengths.ndim))
    if u is None:
        return lengths
    rows = np.broadcast_shapes(u.shape[:-1], lengths.shape[:-1])
    return np.concatenate([np.broadcast_to(a, rows + a.shape[-1:]) for a in (u, lengths)], -1)
