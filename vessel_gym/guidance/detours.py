"""Shortest paths of bounded curvature round circular obstacles, in a graph of touches.

Between two contacts with obstacles, a shortest path is one of Dubins' six words. Along an obstacle
that is wider than the turn radius the path may follow the edge (Boissonnat & Lazard 1996, A
polynomial-time algorithm for computing a shortest path of bounded curvature amidst moderate
obstacles). So the nodes of the graph are *touches*: poses on the edge of a clearance circle,
tangent to it, in either direction. They are the ends of the common tangents of clearance circles
and of the turning circles of start and goal, with evenly spread touches between. Edges are the
shortest words and arcs that keep clear. After the search each touch slides along its edge until no
slide shortens the path. Many scenes are planned together as one batch.
"""

import numpy as np

from estimators.checks import AT_LEAST_0, as_array, finite_array, number
from estimators.engine import compiled
from vessel_gym.checks import instance
from vessel_gym.guidance.roadmap import DISCS, ways
from vessel_gym.guidance.touches import string
from vessel_gym.guidance.words import (
    Path,
    chained,
    follow_on,
    shortened,
    shortest_pieces,
    single,
    whole,
)

_FULL = 2.0 * np.pi
_FAR = 1e6  # turn radii: at greater distances `HAIR` is lost in rounding
TOUCHES = 12, 48
"""Evenly spread touches for each clearance circle and direction, in the first and second search."""
_NEAR = 1.01  # a path of at most this many lower bounds needs no second search


class NoPath(ValueError):
    """No path was found; none exists if the message says that obstacles close every way."""


# --- the check ------------------------------------------------------------------------------------


