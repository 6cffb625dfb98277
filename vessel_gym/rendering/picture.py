"""The image of any task: maps, close-ups of the estimate, charts of states, actions and score."""

import numpy as np

from vessel_gym.core import Core
from vessel_gym.rendering.canvas import Box, Canvas, nice, two_sigma
from vessel_gym.rendering.charts import draw_charts
from vessel_gym.rendering.maps import Frame, View, draw_card, draw_north, draw_scale_bar, views_of
from vessel_gym.rendering.marks import Marks
from vessel_gym.rendering.scene import RECORDED, Scene
from vessel_gym.surroundings import Surroundings, pose, surroundings_of

_GAP = 10.0
_TOP = 402.0  # height of maps and close-ups
_LEFT = 496.0  # width of the maps
_LEGEND = 80.0
_AROUND = np.array([[-1.0, -1.0], [1.0, 1.0]])


class Picture:
    """History and image of one vehicle in an episode.

    States x and y give a map from above; x, and z or h give one from the side. Each map has a
    close-up. Charts of estimates follow.

    Args:
        core: Core of the environment.
        row: Index of the environment in the batch.
    """

    def __init__(self, core: Core, row: int = 0) -> None:
        self.title = core.config.system.name
        self._core, self._row = core, row
        self._surroundings = Surroundings()
        self._history: dict[str, list[np.ndarray]] = {}
        self._views: list[View] = []

    def begin(self) -> None:
        """Begin a new episode in the core's present state, with an empty history."""
        core, row = self._core, self._row
        self._surroundings = surroundings_of(core, core.now.scenario[row])
        start = pose(core.now.state[row : row + 1], core.config.system.vehicle.state_names)[:, :3]
        way = np.concatenate([start, self._surroundings.landmarks])[-1] - start[0]
        self._views = views_of(core.config.system.vehicle.state_names, way[:2])
        self._history = {key: [] for key in (*RECORDED, "action")}

    def record(self) -> None:
        """Append the core's present state to the history."""
        core = self._core
        present = core.happened() | {"action": core.now.action}
        for key, moments in self._history.items():
            moments.append(present[key][self._row].copy())

    @property
    def scene(self) -> Scene:
        """Scene of the episode so far."""
        history, ensemble = (
            {key: np.array(each) for key, each in self._history.items()},
            self._core.now.belief.ensemble,
        )
        if ensemble is not None:
            history["ensemble"] = ensemble[self._row : self._row + 1]
        return Scene(self._core, self._surroundings, history)

    def draw(self, canvas: Canvas) -> None:
        """Draw the whole history on a canvas."""
        canvas.clear()
        scene, (width, height) = self.scene, canvas.size
        marks = Marks(scene)
        box = Box(16, 60, width - 32, height - 76)
        self._header(canvas, Box(box.left, 0, box.width, 60), scene)
        if self._views:
            self._maps(canvas, Box(box.left, box.top, _LEFT, _TOP), marks)
            close = Box(
                box.left + _LEFT + _GAP, box.top, box.width - _LEFT - _GAP, _TOP - _LEGEND - _GAP
            )
            self._close_ups(canvas, close, marks)
            self._legend(canvas, Box(close.left, close.bottom + _GAP, close.width, _LEGEND), marks)
            box = box.inset(0, _TOP + _GAP, 0, 0)
        draw_charts(
            canvas,
            box,
            scene.charts(6 if self._views else 12),
            scene.time,
            self._core.config.system.task.horizon * self._core.config.system.vehicle.dt,
        )

    # --- header -----------------------------------------------------------------------------------

    def _header(self, canvas: Canvas, box: Box, scene: Scene) -> None:
        """Draw conditions, time, distance from the goal, and end of the episode."""
        core, row, goal = self._core, self._row, self._surroundings.goal
        words = [f"estimator {core.config.estimation.filter.name}", *scene.conditions]
        canvas.text(box.left, box.top + 21, self.title, "ink", 17, bold=True)
        canvas.text(box.left, box.top + 44, "   ·   ".join(words), "muted", 13)
        values = {
            "score": f"{core.score[row]:.3f}",
            "time": f"{core.now.steps[row] * core.config.system.vehicle.dt:.1f} s",
        }
        if goal is not None:
            away = float(np.linalg.norm(scene.true[-1, :3] - goal[:3]))
            values["to the goal"] = f"{away:.2f} m" if away < 1.0 else f"{away:.1f} m"
        right, y = box.right, box.top + 32
        for label, value in values.items():
            right -= canvas.text(right, y, value, "ink", 15, "right", bold=True) + 8
            right -= canvas.text(right, y, label, "muted", 13, "right") + 24
        outcome, colour = self._outcome()
        canvas.text(right, y, outcome, colour, 15, "right", bold=True)

    def _outcome(self) -> tuple[str, str]:
        """Outcome of the episode in words, and its colour."""
        task = self._core.config.system.task
        end = task.end_reasons[self._core.now.end[self._row]]
        if end:
            return end, "goal" if end == task.success else "obstacle"
        if self._core.now.steps[self._row] >= task.horizon:
            return "time is up", "obstacle" if task.success else "goal"
        return "under way", "muted"

    # --- maps -------------------------------------------------------------------------------------

    def _maps(self, canvas: Canvas, box: Box, marks: Marks) -> None:
        """Draw the whole track from above and, below that, from the side."""
        points = [self._points(view, marks) for view in self._views]
        heights = [float(np.ptp(each[:, 0])) for each in points]
        share = 1.0 if len(heights) == 1 else float(np.clip(heights[0] / sum(heights), 0.55, 0.7))
        first = share * (box.height - _GAP * (len(points) - 1))
        boxes = box.inset(0, 0, 0, box.height - first), box.inset(0, first + _GAP, 0, 0)
        for view, each, place in zip(self._views, points, boxes, strict=False):
            self._map(canvas, place, view, each, marks)

    def _points(self, view: View, marks: Marks) -> np.ndarray:
        """Points ``(n, 2)`` that a map must show."""
        scene, around = marks.scene, self._surroundings
        points = view.seen(
            np.concatenate([around.landmarks, scene.true[:, :3], scene.believed[:, :3]])
        )
        middle = 0.5 * (points.min(0) + points.max(0))
        parts = [points, middle + 2.0 * around.size * _AROUND]
        if not view.aside:
            parts += [
                around.obstacles[:, :2] + side * around.obstacles[:, 2:] for side in (-1.0, 1.0)
            ]
        elif around.surface is not None:
            parts = [points, np.array([[-around.surface, middle[1]]])]
        return np.concatenate(parts)

    def _map(self, canvas: Canvas, box: Box, view: View, points: np.ndarray, marks: Marks) -> None:
        note = (
            f"to the right is {view.bearing:03.0f}°" if view.aside and len(self._views) > 1 else ""
        )
        sea = draw_card(canvas, box, f"Seen from {'the side' if view.aside else 'above'}", note)
        frame = Frame(
            sea,
            points,
            (22.0, 22.0, 22.0, 16.0),
            view.aside and self._surroundings.surface is not None,
        )
        length = self._surroundings.size * frame.scale
        size = marks.hull.pixels(length, marks.hull.least)
        marks.draw(canvas, frame, view, size, 3.0)
        magnified = marks.hull.scaled and size > 1.05 * length
        draw_scale_bar(canvas, frame, f"vehicle drawn {size / length:.2g}×" if magnified else "")
        if not view.aside:
            draw_north(canvas, box.right - 20, box.top + 24)

    def _close_ups(self, canvas: Canvas, box: Box, marks: Marks) -> None:
        """Draw close-ups of the estimated vehicle, to scale."""
        count, size = len(self._views), self._surroundings.size
        width = (box.width - _GAP * (count - 1)) / count
        for i, view in enumerate(self._views):
            title = (
                "Close-up"
                if count == 1
                else f"Close-up from {'the side' if view.aside else 'above'}"
            )
            sea = draw_card(
                canvas, Box(box.left + i * (width + _GAP), box.top, width, box.height), title
            )
            true, believed = (
                view.seen(each[-1, :3]) for each in (marks.scene.true, marks.scene.believed)
            )
            away, spread = (
                float(np.abs(each).max()) for each in (true - believed, two_sigma(marks.cov(view)))
            )
            half = nice(max(marks.hull.near * size, away + 0.5 * size, 1.5 * spread))
            frame = Frame(sea, believed + half * _AROUND)
            marks.draw(
                canvas, frame, view, marks.hull.pixels(size * frame.scale, 14.0), 4.5, close=True
            )
            draw_scale_bar(canvas, frame, "")

    def _legend(self, canvas: Canvas, box: Box, marks: Marks) -> None:
        """Draw the legend of the marks."""
        canvas.panel(box)
        labels = marks.scene.legend
        if "cloud" in labels:
            labels.pop("ellipse", None)  # the members show it
        wide = (box.width - 12) / -(-len(labels) // 3)
        for i, (kind, label) in enumerate(labels.items()):
            at = np.array([box.left + 28 + (i // 3) * wide, box.top + 16 + (i % 3) * 24])
            canvas.text(at[0] + 22, at[1], label, "ink", 11)
            marks.draw_icon(canvas, kind, at)
