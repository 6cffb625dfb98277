"""The paper on the PUNA: its two paths, and its filter's flights."""

import numpy as np
import pytest

from agents.papers import settings
from agents.papers.puna import experiment as puna

S = settings("puna")
PATHS = S["paths"]


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_taut_string_has_the_length_and_headings_of_geometry(side: float):
    path = puna.taut_string((-100.0, 0.0), (100.0, 0.0), (0.0, 0.0, 30.0), side)
    angle = np.arcsin(0.3)
    assert path.length == pytest.approx(2.0 * np.sqrt(100.0**2 - 30.0**2) + 60.0 * angle)
    # a string that turns left passes with the obstacle on its left
    ends = [-100.0, 0.0, -side * angle], [100.0, 0.0, side * angle]
    np.testing.assert_allclose(path.pose(np.array([0.0, path.length])), ends, atol=1e-9)


def test_words_of_figures_are_shortest_where_the_page_says():
    best = {name: min(of, key=of.get) for name, of in puna.open_case(PATHS).items()}
    assert [name for name, word in best.items() if word == "RSR"] == ["from the x axis"]
    _, _, whole, detour, *_ = puna.obstructed_case(PATHS).values()
    # the straight leads through the obstacle, our plan round it
    assert whole[1] < PATHS["obstacle"][2] == pytest.approx(detour[1])
    assert whole[0] < detour[0]


def test_strings_round_the_obstacle_have_the_lengths_of_errata():
    (srs, *_), (sls, *_), *_ = puna.obstructed_case(PATHS).values()
    assert (srs, sls) == pytest.approx((410.667, 404.963), abs=5e-4)


def test_errors_scale_with_the_root_of_q_and_r():
    few = S | {"steps": 100, "levels": S["levels"] | {"small": [3e-6, 1.5e-4]}}
    whole, small, alone = (
        puna.rms_errors(puna.flight(few, level, "varying"), puna.MEASURED[seen], 50, 4, 0)
        for level, seen in (("flight", "all"), ("small", "all"), ("flight", "x"))
    )
    np.testing.assert_allclose(small, 0.01 * whole, rtol=0.1)  # but for what is not linear
    assert (alone.mean(0) > whole.mean(0)).all()
