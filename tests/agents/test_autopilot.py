"""The autopilot: an LQR design that stands up to an independent one, and flies what it was designed for."""

import gymnasium as gym
import numpy as np
import pytest

from agents import TurningAutopilot, load_agent, rollout
from agents.controllers.turning import Tolerances, gains
from estimators import wrap
from vessel_gym.envs import ThesisCorvetteEnv
from vessel_gym.vehicles.corvette import secant_models, steady_turns
from vessel_gym.vehicles.files import load

ENV = "ThesisCorvette-v0"
SHIP, DT = load("corvette-thesis"), 0.5
SYSTEM = ThesisCorvetteEnv.system


def design_models() -> tuple[np.ndarray, np.ndarray]:
    """``A (k, 5, 5)``, ``B (k, 5, 1)`` of (v, r, psi, rudder, integral of psi) with the rudder rate as the input.

    Built from its meaning: over a step the ship sees the mean of the rudder before and after.
    """
    A_ship, B_ship = secant_models(SHIP, DT)
    travel = SHIP.rudder_rate * DT
    A, B = np.zeros((len(A_ship), 5, 5)), np.zeros((len(A_ship), 5, 1))
    for column in range(5):
        state = np.eye(5)[column]
        A[:, :, column] = _step(A_ship, B_ship, state, 0.0, travel)
    B[:, :, 0] = _step(A_ship, B_ship, np.zeros(5), 1.0, travel)
    return A, B


def _step(A: np.ndarray, B: np.ndarray, state: np.ndarray, rate: float, travel: float) -> np.ndarray:
    ship, rudder, integral = state[:3], state[3], state[4]
    after = rudder + travel * rate
    moved = A @ ship + B[..., 0] * 0.5 * (rudder + after)
    rest = np.tile([after, integral + DT * ship[2]], (len(A), 1))
    return np.concatenate([moved, rest], -1)


@pytest.mark.slow
def test_the_gains_are_those_of_an_independent_riccati_iteration():
    tolerances = Tolerances()
    A, B = design_models()
    weights = [0.0, tolerances.yaw_rate, tolerances.heading, 0.0, tolerances.heading_integral]
    Q = np.diag([1.0 / w**2 if w else 0.0 for w in weights])
    R = np.array([[1.0 / tolerances.rudder_rate**2]])
    P = np.zeros_like(A) + Q
    for _ in range(4000):  # value iteration: the cost of ever more steps to go
        K = np.linalg.solve(R + B.mT @ P @ B, B.mT @ P @ A)
        P = Q + A.mT @ P @ (A - B @ K)
    designed = gains(SHIP, DT, tolerances)
    np.testing.assert_allclose(designed, K[:, 0], rtol=1e-6, atol=1e-8)


@pytest.mark.slow
def test_the_closed_loop_is_stable_and_well_damped_in_every_turn():
    A, B = design_models()
    K = gains(SHIP, DT, Tolerances())
    assert len(K) == len(steady_turns(SHIP).yaw_rate)
    eigenvalues = np.linalg.eigvals(A - B @ K[:, None])
    assert np.abs(eigenvalues).max() < 0.99
    assert np.abs(np.linalg.eigvals(A)).max(-1).min() >= 1.0 - 1e-9  # without the autopilot no turn is held


def test_the_gains_vary_smoothly_from_turn_to_turn():
    K = gains(SHIP, DT, Tolerances())
    steps = np.abs(np.diff(K, axis=0))
    assert (steps < 0.05 * np.abs(K).max(0)).all()


@pytest.mark.slow
@pytest.mark.parametrize("lengths", [2.5, 3.0, 4.0, 5.0, 6.0])
@pytest.mark.parametrize("side", [-1, 1], ids=["to port", "to starboard"])
def test_every_radius_is_held_in_calm_seas(lengths: float, side: int):
    flight = rollout(
        "autopilot", ENV, range(4), {"estimator": "truth", "disturbance": "calm"},
        reset_options={"radius": side * lengths * SHIP.length},
    )  # fmt: skip
    assert not flight.terminated.any()
    assert (flight.length == 600).all()
    truth, reference = flight.history["truth"][-200:], flight.history["reference"][-200:]
    heading = wrap(reference[..., 0] - truth[..., 2])
    assert np.abs(heading).max() < 0.02  # rad; the task's tolerance is 0.05
    assert np.abs(heading.mean(0)).max() < 0.005  # the integral leaves no bias
    rate = reference[-1, :, 3]
    np.testing.assert_array_equal(np.sign(rate), side)
    speed = np.hypot(truth[..., 3], truth[..., 4]).mean(0)
    np.testing.assert_allclose(speed / np.abs(rate), lengths * SHIP.length, rtol=0.02)


