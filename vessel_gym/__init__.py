"""Gymnasium environments with a state estimator in the loop.

Importing this package registers its environments; ``gymnasium.make("vessel_gym:SigmaCorvette-v0")``
does so by itself. An agent sees what a filter believes; the truth moves underneath and is kept for scoring.
"""

from gymnasium.envs.registration import register

__version__ = "0.1.0"

for _name, _steps in (("SigmaCorvette", 600), ("SegorogeniAUV", 500), ("ItsunusaAUV", 600), ("PunaUAV", 900)):
    register(
        id=f"{_name}-v0",
        entry_point=f"vessel_gym.envs:{_name}Env",
        vector_entry_point=f"vessel_gym.envs:{_name}VectorEnv",
        max_episode_steps=_steps,
    )
for _name, _steps in (("Ship", 600), ("AUV", 500), ("FixedWing", 900)):
    register(
        id=f"vessel_gym/{_name}-v0",
        entry_point=f"vessel_gym.envs:{_name}Env",
        vector_entry_point=f"vessel_gym.envs:{_name}VectorEnv",
        max_episode_steps=_steps,
    )
