"""What every scene draws with: palette, canvas, header, plan view, strip chart, ship outline.

Coordinates are pixels of the finished picture, x to the right and y down; points are arrays ``(n, 2)``.
"""

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
import pygame

Colour = tuple[int, int, int]
Point = tuple[float, float]
Align = Literal["left", "centre", "right"]

PAPER: Colour = (241, 244, 247)
PANEL: Colour = (255, 255, 255)
WATER: Colour = (246, 250, 253)
EDGE: Colour = (221, 227, 234)
GRID: Colour = (234, 238, 243)
ZERO: Colour = (203, 211, 220)
TEXT: Colour = (31, 41, 55)
MUTED: Colour = (104, 116, 131)
TRUE: Colour = (29, 88, 158)
TRUE_PALE: Colour = (196, 214, 234)
TRUE_SOFT: Colour = (128, 171, 219)
BELIEVED: Colour = (226, 112, 22)
BELIEVED_PALE: Colour = (253, 228, 205)
COMMANDED: Colour = (138, 150, 164)
LIMIT: Colour = (196, 61, 61)
CURRENT: Colour = (20, 140, 126)
MEMBER: Colour = (240, 165, 98)
FIX: Colour = (128, 78, 168)
OBSTACLE: Colour = (240, 216, 214)

CIRCLE = np.stack([np.cos(np.linspace(0.0, 2.0 * np.pi, 48)), np.sin(np.linspace(0.0, 2.0 * np.pi, 48))], -1)
"""Points ``(48, 2)`` of a unit circle."""

_OVERSAMPLING = 2
_FONTS = "dejavusans,segoeui,helveticaneue,arial,liberationsans,notosans,freesans"


@dataclass(frozen=True)
class Box:
    """A rectangle of the picture."""

    left: float
    top: float
    width: float
    height: float

    @property
    def right(self) -> float:
        """The right edge."""
        return self.left + self.width

    @property
    def bottom(self) -> float:
        """The lower edge."""
        return self.top + self.height

    def inset(self, left: float, top: float, right: float, bottom: float) -> "Box":
        """The box inside these margins."""
        return Box(self.left + left, self.top + top, self.width - left - right, self.height - top - bottom)


@lru_cache(maxsize=16)
def _font(size: int, bold: bool) -> pygame.font.Font:
    pygame.font.init()
    pygame.register_quit(_font.cache_clear)  # fonts die with pygame, which other environments quit when they close
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # no list of system fonts: pygame brings one of its own
        path = pygame.font.match_font(_FONTS, bold=bold)
    return pygame.font.Font(path, size * _OVERSAMPLING if path else round(1.3 * size * _OVERSAMPLING))


@lru_cache(maxsize=1024)
def _label(text: str, size: int, colour: Colour, bold: bool) -> pygame.Surface:
    return _font(size, bold).render(text, True, colour)


