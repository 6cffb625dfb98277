"""The check of the pages' language: it finds what it is for, and nothing in the rest of a page."""

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

_SPEC = spec_from_file_location("readability", Path(__file__).parents[1] / ".ci" / "readability.py")
readability = module_from_spec(_SPEC)
_SPEC.loader.exec_module(readability)

LONG = "A sentence" + " that goes on" * 10
GLOSSARY = "NEES\n  Normalised estimation error squared."


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (f"Short. {LONG}.", "32 words"),
        (f"- an item\n- {LONG}\n", "32 words"),
        ("One; two; three.", "a chain of semicolons"),
        ("The XYZW of a filter.", "XYZW is not in the glossary"),
        ("The noise that it is told of.", 'the retired word "told"'),
    ],
    ids=["paragraph", "item", "semicolons", "abbreviation", "retired"],
)
def test_it_finds_a_mistake(text: str, complaint: str):
    (found,) = readability.complaints(f"# Title\n\n{text}\n", GLOSSARY)
    assert found.startswith(complaint)


@pytest.mark.parametrize(
    "text",
    [
        "The NEES of a filter. `XYZW` is code, of which every piece is one word.",
        f"```python\n# {LONG}\n```",
        f"| a | b |\n|---|---|\n| {LONG} | XYZW |",
        f"<!-- table: one -->\n\n{LONG}\n\n<!-- end -->",
        f"## References\n\n- {LONG}\n",
        f"{LONG[:60]}. `code` begins a sentence, too. {LONG[:60]}.",
    ],
    ids=["defined", "code", "table", "generated", "references", "sentences"],
)
def test_it_is_silent_about_the_rest(text: str):
    assert not [*readability.complaints(f"# Title\n\n{text}\n", GLOSSARY)]


def test_the_pages_and_the_readme_are_among_those_that_it_reads():
    names = {path.relative_to(readability.ROOT).as_posix() for path in readability.pages()}
    assert {"README.md", "docs/index.md", "docs/estimators/kalman.md"} <= names
    assert not any(name.startswith("docs/id/") for name in names)
