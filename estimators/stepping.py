"""A prediction, an update or both: in NumPy, or as one compiled function of arrays."""

from collections.abc import Callable, Sequence
from operator import attrgetter
from typing import Any

import numpy as np

from estimators.angles import difference
from estimators.belief import Belief
from estimators.engine import Compiled
from estimators.linalg import congruence, diagonal, masked, rescuing
from estimators.randomness import RandomKeys

_GIVEN = 1, 1, 1, 2
"""Axes of rows of u, y, available and R."""
_DRAWN = 1, 1
"""Axes of rows of keys and steps."""
_DIGITS = 1e4
"""An update that shrinks a variance by more than this may leave only rounding, of either sign."""
_SHRUNK = 1e-4
"""A step that shrinks all variances by more than this may leave only rounding, of either sign."""


def in_numpy(filter: Any, step: str, belief: Any, data: Any) -> dict[str, Any]:
    """Arrays that a step changes, in NumPy; the mean is NaN in rows with a singular matrix."""
    try:
        with np.errstate(all="ignore"):
            return changes(filter, step, belief, data)
    except np.linalg.LinAlgError:
        healthy = belief.healthy
    if healthy.size == 1 or filter.model_per_row:
        mean = np.full_like(belief.mean, np.nan)
        return belief.arrays() | {"mean": mean, "healthy": np.zeros_like(healthy)}
    after = belief
    for i in np.ndindex(healthy.shape):
        row = np.zeros_like(healthy)
        row[i] = True
        one = belief[row]
        after = after.with_rows(row, one.replaced(in_numpy(filter, step, one, rows_of(data, row))))
    return after.arrays()


def rows_of(data: Any, rows: np.ndarray) -> Any:
    """A step's data for some rows of the batch; a Generator stays what it is."""
    indexed = np.ndarray, RandomKeys
    return tuple(each[rows] if isinstance(each, indexed) else each for each in data)


def in_program(filter: Any, step: str, belief: Any, data: Any) -> dict[str, Any]:
    """Arrays that a step changes, read-only, by a program that is compiled at first use."""
    *given, rng = data
    answers: Sequence[Any] = ()
    if not filter._inside[step]:
        with np.errstate(all="ignore"):
            answers = _answers(filter, step, belief, data)
    if step not in filter._programs:
        filter._programs[step] = _program(filter, step, belief, len(answers))
    (read, program), drawn = filter._programs[step], rng.words if filter.random else ()
    found = program(*read(belief), *given, *answers, *drawn)
    return dict(zip(program.names, found, strict=True))


def _program(
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
        return changes(filter, step, before, (u, y, available, R, rng), more[:answers])

    axes = [array.ndim - batch for array in read(belief)]
    given = _GIVEN + filter._axes.get(step, ())[:answers] + _DRAWN * filter.random
    return read, Compiled(function, (*axes, *given), matrices=True, sealed=True)


def changes(
    filter: Any, step: str, belief: Any, data: Any, answers: Sequence[Any] = ()
) -> dict[str, Any]:
    """Arrays that a step changes; they are tracers while the step is traced."""
    answers = answers or _answers(filter, step, belief, data)
    if step == "update":
        return _corrected(filter, belief, data, *answers)
    u, *_, rng = data
    drawn = (rng,) if filter.random else ()
    changed = filter._predict(belief, u, *answers, *drawn)
    if step == "step":
        return changed | changes(filter, "update", belief.replaced(changed), data)
    # The estimate of an unknown input may reduce variances in a prediction.
    return changed | {"healthy": is_healthy(belief, changed, filter.input_delay is not None)}


def _corrected(
    filter: Any, belief: Any, data: Any, expected: Any, C: Any, R: Any, H: Any = None
) -> dict[str, Any]:
    """Arrays that an update changes, from the expected measurement, C, R and H."""
    u, y, available, _, rng = data
    available = available & np.isfinite(y) & np.isfinite(diagonal(R))
    if rescuing():
        available = available & np.isfinite(expected) & np.isfinite(C).all(-1)
    e = np.where(available, difference(y, expected, filter.model.measurement_angles), 0.0)
    C = np.where(available[..., None], C, 0.0)
    rest = () if H is None else (np.where(available[..., None], H, 0.0),)
    R, drawn = masked(R, available), (rng,) if filter.random else ()
    updated = {"innovation_cov": None, "innovation": e, "available": available}
    updated |= filter._update(belief, u, e, C, R, available, *rest, *drawn)
    if updated["innovation_cov"] is None:
        updated["innovation_cov"] = congruence(C, belief.cov) + R
    return updated | {"healthy": is_healthy(belief, updated, not filter.random, R)}


def _answers(filter: Any, step: str, belief: Any, data: Any) -> Sequence[Any]:
    """Arrays from `propagate` or `expect`, and G or H if the filter estimates an input."""
    (u, _, _, R, _), update = data, step == "update"
    answer = filter.expect(belief, u, R) if update else filter.propagate(belief, u)
    if filter.input_delay is None:
        return answer
    model: Any = filter.model
    return *answer, model.value("H", u) if update else model.input_matrix(belief.mean, u)


def is_healthy(belief: Any, changed: dict[str, Any], shrinks: bool, R: Any = None) -> Any:
    """Mask ``(...)`` of rows that are finite and whose variances cannot be mere rounding.

    Args:
        belief: The belief before the step.
        changed: Arrays that the step changes.
        shrinks: Is variance subtracted? The difference may then be mere rounding, or negative.
        R: Covariance of the measurements of an update.
    """
    after = belief.replaced(changed)
    total = after.mean.sum(-1) + after.cov.sum(-1).sum(-1)
    if after.input_mean is not None:
        total = total + after.input_mean.sum(-1)
    if "feedthrough_cov" in after.names():
        total = total + after.feedthrough_cov.sum((-2, -1))
    healthy = total - total == 0.0
    if R is not None:
        digits = _DIGITS if shrinks else 1e20
        precise = diagonal(after.innovation_cov) > digits * diagonal(R)
        healthy = healthy & ~(np.where(precise, 1.0, 0.0).sum(-1) > 0.0)
    if shrinks:
        left = diagonal(after.cov)
        shrunk = left.sum(-1) < _SHRUNK * diagonal(belief.cov).sum(-1)
        healthy = healthy & ~(shrunk | (np.where(left < 0.0, 1.0, 0.0).sum(-1) > 0.0))
    return healthy
