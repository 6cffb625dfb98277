"""Flights along planned paths: following, courses, what the agent may see, and how flights are scored."""

from typing import Any

import numpy as np
import pytest
from contract import make_core

from vessel_gym.envs import PunaUAVEnv
from vessel_gym.guidance.dubins import Path, lengths, shortest
from vessel_gym.guidance.path_following import ANYWHERE, LEAD, locate
from vessel_gym.guidance.planner import plan
from vessel_gym.models.state_space import StateSpace
from vessel_gym.system import Estimate
from vessel_gym.tasks.flight import ALTITUDE, OBSTACLES, SEGMENTS, Flight
from vessel_gym.vehicles.puna import STATE, airspeed

TASK = PunaUAVEnv.system.task
assert isinstance(TASK, Flight)
AIR = PunaUAVEnv.system.disturbances["moderate"]
STILL = np.zeros((1, 7))
"""An exogenous input without increments and wind."""


def padded(path: Any) -> np.ndarray:
    segments = np.zeros((SEGMENTS, 5))
    segments[: len(path.segments)] = path.segments
    return segments.ravel()


def scenarios(n: int, seed: int = 0) -> np.ndarray:
    return TASK.scenario(np.random.default_rng(seed).random((n, TASK.uniforms)), {})


def segments_of(scenario: np.ndarray) -> np.ndarray:
    rows = scenario[: 5 * SEGMENTS].reshape(SEGMENTS, 5)
    return rows[rows[:, 4] > 0.0]


def on_path(scenario: np.ndarray, s: float, off: float = 0.0, above: float = 0.0) -> np.ndarray:
    """States ``(1, 7)`` at 20 m/s along the path of a course ``(97,)``, ``off`` metres to starboard of it."""
    path = segments_of(scenario)
    begin = np.concatenate([[0.0], np.cumsum(path[:, 4])])
    k = min(int(np.searchsorted(begin, s, side="right")) - 1, len(path) - 1)
    x, y, heading, curvature, _ = path[k]
    turn = curvature * (s - begin[k])
    chord, middle = (s - begin[k]) * np.sinc(0.5 * turn / np.pi), heading + 0.5 * turn
    heading += turn
    truth = np.zeros((1, len(STATE)))
    truth[0, :2] = (
        x + chord * np.cos(middle) - off * np.sin(heading),
        y + chord * np.sin(middle) + off * np.cos(heading),
    )
    truth[0, 2] = scenario[..., ALTITUDE] + above
    truth[0, 3:5] = 20.0 * np.cos(heading), 20.0 * np.sin(heading)
    return truth


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


def test_absurd_poses_give_finite_answers():
    pose = np.array([[1e300, -1e300, 1e300], [1e300, 0.0, 0.0], [-1e200, 1e200, 5e-324]])
    assert np.isfinite(locate(pose, ANYWHERE, crossing(), AHEAD)).all()


# --- courses --------------------------------------------------------------------------------------


def obstacles_of(scenario: np.ndarray) -> np.ndarray:
    circles = scenario[-3 * OBSTACLES :].reshape(OBSTACLES, 3)
    return circles[circles[:, 2] > 0.0]


def test_drawn_paths_can_be_flown_and_clear_their_obstacles():
    for scenario in scenarios(1000):
        path, obstacles = Path(segments_of(scenario)), obstacles_of(scenario)
        assert np.abs(path.segments[:, 3]).max() <= 1.0 / TASK.radius + 1e-12
        assert TASK.distance[0] <= path.length == pytest.approx(scenario[5 * SEGMENTS])
        assert path.length <= 0.8 * TASK.horizon * TASK.dt * TASK.body.cruise_speed
        assert TASK.altitudes[0] <= scenario[..., ALTITUDE] <= TASK.altitudes[1]
        np.testing.assert_array_equal(path.segments[0, :2], 0.0)
        joints = [
            Path(path.segments[: k + 1]).pose(end)
            for k, end in enumerate(path.segments[:, 4].cumsum())
        ]
        np.testing.assert_allclose(joints[:-1], path.segments[1:, :3], atol=1e-6)
        np.testing.assert_allclose(TASK.goal(scenario[None])[0], joints[-1], atol=1e-6)
        assert len(obstacles) == 3
        assert (path.distance(obstacles[:, :2]) >= obstacles[:, 2] + TASK.margin).all()
        sampled = np.pad(path.sample(10.0)[:, :2], ((0, 0), (0, 5)))
        assert TASK.clearance(sampled, scenario).min() >= TASK.margin


