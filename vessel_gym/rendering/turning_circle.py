"""The picture of a turning circle: the map on the left, what is true and what is believed on the right."""

import numpy as np

from estimators import wrap
from vessel_gym.core import Core
from vessel_gym.rendering import register_scene
from vessel_gym.rendering.canvas import (
    BELIEVED,
    BELIEVED_PALE,
    COMMANDED,
    CURRENT,
    EDGE,
    LIMIT,
    MUTED,
    PANEL,
    TEXT,
    TRUE,
    TRUE_PALE,
    TRUE_SOFT,
    WATER,
    Box,
    Canvas,
    PlanView,
    Series,
    comparison_chart,
    draw_grid,
    draw_north,
    draw_scale_bar,
    nice,
    ship_outline,
    strip_chart,
)
from vessel_gym.rendering.journey import Journey, Sample, deviation
from vessel_gym.tasks.circle_track import TRACK, CircleTrack
from vessel_gym.tasks.turning_circle import TurningCircle
from vessel_gym.tracks import believed_path, commanded_path

_SHIP_PIXELS = 88.0  # least length of a ship on the map
_WEDGE_FACTORS = (50, 20, 10, 5, 2, 1)
_WEDGE = np.deg2rad(9.0)  # the widest half-angle to which a wedge is magnified
_HEADING = 2  # of the estimate's components


def wedge_factor(sd: float) -> int:
    """By how much a wedge of two standard deviations [rad] is magnified to be seen."""
    if sd == 0.0:
        return 1
    return next((factor for factor in _WEDGE_FACTORS if 2.0 * sd * factor <= _WEDGE), 1)


