"""A report as data: what is in the data is on the page, and nothing else is needed to read it."""

import csv
import io
import re
from html import unescape

import pytest

from agents.page import (
    Bullets,
    Claim,
    Claims,
    Entry,
    Facts,
    Figure,
    Live,
    Page,
    Prose,
    Section,
    Table,
    entry,
    listed,
    number,
    render,
    words,
    write,
)  # fmt: skip
from agents.plotting import data_uri, styled
from agents.statistics import Interval


def picture() -> str:
    from matplotlib.figure import Figure as Canvas

    with styled():
        canvas = Canvas(figsize=(2, 1))
        canvas.subplots().plot([0, 1], [0, 1])
        return data_uri(canvas)


TABLE = Table(
    "errors",
    "RMS.",
    "filter",
    [("x", "m"), ("y", "")],
    [("calm", [("kf", [Entry("1.0", "0.1"), Entry("−")])])],
)
PAGE = Page(
    "A <title>",
    "in a line",
    ["First & foremost.", "Second."],
    [
        Section(
            "Results", [Prose("A paragraph."), TABLE, Figure(picture(), "tracks", "Of two ships.")]
        ),
        Section(
            "Words", [Bullets(["one"]), Facts("Run", [("command", "python -m x"), ("seed", "7")])]
        ),
        Section("Claims", [Claims([Claim("It holds.", "true", "1 ± 0.1")], "A note."), TABLE]),
    ],
)


def test_everything_in_the_data_is_on_the_page_and_escaped():
    html = render(PAGE)
    words = [
        "A &lt;title&gt;",
        "First &amp; foremost.",
        "Second.",
        "A paragraph.",
        "Of two ships.",
        "RMS.",
        "Calm",
    ]
    for text in (*words, "one", "seed", "It holds.", "verdict true", "A note."):
        assert text in html


def test_tables_and_figures_are_numbered_in_their_order():
    again = Table("again", "", "filter", [("x", "")], [("", [("kf", [Entry("2")])])])
    html = render(
        Page(
            "t",
            "s",
            ["a"],
            [Section("one", [TABLE, PAGE.sections[0].blocks[2]]), Section("two", [again])],
        )
    )
    assert re.findall(r"<b>(\w+ \d)\.</b>", html) == ["Table 1", "Figure 1", "Table 2"]


def test_a_page_needs_nothing_beside_itself():
    html = render(PAGE)
    assert not re.search(r'(?:src|href)="(?!data:)', html)
    assert "<script" not in html
    assert "@import" not in html


def test_a_page_inside_a_page_is_shut_in_and_whole():
    document = '<p title="a & b">1 < 2</p><script>let x = "</iframe>";</script>'
    html = render(Page("t", "s", ["a"], [Section("one", [Live(document, "A dive", "Played.")])]))
    frame = re.search(r'<iframe srcdoc="([^"]*)" title="A dive" sandbox="allow-scripts"', html)
    assert frame
    assert unescape(frame[1]) == document
    assert "<b>Episode 1.</b> A dive. Played." in html


def test_the_same_data_give_the_same_page():
    assert picture() == picture()
    assert render(PAGE) == render(PAGE)


def test_a_table_in_plain_text_keeps_its_sections_units_and_intervals():
    rows = list(csv.reader(io.StringIO(TABLE.csv())))
    assert rows == [["", "filter", "x [m]", "y"], ["calm", "kf", "1.0 ± 0.1", "−"]]


AWKWARD = Table(
    "50 % of {x_1}", "See ~ and \\.", "a|b", [("x_y", "µm"), ("", "°/s")],
    [
        ("calm & rough", [("[kf]", [Entry("−1.0", "0.1"), Entry("#2 ^3")])]),
        ("", [("$", [Entry("–"), Entry("0.1 [0.0, 0.2]")])]),
    ],
)  # fmt: skip


def test_a_table_in_markdown_has_the_same_cells_in_every_row():
    title, _, *lines, _, note = AWKWARD.markdown().splitlines()
    assert title == "**50 % of {x_1}**"
    assert note == AWKWARD.note
    rows = [re.split(r"(?<!\\)\|", line)[1:-1] for line in lines]
    assert [len(row) for row in rows] == [4] * 4
    assert [cell.strip() for cell in rows[2]] == ["calm & rough", "[kf]", "−1.0 ± 0.1", "#2 ^3"]


def test_a_table_with_many_columns_is_set_smaller():
    many = Table("t", "", "a", [("x", "")] * 8, [("", [("kf", [Entry("1")] * 8)])])
    assert 'class="wide"' in render(Page("t", "s", ["a"], [Section("s", [many])]))
    assert 'class="wide"' not in render(PAGE)


def test_numbers_have_true_minus_signs_and_dashes_for_what_is_not_finite():
    assert number(-1.25, 1) == "−1.2"
    assert number(1.0, 2, signed=True) == "+1.00"
    assert number(-0.001, 2) == number(0.001, 2, signed=True) == "0.00"
    assert number(float("nan"), 2) == number(float("inf"), 2) == "–"


def test_only_a_difference_that_excludes_zero_is_bold():
    clear, unclear = Interval(1.0, 0.5, 1.5), Interval(1.0, -0.5, 2.5)
    assert entry(clear, 1, signed=True).strong
    assert not entry(unclear, 1, signed=True).strong
    assert not entry(clear, 1).strong
    assert entry(None, 1) == Entry("–")


def test_lists_read_as_sentences_do():
    assert [listed("a"), listed("ab"), listed("abc")] == ["a", "a and b", "a, b and c"]


def test_a_page_is_written_whole_or_not_at_all(tmp_path):
    path = write(PAGE, tmp_path / "pages" / "a.html")
    assert path.read_text(encoding="utf-8") == render(PAGE)
    broken = Page("x", "y", [], [Section("s", [object()])])  # type: ignore[list-item]
    with pytest.raises(Exception, match="object"):
        write(broken, path)
    assert path.read_text(encoding="utf-8") == render(PAGE)
    assert [p.name for p in path.parent.iterdir()] == ["a.html"]


def test_a_sentence_shows_an_interval_s_width_in_as_many_decimals_as_that_takes():
    assert words(Interval(0.00018, 0.00007, 0.00029), 3) == "0.0002 ± 0.0001"
    assert words(Interval(0.0, 0.0, 0.0), 3) == "0.000 ± 0.000"
    assert words(Interval(0.9, 0.8, 1.0), 1) == "0.9 ± 0.1"


def test_a_page_without_an_answer_is_a_page_and_a_list_of_nothing_is_refused():
    assert 'class="answer"' in render(PAGE)
    assert 'class="answer"' not in render(Page("A title", "in a line", []))
    with pytest.raises(ValueError, match=r"^a list in a sentence needs at least one item$"):
        listed([])
