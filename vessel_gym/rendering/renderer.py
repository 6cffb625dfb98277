"""A window or an array with the image of an episode."""

from functools import cache
from typing import Any

import numpy as np
import pygame

from vessel_gym.rendering.canvas import Canvas
from vessel_gym.rendering.picture import Picture

SIZE = 1008, 720
"""Width and height of an image; video codecs need multiples of 16."""


@cache
def _canvas() -> Canvas:
    """The canvas of all images, which is copied after each drawing."""
    return Canvas(*SIZE)


class Renderer:
    """Draw an episode into an array, or into a window that the user may close at any time.

    Args:
        picture: Image of an episode.
        render_mode: ``"human"`` or ``"rgb_array"``.
        fps: Frames a second of the window.
    """

    def __init__(self, picture: Picture, render_mode: str, fps: int) -> None:
        self._picture, self._render_mode, self._fps = picture, render_mode, fps
        self._human = render_mode == "human"
        self._window: pygame.Surface | None = None
        self._clock = pygame.time.Clock()
        if self._human:
            pygame.display.init()
            pygame.display.set_caption(picture.title)
            self._window = pygame.display.set_mode(SIZE)

    def __reduce__(self) -> tuple[Any, ...]:
        """A copy keeps the history and opens a window of its own."""
        return type(self), (self._picture, self._render_mode, self._fps)

    def begin(self) -> None:
        """Begin a new episode."""
        self._picture.begin()

    def record(self) -> None:
        """Append the present state to the episode's history."""
        self._picture.record()

    def draw(self) -> np.ndarray | None:
        """Return the image ``(height, width, 3)``, or update the window in mode ``"human"``."""
        if not self._human:
            self._picture.draw(_canvas())
            pixels = pygame.image.tobytes(_canvas().finish(), "RGB")
            return np.frombuffer(pixels, np.uint8).reshape(*SIZE[::-1], 3).copy()
        if self._window is not None and any(
            event.type == pygame.QUIT for event in pygame.event.get()
        ):
            self.close()
        if self._window is not None:
            self._picture.draw(_canvas())
            self._window.blit(_canvas().finish(), (0, 0))
            pygame.display.flip()
            self._clock.tick(self._fps)
        return None

    def close(self) -> None:
        """Close the window, if one is open; later images are dropped."""
        if self._window is not None:
            self._window = None
            pygame.display.quit()
