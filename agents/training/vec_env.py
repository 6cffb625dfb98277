"""The adapter from Gymnasium's vector environments to stable-baselines3's."""

from typing import Any

import gymnasium as gym
import numpy as np

from vessel_gym.envs.vector import VesselVectorEnv
from vessel_gym.extras import require

require("stable_baselines3")

from stable_baselines3.common.monitor import Monitor  # noqa: E402
from stable_baselines3.common.vec_env import VecEnv  # noqa: E402


class StableBaselinesVecEnv(VecEnv):
    """A `gymnasium.vector.VectorEnv` as a ``VecEnv`` of stable-baselines3.

    The info of a finished environment has its last observation in ``terminal_observation``, and the
    return and length of the episode in ``episode``, so no Monitor wrapper is needed.
    ``TimeLimit.truncated`` is True if the time limit ended the episode. ``score`` and
    ``is_success`` are there if the environment has them; stable-baselines3's ``EvalCallback``
    reports ``is_success``.

    Args:
        env: The vector environment, with ``SAME_STEP`` autoreset. A `VesselVectorEnv` may have any
            autoreset mode: the adapter resets the environments whose episodes have ended.
        reward_scale: Factor on the rewards for the learner; the return in ``episode`` is without
            it.

    Raises:
        ValueError: if ``env`` is wrapped or of another class than `VesselVectorEnv`, and its
            autoreset mode is not ``SAME_STEP``.
    """

    def __init__(self, env: gym.vector.VectorEnv, reward_scale: float = 1.0) -> None:
        mode = env.metadata.get("autoreset_mode")
        self._resets = mode != gym.vector.AutoresetMode.SAME_STEP
        if self._resets and not isinstance(env, VesselVectorEnv):
            raise ValueError(
                f"the adapter needs an environment with SAME_STEP autoreset, this one has {mode}"
            )
        self.env, self.reward_scale = env, reward_scale
        self._actions: np.ndarray
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self.metadata |= {"render_fps": env.metadata.get("render_fps", 30)}
        self._returns = np.zeros(env.num_envs)
        self._lengths = np.zeros(env.num_envs, int)

    def reset(self) -> np.ndarray:
        """First observations ``(B, k)``; after ``seed(s)``, environment i has the seed ``s + i``.

        Raises:
            ValueError: if `set_options` received different options for the environments.
        """
        if len({repr(each) for each in self._options}) > 1:
            raise ValueError("the environments of a batch share their reset options: give one")
        observations, _ = self.env.reset(seed=self._seeds[0], options=self._options[0] or None)
        self._reset_seeds()
        self._reset_options()
        self._returns[:], self._lengths[:] = 0.0, 0
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Observations, rewards, dones, and an info for each environment."""
        observations, rewards, terminated, truncated, info = self.env.step(self._actions)
        self._returns += rewards
        self._lengths += 1
        dones = terminated | truncated
        if dones.any() and self._resets:
            info = {"final_obs": observations, "final_info": info}
            observations = self.env.reset(options={"reset_mask": dones})[0]
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(dones):
            final = info["final_info"]
            infos[i] = {
                "terminal_observation": info["final_obs"][i],
                "TimeLimit.truncated": bool(truncated[i] and not terminated[i]),
                "episode": {"r": float(self._returns[i]), "l": int(self._lengths[i])},
                **{key: final[key][i].item() for key in ("score", "is_success") if key in final},
            }
        self._returns[dones], self._lengths[dones] = 0.0, 0
        return observations, self.reward_scale * rewards.astype(np.float32), dones, infos

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The attribute of the batch, for each environment."""
        return [getattr(self.env, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Not supported: the environments of a batch share their attributes."""
        raise NotImplementedError(f"environments of a batch share: set env.env.{attr_name}")

    def env_method(
        self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any
    ) -> list[Any]:
        """Not supported: the environments of a batch have no methods of their own."""
        raise NotImplementedError(f"environments of a batch share: call env.env.{method_name}")

    def env_is_wrapped(self, wrapper_class: type[gym.Wrapper], indices: Any = None) -> list[bool]:
        """True for a Monitor, whose work the adapter does itself, False for any other wrapper."""
        return [issubclass(wrapper_class, Monitor) for _ in self._get_indices(indices)]

    def get_images(self) -> list[Any]:
        """An image of each environment, where the render mode is ``"rgb_array"``."""
        return list(self.env.render() or [None] * self.num_envs)
