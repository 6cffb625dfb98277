"""Common part of the single and the vector wrapper: a loop around any environment."""

from collections import OrderedDict
from collections.abc import Callable, Sequence
from contextlib import closing
from copy import deepcopy
from dataclasses import replace
from functools import partial
from operator import attrgetter
from typing import Any, cast

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import (
    Box,
    Dict,
    Discrete,
    MultiBinary,
    MultiDiscrete,
    Space,
    Tuple,
    flatten_space,
)

from estimators import (
    Filter,
    Gaussian,
    Model,
    RandomKeys,
    factory,
    wrap,
)
from estimators.checks import as_number, numbers, short_repr
from vessel_gym import checks
from vessel_gym.models.estimation import LATE, Estimation, EstimatorChoice, is_own, own_filter
from vessel_gym.models.reference_filters import DeadReckoning, Oracle
from vessel_gym.sensor_faults import SensorFault
from vessel_gym.sensors import SUITES, Sensor, Sensors, in_quality
from vessel_gym.simulation.configuration import OBSERVE
from vessel_gym.simulation.draws import next_episodes
from vessel_gym.simulation.loop import Delivery, Estimator
from vessel_gym.simulation.mission import standard_deviations
from vessel_gym.simulation.state import State


class Watch:
    """Sensors, filter and belief of B rows of an environment, from their true states.

    Args:
        space: Observation space of one environment.
        action_space: Action space of one environment.
        rows: B.
        dt: Time step [s] of the environment, see `time_step`.
        model, prior, ...: As of `vessel_gym.wrappers.EstimatedObservation`; functions take B rows.

    Attributes:
        space: Observation space of one environment, whose agent observes estimates.
        now: The record.
    """

    def __init__(
        self, space: Any, action_space: Space, rows: int, dt: float, model: Model,
        prior: Gaussian, observation: Callable[[np.ndarray], Any] | None = None,
        passes: Sequence[Any] = (), known_input: Callable[[Any], Any] | None = None,
        estimator: EstimatorChoice = "ekf", estimator_options: dict[str, Any] | None = None,
        sensors: str | Sequence[Sensor] = "nominal", observe: str = "mean",
        sensor_faults: Sequence[SensorFault] = (),
    ) -> None:  # fmt: skip
        if not isinstance(model, Model):
            raise TypeError(f"model must be a Linear- or NonlinearModel, got {short_repr(model)}")
        checks.instance("prior", prior, Gaussian)
        if prior.mean.shape != (model.n,):
            raise ValueError(f"the prior has shape {prior.mean.shape}, the model {model.n} states")
        checks.function("observation", observation, "the state")
        checks.function("known_input", known_input, "the action")
        self._mode = checks.one_of("observe mode", observe, OBSERVE)
        self.rows, self.model, self.prior, self._own = rows, model, prior, space
        self._passes, self._estimated = _divided(space, passes)
        self._observation, self._known = observation, known_input or plain_action(action_space)
        action = deepcopy(action_space).sample()  # a copy, so that the space's own state stays
        u = numbers(self._known(action))
        if u is None:
            raise ValueError(f"known_input must give numbers, got none for {short_repr(action)}")
        self._inputs = u.size
        model.check_known_input(u.ravel())
        self.sensors = _sensors(model, sensors, u.size, sensor_faults, dt)
        options = checks.options("estimator_options", estimator_options)
        late = checks.one_of("value of late", options.pop("late", LATE[0]), LATE)
        R = self.sensors.noise(model.measurement, prior.mean, u.ravel())
        self.filter = _filter(replace(cast(Any, model), R=R), estimator, options)
        horizon = self.sensors.horizon
        estimation = Estimation(self.filter, cast(Any, None), (), late, horizon)
        self._delivery, self._tells_truth = Delivery(self.sensors), estimation.tells_truth
        self._estimator = Estimator(estimation, "belief", attrgetter("state"))
        self.now, self.seeds = State(episode=np.zeros(rows, int)), list[int]()
        self.space = self._space()

    # --- one step ---------------------------------------------------------------------------------

    def begin(self, rows: np.ndarray, state: Any, seed: Any = None) -> None:
        """Begin episodes in the rows of some indices, in states ``(B, n)``.

        Args:
            rows: Indices.
            state: Of all rows.
            seed: A number s (row i gets s + i) or one number for each row, which restart the count
                of episodes; None: the next episodes.
        """
        state = _as_rows("state", state, self.rows, self.model.n)
        self.seeds, episode = next_episodes(self.seeds, self.now.episode, seed, rows)
        own = RandomKeys.seeded([self.seeds[row] for row in rows]).of(episode[rows])
        now = State(
            episode=episode[rows], steps=np.zeros(len(rows), int),
            sensing=np.stack([own.of(sensor.name).keys for sensor in self.sensors.each], 1),
            filtering=own.of("filter").keys,
            state=state[rows], u=np.zeros((len(rows), self._inputs)),
        )  # fmt: skip
        self._delivery.begin(now)
        self._measure(now)
        prior = self.prior.about(np.broadcast_to(self.prior.mean, now.state.shape))
        self._estimator.begin(now, prior)
        self.now = now if len(rows) == self.rows else self.now.merged(rows, now)

    def step(self, state: Any, action: Any, ended: np.ndarray) -> None:
        """Step all rows to states ``(B, n)``; rows of the mask ``ended (B,)`` begin an episode."""
        if not self.seeds:
            raise ResetNeeded("call reset() before step()")
        u = _as_rows("known_input", self._known(action), self.rows, self._inputs)
        state = _as_rows("state", state, self.rows, self.model.n)
        self.now = now = self.now.but(steps=self.now.steps + 1, state=state, u=u)
        self._measure(now)
        self._estimator.step(now)
        if ended.any():
            self.begin(np.flatnonzero(ended), now.state)

    def _measure(self, now: State) -> None:
        """Sample the sensors, and deliver measurements."""
        no_bias = np.zeros((len(now.state), 0))
        given = now.state, now.u, no_bias, now.steps, now.sensing
        now.y, now.available = self.sensors.read(*given)
        self._delivery(now)

    def info(self) -> dict[str, np.ndarray]:
        """Copies of the last step's record, one row for each environment."""
        now, belief = self.now, self.now.belief
        happened = {
            "truth": now.state, "estimate": belief.mean, "covariance": belief.cov,
            "measurement": now.y, "available": now.available, "healthy": belief.healthy,
        }  # fmt: skip
        if now.faults is not None:
            happened["sensor_faults"] = self._delivery.active(now)
        return {name: values.copy() for name, values in happened.items()}

    # --- observations -----------------------------------------------------------------------------

    def observe(self, seen: Any) -> Any:
        """Observations ``(B, ...)``, given the environment's own observations ``seen``."""
        own, raw, beside = self._own, self._mode == "measurement", self._beside()
        if isinstance(own, Dict):
            passing = {key: seen[key] for key in self._passes}
            return (passing if raw else self._filled(passing)) | beside
        whole = np.array(seen, own.dtype).reshape(self.rows, -1)
        if raw:
            parts = [*beside.values(), whole[:, self._passes]]
        else:
            whole[:, self._estimated] = self._fitted(self._value(), own, self._estimated)
            if not beside:
                return whole.reshape(self.rows, *own.shape)
            parts = [whole, *beside.values()]
        return np.concatenate(parts, -1).astype(np.float32)

    def _beside(self) -> dict[str, np.ndarray]:
        """Measurements and mask in place of estimates, or standard deviations beside them."""
        now = self.now
        if self._mode == "measurement":
            return {"measurement": np.concatenate([now.y, now.available], -1).astype(np.float32)}
        if self._mode == "mean+std":
            return {"std": standard_deviations(now.belief.cov).astype(np.float32)}
        return {}

    def _value(self) -> Any:
        """Values of the user's function of the estimates; without one, the estimates."""
        mean = np.array(self.now.state if self._tells_truth else self.now.belief.mean)
        if self._observation is not None:
            return self._observation(mean)
        if not self._tells_truth:  # filters do not wrap angles
            angles = list(self.model.state_angles)
            mean[:, angles] = wrap(mean[:, angles])
        return mean

    def _filled(self, passing: dict[str, Any]) -> dict[str, Any]:
        """Dictionary of observations, from the function's values and what passes."""
        own, value = self._own, self._value()
        if not isinstance(value, dict) or {*value} != {*self._estimated}:
            wanted = ", ".join(self._estimated)
            raise ValueError(f"observation must give a dictionary of what does not pass: {wanted}")
        filled = dict(passing)
        for key, each in value.items():
            filled[key] = self._fitted(each, own[key]).reshape(self.rows, *own[key].shape)
        return {key: filled[key] for key in own}

    def _fitted(self, value: Any, own: Any, chosen: Any = slice(None)) -> np.ndarray:
        """Estimated components ``(B, k)`` in the form of a space.

        They are clipped to its bounds, which the truth may exceed, and rounded if it has whole
        numbers.
        """
        low, high = own.low.ravel()[chosen], own.high.ravel()[chosen]
        array = _as_rows("observation", value, self.rows, len(low))
        if not self._tells_truth:
            array = np.clip(array, low, high)
        return (np.rint(array) if own.dtype.kind in "iu" else array).astype(own.dtype)

    def _space(self) -> Any:
        """Observation space."""
        own, raw = self._own, self._mode == "measurement"
        if self._mode == "mean":
            return own
        name, least, size = "std", 0.0, self.model.n
        if raw:
            name, least, size = "measurement", -np.inf, 2 * self.sensors.size
        beside = Box(least, np.inf, (size,), np.float32)
        if isinstance(own, Dict):
            kept = {key: own[key] for key in own if not raw or key in self._passes}
            if name in kept:
                raise ValueError(f"observations have a key {name} of their own: observe='mean'")
            return Dict(OrderedDict(kept | {name: beside}))  # Gymnasium sorts a plain dict
        columns = self._passes if raw else slice(None)
        low, high = (each.ravel()[columns].astype(np.float32) for each in (own.low, own.high))
        parts = Box(low, high, dtype=np.float32), beside
        return flatten_space(Tuple(parts[::-1] if raw else parts))


