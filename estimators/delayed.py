"""Measurements that come late, or out of order: fused where they belong.

A `Delayed` filter keeps what it believed before each of the last measurements. A measurement of some steps ago is put
into its step, and what came after is repeated with the same inputs, measurements and random numbers: the belief is
then, to the last bit, what it had been if all had come in time. Nothing is approximated, so it holds for every filter.

Source: Bar-Shalom, Li & Kirubarajan (2001), Estimation with applications to tracking and navigation, on measurements
out of sequence, whose formulas for one step of a linear model this makes needless.
"""

from dataclasses import dataclass, replace
from typing import Any, Generic, NamedTuple, cast

import numpy as np

from estimators.belief import Record
from estimators.checks import as_array, as_mask, integer, short_repr
from estimators.contract import Estimator, Rng
from estimators.models import Gaussian
from estimators.randomness import RandomKeys
from estimators.varying import resolve


class Step(NamedTuple):
    """One step that a late measurement may still reach."""

    predicted: Any  # belief that its measurements meet; None: it is still to be made
    u: np.ndarray | None  # (..., m) known input of the prediction
    moved: RandomKeys | None  # random numbers of it
    y: np.ndarray  # (..., p) what has come of its measurements so far
    available: np.ndarray  # (..., p)
    R: np.ndarray | None  # (..., p, p) of measurements that brought their own, NaN where none did
    read: np.ndarray  # (...) whether there was an update
    keys: RandomKeys | None  # random numbers of that
    measurement_u: np.ndarray | None  # (..., m) known input of the measurements, where it was given with them

    def rows(self, rows: Any) -> "Step":
        """Some rows of the step."""
        some: Any = (None if one is None else one[rows] for one in self)
        return self if rows is ... else Step(*some)

    def with_rows(self, rows: np.ndarray, other: "Step") -> "Step":
        """The same step with some rows of another."""
        merged = (_with_rows(mine, rows, theirs) for mine, theirs in zip(self[1:], other[1:], strict=True))
        step = Step(self.predicted.with_rows(rows, other.predicted), *merged)
        return step if step.predicted.u is None else step._replace(u=step.predicted.u)  # rows without one have zeros


@dataclass(frozen=True, slots=True, eq=False)
class DelayedBelief(Generic[Record]):
    """A belief and the steps that late measurements may still reach; it may be asked for all that the belief may.

    Attributes:
        now: The filter's own belief.
        steps: Oldest first; the last is that of ``now``.
        reach: ``(...)`` how many steps ago a row may still be read: back to where it began, at most the horizon.
        refused: ``(...)`` measurements since then that came too late, or a second time.
    """

    now: Record
    steps: tuple[Step, ...]
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
            self.now[rows], tuple(step.rows(rows) for step in self.steps), self.reach[rows], self.refused[rows]
        )

    def with_rows(self, rows: np.ndarray, other: "DelayedBelief[Record]") -> "DelayedBelief[Record]":
        """This belief with the rows of a mask ``(...)`` replaced, in order, by those of ``other``."""
        k = min(len(self.steps), len(other.steps))  # the newest meet; what lies before a row's first is out of reach
        steps = (a.with_rows(rows, b) for a, b in zip(self.steps[-k:], other.steps[-k:], strict=True))
        return DelayedBelief(
            self.now.with_rows(rows, other.now), (*self.steps[:-k], *steps),
            _with_rows(self.reach, rows, np.minimum(other.reach, k - 1)), _with_rows(self.refused, rows, other.refused),
        )  # fmt: skip


