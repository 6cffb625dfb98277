#!/usr/bin/env bash
# One would expect one seed to bring the same gusts with and without a wrapper that repeats actions.
# But StickyAction draws from the environment's own generator, even with a probability of 0, so that
# from the second step on the gusts are others (Gymnasium 1.4.0, where a wrapper's np_random is the
# environment's; not documented for it). Hurts who measures in pairs what a held command costs: the
# difference contains another weather, and pairing saves nothing. Instead: draw all noise at reset
# or from a generator that wrappers do not see, or write the wrapper with a generator of its own.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install -qq --no-compile gymnasium==1.4.0 numpy==2.4.6

"$folder/env/bin/python" - <<'EOF'
from importlib.metadata import version

import gymnasium as gym
import numpy as np
from gymnasium.wrappers import StickyAction

STILL = np.zeros(1, np.float32)


class Gusts(gym.Env):
    observation_space = gym.spaces.Box(-np.inf, np.inf, (1,))
    action_space = gym.spaces.Box(-1, 1, (1,))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return STILL, {}

    def step(self, action):
        gust = self.np_random.normal()
        return np.array([gust], np.float32), -abs(gust), False, False, {}


def weather(env, seed, steps=6):  # the action is always zero, so that sticking changes nothing
    env.reset(seed=seed)
    return np.array([env.step(STILL)[0][0] for _ in range(steps)])


print("gymnasium", version("gymnasium"))
bare = weather(Gusts(), 3)
never = weather(StickyAction(Gusts(), 0.0), 3)
print("gusts of seed 3, bare:               ", bare.round(2))
print("gusts of seed 3, sticky with p = 0:  ", never.round(2))
pairs = [(weather(Gusts(), seed)[5], weather(StickyAction(Gusts(), 0.0), seed)[5])
         for seed in range(500)]
correlation = np.corrcoef(np.transpose(pairs))[0, 1]
print(f"correlation of the sixth gust over 500 common seeds: {correlation:.2f}")

assert np.array_equal(bare, weather(Gusts(), 3)), "a seed no longer repeats"
assert bare[0] == never[0] and not np.isclose(bare[1:], never[1:]).any(), "the gusts are the same"
assert abs(correlation) < 0.15
EOF
