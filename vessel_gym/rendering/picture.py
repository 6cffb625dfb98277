"""The image of any task: maps, their legend, and the errors of the estimate."""

import numpy as np
import pygame

from vessel_gym.rendering.canvas import Canvas
from vessel_gym.rendering.components import Components
from vessel_gym.rendering.maps import Map, draw_icon, views
from vessel_gym.rendering.scene import Scene

SIZE = 1008, 720
"""Width and height of an image; video codecs need multiples of 16."""
_CANVAS = Canvas(*SIZE)  # of all images: a new one would take a tenth of the time of an image
_GAP, _TOP, _SIDE = 10, 60, 246
_ROW = 24


def draw_picture(scene: Scene, row: int) -> Canvas:
    """The canvas of all images, with an episode so far.

    States x and y give a map from above; x, and z or h give one from the side.

    Args:
        scene: Scene of the episode.
        row: Index of the environment in the batch.
    """
    canvas, (width, height) = _CANVAS, SIZE
    canvas.clear()
    box = pygame.Rect(16, _TOP, width - 32, height - _TOP - 16)
    _draw_header(canvas, box, scene, row)
    found, legend = views(scene), scene.legend
    for i, axes in enumerate(found):
        high = (box.height + _GAP) // len(found)
        top, map_width = box.top + i * high, box.width - _SIDE - _GAP
        Map(scene, axes, pygame.Rect(box.left, top, map_width, high - _GAP)).draw(canvas)
    panel = pygame.Rect(box.right - _SIDE, box.top, _SIDE, _ROW * len(legend) + 12)
    canvas.panel(panel)
    for i, (kind, label) in enumerate(legend.items()):
        at = np.array([panel.left + 28, panel.top + 18 + _ROW * i])
        canvas.text(at[0] + 24, at[1], label, size=11)
        draw_icon(canvas, kind, scene.workspace.hull, at)
    top = panel.bottom + _GAP
    _draw_errors(canvas, pygame.Rect(panel.left, top, _SIDE, box.bottom - top), scene)
    return canvas


def _draw_header(canvas: Canvas, box: pygame.Rect, scene: Scene, row: int) -> None:
    """Draw conditions, score, time and outcome above a box."""
    core = scene.core
    words = [f"estimator {core.config.estimation.filter.name}", *scene.conditions]
    canvas.text(box.left, 21, core.config.system.name, size=17, bold=True)
    canvas.text(box.left, 44, "   ·   ".join(words), "muted", 13)
    end, colour = _outcome(scene, row)
    result = f"{end}   ·   time {scene.time[-1]:.1f} s   ·   score {core.score[row]:.3f}"
    canvas.text(box.right, 32, result, colour, 15, 1.0, bold=True)


def _outcome(scene: Scene, row: int) -> tuple[str, str]:
    """Outcome of the episode in words, and its colour."""
    task, now = scene.core.config.system.task, scene.core.now
    if end := task.end_reasons[now.end[row]]:
        return end, "goal" if end == task.success else "obstacle"
    if now.steps[row] >= task.horizon:
        return "time is up", "obstacle" if task.success else "goal"
    return "under way", "muted"


def _draw_errors(canvas: Canvas, box: pygame.Rect, scene: Scene) -> None:
    """Draw a table of errors of the estimated components, with two standard deviations."""
    names = scene.estimated[: (box.height - 40) // _ROW]
    canvas.panel(pygame.Rect(box.topleft, (box.width, 40 + _ROW * len(names))))
    each = Components(scene.core, scene.history, names)
    title = "Estimate − truth" if each.cov is None else "Estimate − truth ±2σ"
    canvas.text(box.left + 14, box.top + 18, title, bold=True)
    for i, (words, unit, _) in enumerate(each.words):
        y, value = box.top + 46 + _ROW * i, f"{each.error[-1, i]:+.2f}"
        if each.cov is not None:
            value += f" ±{2.0 * np.sqrt(max(each.cov[-1, i, i], 0.0)):.2f}"
        canvas.text(box.left + 14, y, words, "muted", 11)
        canvas.text(box.right - 14, y, f"{value} {unit}".rstrip(), "ink", 11, 1.0)
