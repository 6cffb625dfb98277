# /// script
# dependencies = [
#     "torch==2.13.0", "numpy==2.4.6", "scipy==1.17.1", "llvmlite==0.50.0", "rich==15.0.0",
#     "gymnasium==1.2.2", "ray[rllib]==2.60.0",
# ]
# ///
"""RLlib's env runner samples from a native batch in mode NEXT_STEP, and PPO learns."""

from typing import Any

import numpy as np
import ray
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.env.single_agent_env_runner import SingleAgentEnvRunner
from recorder import ROWS, SEED, STEPS, Arrays, Record, run


class Runner(SingleAgentEnvRunner):
    """Keeps the transitions of its episodes, to which learners add one."""

    kept: dict[str, list[Arrays]]

    def sample(self, **how: Any) -> list[Any]:
        """Episodes, of which those that go on are given in parts."""
        episodes = super().sample(**how)
        for part in episodes:
            observations, flags = part.get_observations(), np.zeros((2, len(part)), bool)
            flags[:, -1] = part.is_terminated, part.is_truncated
            self.kept.setdefault(part.id_.partition("_")[0], []).append({
                "observation": observations[:-1], "next_observation": observations[1:],
                "reward": part.get_rewards(), "terminated": flags[0], "truncated": flags[1],
            })  # fmt: skip
        return episodes


def joined(parts: list[Arrays]) -> Arrays:
    """Parts one after the other."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def play(record: Record) -> None:
    """Train PPO, and compare the episodes of its runner."""
    options = {"max_episode_steps": record.limit}
    config = PPOConfig().environment(f"vessel_gym:{record.env_id}", env_config=options)
    config.debugging(seed=SEED)
    config.env_runners(
        env_runner_cls=Runner,
        num_env_runners=0,
        num_envs_per_env_runner=ROWS,
        gym_env_vectorize_mode="vector_entry_point",
        rollout_fragment_length=250,
    )
    Runner.kept = {}
    algorithm = config.training(train_batch_size=500, minibatch_size=250, num_epochs=1).build_algo()
    for _ in range(STEPS // 250):
        algorithm.train()
    episodes = {
        each["observation"][0].tobytes(): each for each in map(joined, Runner.kept.values())
    }
    rows = [[each.first.tobytes() for each in row if each.steps] for row in record.played()]
    assert len(episodes) == sum(map(len, rows))
    record.check([SEED, SEED + 1], [joined([episodes[first] for first in row]) for row in rows])


if __name__ == "__main__":
    ray.init(num_cpus=1, include_dashboard=False, log_to_driver=False)
    run(play)
