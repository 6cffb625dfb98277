"""What senses and estimates for many rows at once: the half of an environment that knows no truth and no task."""

from typing import Any

import numpy as np

from estimators import Belief, Gaussian, Numbers
from vessel_gym.estimation import Estimation, Oracle
from vessel_gym.sensors import Sensors

Readings = tuple[np.ndarray, np.ndarray]
"""Readings ``(B, p)`` and the mask ``(B, p)`` of those that arrived."""


class Loop:
    """Sensors, their randomness, and the filter and belief of B rows.

    `sense` reads what is true; `begin` and `estimate` are handed readings, and nothing else.

    Args:
        sensors: What is read.
        estimation: The filter, and what it is told.
        rows: B.

    Attributes:
        readings: The last ones.
        belief: What the filter believes.
    """

    def __init__(self, sensors: Sensors, estimation: Estimation, rows: int) -> None:
        self.rows = rows
        self.attach(sensors, estimation)
        self._sensing = np.zeros((rows, len(sensors.each), 2), np.uint64)
        self._filtering = Numbers(np.zeros((rows, 2), np.uint64))
        self.readings: Readings = np.zeros((rows, sensors.size)), np.zeros((rows, sensors.size), bool)
        self.belief: Belief

    def attach(self, sensors: Sensors, estimation: Estimation) -> None:
        """Take what is no state: a copy of a loop needs it again."""
        self.sensors, self.composition = sensors, estimation.composition
        self.filter, self._prior_factor = estimation.filter, estimation.prior
        self.tells_truth = isinstance(self.filter, Oracle)
        """Whether the filter is the declared exception, whose reading is the truth."""
        # A filter of somebody else's may write into what it is given; ours do not.
        self._foreign = not self.filter._ours

    def __getstate__(self) -> dict[str, Any]:
        """All but what `attach` gives, which may hold functions that cannot be pickled."""
        return {name: value for name, value in self.__dict__.items() if name not in _ATTACHED}

    def restart(self, rows: np.ndarray | slice, sensing: np.ndarray, filtering: np.ndarray) -> None:
        """Begin an episode of some rows, with keys ``(rows, sensors, 2)`` and ``(rows, 2)`` of the filter's numbers."""
        self._sensing[rows], self._filtering.keys[rows] = sensing, filtering

    def sense(
        self, state: np.ndarray, forcing: np.ndarray, bias: np.ndarray, steps: np.ndarray,
        rows: np.ndarray | slice | None,
    ) -> Readings:  # fmt: skip
        """Readings of rows (None: all) in a true ``state``, on which ``forcing`` acts, ``steps`` after their start."""
        keys = self._sensing if rows is None else self._sensing[rows]
        return self.sensors.read(state, forcing, bias, steps, keys)

    def begin(self, rows: np.ndarray | None, prior: Gaussian, readings: Readings, u: np.ndarray) -> Belief:
        """The belief of rows (None: all) after their first readings; those of the others stay.

        Args:
            rows: Which.
            prior: What is known at the start, of what the filter estimates.
            readings: The first.
            u: The known input.
        """
        rng = None
        if self.filter.random:
            rng = self._filtering if rows is None else self._filtering[rows]
        prior = prior if self._prior_factor == 1.0 else Gaussian(prior.mean, self._prior_factor * prior.cov)
        if self._foreign:
            belief = self._update(self.filter.init(prior, rng=rng), readings, rng, u)
        else:
            y, available = self._told(readings)
            belief = self.filter._corrected(self.filter._started(prior, rng, u), y, available, None, rng)
        if rows is None:
            self.belief = belief
        else:
            self.belief = self.belief.with_rows(rows, belief)
        return belief

    def estimate(self, readings: Readings, u: np.ndarray, steps: np.ndarray) -> None:
        """One step of all rows, after which they are ``steps (B,)`` on: the known input, then what was read."""
        rng = self._filtering.at(steps.copy()) if self.filter.random else None  # the core counts on in place
        if self._foreign:
            self.belief = self._update(self.filter.predict(self.belief, u, rng=rng), readings, rng)
        else:
            self.belief = self.filter._advance(self.belief, u, *self._told(readings), rng)

    def _update(self, belief: Belief, readings: Readings, rng: Numbers | None, u: np.ndarray | None = None) -> Belief:
        y, available = self._told(readings)
        if self._foreign:
            y, available = y.copy(), None if available is None else available.copy()
        return self.filter.update(belief, y, rng=rng, available=available, u=u)

    def _told(self, readings: Readings) -> tuple[np.ndarray, np.ndarray | None]:
        """Readings and mask, as filters take them."""
        return (readings[0], None) if self.tells_truth else readings


_ATTACHED = ("sensors", "composition", "filter")
