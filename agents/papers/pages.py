"""The page of a paper: its explanation with tables and figures, in one HTML file."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from agents.page import Block, markdown_table, write_page
from agents.papers import read
from agents.papers.figures import draw
from agents.plotting import save_figure


def write_paper(name: str, values: Mapping[str, Any], out: Path) -> Path:
    """Write the page of a paper, its tables as CSV and its figures as SVG; returns the page.

    Args:
        name: One of `agents.papers.PAPERS`.
        values: Result of the paper's ``report``.
        out: Folder.

    Raises:
        OSError: if a file cannot be written.
    """
    (out / "tables").mkdir(parents=True, exist_ok=True)
    for table, rows in values["tables"].items():
        path = out / "tables" / f"{name}-{table}.csv"
        pd.DataFrame(rows).to_csv(path, header=False, index=False)
    figures = {}
    for described in values["figures"]:
        drawn, title = draw(described), f"Figure {described['number']}"
        save_figure(drawn, out / "figures" / file_name(name, title))
        figures[described["caption"]] = drawn
    (title, source, opening), sections = page_parts(name, values["tables"])
    pictures = Block("Figures of the paper", figures=figures)
    return write_page(
        out / f"{name}.html", title, source, [opening], [sections[0], pictures, *sections[1:]]
    )


def file_name(name: str, title: str) -> str:
    """Name of the file of a paper's figure, such as "Figure 4.1"."""
    return f"{name}-{title.removeprefix('Figure ').replace(' ', '-')}.svg"


def page_parts(name: str, tables: Mapping[str, Any]) -> tuple[tuple[str, str, str], list[Block]]:
    """Title, source and opening of a paper's explanation, and its sections with their tables."""
    from markdown_it import MarkdownIt  # late, as Rich imports it only to print

    made = {table: markdown_table(of[0], of[1:], 2) for table, of in tables.items()}
    text = re.sub("<!-- table: (.*) -->", lambda found: made[found[1]], read(name, "page.md"))
    head, *rest = re.split(r"^## (.+)\n", text, flags=re.M)
    title, source, opening, *more = (" ".join(each.split()) for each in head.split("\n\n"))
    parser = MarkdownIt().enable("table")

    def render(body: str) -> str:
        return f'<div class="text">{parser.render(body)}</div>'

    sections = [
        Block(heading, html=render(body))
        for heading, body in zip(rest[::2], rest[1::2], strict=True)
    ]
    summary = Block("In short", html=render("\n\n".join(more)))
    return (title.removeprefix("# "), source, opening), [summary, *sections]
