"""The picture of any task: maps, a close-up of what the estimator believes, charts of state, actions and score."""

import numpy as np

from estimators.angles import difference
from vessel_gym.core import Core
from vessel_gym.rendering.canvas import (
    BELIEVED,
    BELIEVED_PALE,
    CIRCLE,
    COMMANDED,
    FIX,
    GOAL,
    LIMIT,
    MEMBER,
    MUTED,
    OBSTACLE,
    PANEL,
    TEXT,
    TRUE,
    TRUE_PALE,
    TRUE_SOFT,
    Box,
    Canvas,
    Colour,
    nice,
    two_sigma,
)
from vessel_gym.rendering.charts import AXIS, Series, chart, comparison, error
from vessel_gym.rendering.hulls import HULLS
from vessel_gym.rendering.journey import Journey, Moment
from vessel_gym.rendering.maps import (
    Frame,
    View,
    bar_length,
    draw_card,
    draw_grid,
    draw_north,
    draw_scale_bar,
)
from vessel_gym.surroundings import Surroundings, in_words, surroundings_of

_GAP = 10.0
_TOP = 402.0  # height of maps and close-ups
_LEFT = 496.0  # width of the maps
_LEGEND = 80.0
_COLUMNS = 3  # of charts
_COMPONENTS = 4  # charts of estimates
_VEHICLE = {"ship": 44.0, "torpedo": 30.0, "aircraft": 28.0, "dot": 9.0}
"""Least size of a vehicle on a map, in pixels."""
_CLOSE = {"ship": 0.3, "torpedo": 0.7, "aircraft": 2.0, "dot": 2.0}
"""Vehicle sizes that a close-up shows to either side at least."""
_FIRST = ("x", "y", "psi", "u", "north", "z", "h", "theta")
"""What is charted first."""
_POSE = ("x", "y", "z", "h", "phi", "theta", "psi")
"""What maps show: charts tell by how much it is believed wrong."""
_LINES = (TRUE, GOAL, FIX, LIMIT)


