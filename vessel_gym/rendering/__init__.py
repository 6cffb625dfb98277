"""Pictures of an episode with pygame, which is imported only when a renderer is made.

A task gets a picture of its own by a scene (see `vessel_gym.rendering.renderer.Scene`) that is registered for it;
without one it has the plain scene, which knows no more of it than every task says.
"""

import os
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

from gymnasium.error import DependencyNotInstalled

from vessel_gym.core import Core
from vessel_gym.extras import require
from vessel_gym.registry import Registry

if TYPE_CHECKING:
    from vessel_gym.rendering.renderer import Renderer, Scene

__all__ = ["make_renderer", "register_scene"]

MakeScene = Callable[[Core, int], "Scene"]
"""Makes a scene of a core and the row that is shown."""
S = TypeVar("S", bound=MakeScene)


def _ours() -> None:
    from vessel_gym.rendering import dive, flight, turning_circle  # noqa: F401


SCENES: Registry[MakeScene] = Registry("scene", _ours)


def register_scene(task_type: type) -> Callable[[S], S]:
    """A decorator that makes a class the scene of a kind of task, and of its subclasses.

    Args:
        task_type: The class of the task.

    Raises:
        TypeError: for a task type that is no class.
        ValueError: if the task has a scene from another module.
    """

    def register(scene: S) -> S:
        SCENES.register(task_type, scene, scene.__module__)
        return scene

    return register


def make_renderer(core: Core, render_mode: str, fps: int, row: int = 0) -> "Renderer":
    """The renderer of an environment; its scene is chosen by the task.

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
    from vessel_gym.rendering.plain import PlainScene
    from vessel_gym.rendering.renderer import Renderer

    scene = SCENES.of(core.task).get("", PlainScene)
    return Renderer(scene(core, row), render_mode, fps)
