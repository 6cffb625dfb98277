"""The picture of any task: maps, a close-up of what the estimator believes, charts of state, actions and score."""

import numpy as np

from estimators.angles import difference
from vessel_gym.core import Core
from vessel_gym.rendering import palette
from vessel_gym.rendering.canvas import Box, Canvas, nice, two_sigma
from vessel_gym.rendering.charts import Chart, Series, comparison, draw_charts, error
from vessel_gym.rendering.journey import Journey, Moment
from vessel_gym.rendering.maps import Frame, View, draw_card, draw_north, draw_scale_bar, views_of
from vessel_gym.rendering.marks import Marks
from vessel_gym.rendering.palette import Colour
from vessel_gym.surroundings import Surroundings, in_words, pose, surroundings_of

_GAP = 10.0
_TOP = 402.0  # height of maps and close-ups
_LEFT = 496.0  # width of the maps
_LEGEND = 80.0
_AROUND = np.array([[-1.0, -1.0], [1.0, 1.0]])
_FIRST = ("x", "y", "psi", "u", "climb", "z", "h", "theta")
"""Components that are charted first."""
_POSE = ("x", "y", "z", "h", "phi", "theta", "psi")
"""Components that maps show: their charts show the error of the estimate."""
_LINES = (palette.TRUE, palette.GOAL, palette.FIX, palette.LIMIT)


