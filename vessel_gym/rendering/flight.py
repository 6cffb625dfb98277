"""The picture of a flight: path, obstacles and wind from above, where the aircraft is and where it believes to be."""

import numpy as np

from vessel_gym.core import Core
from vessel_gym.guidance.dubins import Path
from vessel_gym.guidance.path_following import COLUMNS, track
from vessel_gym.rendering import register_scene
from vessel_gym.rendering.canvas import (
    BELIEVED,
    CIRCLE,
    COMMANDED,
    CURRENT,
    FIX,
    LIMIT,
    MEMBER,
    MUTED,
    OBSTACLE,
    PANEL,
    TRUE,
    TRUE_PALE,
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
    scale_bar_length,
    two_sigma,
)
from vessel_gym.rendering.journey import Journey, Sample, deviation
from vessel_gym.tasks.flight import OBSTACLES, SEGMENTS, Flight

SPAN = 2.1
"""Wing span [m] of the Skywalker X8, Gryte (2018); the point mass has none."""

_AIRCRAFT_PIXELS = 26.0  # least span of an aircraft in the large view
_STEP = 60.0  # least pixels from one grid line to the next
_CLOSE_STEP = 40.0
_GAP = 10.0
_LEFT = 488.0  # width of the plan view
_CHART = 124.0  # height of a chart

# Half of a flying wing, in spans: nose, leading edge, tip with its fin, trailing edge, stern.
_HALF = np.array([
    [0.17, 0.0], [0.15, 0.035], [0.08, 0.07], [-0.12, 0.48], [-0.13, 0.5], [-0.25, 0.5], [-0.22, 0.47], [-0.1, 0.1],
    [-0.13, 0.03], [-0.13, 0.0],
])  # fmt: skip
_AIRCRAFT = np.concatenate([_HALF, _HALF[-2:0:-1] * [1.0, -1.0]])
_AIR = np.hstack([np.eye(3, 7, 3), np.diag([-1.0, -1.0, 1.0])])
"""What of a state and a wind is the velocity through the air: north, east, up."""


