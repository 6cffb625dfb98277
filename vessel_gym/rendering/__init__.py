"""Pictures of an episode with pygame, which is imported only when a renderer is made.

There is one picture for every task; `vessel_gym.surroundings` describes what lies around the
vehicle, and `vessel_gym.rendering.scene` computes what pictures show, for the page of
`agents.episodes` too.

It may import the core and surroundings; environments import it when one is rendered.
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
    """The renderer of an environment.

    Args:
        core: The environment's core.
        render_mode: ``"human"`` (a window) or ``"rgb_array"`` (needs no display).
        fps: Frames a second that the window keeps.
        row: Which environment of the batch is shown.

    Raises:
        DependencyNotInstalled: without pygame.
    """
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")  # a library prints no greeting
    try:
        require("pygame")
    except ModuleNotFoundError as error:
        raise DependencyNotInstalled(str(error)) from None
    from vessel_gym.rendering.picture import Picture
    from vessel_gym.rendering.renderer import Renderer

    return Renderer(Picture(core, row), render_mode, fps)
