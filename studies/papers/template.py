"""Pages from text: a Markdown template beside the code, filled with numbers and tables.

A template is rendered by Jinja2; then blank lines separate its paragraphs. The title, the subtitle
and the opening paragraph come first, then a section for each ``##``. A paragraph is one block of
the page::

    @table name: title      the table of that name; the lines below are its note
    @claims                 a note, then items of text | verdict | evidence
    @facts: title           items of name | value
    - item                  a list
    other text              a paragraph
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from agents.page import Block, Bullets, Claim, Claims, Facts, Page, Prose, Section, Table, templates


def fill(folder: Path, tables: Mapping[str, Table], **values: Any) -> tuple[Page, str]:
    """Page from the template ``page.md`` of a paper's folder, and its opening paragraph.

    Args:
        folder: Of the paper.
        tables: By name; title and note stand in the template.
        values: Numbers and words for the placeholders.

    Raises:
        KeyError: if the template shows a table that does not exist.
        jinja2.UndefinedError: if it has a placeholder without a value.
    """
    package = templates()
    from jinja2 import FileSystemLoader

    environment = package.overlay(loader=FileSystemLoader(folder))
    top, *parts = re.split(
        r"^## ", environment.get_template("page.md").render(values), flags=re.MULTILINE
    )
    title, subtitle, opening = _paragraphs(top)
    sections = [Section("In one paragraph", [Prose(_joined(opening))])]
    for part in parts:
        heading, _, text = part.partition("\n")
        sections.append(Section(heading, [_block(each, tables) for each in _paragraphs(text)]))
    return Page(title.removeprefix("# "), _joined(subtitle), [], sections), _joined(opening)


def _paragraphs(text: str) -> list[str]:
    return [paragraph for paragraph in re.split(r"\n\s*\n", text.strip()) if paragraph]


def _joined(text: str) -> str:
    return " ".join(text.split())


def _items(text: str) -> tuple[str, list[str]]:
    """The text before a list, and the items of the list."""
    before, *items = re.split(r"^- ", text, flags=re.MULTILINE)
    return _joined(before), [_joined(item) for item in items]


def _block(paragraph: str, tables: Mapping[str, Table]) -> Block:
    found = re.match(r"@(\w+) ?([\w-]*):? ?(.*)\n?", paragraph)
    kind, name, title = found.groups() if found else ("", "", "")
    text, items = _items(paragraph[found.end() :] if found else paragraph)
    match kind:
        case "table":
            return replace(tables[name], title=title, note=text)
        case "claims":
            return Claims([Claim(*item.split(" | ", 2)) for item in items], text)
        case "facts":
            return Facts(
                title, [(fact, value) for fact, value in (item.split(" | ", 1) for item in items)]
            )
    return Bullets(items) if items else Prose(text)
