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
    "cloud": (Canvas.dots, "member", 1.8),
    "believed": (Canvas.polygon, None, "believed"),
}
"""Method of a canvas that draws each kind of marks, with its colours and width."""
ICONS: dict[Any, np.ndarray] = {
    **dict.fromkeys((Canvas.line, Canvas.dashes), np.array([[-14.0, 0.0], [14.0, 0.0]])),
    Canvas.polygon: 7.0 * CIRCLE,
    **dict.fromkeys((Canvas.dots, Canvas.crosses), np.zeros((1, 2))),
}
"""Pixels of a mark in a legend, by the method that draws it."""


def draw_mark(canvas: Canvas, kind: str, points: np.ndarray) -> None:
    """Draw a mark, from the pixels ``(n, 2)`` of its outline, its line or its places."""
    draw, *style = STYLES[kind]
    draw(canvas, points, *style)


def draw_icon(canvas: Canvas, kind: str, hull: str, at: np.ndarray) -> None:
    """Draw the icon of an entry of a legend at a pixel ``(2,)``."""
    vehicle = kind in ("true", "believed")
    draw_mark(canvas, kind, at + (22.0 * HULLS[hull].above if vehicle else ICONS[STYLES[kind][0]]))


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
        self.size = max(around.size, self.hull.least / self.scale)

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Pixels ``(..., 2)`` of points ``(..., 3)``."""
        offset = self.scale * (points @ self.axes.T - self.middle)
        return offset[..., ::-1] * [1.0, -1.0] + self.box.center

    def outline(self, pose: np.ndarray) -> np.ndarray:
        """Outline ``(k, 3)`` of a vehicle with a `pose` ``(6,)``, in north, east and down.

        From above a bank narrows the outline.
        """
        (roll, pitch, yaw), down = pose[3:], np.array([0.0, 0.0, 1.0])
        level = np.array([np.cos(yaw), np.sin(yaw), 0.0])
        ahead = np.cos(pitch) * level - np.sin(pitch) * down
        if self.aside:
            across = self.hull.height * (np.sin(pitch) * level + np.cos(pitch) * down)
        else:
            across = np.cos(roll) * np.cross(down, level)
        return pose[:3] + self.size * (self.hull.above @ [ahead, across])

    def marks(self) -> dict[str, list[np.ndarray]]:
        """Points ``(n, 3)`` of the marks of each kind, in north, east and down."""
        scene, around, circle = self.scene, self.scene.workspace, CIRCLE @ self.axes
        marks = {
            "path": [around.path], "true track": [scene.true[:, :3]], "start": [scene.true[:1, :3]],
            "true": [self.outline(scene.true[-1])], "believed": [self.outline(scene.believed[-1])],
        }  # fmt: skip
        if not self.aside:
            marks["fairway"] = [around.fairway]
            marks["obstacle"] = [[n, e, 0.0] + r * circle for n, e, r in around.obstacles]
        elif around.surface is not None:
            far = self.box.width / self.scale * np.outer([-1.0, 1.0], self.axes[1])
            marks["surface"] = [[*scene.true[0, :2], around.surface] + far]
        if around.goal is not None:
            *goal, radius = around.goal
            marks["goal"] = [goal + max(radius, 4.0 / self.scale) * circle]
        return marks | self._belief() if scene.located else marks

    def _belief(self) -> dict[str, list[np.ndarray]]:
        """Points of position fixes, and of the track, covariance and ensemble of the estimate."""
        scene, position = self.scene, self.scene.position
        track, fixed = scene.believed[:, :3], np.isfinite(scene.fixes[:, 0])
        fixes = scene.true[fixed, :3] + scene.fixes[fixed] @ position.axes
        marks = {"believed track": [track], "fix": [fixes]}
        if position.cov is not None:
            seen = self.axes @ position.axes.T
            ellipse = 2.0 * CIRCLE @ root_of(seen @ position.cov[-1] @ seen.T).T
            marks["ellipse"] = [track[-1] + ellipse @ self.axes]
        if position.members is not None:
            marks["cloud"] = [track[-1] + position.members[-1] @ position.axes]
        return marks

    def draw(self, canvas: Canvas) -> None:
        """Draw the card of the map: marks, title and scale bar."""
        box, marks = self.box, self.marks()
        canvas.panel(box, "water")
        canvas.clip(box.inflate(-4, -4))
        for kind in STYLES:
            for points in marks.get(kind, ()):
                if len(points):
                    draw_mark(canvas, kind, self.pixels(points))
        canvas.clip(None)
        self._notes(canvas)

    def _notes(self, canvas: Canvas) -> None:
        """Write the title, and draw a scale bar."""
        box, metres = self.box, nice(50.0 / self.scale)
        title = "Seen from the side" if self.aside else "Seen from above, north up"
        canvas.text(box.left + 12, box.top + 15, title, bold=True)
        left, y = box.left + 12, box.bottom - 12
        right = left + metres * self.scale
        canvas.line(np.array([[left, y], [right, y]]), "muted", 3.0)
        magnified = self.size / self.scene.workspace.size
        note = f"   ·   vehicle drawn {magnified:.2g}×" if magnified > 1.05 else ""
        canvas.text(right + 8, y, f"{metres:g} m{note}", "muted", 11)
