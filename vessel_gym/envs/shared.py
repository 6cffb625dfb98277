"""Common parts of single and vector environments: spaces and checks of arguments."""

from collections.abc import Mapping
from dataclasses import fields
from inspect import getfullargspec
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box

from estimators.factory import unknown
from vessel_gym.checks import one_of
from vessel_gym.models.state_space import StateSpace
from vessel_gym.simulation.configuration import Options
from vessel_gym.simulation.core import Core


def observation_space(core: Core) -> Box:
    """Finite float32 bounds of scaled, clipped observations."""
    bound = core.config.system.task.BOUND
    return Box(-bound, bound, (core.config.observation_size,), np.float32)


def action_space(core: Core) -> Box:
    """float32 in [-1, 1]: shares of the actuators' ranges."""
    return Box(-1.0, 1.0, (core.config.action_size,), np.float32)


def check_arguments(env: Any, options: Mapping[str, Any], render_mode: str | None) -> None:
    """Refuse unknown arguments of an environment.

    Raises:
        TypeError: naming the first unknown option and the known ones.
        ValueError: for an unknown render mode.
    """
    known = [field.name for field in fields(Options)]
    for option in options:
        if option not in known:
            own: dict[str, None] = {}
            for base in type(env).__mro__:
                spec = getfullargspec(base.__init__)  # type: ignore[misc]
                own |= dict.fromkeys(spec.args[1:] + spec.kwonlyargs)
            # Python's words, which other libraries look for
            python = f"{type(env).__name__}.__init__() got an unexpected"
            raise TypeError(unknown("keyword argument", option, [*own, *known], python))
    if render_mode is not None:
        one_of("render_mode", render_mode, env.metadata["render_modes"])


def first_seed(env: gym.Env | gym.vector.VectorEnv, core: Core) -> int | None:
    """Seed of ``np_random_seed`` for a first episode without a seed; None for later episodes."""
    if core.seeds:
        return None
    seed = env.np_random_seed
    return None if seed == -1 else seed  # -1: np_random was set from outside


BESIDE_BIASES = 1e-6
"""Radius of `robust-kf` that suits slow biases.

The ball enlarges the largest standard deviation of a prediction by 0.07 % a step, which is less
than the slowest bias of a sensor returns to zero.
"""
_OF_UNKNOWN_INPUTS = ("kf-umv-ui", "kf-umv-ui-wdf", "ekf-ui-wdf", "ukf-umv", "ulise")
"""Filters with a prior of the unknown input, which must be true where no measurement shows it."""


def tuning(name: str, space: StateSpace) -> dict[str, Any]:
    """Options of filters: the variance of the unknown input, and the radius of `robust-kf`."""
    if name == "robust-kf":
        return {"radius": BESIDE_BIASES}
    if name in _OF_UNKNOWN_INPUTS and space.inputs:
        return {"input_prior": space.input_cov}
    return {}
