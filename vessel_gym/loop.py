"""Sensing and estimation of many rows, the part of an environment without truth and task."""

from operator import attrgetter
from typing import Any, cast

import numpy as np

from estimators import Belief, Gaussian, RandomKeys
from vessel_gym.delivery import Faulty, Measurements, Transit, of_now, youngest
from vessel_gym.estimation import Estimation


class Loop:
    """Sensors, their random numbers, and filter and belief of B rows.

    `receive` decides which measurements are delivered, and when. `begin` and `estimate` use the
    delivered ones alone.

    Args:
        owner: Object with ``sensors`` and an `Estimation`.
        rows: B.
        name: Name of the owner's attribute with the `Estimation`.

    Attributes:
        delivered: Measurements delivered last, ``(B, p)``; with late sensors by age, ``(B, ages,
            p)``.
        measurements: Youngest delivered measurement of each channel.
        belief: Belief of the filter.
        sensing: Keys ``(B, sensors, 2)`` of the sensors' random numbers.
    """

    sensors = property(attrgetter("owner.sensors"))
    composition, filter, tells_truth = (
        cast(Any, property(attrgetter(f"estimation.{name}")))
        for name in ("composition", "filter", "tells_truth")
    )

    def __init__(self, owner: Any, rows: int, name: str = "estimation") -> None:
        self.owner, self.name, self.rows = owner, name, rows
        sensors = owner.sensors
        self.sensing = np.zeros((rows, len(sensors.each), 2), np.uint64)
        self._filtering = RandomKeys(np.zeros((rows, 2), np.uint64))
        self._faults = Faulty(sensors, rows) if sensors.faults else None
        self._transit = Transit(sensors, rows) if sensors.horizon else None
        ages = (sensors.horizon + 1,) if sensors.horizon else ()
        self.delivered: Measurements = tuple(
            np.zeros((rows, *ages, sensors.size), kind) for kind in (float, bool)
        )  # type: ignore
        self.measurements: Measurements = youngest(self.delivered) if ages else self.delivered
        self.belief: Belief

    @property
    def estimation(self) -> Estimation:
        """Filter and model."""
        estimation: Estimation = getattr(self.owner, self.name)
        return estimation

    def restart(self, rows: np.ndarray | slice, sensing: np.ndarray, filtering: np.ndarray) -> None:
        """Begin an episode of some rows, with the keys of sensors ``(rows, sensors, 2)``.

        The keys of the filter are ``filtering (rows, 2)``.
        """
        self.sensing[rows], self._filtering.keys[rows] = sensing, filtering
        if self._faults is not None:
            self._faults.restart(rows, sensing)
        if self._transit is not None:
            self._transit.restart(rows)

    def receive(
        self,
        measurements: Measurements,
        steps: np.ndarray,
        rows: np.ndarray | None,
        injected: bool = False,
    ) -> Measurements:
        """Deliver measurements to some rows, and return them.

        Args:
            measurements: Samples of this step.
            steps: ``(rows,)`` steps since the start.
            rows: Indices of the rows; None for all.
            injected: Are the measurements delivered as they are, ``(rows, p)`` or by age?
        """
        delivered = measurements
        if self._faults is not None or self._transit is not None:
            delivered = self._delivered(
                measurements, steps, slice(None) if rows is None else rows, injected
            )
        self.delivered = _merged(self.delivered, rows, delivered)
        if self._transit is None:
            self.measurements = self.delivered
        else:
            own = youngest(delivered) if injected else self._transit.youngest(delivered)
            self.measurements = _merged(self.measurements, rows, own)
        return delivered

    def begin(
        self, rows: np.ndarray | None, prior: Gaussian, measurements: Measurements, u: np.ndarray
    ) -> Belief:
        """Belief of some rows (None: all) after the first measurements; other rows keep theirs.

        The prior is that of the filter's state.
        """
        rng, estimation = None, self.estimation
        filter = estimation.filter
        if filter.random:
            rng = self._filtering if rows is None else self._filtering[rows]
        prior = (
            prior if estimation.prior == 1.0 else Gaussian(prior.mean, estimation.prior * prior.cov)
        )
        y, available = self._for_filter(measurements)
        filter = estimation.delayed
        initial = filter.init(prior, rng=rng)
        belief = filter.update(initial, y, rng=rng, available=available, u=u)
        if rows is None:
            self.belief = belief
        else:
            self.belief = self.belief.with_rows(rows, belief)
        return belief

    def estimate(self, measurements: Measurements, u: np.ndarray, steps: np.ndarray) -> None:
        """Advance the belief of all rows by a step, to ``steps (B,)``: predict, then update."""
        estimation = self.estimation
        filter = estimation.filter
        # A copy, because some callers count steps in place.
        rng = self._filtering.at(steps.copy()) if filter.random else None
        y, available = self._for_filter(measurements)
        self.belief = estimation.delayed.step(self.belief, y, u, rng=rng, available=available)

    def extra_info(self, steps: np.ndarray) -> dict[str, np.ndarray]:
        """Entry of ``info`` for sensors with faults: the mask of active faults."""
        return {} if self._faults is None else {"sensor_faults": self._faults.on(steps)}

    def _delivered(
        self,
        measurements: Measurements,
        steps: np.ndarray,
        rows: np.ndarray | slice,
        injected: bool,
    ) -> Measurements:
        """Delivered measurements, from sampled or injected ones."""
        if not injected and self._faults is not None:
            measurements = self._faults.faulted(measurements, steps, rows)
        if self._transit is None:
            return measurements
        if not injected:
            return self._transit.carry(measurements, rows)
        nothing = np.zeros((len(steps), self.sensors.size))
        self._transit.carry((nothing, nothing.astype(bool)), rows)
        by_age = measurements[0].ndim == 3
        return measurements if by_age else of_now(measurements, self.sensors.horizon)

    def _for_filter(self, measurements: Measurements) -> tuple[np.ndarray, np.ndarray | None]:
        """Measurements and mask in the form for the filter."""
        estimation = self.estimation
        if estimation.tells_truth:
            return measurements[0], None
        if estimation.fuses or measurements[0].ndim == 2:
            return measurements
        return (
            youngest(measurements)
            if estimation.late == "as new"
            else (measurements[0][:, 0], measurements[1][:, 0])
        )


def _merged(whole: Measurements, rows: np.ndarray | None, some: Measurements) -> Measurements:
    """Measurements with new values in some rows; None: in all."""
    if rows is None:
        return some
    y, available = whole[0].copy(), whole[1].copy()
    y[rows], available[rows] = some
    return y, available
