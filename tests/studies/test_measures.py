"""Measures of closeness of printed numbers and ours."""

import numpy as np
import pytest

from studies.papers.measures import (
    Comparison,
    Report,
    comparison_table,
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
    speed = comparison("18291", 1.8291, 1e-9, meant="1.8291")
    assert speed.verdict == "agrees"
    assert speed.ratio == pytest.approx(1.0)
    circular = comparison("0.0006", 0.0006, 1e-9, reason="taken from it")
    assert circular.verdict == "not comparable"
    table = comparison_table({"ours": [circular, speed]})
    (*_, where, ours, ratio, verdict), (*_, meant, _, _, _, _) = table[1:]
    assert (where, ours, ratio) == ("12", "0.00060 ± 0.00000", "1.00")
    assert verdict == "not comparable: taken from it"
    assert meant == "18291 (1.8291 meant) rad"
    page = Report({"one": table}, []).page("a\n\n<!-- table: one -->\n\nb")
    assert page.count("\n| I | psi | ") == 2


def test_an_experiment_is_a_row_and_its_typical_factor_the_mean_log_ratio_of_what_compares():
    found = [
        comparison("1.0", 2.0, 1e-9),
        comparison("1.0", 0.5, 1e-9),
        comparison("1.0", 9.0, 1e-9, reason="no"),
    ]
    assert row("p", "I", found) == ("p", "I", 3, 0, 1, 1, 1, 0, pytest.approx(2.0))
    assert rows("p", found) == [row("p", "I", found)]
    assert row("p", "I", found[2:]).factor == 0.0


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


def test_a_trend_follows_a_power_of_the_members():
    members = [50, 100, 200]
    errors = np.array(members) ** -0.5 * np.exp(0.001 * RNG.normal(size=(50, 3)))
    mean, low, high = map(
        float, trend(members, errors).replace("[", "").strip("]").replace(",", "").split()
    )
    assert low <= mean <= high
    assert mean == pytest.approx(100.0 * (4.0**-0.5 - 1.0), abs=0.1)
