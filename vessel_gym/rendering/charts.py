"""Charts over time, in cards."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vessel_gym.rendering.canvas import BELIEVED, BELIEVED_PALE, GRID, MUTED, TEXT, TRUE_SOFT, ZERO, Box, Canvas, Colour


class Series(NamedTuple):
    """One line of a chart; a ``label`` goes into the chart's legend."""

    label: str
    colour: Colour
    value: np.ndarray
    width: float = 1.4
    late: float = 0.0
    """By how many seconds the values come after what they tell of."""


AXIS = 16.0
"""Pixels that the labels of the time take below a chart."""


def ticks(low: float, high: float, count: int) -> np.ndarray:
    """Multiples of 1, 2 or 5 times a power of ten from ``low`` to ``high``, ``count`` of them at most (or 2)."""
    rough = (high - low) / max(count - 1, 1)
    power = 10.0 ** np.floor(np.log10(rough))
    step = next(float(each * power) for each in (1.0, 2.0, 5.0, 10.0) if each * power >= rough * 0.9999)
    return step * np.arange(np.ceil(low / step - 1e-6), np.floor(high / step + 1e-6) + 1.0) + 0.0


def chart(
    canvas: Canvas, box: Box, title: str, time: np.ndarray, end: float, series: Sequence[Series], timed: bool,
    band: tuple[np.ndarray, np.ndarray] | None = None, least: float = 1e-3,
) -> None:  # fmt: skip
    """Lines over time.

    Args:
        canvas: Where to draw.
        box: The card.
        title: Quantity and unit.
        time: Of all values [s], ``(T,)``.
        end: Last time of the axis [s].
        series: Lines, the last on top.
        timed: Whether times are written below.
        band: Lower and upper edge of a pale area below the lines, ``(T,)`` each.
        least: Height of the axis at least.
    """
    canvas.panel(box)
    plot = box.inset(46, 30, 16, 8 + (AXIS if timed else 0.0))
    shown = np.concatenate([each.value for each in series] + list(band or ()))
    low, high = float(np.nanmin(shown)), float(np.nanmax(shown))
    room = 0.06 * (high - low) + 0.5 * max(least - (high - low), 0.0)
    low, high = low - room, high + room
    scale = np.array([plot.width / end, -plot.height / (high - low)])

    def pixels(time: np.ndarray, value: np.ndarray) -> np.ndarray:
        return np.stack([time, value - high], -1) * scale + [plot.left, plot.top]

    if band is not None:
        canvas.polygon(pixels(np.append(time, time[::-1]), np.append(band[0], band[1][::-1])), BELIEVED_PALE)
    for level in ticks(low, high, 4):
        line = pixels(np.array([0.0, end]), np.full(2, level))
        canvas.line(line, ZERO if abs(level) < 1e-9 else GRID, 1.0)
        canvas.text(plot.left - 6, line[0, 1], f"{round(level, 9):g}".replace("-", "−"), MUTED, 10, "right")
    times = ticks(0.0, end, 7)
    for tick in times:
        x = plot.left + tick * scale[0]
        canvas.line(np.array([[x, plot.top], [x, plot.bottom]]), GRID, 1.0)
        if timed:
            words = f"{tick:g} s" if tick == times[-1] else f"{tick:g}"
            canvas.text(x, plot.bottom + 10, words, MUTED, 10, "centre")
    with canvas.clipped(plot.inset(-4, -4, -4, -4)):
        for each in series:
            points = pixels(time - each.late, each.value)
            canvas.line(points, each.colour, each.width)
            canvas.dot(points[-1], each.colour, 2.5)
    canvas.text(box.left + 12, box.top + 15, title, TEXT, 12, bold=True)
    right = box.right - 12.0
    for each in reversed(series):
        if each.label:
            right -= canvas.text(right, box.top + 15, each.label, MUTED, 10, "right") + 5
            canvas.line(np.array([[right - 14.0, box.top + 15], [right, box.top + 15]]), each.colour, 2.0)
            right -= 14.0 + 10.0


def error(
    canvas: Canvas, box: Box, title: str, time: np.ndarray, end: float, value: np.ndarray, sd: np.ndarray, timed: bool
) -> None:  # fmt: skip
    """A chart of what is believed minus what is true ``(T,)``, with the standard deviation that is claimed for it."""
    lines = [Series("±2σ", BELIEVED_PALE, np.zeros(len(time))), Series("believed − true", BELIEVED, value)]
    chart(canvas, box, title, time, end, lines, timed, (-2.0 * sd, 2.0 * sd))


def comparison(
    canvas: Canvas, box: Box, title: str, time: np.ndarray, end: float, true: np.ndarray, believed: np.ndarray,
    timed: bool, sd: np.ndarray | None = None, late: float = 0.0,
) -> None:  # fmt: skip
    """A chart of something true and something believed ``(T,)``, perhaps with the latter's standard deviation."""
    named = "believed" if sd is None else "believed ±2σ"
    lines = [Series("true", TRUE_SOFT, true, 3.5), Series(named, BELIEVED, believed, 1.2, late)]
    band = None if sd is None else (believed - 2.0 * sd, believed + 2.0 * sd)
    chart(canvas, box, title, time, end, lines, timed, band)