def test_an_obstacle_blocks_the_shortest_path():
    for scenario in scenarios(300):
        direct = shortest(scenario[:3], TASK.goal(scenario), TASK.radius)
        obstacles = obstacles_of(scenario)
        assert (direct.distance(obstacles[:, :2]) < obstacles[:, 2]).any()


def test_a_scene_alone_is_its_row_of_a_batch():
    uniforms = np.random.default_rng(5).random((20, TASK.uniforms))
    rows = [TASK.scenario(row[None], {})[0] for row in uniforms]
    np.testing.assert_array_equal(TASK.scenario(uniforms, {}), rows)


@pytest.mark.parametrize("goal", [(700.0, 0.0, 0.0), (150.0, 0.0, 3.0), (-90.0, -90.0, 1.0)])
def test_a_scene_between_given_poses_keeps_clear_of_obstacles(goal: Any):
    options, start = {"start": (0.0, 0.0, 0.0), "goal": goal}, np.zeros(3)
    for scenario in TASK.scenario(np.random.default_rng(6).random((50, TASK.uniforms)), options):
        path, obstacles = Path(segments_of(scenario)), obstacles_of(scenario)
        np.testing.assert_array_equal(path.segments[0, :3], start)
        np.testing.assert_allclose(path.pose(path.length)[:2], goal[:2], atol=1e-6)
        assert (path.distance(obstacles[:, :2]) >= obstacles[:, 2] + TASK.margin).all()


@pytest.mark.parametrize(
    "options",
    [
        {"start": (0.0, 0.0, 0.0), "goal": (200.0, 0.0, 0.0)},
        {"start": (0.0, 0.0, 0.0), "goal": (300.0, 0.0, 0.0)},
        {"goal": (150.0, 0.0, 0.0)},
    ],
    ids=str,
)
def test_near_poses_give_a_scene_for_every_seed(options: Any):
    uniforms = np.random.default_rng(2).random((64, TASK.uniforms))
    drawn = TASK.scenario(uniforms, options)
    goal = TASK.goal(drawn)
    direct = lengths(drawn[:, :3], goal, TASK.radius).min(-1)
    farthest = 0.8 * TASK.horizon * TASK.dt * TASK.body.cruise_speed
    np.testing.assert_allclose(goal[:, :2], np.tile(options["goal"][:2], (64, 1)), atol=1e-6)
    for scenario, shortest_length in zip(drawn, direct, strict=True):
        path, obstacles = Path(segments_of(scenario)), obstacles_of(scenario)
        assert shortest_length - 1e-6 <= path.length <= farthest
        assert (path.distance(obstacles[:, :2]) >= obstacles[:, 2] + TASK.margin).all()


def test_a_scene_may_be_requested():
    obstacles = [(300.0, 10.0, 50.0), (500.0, -90.0, 30.0)]
    options = {
        "start": (10.0, 20.0, 0.1),
        "goal": (700.0, 100.0, 0.5),
        "obstacles": obstacles,
        "altitude": 150.0,
    }
    scenario = TASK.scenario(np.random.default_rng(0).random((3, TASK.uniforms)), options)
    np.testing.assert_array_equal(scenario[0], scenario[2])
    path = plan(options["start"], options["goal"], TASK.radius, obstacles, TASK.margin)
    np.testing.assert_allclose(segments_of(scenario[0]), path.segments)
    assert (
        path.distance(np.array(obstacles)[:, :2]) >= np.array(obstacles)[:, 2] + TASK.margin
    ).all()
    assert scenario[0][..., ALTITUDE] == 150.0
    np.testing.assert_allclose(TASK.goal(scenario)[0], options["goal"], atol=1e-6)
    clear = TASK.scenario(np.zeros((1, TASK.uniforms)), {"obstacles": []})
    np.testing.assert_allclose(segments_of(clear[0]), [[0.0, 0.0, 0.0, 0.0, 750.0]], atol=1e-9)


