#!/usr/bin/env bash
# One would expect time_limit_bootstrap=True to add the value of the state that a time limit cut
# off. But skrl takes the observation that step returned: of a batch in SAME_STEP that is the first
# of the next episode, although infos has "final_obs" (skrl 2.1.1, PPO; SAC stores it, too). In
# NEXT_STEP the value is right, and each episode adds a transition that never happened. Hurts tasks
# whose ends differ from their starts, such as a ship on a track. Instead: SAME_STEP, and
# replace the ended rows of next_observations by infos["final_obs"] in record_transition.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install -qq --no-compile torch==2.13.0
"$folder/env/bin/pip" install -qq --no-compile skrl==2.1.1 gymnasium==1.4.0 numpy==2.4.6

"$folder/env/bin/python" -W ignore - <<'EOF'
from importlib.metadata import version

import gymnasium as gym
import numpy as np
import torch
from skrl.agents.torch.ppo import PPO
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.trainers.torch import SequentialTrainer


class Track(gym.Env):
    """Observes its miles, 0 to 4, and is cut off at 4; no step is rewarded."""

    observation_space = gym.spaces.Box(0, 10, (1,))
    action_space = gym.spaces.Box(-1, 1, (1,))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.miles = 0
        return np.zeros(1, np.float32), {}

    def step(self, action):
        self.miles += 1
        return np.array([self.miles], np.float32), 0.0, False, self.miles == 4, {}


class Critic(DeterministicMixin, Model):  # the value of a state is its miles plus 100
    def __init__(self, **spaces):
        Model.__init__(self, **spaces)
        DeterministicMixin.__init__(self)
        self.scale = torch.nn.Parameter(torch.ones(1))

    def compute(self, inputs, role):
        return self.scale * (inputs["observations"] + 100), {}


class Actor(GaussianMixin, Model):
    def __init__(self, **spaces):
        Model.__init__(self, **spaces)
        GaussianMixin.__init__(self)
        self.net = torch.nn.Linear(1, 1)

    def compute(self, inputs, role):
        return self.net(inputs["observations"]), {"log_std": torch.zeros(1)}


def rewards(mode):  # of the rollout, with what the time limit added
    envs = gym.vector.SyncVectorEnv([Track] * 2, autoreset_mode=mode)
    env = wrap_env(envs, "gymnasium")
    spaces = {"observation_space": env.observation_space, "action_space": env.action_space}
    spaces["device"] = "cpu"
    silent = {"write_interval": 0, "checkpoint_interval": 0}
    settings = {"rollouts": 9, "time_limit_bootstrap": True, "experiment": silent}
    memory = RandomMemory(memory_size=9, num_envs=2, device="cpu")
    models = {"policy": Actor(**spaces), "value": Critic(**spaces)}
    agent = PPO(models=models, memory=memory, cfg=settings | {"discount_factor": 1.0}, **spaces)
    course = {"timesteps": 9, "headless": True, "disable_progressbar": True}
    SequentialTrainer(env=env, agents=agent, cfg=course).train()
    stored = (memory.get_tensor_by_name(name)[:, 0, 0] for name in ("observations", "rewards"))
    return [each.numpy() for each in stored]


print("skrl", version("skrl"), "gymnasium", gym.__version__, "torch", torch.__version__)
print("a time limit at 4 miles should add 104")
(at, same), (next_at, following) = rewards("SameStep"), rewards("NextStep")
print("SAME_STEP: miles", at, "rewards", same)
print("NEXT_STEP: miles", next_at, "rewards", following)
assert at.tolist() == [0, 1, 2, 3, 0, 1, 2, 3, 0]
assert same[3] == same[7] == 100, "the value is no longer that of the next episode"
assert following[3] == 104 and next_at[4] == 4 and following[4] == 0
EOF
