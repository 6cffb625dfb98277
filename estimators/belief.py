"""Beliefs: an immutable record of arrays for each family of filters."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cache
from typing import Any, Self, TypeVar

import numpy as np

from estimators.analysis import covariance
from estimators.checks import as_array, frozen, read_only, with_points
from estimators.engine.matrices import is_traced
from estimators.measurement import Measurement

Record = TypeVar("Record", bound="Belief")
"""The record of a filter's beliefs."""


class Recovery(IntEnum):
    """Remedies of an update, mildest first: the first that gives a finite belief is taken. ``reason`` says why."""

    reason: str

    def __new__(cls, value: int, reason: str) -> "Recovery":
        """A number that has a reason."""
        member = int.__new__(cls, value)
        member._value_, member.reason = value, reason
        return member

    USUAL = 0, "the usual gain was used"
    PSEUDO_INVERSE = (
        1,
        (
            "some measurements repeat others without noise of their own (the innovation covariance"
            " is singular), so the gain was taken with its pseudo-inverse"
        ),
    )
    WITHOUT_CHANNEL = (
        2,
        (
            "a measurement could not be used (what the filter expected of it was not finite, or it"
            " repeats others without noise), so it was left out: `available` says which"
        ),
    )
    PREDICTION = 3, "no measurement could be used, so the prediction stands alone"
    PRIOR = (
        4,
        (
            "the prediction was no longer finite, so the filter began again from its prior and this"
            " measurement"
        ),
    )


APART = ("prior_mean", "prior_cov", "recovery", "u")
"""Fields that are not packed."""
MEMBERS = ("ensemble",)
"""Fields that are packed transposed: members last."""


class Layout:
    """Columns of the fields of packed rows.

    Args:
        shapes: Name and shape of each field of a row, in the order of the columns.
        masks: Names of the fields that are masks, packed as 1 and 0.

    Attributes:
        fields: By name the index ``(..., slice)`` of its columns, and its shape.
        width: Columns of a row.
    """

    def __init__(
        self, shapes: Sequence[tuple[str, tuple[int, ...]]], masks: frozenset[str]
    ) -> None:
        self.fields: dict[str, tuple[Any, tuple[int, ...]]] = {}
        self.width, self.masks = 0, masks
        for name, shape in shapes:
            first, self.width = self.width, self.width + math.prod(shape)
            self.fields[name] = (..., slice(first, self.width)), shape


@cache
def layout_of(
    shapes: tuple[tuple[str, tuple[int, ...]], ...], masks: frozenset[str] = frozenset()
) -> Layout:
    """The one layout of these fields."""
    return Layout(shapes, masks)


class Packed:
    """A record whose fields may be columns of one array; each is a view of it, made when it is first read."""

    __slots__ = ("layout", "packed")
    packed: Any  # (..., width); None: each field is an array of its own
    layout: Any

    def __getattr__(self, name: str) -> Any:
        if name in Packed.__slots__:
            return None
        if self.layout is None or name not in self.__dataclass_fields__:
            raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")
        value = None
        if name in self.layout.fields:
            columns, shape = self.layout.fields[name]
            value = self.packed[columns]
            if len(shape) != 1:
                value = value.reshape(value.shape[:-1] + shape)
            if name in self.layout.masks:
                value = frozen(value != 0.0)
            elif name in MEMBERS:
                value = value.mT
        object.__setattr__(self, name, value)
        return value


