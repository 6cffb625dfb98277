#!/usr/bin/env bash
# One would expect TorchRL to make batches in an autoreset mode that it reads. But
# GymEnv(name, num_envs=n) makes Gymnasium's default, NEXT_STEP, which its own GymWrapper refuses:
# the last observation of each episode is stored as zeros, and a transition to the next episode's
# first observation, with reward 0, is added (TorchRL 0.14.1 with Gymnasium 1.4.0). Hurts who trains
# with time limits: they bootstrap from zeros, and one sample an episode never happened. Instead:
# GymWrapper(gym.make_vec(name, num_envs=n, vector_kwargs={"autoreset_mode": "Disabled"})).
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install -qq --no-compile torch==2.13.0
"$folder/env/bin/pip" install -qq --no-compile torchrl==0.14.1 gymnasium==1.4.0 numpy==2.4.6

cat > "$folder/show.py" <<'EOF'  # in a file, which the processes of a batch can import
from importlib.metadata import version

import gymnasium as gym
import numpy as np
import torch
from torchrl.envs import GymEnv, GymWrapper


class Voyage(gym.Env):
    """Observes its number of miles, from 10 on, and is cut off after 3 to 6 steps."""

    observation_space = gym.spaces.Box(0, 100, (1,))
    action_space = gym.spaces.Box(-1, 1, (1,))

    def __init__(self, frameskip=1):
        self.miles = 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.miles, self.end = 10, 13 + self.np_random.integers(4)
        return np.array([10], np.float32), {}

    def step(self, action):
        self.miles += 1
        return np.array([self.miles], np.float32), 1.0, False, self.miles >= self.end, {}


gym.register("Voyage-v0", entry_point=Voyage)


def counts(env):
    env.set_seed(1)
    data = env.rollout(200, break_when_any_done=False)
    ended, after = data["next", "truncated"], data["next", "observation"]
    lost = (ended & (after == 0)).sum().item()
    invented = (~ended & (data["observation"] > 12) & (after == 10)).sum().item()
    return ended.sum().item(), lost, invented


if __name__ == "__main__":
    print("torchrl", version("torchrl"), "gymnasium", gym.__version__, "torch", torch.__version__)
    wrong = counts(GymEnv("Voyage-v0", num_envs=2))
    off = {"vectorization_mode": "sync", "vector_kwargs": {"autoreset_mode": "Disabled"}}
    right = counts(GymWrapper(gym.make_vec("Voyage-v0", num_envs=2, **off)))
    for name, each in ("num_envs=2", wrong), ("DISABLED", right):
        print(f"{name}: {each[0]} ends, {each[1]} as zeros, {each[2]} steps that never happened")
    assert wrong[1] == wrong[0] > 50, "last observations are kept"
    assert wrong[2] > 50, "no transition is added"
    assert right[0] > 50 and right[1:] == (0, 0)
EOF
"$folder/env/bin/python" -W ignore "$folder/show.py" 2>/dev/null
