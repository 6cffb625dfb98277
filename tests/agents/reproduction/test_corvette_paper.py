from html import unescape

import numpy as np
import pytest

from agents.page import Claims, Page, render
from agents.reproduction import corvette
from agents.reproduction.pages import corvette as corvette_page
from agents.reproduction.settings import corvette as settings
from agents.reproduction.settings.corvette import QUANTITIES, SAMPLES, SIMULATIONS

pytestmark = pytest.mark.slow  # its pages come from the whole experiment

RUNS = 20


@pytest.fixture(scope="module")
def results() -> dict:
    return {name: cell.compute() for name, cell in corvette.cells(RUNS).items()}


@pytest.fixture(scope="module")
def page(results) -> Page:
    return corvette_page.page(results)


@pytest.mark.parametrize("simulation", SIMULATIONS)
@pytest.mark.parametrize("quantity", QUANTITIES)
def test_a_published_mean_is_that_of_its_three_runs(simulation: str, quantity: str):
    *runs, mean = (published.value for published in SIMULATIONS[simulation].published(quantity).values())
    assert np.mean(runs) == pytest.approx(mean, abs=0.00005 + 1e-9)


def test_every_published_number_stands_in_the_page_with_a_verdict(page):
    (table,) = (table for table in page.tables if table.name == "published")
    lines = {
        (title, name): [str(entry) for entry in entries] for title, rows in table.sections for name, entries in rows
    }
    assert len(lines) == 40
    for simulation, s in SIMULATIONS.items():
        for quantity in QUANTITIES:
            for column, published in s.published(quantity).items():
                printed, ours, unit, verdict = lines[f"Simulation {simulation}, {quantity} ({s.where})", column]
                mean = float(ours.split(" ± ")[0])
                assert (printed, unit) == (published.printed, "rad")
                assert verdict.startswith("at or below" if mean <= published.value else "above: ")


def test_the_page_renders_and_decides_every_claim(page):
    text = unescape(render(page))
    claims = [claim for section in page.sections for b in section.blocks if isinstance(b, Claims) for claim in b.rows]
    assert len(claims) == 15
    assert all(claim.kind in ("true", "false", "undecided") and claim.evidence for claim in claims)
    assert all(table.title in text for table in page.tables)


def test_the_record_is_a_full_turn_within_the_thesis_plots():
    heading, u = corvette.turning_record()
    assert heading.shape == (SAMPLES,)
    assert u.shape == (SAMPLES, 2)
    assert heading[0] == 0.0
    assert (np.diff(heading)[1:] > 0.0).all()
    assert 2.0 * np.pi < heading[-1] < 7.0
    reached = np.argmin(u[:, 0] < np.deg2rad(settings.HELM))
    assert reached == np.ceil(settings.HELM / 5.0 / settings.STEP)  # at 5 deg/s


@pytest.mark.parametrize("model", corvette.MODELS)
@pytest.mark.parametrize("simulation", SIMULATIONS)
def test_the_errors_of_heading_and_unknown_input_add_up_to_the_noise(simulation: str, model: str):
    """The law that the page holds against the printed pairs."""
    heading, u = corvette.turning_record()
    noise = 0.01 * np.random.default_rng(1).standard_normal((3, SAMPLES, 2))
    believed = corvette.filter_model(SIMULATIONS[simulation], model)
    errors = corvette.estimate(believed, heading, corvette.unknown_input(0.05), u, noise)
    heading_error, input_error, _ = errors
    np.testing.assert_allclose(heading_error + 2.0 * input_error, noise.sum(-1), rtol=0, atol=1e-12)
    level = corvette.rms(noise.sum(-1)) / np.sqrt(2.0)
    low, high = np.transpose(
        [corvette_page.allowed_noise(*pair) for pair in zip(*map(corvette.rms, errors[:2]), strict=True)]
    )
    assert ((low <= level) & (level <= high)).all()


def test_the_printed_headings_of_I_and_V_are_nearer_the_prediction_than_the_estimate(results):
    low = f"{settings.NOISE:.4f}"
    for simulation, share in (("I", 0.95), ("V", 0.7)):
        found = results[f"{simulation}, as-printed"]
        for errors in (found["rmse"][low], found["wide"]):
            after, _, before = np.mean(errors, axis=-1) / float(SIMULATIONS[simulation].mean_heading)
            assert after < 0.45
            assert share < before < 1.0


