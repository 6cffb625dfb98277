"""Gymnasium environments with a state estimator in the loop.

Importing this package registers its environments; ``gymnasium.make("vessel_gym:SigmaCorvette-v0")``
does so by itself. An agent sees what a filter believes; the truth moves underneath and is kept for scoring.
"""

from gymnasium.envs.registration import register

__version__ = "0.1.0"

register(
    id="SigmaCorvette-v0",
    entry_point="vessel_gym.envs:SigmaCorvetteEnv",
    vector_entry_point="vessel_gym.envs:SigmaCorvetteVectorEnv",
    max_episode_steps=600,
)
