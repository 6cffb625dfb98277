"""`python -m scripts.reproduce`: a page for each paper, nothing computed twice, failures said."""

import json

import pytest

from agents.jobs import Job
from scripts import reproduce
from studies import papers
from studies.papers import PAPERS, jobs, report
from studies.papers.measures import Report, Row


def small(monkeypatch, function: str, **arguments: object) -> None:
    """Make every paper one of a single job, whose result is a number."""

    def made(name: str, results: dict) -> Report:
        tables = {"sums": [("name", "value"), ("sum", str(results["only"]["values"]))]}
        return Report(tables, [Row("A paper", "I", 3, 1, 1, 0, 1, 2, 1.25)])

    text = "# A paper\n\nsmall\n\nIt\nholds.\n\n<!-- table: sums -->\n"
    monkeypatch.setattr(papers, "read", lambda *_: text)
    monkeypatch.setattr(papers, "jobs", lambda name: {"only": Job(function, arguments, "only")})
    monkeypatch.setattr(papers, "report", made)


def test_a_paper_gives_a_page_its_tables_and_its_measures_and_is_computed_once(
    tmp_path, monkeypatch, capsys
):
    small(monkeypatch, "studies.papers:echo", values=[3])
    monkeypatch.setattr(papers, "echo", lambda values: {"values": values}, raising=False)
    assert reproduce.main(("robust",), out=tmp_path, processes=1) == 0
    printed = capsys.readouterr().out
    assert "| A paper | I | 3 | 1 | 1 | 0 | 1 | 2 | 1.25 |" in printed
    assert str(tmp_path / "robust.md") in printed
    first = (tmp_path / "robust.md").read_text()
    assert (tmp_path / "tables" / "robust-sums.csv").read_text() == "name,value\nsum,[3]\n"
    stored = json.loads((tmp_path / "summary.json").read_text())
    assert stored == {
        "robust": {"opening": "It holds.", "rows": [["A paper", "I", 3, 1, 1, 0, 1, 2, 1.25]]}
    }
    computed = (tmp_path / "jobs").stat().st_mtime_ns
    assert reproduce.main(("robust", "robust"), out=tmp_path, processes=1) == 0
    assert (tmp_path / "robust.md").read_text() == first
    assert (tmp_path / "jobs").stat().st_mtime_ns == computed


def test_a_paper_whose_job_fails_has_no_page_and_says_why(tmp_path, monkeypatch, capsys):
    small(monkeypatch, "agents.studies.worlds:environment_id", name="none")
    assert reproduce.main(("robust",), out=tmp_path, processes=1) == 1
    printed = capsys.readouterr().out
    assert "1 of 1 jobs failed" in printed
    assert "unknown environment 'none'" in printed
    assert not (tmp_path / "robust.md").exists()


def test_an_unknown_paper_is_refused_in_a_sentence():
    for call in (
        lambda: reproduce.main(("titanic",)),
        lambda: jobs("titanic"),
        lambda: report("titanic", {}),
        lambda: papers.settings("titanic"),
    ):
        with pytest.raises(ValueError, match="choose from all, corvette"):
            call()


@pytest.mark.parametrize("name", PAPERS)
def test_every_paper_says_what_it_computes_without_computing_it(name):
    found = jobs(name)
    assert found
    assert len({job.key for job in found.values()}) == len(found)
    assert all(job.label for job in found.values())
