"""Environments of one's own, from a system."""

import gymnasium as gym

from vessel_gym.envs.single import VesselEnv
from vessel_gym.envs.vector import VesselVectorEnv
from vessel_gym.system import System


def register_environment(system: System, max_episode_steps: int | None = None) -> str:
    """Register a system with Gymnasium, both faces of it, under its name.

    Args:
        system: What moves, what acts, what is asked; `dataclasses.replace` changes a part of one of ours.
        max_episode_steps: Steps of a full episode; None: the task's horizon.

    Returns:
        The id, which is the system's name.

    Raises:
        ValueError: for the name of an environment of this package: give yours one of its own.
    """
    known = gym.registry.get(system.name)
    if known is not None and str(known.entry_point).startswith("vessel_gym."):
        raise ValueError(f"{system.name!r} is an environment of this package: give yours a name of its own")
    faces = [type(base.__name__, (base,), {"system": system}) for base in (VesselEnv, VesselVectorEnv)]
    gym.registry.pop(system.name, None)  # a notebook's cell may run again
    gym.register(
        system.name,
        entry_point=faces[0],  # type: ignore[arg-type]
        vector_entry_point=faces[1],  # type: ignore[arg-type]
        max_episode_steps=system.task.horizon if max_episode_steps is None else max_episode_steps,
    )
    return system.name
