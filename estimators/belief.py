"""What a filter believes at one time: an immutable record of arrays, one record for each family of filters."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cache
from typing import Any, NamedTuple, Self, TypeVar

import numpy as np

from estimators.analysis import covariance
from estimators.checks import as_array, frozen, read_only, with_points
from estimators.engine.matrices import is_traced
from estimators.reading import Reading

Record = TypeVar("Record", bound="Belief")
"""The record of a filter's beliefs."""


class Recovery(IntEnum):
    """What an update had to do to a row: the first of these that gave a finite belief."""

    USUAL = 0
    PSEUDO_INVERSE = 1
    WITHOUT_CHANNEL = 2
    PREDICTION = 3
    PRIOR = 4

    @property
    def reason(self) -> str:
        """Why it had to, in one sentence."""
        return _REASONS[self]


_REASONS = {
    Recovery.USUAL: "the usual gain was used",
    Recovery.PSEUDO_INVERSE: "some readings repeat others without noise of their own (the innovation covariance is "
    "singular), so the gain was taken with its pseudo-inverse",
    Recovery.WITHOUT_CHANNEL: "a reading could not be used (what the filter expected of it was not finite, or it "
    "repeats others without noise), so it was left out: `available` says which",
    Recovery.PREDICTION: "no reading could be used, so the prediction stands alone",
    Recovery.PRIOR: "the prediction was no longer finite, so the filter began again from its prior and this reading",
}


class Packed:
    """A record whose arrays may stand side by side in one, where each is looked at when it is first asked for."""

    __slots__ = ("layout", "packed")
    packed: Any  # (..., k); None: they stand apart
    layout: Any  # where

    def __getattr__(self, name: str) -> Any:
        if name in Packed.__slots__:
            return None
        layout, value = self.layout, None
        if layout is not None and name in layout.cuts:
            own, shape = layout.cuts[name]
            value = self.packed[own]
            if len(shape) != 1:
                value = value.reshape(value.shape[:-1] + shape)
            if name in layout.masks:
                value = value != 0.0
                value.setflags(write=False)
            elif name in MEMBERS:
                value = value.mT
        elif layout is None or name not in self.__dataclass_fields__:
            raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")
        object.__setattr__(self, name, value)
        return value


class Layout(NamedTuple):
    """Places of the arrays of a packed record: by name the first column, or a pick of columns, and the shape of a row.

    ``masks`` names those that are masks, 1 and 0 there.
    """

    columns: dict[str, tuple[int, tuple[int, ...]]]
    width: int
    cuts: dict[str, tuple[Any, tuple[int, ...]]]
    masks: frozenset[str]


APART = ("prior_mean", "prior_cov", "recovery", "u")
"""Arrays that are not packed with the others."""
MEMBERS = ("ensemble",)
"""Arrays that are packed transposed: members last."""


