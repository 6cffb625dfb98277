"""Scores of the corvette in her seaway by estimator: fixed seeds, thresholds with their false-alarm rates."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from agents import rollout
from agents.metrics import nees_of, scores
from agents.seeds import evaluation_seeds
from vessel_gym.envs import SigmaCorvetteEnv

pytestmark = pytest.mark.slow
SEEDS, SEAS = evaluation_seeds(40), SigmaCorvetteEnv.system.disturbances


@cache
def flown(estimator: str, sea: str, without: bool = False) -> dict[str, np.ndarray]:
    options = (
        {"assume": {"disturbance": replace(SEAS[sea].believed, current=0.0)}} if without else {}
    )
    world = {"estimator": estimator, "estimator_options": options, "disturbance": sea}
    return scores(rollout("autopilot", "SigmaCorvette-v0", SEEDS, world))


@pytest.mark.parametrize("sea", ["moderate", "rough"])
def test_estimate_of_current_raises_score(sea):
    """Paired; the 99.9 % interval of the difference lies above 0."""
    gain = flown("kf-umv-ui", sea)["score"] - flown("kf-umv-ui", sea, without=True)["score"]
    assert gain.mean() > 3.5 * gain.std(ddof=1) / np.sqrt(len(gain))
    assert gain.mean() > 0.02


@pytest.mark.parametrize("estimator", ["kf-umv-ui", "ekf-waves"])
def test_filters_of_waves_are_consistent_in_moderate_seas(estimator):
    """NEES/n of components from 60 s on, over 40 episodes: the mean of the current's varies by 0.1."""
    world = {"estimator": estimator, "disturbance": "moderate"}
    run = rollout("autopilot", "SigmaCorvette-v0", SEEDS, world)

    def late(*names: str) -> float:
        return np.mean(nees_of(run, *names)[120:][run.alive[120:]]) / len(names)

    assert 0.7 < late("x", "y") < 1.4
    assert 0.7 < late("psi") < 1.4
    assert 0.5 < late("current north", "current east") < 1.6


def test_kf_umv_ui_is_best_of_filters_without_wave_states():
    """ULISE, on the linear model, estimates the same d, and is worse in the yaw rate alone."""
    ours = flown("kf-umv-ui", "rough")
    for other in ("ekf", "kf", "ulise", "measurement"):
        theirs = flown(other, "rough")
        assert other == "ulise" or ours["heading_rmse"].mean() < 0.8 * theirs["heading_rmse"].mean()
        assert ours["yaw_rate_rmse"].mean() < 0.8 * theirs["yaw_rate_rmse"].mean()


@pytest.mark.parametrize(
    "estimator", ["kf-umv-ui-wdf", "ulise", "kf", "huber-kf", "robust-kf", "ukf", "enkf", "enkf-sr"]
)
def test_every_filter_that_takes_the_model_flies(estimator):
    assert (
        flown(estimator, "moderate")["score"].mean()
        > 0.8 * flown("ekf", "moderate")["score"].mean()
    )


@pytest.mark.parametrize("estimator", ["ekf-ui-wdf", "ukf-umv"])
def test_delayed_input_filters_estimate_what_kf_umv_ui_does(estimator):
    ours, theirs = flown("kf-umv-ui", "moderate"), flown(estimator, "moderate")
    for name in ("heading_rmse", "yaw_rate_rmse", "position_rmse"):
        # Sigma points see the bend of the turn, too, which shows where waves are low.
        assert (
            (0.98 if estimator == "ukf-umv" else 0.99)
            < theirs[name].mean() / ours[name].mean()
            < 1.01
        )
    # They have no estimate of the very first d, which is one of 600 and four times as large as the
    # errors.
    assert theirs["input_rmse"].mean() == pytest.approx(ours["input_rmse"].mean(), rel=0.03)


def test_the_ship_rolls_as_hard_as_her_sea_and_her_turn_make_her():
    calm, rough = (flown("kf-umv-ui", sea)["roll"].mean() for sea in ("calm", "rough"))
    assert 1.0 < calm < 6.0  # degrees: what the turn does
    assert calm + 0.5 < rough < 15.0
