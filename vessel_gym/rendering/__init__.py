"""Images of an episode with pygame, which is imported only when a renderer is made.

One layout serves every task. `vessel_gym.surroundings` describes the surroundings of the vehicle,
and `vessel_gym.rendering.scene` computes the contents of images, also for the pages of
`agents.episodes`.

For contributors: `vessel_gym.rendering` may import the core and surroundings; environments import
it to render.
"""

import os
from typing import TYPE_CHECKING

from gymnasium.error import DependencyNotInstalled

from vessel_gym.core import Core
from vessel_gym.extras import require

if TYPE_CHECKING:
    from vessel_gym.rendering.renderer import Renderer

__all__ = ["make_renderer"]


def make_renderer(core: Core, render_mode: str, fps: int, row: int = 0) -> "Renderer":
    """Make the renderer of an environment.

    Args:
        core: The environment's core.
        render_mode: ``"human"`` (a window) or ``"rgb_array"`` (needs no display).
        fps: Frames a second of the window.
        row: Index of the environment in the batch.

    Raises:
        DependencyNotInstalled: if pygame is missing.
    """
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")  # no greeting on the terminal
    try:
        require("pygame")
    except ModuleNotFoundError as error:
        raise DependencyNotInstalled(str(error)) from None
    from vessel_gym.rendering.picture import Picture
    from vessel_gym.rendering.renderer import Renderer

    return Renderer(Picture(core, row), render_mode, fps)
