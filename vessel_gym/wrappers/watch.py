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
from gymnasium.spaces import Box, Dict, Discrete, MultiBinary, MultiDiscrete, Space

from estimators import (
    Filter,
    Gaussian,
    LinearModel,
    Model,
    NonlinearModel,
    RandomKeys,
    factory,
    wrap,
)
from estimators.checks import numbers, short_repr
from estimators.randomness import word
from vessel_gym import checks
from vessel_gym.configuration import OBSERVE
from vessel_gym.delivery import Delivery
from vessel_gym.loop import Estimator
from vessel_gym.models.estimation import LATE, Estimation, EstimatorChoice, is_own, own_filter
from vessel_gym.models.reference_filters import DeadReckoning, Oracle
from vessel_gym.sensor_faults import SensorFault
from vessel_gym.sensors import SUITES, Sensor, Sensors
from vessel_gym.state import State

KNOWN = ("truth", "dead-reckoning")
"""Estimators besides filters that a wrapper offers."""


class Watch:
    """Sensors, filter and belief of B rows of an environment, from their true states.

    Args:
        space: Observation space of one environment.
        action_space: Action space of one environment.
        rows: B.
        dt: Time step [s] of the environment, see `time_step`.
        model, prior, ...: As of `vessel_gym.wrappers.EstimatedObservation`; functions take B rows.
    """

    def __init__(
        self, space: Space, action_space: Space, rows: int, dt: float, model: Model,
        prior: Gaussian, observation: Callable[[np.ndarray], Any] | None = None,
        passes: Sequence[Any] = (), known_input: Callable[[Any], Any] | None = None,
        estimator: EstimatorChoice = "ekf", estimator_options: dict[str, Any] | None = None,
        sensors: str | Sequence[Sensor] = "nominal", observe: str = "mean",
        sensor_faults: Sequence[SensorFault] = (),
    ) -> None:  # fmt: skip
        _check_model(model, prior)
        checks.function("observation", observation, "the state")
        checks.function("known_input", known_input, "the action")
        self.observe_mode = checks.one_of("observe mode", observe, OBSERVE)
        self._angles = list(model.state_angles)
        self.rows, self.n, self.prior, self.own = rows, model.n, prior, space
        self._observation, self._known = observation, known_input or plain_action(action_space)
        self._passes = _checked_passes(space, passes)
        self.model, self._suite = model, isinstance(sensors, str)
        u = self._checked_input(action_space)
        self.sensors = _sensors(model, sensors, len(u), sensor_faults, dt)
        options = checks.options("estimator_options", estimator_options)
        late = checks.one_of("value of late", options.pop("late", LATE[0]), LATE)
        R = self.sensors.noise(partial(_expected, self.sensors), prior.mean, u)
        self.filter = _filter(replace(cast(Any, model), R=R), estimator, options)
        horizon = self.sensors.horizon
        estimation = Estimation(self.filter, cast(Any, None), 1.0, (), late, horizon)
        self._delivery = Delivery(self.sensors)
        self._estimator = Estimator(estimation, "belief", attrgetter("state"))
        own = getattr(estimator, "__name__", "own")
        self.estimator = estimator if isinstance(estimator, str) else own
        self.now = State(episode=np.zeros(rows, int))
        self._no_input, self._tells_truth = np.zeros((rows, u.shape[-1])), estimation.tells_truth
        self._keys, self._seeded = np.zeros((rows, 2), np.uint64), np.zeros(rows, bool)
        names = [*(sensor.name for sensor in self.sensors.each), "filter"]
        self._parts = np.array([word(name) for name in names], np.uint64)
        self.space = self._space()
        if observation is not None and rows > 1:
            self._check_rows(observation)

    # --- one step ---------------------------------------------------------------------------------

    def seed(self, rows: np.ndarray, seeds: Sequence[int | None]) -> None:
        """Seed the rows of a mask ``(B,)``, and restart their count of episodes.

        A row whose seed is None continues; without an earlier seed it gets a random one.
        """
        episode = self.now.episode.copy()
        for i in np.flatnonzero(rows).tolist():
            seed = seeds[i]
            if seed is None and not self._seeded[i]:
                seed = int(np.random.SeedSequence().generate_state(1, np.uint64)[0])
            if seed is not None:
                self._keys[i] = RandomKeys.seeded([int(seed)]).keys[0]
                self._seeded[i], episode[i] = True, -1
        self.now = self.now.but(episode=episode)

    def begin(self, rows: np.ndarray, state: np.ndarray) -> None:
        """Begin episodes in the rows of a mask ``(B,)``, in states ``(B, n)``."""
        chosen, state = np.flatnonzero(rows), self._checked(state)
        episode = self.now.episode[chosen] + 1
        seeded = RandomKeys(self._keys[chosen]).of(episode)
        keys = RandomKeys(seeded.keys[:, None]).of(self._parts).keys
        now = State(
            episode=episode, steps=np.zeros(len(chosen), int), sensing=keys[:, :-1].copy(),
            filtering=keys[:, -1].copy(), state=state[chosen], u=self._no_input[chosen],
        )  # fmt: skip
        self._delivery.begin(now)
        self._deliver(now)
        prior = self.prior.about(np.broadcast_to(self.prior.mean, now.state.shape))
        self._estimator.begin(now, prior)
        self.now = now if rows.all() else self.now.merged(chosen, now)

    def go_on(self, state: np.ndarray, action: Any, reset_mask: np.ndarray) -> None:
        """Step all rows to states ``(B, n)``; rows of ``reset_mask (B,)`` begin an episode."""
        if not self._seeded.all():
            raise ResetNeeded("call reset() before step()")
        now = self.now
        self.now = now = now.but(
            steps=now.steps + 1, state=self._checked(state), u=self.known(action)
        )
        self._deliver(now)
        self._estimator.step(now)
        if reset_mask.any():
            self.begin(reset_mask, now.state)

    def _deliver(self, now: State) -> None:
        """Sample the sensors, and deliver measurements."""
        x, u = now.state, now.u
        if self._suite:
            exact = np.asarray(self.model.measurement(x, u), float)
            measured = self.sensors.corrupted(exact, self.sensors.sd, now.steps, now.sensing)
        else:
            no_bias = np.zeros((len(x), 0))
            measured = self.sensors.read(x, u, no_bias, now.steps, now.sensing)
        now.y, now.available = measured
        self._delivery(now)

    def observe(self, seen: Any) -> Any:
        """Observations ``(B, ...)``, given the environment's own observations ``seen``."""
        if self.observe_mode == "measurement":
            return self._read(seen)
        now, belief = self.now, self.now.belief
        mean = np.array(now.state if self._tells_truth else belief.mean)
        if self._angles and self._observation is None and not self._tells_truth:
            mean[:, self._angles] = wrap(mean[:, self._angles])  # filters do not wrap angles
        value = mean if self._observation is None else self._observation(mean)
        beside: dict[str, np.ndarray] = {}
        if "std" in self.observe_mode:
            variance = np.maximum(belief.cov.diagonal(0, -2, -1), 0.0)
            beside["std"] = np.sqrt(variance).astype(np.float32)
        if isinstance(self.own, Dict):
            return self._filled(value, seen) | beside
        fitted = self._fitted(value, self.own, seen, self._passes)
        if not beside:
            return fitted
        parts = [fitted.reshape(self.rows, -1), *beside.values()]
        return np.concatenate(parts, -1).astype(np.float32)

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

    def known(self, action: Any) -> np.ndarray:
        """Known input of filters for an action."""
        u, (rows, m) = self._numbers(action), self._no_input.shape
        if u.shape != (rows, m) and not (rows == 1 and np.atleast_1d(u).shape == (m,)):
            batch = f"an array {rows, m}, a row for each environment"
            wanted = f"{m} numbers" if rows == 1 else batch
            raise ValueError(f"known_input must give {wanted}, got shape {u.shape}")
        if not np.isfinite(u).all():
            raise ValueError(
                f"known_input gave what is not finite, {short_repr(u.tolist())}: was the action"
                f" {short_repr(action)}?"
            )
        return u.reshape(rows, m)

    def _numbers(self, action: Any) -> np.ndarray:
        known = self._known(action)
        u = numbers(known)
        if u is None:
            raise ValueError(
                f"known_input must give numbers, got {short_repr(known)} for {short_repr(action)}"
            )
        return u

    def _read(self, seen: Any) -> Any:
        """Measurements, mask of those that arrived, and passing components."""
        measurements = np.concatenate([self.now.y, self.now.available], -1).astype(np.float32)
        if isinstance(self.own, Dict):
            return {"measurement": measurements, **{key: seen[key] for key in self._passes}}
        whole = np.asarray(seen, np.float32).reshape(self.rows, -1)
        return np.concatenate([measurements, whole[:, list(self._passes)]], -1)

    # --- inside -----------------------------------------------------------------------------------

    def _checked_input(self, action_space: Space) -> np.ndarray:
        """Known input ``(m,)`` of a random action, for which the model's functions are checked."""
        action = deepcopy(action_space).sample()  # a copy, so that the space's own state stays
        u = np.atleast_1d(self._numbers(action))
        self.model.check_known_input(u)
        return u

    def _check_rows(self, observation: Callable[[np.ndarray], Any]) -> None:
        """Refuse an observation function that puts rows last.

        If B is the size of an observation, the shape does not show this.

        Raises:
            ValueError: if a change of the state in one row changes observations of others.
        """
        states = np.broadcast_to(self.prior.mean, (self.rows, self.n)).copy()
        others = states.copy()
        others[0] += np.sqrt(np.diagonal(self.prior.cov)) + 1e-3
        for one, other in zip(*(_parts(observation(x)) for x in (states, others)), strict=True):
            equal = np.array_equal(one[1:], other[1:], equal_nan=True)
            if one.shape[:1] == (self.rows,) and not equal:
                raise ValueError(
                    "observation must give a row for each environment, and mixes them: give x[...,"
                    " 0] and the like, joined by np.stack(..., -1)"
                )

    def _checked(self, state: Any) -> np.ndarray:
        array = numbers(state)
        if array is None or array.shape != (self.rows, self.n):
            wanted = (self.n,) if self.rows == 1 else (self.rows, self.n)
            got = self._described(state)
            raise ValueError(f"state must give the model's states, {wanted} numbers, got {got}")
        if not np.isfinite(array).all():
            bad = array[~np.isfinite(array).all(-1)][0].tolist()
            raise ValueError(f"state gave what is not finite: {short_repr(bad)}")
        return np.array(array, order="C")

    def _described(self, value: Any) -> str:
        """Shape of a user's value without its axis of one row, or the value if it is no numbers."""
        array = numbers(value)
        if array is None:
            return short_repr(value)
        return f"shape {array.shape[1:] if self.rows == 1 else array.shape}"

    def _space(self) -> Space:
        """Observation space."""
        further, measuring = {}, self.observe_mode == "measurement"
        if measuring:
            further["measurement"] = Box(-np.inf, np.inf, (2 * self.sensors.size,), np.float32)
        if "std" in self.observe_mode:
            further["std"] = Box(0.0, np.inf, (self.n,), np.float32)
        if not further:
            return self.own
        if isinstance(self.own, Dict):
            spaces = self.own.spaces
            kept = {key: spaces[key] for key in (self._passes if measuring else spaces)}
            for key in further:
                if key in kept:
                    raise ValueError(
                        f"the environment's observations have a key {key} of their own:"
                        " observe='mean'"
                    )
            return Dict(OrderedDict(kept | further))  # Gymnasium sorts a plain dict by its keys
        bounds = cast(Box, self.own).low.ravel(), cast(Box, self.own).high.ravel()
        others = [(box.low, box.high) for box in further.values()]
        passing = [each[list(self._passes)] for each in bounds]
        parts = [*others, passing] if measuring else [bounds, *others]
        low, high = (np.concatenate(each).astype(np.float32) for each in zip(*parts, strict=True))
        return Box(low, high, dtype=np.float32)

    def _filled(self, value: Any, seen: dict[str, Any]) -> dict[str, Any]:
        """Dictionary of observations, from the function's values and the passing keys."""
        own = cast(Dict, self.own).spaces
        given = value if isinstance(value, dict) else {}
        if {*given, *self._passes} != {*own}:
            missing = sorted({*own} - {*given, *self._passes}) or sorted({*given} - {*own})
            raise ValueError(
                "observation must give a dictionary of all that does not pass,"
                f" {', '.join(missing)} too: give it, or name it in passes"
            )
        return {
            key: seen[key] if key in self._passes else self._fitted(given[key], own[key])
            for key in own
        }

    def _fitted(
        self, value: Any, own: Space, seen: Any = None, passes: Sequence[int] = ()
    ) -> np.ndarray:
        """Observation in the form of the space, with passing components from ``seen``.

        An estimate is clipped to the bounds of the space, which the truth may exceed, and rounded
        in a space of whole numbers.
        """
        if not isinstance(own, Box):
            raise ValueError(
                f"an estimate is of numbers, not of {short_repr(own)}: name it in passes"
            )
        size, array = int(np.prod(own.shape)), numbers(value)
        rest: Any = np.setdiff1d(np.arange(size), passes) if passes else slice(None)
        shape = rest.shape if passes else own.shape
        fitting = (self.rows, *shape), (self.rows, int(np.prod(shape)))
        if array is None or array.shape not in fitting:
            raise ValueError(
                f"the observation space wants {shape} numbers, the estimate gives"
                f" {self._described(value)}: give observation=, a function of the state, or name in"
                " passes what it does not give"
            )
        array = array.reshape(self.rows, -1)
        if np.isnan(array).any():
            bad = self.now.belief.mean[np.isnan(array).any(-1)][0]
            raise ValueError(f"observation gave NaN of the state {short_repr(bad.tolist())}")
        if not self._tells_truth:
            array = np.clip(array, own.low.ravel()[rest], own.high.ravel()[rest])
        array = (np.rint(array) if cast(Any, own.dtype).kind in "iu" else array).astype(own.dtype)
        if passes:
            given, array = array, np.array(seen, own.dtype).reshape(self.rows, -1)
            array[:, rest] = given
        return array.reshape(self.rows, *own.shape)


