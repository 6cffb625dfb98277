"""The experiment on Rudianto et al. (2024): random systems, the least-favourable model, and what the page says."""

from html import unescape

import numpy as np
import pytest

from agents.cells import Cell
from agents.page import Claims, Table, render
from agents.reproduction import robust
from agents.reproduction.pages import robust as robust_page
from agents.reproduction.pages import robust_results
from agents.reproduction.settings import robust as settings
from agents.reproduction.settings.robust import Condition
from agents.statistics import Interval

pytestmark = pytest.mark.slow  # its pages come from the whole experiment

SEEDS = range(1, 13)


def _errors(condition: Condition, seeds=SEEDS, runs: int = 6, steps: int = 80, skipped: int = 20):
    return robust.errors(list(seeds), settings.READINGS, runs, settings.NOISE_SEED, steps, skipped, condition._asdict())


@pytest.fixture(scope="module")
def results():
    """Every cell, with few systems, runs and steps."""
    small = {
        name: population._replace(seeds=population.seeds[:6], runs=2 if len(population.seeds) > 1 else 6)
        for name, population in settings.POPULATIONS.items()
    }
    robust_results.system_traits.cache_clear()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(settings, "POPULATIONS", small)
        patch.setattr(settings, "STEPS", 30)
        patch.setattr(settings, "SKIPPED", 10)
        yield {name: cell.compute() for name, cell in robust.cells().items()}
    robust_results.system_traits.cache_clear()


@pytest.fixture(scope="module")
def page(results):
    return robust_page.page(results)


# --- the systems ------------------------------------------------------------------------------------


def test_every_random_system_is_stable_with_the_margin_of_the_recipe():
    for seed in (settings.PAPER_SEED, *settings.POPULATIONS[settings.RANDOM].seeds):
        system = robust.draw(seed)
        slowest = -np.linalg.eigvals(system.A).real.max()
        assert settings.MARGIN[0] <= slowest * (1 + 1e-12)
        assert slowest <= settings.MARGIN[1] * (1 + 1e-12)
        assert settings.INTENSITY[0] <= system.q <= settings.INTENSITY[1]
        np.testing.assert_allclose(np.linalg.norm(system.C, axis=1), 1.0, rtol=1e-14)