BAD = [
    ({"speed": 3.0}, r"unknown reset option 'speed': choose from start, goal, obstacles, altitude"),
    ({"start": (0.0, np.nan, 0.0)}, r"start must be three numbers within \+-100000, metres x and y and rad, got .*"),
    ({"goal": (2000.0, 0.0, 0.0)}, r"the path to the goal must be 130 to 1440 m long, got 20\d\d m"),
    ({"obstacles": 3.0}, r"obstacles must have shape \(m, 3\), got \(\)"),
    ({"obstacles": [(1.0, 2.0, -3.0)]}, r"obstacles must have a radius of 0 or more, got .*"),
    ({"obstacles": [(1.0, np.nan, 3.0)]}, r"obstacles must be finite, got .*"),
    ({"obstacles": 9 * [(400.0, 0.0, 30.0)]}, r"there may be 5 obstacles at most, got 9"),
    ({"obstacles": [(10.0, 0.0, 30.0)]}, r"the start .*obstacle.*"),
    ({"obstacles": [(0.0, 120.0, 90.0), (0.0, -120.0, 90.0), (120.0, 0.0, 90.0), (-120.0, 0.0, 90.0)]},
     r"no path with turns of 130 m or more was found, .*"),
    ({"goal": (-45.0, 0.0, 0.0), "obstacles": []}, r"the path comes back to where it was .*"),
    ({"start": (0.0, 0.0, 0.0), "goal": (-20.0, 0.0, 0.0)}, r"the path comes back to where it was .*"),
    ({"start": (0.0, 0.0, 0.0), "goal": (100.0, 0.0, 0.0)}, r"the path to the goal must be 130 .* got 100 m"),
    ({"altitude": 10.0}, r"altitude must be between 50 and 1000 m, got 10\.0"),
]  # fmt: skip


@pytest.mark.parametrize(("options", "sentence"), BAD, ids=lambda value: str(value)[:40])
def test_infeasible_scene_is_refused_in_one_sentence(options: dict[str, Any], sentence: str):
    with pytest.raises(ValueError, match=f"^{sentence}$"):
        TASK.scenario(np.full((2, TASK.uniforms), 0.5), options)


# --- the start ------------------------------------------------------------------------------------


def test_the_prior_flies_along_the_path_through_an_unknown_wind():
    scenario = scenarios(4)
    prior = TASK.prior(scenario)
    sensors = make_core("PunaUAV-v0", 1).config.sensors
    space = StateSpace.of_world(PunaUAVEnv.system.vehicle, AIR, sensors)
    cov = space.joint_prior(prior.cov)
    assert cov.shape == (16, 16)
    assert np.linalg.eigvalsh(cov).min() > 0.0
    x = np.random.default_rng(0).standard_normal((20_000, 16)) @ np.linalg.cholesky(cov).T
    z = x[:, 7:13]
    fast = airspeed(prior.mean[0] + x[:, :7], AIR.effect(z, x[:, :7]))
    np.testing.assert_allclose(
        np.std(z, axis=0), np.sqrt(np.diag(AIR.process.start_cov)), rtol=0.03
    )
    np.testing.assert_allclose(np.std(x[:, 13:], axis=0), 0.1, rtol=0.03)  # of the GNSS's bias
    assert fast.mean() == pytest.approx(20.0, abs=0.02)
    assert fast.std() == pytest.approx(0.5, rel=0.05)  # airspeed is known, whatever the wind
    where = TASK.reference(scenario, np.zeros(4), prior.mean)
    np.testing.assert_allclose(where[:, :3], 0.0, atol=1e-9)


# --- what the agent sees --------------------------------------------------------------------------


def seen_at(truth: np.ndarray, scenario: np.ndarray) -> dict[str, np.ndarray]:
    reference = TASK.reference(scenario, np.zeros(len(truth)), truth)
    known = Estimate(truth, np.zeros((len(truth), 3)))
    cruise = np.tile(TASK.body.cruise, (len(truth), 1))
    return TASK.named(TASK.observe(known, scenario, reference, cruise))


