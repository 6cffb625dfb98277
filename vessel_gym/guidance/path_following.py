"""Position of a vehicle relative to a path of arcs and straights, with course and curvature.

A path consists of rows (x, y, initial heading, curvature, length) from
`vessel_gym.guidance.dubins`, flattened; rows of length 0 have no effect. Before its start and
beyond its end a path is straight for `LEAD` metres.

A path may cross itself. Of two near places the one with the vehicle's heading counts: a heading
error costs `PER_RAD` metres a radian, and at most twice that. So no memory is needed.
"""

import numpy as np

from estimators.engine import compiled
from vessel_gym.guidance.words import follow_on

LEAD = 50.0
"""Length [m] of the straights before the start and beyond the end."""
PER_RAD = 20.0
"""Distance [m] that counts as much as a heading error of one radian, for small errors."""
COLUMNS = 5
"""Numbers in the row of a segment."""
_FAR = 1e6  # m, larger coordinates are clipped, so that nothing overflows


def _pieces(segments: np.ndarray) -> tuple[np.ndarray, ...]:
    """Pieces ``(..., k + 2)`` of a path ``(..., 5 k)``, with straights at both ends.

    Returns:
        x, y and heading of each piece's origin, curvature, progress at the origin, first and last
        arc length from the origin, and a mask of existing pieces.
    """
    x, y, heading, curvature, length = (segments[..., i::COLUMNS] for i in range(COLUMNS))
    mask, final, zero = length > 0.0, segments[..., :COLUMNS], np.zeros_like(length[..., :1])
    for k in range(1, length.shape[-1]):
        segment = segments[..., COLUMNS * k : COLUMNS * (k + 1)]
        final = np.where(mask[..., k, None], segment, final)
    begin = np.concatenate([zero, zero, length.cumsum(-1)], -1)
    end_x, end_y, end_heading = follow_on(final[..., 4], *(final[..., i] for i in range(4)))
    return (
        np.concatenate([x[..., :1], x, end_x[..., None]], -1),
        np.concatenate([y[..., :1], y, end_y[..., None]], -1),
        np.concatenate([heading[..., :1], heading, end_heading[..., None]], -1),
        np.concatenate([zero, curvature, zero], -1),
        begin,
        np.concatenate([zero - LEAD, np.zeros_like(length), zero], -1),
        np.concatenate([zero, length, zero + LEAD], -1),
        np.concatenate([zero == 0.0, mask, zero == 0.0], -1),
    )


@compiled(axes=(0, 1))
def pose_along(
    along: np.ndarray, segments: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x, y [m] and heading [rad] ``(...)`` at ``along (...)`` [m] on paths ``(..., 5 k)``."""
    x, y, angle, curvature, begin, _, _, exists = _pieces(segments)
    pose = [x[..., 0], y[..., 0], angle[..., 0], curvature[..., 0], begin[..., 0]]
    for k in range(1, exists.shape[-1]):
        here = exists[..., k] & (along >= begin[..., k])
        piece = x[..., k], y[..., k], angle[..., k], curvature[..., k], begin[..., k]
        pose = [np.where(here, new, old) for new, old in zip(piece, pose, strict=True)]
    return follow_on(along - pose[4], *pose[:4])


def _closest(
    x: np.ndarray, y: np.ndarray, curvature: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Arc length in [low, high] of the point of a segment that is closest to (x, y).

    x is ahead, y to the side of positive curvature.
    """
    straight, side = curvature == 0.0, np.where(curvature > 0.0, 1.0, -1.0)
    radius = 1.0 / np.where(straight, 1.0, abs(curvature))
    full = 2.0 * np.pi * radius
    beyond = np.arctan2(x, radius - side * y) * radius - low
    s = low + (beyond - full * np.floor(beyond / full))
    end = np.where(s - high < low + full - s, high, low)
    return np.where(straight, np.clip(x, low, high), np.where(s <= high, s, end))


def _mean_curvature(
    begin: np.ndarray, curvature: np.ndarray, first: np.ndarray, last: np.ndarray, apart: np.ndarray
) -> np.ndarray:
    """Mean curvature [1/m] of a path's pieces from ``first`` to ``last``, ``apart`` metres."""
    mean = np.zeros_like(first)
    for k in range(1, begin.shape[-1] - 1):
        ends = np.minimum(begin[..., k + 1], last)
        covered = np.maximum(ends - np.maximum(begin[..., k], first), 0.0)
        mean = mean + curvature[..., k] * covered / apart
    return mean


@compiled
def locate(
    pose: np.ndarray, window: np.ndarray, segments: np.ndarray, ahead: np.ndarray
) -> np.ndarray:
    """Positions relative to paths ``(..., 7)``.

    Args:
        pose: ``(..., 3)`` x, y [m] and course [rad].
        window: ``(..., 3)`` least and greatest progress [m], and distance [m] equivalent to a
            heading error of one radian.
        segments: ``(..., 5 k)`` paths.
        ahead: ``(..., 2)`` distances [m] ahead, between which curvatures are averaged: up to the
            first, and from the first to the second.

    Returns:
        Progress of the closest point [m], cross-track error (positive to the side of positive
        curvature) [m], heading of the path there [rad], two mean curvatures ahead [1/m], remaining
        path [m], and distance from the path [m].
    """
    x, y = (np.clip(pose[..., i], -_FAR, _FAR) for i in range(2))
    rx, ry, angle, curvature, begin, first, last, exists = _pieces(segments)
    low = np.maximum(first, window[..., 0, None] - begin)
    high = np.minimum(last, window[..., 1, None] - begin)
    cos, sin, dx, dy = np.cos(angle), np.sin(angle), x[..., None] - rx, y[..., None] - ry
    s = _closest(dx * cos + dy * sin, dy * cos - dx * sin, curvature, low, high)
    ax, ay, at = follow_on(s, rx, ry, angle, curvature)
    turned = 1.0 - np.cos(pose[..., 2, None] - at)
    off = (x[..., None] - ax) ** 2 + (y[..., None] - ay) ** 2
    cost = off + 2.0 * window[..., 2, None] ** 2 * turned
    cost = np.where(exists & (low <= high), cost, np.inf)
    points = np.stack([begin + s, ax, ay, at], -1)
    least = cost[..., 0]
    start = np.concatenate([np.zeros_like(begin[..., :1]), segments[..., :3]], -1)
    point = np.where((least < np.inf)[..., None], points[..., 0, :], start)
    for k in range(1, cost.shape[-1]):
        closer = cost[..., k] < least
        least = np.where(closer, cost[..., k], least)
        point = np.where(closer[..., None], points[..., k, :], point)
    progress, px, py, heading = (point[..., i] for i in range(4))
    near, far = progress + ahead[..., 0], progress + ahead[..., 1]
    soon = _mean_curvature(begin, curvature, progress, near, ahead[..., 0])
    later = _mean_curvature(begin, curvature, near, far, ahead[..., 1] - ahead[..., 0])
    across = (y - py) * np.cos(heading) - (x - px) * np.sin(heading)
    rest, distance = begin[..., -1] - progress, np.hypot(x - px, y - py)
    return np.stack([progress, across, heading, soon, later, rest, distance], -1)


ANYWHERE = np.array([-np.inf, np.inf, PER_RAD])
"""Window for a vehicle of unknown progress."""