def test_one_reading_less_leaves_the_rest_of_the_system_as_it_is():
    both, first = robust.draw(3), robust.draw(3, readings=1)
    for a, b in zip(both._replace(C=both.C[:1]), first, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("error", [0.1, 0.8])
def test_a_mistaken_system_is_off_by_just_the_error_and_still_stable(error: float):
    rng = np.random.default_rng(0)
    for seed in SEEDS:
        system = robust.draw(seed)
        wrong = robust.mistaken(system, error, rng)
        assert np.linalg.norm(wrong.A - system.A) == pytest.approx(error * np.linalg.norm(system.A), rel=1e-12)
        assert np.linalg.eigvals(wrong.A).real.max() < 0.0


# --- the least-favourable model ---------------------------------------------------------------------


def test_with_tolerance_0_nature_plays_the_model():
    worst = robust.least_favourable(robust.discretised([robust.draw(seed) for seed in SEEDS]), 0.0, 30)
    np.testing.assert_allclose(np.array(worst.shift), 0.0, atol=1e-10)
    root = np.array(worst.root)
    np.testing.assert_allclose(root, np.broadcast_to(np.eye(4), root.shape), atol=1e-10)


@pytest.mark.parametrize("tolerance", [0.01, 0.1, 0.3])
def test_from_natures_own_start_the_error_of_the_robust_filter_ends_as_large_as_it_claims(tolerance: float):
    """The defining property of the saddle point. Fifty inverses, some ill-conditioned, cost digits in a few systems."""
    worst = robust.least_favourable(robust.discretised([robust.draw(seed) for seed in range(1, 61)]), tolerance, 50)
    information = np.eye(2) / settings.PRIOR_VARIANCE - worst.start_weight
    assert np.linalg.eigvalsh(information).min() > 0.0
    cov = np.linalg.inv(information)
    for shift, root, F, N in zip(worst.shift, worst.root, worst.error_map, worst.error_noise, strict=True):
        closed, noise = F + N @ shift, N @ root
        cov = closed @ cov @ closed.mT + noise @ noise.mT
    off = np.linalg.norm(cov - worst.claimed, axis=(-2, -1)) / np.linalg.norm(worst.claimed, axis=(-2, -1))
    assert np.median(off) < 1e-12
    assert off.max() < 1e-6


# --- runs -------------------------------------------------------------------------------------------


def test_the_same_seeds_give_the_same_errors_and_conditions_share_their_noise():
    first, second = _errors(settings.OUTLIERS), _errors(settings.OUTLIERS)
    for name in settings.FILTERS:
        np.testing.assert_array_equal(first[name], second[name])
    # Outliers no larger than the rest are none, so what is left is the undisturbed run to the last bit.
    plain, harmless = _errors(Condition()), _errors(settings.OUTLIERS._replace(size=1.0))
    np.testing.assert_array_equal(plain["huber-kf"], harmless["huber-kf"])


def test_a_system_is_filtered_alike_alone_and_among_others():
    model = robust.discretised([robust.draw(seed) for seed in SEEDS])
    record = robust.simulate(model, model, Condition(), 30, 3, 0)
    alone = robust.discretised([robust.draw(SEEDS[4])])
    for name in settings.FILTERS:
        among = [after.mean[4:5] for _, after in robust.track(name, model, record.y)]
        single = [after.mean for _, after in robust.track(name, alone, record.y[:, 4:5])]
        np.testing.assert_allclose(among, single, rtol=0, atol=1e-9)


def test_each_filter_wins_on_its_own_ground_and_loses_elsewhere_over_many_systems():
    """The direction of the main results, by three standard errors over systems."""

    def margin(condition: Condition, name: str, systems: int = 60, **length: int) -> float:
        rmse = _errors(condition, range(1, systems + 1), 2, **length)
        ratio = np.log(np.sqrt((rmse[name] ** 2).mean(1) / (rmse["kf"] ** 2).mean(1)))
        return float(-ratio.mean() / (ratio.std(ddof=1) / np.sqrt(len(ratio))))

    small = next(name for name, (kind, _) in settings.FILTERS.items() if kind == "robust-kf")
    assert margin(settings.OUTLIERS, "huber-kf") > 3.0
    assert margin(settings.OUTLIERS, small) < -3.0
    assert margin(Condition(), "huber-kf") < -3.0
    assert margin(Condition(), small) < -3.0
    assert margin(settings.PARAMETERS, "huber-kf") < -3.0
    # Of 1 %, so that it takes more systems and the whole length.
    own_ground = Condition(tolerance=settings.TOLERANCES[0])
    assert margin(own_ground, small, systems=200, steps=settings.STEPS, skipped=settings.SKIPPED) > 3.0


# --- the printed algorithm --------------------------------------------------------------------------


def test_the_printed_algorithm_is_the_kalman_filter(results):
    assert results["example"]["printed"] < 1e-12


def test_the_misprinted_steady_state_contradicts_itself_and_the_corrected_one_does_not():
    for seed in SEEDS:
        steady = robust.steady_state(robust.discretised([robust.draw(seed)]))
        assert steady["corrected_11"] < 1e-10
        assert steady["printed_11"] > 1e-3
        assert steady["printed_14"] > 1e-3
        assert steady["growth"] > 1.0


# --- cells and page ---------------------------------------------------------------------------------


def test_every_condition_of_every_sweep_has_a_cell_for_both_populations():
    names = robust.cells()
    assert all(isinstance(cell, Cell) for cell in names.values())
    for group in (*settings.SWEEPS.values(), *settings.CROSSED.values()):
        for condition in group:
            for population in (settings.RANDOM, settings.PAPER):
                assert robust.cell_name(population, condition) in names


def test_the_page_has_every_figure_of_the_paper_with_a_verdict_and_every_misprint(page):
    html = unescape(render(page))
    table = next(table for table in page.tables if "figures" in table.title)
    rows = {name: entries for _, section in table.sections for name, entries in section}
    assert list(rows) == list(settings.FIGURES)
    assert all("not comparable" in entries[-1].value for entries in rows.values())
    for name in settings.FIGURES:
        assert f"The paper's {name.lower()}" in html
    assert html.count("data:image/svg+xml") >= len(settings.FIGURES)
    assert "no table of results" in html
    misprints = page.sections[-1].blocks[-1].items
    assert len(misprints) == 10
    for text in misprints:
        assert text in html


def test_every_claim_has_a_verdict_that_its_intervals_bear_out(page, results):
    claims = [claim for section in page.sections for b in section.blocks if isinstance(b, Claims) for claim in b.rows]
    assert all(claim.kind in {"true", "false", "undecided"} and claim.evidence for claim in claims)
    sweep = [("", c) for c in settings.SWEEPS["rate"] if c.rate]
    below = robust_page._lower(results, "", "huber-kf", sweep)
    ratios = [robust_results.mean_ratio(results, settings.RANDOM, c, "huber-kf") for _, c in sweep]
    assert (below.kind == "true") == all(ratio.high < 1.0 for ratio in ratios)
    assert (below.kind == "false") == any(ratio.low > 1.0 for ratio in ratios)


def test_the_interval_of_a_ratio_is_told_by_its_two_ends():
    """It comes of an even one of logarithms: half of its width on either side of the mean is not where it lies."""
    told = robust_page._ratio_entry(Interval(0.8, 0.7, 0.95))
    assert (str(told), told.strong) == ("0.800 [0.700, 0.950]", True)
    told = robust_page._ratio_entry(Interval(1.0, 0.9, 1.2))
    assert (str(told), told.strong) == ("1.000 [0.900, 1.200]", False)


def test_no_ratio_of_the_page_has_an_even_interval(page):
    tables = [table for table in page.tables if any("/ KF" in label for label, _ in table.head)]
    entries = [e for table in tables for _, section in table.sections for _, row in section for e in row[-3:]]
    assert len(entries) > 100
    assert all("[" in e.value and not e.half for e in entries)
    claims = [claim for section in page.sections for b in section.blocks if isinstance(b, Claims) for claim in b.rows]
    assert not [claim.evidence for claim in claims if "±" in claim.evidence]
    assert "±" not in " ".join(page.answer)


def test_every_condition_stands_in_a_table_for_both_populations(page):
    rows = sum(len(section) for table in page.tables if isinstance(table, Table) for _, section in table.sections)
    sweeps = sum(len(group) for group in (*settings.SWEEPS.values(), *settings.CROSSED.values()))
    assert rows >= 2 * sweeps


@pytest.mark.parametrize(
    ("ratios", "said"),
    [
        (
            ((0.98, 0.97, 0.99), (0.9, 0.85, 0.95), (1.2, 1.1, 1.3)),
            "gains 2.0 to 10.0 % in 2 and loses 20.0 % in 1 of 3",
        ),
        (((1.2, 1.1, 1.3), (1.0, 0.9, 1.1)), "loses 20.0 % in 1 of 2"),
        (((1.0, 0.9, 1.1),), "neither gains nor loses beyond chance in any of 1"),
    ],
)
def test_what_a_filter_loses_is_said_beside_what_it_gains(monkeypatch: pytest.MonkeyPatch, ratios, said: str):
    given = iter(Interval(*ratio) for ratio in ratios)
    monkeypatch.setattr(robust_page, "mean_ratio", lambda *_: next(given))
    assert robust_page._balance({}, [Condition()] * len(ratios), "robust-kf") == said


def test_the_answer_counts_every_model_error_and_every_kind_of_outliers(page):
    for c in settings.TOLERANCES:
        (sentence,) = (line for line in page.answer if line.startswith(f"robust-kf with c = {c:g}"))
        assert "of 8 model errors" in sentence
        assert "of 9 kinds of outliers" in sentence
