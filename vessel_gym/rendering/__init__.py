"""Images of an episode with pygame, which is imported only when a renderer is made.

One layout serves every task. `vessel_gym.surroundings` describes the surroundings of the vehicle,
and `vessel_gym.rendering.scene` computes the contents of images, also for the pages of
`agents.episodes`.

For contributors: `vessel_gym.rendering` may import the core and surroundings; environments import
it to render.
"""

import os
from typing import Any

from gymnasium.error import DependencyNotInstalled

from vessel_gym.core import Core
from vessel_gym.extras import require

__all__ = ["make_renderer"]


class _WithoutPygame:
    """Stands for a renderer where pygame is missing, and refuses to draw.

    Learners ask for ``render_mode="rgb_array"`` beforehand (``make_vec_env`` of stable-baselines3
    always does) and most never draw.
    """

    def __init__(self, message: str) -> None:
        self._message = message

    def begin(self) -> None:
        """Begin a new episode."""

    def record(self) -> None:
        """Record nothing."""

    def draw(self) -> None:
        """Raise `DependencyNotInstalled`."""
        raise DependencyNotInstalled(self._message)

    def close(self) -> None:
        """Close nothing."""


def make_renderer(core: Core, render_mode: str, fps: int, row: int = 0) -> Any:
    """Make the renderer of an environment.

    Args:
        core: The environment's core.
        render_mode: ``"human"`` (a window) or ``"rgb_array"`` (needs no display).
        fps: Frames a second of the window.
        row: Index of the environment in the batch.

    Returns:
        A `Renderer`. If pygame is missing, its ``draw`` raises `DependencyNotInstalled`.
    """
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")  # no greeting on the terminal
    try:
        require("pygame")
    except ModuleNotFoundError as error:
        return _WithoutPygame(str(error))
    from vessel_gym.rendering.picture import Picture
    from vessel_gym.rendering.renderer import Renderer

    return Renderer(Picture(core, row), render_mode, fps)
