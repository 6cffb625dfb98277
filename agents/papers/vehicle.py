"""A vehicle under recorded controls, and filters that follow it: shared by the papers on vehicles.

A filter estimates some components of the vehicle's state; the position follows by integrating the
kinematics over the estimates, as in the papers on underwater vehicles.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from typing import Any

import numpy as np

from estimators import Filter, Gaussian, NonlinearModel, compiled, make
from estimators.randomness import RandomKeys, key
from vessel_gym.sensors import Sensor

Advance = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""States ``(..., n)`` one step later under a control ``(..., m)``."""


@dataclass(frozen=True, eq=False)
class Experiment:
    """A vehicle under a recorded control with process noise, and the filter's assumptions.

    Attributes:
        advance: The vehicle's equations over a step.
        start: State ``(n,)`` at the beginning, or one for each run ``(B, n)``.
        controls: ``(T, m)``.
        estimated: Components of the state that a filter estimates, k of them; they suffice for
            their own equations.
        measured: Which of those are measured, p of them.
        process_sd: ``(k,)`` process noise of a step.
        measurement_sd: ``(p,)``.
        prior_sd: ``(k,)`` of the first estimate.
        angles: Which of the estimated components are angles.
    """

    advance: Advance
    start: np.ndarray
    controls: np.ndarray
    estimated: list[int]
    measured: list[int]
    process_sd: np.ndarray
    measurement_sd: np.ndarray
    prior_sd: np.ndarray
    angles: tuple[int, ...] = ()

    @cached_property
    def model(self) -> NonlinearModel:
        """The filter's model, of the vehicle's own equations, noise and measurements."""

        @compiled
        def transition(x: np.ndarray, u: np.ndarray) -> np.ndarray:
            return self.advance(self.state(x), u)[..., self.estimated]

        @compiled
        def measurement(x: np.ndarray, u: np.ndarray) -> np.ndarray:
            return x[..., self.measured]

        Q, R = np.diag(self.process_sd**2), np.diag(self.measurement_sd**2)
        angles = tuple(self.measured.index(i) for i in self.angles if i in self.measured)
        return NonlinearModel(
            transition, measurement, Q, R, state_angles=self.angles, measurement_angles=angles
        )

    def state(self, estimates: np.ndarray) -> np.ndarray:
        """Vehicle states ``(..., n)`` from estimates ``(..., k)``, the other components 0."""
        known = dict(zip(self.estimated, np.moveaxis(estimates, -1, 0), strict=True))
        nothing = 0.0 * estimates[..., 0]
        return np.stack([known.get(i, nothing) for i in range(self.start.shape[-1])], -1)

    def path(self, states: np.ndarray, components: list[int]) -> np.ndarray:
        """Components ``(T + 1, B, c)`` from 0, by their increments in steps from ``(T, B, n)``."""
        moved = self.advance(states, self.controls[:, None]) - states
        return np.cumsum(np.pad(moved[..., components], ((1, 0), (0, 0), (0, 0))), 0)

    def simulate(self, runs: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """True states ``(T + 1, B, n)``, and measurements ``(T, B, p)`` after each step."""
        steps = len(self.controls)
        truth = np.empty((steps + 1, runs, self.start.shape[-1]))
        truth[0] = self.start
        noise = self.process_sd * rng.standard_normal((steps, runs, len(self.process_sd)))
        for k, control in enumerate(self.controls):
            truth[k + 1] = self.advance(truth[k], control)
            truth[k + 1][:, self.estimated] += noise[k]
        exact = truth[1:][..., self.estimated][..., self.measured]
        return truth, exact + self.measurement_sd * rng.standard_normal(exact.shape)

    @cached_property
    def planned(self) -> np.ndarray:
        """States ``(T + 1, n)`` without process noise: the planned path."""
        return np.array([*accumulate(self.controls, self.advance, initial=self.start)])

    def ensemble(self, members: int, name: str = "enkf", **options: Any) -> Filter:
        """An ensemble filter with independent draws, as in the papers."""
        return make(name, self.model, members=members, draws="independent", **options)

    def estimates(
        self, estimator: Filter, measurements: np.ndarray, seed: int = 0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Updated estimates and standard deviations ``(T + 1, B, k)``, the initial ones first."""
        runs = measurements.shape[1]
        keys = RandomKeys(key(seed)).of(np.arange(runs))
        start = np.tile(self.start[self.estimated], (runs, 1))
        belief = estimator.init(Gaussian(start, np.diag(self.prior_sd**2)), keys)
        # and not the beliefs: members of 30,000 steps fill a memory
        means, variances = [belief.mean], [belief.cov.diagonal(0, -2, -1)]
        for k, (control, measurement) in enumerate(zip(self.controls, measurements, strict=True)):
            u = np.tile(control, (runs, 1))
            belief = estimator.step(belief, measurement, u, keys.at(k + 1))
            means.append(belief.mean)
            variances.append(belief.cov.diagonal(0, -2, -1).copy())
        return np.stack(means), np.sqrt(variances)


def own_step(vehicle: Any) -> Advance:
    """The vehicle's step in still water by controls ``(..., 2 a)``: actuators before and after."""
    still, coefficients = np.zeros(len(vehicle.ambient_flows)), vehicle.body.vector()

    def advance(states: np.ndarray, control: np.ndarray) -> np.ndarray:
        before, after = np.split(control, 2, -1)
        return vehicle.moved(states, before, after, still, coefficients)

    return advance


def channel_sd(sensors: tuple[Sensor, ...], channels: Sequence[str]) -> np.ndarray:
    """Nominal standard deviations of some channels of a vehicle's sensors ``(p,)``."""
    sd = {name: sd for of in sensors for name, sd in zip(of.channels, of.sd, strict=True)}
    return np.array([sd[channel] for channel in channels])
