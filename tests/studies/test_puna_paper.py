"""The paper on the PUNA: its two paths, and its filter's flights."""

import numpy as np
import pytest

from studies.papers import settings
from studies.papers.puna import experiment as puna
from vessel_gym.guidance.dubins import approach

S = settings("puna")
PATHS = S["paths"]
FLIGHT = {"process": [3e-5, 0.09, 9e-4, 9e-4], "measurement": [1.5e-3, 4.5, 0.045, 0.045], "steps": 40, "swing": 2.0,
          "period": 1.0}  # fmt: skip


def test_a_taut_string_touches_the_obstacle_ends_at_the_goal_and_has_the_length_of_geometry():
    way, radius = 100.0, 30.0
    for turn in "LR":
        path = puna.string((-way, 0.0), (way, 0.0), (0.0, 0.0, radius), turn)
        assert path.length == pytest.approx(
            2.0 * np.sqrt(way**2 - radius**2) + 2.0 * radius * np.arcsin(radius / way)
        )
        assert approach(path, np.zeros((1, 2)))[0] == pytest.approx(radius)
        np.testing.assert_allclose(path.pose(path.length)[:2], [way, 0.0], atol=1e-9)
        assert (
            np.sign(path.pose(0.5 * path.length)[1]) == {"L": -1.0, "R": 1.0}[turn]
        )  # L passes with it on the left


@pytest.mark.slow
def test_the_printed_points_of_the_obstacle_case_are_tangent_points_to_their_last_digit():
    found = puna.obstacle_case(PATHS)
    printed = [PATHS["obstructed"][end] for end in ("start", "goal")]
    np.testing.assert_allclose(found["tangent points"], printed, rtol=0.0, atol=5e-5)
    assert found["word"] == "RSL"
    assert found["clearance"] < PATHS["obstacle"][2]  # the straight leads through the obstacle
    assert found["strings"]["SRS"] > found["strings"]["SLS"] > np.hypot(*np.subtract(*printed))
    assert found["detour"] > found["length"]


def test_the_figure_s_word_is_the_shortest_only_where_headings_count_from_the_x_axis():
    found = puna.open_case(PATHS)
    best = {
        interpretation: min(words, key=words.get)
        for interpretation, words in found["lengths"].items()
    }
    assert [
        interpretation for interpretation, word in best.items() if word == PATHS["open"]["word"]
    ] == ["from the x axis"]
    assert found["final y"] == pytest.approx(PATHS["open"]["goal"][1])
    assert found["least RSL"]["length"] < found["lengths"]["from the y axis, clockwise"]["RSL"]
    assert puna.PLANE.body.gravity * np.tan(np.deg2rad(puna.bank(20.0, 30.0))) == pytest.approx(
        20.0**2 / 30.0
    )


def test_without_noise_flights_follow_the_model_and_measurements_are_the_truth():
    u = puna.controls("varying", 40, 2.0, 1.0)
    truth, measurements = puna.flights(u, np.zeros(4), np.zeros(4), 2, 0)
    np.testing.assert_array_equal(measurements, truth)
    state = puna.START
    for control, expected in zip(u, truth, strict=True):
        state = puna.PLANE.step(state, control)
        np.testing.assert_allclose(expected, np.tile(state, (2, 1)), rtol=1e-12)


def test_scaling_q_and_r_together_scales_errors_by_the_root():
    case = FLIGHT | {
        "control": "constant",
        "measured": "all",
        "members": [50],
        "runs": 2,
        "seed": 0,
    }
    quiet = {key: [1e-4 * value for value in FLIGHT[key]] for key in ("process", "measurement")}
    whole, small = (puna.estimate(**case | noise)["rmse"] for noise in ({}, quiet))
    np.testing.assert_allclose(small, 0.01 * whole, rtol=0.05)  # but for what is not linear
