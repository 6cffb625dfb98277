"""The picture of a dive: where the vehicle is and where it believes to be, from above, from the side and close up."""

from dataclasses import dataclass

import numpy as np

from vessel_gym.core import Core
from vessel_gym.guidance.dive_path import follow, path_point
from vessel_gym.rendering import register_scene
from vessel_gym.rendering.canvas import (
    BELIEVED,
    COMMANDED,
    CURRENT,
    FIX,
    LIMIT,
    MEMBER,
    MUTED,
    PANEL,
    TRUE,
    TRUE_PALE,
    TRUE_SOFT,
    Box,
    Canvas,
    PlanView,
    Series,
    close_up,
    comparison_chart,
    draw_flows,
    draw_grid,
    draw_map,
    draw_north,
    draw_scale_bar,
    draw_spread,
    draw_start,
    nice,
    scale_bar_length,
    signed,
    strip_chart,
    two_sigma,
)
from vessel_gym.rendering.journey import Journey, Sample, deviation
from vessel_gym.tasks.dive import Dive

_VEHICLE_PIXELS = 30.0  # least length of a vehicle in the large views
_STEP = 40.0  # least pixels from one grid line to the next
_COLUMN = 204.0  # width of the close-ups and the legend
_GAP = 10.0
_MARGIN = 26.0  # least pixels around what is seen


@dataclass(frozen=True)
class _View:
    """A way to look at the dive, as a map whose first coordinate goes up and whose second goes right.

    Attributes:
        title: What is seen.
        aside: From the side, unrolled along the path; otherwise from above.
        course: ``(3,)`` the path's.
        fin: Which actuator is seen to turn.
    """

    title: str
    aside: bool
    course: np.ndarray
    fin: int

    def points(self, position: np.ndarray) -> np.ndarray:
        """Where positions ``(..., 3)`` are seen, ``(..., 2)``: north and east, or up and along the path."""
        if not self.aside:
            return position[..., :2]
        return np.stack([-position[..., 2], follow(position, self.course, 0.0)[..., 0]], -1)

    def gradient(self, position: np.ndarray) -> np.ndarray:
        """What a metre north, east and down does to the point where ``position (3,)`` is seen, ``(2, 3)``."""
        if not self.aside:
            return np.eye(2, 3)
        heading = follow(position, self.course, 0.0)[3]
        return np.array([[0.0, 0.0, -1.0], [np.cos(heading), np.sin(heading), 0.0]])

    def nose(self, position: np.ndarray, heading: float, pitch: float) -> np.ndarray:
        """A unit vector forward as it is seen, ``(2,)``: shorter where it points at or away from the eye."""
        ahead = np.cos(pitch) * np.array([np.cos(heading), np.sin(heading), 0.0])
        return self.gradient(position) @ (ahead - np.array([0.0, 0.0, np.sin(pitch)]))


def torpedo_outline(diameter: float, points: int = 12) -> np.ndarray:
    """A torpedo-shaped vehicle ``(k, 2)`` in lengths, body frame: round nose, stern fins.

    Args:
        diameter: Diameter over length.
        points: Points of one side of the nose.
    """
    radius, turn = 0.5 * diameter, np.linspace(0.0, 0.5 * np.pi, points)
    nose = np.stack([0.22 + 0.28 * np.cos(turn), radius * np.sin(turn)], -1)
    stern = np.array([[-0.2, 1.0], [-0.32, 0.78], [-0.38, 1.5], [-0.46, 1.5], [-0.46, 0.4], [-0.5, 0.25]])
    side = np.concatenate([nose, stern * [1.0, radius]])
    return np.concatenate([side, side[:0:-1] * [1.0, -1.0]])


