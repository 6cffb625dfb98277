"""The estimators that only an environment can have, and how an environment builds one by name."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from estimators import Belief, Filter, LinearModel, NonlinearModel, factory
from estimators.checks import shown
from estimators.filter import Reading, Streams
from estimators.kalman import ExtendedKalmanFilter
from estimators.models import resolve
from vessel_gym import checks
from vessel_gym.sensors import SensorSuite
from vessel_gym.system import System

ENVIRONMENT_ONLY = ("truth", "measurement", "dead-reckoning")


def estimator_names() -> tuple[str, ...]:
    """Every name that an environment's ``estimator`` accepts."""
    return factory.names() + ENVIRONMENT_ONLY


class Oracle(Filter):
    """The declared exception: it is handed the true state and unknown input as its reading."""

    name = "truth"
    _ours = True

    def __init__(self, n: int, q: int) -> None:
        eye = np.eye(n + q)
        super().__init__(LinearModel(np.eye(n), eye[:, :n], np.zeros((n, n)), eye))
        self.q = q

    def _check_known_input(self, u: np.ndarray | None) -> None:
        """It is told, like every filter, and needs it not."""

    def _predict(self, belief: Belief, u: np.ndarray | None, rng: Streams) -> Belief:
        return belief

    def _update(self, belief: Belief, reading: Reading, rng: Streams) -> Belief:
        n, q = self.model.n, self.q
        state = belief.mean + reading.innovation[..., :n]
        batch = state.shape[:-1]
        return Belief(
            state, np.zeros(batch + (n, n)), belief.prior_mean, belief.prior_cov, np.zeros(batch, np.int8),
            input_mean=reading.innovation[..., n:], input_cov=np.zeros(batch + (q, q)),
        )  # fmt: skip


class DeadReckoning(ExtendedKalmanFilter):
    """The model alone: readings are not used."""

    name = "dead-reckoning"
    _ours = True

    def _update(self, belief: Belief, reading: Reading, rng: Streams) -> Belief:
        return belief


@dataclass(frozen=True, slots=True, eq=False)
class HeldReadings(Belief):
    """A belief that also holds the last two readings of every channel, ``(..., p)`` each."""

    held: np.ndarray = None  # type: ignore[assignment]  # the base class has defaults, so must this
    previous: np.ndarray = None  # type: ignore[assignment]  # the reading before
    interval: np.ndarray = None  # type: ignore[assignment]  # seconds between the two
    seen: np.ndarray = None  # type: ignore[assignment]  # whether the channel has ever been read
    age: np.ndarray = None  # type: ignore[assignment]  # steps since the last reading


class HeldMeasurement(Filter):
    """The last reading of every channel, held until the next; no model at all.

    Rates that no sensor gives are differenced from the last two readings, by the vehicle's ``from_readings``.
    """

    name = "measurement"
    _ours = True

    def __init__(self, system: System, model: LinearModel | NonlinearModel) -> None:
        super().__init__(model)
        self._vehicle, self._dt = system.vehicle, system.vehicle.dt
        self._variance, self._input_variance = self._claimed()

    def _claimed(self) -> tuple[np.ndarray, np.ndarray]:
        """Variances ``(n,)`` and ``(q,)`` that the sensor noise alone gives what is derived from two readings."""
        eye, zero = np.eye(self.model.p), np.zeros((self.model.p, self.model.p))
        interval, noise = np.full_like(zero, self._dt), np.diagonal(resolve(self.model.R, None))
        now = self._vehicle.from_readings(eye, zero, interval)
        before = self._vehicle.from_readings(zero, eye, interval)
        state, unknown = (noise @ (a**2 + b**2) for a, b in zip(now, before, strict=True))
        return state, unknown

    def _init(self, belief: Belief, rng: Streams) -> Belief:
        shape = belief.mean.shape[:-1] + (self.model.p,)
        held = self._expected(belief)
        # What no reading shows (the sway, a current) keeps the variance of the prior.
        prior = np.diagonal(belief.cov, axis1=-2, axis2=-1)
        cov = np.where(self._variance > 0.0, self._variance, prior)[..., None] * self._identity
        input_cov = np.zeros(shape[:-1] + 2 * self._input_variance.shape) + np.diag(self._input_variance)
        return HeldReadings(
            belief.mean, cov, belief.prior_mean, belief.prior_cov, belief.recovery, u=belief.u,
            input_mean=np.zeros(shape[:-1] + self._input_variance.shape), input_cov=input_cov,
            held=held, previous=held, interval=np.full(shape, self._dt), seen=np.zeros(shape, bool),
            age=np.zeros(shape),
        )  # fmt: skip

    def _expected(self, belief: Belief) -> np.ndarray:
        return self.model.linearise_measurement(belief.mean, belief.u)[0]

    def _predict(self, belief: Belief, u: np.ndarray | None, rng: Streams) -> Belief:
        assert isinstance(belief, HeldReadings)
        return belief.replace(age=belief.age + 1.0)

    def _update(self, belief: Belief, reading: Reading, rng: Streams) -> Belief:
        assert isinstance(belief, HeldReadings)
        arrived = reading.available
        held = np.where(arrived, self._expected(belief) + reading.innovation, belief.held)
        previous = np.where(arrived, np.where(belief.seen, belief.held, held), belief.previous)
        interval = np.where(arrived, np.maximum(belief.age, 1.0) * self._dt, belief.interval)
        mean, unknown_input = self._vehicle.from_readings(held, previous, interval)
        return belief.replace(
            mean=mean, input_mean=unknown_input, held=held, previous=previous, interval=interval,
            seen=belief.seen | arrived, age=np.where(arrived, 0.0, belief.age),
        )  # fmt: skip


