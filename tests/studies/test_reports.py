"""The papers' pages from few runs, and the numbers of README and docs/papers.md from the stored ones."""

import copy
import json
import re
from functools import cache
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from agents.page import Claims, render
from scripts import reproduce
from studies import papers
from studies.papers import PAPERS, settings
from studies.papers.measures import Report, Row, papers_page, readme_line
from studies.tables.markdown import around

ROOT = Path(__file__).parents[2]
STORED = ROOT / "studies" / "papers" / "summary.json"
FEW = {"seeds": [0, 1], "runs_of_a_seed": 2, "own_runs": 6, "runs": 6}
SMALLER = {
    "segorogeni": {"members": [10, 200, 300]}, "itsunusa": {"members": [20, 40]},
    "puna": {"members": [100, 200, 300], "steps": 40}, "robust": {"steps": 60},
}  # fmt: skip
_PLACE = re.compile(
    r"\b(?:eqs?|secs?)\. [\dIV]|\b(?:Table|[Ff]igure)s? [\dI]|"
    r"\b(?:abstract|conclusion|case \([ab]\)|Hasil|Metode|Pendahuluan|Pembahasan|Tinjauan"
    r" Pustaka)\b"
)
"""A section, equation, table or figure of a paper."""


@cache
def made(name: str) -> Report:
    """The report of a paper from few runs, jobs computed here."""
    few = (
        copy.deepcopy(settings(name))
        | {k: v for k, v in FEW.items() if k in settings(name)}
        | SMALLER.get(name, {})
    )
    if name == "segorogeni":
        few["trial"] |= {"step": 0.05}
        few["printed"] |= {"10": few["printed"]["50"]}
    if name == "itsunusa":
        few["printed"] |= {"20": few["printed"]["200"], "40": few["printed"]["400"]}
    for which in few.get("populations", {}).values():
        which |= {"systems": min(which["systems"], 4), "runs": 4}
    jobs = import_module(f"studies.papers.{name}.experiment").jobs(few)
    page = import_module(f"studies.papers.{name}.page")
    results = {
        what: json.loads(json.dumps(job.compute(), default=np.ndarray.tolist))
        for what, job in jobs.items()
    }
    return page.report(few, results)


@pytest.mark.slow
@pytest.mark.parametrize("name", PAPERS)
def test_every_page_opens_with_a_paragraph_and_every_verdict_names_its_place(name: str):
    report = made(name)
    text = render(report.page)
    assert 80 < len(report.opening.split()) < 260
    assert len(_PLACE.findall(report.opening)) >= 3
    assert all(table.title.replace("'", "&#39;") in text for table in report.page.tables)
    claims = [
        c
        for s in report.page.sections
        for block in s.blocks
        if isinstance(block, Claims)
        for c in block.rows
    ]
    assert claims
    for claim in claims:
        assert claim.kind in ("true", "false", "undecided", "undefined")
        assert claim.evidence
        assert _PLACE.search(claim.text + claim.evidence) or "More members" in claim.text, (
            claim.text
        )


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in PAPERS if name != "robust"])
def test_every_printed_number_stands_in_the_table_with_its_place_and_a_verdict_for_each_column(
    name: str,
):
    report = made(name)
    (table,) = (table for table in report.page.tables if table.name == "published")
    lines = [entries for _, found in table.sections for _, entries in found]
    assert len(lines) == {"corvette": 10, "segorogeni": 18, "itsunusa": 10, "puna": 8}[name]
    for printed, place, *columns in lines:
        assert re.match(r"[\d.]+", printed.value)
        assert _PLACE.search(place.value)
        assert len(columns) == 6
        for verdict in columns[2::3]:
            assert re.split("[:,]", verdict.value)[0] in (
                "agrees",
                "better",
                "worse",
                "not comparable",
            )
    first = next(iter(report.rows)).paper
    counted = [row for row in report.rows if row.paper == first]
    assert sum(row.numbers for row in counted) == len(lines)
    for row in report.rows:
        assert row.numbers == row.agree + row.better + row.worse + row.incomparable


@pytest.mark.parametrize("name", ["corvette", "segorogeni", "itsunusa"])
def test_every_choice_is_a_line_of_the_settings_with_its_place(name: str):
    text = (ROOT / "studies" / "papers" / name / "settings.toml").read_text(encoding="utf-8")
    for choice, values in settings(name)["open"].items():
        assert set(values) == {"first", "believed", "where"}
        assert _PLACE.search(values["where"])
        assert len(re.findall(rf"(?m)^{choice} = \{{.*\}}", text)) == 1


@pytest.mark.parametrize("name", PAPERS)
def test_a_stored_opening_is_that_of_its_page_with_numbers_filled_in(name: str):
    page = (ROOT / "studies" / "papers" / name / "page.md").read_text(encoding="utf-8")
    opening = " ".join(
        re.sub(r"{%.*?%}", "", page).split("\n## ")[0].strip().split("\n\n")[-1].split()
    )
    fixed = map(re.escape, re.split(r"{{.*?}}", opening))
    assert re.fullmatch(
        ".+".join(fixed), json.loads(STORED.read_text(encoding="utf-8"))[name]["opening"]
    )


def test_readme_and_the_papers_page_show_the_stored_results():
    summary = json.loads(STORED.read_text(encoding="utf-8"))
    assert tuple(summary) == PAPERS
    for page, mark, expected in (
        (ROOT / "docs" / "papers.md", "text: papers", papers_page(summary)),
        (ROOT / "README.md", "text: papers, counted", readme_line(summary)),
    ):
        before, after = around(page, mark)
        assert page.read_text(encoding="utf-8")[len(before) : -len(after)].strip() == expected


@pytest.mark.nightly
def test_the_stored_results_are_what_the_command_finds(tmp_path: Path):
    assert reproduce.main(("all",), out=tmp_path, processes=2) == 0
    found, stored = (
        json.loads(path.read_text(encoding="utf-8")) for path in (tmp_path / "summary.json", STORED)
    )
    assert tuple(found) == tuple(stored) == papers.PAPERS
    for name in found:
        assert [Row(*each)[:-1] for each in found[name]["rows"]] == [
            Row(*each)[:-1] for each in stored[name]["rows"]
        ]
        factors = [
            [Row(*each).factor for each in summary[name]["rows"]] for summary in (found, stored)
        ]
        np.testing.assert_allclose(*factors, rtol=1e-6)