class Delayed(Generic[Record]):
    """A filter to which measurements may come late.

    Its ``update`` takes measurements by age, ``y (..., ages, p)``: ``y[..., 0, :]`` are of now, ``y[..., a, :]`` of a
    steps ago, each NaN or masked unless it comes with this very call. A channel has one measurement a step.
    Measurements that are older than the horizon, of before a row began, or that come a second time are refused, and
    counted in the belief's ``refused``. All else is the filter's.

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
            raise TypeError(f"filter must be a filter, as estimators.make gives one, got {short_repr(filter)}")
        self.filter, self.horizon = filter, integer("horizon", horizon, 0)
        self._apart = getattr(filter, "_alike", True)  # rows can be repeated by themselves: they share one model

    def __getattr__(self, name: str) -> Any:
        if name in ("filter", "horizon", "_apart"):  # not yet set: a copy that is being made
            raise AttributeError(name)
        return getattr(self.filter, name)

    def __repr__(self) -> str:
        return f"Delayed({self.filter!r}, horizon={self.horizon})"

    def init(self, prior: Gaussian, rng: Rng = None) -> DelayedBelief[Record]:
        """The belief before any measurement, as `Filter.init`."""
        return self._begun(self.filter.init(prior, rng=self._keys(rng)), rng)

    def _begun(self, begun: Record, rng: Rng) -> DelayedBelief[Record]:
        nothing = np.zeros(begun.mean.shape[:-1], int)
        return DelayedBelief(
            begun, (self._step(begun, begun.mean.shape[:-1], None, self._keys(rng)),), nothing, nothing
        )

    def predict(self, belief: DelayedBelief[Record], u: Any = None, rng: Rng = None) -> DelayedBelief[Record]:
        """One step ahead, as `Filter.predict`."""
        keys, u = self._keys(rng), self._known(belief, u)
        predicted = self.filter.predict(belief.now, u, rng=keys)
        steps = (*belief.steps, self._step(predicted, belief.reach.shape, u, keys))[-self.horizon - 1 :]
        return DelayedBelief(predicted, steps, np.minimum(belief.reach + 1, self.horizon), belief.refused)

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
            available: Mask ``(..., ages, p)`` of the measurements that come with this call; None: all that are finite.
            R: ``(..., ages, p, p)`` their own covariances; None: the model's.
            u: As for `Filter.update`.

        Raises:
            ValueError: if ``y``, ``available`` or ``R`` have the wrong shape, or another ``u`` came before.
        """
        rows, p, now = belief.mean.shape[:-1], self.filter.model.p, belief.steps[-1]
        y = as_array("y", y)
        if y.ndim < 2 or y.shape[-1] != p or y.shape[:-2] != rows:
            raise ValueError(
                f"y has shape {y.shape}, expected {(*rows, 'ages', p)}: measurements by age, those of now first"
            )
        come, u = np.isfinite(y), self._known(belief, u)
        if available is not None:
            come = come & _fitting("available", as_mask("available", available), y.shape)
        if R is not None:
            R = _fitting("R", as_array("R", R), (*y.shape, p))
            come = come & np.isfinite(np.diagonal(R, axis1=-2, axis2=-1))
        if u is not None:
            self._check_one_input(now, u)
            now = now._replace(measurement_u=None if np.array_equal(now.predicted.u, u) else u)
        return self.correct(replace(belief, steps=(*belief.steps[:-1], now)), y, come, R, rng)

    def correct(
        self, belief: DelayedBelief[Record], y: np.ndarray, available: np.ndarray, R: np.ndarray | None, rng: Rng
    ) -> DelayedBelief[Record]:
        """`update` without checks."""
        rows, steps, refused = belief.reach.shape, list(belief.steps), belief.refused
        available = available & np.isfinite(y)
        steps[-1] = steps[-1]._replace(read=np.ones(rows, bool), keys=self._keys(rng))
        oldest = np.zeros(rows, int)
        for age in np.flatnonzero(np.moveaxis(available, -2, 0).reshape(y.shape[-2], -1).any(-1)).tolist():
            new = available[..., age, :]
            if age < len(steps):
                step = steps[-1 - age]
                taken = new & (age <= belief.reach)[..., None] & ~step.available
                steps[-1 - age] = _taken(step, y[..., age, :], taken, None if R is None else R[..., age, :, :])
                oldest = np.where(taken.any(-1), age, oldest)
                new = new & ~taken
            refused = refused + new.sum(-1)
        now = self._repeated(steps, oldest, belief.reach, belief.now)
        return DelayedBelief(now, tuple(steps), belief.reach, refused)

    def begin(self, prior: Gaussian, u: Any, y: np.ndarray, available: np.ndarray, rng: Rng) -> DelayedBelief[Record]:
        """`init`, then `update`, without checks; ``u (..., m)`` is the known input of the first measurement."""
        begun = self.filter.start(prior, self._keys(rng), u)
        return self.correct(self._begun(begun, rng), y, available, None, rng)

    def advance(
        self, belief: DelayedBelief[Record], u: Any, y: np.ndarray, available: np.ndarray, rng: Rng
    ) -> DelayedBelief[Record]:
        """`predict`, then `update`, without checks."""
        steps = (*belief.steps, self._step(None, belief.reach.shape, u, self._keys(rng)))[-self.horizon - 1 :]
        reach = np.minimum(belief.reach + 1, self.horizon)
        return self.correct(DelayedBelief(belief.now, steps, reach, belief.refused), y, available, None, rng)

    def _repeated(self, steps: list[Step], oldest: np.ndarray, reach: np.ndarray, before: Any) -> Any:
        """The belief now; each row is predicted anew in the steps since its oldest new measurement.

        Args:
            steps: The window, of which some are replaced.
            oldest: ``(...)`` age of the oldest measurement that is new in a row.
            reach: ``(...)`` as in `DelayedBelief`.
            before: The belief before the last step, where that is still to be predicted.
        """
        late, now = oldest > 0, None
        rest = ~late
        if 4 * late.sum() > late.size:
            rows = reach >= oldest.max()
            now = self._together(steps, int(oldest.max()), rows, before)
        if now is not None:
            late, rest = late & ~rows, rest & ~rows
        elif steps[-1].predicted is None:
            steps[-1] = steps[-1]._replace(predicted=self._forecast(before, steps[-1]))
        ages = np.unique(oldest[late]).tolist()
        pieces = [(rows, self._alone(steps, age, rows)) for age in ages for rows in [late & (oldest == age)]]
        if now is None:
            if len(pieces) == 1 and not rest.any():
                return pieces[0][1]
            now = self._read(steps[-1])
        elif rest.any():
            pieces.append((rest, self._read(steps[-1], rest)))
        for rows, belief in pieces:
            now = now.with_rows(rows, belief)
        return now

    def _together(self, steps: list[Step], age: int, rows: np.ndarray, before: Any) -> Any:
        """The belief of ``rows``, predicted anew in the last steps with all others; None: the filter cannot.

        Others keep their predictions, and are believed anything now: many rows are computed sooner than taken out.
        """
        window, kept = steps[-1 - age :], None
        if not rows.all():
            packs = [step.predicted.pack() for step in window if step.predicted is not None]
            if any(layout is not packs[0][1] for _, layout in packs):
                return None
            kept = np.flatnonzero(~rows), [packed for packed, _ in packs[1:]]
        found = self._forecast_steps(window, before, kept)
        if found is None:
            return None
        steps[-age:] = (step._replace(predicted=own) for step, own in zip(window[1:], found, strict=True))
        return self._read(steps[-1])

    def _forecast_steps(self, window: list[Step], like: Any, kept: Any = None) -> list[Any] | None:
        """Predictions of all steps of a window but the first; None: the filter cannot.

        Args:
            window: Of the first the prediction is read, and all measurements but the last.
            like: A belief of these rows, with their priors.
            kept: As in `Estimator.forecast_steps`.
        """
        belief = window[0].predicted
        inputs: list[Any] = [belief.u, *(step.u for step in window[1:])]
        if not self._repeats(window[:-1]) or any((one is None) != (inputs[0] is None) for one in inputs):
            return None
        y, available = np.stack([step.y for step in window[:-1]]), np.stack([step.available for step in window[:-1]])
        u = None if inputs[0] is None else np.stack(inputs)
        found = cast(Any, self.filter).forecast_steps(belief, u, y, available, kept)
        if found is None:
            return None
        packed, layout = found
        prior = like.prior_mean, like.prior_cov
        return [belief.view(values, layout, *prior, step.u) for values, step in zip(packed, window[1:], strict=True)]

    def _alone(self, steps: list[Step], age: int, rows: np.ndarray) -> Any:
        """The belief of ``rows``, taken out and predicted anew in the last steps."""
        chosen: Any = rows if self._apart and not rows.all() else ...
        first, *after = steps[-1 - age :]
        window = [first.rows(chosen), *(step._replace(predicted=None).rows(chosen) for step in after)]
        found = self._forecast_steps(window, window[0].predicted)
        if found is None:
            found, step = [], window[0]
            for following in window[1:]:
                step = following._replace(predicted=self._forecast(self._after(step), following))
                found.append(step.predicted)
        for i, predicted in enumerate(found, -age):
            if not rows.all():
                predicted = steps[i].predicted.with_rows(rows, predicted if chosen is rows else predicted[rows])
            steps[i] = steps[i]._replace(predicted=predicted)
        now = self._after(window[-1]._replace(predicted=found[-1]))
        return now if chosen is rows or rows.all() else now[rows]

    def _repeats(self, steps: list[Step]) -> bool:
        """May these steps be one program? All were read, with the model's R and the input of their prediction."""
        plain = isinstance(self.filter, Estimator) and not self.filter.random and steps[0].y.ndim == 2
        return plain and all(step.R is None and step.measurement_u is None and step.read.all() for step in steps)

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
            raise ValueError("u must be the same for all measurements of a step: Delayed takes them in together")

    def fixed_lag(self, belief: DelayedBelief[Record]) -> tuple[np.ndarray, Record | None]:
        """The fixed-lag estimate, which no measurement will change any more: each is of at least ``horizon`` steps ago.

        Returns:
            Mask ``(...)`` of the rows that are older than the horizon, and what these believed so many steps ago, after
            all measurements of that step: its innovations are those of a filter to which nothing comes late. None: no
            row is so old.
        """
        rows = belief.reach == self.horizon
        return rows, self._read(belief.steps[0], rows) if rows.any() else None

    likelihood, sequential = "refused", True

    def log_likelihood(self, predicted: Any, updated: Any) -> np.ndarray:
        """Refused: what a measurement was worth is known when those before it have come.

        Raises:
            ValueError: always.
        """
        raise ValueError(
            "measurements that come late have a likelihood once they are sorted: run the filter itself on them"
        )

    def _keys(self, rng: Rng) -> RandomKeys | None:
        """The random numbers, where there are any, which can be drawn again."""
        if not getattr(self.filter, "random", False):
            return None
        if isinstance(rng, np.random.Generator):
            raise TypeError("a late measurement repeats random numbers: give rng as keys (estimators.RandomKeys)")
        return rng

    def _step(self, predicted: Any, rows: tuple[int, ...], u: np.ndarray | None, moved: RandomKeys | None) -> Step:
        """A step of which nothing has been read; what is read later draws the numbers of the prediction."""
        nothing = np.zeros((*rows, self.filter.model.p))
        return Step(predicted, u, moved, nothing, nothing != 0.0, None, np.zeros(rows, bool), moved, None)

    def _known(self, belief: DelayedBelief[Record], u: Any) -> np.ndarray | None:
        """The known input, a row each and of our own, to be repeated apart."""
        if not isinstance(belief, DelayedBelief):
            raise TypeError(f"belief must be a DelayedBelief, got {type(belief).__name__}: begin with init(prior)")
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
        predicted, _, _, y, available, R, read, keys, u = step
        if not read.all():
            updated = self._after(step._replace(read=np.ones(read.shape, bool))) if read.any() else None
            return predicted if updated is None else predicted.with_rows(read, updated[read])
        filter: Any = self.filter
        if u is not None and predicted.u is not None:
            u = np.where(np.isnan(u), predicted.u, u)
        if R is not None:
            usual = filter._own_R(predicted) if hasattr(filter, "_own_R") else resolve(filter.model.R, predicted.u)
            R = np.where(np.isnan(R), usual, R)
        elif isinstance(filter, Estimator):
            met = predicted if u is None else predicted.with_input(u)
            return filter.correct(met, y, available, None, keys).read_only()
        return filter.update(predicted, y, rng=keys, available=available, R=R, u=u)


