"""The batched core that both faces of an environment share: one step of many environments at once."""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from scipy.linalg import block_diag

from estimators import Belief, Filter, Gaussian, Numbers
from estimators.checks import shown
from estimators.engine import as_word, compiled
from estimators.linalg import shared_root
from estimators.threefry import four_normals, threefry, two_uniforms
from vessel_gym.arrivals import Readings
from vessel_gym.checks import numbers
from vessel_gym.checks import options as checked_options
from vessel_gym.configuration import DRAWN, Configuration
from vessel_gym.disturbances import Disturbance
from vessel_gym.estimation import EstimatorChoice
from vessel_gym.filter_models.build import Composition
from vessel_gym.filter_models.exogenous import Forces
from vessel_gym.foreign import read, refuse_not_finite, traced
from vessel_gym.loop import Loop
from vessel_gym.sensor_faults import SensorFault
from vessel_gym.sensors import Sensor, Sensors
from vessel_gym.system import Estimate, System

DECLARED = 0.5
"""An agent declares a mission done by a last component of its action above this."""
_MOST = 10
"""How often users' functions are traced anew where something that they read has changed, before NumPy computes them."""


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
        sensors: Name of a sensor suite, or a list of `Sensor` objects of one's own.
        disturbance: Name of a disturbance, or a `Disturbance` of one's own.
        mismatch: Relative spread of the truth's parameters around the filter's, in [0, 0.25].
        observe: One of `vessel_gym.configuration.OBSERVE`.
        ends: One of `vessel_gym.configuration.ENDS`; None: ``"belief"`` where estimates are observed, ``"task"`` where
            readings are.
        guidance: Whether the agent is told how to go on, by the path's errors where it is believed to be, or, of raw
            readings, where the last of them put it; None: where estimates are observed.
        num_threads: Threads that share the rows; no result depends on it.
        sensor_faults: What goes wrong with the sensors, and when.

    Raises:
        ValueError: for a name that does not exist (saying which do) or a number out of range.
        TypeError: for an option that the estimator does not have, or sensors, faults or a disturbance that are none.
    """

    def __init__(
        self,
        system: System,
        num_envs: int = 1,
        estimator: EstimatorChoice | None = None,
        estimator_options: dict[str, Any] | None = None,
        sensors: str | Sequence[Sensor] = "nominal",
        disturbance: str | Disturbance = "moderate",
        mismatch: float = 0.0,
        observe: str = "mean",
        ends: str | None = None,
        guidance: bool | None = None,
        num_threads: int = 1,
        sensor_faults: Sequence[SensorFault] = (),
    ) -> None:
        for name, count in (("num_envs", num_envs), ("num_threads", num_threads)):
            if not whole(count) or count < 1:
                raise ValueError(f"{name} must be a positive whole number, got {shown(count)}")
        self.num_envs, self.num_threads = int(num_envs), int(num_threads)
        estimator_options = checked_options("estimator_options", estimator_options)
        self._choices = (
            estimator, estimator_options, sensors, disturbance, mismatch, observe, ends, guidance, sensor_faults,
            self.num_threads,
        )  # fmt: skip
        self.loop: Loop
        self.held: Loop  # what raw readings give as they are, where they guide
        self.attach(system)
        self.action_shape = self.num_envs, self.action_size
        self._ends = np.array(self.task.ends, dtype=object)
        self._none, self._no_input = np.zeros(num_envs, bool), np.zeros((num_envs, 0))
        self._seen: np.ndarray | None = None  # the observation, where it is known

        self.seeds: list[int] = []
        self.episodes = np.zeros(num_envs, int)
        self._keys = np.zeros((num_envs, self.config.draws.world - len(DRAWN), 2), np.uint64)  # of the world's parts
        self._rows = np.arange(num_envs)
        self.steps = np.zeros(num_envs, int)
        self.total = np.zeros(num_envs)
        self.end = np.zeros(num_envs, int)  # number in task.ends
        self.course: np.ndarray  # what the task drew
        self.reference: np.ndarray
        self.state: np.ndarray  # the vehicle's
        self.action: np.ndarray  # the last one, clipped; zero after a reset
        self.actuators: np.ndarray
        self.parameters: np.ndarray  # the truth's
        self.drifting: np.ndarray  # the states of the disturbance, then of the sensors' biases
        self.noise: np.ndarray  # what is new in kicks, disturbance and biases over the coming step
        self.forcing: np.ndarray  # over the coming step
        self.tally: np.ndarray  # what the score remembers

    def attach(self, system: System) -> None:
        """Take what no episode changes from the system: a copied core needs it again."""
        self.config = config = Configuration(system, *self._choices)
        self.system, self.vehicle, self.task, self.forces = config.system, config.vehicle, config.task, config.forces
        self.sensors, self.composition, self.estimator = config.sensors, config.composition, config.estimator
        self.truth_names, self.unknown_inputs = config.true_state.names, config.estimation.inputs
        self.sensors_name, self.disturbance_name = config.sensors_name, config.disturbance_name
        self.mismatch, self.observe_mode, self.guidance = config.mismatch, config.observe_mode, config.guidance
        self.ends, self.success = config.ends, config.success
        self.action_size, self.observation_size = config.action_size, config.observation_size
        for name, estimation in config.estimations.items():
            if hasattr(self, name):
                getattr(self, name).attach(self.sensors, estimation)
            else:
                setattr(self, name, Loop(self.sensors, estimation, self.num_envs))

    def _trace(self) -> None:
        """Make one program of the world and one of the task where users' functions in them can be traced."""
        config, functions = self.config, []
        config.untraced, config.changes = False, config.changes + 1
        sensed, told = (self.state, self.forcing[:, : self.forces.outside], self.bias), self.composition.forces
        steps: tuple[Any, ...] = (
            ("world", self._moving(), self.sensors.users(*sensed)),
            ("mission", self._scoring(), told.users(self.state)),
        )
        for name, arrays, more in steps:
            plain = config.plain[name]
            if plain.users:
                program, few = plain.program(), config.changes < _MOST
                found = traced(plain.step, program.step, arrays, config.own_parts, more) if few else None
                setattr(config, name, plain if found is None else program)
                functions += found or []
        config.reads = read(functions)

    def __getstate__(self) -> dict[str, Any]:
        """All but what `attach` gives, which may hold functions that cannot be pickled."""
        return {name: value for name, value in vars(self).items() if name not in {"config", *vars(self.config)}}

    # --- what was chosen --------------------------------------------------------------------------

    @property
    def filter(self) -> Filter:
        """The estimator."""
        return self.loop.filter

    @property
    def belief(self) -> Belief:
        """What it believes."""
        return self.loop.belief.read_only()

    @property
    def readings(self) -> Readings:
        """What has arrived last, of each channel the youngest."""
        return self.loop.readings

    @property
    def unknown_input(self) -> np.ndarray:
        """The true one of every environment ``(B, q)``; NaN what only the filter thinks there is."""
        columns, array = self.config.unknown_input
        if array:
            return getattr(self, array)[:, columns]
        unheard = np.full((self.num_envs, 1), np.nan)
        return np.concatenate([self.noise, self.forcing, unheard], -1)[:, columns]

    @property
    def truth(self) -> np.ndarray:
        """The true states ``(B, n)``: the vehicle's, the disturbance's if filters are told of them, and the biases."""
        if self.config.true_state.alone:
            return self.state
        return np.concatenate([self.state, self.drifting if self.config.true_state.drifting else self.bias], -1)

    @property
    def score(self) -> np.ndarray:
        """Sums of rewards over that of a perfect episode ``(B,)``, in [0, 1], however long episodes are."""
        perfect, each = self.config.perfect
        return np.clip(self.total / np.maximum(perfect, each * self.steps), 0.0, 1.0)

    def score_of(self, row: int) -> float:
        """That of one environment, in a tenth of the time."""
        perfect, each = self.config.perfect
        score: float = self.total.item(row) / max(perfect, each * self.steps.item(row))
        return score if 0.0 <= score <= 1.0 else min(max(score, 0.0), 1.0)

    @property
    def sea_state(self) -> np.ndarray:
        """The disturbance's state ``(B, k)``."""
        return self.drifting[:, : self.config.world.size]

    @property
    def bias(self) -> np.ndarray:
        """The states of the sensors' biases ``(B, b)``."""
        return self.drifting[:, self.config.world.size :]

    def estimated(self, truth: np.ndarray) -> np.ndarray:
        """What the filter estimates ``(..., n)`` out of true states; NaN for what only the filter thinks there is."""
        estimated = self.config.true_state.estimated
        state = truth[..., estimated]
        state[..., [index < 0 for index in estimated]] = np.nan
        return state

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
            readings: Readings to use instead of the sensors' (for replays), ``(len(rows), p)`` each; where sensors are
                late, ``loop.come`` holds those of a step, by age, ``(len(rows), ages, p)``.

        Raises:
            ValueError: for an option or a value that the task does not have, or readings of another shape.
            TypeError: for options that are no dictionary, or readings that are no pair of arrays.
        """
        rows = self._rows if rows is None else rows
        options = checked_options("options", options)
        if readings is not None:
            readings = _arrived(readings, len(rows), self.sensors)
        config, loop, task = self.config, self.loop, self.config.world.task
        draws = config.draws
        some = None if len(rows) == self.num_envs else rows  # all rows are faster as such
        at = slice(None) if some is None else rows
        seeds = self.seeds if some is None else [self.seeds[row] for row in rows]
        keys, numbers = draw(
            Numbers.seeded(seeds).keys, np.ascontiguousarray(self.episodes[at]), names=draws.words, drawn=draws.counts
        )
        self._refuse_at(np.zeros(len(rows), int), None)
        course = task.course(numbers[:, : task.uniforms], options)
        prior = task.prior(course)
        self._keys[at] = keys[:, len(DRAWN) : draws.world]
        loop.restart(at, keys[:, draws.world :], keys[:, DRAWN.index("filter")])
        steps = np.zeros(len(rows), int)
        actuators, u, state, drifting, noise, forcing, *read, tally = config.world.begin(
            course, prior.mean, shared_root(prior.cov), numbers, keys[:, len(DRAWN) :], steps
        )
        if self.mismatch:
            parameters = config.world.vehicle.parameters(self.mismatch, numbers[:, draws.parameters])
        else:
            parameters = config.nominal.repeat(len(rows), 0)
        self._put(
            some, course=course, state=state, actuators=actuators, parameters=parameters, drifting=drifting,
            noise=noise, forcing=forcing, tally=tally, steps=steps, total=np.zeros(len(rows)),
            end=np.zeros(len(rows), int), action=np.zeros((len(rows), self.action_size)),
        )  # fmt: skip
        readings = loop.receive(readings or (read[0], read[1]), steps, some, readings is not None)
        belief = loop.begin(some, self._known(prior, self.composition), self._handed(readings, rows), u)
        if hasattr(self, "held"):
            self.held.begin(some, self._known(prior, self.held.composition), readings, u)
        self._put(some, reference=self._reference(course, steps, belief, state))
        self._seen = None
        self._refuse_at(self.steps, None)

    def _known(self, prior: Gaussian, told: Composition) -> Gaussian:
        """What a filter knows at the start, of what it estimates."""
        known = _start(prior.cov.tobytes(), told)
        mean = np.zeros((len(prior.mean), len(known.cov)))
        mean[:, : told.base] = prior.mean[:, : told.base]
        return known.about(mean)

    # --- step -------------------------------------------------------------------------------------

    def step(
        self, action: np.ndarray, readings: Readings | None = None, ended: np.ndarray | None = None,
        shape: tuple[int, ...] | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """Advance every environment by one step.

        Args:
            action: ``(B, a)`` finite; clipped to [-1, 1].
            readings: Readings to use instead of the sensors' (for replays); no other random number changes.
            ended: Mask ``(B,)`` of environments whose episode has ended and that are reset next: their actions are
                not looked at.
            shape: That the action must have; None: ``(B, a)``.

        Returns:
            Reward ``(B,)`` and `end` ``(B,)``, which is 0 where an episode goes on.

        Raises:
            ValueError: if the action or the readings have the wrong shape, or the action is not finite.
            TypeError: if the readings are no pair of arrays.
            gymnasium.error.ResetNeeded: before the first reset.
        """
        if not self.seeds:
            raise ResetNeeded("call reset() before the first step()")
        action = self.checked(action, ended, shape)
        if readings is not None:
            readings = _arrived(readings, self.num_envs, self.sensors)
        if self.config.untraced or not all(each.unchanged() for each in self.config.reads):
            self._trace()
        loop, self.action = self.loop, action
        if self.config.own_parts:
            self._refuse_at(self.steps + 1, ended)
        self.steps = self.steps + 1
        self.actuators, u, self.state, self.drifting, self.noise, self.forcing, *read = self._moved()
        readings = loop.receive(readings or (read[0], read[1]), self.steps, None, readings is not None)
        loop.estimate(self._handed(readings), u, self.steps)
        if hasattr(self, "held"):
            self.held.estimate(readings, u, self.steps)
        reward = self._scored()
        self.total += reward
        return reward, self.end

    def _d(self) -> np.ndarray:
        """The estimated unknown input ``(B, q)``; q is 0 where there is none."""
        d = self.loop.belief.input_mean
        return self._no_input if d is None else d

    def _moving(self) -> tuple[np.ndarray, ...]:
        """Arguments of `World.step`."""
        action = self.action[:, :-1] if self.ends == "declaration" else self.action
        return (
            action, self.course, self.reference, self.state, self.actuators, self.forcing, self.parameters, self._keys,
            self.steps, self.drifting, self.noise, self.loop.sensing(None),
        )  # fmt: skip

    def _moved(self) -> Sequence[np.ndarray]:
        """What `World.step` gives; users' functions are checked."""
        world, arrays = self.config.world, self._moving()
        moved = world.step(*arrays, threads=self.num_threads) if world.whole else world.step(*arrays)
        if not world.users:
            return moved
        if world.whole and not moved[-1].all():
            world.step.function(*arrays)  # in NumPy, function by function, which refuses all but what has run away
        return moved[:-1]

    def _scoring(self) -> tuple[np.ndarray, ...]:
        """Arguments of `Mission.step`."""
        action, declared = self.action, self._none
        if self.ends == "declaration":
            action, declared = action[:, :-1], action[:, -1] > DECLARED
        forcing = np.ascontiguousarray(self.forcing[:, : self.forces.outside])
        return (
            self.course, self.steps, declared, self.loop.belief.mean, self._d(), self.state, forcing, self.actuators,
            action, self.tally,
        )  # fmt: skip

    def _scored(self) -> np.ndarray:
        """The reward ``(B,)`` of a step; reference, end and score state follow, and the observation if it is guided."""
        mission, arrays = self.config.mission, self._scoring()
        scored = mission.step(*arrays, threads=self.num_threads) if mission.whole else mission.step(*arrays)
        self.reference, reward, end, self.tally, *seen = scored
        self._seen = seen[0] if self.config.guided else None
        if mission.users:
            if not scored[-1].all():
                self._seen = None
                if mission.whole:
                    mission.step.function(*arrays)
                self._check_ends(end)
            end = end.astype(int)
        self.end = end
        return reward

    def observe(self) -> np.ndarray:
        """The observations ``(B, k)``, float32 and within bounds, made of estimates or readings, mission, actuators."""
        if self.config.untraced:
            self._trace()
        observation = self._seen
        if observation is None:
            bound = self.task.BOUND
            with np.errstate(over="ignore", invalid="ignore"):  # diverged estimates are clipped
                parts = self._observed()
                observation = np.clip(parts[0] if len(parts) == 1 else np.concatenate(parts, -1), -bound, bound)
            if self.config.world.task is not self.task:
                name = f"the observation of {type(self.task).__name__}"
                refuse_not_finite(name, observation, self.steps, None, self.loop.belief.mean, self.state)
            self._seen = observation if self.config.guided else None
        return observation.astype(np.float32, "C")

    def _observed(self) -> list[np.ndarray]:
        """The parts of the observations, before they are clipped."""
        task, course, steps = self.config.world.task, self.course, self.steps
        if self.observe_mode == "measurement":
            parts = [task.observe_readings(self.sensors, *self.loop.readings, course, steps)]
            parts.append(task.observe_mission(course, steps, self.actuators))
            if hasattr(self, "held"):
                held = self._estimate(self.held.belief, self.held.composition)
                reference = task.reference(course, steps, held.state)
                parts.insert(0, task.observe(held, reference, self.actuators))
            return parts
        if self.config.guided:
            return [self.config.mission.observe(self.loop.belief.mean, self._d(), self.reference, self.actuators)]
        estimate = self._estimate(self.loop.belief, self.composition)
        if self.guidance:
            parts = [task.observe(estimate, self.reference, self.actuators)]
        else:
            mission = task.observe_mission(course, steps, self.actuators)
            parts = [task.observe_state(estimate, course), mission]
        if "std" in self.observe_mode:
            parts.append(task.observe_std(estimate))
        if "alarms" in self.observe_mode:
            parts.append(self.loop.alarms)
        return parts

    def _estimate(self, belief: Belief, told: Composition) -> Estimate:
        """What the task sees of a belief."""
        mean, input_mean = belief.mean, belief.input_mean
        state = mean if told.base == mean.shape[1] else mean[:, : told.base]
        if input_mean is not None and not input_mean.shape[-1]:
            input_mean = None
        flow = told.flow(mean, input_mean)
        if "std" not in self.observe_mode:
            return Estimate(state, flow, input_mean)
        variance = np.maximum(belief.cov.diagonal(0, -2, -1), 0.0)
        known = (
            None
            if input_mean is None or belief.input_cov is None
            else np.maximum(belief.input_cov.diagonal(0, -2, -1), 0.0)
        )
        return Estimate(state, flow, input_mean, np.sqrt(variance),
                        None if known is None else np.sqrt(known), told.scale)  # fmt: skip

    def scored_truth(self) -> np.ndarray:
        """A copy of the true states ``(B, n)``.

        Raises:
            gymnasium.error.ResetNeeded: before the first reset.
        """
        if not self.seeds:
            raise ResetNeeded("call reset() before asking for the truth")
        truth = self.truth
        return truth.copy() if truth is self.state else truth

    def info(self, rows: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """Copies of what happened, one row an environment; documented with the environment.

        Args:
            rows: Mask ``(B,)`` of those that are wanted; of the others comes 0 or None. None: all.
        """
        happened = self.happened() | {
            "healthy": self.loop.belief.healthy,
            "score": self.score,
            "end": self._ends[self.end],
            "is_success": self.end == self.success,
        }
        return {name: _only(rows, values) for name, values in happened.items()}

    def happened(self) -> dict[str, np.ndarray]:
        """What happened as it is kept, one row an environment: not to be written into."""
        belief, unknown_input = self.loop.belief, self.unknown_input
        input_mean = belief.input_mean
        happened = {
            "truth": self.truth,
            "unknown_input": unknown_input,
            "reference": self.reference,
            "actuators": self.actuators,
            "measurement": self.loop.readings[0],
            "available": self.loop.readings[1],
            "estimate": belief.mean,
            "covariance": belief.cov,
            "input_estimate": np.zeros(unknown_input.shape) if input_mean is None else input_mean,
            "parameters": self.parameters,
        }
        if self.sensors.horizon:
            happened["refused"] = self.loop.refused
        if self.sensors.faults:
            happened["sensor_faults"] = self.loop.faulty(self.steps)
        if self.loop.monitor is not None:
            happened["alarms"] = self.loop.alarms
        return happened

    def checked(
        self, action: np.ndarray, ended: np.ndarray | None = None, shape: tuple[int, ...] | None = None
    ) -> np.ndarray:
        """The action as floats ``(B, a)`` clipped to [-1, 1], and 0 where an episode has ended."""
        asked = action if type(action) is np.ndarray and action.dtype.kind == "f" else numbers(action)
        if asked is None:
            raise ValueError(f"action must be an array of numbers, got {shown(action)}")
        shape = self.action_shape if shape is None else shape
        if asked.shape != shape:
            raise ValueError(f"action has shape {asked.shape}, expected {shape}")
        checked = np.array(asked, float, order="C", ndmin=2)
        if ended is not None:
            checked[ended] = 0.0
        if not np.isfinite(checked).all():
            raise ValueError("action must be finite, got NaN or infinity")
        return checked.clip(-1.0, 1.0)

    # --- inside -----------------------------------------------------------------------------------

    def _check_ends(self, end: np.ndarray) -> None:
        """Refuse an end of a user's task that there is not."""
        if not np.isin(end, np.arange(len(self._ends))).all():
            name = f"score of {type(self.task).__name__}"
            raise ValueError(
                f"{name} gave the numbers of ends {shown(end.tolist())}: they must be whole and below {len(self._ends)}"
            )

    def _refuse_at(self, steps: np.ndarray, ended: np.ndarray | None) -> None:
        """Tell the user's vehicle and task for their refusals at which step they are, and which rows are over."""
        for part in self.config.own_parts:
            part.steps, part.ended = steps, ended

    def _handed(self, readings: Readings, rows: np.ndarray | None = None) -> Readings:
        """What the filter is handed: the readings; the oracle alone, and no other, the truth."""
        if not self.loop.tells_truth:
            return readings
        truth = np.concatenate([self.estimated(self.truth), self.unknown_input], -1)
        truth = truth if rows is None else truth[rows]
        return truth, np.ones(truth.shape, bool)

    def _reference(self, course: np.ndarray, steps: np.ndarray, belief: Belief, state: np.ndarray) -> np.ndarray:
        """The reference ``(B, k)``: where the vehicle believes to be, or is, if nobody sees what it believes."""
        where = state[:, self.config.based] if self.observe_mode == "measurement" else belief.mean
        reference: np.ndarray = self.config.world.task.reference(course, steps, where)
        return reference

    def _put(self, rows: np.ndarray | None, **arrays: np.ndarray) -> None:
        """Take new values of some rows; None: of all."""
        self.__dict__.update(
            arrays if rows is None else {name: _merged(getattr(self, name), rows, new) for name, new in arrays.items()}
        )


@compiled(axes=(1, 0))
def draw(
    seeds: np.ndarray, episodes: np.ndarray, *, names: tuple[int, ...], drawn: tuple[tuple[int, int, int], ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Keys of the parts of episodes, and the random numbers of their starts.

    They are those of `estimators.Numbers`, at step 0.

    Args:
        seeds: ``(..., 2)`` keys.
        episodes: ``(...)``.
        names: A word for each part.
        drawn: For each part how many uniform numbers and normal ones it draws, and the use of these.

    Returns:
        Keys ``(..., parts, 2)``, and numbers ``(..., k)`` part by part.
    """
    zero: Any = np.uint64(0)
    own = threefry(as_word(episodes), zero, seeds[..., 0], seeds[..., 1])
    keys = [np.stack(threefry(np.uint64(name), zero, *own), -1) for name in names]
    numbers: list[np.ndarray] = []
    for key, (uniforms, count, use) in zip(keys, drawn, strict=True):
        pairs = (two_uniforms(key, np.uint64(i), zero) for i in range((uniforms + 1) // 2))
        numbers += [pair[..., i] for pair in pairs for i in range(2)][:uniforms]
        fours = (four_normals(key, np.uint64(i), np.uint64(use)) for i in range((count + 3) // 4))
        numbers += [four[..., i] for four in fours for i in range(4)][:count]
    empty = np.zeros((*episodes.shape, 0))
    return np.stack(keys, -2), np.stack(numbers, -1) if numbers else empty


def _only(rows: np.ndarray | None, values: np.ndarray) -> np.ndarray:
    """A copy of the values of some rows, with 0 or None in the others; None: of all."""
    if rows is None:
        return values.copy()
    only = np.full(values.shape, None) if values.dtype == object else np.zeros(values.shape, values.dtype)
    only[rows] = values[rows]
    return only


def _merged(whole: np.ndarray, rows: np.ndarray | None, values: np.ndarray) -> np.ndarray:
    """An array with new values of some rows; None: of all."""
    if rows is None:
        return values
    merged = whole.copy()
    merged[rows] = values
    return merged


def joint_prior(cov: np.ndarray, forces: Forces, sensors: Sensors) -> np.ndarray:
    """What is known at the start of vehicle, disturbance and biases together, given that ``(n, n)`` of the vehicle.

    A vehicle whose velocity is over ground is carried along by the flow from the first moment.
    """
    process = forces.disturbance.process
    whole = block_diag(cov, process.start_cov, sensors.bias.start_cov)
    if forces.vehicle.carried is None:
        return whole
    root = np.eye(len(whole))
    n = len(cov)
    root[:n, n : n + process.size] = forces.vehicle.carried @ forces.linear[len(forces.vehicle.kicks) : forces.outside]
    return root @ whole @ root.T


@lru_cache(maxsize=16)
def _start(cov: bytes, told: Composition) -> Gaussian:
    """What a filter knows at the start about a mean of 0, given a covariance ``(n, n)`` of the vehicle."""
    whole = joint_prior(_square(cov), told.forces, told.sensors)
    n, bias = len(_square(cov)), np.arange(len(whole) - told.sensors.bias.size, len(whole))
    kept = np.concatenate([np.arange(told.base), n + told.held, bias])
    known = whole[np.ix_(kept, kept)]
    if told.late:
        known = block_diag(known, told.forces.input_cov)
    return Gaussian(np.zeros(len(known)), known)


def _square(matrix: bytes) -> np.ndarray:
    flat = np.frombuffer(matrix)
    return flat.reshape(2 * (math.isqrt(len(flat)),))


def whole(value: object) -> bool:
    """Whether a value is a whole number: NumPy's too, but not True or 2.0."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def _arrived(readings: Readings, rows: int, sensors: Sensors) -> Readings:
    """Injected readings as sensors give them: what is not finite did not arrive, and reads 0."""
    pair = readings if isinstance(readings, tuple | list) and len(readings) == 2 else (None, None)
    y, mask = (numbers(part) for part in pair)
    if y is None or mask is None:
        raise TypeError(f"readings must be two arrays, values and the mask of those that came, got {shown(readings)}")
    shapes = [(rows, sensors.size), (rows, sensors.horizon + 1, sensors.size)][: 2 if sensors.horizon else 1]
    if y.shape != mask.shape or y.shape not in shapes:
        expected = " each, or by age ".join(map(str, shapes))
        raise ValueError(f"readings have the shapes {y.shape} and {mask.shape}, expected {expected} each")
    available = (mask != 0.0) & np.isfinite(y)
    return np.where(available, y, 0.0), available