@dataclass(frozen=True, slots=True, eq=False)
class Belief(Packed):
    """A filter's belief and everything its next step needs; leading axes are a batch.

    Every filter has these; a family that has more adds it in a record of its own. Of any belief one
    may ask for ``input_mean``, ``input_cov`` and ``ensemble``: they are None where the filter has
    none.

    Attributes:
        mean: ``(..., n)`` state estimate.
        cov: ``(..., n, n)`` its covariance.
        prior_mean: ``(..., n)`` where a lost row starts again.
        prior_cov: ``(..., n, n)`` likewise.
        recovery: ``(...)`` what the last update had to do, as the numbers of `Recovery`; 0: the
            usual.
        u: ``(..., m)`` the known input of the last prediction, or that of its measurement where the
            update was given one;
            None: it was told none.
        innovation: ``(..., p)`` measurement minus expectation, 0 where no measurement came; None
            before an update.
        innovation_cov: ``(..., p, p)`` its covariance, unit where no measurement came; likewise.
        available: ``(..., p)`` which measurements the last update used; likewise.
    """

    mean: np.ndarray
    cov: np.ndarray
    prior_mean: np.ndarray
    prior_cov: np.ndarray
    recovery: np.ndarray
    u: np.ndarray | None = None
    innovation: np.ndarray | None = None
    innovation_cov: np.ndarray | None = None
    available: np.ndarray | None = None

    @property
    def input_mean(self) -> np.ndarray | None:
        """``(..., q)`` estimate of the unknown input; None: the filter has none."""
        return None

    @property
    def input_cov(self) -> np.ndarray | None:
        """``(..., q, q)`` its covariance, likewise."""
        return None

    @property
    def ensemble(self) -> np.ndarray | None:
        """``(..., N, n)`` members as rows; None: the filter has none."""
        return None

    @classmethod
    def view(
        cls,
        packed: np.ndarray,
        layout: Layout,
        prior_mean: Any,
        prior_cov: Any,
        u: Any,
        recovery: Any = None,
    ) -> Self:
        """A belief of packed rows ``(..., width)``, read-only from now on; without ``recovery``: the usual."""
        belief, put, batch = object.__new__(cls), object.__setattr__, packed.shape[:-1]
        packed.setflags(write=False)
        put(belief, "packed", packed)
        put(belief, "layout", layout)
        put(belief, "prior_mean", prior_mean)
        put(belief, "prior_cov", prior_cov)
        put(belief, "u", u)
        put(belief, "recovery", _usual(batch) if recovery is None else recovery)
        (mean, _), (cov, square) = (
            layout.fields["mean"],
            layout.fields["cov"],
        )  # every caller reads these
        put(belief, "mean", packed[mean])
        put(belief, "cov", packed[cov].reshape(batch + square))
        return belief

    def pack(self) -> tuple[np.ndarray, Layout]:
        """Its packed rows ``(..., width)`` and their layout."""
        if self.packed is not None:
            return self.packed, self.layout
        arrays, batch = self.stored(), self.mean.shape[:-1]
        for name, array in arrays.items():
            if np.shape(array)[: len(batch)] != batch or not isinstance(
                array, np.ndarray | np.generic
            ):
                raise ValueError(
                    f"{name} of a belief must be an array with a row for each of the batch, {batch}"
                )
        masks = frozenset(name for name, array in arrays.items() if array.dtype == bool)
        layout = layout_of(
            tuple((name, array.shape[len(batch) :]) for name, array in arrays.items()), masks
        )
        packed = np.empty(batch + (layout.width,))
        for name, (columns, shape) in layout.fields.items():
            packed[columns] = arrays[name].reshape(*batch, math.prod(shape))
        return packed, layout

    @property
    def healthy(self) -> np.ndarray:
        """``(...)`` True where the last update was the usual one."""
        return self.recovery == 0

    @property
    def reasons(self) -> np.ndarray:
        """``(...)`` sentences that say what the last update did to each row, and why."""
        sentences = np.array([remedy.reason for remedy in Recovery], dtype=object)
        return np.asarray(sentences[self.recovery], dtype=object)

    @classmethod
    def of(cls, belief: "Belief", **own: Any) -> Self:
        """A belief as this record, which has ``own`` arrays beside those of every belief."""
        return cls(*(getattr(belief, name) for name in Belief.__dataclass_fields__), **own)

    @classmethod
    def predicted(
        cls, before: "Belief", mean: np.ndarray, cov: np.ndarray, u: np.ndarray | None, **own: Any
    ) -> Self:
        """The belief after a prediction from the one ``before``, with the record's ``own`` arrays."""
        return cls(mean, cov, before.prior_mean, before.prior_cov, before.recovery, u, **own)

    @classmethod
    def updated(
        cls,
        before: "Belief",
        mean: np.ndarray,
        cov: np.ndarray,
        measurement: Measurement,
        S: np.ndarray,
        **own: Any,
    ) -> Self:
        """The belief after a usual update of the one ``before``, ``S`` the innovation's covariance; likewise."""
        return cls(
            mean, cov, before.prior_mean, before.prior_cov, np.zeros(mean.shape[:-1], np.int8), before.u,
            measurement.innovation, S, measurement.available, **own,
        )  # fmt: skip

    def __getitem__(self, rows: Any) -> Self:
        """The beliefs of some rows of the batch: a mask, an index or a slice over leading axes."""
        return self._of({name: None if a is None else a[rows] for name, a in self._parts().items()})

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored_read_only, (type(self), self._arrays())

    def with_rows(self, rows: np.ndarray, other: "Belief") -> Self:
        """This belief with the rows of a mask ``(...)`` replaced, in order, by those of ``other``.

        One of the two may have seen no measurement or no known input yet: its rows then have none
        (an innovation of 0).

        Raises:
            ValueError: if the two are beliefs of different filters.
        """
        if type(other) is not type(self):
            kinds = f"{type(self).__name__} and {type(other).__name__}"
            raise ValueError(f"cannot merge {kinds}: they are of different filters")
        merged = dict[str, Any]()
        for name, (mine, theirs) in _aligned((self, other)).items():
            merged[name] = mine
            if mine is not None and (name == "packed" or not (mine[rows] == theirs).all()):
                merged[name] = np.array(mine)
                merged[name][rows] = theirs
                merged[name].setflags(write=False)
        return self._of(merged)

    def replace(self, **changes: Any) -> Self:
        """This belief with some fields changed."""
        given = {
            name: as_array(name, a) if isinstance(a, list | tuple) else a
            for name, a in changes.items()
        }
        own = {name: frozen(a) if type(a) is np.ndarray else a for name, a in given.items()}
        return _restored(type(self), self._arrays() | own)

    def _moved(self, points: str, changes: dict[str, Any]) -> dict[str, Any]:
        """The points ``(..., N, n)`` of this name whose moments mean and covariance are, about a mean that is given.

        Raises:
            ValueError: if the covariance is given without the points.
        """
        if points in changes:
            return {}
        if "cov" in changes:
            raise ValueError(
                f"cov of this belief is that of its {points}: replace them, or begin anew with init"
            )
        shift = np.asarray(changes.get("mean", self.mean)) - self.mean
        return {points: getattr(self, points) + shift[..., None, :]} if "mean" in changes else {}

    def read_only(self) -> Self:
        """This belief, into whose arrays nobody can write any more."""
        for array in (
            self._arrays().values() if self.packed is None else (self.u,)
        ):  # the others are so when they begin
            if type(array) is np.ndarray:
                array.setflags(write=False)
        return self

    def with_input(self, u: np.ndarray | None) -> Self:
        """This belief with another known input, packed as it is."""
        return self._of(self._parts() | {"u": u})

    def stored(self) -> dict[str, Any]:
        """The arrays that are packed, by name, as they stand there."""
        arrays = self._arrays().items()
        return {
            name: a.mT if name in MEMBERS else a
            for name, a in arrays
            if a is not None and name not in APART
        }

    def _arrays(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in self.__dataclass_fields__}

    def _parts(self) -> dict[str, Any]:
        """Its arrays, packed ones as one."""
        return (
            self._arrays()
            if self.packed is None
            else {n: getattr(self, n) for n in ("packed", *APART)}
        )

    def _of(self, parts: dict[str, Any]) -> Self:
        """A belief of such arrays."""
        return (
            self.view(layout=self.layout, **parts)
            if "packed" in parts
            else _restored(type(self), parts)
        )


