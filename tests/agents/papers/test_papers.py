"""The papers' tables and measures, and `vessel-gym reproduce`, which writes their pages."""

import csv
import json
import re
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents import papers
from agents.commands import reproduce
from agents.jobs import Job
from agents.papers import PAPERS, pages, read, settings
from agents.papers.figures import draw
from agents.papers.measures import Comparison, comparison_table, rows, trend
from agents.papers.pages import file_name, page_parts
from studies.markdown import ROOT, around
from studies.tables import papers_page

STORED = json.loads((ROOT / "docs/papers.json").read_text(encoding="utf-8"))
SMALLER: dict[str, dict[str, Any]] = {
    "corvette": {"runs": 6},
    "segorogeni": {"members": [50, 200, 300], "seeds": [0, 1], "runs_of_a_seed": 2, "own_runs": 6},
    "itsunusa": {"members": [200, 300], "runs": 6},
    "puna": {"members": [100, 200, 300], "runs": 6, "steps": 40},
    "robust": {"steps": 60},
}
NUMBERS = {"corvette": 10, "segorogeni": 18, "itsunusa": 10, "puna": 8}
"""Printed numbers of which there are as many here."""
FIGURES = {
    "corvette": [f"4.{i}" for i in range(1, 11)], "segorogeni": ["2"],
    "itsunusa": ["3", "4", "5", "6"], "robust": ["1", "2", "3", "4", "5"],
    "puna": ["2", "3", "4 constant", "4 varying"],
}  # fmt: skip
"""Result figures of each paper; two of the PUNA's are both called 4."""
VERDICTS = {"agrees", "better", "worse", "not comparable"}
_PLACE = re.compile(
    r"\b(?:eqs?|secs?)\. [\dIV]|\b(?:Table|[Ff]igure)s? [\dI]|"
    r"\b(?:abstract|conclusion|case \([ab]\)|Hasil|Metode|Pendahuluan|Pembahasan|Tinjauan"
    r" Pustaka)\b"
)
"""A section, equation, table or figure of a paper."""


def made(name: str) -> Any:
    """The report of a paper from few runs."""
    few = settings(name) | SMALLER[name]
    if name == "segorogeni":
        few["trial"]["step"] = 0.05
    for which in few.get("populations", {}).values():
        which |= {"systems": min(which["systems"], 4), "runs": 4}
    return import_module(f"agents.papers.{name}.experiment").report(few)


@pytest.mark.slow
@pytest.mark.parametrize("name", PAPERS)
def test_every_number_and_claim_has_a_verdict_and_a_place(name: str):
    report, text = made(name), read(name, "page.md")
    tables = report["tables"]
    assert set(re.findall(r"<!-- table: (.*) -->", text)) == set(tables)
    (_, _, opening), sections = page_parts(name, tables)
    assert "<!--" not in "".join(section.html for section in sections)
    assert [each["number"] for each in report["figures"]] == FIGURES[name]
    for each in report["figures"]:
        draw(each)
        for panel in each["panels"]:
            for line in panel["lines"].values():
                assert {np.isfinite(of).all() for of in line} == {True}
    for table in tables.values():
        assert len(table) > 1
        assert {len(line) for line in table} == {len(table[0])}
    assert len(_PLACE.findall(opening)) >= 3
    claim = r"^\| ([^|]+) \| (?:true|false|undecided|undefined)[^|]* \| ([^|]+) \|$"
    claims = re.findall(claim, text, re.M)
    assert len(claims) >= 3
    for said, evidence in claims:
        assert _PLACE.search(said + evidence) or "More members" in said, said
    for choice in settings(name).get("open", {}).values():
        assert _PLACE.search(choice["where"])
    if name == "robust":  # prints no number
        return
    of = report["rows"]
    assert sum(each.numbers for each in of if each.paper == of[0].paper) == NUMBERS[name]
    for _, _, printed, place, *columns in tables["published"][1:]:
        assert re.match(r"[\d.]+", printed)
        assert _PLACE.search(place)
        assert {verdict.split(",")[0].split(":")[0] for verdict in columns[2::3]} <= VERDICTS


def comparison(printed: str, mean: float, spread: float = 1e-9, **options: Any) -> Comparison:
    deviations = np.random.default_rng(0).normal(size=200)
    ours = mean + spread * (deviations - deviations.mean())
    return Comparison("I", "psi", "rad", printed, "12", ours, **options)