@register_scene(TurningCircle)
class TurningCircleScene(Journey):
    """History and picture of one ship on a commanded turn.

    Args:
        core: The environment's core.
        row: Which environment of the batch is shown.
    """

    _task: TurningCircle

    def __init__(self, core: Core, row: int = 0) -> None:
        assert isinstance(core.task, TurningCircle)
        super().__init__(core, (), row)
        self._ship = core.task.ship
        self._hull = ship_outline(self._ship.beam / self._ship.length)
        self._commanded = np.zeros((1, 2))
        self._tracked = isinstance(core.task, CircleTrack)

    def begin(self) -> None:
        """Start an episode with the course that the task has drawn."""
        super().begin()
        self._commanded = commanded_path(self._task, self._core.course[self._row])

    def draw(self, canvas: Canvas) -> None:
        """Draw the episode so far."""
        history = self.history()
        width, height = canvas.size
        canvas.clear()
        self._header(canvas, Box(16, 0, width - 32, 52), history)
        self._map(canvas, Box(16, 52, 584, height - 68), history)
        self._charts(canvas, Box(612, 52, width - 628, height - 68), history)

    # --- parts of the picture -----------------------------------------------------------------------

    def _header(self, canvas: Canvas, box: Box, history: Sample) -> None:
        core = self._core
        y = box.top + 27
        x = box.left + canvas.text(box.left, y, self.title, TEXT, 17, bold=True) + 16
        canvas.text(x, y, self.conditions("sea"), MUTED, 13)
        time = history.step[-1] * self._task.dt
        score = core.total[self._row] / self._task.horizon
        canvas.text(box.right, y, f"{score:.3f}", TEXT, 15, "right", bold=True)
        canvas.text(box.right - 50, y, "score", MUTED, 13, "right")
        canvas.text(box.right - 108, y, f"{time:.1f} s", TEXT, 15, "right", bold=True)

    def _map(self, canvas: Canvas, box: Box, history: Sample) -> None:
        canvas.panel(box, WATER)
        true = history.truth[:, :2]
        believed = believed_path(history.estimate, self._ship, self._task.dt)
        believed = believed if self._tracked else true[0] + believed
        sea = box.inset(2, 2, 2, 66)
        view = PlanView(sea, np.concatenate([self._commanded, true, believed]), margin=84.0)
        draw_grid(canvas, view)
        length = max(self._ship.length * view.scale, _SHIP_PIXELS)
        heading_sd = history.sd(_HEADING)
        factor = wedge_factor(float(heading_sd.max()))
        half = 2.0 * factor * heading_sd[-1]
        psi, psi_hat = history.truth[-1, 2], history.estimate[-1, 2]

        if half > 0.0:
            angles = np.linspace(-half, half, 17)
            sector = 1.4 * np.stack([np.cos(angles), np.sin(angles)], -1)
            sector = np.concatenate([np.zeros((1, 2)), sector])
            canvas.polygon(view.body(sector, believed[-1], psi_hat, length), BELIEVED_PALE, BELIEVED, 0.5)
        canvas.dashes(view.pixels(self._commanded), COMMANDED, 1.5)
        canvas.line(view.pixels(believed), BELIEVED, 1.5)
        canvas.line(view.pixels(true), TRUE, 2.0)
        canvas.dot(view.pixels(true[0]), TRUE, 4.0)
        canvas.dot(view.pixels(true[0]), PANEL, 2.0)
        self._draw_ship(canvas, view, true[-1], psi, length, history.actuators[-1, 0])
        canvas.outline(view.body(self._hull, believed[-1], psi_hat, length), BELIEVED, 1.5)

        draw_scale_bar(canvas, view, box.left + 18, sea.bottom - 12)
        draw_north(canvas, box.right - 28, box.top + 44)
        self._draw_current(canvas, box)
        magnified = length / (self._ship.length * view.scale)
        self._legend(canvas, box.left, sea.bottom, box.width, magnified, factor)

    def _draw_ship(
        self, canvas: Canvas, view: PlanView, at: np.ndarray, heading: float, length: float, rudder: float
    ) -> None:
        stern = np.array([-0.49, 0.0])
        blade = np.stack([stern, stern + 0.2 * np.array([-np.cos(rudder), np.sin(rudder)])])
        canvas.line(view.body(blade, at, heading, length), LIMIT, 2.0)
        canvas.polygon(view.body(self._hull, at, heading, length), TRUE_PALE, TRUE, 1.5)

    def _draw_current(self, canvas: Canvas, box: Box) -> None:
        _, north, east, *_ = self._core.forcing[self._row]
        speed = float(np.hypot(north, east))
        x, y = box.left + 34, box.top + 34
        half = 16.0 * np.array([east, -north]) / max(speed, 1e-9)
        canvas.arrow((x - half[0], y - half[1]), (x + half[0], y + half[1]), CURRENT)
        canvas.text(x + 26, y, f"current {speed:.2f} m/s", CURRENT, 12)

    def _legend(self, canvas: Canvas, left: float, top: float, width: float, magnified: float, factor: int) -> None:
        canvas.line(np.array([[left, top], [left + width, top]]), EDGE, 1.0)
        x, y = left + np.array([16.0, 194.0, 336.0]), top + np.array([20.0, 44.0])
        for column, (label, colour) in enumerate(
            [
                ("commanded path", COMMANDED),
                ("true track", TRUE),
                ("believed track" if self._tracked else "believed track (dead-reckoned)", BELIEVED),
            ]
        ):
            sample = np.array([[x[column], y[0]], [x[column] + 26, y[0]]])
            (canvas.dashes if colour == COMMANDED else canvas.line)(sample, colour, 2.0)
            canvas.text(x[column] + 34, y[0], label, TEXT, 12)
        icon = self._hull * 26.0
        canvas.polygon(icon + [x[0] + 13, y[1]], TRUE_PALE, TRUE, 1.2)
        size = f", drawn {magnified:.1f}×" if magnified > 1.05 else ""
        canvas.text(x[0] + 34, y[1], "true ship" + size, TEXT, 12)
        canvas.outline(icon + [x[1] + 13, y[1]], BELIEVED, 1.2)
        canvas.text(x[1] + 34, y[1], "believed ship", TEXT, 12)
        wedge = np.array([[0.0, 0.0], [24.0, -5.0], [24.0, 5.0]])
        canvas.polygon(wedge + [x[2] + 1, y[1]], BELIEVED_PALE, BELIEVED, 0.5)
        words = f"believed heading ±2σ, {factor}×" if factor > 1 else "believed heading ±2σ"
        canvas.text(x[2] + 34, y[1], words, TEXT, 12)

    def _charts(self, canvas: Canvas, box: Box, history: Sample) -> None:
        dt, gap = self._task.dt, 10.0
        time = history.step * dt
        span = 0.0, max(self._task.horizon * dt, float(time[-1]))
        height = (box.height - 3 * gap) / 4
        rows = [Box(box.left, box.top + i * (height + gap), box.width, height) for i in range(4)]
        deg = np.rad2deg

        true = deg(wrap(history.reference[:, 0] - history.truth[:, 2]))
        believed = deg(wrap(history.reference[:, 0] - history.estimate[:, 2]))
        sd = deg(history.sd(_HEADING))
        if isinstance(self._task, CircleTrack):
            course = self._core.course[self._row][None]
            along = np.stack([history.truth[:, :2], history.estimate[:, :2]])
            true, believed = (self._task.off_track(course, each[:, None])[:, 0] for each in along)
            side = history.reference[:, TRACK] + 0.5 * np.pi
            direction = np.zeros((len(side), history.cov.shape[-1]))
            direction[:, 0], direction[:, 1] = np.cos(side), np.sin(side)
            comparison_chart(
                canvas, rows[0], "To starboard of the track  [m]", time, span, 10.0, true, believed,
                deviation(direction, history.cov),
            )  # fmt: skip
        else:
            comparison_chart(canvas, rows[0], "Heading error  [°]", time, span, 2.0, true, believed, sd)

        rates = [
            deg(rate)
            for rate in (history.reference[:, 1], history.estimate[:, 5 if self._tracked else 1], history.truth[:, 5])
        ]
        strip_chart(
            canvas, rows[1], "Yaw rate  [°/s]",
            [
                Series("true", TRUE_SOFT, time, rates[2], 3.5),
                Series("believed", BELIEVED, time, rates[1]),
                Series("commanded", TEXT, time, rates[0], 1.0, dashed=True),
            ],
            span, _reach(1.0, *rates, deg(history.reference[:, 3])),
        )  # fmt: skip

        limit = float(deg(self._ship.rudder_limit))
        strip_chart(
            canvas, rows[2], "Rudder  [°]", [Series("", TRUE, time, deg(history.actuators[:, 0]), 1.6)],
            span, 40.0, limit=limit, note=f"limits ±{limit:g}°",
        )  # fmt: skip

        d, d_hat = 1e3 * history.kicks[:, 0], 1e3 * history.input_estimate[:, 0]
        estimated = np.isfinite(d_hat).all()
        lines = [Series("true", TRUE_SOFT if estimated else TRUE, time, d, 3.5 if estimated else 1.2)]
        if estimated:
            delay = (self._core.filter.input_delay or 0) * dt
            lines.append(Series("estimated", BELIEVED, time - delay, d_hat))
        strip_chart(
            canvas, rows[3], "Unknown yaw kick d  [mrad]", lines, span,
            _reach(1.0, *(line.value for line in lines)), note="" if estimated else "not estimated",
        )  # fmt: skip


def _reach(least: float, *values: np.ndarray) -> float:
    """A round number that no value exceeds in size."""
    return nice(max(least, *(float(np.abs(value).max()) for value in values)))
