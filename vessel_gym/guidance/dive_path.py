"""A smooth path that dives while it turns: an arc of a circle in plan, a smooth step in depth.

From above the path leaves the origin along +x and turns with one curvature until it is over the goal. Its depth is
``d (3 t^2 - 2 t^3)`` with ``t`` the share of the arc that is covered, so that it begins and ends level. Beyond its ends
it goes on straight and level. The closest point is that in plan, which has a closed form.

A course is ``(angle, length, depth)``: what the path turns through [rad], the length of its arc in plan and the depth
of its goal [m]. Frames: x north, y east, z down; a positive angle turns to starboard.
"""

import numpy as np
from numba import njit

from estimators.checks import as_array, shaped_array
from estimators.compiled import gufunc

_STRAIGHT = 1e-9  # 1/m, the least curvature: over 100 m it bends a straight path by 5 micrometres


def course_to(goal: np.ndarray) -> np.ndarray:
    """The courses ``(..., 3)`` from the origin to goals ``(..., 3)`` [m]: a chord and a tangent make an arc."""
    goal = shaped_array("goal", goal, "...", 3)
    chord, half = np.hypot(goal[..., 0], goal[..., 1]), np.arctan2(goal[..., 1], goal[..., 0])
    course = np.array(goal, float)  # whose depth is its last component
    course[..., 0], course[..., 1] = 2.0 * half, chord / np.sinc(half / np.pi)
    return course


@njit()
def _curvature(angle: float, length: float) -> float:
    curvature = angle / length
    return curvature if abs(curvature) > _STRAIGHT else _STRAIGHT


@njit()
def _point(s: float, curvature: float, length: float, depth: float) -> tuple[float, float, float, float, float]:
    """Position, heading and slope (depth per metre in plan) of the path at ``s`` metres in plan."""
    on = min(max(s, 0.0), length)
    beyond, t = s - on, on / length
    heading = curvature * on
    x = np.sin(heading) / curvature + beyond * np.cos(heading)
    # 1 - cos without loss of digits where the path is nearly straight
    y = 2.0 * np.sin(0.5 * heading) ** 2 / curvature + beyond * np.sin(heading)
    return x, y, depth * t * t * (3.0 - 2.0 * t), heading, depth * 6.0 * t * (1.0 - t) / length


@gufunc("void(float64, float64[:], float64[:], float64[:])", "(),(c),(k)->(k)")
def _path_point(s: float, course: np.ndarray, room: np.ndarray, out: np.ndarray) -> None:
    out[0], out[1], out[2], out[3], out[4] = _point(s, _curvature(course[0], course[1]), course[1], course[2])


def path_point(s: np.ndarray, course: np.ndarray) -> np.ndarray:
    """The path at ``s (...)`` metres in plan: x, y, z [m], heading [rad] and slope [m depth per m], ``(..., 5)``."""
    return _path_point(as_array("s", s), shaped_array("course", course, "...", 3), np.empty(5))


@gufunc("void(float64[:], float64[:], float64, float64[:], float64[:])", "(c),(c),(),(k)->(k)")
def _follow(position: np.ndarray, course: np.ndarray, ahead: float, room: np.ndarray, out: np.ndarray) -> None:
    x, y, z = position[0], position[1], position[2]
    angle, length, depth = course[0], course[1], course[2]
    curvature = _curvature(angle, length)
    # Polar angle about the arc's centre; it jumps opposite the middle of the arc, far from both ends.
    polar = np.arctan2(curvature * x, 1.0 - curvature * y) - 0.5 * angle
    polar -= 2.0 * np.pi * np.floor(polar / (2.0 * np.pi) + 0.5)
    s = (polar + 0.5 * angle) / curvature
    if s < 0.0:  # before the start and beyond the end the path is straight
        s = min(x, 0.0)
    elif s > length:
        ex, ey, _, heading, _ = _point(length, curvature, length, depth)
        s = length + max((x - ex) * np.cos(heading) + (y - ey) * np.sin(heading), 0.0)
    px, py, pz, heading, slope = _point(s, curvature, length, depth)
    out[0] = s
    out[1] = (y - py) * np.cos(heading) - (x - px) * np.sin(heading)
    out[2] = z - pz
    out[3], out[4] = heading, slope
    ax, ay, az, _, _ = _point(s + ahead, curvature, length, depth)
    out[5], out[6], out[7] = ax - x, ay - y, az - z


def follow(position: np.ndarray, course: np.ndarray, ahead: float) -> np.ndarray:
    """Where a position is relative to the path, ``(..., 8)``.

    Args:
        position: ``(..., 3)`` north, east, down [m].
        course: ``(..., 3)``.
        ahead: Look-ahead distance in plan [m].

    Returns:
        Progress s of the closest point in plan, below 0 before the start and above the length beyond the end;
        cross-track error (positive to starboard of the path) and depth error (positive below it) [m]; heading [rad] and
        slope of the path there; the vector from the position to the path's point ``ahead`` of that, north, east, down.
    """
    position, course = shaped_array("position", position, "...", 3), shaped_array("course", course, "...", 3)
    return _follow(position, course, as_array("ahead", ahead), np.empty(8))