def _check_model(model: Model, prior: Gaussian) -> None:
    if not isinstance(model, LinearModel | NonlinearModel):
        raise TypeError(f"model must be a LinearModel or a NonlinearModel, got {short_repr(model)}")
    if not isinstance(prior, Gaussian):
        raise TypeError(f"prior must be a Gaussian(mean, cov), got {short_repr(prior)}")
    if prior.mean.shape != (model.n,):
        raise ValueError(
            f"the prior is for shape {prior.mean.shape}, the model has {model.n} states:"
            f" ({model.n},)"
        )


def _parts(value: Any) -> list[np.ndarray]:
    """Values of an observation function, key by key."""
    return [np.asarray(part) for part in (value.values() if isinstance(value, dict) else [value])]


def time_step(env: Any) -> float:
    """Time step [s] of a single or vector environment: its ``dt``, or else 1, a step."""
    base = getattr(env, "unwrapped", env)
    if envs := getattr(base, "envs", ()):
        return time_step(envs[0])
    if makers := getattr(base, "env_fns", ()):  # environments in other processes
        with closing(makers[0]()) as one:
            return time_step(one)
    dt = getattr(base, "dt", None)
    return float(dt) if isinstance(dt, int | float | np.floating) and 0.0 < dt < np.inf else 1.0


