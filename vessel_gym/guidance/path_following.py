"""Position of a vehicle relative to a path of arcs and straights, with course and curvature.

A path consists of rows (x, y, initial heading, curvature, length) from
`vessel_gym.guidance.dubins`, flattened; rows of length 0 have no effect. Before its start and
beyond its end a path is straight for `LEAD` metres.

A path may cross itself. Of two near places the one with the vehicle's heading counts: a heading
error costs `PER_RAD` metres a radian, and at most twice that. So no memory is needed.
"""

import numpy as np

from estimators.angles import ahead_and_aside
from estimators.engine import compiled
from vessel_gym.guidance.dubins import COLUMNS, nearest, pose_along

LEAD = 50.0
"""Length [m] of the straights before the start and beyond the end."""
PER_RAD = 20.0
"""Distance [m] that counts as much as a heading error of one radian, for small errors."""
_FAR = 1e6  # m, larger coordinates are clipped, so that nothing overflows


def end_pose(segments: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x, y [m] and heading [rad] ``(...)`` at the end of paths ``(..., 5 k)``."""
    return pose_along(segments[..., COLUMNS - 1 :: COLUMNS].sum(-1), segments)


def padded(rows: np.ndarray, count: int) -> np.ndarray:
    """Rows ``(..., k, c)`` side by side ``(..., count c)``, with zeros for missing ones."""
    *axes, k, columns = rows.shape
    missing = np.zeros((*axes, (count - k) * columns))
    return np.concatenate([rows.reshape(*axes, -1), missing], -1)


def _pieces(segments: np.ndarray) -> tuple[np.ndarray, ...]:
    """Pieces ``(..., k + 2)`` of a path ``(..., 5 k)``, with straights at both ends.

    Returns:
        x, y and heading of each piece's origin, curvature, progress at the origin, and first and
        last arc length from the origin, which are equal for rows of length 0.
    """
    x, y, heading, curvature, length = (segments[..., i::COLUMNS] for i in range(COLUMNS))
    zero = np.zeros_like(length[..., :1])
    ends = end_pose(segments)
    origins = (
        np.concatenate([first[..., :1], first, end[..., None]], -1)
        for first, end in zip((x, y, heading), ends, strict=True)
    )
    return (
        *origins,
        np.concatenate([zero, curvature, zero], -1),
        np.concatenate([zero, zero, length.cumsum(-1)], -1),
        np.concatenate([zero - LEAD, np.zeros_like(length), zero], -1),
        np.concatenate([zero, length, zero + LEAD], -1),
    )


def _mean_curvature(
    begin: np.ndarray, curvature: np.ndarray, first: np.ndarray, last: np.ndarray
) -> np.ndarray:
    """Mean curvature [1/m] of a path's pieces from ``first`` to ``last`` [m]."""
    ends = np.minimum(begin[..., 2:], last[..., None])
    covered = np.maximum(ends - np.maximum(begin[..., 1:-1], first[..., None]), 0.0)
    return (curvature[..., 1:-1] * covered).sum(-1) / (last - first)


@compiled
def locate(
    pose: np.ndarray, window: np.ndarray, segments: np.ndarray, ahead: np.ndarray
) -> np.ndarray:
    """Positions relative to paths ``(..., 6)``.

    Args:
        pose: ``(..., n)`` x, y [m] and course [rad]; further components have no effect.
        window: ``(..., 3)`` least and greatest progress [m], and distance [m] equivalent to a
            heading error of one radian.
        segments: ``(..., 5 k)`` paths.
        ahead: ``(..., 2)`` distances [m] ahead, between which curvatures are averaged: up to the
            first, and from the first to the second.

    Returns:
        Progress of the closest point [m], cross-track error (positive to the side of positive
        curvature) [m], heading of the path there [rad], two mean curvatures ahead [1/m], and
        distance from the path [m].
    """
    x, y = (np.clip(pose[..., i], -_FAR, _FAR) for i in range(2))
    *arc, begin, first, last = _pieces(segments)
    low = np.maximum(first, window[..., 0, None] - begin)
    high = np.minimum(last, window[..., 1, None] - begin)
    s, ax, ay, at = nearest(x[..., None], y[..., None], tuple(arc), low, high)
    turned = 1.0 - np.cos(pose[..., 2, None] - at)
    off = (x[..., None] - ax) ** 2 + (y[..., None] - ay) ** 2
    cost = off + 2.0 * window[..., 2, None] ** 2 * turned
    cost = np.where((first < last) & (low <= high), cost, np.inf)
    points = np.stack([begin + s, ax, ay, at], -1)
    least = np.full_like(x, np.inf)
    point = np.concatenate([np.zeros_like(begin[..., :1]), segments[..., :3]], -1)  # the start
    for k in range(cost.shape[-1]):
        closer = cost[..., k] < least
        least = np.where(closer, cost[..., k], least)
        point = np.where(closer[..., None], points[..., k, :], point)
    progress, px, py, heading = (point[..., i] for i in range(4))
    near, far = progress + ahead[..., 0], progress + ahead[..., 1]
    soon = _mean_curvature(begin, arc[3], progress, near)
    later = _mean_curvature(begin, arc[3], near, far)
    _, across = ahead_and_aside(x - px, y - py, heading)
    return np.stack([progress, across, heading, soon, later, np.hypot(x - px, y - py)], -1)


ANYWHERE = np.array([-np.inf, np.inf, PER_RAD])
"""Window for a vehicle of unknown progress."""
NEAREST = np.array([-np.inf, np.inf, 0.0])
"""Window for the nearest point, whatever the course."""
