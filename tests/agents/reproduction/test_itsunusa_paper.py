"""The paper on ITSUNUSA: its dive, both forms of the update, and a page on which no number is missing."""

from functools import cache
from typing import Any

import numpy as np
import pytest

from agents.page import Claims, Facts, Page, render
from agents.reproduction import itsunusa
from agents.reproduction.pages import itsunusa as itsunusa_page
from agents.reproduction.settings import itsunusa as paper
from vessel_gym.vehicles.itsunusa import STATE

DEPTH = STATE.index("z")


def made_up(exponent: float) -> dict[str, dict[str, Any]]:
    """Results of every cell whose errors go with the members to this power, give or take 1 %."""
    rng = np.random.default_rng(0)
    example = {"time": np.linspace(0.0, 45.0, 50), "truth": rng.normal(size=(50, 4)), "estimate": np.zeros((50, 4))}
    results: dict[str, dict[str, Any]] = {}
    for name, cell in itsunusa.cells().items():
        if name.startswith("time"):
            results[name] = {"seconds": np.array(paper.MEMBERS) * rng.uniform(0.9, 1.1, (50, 1))}
            continue
        relative = np.exp(rng.normal(scale=0.01, size=(cell.arguments["runs"], 4)))
        results[name] = {"rmse": 1e-4 * cell.arguments["members"] ** exponent * relative} | example
    return results


@cache
def page_of(exponent: float) -> Page:
    """The page of such results."""
    return itsunusa_page.page(made_up(exponent))


def claims(page: Page) -> dict[str, str]:
    """The verdict of every claim by its text."""
    blocks = [block for section in page.sections for block in section.blocks if isinstance(block, Claims)]
    return {claim.text: claim.kind for block in blocks for claim in block.rows}


# --- the experiment -----------------------------------------------------------------------------------


def test_the_table_is_the_papers():
    assert sum(len(row) for row in paper.PUBLISHED.values()) == 15
    assert paper.PUBLISHED[300]["heave"].value == 0.01872
    assert paper.PUBLISHED[400]["time"].value == 7.1569
    assert paper.RELATIVE.value == pytest.approx(100.0 * paper.POSITION.value / paper.DEPTH)


@pytest.mark.slow
def test_the_undisturbed_dive_goes_from_rest_to_20_m():
    dive = itsunusa.dive()
    assert dive.controls[0, 0] == 0.0
    assert dive.controls[0, 1] == 0.0
    state = dive.start
    for control in dive.controls:
        state = dive.advance(state, control)
    np.testing.assert_allclose(state[[STATE.index("x"), DEPTH]], [60.0, 20.0], atol=0.2)


def test_the_vehicle_weighs_what_the_assumptions_say():
    body = paper.VEHICLE.body
    assert round(body.mass) == 96
    assert body.buoyancy_excess == 6.0


@pytest.mark.slow
def test_true_motions_integrate_to_the_true_depth():
    dive = itsunusa.dive()
    truth = dive.fly(3, np.random.default_rng(0)).truth
    np.testing.assert_allclose(itsunusa.depths(dive, truth[..., dive.estimated]), truth[..., DEPTH], atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("variant", [*paper.VARIANTS, "ekf"])
def test_the_same_seed_gives_the_same_errors(variant: str):
    first, second = (itsunusa.estimate(variant, 20, 2, 0) for _ in range(2))
    for name, values in first.items():
        np.testing.assert_array_equal(values, second[name])


@pytest.mark.slow
def test_all_filters_see_the_same_dives_also_with_an_inclinometer():
    truths = [itsunusa.estimate(variant, 10, 2, 0)["truth"] for variant in (*paper.VARIANTS, "ekf")]
    truths.append(itsunusa.estimate("symmetric", 10, 2, 0, inclinometer=True)["truth"])
    for truth in truths[1:]:
        np.testing.assert_array_equal(truth, truths[0])


@pytest.mark.slow
def test_depth_is_far_better_known_where_pitch_is_measured():
    without, measured = (itsunusa.estimate("ekf", 0, 10, 0, inclinometer=told)["rmse"] for told in (False, True))
    assert measured[:, 3].mean() < 0.3 * without[:, 3].mean()


def test_twice_the_noise_makes_twice_the_error_of_the_motions():
    once, twice = (itsunusa.estimate("ekf", 0, 10, 0, noise=noise)["rmse"] for noise in (1.0, 2.0))
    np.testing.assert_allclose(twice[:, :3].mean(0) / once[:, :3].mean(0), 2.0, rtol=0.02)


# --- the page -----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_every_published_number_stands_in_the_table_of_each_form_with_a_verdict():
    *tables, times = page_of(0.0).tables[: len(paper.VARIANTS) + 1]
    for table in tables:
        rows = table.rows()[1:]
        assert [row[2] for row in rows] == [
            row[q].printed for row in paper.PUBLISHED.values() for q in paper.QUANTITIES
        ]
        assert all(row[-1].startswith(("at or below", "above: ", "not comparable: ")) for row in rows)
    printed = [row["time"].printed for row in paper.PUBLISHED.values()]
    assert sorted(row[2] for row in times.rows()[1:]) == sorted(printed * len(paper.VARIANTS))
    assert times.name == "time"


@pytest.mark.slow
@pytest.mark.parametrize(("exponent", "verdict"), [(-0.9, "true"), (0.2, "false"), (0.0, "undecided")])
def test_the_claim_on_members_is_decided_by_the_errors(exponent: float, verdict: str):
    found = claims(page_of(exponent))
    for form in itsunusa_page.FORMS.values():
        assert found[f"More members reduce the error ({form})."] == verdict
        assert found[f"More members cost more time ({form})."] == "true"


@pytest.mark.slow
def test_the_printed_falls_stand_where_ours_are_as_steep():
    steep = next(kind for text, kind in claims(page_of(-0.9)).items() if "a quarter to a half" in text)
    flat = next(kind for text, kind in claims(page_of(0.0)).items() if "a quarter to a half" in text)
    assert (steep, flat) == ("undecided", "false")


@pytest.mark.slow
def test_the_misprinted_percentage_is_called_one():
    found = claims(page_of(0.0))
    assert found["The error of the position, 0.03 m of 20 m, is 0.0015 %."] == "false"


@pytest.mark.slow
def test_the_page_is_one_file_with_its_assumptions():
    html = render(page_of(0.0))
    assert html.count("data:image/svg+xml") == 2
    (assumed,) = (facts for section in page_of(0.0).sections for facts in section.blocks if isinstance(facts, Facts))
    assert len(assumed.rows) == 9
    assert all(name in html and text for name, text in assumed.rows)
    assert any(text.startswith("Coefficients") and "96 kg" in text for _, text in assumed.rows)
