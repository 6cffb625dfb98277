"""Every Python example of the README runs."""

import re
from pathlib import Path

import pytest

README = Path(__file__).parents[1] / "README.md"
EXAMPLES = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)


def test_the_readme_has_examples() -> None:
    assert len(EXAMPLES) >= 4


@pytest.mark.parametrize("example", EXAMPLES, ids=range(len(EXAMPLES)))
def test_an_example_of_the_readme_runs(example: str) -> None:
    exec(compile(example, str(README), "exec"), {"__name__": "readme"})


def test_the_own_estimator_of_the_readme_takes_about_20_lines() -> None:
    own = next(example for example in EXAMPLES if "class SteadyStateFilter" in example)
    body = own[own.index("class ") : own.index("env = ")]
    assert len([line for line in body.splitlines() if line.strip()]) <= 20


def test_the_install_line_of_the_readme_has_what_its_other_lines_import() -> None:
    assert "pip install -c constraints.txt -e '.[all]'" in README.read_text(encoding="utf-8")
