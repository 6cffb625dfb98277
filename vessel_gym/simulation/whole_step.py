"""A whole step as one program: world, filter and mission, where all of them are compiled."""

from collections.abc import Mapping, Sequence
from itertools import accumulate
from math import prod
from operator import itemgetter
from types import SimpleNamespace
from typing import Any, NamedTuple, cast

import numpy as np

from estimators import RandomKeys
from estimators.engine import Argument, SideBySide, TracedArray, by_entries, matrix, trace
from estimators.stepping import changes
from vessel_gym.models.estimation import Estimation
from vessel_gym.simulation.mission import Mission
from vessel_gym.simulation.state import Changes, State, apart, arrays_of, in_rows
from vessel_gym.simulation.truth import INFO, Info
from vessel_gym.simulation.world import World

_FIXED = "parameters", "scenario", "episode_constants"
"""Floats of the record that no step changes."""
_ROW = itemgetter((0, ...))  # of one environment, also of one number an environment


class Moment(NamedTuple):
    """A record as a program made it, in which fields are looked up only when they are asked for.

    The arrays of one environment have no axis of the batch; what the properties return has one.

    Attributes:
        program: The program.
        base: An earlier record of the episode, whose other fields no step changes.
        given: Arguments of the step: the action, and arrays that no step changes.
        found: Results of the step: numbers side by side, and other arrays.
    """

    program: "WholeStep"
    base: State
    given: tuple[np.ndarray, ...]
    found: tuple[np.ndarray, ...]

    def record(self) -> State:
        """The record, with all its fields."""
        return self.program.record(self.base, _batched(self.given), _batched(self.found))

    def seen(self) -> tuple[np.ndarray, float]:
        """Observation and reward of one environment."""
        places = self.program.places
        return self.found[places.observation], self.found[places.reward].item()

    @property
    def observation(self) -> np.ndarray:
        """Observations ``(B, k)``."""
        observation = self.found[self.program.places.observation]
        return observation.reshape(-1, observation.shape[-1])

    @property
    def reward(self) -> np.ndarray:
        """Rewards ``(B,)``."""
        return self.found[self.program.places.reward].reshape(-1)

    @property
    def total(self) -> np.ndarray:
        """Sums of rewards ``(B,)``."""
        return self.found[self.program.places.total].reshape(-1)

    def end_of(self, row: int) -> int:
        """Number of the end reason of one environment."""
        return int(self.found[self.program.places.end].item(row))

    @property
    def end(self) -> np.ndarray:
        """Numbers of the end reasons ``(B,)``."""
        return self.found[self.program.places.end].reshape(-1)

    @property
    def steps(self) -> np.ndarray:
        """Numbers of steps ``(B,)``."""
        return self.found[self.program.places.steps].reshape(-1)

    @property
    def over(self) -> np.ndarray:
        """Mask ``(B,)`` of episodes that have ended and are not yet reset."""
        return self.base.over

    @property
    def episode(self) -> np.ndarray:
        """Numbers of the episodes ``(B,)``."""
        return self.base.episode

    def but(self, **changes: Any) -> "Moment":
        """The results with other values in some fields that no step changes."""
        return self._replace(base=self.base.but(**changes))

    def take(self, rows: np.ndarray) -> "Moment":
        """The results in the environments of some indices ``(B',)``, of two or more."""
        given, found = (tuple(each[rows] for each in part) for part in (self.given, self.found))
        return self._replace(base=self.base.take(rows), given=given, found=found)

    def merged(self, rows: np.ndarray, some: State) -> "Moment":
        """The results with the values of episodes that start in the rows of some indices."""
        return self.program.merged(self, rows, some)


class _Places(NamedTuple):
    """Places among the results of what is asked for after each step: arrays of their own."""

    observation: int
    reward: int
    total: int
    end: int
    steps: int


