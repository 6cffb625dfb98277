"""Every Python example of the README, and of the pages that a newcomer reads first, runs."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = (
    ROOT / "README.md",
    ROOT / "docs" / "training.md",
    ROOT / "docs" / "environments" / "README.md",
    ROOT / "docs" / "environments" / "sigma-corvette.md",
    ROOT / "docs" / "tutorials" / "own-filter.md",
)
EXAMPLES = {
    f"{page.relative_to(ROOT)} {i}": code
    for page in PAGES
    for i, code in enumerate(
        re.findall(r"```(?:python|\{code-cell\})\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    )
}
OWN = EXAMPLES["docs/tutorials/own-filter.md 0"]


def test_each_page_has_an_example() -> None:
    assert {name.split(" ")[0] for name in EXAMPLES} == {str(page.relative_to(ROOT)) for page in PAGES}


@pytest.mark.parametrize("example", EXAMPLES.values(), ids=EXAMPLES)
def test_an_example_runs(example: str) -> None:
    if "SteadyStateFilter)" in example and example is not OWN:
        example = OWN + example  # a notebook's cells run in their order
    exec(compile(example, "page", "exec"), {"__name__": "page"})


def test_an_estimator_of_one_s_own_takes_about_20_lines() -> None:
    body = OWN[OWN.index("class ") : OWN.index("env = ")]
    assert len([line for line in body.splitlines() if line.strip()]) <= 20


def test_the_install_line_of_the_readme_has_what_its_other_lines_import() -> None:
    assert "pip install -c constraints.txt -e '.[all]'" in (ROOT / "README.md").read_text(encoding="utf-8")
