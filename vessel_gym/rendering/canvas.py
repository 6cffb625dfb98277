"""A canvas for lines, areas, marks and text, and a window that shows it.

Coordinates are pixels of the finished image, x to the right and y down; points are arrays ``(n,
2)``. Colours are names in `vessel_gym.rendering.palette`.
"""

import os
import warnings
from functools import lru_cache

import numpy as np

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")  # no greeting on the terminal
import pygame

from vessel_gym.rendering.palette import LIGHT

_K = 2  # oversampling
_FONTS = "dejavusans,segoeui,helveticaneue,arial,liberationsans,notosans,freesans"


@lru_cache(maxsize=16)
def _font(size: int, bold: bool) -> pygame.font.Font:
    pygame.font.init()
    # fonts become invalid when another environment quits pygame
    pygame.register_quit(_font.cache_clear)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # without system fonts, pygame's own font serves
        return pygame.font.SysFont(_FONTS, _K * size, bold)


@lru_cache(maxsize=1024)
def _label(text: str, size: int, colour: str, bold: bool) -> pygame.Surface:
    return _font(size, bold).render(text, True, LIGHT[colour])


class Canvas:
    """An image in memory, drawn oversampled and scaled down.

    Args:
        width: Width of the finished image [pixels].
        height: Height of the finished image [pixels].
    """

    def __init__(self, width: int, height: int) -> None:
        self.size = width, height
        self._ink = pygame.Surface((_K * width, _K * height), depth=32)

    def clear(self) -> None:
        """Begin a new image."""
        self._ink.fill(LIGHT["page"])

    def finish(self) -> pygame.Surface:
        """Finished image."""
        return pygame.transform.smoothscale(self._ink, self.size)

    def pixels(self) -> np.ndarray:
        """Finished image as an array ``(height, width, 3)``."""
        return pygame.surfarray.array3d(self.finish()).swapaxes(0, 1).copy()

    def clip(self, box: pygame.Rect | None) -> None:
        """Draw nothing outside a box from now on; None: draw everywhere."""
        self._ink.set_clip(None if box is None else _oversampled(box))

    def panel(self, box: pygame.Rect, colour: str = "paper") -> None:
        """Draw a card with a thin edge."""
        for each, width in ((colour, 0), ("edge", _K)):
            pygame.draw.rect(self._ink, LIGHT[each], _oversampled(box), width, border_radius=6 * _K)

    def line(self, points: np.ndarray, colour: str, width: float = 1.5) -> None:
        """Draw a line through points."""
        if len(points) > 1:
            scaled = (_K * points).tolist()
            pygame.draw.lines(self._ink, LIGHT[colour], False, scaled, round(_K * width))

    def dashes(self, points: np.ndarray, colour: str) -> None:
        """Draw a dashed line through points, with straight dashes."""
        along = np.cumsum(np.hypot(*np.diff(points, axis=0, prepend=points[:1]).T))
        for start in np.arange(0.0, along[-1], 10.0):
            ends = start, start + 6.0
            self.line(np.stack([np.interp(ends, along, column) for column in points.T], -1), colour)

    def polygon(self, points: np.ndarray, colour: str | None, edge: str) -> None:
        """Draw a polygon with an edge, filled if it has a colour."""
        if colour is not None:
            pygame.draw.polygon(self._ink, LIGHT[colour], (_K * points).tolist())
        self.line(np.concatenate([points, points[:2]]), edge)

    def dots(self, points: np.ndarray, colour: str, radius: float) -> None:
        """Draw a filled circle at each point."""
        for point in _K * points:
            pygame.draw.circle(self._ink, LIGHT[colour], point.tolist(), _K * radius)

    def crosses(self, points: np.ndarray, colour: str) -> None:
        """Draw a small x at each point."""
        for arm in np.array([[3.0, 3.0], [3.0, -3.0]]):
            for point in points:
                self.line(np.stack([point - arm, point + arm]), colour, 1.0)

    def text(
        self, x: float, y: float, text: str, colour: str = "ink", size: int = 12,
        anchor: float = 0.0, bold: bool = False,
    ) -> None:  # fmt: skip
        """Write a line of text, vertically centred on ``y``.

        The share ``anchor`` of its width lies to the left of ``x``.
        """
        label = _label(text, size, colour, bold)
        width, height = label.get_size()
        self._ink.blit(label, (round(_K * x - anchor * width), round(_K * y - 0.5 * height)))


def _oversampled(box: pygame.Rect) -> pygame.Rect:
    return pygame.Rect(*(_K * each for each in box))


class Window:
    """A window that the user may close at any time; later images are dropped.

    Args:
        title: Title of the window.
        size: Width and height [pixels].
        fps: Frames a second.
    """

    def __init__(self, title: str, size: tuple[int, int], fps: int) -> None:
        pygame.display.init()
        pygame.display.set_caption(title)
        self._fps, self._clock = fps, pygame.time.Clock()
        self._surface: pygame.Surface | None = pygame.display.set_mode(size)

    def show(self, canvas: Canvas) -> None:
        """Show the image of a canvas."""
        if self._surface and any(event.type == pygame.QUIT for event in pygame.event.get()):
            self.close()
        if self._surface:
            self._surface.blit(canvas.finish(), (0, 0))
            pygame.display.flip()
            self._clock.tick(self._fps)

    def close(self) -> None:
        """Close the window, if it is open."""
        if self._surface:
            self._surface = None
            pygame.display.quit()
