"""Beliefs: an immutable record of arrays for each family of filters."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import lru_cache
from typing import Any, ClassVar, Self, TypeVar

import numpy as np

from estimators.checks import as_array, frozen

Record = TypeVar("Record", bound="Belief")
"""The record of a filter's beliefs."""


@dataclass(frozen=True, eq=False)
class Belief:
    """Mean and covariance of the state, and the last measurement; leading axes are a batch.

    Filters with further fields add them in a subclass, a dataclass without slots. Every belief has
    ``input_mean``, ``input_cov`` and ``ensemble``, which are None if the filter does not have them.

    Attributes:
        mean: ``(..., n)`` state estimate.
        cov: ``(..., n, n)`` its covariance.
        innovation: ``(..., p)`` measurement minus its expectation, 0 where no measurement came.
        innovation_cov: ``(..., p, p)`` its covariance, unit where no measurement came.
        available: ``(..., p)`` mask of the measurements that the last update used; False after a
            prediction.
        healthy: ``(...)`` False where the last step gave values that are not finite, or a
            covariance that is not positive semidefinite. Such a row was computed again with
            pseudo-inverses and without channels that are not finite. If that failed, too, the row
            kept what it had before the step. A particle filter's belief is not healthy, either,
            where no particle explains the measurement.
        u: ``(..., m)`` the known input of the last prediction or measurement, or None.
        parameters: ``(..., k)`` parameters that `Filter.by_rows` gives each row; None for other
            filters.
    """

    mean: np.ndarray
    cov: np.ndarray
    innovation: np.ndarray
    innovation_cov: np.ndarray
    available: np.ndarray
    healthy: np.ndarray
    u: np.ndarray | None = None
    parameters: np.ndarray | None = None

    input_mean: ClassVar[np.ndarray | None] = None
    """``(..., q)`` estimate of the unknown input; None if the filter has none."""
    input_cov: ClassVar[np.ndarray | None] = None
    """``(..., q, q)`` covariance of the unknown input; None if the filter has none."""

    ensemble: ClassVar[np.ndarray | None] = None
    """``(..., N, n)`` members as rows; None if the filter has none."""

    def names(self) -> tuple[str, ...]:
        """Names of the arrays that a compiled step reads: all but the known input."""
        fields = vars(self).items()
        return tuple(name for name, a in fields if name != "u" and a is not None)

    @classmethod
    def of(cls, arrays: dict[str, Any]) -> Self:
        """A belief from arrays by name; missing fields are None."""
        belief = object.__new__(cls)
        vars(belief).update({each.name: arrays.get(each.name) for each in fields(cls)})
        return belief

    def arrays(self) -> dict[str, Any]:
        """The belief's fields by name."""
        return dict(vars(self))

    def replace(self, **changes: Any) -> Self:
        """A copy of the belief with some fields changed, as read-only arrays.

        Raises:
            TypeError: for a field that the belief does not have.
        """
        for name, value in changes.items():
            array = as_array(name, value) if isinstance(value, list | tuple) else value
            changes[name] = frozen(array) if isinstance(array, np.ndarray) else array
        return self.replaced(changes)

    def replaced(self, changed: dict[str, Any]) -> Self:
        """A copy of the belief with some fields changed, whose values are stored unconverted.

        Raises:
            TypeError: for a field that the belief does not have.
        """
        before, after = vars(self), object.__new__(type(self))
        vars(after).update(before, **changed)
        if len(vars(after)) > len(before):
            unknown = changed.keys() - before.keys()
            raise TypeError(f"{type(self).__name__} has no field {unknown.pop()!r}")
        return after

    def __getitem__(self, rows: Any) -> Self:
        """The beliefs of some rows of the batch: a mask, an index or a slice over leading axes."""
        return self.of({k: None if a is None else a[rows] for k, a in self.arrays().items()})

    def with_rows(self, rows: np.ndarray, other: "Belief") -> Self:
        """A copy in which ``other`` replaces the rows that a mask selects.

        Args:
            rows: Mask ``(...)`` of the batch.
            other: The new rows alone, one for each selected row, in the same order.

        Raises:
            ValueError: if the two are beliefs of different filters.
        """
        if type(other) is not type(self):
            kinds = f"{type(self).__name__} and {type(other).__name__}"
            raise ValueError(f"cannot merge {kinds}: they are of different filters")
        merged: dict[str, Any] = {}
        for name, (mine, theirs) in _with_inputs([self, other]).items():
            if mine is not None:
                merged[name] = np.array(mine)
                merged[name][rows] = theirs
        return self.of(merged)

    def read_only(self) -> Self:
        """The belief with read-only arrays; the known input is left as it is."""
        for name in self.names():
            getattr(self, name).setflags(write=False)
        return self


# `field()` keeps dataclass from taking the attribute of `Belief` as the default of a field.


@dataclass(frozen=True, eq=False, kw_only=True)
class InputBelief(Belief):
    """The belief of a filter that estimates the unknown input.

    Attributes:
        input_mean: ``(..., q)`` estimate of the unknown input.
        input_cov: ``(..., q, q)`` its covariance.
        state_input_cov: ``(..., n, q)`` covariance between the errors of state and input.
    """

    input_mean: np.ndarray = field()  # type: ignore[misc]
    input_cov: np.ndarray = field()  # type: ignore[misc]
    state_input_cov: np.ndarray