class Canvas:
    """A picture in memory, drawn oversampled and scaled down.

    Args:
        width: Pixels of the finished picture.
        height: Likewise.
    """

    def __init__(self, width: int, height: int) -> None:
        self.size = width, height
        self._ink = pygame.Surface((width * _OVERSAMPLING, height * _OVERSAMPLING), depth=32)
        self._page = pygame.Surface(self.size, depth=32)

    def clear(self, colour: Colour = PAPER) -> None:
        """Begin a new picture."""
        self._ink.fill(colour)

    def finish(self) -> pygame.Surface:
        """The picture; it is valid until the next `finish`."""
        pygame.transform.smoothscale(self._ink, self.size, self._page)
        return self._page

    @contextmanager
    def clipped(self, box: Box) -> Iterator[None]:
        """Draw nothing outside a box meanwhile."""
        k = _OVERSAMPLING
        self._ink.set_clip(pygame.Rect(box.left * k, box.top * k, box.width * k, box.height * k))
        try:
            yield
        finally:
            self._ink.set_clip(None)

    def panel(self, box: Box, colour: Colour = PANEL) -> None:
        """A card with a thin edge."""
        k = _OVERSAMPLING
        rect = pygame.Rect(box.left * k, box.top * k, box.width * k, box.height * k)
        pygame.draw.rect(self._ink, colour, rect, border_radius=6 * k)
        pygame.draw.rect(self._ink, EDGE, rect, width=k, border_radius=6 * k)

    def line(self, points: np.ndarray, colour: Colour, width: float = 1.5) -> None:
        """A line through points."""
        if len(points) > 1:
            pygame.draw.lines(self._ink, colour, False, _scaled(points), max(1, round(width * _OVERSAMPLING)))

    def dashes(self, points: np.ndarray, colour: Colour, width: float = 1.5, on: float = 6.0, off: float = 4.0) -> None:
        """A dashed line through points."""
        length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
        starts = np.arange(0.0, length[-1], on + off)
        ends = np.minimum(starts + on, length[-1])
        first, last = np.searchsorted(length, starts, "right"), np.searchsorted(length, ends, "left")
        tails, heads = (np.stack([np.interp(at, length, column) for column in points.T], -1) for at in (starts, ends))
        for i in range(len(starts)):
            self.line(np.concatenate([tails[i : i + 1], points[first[i] : last[i]], heads[i : i + 1]]), colour, width)

    def polygon(self, points: np.ndarray, colour: Colour, outline: Colour | None = None, width: float = 1.0) -> None:
        """A filled polygon, with an outline if a colour is given for it."""
        pygame.draw.polygon(self._ink, colour, _scaled(points))
        if outline is not None:
            self.outline(points, outline, width)

    def outline(self, points: np.ndarray, colour: Colour, width: float = 1.0) -> None:
        """A closed line through points."""
        self.line(np.concatenate([points, points[:2]]), colour, width)

    def dot(self, at: Point | np.ndarray, colour: Colour, radius: float = 3.0) -> None:
        """A filled circle."""
        centre = (at[0] * _OVERSAMPLING, at[1] * _OVERSAMPLING)
        pygame.draw.circle(self._ink, colour, centre, radius * _OVERSAMPLING)

    def ring(self, at: Point | np.ndarray, colour: Colour, radius: float, width: float = 1.5) -> None:
        """A circle."""
        centre = (at[0] * _OVERSAMPLING, at[1] * _OVERSAMPLING)
        pygame.draw.circle(self._ink, colour, centre, radius * _OVERSAMPLING, max(1, round(width * _OVERSAMPLING)))

    def cross(self, at: Point | np.ndarray, colour: Colour, radius: float = 4.0, width: float = 1.5) -> None:
        """A small x."""
        arm = radius * np.array([[-1.0, -1.0], [1.0, 1.0]])
        self.line(arm + at, colour, width)
        self.line(arm * [1.0, -1.0] + at, colour, width)

    def arrow(self, start: Point, end: Point, colour: Colour, width: float = 2.0) -> None:
        """An arrow with a filled head."""
        tail, tip = np.array(start), np.array(end)
        along = (tip - tail) / max(float(np.hypot(*(tip - tail))), 1e-9)
        across = np.array([-along[1], along[0]])
        neck = tip - 4.0 * width * along
        self.line(np.array([tail, neck]), colour, width)
        self.polygon(np.array([tip, neck + 2.0 * width * across, neck - 2.0 * width * across]), colour)

    def text(
        self, x: float, y: float, text: str, colour: Colour = TEXT, size: int = 12, align: Align = "left",
        bold: bool = False,
    ) -> float:  # fmt: skip
        """Write a line of text, vertically centred on ``y``; returns its width."""
        label = _label(text, size, colour, bold)
        width, height = label.get_size()
        left = x * _OVERSAMPLING - {"left": 0.0, "centre": 0.5, "right": 1.0}[align] * width
        self._ink.blit(label, (round(left), round(y * _OVERSAMPLING - 0.5 * height)))
        return width / _OVERSAMPLING


def _scaled(points: np.ndarray) -> list[list[float]]:
    return (points * _OVERSAMPLING).tolist()


