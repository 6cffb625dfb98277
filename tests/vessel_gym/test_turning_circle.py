"""A ship that holds a turning circle: which turns are drawn, what the agent may see, and how it is scored."""

from typing import Any

import numpy as np
import pytest
from heading_ship import HEADING_SHIP, SHIP
from sensing import sensors_of

from vessel_gym.system import Estimate
from vessel_gym.vehicles.corvette import steady_turns
from vessel_gym.vehicles.corvette_equations import AROUND, STATE
from vessel_gym.vehicles.corvette_thesis import ThesisCorvette

L = SHIP.length
TASK = HEADING_SHIP.task
VEHICLE = ThesisCorvette(SHIP, 0.5)


def scenarios(n: int, seed: int = 0) -> np.ndarray:
    return TASK.scenario(np.random.default_rng(seed).random((n, 3)), {})


SENSORS = sensors_of(VEHICLE)


def seen(mean: Any, d: Any = None, sd: Any = None, d_sd: Any = None) -> Estimate:
    """An estimate of (v, r, psi) and of the unknown input, in no current."""
    still = np.zeros((len(mean), len(AROUND)))
    return Estimate(np.array(mean), still, d, sd, d_sd, np.zeros(0))


# --- courses --------------------------------------------------------------------------------------


def test_turn_radii_are_three_to_six_lengths_on_either_side():
    scenario = scenarios(2000)
    turns = steady_turns(SHIP)
    radius = np.interp(np.abs(scenario[:, 1]), turns.yaw_rate[1:], turns.radius[1:]) / L
    assert 3.0 * (1 - 1e-3) < radius.min() < 3.05
    assert 5.9 < radius.max() < 6.0 * (1 + 1e-3)
    # 2000 fair sides: a band of 4.9 standard deviations, false-alarm rate 1e-6.
    assert abs((scenario[:, 1] > 0).sum() - 1000) < 4.9 * np.sqrt(500)
    assert (np.abs(scenario[:, 0]) <= np.pi).all()
    assert np.ptp(scenario[:, 0]) > 6.2


def test_a_turn_radius_may_be_requested():
    uniforms = np.random.default_rng(1).random((5, 3))
    for radius in (300.0, -450.0, 1e4):
        scenario = TASK.scenario(uniforms, {"radius": radius})
        np.testing.assert_array_equal(scenario[:, 1], TASK.track.turning(np.array(1.0 / radius)))
        np.testing.assert_array_equal(
            scenario[:, 0], TASK.scenario(uniforms, {})[:, 0]
        )  # the heading is drawn as ever


def test_known_input_is_mean_rudder_and_commanded_yaw_rate():
    commanded = np.array([[0.01], [0.02]])
    told = VEHICLE.known_input(np.array([[0.1], [0.2]]), np.array([[0.14], [0.2]]), commanded)
    np.testing.assert_allclose(told[:, :2], np.hstack([[[0.12], [0.2]], commanded]))


# --- what the agent sees --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mean", "d", "heading", "expected"),
    [
        ([2.0, -0.01, 0.3], [[0.01]], 0.4, [1, 1, 1, 1, -1, 0, 0.5]),
        ([2.0, -0.01, np.pi - 0.01], None, 0.01 - np.pi, [0.2, 1, 1, 0, -1, 0, 0.5]),
        ([0.0, 0.0, 3.0 * np.pi], None, np.pi, [0, 0, 0, 0, -1, 0, 0.5]),
    ],
    ids=["of typical size", "across the cut", "whole turns off"],
)
def test_an_observation_is_one_at_a_typical_size(mean: Any, d: Any, heading: float, expected: Any):
    reference, rudder = np.array([[heading, 0.0, 0.02, 0.04]]), np.array([[-SHIP.rudder_limit]])
    estimate = seen([mean], d if d is None else np.array(d))
    found = TASK.observe(estimate, scenarios(1), reference, rudder)
    np.testing.assert_allclose(found, [expected], atol=1e-9)


def test_standard_deviations_are_scaled_like_their_means():
    mean, sd = np.zeros((1, 3)), np.array([[2.0, 0.01, 0.1]])
    for d_sd, expected in ((np.array([[0.02]]), 2.0), (None, 0.0)):
        found = TASK.observe_std(seen(mean, d_sd, sd, d_sd))
        np.testing.assert_allclose(found, [[1, 1, 1, expected]])


def test_a_measured_heading_is_its_error_to_the_commanded_one():
    scenario = np.tile([0.5, 0.03], (2, 1))  # at first the commanded heading is the initial one
    measurements = np.array([[0.4, 0.02], [0.3, 0.03]])
    seen = TASK.observe_measurements(SENSORS, measurements, scenario, np.zeros(2))
    np.testing.assert_allclose(seen, [[1, 2], [2, 3]], atol=1e-12)


# --- score ----------------------------------------------------------------------------------------


def scored(heading_error: Any, rate_error: Any, turned: Any) -> tuple[np.ndarray, np.ndarray]:
    """Reward and whether the turn is lost, for errors from a reference in the turn.

    The rudder goes on turning by a share of its full rate, so that no reversal counts.
    """
    each = np.broadcast_arrays(np.atleast_1d(heading_error), rate_error, turned)
    heading_error, rate_error, turned = (np.array(x, float) for x in each)
    rows, rudder = len(turned), SHIP.rudder_rate * TASK.dt * turned[:, None]
    truth, scenario = np.zeros((rows, len(STATE))), scenarios(len(turned))
    truth[:, 2], truth[:, 5] = 1.0 - heading_error, 0.03 - rate_error
    reference = np.tile([1.0, 0.03, 0.015, 0.03], (rows, 1))  # the preview does not count
    before = np.stack([0.0 * turned, turned], -1)
    acting = np.random.default_rng(1).normal(size=(rows, 1 + len(AROUND)))  # nor do increments
    reward, end, after = TASK.score(
        truth, acting, scenario, reference, TASK.over(scenario, reference), rudder, 0.0 * rudder,
        before,
    )  # fmt: skip
    np.testing.assert_allclose(after, np.stack([rudder[:, 0], turned], -1))
    return reward, np.array(TASK.end_reasons)[end] == "turn lost"


def test_each_error_and_the_helm_cost_what_is_documented():
    errors = [0.0, 0.05, 0.0, 0.0, 0.0], [0.0, 0.0, 0.15 * 0.03, 0.0, 0.0]
    reward, lost = scored(*errors, [0.0, 0.0, 0.0, 1.0, -0.5])
    expected = [1.0, 0.5, 0.8 + 0.1, 1.0 / 2.25, 1.0 / 1.625]
    np.testing.assert_allclose(reward, expected, rtol=1e-12)
    assert not lost.any()


def test_the_turn_is_lost_a_quarter_turn_off_and_not_before():
    error = np.array([0.0, 1.57, -1.57, 1.571, -1.571, 3.0, 2 * np.pi - 0.1])
    np.testing.assert_array_equal(scored(error, 0.0, 0.0)[1], [0, 0, 0, 1, 1, 1, 0])
