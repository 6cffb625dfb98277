# /// script
# dependencies = [
#     "torch==2.13.0", "numpy==2.4.6", "scipy==1.17.1", "llvmlite==0.50.0", "rich==15.0.0",
#     "gymnasium==1.4.0", "rl_zoo3==2.9.2", "sbx-rl==0.28.0", "jax==0.10.2",
#     "torchrl==0.14.1", "tensordict==0.14.3", "skrl==2.1.1", "tianshou==2.0.1",
#     "minari[hdf5]==0.5.4",
# ]
# ///
"""sbx: PPO on a native batch, TQC on single environments."""

import gymnasium as gym
import numpy as np
from recorder import ROWS, SEED, STEPS, Record, run
from sbx import PPO, TQC
from stable_baselines3.common.env_util import make_vec_env
from with_stable_baselines3 import SEEDS, Rollouts, replayed

from agents.training.vec_env import StableBaselinesVecEnv


class JaxRollouts(Rollouts):
    """Rollouts whose values a network of JAX gives."""

    def value(self, observations: np.ndarray) -> np.ndarray:
        """Values of observations ``(B, k)``."""
        state = self.model.policy.vf_state
        return np.asarray(state.apply_fn(state.params, observations))[:, 0]


def on_policy(record: Record) -> None:
    """PPO on a native batch."""
    batch = gym.make_vec(record.env_id, num_envs=ROWS, max_episode_steps=record.limit)
    rollouts = JaxRollouts(record)
    model = PPO(
        "MlpPolicy",
        StableBaselinesVecEnv(batch),
        n_steps=250,
        batch_size=250,
        n_epochs=1,
        seed=SEED,
    )
    model.learn(ROWS * STEPS, rollouts)
    record.check(SEEDS, rollouts.stored())


def off_policy(record: Record) -> None:
    """TQC on single environments."""
    options = {"max_episode_steps": record.limit}
    batch = make_vec_env(record.env_id, ROWS, env_kwargs=options)
    model = TQC("MlpPolicy", batch, learning_starts=ROWS * STEPS - 10, seed=SEED)
    model.learn(ROWS * STEPS)
    record.check(SEEDS, replayed(model.replay_buffer))


if __name__ == "__main__":
    run(on_policy)
    run(off_policy)
