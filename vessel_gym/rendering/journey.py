"""History of an episode to be drawn: every moment, and the fixes of the position."""

from typing import NamedTuple

import numpy as np

from vessel_gym.core import Core
from vessel_gym.surroundings import pose


class Moment(NamedTuple):
    """One moment of an episode, or as columns a whole one."""

    step: np.ndarray
    truth: np.ndarray  # (n,) the vehicle's state
    estimate: np.ndarray  # (k,) of those of its components that are estimated
    cov: np.ndarray  # (k, k)
    unknown: np.ndarray  # (q,) unknown input of the coming step
    believed_unknown: np.ndarray  # (q,) NaN where the estimator has none
    action: np.ndarray  # (a,)
    score: np.ndarray


class Journey:
    """History of one vehicle on its way.

    Args:
        core: The environment's core.
        row: Which environment of the batch it is.
    """

    def __init__(self, core: Core, row: int) -> None:
        self._core, self._row = core, row
        self._moments: list[Moment] = []
        self.fixes: list[np.ndarray] = []
        """Places of the vehicle by fixes of its position, ``(3,)`` north, east and down."""
        self.names = core.vehicle.state_names
        self.estimated = core.composition.names[: core.composition.base]
        """The components of the vehicle's state that are estimated."""
        self.places = [self.names.index(name) for name in self.estimated]
        self._position = pose(np.eye(len(self.names)), self.names)[:, :3].T
        self.located = bool(self._position[:, self.places].any())
        """Is a component of the position estimated?"""
        self._gives = [self.names.index(name) if name in self.names else -1 for name in core.sensors.gives]
        level = [self.names.index(name) for name in ("x", "y") if name in self.names]
        self._level = [[channel for channel, given in enumerate(self._gives) if given == place] for place in level]
        self.fixed = bool(self._level) and all(self._level)
        """Is the position measured?"""

    def begin(self) -> None:
        """Forget the last episode."""
        self._moments.clear()
        self.fixes.clear()

    def record(self) -> None:
        """Append the core's present state, and a fix of the position if one has come."""
        core, row, k = self._core, self._row, len(self.places)
        belief, unknown = core.belief, core.unknown_input[row]
        d = belief.input_mean
        self._moments.append(
            Moment(
                core.steps[row], core.state[row].copy(), belief.mean[row, :k].copy(), belief.cov[row, :k, :k].copy(),
                unknown.copy(), np.full(len(unknown), np.nan) if d is None else d[row].copy(), core.action[row].copy(),
                core.score[row],
            )
        )  # fmt: skip
        measurements, available = core.measurements
        if self.fixed and all(available[row, channels].any() for channels in self._level):
            state = self._guess(self._moments[-1].truth, self._moments[-1].estimate)
            for channel, place in enumerate(self._gives):
                if place >= 0 and available[row, channel]:
                    state[place] = measurements[row, channel]
            self.fixes.append(self._position @ state)

    def history(self) -> Moment:
        """The episode so far, as columns."""
        return Moment(*(np.array(column) for column in zip(*self._moments, strict=True)))

    def true(self, history: Moment) -> np.ndarray:
        """True places and attitudes of the vehicle ``(T, 6)``, as `pose` has them."""
        return pose(history.truth, self.names)

    def believed(self, history: Moment) -> np.ndarray:
        """Estimated places and attitudes ``(T, 6)``, with the true values of what is not estimated."""
        return pose(self._guess(history.truth, history.estimate), self.names)

    def spread(self, cov: np.ndarray) -> np.ndarray:
        """The covariance of the believed position ``(3, 3)``: north, east, down."""
        root = self._position[:, self.places]
        return root @ cov @ root.T

    def members(self) -> np.ndarray | None:
        """Places ``(N, 3)`` of the vehicle by the members of the ensemble; None without one."""
        ensemble = self._core.belief.ensemble
        if ensemble is None or not self.located:
            return None
        members = ensemble[self._row, :, : len(self.places)]
        return self._guess(np.tile(self._moments[-1].truth, (len(members), 1)), members) @ self._position.T

    def _guess(self, truth: np.ndarray, estimate: np.ndarray) -> np.ndarray:
        guess = truth.copy()
        guess[..., self.places] = estimate
        return guess
