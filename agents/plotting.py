"""The look of every figure, and how it gets into a file or a page."""

import base64
import io
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agents.files import replacing
from vessel_gym.extras import require

if TYPE_CHECKING:
    from matplotlib.figure import Figure

KINDS = (".pdf", ".svg")
"""Suffixes of files of figures."""
WIDTH = 7.2
"""Width of a figure on a page in inches."""
INK = "#444444"
PALETTE = (
    "#1f4e79",
    "#c8590b",
    "#3f7f5f",
    "#7b4f9d",
    "#b08900",
    "#2f8fa8",
    "#8c3b4a",
    "#5a616b",
    "#9aa23a",
    "#d07fa0",
)
"""Colours for many lines; with different markers, also for those who do not see red from green."""

_STYLE = Path(__file__).with_name("templates") / "report.mplstyle"


def styled() -> AbstractContextManager[None]:
    """Context of making a figure: serif type, thin axes, equal bytes from equal data.

    Raises:
        ModuleNotFoundError: without Matplotlib.
    """
    require("matplotlib")
    from matplotlib import style

    return style.context(_STYLE)


def svg(figure: "Figure") -> bytes:
    """The figure as SVG, without a date: equal figures have equal bytes."""
    buffer = io.BytesIO()
    nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    with styled():
        figure.savefig(buffer, format="svg", metadata=nothing)
    return buffer.getvalue()


def data_uri(figure: "Figure") -> str:
    """The figure as an SVG data URI: nothing outside the page, and no ids that clash within it."""
    return "data:image/svg+xml;base64," + base64.b64encode(svg(figure)).decode()


def save_figure(figure: "Figure", path: Path) -> None:
    """Write a figure whole or not at all: as PDF, or as SVG where the path ends so.

    Raises:
        OSError: if it cannot be written.
    """
    with replacing(path) as temporary:
        if path.suffix.lower() == ".svg":
            temporary.write_bytes(svg(figure))
        else:
            with styled():
                figure.savefig(temporary, format="pdf", metadata={"CreationDate": None})


Run = Sequence[Any]
"""Steps ``(n,)`` and returns ``(n,)`` of a training run."""


def aligned(runs: Sequence[Run]) -> tuple[Any, Any]:
    """Steps ``(n,)`` of the shortest run, and the returns of all runs at these ``(runs, n)``."""
    import numpy as np

    steps = min((steps for steps, _ in runs), key=len)
    return steps, np.stack([np.interp(steps, *run) for run in runs])


def learning_figure(trainings: Mapping[str, Sequence[Run]], ylabel: str) -> "Figure":
    """Mean and range over the runs of each training of the returns over the steps."""
    from matplotlib.figure import Figure

    with styled():
        figure = Figure(figsize=(WIDTH, 3.0), layout="constrained")
        axes = figure.subplots()
        colours = PALETTE * len(trainings)
        for (name, runs), colour in zip(trainings.items(), colours, strict=False):
            steps, returns = aligned(runs)
            axes.plot(steps, returns.mean(0), color=colour, label=f"{name}, runs: {len(runs)}")
            band = steps, returns.min(0), returns.max(0)
            axes.fill_between(*band, color=colour, alpha=0.2, linewidth=0)
        axes.set(xlabel="environment steps", ylabel=ylabel)
        axes.legend(loc="lower right", fontsize=8.5)
        axes.grid(axis="y")
    return figure
