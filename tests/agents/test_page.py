"""Numbers, lists and tables in words, and a report that needs nothing but itself."""

import re
from html import unescape

import pandas as pd
import pytest
from matplotlib.figure import Figure

from agents.page import Block, iframe, listed, number, text, write_page
from agents.statistics import Interval

TABLE = pd.DataFrame({"x <m>": ["1.0 ± 0.1"]}, index=["a & b"]).rename_axis("name")


def test_page_is_complete_escaped_and_self_contained(tmp_path):
    document = '<p title="a & b">1 < 2</p><script>let x = "</iframe>";</script>'
    blocks = [
        Block("Errors", TABLE, "RMS < 1."),
        Block("Tracks", figures={"Tracks": Figure()}),
        Block("A dive", html=iframe("A dive", document)),
        Block("Words", items=["one & two"]),
    ]
    path = write_page(
        tmp_path / "pages" / "a.html", "A <title>", "sub", ["First & 2.", "x"], blocks
    )
    html = path.read_text(encoding="utf-8")
    for part in ("A &lt;title&gt;", "First &amp; 2.", "RMS &lt; 1.", "x &lt;m&gt;", "a &amp; b",
                 "1.0 ± 0.1", "one &amp; two"):  # fmt: skip
        assert part in html
    frame = re.search(r'<iframe srcdoc="([^"]*)" title="A dive" sandbox="allow-scripts"', html)
    assert unescape(frame[1]) == document
    assert not re.search(r'(?:src|href)="(?!data:)', html)


def test_tables_of_a_page_lie_beside_it_as_csv_and_latex(tmp_path):
    table = pd.DataFrame({"a_b [°]": ["−1.0 ± 0.1", "–"]}, index=["5 %", "σ"]).rename_axis("name")
    write_page(tmp_path / "a.html", "t", "s", [], [Block("Costs: x/y", table, "n")])
    assert {each.name for each in (tmp_path / "tables").iterdir()} == {
        "costs-x-y.csv", "costs-x-y.tex"
    }  # fmt: skip
    found = pd.read_csv(tmp_path / "tables" / "costs-x-y.csv", index_col="name")
    pd.testing.assert_frame_equal(found, table, check_dtype=False)
    latex = (tmp_path / "tables" / "costs-x-y.tex").read_text(encoding="utf-8")
    assert latex.isascii()
    for part in (r"\toprule", r"name & a\_b [$^\circ$] \\", r"5 \% & $-$1.0 $\pm$ 0.1 \\", "--"):
        assert part in latex


def test_a_page_is_written_whole_or_not_at_all(tmp_path):
    path = write_page(tmp_path / "a.html", "t", "s", [], [Block("b", html="c")])
    before = path.read_text(encoding="utf-8")
    with pytest.raises(Exception, match="object"):
        write_page(path, "t", "s", [], [object()])  # type: ignore[list-item]
    assert path.read_text(encoding="utf-8") == before
    assert [each.name for each in tmp_path.iterdir()] == ["a.html"]


def test_numbers_have_minus_signs_and_dashes_for_non_finite():
    assert number(-1.25, 1) == "−1.2"
    assert number(1.0, 2, signed=True) == "+1.00"
    assert number(-0.001, 2) == number(0.001, 2, signed=True) == "0.00"
    assert number(float("nan"), 2) == number(float("inf"), 2) == text(None, 2) == "–"


def test_interval_has_half_width_or_its_ends_if_uneven():
    assert text(Interval(-1.0, -1.5, -0.5), 1, signed=True) == "−1.0 ± 0.5"
    assert text(Interval(0.5, 0.1, 0.6), 1) == "0.5 [0.1, 0.6]"
    assert text(Interval(0.00018, 0.00007, 0.00029), 3) == "0.0002 ± 0.0001"
    assert text(Interval(0.0, 0.0, 0.0), 3) == "0.000 ± 0.000"
    assert text(Interval(0.9, 0.8, 1.0), 1) == "0.9 ± 0.1"


def test_lists_read_as_in_sentences():
    assert [listed("a"), listed("ab"), listed("abc")] == ["a", "a and b", "a, b and c"]
