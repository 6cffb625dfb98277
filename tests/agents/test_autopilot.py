"""The autopilot: an LQR design that stands up to an independent one, and flies what it was designed for."""

import numpy as np
import pytest
from heading_ship import HEADING_SHIP

from agents import rollout
from agents.controllers.turning import Tolerances, gains
from estimators import wrap
from vessel_gym.vehicles.corvette import secant_models, steady_turns
from vessel_gym.vehicles.files import load

ENV = HEADING_SHIP.name
SHIP, DT = load("corvette-thesis"), 0.5
SYSTEM = HEADING_SHIP


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
