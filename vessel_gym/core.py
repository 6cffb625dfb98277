"""The batched core that both faces of an environment share: one step of many environments at once."""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded

from estimators import Belief, Gaussian
from estimators.checks import shown
from vessel_gym.checks import number, numbers, one_of
from vessel_gym.checks import options as checked_options
from vessel_gym.estimation import EstimatorChoice, Oracle, build
from vessel_gym.sensors import SUITES, Sensors
from vessel_gym.streams import Draws, Purpose, stream
from vessel_gym.system import System

Readings = tuple[np.ndarray, np.ndarray]
"""Readings ``(B, p)`` and the mask ``(B, p)`` of those that arrived."""

_ATTACHED = ("system", "vehicle", "task", "sea", "filter")


class Core:
    """``B`` environments of one system: truth, disturbance, sensors, estimator, task.

    One step::

        action -> actuators -> vehicle (truth) -> sensors -> estimator -> task.observe -> observation
                     disturbance --------'  |                                 ^
                                            '-> task.score -> reward      reference

    The reference is where the estimator believes to be. With ``observe="measurement"`` nothing that it believes
    enters an episode: the reference is where the truth is, and only the score and `info` see it.

    Args:
        system: The environment as data.
        num_envs: B.
        estimator: Name of the estimator, or your own (see `vessel_gym.estimation.build`); None: the system's default.
        estimator_options: Options of that estimator.
        sensors: Name of a sensor suite.
        disturbance: Name of a disturbance.
        mismatch: Relative spread of the truth's parameters around the filter's, in [0, 0.25].
        observe: ``"mean"``, ``"mean+std"`` or ``"measurement"``.

    Raises:
        ValueError: for a name that does not exist (saying which do) or a number out of range.
        TypeError: for an option that the estimator does not have.
    """

    def __init__(
        self,
        system: System,
        num_envs: int = 1,
        estimator: EstimatorChoice | None = None,
        estimator_options: dict[str, Any] | None = None,
        sensors: str = "nominal",
        disturbance: str = "moderate",
        mismatch: float = 0.0,
        observe: str = "mean",
    ) -> None:
        if not whole(num_envs) or num_envs < 1:
            raise ValueError(f"num_envs must be a positive whole number, got {shown(num_envs)}")
        one_of("sensor suite", sensors, SUITES)
        one_of("disturbance", disturbance, system.disturbances)
        one_of("observe mode", observe, system.task.sizes())
        if not 0.0 <= number(mismatch) <= 0.25:
            raise ValueError(f"mismatch must be between 0 and 0.25, got {shown(mismatch)}")
        self.num_envs, self.observe_mode = int(num_envs), observe
        self.suite, self.mismatch = SUITES[sensors], float(mismatch)
        choice = system.estimator if estimator is None else estimator
        self._chosen = disturbance, choice, checked_options("estimator_options", estimator_options)
        self.attach(system)
        self.estimator = self.filter.name
        self._oracle, self._foreign = isinstance(self.filter, Oracle), not self.filter._ours
        self._ends = np.array(self.task.ends, dtype=object)
        self._success = self.task.ends.index(self.task.success)
        self.action_size = len(self.vehicle.action_names)
        self.observation_size = self.task.sizes()[observe]

        self.sensors = Sensors(self.vehicle.instruments, self.suite)
        p = self.sensors.size
        self.seeds: list[int] = []
        self.episodes = np.zeros(num_envs, int)
        self._sea_draws = Draws(num_envs, self.sea.size)
        self._sensor_draws = Draws(num_envs, p, self.sensors.uniforms)
        self._filter_streams = [np.random.default_rng(0)] * num_envs if self.filter.random else None
        self._rows = np.arange(num_envs)
        self.steps = np.zeros(num_envs, int)
        self.total = np.zeros(num_envs)
        self.end = np.zeros(num_envs, int)  # number in task.ends
        self.readings: Readings = np.zeros((num_envs, p)), np.zeros((num_envs, p), bool)
        self.belief: Belief
        self.course: np.ndarray  # what the task drew
        self.reference: np.ndarray
        self.truth: np.ndarray
        self.action: np.ndarray  # the last one, clipped; zero after a reset
        self.actuators: np.ndarray
        self.parameters: np.ndarray  # the truth's
        self.sea_state: np.ndarray
        self.forcing: np.ndarray  # over the coming step
        self.tally: np.ndarray  # what the score remembers

    def attach(self, system: System) -> None:
        """Take what is the same for all copies from the system, and build the filter: a copied core needs it again."""
        disturbance, estimator, options = self._chosen
        self.system, self.vehicle, self.task = system, system.vehicle, system.task
        self.sea = system.disturbances[disturbance]
        self.filter = build(system, estimator, options, self.suite, self.sea)

    def __getstate__(self) -> dict[str, Any]:
        """All but what `attach` gives, which may hold functions that cannot be pickled."""
        state = {name: value for name, value in self.__dict__.items() if name not in _ATTACHED}
        return state | {"strides": _strides(self.belief)} if self.seeds else state

    def __setstate__(self, state: dict[str, Any]) -> None:
        """The state as it was, to the last bit of what follows from it."""
        strides = state.pop("strides", {})
        self.__dict__.update(state)
        if strides:
            self.belief = _laid_out(self.belief, strides)

    # --- reset ------------------------------------------------------------------------------------

    def start(
        self,
        seed: int | Sequence[int] | np.ndarray | None = None,
        options: dict[str, Any] | None = None,
        rows: np.ndarray | None = None,
    ) -> None:
        """Start an episode in some environments: `seed`, then `reset`, or neither if either is refused.

        Raises:
            gymnasium.error.ResetNeeded: where only some are started and the others never were.
        """
        if rows is not None and not self.seeds and len(rows) < self.num_envs:
            raise ResetNeeded("the first reset must be of all environments")
        before = self.seeds, self.episodes.copy()
        try:
            self.seed(seed, rows)
            self.reset(rows, options)
        except Exception:
            self.seeds, self.episodes = before
            raise

    def seed(self, seed: int | Sequence[int] | np.ndarray | None, rows: np.ndarray | None = None) -> None:
        """Begin the count of episodes again with these seeds.

        Args:
            seed: A number s (environment i gets s + i), one number for each environment, or None
                to keep the seeds and go on with the next episode.
            rows: Indices of the environments that are seeded, None: all; the seeds of the others stay.

        Raises:
            ValueError: for a negative seed, one that is not a whole number, or a list of another length.
        """
        rows = self._rows if rows is None else rows
        if seed is None and self.seeds:
            self.episodes[rows] += 1
            return
        if seed is None:
            seed = int(np.random.SeedSequence().generate_state(1)[0])
        if isinstance(seed, np.ndarray):
            seed = seed.tolist()
        if whole(seed):
            seeds = [int(seed) + i for i in range(self.num_envs)]  # type: ignore[arg-type]
        elif isinstance(seed, list | tuple):
            seeds = list(seed)
        else:
            raise ValueError(f"seed must be a whole number or a list of them, got {shown(seed)}")
        if len(seeds) != self.num_envs:
            raise ValueError(f"got {len(seeds)} seeds for {self.num_envs} environments")
        if not all(whole(seeds[row]) and seeds[row] >= 0 for row in rows):
            raise ValueError(f"seeds must be whole numbers >= 0, got {shown(seed)}")
        chosen = set(rows.tolist())
        self.seeds = [int(seeds[i]) if i in chosen else self.seeds[i] for i in range(self.num_envs)]
        self.episodes[rows] = 0

    def reset(
        self, rows: np.ndarray | None = None, options: dict[str, Any] | None = None, readings: Readings | None = None
    ) -> None:
        """Start new episodes in some rows: draw the truth from the task's prior and take the first reading.

        Args:
            rows: Indices of the environments; None: all.
            options: The task's reset options.
            readings: Readings to use instead of the sensors' (for replays), ``(len(rows), p)`` each.

        Raises:
            ValueError: for an option or a value that the task does not have, or readings of another shape.
            TypeError: for options that are no dictionary, or readings that are no pair of arrays.
        """
        rows = self._rows if rows is None else rows
        options = checked_options("options", options)
        if readings is not None:
            readings = _arrived(readings, (len(rows), self.sensors.size))
        vehicle, task = self.vehicle, self.task
        size = task.states
        uniforms = np.empty((len(rows), task.uniforms))
        normals = np.empty((len(rows), size + vehicle.normals))
        for i, row in enumerate(rows):
            generator = stream(self.seeds[row], int(self.episodes[row]), Purpose.RESET)
            generator.random(out=uniforms[i])
            generator.standard_normal(out=normals[i])
        course = task.course(uniforms, options)
        prior = task.prior(course, self.sea)
        x = prior.mean + np.matvec(np.linalg.cholesky(prior.cov), normals[:, :size])
        truth, actuators = vehicle.start(x)
        parameters = vehicle.parameters(self.mismatch, normals[:, size:])
        self._sea_draws.restart(rows, self._streams(rows, Purpose.DISTURBANCE))
        self._sensor_draws.restart(rows, self._streams(rows, Purpose.SENSORS))
        rng = None
        if self._filter_streams is not None:
            rng = self._streams(rows, Purpose.FILTER)
            for row, generator in zip(rows, rng, strict=True):
                self._filter_streams[row] = generator
        sea_state = self.sea.start(self._sea_draws.next(self._some(rows))[0])
        forcing = self.sea.forcing(sea_state)
        self._put(
            rows, course=course, truth=truth, actuators=actuators, parameters=parameters, sea_state=sea_state,
            forcing=forcing, tally=task.begin(truth, course), action=np.zeros((len(rows), self.action_size)),
        )  # fmt: skip
        self.steps[rows], self.total[rows], self.end[rows] = 0, 0.0, 0

        readings = self._sense(self._some(rows)) if readings is None else readings
        y, available = self.readings
        self.readings = self._with_rows(y, rows, readings[0]), self._with_rows(available, rows, readings[1])
        n = self.filter.model.n
        belief = self.filter.init(Gaussian(prior.mean[:, :n], prior.cov[:n, :n]), rng=rng)
        steps = self.steps[rows]
        u = task.known_input(actuators, actuators, course, steps)
        belief = self._update(belief, truth, forcing, readings, rng, u)
        if len(rows) == self.num_envs:
            self.belief = belief
        else:
            self.belief = _laid_out(self.belief.with_rows(rows, belief), _strides(self.belief))
        self._put(rows, reference=self._reference(course, steps, belief, truth))

    # --- step -------------------------------------------------------------------------------------

    def step(
        self, action: np.ndarray, readings: Readings | None = None, ended: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Advance every environment by one step.

        Args:
            action: ``(B, a)`` finite; clipped to [-1, 1].
            readings: Readings to use instead of the sensors' (for replays); the sensors then draw nothing.
            ended: Mask ``(B,)`` of environments whose episode has ended and that are reset next: their actions are
                not looked at.

        Returns:
            Reward ``(B,)`` and termination ``(B,)``.

        Raises:
            ValueError: if the action or the readings have the wrong shape, or the action is not finite.
            TypeError: if the readings are no pair of arrays.
            gymnasium.error.ResetNeeded: before the first reset.
        """
        if not self.seeds:
            raise ResetNeeded("call reset() before the first step()")
        self.action = action = self.checked(action, ended)
        if readings is not None:
            readings = _arrived(readings, self.readings[0].shape)
        vehicle, task, sea = self.vehicle, self.task, self.sea
        before = self.actuators
        after = self.actuators = vehicle.actuate(before, action)
        u = task.known_input(before, after, self.course, self.steps)
        self.truth = vehicle.step(self.truth, before, after, self.forcing, self.parameters)
        self.sea_state = sea.advance(self.sea_state, self._sea_draws.next()[0])
        self.forcing = sea.forcing(self.sea_state)
        self.steps += 1
        self.readings = self._sense(None) if readings is None else readings
        rng = self._filter_streams
        belief = self.filter.predict(self.belief, u, rng=rng)
        self.belief = self._update(belief, self.truth, self.forcing, self.readings, rng)
        self.reference = self._reference(self.course, self.steps, self.belief, self.truth)
        reward, self.end, self.tally = task.score(self.truth, self.reference, after, action, self.tally)
        self.total += reward
        return reward, self.end > 0

    def observe(self) -> np.ndarray:
        """The observations ``(B, k)``, float32 and within bounds, made of estimates or readings, mission, actuators."""
        task = self.task
        if self.observe_mode == "measurement":
            with np.errstate(over="ignore"):  # an absurd reading is clipped
                observation = task.observe_readings(*self.readings, self.course, self.steps, self.actuators)
        else:
            observation = task.observe(self.belief, self.reference, self.actuators)
            if self.observe_mode == "mean+std":
                observation = np.concatenate([observation, task.observe_std(self.belief)], -1)
        np.maximum(observation, -task.BOUND, out=observation)
        return np.minimum(observation, task.BOUND, out=observation).astype(np.float32)

    def scored_truth(self) -> np.ndarray:
        """A copy of the true states ``(B, n)``.

        Raises:
            gymnasium.error.ResetNeeded: before the first reset.
        """
        if not self.seeds:
            raise ResetNeeded("call reset() before asking for the truth")
        return self.truth.copy()

    def info(self) -> dict[str, np.ndarray]:
        """Copies of what happened, one row an environment; documented with the environment."""
        belief = self.belief
        unknown_input = self.forcing[:, : self.vehicle.unknown_inputs]
        input_mean = np.zeros(unknown_input.shape) if belief.input_mean is None else belief.input_mean.copy()
        return {
            "truth": self.truth.copy(),
            "unknown_input": unknown_input.copy(),
            "reference": self.reference.copy(),
            "actuators": self.actuators.copy(),
            "measurement": self.readings[0].copy(),
            "available": self.readings[1].copy(),
            "estimate": belief.mean.copy(),
            "covariance": belief.cov.copy(),
            "input_estimate": input_mean,
            "healthy": belief.healthy,
            "score": self.total / self.task.perfect,
            "end": self._ends[self.end],
            "is_success": self.end == self._success,
            "parameters": self.parameters.copy(),
        }

    def checked(self, action: np.ndarray, ended: np.ndarray | None = None) -> np.ndarray:
        """The action as floats ``(B, a)`` clipped to [-1, 1], and 0 where an episode has ended."""
        asked = numbers(action)
        if asked is None:
            raise ValueError(f"action must be an array of numbers, got {shown(action)}")
        if asked.shape != (self.num_envs, self.action_size):
            raise ValueError(f"action has shape {asked.shape}, expected {(self.num_envs, self.action_size)}")
        if ended is not None:
            asked = np.where(ended[:, None], 0.0, asked)
        if not np.logical_and.reduce(np.isfinite(asked), None):
            raise ValueError("action must be finite, got NaN or infinity")
        return np.minimum(np.maximum(asked, -1.0), 1.0)

    # --- inside -----------------------------------------------------------------------------------

    def _streams(self, rows: np.ndarray, purpose: Purpose) -> list[np.random.Generator]:
        return [stream(self.seeds[row], int(self.episodes[row]), purpose) for row in rows]

    def _some(self, rows: np.ndarray) -> np.ndarray | None:
        """The rows, or None when they are all of them, which is faster."""
        return None if len(rows) == self.num_envs else rows

    def _sense(self, rows: np.ndarray | None) -> Readings:
        chosen = slice(None) if rows is None else rows
        exact = self.vehicle.readings(self.truth[chosen], self.forcing[chosen])
        return self.sensors.read(exact, self.steps[chosen], *self._sensor_draws.next(rows))

    def _update(
        self,
        belief: Belief,
        truth: np.ndarray,
        forcing: np.ndarray,
        readings: Readings,
        rng: list[np.random.Generator] | None,
        u: np.ndarray | None = None,
    ) -> Belief:
        """Hand the readings to the filter; to the oracle alone, and no other, the truth."""
        if self._oracle:
            state = self.vehicle.filter_state(truth, self.filter.model.n)
            unknown_input = forcing[:, : self.vehicle.unknown_inputs]
            return self.filter.update(belief, np.concatenate([state, unknown_input], -1), rng=rng, u=u)
        y, available = readings
        if self._foreign:  # a filter of somebody else's may write into what it is given
            y, available = y.copy(), available.copy()
        return self.filter.update(belief, y, rng=rng, available=available, u=u)

    def _reference(self, course: np.ndarray, steps: np.ndarray, belief: Belief, truth: np.ndarray) -> np.ndarray:
        """The reference ``(B, k)``: where the vehicle believes to be, or is, if nobody sees what it believes."""
        if self.observe_mode == "measurement":
            return self.task.reference(course, steps, self.vehicle.filter_state(truth, self.task.states))
        return self.task.reference(course, steps, belief.mean)

    def _put(self, rows: np.ndarray, **arrays: np.ndarray) -> None:
        for name, values in arrays.items():
            setattr(self, name, self._with_rows(getattr(self, name, None), rows, values))

    def _with_rows(self, whole: np.ndarray | None, rows: np.ndarray, values: np.ndarray) -> np.ndarray:
        if whole is None or len(rows) == self.num_envs:
            return values
        merged = whole.copy()
        merged[rows] = values
        return merged


def whole(value: object) -> bool:
    """Whether a value is a whole number: NumPy's too, but not True or 2.0."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def _strides(belief: Belief) -> dict[str, tuple[int, ...]]:
    """How the arrays of a belief lie in memory."""
    arrays = {field.name: getattr(belief, field.name) for field in fields(belief)}
    return {name: array.strides for name, array in arrays.items() if array is not None}


def _laid_out(belief: Belief, strides: dict[str, tuple[int, ...]]) -> Belief:
    """The belief with arrays that lie in memory as told: the last bit of a product depends on that."""
    arrays = {}
    for name, steps in strides.items():
        values = getattr(belief, name)
        size = sum((n - 1) * step for n, step in zip(values.shape, steps, strict=True)) + values.itemsize
        array: np.ndarray = np.ndarray(values.shape, values.dtype, np.empty(size, np.uint8), strides=steps)
        array[...] = values
        if np.array_equal(array, values):  # but where rows that share their memory have come to differ
            arrays[name] = array
    return belief.replace(**arrays)


def _arrived(readings: Readings, shape: tuple[int, ...]) -> Readings:
    """Injected readings as sensors give them: what is not finite did not arrive, and reads 0."""
    pair = readings if isinstance(readings, tuple | list) and len(readings) == 2 else (None, None)
    y, mask = (numbers(part) for part in pair)
    if y is None or mask is None:
        raise TypeError(f"readings must be two arrays, values and the mask of those that came, got {shown(readings)}")
    if y.shape != shape or mask.shape != shape:
        raise ValueError(f"readings have the shapes {y.shape} and {mask.shape}, expected {shape} each")
    available = (mask != 0.0) & np.isfinite(y)
    return np.where(available, y, 0.0), available