def nice(value: float) -> float:
    """The smallest of 1, 1.5, 2, 3, 5, 8 times a power of ten that is not below a positive value."""
    power = 10.0 ** np.floor(np.log10(value))
    return next(float(step * power) for step in (1.0, 1.5, 2.0, 3.0, 5.0, 8.0, 10.0) if step * power >= value * 0.9999)


def signed(value: float) -> str:
    """A number of a scale, with a true minus sign."""
    return f"{value:g}".replace("-", "−")


class PlanView:
    """A map with north up and east right: equal axes that show every given point.

    Args:
        box: Where it lies in the picture.
        points: ``(n, 2)`` north and east [m] that must be seen.
        margin: Free pixels around them.
    """

    def __init__(self, box: Box, points: np.ndarray, margin: float) -> None:
        low, high = points.min(0), points.max(0)
        north, east = np.maximum(high - low, 1.0)
        self.box = box
        self.scale = float(min((box.width - 2 * margin) / east, (box.height - 2 * margin) / north))
        """Pixels a metre."""
        self._middle = 0.5 * (low + high)
        self._centre = np.array([box.left + 0.5 * box.width, box.top + 0.5 * box.height])

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Where points ``(..., 2)`` of north and east [m] lie in the picture."""
        offset = (points - self._middle) * self.scale
        return self._centre + offset[..., ::-1] * [1.0, -1.0]

    def body(self, shape: np.ndarray, at: np.ndarray, heading: float, length: float) -> np.ndarray:
        """Place a shape given in the body frame (x forward, y starboard, in lengths) on the map.

        Args:
            shape: ``(n, 2)``.
            at: ``(2,)`` north and east [m] of the body's origin.
            heading: Clockwise from north [rad].
            length: Pixels of one length.
        """
        cos, sin = np.cos(heading), np.sin(heading)
        north, east = shape[:, 0] * cos - shape[:, 1] * sin, shape[:, 0] * sin + shape[:, 1] * cos
        return self.pixels(at) + length * np.stack([east, -north], -1)


def draw_grid(canvas: Canvas, view: PlanView, least: float = 80.0, box: Box | None = None) -> None:
    """Thin lines along north and east, at the distance of the scale bar of the same ``least`` pixels, in a box."""
    box, step = view.box if box is None else box, view.scale * scale_bar_length(view, least)
    origin = view.pixels(np.zeros(2))
    for x in np.arange(box.left + (origin[0] - box.left) % step, box.right, step):
        canvas.line(np.array([[x, box.top], [x, box.bottom]]), GRID, 0.5)
    for y in np.arange(box.top + (origin[1] - box.top) % step, box.bottom, step):
        canvas.line(np.array([[box.left, y], [box.right, y]]), GRID, 0.5)


def scale_bar_length(view: PlanView, least: float = 80.0) -> float:
    """A round number of metres that takes between ``least`` pixels and 1.7 times as many or so."""
    return nice(least / view.scale)


def draw_scale_bar(canvas: Canvas, view: PlanView, left: float, y: float, least: float = 80.0) -> None:
    """A bar of a round length with its length in words."""
    metres = scale_bar_length(view, least)
    right = left + metres * view.scale
    canvas.line(np.array([[left, y - 4], [left, y], [right, y], [right, y - 4]]), MUTED, 1.5)
    canvas.text(0.5 * (left + right), y - 11, f"{metres:g} m", MUTED, 12, "centre")


def two_sigma(cov: np.ndarray) -> np.ndarray:
    """Two standard deviations about the origin ``(48, 2)``, of a covariance ``(2, 2)``; without any, one point."""
    values, vectors = np.linalg.eigh(cov)
    return 2.0 * (CIRCLE * np.sqrt(np.maximum(values, 0.0))) @ vectors.T


def draw_header(
    canvas: Canvas, box: Box, title: str, conditions: str, values: dict[str, str], outcome: str, colour: Colour
) -> None:
    """Title and conditions on the left; outcome and named values, the last first, on the right."""
    canvas.text(box.left, box.top + 21, title, TEXT, 17, bold=True)
    canvas.text(box.left, box.top + 44, conditions, MUTED, 13)
    right, y = box.right, box.top + 32
    for label, value in values.items():
        right -= canvas.text(right, y, value, TEXT, 15, "right", bold=True) + 8
        right -= canvas.text(right, y, label, MUTED, 13, "right") + 24
    canvas.text(right, y, outcome, colour, 15, "right", bold=True)


def draw_start(canvas: Canvas, at: np.ndarray) -> None:
    """Where a path begins."""
    canvas.dot(at, TEXT, 4.0)
    canvas.dot(at, PANEL, 2.2)


def draw_map(canvas: Canvas, box: Box, title: str) -> None:
    """The card of a map, with what is seen on it."""
    canvas.panel(box, WATER)
    canvas.text(box.left + 14, box.top + 18, title, TEXT, 13, bold=True)


def close_up(
    canvas: Canvas, box: Box, title: str, believed: np.ndarray, true: np.ndarray, spread: np.ndarray, body: float,
    least: float,
) -> PlanView:  # fmt: skip
    """The card and the view of what is around a believed vehicle: as far as to the true one, and as the belief spreads.

    Args:
        canvas: Where to draw.
        box: The card.
        title: What is seen.
        believed: ``(2,)`` where the vehicle believes to be [m].
        true: ``(2,)`` where it is [m].
        spread: ``(n, 2)`` two standard deviations about ``believed`` [m].
        body: The vehicle's length or span [m].
        least: How many times as much is seen to either side at least.
    """
    canvas.panel(box, WATER)
    canvas.text(box.left + 12, box.top + 15, title, TEXT, 12, bold=True)
    away = float(np.abs(true - believed).max()) + 0.55 * body
    half = nice(max(least * body, away, 1.2 * float(np.abs(spread).max())))
    return PlanView(box.inset(2, 28, 2, 30), np.array([believed - half, believed + half]), 0.0)


def draw_spread(canvas: Canvas, points: np.ndarray) -> None:
    """How sure an estimator is of a position: a pale area ``(n, 2)``, unless it is too small to be seen."""
    if np.ptp(points, 0).max() > 1.0:
        canvas.polygon(points, BELIEVED_PALE, MEMBER, 1.0)


def draw_icon(canvas: Canvas, kind: str, at: np.ndarray, body: np.ndarray = CIRCLE) -> None:
    """What an entry of a legend stands for; ``body (n, 2)`` is the outline of a vehicle in pixels."""
    line = at + [[-14.0, 0.0], [14.0, 0.0]]
    if kind == "path":
        canvas.dashes(line, COMMANDED, 1.5)
    elif kind == "start":
        draw_start(canvas, at)
    elif kind == "goal":
        canvas.ring(at, CURRENT, 7.0, 1.5)
        canvas.dot(at, CURRENT, 2.0)
    elif kind == "true":
        canvas.line(line, TRUE, 2.0)
        canvas.polygon(body + at, TRUE_PALE, TRUE, 1.2)
    elif kind == "believed":
        canvas.line(line, BELIEVED, 1.5)
        canvas.polygon(body + at, PANEL, BELIEVED, 1.2)
    elif kind == "ellipse":
        draw_spread(canvas, at + CIRCLE * [12.0, 6.0])
    elif kind == "fix":
        canvas.cross(at, FIX, 3.5, 1.5)
    elif kind == "fin":
        canvas.line(at + [[-7.0, 0.0], [7.0, 0.0]], LIMIT, 2.0)
    elif kind == "obstacle":
        canvas.polygon(at + CIRCLE * 7.0, OBSTACLE, LIMIT, 1.0)
    elif kind == "berth":
        canvas.dashes(line, LIMIT, 0.8, 2.0, 4.0)
    elif kind == "cloud":
        for member in ((-9, 1), (-5, -3), (-2, 3), (0, -1), (4, 4), (5, -2), (9, 0)):
            canvas.dot(at + member, MEMBER, 1.5)


def draw_flows(canvas: Canvas, box: Box, name: str, flows: Sequence[tuple[np.ndarray, np.ndarray]]) -> None:
    """A flow, true and believed, in the lower right corner of a box.

    Args:
        canvas: Where to draw.
        box: Where the corner is.
        name: Of the flow.
        flows: True and believed: the vector [m/s], and what of it points up and right in the picture. The arrows are
            in proportion.
    """
    longest = max(*(float(np.linalg.norm(flow)) for flow, _ in flows), 1e-9)
    for (flow, seen), label, colour, row in zip(flows, (name, "believed"), (TRUE, BELIEVED), (0, 1), strict=True):
        speed, y = float(np.linalg.norm(flow)), box.bottom - 34 + 18 * row
        canvas.text(box.right - 64, y, label, colour, 11, "right")
        canvas.text(box.right - 12, y, f"{speed:.2f} m/s", colour, 11, "right")
        half = 14.0 / longest * np.array([seen[1], -seen[0]])
        middle = np.array([box.right - 174 + 36 * row, box.bottom - 25])
        if speed > 0.3 * longest:  # else it is a head without a shaft
            canvas.arrow(tuple(middle - half), tuple(middle + half), colour, 1.5)
        elif speed > 0.0:
            canvas.dot(middle, colour, 2.0)


def draw_north(canvas: Canvas, x: float, y: float) -> None:
    """A north arrow, ``(x, y)`` its middle."""
    canvas.polygon(np.array([[x, y - 13.0], [x + 7.0, y + 13.0], [x, y + 8.0], [x - 7.0, y + 13.0]]), MUTED)
    canvas.text(x, y - 23, "N", MUTED, 13, "centre", bold=True)


def ship_outline(beam: float, points: int = 9) -> np.ndarray:
    """A hull from above ``(2 points + 1, 2)`` in ship lengths, body frame: transom stern, fine bow.

    Args:
        beam: Beam over length.
        points: Points of one side.
    """
    x = np.linspace(-0.5, 0.5, points)
    half = 0.5 * beam * np.interp(x, [-0.5, -0.3, 0.05, 0.25, 0.375, 0.5], [0.78, 0.95, 1.0, 0.86, 0.56, 0.0])
    return np.concatenate([np.stack([x, half], -1), np.stack([x, -half], -1)[-2::-1]])


@dataclass(frozen=True)
class Series:
    """One line of a strip chart; ``label`` goes into the chart's legend."""

    label: str
    colour: Colour
    time: np.ndarray
    value: np.ndarray
    width: float = 1.2
    dashed: bool = False


