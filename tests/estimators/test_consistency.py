"""The consistency tests: what they pass and fail, and their error rates."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import binom, chi2, norm

from estimators import Gaussian, LinearModel, NonlinearModel, make
from estimators.consistency import (
    assess,
    chi_square_test,
    simulate,
    whiteness_test,
)
from estimators.linalg import masked
from tests.estimators.cases import random_covariance, unknown_input_system

MODEL = LinearModel([[1.0, 0.5], [0.0, 0.9]], [[1.0, 0.0]], np.diag([0.01, 0.1]), [[1.0]])
PRIOR = Gaussian(np.zeros(2), np.diag([4.0, 1.0]))
TESTS = ("nees", "nis", "whiteness")


def _rng(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def _p_values(data, model: LinearModel = MODEL) -> dict[str, float]:
    report = assess(make("kf", model), PRIOR, _rng(0), data)
    found = {test: getattr(report, test) for test in TESTS}
    return {test: band.p_value for test, band in found.items() if band} | {"all": report.p_value}


# --- what passes, and what fails ------------------------------------------------------------------


@pytest.mark.slow
def test_a_consistent_filter_fails_no_more_often_than_stated():
    """The allowance is for 200 assessments: a false alarm of 0.1 % for each of the ten claims."""
    kf = make("kf", MODEL)
    reports = [
        assess(kf, PRIOR, _rng(i), simulate(MODEL, PRIOR, _rng(100 + i), 60, 40))
        for i in range(200)
    ]
    for rate in (0.05, 0.2):
        allowed = binom.ppf(0.999, len(reports), rate)
        assert sum(not report.passed(rate) for report in reports) <= allowed
        for test in TESTS:
            assert sum(getattr(report, test).p_value < rate for report in reports) <= allowed, test


@pytest.mark.parametrize("name", ["Q", "R"])
@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_a_filter_with_a_wrong_noise_covariance_fails_every_test(name: str, factor: float):
    data = simulate(MODEL, PRIOR, _rng(1), runs=400, steps=60)
    wrong = dataclasses.replace(MODEL, **{name: factor * getattr(MODEL, name)})
    assert max(_p_values(data, wrong).values()) < 1e-3
    assert _p_values(data)["all"] > 0.05


def test_gaps_in_the_measurements_are_no_sign_of_inconsistency():
    data = simulate(MODEL, PRIOR, _rng(0), runs=300, steps=40)
    data = data._replace(available=_rng(9).random(data.y.shape) >= 0.4)
    assert _p_values(data)["all"] > 0.01
    assert _p_values(data, dataclasses.replace(MODEL, R=3.0 * MODEL.R))["all"] < 1e-3
    every_other = np.broadcast_to(np.arange(40)[:, None, None] % 2 == 0, data.y.shape)
    report = assess(make("kf", MODEL), PRIOR, _rng(0), data._replace(available=every_other))
    assert report.whiteness is not None
    assert np.isnan(report.whiteness.found[0]).all()  # no pair is one step apart


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("kf-umv-ui", {"input_prior": 4.0}),
        ("kf-umv-ui-wdf", {"input_prior": 4.0}),
        ("ulise", {"input_prior": 4.0}),
        ("kf", {"input_cov": 9.0}),
    ],
)
def test_a_filter_is_judged_by_what_an_unknown_input_leaves(name: str, options: dict):
    system = unknown_input_system(0, feedthrough=name != "kf-umv-ui-wdf")
    model, d = system.model, 3.0 * _rng(1).normal(size=(40, 300, 1))
    data = simulate(model, system.prior, _rng(3), runs=300, steps=40, u=np.zeros(2), d=d)
    report = assess(make(name, model, **options), system.prior, _rng(0), data)
    assert report.passed(0.01)
    assert (report.nis is None) == (name == "ulise")
    assert report.whiteness is None
    wrong = dataclasses.replace(model, R=3.0 * model.R)
    report = assess(make(name, wrong, **options), system.prior, _rng(0), data)
    assert not report.passed(1e-3)
    assert report.nis is None or report.nis.p_value < 1e-3


def test_angles_are_compared_the_short_way_round():
    model = NonlinearModel(
        lambda x, u: x + 1.0, lambda x, u: x, [[0.01]], [[0.1]],
        state_angles=(0,), measurement_angles=(0,),
    )  # fmt: skip
    data, prior = (
        simulate(model, Gaussian([0.0], [[0.1]]), _rng(0), 300, 30),
        Gaussian([0.0], [[0.1]]),
    )
    turned = data._replace(x=data.x + 2.0 * np.pi * _rng(1).integers(-2, 3, size=data.x.shape))
    assert assess(make("ekf", model), prior, _rng(0), turned).passed(0.01)


def test_a_filter_with_random_members_can_be_assessed():
    data = simulate(MODEL, PRIOR, _rng(5), 40, 15)
    report = assess(make("enkf", MODEL, members=2000), PRIOR, _rng(6), data)
    assert report.passed(0.01)


# --- the single tests -----------------------------------------------------------------------------


def test_the_chi_square_test_judges_one_time_or_many():
    values = _rng(0).chisquare(3, size=(1, 50))
    band = chi_square_test(values, 3)
    ends = np.array(chi2.interval(0.95, 150)) / 150.0
    np.testing.assert_allclose((band.low[0], band.high[0]), ends, rtol=1e-12)
    tail = chi2.sf(values.sum(), 150)
    assert band.found[0, 0] == pytest.approx(values.mean() / 3.0)
    assert band.p_value == pytest.approx(2.0 * min(tail, 1.0 - tail), rel=1e-10)
    many = np.full((100, 1), chi2.ppf(0.5, 2))
    many[50] = chi2.isf(1e-5, 2)
    assert chi_square_test(many, 2).p_value == pytest.approx(100 * 2e-5)
    many[50] = np.nan  # what is not a number is not consistent
    assert chi_square_test(many, 2).p_value == 0.0


def test_degrees_of_freedom_may_differ_between_runs_and_be_none():
    degrees = np.array([[2, 0, 1], [0, 0, 0]])
    band = chi_square_test(np.array([[2.0, 0.0, 1.0], [0.0, 0.0, 0.0]]), degrees)
    np.testing.assert_allclose(band.found[:, 0], [1.0, np.nan])
    np.testing.assert_allclose(band.high, [chi2.ppf(0.975, 3) / 3.0, np.nan], rtol=1e-12)
    assert band.p_value == 1.0  # two times, the second of which says nothing


def test_whiteness_of_one_series_is_the_test_of_ljung_and_box():
    e, lags = _rng(0).normal(size=80), np.arange(1, 13)
    r = np.array([(e[lag:] * e[:-lag]).sum() for lag in lags]) / (e**2).sum()
    statistic = 80 * 82 * (r**2 / (80 - lags)).sum()
    found = whiteness_test(e[:, None, None].tolist(), [[[[1.0]]]] * 80, lags=12)
    assert found.p_value == pytest.approx(chi2.sf(statistic, 12), rel=1e-10)
    np.testing.assert_allclose(found.high, norm.ppf(0.975) / np.sqrt(80 - lags), rtol=1e-12)
    np.testing.assert_allclose(found.found[:, 0], r * 80 / (80 - lags), rtol=1e-12)


def test_whiteness_does_not_depend_on_scale_or_mixture():
    rng = _rng(1)
    S = np.broadcast_to(random_covariance(rng, 3), (50, 8, 3, 3))
    e = np.matvec(np.linalg.cholesky(S), rng.normal(size=(50, 8, 3)))
    mix = rng.normal(size=(3, 3))
    one = whiteness_test(e, S).p_value
    for other in (whiteness_test(e, 7.0 * S), whiteness_test(np.matvec(mix, e), mix @ S @ mix.T)):
        assert other.p_value == pytest.approx(one, rel=1e-9)


def test_whiteness_over_gaps_has_its_level_too():
    """Correlated measurements, each missing at times, whose correlation the filter ignores."""
    p, root = [], np.linalg.cholesky([[1.0, 1.8], [1.8, 4.0]])
    for seed in range(200):
        rng = _rng(1000 + seed)
        available = rng.random((40, 15, 2)) < [0.5, 0.9]
        e = np.where(available, np.matvec(root, rng.normal(size=(40, 15, 2))), np.nan)
        p.append(whiteness_test(e, masked(np.eye(2), available), lags=8).p_value)
    for level in (0.05, 0.5, 0.95):  # each with a false alarm of 0.1 %
        low, high = binom.ppf([0.0005, 0.9995], len(p), level)
        assert low <= (np.array(p) < level).sum() <= high


def test_a_lag_without_a_pair_of_measurements_says_nothing():
    e, S = _rng(2).normal(size=(41, 3, 1)), np.ones((41, 3, 1, 1))
    thinned = whiteness_test(e[::2], S[::2], lags=3)
    e[1::2] = np.nan
    found = whiteness_test(e, S, lags=6)
    np.testing.assert_array_equal(np.isnan(found.found[:, 0]), [True, False] * 3)
    assert found.p_value == pytest.approx(thinned.p_value, rel=1e-12)


def test_innovations_without_spread_are_refused():
    twins = np.repeat(_rng(0).normal(size=(10, 4, 1)), 2, axis=-1)
    with pytest.raises(ValueError, match="no spread"):
        whiteness_test(twins, np.broadcast_to(np.eye(2), (10, 4, 2, 2)), lags=2)


# --- simulation ----------------------------------------------------------------------------------


def test_simulated_runs_follow_known_and_unknown_input():
    model = LinearModel(
        [[0.5]], lambda u: 1.0 + u[..., None], [[0.0]], [[0.0]], B=[[1.0]], G=[[1.0]], H=[[2.0]]
    )
    u, prior, x = np.arange(5.0)[:, None, None], Gaussian([1.0], [[0.0]]), 1.0
    runs = simulate(model, prior, _rng(0), runs=3, steps=5, u=u, d=10.0 * u)
    for k in range(5):
        np.testing.assert_allclose(runs.x[k], np.full((3, 1), x))
        np.testing.assert_allclose(runs.y[k], np.full((3, 1), (1.0 + k) * x + 20.0 * k))
        x = 0.5 * x + 11.0 * k
    with pytest.raises(AssertionError, match="the model has no unknown input"):
        simulate(MODEL, PRIOR, _rng(0), 3, 5, d=u)
