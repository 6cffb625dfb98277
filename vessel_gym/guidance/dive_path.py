"""A smooth path that dives while it turns: an arc of a circle in plan, a smooth step in depth.

In plan the path leaves the origin along +x and turns with one curvature to the goal. Its depth is
``d (3 t^2 - 2 t^3)`` with ``t`` the covered share of the arc, so that the path begins and ends
level. Beyond its ends the path is straight and level. The closest point is the closest in plan,
which has a closed form.

An arc is ``(angle, length, depth)``: the turn of the path [rad], the length of the arc in plan and
the depth of the goal [m]. Frames: x north, y east, z down; a positive angle turns to starboard.
"""

import numpy as np

from estimators.engine import compiled

_STRAIGHT = 1e-9  # 1/m, the least curvature: over 100 m it bends a straight path by 5 micrometres


@compiled
def arc_to(goal: np.ndarray) -> np.ndarray:
    """Arcs ``(..., 3)`` from the origin to goals ``(..., 3)`` [m], given by chord and tangent."""
    chord, half = np.hypot(goal[..., 0], goal[..., 1]), np.arctan2(goal[..., 1], goal[..., 0])
    some = np.where(half == 0.0, 1e-20, half)
    return np.stack([2.0 * half, chord * (some / np.sin(some)), goal[..., 2]], -1)


def _curvature(arc: np.ndarray) -> np.ndarray:
    curvature = arc[..., 0] / arc[..., 1]
    return np.where(abs(curvature) > _STRAIGHT, curvature, _STRAIGHT)


@compiled(axes=(0, 1))
def path_point(s: np.ndarray | float, arc: np.ndarray) -> np.ndarray:
    """x, y, z [m], heading [rad], slope [m/m] ``(..., 5)`` at ``s (...)`` metres in plan."""
    length, depth, curvature = arc[..., 1], arc[..., 2], _curvature(arc)
    on = np.clip(s, 0.0, length)
    beyond, t = s - on, on / length
    heading = curvature * on
    x = np.sin(heading) / curvature + beyond * np.cos(heading)
    # 1 - cos without loss of digits where the path is nearly straight
    y = 2.0 * np.sin(0.5 * heading) ** 2 / curvature + beyond * np.sin(heading)
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
    x, y, z = (position[..., i] for i in range(3))
    angle, length, curvature = arc[..., 0], arc[..., 1], _curvature(arc)
    # Polar angle about the arc's centre, with its jump opposite the middle of the arc, far from
    # both ends.
    polar = np.arctan2(curvature * x, 1.0 - curvature * y) - 0.5 * angle
    polar = polar - 2.0 * np.pi * np.floor(polar / (2.0 * np.pi) + 0.5)
    on = (polar + 0.5 * angle) / curvature
    end_x, end_y, _, heading, _ = np.moveaxis(path_point(length, arc), -1, 0)
    beyond = np.maximum((x - end_x) * np.cos(heading) + (y - end_y) * np.sin(heading), 0.0)
    # Before the start and beyond the end the path is straight.
    s = np.where(on < 0.0, np.minimum(x, 0.0), np.where(on > length, length + beyond, on))
    px, py, pz, heading, slope = np.moveaxis(path_point(s, arc), -1, 0)
    across = (y - py) * np.cos(heading) - (x - px) * np.sin(heading)
    to_point = path_point(s + ahead, arc)[..., :3] - position
    return np.concatenate([np.stack([s, across, z - pz, heading, slope], -1), to_point], -1)
