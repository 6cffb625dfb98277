"""Pictures of an episode with pygame, which is imported only when a renderer is made.

A task gets a picture by a scene (see `vessel_gym.rendering.renderer.Scene`) and an entry in `make_renderer`.
"""

import os
from collections.abc import Callable
from typing import TYPE_CHECKING

from gymnasium.error import DependencyNotInstalled

from vessel_gym.core import Core
from vessel_gym.extras import require
from vessel_gym.tasks.dive import SpatialDive, VerticalDive
from vessel_gym.tasks.flight import Flight
from vessel_gym.tasks.turning_circle import TurningCircle

if TYPE_CHECKING:
    from vessel_gym.rendering.renderer import Renderer, Scene

__all__ = ["make_renderer"]


def make_renderer(core: Core, render_mode: str, fps: int, row: int = 0) -> "Renderer":
    """The renderer of an environment; its scene is chosen by the task.

    Args:
        core: The environment's core.
        render_mode: ``"human"`` (a window) or ``"rgb_array"`` (needs no display).
        fps: Frames a second that the window keeps.
        row: Which environment of the batch is shown.

    Raises:
        DependencyNotInstalled: without pygame.
        NotImplementedError: for a task that has no scene.
    """
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")  # a library prints no greeting
    try:
        require("pygame")
    except ModuleNotFoundError as error:
        raise DependencyNotInstalled(str(error)) from None
    from vessel_gym.rendering.dive import DiveScene
    from vessel_gym.rendering.flight import FlightScene
    from vessel_gym.rendering.renderer import Renderer
    from vessel_gym.rendering.turning_circle import TurningCircleScene

    scenes: dict[type[object], Callable[[Core, int], Scene]] = {
        TurningCircle: TurningCircleScene,
        SpatialDive: DiveScene,
        VerticalDive: DiveScene,
        Flight: FlightScene,
    }
    task = type(core.task)
    if task not in scenes:
        raise NotImplementedError(f"there is no picture of the task {task.__name__} yet")
    return Renderer(scenes[task](core, row), render_mode, fps)
