"""Rudianto et al. (2024): random systems, the least-favourable model, and the printed algorithm."""

import numpy as np
import pytest

from studies.papers import settings
from studies.papers.robust import experiment as robust
from studies.papers.robust.experiment import Condition

S = settings("robust")
SEEDS = range(1, 13)
OUTLIERS, PARAMETERS = (Condition(**S[key]) for key in ("outliers", "parameters"))


def _errors(
    condition: Condition, systems: int = 12, runs: int = 6, steps: int = 80, skipped: int = 20
):
    return robust.errors(
        1, systems, runs, S["noise_seed"], steps, skipped, condition._asdict(), S["filters"]
    )


def test_every_random_system_is_stable_with_the_margin_of_the_recipe():
    for seed in (2024, *range(1, 201)):
        system = robust.draw(seed)
        assert robust.MARGIN[0] <= -robust.growth(system.A) * (1 + 1e-12)
        assert -robust.growth(system.A) <= robust.MARGIN[1] * (1 + 1e-12)
        assert robust.INTENSITY[0] <= system.q <= robust.INTENSITY[1]
        np.testing.assert_allclose(np.linalg.norm(system.C, axis=1), 1.0, rtol=1e-14)


@pytest.mark.parametrize("error", [0.1, 0.8])
def test_a_mistaken_system_is_off_by_just_the_error_and_still_stable(error: float):
    rng = np.random.default_rng(0)
    for seed in SEEDS:
        system = robust.draw(seed)
        wrong = robust.mistaken(system, error, rng)
        assert np.linalg.norm(wrong.A - system.A) == pytest.approx(
            error * np.linalg.norm(system.A), rel=1e-12
        )
        assert robust.growth(wrong.A) < 0.0


def test_with_tolerance_0_nature_plays_the_model():
    worst = robust.least_favourable(
        robust.discretised([robust.draw(seed) for seed in SEEDS]), 0.0, 30
    )
    np.testing.assert_allclose(np.array(worst.shift), 0.0, atol=1e-10)
    root = np.array(worst.root)
    np.testing.assert_allclose(root, np.broadcast_to(np.eye(4), root.shape), atol=1e-10)


@pytest.mark.parametrize("tolerance", [0.01, 0.1, 0.3])
def test_from_natures_own_start_the_error_of_the_robust_filter_ends_as_large_as_it_claims(
    tolerance: float,
):
    """The defining property of the saddle point. Fifty inverses, some ill-conditioned, cost digits in a few systems."""
    worst = robust.least_favourable(
        robust.discretised([robust.draw(seed) for seed in range(1, 61)]), tolerance, 50
    )
    information = np.eye(2) / robust.PRIOR_VARIANCE - worst.start_weight
    assert np.linalg.eigvalsh(information).min() > 0.0
    cov = np.linalg.inv(information)
    for shift, root, F, N in zip(
        worst.shift, worst.root, worst.error_map, worst.error_noise, strict=True
    ):
        closed, noise = F + N @ shift, N @ root
        cov = closed @ cov @ closed.mT + noise @ noise.mT
    off = np.linalg.norm(cov - worst.claimed, axis=(-2, -1)) / np.linalg.norm(
        worst.claimed, axis=(-2, -1)
    )
    assert np.median(off) < 1e-12
    assert off.max() < 1e-6


@pytest.mark.slow
def test_each_filter_wins_on_its_own_ground_and_loses_elsewhere_over_many_systems():
    """The direction of the main results, by three standard errors over systems."""

    def margin(condition: Condition, name: str, systems: int = 60, **length: int) -> float:
        rmse = _errors(condition, systems, 2, **length)
        ratio = np.log(np.sqrt((rmse[name] ** 2).mean(1) / (rmse["kf"] ** 2).mean(1)))
        return float(-ratio.mean() / (ratio.std(ddof=1) / np.sqrt(len(ratio))))

    small, default = "robust-kf, c = 0.001", "robust-kf, c = 0.01"
    assert margin(OUTLIERS, "huber-kf") > 3.0
    assert max(margin(OUTLIERS, default), margin(OUTLIERS, small)) < -3.0
    assert margin(Condition(), "huber-kf") < -3.0
    assert margin(Condition(), default) < -3.0
    assert margin(PARAMETERS, "huber-kf") < -3.0
    # Of 1 %, so that it takes more systems and the whole length.
    own_ground = Condition(tolerance=0.01)
    assert margin(own_ground, default, systems=200, steps=S["steps"], skipped=S["skipped"]) > 3.0
