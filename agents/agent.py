"""Agents: batches of observations in, batches of actions out."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from gymnasium.spaces import Box

from agents.controllers import CONTROLLERS, PPO, RANDOM, make_controller, unknown_controller
from agents.policies.agent import TrainedAgent
from agents.policies.checkpoint import packaged, policy_path
from agents.wrapped import core_of
from estimators.checks import short_repr
from estimators.tunable import check_parameters
from vessel_gym.checks import options


@runtime_checkable
class Agent(Protocol):
    """Interface of agents, which act on observations alone."""

    def reset(self, num_envs: int) -> None:
        """Begin new episodes in ``num_envs`` environments: forget everything."""
        ...

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Actions ``(B, a)`` in [-1, 1] for observations ``(B, k)``."""
        ...


class RandomAgent:
    """Agent of uniform random actions, repeatable by its seed."""

    def __init__(self, action_size: int, seed: int = 0) -> None:
        self._size, self._seed = action_size, seed
        self.reset(1)

    def reset(self, num_envs: int) -> None:
        """Begin the stream again."""
        self._rng = np.random.default_rng(self._seed)

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Actions, uniform in [-1, 1]."""
        return self._rng.uniform(-1.0, 1.0, (len(observations), self._size)).astype(np.float32)


def load_agent(name: str | Path, env: Any, parameters: Mapping[str, float] | None = None) -> Agent:
    """An agent by name, or a trained one from its file.

    Args:
        name: One of these:

            - a controller that is registered for the environment's task, such as ``"autopilot"``
              (see `agents.controllers`);
            - ``"ppo"``, which comes with the package, trained on the environment's default
              estimates;
            - ``"random"``;
            - the path of a file of tuned parameters (``.toml``) of `vessel-gym tune`;
            - the path of a policy (``.npz``) that `agents.save_agent` or ``vessel-gym train``
              wrote, or of the stable-baselines3 model (``.zip``) beside it;
            - ``"module:object"``, a controller of your own: the object is called with the
              environment's `System`. The module is imported, which runs its code.
        env: The environment in which the agent will act, single or vector, wrapped or not.
        parameters: Parameters of a controller by name, of those in its attribute ``tunable``; the
            others have their defaults.

    Raises:
        ValueError: if the name is none of these, or if the policy is damaged or was trained on
            another observation or vehicle; for an unknown parameter, or one that is not a finite
            number or not above 0 where it must be.
        numpy.linalg.LinAlgError: if no controller stabilises the vehicle with these parameters.
        TypeError: for what is neither a name nor a path, for parameters that are no dictionary, or
            if ``"module:object"`` makes no agent.
    """
    if not isinstance(name, str | os.PathLike):
        raise TypeError(
            "load_agent takes a name, autopilot or random, or the path of a checkpoint, got"
            f" {short_repr(name)}"
        )
    given, env, path = env, env.unwrapped, policy_path(name)
    parameters = options("parameters", parameters)
    if name in (RANDOM, PPO) or os.path.isfile(path):  # pathlib raises for a name too long
        check_parameters(str(name), {}, parameters)
    if name == RANDOM:
        space = getattr(env, "single_action_space", env.action_space)
        if not isinstance(space, Box):
            raise ValueError(f"the random agent needs a continuous action space, got {space}")
        return RandomAgent(space.shape[0])
    ours = hasattr(env, "core")
    if ours and name == PPO:
        return TrainedAgent(packaged(env.system.name), env)
    if ours and name in CONTROLLERS.of(env.core.config.system.task):
        return _guided(str(name), env, parameters)
    if Path(name).suffix == ".toml":
        from agents.tuning.tuned import load_tuned  # which loads agents

        return load_tuned(name).agent_in(given)
    if os.path.isfile(path):
        return TrainedAgent(path, given)
    if isinstance(name, str) and ":" in name:
        return make_controller(name, core_of(given).config.system, **parameters)
    if Path(name).suffix in (".zip", ".npz") or len(Path(name).parts) > 1:
        raise ValueError(f"there is no checkpoint {str(name)!r}")
    if not ours:
        raise ValueError(
            f"{name} flies the environments of vessel_gym alone: name random, the path of a"
            " checkpoint, or your own agent as module:object"
        )
    raise ValueError(
        unknown_controller(str(name), env.system, PPO, RANDOM, "the path of a checkpoint")
    )


def _guided(name: str, env: Any, parameters: Mapping[str, float]) -> Agent:
    """A registered controller, which needs estimates and guidance."""
    if env.core.config.options.observe == "measurement":
        raise ValueError(f'the {name} needs estimates: use observe="mean" or "mean+std"')
    if not env.core.config.options.guidance:
        raise ValueError(f"the {name} goes by guidance: leave out guidance")
    made: Agent = make_controller(name, env.system, **parameters)
    return made
