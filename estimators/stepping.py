"""A prediction, an update or both, as one compiled function of arrays."""

from collections.abc import Callable
from operator import attrgetter
from typing import Any

from estimators.belief import Belief
from estimators.engine import Compiled
from estimators.randomness import RandomKeys

_GIVEN = 1, 1, 1, 2
"""Axes of rows of u, y, available and R."""
_DRAWN = 1, 1
"""Axes of rows of keys and steps."""


def compiled_step(
    filter: Any, step: str, belief: Belief, answers: int
) -> tuple[Callable[[Belief], tuple[Any, ...]], Compiled]:
    """A step of a filter as a function of arrays that returns those that it changes, by name.

    The arrays are those of a belief, as the function returned first gives them; known input,
    measurement, mask and covariance of the measurement, or None; the model's arrays; and keys and
    steps for a filter that draws random numbers.

    Args:
        filter: The filter.
        step: "predict", "update", or "step" for both together.
        belief: A belief before the step.
        answers: Number of the model's arrays that are given; 0: the program computes them.
    """
    names, batch = belief.names(), belief.mean.ndim - 1
    read = attrgetter(*names)

    def function(*arrays: Any) -> dict[str, Any]:
        before = filter.record.of(dict(zip(names, arrays, strict=False)))
        u, y, available, R, *more = arrays[len(names) :]
        rng = RandomKeys(more[-2], more[-1][..., 0]) if filter.random else None
        changed: dict[str, Any] = filter._changed(
            step, before, (u, y, available, R, rng), more[:answers]
        )
        return changed

    axes = [array.ndim - batch for array in read(belief)]
    given = _GIVEN + filter._axes.get(step, ())[:answers] + _DRAWN * filter.random
    return read, Compiled(function, (*axes, *given), matrices=True, sealed=True)
