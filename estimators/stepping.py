"""A prediction, an update or both, as one program of the engine."""

from collections.abc import Sequence
from functools import partial
from itertools import compress, filterfalse
from operator import is_not
from typing import Any

import numpy as np

from estimators.belief import unmeasured
from estimators.engine import Argument, is_traced, trace
from estimators.randomness import RandomKeys

_GIVEN = (1, "f"), (1, "f"), (1, "b"), (2, "f")
"""Axes and kinds of rows of u, y, available and R."""
_DRAWN = (1, "u"), (1, "i")


class StepProgram:
    """A step of a filter, traced for rows of some shapes.

    It takes only the arrays that it reads, and returns read-only arrays. Arrays that are equal in
    all rows and steps are made once a batch.

    Args:
        filter: The filter.
        step: "predict", "update", or "step" for both together.
        inside: Does the program compute the model's arrays? Otherwise they are given.
        belief: A belief before the step.
        given: Known input, measurement, mask and covariance of the measurement, or None; the
            model's arrays; and keys and steps for a filter that draws random numbers.

    Attributes:
        inside: As given.
    """

    def __init__(
        self, filter: Any, step: str, inside: bool, belief: Any, given: Sequence[Any]
    ) -> None:
        record, names, batch = filter.record, filter.record.names(), belief.mean.ndim - 1
        drawn: Any = _DRAWN if filter.random else ()
        answered = len(given) - len(_GIVEN + drawn)
        answers = [*zip(filter._axes.get(step, ())[:answered], "ffff", strict=False)]
        rows = list[Any]()
        for array in map(partial(getattr, belief), names):
            rows.append(Argument(array.shape[batch:], array.dtype.kind))
        for each, (axes, kind) in zip(given, (*_GIVEN, *answers, *drawn), strict=True):
            rows.append(None if each is None else Argument(each.shape[each.ndim - axes :], kind))
        sources = *names, *compress(range(len(given)), map(partial(is_not, None), given))

        def function(*arrays: Any) -> list[Any]:
            before = record.of(dict(zip((*names, "u"), arrays, strict=False)))
            u, y, available, R, *more = arrays[len(names) :]
            rng = RandomKeys(more[-2], more[-1][..., 0]) if drawn else None
            data = u, y, available, R, rng
            changed = filter._changed(step, before, data, more[: len(answers)])
            if step == "predict":
                changed |= unmeasured((), filter.model.p, changed["healthy"])
            traced: dict[str, Any] = {}
            for name, array in changed.items():
                (traced if is_traced(array) else self._constants)[name] = array
            self._order = *traced, *self._constants
            return [*traced.values()]

        self.inside, self._constants = inside, dict[str, Any]()
        self._batch: tuple[int, ...] | None = None
        self._arrays: list[np.ndarray] = []
        self._function = trace(function, rows, True, True)
        self._names, self._others = list[Any](), list[Any]()
        for i in self._function.arguments:
            (self._names if i < len(names) else self._others).append(sources[i])
        self._kept = [*filterfalse(self._order.__contains__, names)]

    def __call__(self, belief: Any, *given: Any) -> Any:
        """The belief after the step."""
        arrays = [
            *map(partial(getattr, belief), self._names),
            *map(given.__getitem__, self._others),
        ]
        if (results := self._function.call(*arrays)) is None:
            results = self._function.compute(*arrays)
        if self._batch != (batch := belief.mean.shape[:-1]):
            self._batch = batch
            self._arrays = [*map(partial(_repeated, batch=batch), self._constants.values())]
        after, put = object.__new__(type(belief)), object.__setattr__
        for name, array in zip(self._order, (*results, *self._arrays), strict=True):
            put(after, name, array)
        for name in self._kept:
            put(after, name, getattr(belief, name))
        put(after, "u", given[0])
        return after


def _repeated(value: Any, batch: tuple[int, ...]) -> np.ndarray:
    """A read-only array for a batch, repeated from one row."""
    array = np.array(np.broadcast_to(value, batch + np.shape(value)), order="C")
    array.setflags(write=False)
    return array
