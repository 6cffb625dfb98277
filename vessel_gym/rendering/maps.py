"""Maps: views of north, east and down, to scale, with their marks."""

from typing import Any

import numpy as np
import pygame

from vessel_gym.processes import root_of
from vessel_gym.rendering.canvas import Canvas
from vessel_gym.rendering.hulls import CIRCLE, HULLS
from vessel_gym.rendering.scene import Scene, nice

STYLES: dict[str, tuple[Any, ...]] = {
    "surface": (Canvas.line, "true_soft", 2.0),
    "fairway": (Canvas.polygon, "paper", "muted"),
    "obstacle": (Canvas.polygon, "obstacle_pale", "obstacle"),
    "path": (Canvas.dashes, "commanded"),
    "fix": (Canvas.crosses, "measurement"),
    "goal": (Canvas.polygon, None, "goal"),
    "believed track": (Canvas.line, "believed"),
    "true track": (Canvas.line, "true", 2.0),
    "start": (Canvas.dots, "ink", 4.0),
    "true": (Canvas.polygon, "true_pale", "true"),
    "ellipse": (Canvas.polygon, None, "believed"),
    "cloud": (Canvas.dots, "member", 1.4),
    "believed": (Canvas.polygon, None, "believed"),
}
"""Method of a canvas that draws each kind of marks, with its colours and width."""
_LINE = np.array([[-14.0, 0.0], [14.0, 0.0]])
ICONS = {
    "ellipse": CIRCLE * [12.0, 6.0],
    "cloud": np.array([[-9, 1], [-5, -3], [-2, 3], [0, -1], [4, 4], [5, -2], [9, 0]], float),
    "fix": np.zeros((1, 2)),
    "start": np.zeros((1, 2)),
    "fairway": np.array([[-14.0, -6.0], [14.0, -6.0], [14.0, 6.0], [-14.0, 6.0]]),
    "goal": 7.0 * CIRCLE,
    "obstacle": 7.0 * CIRCLE,
}
"""Points of the marks of a legend; others are lines."""


def draw_mark(canvas: Canvas, kind: str, points: np.ndarray) -> None:
    """Draw a mark, from the pixels ``(n, 2)`` of its outline, its line or its places."""
    draw, *style = STYLES[kind]
    draw(canvas, points, *style)


def draw_icon(canvas: Canvas, kind: str, hull: str, at: np.ndarray) -> None:
    """Draw the icon of an entry of a legend at a pixel ``(2,)``."""
    if f"{kind} track" in STYLES:
        draw_mark(canvas, f"{kind} track", at + _LINE)
        draw_mark(canvas, kind, at + 22.0 * HULLS[hull].above)
    else:
        draw_mark(canvas, kind, at + ICONS.get(kind, _LINE))


def views(scene: Scene) -> list[np.ndarray]:
    """Directions up and right ``(2, 3)`` of the maps of a scene: from above and from the side.

    To the right of the view from the side lies the last of the landmarks.
    """
    names, start = scene.core.config.system.vehicle.state_names, scene.true[0, :3]
    found = [np.eye(2, 3)] if {"x", "y"} <= set(names) else []
    if "x" in names and {"z", "h"} & set(names):
        north, east, _ = np.vstack([start, scene.workspace.landmarks])[-1] - start
        bearing = np.arctan2(east, north)
        found.append(np.array([[0.0, 0.0, -1.0], [np.cos(bearing), np.sin(bearing), 0.0]]))
    return found