def _as_rows(name: str, value: Any, rows: int, size: int) -> np.ndarray:
    """Numbers ``(rows, size)``, a new array, that a user's function has given.

    Raises:
        ValueError: naming the function, for another shape or numbers that are not finite.
    """
    array = numbers(value)
    if array is None or array.size != rows * size or (rows > 1 and len(array) != rows):
        wanted = f"{size} numbers" if rows == 1 else f"a row of {size} numbers for each of {rows}"
        got = short_repr(value) if array is None else f"shape {array.shape}"
        raise ValueError(f"{name} must give {wanted}, got {got}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} gave what is not finite: {short_repr(array.tolist())}")
    return np.array(array.reshape(rows, size), order="C")


def time_step(env: Any) -> float:
    """Time step [s] of a single or vector environment: its ``dt``, or else 1, a step."""
    base = getattr(env, "unwrapped", env)
    if envs := getattr(base, "envs", ()):
        return time_step(envs[0])
    if makers := getattr(base, "env_fns", ()):  # environments in other processes
        with closing(makers[0]()) as one:
            return time_step(one)
    dt = as_number(getattr(base, "dt", 1.0))
    return dt if 0.0 < dt < np.inf else 1.0


def observed_state(env: Any, seen: Any) -> Any:
    """The state of an environment whose observation is the state."""
    return seen


