"""The batched core of single and vector environments: one step of many environments at once."""

from collections.abc import Sequence
from operator import attrgetter
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded

from estimators import Belief, Gaussian, RandomKeys
from estimators.checks import short_repr
from estimators.linalg import shared_root
from vessel_gym.checks import checked_action, is_integer
from vessel_gym.checks import options as checked_options
from vessel_gym.configuration import Configuration, Options
from vessel_gym.delivery import Measurements, injected
from vessel_gym.foreign import refuse_not_finite
from vessel_gym.loop import Loop
from vessel_gym.mission import estimate_of, standard_deviations
from vessel_gym.start import DRAWN, draw, known, seeds_of
from vessel_gym.state import EnvState, blank
from vessel_gym.system import System
from vessel_gym.tasks.task import Estimate


def _of(path: str) -> Any:
    """Read-only property that returns an attribute of a part by its dotted path."""
    return property(attrgetter(path))


class Core:
    """``B`` environments of one system: truth, disturbance, sensors, estimator, task.

    One step::

        action -> actuators -> vehicle -> sensors -> estimator -> task.observe -> observation
                 disturbance ----'  |                                 ^
                                    '-> task.score -> reward      reference

    The reference is evaluated at the estimated state. With ``observe="measurement"`` no estimate
    enters an episode: the reference is evaluated at the true state, and only the score and `info`
    use it.

    Args:
        system: The environment as data.
        num_envs: B.
        arguments: Fields of `vessel_gym.configuration.Options`, in order.
        named: Fields of `vessel_gym.configuration.Options`, by name.

    Attributes:
        config: System and options, which no step changes.
        now: Truth and score after the last step.
        loop: Sensors, estimator and belief.
        raw: Estimator ``"measurement"`` for guidance from raw measurements; None without such
            guidance.
        seeds: One seed for each environment; empty before the first reset.
        episodes: Number ``(B,)`` of the episode since the environment was seeded.

    Raises:
        ValueError: as `vessel_gym.configuration.Options`.
        TypeError: as `vessel_gym.configuration.Options`.
    """

    system, vehicle, task = map(
        _of, ("config.system", "config.system.vehicle", "config.system.task")
    )
    sensors, forces, composition = map(
        _of, ("config.sensors", "config.world.forces", "config.composition")
    )
    truth_names, unknown_inputs = map(_of, ("config.true_state.names", "config.estimation.inputs"))
    observe_mode, action_size, observation_size = (
        _of(f"config.{name}") for name in ("observe_mode", "action_size", "observation_size")
    )
    filter, estimator, measurements = map(
        _of, ("loop.filter", "loop.filter.name", "loop.measurements")
    )
    state, action, actuators, parameters = (
        _of(f"now.{name}") for name in ("state", "action", "actuators", "parameters")
    )
    drifting, noise, exogenous, scenario = (
        _of(f"now.{name}") for name in ("drifting", "noise", "exogenous", "scenario")
    )
    reference, steps, total, end = (
        _of(f"now.{name}") for name in ("reference", "steps", "total", "end")
    )

    def __init__(self, system: System, num_envs: int = 1, *arguments: Any, **named: Any) -> None:
        if not is_integer(num_envs) or num_envs < 1:
            raise ValueError(
                f"num_envs must be a positive whole number, got {short_repr(num_envs)}"
            )
        self.num_envs = int(num_envs)
        self.config = config = Configuration(system, Options(*arguments, **named))
        self.loop = Loop(config, self.num_envs)
        self.raw = None if config.raw is None else Loop(config, self.num_envs, "raw")
        self.action_shape = self.num_envs, config.action_size
        self._rows, self._no_input = np.arange(num_envs), np.zeros((num_envs, 0))
        self.seeds: list[int] = []
        self.episodes = np.zeros(num_envs, int)
        self.now = blank(self.num_envs)

    @property
    def belief(self) -> Belief:
        """Belief of the estimator, read-only."""
        return self.loop.belief.read_only()

    @property
    def unknown_input(self) -> np.ndarray:
        """True unknown input ``(B, q)``; NaN in components that only the filter's model has."""
        return self.config.unknown_input.values(self.now)

    @property
    def truth(self) -> np.ndarray:
        """True states ``(B, n)`` of vehicle, disturbance (if filters assume one) and biases."""
        return self.config.true_state.values(self.now, self.config.world.size)

    @property
    def score(self) -> np.ndarray:
        """Scores ``(B,)`` in [0, 1]: sums of rewards over that of a perfect episode."""
        perfect, each = self.config.perfect
        return np.clip(self.now.total / np.maximum(perfect, each * self.now.steps), 0.0, 1.0)

    def score_of(self, row: int) -> float:
        """Score of one environment, ten times as fast as `score`."""
        perfect, each = self.config.perfect
        score: float = self.now.total.item(row) / max(perfect, each * self.now.steps.item(row))
        return score if 0.0 <= score <= 1.0 else min(max(score, 0.0), 1.0)

    @property
    def sea_state(self) -> np.ndarray:
        """State of the disturbance ``(B, k)``."""
        return self.now.drifting[:, : self.config.world.size]

    @property
    def bias(self) -> np.ndarray:
        """States of the sensors' biases ``(B, b)``."""
        return self.now.drifting[:, self.config.world.size :]

    def estimated(self, truth: np.ndarray) -> np.ndarray:
        """True states ``(..., n)`` in the order of the filter's; NaN where the truth has none."""
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
        """Start an episode in some environments: `seed`, then `reset`; neither if one fails.

        Raises:
            gymnasium.error.ResetNeeded: if the first reset leaves out an environment.
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

    def seed(
        self, seed: int | Sequence[int] | np.ndarray | None, rows: np.ndarray | None = None
    ) -> None:
        """Set seeds and restart the count of episodes.

        Args:
            seed: A number s (environment i gets s + i), one number for each environment, or None to
                keep the seeds and go on with the next episode.
            rows: Indices of the environments to seed, None for all; the others keep their seeds.

        Raises:
            ValueError: for a seed that is negative or not a whole number, or a list of the wrong
                length.
        """
        rows = self._rows if rows is None else rows
        if seed is None and self.seeds:
            self.episodes[rows] += 1
            return
        seeds = seeds_of(seed, self.num_envs, rows.tolist())
        chosen = set(rows.tolist())
        self.seeds = [seeds[i] if i in chosen else self.seeds[i] for i in range(self.num_envs)]
        self.episodes[rows] = 0

    def reset(
        self,
        rows: np.ndarray | None = None,
        options: dict[str, Any] | None = None,
        measurements: Measurements | None = None,
    ) -> None:
        """Start new episodes in some rows: draw the true states and take the first measurements.

        Args:
            rows: Indices of the environments; None for all.
            options: Reset options of the task.
            measurements: Measurements and mask ``(len(rows), p)`` to use instead of the sensors'
                (for replays). With late sensors, measurements by age ``(len(rows), ages, p)``, as
                ``loop.delivered`` holds them, serve too.

        Raises:
            ValueError: for an option or a value that the task does not accept, or measurements of
                the wrong shape.
            TypeError: for options that are no dictionary, or measurements that are no pair of
                arrays.
        """
        rows = self._rows if rows is None else rows
        options = checked_options("options", options)
        if measurements is not None:
            measurements = injected(measurements, len(rows), self.sensors)
        config, loop = self.config, self.loop
        task, draws = config.world.task, config.draws
        some = None if len(rows) == self.num_envs else rows  # None is faster than an index of all
        at = slice(None) if some is None else rows
        seeds = self.seeds if some is None else [self.seeds[row] for row in rows]
        episodes = np.ascontiguousarray(self.episodes[at])
        keys, numbers = draw(
            RandomKeys.seeded(seeds).keys, episodes, names=draws.words, drawn=draws.counts
        )
        self._refuse_at(np.zeros(len(rows), int), None)
        scenario = task.scenario(numbers[:, : task.uniforms], options)
        prior = task.prior(scenario)
        loop.restart(at, keys[:, draws.world :], keys[:, DRAWN.index("filter")])
        now, u, sampled = self._initial(scenario, prior, keys, numbers)
        measurements = loop.receive(
            measurements or sampled, now.steps, some, measurements is not None
        )
        belief = loop.begin(
            some, known(prior, config.composition), self._passed(measurements, now), u
        )
        if self.raw is not None:
            self.raw.begin(some, known(prior, self.raw.composition), measurements, u)
        now.reference, *seen = config.mission.begin(
            scenario, now.steps, belief.mean, self._d(belief), now.state, now.actuators
        )
        now.observation = seen[0] if seen else None
        self.now = now = now if some is None else self.now.merged(some, now)
        self._refuse_at(now.steps, None)

    def _initial(
        self, scenario: np.ndarray, prior: Gaussian, keys: np.ndarray, numbers: np.ndarray
    ) -> tuple[EnvState, np.ndarray, Measurements]:
        """State at the start of episodes, known input and measurements, from random numbers."""
        config, rows = self.config, len(keys)
        steps, root = np.zeros(rows, int), shared_root(prior.cov)
        actuators, u, state, drifting, noise, exogenous, drawn, y, available, score_state = (
            config.world.begin(scenario, prior.mean, root, numbers, keys[:, len(DRAWN) :], steps)
        )
        if mismatch := config.options.mismatch:
            spread = numbers[:, config.draws.parameters]
            parameters = config.world.vehicle.parameters(mismatch, spread)
        else:
            parameters = config.nominal.repeat(rows, 0)
        moving = np.ascontiguousarray(keys[:, len(DRAWN) : config.draws.world])
        now = EnvState(
            moving, steps, scenario, parameters, state, np.zeros((rows, config.action_size)),
            actuators, drifting, noise, exogenous, np.zeros_like(noise), np.zeros_like(exogenous),
            drawn, scenario, score_state, np.zeros(rows), steps.copy(),
        )  # fmt: skip
        return now, u, (y, available)

    # --- step -------------------------------------------------------------------------------------

    def step(
        self, action: np.ndarray, measurements: Measurements | None = None,
        ended: np.ndarray | None = None, shape: tuple[int, ...] | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """Advance every environment by one step.

        Args:
            action: ``(B, a)`` finite; clipped to [-1, 1].
            measurements: Measurements to use instead of the sensors' (for replays); all other
                random numbers stay the same.
            ended: Mask ``(B,)`` of environments whose episode has ended and that are reset next:
                their actions are not checked.
            shape: Shape that the action must have; None for ``(B, a)``.

        Returns:
            Reward ``(B,)`` and number of the end reason ``(B,)``, which is 0 where an episode goes
            on.

        Raises:
            ValueError: if the action or the measurements have the wrong shape, or the action is not
                finite.
            TypeError: if the measurements are no pair of arrays.
            gymnasium.error.ResetNeeded: before the first reset.
        """
        if not self.seeds:
            raise ResetNeeded("call reset() before the first step()")
        action = checked_action(action, self.action_shape if shape is None else shape, ended)
        if measurements is not None:
            measurements = injected(measurements, self.num_envs, self.sensors)
        loop, now = self.loop, self.now.after(action)
        self._refuse_at(now.steps, ended)
        now.actuators, u, now.state, now.drifting, now.noise, now.exogenous, *read = self._moved(
            now
        )
        measurements = loop.receive(
            measurements or (read[0], read[1]), now.steps, None, measurements is not None
        )
        loop.estimate(self._passed(measurements, now), u, now.steps)
        if self.raw is not None:
            self.raw.estimate(measurements, u, now.steps)
        now.reference, reward, now.end, now.score_state, *seen = self._scored(now)
        now.total, now.observation = now.total + reward, seen[0] if seen else None
        self.now = now
        return reward, now.end

    def _moved(self, now: EnvState) -> Sequence[np.ndarray]:
        """Result of `vessel_gym.world.World.step`."""
        moved: Sequence[np.ndarray] = self.config.world.step(
            now.action, now.scenario, now.reference, now.state, now.actuators, now.exogenous,
            now.parameters, now.keys, now.steps, now.drifting, now.noise, now.drawn,
            self.loop.sensing,
        )  # fmt: skip
        return moved

    def _scored(self, now: EnvState) -> Sequence[np.ndarray]:
        """Result of `vessel_gym.mission.Mission.step`."""
        belief = self.loop.belief
        # compiled code needs contiguous arrays
        estimates = map(np.ascontiguousarray, (belief.mean, self._d(belief)))
        exogenous, forces = now.exogenous, self.config.world.forces
        if forces.faulty:
            exogenous = np.ascontiguousarray(exogenous[:, : forces.outside])
        scored: Sequence[np.ndarray] = self.config.mission.step(
            now.scenario, now.steps, *estimates, now.state, exogenous, now.actuators, now.action,
            now.score_state,
        )  # fmt: skip
        return scored

    def _d(self, belief: Belief) -> np.ndarray:
        """Estimated unknown input ``(B, q)``; q is 0 if the filter estimates none."""
        d = belief.input_mean
        return self._no_input[: len(belief.mean)] if d is None else d

    def observe(self) -> np.ndarray:
        """Observations ``(B, k)``: float32, clipped to the task's bound."""
        now, bound = self.now, self.task.BOUND
        observation = now.observation
        if observation is None:
            with np.errstate(over="ignore", invalid="ignore"):  # diverged estimates are clipped
                observation = np.clip(np.concatenate(self._observed(), -1), -bound, bound)
            if self.config.world.task is not self.task:
                name = f"the observation of {type(self.task).__name__}"
                refuse_not_finite(
                    name, observation, now.steps, None, self.loop.belief.mean, now.state
                )
        return observation.astype(np.float32, "C")

    def _observed(self) -> list[np.ndarray]:
        """Parts of the observations before clipping."""
        task, now = self.config.world.task, self.now
        scenario, steps, actuators = now.scenario, now.steps, now.actuators
        if self.observe_mode == "measurement":
            seen = task.observe_measurements(self.sensors, *self.loop.measurements, scenario, steps)
            parts = [seen, task.observe_mission(scenario, steps, actuators)]
            if self.raw is not None:
                estimate = self._estimate(self.raw)
                reference = task.reference(scenario, steps, estimate.state)
                parts.insert(0, task.observe(estimate, reference, actuators))
            return parts
        estimate = self._estimate(self.loop)
        if self.config.options.guidance:
            parts = [task.observe(estimate, self.reference, actuators)]
        else:
            parts = [
                task.observe_state(estimate, scenario),
                task.observe_mission(scenario, steps, actuators),
            ]
        if "std" in self.observe_mode:
            parts.append(task.observe_std(estimate))
        return parts

    def _estimate(self, loop: Loop) -> Estimate:
        """The part of a loop's belief that the task observes."""
        belief, composition = loop.belief, loop.composition
        estimate = estimate_of(composition, belief.mean, belief.input_mean)
        if "std" in self.observe_mode:
            estimate.sd, estimate.scale = standard_deviations(belief.cov), composition.scale
            if estimate.input_mean is not None and belief.input_cov is not None:
                estimate.input_sd = standard_deviations(belief.input_cov)
        return estimate

    def scored_truth(self) -> np.ndarray:
        """Copy of the true states ``(B, n)``.

        Raises:
            gymnasium.error.ResetNeeded: before the first reset.
        """
        if not self.seeds:
            raise ResetNeeded("call reset() before asking for the truth")
        truth = self.truth
        return truth.copy() if truth is self.now.state else truth

    def info(self, rows: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """Copies of the last step's record, one row for each environment.

        Args:
            rows: Mask ``(B,)`` of the rows to copy; other rows hold 0. None for all.
        """
        happened, own = self.happened() | {"healthy": self.loop.belief.healthy}, {
            "score": self.score,
            "end": self.end.copy(),
            "is_success": self.end == self.config.success,
        }  # fmt: skip
        if rows is None:
            return {name: values.copy() for name, values in happened.items()} | own
        return {name: _only(rows, values) for name, values in (happened | own).items()}

    def happened(self) -> dict[str, np.ndarray]:
        """Record of the last step, read-only, one row for each environment."""
        loop, now, unknown_input = self.loop, self.now, self.unknown_input
        belief, (measurement, available) = loop.belief, loop.measurements
        input_mean = belief.input_mean
        happened = {
            "truth": self.truth,
            "unknown_input": unknown_input,
            "reference": now.reference,
            "actuators": now.actuators,
            "measurement": measurement,
            "available": available,
            "estimate": belief.mean,
            "covariance": belief.cov,
            "input_estimate": np.zeros(unknown_input.shape) if input_mean is None else input_mean,
            "parameters": now.parameters,
        }
        return happened | loop.extra_info(now.steps)

    # --- inside -----------------------------------------------------------------------------------

    def _refuse_at(self, steps: np.ndarray, ended: np.ndarray | None) -> None:
        """Pass step numbers and ended rows to the user's parts, for their error messages."""
        for part in self.config.world.own_parts:
            part.steps, part.ended = steps, ended

    def _passed(self, measurements: Measurements, now: EnvState) -> Measurements:
        """The filter's measurements; for the oracle alone, the truth."""
        if not self.loop.tells_truth:
            return measurements
        config = self.config
        truth = (
            self.estimated(config.true_state.values(now, config.world.size)),
            config.unknown_input.values(now),
        )
        values = np.concatenate(truth, -1)
        return values, np.ones(values.shape, bool)


def _only(rows: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Copy of the values of some rows, with 0 in the others."""
    only = np.zeros(values.shape, values.dtype)
    only[rows] = values[rows]
    return only
