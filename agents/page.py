"""A report as data, and as one HTML file that needs nothing but itself."""

import csv
import io
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from agents.files import replacing
from agents.statistics import Interval
from vessel_gym.extras import require


@dataclass(frozen=True)
class Entry:
    """A field of a table: a value in words, or as `number` writes it, and half of its 95 % interval; strong is bold."""

    value: str
    half: str = ""
    strong: bool = False

    def __str__(self) -> str:
        return f"{self.value} ± {self.half}" if self.half else self.value


@dataclass(frozen=True)
class Table:
    """A table with its caption and note.

    Attributes:
        title: The caption.
        note: What a reader must know to read it.
        first: Heading of the first column.
        head: Label and unit of the others.
        sections: A title (or none) and rows, each a name and its entries.
        name: Of the file that holds it, where it is written to one.
    """

    title: str
    note: str
    first: str
    head: list[tuple[str, str]]
    sections: list[tuple[str, list[tuple[str, list[Entry]]]]]
    name: str = ""

    @property
    def has_units(self) -> bool:
        """True if any column has a unit."""
        return any(unit for _, unit in self.head)

    @property
    def wide(self) -> bool:
        """True for a table of many columns, which is set smaller."""
        return len(self.head) > 6

    @property
    def text(self) -> list[bool]:
        """For each column of the head, whether it holds words: they stand left and may be broken."""
        columns = list(
            zip(*(entries for _, rows in self.sections for _, entries in rows), strict=True)
        )
        words = [
            [e.value for e in column if e.value != "–"]
            for column in columns or [()] * len(self.head)
        ]
        return [bool(column) and all(value[:1].isalpha() for value in column) for column in words]

    def rows(self) -> list[list[str]]:
        """Heading and rows in plain text, the section's title in a column of its own where there is one."""
        titled = any(title for title, _ in self.sections)
        heading = [
            self.first,
            *(f"{label} [{unit}]" if unit else label for label, unit in self.head),
        ]
        body = [
            [title, name, *map(str, entries)] if titled else [name, *map(str, entries)]
            for title, rows in self.sections
            for name, entries in rows
        ]
        return [["", *heading] if titled else heading, *body]

    def csv(self) -> str:
        """As comma-separated values."""
        return csv_text(self.rows())

    def markdown(self) -> str:
        """As Markdown, the title above and the note below."""
        heading, *body = [[cell.replace("|", "\\|") for cell in row] for row in self.rows()]
        names = len(heading) - len(self.head)
        table = markdown_table(heading, body, names)
        return "\n".join(
            [f"**{self.title}**", "", table, *(["", self.note] if self.note else []), ""]
        )


@dataclass(frozen=True)
class Prose:
    """A paragraph."""

    text: str


@dataclass(frozen=True)
class Bullets:
    """A list of sentences."""

    items: list[str]


@dataclass(frozen=True)
class Facts:
    """Names and values: settings, assumptions."""

    title: str
    rows: list[tuple[str, str]]


@dataclass(frozen=True)
class Figure:
    """A picture with its caption; the image is a data URI, see `agents.plotting`."""

    image: str
    title: str
    caption: str


@dataclass(frozen=True)
class Live:
    """A page of its own inside the report, which plays there: a whole HTML document."""

    document: str
    title: str
    caption: str


@dataclass(frozen=True)
class Claim:
    """A statement that the data decide: "true", "false" or "undecided", perhaps with a word more after a comma."""

    text: str
    verdict: str
    evidence: str

    @property
    def kind(self) -> str:
        """The verdict's first word."""
        return self.verdict.split(",")[0]


@dataclass(frozen=True)
class Claims:
    """Statements, verdicts and evidence."""

    rows: list[Claim]
    note: str = ""


Block = Prose | Bullets | Facts | Figure | Live | Claims | Table


@dataclass(frozen=True)
class Section:
    """A heading and what stands under it."""

    title: str
    blocks: list[Block]


@dataclass(frozen=True)
class Page:
    """A report: its answer is in sentences, the conclusion first, its summary a small table below that."""

    title: str
    subtitle: str
    answer: list[str]
    sections: list[Section] = field(default_factory=list)
    summary: Table | None = None

    @property
    def tables(self) -> list[Table]:
        """The tables in their order."""
        return [
            block
            for section in self.sections
            for block in section.blocks
            if isinstance(block, Table)
        ]