def observed_state(env: Any, seen: Any) -> Any:
    """The state of an environment whose observation is the state."""
    return seen


def plain_action(space: Space) -> Callable[[Any], Any]:
    """Function from actions of a space to numbers ``(..., m)``, clipped to the bounds."""
    if isinstance(space, Box):
        return partial(_clipped, space.low.astype(float), space.high.astype(float))
    if isinstance(space, Discrete):
        return partial(_clipped, -np.inf, np.inf)
    if isinstance(space, MultiDiscrete | MultiBinary):
        return partial(np.asarray, dtype=float)
    raise TypeError(
        "give known_input=, a function of the action: no numbers follow by themselves from"
        f" {short_repr(space)}"
    )


def _clipped(low: Any, high: Any, action: Any) -> np.ndarray:
    """Actions of any shape, clipped, as vectors ``(..., m)``."""
    clipped = np.clip(np.asarray(action, float), low, high)
    return clipped.reshape(*clipped.shape[: clipped.ndim - np.ndim(low)], -1)


def _checked_passes(space: Space, passes: Sequence[Any]) -> tuple[Any, ...]:
    if not isinstance(passes, list | tuple | range | np.ndarray):
        raise TypeError(f"passes must be a list of keys or components, got {short_repr(passes)}")
    chosen = tuple(passes)
    if isinstance(space, Dict):
        for key in chosen:
            if key not in space.spaces:
                raise ValueError(
                    factory.unknown("key of the observation in passes", key, list(space.spaces))
                )
        return chosen
    deepest = 1 if space.dtype == np.uint8 else 2
    if not isinstance(space, Box) or len(space.shape) > deepest:
        what = "images" if isinstance(space, Box) else short_repr(space)
        raise TypeError(
            f"the environment shows {what}, and an estimate is of numbers: wrap it in one whose"
            " observations are a Box of states or a Dict of such"
        )
    size = int(np.prod(space.shape))
    if any(
        isinstance(i, bool) or not isinstance(i, int | np.integer) or not 0 <= i < size
        for i in chosen
    ):
        raise ValueError(
            f"passes must be indices of components below {size}, got {short_repr(passes)}"
        )
    return chosen


