"""Paths round obstacles: clearance and curvature by sampling, symmetries, strings of known length, closed ways."""

import numpy as np
import pytest

from vessel_gym.guidance.dubins import shortest
from vessel_gym.guidance.planner import plan

SIZE = 20.0
"""Side of the square [turn radii] in which poses and obstacles of a random scene lie."""


def random_scene(rng: np.random.Generator, count: int, largest: float):
    """Start, goal and obstacles ``(count, 3)`` in turn radii, 2 or more between poses and obstacles."""
    start, goal = rng.uniform(0.0, 1.0, (2, 3)) * [SIZE, SIZE, 2.0 * np.pi]
    drawn = rng.uniform([0.0, 0.0, 0.3], [SIZE, SIZE, largest], (100 * count, 3))
    room = [np.hypot(*(drawn[:, :2] - pose[:2]).T) - drawn[:, 2] for pose in (start, goal)]
    return start, goal, drawn[np.min(room, 0) >= 2.0][:count]


def is_clear(path, obstacles: np.ndarray) -> bool:
    return bool((path.distance(obstacles[:, :2]) >= obstacles[:, 2]).all())


@pytest.fixture(scope="module")
def blocked():
    """Scenes in which an obstacle is in the way of the shortest path."""
    rng, scenes = np.random.default_rng(3), []
    while len(scenes) < 20:
        scene = random_scene(rng, 1 + len(scenes) % 8, (0.9, 1.5, 3.0)[len(scenes) % 3])
        if not is_clear(shortest(*scene[:2], 1.0), scene[2]):
            scenes.append(scene)
    return scenes


