"""Arrays of ``info`` as functions of the record: true states, true unknown input, and others."""

from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from vessel_gym.models.state_space import StateSpace
from vessel_gym.sensors import columns
from vessel_gym.simulation.state import Changes, State
from vessel_gym.simulation.world import World

INFO = (
    "truth", "unknown_input", "reference", "actuators", "measurement", "available", "estimate",
    "covariance", "input_estimate", "parameters", "healthy", "score", "end", "is_success",
)  # fmt: skip
"""Arrays of ``info``."""
SCORED = INFO[-4:]
"""Arrays of ``info`` with one number for each environment."""


class TrueState(NamedTuple):
    """Components of `vessel_gym.simulation.core.Core.truth`."""

    names: tuple[str, ...]
    slow: slice  # components of the record's ``slow`` among them
    alone: bool  # are they the vehicle's state alone?
    estimated: list[int]  # places of the filter's states; -1: only the filter's model has the state
    increments: list[int]  # indices of those of the step that has ended that are components

    def values(self, now: State) -> np.ndarray:
        """True states ``(B, n)``."""
        if self.alone:
            return now.state
        increments = now.exogenous_before[..., self.increments]
        return np.concatenate([now.state, now.slow[..., self.slow], increments], -1)

    def in_filter_order(self, truth: np.ndarray) -> np.ndarray:
        """True states ``(..., n)`` in the order of the filter's; NaN where the truth has none."""
        state = truth[..., self.estimated]
        state[..., [index < 0 for index in self.estimated]] = np.nan
        return state

    @classmethod
    def of(cls, world: World, space: StateSpace) -> "TrueState":
        """The true state of a world, with the places of a filter's states."""
        disturbance, vehicle = world.disturbance, world.vehicle.state_names
        waves = disturbance.assumed_as == "states" or len(space.kept) > 0
        names = *vehicle, *(disturbance.names if waves else ()), *world.sensors.bias_names
        names = *names, *space.last_names
        estimated = [names.index(name) if name in names else -1 for name in space.names]
        slow = slice(0 if waves else world.size, None)
        return cls(names, slow, len(names) == len(vehicle), estimated, [*space.last])


class UnknownInput(NamedTuple):
    """Places of the true unknown input in the environment's state.

    Increments and changes are those of the step that has ended, flows and faults the present ones.
    """

    columns: Any  # of one array, or of all three side by side and a last column of NaN
    array: (
        str  # "noise_before", "exogenous_before" or "exogenous"; "" for columns of several arrays
    )

    def values(self, now: State) -> np.ndarray:
        """True unknown input ``(B, q)``; NaN in components that only the filter's model has."""
        if self.array:
            chosen: np.ndarray = getattr(now, self.array)[..., self.columns]
            return chosen
        unheard = np.full((*now.steps.shape, 1), np.nan)
        arrays = now.noise_before, now.exogenous_before, now.exogenous, unheard
        return np.concatenate(arrays, -1)[..., self.columns]

    @classmethod
    def of(cls, world: World, names: tuple[str, ...]) -> "UnknownInput":
        """Places of the components of the unknown input, by their names."""
        channels, increments = world.space.channels, world.vehicle.increments
        arrays = {
            "noise_before": world.space.noise_names,
            "exogenous_before": [name if name in increments else None for name in channels],
            "exogenous": [None if name in increments else name for name in channels],
        }  # fmt: skip
        for array, held in arrays.items():
            if all(name in held for name in names):
                return cls(columns([held.index(name) for name in names]), array)
        held = [*chain(*arrays.values())]
        return cls(columns([held.index(name) if name in held else len(held) for name in names]), "")


class Scale(NamedTuple):
    """Scale of a task's scores, and its success."""

    perfect: float  # sum of rewards of a perfect episode
    each: float  # reward of a further step of a perfect episode
    success: int  # number of the end reason; 0: to last for the horizon
    least: int  # steps of the shortest episode that can be a success

    @classmethod
    def of(cls, task: Any) -> "Scale":
        """The scale of a task."""
        perfect, success = float(task.perfect), task.end_reasons.index(task.success)
        least = 0 if success else task.horizon
        return cls(perfect, float(task.perfect == task.horizon), success, least)

    def scores(self, total: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """Scores ``(B,)`` in [0, 1]: sums of rewards over that of a perfect episode."""
        shares = total / np.maximum(self.perfect, self.each * steps)
        return np.minimum(np.maximum(shares, 0.0), 1.0)

    def successes(self, end: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """Mask ``(B,)`` of the episodes that have ended as the task asks."""
        return (end == self.success) & (steps >= self.least)


def info_arrays(
    true_state: TrueState, unknown_input: UnknownInput, scale: Scale, now: State
) -> Changes:
    """Arrays of ``info``, one row for each environment."""
    unknown, belief, d = unknown_input.values(now), now.belief, now.belief.input_mean
    arrays = (
        true_state.values(now), unknown, now.reference, now.actuators, now.y, now.available,
        belief.mean, belief.cov, np.zeros(unknown.shape) if d is None else d, now.parameters,
        belief.healthy, scale.scores(now.total, now.steps), now.end,
        scale.successes(now.end, now.steps),
    )  # fmt: skip
    return dict(zip(INFO, arrays, strict=True))
