"""Windows of steps that late measurements may still reach, see `estimators.delayed`."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from estimators.randomness import RandomKeys


class Step(NamedTuple):
    """One step that a late measurement may still reach."""

    predicted: Any  # belief that its measurements meet; None: it is still to be made
    moved: RandomKeys | None  # random numbers of the prediction
    R: np.ndarray | None  # (..., p, p) of measurements that brought their own, NaN where none did
    keys: RandomKeys | None  # random numbers of the update
    measurement_u: (
        np.ndarray | None
    )  # (..., m) known input of the measurements, where it was given with them
    u: np.ndarray | None  # (..., m) known input of the prediction
    y: np.ndarray  # (..., p) what has come of its measurements so far
    available: np.ndarray  # (..., p)
    read: np.ndarray  # (...) whether there was an update

    def rows(self, rows: Any) -> "Step":
        """Some rows of the step."""
        some: Any = (None if one is None else one[rows] for one in self)
        return self if rows is ... else Step(*some)


class Run:
    """Predictions of successive steps, of which those that nobody reads are not kept.

    Args:
        forecasts: Packed predictions of some of the steps, or None.
        like: Belief that has their layout, and the priors of the rows.
        wait: ``(rows,)`` steps after which a row begins, with its row of ``like``.
        steps: How many.
        kept: Steps whose predictions are computed at once.
    """

    def __init__(
        self, forecasts: Any, like: Any, wait: np.ndarray, steps: int, kept: Sequence[int]
    ) -> None:
        self.forecasts, self.like, self.wait, self.steps = forecasts, like, wait, steps
        found = forecasts(kept)
        self.found = None if found is None else dict(zip(kept, found, strict=True))

    def __getstate__(self) -> dict[str, Any]:
        """A copy has all predictions, and no filter."""
        found = {step: self.packed(step) for step in range(self.steps)}
        return vars(self) | {"found": found, "forecasts": None}

    def packed(self, step: int) -> np.ndarray:
        """The prediction of a step, ``(rows, width)``."""
        assert self.found is not None
        if step not in self.found:
            self.found = dict(enumerate(self.forecasts(range(self.steps))))
        return self.found[step]


class Forecast(NamedTuple):
    """A prediction of which no belief has been made yet."""

    run: Run
    step: int  # of the run

    def rows(self, rows: np.ndarray) -> np.ndarray:
        """Some of its packed rows."""
        initial = (self.run.wait[rows] > self.step).all()
        return (self.run.like.pack()[0] if initial else self.run.packed(self.step))[rows]


class Window(NamedTuple):
    """The last steps, oldest first: a value of each, or arrays whose first axis is that of the steps. See `Step`."""

    predicted: tuple[Any, ...]
    moved: tuple[RandomKeys | None, ...]
    R: tuple[np.ndarray | None, ...]
    keys: tuple[RandomKeys | None, ...]
    measurement_u: tuple[np.ndarray | None, ...]
    u: tuple[np.ndarray | None, ...]
    y: np.ndarray
    available: np.ndarray
    read: np.ndarray

    @classmethod
    def initial(cls, belief: Any, channels: int, keys: RandomKeys | None) -> "Window":
        """The window of a belief before any measurement, which draws the numbers of ``keys``."""
        y = np.zeros((1, *belief.mean.shape[:-1], channels))
        each = (belief,), (keys,), (None,), (keys,), (None,), (belief.u,)
        return cls(*each, y, y != 0.0, np.zeros(y.shape[:-1], bool))

    def followed(
        self, predicted: Any, u: np.ndarray | None, keys: RandomKeys | None, most: int
    ) -> "Window":
        """The window one step on, of at most so many steps; nothing has been read of the last one."""
        first = max(len(self.y) + 1 - most, 0)
        arrays = (
            np.concatenate([array[first:], np.zeros((1, *array.shape[1:]), array.dtype)])
            for array in self[6:]
        )
        pairs = zip(self[:6], (predicted, keys, None, keys, None, u), strict=True)
        each: Any = ((*some[first:], new) for some, new in pairs)
        return Window(*each, *arrays)

    def last(self, steps: int) -> "Window":
        """The last steps."""
        some: Any = (each[-steps:] for each in self)
        return Window(*some)

    def with_predicted(self, *predicted: Any) -> "Window":
        """The window with other predictions of the last steps."""
        return self._replace(predicted=(*self.predicted[: -len(predicted)], *predicted))

    def belief(self, step: int) -> Any:
        """The prediction of a step."""
        found = self.predicted[step]
        if not isinstance(found, Forecast):
            return found
        like = found.run.like
        packed, (_, layout) = (
            found.run.packed(found.step),
            like.pack(),
        )  # the layout is not that of before in a copy
        return like.view(packed, layout, like.prior_mean, like.prior_cov, self.u[step])

    def step(self, step: int) -> Step:
        """One of its steps."""
        others: Any = (each[step] for each in self[1:])
        return Step(self.belief(step), *others)

    def rows(self, rows: Any) -> "Window":
        """Some rows of all steps."""
        predicted = tuple(
            None if one is None else self.belief(i)[rows] for i, one in enumerate(self.predicted)
        )
        each: Any = (
            tuple(None if one is None else one[rows] for one in some) for some in self[1:6]
        )
        at = (slice(None), *(rows if isinstance(rows, tuple) else (rows,)))
        arrays: Any = (np.ascontiguousarray(array[at]) for array in self[6:])
        return Window(predicted, *each, *arrays)

    def with_rows(self, rows: np.ndarray, other: "Window") -> "Window":
        """This window with some rows of another in the steps that both have: before a row's first nothing is read."""
        k = min(len(self.y), len(other.y))
        predicted = [self.belief(i).with_rows(rows, other.belief(i)) for i in range(-k, 0)]
        each: list[Any] = [(*self.predicted[:-k], *predicted)]
        for mine, theirs in zip(self[1:6], other[1:6], strict=True):
            pairs = zip(mine[-k:], theirs[-k:], strict=True)
            each.append((*mine[:-k], *(with_rows(one, rows, two) for one, two in pairs)))
        u = (
            known if belief.u is None else belief.u
            for known, belief in zip(each[5][-k:], predicted, strict=True)
        )
        each[5] = (*each[5][:-k], *u)  # where one was told none, its rows have zeros
        arrays = [array.copy() for array in self[6:]]
        for array, new in zip(arrays, other[6:], strict=True):
            array[-k:, rows] = new[-k:]
        return Window(*each, *arrays)


def with_rows(mine: Any, rows: np.ndarray, theirs: Any) -> Any:
    """Arrays or keys with some rows of others; where one has none, its rows have nothing that is ever looked at."""
    some = theirs if mine is None else mine
    if isinstance(some, RandomKeys):
        keys = (None if one is None else one.keys for one in (mine, theirs))
        steps = (
            None if one is None else np.broadcast_to(one.step, one.keys.shape[:-1])
            for one in (mine, theirs)
        )
        (my_keys, their_keys), (my_step, their_step) = keys, steps
        return RandomKeys(
            with_rows(my_keys, rows, their_keys), with_rows(my_step, rows, their_step)
        )
    if some is None:
        return None
    nothing = np.nan if some.dtype == float else 0
    if mine is None:
        mine = np.full(rows.shape + theirs.shape[1:], nothing, theirs.dtype)
    merged = np.array(mine)
    merged[rows] = nothing if theirs is None else theirs
    return merged
