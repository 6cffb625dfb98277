"""A ship that holds a turning circle: which turns are drawn, what the agent may see, and how it is scored."""

import numpy as np
import pytest
from heading_ship import HEADING_SHIP, SHIP
from scipy.optimize import root
from sensing import assumed

from estimators import Belief, Gaussian, make
from vessel_gym.envs.thesis_corvette import UnknownStep
from vessel_gym.sensors import Sensors
from vessel_gym.system import Estimate
from vessel_gym.vehicles.corvette import steady_turns
from vessel_gym.vehicles.corvette_equations import AROUND, STATE, corvette_rates
from vessel_gym.vehicles.corvette_thesis import ThesisCorvette

L = SHIP.length
TASK = HEADING_SHIP.task
VEHICLE = ThesisCorvette(SHIP, 0.5)


def scenarios(n: int, seed: int = 0) -> np.ndarray:
    return TASK.scenario(np.random.default_rng(seed).random((n, 3)), {})


SENSORS = Sensors(
    VEHICLE.sensors, VEHICLE.state_names, VEHICLE.increments + VEHICLE.ambient_flows, 0.5
)


def started(rows: int, estimator: str = "kf-umv-ui") -> Belief:
    kf = make(estimator, assumed(VEHICLE, "corrected", UnknownStep(), SENSORS)[1])
    n = kf.model.n
    prior = TASK.prior(scenarios(rows))
    return kf.init(Gaussian(prior.mean[:, :n], prior.cov[:n, :n]))


def seen_of(belief: Belief) -> Estimate:
    """What the task sees of a belief that knows of no current."""
    sd, no_flow = np.sqrt(belief.cov.diagonal(0, -2, -1)), np.zeros((len(belief.mean), len(AROUND)))
    input_sd = None if belief.input_cov is None else np.sqrt(belief.input_cov.diagonal(0, -2, -1))
    return Estimate(belief.mean, no_flow, belief.input_mean, sd, input_sd, np.zeros(0))


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


@pytest.mark.parametrize("lengths", [2.5, 3.3, 4.7, 6.0, -2.5, -5.1])
def test_commanded_yaw_rate_is_that_of_the_steady_turn(lengths):
    # Solve for the steady turn at the yaw rate that the task commands; its track must have the
    # radius.
    rate = TASK.track.turning(np.array(1.0 / (lengths * L)))
    assert np.sign(rate) == np.sign(lengths)
    turns = steady_turns(SHIP)

    def residual(z):
        motion = np.array([0.0, 0.0, 0.0, z[0], z[1], abs(float(rate)), 0.0, 0.0])
        return corvette_rates(motion, z[2:], np.zeros(len(AROUND)), SHIP.vector())[3:6] * [
            1.0,
            1.0,
            100.0,
        ]

    guess = [
        np.interp(abs(rate), turns.yaw_rate, column)
        for column in (turns.speed, turns.sway, turns.rudder)
    ]
    surge, sway, _ = root(residual, guess, tol=1e-12).x
    # Between entries of the table; tight turns are sensitive, since the yaw rate hardly rises with
    # more rudder.
    assert np.hypot(surge, sway) / abs(rate) == pytest.approx(abs(lengths) * L, rel=1e-3)


def test_a_turn_radius_may_be_requested():
    uniforms = np.random.default_rng(1).random((5, 3))
    for radius in (300.0, -450.0, 1e4):
        scenario = TASK.scenario(uniforms, {"radius": radius})
        np.testing.assert_array_equal(scenario[:, 1], TASK.track.turning(np.array(1.0 / radius)))
        np.testing.assert_array_equal(
            scenario[:, 0], TASK.scenario(uniforms, {})[:, 0]
        )  # the heading is drawn as ever


@pytest.mark.parametrize("radius", [0.0, 252.0, -252.0, np.inf, -np.inf, np.nan])
def test_a_radius_that_the_ship_cannot_hold_is_refused(radius):
    with pytest.raises(ValueError, match="radius must be 253 to 100000 m"):
        TASK.scenario(np.zeros((1, 3)), {"radius": radius})


# --- what the agent sees --------------------------------------------------------------------------


def test_the_observation_is_scaled_so_that_one_is_a_typical_size():
    rows = seen_of(
        started(1).replace(mean=np.array([[2.0, -0.01, 0.3]]), input_mean=np.array([[0.01]]))
    )
    reference, rudder = np.array([[0.4, 0.0, 0.02, 0.04]]), np.array([[-SHIP.rudder_limit]])
    np.testing.assert_allclose(
        TASK.observe(rows, scenarios(1), reference, rudder), [[1, 1, 1, 1, -1, 0, 0.5]], atol=1e-12
    )


