"""Flight of a trained policy: its frames, its recurrent state, and the environment that it fits."""

from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from agents.policies.checkpoint import load, same_vehicle, vehicle_of
from agents.policies.network import Dense, one_thread


class TrainedAgent:
    """A trained policy, flown without exploration noise; it keeps a memory for each environment of the batch.

    Args:
        path: A checkpoint.
        env: The environment that it will fly, to check the observation.
        trust: See `agents.load_agent`.
        dense: See `load`.

    Raises:
        ValueError: if the file is no checkpoint that may be loaded, or was trained on another
            observation, other actions or another vehicle.
        ModuleNotFoundError: without torch or stable-baselines3, where it needs them.
    """

    def __init__(self, path: Path, env: Any, trust: bool = False, dense: bool = False) -> None:
        self._policy = load(path, trust, dense)
        core = getattr(env.unwrapped, "core", None)
        spaces = [
            getattr(env, f"single_{name}", getattr(env, name))
            for name in ("observation_space", "action_space")
        ]
        given = None if core is None else core.observe_mode
        wanted = spaces[1].shape if core is None else (core.action_size,)
        network, frames = self._policy.network, self._policy.frames
        self._size = int(np.prod(spaces[0].shape)) if core is None else core.observation_size
        # Two kinds of observation may have the same length: ask what it was trained on, not only
        # how long that is.
        trained = self._policy.observe
        if trained is not None and trained != given:
            here = "is none of vessel_gym" if given is None else f"gives {given!r}"
            raise ValueError(f"{path} was trained on observe={trained!r}, this environment {here}")
        seen, done = network.observation_space.shape, network.action_space.shape
        if (seen, done) != ((frames * self._size,), wanted):
            raise ValueError(
                f"{path} was trained in another environment: on observations of shape {seen} and"
                f" actions of shape {done}, not {(frames * self._size,)} and {wanted}"
            )
        if core is None:
            network.action_space = spaces[
                1
            ]  # a checkpoint of ours has no bounds: all our actions lie in [-1, 1]
        known = self._policy.vehicle
        if known and not same_vehicle(known, {} if core is None else vehicle_of(core.vehicle)):
            raise ValueError(
                f"{path} was trained on another vehicle, that of {self._policy.environment}: fly it"
                f" there, or train an agent in {core.system.name if core else 'this environment'}"
            )
        self.reset(1)

    def reset(self, num_envs: int) -> None:
        """Forget everything: the frames before the first are zeros, and so is the recurrent state."""
        self._seen = np.zeros((num_envs, self._policy.frames * self._size), np.float32)
        self._state = None

    def act(self, observations: np.ndarray) -> np.ndarray:
        """The policy's mean action.

        Raises:
            ValueError: for another number of rows than that of `reset`, or other observations.
        """
        wanted = len(self._seen), self._size
        if np.shape(observations) != wanted:
            raise ValueError(
                f"observations must have shape {wanted}, as many rows as reset(num_envs) was told,"
                f" got {np.shape(observations)}"
            )
        scale, size = self._policy.normalized, self._policy.normalizes
        frame = scale(observations) if size == self._size else observations
        self._seen = np.concatenate(
            [self._seen[:, self._size :], frame], axis=1
        )  # the newest frame last
        seen = scale(self._seen) if size not in (0, self._size) else self._seen
        network = self._policy.network
        with nullcontext() if isinstance(network, Dense) else one_thread():
            actions, self._state = network.predict(seen, self._state, deterministic=True)
        return actions
