"""What the reward of a ship weighs, by flights in moderate seas: place, steering without bound, and estimates."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from agents.controllers import make_controller
from vessel_gym.core import Core
from vessel_gym.envs import SigmaCorvetteEnv
from vessel_gym.tasks.helm import smoothness

TASK = SigmaCorvetteEnv.system.task
ROWS = 12


def flown(
    estimator: str = "truth",
    beside: float = 0.0,
    helm: Callable[[int, np.ndarray], np.ndarray] = lambda k, a: a,
) -> tuple[float, float, float]:
    """Score, rudder travel [deg/min] and reversals [1/min] of the autopilot, whose actions ``helm`` may change.

    Args:
        estimator: The estimator.
        beside: Distance [m] to starboard of the track that the autopilot takes for the track.
        helm: Action by step and the autopilot's action.
    """
    core, autopilot = (
        Core(SigmaCorvetteEnv.system, ROWS, estimator),
        make_controller("autopilot", SigmaCorvetteEnv.system),
    )
    core.start(list(range(20_000, 20_000 + ROWS)))
    autopilot.reset(ROWS)
    rudder = [core.now.actuators]
    for k in range(TASK.horizon):
        seen = core.observe()
        seen[:, 7] -= beside / TASK.TRACK_SCALE
        core.step(helm(k, autopilot.act(seen)))
        rudder.append(core.now.actuators)
    minutes, moved = TASK.horizon * TASK.dt / 60.0, np.diff(np.rad2deg(rudder), axis=0)
    reversals = (moved[1:] * moved[:-1] < 0.0).sum(0).mean()
    return (
        (core.now.total / TASK.horizon).mean(),
        np.abs(moved).sum(0).mean() / minutes,
        reversals / minutes,
    )


steered = cache(flown)


def dithered(amplitude: float, period: int) -> tuple[float, float, float]:
    """The flight on the truth with a square wave of the rudder's rate added, of an even number of steps."""

    def helm(k: int, action: np.ndarray) -> np.ndarray:
        return np.clip(action + (amplitude if k % period < period // 2 else -amplitude), -1.0, 1.0)

    return flown(helm=helm)


def test_a_good_autopilot_on_the_truth_is_worth_most_of_a_perfect_step():
    assert steered()[0] > 0.6


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_fifty_metres_beside_the_track_are_worth_next_to_nothing(side: float):
    assert flown(beside=50.0 * side)[0] <= 0.15 / 3.0


@pytest.mark.parametrize("hysteresis", [0.0, 0.2, 0.5])
def test_a_rudder_that_only_changes_sides_at_full_rate_is_not_worth_it(hysteresis: float):
    last = np.ones((ROWS, 1))

    def helm(k: int, action: np.ndarray) -> np.ndarray:
        last[:] = np.where(np.abs(action) >= hysteresis, np.where(action >= 0.0, 1.0, -1.0), last)
        return last

    assert flown(helm=helm)[0] <= 0.3


@pytest.mark.parametrize(("amplitude", "period"), [(0.04, 2), (0.11, 4)])
def test_to_triple_the_reversals_costs_a_twentieth(amplitude: float, period: int):
    score, _, reversals = dithered(amplitude, period)
    assert 3.0 * steered()[2] <= reversals <= 3.7 * steered()[2]
    assert score <= steered()[0] - 0.05


def test_the_more_the_rudder_travels_at_the_same_place_the_lower_the_score():
    flights = [steered(), *(dithered(amplitude, 4) for amplitude in (0.05, 0.1, 0.2, 0.4, 0.8))]
    scores, travels, _ = zip(*flights, strict=True)
    assert (np.diff(travels) > 0.0).all()
    assert (np.diff(scores) < 0.0).all()


def test_the_less_an_estimate_is_worth_the_more_the_rudder_travels():
    flights = [steered(estimator) for estimator in ("truth", "kf-umv-ui", "ekf", "measurement")]
    scores, travels, _ = zip(*flights, strict=True)
    assert (np.diff(travels) > 0.0).all()
    assert (np.diff(scores) < 0.0).all()


def test_effort_costs_without_bound_and_rest_nothing():
    rate = np.array([[0.0], [0.1], [1.0], [-1.0], [1e9]])
    one = smoothness(rate, rate)
    assert one[0] == 1.0
    assert (np.diff(one[[0, 1, 2, 4]]) < 0.0).all()
    assert one[2] == one[3]
    assert 0.0 < one[4] < 1e-8
    turned = smoothness(rate, -rate)
    assert (turned[1:] < one[1:]).all()
    np.testing.assert_allclose(1.0 / turned - 1.0, (1.25 + 4.0) * np.abs(rate[:, 0]))
    both = smoothness(np.array([[1.0, 0.0]]), np.array([[1.0, 0.0]]), 2.0)
    np.testing.assert_allclose(1.0 / both - 1.0, 1.25)
