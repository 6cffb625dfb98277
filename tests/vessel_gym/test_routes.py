"""Routes of waypoints: legs and arcs without a jump, files that hold them, and lists that are refused."""

from itertools import pairwise
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from vessel_gym.envs import SigmaChannelEnv
from vessel_gym.guidance.geodesy import local
from vessel_gym.guidance.routes import route

TASK: Any = SigmaChannelEnv.system.task
RADIUS = TASK.turn * TASK.ship.length
DOGLEG = np.array([[0.0, 0.0], [1200.0, 0.0], [2000.0, 1100.0], [3400.0, 900.0]])
ROUTES = {
    "dogleg": DOGLEG,
    "elsewhere": DOGLEG + [4e6, -7e5],
    "nearly straight": np.array([[0.0, 0.0], [1500.0, 1.0], [3000.0, 0.0]]),
    "straight on": np.array([[0.0, 0.0], [1500.0, 0.0], [3000.0, 0.0]]),
    "hairpin": np.array([[0.0, 0.0], [1500.0, 0.0], [700.0, 1500.0]]),
    "zigzag": np.array([[600.0 * k, 450.0 * (k % 2)] for k in range(TASK.waypoints)]),
}
every_route = pytest.mark.parametrize("waypoints", ROUTES.values(), ids=ROUTES)


@every_route
def test_arcs_join_the_legs_without_a_jump(waypoints: np.ndarray) -> None:
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
    "one": ([[0, 0]], "waypoints must be at least 2, got 1"),
    "too many": ([[500.0 * k, 0] for k in range(9)], "waypoints must be 8 at most, got 9: channel_system"),
    "twice the same": ([[0, 0], [1000, 0], [1000, 0]], "waypoints 2 and 3 are 0 m apart, less than"),
    "in degrees": (
        [[51.0, 3.0], [51.2, 3.1]],
        "waypoints 1 and 2 are 0.22 m apart, less than 101 m: vessel_gym.guidance.geodesy.local makes",
    ),
    "back": ([[0, 0], [2000, 0], [0, 1]], "the course changes by 180 degrees at waypoint 2, more than 120"),
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
}  # fmt: skip


@pytest.mark.parametrize(("waypoints", "sentence"), BAD.values(), ids=BAD)
def test_a_route_that_cannot_be_followed_is_refused(waypoints: Any, sentence: str) -> None:
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


# --- places in degrees ----------------------------------------------------------------------------

GEODESICS = {
    "along the equator": ((0.0, 20.0), 90.0, 10e3, (0.0, 20.089831528)),
    "middle latitude": ((52.0, 4.0), 37.0, 10e3, (52.071743171, 4.087768856)),
    "south": ((-35.5, -60.25), 200.0, 50e3, (-35.92331322, -60.439481356)),
    "date line": ((-18.0, 179.9), 80.0, 50e3, (-17.920997127, -179.635257439)),
    "far north": ((78.2, 15.6), 310.0, 100e3, (78.755073408, 12.08040266)),
}
"""Origin, azimuth [deg], distance [m] and place on WGS84, by GeographicLib 2.1 (Karney 2013)."""


@pytest.mark.parametrize(
    ("origin", "azimuth", "distance", "place"), GEODESICS.values(), ids=GEODESICS
)
def test_local_places_keep_bearing_and_distance_of_geodesics(
    origin: tuple[float, float], azimuth: float, distance: float, place: tuple[float, float]
) -> None:
    """To the third order: a place d away is d^3 / (6 R^2) nearer, with the least radius of curvature R."""
    north, east = local([place], origin)[0]
    assert 0.0 < distance - np.hypot(north, east) < distance**3 / (6.0 * 6.335e6**2)
    aside = np.rad2deg(np.arctan2(east, north)) - azimuth
    assert abs(np.deg2rad((aside + 180.0) % 360.0 - 180.0)) * distance < 0.02


def test_local_places_do_not_depend_on_where_longitudes_begin() -> None:
    rng = np.random.default_rng(0)
    places = [54.0, 8.0] + 0.2 * rng.normal(size=(20, 2))
    for turn in (10.0, 172.0, -360.0):
        shifted = local(places + [0.0, turn], places[0] + [0.0, turn])
        np.testing.assert_allclose(shifted, local(places, places[0]), atol=1e-6)


@pytest.mark.parametrize(
    ("places", "origin", "sentence"),
    [
        ([[95.0, 8.0]], (54.0, 8.0), "latitudes must be within 90 degrees, got 95"),
        ([[54.0, 8.0]], (-100.0, 8.0), "latitudes must be within 90 degrees, got -100"),
        ([54.0, 8.0], (54.0, 8.0), r"places must have shape \(k, 2\)"),
        ([[54.0, np.nan]], (54.0, 8.0), "places must be finite"),
    ],
)
def test_places_that_are_none_on_the_earth_are_refused(
    places: Any, origin: Any, sentence: str
) -> None:
    with pytest.raises(ValueError, match=sentence):
        local(places, origin)
