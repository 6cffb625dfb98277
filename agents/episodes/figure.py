"""Figure of an episode for print: tracks, and the errors of all estimators in bands of ±2σ."""

import base64
from typing import TYPE_CHECKING, Any

import numpy as np

from agents.plotting import INK, PALETTE, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def episode_figure(page: dict[str, Any]) -> "Figure":
    """Figure of the data of a page, see `agents.episodes.page.Episode`."""
    from matplotlib.figure import Figure

    flights, word = page["flights"], "score" if page["flights"][0]["scored"] else "return"
    titles = [chart["title"] for chart in flights[0]["charts"]]
    with styled():
        figure = Figure(figsize=(7.2, 1.2 * max(len(titles), 3)), layout="constrained")
        grid = figure.add_gridspec(len(titles), 1 + page["placed"])
        panels = {title: figure.add_subplot(grid[i, -1]) for i, title in enumerate(titles)}
        for title, panel in panels.items():
            panel.set_title(title, loc="left")
            panel.grid()
        panel.set_xlabel(f"time [{page['unit']}]")
        for flight, colour in zip(flights, PALETTE, strict=False):
            label = f"{flight['estimator']}, {word} {flight['score']:.3f}"
            for chart in flight["charts"]:
                _draw_error(panels[chart["title"]], chart, page["dt"], color=colour, label=label)
        if page["placed"]:
            _draw_map(figure.add_subplot(grid[:, 0]), page["scene"], flights)
        title = f"{page['name']}: estimate minus truth, with bands of ±2σ"
        lines = panel.get_legend_handles_labels()
        figure.legend(*lines, title=title, loc="outside upper center", ncols=3)
    return figure


def _draw_error(panel: "Axes", chart: dict[str, Any], dt: float, **look: Any) -> None:
    """Draw a chart's estimate with its band, minus the truth where the chart has one."""
    *true, line = (_unpacked(each["value"]) for each in chart["series"])
    if chart["series"][-1]["label"] == "true":  # not estimated
        return
    time, zero = dt * np.arange(len(line)), true[0] if true else 0.0
    panel.plot(time, line - zero, **look)
    if chart["band"]:
        low, high = (_unpacked(edge) - zero for edge in chart["band"])
        panel.fill_between(time, low, high, color=look["color"], alpha=0.15, linewidth=0)


def _draw_map(panel: "Axes", scene: dict[str, Any], flights: list[dict[str, Any]]) -> None:
    """Draw the true tracks from above, or from the side if they lie in a vertical plane."""
    x, y = (1, 0) if scene["high"][1] - scene["low"][1] > 1e-3 else (0, 2)
    tracks = [_unpacked(flight["true"]) for flight in flights]
    for track, colour in zip([_unpacked(scene["path"]), *tracks], (INK, *PALETTE), strict=False):
        panel.plot(*track[:, [x, y]].T, color=colour, linestyle="--" if colour == INK else "-")
    for north, east, radius in _unpacked(scene["obstacles"]):
        turn = np.linspace(0.0, 2.0 * np.pi)
        panel.fill(east + radius * np.cos(turn), north + radius * np.sin(turn), INK, alpha=0.25)
    names = "north [m]", "east [m]", "down [m]"
    panel.set(xlabel=names[x], ylabel=names[y], aspect="equal", anchor="N", yinverted=y == 2)


def _unpacked(packed: dict[str, Any]) -> np.ndarray:
    """Inverse of `agents.episodes.page.packed` for an array."""
    values = np.frombuffer(base64.b64decode(packed["float32"]), "<f4")
    return values.reshape(packed["shape"])
