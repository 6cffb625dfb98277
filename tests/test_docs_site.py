"""The pages of the documentation site: found, short, with titles, and pictures that say what they show."""

import json
import posixpath
import re
import tomllib
from pathlib import Path

import gymnasium as gym
import pytest

import agents
import estimators
import vessel_gym
from vessel_gym.models.estimation import VARIANTS, estimator_names

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
BUILT = ("_build", "examples", "generated")
PAGES = {
    path.relative_to(DOCS).with_suffix("").as_posix(): path.read_text(encoding="utf-8")
    for path in sorted(DOCS.rglob("*.md"))
    if not set(BUILT) & set(path.parts)
}
WORDS = 1200
"""At most so many on a page."""
FENCED = re.compile(r"^(```+)[^`\n]*\n(.*?)^\1\s*$", re.M | re.S)
PICTURE = re.compile(r"!\[(.*?)\]\((.*?)\)")


def prose(page: str) -> str:
    """A page without front matter, code, tables, comments and the addresses of its links."""
    text = re.sub(r"\A---\n.*?\n---\n", "", page, flags=re.S)
    text = re.sub(r"\]\([^)]*\)", "]", FENCED.sub("", text))
    return "\n".join(
        line for line in text.splitlines() if not line.lstrip().startswith(("|", "<!--", ":"))
    )


def toctrees(name: str) -> list[str]:
    """The pages that a page's toctrees name."""
    found = re.findall(r"^```\{toctree\}\n(.*?)^```", PAGES[name], re.M | re.S)
    entries = (line.strip() for block in found for line in block.splitlines())
    folder = posixpath.dirname(name)
    return [
        posixpath.normpath(posixpath.join(folder, entry))
        for entry in entries
        if entry and entry[0] != ":"
    ]


def test_every_page_is_in_one_toctree():
    listed = [entry for name in PAGES for entry in toctrees(name)]
    assert len(listed) == len(set(listed))
    assert set(listed) - {"examples/index"} == set(PAGES) - {"index"}


@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_short_and_has_one_title(name: str):
    text = prose(PAGES[name])
    assert len(re.findall(r"[^\W\d_][\w'’-]*", text)) <= WORDS
    titles = re.findall(r"^# .+", text, re.M)
    assert len(titles) == 1
    assert text.lstrip().startswith(titles[0])


@pytest.mark.parametrize("package", [agents, estimators, vessel_gym])
def test_the_api_page_lists_every_public_name(package):
    listed = set(re.findall(r"^   (\w+)$", PAGES["api/README"], re.M))
    assert set(package.__all__) - {"Model", "Rng"} <= listed  # these are types of arguments


def test_the_page_of_filters_has_a_line_for_each_name():
    section = PAGES["estimators/README"].partition("\n## Filters\n")[2].partition("\n## ")[0]
    lines = re.findall(r"^\| (`.*?`) \| \w", section, re.M)
    endings = {f"...-{ending}" for ending in VARIANTS}
    assert {*re.findall(r"`(.*?)`", " ".join(lines))} == {*estimator_names()} | endings


@pytest.mark.parametrize(
    "name", [name for name, page in PAGES.items() if PICTURE.search(page) or "plt.show" in page]
)
def test_every_picture_is_there_and_says_what_it_shows(name: str):
    for alt, where in PICTURE.findall(PAGES[name]):
        assert len(alt.split()) >= 3
        assert (DOCS / name).parent.joinpath(where).is_file()
    cells = [
        code for _, code in FENCED.findall(PAGES[name]) if re.search(r"plt\.show|_figure\(", code)
    ]
    assert all(
        re.search(r"^:    alt: (\S+ ){3,}", code, re.M)
        for code in cells
        if PAGES[name].startswith("---")
    )


CODE = re.compile(r"^```(?:python[^\n]*|py|sh|toml|\{code-cell\})\n(.*?)^```", re.M | re.S)


@pytest.mark.parametrize("name", [name for name, page in PAGES.items() if CODE.search(page)])
def test_code_of_a_page_is_not_cut_on_a_screen(name: str):
    lines = [line for code in CODE.findall(PAGES[name]) for line in code.splitlines()]
    assert [line for line in lines if len(line) > 76 and not line.startswith(":")] == []


def test_the_switcher_offers_this_version():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"][
        "version"
    ]
    assert version in [
        one["version"] for one in json.loads((DOCS / "_static" / "switcher.json").read_text())
    ]


def test_every_environment_has_a_page_made_from_its_manual():
    specs = [
        spec
        for spec in gym.registry.values()
        if str(spec.entry_point).startswith("vessel_gym.envs:")
    ]
    named = {str(spec.entry_point).replace(":", ".") for spec in specs if spec.namespace is None}
    assert set(re.findall(r"^```\{manual\} (\S+)", "\n".join(PAGES.values()), re.M)) == named
