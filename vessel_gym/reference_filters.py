"""Reference estimators of an environment: truth, dead reckoning, and zero-order hold."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from estimators import ExtendedKalmanFilter, Filter, InputBelief, LinearModel, compiled, wrap
from estimators.filter import Changes
from estimators.kalman import unseen_input
from estimators.varying import resolve
from vessel_gym.filter_models.build import Composition


@compiled
class Oracle(Filter[InputBelief]):
    """The oracle, whose measurement is the true state and unknown input."""

    name = "truth"
    record = InputBelief

    def __init__(self, n: int, q: int) -> None:
        eye = np.eye(n + q)
        super().__init__(LinearModel(np.eye(n), eye[:, :n], np.zeros((n, n)), eye))
        self.q = q

    def _begin(self, mean: np.ndarray, cov: np.ndarray, rng: Any) -> Changes:
        return unseen_input(mean, np.zeros((self.q, self.q)))

    def _predict(self, belief: Any, u: Any, *_: Any) -> Changes:
        return {"mean": belief.mean}

    def _update(self, belief: Any, u: Any, e: Any, *_: Any) -> Changes:
        n = self.model.n
        cov = np.zeros(belief.cov.shape)
        return {"mean": belief.mean + e[..., :n], "cov": cov, "input_mean": e[..., n:]}


@compiled
class DeadReckoning(ExtendedKalmanFilter):
    """The filter's model alone, without measurements."""

    name = "dead-reckoning"

    def _update(
        self, belief: Any, u: Any, e: Any, C: Any, R: Any, available: Any, *_: Any
    ) -> Changes:
        unused = np.zeros(available.shape, bool)
        return {"mean": belief.mean, "innovation_cov": R, "available": unused}


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class HeldBelief(InputBelief):
    """Belief with the last two measurements of every channel, ``(..., p)`` each."""

    held: np.ndarray
    previous: np.ndarray  # the measurement before the held one
    interval: np.ndarray  # time between the two, s
    seen: np.ndarray  # has the channel been measured yet?
    age: np.ndarray  # steps since the last measurement


class ZeroOrderHold(Filter[HeldBelief]):
    """The last measurement of every channel, held until the next, without a model.

    States follow from what sensors give (`vessel_gym.sensors.Sensor`). Rates that no sensor
    measures are differences of the last two measurements of the state. States that cannot be
    derived are 0.
    """

    name = "measurement"
    record = HeldBelief

    def __init__(self, composition: Composition, inputs: tuple[str, ...]) -> None:
        super().__init__(composition.model)
        vehicle, self._sensors = composition.vehicle, composition.sensors
        self._names, self._inputs, self._dt, self._cruise = (
            composition.names,
            inputs,
            vehicle.dt,
            vehicle.cruise[1],
        )
        given = self._sensors.gives
        self._differenced = [
            (rate, of, given.index(of), of in vehicle.angles)
            for rate, of in vehicle.rates.items()
            if rate not in given and of in given
        ]
        self._variance, self._input_variance = self._claimed()

    def _claimed(self) -> tuple[np.ndarray, np.ndarray]:
        """Variances ``(n,)`` and ``(q,)`` of the derived state and d, from sensor noise alone."""
        eye, zero = np.eye(self.model.p), np.zeros((self.model.p, self.model.p))
        interval, noise = (
            np.full_like(zero, self._dt),
            np.diagonal(resolve(self.model.R, self._cruise)),
        )
        now, before = self._derived(eye, zero, interval), self._derived(zero, eye, interval)
        state, unknown = (noise @ (a**2 + b**2) for a, b in zip(now, before, strict=True))
        return state, unknown

    def _derived(
        self, measurements: np.ndarray, previous: np.ndarray, interval: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """State ``(..., n)`` and unknown input ``(..., q)`` from two measurements ``(..., p)``."""
        known = self._sensors.states_from(measurements)
        for rate, _, channel, angle in self._differenced:
            change = measurements[..., channel] - previous[..., channel]
            known[rate] = (wrap(change) if angle else change) / interval[..., channel]
        nothing = np.zeros(measurements.shape[:-1])
        state = np.stack([known.get(name, nothing) for name in self._names], -1)
        if not self._inputs:
            return state, np.zeros(measurements.shape[:-1] + (0,))
        return state, np.stack([known.get(name, nothing) for name in self._inputs], -1)

    def _begin(self, mean: np.ndarray, cov: np.ndarray, rng: Any) -> Changes:
        shape, sizes = mean.shape[:-1] + (self.model.p,), self._input_variance.shape
        held = self.model.measurement(mean, None)
        # What no measurement shows (the sway, a current) keeps the variance of the prior.
        variance = np.where(self._variance > 0.0, self._variance, np.diagonal(cov, 0, -2, -1))
        input_cov = np.zeros(shape[:-1] + 2 * sizes) + np.diag(self._input_variance)
        return unseen_input(mean, input_cov) | {
            "cov": variance[..., None] * np.eye(mean.shape[-1]),
            "held": held,
            "previous": held,
            "interval": np.full(shape, self._dt),
            "seen": np.zeros(shape, bool),
            "age": np.zeros(shape),
        }

    def propagate(self, belief: Any, u: np.ndarray | None) -> tuple[Any, ...]:
        """Nothing, because the prediction uses no model."""
        return ()

    def expect(self, belief: Any, u: np.ndarray | None, R: Any = None) -> tuple[Any, ...]:
        """Expected measurement, zero C, and R."""
        C = np.zeros((self.model.p, self.model.n))
        return self.model.measurement(belief.mean, u), C, self._noise(belief, u, R)

    def _predict(self, belief: Any, u: Any, *_: Any) -> Changes:
        return {"mean": belief.mean, "age": belief.age + 1.0}

    def _update(
        self, belief: Any, u: Any, e: Any, C: Any, R: Any, available: Any, *_: Any
    ) -> Changes:
        measured = self.model.measurement(belief.mean, u) + e
        held = np.where(available, measured, belief.held)
        previous = np.where(available, np.where(belief.seen, belief.held, held), belief.previous)
        interval = np.where(available, np.maximum(belief.age, 1.0) * self._dt, belief.interval)
        mean, unknown_input = self._derived(held, previous, interval)
        return {
            "mean": mean,
            "input_mean": unknown_input,
            "innovation_cov": R,
            "held": held,
            "previous": previous,
            "interval": interval,
            "seen": belief.seen | available,
            "age": np.where(available, 0.0, belief.age),
        }