@register_scene(Dive)
class DiveScene(Journey):
    """History and picture of one underwater vehicle on a dive; one that turns is also seen from above.

    Args:
        core: The environment's core.
        row: Which environment of the batch is shown.
    """

    _task: Dive

    def __init__(self, core: Core, row: int = 0) -> None:
        assert isinstance(core.task, Dive)
        super().__init__(core, ("x", "y"), row)
        names, body = list(core.vehicle.state_names), self._task.auv
        self._names, self._hull = names, torpedo_outline(body.diameter / body.length)
        self._position = self._task.position(np.eye(len(names))).T  # (3, n)
        self._turns = "psi" in names
        self._views: list[_View] = []
        self._path = np.zeros((1, 3))

    def begin(self) -> None:
        """Start an episode with the course that the task has drawn."""
        super().begin()
        course = self._core.course[self._row]
        self._path = path_point(np.linspace(0.0, course[1], 81), course)[:, :3]
        side = "Seen from the side, unrolled along the path" if self._turns else "Seen from the side"
        self._views = [_View(side, True, course, len(self._core.vehicle.action_names) - 2)]
        if self._turns:
            self._views.insert(0, _View("Seen from above", False, course, 0))

    def draw(self, canvas: Canvas) -> None:
        """Draw the episode so far."""
        history = self.history()
        missed = np.linalg.norm(self._now(history.truth)[0] - self._path[-1])
        box = self.sheet(canvas, f"{missed:.2f} m").inset(0, 0, _COLUMN + _GAP, 0)
        chart = 150.0 if self._turns else 128.0
        large = box.height - 2 * (chart + _GAP)
        count = len(self._views)
        each = (box.width - (count - 1) * _GAP) / count
        for i, view in enumerate(self._views):
            self._large(canvas, Box(box.left + i * (each + _GAP), box.top, each, large), view, history)
        self._charts(canvas, Box(box.left, box.top + large + _GAP, box.width, 2 * chart + _GAP), history)
        self._column(canvas, Box(box.right + _GAP, box.top, _COLUMN, box.height), history)

    # --- what is known of the present moment --------------------------------------------------------

    def _now(self, states: np.ndarray) -> tuple[np.ndarray, float, float]:
        """Position, heading and pitch at the end of a column of states."""
        state = states[-1]
        heading = float(state[self._names.index("psi")]) if self._turns else 0.0
        return self._position @ state, heading, float(state[self._names.index("theta")])

    def _two_sigma(self, view: _View, history: Sample) -> np.ndarray:
        """Two standard deviations about the believed position as a view shows them, ``(k, 2)``; none: one point."""
        root = view.gradient(self._position @ history.estimate[-1])
        return two_sigma(root @ self._spread(history)[-1] @ root.T)

    def _spread(self, history: Sample) -> np.ndarray:
        """Covariances ``(k, 3, 3)`` of the believed position."""
        n = len(self._names)
        return self._position @ history.cov[:, :n, :n] @ self._position.T

    # --- parts of the picture -----------------------------------------------------------------------

    def _large(self, canvas: Canvas, box: Box, view: _View, history: Sample) -> None:
        """The whole dive from one side."""
        task, course = self._task, view.course
        draw_map(canvas, box, view.title)
        sea = box.inset(2, 34, 2, 50)
        true, believed = (view.points(states @ self._position.T) for states in (history.truth, history.estimate))
        shown = [view.points(self._path), true, believed]
        floor = course[2] + task.margin
        if view.aside:
            shown.append(np.array([[task.launch_depth, 0.0], [-floor, course[1]]]))
        points = np.concatenate(shown)
        if view.aside:  # hung up at the surface, with as much water below as there is room for
            room = sea.inset(38, 0, 6, 0)
            across = PlanView(room, points, _MARGIN)
            points = np.concatenate([points, [[points[:, 0].max() - (sea.height - 2 * _MARGIN) / across.scale, 0.0]]])
        else:
            room = sea
        frame = PlanView(room, points, _MARGIN)
        with canvas.clipped(sea):
            self._water(canvas, sea, frame, view, floor)
            length = max(task.auv.length * frame.scale, _VEHICLE_PIXELS)
            self._ellipse(canvas, frame, view, history)
            self._paths(canvas, frame, view, true, believed)
            self._marks(canvas, frame, view)
            self._members(canvas, frame, view, 1.2)
            self._vehicles(canvas, frame, view, history, length)
        draw_scale_bar(canvas, frame, box.left + 16, box.bottom - 14, _STEP)
        magnified = length / (task.auv.length * frame.scale)
        if magnified > 1.05:
            x = box.left + 16 + scale_bar_length(frame, _STEP) * frame.scale + 14
            canvas.text(x, box.bottom - 17, f"vehicles drawn {magnified:.1f}×", MUTED, 11)
        if not view.aside:
            draw_north(canvas, box.right - 24, box.top + 42)
        if not (view.aside and self._turns):
            self._draw_current(canvas, box, view, history)

    def _water(self, canvas: Canvas, sea: Box, frame: PlanView, view: _View, floor: float) -> None:
        """Grid; from the side also the surface, the depth that is too deep and the scale of depth."""
        draw_grid(canvas, frame, _STEP, sea)
        if not view.aside:
            return
        task, step = self._task, scale_bar_length(frame, _STEP)
        surface, bottom = (float(frame.pixels(np.array([up, 0.0]))[1]) for up in (task.launch_depth, -floor))
        ends = np.array([sea.left, sea.right])
        sky = np.array([[sea.left, sea.top], [sea.right, sea.top], [sea.right, surface], [sea.left, surface]])
        canvas.polygon(sky, PANEL)
        canvas.line(np.stack([ends, np.full(2, surface)], -1), TRUE_SOFT, 2.0)
        canvas.text(
            sea.right - 8, surface - 11, f"surface, {task.launch_depth:g} m above the start", MUTED, 11, "right"
        )
        canvas.dashes(np.stack([ends, np.full(2, bottom)], -1), LIMIT, 1.0, 4.0, 4.0)
        canvas.text(sea.left + 46, bottom - 9, "too deep", LIMIT, 11)
        for depth in step * np.arange(0.0, floor // step + 1.0):
            y = float(frame.pixels(np.array([-depth, 0.0]))[1])
            if abs(y - bottom) > 7.0:  # else the line would cross it out
                canvas.text(sea.left + 32, y, "0 m" if depth == 0.0 else signed(depth), MUTED, 11, "right")

    def _paths(self, canvas: Canvas, frame: PlanView, view: _View, true: np.ndarray, believed: np.ndarray) -> None:
        """Goal, commanded path and tracks."""
        goal = frame.pixels(view.points(self._path[-1]))
        canvas.dot(goal, PANEL, self._task.GOAL_TOLERANCE * frame.scale)
        canvas.dashes(frame.pixels(view.points(self._path)), COMMANDED, 1.5)
        canvas.line(frame.pixels(believed), BELIEVED, 1.5)
        canvas.line(frame.pixels(true), TRUE, 2.0)
        canvas.ring(goal, CURRENT, self._task.GOAL_TOLERANCE * frame.scale, 1.5)
        canvas.dot(goal, CURRENT, 2.0)
        start = frame.pixels(view.points(self._path[0]))
        draw_start(canvas, start)

    def _marks(self, canvas: Canvas, frame: PlanView, view: _View) -> None:
        """Acoustic fixes, which tell no depth: from the side they are drawn at the surface."""
        if self._fixes:
            fixes = np.array(self._fixes)
            points = view.points(np.pad(fixes, ((0, 0), (0, 3 - fixes.shape[1]))))
            if view.aside:
                points[:, 0] = self._task.launch_depth
            for at in frame.pixels(points):
                canvas.cross(at, FIX, 3.5, 1.5)

    def _ellipse(self, canvas: Canvas, frame: PlanView, view: _View, history: Sample) -> None:
        """Two standard deviations of the believed position, where no ensemble shows how sure the estimator is."""
        if self.members is None:
            at = view.points(self._position @ history.estimate[-1])
            draw_spread(canvas, frame.pixels(at + self._two_sigma(view, history)))

    def _members(self, canvas: Canvas, frame: PlanView, view: _View, radius: float) -> None:
        """The members of the ensemble."""
        if self.members is not None:
            for at in frame.pixels(view.points(self._task.position(self.members))):
                canvas.dot(at, MEMBER, radius)

    def _vehicles(self, canvas: Canvas, frame: PlanView, view: _View, history: Sample, length: float) -> None:
        fin = history.actuators[-1, view.fin]
        blade = np.array([[-0.46, 0.0], [-0.46 - 0.2 * np.cos(fin), 0.2 * np.sin(fin)]])
        canvas.line(self._placed(blade, frame, view, history.truth, length), LIMIT, 2.0)
        canvas.polygon(self._placed(self._hull, frame, view, history.truth, length), TRUE_PALE, TRUE, 1.5)
        canvas.outline(self._placed(self._hull, frame, view, history.estimate, length), BELIEVED, 1.5)

    def _placed(
        self, shape: np.ndarray, frame: PlanView, view: _View, states: np.ndarray, length: float
    ) -> np.ndarray:  # fmt: skip
        """A shape in the vehicle's frame where it is seen; foreshortened, and from the side never upside down."""
        position, heading, pitch = self._now(states)
        up, right = view.nose(position, heading, pitch)
        share = max(float(np.hypot(up, right)), self._task.auv.diameter / self._task.auv.length)
        flip = -1.0 if view.aside and right < 0.0 else 1.0
        at = view.points(position)
        return frame.body(shape * [share, flip], at, float(np.arctan2(right, up)), length)

    def _draw_current(self, canvas: Canvas, box: Box, view: _View, history: Sample) -> None:
        """The current, true and believed, as arrows of lengths in proportion."""
        flows = [history.flow[-1], history.believed_flow[-1]]
        draw_flows(canvas, box, "current", [(flow, np.array([0.0, flow[0]]) if view.aside else flow) for flow in flows])

    # --- the column on the right --------------------------------------------------------------------

    def _column(self, canvas: Canvas, box: Box, history: Sample) -> None:
        """A close-up of every view, and what the marks mean."""
        legend = 226.0
        each = min((box.height - legend) / len(self._views) - _GAP, 320.0)
        for i, view in enumerate(self._views):
            self._close_up(canvas, Box(box.left, box.top + i * (each + _GAP), box.width, each), view, history)
        top = box.top + len(self._views) * (each + _GAP)
        self._legend(canvas, Box(box.left, top, box.width, box.bottom - top), history)

    def _close_up(self, canvas: Canvas, box: Box, view: _View, history: Sample) -> None:
        """What is around the believed vehicle, to scale."""
        true, believed = (view.points(states @ self._position.T) for states in (history.truth, history.estimate))
        length, title = self._task.auv.length, "Close-up from the side" if view.aside else "Close-up from above"
        frame = close_up(canvas, box, title, believed[-1], true[-1], self._two_sigma(view, history), length, 1.2)
        with canvas.clipped(frame.box):
            draw_grid(canvas, frame, 36.0)
            if view.aside:
                _, y = frame.pixels(np.array([self._task.launch_depth, 0.0]))
                canvas.line(np.array([[frame.box.left, y], [frame.box.right, y]]), TRUE_SOFT, 2.0)
            self._ellipse(canvas, frame, view, history)
            self._paths(canvas, frame, view, true, believed)
            self._marks(canvas, frame, view)
            self._vehicles(canvas, frame, view, history, length * frame.scale)
            self._members(canvas, frame, view, 1.7)
        draw_scale_bar(canvas, frame, box.left + 12, box.bottom - 9, 36.0)

    def _legend(self, canvas: Canvas, box: Box, history: Sample) -> None:
        labels = {
            "path": "path to follow",
            "start": "start",
            "goal": f"goal, reached within {self._task.GOAL_TOLERANCE:g} m",
            "true": "true vehicle, its track",
            "believed": "believed vehicle, its track",
            "fin": "fin of the true vehicle",
            **self.belief_label(self._spread(history)[-1]),
            "fix": "acoustic fix of the position",
        }
        pitch = min((box.height - 16) / (len(labels) + 0.7), 26.0)
        self.legend(canvas, box, labels, pitch, self._hull * 26.0)
        below = box.top + 4 + (len(labels) + 0.3) * pitch
        canvas.text(box.left + 46, below, "(from the side: at the surface)", MUTED, 10)

    # --- charts -------------------------------------------------------------------------------------

    def _charts(self, canvas: Canvas, box: Box, history: Sample) -> None:
        task, dt = self._task, self._task.dt
        time = history.step * dt
        usual = max(1.15 * self._views[0].course[1] / task.auv.cruise_speed, float(time[-1]))
        span = 0.0, 30.0 * np.ceil(usual / 30.0)
        width, height = (box.width - _GAP) / 2, (box.height - _GAP) / 2
        boxes = [
            Box(box.left + i * (width + _GAP), box.top + j * (height + _GAP), width, height)
            for j in range(2) for i in range(2)
        ]  # fmt: skip
        right, above = self._errors(history)
        u = self._names.index("u")
        speed = history.truth[:, u], history.estimate[:, u], history.sd(u)

        if self._turns:
            comparison_chart(canvas, boxes.pop(0), "Right of the path  [m]", time, span, 0.5, *right, limit=task.LOST)
        comparison_chart(canvas, boxes.pop(0), "Above the path  [m]", time, span, 0.5, *above, limit=task.LOST)
        self._fins(canvas, boxes.pop(0), time, span, history)
        comparison_chart(canvas, boxes.pop(0), "Speed through the water  [m/s]", time, span, 1.0, *speed, lowest=0.0)
        if boxes:
            flow = history.flow[:, 0], history.believed_flow[:, 0], history.sd(len(self._names))
            comparison_chart(canvas, boxes.pop(0), "Current ahead  [m/s]", time, span, 0.1, *flow)

    def _errors(self, history: Sample) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Distance to the right of the path and above it [m]: true, believed, and the latter's standard deviation."""
        course, errors = self._views[0].course, []
        for states in (history.truth, history.estimate):
            on = follow(states @ self._position.T, course, 0.0)
            steep = np.hypot(1.0, on[:, 4])
            errors.append((on[:, 1], -on[:, 2] / steep))
        heading, zero = on[:, 3], np.zeros(len(on))
        across = np.stack([-np.sin(heading), np.cos(heading), zero], -1)
        up = np.stack([on[:, 4] * np.cos(heading), on[:, 4] * np.sin(heading), zero - 1.0], -1) / steep[:, None]
        sds = [deviation(direction, self._spread(history)) for direction in (across, up)]
        return [(errors[0][i], errors[1][i], sds[i]) for i in range(2)]

    def _fins(
        self, canvas: Canvas, box: Box, time: np.ndarray, span: tuple[float, float], history: Sample
    ) -> None:  # fmt: skip
        names, limit = self._core.vehicle.action_names[:-1], float(np.rad2deg(self._task.auv.fin_limit))
        angles = np.rad2deg(history.actuators[:, :-1])
        series = [
            Series(name if len(names) > 1 else "", colour, time, angles[:, i], 1.4)
            for i, (name, colour) in enumerate(zip(names, (TRUE, CURRENT), strict=False))
        ]
        title = "Fins  [°]" if len(names) > 1 else f"{names[0].capitalize()}  [°]"
        strip_chart(canvas, box, title, series, span, nice(1.2 * limit), limit=limit, note=f"limits ±{limit:g}°")
