"""Maps: views of north, east and down, to scale, and the common marks of maps."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vessel_gym.rendering.canvas import Box, Canvas, nice
from vessel_gym.rendering.hulls import Hull


@dataclass(frozen=True, eq=False)
class View:
    """Projection of north, east and down onto a map.

    Attributes:
        axes: ``(2, 3)`` directions up and right of the image, in north, east and down.
        aside: Is the view from the side, not from above?
    """

    axes: np.ndarray
    aside: bool

    @property
    def bearing(self) -> float:
        """Direction in the plane that points right, clockwise from north [°]."""
        return float(np.rad2deg(np.arctan2(self.axes[1, 1], self.axes[1, 0])) % 360.0)

    def seen(self, points: np.ndarray) -> np.ndarray:
        """Metres up and right ``(..., 2)`` of points ``(..., 3)``."""
        return points @ self.axes.T

    def body(self, pose: np.ndarray, hull: Hull) -> np.ndarray:
        """Outline ``(k, 2)`` of a vehicle with a `pose` ``(6,)``, in lengths up and right.

        From the side the outline is foreshortened and never upside down; from above a bank narrows
        it.
        """
        roll, pitch, yaw = pose[3:]
        ahead = np.array([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), -np.sin(pitch)])
        nose = self.axes @ ahead
        outline = hull.aside if self.aside else hull.above
        share = max(float(np.hypot(*nose)), 0.15)
        along = nose / max(float(np.hypot(*nose)), 1e-9)
        across = np.array([-along[1], along[0]])  # to starboard, or down
        across = across * ((1.0 if along[1] >= 0.0 else -1.0) if self.aside else np.cos(roll))
        return outline[:, :1] * share * along + outline[:, 1:] * across


def views_of(names: Sequence[str], way: np.ndarray) -> list[View]:
    """Views of vehicles with certain states: from above, from the side, both or none.

    Args:
        names: Names of the components of the state.
        way: ``(2,)`` direction north and east that points right in a view from the side.
    """
    views = [View(np.eye(2, 3), False)] if {"x", "y"} <= set(names) else []
    if "x" in names and {"z", "h"} & set(names):
        along = way / np.hypot(*way) if way.any() else np.array([1.0, 0.0])
        views.append(View(np.array([[0.0, 0.0, -1.0], [*along, 0.0]]), True))
    return views


class Frame:
    """A part of an image in which points up and right [m] are drawn to scale.

    Args:
        box: Box in the image.
        points: ``(n, 2)`` points that the frame must contain.
        margins: Pixels of the box that stay free of points: left, top, right, bottom.
        hung: Does the highest point lie at the upper margin? Otherwise the points are centred.
    """

    def __init__(
        self, box: Box, points: np.ndarray,
        margins: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0), hung: bool = False,
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
        """Pixels of points ``(..., 2)``."""
        offset = (points - self._middle) * self.scale
        return self._centre + offset[..., ::-1] * [1.0, -1.0]


def draw_card(canvas: Canvas, box: Box, title: str, note: str = "") -> Box:
    """Draw the card of a map with its title, and return the box of the map.

    A strip for the scale stays free below the box.
    """
    canvas.panel(box, "water")
    width = canvas.text(box.left + 12, box.top + 15, title, "ink", 12, bold=True)
    canvas.text(box.left + 20 + width, box.top + 15, note, "muted", 10)
    return box.inset(2, 28, 2, 24)


def draw_grid(canvas: Canvas, frame: Frame, step: float) -> None:
    """Draw thin lines every ``step`` metres."""
    box, gap, origin = frame.box, frame.scale * step, frame.pixels(np.zeros(2))
    x = np.arange(box.left + (origin[0] - box.left) % gap, box.right, gap)
    y = np.arange(box.top + (origin[1] - box.top) % gap, box.bottom, gap)
    canvas.segments(
        np.stack([np.stack([x, 0.0 * x + end], -1) for end in (box.top, box.bottom)], 1),
        "grid",
        0.5,
    )
    canvas.segments(
        np.stack([np.stack([0.0 * y + end, y], -1) for end in (box.left, box.right)], 1),
        "grid",
        0.5,
    )


def bar_length(frame: Frame) -> float:
    """Round number of metres of about 50 to 80 pixels."""
    return nice(50.0 / frame.scale)


def draw_scale_bar(canvas: Canvas, frame: Frame, note: str) -> None:
    """Draw a scale bar with its length below the map on the left, and a remark beside it."""
    metres, left, y = bar_length(frame), frame.box.left + 12, frame.box.bottom + 14
    right = left + metres * frame.scale
    canvas.line(np.array([[left, y - 4], [left, y], [right, y], [right, y - 4]]), "muted", 1.5)
    canvas.text(right + 8, y - 3, f"{metres:g} m" + (f"   ·   {note}" if note else ""), "muted", 11)


def draw_north(canvas: Canvas, x: float, y: float) -> None:
    """Draw a north arrow with its middle at ``(x, y)``."""
    canvas.polygon(
        np.array([[x, y - 12.0], [x + 6.0, y + 12.0], [x, y + 7.0], [x - 6.0, y + 12.0]]), "muted"
    )
    canvas.text(x, y + 21, "N", "muted", 11, "centre", bold=True)
