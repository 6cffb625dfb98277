"""Measures of closeness, and pages from templates."""

from pathlib import Path

import jinja2
import numpy as np
import pytest

from agents.page import Bullets, Claim, Claims, Facts, Prose, Table
from agents.statistics import Interval
from studies.papers import template
from studies.papers.measures import (
    Comparison,
    comparison_table,
    falls,
    papers_page,
    readme_line,
    row,
    rows,
    trend,
)

RNG = np.random.default_rng(0)


def comparison(printed: str, mean: float, spread: float, **options) -> Comparison:
    deviations = RNG.normal(size=200)
    deviations -= deviations.mean()
    return Comparison("I", "psi", "rad", printed, "12", mean + spread * deviations, **options)


def test_a_printed_number_agrees_within_rounding_and_our_interval_and_scatter_is_said():
    assert comparison("0.0047", 0.00474, 1e-9).verdict == "agrees"
    assert comparison("0.0047", 0.00476, 1e-9).verdict == "worse"
    assert comparison("0.0047", 0.00464, 1e-9).verdict == "better"
    assert comparison("0.0047", 0.0048, 0.0005).verdict == "agrees"  # 0.00005 and 0.00007
    assert comparison("0.0047", 0.0040, 0.0005).words == "better, within the scatter of 1"
    assert comparison("0.0047", 0.0040, 0.0005, averaged=10).words == "better"


def test_a_misprint_is_compared_as_meant_and_what_is_circular_not_at_all():
    speed = comparison("18291", 1.8291, 1e-9, meant=1.8291)
    assert speed.verdict == "agrees"
    assert speed.ratio.mean == pytest.approx(1.0)
    circular = comparison("0.0006", 0.0006, 1e-9, reason="taken from it")
    assert circular.verdict == "not comparable"
    (_, ((name, entries), *_)), = comparison_table({"": [circular]}).sections  # fmt: skip
    assert name == "psi"
    assert entries[1].value == "12"
    assert entries[-1].value == "not comparable: taken from it"


def test_an_experiment_is_a_row_and_its_typical_factor_the_mean_log_ratio_of_what_compares():
    found = [
        comparison("1.0", 2.0, 1e-9),
        comparison("1.0", 0.5, 1e-9),
        comparison("1.0", 9.0, 1e-9, reason="no"),
    ]
    assert row("p", "I", found) == ("p", "I", 3, 0, 1, 1, 1, 0, pytest.approx(2.0))
    assert rows("p", found) == [row("p", "I", found)]
    assert row("p", "I", found[2:]).texts[-1] == "–"


def test_docs_count_each_way_and_leave_what_a_search_found_out_of_the_sentence():
    summary = {
        "a": {
            "opening": "Opened.",
            "rows": [
                ["A", "I", 3, 1, 1, 0, 1, 0, 4.0], ["A", "II", 2, 1, 0, 1, 0, 0, 1.0],
                ["A (exploratory)", "I", 3, 3, 0, 0, 0, 3, 1.0],
            ],
        }
    }  # fmt: skip
    page = papers_page(summary)
    assert "| A | 2 | 0 | 1, 1 | 1 | 2.0 |" in page
    assert "**A.** Opened." in page
    assert (
        "of 4 comparable\nprinted errors ours equal 2, are smaller than 1 and larger than 1; 0 lies"
        " within 25 %." in readme_line(summary)
    )


def test_a_trend_follows_a_power_of_the_members_and_says_when_errors_fall():
    members = [50, 100, 200]
    errors = np.array(members) ** -0.5 * np.exp(0.01 * RNG.normal(size=(50, 3)))
    change = trend(members, errors)
    assert change.low < 100.0 * (4.0**-0.5 - 1.0) < change.high
    assert falls(change) == "true"
    assert falls(Interval(1.0, 0.5, 1.5)) == "false"
    assert falls(Interval(0.1, -0.5, 0.7)).startswith("undecided")


# --- templates ------------------------------------------------------------------------------------

TEXT = """# A paper

One line,
two lines of subtitle

The opening has {{ share }} %.

## Results

Prose.

- one
- two | three

@table errors: RMSE | in rad
Below.

@claims
A note.
- It holds | true, of ours | since 0.1 | 0.2

@facts: Settings
- step | 0.1 s
"""


def test_every_kind_of_block_comes_out_of_a_template_and_nothing_is_left_out_in_silence(
    tmp_path: Path,
):
    (tmp_path / "page.md").write_text(TEXT, encoding="utf-8")
    table = Table("", "", "", [], [], "errors")

    def fill(tables=("errors",), **values):
        return template.fill(tmp_path, dict.fromkeys(tables, table), **values)

    page, opening = fill(share="−1.2")
    assert opening == "The opening has −1.2 %."
    assert (page.title, page.subtitle) == ("A paper", "One line, two lines of subtitle")
    assert page.sections[0].blocks == [Prose(opening)]
    prose, bullets, shown, claims, facts = page.sections[1].blocks
    assert (prose, bullets) == (Prose("Prose."), Bullets(["one", "two | three"]))
    assert (shown.title, shown.note, shown.name) == ("RMSE | in rad", "Below.", "errors")
    assert claims == Claims([Claim("It holds", "true, of ours", "since 0.1 | 0.2")], "A note.")
    assert facts == Facts("Settings", [("step", "0.1 s")])
    with pytest.raises(jinja2.UndefinedError, match="share"):
        fill()
    with pytest.raises(KeyError, match="errors"):
        fill(tables=(), share="1")