@compiled
def distances(segments: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distances ``(...)`` of arcs and straights ``(..., 5)`` from points ``(..., 2)``."""
    x, y, heading, curvature, length = (segments[..., i] for i in range(5))
    east, north = points[..., 0], points[..., 1]
    straight, dx, dy = curvature == 0.0, east - x, north - y
    cos, sin = np.cos(heading), np.sin(heading)
    ahead, left = dx * cos + dy * sin, dy * cos - dx * sin
    line = np.hypot(ahead - np.clip(ahead, 0.0, length), left)
    radius = 1.0 / np.where(straight, 1.0, np.maximum(abs(curvature), 1e-300))
    side = np.where(curvature > 0.0, 1.0, -1.0)
    beside = radius - side * left  # from the point to the centre
    abreast = whole(np.arctan2(ahead, beside)) * radius <= length
    end_x, end_y, _ = follow_on(length, x, y, heading, curvature)
    ends = np.minimum(np.hypot(dx, dy), np.hypot(east - end_x, north - end_y))
    return np.where(straight, line, np.where(abreast, abs(np.hypot(ahead, beside) - radius), ends))


def approach(path: Path, points: np.ndarray) -> np.ndarray:
    """Distance ``(m,)`` [m] of a path from points ``(m, 2)``, in closed form.

    Args:
        path: Path.
        points: x, y [m].
    """
    instance("path", path, Path)
    return distances(path.segments, finite_array("points", points, "...", 2)[..., None, :]).min(-1)


def sound(
    segments: np.ndarray, goal: np.ndarray, radius: np.ndarray | float, discs: np.ndarray
) -> np.ndarray:
    """Mask of paths ``(..., k, 5)`` that end at the goal, keep the turn radius and meet no disc.

    Args:
        segments: ``(..., k, 5)``; segments of length 0 have no effect.
        goal: ``(..., 3)`` pose.
        radius: Turn radius [m].
        discs: ``(..., m, 3)``, NaN for missing discs.
    """
    last, lengths = segments[..., -1, :], segments[..., 4]
    gentle = (abs(segments[..., 3]) * radius <= 1.0 + 1e-12).all(-1)
    size = radius + abs(goal[..., :2]).max(-1) + lengths.sum(-1)
    x, y, heading = follow_on(last[..., 4], *(last[..., i] for i in range(4)))
    turned = abs((heading - goal[..., 2] + np.pi) % _FULL - np.pi)
    miss = np.maximum(np.maximum(abs(x - goal[..., 0]), abs(y - goal[..., 1])), radius * turned)
    hit = distances(segments[..., None, :, :], discs[..., None, :2]).min(-1) < discs[..., 2]
    return gentle & (miss <= 1e-9 * size) & ~hit.any(-1)


@compiled(axes=(1, 1, 0, 2))
def _direct(
    start: np.ndarray, goal: np.ndarray, radius: np.ndarray, discs: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shortest paths ``(..., 3, 5)`` without obstacles, lengths, and mask of `sound` ones."""
    segments = shortest_pieces(start, goal, radius)
    pieces = [segments[..., i, :] for i in range(3)]
    for i in (0, 1, 0):  # sort pieces of length 0 to the end
        swapped = (pieces[i][..., 4] == 0.0)[..., None]
        a, b = pieces[i : i + 2]
        pieces[i : i + 2] = np.where(swapped, b, a), np.where(swapped, a, b)
    return np.stack(pieces, -2), segments[..., 4].sum(-1), sound(segments, goal, radius, discs)


# --- planning -------------------------------------------------------------------------------------


def plan(
    start: np.ndarray, goal: np.ndarray, radius: float, obstacles: np.ndarray, margin: float = 0.0
) -> Path:
    """A short path between two poses that keeps clear of circular obstacles.

    The result is the `shortest` path if that keeps clear. Otherwise the planner returns the
    shortest way over a set of poses that are tangent to the obstacles' circles. The way has passed
    a check of clearance, curvature and arrival, but is not provably the shortest path. No path is
    shorter than the result's ``lower_bound``.

    Args:
        start: ``(3,)`` pose [m, m, rad].
        goal: ``(3,)`` pose.
        radius: Turn radius [m] of the tightest turn.
        obstacles: ``(m, 3)`` x, y and radius [m]; obstacles may overlap.
        margin: Distance [m] to keep from obstacles.

    Raises:
        NoPath: (a ValueError) if no path was found. The message says whether the obstacles close
            every way, or only the search failed.
        ValueError: for invalid numbers, for a start or a goal within the margin of an obstacle, and
            for a way round obstacles that are more than a million turn radii away, where rounding
            would decide.
    """
    start, goal, radius = single(start, goal, radius)
    segments, bounds, errors = plans(
        start[None], goal[None], radius, _discs(obstacles, margin)[None]
    )
    if errors:
        raise errors[0]
    return shortened(segments[0], float(bounds[0]))


Plans = tuple[np.ndarray, np.ndarray, dict[int, ValueError]]
"""Segments ``(S, k, 5)`` (length 0: padding), lower bounds ``(S,)``, and errors by scene."""
_BATCH = 256
"""Number of discs in the scenes that are searched together."""
_CLOSED = (
    "the obstacles with their margin close every way to the goal: ask for less margin or remove an"
    " obstacle"
)
_UNFOUND = (
    "no path with turns of {:.6g} m or more was found, which does not prove that there is none:"
    " move the poses away from the obstacles, turn tighter or ask for less margin"
)


def plans(start: np.ndarray, goal: np.ndarray, radius: float, discs: np.ndarray) -> Plans:
    """Paths in many scenes; see `plan`.

    Args:
        start: ``(S, 3)`` poses.
        goal: ``(S, 3)`` poses.
        radius: Turn radius [m].
        discs: ``(S, m, 3)`` clearance circles, NaN for missing ones.
    """
    missing = np.full((len(start), max(-discs.shape[1] % DISCS, DISCS - discs.shape[1]), 3), np.nan)
    discs = np.concatenate([discs, missing], 1)
    segments, length, clear = _direct(start, goal, np.array(radius), discs)
    errors: dict[int, ValueError] = {}
    if clear.all():
        return segments, length, errors
    offsets = np.concatenate([discs, goal[:, None]], 1) - start[:, None]
    size = np.fmax.reduce(abs(offsets[..., :2]), (1, 2)) / radius
    far = ~clear & (size > _FAR)
    for s in np.nonzero(far)[0].tolist():
        errors[s] = ValueError(
            f"poses and obstacles must lie within {_FAR:.0e} turn radii of each other for a way"
            f" round, got {size[s]:.0e}: turn wider or leave out what is far away"
        )
    for name, poses in (("goal", goal), ("start", start)):
        depth = discs[..., 2] - np.hypot(*np.moveaxis(discs[..., :2] - poses[:, None, :2], -1, 0))
        for s in np.nonzero(~clear & (depth > 0.0).any(-1))[0].tolist():
            errors[s] = ValueError(
                f"the {name} is {np.nanmax(depth[s]):.6g} m inside obstacle"
                f" {np.nanargmax(depth[s])} or its margin: move the {name} or the obstacle, or ask"
                " for less margin"
            )
    rest = np.array([s for s in np.nonzero(~clear)[0].tolist() if s not in errors], int)
    found = [(np.nonzero(clear)[0], segments[clear], length[clear])]
    together = max(_BATCH // discs.shape[1], 1)
    for part in np.split(rest, range(together, len(rest), together)):
        way, bound, failed = _around(start[part], goal[part], radius, discs[part], length[part])
        errors |= {int(part[s]): error for s, error in failed.items()}
        found.append((part, way, bound))
    longer = np.zeros((len(start), max(way.shape[1] for _, way, _ in found), 5))
    for part, way, bound in found:
        longer[part, : way.shape[1]], length[part] = way, bound
    return longer, length, errors


def _around(
    start: np.ndarray, goal: np.ndarray, radius: float, discs: np.ndarray, direct: np.ndarray
) -> Plans:
    """Plans of scenes in which the shortest path, of length ``direct``, is blocked."""
    scale, origin = np.array([radius, radius, 1.0]), start * [1.0, 1.0, 0.0]
    here, there = start - origin, (goal - origin) / scale
    rounds = (discs - origin[:, None]) / radius
    bound = string(here, there, rounds) * radius
    length, found = np.full(len(start), np.inf), np.zeros((len(start), 1, 5))
    rest = np.nonzero(bound < np.inf)[0]
    for count in TOUCHES:
        if not len(rest):
            break
        pieces = ways(here[rest], there[rest], rounds[rest], count, length[rest] / radius)
        sizes = np.array([len(rows) for rows in pieces], int)
        most = sizes.max(initial=0)
        if not most:
            break
        padded = np.array(
            [np.concatenate([rows, np.zeros((most - len(rows), 2))]) for rows in pieces]
        )
        segments = chained(start[rest], padded[..., 0] / radius, padded[..., 1] * radius)
        better = sound(segments, goal[rest], radius, discs[rest]) & (padded[..., 1] > 0.0).any(-1)
        found = np.concatenate([found, np.zeros((len(found), max(most - found.shape[1], 0), 5))], 1)
        segments[np.arange(most) >= sizes[:, None]] = 0.0  # equal to a scene planned alone
        found[rest[better]], found[rest[better], :most] = 0.0, segments[better]
        length[rest[better]] = segments[better, :, 4].cumsum(-1)[:, -1]
        rest = rest[~(length <= _NEAR * np.minimum(np.maximum(bound, direct), length))[rest]]
    sentences = np.where(bound == np.inf, _CLOSED, _UNFOUND.format(radius))
    errors: dict[int, ValueError] = {
        s: NoPath(sentences[s]) for s in np.nonzero(length == np.inf)[0].tolist()
    }
    return found, np.minimum(np.maximum(bound, direct), length), errors


def _discs(obstacles: np.ndarray, margin: float) -> np.ndarray:
    """Clearance circles ``(m, 3)``.

    Raises:
        ValueError: for invalid obstacles, or a negative margin.
    """
    obstacles = as_array("obstacles", obstacles)
    room = number("the margin", margin, AT_LEAST_0, np.inf, "finite and 0 or more")
    if obstacles.size == 0:
        obstacles = np.zeros((0, 3))
    if obstacles.ndim != 2 or obstacles.shape[1] != 3:
        raise ValueError(f"obstacles must be rows (x, y, radius), got shape {obstacles.shape}")
    if not np.isfinite(obstacles).all() or (obstacles[:, 2] < 0.0).any():
        bad = ~np.isfinite(obstacles).all(-1) | (obstacles[:, 2] < 0.0)
        raise ValueError(
            f"obstacle {bad.argmax()} must have finite numbers and a radius of 0 or more:"
            " correct it"
        )
    return obstacles + [0.0, 0.0, room]