def test_on_the_path_every_observed_error_is_zero():
    for scenario in scenarios(20, 1):
        s = 0.37 * scenario[5 * SEGMENTS]
        seen = seen_at(on_path(scenario, s), scenario[None])
        for name in ("cross-track", "altitude error", "course sine", "climb", "wind down", "bank"):
            assert seen[name][0] == pytest.approx(0.0, abs=1e-6), name
        assert seen["course cosine"][0] == pytest.approx(1.0)
        assert seen["ground speed error"][0] == pytest.approx(0.0, abs=1e-12)
        assert seen["airspeed error"][0] == pytest.approx(0.0, abs=1e-12)
        assert seen["remaining"][0] == pytest.approx(scenario[5 * SEGMENTS] - s)
        assert np.tan(seen["bank of the path"][0]) == pytest.approx(
            20.0**2 * seen["curvature"][0] / 9.81
        )


def test_errors_have_the_signs_that_their_names_say():
    scenario = scenarios(1, 2)
    truth = on_path(scenario[0], 100.0, off=7.0, above=-2.0)
    seen = seen_at(truth, scenario)
    assert seen["cross-track"][0] == pytest.approx(7.0)
    assert seen["altitude error"][0] == pytest.approx(-2.0)
    turned = truth.copy()
    cos, sin = np.cos(-0.3), np.sin(-0.3)  # to port of the path's course
    turned[0, 3:5] = cos * truth[0, 3] - sin * truth[0, 4], sin * truth[0, 3] + cos * truth[0, 4]
    assert seen_at(turned, scenario)["course sine"][0] == pytest.approx(np.sin(0.3))


def test_obstacles_are_seen_on_their_side_and_fade_with_distance():
    scenario = TASK.scenario(np.zeros((1, TASK.uniforms)), {"obstacles": [(400.0, 100.0, 30.0)]})
    truth = np.zeros((3, 7))
    truth[:, 0], truth[:, 2], truth[:, 3] = [400.0, 350.0, 100.0], scenario[..., ALTITUDE], 20.0
    seen = seen_at(truth, np.repeat(scenario, 3, axis=0))
    np.testing.assert_allclose(
        seen["obstacles to starboard"][[0, 2]], [1.0 - 70.0 / 100.0, 0.0], atol=1e-9
    )
    np.testing.assert_allclose(seen["obstacles ahead"][[0, 2]], 0.0, atol=1e-9)
    assert seen["obstacles ahead"][1] > 0.05


# --- the score ------------------------------------------------------------------------------------


def flown(
    scenario: np.ndarray, places: list[tuple[float, float, float]], action: float = 0.0
) -> tuple[float, str]:
    """Score and end of a flight through places (progress, off, above) of a course ``(97,)``."""
    scenario, total = scenario[None], 0.0
    score_state = TASK.initial_score_state(on_path(scenario[0], places[0][0]), scenario)
    for k, place in enumerate(places):
        truth = on_path(scenario[0], *place)
        reference = TASK.reference(scenario, np.zeros(1), truth)
        command = np.full((1, 3), action * (-1) ** k)
        reward, end, score_state = TASK.score(
            truth, STILL, scenario, reference, TASK.over(scenario, reference), np.zeros((1, 3)),
            command, score_state,
        )  # fmt: skip
        assert 0.0 <= reward[0] <= 1.0
        total += reward[0]
        if end[0]:
            return total, TASK.end_reasons[end[0]]
    return total, ""


def along(
    scenario: np.ndarray, step: float = 2.0, off: float = 0.0, above: float = 0.0
) -> list[Any]:
    return [(s, off, above) for s in np.arange(0.0, scenario[5 * SEGMENTS] + step + 1e-6, step)]


@pytest.mark.slow
def test_a_perfect_flight_scores_one_and_ends_by_arriving():
    for scenario in scenarios(5, 3):
        score, end = flown(scenario, along(scenario))
        assert end == "arrived"
        assert score == pytest.approx(1.0, abs=0.02)


