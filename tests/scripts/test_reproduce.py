"""`python -m scripts.reproduce`: a page for each paper, nothing computed twice, failures said."""

import pytest

from agents.cells import Cell, journal
from agents.page import Entry, Page, Prose, Section, Table
from agents.reproduction import PAPERS, cells, page
from scripts import reproduce


def small(monkeypatch, function: str, **arguments: object) -> None:
    """Make every paper one of a single cell, whose result is a number."""

    def made(name: str, results: dict) -> Page:
        table = Table(
            "t", "", "name", [("value", "")], [("", [("sum", [Entry(str(results["only"]["values"]))])])], "sums"
        )
        return Page("A paper", "small", ["It holds.", "Always."], [Section("s", [Prose("p"), table])])

    monkeypatch.setattr("agents.reproduction.cells", lambda name: {"only": Cell(function, arguments, "only")})
    monkeypatch.setattr("agents.reproduction.page", made)


def test_a_paper_gives_a_page_and_its_tables_and_is_computed_once(tmp_path, monkeypatch, capsys):
    small(monkeypatch, "agents.reproduction:echo", values=[3])
    monkeypatch.setattr("agents.reproduction.echo", lambda values: {"values": values}, raising=False)
    assert reproduce.main(("robust",), out=tmp_path, jobs=1) == 0
    printed = capsys.readouterr().out
    assert "It holds. Always." in printed
    assert str(tmp_path / "robust.html") in printed
    first = (tmp_path / "robust.html").read_text()
    assert (tmp_path / "tables" / "robust-sums.csv").read_text() == "name,value\nsum,[3]\n"
    assert reproduce.main(("robust", "robust"), out=tmp_path, jobs=1) == 0
    assert (tmp_path / "robust.html").read_text() == first
    assert len(journal(tmp_path)) == 1


def test_a_paper_whose_cell_fails_has_no_page_and_says_why(tmp_path, monkeypatch, capsys):
    small(monkeypatch, "agents.studies.worlds:environment_id", name="none")
    assert reproduce.main(("robust",), out=tmp_path, jobs=1) == 1
    printed = capsys.readouterr().out
    assert "1 of 1 cells failed" in printed
    assert "unknown environment 'none'" in printed
    assert not (tmp_path / "robust.html").exists()


def test_no_paper_or_an_unknown_one_is_refused_in_a_sentence():
    with pytest.raises(ValueError, match="name the papers"):
        reproduce.main(())
    with pytest.raises(ValueError, match="choose from all, corvette"):
        cells("titanic")
    with pytest.raises(ValueError, match="choose from all, corvette"):
        page("titanic", {})


@pytest.mark.parametrize("name", PAPERS)
def test_every_paper_says_what_it_computes_without_computing_it(name):
    found = cells(name)
    assert found
    assert len({cell.key for cell in found.values()}) == len(found)
    assert all(cell.label for cell in found.values())
