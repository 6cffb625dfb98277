"""Printed numbers beside ours: every one gets a verdict, and a worse one a reason."""

import pytest

from agents.reproduction.comparison import Comparison, Published, tally
from agents.reproduction.pages.comparison import comparison_table
from agents.statistics import Interval

PRINTED = Published("0.0047", "rad", "Table 4.9")
BELOW, ABOVE = Interval(0.0040, 0.0039, 0.0041), Interval(0.0050, 0.0046, 0.0054)


def test_our_mean_decides_the_verdict():
    assert Comparison("I", "psi", PRINTED, BELOW).verdict == "at or below"
    assert Comparison("I", "psi", PRINTED, Interval(0.0047, 0.004, 0.005)).verdict == "at or below"
    assert Comparison("I", "psi", PRINTED, ABOVE, above="more noise").verdict == "above: more noise"
    assert (
        Comparison("I", "s", PRINTED, BELOW, incomparable="another machine").verdict
        == "not comparable: another machine"
    )


def test_what_is_above_needs_a_reason_and_so_does_what_is_missing():
    with pytest.raises(ValueError, match="say why"):
        Comparison("I", "psi", PRINTED, ABOVE)
    with pytest.raises(ValueError, match="why there is none"):
        Comparison("I", "psi", PRINTED, None)


def test_a_misprinted_number_is_shown_as_printed_and_compared_as_meant():
    speed = Published("18291", "m/s", "page 5", meant=1.8291)
    table = comparison_table("t", "", [Comparison("varying", "v", speed, Interval(1.8, 1.7, 1.9))])
    (_, ((name, entries),)), = table.sections  # fmt: skip
    assert name == "v"
    assert entries[0].value == "18291 (meant: 1.8291)"
    assert entries[-1].value == "at or below"


def test_every_comparison_is_in_the_table_under_its_row_and_in_the_tally():
    comparisons = [
        Comparison("I", "psi", PRINTED, BELOW),
        Comparison("I", "d", PRINTED, ABOVE, above="noise"),
        Comparison("II", "time", PRINTED, None, incomparable="another machine"),
    ]
    table = comparison_table("t", "", comparisons)
    assert [(title, [name for name, _ in rows]) for title, rows in table.sections] == [
        ("I", ["psi", "d"]),
        ("II", ["time"]),
    ]
    assert tally(comparisons) == "1 of 3 numbers at or below the published one, 1 above, 1 not comparable"
