"""The look of every figure in a report, and how it gets into a page."""

import base64
import io
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TRUE, BELIEVED, RAW, PALE, PUBLISHED, INK = "#1f4e79", "#c8590b", "#8a8f96", "#f3cfae", "#a3271b", "#444444"
PALETTE = ("#1f4e79", "#c8590b", "#3f7f5f", "#7b4f9d", "#b08900", "#2f8fa8", "#8c3b4a", "#5a616b", "#9aa23a", "#d07fa0")
"""Colours for many lines, told apart also by those who do not see red from green where markers differ as well."""

_STYLE: Any = {
    "font.family": "STIXGeneral",
    "mathtext.fontset": "stix",
    "font.size": 10,
    "axes.titlesize": 10,
    "axes.labelsize": 10,
    "legend.fontsize": 9.5,
    "legend.frameon": False,
    "axes.linewidth": 0.6,
    "axes.edgecolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.labelsize": 9,
    "ytick.labelsize": 9,
    "lines.linewidth": 1.1,
    "grid.color": "#e3e5e8",
    "grid.linewidth": 0.5,
    "svg.hashsalt": "vessel-gym",
}


def styled() -> AbstractContextManager[None]:
    """The context in which a figure is made: serif type, thin axes, and the same bytes from the same data."""
    from matplotlib import rc_context

    return rc_context(_STYLE)


def data_uri(figure: "Figure") -> str:
    """The figure as an SVG data URI: nothing outside the page, and no ids that clash within it."""
    buffer = io.BytesIO()
    nothing: dict[str, Any] = {"Date": None, "Creator": None, "Format": None, "Type": None}
    with styled():
        figure.savefig(buffer, format="svg", metadata=nothing)
    return "data:image/svg+xml;base64," + base64.b64encode(buffer.getvalue()).decode()
