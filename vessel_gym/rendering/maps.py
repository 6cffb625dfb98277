"""Maps: a way to look at north, east and down, to scale, with what lies on every map."""

from dataclasses import dataclass

import numpy as np

from vessel_gym.rendering.canvas import GRID, MUTED, TEXT, WATER, Box, Canvas, nice


@dataclass(frozen=True, eq=False)
class View:
    """A way to look.

    Attributes:
        axes: ``(2, 3)`` what of north, east and down goes up in the picture, and what goes right.
        aside: From the side; otherwise from above.
    """

    axes: np.ndarray
    aside: bool

    def seen(self, points: np.ndarray) -> np.ndarray:
        """Where points ``(..., 3)`` are seen: how far up, how far right [m], ``(..., 2)``."""
        return points @ self.axes.T

    def body(self, pose: np.ndarray, outlines: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """The outline ``(k, 2)`` up and right, of a vehicle that lies as in a `pose` ``(6,)``, about its place.

        From the side it is foreshortened and never upside down; from above a bank narrows it.
        """
        roll, pitch, yaw = pose[3:]
        ahead = np.array([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), -np.sin(pitch)])
        nose = self.axes @ ahead
        outline = outlines[int(self.aside)]
        share = max(float(np.hypot(*nose)), 0.15)
        along = nose / max(float(np.hypot(*nose)), 1e-9)
        across = np.array([-along[1], along[0]])  # to starboard, or down
        across = across * ((1.0 if along[1] >= 0.0 else -1.0) if self.aside else np.cos(roll))
        return outline[:, :1] * share * along + outline[:, 1:] * across


class Frame:
    """A part of a picture in which points up and right [m] are drawn to scale: all of those that are given are in it.

    Args:
        box: Where it lies in the picture.
        points: ``(n, 2)``.
        margins: Pixels of the box that stay free of them: left, top, right, bottom.
        hung: Whether the highest of them lies at the upper margin; otherwise all are in the middle.
    """

    def __init__(
        self, box: Box, points: np.ndarray, margins: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0),
        hung: bool = False,
    ) -> None:  # fmt: skip
        low, high = points.min(0), points.max(0)
        up, right = np.maximum(high - low, 1e-9)
        room = box.inset(*margins)
        self.box = box
        self.scale = float(min(room.width / right, room.height / up))
        """Pixels a metre."""
        self._middle = 0.5 * (low + high)
        high_up = 0.5 * up * self.scale if hung else 0.5 * room.height
        self._centre = np.array([room.left + 0.5 * room.width, room.top + high_up])

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Where points ``(..., 2)`` lie in the picture."""
        offset = (points - self._middle) * self.scale
        return self._centre + offset[..., ::-1] * [1.0, -1.0]


def draw_card(canvas: Canvas, box: Box, title: str, note: str = "") -> Box:
    """The card of a map with its title; returns where the map belongs."""
    canvas.panel(box, WATER)
    width = canvas.text(box.left + 12, box.top + 15, title, TEXT, 12, bold=True)
    canvas.text(box.left + 20 + width, box.top + 15, note, MUTED, 10)
    return box.inset(2, 28, 2, 2)


def draw_grid(canvas: Canvas, frame: Frame, step: float) -> None:
    """Thin lines every ``step`` metres."""
    box, gap, origin = frame.box, frame.scale * step, frame.pixels(np.zeros(2))
    for x in np.arange(box.left + (origin[0] - box.left) % gap, box.right, gap):
        canvas.line(np.array([[x, box.top], [x, box.bottom]]), GRID, 0.5)
    for y in np.arange(box.top + (origin[1] - box.top) % gap, box.bottom, gap):
        canvas.line(np.array([[box.left, y], [box.right, y]]), GRID, 0.5)


def bar_length(frame: Frame) -> float:
    """A round number of metres that takes 50 pixels to 80 or so."""
    return nice(50.0 / frame.scale)


def draw_scale_bar(canvas: Canvas, frame: Frame, note: str) -> None:
    """A bar of a round length with its length in words, in the lower left corner; a remark beside it."""
    metres, left, y = bar_length(frame), frame.box.left + 12, frame.box.bottom - 10
    right = left + metres * frame.scale
    canvas.line(np.array([[left, y - 4], [left, y], [right, y], [right, y - 4]]), MUTED, 1.5)
    canvas.text(right + 8, y - 3, f"{metres:g} m" + (f"   ·   {note}" if note else ""), MUTED, 11)


def draw_north(canvas: Canvas, x: float, y: float) -> None:
    """A north arrow, ``(x, y)`` its middle."""
    canvas.polygon(np.array([[x, y - 12.0], [x + 6.0, y + 12.0], [x, y + 7.0], [x - 6.0, y + 12.0]]), MUTED)
    canvas.text(x, y + 21, "N", MUTED, 11, "centre", bold=True)
