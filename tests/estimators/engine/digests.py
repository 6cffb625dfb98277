"""Digests of 40 steps of 32 rows in the environments, on a processor with fewer features.

python tests/estimators/engine/digests.py native|avx2|sse
"""

import sys
from hashlib import sha256

import gymnasium as gym
import numpy as np

import vessel_gym  # noqa: F401  (registers the environments)
from estimators.engine import machine

ENVIRONMENTS = (
    "SigmaCorvette-v0", "SigmaChannel-v0", "SegorogeniAUV-v0", "ItsunusaAUV-v0", "PunaUAV-v0",
    "ThesisCorvette-v0",
)  # fmt: skip
LACKING = {
    "native": (),
    "avx2": ("avx512", "avx10", "evex"),
    "sse": ("avx", "fma", "f16c", "vaes", "vpclmul", "evex", "xop"),
}
"""Parts of the names of the features that a processor lacks."""


def processor(lacking: tuple[str, ...]) -> tuple[str, ...]:
    """This processor without some features, as LLVM describes it."""
    version, triple, name, features = machine._processor()
    kept = [
        f"-{feature[1:]}" if any(word in feature for word in lacking) else feature
        for feature in features.split(",")
    ]
    return version, triple, "x86-64-v2" if "avx" in lacking else name, ",".join(kept)


def digest(env_id: str) -> str:
    """Digest of observations, rewards and covariances."""
    env = gym.make_vec(env_id, num_envs=32, vectorization_mode="vector_entry_point")
    observation, _ = env.reset(seed=0)
    found = sha256(observation.tobytes())
    actions = np.random.default_rng(0).uniform(-0.2, 0.2, (40, *env.action_space.shape))
    for action in actions.astype(np.float32):
        observation, reward, *_, info = env.step(action)
        for array in (observation, reward, info["covariance"]):
            found.update(array.tobytes())
    return found.hexdigest()


if __name__ == "__main__":
    described = processor(LACKING[sys.argv[1]])
    machine._processor = lambda: described  # type: ignore[assignment]
    for env_id in ENVIRONMENTS:
        print(env_id, digest(env_id))
