"""Flights along planned paths: following, courses, what the agent may see, and ends."""

from typing import Any

import numpy as np
import pytest
from contract import make_core

from vessel_gym.envs import PunaUAVEnv
from vessel_gym.guidance.dubins import Path, shortest
from vessel_gym.guidance.path_following import ANYWHERE, LEAD, locate
from vessel_gym.guidance.planner import plan
from vessel_gym.models.state_space import StateSpace
from vessel_gym.system import Estimate
from vessel_gym.tasks.flight import ALTITUDE, LENGTH, OBSTACLES, SEGMENTS, Flight
from vessel_gym.vehicles.puna import airspeed

TASK = PunaUAVEnv.system.task
assert isinstance(TASK, Flight)
AIR = PunaUAVEnv.system.disturbances["moderate"]


def padded(path: Any) -> np.ndarray:
    segments = np.zeros((SEGMENTS, 5))
    segments[: len(path.segments)] = path.segments
    return segments.ravel()


def scenarios(n: int, seed: int = 0) -> np.ndarray:
    return TASK.scenario(np.random.default_rng(seed).random((n, TASK.uniforms)), {})


def path_of(scenario: np.ndarray) -> Path:
    rows = scenario[: 5 * SEGMENTS].reshape(SEGMENTS, 5)
    return Path(rows[rows[:, 4] > 0.0])


def obstacles_of(scenario: np.ndarray) -> np.ndarray:
    circles = scenario[-3 * OBSTACLES :].reshape(OBSTACLES, 3)
    return circles[circles[:, 2] > 0.0]


def is_clear(scenario: np.ndarray) -> bool:
    obstacles = obstacles_of(scenario)
    distance = path_of(scenario).distance(obstacles[:, :2])
    return bool((distance >= obstacles[:, 2] + TASK.margin).all())


def at(x: float, y: float, heading: float, altitude: float) -> np.ndarray:
    """State ``(1, 7)`` of level flight at 20 m/s."""
    return np.array([[x, y, altitude, 20.0 * np.cos(heading), 20.0 * np.sin(heading), 0.0, 0.0]])


AHEAD = np.array([20.0, 60.0])  # m


# --- following ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "goal", [(500.0, 300.0, 3.0), (700.0, 0.0, 0.0), (300.0, -400.0, -2.0)], ids=str
)
def test_locate_finds_progress_offset_and_heading(goal: Any):
    path = plan([0.0, 0.0, 0.3], goal, 130.0, [(250.0, 50.0, 40.0)], 20.0)
    s = np.linspace(1.0, path.length - 1.0, 300)
    pose = path.pose(s)
    off = np.random.default_rng(0).uniform(-60.0, 60.0, 300)
    moved = pose + np.stack(
        [-off * np.sin(pose[:, 2]), off * np.cos(pose[:, 2]), np.zeros(300)], -1
    )
    found = locate(moved, ANYWHERE, padded(path), AHEAD)
    np.testing.assert_allclose(found[:, 0], s, atol=1e-8)
    np.testing.assert_allclose(found[:, 1], off, atol=1e-8)
    np.testing.assert_allclose(found[:, 2], pose[:, 2], atol=1e-10)
    np.testing.assert_allclose(found[:, 5], np.abs(off), atol=1e-8)
    # what the path turns through ahead; beyond its end it goes straight on
    np.testing.assert_allclose(
        found[:, 3] * 20.0, path.pose(s + 20.0)[:, 2] - pose[:, 2], atol=1e-8
    )
    np.testing.assert_allclose(
        found[:, 4] * 40.0, path.pose(s + 60.0)[:, 2] - path.pose(s + 20.0)[:, 2], atol=1e-8
    )


