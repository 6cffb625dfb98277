"""The path of a dive: its closed forms stand up to brute force, its derivatives to its positions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from vessel_gym.guidance.dive_path import arc_to, follow, path_point
from vessel_gym.guidance.path_following import LEAD

ANGLES = st.floats(-5.5, 5.5)  # rad: up to seven eighths of a circle
LENGTHS = st.floats(5.0, 200.0)  # m
DEPTHS = st.floats(0.0, 30.0)  # m
ARCS = st.tuples(ANGLES, LENGTHS, DEPTHS).map(np.array)
SOME = np.array(
    [[1.2, 22.0, 6.0], [-2.0, 30.0, 4.0], [0.0, 60.0, 20.0], [4.5, 80.0, 10.0], [-1e-7, 25.0, 5.0]]
)
DIVES = pytest.mark.parametrize("arc", SOME, ids=lambda arc: f"{arc[0]:g} rad")
LAW = settings(derandomize=True, deadline=None)


def beside(s: np.ndarray, cross: np.ndarray, below: np.ndarray, arc: np.ndarray) -> np.ndarray:
    """Positions ``(..., 3)`` off the path at s, by ``cross`` metres to starboard and ``below``."""
    x, y, z, heading, _ = np.moveaxis(path_point(s, arc), -1, 0)
    return np.stack(
        np.broadcast_arrays(x - cross * np.sin(heading), y + cross * np.cos(heading), z + below), -1
    )


# --- the path itself ------------------------------------------------------------------------------


@LAW
@given(ARCS)
def test_the_path_leaves_the_origin_and_arrives_level(arc: np.ndarray):
    angle, length, depth = arc
    np.testing.assert_allclose(path_point(0.0, arc), np.zeros(5), atol=1e-12)
    end = path_point(length, arc)
    np.testing.assert_allclose(
        end[2:], [depth, angle, 0.0], rtol=1e-12, atol=1e-6
    )  # 1e-9 per metre of curvature


@LAW
@given(st.floats(2.0, 100.0), st.floats(-2.7, 2.7), DEPTHS)
def test_the_course_to_a_goal_reaches_it(distance: float, bearing: float, depth: float):
    goal = np.array([distance * np.cos(bearing), distance * np.sin(bearing), depth])
    arc = arc_to(goal)
    np.testing.assert_allclose(path_point(arc[1], arc)[:3], goal, rtol=0, atol=1e-6 * distance)
    assert arc[0] == pytest.approx(
        2.0 * bearing, abs=1e-12
    )  # a tangent and its chord: half the angle


@DIVES
def test_heading_and_slope_are_the_derivatives_of_the_position(arc: np.ndarray):
    length = arc[1]
    s, h = np.linspace(-5.0, length + 5.0, 400), 1e-4
    s = s[(np.abs(s) > h) & (np.abs(s - length) > h)]  # at the ends the slope has a corner
    point = path_point(s, arc)
    rate = (path_point(s + h, arc) - path_point(s - h, arc)) / (2.0 * h)
    np.testing.assert_allclose(rate[:, 0], np.cos(point[:, 3]), atol=1e-7)
    np.testing.assert_allclose(rate[:, 1], np.sin(point[:, 3]), atol=1e-7)
    np.testing.assert_allclose(rate[:, 2], point[:, 4], atol=1e-7)
    inside = (s > h) & (s < length - h)
    np.testing.assert_allclose(rate[inside, 3], arc[0] / length, atol=2e-9)
    np.testing.assert_array_equal(rate[~inside, 3:], 0.0)


@LAW
@given(ARCS, st.floats(0.0, 100.0))
def test_beyond_its_ends_the_path_goes_on_straight_and_level(arc: np.ndarray, beyond: float):
    for end, step in ((0.0, -beyond), (arc[1], beyond)):
        point, there = path_point(end, arc), path_point(end + step, arc)
        straight = point + step * np.array([np.cos(point[3]), np.sin(point[3]), 0.0, 0.0, 0.0])
        straight[4] = 0.0
        np.testing.assert_allclose(there, straight, rtol=0, atol=1e-9)


@LAW
@given(LENGTHS, DEPTHS, st.floats(-3.0, 210.0))
def test_a_path_that_hardly_turns_is_the_straight_one(length: float, depth: float, s: float):
    straight = path_point(s, np.array([0.0, length, depth]))
    on = np.clip(s / length, 0.0, 1.0)
    np.testing.assert_allclose(
        straight[:3], [s, 0.0, depth * on**2 * (3 - 2 * on)], rtol=1e-12, atol=1e-4
    )
    for angle in (1e-14, -1e-10, 1e-8, 1e-6):  # no digits are lost on the way to zero
        bent = path_point(s, np.array([angle, length, depth]))
        curve = 0.5 * angle / length * min(max(s, 0.0), length) ** 2 + angle * max(s - length, 0.0)
        np.testing.assert_allclose(bent[:3], straight[:3] + [0.0, curve, 0.0], rtol=0, atol=5e-5)


# --- where a position is relative to it -----------------------------------------------------------


@pytest.mark.slow
@LAW
@given(ARCS, st.floats(-1.0, 2.0), st.floats(-0.9, 0.9), st.floats(-10.0, 10.0))
def test_a_position_off_the_path_is_found_again(
    arc: np.ndarray, share: float, off: float, below: float
):
    angle, length, _ = arc
    radius = length / max(abs(angle), 1e-9)
    s, cross = np.clip(share * length, -LEAD, length + LEAD), off * min(radius, 20.0)
    if not 0.0 <= share <= 1.0:  # abreast of the straight pieces the arc may come nearer
        s, cross = (s if abs(angle) < 0.5 else np.clip(s, 0.0, length)), 0.2 * cross
    seen = follow(beside(s, cross, below, arc), arc, 0.0)
    scale = 1e-7 * (1.0 + length)
    np.testing.assert_allclose(seen[:3], [s, cross, below], rtol=0, atol=scale)
    np.testing.assert_allclose(seen[3:5], path_point(seen[0], arc)[3:], rtol=0, atol=1e-9)


@pytest.mark.slow
@DIVES
def test_ends_are_passed_only_behind_the_start_or_past_the_end(arc: np.ndarray):
    """Even across the circle from the arc, where progress jumps from one end to the other."""
    length = arc[1]
    north, east = np.meshgrid(np.linspace(-90.0, 90.0, 91), np.linspace(-90.0, 90.0, 91))
    position = np.stack([north, east, 0.0 * north], -1).reshape(-1, 3)
    progress, cross = follow(position, arc, 0.0)[:, :2].T
    end = path_point(length, arc)
    onward = (position - end[:3]) @ [np.cos(end[3]), np.sin(end[3]), 0.0]
    before, after = progress < 0.0, progress > length
    np.testing.assert_allclose(progress[before], np.maximum(position[before, 0], -LEAD))
    np.testing.assert_allclose(progress[after] - length, np.minimum(onward[after], LEAD))
    points = path_point(np.linspace(0.0, length, 2001), arc)[:, :2]
    nearest = cKDTree(points).query(position[:, :2])[0]
    there = path_point(progress, arc)[:, :2]
    on = (progress >= 0.0) & (progress <= length)
    assert 100 < on.sum() < len(on)
    np.testing.assert_allclose(
        np.hypot(*(position[:, :2] - there).T)[on], nearest[on], rtol=0, atol=2e-2
    )
    inside = (progress > 0.0) & (progress < length)
    np.testing.assert_allclose(np.abs(cross[inside]), nearest[inside], rtol=0, atol=2e-2)


@LAW
@given(ARCS, st.floats(-0.5, 1.5), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(0.0, 30.0))
def test_the_vector_ahead_leads_to_the_path(
    arc: np.ndarray, share: float, cross: float, below: float, ahead: float
):
    position = beside(share * arc[1], cross, below, arc)
    seen = follow(position, arc, ahead)
    target = path_point(seen[0] + ahead, arc)[:3]
    np.testing.assert_allclose(position + seen[5:], target, rtol=0, atol=1e-9 * (1.0 + arc[1]))
    np.testing.assert_array_equal(
        seen[:5], follow(position, arc, 0.0)[:5]
    )  # the rest does not depend on it


@DIVES
def test_progress_goes_on_steadily_across_the_ends(arc: np.ndarray):
    length = arc[1]
    for cross in (-1.0, 0.0, 2.0):
        for end in (0.0, length):
            s = end + np.linspace(-1e-3, 1e-3, 21)
            seen = follow(beside(s, cross, 0.5, arc), arc, 2.0)
            np.testing.assert_allclose(seen[:, 0], s, rtol=0, atol=1e-8)
            assert np.abs(np.diff(seen, axis=0)).max() < 1e-3


def test_positions_far_away_give_finite_numbers():
    for scale in (1e3, 1e6, 1e12, 1e100, 1e150):
        rng = np.random.default_rng(0)
        position = scale * rng.normal(size=(200, 1, 3))
        seen = follow(position, SOME, 2.5)
        assert np.isfinite(seen).all()
        assert ((seen[..., 2] > 0.0) == (position[..., 2] > 0.0)).all()
