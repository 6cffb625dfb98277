"""The PUNA paper's reproduction: strings and paths, flights and their estimates, and what the page says of them."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from agents.page import Claims, Page, Table, render
from agents.reproduction import puna
from agents.reproduction.comparison import tally
from agents.reproduction.pages import puna as puna_page
from agents.reproduction.pages import puna_results
from agents.reproduction.pages.comparison import geometric_ratio
from agents.reproduction.settings import puna as paper
from agents.statistics import Interval
from vessel_gym.guidance.dubins import approach

pytestmark = pytest.mark.slow  # its pages come from the whole experiment

RUNS = 6


def computed(runs: int = RUNS) -> dict[str, dict[str, Any]]:
    """Every cell with fewer runs."""
    found = {}
    for name, cell in puna.cells().items():
        fewer = {key: value for key, value in (("runs", runs), ("repetitions", 2)) if key in cell.arguments}
        found[name] = replace(cell, arguments=cell.arguments | fewer).compute()
    return found


@pytest.fixture(scope="module")
def results() -> dict[str, dict[str, Any]]:
    return computed()


@pytest.fixture(scope="module")
def page(results: dict[str, dict[str, Any]]) -> Page:
    return puna_page.page(results)


def claims(page: Page) -> dict[str, str]:
    """Verdicts by statement."""
    return {
        row.text: row.verdict
        for section in page.sections
        for block in section.blocks
        if isinstance(block, Claims)
        for row in block.rows
    }


def table(page: Page, name: str) -> Table:
    return next(found for found in page.tables if found.name == name)


# --- paths ------------------------------------------------------------------------------------------


def test_a_taut_string_touches_the_obstacle_ends_at_the_goal_and_has_the_length_of_geometry():
    way, radius = 100.0, 30.0
    for turn in "LR":
        path = puna.string((-way, 0.0), (way, 0.0), (0.0, 0.0, radius), turn)
        assert path.word == f"S{turn}S"
        assert path.length == pytest.approx(2.0 * np.sqrt(way**2 - radius**2) + 2.0 * radius * np.arcsin(radius / way))
        assert approach(path, np.zeros((1, 2)))[0] == pytest.approx(radius)
        np.testing.assert_allclose(path.pose(path.length)[:2], [way, 0.0], atol=1e-9)
        assert np.sign(path.pose(0.5 * path.length)[1]) == {"L": -1.0, "R": 1.0}[turn]  # L passes with it on the left


def test_the_printed_points_of_the_obstacle_case_are_tangent_points_to_their_last_digit():
    found = puna.obstacle_case()
    printed = [paper.OBSTRUCTED.start, paper.OBSTRUCTED.goal]
    np.testing.assert_allclose(found["tangent points"], printed, rtol=0.0, atol=paper.PRINT)
    assert found["word"] == "RSL"
    assert found["clearance"] < paper.OBSTRUCTED.obstacle[2]  # the straight leads through the obstacle
    assert found["strings"]["SLS"] < found["strings"]["SRS"]
    assert found["strings"]["SLS"] > np.hypot(*np.subtract(*printed))
    assert found["detour"] > found["length"]


def test_the_figure_s_word_is_the_shortest_only_where_headings_count_from_the_x_axis():
    found = puna.open_case()
    best = {reading: min(words, key=words.get) for reading, words in found["lengths"].items()}
    assert [reading for reading, word in best.items() if word == paper.OPEN.word] == ["from the x axis"]
    assert found["final y"] == pytest.approx(paper.OPEN.goal[1])
    rsl = found["lengths"]["from the y axis, clockwise"]["RSL"]
    assert found["least RSL"]["length"] < rsl  # at another y than the printed one


def test_a_bank_turns_in_the_radius_that_it_is_for():
    inwards = puna.PLANE.body.gravity * np.tan(puna.bank(30.0))
    assert inwards == pytest.approx(paper.SPEED**2 / 30.0)


# --- estimation -------------------------------------------------------------------------------------


def test_without_noise_flights_follow_the_model_and_readings_are_the_truth():
    u = puna.controls("varying")
    truth, readings = puna.flights(u, np.zeros(4), np.zeros(4), 2, 0)
    np.testing.assert_array_equal(readings, truth)
    state = np.array(paper.START)
    for control, expected in zip(u, truth, strict=True):
        state = puna.PLANE.step(state, control)
        np.testing.assert_allclose(expected, np.tile(state, (2, 1)), rtol=1e-12)


@pytest.mark.slow
def test_every_size_and_both_sets_of_measurements_see_the_same_flights(results):
    for level in paper.LEVELS:
        for control in paper.CONTROLS:
            every, alone = (results[f"{level}, {control}, {measured}"] for measured in paper.MEASURED)
            np.testing.assert_array_equal(every["truth"], alone["truth"])
            np.testing.assert_array_equal(every["slowest"], alone["slowest"])
            assert every["rmse"].shape == (len(paper.MEMBERS), RUNS, 4)
            assert (every["rmse"] != alone["rmse"]).all()


def test_the_same_seed_gives_the_same_errors_and_another_seed_others():
    case = {"level": "flight", "control": "varying", "measured": "x", "members": [50], "runs": 2}
    first = puna.estimate(**case, seed=1)["rmse"]
    np.testing.assert_array_equal(puna.estimate(**case, seed=1)["rmse"], first)
    assert (puna.estimate(**case, seed=2)["rmse"] != first).all()


def test_scaling_q_and_r_together_scales_errors_by_the_root():
    case = {"level": "flight", "scales": [[1.0, 1.0], [1e-4, 1e-4]], "members": 50, "runs": 2, "seed": 0}
    whole, small = puna.scaled(**case)["rmse"]
    np.testing.assert_allclose(small, 0.01 * whole, rtol=0.05)  # but for what is not linear


@pytest.mark.parametrize("level", paper.LEVELS)
@pytest.mark.parametrize("factor", [0.01, 3.0])
def test_a_partner_leaves_the_variance_of_a_random_walk_as_it_is(level, factor):
    q_factor, r_factor = puna.partner(level, factor)
    chosen, variances = paper.LEVELS[level], []
    for q, r in ((1.0, 1.0), (q_factor, r_factor)):
        variance = 1.0
        for _ in range(5000):
            ahead = variance + q * chosen.process
            variance = ahead * r * chosen.reading / (ahead + r * chosen.reading)
        variances.append(variance)
    assert variances[0] == pytest.approx(variances[1])


def test_the_ratio_of_paired_errors_is_known_without_an_interval_where_all_pairs_agree():
    errors = np.random.default_rng(0).uniform(1.0, 2.0, 9)
    found = geometric_ratio(3.0 * errors, errors)
    assert (found.low, found.mean, found.high) == pytest.approx((3.0, 3.0, 3.0))


# --- the page ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_every_printed_error_stands_beside_ours_with_a_verdict_at_both_levels_and_for_both_sets(results, page):
    for level in paper.LEVELS:
        found = puna_results.comparisons(results, level)
        assert len(found) == 16
        rows = [entries for _, section in table(page, f"errors-{level}").sections for _, entries in section]
        assert len(rows) == 16
        for comparison, (printed, ours, unit, verdict) in zip(found, rows, strict=True):
            assert printed.value.startswith(comparison.published.printed)
            assert (unit.value, verdict.value) == (comparison.published.unit, comparison.verdict)
            assert ours.half
    assert "18291 (meant: 1.8291)" in render(page)


def test_every_printed_point_stands_beside_the_tangent_point(page):
    rows = [entries for _, section in table(page, "points").sections for _, entries in section]
    printed = np.ravel([paper.OBSTRUCTED.start, paper.OBSTRUCTED.goal])
    assert [float(row[0].value.replace("−", "-")) for row in rows] == list(printed)


def test_every_claim_has_a_verdict_and_each_state_its_own(page):
    found = claims(page)
    assert len(found) == 10
    assert all(verdict.split(",")[0] in ("true", "false", "undecided") for verdict in found.values())
    assert sum(text.startswith("Measuring every state") for text in found) == len(paper.STATES)
    assert found["The path with an obstacle, SRS, is optimal"] == "false"


@pytest.mark.parametrize(
    ("factors", "verdict"),
    [
        ((0.5, 1.0, 1.0, 1.0, 1.0), "false, 50 are better"),
        ((2.0, 2.0, 2.0, 1.0, 2.0), "true"),
        ((2.0, 2.0, 2.0, 1.0, 1.0), "undecided, no detectable difference from 400"),
    ],
)
def test_the_best_size_is_what_the_errors_say(results, factors, verdict):
    name = "flight, constant, all"
    noise = np.random.default_rng(3).normal(1.0, 1e-3, (len(paper.MEMBERS), RUNS, 4))
    made = results | {name: results[name] | {"rmse": np.array(factors)[:, None, None] * noise}}
    assert puna_page._best_claim(made, "constant").verdict == verdict


def test_much_better_is_said_only_of_much():
    low, high = Interval(1.1, 1.05, 1.15), Interval(2.0, 1.9, 2.1)
    assert puna_page._gain_verdict([high, high]) == "true"
    assert puna_page._gain_verdict([low, high]).startswith("true, but not much")
    assert puna_page._gain_verdict([Interval(1.0, 0.9, 1.1), high]).startswith("undecided")
    assert puna_page._gain_verdict([Interval(0.8, 0.7, 0.9), high]) == "false"


def test_the_answer_has_the_tally_of_either_noise(results, page):
    (line,) = (line for line in page.answer if line.startswith("The eight printed errors"))
    for level in paper.LEVELS:
        assert tally(puna_results.comparisons(results, level)) in line
