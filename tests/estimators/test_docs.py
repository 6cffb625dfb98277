"""Every example in the documentation of the estimators runs, and so do the recipes of filters."""

import re
from pathlib import Path

import numpy as np
import pytest

DOCS = Path(__file__).parents[2] / "docs"
PAGES = sorted((DOCS / "estimators").glob("*.md"))
EXAMPLES = [
    pytest.param(code, id=f"{page.stem} {i}")
    for page in PAGES
    for i, code in enumerate(
        re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.M | re.S)
    )
]


def test_there_are_examples():
    assert len(EXAMPLES) > 3


@pytest.mark.slow
@pytest.mark.parametrize("code", EXAMPLES)
def test_an_example_runs_as_it_stands(
    code: str, capsys: pytest.CaptureFixture, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)  # what an example saves is not kept
    for library in re.findall(r"^(?:from|import) (filterpy|pykalman|dapper)\b", code, re.M):
        pytest.importorskip(library)
    if "agents" in code:
        pytest.importorskip("torch")
    exec(compile(code, "<example>", "exec"), {"__name__": "__main__"})


@pytest.mark.slow
@pytest.mark.parametrize("recipe", ["several-models", "error-state"])
def test_a_recipe_runs_from_its_first_block_to_its_last(recipe: str, capsys: pytest.CaptureFixture):
    text, found = (
        (DOCS / "recipes" / f"{recipe}.md").read_text(encoding="utf-8"),
        {"__name__": "__main__"},
    )
    for code in re.findall(r"^```python\n(.*?)^```", text, re.M | re.S):
        exec(compile(code, f"docs/recipes/{recipe}.md", "exec"), found)
    first = re.search(r"^class (InteractingModels|AttitudeFilter)\(.*?^```", text, re.M | re.S)
    assert first is not None
    assert first[0].count("\n") <= 40
    if recipe == "several-models":  # which is better than one model
        errors = np.array(found["errors"])[10:].mean(0)
        assert errors[0] < 0.4 * errors[1]