def _restored(record: type[Record], arrays: dict[str, Any]) -> Record:
    """A belief of these arrays by name."""
    return record(arrays.pop("mean"), **arrays)


def _restored_read_only(record: type[Record], arrays: dict[str, Any]) -> Record:
    """The same of a belief that was pickled or copied."""
    return _restored(record, arrays).read_only()


# Where a record gives what every belief can be asked for, `field` hides the property above, which
# is no default.


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class InputBelief(Belief):
    """The belief of a filter that estimates the unknown input, too.

    Attributes:
        input_mean: ``(..., q)`` estimate of the unknown input.
        input_cov: ``(..., q, q)`` its covariance.
        state_input_cov: ``(..., n, q)`` covariance between the two errors.
        input_observed: ``(..., q, q)`` projector on the directions of the unknown input that the
            measurements show well; in the others its prior counts, too. None: the filter was told
            the input's covariance, which counts in every direction.
    """

    input_mean: np.ndarray = field()
    input_cov: np.ndarray = field()
    state_input_cov: np.ndarray
    input_observed: np.ndarray | None = None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DelayedInputBelief(InputBelief):
    """The belief of a filter to which a measurement shows the unknown input of the step before.

    Attributes:
        input_observed: As in `InputBelief`.
        pending: ``(...)`` True where a prediction waits for the measurement that shows its unknown
            input.
        input_matrix: ``(..., n, q)`` G of the last prediction, for a model whose G is a function.
    """

    input_observed: np.ndarray
    pending: np.ndarray
    input_matrix: np.ndarray | None = None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FeedthroughBelief(DelayedInputBelief):
    """The belief of a filter that sees a part of the unknown input at once, and the whole one step later.

    Attributes:
        feedthrough_mean: ``(..., q)`` what the measurements of this very step show of the unknown
            input that acts now, 0 in the other directions.
        feedthrough_cov: ``(..., q, q)`` its covariance, 0 in the other directions.
        state_feedthrough_cov: ``(..., n, q)`` covariance of its error and the state's.
        feedthrough_observed: ``(..., q, q)`` projector on the directions that they show.
        input_reach: ``(..., n + q, q)`` how the unknown input stands in the errors of the state and
            of what is known of the input, in the directions of it that no measurement has shown
            yet: those that act now, and after a prediction those that acted before it.
    """

    feedthrough_mean: np.ndarray
    feedthrough_cov: np.ndarray
    state_feedthrough_cov: np.ndarray
    feedthrough_observed: np.ndarray
    input_reach: np.ndarray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class EnsembleBelief(Belief):
    """The belief of a filter that carries members.

    Attributes:
        ensemble: ``(..., N, n)`` members as rows.
    """

    ensemble: np.ndarray = field()
    __new__ = with_points("ensemble")

    def replace(self, **changes: Any) -> Self:
        """This belief with some fields changed; another mean moves the members, other members have their moments."""
        own = self._moved("ensemble", changes)
        if "ensemble" in changes:
            mean, members = changes["ensemble"].mean(-2), members_last(changes["ensemble"])
            own = {"mean": mean, "cov": covariance(members, mean)}
        return Belief.replace(self, **(own | changes))