def plain_action(space: Space) -> Callable[[Any], Any]:
    """Function from actions of a space to numbers ``(..., m)``, clipped to the bounds."""
    if isinstance(space, Box):
        return partial(_clipped, space.low.astype(float), space.high.astype(float))
    if isinstance(space, Discrete | MultiDiscrete | MultiBinary):
        unbounded = np.full(space.shape or (), np.inf)
        return partial(_clipped, -unbounded, unbounded)
    raise TypeError(
        "give known_input=, a function of the action: no numbers follow by themselves from"
        f" {short_repr(space)}"
    )


def _clipped(low: np.ndarray, high: np.ndarray, action: Any) -> np.ndarray:
    """Actions of any shape, clipped, as vectors ``(..., m)``."""
    clipped = np.clip(np.asarray(action, float), low, high)
    return clipped.reshape(*clipped.shape[: clipped.ndim - low.ndim], -1)


def _divided(space: Any, passes: Sequence[Any]) -> tuple[list[Any], list[Any]]:
    """Keys or components of an observation that pass, and those that are estimated.

    Raises:
        ValueError: for a key or component that the observation does not have.
        TypeError: for an estimated part that is no array of numbers.
    """
    every: list[Any] = list(space if isinstance(space, Dict) else range(int(np.prod(space.shape))))
    if unknown := [each for each in passes if each not in every]:
        raise ValueError(f"the observation has no {short_repr(unknown[0])}, which passes= names")
    estimated = [each for each in every if each not in passes]
    for part in [space[key] for key in estimated] if isinstance(space, Dict) else [space]:
        deepest = 1 if part.dtype == np.uint8 else 2
        if not isinstance(part, Box) or len(part.shape) > deepest:
            raise TypeError(
                f"an estimate is of numbers, not of {short_repr(part)}: name it in passes=, or wrap"
                " the environment in one whose observations are a Box of states or a Dict of such"
            )
    return list(passes), estimated


