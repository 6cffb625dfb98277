"""A report as data, and as one HTML file that needs nothing but itself."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass, field
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
        columns = list(zip(*(entries for _, rows in self.sections for _, entries in rows), strict=True))
        words = [[e.value for e in column if e.value != "–"] for column in columns or [()] * len(self.head)]
        return [bool(column) and all(value[:1].isalpha() for value in column) for column in words]

    def rows(self) -> list[list[str]]:
        """Heading and rows in plain text, the section's title in a column of its own where there is one."""
        titled = any(title for title, _ in self.sections)
        heading = [self.first, *(f"{label} [{unit}]" if unit else label for label, unit in self.head)]
        body = [
            [title, name, *map(str, entries)] if titled else [name, *map(str, entries)]
            for title, rows in self.sections
            for name, entries in rows
        ]
        return [["", *heading] if titled else heading, *body]

    def csv(self) -> str:
        """As comma-separated values."""
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows(self.rows())
        return text.getvalue()

    def markdown(self) -> str:
        """As Markdown, the title above and the note below."""
        heading, *body = [[cell.replace("|", "\\|") for cell in row] for row in self.rows()]
        names = len(heading) - len(self.head)
        rule = ["---"] * names + ["---:"] * len(self.head)
        lines = [f"| {' | '.join(row)} |" for row in (heading, rule, *body)]
        return "\n".join([f"**{self.title}**", "", *lines, *(["", self.note] if self.note else []), ""])

    def latex(self) -> str:
        """As a LaTeX table for ``booktabs``, a section's title on a line of its own."""
        heading = [
            tex(self.first),
            *(f"{tex(label)} [{tex(unit)}]" if unit else tex(label) for label, unit in self.head),
        ]
        lines = [" & ".join(heading) + r" \\"]
        for title, rows in self.sections:
            lines.append(r"\midrule")
            if title:
                lines.append(rf"\multicolumn{{{len(heading)}}}{{l}}{{\textit{{{tex(title)}}}}} \\")
            lines += [
                " & ".join([tex(name), *(tex(str(entry)) for entry in entries)]) + r" \\" for name, entries in rows
            ]
        return "\n".join([
            "% needs \\usepackage{booktabs}",
            r"\begin{table}", r"\centering", rf"\caption{{{tex(self.title)}}}", rf"\label{{tab:{self.name}}}",
            rf"\begin{{tabular}}{{l{'r' * len(self.head)}}}", r"\toprule", *lines, r"\bottomrule", r"\end{tabular}",
            *([rf"\par\smallskip\footnotesize {tex(self.note)}"] if self.note else []),
            r"\end{table}", "",
        ])  # fmt: skip


_TEX = {
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}", '"': r"\textquotedbl{}",
    **{character: "\\" + character for character in "&%$#_{}"},
    # A bracket after the end of a row would be read as that row's spacing.
    "[": "{[}", "]": "{]}",
    "±": r"$\pm$", "−": "$-$", "–": "--", "°": r"$^\circ$", "×": r"$\times$", "≥": r"$\geq$", "≤": r"$\leq$",
    "µ": r"$\mu$", "σ": r"$\sigma$", "ψ": r"$\psi$", "²": "$^2$", "→": r"$\to$", "…": r"\ldots{}",
}  # fmt: skip


def tex(text: str) -> str:
    """Plain text for LaTeX: what means something to it is escaped, and symbols are named."""
    return "".join(_TEX.get(character, character) for character in text)


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
        return [block for section in self.sections for block in section.blocks if isinstance(block, Table)]


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


def render(page: Page) -> str:
    """The page as HTML, its tables and figures numbered in their order."""
    require("jinja2")
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("agents"), autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=StrictUndefined
    )
    numbers: dict[int, int] = {}
    counts: dict[type, int] = {}
    for section in page.sections:
        for block in section.blocks:
            counts[type(block)] = numbers[id(block)] = counts.get(type(block), 0) + 1
    context: dict[str, Any] = {"page": page, "number": lambda block: numbers.get(id(block))}
    html = environment.get_template("page.html").render(kind=lambda block: type(block).__name__, **context)
    return html.replace(" ± ", "\u00a0±\u00a0")  # no line breaks there


def write(page: Page, path: Path) -> Path:
    """Write the page to a file, whole or not at all.

    Raises:
        OSError: if it cannot be written.
    """
    with replacing(path) as temporary:
        temporary.write_text(render(page), encoding="utf-8")
    return path
