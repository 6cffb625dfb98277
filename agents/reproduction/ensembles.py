"""What the papers on ensemble filters share: a vehicle that a filter watches.

A filter estimates some components of the vehicle's state; the position follows by integrating the kinematics over what
it estimates, as the papers do.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from estimators import Filter, Gaussian, NonlinearModel
from vessel_gym.sensors import Sensor

Advance = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""States ``(..., n)`` one step later under a control ``(..., m)``."""


class Flights(NamedTuple):
    """Runs of a vehicle.

    Attributes:
        truth: ``(T + 1, B, n)``.
        readings: ``(T, B, p)``, after each step.
    """

    truth: np.ndarray
    readings: np.ndarray


@dataclass(frozen=True, eq=False)
class Experiment:
    """A vehicle under a recorded control, kicked at every step, and what a filter is told of it.

    Attributes:
        advance: The vehicle's equations over a step.
        start: State ``(n,)`` at the beginning.
        controls: ``(T, m)``.
        estimated: The components of the state that a filter estimates, k of them; they suffice for their own equations.
        measured: Which of those are measured, p of them.
        kick_sd: ``(k,)`` process noise of a step.
        reading_sd: ``(p,)``.
        prior_sd: ``(k,)`` of the first belief about the start.
    """

    advance: Advance
    start: np.ndarray
    controls: np.ndarray
    estimated: list[int]
    measured: list[int]
    kick_sd: np.ndarray
    reading_sd: np.ndarray
    prior_sd: np.ndarray

    @cached_property
    def model(self) -> NonlinearModel:
        """The filter's model: the same equations, noise and readings."""

        def transition(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
            assert u is not None
            return self.advance(self.state(x), u)[..., self.estimated]

        def measurement(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
            return x[..., self.measured]

        return NonlinearModel(transition, measurement, np.diag(self.kick_sd**2), np.diag(self.reading_sd**2))

    def state(self, estimates: np.ndarray) -> np.ndarray:
        """Vehicle states ``(..., n)`` from estimates ``(..., k)``, the other components 0."""
        state = np.zeros(estimates.shape[:-1] + self.start.shape)
        state[..., self.estimated] = estimates
        return state

    def fly(self, runs: int, rng: np.random.Generator) -> Flights:
        """Runs of the vehicle and their readings: the same for every filter, so that filters are compared in pairs."""
        steps = len(self.controls)
        truth = np.empty((steps + 1, runs, len(self.start)))
        truth[0] = self.start
        kicks = self.kick_sd * rng.standard_normal((steps, runs, len(self.kick_sd)))
        for k, control in enumerate(self.controls):
            truth[k + 1] = self.advance(truth[k], control)
            truth[k + 1][:, self.estimated] += kicks[k]
        exact = truth[1:][..., self.estimated][..., self.measured]
        return Flights(truth, exact + self.reading_sd * rng.standard_normal(exact.shape))

    def estimates(self, estimator: Filter, readings: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """What a filter believes after each reading, ``(T + 1, B, k)``; the first is where it begins."""
        runs = readings.shape[1]
        mean = np.tile(self.start[self.estimated], (runs, 1))
        belief = estimator.init(Gaussian(mean, np.diag(self.prior_sd**2)), rng)
        believed = [belief.mean]
        for control, reading in zip(self.controls, readings, strict=False):
            belief = estimator.update(estimator.predict(belief, control, rng), reading, rng)
            believed.append(belief.mean)
        return np.stack(believed)


def channel_sd(sensors: tuple[Sensor, ...], channels: Sequence[str]) -> np.ndarray:
    """Nominal standard deviations of some channels of a vehicle's sensors ``(p,)``."""
    sd = {channel: sd for sensor in sensors for channel, sd in zip(sensor.channels, sensor.sd, strict=True)}
    return np.array([sd[channel] for channel in channels])


def rms(errors: np.ndarray) -> np.ndarray:
    """Root mean square over the steps: ``(T, B, k)`` to ``(B, k)``."""
    return np.sqrt(np.mean(errors**2, 0))


def thinned(history: np.ndarray, points: int = 400) -> np.ndarray:
    """At most so many rows of a history ``(T, ...)``, evenly spaced, the first and the last among them."""
    return history[np.linspace(0, len(history) - 1, min(points, len(history))).round().astype(int)]


def seconds_a_step(
    experiment: Experiment, make: Callable[[int], Filter], members: Sequence[int], steps: int, repeats: int, seed: int
) -> np.ndarray:
    """Measured time of a step of one run ``(repeats, len(members))`` [s]; sizes take turns, so that load hits all.

    Args:
        experiment: What is estimated.
        make: A filter with so many members.
        members: Sizes.
        steps: How many steps are timed together.
        repeats: How often.
        seed: Of the run and of the filter.
    """
    rng = np.random.default_rng(seed)
    readings = experiment.fly(1, rng).readings[:steps]
    filters = [make(size) for size in members]
    seconds = np.empty((repeats, len(members)))
    for estimator in filters:  # load and compile
        experiment.estimates(estimator, readings[:2], rng)
    for row in seconds:
        for i, estimator in enumerate(filters):
            begin = time.perf_counter()
            experiment.estimates(estimator, readings, rng)
            row[i] = (time.perf_counter() - begin) / len(readings)
    return seconds
