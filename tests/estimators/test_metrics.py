"""Scores and angles against SciPy and against themselves."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimators import nees, nis, rmse, wrap
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


@pytest.mark.parametrize("turns", [-4, -1, 0, 3])
def test_wrap_stays_in_its_interval_beside_the_seam(turns: int):
    seam = (2 * turns + 1) * np.pi
    angles = np.array([np.nextafter(seam, -np.inf), seam, np.nextafter(seam, np.inf)])
    wrapped = wrap(angles)
    assert (wrapped > -np.pi).all(), wrapped + np.pi
    assert (wrapped <= np.pi).all()


# --- errors ---------------------------------------------------------------------------------------


def test_rmse_is_one_value_a_component_over_the_axes_asked_for():
    estimate, truth = np.random.default_rng(0).normal(size=(2, 6, 5, 3))
    square = (estimate - truth) ** 2
    for axis, over in ((None, (0, 1)), ((0, 1), (0, 1)), (0, 0)):
        expected = np.sqrt(square.mean(over))
        np.testing.assert_allclose(rmse(estimate, truth, axis=axis), expected, rtol=1e-14)


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


# --- consistency ----------------------------------------------------------------------------------


def test_nees_and_nis_are_squared_standardised_distances():
    rng = np.random.default_rng(0)
    mean, truth = rng.normal(size=(2, 4, 5, 3))
    cov, error = random_covariance(rng, 3, (4, 5)), truth - mean
    whitened = np.linalg.solve(np.linalg.cholesky(cov), error[..., None])[..., 0]
    np.testing.assert_allclose(nees(mean, cov, truth), (whitened**2).sum(-1), rtol=1e-11)
    np.testing.assert_allclose(nis(error, cov), (whitened**2).sum(-1), rtol=1e-11)


def test_what_is_missing_adds_nothing_to_nis_and_nees():
    rng = np.random.default_rng(2)
    p, kept = 4, np.array([True, False, True, False])
    S, e = random_covariance(rng, p), rng.normal(size=p)
    missing_S = np.where(np.outer(kept, kept), S, np.eye(p))  # as an update reports it
    assert nis(np.where(kept, e, 0.0), missing_S) == pytest.approx(
        nis(e[kept], S[kept][:, kept]), rel=1e-13
    )
    assert nis(np.zeros(p), np.eye(p)) == 0.0
    unknown = np.where(kept, e, np.nan)
    for cov in (S, np.where(np.outer(kept, kept), S, np.nan)):
        assert (
            nis(unknown, cov) == nees(np.zeros(p), cov, unknown) == nis(e[kept], S[kept][:, kept])
        )
    assert nis(np.full(p, np.nan), S) == 0.0
    assert np.isnan(nees(unknown, S, e))  # an estimate that is lost is no perfect one


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