def _sensors(
    model: Model,
    sensors: str | Sequence[Sensor],
    inputs: int,
    faults: Sequence[SensorFault],
    dt: float,
) -> Sensors:
    """Sensors of the model's measurements in a quality, or the user's own.

    The model has ``inputs`` known inputs.
    """
    states = tuple(f"x{i}" for i in range(model.n))
    if isinstance(sensors, str):
        suite = SUITES[checks.one_of("sensor suite", sensors, SUITES)]
        R: Any = model.R
        if callable(R) or R.ndim > 2 or np.any(np.diag(np.diagonal(R)) != R):
            raise ValueError(
                "sensors read with independent noise: give the model a diagonal R, or sensors of"
                " your own"
            )
        sd = np.sqrt(np.diagonal(R)).tolist()
        reads = [partial(_channel, model, i) for i in range(len(sd))]
        own = [Sensor(f"y{i}", (f"y{i}",), reads[i], (sd[i],)) for i in range(len(sd))]
        sensors = suite.of(own)
    made = Sensors(sensors, states, tuple(f"u{i}" for i in range(inputs)), dt, faults)
    if made.bias.size:
        raise ValueError("sensors here have no bias: make it a state of the model")
    if made.size != model.p:
        raise ValueError(f"the sensors have {made.size} channels, the model reads {model.p}")
    return made


def _expected(sensors: Sensors, x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
    """Measurements without noise ``(..., p)`` in states ``(..., n)``."""
    assert u is not None
    return sensors.exact(x, np.broadcast_to(u, x.shape[:-1] + u.shape[-1:]))


def _channel(model: Model, i: int, state: np.ndarray, exogenous: np.ndarray) -> np.ndarray:
    return np.asarray(model.measurement(state, exogenous))[..., i : i + 1]


def _filter(model: Model, estimator: EstimatorChoice, options: dict[str, Any]) -> Filter:
    if is_own(estimator):
        return own_filter(estimator, options, model)
    known = (*factory.names(), *KNOWN)
    if not isinstance(estimator, str) or estimator not in known:
        sentence = factory.unknown("estimator", estimator, known)
        raise ValueError(f'{sentence}; raw measurements are observe="measurement"')
    if estimator not in KNOWN:
        return factory.make(estimator, model, **options)
    if options:
        raise TypeError(f"{estimator} has no option {next(iter(options))!r}: it takes none")
    return Oracle(model.n, 0) if estimator == "truth" else DeadReckoning(model)
