"""Measurements that come late, or out of order: fused where they belong.

A `Delayed` filter keeps what it believed before each of the last measurements. A measurement of
some steps ago is put into its step, and what came after is repeated with the same inputs,
measurements and random numbers: the belief is then, to the last bit, what it had been if all had
come in time. Nothing is approximated, so it holds for every filter.

Source: Bar-Shalom, Li & Kirubarajan (2001), Estimation with applications to tracking and
navigation, on measurements out of sequence, whose formulas for one step of a linear model this
makes needless.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Generic

import numpy as np

from estimators.belief import Record
from estimators.checks import as_array, as_mask, integer, short_repr
from estimators.filter import Filter as Estimator
from estimators.filter import Rng
from estimators.models import Gaussian
from estimators.randomness import RandomKeys
from estimators.varying import resolve
from estimators.window import Forecast, Run, Step, Window, with_rows


@dataclass(frozen=True, slots=True, eq=False)
class DelayedBelief(Generic[Record]):
    """A belief and the steps that late measurements may still reach; it may be asked for all that the belief may.

    Attributes:
        now: The filter's own belief.
        window: The steps; the last is that of ``now``.
        reach: ``(...)`` how many steps ago a row may still be read: back to where it began, at most
            the horizon.
        refused: ``(...)`` measurements since then that came too late, or a second time.
    """

    now: Record
    window: Window
    reach: np.ndarray
    refused: np.ndarray

    def __getattr__(self, name: str) -> Any:
        if name == "replace" or name.startswith("__"):  # the steps would not know of it
            raise AttributeError(name)
        return getattr(self.now, name)

    def read_only(self) -> "DelayedBelief[Record]":
        """This belief: those of filters are read-only."""
        return self

    def __getitem__(self, rows: Any) -> "DelayedBelief[Record]":
        """The beliefs of some rows of the batch."""
        return DelayedBelief(
            self.now[rows], self.window.rows(rows), self.reach[rows], self.refused[rows]
        )

    def with_rows(
        self, rows: np.ndarray, other: "DelayedBelief[Record]"
    ) -> "DelayedBelief[Record]":
        """This belief with the rows of a mask ``(...)`` replaced, in order, by those of ``other``."""
        k = min(len(self.window.y), len(other.window.y))
        return DelayedBelief(
            self.now.with_rows(rows, other.now), self.window.with_rows(rows, other.window),
            with_rows(self.reach, rows, np.minimum(other.reach, k - 1)), with_rows(self.refused, rows, other.refused),
        )  # fmt: skip


class Delayed(Generic[Record]):
    """A filter to which measurements may come late.

    Its ``update`` takes measurements by age, ``y (..., ages, p)``: ``y[..., 0, :]`` are of now,
    ``y[..., a, :]`` of a steps ago, each NaN or masked unless it comes with this very call. A
    channel has one measurement a step. Measurements that are older than the horizon, of before a
    row began, or that come a second time are refused, and counted in the belief's ``refused``. All
    else is the filter's.

    Args:
        filter: Any filter, one of your own too: what has ``init``, ``predict`` and ``update``.
        horizon: How many steps late a measurement may come. 0: the filter itself, to the last bit.

    Raises:
        TypeError: if ``filter`` is none.
        ValueError: if ``horizon`` is no whole number of at least 0.
    """

    def __init__(self, filter: Estimator[Record], horizon: int) -> None:
        if isinstance(filter, type | Delayed) or not all(
            hasattr(filter, name) for name in ("init", "predict", "update")
        ):
            raise TypeError(
                f"filter must be a filter, as estimators.make gives one, got {short_repr(filter)}"
            )
        self.filter, self.horizon = filter, integer("horizon", horizon, 0)
        self._apart = getattr(
            filter, "_alike", True
        )  # rows can be repeated by themselves: they share one model

    def __getattr__(self, name: str) -> Any:
        if name in ("filter", "horizon", "_apart"):  # not yet set: a copy that is being made
            raise AttributeError(name)
        return getattr(self.filter, name)

    def __repr__(self) -> str:
        return f"Delayed({self.filter!r}, horizon={self.horizon})"

    def init(self, prior: Gaussian, rng: Rng = None) -> DelayedBelief[Record]:
        """The belief before any measurement, as `Filter.init`."""
        return self._initial(self.filter.init(prior, rng=self._keys(rng)), rng)

    def _initial(self, initial: Record, rng: Rng) -> DelayedBelief[Record]:
        nothing = np.zeros(initial.mean.shape[:-1], int)
        return DelayedBelief(
            initial, Window.initial(initial, self.filter.model.p, self._keys(rng)), nothing, nothing
        )

    def predict(
        self, belief: DelayedBelief[Record], u: Any = None, rng: Rng = None
    ) -> DelayedBelief[Record]:
        """One step ahead, as `Filter.predict`."""
        keys, u = self._keys(rng), self._known(belief, u)
        predicted = self.filter.predict(belief.now, u, rng=keys)
        return self._followed(belief, predicted, u, keys)

    def _followed(
        self, belief: DelayedBelief[Record], predicted: Any, u: Any, keys: Any
    ) -> DelayedBelief[Record]:
        window = belief.window.followed(predicted, u, keys, self.horizon + 1)
        now = belief.now if predicted is None else predicted
        return DelayedBelief(
            now, window, np.minimum(belief.reach + 1, self.horizon), belief.refused
        )

    def update(
        self,
        belief: DelayedBelief[Record],
        y: np.ndarray,
        rng: Rng = None,
        available: np.ndarray | None = None,
        R: np.ndarray | None = None,
        u: np.ndarray | None = None,
    ) -> DelayedBelief[Record]:
        """Take in what has come: measurements of now, and late ones.

        Args:
            belief: The predicted belief.
            y: ``(..., ages, p)``; a value that is not finite has not come.
            rng: As for `Filter.update`.
            available: Mask ``(..., ages, p)`` of the measurements that come with this call; None:
                all that are finite.
            R: ``(..., ages, p, p)`` their own covariances; None: the model's.
            u: As for `Filter.update`.

        Raises:
            ValueError: if ``y``, ``available`` or ``R`` have the wrong shape, or another ``u`` came
                before.
        """
        rows, p, window = belief.mean.shape[:-1], self.filter.model.p, belief.window
        y = as_array("y", y)
        if y.ndim < 2 or y.shape[-1] != p or y.shape[:-2] != rows:
            raise ValueError(
                f"y has shape {y.shape}, expected {(*rows, 'ages', p)}: measurements by age, those"
                " of now first"
            )
        arrived, u = np.isfinite(y), self._known(belief, u)
        if available is not None:
            arrived = arrived & _fitting("available", as_mask("available", available), y.shape)
        if R is not None:
            R = _fitting("R", as_array("R", R), (*y.shape, p))
            arrived = arrived & np.isfinite(np.diagonal(R, axis1=-2, axis2=-1))
        if u is not None:
            now = window.step(-1)
            self._check_one_input(now, u)
            own = None if np.array_equal(now.predicted.u, u) else u
            window = window._replace(measurement_u=(*window.measurement_u[:-1], own))
        return self.correct(replace(belief, window=window), y, arrived, R, rng)

    def correct(
        self,
        belief: DelayedBelief[Record],
        y: np.ndarray,
        available: np.ndarray,
        R: np.ndarray | None,
        rng: Rng,
    ) -> DelayedBelief[Record]:
        """`update` without checks."""
        window = belief.window
        own = (array.copy() for array in (window.y, window.available, window.read))
        return self._corrected(
            replace(belief, window=Window(*window[:6], *own)), y, available, R, rng
        )

    def _corrected(
        self,
        belief: DelayedBelief[Record],
        y: np.ndarray,
        available: np.ndarray,
        R: np.ndarray | None,
        rng: Rng,
    ) -> DelayedBelief[Record]:
        """The same, where the window's measurements belong to it alone."""
        window, reach, refused, oldest = (
            belief.window,
            belief.reach,
            belief.refused,
            np.zeros(belief.reach.shape, int),
        )
        window.read[-1], newest, own_R = True, len(window.y) - 1, list(window.R)
        by_age = np.moveaxis(available, -2, 0).reshape(y.shape[-2], -1)
        for age in np.flatnonzero(by_age.any(1)).tolist():
            values, i = y[..., age, :], newest - age
            new = available[..., age, :] & np.isfinite(values)
            if i >= 0:
                accepted = new & (age <= reach)[..., None] & ~window.available[i]
                if R is not None or own_R[i] is not None:
                    own_R[i] = _merged_R(
                        own_R[i],
                        window.available[i],
                        accepted,
                        None if R is None else R[..., age, :, :],
                    )
                np.copyto(window.y[i], values, where=accepted)
                window.available[i] |= accepted
                rows = accepted.any(-1)
                window.read[i] |= rows
                oldest = np.where(rows, age, oldest)
                new ^= accepted
            if new.any():
                refused = refused + new.sum(-1)
        window = window._replace(R=tuple(own_R), keys=(*window.keys[:-1], self._keys(rng)))
        now, window = self._repeated(window, oldest, reach, belief.now)
        return DelayedBelief(now, window, reach, refused)

    def begin(
        self, prior: Gaussian, u: Any, y: np.ndarray, available: np.ndarray, rng: Rng
    ) -> DelayedBelief[Record]:
        """`init`, then `update`, without checks; ``u (..., m)`` is the known input of the first measurement."""
        initial = self.filter.start(prior, self._keys(rng), u)
        return self._corrected(self._initial(initial, rng), y, available, None, rng)

    def advance(
        self, belief: DelayedBelief[Record], u: Any, y: np.ndarray, available: np.ndarray, rng: Rng
    ) -> DelayedBelief[Record]:
        """`predict`, then `update`, without checks."""
        return self._corrected(
            self._followed(belief, None, u, self._keys(rng)), y, available, None, rng
        )

    def _repeated(
        self, window: Window, oldest: np.ndarray, reach: np.ndarray, before: Any
    ) -> tuple[Any, Window]:
        """The belief now; each row is predicted anew in the steps since its oldest new measurement.

        Args:
            window: With these measurements.
            oldest: ``(...)`` how many steps ago the oldest new one of each row was taken.
            reach: ``(...)`` as in `DelayedBelief`.
            before: The belief before the last step, where that is still to be predicted.

        Returns:
            It, and the window with these predictions.
        """
        late = oldest > 0
        many = (
            4 * late.sum() > late.size
        )  # all rows are computed sooner than some of them are taken out
        found = self._together(window, int(oldest.max()), reach, before) if many else None
        if found is not None:
            window = found
        else:
            if window.predicted[-1] is None:
                window = window.with_predicted(self._forecast(before, window.step(-1)))
            for age in sorted({*oldest[late].tolist()}):
                window = self._alone(window, age, late & (oldest == age))
        return self._read(window.step(-1)), window

    def _together(self, window: Window, age: int, reach: np.ndarray, before: Any) -> Window | None:
        """The window with new predictions of all rows, each since its oldest step; None: the filter cannot."""
        some, wait = window.last(age + 1), age - np.minimum(reach, age)
        if not self._repeats(some):
            return None
        belief, start = some.belief(0), some.predicted[0]
        if wait.any():
            packed, layout = belief.pack()
            packed = np.array(packed)
            for k in {*wait.tolist()} - {0}:
                rows, initial = np.flatnonzero(wait == k), some.predicted[k]
                found = initial.run.like if isinstance(initial, Forecast) else initial
                if found.pack()[1] is not layout:
                    return None
                packed[rows] = (
                    initial.rows(rows) if isinstance(initial, Forecast) else found.pack()[0][rows]
                )
            belief = belief.view(packed, layout, before.prior_mean, before.prior_cov, belief.u)
        # The next late measurement is likely to be of as many steps after this one as this is after
        # the one before.
        next_step = start.step if isinstance(start, Forecast) else age
        forecasts = self._forecasts(
            some, belief, wait, sorted({*range(min(next_step + 1, age)), age - 1})
        )
        return None if forecasts is None else window.with_predicted(*forecasts)

    def _alone(self, window: Window, age: int, rows: np.ndarray) -> Window:
        """The window with predictions of ``rows`` alone that are made anew in the last steps."""
        apart = self._apart and not rows.all()
        some = window.last(age + 1)
        if apart:
            some = some.rows(rows)
        belief = some.belief(0)
        found = (
            self._forecasts(some, belief, np.zeros(len(some.y[0]), int), range(age))
            if self._repeats(some)
            else None
        )
        if found is None:
            found = []
            for i in range(age):
                belief = self._forecast(
                    self._after(some.step(i)._replace(predicted=belief)), some.step(i + 1)
                )
                found.append(belief)
        if not rows.all():
            made = Window(tuple(found), *some.last(age)[1:])
            found = [
                window.belief(i).with_rows(rows, made.belief(i) if apart else made.belief(i)[rows])
                for i in range(-age, 0)
            ]
        return window.with_predicted(*found)

    def _repeats(self, window: Window) -> bool:
        """May programs predict these steps? All were read, with the model's R and the input of their prediction."""
        plain = isinstance(self.filter, Estimator) and not self.filter.random and window.y.ndim == 3
        own = any(
            each is not None for some in (window.R[:-1], window.measurement_u[:-1]) for each in some
        )
        return plain and not own and bool(window.read[:-1].all())

    def _forecasts(
        self, window: Window, belief: Any, wait: np.ndarray, kept: Sequence[int]
    ) -> list[Forecast] | None:
        """Predictions of all steps of a window but the first, in programs; None: the filter cannot.

        Args:
            window: The steps.
            belief: The prediction of the first one, or for some rows of a later one.
            wait: ``(rows,)`` how many steps later that is.
            kept: Those that are likely to be read.
        """
        inputs: list[Any] = [belief.u, *window.u[1:]]
        known = [each is not None for each in inputs]
        if any(known) and not all(known):
            return None
        filter: Any = self.filter
        like = filter.record.view(*belief.pack(), belief.prior_mean, belief.prior_cov, belief.u)
        u = np.stack(inputs) if all(known) else None
        forecasts = partial(
            filter.forecast_steps, like, u, window.y[:-1], window.available[:-1], wait
        )
        run = Run(forecasts, like, wait, len(window.y) - 1, kept)
        return None if run.found is None else [Forecast(run, step) for step in range(run.steps)]

    def _forecast(self, belief: Any, step: Step) -> Any:
        predict: Any = getattr(self.filter, "forecast", self.filter.predict)
        return predict(belief, step.u, step.moved)

    def _check_one_input(self, step: Step, u: np.ndarray) -> None:
        """Refuse another known input for a step of which measurements have come: they are taken in together.

        Raises:
            ValueError: saying so.
        """
        before = step.predicted.u if step.measurement_u is None else step.measurement_u
        other = np.ones(u.shape, bool) if before is None or before.shape != u.shape else before != u
        if (step.available.any(-1, keepdims=True) & other).any():
            raise ValueError(
                "u must be the same for all measurements of a step: Delayed takes them in together"
            )

    likelihood, sequential = "refused", True

    def log_likelihood(self, predicted: Any, updated: Any) -> np.ndarray:
        """Refused: what a measurement was worth is known when those before it have come.

        Raises:
            ValueError: always.
        """
        raise ValueError(
            "measurements that come late have a likelihood once they are sorted: run the filter"
            " itself on them"
        )

    def _keys(self, rng: Rng) -> RandomKeys | None:
        """The random numbers, where there are any, which can be drawn again."""
        if not getattr(self.filter, "random", False):
            return None
        if isinstance(rng, np.random.Generator):
            raise TypeError(
                "a late measurement repeats random numbers: give rng as keys"
                " (estimators.RandomKeys)"
            )
        return rng

    def _known(self, belief: DelayedBelief[Record], u: Any) -> np.ndarray | None:
        """The known input, a row each and of our own, to be repeated apart."""
        if not isinstance(belief, DelayedBelief):
            raise TypeError(
                f"belief must be a DelayedBelief, got {type(belief).__name__}: begin with"
                " init(prior)"
            )
        if u is None:
            return None
        u = np.atleast_1d(as_array("u", u))
        return np.array(_fitting("u", u, belief.mean.shape[:-1] + u.shape[-1:]))

    def _read(self, step: Step, rows: Any = ...) -> Any:
        """Some rows after the measurements of this step so far; as they were predicted where there was no update."""
        if not self._apart:
            return self._after(step) if rows is ... else self._after(step)[rows]
        return self._after(step.rows(rows))

    def _after(self, step: Step) -> Any:
        predicted, _, R, keys, u, _, y, available, read = step
        if not read.all():
            updated = (
                self._after(step._replace(read=np.ones(read.shape, bool))) if read.any() else None
            )
            return predicted if updated is None else predicted.with_rows(read, updated[read])
        filter: Any = self.filter
        if u is not None and predicted.u is not None:
            u = np.where(np.isnan(u), predicted.u, u)
        if R is not None:
            usual = (
                filter._own_R(predicted)
                if hasattr(filter, "_own_R")
                else resolve(filter.model.R, predicted.u)
            )
            R = np.where(np.isnan(R), usual, R)
        elif isinstance(filter, Estimator):
            met = predicted if u is None else predicted.with_input(u)
            return filter.correct(met, y, available, None, keys).read_only()
        return filter.update(predicted, y, rng=keys, available=available, R=R, u=u)