def _taken(step: Step, y: np.ndarray, taken: np.ndarray, R: np.ndarray | None) -> Step:
    """The step with the measurements ``taken (..., p)`` of ``y (..., p)``."""
    if R is not None or step.R is not None:  # those of different calls have nothing in common
        together, one = taken[..., None] & taken[..., None, :], taken[..., None] ^ taken[..., None, :]
        before = np.nan if step.R is None else step.R
        R = np.where(together, np.nan if R is None else R, np.where(one, 0.0, before))
    return step._replace(
        y=np.where(taken, y, step.y), available=step.available | taken, R=R,
        read=step.read | taken.any(-1),
    )  # fmt: skip


def _fitting(name: str, values: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    try:
        return np.broadcast_to(values, shape)
    except ValueError:
        raise ValueError(f"{name} has shape {values.shape}, expected {shape}") from None


def _with_rows(mine: Any, rows: np.ndarray, theirs: Any) -> Any:
    """Arrays or keys with some rows of others; where one has none, its rows have nothing that is ever looked at."""
    some = theirs if mine is None else mine
    if isinstance(some, RandomKeys):
        keys = (None if one is None else one.keys for one in (mine, theirs))
        steps = (None if one is None else np.broadcast_to(one.step, one.keys.shape[:-1]) for one in (mine, theirs))
        (my_keys, their_keys), (my_step, their_step) = keys, steps
        return RandomKeys(_with_rows(my_keys, rows, their_keys), _with_rows(my_step, rows, their_step))
    if some is None:
        return None
    nothing = np.nan if some.dtype == float else 0
    if mine is None:
        mine = np.full(rows.shape + theirs.shape[1:], nothing, theirs.dtype)
    merged = np.array(mine)
    merged[rows] = nothing if theirs is None else theirs
    return merged


def by_age(y: np.ndarray, delay: np.ndarray) -> np.ndarray:
    """Measurements ``(T, ..., ages, p)`` as they come, for `Delayed`, of those ``y (T, ..., p)`` as they were taken.

    Args:
        y: Times first; NaN where none was taken.
        delay: Whole steps by which each comes late, broadcast to y. What comes after the last time is not in it.

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
    come = np.full((*y.shape[:-1], ages, y.shape[-1]), np.nan)
    for age in range(min(ages, len(y))):
        come[age:, ..., age, :] = np.where(late == age, y, np.nan)[: len(y) - age]
    return come
