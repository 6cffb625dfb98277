"""Reference estimators of an environment: truth, dead reckoning, and zero-order hold."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from estimators import (
    ExtendedKalmanFilter,
    Filter,
    InputBelief,
    LinearModel,
    Model,
    compiled,
    wrap,
)  # fmt: skip
from estimators.filter import Changes
from estimators.kalman import unseen_input
from vessel_gym.models.state_space import StateSpace


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


@dataclass(frozen=True, eq=False, kw_only=True)
class HeldBelief(InputBelief):
    """Belief with the last measurement of every channel, ``(..., p)`` each."""

    held: np.ndarray
    slope: np.ndarray  # change from the measurement before, in a second
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

    def __init__(self, space: StateSpace, model: Model, inputs: tuple[str, ...]) -> None:
        super().__init__(model)
        vehicle, self._sensors, self._dt = space.vehicle, space.sensors, space.vehicle.dt
        self._names = *space.names, *inputs
        self._turns = np.isin(np.arange(model.p), space.sensors.angles)
        given = space.sensors.gives
        self._differenced = [
            (rate, given.index(of))
            for rate, of in vehicle.rates.items()
            if rate not in given and of in given
        ]
        # variances of the derived state and d, of a measurement and the one before
        noise, eye = np.diagonal(model.value("R", vehicle.cruise[1])), np.eye(model.p)
        now, before = (self._derived(each, eye / self._dt) for each in (eye, 0.0 * eye))
        self._variance = noise @ (now**2 + before**2)

    def _derived(self, measurements: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """State and unknown input ``(..., n + q)`` from measurements and slopes ``(..., p)``."""
        known = self._sensors.states_from(measurements)
        known |= {rate: slopes[..., channel] for rate, channel in self._differenced}
        nothing = np.zeros(measurements.shape[:-1])
        return np.stack([known.get(name, nothing) for name in self._names], -1)

    def _begin(self, mean: np.ndarray, cov: np.ndarray, rng: Any) -> Changes:
        n, shape = mean.shape[-1], mean.shape[:-1] + (self.model.p,)
        state, unknown = np.split(self._variance, [n])
        # What no measurement shows (the sway, a current) keeps the variance of the prior.
        variance = np.where(state > 0.0, state, np.diagonal(cov, 0, -2, -1))
        input_cov = np.zeros((*shape[:-1], 1, 1)) + np.diag(unknown)
        return unseen_input(mean, input_cov) | {
            "cov": variance[..., None] * np.eye(n),
            "held": self.model.measurement(mean, None),
            "slope": np.zeros(shape),
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
        held = np.where(available, self.model.measurement(belief.mean, u) + e, belief.held)
        change, seconds = held - belief.held, np.maximum(belief.age, 1.0) * self._dt
        slope = np.where(self._turns, wrap(change), change) / seconds
        slope = np.where(available, np.where(belief.seen, slope, 0.0), belief.slope)
        derived, n = self._derived(held, slope), self.model.n
        return {
            "mean": derived[..., :n].copy(),  # programs are slower for arrays in another order
            "input_mean": derived[..., n:].copy(),
            "innovation_cov": R,
            "held": held,
            "slope": slope,
            "seen": belief.seen | available,
            "age": np.where(available, 0.0, belief.age),
        }
