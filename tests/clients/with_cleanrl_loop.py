"""The loop of CleanRL's ppo_continuous_action, which wants SAME_STEP, on both kinds of batches."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from recorder import ROWS, SEED, STEPS, Record, returns

GAMMA, LAMBDA = 0.99, 0.95


def value(observations: np.ndarray) -> np.ndarray:
    """A critic's answer."""
    return np.asarray(observations, float).sum(-1)


def collect(envs: Any) -> dict[str, np.ndarray]:
    """One rollout, as CleanRL's script collects it, and the value of what time limits cut off."""
    rng, lengths = np.random.default_rng(SEED), []
    shape = STEPS, ROWS
    obs = np.zeros((*shape, *envs.single_observation_space.shape), np.float32)
    rewards, dones = np.zeros(shape), np.zeros(shape, bool)
    next_obs, _ = envs.reset(seed=SEED)
    next_done = np.zeros(ROWS, bool)
    for step in range(STEPS):
        obs[step], dones[step] = next_obs, next_done
        actions = rng.normal(size=envs.action_space.shape).clip(-1.0, 1.0).astype(np.float32)
        next_obs, rewards[step], terminations, truncations, infos = envs.step(actions)
        next_done = terminations | truncations
        if "final_info" in infos:
            # a wrapper around the batch writes beside what each environment's own wrapper wrote
            ended = infos if "episode" in infos else infos["final_info"]
            lengths += ended["episode"]["l"][ended["_episode"]].tolist()
        for row in np.flatnonzero(truncations & ~terminations):  # an end at the limit is an end
            rewards[step, row] += GAMMA * value(infos["final_obs"][row])
    targets, carried = np.zeros(shape), 0.0
    for step in reversed(range(STEPS)):
        values = value(next_obs)
        targets[step] = rewards[step] + GAMMA * ~next_done * (values + LAMBDA * carried)
        next_obs, next_done = obs[step], dones[step]
        carried = targets[step] - value(next_obs)
    return {"observation": obs, "targets": targets, "lengths": np.array(lengths)}


def play(record: Record, envs: Any) -> None:
    """Compare a rollout with what happened."""
    stored = collect(envs)
    expected = returns(record.happened(), value, GAMMA, LAMBDA)
    np.testing.assert_allclose(stored.pop("targets"), expected, 1e-4, 1e-4, err_msg="targets")
    ended = [len(each.steps) for row in record.played() for each in row[:-1]]
    assert sorted(stored.pop("lengths").tolist()) == sorted(ended)
    record.check([SEED, SEED + 1], stored)


def native(record: Record) -> None:
    """A native batch."""
    mode = {"autoreset_mode": "SameStep", "max_episode_steps": record.limit}
    batch = gym.make_vec(record.env_id, num_envs=ROWS, **mode)
    play(record, gym.wrappers.vector.RecordEpisodeStatistics(batch))


def gymnasiums_own(record: Record) -> None:
    """Gymnasium's batch of single environments."""

    def make() -> gym.Env:
        env = gym.make(record.env_id, max_episode_steps=record.limit)
        return gym.wrappers.RecordEpisodeStatistics(env)

    play(record, SyncVectorEnv([make] * ROWS, autoreset_mode=AutoresetMode.SAME_STEP))