def test_heading_error_is_zero_across_the_cut():
    rows = seen_of(
        started(2).replace(mean=np.array([[0.0, 0.03, np.pi - 0.01], [0.0, 0.03, 3 * np.pi]]))
    )
    reference = np.array([[-np.pi + 0.01, 0.03, 0.03, 0.03], [np.pi, 0.03, 0.03, 0.03]])
    observation = TASK.observe(rows, scenarios(2), reference, np.zeros((2, 1)))
    np.testing.assert_allclose(observation[:, 0], [0.2, 0.0], atol=1e-9)
    np.testing.assert_allclose(observation[:, 1], 0.0, atol=1e-12)


def test_filter_without_unknown_input_shows_zero():
    kf = seen_of(started(3, estimator="kf"))
    assert kf.input_mean is None
    scenario = scenarios(3)
    reference = TASK.command(scenario, np.zeros(3))
    seen = TASK.observe(kf, scenario, reference, np.zeros((3, 1)))
    np.testing.assert_array_equal(seen[:, 3], 0.0)
    np.testing.assert_array_equal(TASK.observe_std(kf)[:, 3], 0.0)


def test_standard_deviations_are_scaled_like_their_means():
    cov = np.tile(np.diag([2.0, 0.01, 0.1]) ** 2, (2, 1, 1))
    rows = seen_of(started(2).replace(cov=cov, input_cov=np.full((2, 1, 1), 0.02**2)))
    np.testing.assert_allclose(TASK.observe_std(rows), [[1, 1, 1, 2]] * 2)


def test_missing_measurements_are_zero_and_the_mask_says_so():
    scenario = np.tile([0.5, 0.03], (3, 1))  # at first the commanded heading is the initial one
    measurements = np.array(
        [[0.4, 0.02], [0.3, 0.02], [0.4, 0.03]]
    )  # whatever is left in a missing one
    available = np.array([[True, True], [False, True], [True, False]])
    observation = TASK.observe_measurements(SENSORS, measurements, available, scenario, np.zeros(3))
    np.testing.assert_allclose(
        observation[:, :4], [[1, 2, 1, 1], [0, 2, 0, 1], [1, 0, 1, 0]], atol=1e-12
    )


# --- score ----------------------------------------------------------------------------------------


def rewarded(truth, reference, action):
    """Reward and whether the turn is lost, of a rudder that goes on turning as the action says; no increment counts."""
    step = SHIP.rudder_rate * TASK.dt * action
    scenario = scenarios(len(truth))
    score_state = TASK.initial_score_state(truth, scenario)
    score_state = score_state + np.concatenate([0.0 * action, action], -1)
    rudder, action = step, np.random.default_rng(0).uniform(-1.0, 1.0, action.shape)
    acting = np.random.default_rng(1).normal(size=(len(truth), 1 + len(AROUND)))
    reward, end, after = TASK.score(
        truth, acting, scenario, reference, TASK.over(scenario, reference), rudder, action,
        score_state,
    )  # fmt: skip
    np.testing.assert_allclose(after, np.concatenate([step, score_state[:, 1:]], -1))
    return reward, np.array(TASK.end_reasons)[end] == "turn lost"


def scored(heading_error, rate_error, action, commanded=0.03):
    """Reward and termination for errors of truth from a reference in the turn."""
    heading_error, rate_error, action = np.broadcast_arrays(
        np.atleast_1d(np.asarray(heading_error, float)), rate_error, action
    )  # fmt: skip
    truth = np.zeros((len(heading_error), len(STATE)))
    truth[:, 2], truth[:, 5] = 1.0 - heading_error, commanded - rate_error
    reference = np.tile(
        [1.0, commanded, 0.5 * commanded, commanded], (len(truth), 1)
    )  # the preview does not count
    return rewarded(truth, reference, np.array(action, float)[:, None])


def test_holding_the_turn_with_the_rudder_still_earns_one():
    reward, terminated = scored(0.0, 0.0, 0.0)
    assert reward == 1.0
    assert not terminated


def test_each_error_and_the_helm_cost_what_is_documented():
    reward, _ = scored([0.05, 0.0, 0.0, 0.0], [0.0, 0.15 * 0.03, 0.0, 0.0], [0.0, 0.0, 1.0, -0.5])
    np.testing.assert_allclose(reward, [0.5, 0.8 + 0.1, 1.0 / 2.25, 1.0 / 1.625], rtol=1e-12)


def test_more_error_never_pays():
    errors = np.linspace(0.0, np.pi, 200)
    for side in (1, -1):
        assert (np.diff(scored(side * errors, 0.0, 0.0)[0]) < 0.0).all()
        assert (np.diff(scored(0.0, side * errors, 0.0)[0]) < 0.0).all()
        assert (np.diff(scored(0.0, 0.0, side * errors / np.pi)[0]) < 0.0).all()


def test_the_turn_is_lost_a_quarter_turn_off_and_not_before():
    error = np.array([0.0, 1.57, -1.57, 1.571, -1.571, 3.0, 2 * np.pi - 0.1])
    _, terminated = scored(error, 0.0, 0.0)
    np.testing.assert_array_equal(terminated, [False, False, False, True, True, True, False])