class Map:
    """A view of a scene, to scale, in which tracks and landmarks have room.

    Args:
        scene: Scene of the episode.
        axes: ``(2, 3)`` directions up and right of the image, in north, east and down.
        box: Box in the image.

    Attributes:
        middle: Metres up and right ``(2,)`` in the middle of the box.
        scale: Pixels of a metre.
        size: Length of the drawn vehicle [m], which a small scale enlarges.
    """

    def __init__(self, scene: Scene, axes: np.ndarray, box: pygame.Rect) -> None:
        self.scene, self.axes, self.box, self.aside = scene, axes, box, bool(axes[0, 2])
        around, start = scene.workspace, scene.true[0, :3]
        self.hull = HULLS[around.hull]
        points = [around.landmarks, scene.true[:, :3], scene.believed[:, :3]]
        points += [start + side * around.size * np.ones((1, 3)) for side in (-2.0, 2.0)]
        if not self.aside:
            obstacles = around.obstacles
            points += [obstacles * [1, 1, 0] + side * obstacles[:, 2:] for side in (-1.0, 1.0)]
        elif around.surface is not None:
            points.append(np.array([[*start[:2], around.surface]]))
        seen = np.concatenate(points) @ axes.T
        low, high = seen.min(0), seen.max(0)
        room = np.array([box.height - 84.0, box.width - 48.0])
        self.scale = float((room / np.maximum(high - low, 1e-9)).min())
        self.middle = 0.5 * (low + high)
        least = self.hull.least / self.scale
        self.size = max(around.size, least) if self.hull.scaled else least

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Pixels ``(..., 2)`` of points ``(..., 3)``."""
        offset = self.scale * (points @ self.axes.T - self.middle)
        return offset[..., ::-1] * [1.0, -1.0] + self.box.center

    def outline(self, pose: np.ndarray) -> np.ndarray:
        """Pixels ``(k, 2)`` of the outline of a vehicle with a `pose` ``(6,)``.

        From above a bank narrows the outline.
        """
        (roll, pitch, yaw), hull = pose[3:], self.hull
        level = np.array([np.cos(yaw), np.sin(yaw), 0.0])
        ahead = np.cos(pitch) * level - [0.0, 0.0, np.sin(pitch)]
        starboard = np.cos(roll) * np.array([-np.sin(yaw), np.cos(yaw), 0.0])
        down = np.sin(pitch) * level + [0.0, 0.0, np.cos(pitch)]
        across = hull.height * down if self.aside else starboard
        return self.pixels(pose[:3] + self.size * (hull.above @ [ahead, across]))

    def marks(self) -> dict[str, list[np.ndarray]]:
        """Pixels ``(n, 2)`` of the marks of each kind."""
        scene, around, at = self.scene, self.scene.workspace, self.pixels
        true, believed = scene.true[:, :3], scene.believed[:, :3]
        marks = {
            "path": [at(around.path)], "true track": [at(true)], "start": [at(true[:1])],
            "true": [self.outline(scene.true[-1])], "believed": [self.outline(scene.believed[-1])],
        }  # fmt: skip
        if not self.aside:
            marks["fairway"], level = [at(around.fairway)], around.obstacles * [1.0, 1.0, 0.0]
            sizes = self.scale * around.obstacles[:, 2]
            marks["obstacle"] = [at(p) + r * CIRCLE for p, r in zip(level, sizes, strict=True)]
        elif around.surface is not None:
            ends = np.array([[self.box.left, 0.0], [self.box.right, 0.0]])
            marks["surface"] = [ends + [0.0, at(np.array([0.0, 0.0, around.surface]))[1]]]
        if around.goal is not None:
            *goal, radius = around.goal
            marks["goal"] = [at(np.array(goal)) + max(self.scale * radius, 4.0) * CIRCLE]
        if scene.located:
            marks["believed track"] = [at(believed)]
            marks |= self._belief()
        return marks

    def _belief(self) -> dict[str, list[np.ndarray]]:
        """Pixels of position fixes, and of the covariance and ensemble about the estimate."""
        scene, position, at = self.scene, self.scene.position, self.pixels
        last, fixed = scene.believed[-1, :3], np.isfinite(scene.fixes[:, 0])
        marks = {"fix": [at(scene.true[fixed, :3] + scene.fixes[fixed] @ position.axes)]}
        if position.cov is not None:
            seen = self.axes @ position.axes.T
            ellipse = 2.0 * CIRCLE @ root_of(seen @ position.cov[-1] @ seen.T).T
            marks["ellipse"] = [at(last + ellipse @ self.axes)]
        if position.members is not None:
            marks["cloud"] = [at(last + position.members[-1] @ position.axes)]
        return marks

    def draw(self, canvas: Canvas) -> None:
        """Draw the card of the map: marks, title and scale bar."""
        box, marks = self.box, self.marks()
        canvas.panel(box, "water")
        canvas.clip(box.inflate(-4, -4))
        for kind in STYLES:
            for points in marks.get(kind, ()):
                if len(points):
                    draw_mark(canvas, kind, points)
        canvas.clip(None)
        self._notes(canvas)

    def _notes(self, canvas: Canvas) -> None:
        """Write the title, and draw a scale bar."""
        box, metres = self.box, nice(50.0 / self.scale)
        bearing = np.rad2deg(np.arctan2(self.axes[1, 1], self.axes[1, 0])) % 360.0
        way = f"the side, {bearing:03.0f}° to the right" if self.aside else "above, north up"
        canvas.text(box.left + 12, box.top + 15, f"Seen from {way}", bold=True)
        left, y = box.left + 12, box.bottom - 12
        right = left + metres * self.scale
        bar = [[left, y - 4], [left, y], [right, y], [right, y - 4]]
        canvas.line(np.array(bar), "muted")
        magnified = self.size / self.scene.workspace.size
        enlarged = self.hull.scaled and magnified > 1.05
        note = f"   ·   vehicle drawn {magnified:.2g}×" if enlarged else ""
        canvas.text(right + 8, y - 3, f"{metres:g} m{note}", "muted", 11)