class Layout:
    """Places of arrays ``(B, ...)`` in one array ``(B, k)``, as fewer arrays take less time.

    Args:
        shapes: Shape of a row of each array, by name.

    Attributes:
        first: Column of the first number of each array, by name.
        size: Number of columns k.
    """

    def __init__(self, shapes: Mapping[str, tuple[int, ...]]) -> None:
        self._shapes = shapes
        *starts, self.size = accumulate(map(prod, shapes.values()), initial=0)
        self.first = dict(zip(shapes, starts, strict=True))

    def parts(self, numbers: np.ndarray) -> dict[str, np.ndarray]:
        """The arrays, read-only and in C order."""
        parts = {}
        for name, shape in self._shapes.items():
            start = self.first[name]
            part = numbers[:, start : start + prod(shape)].copy()  # for the strides of one row, too
            parts[name] = part.reshape(len(numbers), *shape)
            parts[name].setflags(write=False)
        return parts

    def traced(self, numbers: Any) -> dict[str, Any]:
        """The arrays of a row as vectors, matrices and numbers, from a traced vector ``(k,)``."""
        parts = {}
        for name, shape in self._shapes.items():
            start = self.first[name]
            parts[name] = numbers[start : start + prod(shape)].reshape(shape)[()]
        return parts


class WholeStep:
    """The stages of a step in one program; the stages one by one give the same bits.

    Args:
        world: Its stage moves the truth and samples the sensors.
        estimation: Filter whose prediction and update are compiled together.
        mission: Its stage scores the step.
        info: Function that makes the arrays of ``info``, which belong to the caller; None: the
            program makes none.

    Attributes:
        layout: Places of the record's numbers in the program's first result.
        others: Names of its other results, but for the arrays of ``info``.
        places: Places of what is asked for after each step.
    """

    def __init__(
        self, world: World, estimation: Estimation, mission: Mission, info: Info | None
    ) -> None:
        self._world, self._mission, self._filter = world, mission, estimation.filter
        self._info, self._read = info, cast(Any, None)
        self.layout, self.others = Layout({}), list[str]()
        self.places: Any = None

    @staticmethod
    def serves(world: World, estimation: Estimation, mission: Mission) -> bool:
        """Can these stages be one program? Not with users' NumPy, late or faulty sensors."""
        compiled = world.step.compiled and mission.step.compiled and mission.observes
        in_time = not world.sensors.horizon and not world.sensors.faults
        plain = compiled and in_time and not estimation.tells_truth
        return plain and estimation.filter.joins_steps()

    def __call__(
        self, last: State | Moment, action: np.ndarray
    ) -> tuple[Moment | None, tuple[np.ndarray, ...]]:
        """The record a step later, and the arrays of ``info``.

        The record is None if the filter loses a row, which the stages recover.

        Args:
            last: The record before the step.
            action: ``(B, a)``, or ``(a,)`` of one environment.
        """
        if self._read is None:
            self._trace(last.record() if isinstance(last, Moment) else last)
        if isinstance(last, Moment):
            base, values = last.base, (action, *last.given[1:], *last.found)
        else:
            rest = self._values(last)
            base, values = last, (action, *(map(_ROW, rest) if action.ndim == 1 else rest))
        found = self._program.call(*self._read(values))
        if b"\0" in found[self._healthy].tobytes():
            return None, ()
        record, info = found[: self._first_info], found[self._first_info :]
        return Moment(self, base, values[: self._end_of_fixed], record), info

    def record(self, base: State, given: Sequence[Any], found: Sequence[Any]) -> State:
        """The record of a `Moment`."""
        others = dict(zip(self.others, found[1:], strict=True))
        fields, belief = apart(self.layout.parts(found[0]) | others)
        belief = base.belief.replaced(belief | {"u": fields["u"]})
        return base.but(**fields, action=given[0], belief=belief)

    def merged(self, moment: Moment, rows: np.ndarray, some: State) -> Moment:
        """See `Moment.merged`."""
        new, held = self._values(some), arrays_of(moment.base)
        old = [*map(held.__getitem__, self._fixed), *moment.found]
        made = [in_rows(was, rows, now) for was, now in zip(old, new, strict=True)]
        fixed, found = made[: len(self._fixed)], made[len(self._fixed) :]
        fields, belief = apart(dict(zip(self._fixed, fixed, strict=True)))
        base = moment.base.but(**fields, belief=moment.base.belief.replaced(belief))
        action = in_rows(moment.given[0], rows, 0.0)
        return Moment(self, base, (action, *fixed), tuple(found))

    def _values(self, last: State) -> list[np.ndarray]:
        """Arguments of a step from a record, but for the action."""
        arrays = arrays_of(last)
        numbers = [arrays[name].reshape(len(last.steps), -1) for name in self.layout.first]
        fixed, others = ([arrays[name] for name in each] for each in (self._fixed, self.others))
        return [*fixed, np.concatenate(numbers, 1), *others]

    def _trace(self, last: State) -> None:
        """Trace the stages for rows of the record."""
        arrays = arrays_of(last).items()
        rows = {name: Argument(a.shape[1:], a.dtype.kind, "." in name) for name, a in arrays}
        alone = "action", *_FIXED, *_Places._fields
        numbers = [n for n, row in rows.items() if row.kind == "f" and n not in alone]
        layout = self.layout = Layout({name: rows.pop(name).shape for name in numbers})

        def function(block: Any, *tracers: Any) -> list[Any]:
            given = layout.traced(block) | dict(zip(rows, tracers, strict=True))
            changed, info = self._changes(given)
            after = given | changed
            self.others = [name for name in changed if name not in layout.first]
            others = map(after.__getitem__, self.others)
            return [SideBySide(map(after.__getitem__, numbers)), *others, *info]

        arguments = [Argument((layout.size,), whole=True), *rows.values()]
        self._program = trace(function, arguments, sealed=True, own=len(INFO) if self._info else 0)
        self._lay_out([*rows])

    def _lay_out(self, apart: list[str]) -> None:
        """Find the program's arguments among the values of a step."""
        self._fixed = [name for name in apart if name not in {*self.others, "action"}]
        self._end_of_fixed, self._first_info = 1 + len(self._fixed), 1 + len(self.others)
        self._healthy = 1 + self.others.index("belief.healthy")
        self.places = _Places(*(1 + self.others.index(name) for name in _Places._fields))
        values = ["action", *self._fixed, "", *self.others]
        self._read = itemgetter(*map(values.index, ["", *apart]))

    def _changes(self, given: dict[str, Any]) -> tuple[Changes, list[Any]]:
        """Arrays that a step changes, and the arrays of ``info``."""
        fields, arrays = apart(given)
        row: Any = State(**{name: by_entries(array) for name, array in fields.items()})
        first = {
            "steps": row.steps + 1, "noise_before": row.noise, "exogenous_before": row.exogenous,
        }  # fmt: skip
        world, filter = self._world.step.function(row.but(**first)), self._filter
        row = row.but(**first, **world)
        rng = RandomKeys(row.filtering, row.steps) if filter.random else None
        data = *map(_whole, (row.u, row.y, row.available)), None, rng
        belief = filter.record.of(arrays | {"u": data[0]})
        changed = changes(filter, "step", belief, data)
        row = row.but(belief=_entrywise(belief.replaced(changed)))
        scored = self._mission.step.function(row)
        row = row.but(**scored)
        named = {f"belief.{name}": array for name, array in changed.items()}
        every = first | world | scored | named
        return every, [*self._info(row).values()] if self._info else []


def _batched(arrays: Sequence[np.ndarray]) -> Sequence[np.ndarray]:
    """Arrays with a row for each environment, of which the first is ``(a,)`` for one."""
    return arrays if arrays[0].ndim > 1 else [each[None] for each in arrays]


def _entrywise(belief: Any) -> Any:
    """The arrays of a traced belief that missions and ``info`` read, entry by entry."""
    return SimpleNamespace(
        mean=by_entries(belief.mean),
        cov=belief.cov,
        input_mean=by_entries(belief.input_mean),
        input_cov=belief.input_cov,
        healthy=belief.healthy,
    )


def _whole(value: Any) -> Any:
    """A traced array as a vector or matrix."""
    return matrix(TracedArray.of(value))
