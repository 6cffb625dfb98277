"""Short paths of bounded curvature round circular obstacles, in a graph of tangent poses.

Between two contacts with obstacles, a shortest path is one of Dubins' six words. Along an obstacle
that is wider than the turn radius the path may follow the edge (Boissonnat & Lazard 1996, A
polynomial-time algorithm for computing a shortest path of bounded curvature amidst moderate
obstacles). So the nodes of the graph are poses tangent to the clearance circles, obstacles with
their margins: evenly spread, in either direction. A* finds the shortest way through them.
"""

import numpy as np

from estimators.checks import AT_LEAST_0, as_array, finite_array, number, short_repr
from vessel_gym.guidance.dubins import (
    CURVATURES,
    Path,
    chained,
    checked,
    distances,
    lengths,
    path_of,
    whole,
    word_pieces,
)

TANGENTS = 16
"""Number of tangent poses on each clearance circle in each direction."""
_HAIR = 1e-9  # turn radii between poses and circles: no rounding error leads inside


def plan(
    start: np.ndarray, goal: np.ndarray, radius: float, obstacles: np.ndarray, margin: float = 0.0
) -> Path:
    """A short path between two poses that keeps clear of circular obstacles.

    The result is the `shortest` path if that keeps clear. Otherwise it is the shortest way through
    `TANGENTS` poses on each clearance circle in each direction, not provably the shortest path.

    Args:
        start: ``(3,)`` pose [m, m, rad].
        goal: ``(3,)`` pose.
        radius: Turn radius [m] of the tightest turn.
        obstacles: ``(m, 3)`` x, y and radius [m]; obstacles may overlap.
        margin: Distance [m] to keep from obstacles.

    Raises:
        ValueError: for invalid numbers, for a start or a goal within the margin of an obstacle, and
            if no path was found, which does not prove that there is none.
    """
    start, goal, turn = checked(start, goal, radius)
    room = number("the margin", margin, AT_LEAST_0, np.inf, "finite and 0 or more")
    discs = checked_obstacles(obstacles) + [0.0, 0.0, room]
    for name, pose in (("start", start), ("goal", goal)):
        depth = discs[:, 2] - np.hypot(*(discs[:, :2] - pose[:2]).T)
        if (depth > 0.0).any():
            raise ValueError(
                f"the {name} is {depth.max():.6g} m inside obstacle {depth.argmax()} or its margin:"
                f" move the {name} or the obstacle, or ask for less margin"
            )
    ends = [[*start, -1.0, 0.0], [*goal, -1.0, 0.0]]
    legs = _search(np.concatenate([ends, _tangents(discs, radius)]), turn, discs)
    if not len(legs):
        raise ValueError(
            f"no path with turns of {radius:.6g} m or more was found, which does not prove that"
            " there is none: move the poses away from the obstacles, turn tighter or ask for less"
            " margin"
        )
    pieces = path_of(np.concatenate(legs)).segments
    first = np.diff(pieces[:, 3], prepend=np.nan) != 0.0  # two legs may share an arc
    extents = np.add.reduceat(pieces[:, 4], np.flatnonzero(first))
    return path_of(chained(start, pieces[first, 3], extents))


def _tangents(discs: np.ndarray, radius: float) -> np.ndarray:
    """Nodes ``(n, 5)``: tangent pose, disc, and curvature of its edge (0: too narrow to follow).

    Args:
        discs: ``(m, 3)``.
        radius: Turn radius [m].
    """
    disc, way, step = np.indices((len(discs), 2, TANGENTS)).reshape(3, -1)
    bearing, side = step * (2.0 * np.pi / TANGENTS), 1.0 - 2.0 * way
    x, y, reach = (discs[disc] + [0.0, 0.0, _HAIR * radius]).T
    return np.stack([
        x + reach * np.cos(bearing), y + reach * np.sin(bearing), bearing + 0.5 * np.pi * side,
        disc, np.where(reach >= radius, side / np.maximum(reach, radius), 0.0),
    ], -1)  # fmt: skip


def _search(nodes: np.ndarray, radius: np.ndarray, discs: np.ndarray) -> list[np.ndarray]:
    """Legs ``(3, 5)`` of the shortest way from the first node to the second; empty without one."""
    ahead = lengths(nodes[:, :3], nodes[1, :3], radius).min(-1)  # no way round is shorter
    way, unseen = np.append(0.0, np.full(len(nodes) - 1, np.inf)), np.ones(len(nodes), bool)
    before, legs = np.zeros(len(nodes), int), np.zeros((len(nodes), 3, 5))
    while unseen[1]:
        bound = np.where(unseen, way + ahead, np.inf)
        here = bound.argmin()
        if bound[here] == np.inf:
            return []
        unseen[here] = False
        segments, length = _ways(nodes[here], nodes, radius, discs)
        shorter = way[here] + length < way
        way[shorter], before[shorter] = way[here] + length[shorter], here
        legs[shorter] = segments[shorter]
    found = [1]
    while before[found[-1]]:
        found.append(before[found[-1]])
    return [*legs[found[::-1]]]


def _ways(
    here: np.ndarray, nodes: np.ndarray, radius: np.ndarray, discs: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Shortest clear words, or arcs along an edge, from a node ``(5,)`` to nodes ``(n, 5)``.

    Returns:
        Segments ``(n, 3, 5)`` and lengths ``(n,)``, infinite if no way is clear.
    """
    bend, shape = here[4], (len(nodes), len(CURVATURES) + 1, 3)
    curvatures, pieces = np.zeros((2, *shape))
    curvatures[:, :-1], curvatures[:, -1, 0] = CURVATURES / radius, bend
    pieces[:, :-1] = word_pieces(here[:3], nodes[:, :3], radius) * radius
    follows = (bend != 0.0) & (nodes[:, 3:] == here[3:]).all(-1)
    angle = whole((nodes[:, 2] - here[2]) * np.sign(bend))
    pieces[:, -1, 0] = np.where(follows, angle / np.where(follows, abs(bend), 1.0), np.inf)
    start, length = np.broadcast_to(here[:3], shape), pieces.sum(-1)
    segments = chained(start, curvatures, np.where(np.isfinite(pieces), pieces, 0.0))
    for disc in discs:
        length[(distances(segments, disc[:2]) < disc[2]).any(-1)] = np.inf
    best = np.arange(len(nodes)), length.argmin(-1)
    return segments[best], length[best]


def checked_obstacles(obstacles: object) -> np.ndarray:
    """Obstacles ``(m, 3)`` as a float array.

    Raises:
        ValueError: for numbers that are not finite, or a radius below 0.
    """
    rows = as_array("obstacles", obstacles)
    rows = finite_array("obstacles", rows if rows.size else np.zeros((0, 3)), "m", 3)
    if (rows[:, 2] < 0.0).any():
        raise ValueError(f"obstacles must have a radius of 0 or more, got {short_repr(obstacles)}")
    return rows
