"""Scores and angles against SciPy and against themselves."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from estimators import chi_square_band, nees, nis, rmse, wrap
from tests.estimators.cases import random_covariance

# --- angles ---------------------------------------------------------------------------------------


@settings(derandomize=True, max_examples=300, deadline=None)
@given(angle=st.floats(-1e4, 1e4))
def test_wrap_gives_the_same_direction_between_minus_pi_and_pi(angle: float):
    wrapped = float(wrap(angle))
    assert -np.pi < wrapped <= np.pi
    # Rounding of an angle of this size, and of the turns taken off it.
    np.testing.assert_allclose(
        [np.sin(wrapped), np.cos(wrapped)], [np.sin(angle), np.cos(angle)], rtol=0, atol=1e-11
    )


@pytest.mark.parametrize("turns", range(-4, 5))
def test_wrap_stays_in_its_interval_beside_the_seam(turns: int):
    seam = (2 * turns + 1) * np.pi
    angles = np.array([np.nextafter(seam, -np.inf), seam, np.nextafter(seam, np.inf)])
    wrapped = wrap(angles)
    assert (wrapped > -np.pi).all(), wrapped + np.pi
    assert (wrapped <= np.pi).all()


def test_wrap_takes_both_ends_to_plus_pi_and_leaves_small_angles_alone():
    assert wrap(np.pi) == np.pi
    assert wrap(-np.pi) == np.pi
    angles = np.linspace(-3.1, 3.1, 63).reshape(7, 9)
    np.testing.assert_allclose(wrap(angles), angles, rtol=0, atol=1e-15)
    np.testing.assert_allclose(wrap(angles + 6 * np.pi), angles, rtol=0, atol=1e-14)


# --- errors ---------------------------------------------------------------------------------------


def test_rmse_is_one_value_a_component_over_the_axes_asked_for():
    rng = np.random.default_rng(0)
    estimate, truth = rng.normal(size=(2, 6, 5, 3))
    error = estimate - truth
    np.testing.assert_allclose(
        rmse(estimate, truth), np.sqrt((error.reshape(-1, 3) ** 2).sum(0) / 30), rtol=1e-14
    )
    np.testing.assert_allclose(
        rmse(estimate, truth, axis=0), np.linalg.norm(error, axis=0) / np.sqrt(6), rtol=1e-14
    )
    np.testing.assert_allclose(
        rmse(estimate, truth, axis=(0, 1)), rmse(estimate, truth), rtol=1e-14
    )
    np.testing.assert_allclose(rmse(estimate[0, 0], truth[0, 0]), np.abs(error[0, 0]), rtol=1e-14)


def test_rmse_takes_the_short_way_round_for_angles_only():
    estimate, truth = np.array([[3.1, 3.1], [-3.0, -3.0]]), np.array([[-3.1, -3.1], [3.0, 3.0]])
    errors = np.array([2 * np.pi - 6.2, 2 * np.pi - 6.0])
    value = rmse(estimate, truth, angles=(1,))
    assert value[0] == pytest.approx(np.sqrt((6.2**2 + 6.0**2) / 2))
    assert value[1] == pytest.approx(np.sqrt((errors**2).mean()))


def test_rmse_and_nees_do_not_notice_whole_turns_of_an_angle():
    rng = np.random.default_rng(1)
    estimate, truth = rng.normal(size=(2, 50, 3))
    turned = estimate + 2 * np.pi * rng.integers(-3, 4, size=(50, 1)) * np.array([0.0, 1.0, 0.0])
    cov = random_covariance(rng, 3)
    close = {"rtol": 0, "atol": 1e-12}
    np.testing.assert_allclose(
        rmse(turned, truth, angles=(1,)), rmse(estimate, truth, angles=(1,)), **close
    )
    np.testing.assert_allclose(
        nees(turned, cov, truth, (1,)), nees(estimate, cov, truth, (1,)), rtol=1e-11
    )


def test_scores_leave_what_they_are_given_alone():
    estimate, truth, cov = np.full((2, 2), 4.0), np.full((2, 2), -4.0), np.eye(2)
    rmse(estimate, truth, angles=(0, 1))
    nees(estimate, cov, truth, angles=(0, 1))
    nis(estimate, cov)
    assert (estimate == 4.0).all()
    assert (truth == -4.0).all()
    np.testing.assert_array_equal(cov, np.eye(2))


# --- consistency ----------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [1, 3, 6])
def test_nees_and_nis_are_squared_distances_in_standard_deviations(n: int):
    rng = np.random.default_rng(n)
    mean, truth, cov = (
        rng.normal(size=(4, 5, n)),
        rng.normal(size=(4, 5, n)),
        random_covariance(rng, n, (4, 5)),
    )
    error = truth - mean
    whitened = np.linalg.solve(np.linalg.cholesky(cov), error[..., None])[..., 0]
    np.testing.assert_allclose(nees(mean, cov, truth), (whitened**2).sum(-1), rtol=1e-11)
    np.testing.assert_allclose(nis(error, cov), (whitened**2).sum(-1), rtol=1e-11)
    np.testing.assert_allclose(
        nees(mean, cov[0, 0], truth)[0, 0], (whitened**2).sum(-1)[0, 0], rtol=1e-11
    )


@pytest.mark.parametrize("n", [1, 4])
def test_nees_and_nis_of_true_gaussians_follow_the_chi_square_law(n: int):
    rng = np.random.default_rng(10 + n)
    runs, cov = 40_000, random_covariance(rng, n)
    error = np.matvec(np.linalg.cholesky(cov), rng.normal(size=(runs, n)))
    for values in (nees(np.zeros(n), cov, error), nis(error, cov)):
        for level in (0.025, 0.5, 0.975):
            # Three standard errors at three levels for two sizes: false alarm of 1.6 %.
            share = (values < chi2.ppf(level, n)).mean()
            assert abs(share - level) < 3.0 * np.sqrt(level * (1.0 - level) / runs)


def test_missing_measurements_add_nothing_to_nis():
    rng = np.random.default_rng(2)
    p, kept = 4, np.array([True, False, True, False])
    S, e = random_covariance(rng, p), rng.normal(size=p)
    missing_S = np.where(np.outer(kept, kept), S, np.eye(p))  # as an update reports it
    assert nis(np.where(kept, e, 0.0), missing_S) == pytest.approx(
        nis(e[kept], S[kept][:, kept]), rel=1e-13
    )
    assert nis(np.zeros(p), np.eye(p)) == 0.0


def test_nis_of_a_singular_s_has_no_unit():
    for unit in (1e-16, 1e-6, 1.0, 1e6):
        assert nis([0.0], [[0.0]]) == 0.0
        assert nis([4e-10 * unit], [[0.0]]) == np.inf
        assert nis([unit, -unit], np.full((2, 2), unit**2)) == np.inf
        assert nis([2.0 * unit, 2.0 * unit], np.full((2, 2), unit**2)) == pytest.approx(4.0)
        assert (
            nis([1e-15 * unit], [[0.0]], unit)
            == nees([unit], [[0.0]], [unit * (1.0 + 1e-15)])
            == 0.0
        )
        assert (
            nis([1e-6 * unit], [[0.0]], unit)
            == nees([unit], [[0.0]], [unit * (1.0 + 1e-6)])
            == np.inf
        )


@pytest.mark.parametrize("runs", [1, 10, 400])
@pytest.mark.parametrize("degrees", [1, 4, 12])
@pytest.mark.parametrize("confidence", [0.5, 0.95, 0.999])
def test_the_chi_square_band_is_that_of_scipy(runs: int, degrees: int, confidence: float):
    tails = np.array([(1.0 - confidence) / 2.0, (1.0 + confidence) / 2.0])
    band = chi_square_band(runs, degrees, confidence)
    np.testing.assert_allclose(band, chi2.ppf(tails, runs * degrees) / runs, rtol=1e-10)
    assert band[0] < degrees
    assert all(isinstance(end, float) for end in band)


def test_the_chi_square_band_is_at_95_percent_unless_told():
    assert chi_square_band(50, 3) == chi_square_band(50, 3, 0.95)
