"""Registration of a user's own environments."""

from typing import Any

import gymnasium as gym

from estimators.checks import integer, short_repr
from vessel_gym.checks import instance
from vessel_gym.contract import check_system
from vessel_gym.envs.single import VesselEnv
from vessel_gym.envs.vector import VesselVectorEnv
from vessel_gym.system import System


def register_environment(system: System, max_episode_steps: int | None = None) -> str:
    """Register a system with Gymnasium under its name, as single and vector environment.

    Args:
        system: The environment as data; `dataclasses.replace` changes a field of a system of the
            package.
        max_episode_steps: Steps of a full episode; None for the task's horizon.

    Returns:
        The id, which is the system's name.

    Raises:
        ValueError: for a name that Gymnasium does not accept, or that belongs to an environment
            registered elsewhere; or as `vessel_gym.contract.check_system`.
        TypeError: for an object that is no system.
    """
    instance("system", system, System)
    if max_episode_steps is not None:
        integer("max_episode_steps", max_episode_steps, 1)
    try:
        gym.envs.registration.parse_env_id(system.name)
    except gym.error.Error:
        raise ValueError(
            f"name of a system must be like MyShip-v0, got {short_repr(system.name)}"
        ) from None
    known = gym.registry.get(system.name)
    if known is not None and not getattr(known.entry_point, "own", False):
        raise ValueError(f"{system.name!r} is an environment already: give yours a name of its own")
    check_system(system)
    made = {"system": system, "own": True, "__reduce__": _reduced}
    faces = [type(base.__name__, (base,), made) for base in (VesselEnv, VesselVectorEnv)]
    gym.registry.pop(system.name, None)  # a notebook's cell may run again
    gym.register(
        system.name,
        entry_point=faces[0],  # type: ignore[arg-type]
        vector_entry_point=faces[1],  # type: ignore[arg-type]
        max_episode_steps=system.task.horizon if max_episode_steps is None else max_episode_steps,
    )
    return system.name


def _reduced(self: VesselEnv | VesselVectorEnv) -> tuple[Any, ...]:
    """Pickle an environment by its state and the name under which its class is registered."""
    state = {
        name: value for name, value in self.__dict__.items() if name != "spec"
    }  # a spec holds the class
    return _blank, (self.system.name, isinstance(self, VesselVectorEnv)), state


def _blank(name: str, batch: bool) -> Any:
    spec = gym.spec(name)
    made: Any = spec.vector_entry_point if batch else spec.entry_point
    blank = made.__new__(made)
    blank.spec = spec
    return blank
