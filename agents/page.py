"""Numbers and lists in words, tables, and reports as one HTML file."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from agents.files import write_text
from agents.plotting import data_uri
from agents.statistics import Interval, crossed_interval
from vessel_gym.extras import require

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

LATEX = {"−": "$-$", "±": r"$\pm$", "–": "--", "°": r"$^\circ$", "σ": r"$\sigma$"}
"""Characters of tables that LaTeX lacks in text."""


def number(value: float, decimals: int, signed: bool = False) -> str:
    """A number with its decimals and a true minus; a dash where it is not finite."""
    text = f"{value:{'+' if signed else ''}.{decimals}f}"
    if not text.strip("+-0."):
        text = text.strip("+-")
    return "–" if "n" in text else text.replace("-", "−")


def text(value: Interval | float | None, decimals: int = 3, signed: bool = False) -> str:
    """A number, or an interval: "mean ± half", an uneven one by its ends; a dash for None.

    There are more decimals where these would show none of the interval's width.
    """
    if not isinstance(value, Interval):
        return "–" if value is None else number(value, decimals, signed)
    while decimals < 6 and 1e-6 < value.high - value.low < 10.0**-decimals:
        decimals += 1
    mean = number(value.mean, decimals, signed)
    if value.even:
        return f"{mean} ± {number(value.half, decimals)}"
    low, high = (number(end, decimals, signed) for end in (value.low, value.high))
    return f"{mean} [{low}, {high}]"


def mean_and_half(values: np.ndarray, decimals: int = 3) -> str:
    """The mean ``(seeds,)`` or ``(runs, seeds)`` with its 95 % interval."""
    return text(crossed_interval(np.atleast_2d(values)), decimals)


def listed(items: Sequence[str]) -> str:
    """A list of at least one item in a sentence: "a, b and c"."""
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} and {items[-1]}"


def named(words: Mapping[str, str]) -> str:
    """Names and their words as a part of a sentence: "receiver: SBAS, gyro compass: magnetic"."""
    return ", ".join(f"{name}: {each}" for name, each in words.items())


def markdown_table(heading: Sequence[str], rows: Iterable[Sequence[str]], words: int) -> str:
    """A table in Markdown whose first columns hold words and stand left; the others stand right."""
    rule = ["---"] * words + ["---:"] * (len(heading) - words)
    return "\n".join(f"| {' | '.join(row)} |" for row in (heading, rule, *rows))


@dataclass(frozen=True)
class Block:
    """A part of a page: a heading, its content as HTML, and what a reader must know to read it.

    A table is also kept as it is, for files beside the page.
    """

    title: str
    html: str
    note: str = ""
    table: "pd.DataFrame | None" = None


def table(title: str, frame: "pd.DataFrame", note: str = "") -> Block:
    """A table of texts as a block."""
    frame = frame.reset_index()
    return Block(title, frame.to_html(border=0, index=False), note, frame)


def picture(title: str, figure: "Figure", note: str = "") -> Block:
    """A figure as a block."""
    return Block(title, f'<img src="{data_uri(figure)}" alt="{escape(title)}">', note)


def frame(title: str, document: str, note: str = "") -> Block:
    """A whole HTML document, which plays on its own, as a block."""
    return Block(title, iframe(title, document), note)


def iframe(title: str, document: str, style: str = "") -> str:
    """An element that shows a whole HTML document, which may run its own scripts alone."""
    attributes = f'title="{escape(title)}" sandbox="allow-scripts" loading="lazy" style="{style}"'
    return f'<iframe srcdoc="{escape(document)}" {attributes}></iframe>'


def bullets(title: str, items: Sequence[str]) -> Block:
    """Sentences as a block."""
    return Block(title, "<ul>" + "".join(f"<li>{escape(item)}</li>" for item in items) + "</ul>")


def preformatted(title: str, lines: Sequence[str]) -> Block:
    """Lines of code as a block."""
    return Block(title, f"<pre>{escape(chr(10).join(lines))}</pre>")


def write_page(
    path: Path, title: str, subtitle: str, answer: Sequence[str], blocks: Sequence[Block]
) -> Path:
    """Write a report to a file, whole or not at all: its answer, and then its blocks.

    Its tables are also written into the folder ``tables`` beside it, as CSV and, with the rules of
    booktabs, as LaTeX.

    Raises:
        OSError: if it cannot be written.
        ModuleNotFoundError: without Jinja.
    """
    require("jinja2")
    from jinja2 import Environment, PackageLoader, StrictUndefined

    templates = Environment(
        loader=PackageLoader("agents"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    html = templates.get_template("page.html").render(
        title=title, subtitle=subtitle, answer=answer, blocks=blocks
    )
    write_text(path, html)
    for block in blocks:
        if block.table is not None:
            _write_table(
                path.parent / "tables" / re.sub(r"\W+", "-", block.title.lower()), block.table
            )
    return path


def _write_table(path: Path, frame: "pd.DataFrame") -> None:
    """Write a table as ``.csv`` and ``.tex``."""
    latex = frame.to_latex(index=False, escape=True).translate(str.maketrans(LATEX))
    for suffix, text in ((".csv", frame.to_csv(index=False)), (".tex", latex)):
        write_text(path.with_name(path.name + suffix), text)
