"""Arrays of ``info`` as functions of the record: true states, true unknown input, and others."""

from typing import Any, NamedTuple

import numpy as np

from vessel_gym.models.estimation import Estimation
from vessel_gym.models.state_space import StateSpace
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
    estimated: list[int]  # places of the filter's states; -1: only the filter's model has the state
    increments: list[int]  # indices of those of the step that has ended that are components

    def values(self, now: State) -> np.ndarray:
        """True states ``(B, n)``."""
        increments = now.exogenous_before[..., self.increments]
        return np.concatenate([now.state, now.slow[..., self.slow], increments], -1)

    def in_filter_order(self, truth: np.ndarray) -> np.ndarray:
        """True states ``(..., n)`` in the order of the filter's; NaN where the truth has none."""
        return _with_unknown(truth)[..., self.estimated]

    @classmethod
    def of(cls, world: World, space: StateSpace) -> "TrueState":
        """The true state of a world, with the places of a filter's states."""
        disturbance, vehicle = world.disturbance, world.vehicle.state_names
        waves = disturbance.assumed_as == "states" or len(space.kept) > 0
        names = *vehicle, *(disturbance.names if waves else ()), *world.sensors.bias_names
        names = *names, *space.last_names
        estimated = [names.index(name) if name in names else -1 for name in space.names]
        slow = slice(0 if waves else world.size, None)
        return cls(names, slow, estimated, [*space.last])


def _with_unknown(values: np.ndarray) -> np.ndarray:
    """Values ``(..., k + 1)`` with NaN in a last column, which the index -1 finds."""
    return np.concatenate([values, np.full((*values.shape[:-1], 1), np.nan)], -1)


class Info:
    """The arrays of ``info`` as a function of the record.

    Args:
        world: True world.
        estimation: Filter and its model.
        task: Task.

    Attributes:
        true_state: Places of the true state.
        perfect: Sum of rewards of a perfect episode.
        each: Reward of a further step of a perfect episode.
        success: Number of the end reason that means success; 0: to last for the horizon.
        least: Steps of the shortest episode that can be a success.
    """

    def __init__(self, world: World, estimation: Estimation, task: Any) -> None:
        self.true_state = TrueState.of(world, estimation.space)
        self.perfect, self.each = float(task.perfect), float(task.perfect == task.horizon)
        self.success = task.end_reasons.index(task.success)
        self.least = 0 if self.success else task.horizon
        channels, increments = world.space.channels, world.vehicle.increments
        before = [name if name in increments else "" for name in channels]
        known = *before, *channels, *world.space.noise_names  # as `unknown_input` joins them
        self._inputs = [known.index(d) if d in known else -1 for d in estimation.inputs]

    def __call__(self, now: State) -> Changes:
        """Arrays of ``info``, one row for each environment."""
        unknown, belief, d = self.unknown_input(now), now.belief, now.belief.input_mean
        arrays = (
            self.true_state.values(now), unknown, now.reference, now.actuators, now.y,
            now.available, belief.mean, belief.cov, np.zeros(unknown.shape) if d is None else d,
            now.parameters, belief.healthy, self.scores(now.total, now.steps), now.end,
            (now.end == self.success) & (now.steps >= self.least),
        )  # fmt: skip
        return dict(zip(INFO, arrays, strict=True))

    def unknown_input(self, now: State) -> np.ndarray:
        """True unknown input ``(B, q)``; NaN in components that only the filter's model has.

        Increments and changes are those of the step that has ended, flows and faults the present
        ones.
        """
        arrays = now.exogenous_before, now.exogenous, now.noise_before
        return _with_unknown(np.concatenate(arrays, -1))[..., self._inputs]

    def scores(self, total: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """Scores ``(B,)`` in [0, 1]: sums of rewards over that of a perfect episode."""
        shares = total / np.maximum(self.perfect, self.each * steps)
        return np.minimum(np.maximum(shares, 0.0), 1.0)

    def oracle(self, now: State) -> np.ndarray:
        """Measurement ``(B, n + q)`` of the oracle alone: true state and unknown input."""
        truth = self.true_state.in_filter_order(self.true_state.values(now))
        return np.concatenate([truth, self.unknown_input(now)], -1)
