"""History of an episode, drawn into arrays or a window."""

from typing import Any

import numpy as np
from gymnasium.error import DependencyNotInstalled

from vessel_gym.extras import require
from vessel_gym.rendering.scene import RECORDED, Scene
from vessel_gym.simulation.core import Core
from vessel_gym.tasks.task import Workspace


class Renderer:
    """History of one vehicle in an episode, and its image.

    Learners ask for images beforehand (``make_vec_env`` of stable-baselines3 always does) and most
    never draw: pygame is needed to draw alone.

    Args:
        core: The environment's core.
        render_mode: ``"human"`` (a window) or ``"rgb_array"`` (needs no display).
        fps: Frames a second of the window.
        row: Index of the environment in the batch.
    """

    def __init__(self, core: Core, render_mode: str, fps: int, row: int = 0) -> None:
        self._core, self._human, self._fps, self._row = core, render_mode == "human", fps, row
        self._workspace = Workspace()
        self._history: dict[str, list[np.ndarray]] = {}
        self._window: Any = None

    def __getstate__(self) -> dict[str, Any]:
        """A copy keeps the history and opens a window of its own."""
        return vars(self) | {"_window": None}

    def record(self, begin: bool) -> None:
        """Append the core's present state to the history, which begins anew if asked."""
        core, row = self._core, self._row
        if begin:
            self._workspace = core.config.system.task.workspace(core.now.scenario[row])
            self._history = {key: [] for key in RECORDED}
        present = core.info()
        for key, moments in self._history.items():
            moments.append(present[key][row].copy())

    @property
    def scene(self) -> Scene:
        """Scene of the episode so far."""
        history = {key: np.array(each) for key, each in self._history.items()}
        ensemble = self._core.now.belief.ensemble
        if ensemble is not None:
            history["ensemble"] = ensemble[self._row : self._row + 1]
        return Scene(self._core, self._workspace, history)

    def draw(self) -> np.ndarray | None:
        """Return the image ``(height, width, 3)``, or update the window in mode ``"human"``.

        Raises:
            DependencyNotInstalled: without pygame.
        """
        try:
            require("pygame")
        except ModuleNotFoundError as error:
            raise DependencyNotInstalled(str(error)) from error
        from vessel_gym.rendering.canvas import Window
        from vessel_gym.rendering.picture import draw_picture

        canvas = draw_picture(self.scene, self._row)
        if not self._human:
            return canvas.pixels()
        if self._window is None:
            self._window = Window(self._core.config.system.name, canvas.size, self._fps)
        self._window.show(canvas)
        return None

    def close(self) -> None:
        """Close the window, if one is open; later images are dropped."""
        if self._window is not None:
            self._window.close()
