"""Pages from Markdown templates: every kind of block, and nothing left out in silence."""

import ast
from pathlib import Path

import jinja2
import pytest

from agents.page import Bullets, Claim, Claims, Entry, Facts, Figure, Prose, Table
from agents.reproduction.pages import template

PAGES = Path(template.__file__).parent
TEXT = """# A paper

One line,
two lines of subtitle

- {{ share|number(1, True) }} % less error,
  beyond doubt.
- Half.

## Results

Prose of {{ runs }}
runs.

- one
- two | three

@table errors: RMSE | in rad
Below, {{ runs }} runs.

@figure path: The path
Crosses: ends.

@claims
A note.
- It holds | true, of ours | since 0.1 | 0.2
- It fails | false | never

@facts: Settings
- step | 0.1 s
"""


@pytest.fixture
def fill(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(jinja2, "PackageLoader", lambda *_: jinja2.DictLoader({"paper.md": TEXT}))
    table = Table("", "", "", [("x", "m")], [("", [("a", [Entry("1")])])], "errors")

    def filled(tables=("errors",), **values):
        return template.fill("paper", dict.fromkeys(tables, table), {"path": "data:,"}, **values)

    return filled


def test_every_kind_of_block_comes_out_of_a_template(fill):
    page = fill(share=-1.25, runs=50)
    assert (page.title, page.subtitle) == ("A paper", "One line, two lines of subtitle")
    assert page.answer == ["−1.2 % less error, beyond doubt.", "Half."]
    (section,) = page.sections
    prose, bullets, table, figure, claims, facts = section.blocks
    assert section.title == "Results"
    assert prose == Prose("Prose of 50 runs.")
    assert bullets == Bullets(["one", "two | three"])
    assert isinstance(table, Table)
    assert (table.title, table.note, table.name) == ("RMSE | in rad", "Below, 50 runs.", "errors")
    assert table.sections == [("", [("a", [Entry("1")])])]
    assert figure == Figure("data:,", "The path", "Crosses: ends.")
    rows = [Claim("It holds", "true, of ours", "since 0.1 | 0.2"), Claim("It fails", "false", "never")]
    assert claims == Claims(rows, "A note.")
    assert facts == Facts("Settings", [("step", "0.1 s")])


def test_a_placeholder_without_a_value_and_a_table_that_does_not_exist_are_refused(fill):
    with pytest.raises(jinja2.UndefinedError, match="runs"):
        fill(share=1.0)
    with pytest.raises(KeyError, match="errors"):
        fill(tables=(), share=1.0, runs=50)


@pytest.mark.parametrize("name", ["corvette", "segorogeni", "itsunusa", "puna", "robust"])
def test_prose_stands_in_the_template_and_not_in_the_code(name: str):
    """The longest string of the code, docstrings apart, is a part of a sentence; the template has the sentences."""
    tree = ast.parse((PAGES / f"{name}.py").read_text(encoding="utf-8"))
    documented = (ast.Module, ast.FunctionDef, ast.ClassDef)
    docstrings = {ast.get_docstring(node, clean=False) for node in ast.walk(tree) if isinstance(node, documented)}
    strings = {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    assert max(len(text.split()) for text in strings - docstrings) < 25
    assert len((PAGES / f"{name}.md").read_text(encoding="utf-8").split()) > 500
