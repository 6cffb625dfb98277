"""Examples of the pages run as they stand."""

from pathlib import Path

import pytest
from pages import DOCS, blocks

from agents.seeds import evaluation_seeds

ELSEWHERE = {
    "engine",
    "primer",
    "recipes/capytaine",
    "studies",
    "training",
    "vehicles",
}
"""Pages whose examples other tests run."""
AT_NIGHT = {
    "any-environment",
    "recipes/differential-drive",
    "recipes/error-state",
    "recipes/own-measurements",
    "recipes/several-models",
    "tuning",
}
"""Pages that take as long as all others together, as do those on estimators.

By day other tests run what they show.
"""
FILES = [
    path for part in (".", "recipes", "estimators") for path in sorted(DOCS.glob(f"{part}/*.md"))
]
PAGES = [
    page
    for page in (file.relative_to(DOCS).with_suffix("").as_posix() for file in FILES)
    if blocks(page, "python")
]


def at_night(page: str) -> bool:
    return page in AT_NIGHT or page.startswith("estimators/")


LIBRARIES = {"InvertedPendulum": "mujoco", "LunarLander": "Box2D"} | {
    name: name for name in ("pandas", "filterpy", "pykalman", "dapper")
}


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=pytest.mark.nightly if at_night(page) else ())
        for page in PAGES
        if page not in ELSEWHERE
    ],
)
def test_the_examples_of_a_page_run(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "agents.seeds.evaluation_seeds", lambda *_: evaluation_seeds(3)
    )  # few flights
    names = {"__name__": "page"}
    for code in blocks(page, "python"):
        for name, library in LIBRARIES.items():
            if name in code:
                pytest.importorskip(library)
        exec(compile(code, f"docs/{page}.md", "exec"), names)
