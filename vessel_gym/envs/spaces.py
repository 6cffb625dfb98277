"""Spaces that both faces of an environment share."""

import numpy as np
from gymnasium.spaces import Box

from vessel_gym.core import Core


def observation_space(core: Core) -> Box:
    """Finite float32 bounds: observations are scaled to be of order 1 and clipped."""
    return Box(-core.task.BOUND, core.task.BOUND, (core.observation_size,), np.float32)


def action_space(core: Core) -> Box:
    """float32 in [-1, 1]: shares of what the actuators can do."""
    return Box(-1.0, 1.0, (core.action_size,), np.float32)