@dataclass(frozen=True, slots=True, eq=False)
class Belief(Packed):
    """A filter's belief and everything its next step needs; leading axes are a batch.

    Every filter has these; a family that has more adds it in a record of its own. Of any belief one may ask for
    ``input_mean``, ``input_cov`` and ``ensemble``: they are None where the filter has none.

    Attributes:
        mean: ``(..., n)`` state estimate.
        cov: ``(..., n, n)`` its covariance.
        prior_mean: ``(..., n)`` where a lost row starts again.
        prior_cov: ``(..., n, n)`` likewise.
        recovery: ``(...)`` what the last update had to do, as the numbers of `Recovery`; 0: the usual.
        u: ``(..., m)`` the known input of the last prediction, or that of its reading where the update was given one;
            None: it was told none.
        innovation: ``(..., p)`` reading minus expectation, 0 where no reading came; None before an update.
        innovation_cov: ``(..., p, p)`` its covariance, unit where no reading came; likewise.
        available: ``(..., p)`` which readings the last update used; likewise.
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
    def looked_at(
        cls, packed: np.ndarray, layout: Layout, prior_mean: Any, prior_cov: Any, u: np.ndarray | None
    ) -> Self:
        """A belief of packed arrays ``(..., k)``, and of some that stand apart."""
        belief, put = object.__new__(cls), object.__setattr__
        packed.setflags(write=False)
        put(belief, "packed", packed)
        put(belief, "layout", layout)
        put(belief, "prior_mean", prior_mean)
        put(belief, "prior_cov", prior_cov)
        put(belief, "recovery", _usual(packed.shape[:-1]))
        (mean, _), (cov, square) = layout.cuts["mean"], layout.cuts["cov"]  # what everybody asks for
        put(belief, "mean", packed[mean])
        put(belief, "cov", packed[cov].reshape(packed.shape[:-1] + square))
        put(belief, "u", u)
        return belief

    def side_by_side(self) -> tuple[np.ndarray, Layout]:
        """Its arrays packed ``(..., k)``, and where each stands."""
        if self.packed is not None:
            return self.packed, self.layout
        arrays, batch = self.stored(), self.mean.shape[:-1]
        for name, array in arrays.items():
            if np.shape(array)[: len(batch)] != batch or not isinstance(array, np.ndarray | np.generic):
                raise ValueError(f"{name} of a belief must be an array with a row for each of the batch, {batch}")
        masks = frozenset(name for name, array in arrays.items() if array.dtype == bool)
        layout = laid_out(tuple((name, array.shape[len(batch) :]) for name, array in arrays.items()), masks)
        packed = np.empty(batch + (layout.width,))
        for name, (first, shape) in layout.columns.items():
            packed[..., first : first + math.prod(shape)] = arrays[name].reshape(*batch, math.prod(shape))
        return packed, layout

    @property
    def healthy(self) -> np.ndarray:
        """``(...)`` True where the last update was the usual one."""
        return self.recovery == 0

    @property
    def reasons(self) -> np.ndarray:
        """``(...)`` sentences that say what the last update did to each row, and why."""
        sentences = np.array([rung.reason for rung in Recovery], dtype=object)
        return np.asarray(sentences[self.recovery], dtype=object)

    @classmethod
    def of(cls, belief: "Belief", **own: Any) -> Self:
        """A belief as this record, which has ``own`` arrays beside those of every belief."""
        return cls(*(getattr(belief, name) for name in Belief.__dataclass_fields__), **own)

    @classmethod
    def predicted(cls, before: "Belief", mean: np.ndarray, cov: np.ndarray, u: np.ndarray | None, **own: Any) -> Self:
        """What a prediction from the belief ``before`` leaves, and the record's ``own`` arrays."""
        return cls(mean, cov, before.prior_mean, before.prior_cov, before.recovery, u, **own)

    @classmethod
    def updated(
        cls, before: "Belief", mean: np.ndarray, cov: np.ndarray, reading: Reading, S: np.ndarray, **own: Any
    ) -> Self:
        """What a usual update of the belief ``before`` leaves, ``S`` the innovation's covariance; likewise."""
        return cls(
            mean, cov, before.prior_mean, before.prior_cov, np.zeros(mean.shape[:-1], np.int8), before.u,
            reading.innovation, S, reading.available, **own,
        )  # fmt: skip

    def __getitem__(self, rows: Any) -> Self:
        """The beliefs of some rows of the batch: a mask, an index or a slice over leading axes."""
        if self.packed is not None:
            apart = {name: getattr(self, name) for name in APART}
            before = self.looked_at(self.packed[rows], self.layout, None, None, None)
            for name, array in apart.items():
                object.__setattr__(before, name, None if array is None else array[rows])
            return before
        arrays: dict[str, Any] = {name: None if a is None else a[rows] for name, a in self._arrays().items()}
        return type(self)(arrays.pop("mean"), **arrays)

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (type(self), self._arrays())

    def with_rows(self, rows: np.ndarray, other: "Belief") -> Self:
        """This belief with the rows of a mask ``(...)`` replaced, in order, by those of ``other``.

        One of the two may have seen no reading or no known input yet: its rows then have none (an innovation of 0).

        Raises:
            ValueError: if the two are beliefs of different filters.
        """
        if type(other) is not type(self):
            kinds = f"{type(self).__name__} and {type(other).__name__}"
            raise ValueError(f"cannot merge {kinds}: they are of different filters")
        packed = self.packed is not None and self.layout is other.layout
        merged: dict[str, Any] = {}
        for name in ("prior_mean", "prior_cov", "u") if packed else self.__dataclass_fields__:
            mine, theirs = getattr(self, name), getattr(other, name)
            if mine is not None or theirs is not None:
                merged[name] = np.array(_unseen(name, theirs, self) if mine is None else mine)
                merged[name][rows] = _unseen(name, mine, other) if theirs is None else theirs
        if not packed:
            return type(self)(**merged)
        together, width = self.packed.copy(), self.layout.width  # what a program adds behind is for itself
        together[rows, :width] = other.packed[..., :width]
        return self.looked_at(together, self.layout, **({"u": None} | merged))

    def replace(self, **changes: Any) -> Self:
        """This belief with some fields changed."""
        given = {name: as_array(name, a) if isinstance(a, list | tuple) else a for name, a in changes.items()}
        own = {name: frozen(a) if type(a) is np.ndarray else a for name, a in given.items()}
        arrays = self._arrays() | own
        return type(self)(arrays.pop("mean"), **arrays)

    def _moved(self, points: str, changes: dict[str, Any]) -> dict[str, Any]:
        """The points ``(..., N, n)`` of this name whose moments mean and covariance are, about a mean that is given.

        Raises:
            ValueError: if the covariance is given without the points.
        """
        if points in changes:
            return {}
        if "cov" in changes:
            raise ValueError(f"cov of this belief is that of its {points}: replace them, or begin anew with init")
        shift = np.asarray(changes.get("mean", self.mean)) - self.mean
        return {points: getattr(self, points) + shift[..., None, :]} if "mean" in changes else {}

    def read_only(self) -> Self:
        """This belief, into whose arrays nobody can write any more."""
        for array in self._arrays().values() if self.packed is None else (self.u,):  # the others are so when they begin
            if type(array) is np.ndarray:
                array.setflags(write=False)
        return self

    def with_input(self, u: np.ndarray | None) -> Self:
        """This belief with another known input, packed as it is."""
        if self.packed is None:
            same = self[...]
            object.__setattr__(same, "u", u)
            return same
        same = self.looked_at(self.packed, self.layout, self.prior_mean, self.prior_cov, u)
        object.__setattr__(same, "recovery", self.recovery)
        return same

    def stored(self) -> dict[str, Any]:
        """The arrays that are packed, by name, as they stand there."""
        arrays = self._arrays().items()
        return {name: a.mT if name in MEMBERS else a for name, a in arrays if a is not None and name not in APART}

    def _arrays(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in self.__dataclass_fields__}