def number(value: float, decimals: int, signed: bool = False) -> str:
    """A number with its decimals and a true minus, zero without a sign; a dash where it is not finite."""
    text = f"{value:{'+' if signed else ''}.{decimals}f}"
    if not text.strip("+-0."):
        text = text.strip("+-")
    return "–" if "n" in text else text.replace("-", "−")


def entry(interval: Interval | None, decimals: int, signed: bool = False) -> Entry:
    """An interval in a table, an uneven one by its ends; bold where a difference (``signed``) excludes zero."""
    if interval is None:
        return Entry("–")
    value, strong = number(interval.mean, decimals, signed), signed and interval.excludes_zero
    if interval.even:
        return Entry(value, number(interval.half, decimals), strong)
    low, high = (number(end, decimals, signed) for end in (interval.low, interval.high))
    return Entry(f"{value} [{low}, {high}]", strong=strong)


def words(interval: Interval | None, decimals: int, signed: bool = False) -> str:
    """An interval in a sentence, with more decimals where these would show none of its width."""
    if interval is not None:
        while decimals < 6 and 0.0 < interval.high - interval.low < 10.0**-decimals:
            decimals += 1
    return str(entry(interval, decimals, signed))


def listed(items: Sequence[str]) -> str:
    """A list in a sentence: "a, b and c".

    Raises:
        ValueError: if there is nothing to list.
    """
    if not items:
        raise ValueError("a list in a sentence needs at least one item")
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} and {items[-1]}"


def many(count: int, noun: str) -> str:
    """A number of things."""
    return f"{count} {noun}{'s' if count != 1 else ''}"


def markdown_table(heading: Sequence[str], rows: Iterable[Sequence[str]], words: int) -> str:
    """A table in Markdown, of which so many columns hold words and stand left; the others stand right."""
    rule = ["---"] * words + ["---:"] * (len(heading) - words)
    return "\n".join(f"| {' | '.join(row)} |" for row in (heading, rule, *rows))


def csv_text(rows: Iterable[Sequence[Any]]) -> str:
    """Rows as comma-separated values."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


@cache
def templates() -> Any:
    """Jinja's environment of the package's templates: HTML is escaped, and a name without a value is an error.

    Raises:
        ModuleNotFoundError: without Jinja.
    """
    require("jinja2")
    from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

    environment = Environment(
        loader=PackageLoader("agents"), autoescape=select_autoescape(default_for_string=False), trim_blocks=True,
        lstrip_blocks=True, keep_trailing_newline=False, undefined=StrictUndefined,
    )  # fmt: skip
    environment.filters |= {"number": number, "words": words, "listed": listed, "repr": repr}
    environment.filters |= {
        "g": "{:g}".format,
        "capitalised": lambda text: text[0].upper() + text[1:],
    }
    return environment


@cache
def _notes(file: str) -> dict[str, list[Any]]:
    """Templates of the notes of a file: their titles, where they have some, and paragraphs, by name."""
    text = files("agents").joinpath("templates", file).read_text(encoding="utf-8")
    found = {}
    for note in re.split(r"(?m)^## ", text)[1:]:
        heading, *parts = note.strip().split("\n\n")
        name, *title = heading.split(": ", 1)
        found[name] = [templates().from_string(" ".join(each.split())) for each in (*title, *parts)]
    return found


def paragraphs(file: str, name: str, **values: Any) -> list[str]:
    """The title, if it has one, and the paragraphs of a note with these values; those that are empty are left out.

    A file of ``templates/`` has a line ``## name`` or ``## name: title`` above each note.

    Raises:
        jinja2.UndefinedError: if a value lacks.
        ModuleNotFoundError: without Jinja.
    """
    return [text for each in _notes(file)[name] if (text := each.render(values).strip())]


def render(page: Page) -> str:
    """The page as HTML, its tables and figures numbered in their order."""
    numbers: dict[int, int] = {}
    counts: dict[type, int] = {}
    for section in page.sections:
        for block in section.blocks:
            counts[type(block)] = numbers[id(block)] = counts.get(type(block), 0) + 1
    context: dict[str, Any] = {"page": page, "number": lambda block: numbers.get(id(block))}
    html = (
        templates()
        .get_template("page.html")
        .render(kind=lambda block: type(block).__name__, **context)
    )
    return html.replace(" ± ", "\u00a0±\u00a0")  # no line breaks there


def write(page: Page, path: Path) -> Path:
    """Write the page to a file, whole or not at all.

    Raises:
        OSError: if it cannot be written.
    """
    with replacing(path) as temporary:
        temporary.write_text(render(page), encoding="utf-8")
    return path
