"""Contents of every map: surroundings, tracks, fixes, belief, vehicle."""

import numpy as np

from vessel_gym.rendering.canvas import Canvas, two_sigma
from vessel_gym.rendering.hulls import CIRCLE, HULLS
from vessel_gym.rendering.maps import Frame, View, bar_length, draw_grid
from vessel_gym.rendering.scene import Scene


class Marks:
    """Contents of every map of an episode so far.

    Args:
        scene: Scene of the episode.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene, self.hull = scene, HULLS[scene.surroundings.hull]
        position, located = scene.position, scene.located
        self._spread = (
            np.zeros((3, 3))
            if position.cov is None
            else position.axes.T @ position.cov[-1] @ position.axes
        )
        self._members = None
        if located and position.members is not None:
            self._members = scene.believed[-1, :3] + position.members[-1] @ position.axes
        fixed = np.isfinite(scene.fixes[:, 0]) & located
        self._fixes = scene.true[fixed, :3] + scene.fixes[fixed] @ position.axes

    def cov(self, view: View) -> np.ndarray:
        """Covariance ``(2, 2)`` of the estimated position in a view."""
        return view.axes @ self._spread @ view.axes.T

    def draw(
        self,
        canvas: Canvas,
        frame: Frame,
        view: View,
        size: float,
        mark: float,
        close: bool = False,
    ) -> None:
        """Draw all marks in a frame.

        Args:
            canvas: Canvas.
            frame: Frame with its scale.
            view: View.
            size: Length of the vehicle [pixels].
            mark: Half width of a cross [pixels].
            close: Is the frame a close-up, which shows more of the belief?
        """
        scene, around = self.scene, self.scene.surroundings

        def at(points: np.ndarray) -> np.ndarray:
            return frame.pixels(view.seen(points))

        with canvas.clipped(frame.box):
            draw_grid(canvas, frame, bar_length(frame))
            if view.aside and around.surface is not None:
                _draw_sky(canvas, frame, around.surface, not close)
            for north, east, radius in () if view.aside else around.obstacles:
                canvas.polygon(
                    frame.pixels([north, east] + radius * CIRCLE), "obstacle_pale", "obstacle", 1.0
                )
            if len(around.fairway) and not view.aside:
                canvas.polygon(at(around.fairway), "paper", "muted", 1.0)
            if len(around.path):
                canvas.dashes(at(around.path), "commanded", 1.5)
            canvas.crosses(at(self._fixes), "measurement", mark, 0.35 * mark)
            if around.goal is not None:
                goal, radius = at(np.array(around.goal[:3])), max(around.goal[3] * frame.scale, 4.0)
                canvas.ring(goal, "goal", radius, 1.5)
                canvas.dot(goal, "goal", 2.0)
            if scene.located:
                canvas.line(at(scene.believed[:, :3]), "believed", 1.5)
            canvas.line(at(scene.true[:, :3]), "true", 2.0)
            if not close:
                _draw_start(canvas, at(scene.true[0, :3]))
            self._vehicles(canvas, frame, view, size, close)

    def _vehicles(self, canvas: Canvas, frame: Frame, view: View, size: float, close: bool) -> None:
        """Draw the true vehicle, the estimated vehicle, and the covariance of its position."""
        toward = np.array([[0.0, -1.0], [1.0, 0.0]])  # from up and right to x and y
        true, believed = (
            frame.pixels(view.seen(pose[:3])) + size * view.body(pose, self.hull) @ toward
            for pose in (self.scene.true[-1], self.scene.believed[-1])
        )
        ellipse = frame.pixels(view.seen(self.scene.believed[-1, :3]) + two_sigma(self.cov(view)))
        sure = self._members is not None or np.ptp(ellipse, 0).max() < 1.0
        if not sure:
            canvas.polygon(ellipse, "believed_pale")
        canvas.polygon(true, "true_pale", "true", 1.5)
        if not sure:
            canvas.outline(ellipse, "believed", 1.5)
        if self._members is not None:
            for member in frame.pixels(view.seen(self._members)):
                canvas.dot(member, "member", 1.8 if close else 1.2)
        canvas.outline(believed, "believed", 1.5)
        if close:
            canvas.dot(frame.pixels(view.seen(self.scene.true[-1, :3])), "true", 3.0)
            canvas.dot(frame.pixels(view.seen(self.scene.believed[-1, :3])), "believed", 3.0)

    def draw_icon(self, canvas: Canvas, kind: str, at: np.ndarray) -> None:
        """Draw the icon of an entry of the legend."""
        line, outline = (
            at + [[-14.0, 0.0], [14.0, 0.0]],
            at + self.hull.pixels(22.0, 0.0) * self.hull.above,
        )
        if kind == "true":
            canvas.line(line, "true", 2.0)
            canvas.polygon(outline, "true_pale", "true", 1.2)
        elif kind == "believed":
            canvas.line(line, "believed", 1.5)
            canvas.polygon(outline, "paper", "believed", 1.2)
        elif kind == "cloud":
            for member in ((-9, 1), (-5, -3), (-2, 3), (0, -1), (4, 4), (5, -2), (9, 0)):
                canvas.dot(at + member, "member", 1.5)
        elif kind == "ellipse":
            canvas.polygon(at + CIRCLE * [12.0, 6.0], "believed_pale", "believed", 1.0)
        elif kind == "fix":
            canvas.crosses(at[None], "measurement", 3.5, 1.5)
        elif kind == "start":
            _draw_start(canvas, at)
        elif kind == "path":
            canvas.dashes(line, "commanded", 1.5)
        elif kind == "fairway":
            canvas.polygon(
                at + [[-14.0, -6.0], [14.0, -6.0], [14.0, 6.0], [-14.0, 6.0]], "paper", "muted", 1.0
            )
        elif kind == "goal":
            canvas.ring(at, "goal", 7.0, 1.5)
            canvas.dot(at, "goal", 2.0)
        elif kind == "obstacle":
            canvas.polygon(at + CIRCLE * 7.0, "obstacle_pale", "obstacle", 1.0)


def _draw_sky(canvas: Canvas, frame: Frame, surface: float, named: bool) -> None:
    """Draw all above the water's surface, seen from the side, with the surface's name if asked."""
    box, y = frame.box, float(frame.pixels(np.array([-surface, 0.0]))[1])
    if y > box.top:
        sky = [[box.left, box.top], [box.right, box.top], [box.right, y], [box.left, y]]
        canvas.polygon(np.array(sky), "paper")
        canvas.line(np.array([[box.left, y], [box.right, y]]), "true_soft", 2.0)
        if named:
            canvas.text(box.right - 10, y - 9, "surface", "muted", 10, "right")


def _draw_start(canvas: Canvas, at: np.ndarray) -> None:
    canvas.dot(at, "ink", 4.0)
    canvas.dot(at, "paper", 2.2)
