"""The estimator in the loop: a filter's belief in the record, from the delivered measurements."""

from collections.abc import Callable

import numpy as np

from estimators import Gaussian, RandomKeys
from vessel_gym.models.estimation import Estimation
from vessel_gym.simulation.delivery import youngest
from vessel_gym.simulation.state import State


class Estimator:
    """A filter whose belief is in the record.

    Args:
        estimation: Filter and model.
        field: Field of the record with the belief, ``"belief"`` or ``"raw"``.
        truth: Function of the record that returns the measurement of the oracle.

    Attributes:
        parameters: ``(B, k)`` of a filter with parameters by rows; None: the filter's own.
    """

    def __init__(
        self, estimation: Estimation, field: str, truth: Callable[[State], np.ndarray]
    ) -> None:
        self.estimation, self.field = estimation, field
        self.filter, self._random = estimation.delayed, estimation.filter.random
        self._truth = truth if estimation.tells_truth else None
        self.parameters: np.ndarray | None = None

    def begin(self, now: State, prior: Gaussian) -> None:
        """Belief after the first measurements; the prior is that of the filter's state."""
        rng = RandomKeys(now.filtering) if self._random else None
        y, available = self._measured(now)
        initial = self.filter.init(prior, rng=rng)
        if self.parameters is not None:
            initial = initial.replace(parameters=self.parameters)
        belief = self.filter.update(initial, y, rng=rng, available=available, u=now.u)
        setattr(now, self.field, belief)

    def step(self, now: State) -> None:
        """Belief a step later: predict, then update."""
        rng = RandomKeys(now.filtering, now.steps) if self._random else None
        y, available = self._measured(now)
        before = getattr(now, self.field)
        setattr(now, self.field, self.filter.step(before, y, now.u, rng=rng, available=available))

    def _measured(self, now: State) -> tuple[np.ndarray, np.ndarray | None]:
        """Measurements and their mask in the form for the filter."""
        if self._truth is not None:
            return self._truth(now), None
        if now.arrived is None:
            return now.y, now.available
        y, available = now.arrived
        if self.estimation.fuses:
            return y, available
        if self.estimation.late == "as new":
            return youngest(now.arrived)
        return y[:, 0], available[:, 0]
