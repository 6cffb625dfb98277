"""The batched core of single and vector environments: many environments at once."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded

from estimators import Gaussian, RandomKeys
from estimators.checks import integer
from estimators.linalg import shared_root
from vessel_gym.checks import checked_action, is_compiled, refuse_not_finite
from vessel_gym.checks import options as checked_options
from vessel_gym.simulation.configuration import Configuration, Options
from vessel_gym.simulation.draws import DRAWN, filter_prior, next_episodes, start_numbers
from vessel_gym.simulation.state import State
from vessel_gym.simulation.truth import INFO
from vessel_gym.simulation.whole_step import Moment
from vessel_gym.system import System

_FEW = 512
"""Rows up to which one program is faster than its stages, which fit better in caches."""


class Core:
    """``B`` environments of one system: what no step changes, and a record of all that one does.

    One step::

        action -> actuators -> vehicle -> sensors -> delivery -> estimator -> mission -> observation
                 disturbance ----'  |                                            ^
                                    '--------------------------------------------'-> reward

    The reference is evaluated at the estimated state. With ``observe="measurement"`` no estimate
    enters an episode: the reference is evaluated at the true state, and only the score and `info`
    use it.

    Args:
        system: The environment as data.
        num_envs: B.
        arguments: Fields of `vessel_gym.simulation.configuration.Options`, in order.
        named: Fields of `vessel_gym.simulation.configuration.Options`, by name.

    Attributes:
        config: World, estimators, mission and options, which no step changes.
        last: ``now``, or what a program has made of it.
        seeds: One seed for each environment; empty before the first reset.

    Raises:
        ValueError: as `vessel_gym.simulation.configuration.Options`.
        TypeError: as `vessel_gym.simulation.configuration.Options`.
    """

    def __init__(self, system: System, num_envs: int = 1, *arguments: Any, **named: Any) -> None:
        self.num_envs = integer("num_envs", num_envs, 1)
        self.config = Configuration(system, Options(*arguments, **named))
        self.action_shape = self.num_envs, self.config.action_size
        self._together = bool(self.config.whole_steps) and num_envs <= _FEW
        self.seeds: list[int] = []
        zeros = np.zeros(num_envs, int)
        self.last: State | Moment = State(episode=zeros, over=zeros.astype(bool), end=zeros)

    def __getstate__(self) -> dict[str, Any]:
        """The attributes, with the record in place of a program's results."""
        return vars(self) | {"last": self.now}

    # --- step -------------------------------------------------------------------------------------

    def step(self, action: np.ndarray, ended: np.ndarray | None = None) -> State:
        """Advance every environment by one step, and return the new record, which is ``now``.

        Args:
            action: ``(B, a)`` finite; clipped to [-1, 1].
            ended: Mask ``(B,)`` of environments whose episode has ended and that are reset next:
                their actions are not checked.

        Raises:
            ValueError: if the action has the wrong shape or is not finite.
            gymnasium.error.ResetNeeded: before the first reset.
        """
        self.advance(action, self.action_shape, ended, info=False)
        return self.now

    def advance(
        self, action: np.ndarray, shape: tuple[int, ...], ended: np.ndarray | None = None,
        info: bool = True,
    ) -> tuple[np.ndarray, ...] | None:  # fmt: skip
        """Advance as `step` does, for an action of another shape, without making the record.

        It returns the arrays of `info` that the program made, if asked for; None if the stages were
        run one by one.
        """
        if not self.seeds:
            raise ResetNeeded("call reset() before the first step()")
        action = checked_action(action, shape, ended)
        if self._together:
            own = action[0] if self.num_envs == 1 else action
            moment, made = self.config.whole_steps[info](self.last, own)
            if moment is not None:
                self.last = moment
                return made
        self.last = self._stages(action, ended)
        return None

    @property
    def now(self) -> State:
        """The record after the last step.

        Steps replace it and leave its arrays as they are, so that a record which is put back is
        stepped again with equal results.
        """
        if not isinstance(self.last, State):
            self.last = self.last.record()
        return self.last

    @now.setter
    def now(self, now: State) -> None:
        self.last = now

    def _stages(self, action: np.ndarray, ended: np.ndarray | None) -> State:
        """The record a step later, stage by stage."""
        config, last = self.config, self.now
        now = last.acted(action)
        config.world.step(now)
        config.delivery(now)
        for estimator in config.estimators:
            estimator.step(now)
        config.mission.step(now)
        for method, field in config.numpy_methods.items():
            if (values := getattr(now, field)) is not None:
                refuse_not_finite(method, values, now.steps, ended, last.state, now.belief.mean)
        return now

    # --- reset ------------------------------------------------------------------------------------

    def start(
        self,
        seed: int | Sequence[int] | np.ndarray | None = None,
        options: dict[str, Any] | None = None,
        rows: np.ndarray | None = None,
    ) -> State:
        """Start episodes in some rows: draw the true states and take the first measurements.

        Args:
            seed: A number s (environment i gets s + i) or one number for each environment, which
                restart the count of episodes; None to keep the seeds and go on with the next.
            options: Reset options of the task.
            rows: Indices of the environments; None for all. The others do not change.

        Returns:
            The record of these rows.

        Raises:
            ValueError: for a seed that is negative or not a whole number, a list of the wrong
                length, or an option or a value that the task does not accept; nothing has changed
                then.
            TypeError: for options that are no dictionary.
            gymnasium.error.ResetNeeded: if the first start leaves out an environment.
        """
        config, rows = self.config, np.arange(self.num_envs) if rows is None else rows
        seeds, episode = next_episodes(self.seeds, self.last.episode, seed, rows)
        keys = RandomKeys.seeded([seeds[i] for i in rows]).keys
        now, prior = self._drawn(keys, episode[rows], checked_options("options", options))
        config.world.begin(now)
        config.delivery.begin(now)
        config.delivery(now)
        for estimator in config.estimators:
            estimator.begin(now, filter_prior(prior, estimator.estimation.space))
        config.mission.begin(now)
        now = now.without_start()
        self.seeds = seeds
        self.last = now if len(rows) == self.num_envs else self.last.merged(rows, now)
        return now

    def restart(self, rows: np.ndarray, made: tuple[np.ndarray, ...] | None) -> None:
        """Start the next episodes in some rows, of which the arrays of ``info`` then tell.

        Args:
            rows: Indices of the environments.
            made: As for `info`.
        """
        now = self.start(rows=rows)
        if made is not None:
            info = self.info(made)
            for name, values in self.config.info.changes(now).items():
                info[name][rows] = values

    def _drawn(
        self, seeds: np.ndarray, episode: np.ndarray, options: dict[str, Any]
    ) -> tuple[State, Gaussian]:
        """The record with the random numbers and scenarios of new episodes, and the prior."""
        config, count, steps = self.config, len(episode), np.zeros(len(episode), int)
        vehicle, task, draws = config.world.vehicle, config.system.task, config.draws
        keys, *drawn = start_numbers(seeds, episode, words=draws.words, counts=draws.counts)
        numbers = dict(zip((*DRAWN, "slow"), drawn, strict=True))
        scenario = task.scenario(numbers["task"], options)
        prior, parameters = task.prior(scenario), np.tile(vehicle.nominal_parameters, (count, 1))
        if mismatch := config.options.mismatch:
            parameters = vehicle.parameters(mismatch, numbers["parameters"])
        now = State(
            episode=episode, over=np.zeros(count, bool), steps=steps,
            keys=keys[:, len(DRAWN) : draws.world].copy(), sensing=keys[:, draws.world :].copy(),
            filtering=keys[:, DRAWN.index("filter")].copy(),
            scenario=scenario, parameters=parameters, prior_mean=prior.mean,
            prior_root=shared_root(prior.cov)[None].repeat(count, 0),
            prior_normals=numbers["vehicle"], slow_normals=numbers["slow"],
            constant_uniforms=numbers["field"], episode_constants=numbers["field"],
            noise_before=np.zeros((count, len(config.world.root))),
            exogenous_before=np.zeros((count, len(config.world.space.channels))),
            action=np.zeros((count, config.action_size)),
            reward=np.zeros(count), total=np.zeros(count), end=np.zeros(count, int),
        )  # fmt: skip
        reference = task.reference(scenario, steps, prior.mean)
        return now.but(**config.mission.asked(now, steps, reference)), prior

    # --- what is seen -----------------------------------------------------------------------------

    def observe(self) -> np.ndarray:
        """Observations ``(B, k)``: float32, clipped to the task's bound."""
        observation = self.last.observation
        if observation is None:
            now, task = self.now, self.config.system.task
            observation = self.config.mission.observation(now, now.reference)
            if not is_compiled(task):
                name = f"the observation of {type(task).__name__}"
                refuse_not_finite(name, observation, now.steps, None, now.belief.mean, now.state)
        return observation.astype(np.float32, "C")

    # --- what is scored ---------------------------------------------------------------------------

    @property
    def score(self) -> np.ndarray:
        """Scores ``(B,)`` in [0, 1]: sums of rewards over that of a perfect episode."""
        return self.config.scores(self.last.total, self.last.steps)

    @property
    def truth(self) -> np.ndarray:
        """True states ``(B, n)`` of vehicle, disturbance (if filters assume one) and biases.

        Raises:
            gymnasium.error.ResetNeeded: before the first reset.
        """
        if not self.seeds:
            raise ResetNeeded("call reset() before asking for the truth")
        return self.config.true_state.values(self.now)

    def info(self, made: tuple[np.ndarray, ...] | None = None) -> dict[str, np.ndarray]:
        """The last step's record in arrays of the caller's, one row for each environment.

        Args:
            made: What `advance` has just returned, whose arrays nobody else has.
        """
        if made is not None:
            arrays = made if self.num_envs > 1 else [each[None] for each in made]
            return dict(zip(INFO, arrays, strict=True))
        config, now = self.config, self.now
        info = config.info.changes(now)
        if now.faults is not None:
            info["sensor_faults"] = config.delivery.active(now)
        return info