def strip_chart(
    canvas: Canvas,
    box: Box,
    title: str,
    series: Sequence[Series],
    span: tuple[float, float],
    half_range: float,
    band: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None,
    limit: float | None = None,
    limit_label: str = "",
    note: str = "",
    lowest: float | None = None,
) -> None:
    """A chart over time, symmetric about zero unless told otherwise, in a card.

    Args:
        canvas: Where to draw.
        box: The card.
        title: Quantity and unit.
        series: Lines, the last on top.
        span: First and last time [s] of the axis.
        half_range: The axis reaches from minus this, or from ``lowest``, to plus this.
        band: Time, lower and upper edge of a pale area below the lines.
        limit: Dashed lines at plus and minus this.
        limit_label: What the limit means, written below the upper line.
        note: A remark after the legend.
        lowest: Lower end of the axis.
    """
    canvas.panel(box)
    plot = box.inset(44, 32, 22, 22)
    bottom = -half_range if lowest is None else lowest
    centre, half = 0.5 * (bottom + half_range), 0.5 * (half_range - bottom)
    sx, sy = plot.width / (span[1] - span[0]), 0.5 * plot.height / half
    middle = plot.top + 0.5 * plot.height + centre * sy

    def pixels(time: np.ndarray, value: np.ndarray) -> np.ndarray:
        return np.stack([plot.left + (time - span[0]) * sx, middle - value * sy], -1)

    if band is not None and len(band[0]) > 1:
        time, low, high = band
        edge = np.concatenate([pixels(time, low), pixels(time, high)[::-1]])
        canvas.polygon(edge, BELIEVED_PALE)
    ends = np.array(span)
    for level in (bottom, centre, half_range):
        canvas.line(pixels(ends, np.full(2, level)), ZERO if level == 0.0 else GRID, 1.0)
        canvas.text(plot.left - 6, middle - level * sy, signed(level), MUTED, 11, "right")
    for tick in np.linspace(*span, 7):
        x = plot.left + (tick - span[0]) * sx
        canvas.line(np.array([[x, plot.top], [x, plot.bottom]]), GRID, 1.0)
        canvas.text(x, plot.bottom + 10, f"{tick:.0f} s" if tick == span[1] else f"{tick:.0f}", MUTED, 11, "centre")
    if limit is not None:
        for level in (-limit, limit):
            canvas.dashes(pixels(ends, np.full(2, level)), LIMIT, 1.0, 4.0, 4.0)
        canvas.text(plot.right - 4, middle - limit * sy + 8, limit_label, LIMIT, 10, "right")
    for item in series:
        points = pixels(item.time, item.value)
        (canvas.dashes if item.dashed else canvas.line)(points, item.colour, item.width)
        if not item.dashed:
            canvas.dot(points[-1], item.colour, 2.5)
    canvas.text(box.left + 12, box.top + 16, title, TEXT, 12, bold=True)
    right = box.right - 12.0
    if note:
        right -= canvas.text(right, box.top + 16, note, MUTED, 11, "right") + 14
    for item in reversed(series):
        if item.label:
            right = _legend_entry(canvas, right, box.top + 16, item)