@pytest.mark.parametrize(
    ("mean", "spread", "averaged", "words"),
    [
        (0.00474, 1e-9, 1, "agrees"),
        (0.00476, 1e-9, 1, "worse"),
        (0.00464, 1e-9, 1, "better"),
        (0.0048, 0.0005, 1, "agrees"),  # 0.00005 and 0.00007
        (0.0040, 0.0005, 1, "better, within the scatter of 1"),
        (0.0040, 0.0005, 10, "better"),
    ],
)
def test_a_number_agrees_within_rounding_and_our_interval(
    mean: float, spread: float, averaged: int, words: str
):
    assert comparison("0.0047", mean, spread, averaged=averaged).words == words


def test_misprints_count_as_meant_and_circular_numbers_not():
    circular = comparison("1.0", 9.0, reason="taken from it")
    speed = comparison("18291", 2 * 1.8291, meant="1.8291")
    found = [comparison("1.0", 0.5), circular, speed]
    assert rows("p", found) == [("p", "I", 3, 0, 1, 1, 1, 0, pytest.approx(2.0))]
    _, _, (*_, verdict), (*_, meant, _, _, _, _) = comparison_table({"ours": found})
    assert verdict == "not comparable: taken from it"
    assert meant == "18291 (1.8291 meant) rad"


def test_a_trend_follows_a_power_of_the_members():
    members = np.array([50, 100, 200])
    errors = members**-0.5 * np.exp(0.001 * np.random.default_rng(0).normal(size=(50, 3)))
    mean, low, high = map(float, re.findall(r"[-\d.]+", trend(members, errors).replace("−", "-")))
    assert low <= mean <= high
    assert mean == pytest.approx(100.0 * (4.0**-0.5 - 1.0), abs=0.1)


def test_the_papers_page_shows_stored_results():
    before, after = around(ROOT / "docs/papers.md", "text: papers")
    text = (ROOT / "docs/papers.md").read_text(encoding="utf-8")
    assert text[len(before) : -len(after)].strip() == papers_page(STORED)


@pytest.mark.nightly
def test_the_stored_results_are_what_the_command_finds(tmp_path: Path):
    assert reproduce.main(("all",), out=tmp_path) == 0
    found = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    for name, of in STORED.items():
        for one, other in zip(found[name]["rows"], of["rows"], strict=True):
            assert one == [*other[:-1], pytest.approx(other[-1], rel=1e-6)]


def test_the_papers_page_shows_every_stored_figure():
    stored = {file_name(name, title) for name, each in STORED.items() for title in each["figures"]}
    assert {path.name for path in (ROOT / "docs/images/papers").iterdir()} == stored
    assert {name: [*each["figures"]] for name, each in STORED.items()} == {
        name: [f"Figure {number}" for number in numbers] for name, numbers in FIGURES.items()
    }


def test_numbers_of_the_table_of_items_are_stored_ones():
    text = (ROOT / "docs/papers.csv").read_text(encoding="utf-8")
    items = [*csv.DictReader(text.splitlines())]
    assert all(all(item.values()) for item in items)
    kept = json.dumps(STORED) + "".join(read(name, "page.md") for name in PAPERS)
    for item in items:
        for number in re.findall(r"\d+\.\d{2,}", item["printed"] + item["ours"]):
            assert number in kept, (item["item"], number)


def test_a_paper_is_computed_once_and_one_that_fails_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    panel = {"x": "t", "y": "x", "lines": {"real": [[0, 1], [2, 3]]}}
    report: Any = {
        "tables": {"sums": [["name", "sum"], ["a", "3"]]},
        "figures": [{"number": "7", "caption": "A line.", "panels": [panel]}],
        "rows": [["A", "I", *range(6), 1.25]],
    }
    calls = []
    monkeypatch.setattr(papers, "made", lambda: calls.append(1) or report, raising=False)
    text = "# A\n\nof\n\nIt holds.\n\n## Printed\n\n<!-- table: sums -->\n"
    for module in (papers, pages):
        monkeypatch.setattr(module, "read", lambda *_: text)
    jobs = {"robust": Job("agents.papers:made", {}),
            "puna": Job("agents.papers:settings", {"name": "x"})}  # fmt: skip
    monkeypatch.setattr(papers, "job", jobs.get)
    for _ in range(2):
        assert reproduce.main(("robust", "puna", "robust"), out=tmp_path, processes=1) == 1
    assert len(calls) == 1
    html = (tmp_path / "robust.html").read_text()
    assert html.index("It holds.") < html.index("A line.") < html.index("<td>3</td>")
    assert (tmp_path / "figures" / "robust-7.svg").stat().st_size > 1000
    assert (tmp_path / "tables" / "robust-sums.csv").read_text() == "name,sum\na,3\n"
    stored = json.loads((tmp_path / "summary.json").read_text())
    assert stored == {"robust": report | {"figures": {"Figure 7": "A line."}}}
    assert "TOMLDecodeError" in capsys.readouterr().out
