"""A smooth path that dives while it turns: an arc of a circle in plan, a smooth step in depth.

In plan the path leaves the origin along +x and turns with one curvature to the goal. Its depth is
``d (3 t^2 - 2 t^3)`` with ``t`` the covered share of the arc, so that the path begins and ends
level. Beyond its ends the path is straight and level, see `path_following`. The closest point is
the closest in plan.

An arc is ``(angle, length, depth)``: the turn of the path [rad], the length of the arc in plan and
the depth of the goal [m]; what follows these numbers is ignored. Frames: x north, y east, z down; a
positive angle turns to starboard.
"""

import numpy as np

from estimators.engine import compiled
from vessel_gym.guidance.dubins import pose_along
from vessel_gym.guidance.path_following import NEAREST, locate

_AHEAD = np.array([1.0, 2.0])  # m, for curvatures, which an arc does not need


@compiled
def arc_to(goal: np.ndarray) -> np.ndarray:
    """Arcs ``(..., 3)`` from the origin to goals ``(..., 3)`` [m], given by chord and tangent."""
    chord, half = np.hypot(goal[..., 0], goal[..., 1]), np.arctan2(goal[..., 1], goal[..., 0])
    some = np.where(half == 0.0, 1e-20, half)
    return np.stack([2.0 * half, chord * (some / np.sin(some)), goal[..., 2]], -1)


def _in_plan(arc: np.ndarray) -> np.ndarray:
    """Segments ``(..., 5)`` of arcs ``(..., 3)``."""
    zero = np.zeros_like(arc[..., :3])
    return np.concatenate([zero, arc[..., :1] / arc[..., 1:2], arc[..., 1:2]], -1)


@compiled(axes=(0, 1))
def path_point(s: np.ndarray | float, arc: np.ndarray) -> np.ndarray:
    """x, y, z [m], heading [rad], slope [m/m] ``(..., 5)`` at ``s (...)`` metres in plan."""
    length, depth = arc[..., 1], arc[..., 2]
    x, y, heading = pose_along(s, _in_plan(arc))
    t = np.clip(s / length, 0.0, 1.0)
    z, slope = depth * t * t * (3.0 - 2.0 * t), depth * 6.0 * t * (1.0 - t) / length
    return np.stack([x, y, z, heading, slope], -1)


@compiled(axes=(1, 1, 0))
def follow(position: np.ndarray, arc: np.ndarray, ahead: np.ndarray | float) -> np.ndarray:
    """Positions relative to paths ``(..., 8)``.

    Args:
        position: ``(..., 3)`` north, east, down [m].
        arc: ``(..., 3)`` arcs.
        ahead: ``(...)`` look-ahead distance in plan [m].

    Returns:
        Progress, cross-track error, depth error [m], heading [rad] and slope of the path at the
        closest point in plan, and the vector north, east, down [m] to the path's point ``ahead``
        metres beyond that. Progress is negative before the start, and above the length beyond the
        end. Errors are positive to starboard of the path and below the path.
    """
    place = locate(position, NEAREST, _in_plan(arc), _AHEAD)
    progress = place[..., 0]
    point, target = path_point(progress, arc), path_point(progress + ahead, arc)
    below = position[..., 2:] - point[..., 2:3]
    to_target = target[..., :3] - position
    return np.concatenate([place[..., :2], below, point[..., 3:], to_target], -1)
