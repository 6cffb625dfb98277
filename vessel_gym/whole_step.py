"""A whole step as one program: world, filter and mission, where all of them are compiled."""

from collections.abc import Sequence
from functools import partial
from operator import attrgetter, itemgetter
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from estimators import RandomKeys
from estimators.engine import trace
from estimators.engine.arrays import TracedArray
from estimators.engine.function import Argument
from estimators.engine.matrices import matrix
from vessel_gym.estimation import Estimation
from vessel_gym.mission import Mission
from vessel_gym.state import Changes, State
from vessel_gym.truth import INFO, TrueState, UnknownInput, info_arrays
from vessel_gym.world import World

_GIVEN = "action", "noise_before", "exogenous_before"
"""Arrays of the record that are not results of the program."""
_ROW, _FIRST_OF = itemgetter(0), itemgetter(None)
_SEEN = "observation", "reward", "end", "total", "steps"


class Moment(NamedTuple):
    """A record as a program made it, in which fields are looked up only when they are asked for.

    The arrays of one environment have no axis of the batch.

    Attributes:
        program: The program.
        base: An earlier record of the episode, whose other fields no step changes.
        values: Arguments of the step: the action, arrays that no step changes, arrays before it.
        found: Results of the step, with the arrays of ``info`` last.
    """

    program: "WholeStep"
    base: State
    values: tuple[np.ndarray, ...]
    found: tuple[np.ndarray, ...]

    def record(self) -> State:
        """The record, with all its fields."""
        one = self.values[0].ndim == 1
        values, found = (
            [*map(_FIRST_OF, each)] if one else each for each in (self.values, self.found)
        )
        return self.program.record(self.base, values, found)

    def info(self) -> dict[str, np.ndarray]:
        """The arrays of ``info`` that the program made."""
        return dict(zip(INFO, self.found[self.program.first_info :], strict=True))


