"""The papers' tables from few runs; the numbers of README and docs/papers.md from stored ones."""

import copy
import json
import re
from functools import cache
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from scripts import reproduce
from studies.papers import PAPERS, opening, read, settings
from studies.papers.measures import Report, Row, papers_page, readme_line
from studies.tables import around

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
    few = copy.deepcopy(settings(name)) | SMALLER.get(name, {})
    few |= {key: value for key, value in FEW.items() if key in few}
    if name == "segorogeni":
        few["trial"] |= {"step": 0.05}
        few["printed"] |= {"10": few["printed"]["50"]}
    if name == "itsunusa":
        few["printed"] |= {"20": few["printed"]["200"], "40": few["printed"]["400"]}
    for which in few.get("populations", {}).values():
        which |= {"systems": min(which["systems"], 4), "runs": 4}
    jobs = import_module(f"studies.papers.{name}.experiment").jobs(few)
    results = {
        what: json.loads(json.dumps(job.call(Path()), default=np.ndarray.tolist))
        for what, job in jobs.items()
    }
    return import_module(f"studies.papers.{name}.page").report(few, results)


@pytest.mark.slow
@pytest.mark.parametrize("name", PAPERS)
def test_a_page_shows_every_table_and_every_claim_has_a_verdict_and_a_place(name: str):
    report, text = made(name), read(name, "page.md")
    assert set(re.findall(r"<!-- table: (.*) -->", text)) == set(report.tables)
    assert "<!--" not in report.page(text)
    for table in report.tables.values():
        assert len(table) > 1
        assert {len(line) for line in table} == {len(table[0])}
    assert 80 < len(opening(name).split()) < 260
    assert len(_PLACE.findall(opening(name))) >= 3
    claims = re.findall(
        r"^\| ([^|]+) \| (true|false|undecided|undefined)[^|]* \| ([^|]+) \|$", text, re.M
    )
    assert len(claims) >= 3
    for claim, _, evidence in claims:
        assert _PLACE.search(claim + evidence) or "More members" in claim, claim


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "numbers"), [("corvette", 10), ("segorogeni", 18), ("itsunusa", 10), ("puna", 8)]
)
def test_every_printed_number_stands_in_the_table_with_its_place_and_verdicts(
    name: str, numbers: int
):
    report = made(name)
    head, *lines = report.tables["published"]
    assert len(lines) == numbers
    for _, _, printed, place, *columns in lines:
        assert re.match(r"[\d.]+", printed)
        assert _PLACE.search(place)
        for verdict in columns[2::3]:
            assert re.match("agrees|better|worse|not comparable", verdict)
    assert head[6::3] == ["verdict"] * ((len(head) - 4) // 3)
    counted = [row for row in report.rows if row.paper == report.rows[0].paper]
    assert sum(row.numbers for row in counted) == len(lines)
    for row in report.rows:
        assert row.numbers == row.agree + row.better + row.worse + row.incomparable


@pytest.mark.parametrize("name", ["corvette", "segorogeni", "itsunusa"])
def test_every_choice_is_a_line_of_the_settings_with_its_place(name: str):
    for choice, values in settings(name)["open"].items():
        assert set(values) == {"first", "believed", "where"}
        assert _PLACE.search(values["where"])
        assert len(re.findall(rf"(?m)^{choice} = \{{.*\}}", read(name, "settings.toml"))) == 1


def test_readme_and_the_papers_page_show_the_stored_results_and_the_openings():
    summary = json.loads(STORED.read_text(encoding="utf-8"))
    assert {name: each["opening"] for name, each in summary.items()} == {
        name: opening(name) for name in PAPERS
    }
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
        [
            Row(*row)
            for each in json.loads(path.read_text(encoding="utf-8")).values()
            for row in each["rows"]
        ]
        for path in (tmp_path / "summary.json", STORED)
    )
    assert [row[:-1] for row in found] == [row[:-1] for row in stored]
    np.testing.assert_allclose(
        *([row.factor for row in rows] for rows in (found, stored)), rtol=1e-6
    )
