"""Rudianto et al. (2024): random systems, the least-favourable model, and the printed algorithm."""

import numpy as np
import pytest

from agents.papers import settings
from agents.papers.robust import experiment as robust

MODEL = robust.discretised([robust.draw(seed) for seed in range(1, 61)])


@pytest.mark.parametrize("error", [0.1, 0.8])
def test_systems_are_stable_and_mistaken_ones_off_by_the_error(
    error: float,
):
    rng = np.random.default_rng(0)
    for seed in (2024, *range(1, 41)):
        system = robust.draw(seed)
        assert 0.1 - 1e-12 <= -robust.growth(system.A) <= 1.0 + 1e-12
        wrong = robust.mistaken(system, error, rng).A
        assert np.linalg.norm(wrong - system.A) == pytest.approx(error * np.linalg.norm(system.A))
        assert robust.growth(wrong) < 0.0


@pytest.mark.parametrize("tolerance", [0.0, 0.01, 0.1, 0.3])
def test_worst_case_error_of_the_robust_filter_is_what_it_claims(
    tolerance: float,
):
    """The saddle point. Fifty inverses, some ill-conditioned, cost digits in a few systems."""
    worst = robust.least_favourable(MODEL, tolerance, 50)
    if not tolerance:  # nature plays the model
        np.testing.assert_allclose(worst.shift, 0.0, atol=1e-10)
    cov = np.linalg.inv(np.eye(2) / robust.PRIOR_VARIANCE - worst.start_weight)
    assert np.linalg.eigvalsh(cov).min() > 0.0
    for shift, root, F, N in zip(*worst[:4], strict=True):
        closed, noise = F + N @ shift, N @ root
        cov = closed @ cov @ closed.mT + noise @ noise.mT
    off = np.linalg.norm(cov - worst.claimed, axis=(-2, -1))
    off /= np.linalg.norm(worst.claimed, axis=(-2, -1))
    assert np.median(off) < 1e-12
    assert off.max() < 1e-6


def test_the_printed_algorithm_is_the_kalman_filter():
    model, record, of = robust.kalman(settings("robust") | {"steps": 60}, 2, robust.Condition())
    printed = robust.printed_estimates(model, record.y[:, 0, 0])
    np.testing.assert_allclose(printed, of.mean[:, 0, 0], rtol=0, atol=1e-13)