def _merged_R(
    before: np.ndarray | None, available: np.ndarray, accepted: np.ndarray, R: np.ndarray | None
) -> np.ndarray:
    """R of the measurements ``available (..., p)`` before, and those ``accepted``; NaN where none brought its own."""
    together, one = (
        accepted[..., None] & accepted[..., None, :],
        accepted[..., None] ^ accepted[..., None, :],
    )
    # those of different calls have nothing in common
    return np.where(
        together,
        np.nan if R is None else R,
        np.where(one, 0.0, np.nan if before is None else before),
    )


def _fitting(name: str, values: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    try:
        return np.broadcast_to(values, shape)
    except ValueError:
        raise ValueError(f"{name} has shape {values.shape}, expected {shape}") from None


def by_age(y: np.ndarray, delay: np.ndarray) -> np.ndarray:
    """Measurements ``(T, ..., ages, p)`` as they come, for `Delayed`, of those ``y (T, ..., p)`` as they were taken.

    Args:
        y: Times first; NaN where none was taken.
        delay: Whole steps by which each comes late, broadcast to y. What comes after the last time
            is not in it.

    Raises:
        ValueError: if delays are negative or no whole numbers.
    """
    y = as_array("y", y)
    if y.ndim < 2 or len(y) == 0:
        raise ValueError(f"y has shape {y.shape}, expected (T, ..., p), times first")
    late = _fitting("delay", as_array("delay", delay), y.shape)
    if not ((late >= 0.0) & (late == np.rint(late))).all():
        raise ValueError("delay must be whole numbers of steps of at least 0")
    ages = int(late[late < len(y)].max(initial=0.0)) + 1  # what comes later does not come at all
    arrived = np.full((*y.shape[:-1], ages, y.shape[-1]), np.nan)
    for age in range(min(ages, len(y))):
        arrived[age:, ..., age, :] = np.where(late == age, y, np.nan)[: len(y) - age]
    return arrived
