"""Charts over time, in cards."""

from collections.abc import Sequence

import numpy as np

from vessel_gym.rendering.canvas import Box, Canvas, nice, signed
from vessel_gym.rendering.scene import Chart, ticks

_GAP = 10.0
_COLUMNS = 3
_AXIS = 16.0  # pixels of the time labels below a chart


def draw_charts(
    canvas: Canvas, box: Box, charts: Sequence[Chart], time: np.ndarray, longest: float
) -> None:
    """Draw charts side by side in rows.

    Args:
        canvas: Canvas.
        box: Box of all charts.
        charts: Charts in reading order.
        time: ``(T,)`` times of the values [s].
        longest: Longest time axis [s], unless the values last longer.
    """
    now = float(time[-1])
    end = max(now, min(nice(max(now, 0.03 * longest)), longest))
    rows = [charts[i : i + _COLUMNS] for i in range(0, len(charts), _COLUMNS)]
    high = (box.height - _AXIS - (len(rows) - 1) * _GAP) / len(rows)
    for j, row in enumerate(rows):
        wide = (box.width - (len(row) - 1) * _GAP) / len(row)
        last = row is rows[-1]
        for i, chart in enumerate(row):
            place = Box(
                box.left + i * (wide + _GAP), box.top + j * (high + _GAP), wide, high + last * _AXIS
            )
            draw_chart(canvas, place, chart, time, end, last)


def draw_chart(
    canvas: Canvas, box: Box, chart: Chart, time: np.ndarray, end: float, timed: bool
) -> None:
    """Draw a chart in a card.

    Args:
        canvas: Canvas.
        box: Card.
        chart: Chart.
        time: ``(T,)`` times of the values [s].
        end: Last time of the axis [s].
        timed: Are times written below?
    """
    canvas.panel(box)
    plot = box.inset(46, 30, 16, 8 + (_AXIS if timed else 0.0))
    low, high = chart.limits
    scale = np.array([plot.width / end, -plot.height / (high - low)])

    def pixels(time: np.ndarray, value: np.ndarray) -> np.ndarray:
        return np.stack([time, value - high], -1) * scale + [plot.left, plot.top]

    if chart.band is not None and len(time) > 1:
        edge = np.append(chart.band[0], chart.band[1][::-1])
        canvas.polygon(pixels(np.append(time, time[::-1]), edge), "believed_pale")
    for level in chart.ticks:
        line = pixels(np.array([0.0, end]), np.full(2, level))
        canvas.line(line, "grid" if level else "zero", 1.0)
        canvas.text(plot.left - 6, line[0, 1], signed(level), "muted", 10, "right")
    times = ticks(0.0, end, 4)
    for tick in times:
        x = plot.left + tick * scale[0]
        canvas.line(np.array([[x, plot.top], [x, plot.bottom]]), "grid", 1.0)
        if timed:
            words = f"{tick:g} s" if tick == times[-1] else f"{tick:g}"
            canvas.text(x, plot.bottom + 10, words, "muted", 10, "centre")
    with canvas.clipped(plot.inset(-4, -4, -4, -4)):
        for each in chart.series:
            if np.isfinite(each.value).any():
                points = pixels(time, each.value)[np.isfinite(each.value)]
                canvas.line(points, each.colour, each.width)
                canvas.dot(points[-1], each.colour, 2.5)
    canvas.text(box.left + 12, box.top + 15, chart.title, "ink", 12, bold=True)
    right = box.right - 12.0
    for each in reversed(chart.series):
        if each.label:
            right -= canvas.text(right, box.top + 15, each.label, "muted", 10, "right") + 5
            canvas.line(
                np.array([[right - 9.0, box.top + 15], [right, box.top + 15]]), each.colour, 2.0
            )
            right -= 9.0 + 10.0