def test_the_d_of_II_errs_by_the_noise_of_the_readings(results):
    errors = np.asarray(results["II, as-printed"]["rmse"][f"{settings.NOISE:.4f}"])[1]
    assert errors.mean() == pytest.approx(settings.NOISE, rel=4.0 / np.sqrt(2.0 * RUNS * SAMPLES))  # 4 standard errors


@pytest.mark.parametrize("prior", [1e-3, 1.0])
@pytest.mark.parametrize("simulation", ["I", "III"])
def test_of_a_wrong_first_heading_the_second_prediction_keeps_a_share_that_the_page_states(simulation: str, prior):
    s = SIMULATIONS[simulation]
    believed, heading, noise = corvette.filter_model(s, "as-printed"), np.zeros(2), np.zeros((1, 2, 2))
    u, wrong = np.zeros((2, 2)), 0.05
    *_, predicted = corvette.estimate(believed, heading + wrong, np.zeros(2), u, noise, prior)
    assert predicted[0, 0] == pytest.approx(-wrong)
    assert predicted[0, 1] == pytest.approx(-wrong * corvette_page.left_of_start(s.R, prior))


def test_an_unknown_input_that_drives_the_heading_leaves_the_errors_as_they_are(results):
    small, large = (np.array(results[f"{name}, as-printed"]["driven"]) for name in ("I", "V"))
    np.testing.assert_allclose(large, small, rtol=0, atol=1e-10)


def test_what_an_unknown_input_in_the_readings_alone_adds_is_proportional_to_it(results):
    small, large = (np.array(results[f"{name}, as-printed"]["quiet"]["d"]) for name in ("I", "V"))
    np.testing.assert_allclose(large, settings.LARGER_SIZE / settings.SIZE * small, rtol=1e-9)


def test_the_settled_filter_depends_on_the_ratio_of_Q_and_R_only():
    errors = []
    heading, u = corvette.turning_record()
    noise = 1e-3 * np.random.default_rng(2).standard_normal((1, SAMPLES, 2))
    for simulation in ("I", "IV"):
        believed = corvette.filter_model(SIMULATIONS[simulation], "as-printed")
        errors.append(corvette.estimate(believed, heading, corvette.unknown_input(0.01), u, noise))
    difference = np.abs(np.subtract(*errors))
    assert difference[:, :, :5].max() > 1e-4  # the start differs, as P0 is the same
    assert difference[:, :, 100:].max() < 1e-7


@pytest.mark.parametrize("model", corvette.MODELS)
def test_a_filter_told_the_truth_errs_by_its_bound(model: str):
    """Readings of a system with the stated Q and R: the bound is not just a number of the filter's own."""
    believed = corvette.filter_model(SIMULATIONS["I"], model)
    u = corvette.turning_record()[1][-1]
    rng = np.random.default_rng(3)
    runs, settled = 400, 60
    x, headings = np.zeros((runs, 3)), []
    for _ in range(settled):
        headings.append(x[:, 2])
        x = believed.transition(x, u) + settings.SMALL**0.5 * rng.standard_normal((runs, 3))
    noise = settings.SMALL**0.5 * rng.standard_normal((runs, settled, 2))
    errors = corvette.estimate(believed, np.transpose(headings), np.zeros(settled), np.tile(u, (settled, 1)), noise)
    found = np.std(errors[:2, :, -1], axis=-1)
    np.testing.assert_allclose(found, corvette.bound(believed, u), rtol=4.0 / np.sqrt(2.0 * runs))  # 4 standard errors


def test_equal_seeds_give_equal_results_and_others_do_not():
    arguments = {"simulation": "I", "model": "as-printed", "runs": 3}
    one, again, other = (corvette.simulate(**arguments, seed=seed) for seed in (0, 0, 1))
    for level, errors in one["rmse"].items():
        np.testing.assert_array_equal(errors, again["rmse"][level])
        assert (errors != other["rmse"][level]).all()
