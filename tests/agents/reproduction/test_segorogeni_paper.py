"""The paper on Segorogeni: its dive, what the errors are made of, and a page on which no number is missing."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from agents.page import Claims, Facts, Page, render
from agents.reproduction import segorogeni
from agents.reproduction.pages import segorogeni as segorogeni_page
from agents.reproduction.settings import segorogeni as paper
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.segorogeni import STATE

PLACE = [STATE.index(name) for name in ("x", "y", "z", "psi")]


def made_up(exponent: float) -> dict[str, dict[str, Any]]:
    """Results of every cell whose errors go with the members to this power, give or take 1 %, which evens out."""
    rng = np.random.default_rng(0)
    example = {"time": np.linspace(0.0, 30.0, 50), "truth": rng.normal(size=(50, 4)), "estimate": np.zeros((50, 4))}
    results: dict[str, dict[str, Any]] = {}
    for name, cell in segorogeni.cells().items():
        if name == "time":
            results[name] = {"seconds": np.array(paper.MEMBERS) * rng.uniform(0.9, 1.1, (50, 1))}
            continue
        runs, members = cell.arguments["runs"], max(cell.arguments["members"], 1)
        scatter = rng.normal(scale=0.01, size=(runs // 2, 4))
        rmse = 1e-4 * members**exponent * np.exp(np.concatenate([scatter, -scatter]))
        results[name] = {"rmse": rmse, "final": np.abs(rng.normal(size=(runs, 3)))} | example
    return results


@cache
def page_of(exponent: float) -> Page:
    """The page of such results."""
    return segorogeni_page.page(made_up(exponent))


def claims(page: Page) -> dict[str, str]:
    """The verdict of every claim by its text."""
    blocks = [block for section in page.sections for block in section.blocks if isinstance(block, Claims)]
    return {claim.text: claim.kind for block in blocks for claim in block.rows}


# --- the experiment -----------------------------------------------------------------------------------


def test_the_table_is_the_papers():
    assert sum(len(row) for row in paper.PUBLISHED.values()) == 20
    assert len(paper.FINAL) == 3
    assert paper.PUBLISHED[200]["z"].value == 0.0814
    assert paper.PUBLISHED[300]["time"].value == 18.15


@pytest.mark.slow
@pytest.mark.parametrize(("scheme", "tolerance"), [("own", 1e-6), ("printed", 0.01)])
def test_the_undisturbed_dive_goes_from_rest_to_the_papers_goal(scheme: str, tolerance: float):
    dive = segorogeni.dive(scheme)
    state = np.zeros(len(STATE))
    for control in dive.controls:
        state = dive.advance(state, control)
    np.testing.assert_allclose(state[PLACE[:3]], paper.GOAL, atol=tolerance)


def test_without_ballast_the_printed_kinematics_sink_too_slowly():
    body = replace(load("segorogeni"), printed_kinematics=True)
    control = np.array([0.0, -body.fin_limit, body.thrust_limit] * 2)
    state = np.zeros(len(STATE))
    for _ in range(300):
        state = paper.VEHICLE.moved(state, *np.split(control, 2, -1), np.zeros(2), body.vector())
    assert round(state[STATE.index("w")], 2) == 0.16
    assert paper.DURATION * state[STATE.index("w")] < paper.GOAL[2]


def test_the_rudder_starts_at_the_printed_angle():
    for scheme in ("own", "printed"):
        assert segorogeni.dive(scheme).controls[0, 0] == pytest.approx(np.deg2rad(5.0))


def test_both_steps_have_the_same_white_noise():
    own, printed = (segorogeni.dive(scheme) for scheme in ("own", "printed"))
    np.testing.assert_allclose(own.kick_sd**2 / paper.OWN_DT, printed.kick_sd**2 / paper.DT)
    np.testing.assert_allclose(own.reading_sd**2 * paper.OWN_DT, printed.reading_sd**2 * paper.DT)
    assert len(own.controls) * paper.OWN_DT == pytest.approx(len(printed.controls) * paper.DT)


def test_true_velocities_integrate_to_the_true_position():
    dive = segorogeni.dive("own")
    truth = dive.fly(3, np.random.default_rng(0)).truth
    places = segorogeni.positions(dive, truth[..., dive.estimated])
    np.testing.assert_allclose(places, truth[..., PLACE], atol=1e-9)


def test_the_paper_measures_surge_sway_heave_and_yaw():
    dive = segorogeni.dive("own")
    assert [STATE[dive.estimated[i]] for i in dive.measured] == ["u", "v", "w", "r"]


def test_the_same_seed_gives_the_same_errors_and_another_one_others():
    first, second, other = (segorogeni.estimate("own", 10, 3, seed) for seed in (0, 0, 1))
    for name, values in first.items():
        np.testing.assert_array_equal(values, second[name])
    assert not np.allclose(first["rmse"], other["rmse"])


def test_sizes_and_filters_see_the_same_dives():
    small, large, exact = (
        segorogeni.estimate("own", members, 2, 0, estimator=estimator)
        for members, estimator in ((10, "enkf"), (20, "enkf"), (0, "ekf"))
    )
    np.testing.assert_array_equal(small["truth"], large["truth"])
    np.testing.assert_array_equal(small["truth"], exact["truth"])
    assert not np.array_equal(small["estimate"], large["estimate"])


# --- the page -----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_every_published_number_stands_on_the_page_with_a_verdict():
    errors, times = (table.rows()[1:] for table in page_of(0.0).tables[:2])
    verdicts = ("at or below", "above: ", "not comparable: ")
    assert all(row[-1].startswith(verdicts) for row in errors + times)
    printed = [row[name].printed for row in paper.PUBLISHED.values() for name in paper.QUANTITIES]
    assert [row[2] for row in errors] == printed + [published.printed for published in paper.FINAL.values()]
    assert [row[2] for row in times] == [row["time"].printed for row in paper.PUBLISHED.values()]
    assert len(errors + times) == 23


@pytest.mark.slow
def test_what_is_measured_in_seconds_stands_in_a_table_of_its_own():
    slower = made_up(0.0)
    slower["time"] = {"seconds": 2.0 * slower["time"]["seconds"]}
    for one, other in zip(page_of(0.0).tables, segorogeni_page.page(slower).tables, strict=True):
        assert (one == other) == (one.name != "time")


@pytest.mark.slow
@pytest.mark.parametrize(("exponent", "verdict"), [(-0.5, "true"), (0.5, "false"), (0.0, "undecided")])
def test_the_claim_on_members_is_decided_by_the_errors(exponent: float, verdict: str):
    found = claims(page_of(exponent))
    assert found["More members reduce the error."] == verdict
    assert found["More members cost more time."] == "true"


@pytest.mark.slow
def test_the_page_is_one_file_with_its_assumptions():
    html = render(page_of(0.0))
    assert html.count("data:image/svg+xml") == 2
    (assumed,) = (facts for section in page_of(0.0).sections for facts in section.blocks if isinstance(facts, Facts))
    assert len(assumed.rows) == 8
    assert all(name in html and text for name, text in assumed.rows)
    assert "2 negative eigenvalues of 6" in html