@register_scene(Flight)
class FlightScene(Journey):
    """History and picture of one aircraft on a planned path round obstacles.

    Args:
        core: The environment's core.
        row: Which environment of the batch is shown.
    """

    _task: Flight

    def __init__(self, core: Core, row: int = 0) -> None:
        assert isinstance(core.task, Flight)
        super().__init__(core, ("x", "y"), row)
        self._segments = np.zeros(0)
        self._path = self._obstacles = np.zeros((0, 3))
        self._goal = np.zeros(3)
        self._length = self._altitude = 0.0

    def begin(self) -> None:
        """Start an episode with the course that the task has drawn."""
        super().begin()
        course, task = self._core.course[self._row], self._task
        self._segments = course[: COLUMNS * SEGMENTS].copy()
        rows = self._segments.reshape(SEGMENTS, COLUMNS)
        path = Path(rows[rows[:, 4] > 0.0])
        self._path, self._length = path.sample(3.0), path.length
        obstacles = course[-3 * OBSTACLES :].reshape(OBSTACLES, 3)
        self._obstacles = obstacles[obstacles[:, 2] > 0.0]
        self._goal, self._altitude = task.goal(course[None])[0], float(task.altitude_of(course))

    def draw(self, canvas: Canvas) -> None:
        """Draw the episode so far."""
        history = self.history()
        missed = np.hypot(*(history.truth[-1, :2] - self._goal[:2]))
        box = self.sheet(canvas, f"{missed:.1f} m")
        left = Box(box.left, box.top, _LEFT, box.height - _CHART - _GAP)
        right = Box(left.right + _GAP, box.top, box.width - _LEFT - _GAP, box.height - 3 * (_CHART + _GAP))
        half = (right.width - _GAP) / 2
        self._plan(canvas, left, history)
        self._close_up(canvas, Box(right.left, right.top, half, right.height), history)
        self._legend(canvas, Box(right.left + half + _GAP, right.top, half, right.height), history)
        boxes = [Box(right.left, right.bottom + _GAP + i * (_CHART + _GAP), right.width, _CHART) for i in range(3)]
        self._charts(canvas, [Box(left.left, left.bottom + _GAP, left.width, _CHART), *boxes], history)

    # --- parts of the picture -----------------------------------------------------------------------

    def _plan(self, canvas: Canvas, box: Box, history: Sample) -> None:
        """The whole flight from above."""
        draw_map(canvas, box, "Seen from above")
        air = box.inset(2, 34, 2, 50)
        around = self._obstacles[:, None, :2] + self._obstacles[:, None, 2:] * CIRCLE
        points = [self._path[:, :2], history.truth[:, :2], history.estimate[:, :2], around.reshape(-1, 2)]
        frame = PlanView(air.inset(0, 0, 24, 0), np.concatenate(points), 26.0)  # clear of the north arrow
        span = max(SPAN * frame.scale, _AIRCRAFT_PIXELS)
        with canvas.clipped(air):
            draw_grid(canvas, frame, _STEP, air)
            self._scene(canvas, frame, history, span, 1.2)
        self._scale(canvas, frame, box.left + 16, box.bottom - 14, _STEP, span)
        draw_north(canvas, box.right - 24, box.top + 42)
        flows = [history.flow[-1, :2], history.believed_flow[-1, :2]]
        draw_flows(canvas, box, "wind", [(flow, flow) for flow in flows])

    def _close_up(self, canvas: Canvas, box: Box, history: Sample) -> None:
        """What is around the believed aircraft, to scale."""
        spread = two_sigma(history.cov[-1, :2, :2])
        frame = close_up(
            canvas, box, "Close-up", history.estimate[-1, :2], history.truth[-1, :2], spread, SPAN, 3.0
        )  # fmt: skip
        with canvas.clipped(frame.box):
            draw_grid(canvas, frame, _CLOSE_STEP)
            span = max(SPAN * frame.scale, 0.7 * _AIRCRAFT_PIXELS)
            self._scene(canvas, frame, history, span, 1.7)
        self._scale(canvas, frame, box.left + 12, box.bottom - 9, _CLOSE_STEP, span)

    def _scale(self, canvas: Canvas, frame: PlanView, left: float, y: float, step: float, span: float) -> None:
        """A scale bar, and how much larger than to scale the aircraft are drawn."""
        draw_scale_bar(canvas, frame, left, y, step)
        magnified = span / (SPAN * frame.scale)
        words = f"aircraft drawn {magnified:.2g}×" if magnified > 1.05 else "aircraft to scale"
        canvas.text(left + scale_bar_length(frame, step) * frame.scale + 14, y - 3, words, MUTED, 11)

    def _scene(self, canvas: Canvas, frame: PlanView, history: Sample, span: float, radius: float) -> None:
        """All that lies on a map: obstacles, path, tracks, fixes, belief and aircraft."""
        goal, tolerance = frame.pixels(self._goal[:2]), self._task.GOAL_TOLERANCE * frame.scale
        canvas.dot(goal, PANEL, tolerance)
        if self.members is None:
            draw_spread(canvas, frame.pixels(history.estimate[-1, :2] + two_sigma(history.cov[-1, :2, :2])))
        for x, y, size in self._obstacles:
            at = np.array([x, y])
            canvas.polygon(frame.pixels(at + size * CIRCLE), OBSTACLE, LIMIT, 1.0)
            canvas.dashes(frame.pixels(at + (size + self._task.margin) * CIRCLE), LIMIT, 0.8, 2.0, 4.0)
        canvas.dashes(frame.pixels(self._path[:, :2]), COMMANDED, 1.5)
        canvas.line(frame.pixels(history.estimate[:, :2]), BELIEVED, 1.5)
        canvas.line(frame.pixels(history.truth[:, :2]), TRUE, 2.0)
        canvas.ring(goal, CURRENT, tolerance, 1.0)
        canvas.dot(goal, CURRENT, min(2.0, 0.4 * tolerance))
        draw_start(canvas, frame.pixels(self._path[0, :2]))
        for fix in self._fixes:
            canvas.cross(frame.pixels(fix[:2]), FIX, 2.0 * radius, 1.2)
        for at in frame.pixels(self.members[:, :2]) if self.members is not None else ():
            canvas.dot(at, MEMBER, radius)
        canvas.polygon(self._placed(frame, history.truth[-1], history.flow[-1], span), TRUE_PALE, TRUE, 1.5)
        believed = self._placed(frame, history.estimate[-1], history.believed_flow[-1], span)
        canvas.outline(believed, BELIEVED, 1.5)

    def _placed(self, frame: PlanView, state: np.ndarray, wind: np.ndarray, span: float) -> np.ndarray:
        """An aircraft on a map: its nose points where it flies through the air, a bank narrows its wing."""
        north, east, _ = _AIR @ np.concatenate([state, wind])
        return frame.body(_AIRCRAFT * [1.0, np.cos(state[6])], state[:2], float(np.arctan2(east, north)), span)

    def _legend(self, canvas: Canvas, box: Box, history: Sample) -> None:
        task = self._task
        labels = {
            "path": "planned path",
            "start": "start",
            "goal": f"goal, reached within {task.GOAL_TOLERANCE:g} m",
            "obstacle": "obstacle",
            "berth": f"the path stays {task.margin:g} m clear",
            "true": "true aircraft, its track",
            "believed": "believed aircraft, its track",
            **self.belief_label(history.cov[-1, :2, :2]),
            "fix": "GNSS fix, once a second",
        }
        self.legend(canvas, box, labels, (box.height - 16) / len(labels), _AIRCRAFT * 22.0)

    # --- charts -------------------------------------------------------------------------------------

    def _charts(self, canvas: Canvas, boxes: list[Box], history: Sample) -> None:
        """Altitude, and in the other boxes what is right of the path, bank and airspeed."""
        task = self._task
        time = history.step * task.dt
        usual = max(1.1 * self._length / task.body.cruise_speed, float(time[-1]))
        span = 0.0, 12.0 * np.ceil(usual / 12.0)
        commanded = Series("commanded", COMMANDED, np.array(span), np.full(2, self._altitude), 1.2, dashed=True)
        comparison_chart(
            canvas, boxes[0], "Altitude  [m]", time, span, 5.0, history.truth[:, 2], history.estimate[:, 2],
            history.sd(2), middle=float(round(self._altitude)), behind=[commanded],
        )  # fmt: skip
        comparison_chart(canvas, boxes[1], "Right of the path  [m]", time, span, 3.0, *self._across(history), task.LOST)
        self._banks(canvas, boxes[2], time, span, history)
        pairs = (history.truth, history.flow), (history.estimate, history.believed_flow)
        through = [np.concatenate(pair, -1) @ _AIR.T for pair in pairs]
        true, believed = np.linalg.norm(through, axis=-1)
        ahead = through[1] / np.maximum(believed, 1e-9)[:, None] @ _AIR
        comparison_chart(
            canvas, boxes[3], "Airspeed  [m/s]", time, span, 3.0, true, believed, deviation(ahead, history.cov),
            middle=float(round(task.body.cruise_speed)),
        )  # fmt: skip

    def _across(self, history: Sample) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distance to starboard of the path [m]: true, believed, and the latter's standard deviation."""
        window = self._task.WINDOW
        on = [
            track(states[:, :2], self._segments, history.tally[:, 0] - window, history.tally[:, 0] + window)
            for states in (history.truth, history.estimate)
        ]
        across = np.zeros((len(history.step), history.cov.shape[-1]))
        across[:, 0], across[:, 1] = -np.sin(on[1][:, 2]), np.cos(on[1][:, 2])
        return on[0][:, 1], on[1][:, 1], deviation(across, history.cov)

    def _banks(
        self, canvas: Canvas, box: Box, time: np.ndarray, span: tuple[float, float], history: Sample
    ) -> None:  # fmt: skip
        limit = float(np.rad2deg(self._task.body.bank_limit))
        true, believed, command, sd = np.rad2deg(
            [history.truth[:, 6], history.estimate[:, 6], history.actuators[:, 2], history.sd(6)]
        )
        comparison_chart(
            canvas, box, "Bank  [°]", time, span, 1.2 * limit, true, believed, sd, limit, "limit of the command",
            behind=[Series("commanded", COMMANDED, time, command, 1.2, dashed=True)],
        )  # fmt: skip