def test_with_a_ship_that_differs_from_its_model_the_integral_still_leaves_no_bias():
    flight = rollout(
        "autopilot", ENV, range(30), {"estimator": "truth", "disturbance": "calm", "mismatch": 0.1},
        reset_options={"radius": 4.0 * SHIP.length},
    )  # fmt: skip
    heading = wrap(flight.history["reference"][-200:, :, 0] - flight.history["truth"][-200:, :, 2])
    assert np.abs(heading.mean(0)).max() < 0.005


def observations(seed: int, steps: int, rows: int) -> np.ndarray:
    """Observations from flights, which the autopilot would see."""
    env = gym.make_vec(ENV, num_envs=rows, disturbance="rough")
    agent = load_agent("autopilot", env)
    agent.reset(rows)
    seen = [env.reset(seed=seed)[0]]
    for _ in range(steps):
        seen.append(env.step(agent.act(seen[-1]))[0])
    return np.stack(seen)


def test_mirrored_observations_give_mirrored_actions():
    one, mirror = TurningAutopilot(SYSTEM), TurningAutopilot(SYSTEM)
    one.reset(5)
    mirror.reset(5)
    largest = 0.0
    for seen in observations(0, 200, 5):
        actions = one.act(seen)
        np.testing.assert_array_equal(mirror.act(-seen), -actions)
        largest = max(largest, float(np.abs(actions).max()))
    assert largest > 0.3


def test_it_acts_on_the_observation_alone():
    """The same observations give the same actions whatever happens to any environment in between."""
    seen = observations(1, 60, 3)
    one, other = TurningAutopilot(SYSTEM), TurningAutopilot(SYSTEM)
    one.reset(3)
    expected = [one.act(frame) for frame in seen]
    env = gym.make_vec(ENV, num_envs=3)
    env.reset(seed=99)
    other.reset(3)
    for frame, actions in zip(seen, expected, strict=True):
        env.step(env.action_space.sample())
        np.testing.assert_array_equal(other.act(frame.copy()), actions)


def test_a_batch_of_one_acts_as_its_row_in_a_batch_and_observations_are_not_changed():
    seen = observations(2, 60, 4)
    copy = seen.copy()
    batch = TurningAutopilot(SYSTEM)
    batch.reset(4)
    singles = [TurningAutopilot(SYSTEM) for _ in range(4)]
    for frame in seen:
        actions = batch.act(frame)
        assert actions.shape == (4, 1)
        assert actions.dtype == np.float32
        assert np.abs(actions).max() <= 1.0
        for i, single in enumerate(singles):
            np.testing.assert_allclose(single.act(frame[i : i + 1])[0], actions[i], rtol=0, atol=1e-7)
    np.testing.assert_array_equal(seen, copy)


def test_a_reset_forgets_everything():
    seen = observations(3, 100, 2)
    agent = TurningAutopilot(SYSTEM)
    agent.reset(2)
    first = [agent.act(frame) for frame in seen]
    agent.reset(2)
    np.testing.assert_array_equal([agent.act(frame) for frame in seen], first)
    np.testing.assert_raises(AssertionError, np.testing.assert_array_equal, agent.act(seen[0]), first[0])


def test_the_standard_deviations_of_the_longer_observation_are_not_used():
    seen = observations(4, 30, 2)
    short, long = TurningAutopilot(SYSTEM), TurningAutopilot(SYSTEM)
    short.reset(2)
    long.reset(2)
    for frame in seen:
        longer = np.concatenate([frame, np.full((2, 4), 7.0, np.float32)], -1)
        np.testing.assert_array_equal(long.act(longer), short.act(frame))


def test_raw_readings_are_refused():
    env = gym.make(ENV, observe="measurement")
    with pytest.raises(ValueError, match='the autopilot needs estimates: use observe="mean"'):
        load_agent("autopilot", env)