def comparison_chart(
    canvas: Canvas, box: Box, title: str, time: np.ndarray, span: tuple[float, float], least: float,
    true: np.ndarray, believed: np.ndarray, sd: np.ndarray, limit: float = np.inf, limit_label: str = "lost",
    lowest: float | None = None, middle: float = 0.0, behind: Sequence[Series] = (),
) -> None:  # fmt: skip
    """A strip chart of something true and something believed, about zero or another middle.

    Args:
        canvas: Where to draw.
        box: The card.
        title: Quantity and unit.
        time: Of all values [s].
        span: First and last time [s] of the axis.
        least: The axis reaches this far at least.
        true: What was.
        believed: What was believed.
        sd: The latter's standard deviation.
        limit: Dashed lines at plus and minus this, if the axis reaches as far.
        limit_label: What the limit means.
        lowest: Lower end of the axis, unless something lies below.
        middle: Of the axis.
        behind: More lines, below the others.
    """
    low, high = believed - 2.0 * sd, believed + 2.0 * sd
    reach = nice(max(least, *(float(np.abs(value - middle).max()) for value in (true, low, high))))
    seen = limit if limit <= reach else None
    if lowest is not None and min(true.min(), low.min()) < lowest:
        lowest = None
    if middle:
        lowest = middle - reach
    strip_chart(
        canvas, box, title,
        [*behind, Series("true", TRUE_SOFT, time, true, 3.5), Series("believed ±2σ", BELIEVED, time, believed)],
        span, middle + reach, band=(time, low, high), limit=seen, limit_label=limit_label, lowest=lowest,
    )  # fmt: skip


def _legend_entry(canvas: Canvas, right: float, y: float, item: Series) -> float:
    """A sample of the line and its label, ending at ``right``; returns where the next one may end."""
    left = right - canvas.text(right, y, item.label, MUTED, 11, "right") - 6
    sample = np.array([[left - 16.0, y], [left, y]])
    if item.dashed:
        canvas.dashes(sample, item.colour, item.width, 4.0, 2.0)
    else:
        canvas.line(sample, item.colour, max(item.width, 2.0))
    return left - 16 - 12