def trace(path, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions (complex) and headings at most ``spacing`` apart, from start pose, curvatures and lengths alone."""
    z, heading = [complex(*path.segments[0, :2])], [path.segments[0, 2]]
    for curvature, length in path.segments[:, 3:]:
        steps = int(np.ceil(length / spacing)) + 1
        s = length * np.arange(1, steps + 1) / steps
        turn = np.exp(1j * curvature * s)
        along = s if curvature == 0.0 else (turn - 1.0) / (1j * curvature)
        z.extend(z[-1] + np.exp(1j * heading[-1]) * along)
        heading.extend(heading[-1] + curvature * s)
    return np.array(z), np.array(heading)


def assert_sound(path, start, goal, radius: float, obstacles: np.ndarray) -> None:
    """A path joins its poses, keeps clear to 1e-6 and turns no tighter than the radius."""
    z, heading = trace(path, 0.02 * radius)
    assert z[0] == complex(*start[:2])
    assert heading[0] == start[2]
    assert abs(z[-1] - complex(*goal[:2])) < 1e-9 * radius
    assert abs(np.angle(np.exp(1j * (heading[-1] - goal[2])))) < 1e-9
    distance = np.abs(z[:, None] - (obstacles[:, 0] + 1j * obstacles[:, 1]))
    assert (distance.min(0) >= obstacles[:, 2] - 1e-6).all()
    assert radius * np.abs(path.segments[:, 3]).max() <= 1.0 + 1e-9
    ends, headings = trace(path, np.inf)
    joints = path.segments[1:, 0] + 1j * path.segments[1:, 1]
    np.testing.assert_allclose(joints, ends[1:-1], atol=1e-9 * radius)
    np.testing.assert_allclose(path.segments[1:, 2], headings[1:-1], atol=1e-9)
    assert (np.diff(path.segments[:, 3]) != 0.0).all()


# --- random scenes --------------------------------------------------------------------------------


def test_a_plan_is_sound_and_a_clear_shortest_path_is_kept():
    rng, around = np.random.default_rng(0), 0
    for k in range(60):
        start, goal, obstacles = random_scene(rng, 1 + k % 8, (0.9, 1.5, 3.0)[k % 3])
        path, direct = plan(start, goal, 1.0, obstacles), shortest(start, goal, 1.0)
        assert_sound(path, start, goal, 1.0, obstacles)
        if is_clear(direct, obstacles):
            np.testing.assert_array_equal(path.segments, direct.segments)
        else:
            assert path.length > direct.length
            around += 1
    assert around > 5


def test_a_plan_is_as_long_mirrored_backwards_and_scaled(blocked):
    mirror, turn = np.array([1.0, -1.0, -1.0]), np.array([0.0, 0.0, np.pi])
    larger = np.array([100.0, 100.0, 1.0])
    for start, goal, obstacles in blocked:
        expected = pytest.approx(plan(start, goal, 1.0, obstacles).length, rel=1e-6)
        mirrored = plan(start * mirror, goal * mirror, 1.0, obstacles * [1.0, -1.0, 1.0])
        assert mirrored.length == expected
        assert plan(goal + turn, start + turn, 1.0, obstacles).length == expected
        scaled = plan(start * larger, goal * larger, 100.0, obstacles * 100.0)
        assert scaled.length / 100.0 == expected


def test_distance_is_that_of_the_nearest_sample(blocked):
    for start, goal, obstacles in blocked:
        path = shortest(start, goal, 1.0)
        z, _ = trace(path, 1e-3)
        sampled = np.abs(z[:, None] - (obstacles[:, 0] + 1j * obstacles[:, 1])).min(0)
        exact = path.distance(obstacles[:, :2])
        assert (exact <= sampled + 1e-12).all()
        assert (sampled - exact <= 5e-4).all()  # half a spacing


# --- paths whose length is known ------------------------------------------------------------------


@pytest.mark.parametrize("radius", [0.5, 2.5, 6.0])
def test_round_one_obstacle_a_plan_is_nearly_a_taut_string(radius):
    angle = np.arcsin(radius / 10.0)
    string = 2.0 * np.sqrt(100.0 - radius**2) + 2.0 * angle * radius
    path = plan([-10.0, 0.0, angle], [10.0, 0.0, -angle], 1.0, [[0.0, 0.0, radius]])
    assert string - 1e-9 <= path.length <= 1.005 * string


# --- the published case with an obstacle ----------------------------------------------------------

OBSTACLE = np.array([[-250.0, 150.0, 30.0]])


def test_the_obstacle_is_not_in_the_way_of_the_printed_poses():
    for start, goal in ((np.pi / 3, 0.0), (np.pi / 2 - np.pi / 3, np.pi / 2)):  # from x and from y
        poses = [-407.7151, 149.8384, start], [-5.6824, 126.9565, goal]
        assert shortest(*poses, 100.0).distance(OBSTACLE[:, :2])[0] > 30.0


# --- where there is no path, and bad input --------------------------------------------------------


def test_a_ring_of_obstacles_closes_the_way_and_a_gap_opens_it():
    start, goal = np.array([0.0, 0.0, 3.0]), np.array([20.0, 3.0, 1.0])
    bearing = np.arange(12) * np.pi / 6.0
    ring = np.stack([6.0 * np.cos(bearing), 6.0 * np.sin(bearing), np.full(12, 2.0)], -1)
    opened = np.roll(ring, 1, 0)[3:]
    for a, b in ((start, goal), (goal, start)):
        with pytest.raises(ValueError, match="does not prove that there is none"):
            plan(a, b, 1.0, ring)
        assert_sound(plan(a, b, 1.0, opened), a, b, 1.0, opened)
        with pytest.raises(
            ValueError, match="no path"
        ):  # the gap is there, but not with this margin
            plan(a, b, 1.0, opened, margin=3.5)


START, GOAL, DISC = [0.0, 0.0, 0.0], [20.0, 0.0, 0.0], [10.0, 0.0, 2.0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([10.0, 1.0, 0.0], GOAL, 1.0, [[5.0, 9.0, 1.0], DISC]), "start is 1 m inside obstacle 1"),
        ((START, [12.5, 0.0, 0.0], 1.0, [DISC], 1.0), "goal is 0.5 m inside obstacle 0 or its margin: move the goal"),
        ((START, GOAL, 1.0, [DISC, [10.0, 0.0, -2.0]]), "obstacles must have a radius of 0 or more"),
        ((START, GOAL, 1.0, [DISC], -0.1), "margin must be finite and 0 or more"),
    ],
)  # fmt: skip
def test_bad_input_is_refused_in_a_sentence(arguments, message):
    with pytest.raises(ValueError, match=message):
        plan(*arguments)