@dataclass(frozen=True, eq=False, kw_only=True)
class ObservedInputBelief(InputBelief):
    """The belief of a filter that estimates observed directions of the unknown input without bias.

    Attributes:
        input_observed: ``(..., q, q)`` projector on the directions of the unknown input that the
            measurements show well; in the other directions the estimate also uses the prior.
    """

    input_observed: np.ndarray


@dataclass(frozen=True, eq=False, kw_only=True)
class DelayedInputBelief(ObservedInputBelief):
    """The belief of a filter that estimates the unknown input one step late.

    Attributes:
        pending: ``(...)`` True where a prediction waits for the measurement that shows its unknown
            input.
        input_matrix: ``(..., n, q)`` G of the last prediction.
    """

    pending: np.ndarray
    input_matrix: np.ndarray


@dataclass(frozen=True, eq=False, kw_only=True)
class FeedthroughBelief(ObservedInputBelief):
    """The belief of a filter that estimates part of the unknown input late.

    Attributes:
        pending: ``(...)`` True where a prediction waits for the measurement that shows the rest of
            its unknown input.
        input_reach: ``(..., n + q, q)`` gain from the unknown input to the errors of the state (n
            rows) and of the input's estimate (q rows), in the directions of the input that no
            measurement has shown yet. After an update the input is d(k), after a prediction d(k-1).
        feedthrough_mean: ``(..., q)`` estimate of the unknown input d(k) from the measurements of
            step k; 0 in the directions that these measurements do not show.
        feedthrough_cov: ``(..., q, q)`` its covariance, 0 in the same directions.
        state_feedthrough_cov: ``(..., n, q)`` covariance between the errors of the state and of
            ``feedthrough_mean``.
        feedthrough_observed: ``(..., q, q)`` projector on the directions that these measurements
            show.
    """

    pending: np.ndarray
    input_reach: np.ndarray
    feedthrough_mean: np.ndarray
    feedthrough_cov: np.ndarray
    state_feedthrough_cov: np.ndarray
    feedthrough_observed: np.ndarray

    @property
    def input_matrix(self) -> np.ndarray:
        """``(..., n, q)`` gain from the unknown input to the error of the state."""
        return self.input_reach[..., : self.mean.shape[-1], :]


@dataclass(frozen=True, eq=False, kw_only=True)
class EnsembleBelief(Belief):
    """The belief of an ensemble filter; its mean and covariance are those of the members.

    Attributes:
        members: ``(..., n, N)`` members as columns, as they are stored; ``ensemble`` gives them as
            rows.
    """

    members: np.ndarray

    @property
    def ensemble(self) -> np.ndarray:  # type: ignore[override]
        """``(..., N, n)`` members as rows."""
        return self.members.mT

    def replace(self, **changes: Any) -> Self:
        """A copy with some fields or its ``ensemble`` changed; a new mean shifts the members.

        Raises:
            TypeError: for a field that the belief does not have.
            ValueError: if the covariance is given without members.
        """
        if "ensemble" in changes:
            from estimators.analysis import covariance  # late, as few beliefs have members

            members = np.ascontiguousarray(np.asarray(changes.pop("ensemble")).mT)
            mean = members.mean(-1)
            moments = {"mean": mean, "cov": covariance(members, mean), "members": members}
            changes = moments | changes
        return Belief.replace(self, **changes_of_points(self, changes, "members", -1))


def changes_of_points(belief: Any, changes: dict[str, Any], name: str, axis: int) -> dict[str, Any]:
    """Changes of a belief, and of its points along ``axis``, which a new mean shifts.

    Raises:
        ValueError: if the covariance is given without points.
    """
    if name in changes or not {"mean", "cov"} & changes.keys():
        return changes
    if "cov" in changes:
        raise ValueError(
            f"cov of this belief is that of its {name}: replace them, or begin anew with init"
        )
    shift = np.expand_dims(changes["mean"] - belief.mean, axis)
    return changes | {name: getattr(belief, name) + shift}


@lru_cache(4)  # they are as large as the batch
def unmeasured(batch: tuple[int, ...], p: int) -> dict[str, np.ndarray]:
    """Read-only arrays about the measurement of ``p`` channels before there is one, cached."""
    blank = {
        "innovation": np.zeros((*batch, p)),
        "innovation_cov": np.zeros((*batch, p, p)) + np.eye(p),
        "available": np.zeros((*batch, p), bool),
    }
    for array in blank.values():
        array.setflags(write=False)
    return blank


def over_time(beliefs: Sequence[Record]) -> Record:
    """Beliefs of successive times, stacked into one belief whose leading axis is time."""
    stacked = {
        name: None if arrays[0] is None else np.stack(arrays)
        for name, arrays in _with_inputs(beliefs).items()
    }
    if stacked["u"] is not None:
        stacked["u"].setflags(write=False)
    return beliefs[0].of(stacked).read_only()


def _with_inputs(beliefs: Sequence[Belief]) -> dict[str, list[Any]]:
    """Arrays of several beliefs by name; a missing known input is 0 if another belief has one."""
    arrays = {name: [getattr(b, name) for b in beliefs] for name in beliefs[0].arrays()}
    like = next((u for u in arrays["u"] if u is not None), None)
    if like is not None:
        arrays["u"] = [
            np.zeros(b.mean.shape[:-1] + like.shape[-1:]) if b.u is None else b.u for b in beliefs
        ]
    return arrays