def _sensors(
    model: Model, sensors: str | Sequence[Sensor], inputs: int, faults: Sequence[SensorFault],
    dt: float,
) -> Sensors:  # fmt: skip
    """Sensors of the model's measurements in a quality, or the user's own.

    The model has ``inputs`` known inputs.
    """
    states = tuple(f"x{i}" for i in range(model.n))
    if isinstance(sensors, str):
        quality = SUITES[checks.one_of("sensor suite", sensors, SUITES)]
        R: Any = model.R
        if callable(R) or R.ndim > 2 or np.any(np.diag(np.diagonal(R)) != R):
            raise ValueError(
                "sensors read with independent noise: give the model a diagonal R, or sensors of"
                " your own"
            )
        sd = enumerate(np.sqrt(np.diagonal(R)).tolist())
        own = [Sensor(f"y{i}", (f"y{i}",), partial(_channel, model, i), (each,)) for i, each in sd]
        sensors = in_quality(own, **quality)
    made = Sensors(sensors, states, tuple(f"u{i}" for i in range(inputs)), dt, faults)
    if made.bias.size:
        raise ValueError("sensors here have no bias: make it a state of the model")
    if made.size != model.p:
        raise ValueError(f"the sensors have {made.size} channels, the model reads {model.p}")
    return made


def _channel(model: Model, i: int, state: np.ndarray, exogenous: np.ndarray) -> np.ndarray:
    return np.asarray(model.measurement(state, exogenous))[..., i : i + 1]


def _filter(model: Model, estimator: EstimatorChoice, options: dict[str, Any]) -> Filter:
    """A filter of the package or the user's own, the oracle or dead reckoning."""
    if is_own(estimator):
        return own_filter(estimator, options, model)
    name = checks.one_of("estimator", estimator, (*factory.names(), "truth", "dead-reckoning"))
    if name == "truth":
        return Oracle(model.n, 0, **options)
    if name == "dead-reckoning":
        return DeadReckoning(model, **options)
    return factory.make(name, model, **options)
