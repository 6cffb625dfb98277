"""Numbers and lists in words, tables, and reports as one HTML file."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
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
    if isinstance(value, Interval) and np.isnan(value.half):
        value = value.mean
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
    """A part of a page: a heading, one kind of content, and what a reader must know to read it.

    Attributes:
        title: The heading.
        table: A table of texts, which is also written into files beside the page.
        note: What a reader must know.
        figures: Figures by their captions.
        items: Sentences of a list.
        code: Lines of code.
        html: Anything else, as HTML.
    """

    title: str
    table: "pd.DataFrame | None" = None
    note: str = ""
    figures: "Mapping[str, Figure]" = field(default_factory=dict)
    items: Sequence[str] = ()
    code: str = ""
    html: str = ""


def iframe(title: str, document: str, style: str = "") -> str:
    """An element that shows a whole HTML document, which may run its own scripts alone."""
    attributes = f'title="{escape(title)}" sandbox="allow-scripts" loading="lazy" style="{style}"'
    return f'<iframe srcdoc="{escape(document)}" {attributes}></iframe>'


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
        title=title, subtitle=subtitle, answer=answer, blocks=blocks, data_uri=data_uri
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
    frame = frame.reset_index()
    latex = frame.to_latex(index=False, escape=True).translate(str.maketrans(LATEX))
    for suffix, text in ((".csv", frame.to_csv(index=False)), (".tex", latex)):
        write_text(path.with_name(path.name + suffix), text)
