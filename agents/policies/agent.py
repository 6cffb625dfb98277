"""Flight of a trained policy: its frames, its recurrent state, and the environment that it fits."""

from pathlib import Path
from typing import Any

import numpy as np

from agents.policies.checkpoint import load, same_vehicle, vehicle_of


class TrainedAgent:
    """A trained policy without exploration noise, with a memory for each environment of the batch.

    Args:
        path: A checkpoint.
        env: The environment that it will fly, to check the observation.

    Raises:
        ValueError: if the file is no policy of `agents.save_agent`, or was trained on another
            observation, other actions or another vehicle.
    """

    def __init__(self, path: Path, env: Any) -> None:
        observations, actions = (
            getattr(env, f"single_{name}", getattr(env, name))
            for name in ("observation_space", "action_space")
        )
        policy, self._network = load(path, actions)
        core, size = getattr(env.unwrapped, "core", None), int(np.prod(observations.shape))
        observe = None if core is None else core.config.options.observe
        here = "is none of vessel_gym" if core is None else f"gives {observe!r}"
        # Two kinds of observation may have the same length.
        if policy.observe not in (None, observe):
            raise ValueError(
                f"{path} was trained on observe={policy.observe!r}, this environment {here}"
            )
        shapes = policy.observations, policy.actions
        wanted = [policy.frames * size], list(actions.shape)
        if shapes != wanted:
            raise ValueError(
                f"{path} was trained in another environment: on observations of shape {shapes[0]}"
                f" and actions of shape {shapes[1]}, not {wanted[0]} and {wanted[1]}"
            )
        vehicle, where = {}, "this environment"
        if core is not None:
            vehicle, where = vehicle_of(core.config.system.vehicle), core.config.system.name
        if policy.vehicle and not same_vehicle(policy.vehicle, vehicle):
            raise ValueError(
                f"{path} was trained on another vehicle, that of {policy.environment}: fly it"
                f" there, or train an agent in {where}"
            )
        self._policy, self._size = policy, size
        self.reset(1)

    def reset(self, num_envs: int) -> None:
        """Forget everything: the frames before the first and the recurrent state are zeros."""
        self._frames = np.zeros((num_envs, self._policy.frames * self._size), np.float32)
        self._state = None

    def act(self, observations: np.ndarray) -> np.ndarray:
        """The policy's mean action.

        Raises:
            ValueError: for another number of rows than that of `reset`, or other observations.
        """
        wanted = len(self._frames), self._size
        if np.shape(observations) != wanted:
            raise ValueError(
                f"observations must have shape {wanted}, as many rows as reset(num_envs) was told,"
                f" got {np.shape(observations)}"
            )
        newest = observations
        if self._policy.mean:
            deviation = (newest - self._policy.mean) / np.sqrt(self._policy.variance)
            newest = np.clip(deviation, -self._policy.clip, self._policy.clip)
        self._frames = np.concatenate(
            [self._frames[:, self._size :], newest], axis=1, dtype=np.float32
        )
        actions, self._state = self._network(self._frames, self._state)
        return actions
