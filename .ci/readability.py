"""Check the language of pages: ``python .ci/readability.py [PAGE ...]``, by default all pages in English.

A sentence has at most 30 words and one semicolon. Every abbreviation is in the glossary, and no
retired word is used. Code, formulas, tables, references and text that commands write are not
checked.
"""

import re
import sys
from collections.abc import Iterator
from pathlib import Path

from markdown_it import MarkdownIt
from markdown_it.token import Token

ROOT = Path(__file__).resolve().parents[1]
NOT_READ = {"_build", "examples", "generated", "id"}
LONGEST = 30
"""Words of a sentence; the advice for technical English is 20 to 25 (ASD-STE100)."""
LEFT_OUT = re.compile(
    r"\A---\n.*?\n---\n"  # front matter
    r"|<!-- (?:table|text): .*?<!-- end -->|<!-- measured -->.*?<!-- end -->|<!-- (\w+) -->.*?<!--"
    r" /\1 -->"
    r"|^\$\$$.*?^\$\$$"  # formulas
    r"|^:{3,}.*?$|^:[a-z-]+:.*?$"  # fences and options of MyST's directives
    r"|^## (?:References|Sources)\n.*?(?=^## |\Z)|^Sources?: .*?(?=\n\n|\Z)",
    re.S | re.M,
)
FORMULA = re.compile(r"\$[^$`]+\$")
END = re.compile(
    r"(?<=[.!?])(?<!\bsec\.)(?<!\bch\.)(?<!\beq\.)(?<!\bal\.)[\"')]*\s+(?=[A-Z0-9\"(±−])"
)
ABBREVIATION = re.compile(r"\b[A-Z]{2,}\b")
KNOWN = re.compile(
    "AMD|API|AVX|BLAS|CI|CPU|CSV|FMA|GPU|HTML|IEEE|IMO|IR|ISO|JSON|LLVM|MIT|SI|SOLAS|TOML|UTC"
    "|DAPPER|EPYC|ITS|ITSUNUSA|ITTC|LAUV|PUNA|REMUS|SEGOROGENI|SIGMA"
)
"""Abbreviations that a programmer or a mariner knows; names of ships, programs and authorities."""
RETIRED = re.compile(r"\b(?:bent|humps?|kicks?|ladder|rungs?|sheets?|told)\b", re.I)
"""The field says assumed, nonlinear, modes, increment, fallback, metrics; the changelog has the table."""


def pages() -> list[Path]:
    """Pages in English of the documentation and the repository's front."""
    found = (
        page
        for page in (ROOT / "docs").rglob("*.md")
        if not NOT_READ & set(page.relative_to(ROOT).parts)
    )
    return [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(found)]


def sentences(text: str) -> Iterator[str]:
    """Sentences of a page's headings, paragraphs and list items."""
    table = False
    for token in (
        MarkdownIt("commonmark")
        .enable("table")
        .parse(FORMULA.sub("`formula`", LEFT_OUT.sub("", text)))
    ):
        table = token.type == "table_open" or (table and token.type != "table_close")
        if token.type == "inline" and not table:
            yield from END.split("".join(map(_words, token.children or ())))


def _words(token: Token) -> str:
    """Text of a part of a sentence; a piece of code is one word, and may begin a sentence."""
    return {"code_inline": "Code", "text": token.content, "softbreak": " ", "hardbreak": " "}.get(
        token.type, ""
    )


def complaints(text: str, glossary: str) -> Iterator[str]:
    """What to mend in a page."""
    for sentence in sentences(text):
        if (length := len(sentence.split())) > LONGEST:
            yield f"{length} words: {sentence}"
        if sentence.count(";") > 1:
            yield f"a chain of semicolons: {sentence}"
        for word in sorted(set(ABBREVIATION.findall(sentence))):
            if not KNOWN.fullmatch(word) and not re.search(rf"\b{word}\b", glossary):
                yield f"{word} is not in the glossary: {sentence}"
        if retired := RETIRED.search(sentence):
            yield f'the retired word "{retired[0]}": {sentence}'


def main(paths: list[Path]) -> int:
    """Print what to mend; the number of complaints."""
    glossary = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
    found = [
        f"{path}: {each}"
        for path in paths
        for each in complaints(path.read_text(encoding="utf-8"), glossary)
    ]
    print(*found, sep="\n", end="\n" if found else "")
    return len(found)


if __name__ == "__main__":
    sys.exit(min(main([Path(name) for name in sys.argv[1:]] or pages()), 1))