def test_beyond_its_ends_the_path_goes_straight_on():
    path = shortest([0.0, 0.0, 0.0], [600.0, 200.0, 1.0], 130.0)
    end = path.pose(path.length)
    ahead = end + [30.0 * np.cos(1.0), 30.0 * np.sin(1.0), 0.0]
    before, after, far = locate(
        np.stack([[-30.0, 2.0, 0.0], ahead, [-200.0, 0.0, 0.0]]), ANYWHERE, padded(path), AHEAD
    )
    np.testing.assert_allclose(before[:2], [-30.0, 2.0], atol=1e-9)
    np.testing.assert_allclose(after[:2], [path.length + 30.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(far[[0, 5]], [-LEAD, 150.0], atol=1e-9)


def crossing() -> np.ndarray:
    """A path that crosses itself at right angles: 100 m ahead, three quarters of a circle, 100 m and more."""
    rows = np.zeros((SEGMENTS, 5))
    rows[0] = 0.0, 0.0, 0.0, 0.0, 200.0
    rows[1] = 200.0, 0.0, 0.0, 0.01, 150.0 * np.pi
    rows[2] = 100.0, 100.0, 1.5 * np.pi, 0.0, 300.0
    return rows.ravel()


def test_rows_of_length_0_have_no_effect():
    poses = np.random.default_rng(0).uniform(-100.0, 400.0, (100, 3))
    rows = crossing().reshape(SEGMENTS, 5)
    padded = np.insert(rows, [1, 2, 3], 0.0, axis=0).ravel()
    for window in (ANYWHERE, np.array([100.0, 500.0, 0.0])):
        np.testing.assert_allclose(
            locate(poses, window, padded, AHEAD), locate(poses, window, rows.ravel(), AHEAD)
        )


def test_heading_decides_at_a_crossing():
    again = 200.0 + 150.0 * np.pi + 100.0
    for off in (-3.0, 0.0, 3.0):
        pose = np.array([[100.0 + off, off, 0.1], [100.0 + off, off, -0.5 * np.pi - 0.1]])
        first, second = locate(pose, ANYWHERE, crossing(), AHEAD)
        assert first[0] == pytest.approx(100.0 + off)
        assert second[0] == pytest.approx(again - off)


def test_progress_window_decides_at_a_crossing():
    for low, high, expected in (
        (50.0, 150.0, 100.0),
        (700.0, 900.0, 300.0 + 150.0 * np.pi),
        (0.0, 60.0, 60.0),
    ):
        found = locate(np.array([100.0, 0.0, 0.0]), np.array([low, high, 0.0]), crossing(), AHEAD)
        assert found[0] == pytest.approx(expected)


# --- courses --------------------------------------------------------------------------------------


def test_drawn_paths_can_be_flown_and_clear_their_obstacles():
    for scenario in scenarios(300):
        path = path_of(scenario)
        assert np.abs(path.segments[:, 3]).max() <= 1.0 / TASK.radius + 1e-12
        assert TASK.distance[0] <= path.length == pytest.approx(scenario[LENGTH])
        assert path.length <= 0.8 * TASK.horizon * TASK.dt * TASK.body.cruise_speed
        assert TASK.altitudes[0] <= scenario[ALTITUDE] <= TASK.altitudes[1]
        np.testing.assert_array_equal(path.segments[0, :2], 0.0)
        joints = [
            Path(path.segments[: k + 1]).pose(end)
            for k, end in enumerate(path.segments[:, 4].cumsum())
        ]
        np.testing.assert_allclose(joints[:-1], path.segments[1:, :3], atol=1e-6)
        np.testing.assert_allclose(TASK.goal(scenario[None])[0], joints[-1], atol=1e-6)
        assert len(obstacles_of(scenario)) == 3
        assert is_clear(scenario)
        sampled = np.pad(path.sample(10.0)[:, :2], ((0, 0), (0, 5)))
        assert TASK.clearance(sampled, scenario).min() >= TASK.margin
        direct = shortest(scenario[:3], TASK.goal(scenario), TASK.radius)
        obstacles = obstacles_of(scenario)
        assert (direct.distance(obstacles[:, :2]) < obstacles[:, 2]).any()


def test_a_scene_may_be_requested():
    obstacles = [(300.0, 10.0, 50.0), (500.0, -90.0, 30.0)]
    start, goal = (10.0, 20.0, 0.1), (700.0, 100.0, 0.5)
    options = {"start": start, "goal": goal, "obstacles": obstacles, "altitude": 150.0}
    scenario = TASK.scenario(np.random.default_rng(0).random((3, TASK.uniforms)), options)
    np.testing.assert_array_equal(scenario[0], scenario[2])
    path = plan(start, goal, TASK.radius, obstacles, TASK.margin)
    np.testing.assert_allclose(path_of(scenario[0]).segments, path.segments)
    np.testing.assert_array_equal(obstacles_of(scenario[0]), obstacles)
    assert scenario[0, ALTITUDE] == 150.0
    np.testing.assert_allclose(TASK.goal(scenario)[0], goal, atol=1e-6)


@pytest.mark.parametrize("radius", [97.5, 130.0])
@pytest.mark.parametrize(
    "given", [{}, {"obstacles": [(300.0, 10.0, 50.0)]}], ids=["drawn", "planned"]
)
def test_turns_of_a_path_have_the_radius_of_the_option(given: dict[str, Any], radius: float):
    uniforms = np.random.default_rng(8).random((20, TASK.uniforms))
    for scenario in TASK.scenario(uniforms, {"radius": radius} | given):
        curvatures = np.abs(path_of(scenario).segments[:, 3])
        assert curvatures.max() == pytest.approx(1.0 / radius)
        assert is_clear(scenario)


BAD = [
    ({"speed": 3.0}, r"unknown reset option 'speed': choose from start, goal, obstacles, altitude, .*"),
    ({"radius": 50.0}, r"radius must be between 96 and 131 m, got 50\.0"),
    ({"radius": 700.0, "obstacles": []}, r"radius must be between 65 and 650 m, got 700\.0"),
    ({"goal": (2000.0, 0.0, 0.0)}, r"the path to the goal must be 130 to 1440 m long, got 20\d\d m"),
    ({"obstacles": [(2e5, 0.0, 30.0)]}, r"obstacles must lie within 100000 m of the origin, got .*"),
    ({"obstacles": 9 * [(400.0, 0.0, 30.0)]}, r"there may be 5 obstacles at most, got 9"),
    ({"obstacles": [(10.0, 0.0, 30.0)]}, r"the start .*obstacle.*"),
    ({"obstacles": [(0.0, 120.0, 90.0), (0.0, -120.0, 90.0), (120.0, 0.0, 90.0), (-120.0, 0.0, 90.0)]},
     r"no path with turns of 130 m or more was found, .*"),
    ({"goal": (-45.0, 0.0, 0.0), "obstacles": []}, r"the path comes back to where it was .*"),
    ({"altitude": 10.0}, r"altitude must be between 50 and 1000 m, got 10\.0"),
]  # fmt: skip


@pytest.mark.parametrize(("options", "sentence"), BAD, ids=range(len(BAD)))
def test_infeasible_scene_is_refused_in_one_sentence(options: dict[str, Any], sentence: str):
    with pytest.raises(ValueError, match=f"^{sentence}$"):
        TASK.scenario(np.full((2, TASK.uniforms), 0.5), options)


def test_airspeed_at_the_start_is_known_whatever_the_wind():
    prior = TASK.prior(scenarios(4))
    sensors = make_core("PunaUAV-v0", 1).config.sensors
    cov = StateSpace.of_world(PunaUAVEnv.system.vehicle, AIR, sensors).joint_prior(prior.cov)
    x = np.random.default_rng(0).standard_normal((20_000, 16)) @ np.linalg.cholesky(cov).T
    fast = airspeed(prior.mean[0] + x[:, :7], AIR.effect(x[:, 7:13], x[:, :7]))
    assert fast.mean() == pytest.approx(20.0, abs=0.02)
    assert fast.std() == pytest.approx(0.5, rel=0.05)
    where = TASK.reference(scenarios(4), np.zeros(4), prior.mean)
    np.testing.assert_allclose(where[:, :3], 0.0, atol=1e-9)


# --- what the agent sees --------------------------------------------------------------------------


def seen_at(truth: np.ndarray, scenario: np.ndarray) -> dict[str, np.ndarray]:
    reference = TASK.reference(scenario, np.zeros(len(truth)), truth)
    known = Estimate(truth, np.zeros((len(truth), 3)))
    cruise = np.tile(TASK.body.cruise, (len(truth), 1))
    return TASK.named(TASK.observe(known, scenario, reference, cruise))


@pytest.mark.parametrize(("off", "above", "turned"), [(0.0, 0.0, 0.0), (7.0, -2.0, -0.3)])
def test_observed_errors_are_those_that_their_names_say(off: float, above: float, turned: float):
    for scenario in scenarios(20, 1):
        s = 0.37 * scenario[LENGTH]
        x, y, heading = path_of(scenario).pose(s)
        x, y = x - off * np.sin(heading), y + off * np.cos(heading)
        truth = at(x, y, heading + turned, scenario[ALTITUDE] + above)
        seen = seen_at(truth, scenario[None])
        expected = {
            "cross-track": off, "altitude error": above, "course sine": np.sin(-turned),
            "course cosine": np.cos(turned), "climb": 0.0, "wind down": 0.0, "bank": 0.0,
            "ground speed error": 0.0, "airspeed error": 0.0, "remaining": scenario[LENGTH] - s,
            "bank of the path": np.arctan(20.0**2 * seen["curvature"][0] / 9.81),
        }  # fmt: skip
        for name, value in expected.items():
            assert seen[name][0] == pytest.approx(value, abs=1e-6), name


STRAIGHT = TASK.scenario(np.zeros((1, TASK.uniforms)), {"obstacles": [(400.0, 100.0, 30.0)]})
"""A straight path of 750 m, and an obstacle to starboard."""


def test_obstacles_are_seen_on_their_side_and_fade_with_distance():
    truth = np.concatenate([at(x, 0.0, 0.0, 100.0) for x in (400.0, 350.0, 100.0)])
    seen = seen_at(truth, np.repeat(STRAIGHT, 3, axis=0))
    np.testing.assert_allclose(seen["obstacles to starboard"][[0, 2]], [0.3, 0.0], atol=1e-9)
    np.testing.assert_allclose(seen["obstacles ahead"][[0, 2]], 0.0, atol=1e-9)
    assert seen["obstacles ahead"][1] > 0.05


# --- ends -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "wind", "expected"),
    [
        ({}, 0.0, ""), ({3: 9.9}, 0.0, "stalled"), ({}, 10.1, "stalled"), ({}, -10.1, ""),
        ({3: 9.9}, -0.2, ""), ({2: -1.0}, 0.0, "crashed"), ({0: 400.0, 1: 69.0}, 0.0, ""),
        ({0: 400.0, 1: 71.0}, 0.0, "hit an obstacle"),
    ],
    ids=str,
)  # fmt: skip
def test_stall_by_airspeed_ground_and_obstacles_end_a_flight(
    change: dict[int, float], wind: float, expected: str
):
    truth = at(300.0, 0.0, 0.0, float(STRAIGHT[0, ALTITUDE]))
    truth[0, list(change)] = list(change.values())
    reference, acting = TASK.reference(STRAIGHT, np.zeros(1), truth), np.eye(1, 7, 4) * wind
    _, end, _ = TASK.score(
        truth, acting, STRAIGHT, reference, np.zeros(1, bool), *np.zeros((2, 1, 3)),
        np.eye(1, 7) * truth[0, 0],
    )  # fmt: skip
    assert TASK.end_reasons[end[0]] == expected