EstimatorChoice = str | Callable[..., Filter]
"""A name of `estimator_names`, or your own: a `Filter` subclass, or any function of a model that returns a filter."""


def build(
    system: System, estimator: EstimatorChoice, options: dict[str, Any] | None, suite: SensorSuite, disturbance: Any
) -> Filter:
    """The estimator of an environment.

    Args:
        system: The environment's system.
        estimator: One of `estimator_names`, or a function of the model (and options) that returns a filter.
        options: The filter's own options, over the system's tuning; ``model`` chooses the filter's model.
        suite: The sensor suite, whose noise the filter knows.
        disturbance: The disturbance, whose variance the tuning may use.

    Raises:
        ValueError: for an unknown name, or a filter that cannot work with the model.
        TypeError: for an option that the filter does not have, options that are no dictionary, an object that is
            neither a name nor a function, or a function that returns no filter.
    """
    options = checks.options("estimator_options", options)
    if isinstance(estimator, Filter) or (isinstance(estimator, type) and not issubclass(estimator, Filter)):
        kind = f"an instance of {type(estimator).__name__}" if isinstance(estimator, Filter) else shown(estimator)
        raise TypeError(
            f"estimator must be a name, a Filter class or a function of the model that returns a filter, got {kind}"
        )
    if callable(estimator):
        own = estimator(_model(system, options.pop("model", system.filter_model), suite, disturbance), **options)
        if not isinstance(own, Filter):
            raise TypeError(f"estimator must return an estimators.Filter, got {type(own).__name__}")
        return own
    if not isinstance(estimator, str) or estimator not in estimator_names():
        raise ValueError(factory.unknown("estimator", estimator, accepted(system, suite, disturbance)))
    kind = options.pop("model", system.filter_models.get(estimator, system.filter_model))
    model = _model(system, kind, suite, disturbance)
    if estimator in ENVIRONMENT_ONLY and options:
        raise TypeError(f"{estimator} has no option {next(iter(options))!r}: it takes model")
    if estimator == "truth":
        return Oracle(model.n, system.vehicle.unknown_inputs)
    if estimator == "measurement":
        return HeldMeasurement(system, model)
    if estimator == "dead-reckoning":
        return DeadReckoning(model)
    return factory.make(estimator, model, **{**system.tuning(estimator, disturbance), **options})


def accepted(system: System, suite: SensorSuite, disturbance: Any) -> tuple[str, ...]:
    """Those of `estimator_names` that a system's models can carry."""
    names = []
    for name in estimator_names():
        try:
            build(system, name, None, suite, disturbance)
        except ValueError:
            continue
        names.append(name)
    return tuple(names)


def _model(system: System, kind: object, suite: SensorSuite, disturbance: Any) -> LinearModel | NonlinearModel:
    if not isinstance(kind, str):
        raise TypeError(f"model must be the name of a filter model, such as {system.filter_model!r}, got {shown(kind)}")
    return system.vehicle.model(kind, suite.noise, disturbance)
