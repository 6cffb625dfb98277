#!/usr/bin/env bash
# One would expect an observation space written as a dict, by keywords or as an OrderedDict to be
# one space. But a dict is sorted by key, the others are not: the three compare equal and contain
# each other's observations, yet flatten in another order; wrappers that rebuild a space sort it
# (Gymnasium 1.4.0, spaces.Dict; only its argument `sort_keys` hints at it). Hurts who trains on
# FlattenObservation and evaluates in a space made in another way: checks pass, and the policy reads
# heading as position. Instead: an array, or compare list(space) before a policy is loaded.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install -qq --no-compile gymnasium==1.4.0 numpy==2.4.6

"$folder/env/bin/python" - <<'EOF'
from collections import OrderedDict
from importlib.metadata import version

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box, Dict, flatten
from gymnasium.wrappers import FilterObservation, FlattenObservation

position, heading = Box(-100, 100, (2,)), Box(-4, 4, (1,))
spaces = {
    "dict": Dict({"position": position, "heading": heading}),
    "keywords": Dict(position=position, heading=heading),
    "OrderedDict": Dict(OrderedDict(position=position, heading=heading)),
}
seen = {"position": np.array([30, 40], "f4"), "heading": np.array([1], "f4")}



class Anchored(gym.Env):
    observation_space, action_space = spaces["keywords"], Box(-1, 1, (1,))

    def reset(self, *, seed=None, options=None):
        return seen, {}


print("gymnasium", version("gymnasium"))
for name, space in spaces.items():
    print(f"{name:12}", list(space), flatten(space, seen), "contains:", space.contains(seen))
print("by hand     ", list(seen), np.concatenate(list(seen.values())))

first, *others = spaces.values()
flat = FlattenObservation(Anchored()).reset()[0]
kept = FlattenObservation(FilterObservation(Anchored(), ["position", "heading"])).reset()[0]
print("of an environment", flat, "and with a filter that keeps every key", kept)
print("equal:", [first == other for other in others])
assert all(first == other for other in others), "the spaces no longer compare equal"
assert all(space.contains(seen) for space in spaces.values())
assert flatten(first, seen).tolist() == [1, 30, 40], "a dict is no longer sorted"
for other in others:
    assert flatten(other, seen).tolist() == [30, 40, 1], "keywords are sorted now"
assert flat.tolist() == [30, 40, 1] and kept.tolist() == [1, 30, 40], "the filter keeps the order"
EOF
