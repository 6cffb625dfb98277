"""The consistency tools: what they pass, what they fail, how often they are wrong, and their picture."""

import dataclasses
import io
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom, chi2, norm

import estimators
from estimators import Filter, Gaussian, LinearModel, NonlinearModel, chi_square_band, make
from estimators.consistency import (
    LEVELS,
    Consistency,
    assess,
    chi_square_test,
    consistency_figure,
    coverage_test,
    simulate,
    whiteness_test,
)
from estimators.linalg import masked
from tests.estimators.cases import kalman_system, random_covariance, unknown_input_system

MODEL = LinearModel([[1.0, 0.5], [0.0, 0.9]], [[1.0, 0.0]], np.diag([0.01, 0.1]), [[1.0]])
PRIOR = Gaussian(np.zeros(2), np.diag([4.0, 1.0]))


def _rng(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


# --- how often a consistent filter is failed ------------------------------------------------------


@pytest.fixture(scope="module")
def reports() -> list[Consistency]:
    """A Kalman filter on its own model, assessed 200 times."""
    filter = make("kf", MODEL)
    return [assess(filter, PRIOR, _rng(100 + i), runs=60, steps=40, lags=10) for i in range(200)]


@pytest.mark.slow
def test_a_consistent_filter_is_failed_no_more_often_than_is_stated(reports: list[Consistency]):
    # The allowance is for the luck of 200 assessments: false alarm of 0.1 % for each of the ten
    # claims.
    for rate in (0.05, 0.2):
        allowed = binom.ppf(0.999, len(reports), rate)
        assert sum(not report.passed(rate) for report in reports) <= allowed
        for test in ("nees", "nis", "whiteness", "coverage"):
            assert sum(getattr(report, test).p_value < rate for report in reports) <= allowed, test


# --- what an inconsistent filter fails ------------------------------------------------------------


@pytest.mark.parametrize("name", ["Q", "R"])
@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_a_filter_with_a_wrong_noise_covariance_fails_every_test(name: str, factor: float):
    wrong = dataclasses.replace(MODEL, **{name: factor * getattr(MODEL, name)})
    report = assess(
        make("kf", wrong), PRIOR, _rng(0), simulate(MODEL, PRIOR, _rng(1), runs=400, steps=60)
    )
    assert not report.passed(1e-3)
    for test in ("nees", "nis", "whiteness", "coverage"):
        assert getattr(report, test).p_value < 1e-3, test
    # The same data under the true model: nothing to complain of.
    assert assess(
        make("kf", MODEL), PRIOR, _rng(0), simulate(MODEL, PRIOR, _rng(1), runs=400, steps=60)
    ).passed()


def test_a_conservative_filter_fails_unless_that_is_allowed():
    robust = make("robust-kf", MODEL, radius=0.1)
    strict, allowed = (
        assess(robust, PRIOR, _rng(2), runs=400, steps=60, conservative=conservative)
        for conservative in (False, True)
    )
    assert not strict.passed(1e-3)
    assert allowed.passed()
    np.testing.assert_array_equal(allowed.nees.mean, strict.nees.mean)
    assert (allowed.nees.low == 0.0).all()
    assert (allowed.coverage.high == 1.0).all()


def test_overconfidence_is_failed_even_where_a_filter_may_be_conservative():
    sure = make("kf", dataclasses.replace(MODEL, Q=0.2 * MODEL.Q))
    report = assess(
        sure, PRIOR, _rng(0), simulate(MODEL, PRIOR, _rng(1), runs=400, steps=60), conservative=True
    )
    for test in (report.nees, report.nis, report.coverage):
        assert test.p_value < 1e-3


@pytest.mark.parametrize(
    "share", [0.0, 0.4], ids=["every measurement arrives", "measurements drop out"]
)
@pytest.mark.parametrize("seed", [0, 1])
def test_gaps_in_the_measurements_are_no_sign_of_inconsistency(seed: int, share: float):
    system = kalman_system(seed)
    data = simulate(system.model, system.prior, _rng(seed), runs=300, steps=40, u=np.ones(system.m))
    data = data._replace(available=_rng(9).random(data.y.shape) >= share)
    report = assess(make("kf", system.model), system.prior, _rng(0), data)
    assert report.passed(0.01)
    np.testing.assert_allclose(report.nis.expected, data.available.sum(-1).mean(-1), rtol=1e-14)
    wrong = dataclasses.replace(system.model, R=3.0 * system.model.R)
    assert not assess(make("kf", wrong), system.prior, _rng(0), data).passed(1e-3)


@pytest.mark.parametrize("name", ["kf-umv-ui", "kf-umv-ui-wdf"])
def test_a_filter_that_estimates_an_unknown_input_is_judged_by_what_the_input_leaves(name: str):
    system = unknown_input_system(0, feedthrough=name == "kf-umv-ui")
    filter = make(name, system.model, input_prior=4.0)
    swing = 50.0 * np.sin(np.arange(40.0))[:, None, None]
    data = simulate(
        system.model, system.prior, _rng(3), runs=300, steps=40, u=np.zeros(system.m), d=swing
    )
    report = assess(filter, system.prior, _rng(0), data)
    assert report.whiteness is None
    assert report.passed(0.01)
    np.testing.assert_array_equal(report.nis.expected[1:], 2.0)
    wrong = dataclasses.replace(system.model, R=3.0 * system.model.R)
    assert not assess(make(name, wrong, input_prior=4.0), system.prior, _rng(0), data).passed(1e-3)


def test_a_filter_whose_innovations_carry_the_inputs_of_two_steps_is_judged_without_them():
    system = unknown_input_system(0, feedthrough=True)
    data = simulate(
        system.model, system.prior, _rng(3), runs=300, steps=40, u=np.zeros(system.m), d=[[[7.0]]]
    )
    report = assess(make("ulise", system.model, input_prior=4.0), system.prior, _rng(0), data)
    assert report.nis is None
    assert report.whiteness is None
    assert report.passed(0.01)
    wrong = dataclasses.replace(system.model, R=3.0 * system.model.R)
    assert not assess(make("ulise", wrong, input_prior=4.0), system.prior, _rng(0), data).passed(
        1e-3
    )


def test_a_filter_that_is_told_the_variance_of_its_input_is_judged_by_whole_innovations():
    system = unknown_input_system(0, feedthrough=True)
    d = 3.0 * _rng(1).normal(size=(40, 300, 1))
    data = simulate(
        system.model, system.prior, _rng(3), runs=300, steps=40, u=np.zeros(system.m), d=d
    )
    report = assess(make("kf", system.model, input_cov=9.0), system.prior, _rng(0), data)
    assert report.passed(0.01)
    np.testing.assert_array_equal(report.nis.expected, 3.0)
    assert not assess(make("kf", system.model, input_cov=3.0), system.prior, _rng(0), data).passed(
        1e-3
    )


def test_an_unknown_input_that_the_model_does_not_have_is_refused():
    system = kalman_system(0)
    with pytest.raises(ValueError, match="d was given, but the model has no unknown input"):
        simulate(system.model, system.prior, _rng(0), d=[[[1.0]]])


def test_what_is_not_a_number_is_not_consistent():
    values = _rng(0).chisquare(3, size=(20, 50))
    assert chi_square_test(values, 3).p_value > 0.0
    values[7, 3] = np.nan
    assert chi_square_test(values, 3).p_value == 0.0


def test_angles_are_compared_the_short_way_round():
    model = NonlinearModel(
        lambda x, u: x + 1.0,
        lambda x, u: x,
        np.diag([0.01]),
        np.diag([0.1]),
        state_angles=(0,),
        measurement_angles=(0,),
    )
    prior = Gaussian([0.0], [[0.1]])
    data = simulate(model, prior, _rng(0), runs=300, steps=30)
    turned = data._replace(x=data.x + 2.0 * np.pi * _rng(1).integers(-2, 3, size=data.x.shape))
    assert assess(make("ekf", model), prior, _rng(0), turned).passed(0.01)


def test_a_filter_with_random_members_can_be_assessed():
    report = assess(make("enkf", MODEL, members=2000), PRIOR, _rng(5), runs=40, steps=15, lags=5)
    assert report.passed(0.01)


# --- the single tests -----------------------------------------------------------------------------


def test_the_chi_square_test_is_exact_at_one_time():
    values = _rng(0).chisquare(3, size=(1, 50))
    band = chi_square_test(values, 3)
    np.testing.assert_allclose((band.low[0], band.high[0]), chi_square_band(50, 3), rtol=1e-12)
    tail = chi2.cdf(values.sum(), 150)
    assert band.p_value == pytest.approx(2.0 * min(tail, 1.0 - tail), rel=1e-10)
    assert chi_square_test(values, 3, conservative=True).p_value == pytest.approx(
        1.0 - tail, rel=1e-10
    )
    assert chi_square_test(values, 3, conservative=True).high[0] < band.high[0]


def test_degrees_of_freedom_may_differ_between_runs_and_be_none():
    degrees = np.array([[2, 0, 1], [0, 0, 0]])
    band = chi_square_test(np.array([[2.0, 0.0, 1.0], [0.0, 0.0, 0.0]]), degrees)
    np.testing.assert_allclose(band.expected, [1.0, 0.0])
    np.testing.assert_allclose(band.high, [chi2.ppf(0.975, 3) / 3.0, 0.0], rtol=1e-12)
    assert band.p_value == 1.0  # two times, the second of which says nothing


def test_many_times_are_judged_together():
    """One value in a hundred beyond its 1 % point is no reason to fail; one beyond its 0.001 % point is."""
    values = np.full((100, 1), chi2.ppf(0.5, 2))
    for level, passes in ((0.995, True), (1.0 - 1e-5, False)):
        values[50] = chi2.ppf(level, 2)
        assert (chi_square_test(values, 2).p_value > 0.05) == passes


def test_the_whiteness_of_one_series_is_the_test_of_ljung_and_box():
    e = _rng(0).normal(size=80)
    lags = np.arange(1, 13)
    r = np.array([(e[lag:] * e[:-lag]).sum() for lag in lags]) / (e**2).sum()
    expected = 80 * 82 * (r**2 / (80 - lags)).sum()
    found = whiteness_test(e[:, None, None], np.ones((80, 1, 1, 1)), lags=12)
    assert found.statistic == pytest.approx(expected, rel=1e-12)
    assert found.degrees == 12
    assert found.p_value == pytest.approx(chi2.sf(expected, 12), rel=1e-10)
    np.testing.assert_allclose(found.bound[:, 0], norm.ppf(0.975) / np.sqrt(80 - lags), rtol=1e-12)


def test_whiteness_does_not_depend_on_scale_or_mixture_of_the_measurements():
    rng = _rng(1)
    S = np.broadcast_to(random_covariance(rng, 3), (50, 8, 3, 3))
    e = np.matvec(np.linalg.cholesky(S), rng.normal(size=(50, 8, 3)))
    mix = rng.normal(size=(3, 3))
    one = whiteness_test(e, S)
    assert one.degrees == 9 * 20
    for other in (whiteness_test(e, 7.0 * S), whiteness_test(np.matvec(mix, e), mix @ S @ mix.T)):
        assert other.statistic == pytest.approx(one.statistic, rel=1e-9)


def test_a_wrong_gain_shows_as_coloured_innovations_whatever_covariance_is_claimed():
    system = kalman_system(3, p=2)
    data = simulate(system.model, system.prior, _rng(0), runs=50, steps=60, u=np.zeros(system.m))
    for factor, white in ((1.0, True), (0.05, False), (20.0, False)):
        wrong = dataclasses.replace(system.model, Q=factor * system.model.Q)
        report = assess(make("kf", wrong), system.prior, _rng(0), data)
        assert (report.whiteness.p_value > 0.01) == white
        outside = np.abs(report.whiteness.correlation) > report.whiteness.bound
        assert outside[0].any() != white


@pytest.mark.parametrize("known", [True, False], ids=["correlation known", "correlation ignored"])
def test_whiteness_over_gaps_has_its_level_too(known: bool):
    """Correlated measurements, each missing at times: the p-value stays uniform, whatever S the filter claims."""
    p, true = [], np.array([[1.0, 1.8], [1.8, 4.0]])
    root, claimed = np.linalg.cholesky(true), true if known else np.eye(2)
    for seed in range(200):
        rng = _rng(1000 + seed)
        available = rng.random((40, 15, 2)) < [0.5, 0.9]
        e = np.matvec(root, rng.normal(size=(40, 15, 2))) * available
        p.append(whiteness_test(e, masked(claimed, available), available, lags=8).p_value)
    for level in (0.05, 0.5, 0.95):
        low, high = binom.ppf(
            [0.0005, 0.9995], len(p), level
        )  # false alarm of 0.1 % at each of three levels
        assert low <= (np.array(p) < level).sum() <= high


def test_a_lag_at_which_a_measurement_never_came_twice_says_nothing():
    e = _rng(2).normal(size=(41, 3, 1))
    available = np.zeros(e.shape, bool)
    available[::2] = True
    found = whiteness_test(e * available, np.ones((41, 3, 1, 1)), available, lags=6)
    np.testing.assert_array_equal(np.isnan(found.correlation[:, 0]), [True, False] * 3)
    assert found.degrees == 3
    thinned = whiteness_test(e[::2], np.ones((21, 3, 1, 1)), lags=3)
    assert found.statistic == pytest.approx(thinned.statistic, rel=1e-12)


@pytest.mark.parametrize("lags", [0, 10])
def test_lags_must_fit_the_series(lags: int):
    with pytest.raises(ValueError, match="lags must be between 1 and 9 for 10 times"):
        whiteness_test(np.ones((10, 1, 1)), np.ones((10, 1, 1, 1)), lags=lags)


def test_innovations_without_spread_are_refused():
    with pytest.raises(ValueError, match="no spread"):
        whiteness_test(np.zeros((10, 1, 1)), np.ones((10, 1, 1, 1)), lags=2)
    twins = np.repeat(_rng(0).normal(size=(10, 4, 1)), 2, axis=-1)
    with pytest.raises(ValueError, match="no spread"):
        whiteness_test(twins, np.broadcast_to(np.eye(2), (10, 4, 2, 2)), lags=2)


def test_credible_intervals_of_true_gaussians_cover_as_they_should():
    rng, runs = _rng(0), 20_000
    cov = random_covariance(rng, 3)
    truth = np.matvec(np.linalg.cholesky(cov), rng.normal(size=(runs, 3)))
    found = coverage_test(np.zeros((runs, 3)), np.broadcast_to(cov, (runs, 3, 3)), truth)
    # 33 shares, each outside its interval with probability 1e-4: false alarm of 0.3 %.
    low, high = binom.interval(1.0 - 1e-4, runs, np.array(LEVELS)[:, None])
    assert (low <= runs * found.share).all()
    assert (runs * found.share <= high).all()
    assert found.p_value > 0.003
    narrow = coverage_test(np.zeros((runs, 3)), np.broadcast_to(0.9 * cov, (runs, 3, 3)), truth)
    assert narrow.p_value < 1e-6


@pytest.mark.parametrize("runs", [7, 50, 1000])
def test_the_interval_of_a_share_is_binomial(runs: int):
    found = coverage_test(np.zeros((runs, 1)), np.ones((runs, 1, 1)), np.zeros((runs, 1)))
    low, high = binom.interval(0.95, runs, np.array(LEVELS))
    np.testing.assert_allclose(runs * found.low, low, rtol=0, atol=1e-9)
    np.testing.assert_allclose(runs * found.high, high, rtol=0, atol=1e-9)
    assert (found.share == 1.0).all()
    expected = min(1.0, len(LEVELS) * min(1.0, 2.0 * 0.1**runs))
    assert found.p_value == pytest.approx(expected, rel=1e-9)
    sided = coverage_test(
        np.zeros((runs, 1)), np.ones((runs, 1, 1)), np.zeros((runs, 1)), conservative=True
    )
    assert sided.p_value == 1.0


# --- simulation -----------------------------------------------------------------------------------


def test_simulated_runs_without_noise_follow_known_and_unknown_input():
    nothing = np.zeros((2, 2))
    model = LinearModel(
        [[1.0, 1.0], [0.0, 0.5]],
        np.eye(2),
        nothing,
        nothing,
        B=[[0.0], [1.0]],
        G=[[1.0], [0.0]],
        H=[[0.0], [2.0]],
    )
    u, d = np.arange(5.0)[:, None, None], 10.0 * np.arange(5.0)[:, None, None]
    runs = simulate(model, Gaussian([1.0, 2.0], nothing), _rng(0), runs=3, steps=5, u=u, d=d)
    x = np.array([1.0, 2.0])
    for k in range(5):
        np.testing.assert_allclose(runs.x[k], np.tile(x, (3, 1)))
        np.testing.assert_allclose(runs.y[k], np.tile(x + [0.0, 20.0 * k], (3, 1)))
        x = model.A @ x + [10.0 * k, k]


def test_a_measurement_that_depends_on_the_known_input_sees_that_of_the_step_before():
    """As an update does that is not told otherwise: so the filter of a model of this kind is consistent."""
    model = LinearModel([[0.9]], lambda u: u[..., None] + 2.0, [[0.1]], [[0.2]], B=[[1.0]])
    prior, u = Gaussian([0.0], [[1.0]]), np.cos(np.arange(40.0))[:, None, None]
    data = simulate(model, prior, _rng(0), runs=300, steps=40, u=u)
    assert assess(make("kf", model), prior, _rng(0), data).passed(0.01)
    shifted = data._replace(u=np.roll(data.u, 1, axis=0))
    assert not assess(make("kf", model), prior, _rng(0), shifted).passed(1e-3)


@pytest.mark.parametrize("size", [{"runs": 1}, {"steps": 1}])
def test_too_little_to_simulate_is_refused(size: dict[str, int]):
    with pytest.raises(ValueError, match="runs and steps must be at least 2"):
        simulate(MODEL, PRIOR, _rng(0), **size)


# --- the figure -----------------------------------------------------------------------------------


def _panels(filter: Filter, prior: Gaussian, **options: object):
    report = assess(filter, prior, _rng(0), runs=50, steps=40, **options)
    figure = consistency_figure(report)
    written = io.BytesIO()
    figure.savefig(written, format="png", dpi=40)
    assert written.getvalue().startswith(b"\x89PNG")
    return report, figure, figure.axes


@pytest.mark.slow
def test_the_figure_shows_each_test_in_a_panel_with_named_axes():
    pytest.importorskip("matplotlib")
    report, figure, panels = _panels(make("kf", MODEL), PRIOR)
    labels = [(axes.get_xlabel(), axes.get_ylabel()) for axes in panels]
    assert labels == [
        ("step", "NEES / states, mean over runs"),
        ("step", "NIS / measurements, mean over runs"),
        ("lag [steps]", "autocorrelation"),
        ("nominal probability [%]", "found minus nominal [%]"),
    ]
    assert "kf: no sign of inconsistency" in figure.get_suptitle()
    for axes in panels:
        assert "p = " in axes.get_title()
        assert "95 % band" in [text.get_text() for text in axes.get_legend().get_texts()]
    shown = [line.get_ydata() for line in panels[0].lines]
    assert any(np.array_equal(y, report.nees.mean / MODEL.n) for y in shown)
    assert any(
        np.array_equal(y, report.whiteness.correlation[:, 0])
        for y in (line.get_ydata() for line in panels[2].lines)
    )
    assert len(panels[3].lines) == 1 + MODEL.n


@pytest.mark.slow
def test_only_the_figure_loads_matplotlib_and_it_opens_no_window():
    pytest.importorskip("matplotlib")
    program = """
import sys
import numpy as np
from estimators import Gaussian, LinearModel, make
from estimators.consistency import assess, consistency_figure
filter = make("kf", LinearModel(np.eye(1), np.eye(1), np.eye(1), np.eye(1)))
report = assess(filter, Gaussian([0.0], [[1.0]]), np.random.default_rng(0), runs=5, steps=30)
print("matplotlib" in sys.modules, "scipy.stats" in sys.modules)
consistency_figure(report)
print("matplotlib" in sys.modules, "matplotlib.pyplot" in sys.modules)
"""
    environment = {**os.environ, "PYTHONPATH": str(Path(estimators.__file__).parents[1])}
    result = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, env=environment, check=True
    )  # fmt: skip
    assert result.stdout.split() == ["False", "False", "True", "False"]
