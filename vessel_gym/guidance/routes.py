"""Routes of a ship: straight legs between waypoints, joined by tangent arcs of one radius.

Waypoints are rows (north, east) in metres.
"""

from itertools import combinations

import numpy as np

from estimators.angles import wrap
from estimators.checks import finite_array
from vessel_gym.guidance.dubins import Path, chained, path_of

SHARPEST = np.deg2rad(120.0)
"""Greatest change of course at a waypoint [rad]."""
LONGEST = 1e5
"""Longest route [m]: a larger number is an error of the unit."""
SHORTEST = 0.25
"""Shortest leg in radii of the arcs, about a ship length: a shorter one is an error of the unit."""


def route(waypoints: object, radius: float, clearance: float = 0.0) -> tuple[np.ndarray, Path]:
    """Waypoints ``(k, 2)`` relative to the first one, north and east [m], and the path along them.

    Args:
        waypoints: Rows (north, east) [m], at least 2.
        radius: Radius of the arcs [m].
        clearance: Least distance [m] between legs that do not follow each other.

    Raises:
        ValueError: for invalid waypoints, a change of course above `SHARPEST`, a leg below
            `SHORTEST` or too short for its arcs, a route longer than `LONGEST`, or legs within the
            clearance of each other.
    """
    points = finite_array("waypoints, rows (north, east) in metres,", waypoints, "k", 2)
    if len(points) < 2:
        raise ValueError(f"waypoints must be at least 2, got {len(points)}")
    with np.errstate(over="ignore"):
        points = points - points[0]
        legs = np.diff(points, axis=0)
        length = np.hypot(*legs.T)
    _refuse_other_units(length, SHORTEST * radius)
    course = np.arctan2(legs[:, 1], legs[:, 0])
    turn = wrap(np.diff(course))
    if (np.abs(turn) > SHARPEST).any():
        at = int(np.abs(turn).argmax())
        raise ValueError(
            f"the course changes by {np.rad2deg(abs(turn[at])):.0f} degrees at waypoint {at + 2},"
            f" more than {np.rad2deg(SHARPEST):.0f}"
        )
    tangent = np.pad(radius * np.tan(0.5 * np.abs(turn)), 1)
    straight = length - tangent[:-1] - tangent[1:]
    if (straight < 0.0).any():
        at = int(straight.argmin())
        raise ValueError(
            f"leg {at + 1} of the route is {length[at]:.0f} m long and needs"
            f" {length[at] - straight[at]:.0f} m for its arcs of {radius:.0f} m radius"
        )
    for i, j in combinations(range(len(legs)), 2):
        if j > i + 1 and (apart := _apart(points[i : i + 2], points[j : j + 2])) <= clearance:
            raise ValueError(
                f"legs {i + 1} and {j + 1} of the route come within {apart:.0f} m of each other,"
                f" nearer than {clearance:.0f} m"
            )
    lengths, curvatures = np.zeros((2, 2 * len(legs) - 1))
    lengths[::2], lengths[1::2] = straight, radius * np.abs(turn)
    curvatures[1::2] = np.sign(turn) / radius
    return points, path_of(chained(np.array([0.0, 0.0, course[0]]), curvatures, lengths))


def _refuse_other_units(length: np.ndarray, least: float) -> None:
    """Refuse lengths of legs that are no metres, or degrees."""
    if not length.sum() <= LONGEST:
        raise ValueError(
            f"the legs of a route must be {LONGEST:.0f} m together at most, got"
            f" {length.sum():.4g} m"
        )
    if length.min() < least:
        at = int(length.argmin())
        raise ValueError(
            f"waypoints {at + 1} and {at + 2} are {length[at]:.2g} m apart, less than"
            f" {least:.0f} m: vessel_gym.guidance.geodesy.local makes metres of degrees"
        )


def _apart(one: np.ndarray, other: np.ndarray) -> float:
    """Least distance [m] between legs from and to places ``(2, 2)``; 0 if they cross."""
    distances, crossing = [], True
    for leg, places in ((one, other), (other, one)):
        way, off = leg[1] - leg[0], places - leg[0]
        share = np.clip(off @ way / (way @ way), 0.0, 1.0)
        distances.append(np.hypot(*(share[:, None] * way - off).T).min())
        crossing = crossing and (off @ [-way[1], way[0]]).prod() < 0.0
    return 0.0 if crossing else float(min(distances))
