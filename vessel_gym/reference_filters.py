"""The estimators that only an environment can have: truth, dead reckoning, and the last measurements held."""

from dataclasses import dataclass

import numpy as np

from estimators import (
    Belief,
    Filter,
    GaussianFilter,
    InputBelief,
    LinearModel,
    Measurement,
    Rng,
    wrap,
)
from estimators.kalman import unseen_input
from estimators.varying import resolve
from vessel_gym.filter_models.build import Composition


class Oracle(Filter[InputBelief], verified=True):
    """The declared exception: it is handed the true state and unknown input as its measurement."""

    name = "truth"
    record = InputBelief

    def __init__(self, n: int, q: int) -> None:
        eye = np.eye(n + q)
        super().__init__(LinearModel(np.eye(n), eye[:, :n], np.zeros((n, n)), eye))
        self.q = q

    def _check_known_input(self, u: np.ndarray | None) -> None:
        """Known input of the interface, which it does not need."""

    def _init(self, belief: Belief, rng: Rng) -> InputBelief:
        return InputBelief.of(belief, **unseen_input(belief.mean, np.zeros((self.q, self.q))))

    def _predict(self, belief: InputBelief, u: np.ndarray | None, rng: Rng) -> InputBelief:
        return belief

    def _update(self, belief: InputBelief, measurement: Measurement, rng: Rng) -> InputBelief:
        n = self.model.n
        return belief.replace(
            mean=belief.mean + measurement.innovation[..., :n], cov=np.zeros(belief.cov.shape), u=None,
            recovery=np.zeros(belief.recovery.shape, np.int8), input_mean=measurement.innovation[..., n:],
        )  # fmt: skip


class DeadReckoning(GaussianFilter, verified=True):
    """The model alone: measurements are not used."""

    name = "dead-reckoning"

    def _update(self, belief: Belief, measurement: Measurement, rng: Rng) -> Belief:
        return belief


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class HeldBelief(InputBelief):
    """A belief that also holds the last two measurements of every channel, ``(..., p)`` each."""

    held: np.ndarray
    previous: np.ndarray  # the measurement before
    interval: np.ndarray  # seconds between the two
    seen: np.ndarray  # whether the channel has ever been read
    age: np.ndarray  # steps since the last measurement


class ZeroOrderHold(Filter[HeldBelief], verified=True):
    """The last measurement of every channel, held until the next; no model at all.

    States follow from what the sensors give (`vessel_gym.sensors.Sensor`); rates that none gives
    are differenced from the last two measurements of what they are the rate of. What no sensor
    gives is 0.
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
        """Variances ``(n,)`` and ``(q,)`` that the sensor noise alone gives what is derived from two measurements."""
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
        """State ``(..., n)`` and unknown input ``(..., q)`` from the last two measurements ``(..., p)`` alone."""
        known = self._sensors.states_from(measurements)
        for rate, _, channel, angle in self._differenced:
            change = measurements[..., channel] - previous[..., channel]
            known[rate] = (wrap(change) if angle else change) / interval[..., channel]
        nothing = np.zeros(measurements.shape[:-1])
        state = np.stack([known.get(name, nothing) for name in self._names], -1)
        if not self._inputs:
            return state, np.zeros(measurements.shape[:-1] + (0,))
        return state, np.stack([known.get(name, nothing) for name in self._inputs], -1)

    def _init(self, belief: Belief, rng: Rng) -> HeldBelief:
        shape = belief.mean.shape[:-1] + (self.model.p,)
        held = self._expected(belief)
        # What no measurement shows (the sway, a current) keeps the variance of the prior.
        prior = np.diagonal(belief.cov, axis1=-2, axis2=-1)
        cov = np.where(self._variance > 0.0, self._variance, prior)[..., None] * self._identity
        input_cov = np.zeros(shape[:-1] + 2 * self._input_variance.shape) + np.diag(
            self._input_variance
        )
        return HeldBelief.of(
            belief.replace(cov=cov), input_mean=np.zeros(shape[:-1] + self._input_variance.shape), input_cov=input_cov,
            state_input_cov=np.zeros(belief.mean.shape + self._input_variance.shape), held=held, previous=held,
            interval=np.full(shape, self._dt), seen=np.zeros(shape, bool), age=np.zeros(shape),
        )  # fmt: skip

    def _expected(self, belief: Belief) -> np.ndarray:
        return self.model.linearise_measurement(belief.mean, belief.u)[0]

    def _predict(self, belief: HeldBelief, u: np.ndarray | None, rng: Rng) -> HeldBelief:
        return belief.replace(age=belief.age + 1.0)

    def _update(self, belief: HeldBelief, measurement: Measurement, rng: Rng) -> HeldBelief:
        arrived = measurement.available
        held = np.where(arrived, self._expected(belief) + measurement.innovation, belief.held)
        previous = np.where(arrived, np.where(belief.seen, belief.held, held), belief.previous)
        interval = np.where(arrived, np.maximum(belief.age, 1.0) * self._dt, belief.interval)
        mean, unknown_input = self._derived(held, previous, interval)
        return belief.replace(
            mean=mean, input_mean=unknown_input, held=held, previous=previous, interval=interval,
            seen=belief.seen | arrived, age=np.where(arrived, 0.0, belief.age),
        )  # fmt: skip