@cache
def _usual(rows: tuple[int, ...]) -> np.ndarray:
    """Remedies of rows that needed none, made once for as many."""
    recovery = np.zeros(rows, np.int8)
    recovery.flags.writeable = False
    return recovery


def prior_belief(mean: np.ndarray, cov: np.ndarray, u: np.ndarray | None) -> Belief:
    """A belief before an episode, for a program that has the covariance ``(n, n)`` of all rows as a constant."""
    belief, covs = object.__new__(Belief), np.full(mean.shape + mean.shape[-1:], cov)
    values: dict[str, Any] = {
        "packed": mean,
        "layout": layout_of((("mean", mean.shape[-1:]),)),
        "u": u,
    }
    values |= {"prior_mean": mean, "prior_cov": covs, "recovery": _usual(mean.shape[:-1])}
    for name, value in values.items():
        object.__setattr__(belief, name, value)
    return belief


def members_last(ensemble: np.ndarray) -> np.ndarray:
    """``(..., n, N)`` of an ensemble ``(..., N, n)``, contiguous: a view where members are last in memory already."""
    return ensemble.mT if is_traced(ensemble) else np.ascontiguousarray(ensemble.mT)


def over_time(beliefs: Sequence[Record]) -> Record:
    """Beliefs of one filter at successive times as one whose leading axis is time.

    Where one has seen no measurement or no known input yet and another has, it has none (an
    innovation of 0).

    Raises:
        ValueError: if there is none, or they are of different filters.
    """
    kinds = {type(belief) for belief in beliefs}
    if len(kinds) != 1:
        raise ValueError(
            f"beliefs at successive times must be of one filter, got {len(kinds)} kinds of them"
        )
    stacked = {
        name: None if a[0] is None else read_only(np.stack(a))
        for name, a in _aligned(beliefs).items()
    }
    return beliefs[0]._of(stacked).read_only()


def _aligned(beliefs: Sequence[Belief]) -> dict[str, list[Any]]:
    """By name the arrays of several beliefs, packed ones as one where all have one layout; None where none has it."""
    alike = all(
        belief.packed is not None and belief.layout is beliefs[0].layout for belief in beliefs
    )
    parts = [belief._parts() if alike else belief._arrays() for belief in beliefs]
    aligned = {name: [each[name] for each in parts] for name in parts[0]}
    for name, arrays in aligned.items():
        seen = next((array for array in arrays if array is not None), None)
        if seen is not None and any(array is None for array in arrays):
            pairs = zip(arrays, beliefs, strict=True)
            aligned[name] = [
                _unseen(name, seen, belief) if array is None else array for array, belief in pairs
            ]
    return aligned


def _unseen(name: str, like: np.ndarray, belief: Belief) -> np.ndarray:
    """A field's value in a belief that has seen no measurement, or was told no known input, yet."""
    if name not in ("u", "innovation", "innovation_cov", "available"):
        raise ValueError(
            f"cannot merge two beliefs of which only one has {name}: they are of different filters"
        )
    size = like.shape[-1]
    blank = np.eye(size) if name == "innovation_cov" else np.zeros(size, like.dtype)
    return np.broadcast_to(blank, belief.mean.shape[:-1] + blank.shape)


def finite_rows(belief: Belief) -> np.ndarray:
    """The rows ``(...)`` of which everything is finite."""
    finite = np.isfinite(belief.mean).all(-1)
    for name, axes in _CHECKED.items():
        if (array := getattr(belief, name, None)) is not None:
            finite = finite & np.isfinite(array).all(axes)
    return finite


_CHECKED: dict[str, int | tuple[int, int]] = {
    **dict.fromkeys(("input_mean", "feedthrough_mean", "innovation"), -1),
    **dict.fromkeys(
        ("cov", "innovation_cov", "input_cov", "feedthrough_cov", "ensemble"), (-2, -1)
    ),
}
