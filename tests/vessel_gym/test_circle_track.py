"""The track of a turning circle: its geometry, what is seen of it, and that nothing but holding it pays."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

from vessel_gym.envs import SigmaCorvetteEnv
from vessel_gym.tasks.circle_track import CURVATURE, SPEED
from vessel_gym.tasks.track import BELIEVED, OFF, RATE_NOW, TRACK, WANTED
from vessel_gym.vehicles.corvette import steady_turns

TASK = SigmaCorvetteEnv.system.task
SHIP = TASK.ship


def scenarios(count: int, seed: int = 0) -> np.ndarray:
    return TASK.scenario(np.random.default_rng(seed).random((count, 3)), {})


def integrated(scenario: np.ndarray, along: float) -> np.ndarray:
    """Place and direction, by quadrature of the direction along the track."""
    lead, ramp = TASK.lead * SHIP.speed, 0.5 * TASK.ramp * (SHIP.speed + scenario[SPEED])

    def forward(s: float, at: np.ndarray) -> list[float]:
        share = min(max((s - lead) / ramp, 0.0), 1.0)
        return [np.cos(at[2]), np.sin(at[2]), scenario[CURVATURE] * share]

    start = [0.0, 0.0, scenario[0]]
    pieces = [0.0, *(edge for edge in (lead, lead + ramp) if edge < along), along]
    for low, high in pairwise(pieces):
        start = solve_ivp(forward, (low, high), start, rtol=1e-10, atol=1e-8).y[:, -1]
    return np.asarray(start)


def test_the_track_is_a_straight_a_clothoid_and_a_circle():
    for scenario in scenarios(6):
        for along in (30.0, 77.0, 200.0, 400.0, 900.0, 2500.0):
            pose = TASK.track(scenario[None], np.array([along]))
            expected = integrated(scenario, along)
            assert np.abs(pose[0, :2] - expected[:2]).max() < 0.05
            assert pose[0, 2] == pytest.approx(expected[2], abs=1e-6)


def on_track(scenario: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Poses ``(B, 3)`` at a step of ships that keep to track and speed."""
    return TASK.track(scenario, TASK.nominal_distance(scenario, step))


def test_the_nearest_point_is_nearest():
    """Against a search along the track, from places up to 80 m off."""
    rng = np.random.default_rng(1)
    for scenario in scenarios(20):
        step = rng.integers(0, 600)
        place = on_track(scenario[None], np.array([step]))[0, :2] + rng.uniform(-80.0, 80.0, 2)
        state = np.zeros((1, 6))
        state[0, :2] = place
        reference = TASK.reference(scenario[None], np.array([step]), state)[0]

        def distance(s: float, scenario: np.ndarray = scenario, place: np.ndarray = place) -> float:
            return float(np.hypot(*(TASK.track(scenario[None], np.array([s]))[0, :2] - place)))

        over = TASK.lead + TASK.ramp
        sailed = over * SHIP.speed + scenario[SPEED] * (step * TASK.dt - over)
        guesses = np.linspace(max(sailed - 600.0, 0.0), sailed + 600.0, 241)
        near = guesses[np.argmin([distance(s) for s in guesses])]
        along = minimize_scalar(
            distance, bounds=(max(near - 10.0, 0.0), near + 10.0), method="bounded"
        ).x
        if along < 1.0:
            continue  # before the track begins, its straight goes on backwards
        assert abs(reference[OFF]) == pytest.approx(distance(along), abs=0.1)
        direction = TASK.track(scenario[None], np.array([along]))[0, 2]
        assert np.cos(reference[TRACK] - direction) > 1.0 - 1e-6
        point = TASK.track(scenario[None], np.array([along]))[0, :2]
        starboard = np.array([-np.sin(direction), np.cos(direction)])
        assert np.sign(reference[OFF]) == np.sign((place - point) @ starboard)


def test_ship_on_the_track_has_no_error_and_commanded_rate():
    scenario, steps = scenarios(5), np.arange(0, 600, 7)
    for step in steps:
        at = np.full(5, step)
        state = on_track(scenario, at)
        reference = TASK.reference(scenario, at, state)
        assert np.abs(reference[:, OFF]).max() < 0.05
        assert np.abs(np.sin(reference[:, TRACK] - state[:, 2])).max() < 1e-3
        assert (reference[:, BELIEVED] == state[:, 2]).all()
    assert reference[:, RATE_NOW] == pytest.approx(scenario[:, 1], rel=1e-9)
    # In a turn to starboard the ship's head points inside of her track.
    assert (
        np.sin(reference[:, WANTED] - reference[:, TRACK]) * np.sign(scenario[:, 1]) > 0.02
    ).all()


def test_a_perfect_step_in_the_turn_is_worth_one():
    scenario, along = scenarios(1), np.array([1200.0])
    pose = TASK.track(scenario, along)
    turns, side = steady_turns(SHIP), np.sign(scenario[0, 1])
    u, v = (
        np.interp(abs(scenario[0, 1]), turns.yaw_rate, each) for each in (turns.speed, turns.sway)
    )
    state, kept = np.zeros((1, 8)), np.zeros((1, 4))
    state[0, :2], state[0, 2] = pose[0, :2], pose[0, 2] - np.arctan2(side * v, u)
    state[0, 3:6] = u, side * v, scenario[0, 1]
    kept[0, :2] = along - scenario[0, SPEED] * TASK.dt

    def reward(state: np.ndarray) -> float:
        still = np.zeros((1, 8)), scenario, np.zeros((1, 8)), np.zeros(1, bool)
        return TASK.score(state, *still, *np.zeros((2, 1, 1)), kept)[0][0]

    assert reward(state) == pytest.approx(1.0, abs=1e-3)
    slower = state * [1.0, 1.0, 1.0, 1.0, 1.0, 0.85, 1.0, 1.0]
    assert reward(slower) == pytest.approx(0.8, abs=0.01)
