"""Routes of waypoints: legs and arcs without a jump, files that hold them, and lists that are refused."""

from itertools import pairwise
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from vessel_gym.envs import SigmaChannelEnv
from vessel_gym.guidance.routes import LONGEST, WAYPOINTS, route

TASK: Any = SigmaChannelEnv.system.task
RADIUS = TASK.turn * TASK.ship.length
DOGLEG = np.array([[0.0, 0.0], [1200.0, 0.0], [2000.0, 1100.0], [3400.0, 900.0]])
ROUTES = {
    "dogleg": DOGLEG,
    "elsewhere": DOGLEG + [4e6, -7e5],
    "nearly straight": np.array([[0.0, 0.0], [1500.0, 1.0], [3000.0, 0.0]]),
    "straight on": np.array([[0.0, 0.0], [1500.0, 0.0], [3000.0, 0.0]]),
    "hairpin": np.array([[0.0, 0.0], [1500.0, 0.0], [700.0, 1500.0]]),
    "zigzag": np.array([[600.0 * k, 450.0 * (k % 2)] for k in range(WAYPOINTS)]),
}
every_route = pytest.mark.parametrize("waypoints", ROUTES.values(), ids=ROUTES)


@every_route
def test_arcs_join_the_legs_without_a_jump_of_place_or_direction(waypoints: np.ndarray) -> None:
    points, path = route(waypoints, RADIUS)
    np.testing.assert_allclose(points, waypoints - waypoints[0], atol=1e-9)
    for before, after in pairwise(path.segments[:, 4].cumsum()):
        left, right = path.pose(np.array([before - 1e-6, before + 1e-6]))
        assert np.abs(right - left).max() < 3e-6
        assert after > before
    begin, end = path.pose(np.array([0.0, path.length]))
    np.testing.assert_allclose(begin[:2], 0.0, atol=1e-9)
    np.testing.assert_allclose(end[:2], points[-1], atol=1e-6)
    last = points[-1] - points[-2]
    assert np.cos(end[2] - np.arctan2(last[1], last[0])) > 1.0 - 1e-12
    assert np.abs(path.segments[:, 3]).max() <= 1.0 / RADIUS
    # An arc begins R tan(turn / 2) before its waypoint and comes as near to it as R / cos(turn / 2)
    # - R.
    legs = np.diff(points, axis=0)
    turns = np.diff(np.unwrap(np.arctan2(legs[:, 1], legs[:, 0])))
    straight = np.hypot(*legs.T).sum() - 2.0 * RADIUS * np.tan(0.5 * np.abs(turns)).sum()
    assert path.length == pytest.approx(straight + RADIUS * np.abs(turns).sum(), abs=1e-6)
    dense = path.sample(1.0)[:, :2]
    for point, turn in zip(points[1:-1], turns, strict=True):
        nearest, cut = np.hypot(*(dense - point).T).min(), RADIUS / np.cos(0.5 * turn) - RADIUS
        assert cut - 1e-6 <= nearest <= np.hypot(cut, 0.5) + 1e-6


# --- bad routes -----------------------------------------------------------------------------------

BAD = {
    "a word": ("abc", "waypoints must be rows"),
    "three columns": ([[0, 0, 0], [1000, 0, 0]], "waypoints must be rows"),
    "one": ([[0, 0]], "waypoints must be 2 to 8, got 1"),
    "too many": ([[500.0 * k, 0] for k in range(9)], "waypoints must be 2 to 8, got 9"),
    "not finite": ([[0, 0], [np.nan, 0]], "waypoints must be finite"),
    "twice the same": ([[0, 0], [1000, 0], [1000, 0]], "waypoints 2 and 3 are the same place"),
    "back": ([[0, 0], [2000, 0], [0, 1]], "the course changes by 180 degrees at waypoint 2, more than 120"),
    "short": ([[0, 0], [200, 0], [200, 2000]], "leg 1 of the route is 200 m long and needs 404 m for its arcs"),
    "short in between": (
        [[0, 0], [2000, 0], [2000, 700], [4000, 700]], "leg 2 of the route is 700 m long and needs 809 m",
    ),
    "across itself": (
        [[0, 0], [3000, 0], [3000, 2000], [1500, 2000], [1500, -2000]],
        "legs 1 and 4 of the route come within 0 m of each other",
    ),
    "beside itself": (
        [[0, 0], [3000, 0], [3000, 1500], [1500, 1500], [1500, 60], [4500, 61]],
        "legs 1 and 4 of the route come within 60 m of each other, nearer than 70 m",
    ),
    "beyond": ([[0, 0], [1e6, 0]], f"the legs of a route must be {LONGEST:.0f} m together at most"),
}  # fmt: skip


@pytest.mark.parametrize(("waypoints", "sentence"), BAD.values(), ids=BAD)
def test_a_route_that_cannot_be_followed_is_refused_in_one_sentence(
    waypoints: Any, sentence: str
) -> None:
    env = gym.make("SigmaChannel-v0")
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        env.reset(seed=0, options={"waypoints": waypoints})
    message = str(caught.value)
    assert message.startswith(sentence)
    assert "\n" not in message
    assert len(message) < 200


def followed(waypoints: np.ndarray) -> tuple[Any, Any]:
    """Waypoints and path of a route; None of one that is refused in a sentence."""
    try:
        return route(waypoints, RADIUS, 2.0 * TASK.margin)
    except ValueError as error:
        message = str(error)
    assert 20 < len(message) < 200
    return None, None


def test_random_routes_are_followed_or_refused() -> None:
    """Every list of numbers gives a path that keeps its promises, or one sentence."""
    rng, kept = np.random.default_rng(0), 0
    for _ in range(400):
        count = int(rng.integers(1, 11))
        waypoints = np.cumsum(
            rng.normal(0.0, 10.0 ** rng.uniform(1.0, 3.7), (count, 2)) + [rng.uniform(0, 2e3), 0], 0
        )
        points, path = followed(waypoints)
        if path is None:
            continue
        kept += 1
        np.testing.assert_allclose(path.pose(path.length)[:2], points[-1], atol=1e-5)
        assert (path.segments[:, 4] > 0.0).all()
    assert kept > 40
