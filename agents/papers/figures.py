"""Counterparts of the papers' figures: described by experiments as plain data, drawn here.

A figure is ``{"number", "caption", "panels"}``. A panel has labels ``x`` and ``y`` (and ``z`` in
three dimensions), and ``lines`` by name, each a list of coordinates. It may have a ``band`` (x,
low, high) of two standard deviations, limits ``ylim`` and ``equal`` scales.
"""

from collections.abc import Iterable, Mapping, Sequence
from itertools import repeat
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from agents.plotting import INK, PALETTE, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Panel = dict[str, Any]
_WIDTH, _HEIGHT = 4.6, 2.7  # inches, of a panel


def figure(number: str, caption: str, *panels: Panel) -> dict[str, Any]:
    """A figure of a paper."""
    return {"number": number, "caption": caption, "panels": panels}


def over_time(
    times: np.ndarray,
    y: str,
    lines: dict[str, np.ndarray],
    sd: np.ndarray | None = None,
    x: str = "time [s]",
) -> Panel:
    """Lines ``(T,)`` over time; the last has a band of two standard deviations ``sd (T,)``."""
    panel = {"x": x, "y": y, "lines": {name: [times, line] for name, line in lines.items()}}
    if sd is None:
        return panel
    last = [*lines.values()][-1]
    return panel | {"band": [times, last - 2.0 * sd, last + 2.0 * sd]}


def panels(
    times: np.ndarray,
    names: Sequence[str],
    lines: Mapping[str, np.ndarray],
    sds: Iterable[Any] = repeat(None),
) -> list[Panel]:
    """A panel `over_time` for each of k components: lines ``(T, k)``, an sd or None for each."""
    components = zip(names, sds, *(line.T for line in lines.values()), strict=False)
    return [
        over_time(times, name, dict(zip(lines, of, strict=True)), sd)
        for name, sd, *of in components
    ]


def draw(described: dict[str, Any]) -> "Figure":
    """The figure below its caption, one panel below the other."""
    from matplotlib.figure import Figure

    panels = described["panels"]
    with styled():
        drawn = Figure(figsize=(_WIDTH, _HEIGHT * len(panels)), layout="constrained")
        caption = fill(f"Figure {described['number']}. {described['caption']}", 76)
        drawn.suptitle(caption, x=0.01, ha="left", fontsize=9)
        for i, panel in enumerate(panels, 1):
            projection = "3d" if "z" in panel else None
            _draw(drawn.add_subplot(len(panels), 1, i, projection=projection), panel)
    return drawn


def _draw(axes: "Axes", panel: Panel) -> None:
    """The lines of a panel; the first is the truth or the plan."""
    for (name, line), color in zip(panel["lines"].items(), (INK, *PALETTE[1:]), strict=False):
        axes.plot(*line, color=color, label=name)
    if "band" in panel:
        axes.fill_between(*panel["band"], color=PALETTE[1], alpha=0.2, linewidth=0)
    axes.set(**{f"{axis}label": panel[axis] for axis in "xyz" if axis in panel})
    if "ylim" in panel:
        axes.set_ylim(panel["ylim"])
    if panel.get("equal"):
        axes.set_aspect("equal", "datalim")
    if "z" in panel:
        axes.invert_zaxis()  # type: ignore[attr-defined]
    axes.legend(fontsize=8, loc="upper left" if "z" in panel else "best")