class Picture:
    """History and picture of one vehicle on its way.

    There is a map from above where its state has the components x and y, and one from the side where it has z or h,
    each with a close-up; then charts of what is estimated beside the position.

    Args:
        core: The environment's core.
        row: Which environment of the batch is shown.
    """

    def __init__(self, core: Core, row: int = 0) -> None:
        self.title = core.system.name
        self._core, self._row = core, row
        self.journey = Journey(core, row)
        self._around = Surroundings()
        self._fixed = np.zeros((1, 3))
        self._views: list[View] = []

    def begin(self) -> None:
        """Forget the last episode: another one begins, in the state that the core is in."""
        self.journey.begin()
        around = self._around = surroundings_of(self._core, self._core.course[self._row])
        goal = np.array([around.goal or ()]).reshape(-1, 4)
        self._fixed = np.concatenate([around.path, goal[:, :3]])
        names, self._views = self.journey.names, []
        if "x" in names and "y" in names:
            self._views.append(View(np.eye(2, 3), False))
        if "x" in names and ("z" in names or "h" in names):
            way = np.array([1.0, 0.0])
            if len(self._fixed) > 1 and np.hypot(*(self._fixed[-1] - self._fixed[0])[:2]) > around.size:
                way = (self._fixed[-1] - self._fixed[0])[:2]
            way = way / np.hypot(*way)
            self._views.append(View(np.array([[0.0, 0.0, -1.0], [*way, 0.0]]), True))

    def record(self) -> None:
        """Append the core's present state to the history."""
        self.journey.record()

    def draw(self, canvas: Canvas) -> None:
        """Draw the history on a canvas, all of it."""
        canvas.clear()
        width, height = canvas.size
        history = self.journey.history()
        true, believed = self.journey.true(history), self.journey.believed(history)
        box = Box(16, 60, width - 32, height - 76)
        self._header(canvas, Box(box.left, 0, box.width, 60), history, true[-1])
        if self._views:
            spread, members = self.journey.spread(history.cov[-1]), self.journey.members()
            shown = _Shown(self._around, self.journey, true, believed, spread, members)
            self._maps(canvas, Box(box.left, box.top, _LEFT, _TOP), shown)
            side = Box(box.left + _LEFT + _GAP, box.top, box.width - _LEFT - _GAP, _TOP - _LEGEND - _GAP)
            self._close_ups(canvas, side, shown)
            self._legend(canvas, Box(side.left, side.bottom + _GAP, side.width, _LEGEND), shown)
            box = box.inset(0, _TOP + _GAP, 0, 0)
        self._charts(canvas, box, history)

    # --- header -------------------------------------------------------------------------------------

    def _header(self, canvas: Canvas, box: Box, history: Moment, true: np.ndarray) -> None:
        """Under which conditions the vehicle is on its way, for how long, and its end."""
        core = self._core
        words = [f"estimator {core.estimator}", f"{core.disturbance_name} disturbance", f"{core.sensors_name} sensors"]
        words += [f"mismatch {100 * core.mismatch:g} %"] if core.mismatch else []
        canvas.text(box.left, box.top + 21, self.title, TEXT, 17, bold=True)
        canvas.text(box.left, box.top + 44, "   ·   ".join(words), MUTED, 13)
        values = {"score": f"{history.score[-1]:.3f}", "time": f"{history.step[-1] * core.vehicle.dt:.1f} s"}
        if self._around.goal is not None:
            away = float(np.linalg.norm(true[:3] - self._around.goal[:3]))
            values["to the goal"] = f"{away:.2f} m" if away < 1.0 else f"{away:.1f} m"
        right, y = box.right, box.top + 32
        for label, value in values.items():
            right -= canvas.text(right, y, value, TEXT, 15, "right", bold=True) + 8
            right -= canvas.text(right, y, label, MUTED, 13, "right") + 24
        outcome, colour = self._outcome(history)
        canvas.text(right, y, outcome, colour, 15, "right", bold=True)

    def _outcome(self, history: Moment) -> tuple[str, Colour]:
        """How the journey has ended, in words, or that it has not."""
        task = self._core.task
        end = task.ends[self._core.end[self._row]]
        if end:
            return end, GOAL if end == task.success else LIMIT
        if history.step[-1] >= task.horizon:
            return "time is up", LIMIT if task.success else GOAL
        return "under way", MUTED

    # --- maps ---------------------------------------------------------------------------------------

    def _maps(self, canvas: Canvas, box: Box, shown: "_Shown") -> None:
        """All of the journey, from above and, below, from the side."""
        points = [self._points(view, shown) for view in self._views]
        heights = [max(float(np.ptp(each[:, 0])), 1e-3 * shown.around.size) for each in points]
        share = 1.0 if len(heights) < 2 else float(np.clip(heights[0] / sum(heights), 0.55, 0.7))
        top = box.top
        for view, seen, part in zip(self._views, points, (share, 1.0 - share), strict=False):
            height = part * (box.height - _GAP * (len(points) - 1))
            self._map(canvas, Box(box.left, top, box.width, height), view, seen, shown)
            top += height + _GAP

    def _points(self, view: View, shown: "_Shown") -> np.ndarray:
        """What must be seen on a map, ``(n, 2)``."""
        around = shown.around
        found = view.seen(np.concatenate([self._fixed, shown.true[:, :3], shown.believed[:, :3]]))
        more = [0.5 * (found.min(0) + found.max(0)) + 2.0 * around.size * np.array([[-1.0, -1.0], [1.0, 1.0]])]
        if not view.aside:
            more += [around.obstacles[:, :2] + side * around.obstacles[:, 2:] for side in (-1.0, 1.0)]
        elif around.surface is not None:
            more = [np.array([[-around.surface, found[0, 1]]])]
        return np.concatenate([found, *more])

    def _map(self, canvas: Canvas, box: Box, view: View, points: np.ndarray, shown: "_Shown") -> None:
        bearing = np.rad2deg(np.arctan2(view.axes[1, 1], view.axes[1, 0])) % 360.0
        note = f"to the right is {bearing:03.0f}°" if view.aside and len(self._views) > 1 else ""
        sea = draw_card(canvas, box, f"Seen from {'the side' if view.aside else 'above'}", note)
        frame = Frame(sea, points, (22.0, 22.0, 22.0, 38.0), view.aside and shown.around.surface is not None)
        size = max(shown.around.size * frame.scale, _VEHICLE[shown.around.hull])
        shown.draw(canvas, frame, view, size, 3.0)
        magnified = size / (shown.around.size * frame.scale)
        drawn = magnified > 1.05 and shown.around.hull != "dot"
        draw_scale_bar(canvas, frame, f"vehicle drawn {magnified:.2g}×" if drawn else "")
        if not view.aside:
            draw_north(canvas, box.right - 20, box.top + 24)

    def _close_ups(self, canvas: Canvas, box: Box, shown: "_Shown") -> None:
        """What is around the believed vehicle, to scale."""
        count = len(self._views)
        width = (box.width - _GAP * (count - 1)) / count
        for i, view in enumerate(self._views):
            title = "Close-up" if count == 1 else f"Close-up from {'the side' if view.aside else 'above'}"
            sea = draw_card(canvas, Box(box.left + i * (width + _GAP), box.top, width, box.height), title)
            middle, away = view.seen(shown.believed[-1, :3]), view.seen(shown.true[-1, :3] - shown.believed[-1, :3])
            around = shown.around
            farthest = np.abs(away).max() + 0.3 * around.size, 1.5 * np.abs(two_sigma(shown.cov(view))).max()
            half = nice(max(_CLOSE[around.hull] * around.size, *map(float, farthest)))
            frame = Frame(sea, middle + half * np.array([[-1.0, -1.0], [1.0, 1.0]]))
            shown.draw(canvas, frame, view, max(around.size * frame.scale, 14.0), 4.5, close=True)
            draw_scale_bar(canvas, frame, "")

    def _legend(self, canvas: Canvas, box: Box, shown: "_Shown") -> None:
        """What the marks mean."""
        canvas.panel(box)
        labels = shown.legend()
        each = (box.width - 12) / -(-len(labels) // 3)
        for i, (kind, label) in enumerate(labels.items()):
            at = np.array([box.left + 28 + (i // 3) * each, box.top + 16 + (i % 3) * 24])
            canvas.text(at[0] + 22, at[1], label, TEXT, 11)
            shown.icon(canvas, kind, at)

    # --- charts -------------------------------------------------------------------------------------

    def _charts(self, canvas: Canvas, box: Box, history: Moment) -> None:
        """Estimates, the unknown input if there is one only, actions and score, as many as there is room for."""
        core, dt = self._core, self._core.vehicle.dt
        time = history.step * dt
        end = min(nice(max(float(time[-1]), 20.0 * dt)), max(core.task.horizon * dt, float(time[-1])))
        rows = 2 if self._views else 4
        high = (box.height - AXIS - (rows - 1) * _GAP) / rows
        wide = (box.width - (_COLUMNS - 1) * _GAP) / _COLUMNS
        places = [
            Box(box.left + (i % _COLUMNS) * (wide + _GAP), box.top + (i // _COLUMNS) * (high + _GAP), wide,
                high + AXIS * (i // _COLUMNS == rows - 1))
            for i in range(rows * _COLUMNS)
        ]  # fmt: skip
        unknown = len(core.unknown_inputs) == 1 and bool(np.isfinite(history.believed_unknown).all())
        for name in self._components()[: len(places) - 2 - unknown]:
            place = places.pop(0)
            self._component(canvas, place, name, time, end, history, place.bottom == box.bottom)
        if unknown:
            late = (core.filter.input_delay or 0) * dt
            true, believed = history.unknown[:, 0], history.believed_unknown[:, 0]
            place = places.pop(0)
            title = f"Unknown {core.unknown_inputs[0]}"
            comparison(canvas, place, title, time, end, true, believed, place.bottom == box.bottom, late=late)
        names = zip(core.vehicle.action_names, _LINES, history.action.T, strict=False)
        actions = [Series(name, colour, values) for name, colour, values in names]
        place = places.pop(0)
        chart(canvas, place, "Actions", time, end, actions, place.bottom == box.bottom, least=2.2)
        place = places.pop(0)
        chart(canvas, place, "Score so far", time, end, [Series("", TRUE, history.score, 2.0)], True)

    def _components(self) -> list[str]:
        """The names of what is estimated, in the order of interest."""
        names = self.journey.estimated
        first = [name for name in _FIRST if name in names]
        return [*first, *(name for name in names if name not in first)]

    def _component(
        self, canvas: Canvas, box: Box, name: str, time: np.ndarray, end: float, history: Moment, timed: bool
    ) -> None:  # fmt: skip
        i, angles = self.journey.estimated.index(name), self._core.vehicle.angles
        words, unit, scale = in_words(name, angles)
        true = history.truth[:, [self.journey.places[i]]]
        # An estimate that is a full turn off is not wrong.
        off = scale * difference(history.estimate[:, [i]], true, (0,) if name in angles else ())[:, 0]
        sd = scale * np.sqrt(np.maximum(history.cov[:, i, i], 0.0))
        title = words[:1].upper() + words[1:] + (f"  [{unit}]" if unit else "")
        if name in _POSE:
            error(canvas, box, title, time, end, off, sd, timed)
        else:
            comparison(canvas, box, title, time, end, scale * true[:, 0], scale * true[:, 0] + off, timed, sd)


class _Shown:
    """What lies on every map of a moment: surroundings, tracks, belief and vehicle."""

    def __init__(
        self, around: Surroundings, journey: Journey, true: np.ndarray, believed: np.ndarray, spread: np.ndarray,
        members: np.ndarray | None,
    ) -> None:  # fmt: skip
        self.around, self.true, self.believed = around, true, believed
        self._journey, self._spread, self._members = journey, spread, members

    def cov(self, view: View) -> np.ndarray:
        """Covariance ``(2, 2)`` of the believed position as it is seen."""
        return view.axes @ self._spread @ view.axes.T

    def draw(self, canvas: Canvas, frame: Frame, view: View, size: float, mark: float, close: bool = False) -> None:
        """Draw all of it in a frame.

        Args:
            canvas: Where to draw.
            frame: To which scale.
            view: From where it is seen.
            size: Pixels of the vehicle.
            mark: Pixels of half a cross.
            close: Whether the frame is a close-up, which shows more of the belief.
        """
        around, box = self.around, frame.box

        def at(points: np.ndarray) -> np.ndarray:
            return frame.pixels(view.seen(points))

        with canvas.clipped(box):
            draw_grid(canvas, frame, bar_length(frame))
            if view.aside and around.surface is not None:
                y = float(frame.pixels(np.array([-around.surface, 0.0]))[1])
                if y > box.top:
                    sky = [[box.left, box.top], [box.right, box.top], [box.right, y], [box.left, y]]
                    canvas.polygon(np.array(sky), PANEL)
                    canvas.line(np.array([[box.left, y], [box.right, y]]), TRUE_SOFT, 2.0)
                    if not close:
                        canvas.text(box.right - 10, y - 9, "surface", MUTED, 10, "right")
            for north, east, radius in () if view.aside else around.obstacles:
                canvas.polygon(frame.pixels([north, east] + radius * CIRCLE), OBSTACLE, LIMIT, 1.0)
            if len(around.path):
                canvas.dashes(at(around.path), COMMANDED, 1.5)
            for fix in at(np.array(self._journey.fixes).reshape(-1, 3)):
                canvas.cross(fix, FIX, mark, 0.35 * mark)
            if around.goal is not None:
                goal, radius = at(np.array(around.goal[:3])), max(around.goal[3] * frame.scale, 4.0)
                canvas.ring(goal, GOAL, radius, 1.5)
                canvas.dot(goal, GOAL, 2.0)
            if self._journey.located.any():
                canvas.line(at(self.believed[:, :3]), BELIEVED, 1.5)
            canvas.line(at(self.true[:, :3]), TRUE, 2.0)
            if not close:
                start = at(self.true[0, :3])
                canvas.dot(start, TEXT, 4.0)
                canvas.dot(start, PANEL, 2.2)
            self._vehicles(canvas, frame, view, size, close)

    def _vehicles(self, canvas: Canvas, frame: Frame, view: View, size: float, close: bool) -> None:
        """The true vehicle, how sure the estimator is of its place, the believed vehicle."""
        outlines, toward = HULLS[self.around.hull], np.array([[0.0, -1.0], [1.0, 0.0]])  # up and right to x and y
        true, believed = (
            frame.pixels(view.seen(pose[:3])) + size * view.body(pose, outlines) @ toward
            for pose in (self.true[-1], self.believed[-1])
        )
        canvas.polygon(true, TRUE_PALE, TRUE, 1.5)
        if self._members is not None:
            for member in frame.pixels(view.seen(self._members)):
                canvas.dot(member, MEMBER, 1.8 if close else 1.2)
        else:
            ellipse = frame.pixels(view.seen(self.believed[-1, :3]) + two_sigma(self.cov(view)))
            if np.ptp(ellipse, 0).max() > 1.0:
                canvas.polygon(ellipse, BELIEVED_PALE, MEMBER, 1.0)
        canvas.outline(believed, BELIEVED, 1.5)
        if close:
            canvas.dot(frame.pixels(view.seen(self.true[-1, :3])), TRUE, 3.0)
            canvas.dot(frame.pixels(view.seen(self.believed[-1, :3])), BELIEVED, 3.0)

    def legend(self) -> dict[str, str]:
        """What marks there are, in words."""
        around, located = self.around, bool(self._journey.located.any())
        labels = {"true": "true vehicle", "believed": "believed vehicle"}
        if located and self._members is not None:
            labels["cloud"] = f"ensemble of {len(self._members)}"
        elif located and np.trace(self._spread) > 0.0:
            labels["ellipse"] = "believed ±2σ"
        labels |= {"fix": "position fix"} if self._journey.fixes else {}
        labels |= {"start": "start"}
        labels |= {"path": "path to follow"} if len(around.path) else {}
        labels |= {"goal": f"goal, within {around.goal[3]:g} m"} if around.goal is not None else {}
        return labels | ({"obstacle": "obstacle"} if len(around.obstacles) else {})

    def icon(self, canvas: Canvas, kind: str, at: np.ndarray) -> None:
        """What an entry of the legend stands for."""
        line, outline = at + [[-14.0, 0.0], [14.0, 0.0]], at + 22.0 * HULLS[self.around.hull][0] * [1.0, 1.0]
        if self.around.hull == "dot":
            outline = at + 9.0 * HULLS["dot"][0]
        if kind == "true":
            canvas.line(line, TRUE, 2.0)
            canvas.polygon(outline, TRUE_PALE, TRUE, 1.2)
        elif kind == "believed":
            canvas.line(line, BELIEVED, 1.5)
            canvas.polygon(outline, PANEL, BELIEVED, 1.2)
        elif kind == "cloud":
            for member in ((-9, 1), (-5, -3), (-2, 3), (0, -1), (4, 4), (5, -2), (9, 0)):
                canvas.dot(at + member, MEMBER, 1.5)
        elif kind == "ellipse":
            canvas.polygon(at + CIRCLE * [12.0, 6.0], BELIEVED_PALE, MEMBER, 1.0)
        elif kind == "fix":
            canvas.cross(at, FIX, 3.5, 1.5)
        elif kind == "start":
            canvas.dot(at, TEXT, 4.0)
            canvas.dot(at, PANEL, 2.2)
        elif kind == "path":
            canvas.dashes(line, COMMANDED, 1.5)
        elif kind == "goal":
            canvas.ring(at, GOAL, 7.0, 1.5)
            canvas.dot(at, GOAL, 2.0)
        elif kind == "obstacle":
            canvas.polygon(at + CIRCLE * 7.0, OBSTACLE, LIMIT, 1.0)
