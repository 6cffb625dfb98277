"""Dubins paths against an integration and a search of their own, symmetries, and poses at which formulas jump."""

from itertools import product

import numpy as np
import pytest

from vessel_gym.guidance.dubins import (
    CURVATURES,
    WORDS,
    Path,
    chained,
    lengths,
    path_of,
    shortest,
    word_pieces,
)

PAIRS = 400
"""Random pairs of poses in a run of the tests; set 10_000 for the full count, which takes a minute."""
SIDES = {"L": 1.0, "S": 0.0, "R": -1.0}


def word_path(start: np.ndarray, goal: np.ndarray, radius: float, word: str) -> Path:
    """The path of a word."""
    i = WORDS.index(word)
    pieces = word_pieces(start, goal, radius)[i] * radius
    return path_of(chained(start, CURVATURES[i] / radius, pieces))


def random_pairs(n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of poses whose distances cover 0 to 20 turn radii, near ones as often as far ones."""
    rng = np.random.default_rng(seed)
    start = rng.uniform(-1.0, 1.0, (n, 3)) * [10.0, 10.0, np.pi]
    distance, bearing = 20.0 * rng.uniform(size=n) ** 2, rng.uniform(-np.pi, np.pi, n)
    goal = start + np.stack(
        [distance * np.cos(bearing), distance * np.sin(bearing), rng.uniform(-np.pi, np.pi, n)], -1
    )
    return start, goal


def travel(pose: np.ndarray, sides: str | np.ndarray, pieces: np.ndarray) -> np.ndarray:
    """Poses after arcs and straights, by rotation about the centre of each arc; radius 1.

    Args:
        pose: ``(..., 3)``.
        sides: ``(k,)`` letters.
        pieces: ``(..., k)`` lengths.
    """
    z, heading = pose[..., 0] + 1j * pose[..., 1], pose[..., 2]
    for letter, length in zip(sides, np.moveaxis(np.asarray(pieces, float), -1, 0), strict=True):
        side = SIDES[letter]
        if side == 0.0:
            z = z + length * np.exp(1j * heading)
        else:
            centre = z + 1j * side * np.exp(1j * heading)
            z, heading = centre + (z - centre) * np.exp(1j * side * length), heading + side * length
    return np.stack([z.real, z.imag, heading], -1)


def misses(end: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """How far the poses ``(..., 3)`` differ: the largest of x, y and the heading modulo 2 pi."""
    turn = np.angle(np.exp(1j * (end[..., 2] - goal[..., 2])))
    return np.max(
        np.abs(np.stack([end[..., 0] - goal[..., 0], end[..., 1] - goal[..., 1], turn])), 0
    )


# --- the six words --------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("radius", [1.0, 0.3])
def test_every_candidate_reaches_the_goal_in_its_length(radius):
    seen = set()
    for start, goal in zip(*random_pairs(PAIRS, 0), strict=True):
        for word, length in zip(WORDS, lengths(start, goal, radius), strict=True):
            if length == np.inf:
                continue
            path = word_path(start, goal, radius, word)
            assert path.word == word
            assert path.length == pytest.approx(length, rel=1e-14)
            scale = np.array([radius, radius, 1.0])
            end = travel(start / scale, word, path.segments[:, 4] / radius) * scale
            assert misses(end, goal) < 1e-9
            seen.add(word)
    assert seen == set(WORDS)


def test_lengths_are_the_same_backwards_and_in_the_mirror():
    start, goal = random_pairs(100 * PAIRS, 2)
    found, turn, mirror = (
        lengths(start, goal, 1.0),
        np.array([0.0, 0.0, np.pi]),
        np.array([1.0, -1.0, -1.0]),
    )
    swapped = [WORDS.index(word.translate(str.maketrans("LR", "RL"))) for word in WORDS]
    reversed_ = [WORDS.index(word.translate(str.maketrans("LR", "RL"))[::-1]) for word in WORDS]
    np.testing.assert_allclose(
        lengths(start * mirror, goal * mirror, 1.0)[:, swapped], found, rtol=0, atol=1e-9
    )
    np.testing.assert_allclose(
        lengths(goal + turn, start + turn, 1.0)[:, reversed_], found, rtol=0, atol=1e-9
    )


def test_lengths_move_turn_and_scale_with_the_poses():
    start, goal = random_pairs(100 * PAIRS, 3)
    found, angle = lengths(start, goal, 1.0), 2.3
    turn = np.array(
        [[np.cos(angle), np.sin(angle), 0.0], [-np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]]
    )
    moved = [pose @ turn * [50.0, 50.0, 1.0] + [-300.0, 700.0, angle] for pose in (start, goal)]
    np.testing.assert_allclose(lengths(*moved, 50.0), 50.0 * found, rtol=0, atol=50.0 * 1e-9)


# --- where formulas jump by a full circle ---------------------------------------------------------

FRAMES = [
    (0.0, 0.0, 0.0),
    (3.0, -7.0, 0.7),
    (-500.0, 100.0, -2.4),
    (0.1, 0.2, 3.1),
    (1e4, -3e4, 40.0),
]
"""Starts [turn radii, rad] from which the same move is made: each rounds it in its own way."""

frames = pytest.mark.parametrize("start", FRAMES)


@frames
def test_reversed_pose_is_seven_thirds_of_pi_away(start):
    start = np.array(start)
    same = shortest(start, start, 1.0)
    assert (same.length, same.word) == (0.0, "S")
    assert shortest(start, start + [0.0, 0.0, 2.0 * np.pi], 1.0).length == 0.0
    for turn in (np.pi, -np.pi, 3.0 * np.pi):
        assert shortest(start, start + [0.0, 0.0, turn], 1.0).length == pytest.approx(
            7.0 * np.pi / 3.0, abs=1e-9
        )


@pytest.mark.slow
@frames
@pytest.mark.parametrize("word", WORDS)
def test_a_word_that_loses_pieces_is_never_a_circle_too_long(start, word):
    rng = np.random.default_rng(5)
    start = np.array(start)
    for kept in product((0.0, 1.0), repeat=3):
        for _ in range(20):
            pieces = rng.uniform(0.0, 6.0, 3)
            if word[1] != "S":
                pieces[1] = rng.uniform(np.pi, 6.0)
            pieces *= kept
            goal = travel(start, word, pieces)
            assert lengths(start, goal, 1.0)[WORDS.index(word)] <= pieces.sum() + 1e-9
            path = word_path(start, goal, 1.0, word)
            assert misses(path.pose(path.length), goal) < 1e-9


# --- paths ----------------------------------------------------------------------------------------


def test_path_segments_join_and_samples_lie_on_it():
    for start, goal in zip(*random_pairs(50, 6), strict=True):
        path = shortest(start, goal, 1.0)
        pose = start
        for row, letter in zip(path.segments, path.word, strict=True):
            np.testing.assert_allclose(row[:3], pose, rtol=0, atol=1e-12)
            assert row[3] == SIDES[letter]
            pose = travel(pose, letter, row[4:])
        samples = path.sample(0.01)
        chords = np.hypot(*np.diff(samples[:, :2], axis=0).T)
        assert misses(samples[0], start) == 0.0
        assert misses(samples[-1], goal) < 1e-9
        assert chords.max() <= 0.01
        assert chords.sum() == pytest.approx(path.length, rel=1e-5)
        assert (
            np.abs(np.diff(samples[:, 2])).max() <= 0.01 + 1e-12
        )  # heading continuous, no tighter than the radius
        halfway = np.arctan2(*np.diff(samples[:, 1::-1], axis=0).T)
        turned = np.angle(np.exp(1j * (halfway - samples[:-1, 2])))
        assert np.abs(turned).max() <= 0.005 + 1e-9  # and the heading is that of the motion


def test_poses_are_asked_for_at_any_arc_lengths():
    path = shortest([0.0, 0.0, 0.0], [6.0, 3.0, -1.0], 1.0)
    s = np.linspace(0.0, path.length, 12).reshape(3, 4)
    assert path.pose(s).shape == (3, 4, 3)
    lengths = path.segments[:, 4]
    middle = lengths.cumsum() - 0.5 * lengths
    step = 1e-6
    rate = (path.pose(middle + step)[:, 2] - path.pose(middle - step)[:, 2]) / (2.0 * step)
    np.testing.assert_allclose(rate, path.segments[:, 3], rtol=0, atol=1e-8)
    np.testing.assert_array_equal(path.pose(-1.0), path.pose(0.0))
    np.testing.assert_array_equal(path.pose(path.length + 1.0), path.pose(path.length))


# --- the published case without obstacles ---------------------------------------------------------


def test_published_case_is_rsr_from_x_and_rsl_from_y():
    from_x = shortest([-500.0, 100.0, np.pi / 6], [0.0, 200.0, 0.0], 100.0)
    assert from_x.word == "RSR"
    assert from_x.length == pytest.approx(510.6, abs=0.05)
    from_y = shortest([-500.0, 100.0, np.pi / 2 - np.pi / 6], [0.0, 200.0, np.pi / 2], 100.0)
    assert from_y.word == "RSL"
    assert from_y.length == pytest.approx(579.3, abs=0.05)


def test_published_points_are_rsl_tangent_points():
    path = shortest([-500.0, 100.0, np.pi / 3], [0.0, 126.795, 0.0], 100.0)
    assert path.word == "RSL"
    assert path.length == pytest.approx(518.774, abs=5e-4)
    points = path.segments[1:, :2]
    np.testing.assert_allclose(
        points, [[-407.7151, 149.8384], [-5.6824, 126.9565]], rtol=0, atol=5e-4
    )


# --- many at once, and bad input ------------------------------------------------------------------


def test_many_pairs_at_once_are_the_pairs_one_by_one():
    start, goal = random_pairs(24, 7)
    radius = np.linspace(0.5, 3.0, 4)
    batch = lengths(start.reshape(6, 4, 3), goal.reshape(6, 4, 3), radius)
    assert batch.shape == (6, 4, 6)
    for row, a, b, r in zip(batch.reshape(24, 6), start, goal, np.tile(radius, 6), strict=True):
        np.testing.assert_array_equal(lengths(a, b, r), row)
        assert shortest(a, b, r).length == pytest.approx(row.min(), rel=1e-14)
    np.testing.assert_array_equal(lengths(start, goal[0], 1.0)[5], lengths(start[5], goal[0], 1.0))


POSE = [0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: lengths([0.0, np.nan, 0.0], POSE, 1.0), "start must be finite"),
        (lambda: lengths(POSE, POSE, -1.0), "turn radius must be positive"),
        (
            lambda: shortest(np.zeros((2, 3)), np.zeros((2, 3)), 1.0),
            r"start must have shape \(3,\), got \(2, 3\)",
        ),
        (lambda: shortest(POSE, [20.0, 0.0, 0.0], 1.0).sample(0.0), "spacing"),
    ],
)
def test_requests_for_no_single_path_say_what_to_do(call, message):
    with pytest.raises(ValueError, match=message):
        call()
