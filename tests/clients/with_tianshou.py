# /// script
# dependencies = [
#     "torch==2.13.0", "numpy==2.4.6", "scipy==1.17.1", "llvmlite==0.50.0", "rich==15.0.0",
#     "gymnasium==1.4.0", "rl_zoo3==2.9.2", "sbx-rl==0.28.0", "jax==0.10.2",
#     "torchrl==0.14.1", "tensordict==0.14.3", "skrl==2.1.1", "tianshou==2.0.1",
#     "minari[hdf5]==0.5.4",
# ]
# ///
"""tianshou's collector fills a replay buffer from single environments, and returns follow."""

from functools import partial

import gymnasium as gym
import numpy as np
from recorder import ROWS, SEED, STEPS, Record, returns, run
from tianshou.algorithm import Algorithm
from tianshou.algorithm.modelfree.reinforce import ProbabilisticActorPolicy
from tianshou.data import Collector, VectorReplayBuffer
from tianshou.env import DummyVectorEnv
from tianshou.utils.net.common import RandomActor

NAMES = {"obs": "observation", "obs_next": "next_observation", "act": "action", "rew": "reward"}


def value(observations: np.ndarray) -> np.ndarray:
    """A critic's answer."""
    return np.asarray(observations, float).sum(-1)


def play(record: Record) -> None:
    """Collect with random actions."""
    envs = DummyVectorEnv([partial(gym.make, record.env_id, max_episode_steps=record.limit)] * ROWS)
    envs.seed(SEED)
    space, buffer = envs.action_space[0], VectorReplayBuffer(ROWS * STEPS, ROWS)
    actor = RandomActor(space)
    policy = ProbabilisticActorPolicy(
        actor=actor, dist_fn=actor.compute_action_batch, action_space=space
    )
    Collector(policy, envs, buffer).collect(
        n_step=ROWS * STEPS, random=True, reset_before_collect=True
    )
    batch = buffer[:]
    names = NAMES | {name: name for name in ("terminated", "truncated")}
    stored = {
        ours: batch[name].reshape(ROWS, STEPS, -1).swapaxes(0, 1) for name, ours in names.items()
    }
    for name in ("reward", "terminated", "truncated"):
        stored[name] = stored[name][..., 0]
    record.check([SEED, SEED + 1], stored)
    targets, _ = Algorithm.compute_episodic_return(
        batch, buffer, np.arange(ROWS * STEPS), value(batch.obs_next), value(batch.obs)
    )
    expected = returns(record.happened(), value, 0.99, 0.95).T.ravel()
    np.testing.assert_allclose(targets, expected, 1e-4, 1e-4)


if __name__ == "__main__":
    run(play)
