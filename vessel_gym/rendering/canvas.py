"""Boxes, and a canvas for lines, areas, marks and text.

Coordinates are pixels of the finished image, x to the right and y down; points are arrays ``(n,
2)``.
"""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
import pygame

from vessel_gym.rendering.hulls import CIRCLE
from vessel_gym.rendering.palette import LIGHT

Point = tuple[float, float]
Align = Literal["left", "centre", "right"]

_OVERSAMPLING = 2
_FONTS = "dejavusans,segoeui,helveticaneue,arial,liberationsans,notosans,freesans"


@dataclass(frozen=True)
class Box:
    """A rectangle of the image."""

    left: float
    top: float
    width: float
    height: float

    @property
    def right(self) -> float:
        """Right edge."""
        return self.left + self.width

    @property
    def bottom(self) -> float:
        """Lower edge."""
        return self.top + self.height

    def inset(self, left: float, top: float, right: float, bottom: float) -> "Box":
        """Box inside these margins."""
        return Box(
            self.left + left, self.top + top, self.width - left - right, self.height - top - bottom
        )


@lru_cache(maxsize=16)
def _font(size: int, bold: bool) -> pygame.font.Font:
    pygame.font.init()
    pygame.register_quit(
        _font.cache_clear
    )  # fonts become invalid when another environment quits pygame
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # without system fonts, pygame's own font serves
        path = pygame.font.match_font(_FONTS, bold=bold)
    return pygame.font.Font(
        path, size * _OVERSAMPLING if path else round(1.3 * size * _OVERSAMPLING)
    )


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
        self._ink = pygame.Surface((width * _OVERSAMPLING, height * _OVERSAMPLING), depth=32)
        self._page = pygame.Surface(self.size, depth=32)

    def clear(self, colour: str = "page") -> None:
        """Begin a new image."""
        self._ink.fill(LIGHT[colour])

    def finish(self) -> pygame.Surface:
        """Finished image, valid until the next `finish`."""
        pygame.transform.smoothscale(self._ink, self.size, self._page)
        return self._page

    @contextmanager
    def clipped(self, box: Box) -> Iterator[None]:
        """Context in which nothing is drawn outside a box."""
        self._ink.set_clip(_rect(box))
        try:
            yield
        finally:
            self._ink.set_clip(None)

    def panel(self, box: Box, colour: str = "paper") -> None:
        """Draw a card with a thin edge."""
        k, rect = _OVERSAMPLING, _rect(box)
        pygame.draw.rect(self._ink, LIGHT[colour], rect, border_radius=6 * k)
        pygame.draw.rect(self._ink, LIGHT["edge"], rect, width=k, border_radius=6 * k)

    def line(self, points: np.ndarray, colour: str, width: float = 1.5) -> None:
        """Draw a line through points."""
        if len(points) > 1:
            pygame.draw.lines(
                self._ink,
                LIGHT[colour],
                False,
                _scaled(points),
                max(1, round(width * _OVERSAMPLING)),
            )

    def segments(self, ends: np.ndarray, colour: str, width: float = 1.5) -> None:
        """Draw the visible ones of straight lines ``(n, 2, 2)``."""
        clip = np.array(self._ink.get_clip()) / _OVERSAMPLING
        seen = (ends.max(1) >= clip[:2] - width) & (ends.min(1) <= clip[:2] + clip[2:] + width)
        for start, end in _scaled(ends[seen.all(-1)]):
            pygame.draw.line(
                self._ink, LIGHT[colour], start, end, max(1, round(width * _OVERSAMPLING))
            )

    def dashes(
        self, points: np.ndarray, colour: str, width: float = 1.5, on: float = 6.0, off: float = 4.0
    ) -> None:
        """Draw a dashed line through points, with straight dashes."""
        length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
        starts = np.arange(0.0, length[-1], on + off)
        ends = np.minimum(starts + on, length[-1])
        at = [
            np.stack([np.interp(along, length, column) for column in points.T], -1)
            for along in (starts, ends)
        ]
        self.segments(np.stack(at, 1), colour, width)

    def polygon(
        self, points: np.ndarray, colour: str, outline: str | None = None, width: float = 1.0
    ) -> None:
        """Draw a filled polygon, with an outline if it has a colour."""
        pygame.draw.polygon(self._ink, LIGHT[colour], _scaled(points))
        if outline is not None:
            self.outline(points, outline, width)

    def outline(self, points: np.ndarray, colour: str, width: float = 1.0) -> None:
        """Draw a closed line through points."""
        self.line(np.concatenate([points, points[:2]]), colour, width)

    def dot(self, at: Point | np.ndarray, colour: str, radius: float = 3.0) -> None:
        """Draw a filled circle."""
        self.ring(at, colour, radius, 0.0)

    def ring(self, at: Point | np.ndarray, colour: str, radius: float, width: float = 1.5) -> None:
        """Draw a circle, filled if the width is 0."""
        k = _OVERSAMPLING
        pygame.draw.circle(
            self._ink, LIGHT[colour], (at[0] * k, at[1] * k), radius * k, round(width * k)
        )

    def crosses(
        self, points: np.ndarray, colour: str, radius: float = 4.0, width: float = 1.5
    ) -> None:
        """Draw a small x at each point."""
        arms = radius * np.array([[[-1.0, -1.0], [1.0, 1.0]], [[-1.0, 1.0], [1.0, -1.0]]])
        self.segments((points[:, None, None] + arms).reshape(-1, 2, 2), colour, width)

    def text(
        self, x: float, y: float, text: str, colour: str = "ink", size: int = 12,
        align: Align = "left", bold: bool = False,
    ) -> float:  # fmt: skip
        """Write a line of text, vertically centred on ``y``, and return its width."""
        label = _label(text, size, colour, bold)
        width, height = label.get_size()
        left = x * _OVERSAMPLING - {"left": 0.0, "centre": 0.5, "right": 1.0}[align] * width
        self._ink.blit(label, (round(left), round(y * _OVERSAMPLING - 0.5 * height)))
        return width / _OVERSAMPLING


def _rect(box: Box) -> pygame.Rect:
    k = _OVERSAMPLING
    return pygame.Rect(box.left * k, box.top * k, box.width * k, box.height * k)


def _scaled(points: np.ndarray) -> Any:
    return (points * _OVERSAMPLING).tolist()


def nice(value: float) -> float:
    """Smallest of 1, 1.5, 2, 3, 5, 6, 8 times a power of ten that is at least a positive value."""
    power = 10.0 ** np.floor(np.log10(value))
    return next(
        float(step * power)
        for step in (1.0, 1.5, 2.0, 3.0, 5.0, 6.0, 8.0, 10.0)
        if step * power >= value * 0.9999
    )


def signed(value: float) -> str:
    """Number of a scale, with a true minus sign."""
    return f"{value:g}".replace("-", "−")


def two_sigma(cov: np.ndarray) -> np.ndarray:
    """Ellipse ``(48, 2)`` of two standard deviations, of a covariance ``(2, 2)``."""
    values, vectors = np.linalg.eigh(cov)
    return 2.0 * (CIRCLE * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
