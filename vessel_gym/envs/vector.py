"""Vector environments: a native `gymnasium.vector.VectorEnv` on the batched core."""

import sys
from collections.abc import Sequence
from functools import cache
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from estimators.checks import integer
from vessel_gym.checks import one_of
from vessel_gym.envs.single import action_space, check_arguments, first_seed, observation_space
from vessel_gym.simulation.core import Core
from vessel_gym.system import System


class VesselVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Many environments in one batch.

    Environment i of a batch with seed s repeats the single environment with seed s + i. After the
    end of an episode, ``autoreset_mode`` decides what follows; the episodes are equal in all modes:

    - ``"NextStep"`` (Gymnasium's default): the next `step` ignores the environment's action and
      returns the first observation of the next episode, with reward 0.
    - ``"SameStep"``: `step` returns the first observation of the next episode.
      ``info["final_obs"]`` and ``info["final_info"]`` belong to the ended episode.
    - ``"Disabled"``: `step` raises an error until ``reset(options={"reset_mask": ended})`` has
      started new episodes.

    In every mode ``reset(options={"reset_mask": mask})``, with a boolean array ``(num_envs,)``,
    starts new episodes in these environments and does not change the others.

    Args:
        num_envs: Number of environments.
        max_episode_steps: Steps after which an episode is truncated; None: never.
            `gymnasium.make_vec` passes the registered value.
        autoreset_mode: A `gymnasium.vector.AutoresetMode` or its value.
        render_mode: ``None`` or ``"rgb_array"``.
        options: Fields of `vessel_gym.simulation.configuration.Options`, by name.

    Raises:
        ValueError: as `VesselEnv`, and for a ``num_envs`` that is not a positive whole number or an
            unknown mode.
    """

    metadata = {
        "autoreset_mode": AutoresetMode.NEXT_STEP,
        "render_modes": ["rgb_array"],
        "render_fps": 20,
    }
    system: ClassVar[System]

    def __init__(
        self,
        num_envs: int = 1,
        max_episode_steps: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        check_arguments(self, options, render_mode)
        if max_episode_steps is not None:
            integer("max_episode_steps", max_episode_steps, 1)
        mode = getattr(autoreset_mode, "value", autoreset_mode)
        modes = [each.value for each in AutoresetMode]
        self.autoreset_mode = AutoresetMode(one_of("autoreset_mode", mode, modes))
        self.metadata = self.metadata | {"autoreset_mode": self.autoreset_mode}
        self.core = Core(self.system, num_envs, **options)
        self.num_envs = num_envs
        self.max_episode_steps = max_episode_steps
        self.render_mode = render_mode
        self.single_observation_space = observation_space(self.core)
        self.single_action_space = action_space(self.core)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._every = np.ones(num_envs, bool)
        self._renderers: list[Any] = []

    @property
    def truth(self) -> np.ndarray:
        """Copy of the true states ``(num_envs, n)``, for scoring only."""
        return self.core.truth.copy()

    @property
    def end_reasons(self) -> tuple[str, ...]:
        """Reasons for an episode's end, by the number in ``info["end"]``; the first is empty."""
        return self.system.task.end_reasons

    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode in every environment, or in those of ``options["reset_mask"]``.

        Args:
            seed: A number s (environment i gets s + i), one number for each environment, or None to
                go on with the next episode. ``np_random_seed`` is the first one.
            options: Reset options of the task, and ``reset_mask``, a boolean array ``(num_envs,)``.

        Returns:
            Observations of all environments, and info of those that were reset.

        Raises:
            ValueError: for wrong seeds or options; no environment has changed then.
            TypeError: for a mask that is not a boolean array.
            gymnasium.error.ResetNeeded: if the first reset leaves out an environment.
        """
        core, mask = self.core, np.ones(self.num_envs, bool)
        if isinstance(options, dict) and "reset_mask" in options:
            options = dict(options)  # a copy, because the caller's must not change
            mask = self._checked_mask(options.pop("reset_mask"))
        core.start(first_seed(self, core) if seed is None else seed, options, np.flatnonzero(mask))
        if seed is not None:
            super().reset(seed=core.seeds[0])
        self._record(mask, np.zeros_like(mask))
        return core.observe(), self._masked(core.info(), mask)

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advance every environment by one step; ``autoreset_mode`` decides what follows an end.

        Raises:
            ValueError: if the actions have the wrong shape or are not finite; no environment has
                changed then.
            gymnasium.error.ResetNeeded: before the first reset; in mode ``"Disabled"`` also where
                an episode has ended.
        """
        core, restarted, final = self.core, self.core.last.over, {}
        if restarting := np.count_nonzero(restarted):  # faster than any()
            made = self._step_and_restart(actions, restarted)
        else:
            made = core.advance(actions, core.action_shape)
        reward, terminated = core.last.reward.copy(), core.last.end.astype(bool)  # 0 at a start
        truncated = core.last.steps >= (self.max_episode_steps or sys.maxsize)
        done = terminated | truncated
        if restarting or np.count_nonzero(done):
            if self.autoreset_mode is not AutoresetMode.SAME_STEP:
                core.last = core.last.but(over=done)
            else:
                final, restarted = self._final(done, made), done
                core.restart(np.flatnonzero(done), made)
        self._record(restarted, ~restarted)
        info = self._masked(core.info(made))
        return core.observe(), reward, terminated, truncated, info | final

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Image ``(height, width, 3)`` of each environment's episode so far."""
        if self.render_mode is None:
            gym.logger.warn("render() was called without a render_mode: give one to gym.make_vec")
            return None
        return tuple(renderer.draw() for renderer in self._renderers) or None

    def close_extras(self, **kwargs: Any) -> None:
        """Drop the renderers."""
        self._renderers = []

    def _step_and_restart(self, actions: np.ndarray, ended: np.ndarray) -> Any:
        """Step running environments, and start new episodes where the last step ended one."""
        if self.autoreset_mode is AutoresetMode.DISABLED:
            raise ResetNeeded(
                f"{ended.sum()} of {self.num_envs} episodes have ended: call"
                " reset(options={'reset_mask': terminated | truncated}) before the next step()"
            )
        core = self.core
        with np.errstate(all="ignore"):  # states of ended vehicles are not used
            made = core.advance(actions, core.action_shape, ended)
        core.restart(np.flatnonzero(ended), made)
        return made

    def _final(self, done: np.ndarray, made: Any) -> dict[str, Any]:
        """Last observations and infos of ended episodes."""
        observation = self.core.observe()
        final_observations = np.full(self.num_envs, None, dtype=object)
        for row in np.flatnonzero(done):
            final_observations[row] = observation[row]
        info = {name: values.copy() for name, values in self.core.info(made).items()}
        final_info = self._masked(info, done)
        return {
            "final_obs": final_observations, "_final_obs": done.copy(),
            "final_info": final_info, "_final_info": done.copy(),
        }  # fmt: skip

    def _checked_mask(self, mask: Any) -> np.ndarray:
        """The ``reset_mask`` of `reset`, checked."""
        if not isinstance(mask, np.ndarray) or mask.dtype != bool:
            raise TypeError(f"reset_mask must be a boolean array, got {mask!r}")
        if mask.shape != (self.num_envs,) or not mask.any():
            raise ValueError(
                f"reset_mask must have shape {(self.num_envs,)} and a True in it, got {mask!r}"
            )
        return mask

    def _record(self, reset_mask: np.ndarray, going: np.ndarray) -> None:
        """Record the state of some environments for images, and begin those that were reset."""
        if self.render_mode is None:
            return
        if not self._renderers:
            from vessel_gym.rendering.renderer import Renderer

            given = self.core, self.render_mode, self.metadata["render_fps"]
            self._renderers = [Renderer(*given, row) for row in range(self.num_envs)]
        for renderer, new, on in zip(self._renderers, reset_mask, going, strict=True):
            if new or on:
                renderer.record(begin=new)

    def _masked(
        self, info: dict[str, np.ndarray], rows: np.ndarray | None = None
    ) -> dict[str, Any]:
        """Info in Gymnasium's form: every array with a ``_key``, the mask of the rows that have it.

        Arrays are 0 in other rows. All keys have one mask, because an array for each takes longer.
        """
        mask = (self._every if rows is None else rows).copy()
        if rows is not None:
            for values in info.values():
                values[~rows] = 0
        return info | dict.fromkeys(_mask_names(*info), mask)


@cache
def _mask_names(*keys: str) -> list[str]:
    return [f"_{key}" for key in keys]
