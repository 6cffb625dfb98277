"""The plain picture of any task: where the vehicle is and believes to be, its state over time, actions and score."""

import numpy as np

from estimators.angles import difference
from vessel_gym.core import Core
from vessel_gym.rendering.canvas import (
    BELIEVED,
    CURRENT,
    EDGE,
    FIX,
    LIMIT,
    TEXT,
    TRUE,
    Box,
    Canvas,
    PlanView,
    Series,
    comparison_chart,
    draw_grid,
    draw_icon,
    draw_map,
    draw_north,
    draw_scale_bar,
    draw_spread,
    draw_start,
    nice,
    strip_chart,
    two_sigma,
)
from vessel_gym.rendering.journey import Journey, Sample

_GAP = 10.0
_LEFT = 488.0  # width of the map
_CHARTS = 5  # in a column
_LINES = (TRUE, CURRENT, FIX, LIMIT)
_PLANES = (
    ("x", "y", "Seen from above", 1.0),
    ("x", "z", "Seen from the side", -1.0),
    ("x", "h", "Seen from the side", 1.0),
)
"""Components of the state that make a map: those along its two sides, its title, and where the second one points."""


class PlainScene(Journey):
    """History and picture of one vehicle, of which no more is known than what every `vessel_gym.system.Vehicle` tells.

    A map is drawn where the state has the components x and y, or x and z or h; then charts of what is estimated beside
    the position, as many as there is room for, each with twice its standard deviation.

    Args:
        core: The environment's core.
        row: Which environment of the batch is shown.
    """

    def __init__(self, core: Core, row: int = 0) -> None:
        super().__init__(core, (), row)
        self._names = core.vehicle.state_names
        self._plane = next((p for p in _PLANES if p[0] in self._names and p[1] in self._names), None)

    def draw(self, canvas: Canvas) -> None:
        """Draw the episode so far."""
        history = self.history()
        box, told = self.sheet(canvas, ""), self._core.composition
        names = told.names[: told.base]
        shown = [(i, name) for i, name in enumerate(names) if self._plane is None or name not in self._plane[:2]]
        low = (box.height - (_CHARTS - 1) * _GAP) / _CHARTS
        left = Box(box.left, box.top, _LEFT, box.height - low - _GAP)
        right = Box(left.right + _GAP, box.top, box.width - _LEFT - _GAP, left.height)
        time = history.step * self._core.vehicle.dt
        end = max(self._task.horizon * self._core.vehicle.dt, float(time[-1]))
        span = 0.0, 6.0 * np.ceil(end / 6.0)  # six whole steps of the axis
        if self._plane is not None:
            self._map(canvas, left, history, names)
        else:
            self._states(canvas, left, time, span, history, shown[1::2])
        self._states(canvas, right, time, span, history, shown if self._plane is not None else shown[::2])
        self._actions(canvas, Box(left.left, left.bottom + _GAP, left.width, low), time, span, history)
        score = history.total / self._task.perfect
        worst = float(score.min())
        strip_chart(
            canvas, Box(right.left, right.bottom + _GAP, right.width, low), "Score so far",
            [Series("", TRUE, time, score, 2.0)], span, nice(max(1.0, float(score.max()))),
            lowest=-nice(-worst) if worst < 0.0 else 0.0,
        )  # fmt: skip

    # --- parts of the picture -----------------------------------------------------------------------

    def _map(self, canvas: Canvas, box: Box, history: Sample, names: tuple[str, ...]) -> None:
        """Tracks in the plane of two components of the position, and how sure the estimator is of where it is."""
        assert self._plane is not None
        first, second, title, sign = self._plane
        aside = second != "y"
        draw_map(canvas, box, title)
        sea = box.inset(2, 34, 2, 70)
        # A map's first coordinate goes up: from above that is x, to the north, from the side the height.
        order = [(second, sign), (first, 1.0)] if aside else [(first, 1.0), (second, sign)]
        signs = np.array([sign for _, sign in order])
        true = history.truth[:, [self._names.index(name) for name, _ in order]] * signs
        known = all(name in names for name, _ in order)
        points, ellipse = true, np.zeros((1, 2))
        if known:
            index = [names.index(name) for name, _ in order]
            believed = history.estimate[:, index] * signs
            cov = history.cov[-1][np.ix_(index, index)] * np.outer(signs, signs)
            ellipse = believed[-1] + two_sigma(cov)
            points = np.concatenate([true, believed, ellipse])
        middle = 0.5 * (points.min(0) + points.max(0))
        frame = PlanView(sea, np.concatenate([points, middle + [[-5.0, -5.0], [5.0, 5.0]]]), 40.0)
        with canvas.clipped(sea):
            draw_grid(canvas, frame, 60.0, sea)
            if known:
                draw_spread(canvas, frame.pixels(ellipse))
                canvas.line(frame.pixels(believed), BELIEVED, 1.5)
            canvas.line(frame.pixels(true), TRUE, 2.0)
            draw_start(canvas, frame.pixels(true[0]))
            canvas.dot(frame.pixels(true[-1]), TRUE, 5.0)
            if known:
                canvas.ring(frame.pixels(believed[-1]), BELIEVED, 7.0, 1.5)
        draw_scale_bar(canvas, frame, box.left + 16, sea.bottom - 10, 60.0)
        if not aside:
            draw_north(canvas, box.right - 24, box.top + 42)
        self._legend(canvas, Box(box.left, sea.bottom, box.width, box.bottom - sea.bottom), known)

    def _legend(self, canvas: Canvas, box: Box, known: bool) -> None:
        canvas.line(np.array([[box.left, box.top], [box.right, box.top]]), EDGE, 1.0)
        labels = {"start": "start", "where": "true position, its track"}
        labels |= (
            {"belief": "believed position, its track", "ellipse": "believed position ±2σ"}
            if known else {"none": "(no estimate of the position)"}
        )  # fmt: skip
        for i, (kind, label) in enumerate(labels.items()):
            at = np.array([box.left + 30 + 230 * (i % 2), box.top + 20 + 26 * (i // 2)])
            line = at + [[-14.0, 0.0], [14.0, 0.0]]
            if kind == "where":
                canvas.line(line, TRUE, 2.0)
                canvas.dot(at, TRUE, 5.0)
            elif kind == "belief":
                canvas.line(line, BELIEVED, 1.5)
                canvas.ring(at, BELIEVED, 7.0, 1.5)
            else:
                draw_icon(canvas, kind, at)
            canvas.text(at[0] + 22, at[1], label, TEXT, 12)

    def _states(
        self, canvas: Canvas, box: Box, time: np.ndarray, span: tuple[float, float], history: Sample,
        shown: list[tuple[int, str]],
    ) -> None:  # fmt: skip
        """A chart of each of some components of what is estimated, while there is room."""
        shown = shown[: _CHARTS - 1]
        each = (box.height + _GAP) / max(len(shown), 1)
        told = self._core.composition
        names = told.names[: told.base]
        state = history.truth[:, [self._names.index(name) for name in names]]
        # An estimate that is a full turn off is not wrong: it is drawn beside the truth.
        angles = tuple(i for i, name in enumerate(names) if name in self._core.vehicle.angles)
        believed = state + difference(history.estimate, state, angles)
        for row, (i, name) in enumerate(shown):
            place = Box(box.left, box.top + row * each, box.width, each - _GAP)
            sd, middle = history.sd(i), _middle(np.concatenate([state[:, i], believed[:, i]]))
            comparison_chart(canvas, place, name, time, span, 1e-3, state[:, i], believed[:, i], sd, middle=middle)

    def _actions(
        self, canvas: Canvas, box: Box, time: np.ndarray, span: tuple[float, float], history: Sample
    ) -> None:  # fmt: skip
        """What was asked for, between the limits -1 and 1; the first few of many."""
        named = zip(self._core.vehicle.action_names, _LINES, history.action.T, strict=False)
        lines = [Series(name, colour, time, values, 1.4) for name, colour, values in named]
        strip_chart(canvas, box, "Actions", lines, span, 1.0)


def _middle(values: np.ndarray) -> float:
    """What a chart of values is drawn about: zero, unless they all lie far from it; a round number."""
    middle, half = 0.5 * (values.max() + values.min()), 0.5 * np.ptp(values)
    if abs(middle) < 3.0 * half or abs(middle) < 1e-2:
        return 0.0
    step = nice(max(half, 1e-3 * abs(middle)))
    return float(np.round(middle / step) * step)
