# /// script
# dependencies = [
#     "torch==2.13.0", "numpy==2.4.6", "scipy==1.17.1", "llvmlite==0.50.0", "rich==15.0.0",
#     "gymnasium==1.4.0", "rl_zoo3==2.9.2", "sbx-rl==0.28.0", "jax==0.10.2",
#     "torchrl==0.14.1", "tensordict==0.14.3", "skrl==2.1.1", "tianshou==2.0.1",
#     "minari[hdf5]==0.5.4",
# ]
# ///
"""TorchRL: a single environment by its name, and native batches that it resets itself."""

from functools import partial

import gymnasium as gym
import torch
from recorder import ROWS, SEED, STEPS, Arrays, Record, run
from torchrl._utils import seed_generator
from torchrl.collectors import Collector
from torchrl.envs import EnvBase, GymEnv, GymWrapper, SerialEnv


def play(record: Record, env: EnvBase, seeds: list[int]) -> None:
    """Collect with random actions, and compare."""
    torch.manual_seed(SEED)
    env.set_seed(SEED)  # the collector's own set_seed starts episodes whose beginning it drops
    collector = Collector(env, None, frames_per_batch=ROWS * 250, total_frames=ROWS * STEPS)
    data = torch.cat(list(collector), -1).transpose(0, 1)
    stored: Arrays = {name: data[name].numpy() for name in ("observation", "action")}
    for name in ("reward", "terminated", "truncated"):
        stored[name] = data["next", name][..., 0].numpy()
    record.check(seeds, stored | {"next_observation": data["next", "observation"].numpy()})


def batch(record: Record) -> None:
    """A native batch in mode DISABLED."""
    mode = {"autoreset_mode": "Disabled", "max_episode_steps": record.limit}
    play(record, GymWrapper(gym.make_vec(record.env_id, num_envs=ROWS, **mode)), [SEED, SEED + 1])


def singles(record: Record) -> None:
    """Single environments by their name."""
    make = partial(GymEnv, record.env_id, max_episode_steps=record.limit)
    play(record, SerialEnv(ROWS, make), [SEED, seed_generator(SEED)])


if __name__ == "__main__":
    run(batch)
    run(singles)
