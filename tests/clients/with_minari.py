# /// script
# dependencies = [
#     "torch==2.13.0", "numpy==2.4.6", "scipy==1.17.1", "llvmlite==0.50.0", "rich==15.0.0",
#     "gymnasium==1.4.0", "rl_zoo3==2.9.2", "sbx-rl==0.28.0", "jax==0.10.2",
#     "torchrl==0.14.1", "tensordict==0.14.3", "skrl==2.1.1", "tianshou==2.0.1",
#     "minari[hdf5]==0.5.4",
# ]
# ///
"""Minari records episodes, and its dataset's actions and seeds give them again."""

import os
from tempfile import mkdtemp

os.environ["MINARI_DATASETS_PATH"] = mkdtemp()

import gymnasium as gym
import minari
import numpy as np
from recorder import SEED, STEPS, Record, run


def play(record: Record) -> None:
    """Record random actions, and replay what was kept."""
    env = gym.make(record.env_id, max_episode_steps=record.limit)
    collector = minari.DataCollector(env, record_infos=True)
    rng, steps = np.random.default_rng(SEED), 0
    for seed in range(SEED, SEED + 100):
        collector.reset(seed=seed)
        done = False
        while not done:
            action = rng.normal(size=env.action_space.shape).clip(-1, 1).astype(np.float32)
            _, _, terminated, truncated, _ = collector.step(action)
            steps, done = steps + 1, terminated or truncated
        if steps >= 2 * STEPS:
            break
    name = f"{record.env_id.lower().partition('-')[0]}/random-v0"
    collector.create_dataset(name)
    dataset = minari.load_dataset(name)
    (played,) = record.played()
    replayed = dataset.recover_environment()
    assert dataset.total_steps == steps
    seeds = [each["seed"] for each in dataset.storage.get_episode_metadata(dataset.episode_indices)]
    for row, episode in enumerate(dataset.iterate_episodes()):
        assert len(episode.actions) == len(played[row].steps)
        observation, info = replayed.reset(seed=int(seeds[row]))
        for step, action in enumerate(episode.actions):
            np.testing.assert_array_equal(observation, episode.observations[step])
            observation, reward, terminated, truncated, info = replayed.step(action)
            assert reward == episode.rewards[step]
            assert [terminated, truncated] == [
                episode.terminations[step],
                episode.truncations[step],
            ]
            assert info["end"] == episode.infos["end"][step + 1]
        np.testing.assert_array_equal(observation, episode.observations[-1])
        np.testing.assert_array_equal(observation, played[row].steps[-1]["next_observation"])
    print(record.env_id, steps, "transitions in", row + 1, "episodes")


if __name__ == "__main__":
    run(play)
