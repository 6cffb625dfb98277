# /// script
# dependencies = [
#     "torch==2.13.0", "numpy==2.4.6", "scipy==1.17.1", "llvmlite==0.50.0", "rich==15.0.0",
#     "gymnasium==1.4.0", "rl_zoo3==2.9.2", "sbx-rl==0.28.0", "jax==0.10.2",
#     "torchrl==0.14.1", "tensordict==0.14.3", "skrl==2.1.1", "tianshou==2.0.1",
#     "minari[hdf5]==0.5.4",
# ]
# ///
"""skrl's PPO on a native batch in mode SAME_STEP."""

from typing import Any

import gymnasium as gym
import numpy as np
import torch
from recorder import ROWS, SEED, STEPS, Record, returns, run
from skrl.agents.torch.ppo import PPO
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.trainers.torch import SequentialTrainer
from skrl.utils import set_seed
from skrl.utils.model_instantiators.torch import deterministic_model, gaussian_model


class LastObservations:
    """A mixin for agents: an ended episode's transition keeps its last observation."""

    def record_transition(self, *, next_observations, infos, **others):
        """Record the transitions of a step."""
        ended = np.array(infos.get("_final_obs", False))
        if ended.any():
            rows, last = torch.from_numpy(ended), infos["final_obs"][ended]
            next_observations = next_observations.clone()
            next_observations[rows] = torch.from_numpy(np.stack(last))
        others |= {"next_observations": next_observations, "infos": infos}
        super().record_transition(**others)


class Learner(LastObservations, PPO):
    """PPO whose returns are compared with what happened."""

    record: Record

    def value_of(self, observations: np.ndarray) -> np.ndarray:
        """Values of observations ``(B, k)``."""
        asked = {"observations": torch.from_numpy(observations)}
        values: np.ndarray = self.value.act(asked, role="value")[0].detach().numpy()
        return values[:, 0]

    def update(self, **when: int) -> None:
        """Learn from a rollout."""
        rollout = {k: v[-self.cfg.rollouts :] for k, v in self.record.happened().items()}
        expected = returns(rollout, self.value_of, 0.99, 0.95)
        super().update(**when)
        found, observations = (
            self.memory.get_tensor_by_name(name).numpy() for name in ("returns", "observations")
        )
        np.testing.assert_allclose(found[..., 0], expected, 1e-4, 1e-4, err_msg="returns")
        self.kept.append(observations.copy())


def play(record: Record) -> None:
    """Train PPO."""
    set_seed(SEED)
    mode = {"autoreset_mode": "SameStep", "max_episode_steps": record.limit}
    env = wrap_env(gym.make_vec(record.env_id, num_envs=ROWS, **mode), "gymnasium")
    spaces: Any = {
        "observation_space": env.observation_space,
        "action_space": env.action_space,
        "device": "cpu",
    }
    network = [{"name": "net", "input": "OBSERVATIONS", "layers": [8], "activations": "tanh"}]
    models = {
        "policy": gaussian_model(network=network, output="ACTIONS", **spaces),
        "value": deterministic_model(network=network, output="ONE", **spaces),
    }
    silent = {"write_interval": 0, "checkpoint_interval": 0}
    settings = {"rollouts": 250, "time_limit_bootstrap": True}
    settings |= {"discount_factor": 0.99, "gae_lambda": 0.95, "experiment": silent}
    agent = Learner(
        models=models, memory=RandomMemory(memory_size=250, num_envs=ROWS), cfg=settings, **spaces
    )
    agent.record, agent.kept = record, []
    course = {"timesteps": STEPS, "headless": True, "disable_progressbar": True}
    SequentialTrainer(env=env, agents=agent, cfg=course).train()
    record.check([SEED, SEED + 1], {"observation": np.concatenate(agent.kept)})


if __name__ == "__main__":
    run(play)
