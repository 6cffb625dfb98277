"""Scenes drawn path first: a path, and obstacles beside it, so that none needs a planner."""

import numpy as np

from estimators.engine import compiled
from vessel_gym.guidance.dubins import chained, pose_along, shortest_pieces

_ASIDE = 3.25  # turn radius, over the largest distance between a path and a margin beside it
_HAIR = 1e-6  # m between the path and the margin that it touches


def _beside(path: np.ndarray, share: np.ndarray, off: np.ndarray) -> np.ndarray:
    """Poses ``(..., 3)`` to starboard of paths ``(..., k, 5)`` by ``off`` [m], at a share."""
    along = share * path[..., 4].sum(-1)
    x, y, heading = pose_along(along, path.reshape(*path.shape[:-2], -1))
    return np.stack([x - off * np.sin(heading), y + off * np.cos(heading), heading], -1)


@compiled(axes=(1, 1, 0, 1, 1, 1, 0))
def scene(
    start: np.ndarray, goal: np.ndarray, turn: np.ndarray, along: np.ndarray, across: np.ndarray,
    radius: np.ndarray, margin: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Paths between poses round an obstacle in the way, with two other obstacles beside them.

    The first obstacle is in the middle of the shortest path, so that it blocks it. The path passes
    along its margin, on the side on which it is shorter. One obstacle beside the path is in its
    first half and one in its second. The poses must be several turn radii apart, and a turn radius
    must exceed that of an obstacle with its margin.

    Args:
        start: ``(..., 3)`` poses [m, m, rad].
        goal: ``(..., 3)`` poses.
        turn: Turn radius [m].
        along: ``(..., 3)`` places of the obstacles along the way, in [0, 1].
        across: ``(..., 3)`` places of the obstacles across the way, in [-1, 1].
        radius: ``(..., 3)`` radii of the obstacles [m].
        margin: Distance [m] that the path keeps from obstacles.

    Returns:
        Segments ``(..., 6, 5)``, and obstacles ``(..., 3, 3)`` (x, y, radius).
    """
    direct, reach = shortest_pieces(start, goal, turn), radius + margin + _HAIR
    middle, off = 0.4 + 0.2 * along[..., 0], across[..., 0] * radius[..., 0]
    ways = []
    for side in (-1.0, 1.0):
        tangent = _beside(direct, middle, off + side * reach[..., 0])
        legs = shortest_pieces(start, tangent, turn), shortest_pieces(tangent, goal, turn)
        ways.append(np.concatenate(legs, -2))
    port, starboard = ways
    to_port, to_starboard = port[..., 4].sum(-1), starboard[..., 4].sum(-1)
    path = np.where((to_port < to_starboard)[..., None, None], port, starboard)
    path = chained(start, path[..., 3], path[..., 4])  # headings go on from leg to leg
    off_path = np.copysign(reach, across) + (turn / _ASIDE)[..., None] * across
    centres = [
        _beside(direct, middle, off),
        _beside(path, 0.2 + 0.2 * along[..., 1], off_path[..., 1]),
        _beside(path, 0.7 + 0.2 * along[..., 2], off_path[..., 2]),
    ]
    return path, np.concatenate([np.stack(centres, -2)[..., :2], radius[..., None]], -1)