def _restored(record: type[Record], arrays: dict[str, Any]) -> Record:
    """A belief that was pickled or copied, read-only again."""
    return record(arrays.pop("mean"), **arrays).read_only()


# Where a record gives what every belief can be asked for, `field` hides the property above, which is no default.


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class InputBelief(Belief):
    """The belief of a filter that estimates the unknown input, too.

    Attributes:
        input_mean: ``(..., q)`` estimate of the unknown input.
        input_cov: ``(..., q, q)`` its covariance.
        state_input_cov: ``(..., n, q)`` covariance between the two errors.
        input_observed: ``(..., q, q)`` projector on the directions of the unknown input that the readings show well;
            in the others its prior counts, too. None: the filter was told the input's covariance, which counts in every
            direction.
    """

    input_mean: np.ndarray = field()
    input_cov: np.ndarray = field()
    state_input_cov: np.ndarray
    input_observed: np.ndarray | None = None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DelayedInputBelief(InputBelief):
    """The belief of a filter to which a reading shows the unknown input of the step before.

    Attributes:
        input_observed: As in `InputBelief`.
        pending: ``(...)`` True where a prediction waits for the reading that shows its unknown input.
        input_matrix: ``(..., n, q)`` G of the last prediction, for a model whose G is a function.
    """

    input_observed: np.ndarray
    pending: np.ndarray
    input_matrix: np.ndarray | None = None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FeedthroughBelief(DelayedInputBelief):
    """The belief of a filter that sees a part of the unknown input at once, and the whole one step later.

    Attributes:
        feedthrough_mean: ``(..., q)`` what the readings of this very step show of the unknown input that acts
            now, 0 in the other directions.
        feedthrough_cov: ``(..., q, q)`` its covariance, 0 in the other directions.
        state_feedthrough_cov: ``(..., n, q)`` covariance of its error and the state's.
        feedthrough_observed: ``(..., q, q)`` projector on the directions that they show.
        input_reach: ``(..., n + q, q)`` how the unknown input stands in the errors of the state and of what is known of
            the input, in the directions of it that no reading has shown yet: those that act now, and after a prediction
            those that acted before it.
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
    """What updates had to do to rows of which each took the usual one, made once for as many."""
    recovery = np.zeros(rows, np.int8)
    recovery.flags.writeable = False
    return recovery


@cache
def laid_out(shapes: tuple[tuple[str, tuple[int, ...]], ...], masks: frozenset[str] = frozenset()) -> Layout:
    """Arrays of these names and shapes of a row, in their order, some of which are masks."""
    columns, width = {}, 0
    for name, shape in shapes:
        columns[name], width = (width, shape), width + math.prod(shape)
    cuts = {name: ((..., slice(at, at + math.prod(shape))), shape) for name, (at, shape) in columns.items()}
    return Layout(columns, width, cuts, masks)


def prior_belief(mean: np.ndarray, cov: np.ndarray, u: np.ndarray | None) -> Belief:
    """What is known before an episode, for a program that has the covariance ``(n, n)`` of all rows as a constant."""
    belief, batch = object.__new__(Belief), mean.shape[:-1]
    covs = np.empty(mean.shape + mean.shape[-1:])
    covs[...] = cov
    values: dict[str, Any] = {"packed": mean, "layout": laid_out((("mean", mean.shape[-1:]),)), "u": u}
    values |= {"prior_mean": mean, "prior_cov": covs, "recovery": _usual(batch)}
    for name, value in values.items():
        object.__setattr__(belief, name, value)
    return belief


def members_last(ensemble: np.ndarray) -> np.ndarray:
    """``(..., n, N)`` of an ensemble ``(..., N, n)``, contiguous: a view where members are last in memory already."""
    return ensemble.mT if is_traced(ensemble) else np.ascontiguousarray(ensemble.mT)


def over_time(beliefs: Sequence[Record]) -> Record:
    """Beliefs of one filter at successive times as one whose leading axis is time.

    Where one has seen no reading or no known input yet and another has, it has none (an innovation of 0).

    Raises:
        ValueError: if there is none, or they are of different filters.
    """
    kinds = {type(belief) for belief in beliefs}
    if len(kinds) != 1:
        raise ValueError(f"beliefs at successive times must be of one filter, got {len(kinds)} kinds of them")
    first, alike = beliefs[0], all(belief.layout is beliefs[0].layout for belief in beliefs)
    packed = None if first.packed is None or not alike else [b.packed[..., : first.layout.width] for b in beliefs]
    whole: dict[str, Any] = {}
    for name in first.__dataclass_fields__ if packed is None else APART:
        values = [getattr(belief, name) for belief in beliefs]
        seen = next((value for value in values if value is not None), None)
        if seen is None:
            whole[name] = None
            continue
        pairs = zip(values, beliefs, strict=True)
        whole[name] = np.stack([_unseen(name, seen, belief) if value is None else value for value, belief in pairs])
    if packed is None:
        return kinds.pop()(**whole).read_only()
    mean, cov, recovery, u = (read_only(whole[name]) for name in APART)
    together = first.looked_at(np.stack(packed), first.layout, mean, cov, u)
    object.__setattr__(together, "recovery", recovery)
    return together


def _unseen(name: str, like: np.ndarray, belief: Belief) -> np.ndarray:
    """What a field says in a belief that has seen no reading, or was told no known input, yet."""
    if name not in ("u", "inputs", "innovation", "innovation_cov", "available"):
        raise ValueError(f"cannot merge two beliefs of which only one has {name}: they are of different filters")
    size = like.shape[-1]
    blank = np.eye(size) if name == "innovation_cov" else np.zeros(size, like.dtype)
    return np.broadcast_to(blank, belief.mean.shape[:-1] + blank.shape)
