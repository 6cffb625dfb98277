"""Measurements that come late or out of order: each is fused at the step that it belongs to.

A `Delayed` filter keeps its predictions of the last steps. A measurement of some steps ago is put
into its step, and all steps since then are repeated with the same inputs, measurements and random
numbers. The belief is then the same, to the last bit, as if all measurements had come in time;
``healthy`` tells of trouble in the repeated steps, too.
Nothing is approximated, so this works for every filter. A step without an update is repeated with
an update that has no measurements.

Source: Bar-Shalom, Li & Kirubarajan (2001), Estimation with applications to tracking and
navigation, on measurements out of sequence; their formulas for one step of a linear model are not
needed here.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, Self

import numpy as np

from estimators.checks import as_mask, broadcast, integer, known_input, shaped_array, short_repr
from estimators.filter import Filter, Rng
from estimators.models import Gaussian
from estimators.randomness import RandomKeys


class Step(NamedTuple):
    """One step that a late measurement may still reach.

    Attributes:
        predicted: The belief before its measurements; its ``u`` is their known input.
        u: ``(..., m)`` known input of the prediction that led to it.
        predict_keys: Random numbers of that prediction.
        update_keys: Random numbers of the update.
        y: ``(..., p)`` measurements of the step that have come so far.
        available: ``(..., p)`` mask of these.
    """

    predicted: Any
    u: np.ndarray | None
    predict_keys: RandomKeys | None
    update_keys: RandomKeys | None
    y: np.ndarray
    available: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class DelayedBelief:
    """A belief and the steps that late measurements may still reach.

    The attributes of ``now`` are attributes of this record, too.

    Attributes:
        now: The filter's own belief.
        steps: The steps, oldest first; the last is that of ``now``.
        reach: ``(...)`` greatest age in steps of a measurement that each system of the batch
            accepts: the number of steps since its `init`, at most the horizon.
        refused: ``(...)`` number of measurements refused since the system's `init`, because they
            came too late or a second time.
    """

    now: Any
    steps: tuple[Step, ...]
    reach: np.ndarray
    refused: np.ndarray

    def __getattr__(self, name: str) -> Any:
        if name == "replace":  # the steps would not know of it
            raise AttributeError(name)
        return getattr(self.now, name)

    def __getitem__(self, rows: Any) -> Self:
        """The beliefs of some rows of the batch."""
        some: Any = ([None if a is None else a[rows] for a in step] for step in self.steps)
        steps = tuple(Step(*each) for each in some)
        return type(self)(self.now[rows], steps, self.reach[rows], self.refused[rows])

    def with_rows(self, rows: np.ndarray, other: Self) -> Self:
        """A copy in which ``other`` replaces the selected rows, see `Belief.with_rows`."""
        steps = list(self.steps)
        for i in range(-min(len(steps), len(other.steps)), 0):
            steps[i] = Step(*map(partial(_with_rows, rows), steps[i], other.steps[i]))
        reach = _with_rows(rows, self.reach, np.minimum(other.reach, len(steps) - 1))
        refused = _with_rows(rows, self.refused, other.refused)
        return type(self)(self.now.with_rows(rows, other.now), tuple(steps), reach, refused)


class Delayed:
    """A filter that accepts measurements that come late.

    Its ``update`` takes measurements by age, ``y (..., ages, p)``: ``y[..., 0, :]`` are
    measurements of the present step, ``y[..., a, :]`` those of ``a`` steps ago. Each is NaN or
    masked unless it comes with this call. A channel has one measurement a step. Measurements are
    refused if they are older than the horizon, date from before the `init` of their row of the
    batch, or come a second time; the belief's ``refused`` counts them. Everything else is as in the
    filter.

    Args:
        filter: Any filter, also one of your own: an object with ``init``, ``predict`` and
            ``update``.
        horizon: Largest number of steps by which a measurement may be late. 0 gives the results of
            the filter itself, to the last bit.

    Raises:
        TypeError: if ``filter`` is not a filter.
        ValueError: if ``horizon`` is not a whole number of at least 0.
    """

    likelihood = "refused"

    def __init__(self, filter: Filter[Any], horizon: int) -> None:
        if isinstance(filter, type) or not hasattr(filter, "update"):
            raise TypeError(
                f"filter must be a filter, as estimators.make gives one, got {short_repr(filter)}"
            )
        self.filter, self.horizon = filter, integer("horizon", horizon, 0)

    def __getattr__(self, name: str) -> Any:
        if name == "filter":  # not yet set: a copy that is being made
            raise AttributeError(name)
        return getattr(self.filter, name)

    def init(self, prior: Gaussian, rng: Rng = None) -> DelayedBelief:
        """The belief before any measurement, as `Filter.init`."""
        keys = self._repeatable_keys(rng)
        initial = self.filter.init(prior, rng=keys)
        none = np.zeros(initial.mean.shape[:-1], int)
        return DelayedBelief(initial, (self._new_step(initial, None, keys),), none, none)

    def predict(self, belief: DelayedBelief, u: Any = None, rng: Rng = None) -> DelayedBelief:
        """One step ahead, as `Filter.predict`."""
        keys, u = self._repeatable_keys(rng), self._known_input(belief, u)
        predicted = self.filter.predict(belief.now, u, rng=keys)
        steps = (*belief.steps, self._new_step(predicted, u, keys))[-self.horizon - 1 :]
        reach = np.minimum(belief.reach + 1, self.horizon)
        return DelayedBelief(predicted, steps, reach, belief.refused)

    def update(
        self,
        belief: DelayedBelief,
        y: np.ndarray,
        rng: Rng = None,
        available: np.ndarray | None = None,
        R: None = None,
        u: np.ndarray | None = None,
    ) -> DelayedBelief:
        """Correct the belief by the measurements that have come, present and late ones.

        Args:
            belief: The predicted belief.
            y: ``(..., ages, p)``; a value that is not finite counts as not yet come.
            rng: As for `Filter.update`.
            available: Mask ``(..., ages, p)`` of the measurements that come with this call; None:
                all that are finite.
            R: Must be None: measurements have the covariance of the model.
            u: As for `Filter.update`, for the measurements of the present step.

        Raises:
            ValueError: if ``y`` or ``available`` have the wrong shape, R is given, or ``u`` differs
                from that of an earlier update of this step.
        """
        if R is not None:
            raise ValueError("Delayed takes no R: measurements have the covariance of the model")
        keys, u = self._repeatable_keys(rng), self._known_input(belief, u)
        y = shaped_array("y", y, *belief.reach.shape, "ages", self.filter.model.p)
        arrived = np.isfinite(y)
        if available is not None:
            arrived &= broadcast("available", as_mask("available", available), y.shape)
        *before, now = belief.steps
        if u is not None:
            if (now.available.any(-1, keepdims=True) & (u != now.predicted.u)).any():
                raise ValueError(
                    "u must be the same for all measurements of a step: Delayed takes them in"
                    " together"
                )
            now = now._replace(predicted=now.predicted.replace(u=u))
        steps, oldest = [*before, now._replace(update_keys=keys)], 0
        refused = belief.refused + arrived.sum((-2, -1))
        for age in np.flatnonzero(arrived.any((*range(y.ndim - 2), -1))[: len(steps)]).tolist():
            step = steps[-1 - age]
            accepted = arrived[..., age, :] & (age <= belief.reach)[..., None] & ~step.available
            if accepted.any():
                known, both = np.where(accepted, y[..., age, :], step.y), step.available | accepted
                steps[-1 - age] = step._replace(y=known, available=both)
                refused, oldest = refused - accepted.sum(-1), age
        self._repeat(steps, oldest, belief.reach)
        return DelayedBelief(self._update_step(steps[-1]), tuple(steps), belief.reach, refused)

    def _repeat(self, steps: list[Step], oldest: int, reach: np.ndarray) -> None:
        """Repeat the predictions of all steps after an old one."""
        for ago in range(oldest)[::-1]:
            step, before = steps[-1 - ago], self._update_step(steps[-2 - ago])
            predicted = self.filter.predict(before, step.u, rng=step.predict_keys)
            # u is that of the measurements; trouble in a repeated step is trouble now
            healthy = predicted.healthy & before.healthy
            predicted = predicted.replace(u=step.predicted.u, healthy=healthy)
            began = reach <= ago  # in this step, or later
            if began.any():
                predicted = predicted.with_rows(began, step.predicted[began])
            steps[-1 - ago] = step._replace(predicted=predicted)

    def _update_step(self, step: Step) -> Any:
        """The belief after the measurements of a step."""
        return self.filter.update(
            step.predicted, step.y, rng=step.update_keys, available=step.available
        )

    def step(
        self,
        belief: DelayedBelief,
        y: np.ndarray,
        u: Any = None,
        rng: Rng = None,
        available: np.ndarray | None = None,
    ) -> DelayedBelief:
        """`predict`, then `update`, as `Filter.step`."""
        return self.update(self.predict(belief, u, rng), y, rng, available)

    def log_likelihood(self, predicted: Any, updated: Any) -> np.ndarray:
        """Raise an error: a likelihood needs all earlier measurements, but late ones may come.

        Raises:
            ValueError: always.
        """
        raise ValueError(
            "measurements that come late have a likelihood once they are sorted: run the filter"
            " itself on them"
        )

    def _new_step(self, predicted: Any, u: Any, keys: Any) -> Step:
        """A step without measurements so far."""
        y = np.zeros((*predicted.mean.shape[:-1], self.filter.model.p))
        return Step(predicted, u, keys, keys, y, y > 0.0)

    def _repeatable_keys(self, rng: Rng) -> RandomKeys | None:
        """Keys, whose random numbers can be drawn again; None for a filter that draws none."""
        if not getattr(self.filter, "random", False):
            return None
        if isinstance(rng, np.random.Generator):
            raise TypeError(
                "a late measurement repeats random numbers: give rng as keys"
                " (estimators.RandomKeys)"
            )
        return rng

    def _known_input(self, belief: DelayedBelief, u: Any) -> np.ndarray | None:
        """The known input with a row for each belief, in an array of its own."""
        if not isinstance(belief, DelayedBelief):
            raise TypeError(
                f"belief must be a DelayedBelief, got {type(belief).__name__}: begin with"
                " init(prior)"
            )
        return known_input(u, belief.reach.shape)


def _with_rows(rows: np.ndarray, mine: Any, theirs: Any) -> Any:
    """A belief, keys or an array with some rows of another; None counts as rows of zeros."""
    if mine is None and theirs is None:
        return None
    if isinstance(mine, RandomKeys):
        step = np.broadcast_to(mine.step, mine.keys.shape[:-1])
        step = _with_rows(rows, step, theirs.step)
        return RandomKeys(_with_rows(rows, mine.keys, theirs.keys), step)
    if hasattr(mine, "with_rows"):
        return mine.with_rows(rows, theirs)
    merged = np.zeros(rows.shape + theirs.shape[1:]) if mine is None else np.array(mine)
    merged[rows] = 0.0 if theirs is None else theirs
    return merged