def test_errors_cost_and_half_is_lost_at_the_tolerances():
    scenario = scenarios(1, 4)[0]
    best = flown(scenario, along(scenario)[:100])[0]
    assert flown(scenario, along(scenario, off=3.0)[:100])[0] == pytest.approx(0.5 * best, rel=0.03)
    assert flown(scenario, along(scenario, above=1.5)[:100])[0] == pytest.approx(
        0.5 * best, rel=0.03
    )


def test_commands_that_jump_cost_without_bound():
    """Travel and reversals of a command that jumps by ``2 a`` each step: ``1.25 a + 4 a``, relative to 1."""
    scenario = scenarios(1, 4)[0]
    best, *jumpy = (
        flown(scenario, along(scenario)[:100], action=a)[0] for a in (0.0, 0.1, 0.5, 1.0)
    )
    np.testing.assert_allclose(jumpy, best / (1.0 + 5.25 * np.array([0.1, 0.5, 1.0])), rtol=0.02)


@pytest.mark.slow
def test_dawdling_circling_and_going_back_pay_nothing():
    scenario = scenarios(1, 5)[0]
    straight = along(scenario)
    dawdling = [place for place in straight for _ in range(3)]
    back = straight[:100] + straight[60:100][::-1] + straight[60:]
    best = flown(scenario, straight)[0]
    assert flown(scenario, dawdling)[0] <= best + 1e-12
    assert flown(scenario, back)[0] <= best + 1e-12
    assert flown(scenario, along(scenario, step=3.9))[0] <= best + 0.02


def test_a_short_cut_to_the_goal_forgoes_the_path():
    scenario = scenarios(1, 6)[0]
    places = along(scenario)
    score, end = flown(scenario, places[:50] + places[-20:])
    assert end in ("off the path", "arrived")
    assert score < 0.3


def test_every_end_has_its_reason():
    scenario = TASK.scenario(np.zeros((1, TASK.uniforms)), {"obstacles": [(400.0, 100.0, 30.0)]})
    base = on_path(scenario[0], 300.0)
    cases = {"": {}, "off the path": {1: 120.0}, "off the altitude": {2: 41.0}, "stalled": {3: 8.0}}
    for expected, change in cases.items():
        truth = base.copy()
        for i, value in change.items():
            truth[0, i] = value + (truth[0, i] if i == 2 else 0.0)
        assert ending(scenario, truth, truth) == expected
    low = base.copy()
    low[0, 2] = -1.0
    assert ending(scenario, low, low) == "crashed"
    hit = base.copy()
    hit[0, :2] = 400.0, 80.0
    assert ending(scenario, hit, base) == "hit an obstacle"
    there = on_path(scenario[0], 750.0 + 1.0)
    assert ending(scenario, there, there) == "arrived"
    assert ending(scenario, base, there) == "missed the goal"


def test_stall_is_by_airspeed_not_ground_speed():
    scenario = scenarios(1, 7)
    truth = on_path(scenario[0], 300.0)
    along, against = STILL.copy(), STILL.copy()
    along[0, 4:6], against[0, 4:6] = 0.6 * truth[0, 3:5], -0.6 * truth[0, 3:5]
    reference, score_state = TASK.reference(scenario, np.zeros(1), truth), np.eye(1, 7) * 290.0
    ends = [TASK.end_reasons[TASK.score(truth, wind, scenario, reference, np.zeros(1, bool), np.zeros((1, 3)),
    np.zeros((1, 3)), score_state)[1][0]]
            for wind in (STILL, along, against)]  # fmt: skip
    assert ends == ["", "stalled", ""]


def ending(scenario: np.ndarray, truth: np.ndarray, believed: np.ndarray) -> str:
    reference = TASK.reference(scenario, np.zeros(1), believed)
    score_state = np.eye(1, 7) * 290.0 if truth[0, 0] < 700.0 else np.eye(1, 7) * 740.0
    return TASK.end_reasons[
        TASK.score(
            truth,
            STILL,
            scenario,
            reference,
            TASK.over(scenario, reference),
            np.zeros((1, 3)),
            np.zeros((1, 3)),
            score_state,
        )[1][0]
    ]