class Picture:
    """History and picture of one vehicle on its way.

    There is a map from above where its state has the components x and y, and one from the side where it has x, and z
    or h, each with a close-up; then charts of what is estimated.

    Args:
        core: The environment's core.
        row: Which environment of the batch is shown.
    """

    def __init__(self, core: Core, row: int = 0) -> None:
        self.title = core.system.name
        self.journey = Journey(core, row)
        self._core, self._row = core, row
        self._around = Surroundings()
        self._landmarks = np.zeros((0, 3))
        self._views: list[View] = []

    def begin(self) -> None:
        """Forget the last episode: another one begins, in the state that the core is in."""
        self.journey.begin()
        core, row = self._core, self._row
        self._around = around = surroundings_of(core, core.scenario[row])
        goal = np.zeros((0, 3)) if around.goal is None else np.array([around.goal[:3]])
        self._landmarks = np.concatenate([around.path, goal])
        start = pose(core.state[row : row + 1], core.vehicle.state_names)[:, :3]
        way = np.concatenate([start, self._landmarks])[-1] - start[0]
        self._views = views_of(core.vehicle.state_names, way[:2])

    def record(self) -> None:
        """Append the core's present state to the history."""
        self.journey.record()

    def draw(self, canvas: Canvas) -> None:
        """Draw the history on a canvas, all of it."""
        canvas.clear()
        history, (width, height) = self.journey.history(), canvas.size
        marks = Marks(self._around, self.journey, history)
        box = Box(16, 60, width - 32, height - 76)
        self._header(canvas, Box(box.left, 0, box.width, 60), history, marks.true[-1, :3])
        if self._views:
            self._maps(canvas, Box(box.left, box.top, _LEFT, _TOP), marks)
            close = Box(box.left + _LEFT + _GAP, box.top, box.width - _LEFT - _GAP, _TOP - _LEGEND - _GAP)
            self._close_ups(canvas, close, marks)
            self._legend(canvas, Box(close.left, close.bottom + _GAP, close.width, _LEGEND), marks)
            box = box.inset(0, _TOP + _GAP, 0, 0)
        dt = self._core.vehicle.dt
        draw_charts(canvas, box, self._charts(history), history.step * dt, self._core.task.horizon * dt)

    # --- header -------------------------------------------------------------------------------------

    def _header(self, canvas: Canvas, box: Box, history: Moment, place: np.ndarray) -> None:
        """Under which conditions the vehicle is on its way, for how long, how far from its goal, and its end."""
        core = self._core
        config, mismatch = core.config, core.config.options.mismatch
        words = [
            f"estimator {core.estimator}",
            f"{config.disturbance_name} disturbance",
            f"{config.sensors_name} sensors",
        ]
        words += [f"mismatch {100 * mismatch:g} %"] if mismatch else []
        canvas.text(box.left, box.top + 21, self.title, palette.TEXT, 17, bold=True)
        canvas.text(box.left, box.top + 44, "   ·   ".join(words), palette.MUTED, 13)
        values = {"score": f"{history.score[-1]:.3f}", "time": f"{history.step[-1] * core.vehicle.dt:.1f} s"}
        if self._around.goal is not None:
            away = float(np.linalg.norm(place - self._around.goal[:3]))
            values["to the goal"] = f"{away:.2f} m" if away < 1.0 else f"{away:.1f} m"
        right, y = box.right, box.top + 32
        for label, value in values.items():
            right -= canvas.text(right, y, value, palette.TEXT, 15, "right", bold=True) + 8
            right -= canvas.text(right, y, label, palette.MUTED, 13, "right") + 24
        outcome, colour = self._outcome(history)
        canvas.text(right, y, outcome, colour, 15, "right", bold=True)

    def _outcome(self, history: Moment) -> tuple[str, Colour]:
        """Outcome of the episode in words, and its colour."""
        task = self._core.task
        end = task.end_reasons[self._core.end[self._row]]
        if end:
            return end, palette.GOAL if end == task.success else palette.LIMIT
        if history.step[-1] >= task.horizon:
            return "time is up", palette.LIMIT if task.success else palette.GOAL
        return "under way", palette.MUTED

    # --- maps ---------------------------------------------------------------------------------------

    def _maps(self, canvas: Canvas, box: Box, marks: Marks) -> None:
        """All of the journey, from above and, below that, from the side."""
        points = [self._points(view, marks) for view in self._views]
        heights = [float(np.ptp(each[:, 0])) for each in points]
        share = 1.0 if len(heights) == 1 else float(np.clip(heights[0] / sum(heights), 0.55, 0.7))
        first = share * (box.height - _GAP * (len(points) - 1))
        boxes = box.inset(0, 0, 0, box.height - first), box.inset(0, first + _GAP, 0, 0)
        for view, each, place in zip(self._views, points, boxes, strict=False):
            self._map(canvas, place, view, each, marks)

    def _points(self, view: View, marks: Marks) -> np.ndarray:
        """Points ``(n, 2)`` that a map must show."""
        around = self._around
        points = view.seen(np.concatenate([self._landmarks, marks.true[:, :3], marks.believed[:, :3]]))
        middle = 0.5 * (points.min(0) + points.max(0))
        parts = [points, middle + 2.0 * around.size * _AROUND]
        if not view.aside:
            parts += [around.obstacles[:, :2] + side * around.obstacles[:, 2:] for side in (-1.0, 1.0)]
        elif around.surface is not None:
            parts = [points, np.array([[-around.surface, middle[1]]])]
        return np.concatenate(parts)

    def _map(self, canvas: Canvas, box: Box, view: View, points: np.ndarray, marks: Marks) -> None:
        note = f"to the right is {view.bearing:03.0f}°" if view.aside and len(self._views) > 1 else ""
        sea = draw_card(canvas, box, f"Seen from {'the side' if view.aside else 'above'}", note)
        frame = Frame(sea, points, (22.0, 22.0, 22.0, 16.0), view.aside and self._around.surface is not None)
        length = self._around.size * frame.scale
        size = marks.hull.pixels(length, marks.hull.least)
        marks.draw(canvas, frame, view, size, 3.0)
        magnified = marks.hull.scaled and size > 1.05 * length
        draw_scale_bar(canvas, frame, f"vehicle drawn {size / length:.2g}×" if magnified else "")
        if not view.aside:
            draw_north(canvas, box.right - 20, box.top + 24)

    def _close_ups(self, canvas: Canvas, box: Box, marks: Marks) -> None:
        """Draw close-ups of the estimated vehicle, to scale."""
        count, size = len(self._views), self._around.size
        width = (box.width - _GAP * (count - 1)) / count
        for i, view in enumerate(self._views):
            title = "Close-up" if count == 1 else f"Close-up from {'the side' if view.aside else 'above'}"
            sea = draw_card(canvas, Box(box.left + i * (width + _GAP), box.top, width, box.height), title)
            true, believed = view.seen(marks.true[-1, :3]), view.seen(marks.believed[-1, :3])
            away, spread = (float(np.abs(each).max()) for each in (true - believed, two_sigma(marks.cov(view))))
            half = nice(max(marks.hull.near * size, away + 0.3 * size, 1.5 * spread))
            frame = Frame(sea, believed + half * _AROUND)
            marks.draw(canvas, frame, view, marks.hull.pixels(size * frame.scale, 14.0), 4.5, close=True)
            draw_scale_bar(canvas, frame, "")

    def _legend(self, canvas: Canvas, box: Box, marks: Marks) -> None:
        """Draw the meaning of the marks."""
        canvas.panel(box)
        labels = marks.legend()
        wide = (box.width - 12) / -(-len(labels) // 3)
        for i, (kind, label) in enumerate(labels.items()):
            at = np.array([box.left + 28 + (i // 3) * wide, box.top + 16 + (i % 3) * 24])
            canvas.text(at[0] + 22, at[1], label, palette.TEXT, 11)
            marks.draw_icon(canvas, kind, at)

    # --- charts -------------------------------------------------------------------------------------

    def _charts(self, history: Moment) -> list[Chart]:
        """Estimates, the unknown input if there is one only, actions and score, as many as there is room for."""
        core = self._core
        charts = [self._component(name, history) for name in self._components()]
        rest = []
        if len(core.unknown_inputs) == 1 and np.isfinite(history.believed_unknown).all():
            true, believed = history.unknown[:, 0], history.believed_unknown[:, 0]
            late = (core.filter.input_delay or 0) * core.vehicle.dt
            rest.append(comparison(f"Unknown {core.unknown_inputs[0]}", true, believed, late=late))
        names = zip(core.vehicle.action_names, _LINES, history.action.T, strict=False)
        rest.append(Chart("Actions", [Series(*each) for each in names], reach=(-1.0, 1.0)))
        rest.append(Chart("Score so far", [Series("", palette.TRUE, history.score, 2.0)], reach=(0.0, 0.1)))
        return charts[: (6 if self._views else 12) - len(rest)] + rest

    def _components(self) -> list[str]:
        """The names of what is estimated, in the order of interest."""
        names = self.journey.estimated
        first = [name for name in _FIRST if name in names]
        return [*first, *(name for name in names if name not in first)]

    def _component(self, name: str, history: Moment) -> Chart:
        i, angles = self.journey.estimated.index(name), self._core.vehicle.angles
        words, unit, scale = in_words(name, angles)
        true = history.truth[:, [self.journey.places[i]]]
        # An estimate that is a full turn off is not wrong.
        off = scale * difference(history.estimate[:, [i]], true, (0,) if name in angles else ())[:, 0]
        sd = scale * np.sqrt(np.maximum(history.cov[:, i, i], 0.0))
        title = words[:1].upper() + words[1:] + (f"  [{unit}]" if unit else "")
        if name in _POSE:
            return error(title, off, sd)
        return comparison(title, scale * true[:, 0], scale * true[:, 0] + off, sd)
