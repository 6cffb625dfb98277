"""Every Python example of the README, and of the pages that a newcomer reads first, runs."""

import json
import re
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

from agents.seeds import evaluation_seeds

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = (
    ROOT / "README.md",
    DOCS / "primer.md",
    DOCS / "training.md",
    DOCS / "environments" / "README.md",
    DOCS / "environments" / "sigma-channel.md",
)
NOTEBOOKS = (DOCS / "tutorials" / "own-filter.md", *sorted((DOCS / "id").glob("*-*.md")))


def examples(page: Path) -> list[str]:
    """Python of a page, without the options of cells."""
    found = re.findall(
        r"```(?:python|\{code-cell\})\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL
    )
    return [re.sub(r"^:.*\n", "", code, flags=re.M) for code in found]


def test_the_notebook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    cells = json.loads((DOCS / "notebooks" / "first-ship.ipynb").read_text(encoding="utf-8"))[
        "cells"
    ]
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    assert "%pip" in code[0]
    namespace: dict[str, object] = {"__name__": "notebook"}
    for cell in code[1:]:
        exec(compile(cell, "cell", "exec"), namespace)


AT_NIGHT = "filter-ensemble", "lima-menit", "own-filter", "training.md 0"
"""Pages that take longest: others by day record ensembles, have own parts and train."""
EXAMPLES = {
    f"{page.relative_to(ROOT)} {i}": code for page in PAGES for i, code in enumerate(examples(page))
} | {f"{page.relative_to(ROOT)} all": "".join(examples(page)) for page in NOTEBOOKS}


def test_each_page_has_an_example() -> None:
    assert {name.split(" ")[0] for name in EXAMPLES} == {
        str(page.relative_to(ROOT)) for page in (*PAGES, *NOTEBOOKS)
    }


@pytest.mark.parametrize(
    "example",
    [
        pytest.param(
            code, id=name, marks=pytest.mark.nightly if any(map(name.count, AT_NIGHT)) else ()
        )
        for name, code in EXAMPLES.items()
    ],
)
def test_an_example_runs(example: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plt, "show", lambda: plt.close("all"))
    monkeypatch.setattr("agents.seeds.evaluation_seeds", lambda *_: evaluation_seeds(3))
    monkeypatch.chdir(tmp_path)
    if "results/ppo.zip" in example:  # which a command above it has trained
        from agents.training.algorithms import train

        monkeypatch.setattr("agents.training.callbacks.EPISODES", 1)
        world, out = {"estimator": "kf-umv-ui"}, Path("results/ppo")
        train("SigmaCorvette-v0", out, world, steps=128, folder=out)
    exec(compile(example, "page", "exec"), {"__name__": "page"})


def test_links_of_readme_are_absolute_and_lead_to_files() -> None:
    links = re.findall(r"\]\(([^)]+)\)", (ROOT / "README.md").read_text(encoding="utf-8"))
    assert len(links) > 20
    assert all(link.startswith(("https://", "#")) for link in links)
    ours = r"https://(?:github.com/vessel-gym/vessel-gym/blob|raw.githubusercontent.com/vessel-gym/vessel-gym)/main/([^#]+)"
    paths = [found[1] for link in links if (found := re.match(ours, link))]
    site = re.search(r'Documentation = "(.*?)"', (ROOT / "pyproject.toml").read_text())[1]
    pages = [link.removeprefix(site) for link in links if link.startswith(site)]
    paths += [f"docs/{page[:-5]}.md" for page in pages if page.endswith(".html")]
    assert len(paths) > 10
    assert [path for path in paths if not (ROOT / path).is_file()] == []
