"""stable-baselines3 on a native batch, sb3-contrib on single environments: both buffers."""

from typing import Any

import gymnasium as gym
import numpy as np
from recorder import ROWS, SEED, STEPS, Arrays, Record, returns
from sb3_contrib import TQC
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env

from agents.training.vec_env import StableBaselinesVecEnv

SEEDS = [SEED + row for row in range(ROWS)]


def replayed(buffer: Any) -> Arrays:
    """Transitions of a replay buffer of stable-baselines3."""
    steps = slice(0, buffer.pos)
    return {
        "observation": buffer.observations[steps],
        "next_observation": buffer.next_observations[steps],
        "action": buffer.actions[steps],
        "reward": buffer.rewards[steps],
        "terminated": buffer.dones[steps] * (1 - buffer.timeouts[steps]),
        "truncated": buffer.timeouts[steps],
    }


class Rollouts(BaseCallback):
    """Keeps each rollout, and compares its returns with what happened."""

    def __init__(self, record: Record) -> None:
        super().__init__()
        self.record, self.kept = record, []

    def _on_step(self) -> bool:
        return True

    def value(self, observations: np.ndarray) -> np.ndarray:
        """Values of observations ``(B, k)``."""
        policy: Any = self.model.policy
        values: np.ndarray = (
            policy.predict_values(policy.obs_to_tensor(observations)[0]).detach().numpy()
        )
        return values[:, 0]

    def _on_rollout_end(self) -> None:
        model, buffer = self.model, self.model.rollout_buffer
        rollout = {k: v[-buffer.buffer_size :] for k, v in self.record.happened().items()}
        expected = returns(rollout, self.value, model.gamma, model.gae_lambda)
        np.testing.assert_allclose(buffer.returns, expected, 1e-4, 1e-4, err_msg="returns")
        self.kept.append({"observation": buffer.observations, "action": buffer.actions.clip(-1, 1)})

    def stored(self) -> Arrays:
        """Rollouts one after the other."""
        return {name: np.concatenate([each[name] for each in self.kept]) for name in self.kept[0]}


def on_policy(record: Record) -> None:
    """PPO on a native batch."""
    batch = gym.make_vec(record.env_id, num_envs=ROWS, max_episode_steps=record.limit)
    rollouts = Rollouts(record)
    sizes = {"n_steps": 250, "batch_size": 250, "n_epochs": 1}
    model = PPO("MlpPolicy", StableBaselinesVecEnv(batch), seed=SEED, device="cpu", **sizes)
    model.learn(ROWS * STEPS, rollouts)
    record.check(SEEDS, rollouts.stored())


def off_policy(record: Record) -> None:
    """TQC on single environments."""
    options = {"max_episode_steps": record.limit}
    batch = make_vec_env(record.env_id, ROWS, env_kwargs=options)
    starts = ROWS * STEPS - 10
    model = TQC("MlpPolicy", batch, learning_starts=starts, seed=SEED, device="cpu")
    model.learn(ROWS * STEPS)
    record.check(SEEDS, replayed(model.replay_buffer))
