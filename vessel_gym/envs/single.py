"""Single environments: a `gymnasium.Env` on a batch of one."""

from collections.abc import Mapping
from dataclasses import fields
from inspect import getfullargspec
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils import seeding

from estimators.checks import short_repr
from estimators.factory import unknown
from vessel_gym.checks import checked_action, is_integer, one_of
from vessel_gym.simulation.configuration import Options
from vessel_gym.simulation.core import Core
from vessel_gym.simulation.state import State
from vessel_gym.simulation.truth import INFO, SCORED
from vessel_gym.system import System


class VesselEnv(gym.Env[np.ndarray, np.ndarray]):
    """An environment with an estimator in the loop, whose agent observes estimates.

    With sensor faults, ``info["sensor_faults"]`` is the mask of the active ones.

    Args:
        render_mode: ``None``, ``"human"`` or ``"rgb_array"``.
        options: Fields of `vessel_gym.simulation.configuration.Options`, by name.

    Raises:
        ValueError: for an invalid value, an unknown name (of an estimator, sensor suite,
            disturbance or mode), or a filter that cannot work with the model.
        TypeError: for an unknown argument, an option that the estimator does not have, or sensors
            or faults of another class.
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 20}
    system: ClassVar[System]
    _generator: Any = None  # a generator, or a seed before first use

    def __init__(self, render_mode: str | None = None, **options: Any) -> None:
        check_arguments(self, options, render_mode)
        self.core = Core(self.system, **options)
        self.observation_space = observation_space(self.core)
        self.action_space = action_space(self.core)
        self._shape = self.action_space.shape
        self.render_mode = render_mode
        self._renderer: Any = None

    @property
    def _np_random(self) -> Any:
        """Generator of Gymnasium, made at first use because seeding takes a fifth of a reset."""
        if isinstance(self._generator, int):
            self._generator, _ = seeding.np_random(self._generator)
        return self._generator

    @_np_random.setter
    def _np_random(self, generator: Any) -> None:
        self._generator = generator

    @property
    def truth(self) -> np.ndarray:
        """Copy of the true state, for scoring only; names: ``core.config.true_state.names``."""
        return self.core.truth[0].copy()

    @property
    def end_reasons(self) -> tuple[str, ...]:
        """Reasons for an episode's end, by the number in ``info["end"]``; the first is empty."""
        return self.system.task.end_reasons

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode, see `gymnasium.Env.reset`; ``options`` are the task's."""
        if seed is not None and not is_integer(seed):
            raise ValueError(f"seed must be a whole number or None, got {short_repr(seed)}")
        self.core.start(first_seed(self, self.core) if seed is None else seed, options)
        if seed is not None:
            self._np_random, self._np_random_seed = int(seed), int(seed)
        if self.render_mode is not None:
            self._record(begin=True)
        return self.core.observe()[0], self._info()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Advance by one step, see `gymnasium.Env.step`; `gymnasium.wrappers.TimeLimit` truncates.

        After its end an episode does not change, with reward 0, until the next reset.
        """
        core = self.core
        if core.last.end_of(0):
            checked_action(action, self._shape)
            return core.observe()[0], 0.0, True, False, self._info()
        made = core.advance(action, self._shape)
        last = core.last
        if made is None or isinstance(last, State):
            observation, reward, info = core.observe()[0], core.now.reward.item(0), self._info()
        else:
            seen, reward = last.seen()
            observation = seen.astype(np.float32)
            info = _with_numbers(dict(zip(INFO, made, strict=True)))
        if self.render_mode is not None:
            self._record()
        return observation, reward, info["end"] > 0, False, info

    def render(self) -> np.ndarray | None:
        """Image ``(height, width, 3)`` of the episode; in mode ``"human"``, update the window."""
        if self.render_mode is None:
            gym.logger.warn("render() was called without a render_mode: give one to gym.make")
            return None
        return self._renderer.draw() if self._renderer is not None else None

    def close(self) -> None:
        """Close the window, if one is open."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _info(self) -> dict[str, Any]:
        return _with_numbers({name: each[0] for name, each in self.core.info().items()})

    def _record(self, begin: bool = False) -> None:
        if self._renderer is None:
            from vessel_gym.rendering.renderer import Renderer

            assert self.render_mode is not None
            self._renderer = Renderer(self.core, self.render_mode, self.metadata["render_fps"])
        self._renderer.record(begin)
        if self.render_mode == "human":
            self._renderer.draw()


def _with_numbers(info: dict[str, Any]) -> dict[str, Any]:
    """``info`` with Python's numbers in place of arrays of one number."""
    for name in SCORED:
        info[name] = info[name].item()
    return info


def observation_space(core: Core) -> Box:
    """Finite float32 bounds of scaled, clipped observations."""
    bound = core.config.system.task.BOUND
    return Box(-bound, bound, (core.config.observation_size,), np.float32)


def action_space(core: Core) -> Box:
    """float32 in [-1, 1]: shares of the actuators' ranges."""
    return Box(-1.0, 1.0, (core.config.action_size,), np.float32)


def check_arguments(env: Any, options: Mapping[str, Any], render_mode: str | None) -> None:
    """Refuse unknown arguments of an environment.

    Raises:
        TypeError: naming the first unknown option and the known ones.
        ValueError: for an unknown render mode.
    """
    known = [field.name for field in fields(Options)]
    for option in options:
        if option not in known:
            own: dict[str, None] = {}
            for base in type(env).__mro__:
                spec = getfullargspec(base.__init__)  # type: ignore[misc]
                own |= dict.fromkeys(spec.args[1:] + spec.kwonlyargs)
            # Python's words, which other libraries look for
            python = f"{type(env).__name__}.__init__() got an unexpected"
            raise TypeError(unknown("keyword argument", option, [*own, *known], python))
    if render_mode is not None:
        one_of("render_mode", render_mode, env.metadata["render_modes"])


def first_seed(env: gym.Env | gym.vector.VectorEnv, core: Core) -> int | None:
    """Seed of ``np_random_seed`` for a first episode without a seed; None for later episodes."""
    if core.seeds:
        return None
    seed = env.np_random_seed
    return None if seed == -1 else seed  # -1: np_random was set from outside
