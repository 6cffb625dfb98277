"""A user's own environments and filters: registration, and the model that a filter gets."""

from contextlib import closing
from typing import Any

import gymnasium as gym
import numpy as np

from estimators import Gaussian
from estimators.checks import short_repr
from estimators.filter import Model
from vessel_gym.checks import instance
from vessel_gym.contract import check_system
from vessel_gym.envs.single import VesselEnv
from vessel_gym.envs.vector import VesselVectorEnv
from vessel_gym.system import System


def register_environment(system: System) -> str:
    """Register a system with Gymnasium under its name, as single and vector environment.

    An episode lasts for the task's horizon; `gymnasium.make` takes another ``max_episode_steps``.

    Args:
        system: The environment as data; `dataclasses.replace` changes a field of a system of the
            package.

    Returns:
        The id, which is the system's name.

    Raises:
        ValueError: for a name that Gymnasium does not accept, or that belongs to an environment
            registered elsewhere; or as `vessel_gym.contract.check_system`.
        TypeError: for an object that is no system.
    """
    instance("system", system, System)
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
        max_episode_steps=system.task.horizon,
    )
    return system.name


def model_of(env_id: str, **options: Any) -> tuple[Model, Gaussian, np.ndarray]:
    """Model that the filter of an environment gets, with a belief and an input, to try a filter on.

    ``check_filter(MyFilter, *model_of("SigmaCorvette-v0"))`` tries one of your own. The states are
    in the order of ``info["estimate"]``, and the measurements in that of ``info["measurement"]``.
    The docstring of the environment names both.

    Args:
        env_id: A registered environment of a `vessel_gym.system.System`.
        options: Arguments of the environment, such as ``sensors="budget"``, or
            ``estimator_options={"model": "linear"}`` for another kind of model.

    Returns:
        The model, the belief at the start of an episode with its mean ``(n,)`` and covariance
        ``(n, n)``, and the known input ``(m,)`` of the first step.

    Raises:
        gymnasium.error.Error: if there is no such environment.
        TypeError: if it is the environment of another package.
    """
    env: Any = gym.make(env_id, **options)
    with closing(env):
        instance(env_id, env.unwrapped, VesselEnv)
        _, info = env.reset(seed=0)
        env.step(np.zeros(env.action_space.shape))
        core = env.unwrapped.core
        start = Gaussian(info["estimate"], info["covariance"])
        return core.config.estimation.filter.model, start, core.now.u[0]


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
