"""Every example in the documentation of the estimators runs."""

import re
from pathlib import Path

import pytest

PAGES = sorted((Path(__file__).parents[2] / "docs" / "estimators").glob("*.md"))
EXAMPLES = [
    pytest.param(code, id=f"{page.stem} {i}")
    for page in PAGES
    for i, code in enumerate(re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.M | re.S))
]


def test_there_are_examples():
    assert len(EXAMPLES) > 3


@pytest.mark.slow
@pytest.mark.parametrize("code", EXAMPLES)
def test_an_example_runs_as_it_stands(code: str, capsys: pytest.CaptureFixture, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # what an example saves is not kept
    if "consistency_figure" in code:
        pytest.importorskip("matplotlib")
    for library in re.findall(r"^(?:from|import) (filterpy|pykalman|dapper)\b", code, re.M):
        pytest.importorskip(library)
    if "agents" in code:
        pytest.importorskip("torch")
    exec(compile(code, "<example>", "exec"), {"__name__": "__main__"})


def test_the_pendulum_takes_fifteen_lines():
    code = EXAMPLES[[example.id for example in EXAMPLES].index("README 0")].values[0]
    lines = [line for line in code.splitlines() if line.strip()]
    assert len(lines) <= 15