class WholeStep:
    """The stages of a step in one program; the stages one by one give the same bits.

    Args:
        world: Its stage moves the truth and samples the sensors.
        estimation: Filter whose prediction and update are compiled together.
        mission: Its stage scores the step.
        info: Does the program also make the arrays of ``info``? They belong to the caller.

    Attributes:
        seen: Function of a `Moment`'s results that returns observation, reward, end, sum of rewards
            and number of steps; the observation is that of `vessel_gym.mission.Mission`.
        first_info: Number of results before the arrays of ``info``.
    """

    def __init__(self, world: World, estimation: Estimation, mission: Mission, info: bool) -> None:
        self._world, self._mission, self._filter = world, mission, estimation.filter
        self._true_state = TrueState.of(world, estimation.composition)
        self._unknown_input = UnknownInput.of(world, estimation.inputs)
        self._info = INFO if info else ()
        self._read: Any = None
        self.seen: Any = None
        self.first_info = 0

    @staticmethod
    def serves(world: World, estimation: Estimation, mission: Mission) -> bool:
        """Can these stages be one program? Not with users' NumPy, late or faulty sensors."""
        compiled = world.step.compiled and mission.step.compiled and mission.guided
        in_time = not world.sensors.horizon and not world.sensors.faults
        plain = compiled and in_time and not estimation.tells_truth
        return plain and estimation.filter.joins_steps()

    def __call__(self, last: State | Moment, action: np.ndarray) -> Moment | None:
        """The record a step later; None if the filter loses a row, which the stages recover.

        Args:
            last: The record before the step.
            action: ``(B, a)``, or ``(a,)`` of one environment.
        """
        if self._read is None:
            self._trace(last.record() if isinstance(last, Moment) else last)
        if isinstance(last, Moment):
            base, values = last.base, (action, *last.values[1 : self._end_of_rest], *last.found)
        else:
            rest = self._values(last)
            base, values = last, (action, *(map(_ROW, rest) if action.ndim == 1 else rest))
        arrays = self._read(values)
        if (found := self._program.call(*arrays)) is None:
            found = self._program.compute(*arrays)
        if b"\0" in found[self._healthy].tobytes():
            return None
        return Moment(self, base, values, found)

    def record(self, base: State, values: Sequence[Any], found: Sequence[Any]) -> State:
        """The record of a `Moment`."""
        first = len(self._changed)
        fields = dict(zip(self._names[first:], found[first:], strict=False))
        noise, exogenous = self._before(values)
        changed = dict(zip(self._changed, found, strict=False)) | {"u": fields["u"]}
        return base.but(
            **fields, action=values[0], noise_before=noise, exogenous_before=exogenous,
            belief=base.belief.replaced(changed), info=None,
        )  # fmt: skip

    def _trace(self, last: State) -> None:
        """Trace the stages for rows of the record."""
        record = self._filter.record
        self._filter.model.compare(last.belief.mean, last.u, "step")
        names = record.names()
        held = {name: each for name, each in vars(last).items() if isinstance(each, np.ndarray)}
        arrays = held | {f"belief.{name}": getattr(last.belief, name) for name in names}
        rows = [Argument(each.shape[1:], each.dtype.kind) for each in arrays.values()]

        def function(*tracers: Any) -> list[Any]:
            row = State(**dict(zip(held, tracers, strict=False)))
            row = row.but(
                steps=row.steps + 1, noise_before=row.noise, exogenous_before=row.exogenous
            )
            belief = record.of(dict(zip(names, tracers[len(held) :], strict=True)))
            changed, fields = self._changes(row, belief)
            self._changed, self._names = (*changed,), (*changed, *fields)
            info = self._info_results(row.but(**fields), belief.replaced(changed))
            return [*changed.values(), *fields.values(), *info]

        whole = [name not in held for name in arrays]
        own = len(self._info)
        self._program = trace(function, rows, whole, sealed=True, own=own)
        self._lay_out([*arrays])

    def _lay_out(self, arguments: list[str]) -> None:
        """Find the program's arguments among the values of a step, and what is read of results."""
        fields = self._names[len(self._changed) :]
        results = [*(f"belief.{name}" for name in self._changed), *fields]
        rest = [name for name in arguments if name not in {*results, *_GIVEN}]
        values = ["action", *rest, *results]
        self._end_of_rest, self._values = 1 + len(rest), attrgetter(*values[1:])
        read = (arguments[i] for i in self._program.arguments)
        self._read = itemgetter(*map(values.index, read))
        self._before = itemgetter(values.index("noise"), values.index("exogenous"))
        self.first_info = len(self._names)
        self._healthy = self._names.index("healthy")
        self.seen = itemgetter(*map(self._names.index, _SEEN))

    def _changes(self, row: State, belief: Any) -> tuple[Changes, Changes]:
        """Arrays of the belief and of the record that a step changes."""
        world = self._world.step.function(row)
        row = row.but(**world)
        whole, filter = partial(_whole, belief.mean.program), self._filter
        rng = RandomKeys(row.filtering, row.steps) if filter.random else None
        data = whole(row.u), whole(row.y), whole(row.available), None, rng
        before = belief.replaced({"u": data[0]})
        changed = filter._changed("step", before, data)
        row = row.but(belief=_entrywise(before.replaced(changed)))
        return changed, {"steps": row.steps} | world | self._mission.step.function(row)

    def _info_results(self, row: State, belief: Any) -> list[Any]:
        """Arrays of ``info``, if they are asked for."""
        if not self._info:
            return []
        row = row.but(belief=_entrywise(belief))
        return [*info_arrays(self._true_state, self._unknown_input, row).values()]


def _entrywise(belief: Any) -> Any:
    """The arrays of a traced belief that missions and ``info`` read, entry by entry."""
    d = None if belief.input_mean is None else belief.input_mean.scalars()
    return SimpleNamespace(mean=belief.mean.scalars(), cov=belief.cov, input_mean=d)


def _whole(program: Any, value: Any) -> Any:
    """A traced array as a vector or matrix."""
    return matrix(program, TracedArray.of(value))
