"""Paths of bounded curvature round circular obstacles: the shortest one in a graph of common tangents.

A shortest path that is pulled taut round obstacles runs along circles and along their common tangents. An obstacle
whose clearance circle is wider than the turn radius is its own guide circle. Round a smaller one the vehicle turns
at its turn radius and touches the clearance circle in one point: the guide circles are then circles of the turn
radius that contain the clearance circle and touch it from inside, in several directions. Each guide circle may
be followed either way round; tangents join them so that the heading is continuous. The ends of
the tangents are the nodes of the graph, tangents and the arcs between neighbouring ends its edges.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from estimators import wrap
from vessel_gym.guidance.words import WORDS, Path, advance, chain, checked, lengths, shortest, word_path

_FULL = 2.0 * np.pi
_HAIR = 1e-9  # of the turn radius: guide circles are wider by it, so that what touches one passes the check
_START, _GOAL, _GUIDE = 0.0, 1.0, 2.0


class NoPath(ValueError):
    """No path was found; where the way is not shown to be closed, this is no proof that there is none."""


@dataclass(frozen=True)
class Effort:
    """How many circles the graph is built from."""

    directions: int  # in which a circle of the turn radius touches a smaller clearance circle
    leads: tuple[float, ...]  # straights before the first turn and after the last, in turn radii


QUICK = Effort(directions=8, leads=(0.0, 0.5, 1.0))
THOROUGH = Effort(directions=24, leads=(0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0))
"""For scenes in which `QUICK` finds nothing."""


# --- the graph --------------------------------------------------------------------------------------


@njit(cache=True)
def _straight_clear(x: float, y: float, cos: float, sin: float, length: float, discs: np.ndarray) -> bool:
    """Whether a straight keeps out of all discs ``(m, 3)`` of x, y, radius."""
    for k in range(len(discs)):
        dx, dy = discs[k, 0] - x, discs[k, 1] - y
        along = min(max(dx * cos + dy * sin, 0.0), length)
        ax, ay = dx - along * cos, dy - along * sin
        if ax * ax + ay * ay < discs[k, 2] * discs[k, 2]:
            return False
    return True


@njit(cache=True)
def _tangents(circles: np.ndarray, discs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The clear straights from one directed circle to another.

    On a circle that turns to side +-1, the point of heading psi is the centre + side radius (sin psi, -cos psi).

    Args:
        circles: ``(n, 5)`` x, y, radius, side (1: L, -1: R), kind.
        discs: ``(m, 3)`` x, y, radius to keep out of.

    Returns:
        Pairs ``(e, 2)`` of circles and ``(e, 2)`` headings and lengths.
    """
    n = len(circles)
    pairs, lines = np.empty((n * n, 2), np.int64), np.empty((n * n, 2))
    count = 0
    for i in range(n):
        if circles[i, 4] == _GOAL:
            continue
        bend_i = circles[i, 2] * circles[i, 3]
        for j in range(n):
            if i == j or circles[j, 4] == _START:
                continue
            dx, dy = circles[j, 0] - circles[i, 0], circles[j, 1] - circles[i, 1]
            bend = bend_i - circles[j, 2] * circles[j, 3]
            square = dx * dx + dy * dy - bend * bend
            if square <= 0.0:
                continue
            length = np.sqrt(square)
            whole = square + bend * bend
            cos, sin = (dx * length - dy * bend) / whole, (dy * length + dx * bend) / whole
            x, y = circles[i, 0] + bend_i * sin, circles[i, 1] - bend_i * cos
            if _straight_clear(x, y, cos, sin, length, discs):
                pairs[count, 0], pairs[count, 1] = i, j
                lines[count, 0], lines[count, 1] = np.arctan2(sin, cos), length
                count += 1
    return pairs[:count].copy(), lines[:count].copy()


@njit(cache=True)
def _arcs(
    circles: np.ndarray, discs: np.ndarray, owner: np.ndarray, turned: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The clear arcs between neighbouring points on the circles.

    Args:
        circles: ``(n, 5)``.
        discs: ``(m, 3)``.
        owner: ``(p,)`` the circle of each point, sorted.
        turned: ``(p,)`` side times heading in [0, 2 pi), sorted within a circle: it grows along the circle.

    Returns:
        Pairs ``(e, 2)`` of points and ``(e,)`` angles between them.
    """
    points = len(owner)
    pairs, angles = np.empty((points, 2), np.int64), np.empty(points)
    begin, width = np.empty(len(discs)), np.empty(len(discs))  # of what the discs cover of a circle
    count = first = 0
    while first < points:
        last = first
        while last < points and owner[last] == owner[first]:
            last += 1
        x, y, radius, side = circles[owner[first]][:4]
        covered = 0
        for k in range(len(discs)):
            dx, dy = discs[k, 0] - x, discs[k, 1] - y
            distance = np.hypot(dx, dy)
            if distance >= radius + discs[k, 2] or distance + discs[k, 2] <= radius:
                continue
            cos = -1.0  # the whole circle
            if distance + radius > discs[k, 2]:
                cos = (radius * radius + distance * distance - discs[k, 2] ** 2) / (2.0 * radius * distance)
            half = np.arccos(min(max(cos, -1.0), 1.0))
            begin[covered] = side * np.arctan2(dy, dx) + 0.5 * np.pi - half
            width[covered] = 2.0 * half
            covered += 1
        for p in range(first, last):
            following = p + 1 if p + 1 < last else first
            angle = (turned[following] - turned[p]) % _FULL
            clear = following != p
            for k in range(covered):
                ahead = (begin[k] - turned[p]) % _FULL
                if ahead < angle or ahead + width[k] > _FULL:
                    clear = False
                    break
            if clear:
                pairs[count, 0], pairs[count, 1], angles[count] = p, following, angle
                count += 1
        first = last
    return pairs[:count].copy(), angles[:count].copy()


def _guides(obstacles: np.ndarray, radius: float, directions: int, along: float) -> np.ndarray:
    """Guide circles ``(n, 3)`` of the clearance circles ``(m, 3)``.

    Args:
        obstacles: ``(m, 3)`` x, y and radius to keep out of.
        radius: Turn radius [m].
        directions: Circles round a clearance circle that is smaller than the turn radius.
        along: Direction from start to goal [rad]: two of the circles touch at right angles to it, where the path
            will most often pass.
    """
    wide = obstacles + [0.0, 0.0, _HAIR * radius]
    small = wide[wide[:, 2] < radius]
    angle = along + 0.5 * np.pi + _FULL / directions * np.arange(directions)
    shift = (radius - small[:, 2])[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    centres = (small[:, None, :2] + shift).reshape(-1, 2)
    turning = np.column_stack([centres, np.full(len(centres), radius)])
    return np.concatenate([wide[wide[:, 2] >= radius], turning])


def _directed(circles: np.ndarray, kind: float) -> np.ndarray:
    """Directed circles ``(2 n, 5)``, L then R, of circles ``(n, 3)``."""
    return np.concatenate(
        [np.column_stack([circles, np.full((len(circles), 2), (side, kind))]) for side in (1.0, -1.0)]
    )


def _turning(pose: np.ndarray, leads: np.ndarray, radius: float, kind: float) -> np.ndarray:
    """Directed turning circles ``(2 l, 5)``, L then R, of the poses that lie ``leads`` [m] ahead of a pose."""
    ahead = advance(pose, 0.0, leads)
    normal = radius * np.array([-np.sin(pose[2]), np.cos(pose[2])])
    circles = _directed(np.column_stack([ahead[:, :2], np.full(len(leads), radius)]), kind)
    circles[:, :2] += circles[:, 3:4] * normal
    return circles


def _search(
    start: np.ndarray, goal: np.ndarray, radius: float, guides: np.ndarray, discs: np.ndarray, leads: np.ndarray
) -> np.ndarray | None:
    """The shortest way through the tangent graph, or None.

    Args:
        start: ``(3,)`` pose.
        goal: ``(3,)`` pose.
        radius: Turn radius [m]; 0 pulls a string taut, whose ends have no heading.
        guides: ``(n, 3)`` x, y, radius of the circles to go along.
        discs: ``(m, 3)`` x, y, radius of the circles to keep out of.
        leads: ``(l,)`` straights [m] before the first turn and after the last.

    Returns:
        Pieces ``(k, 3)``: side (0: straight), radius, length.
    """
    turns = 2 * len(leads)
    circles = np.concatenate(
        [_turning(start, leads, radius, _START), _turning(goal, -leads, radius, _GOAL), _directed(guides, _GUIDE)]
    )
    pairs, lines = _tangents(circles, discs)
    e = len(pairs)
    # Nodes: where straights leave their circle, where they arrive, where start circles begin and where goal circles
    # end, the start and the goal. All but the last two lie on circles.
    owner = np.concatenate([pairs[:, 0], pairs[:, 1], np.arange(2 * turns)])
    heading = np.concatenate([lines[:, 0], lines[:, 0], np.repeat([start[2], goal[2]], turns)])
    first, last = 2 * e + np.arange(turns), 2 * e + turns + np.arange(turns)
    source, sink = 2 * e + 2 * turns, 2 * e + 2 * turns + 1
    turned = (circles[owner, 3] * heading) % _FULL
    order = np.lexsort((turned, owner))
    arcs, angles = _arcs(circles, discs, owner[order], turned[order])
    bent = circles[owner[order[arcs[:, 0]]]]
    into = np.tile(_leads_clear(start, leads, discs), 2)
    out = np.tile(_leads_clear(goal, -leads, discs), 2)
    lead = np.tile(leads, 2)

    tails = np.concatenate([np.arange(e), order[arcs[:, 0]], np.full(into.sum(), source), last[out]])
    heads = np.concatenate([e + np.arange(e), order[arcs[:, 1]], first[into], np.full(out.sum(), sink)])
    pieces = np.zeros((len(tails), 3))
    pieces[:, 2] = np.concatenate([lines[:, 1], angles * bent[:, 2], lead[into], lead[out]])
    pieces[e : e + len(bent), 0], pieces[e : e + len(bent), 1] = bent[:, 3], bent[:, 2]
    graph = csr_array((pieces[:, 2], (tails, heads)), shape=(sink + 1, sink + 1))
    distance, before = dijkstra(graph, indices=source, return_predecessors=True)
    if not np.isfinite(distance[sink]):
        return None
    way, node = [], sink
    while node != source:
        way.append(np.flatnonzero((tails == before[node]) & (heads == node))[0])
        node = before[node]
    return pieces[way[::-1]]


def _leads_clear(pose: np.ndarray, leads: np.ndarray, discs: np.ndarray) -> np.ndarray:
    """Whether the straights from a pose to ``leads`` [m] ahead (negative: behind) of it are clear ``(l,)``."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    clear = [
        _straight_clear(pose[0], pose[1], way * cos, way * sin, abs(lead), discs)
        for way, lead in zip(np.sign(leads), leads, strict=True)
    ]
    return np.array(clear)


def _joined(start: np.ndarray, pieces: np.ndarray) -> Path:
    """The path from the start along pieces ``(k, 3)``; successive arcs of one circle become one."""
    curvature = pieces[:, 0] / np.where(pieces[:, 0] == 0.0, 1.0, pieces[:, 1])
    new = np.flatnonzero(np.diff(curvature, prepend=np.nan) != 0.0)
    return chain(start, curvature[new], np.add.reduceat(pieces[:, 2], new))


# --- the check --------------------------------------------------------------------------------------


def approach(path: Path, points: np.ndarray) -> np.ndarray:
    """The distance ``(m,)`` [m] at which a path passes points ``(m, 2)``, in closed form.

    Args:
        path: The path.
        points: x, y [m].
    """
    x, y, heading, curvature, length = path.segments[:, :, None].transpose(1, 0, 2)
    dx, dy = points[:, 0] - x, points[:, 1] - y
    cos, sin = np.cos(heading), np.sin(heading)
    ahead, left = dx * cos + dy * sin, dy * cos - dx * sin  # (k, m), seen from where the segment begins
    straight = np.hypot(ahead - np.clip(ahead, 0.0, length), left)
    side, radius = np.sign(curvature), 1.0 / np.where(curvature == 0.0, 1.0, np.abs(curvature))
    beside = radius - side * left  # from the point to the centre
    passed = np.arctan2(ahead, beside) % _FULL * radius  # arc length at which the vehicle is nearest
    final = advance(path.segments[:, :3], path.segments[:, 3], path.segments[:, 4])[:, :, None]
    ends = np.minimum(np.hypot(dx, dy), np.hypot(points[:, 0] - final[:, 0], points[:, 1] - final[:, 1]))
    arc = np.where(passed <= length, np.abs(np.hypot(ahead, beside) - radius), ends)
    return np.where(curvature == 0.0, straight, arc).min(0, initial=np.inf)


def _sound(path: Path, goal: np.ndarray, radius: float, discs: np.ndarray) -> bool:
    """Whether a path ends at the goal, turns no tighter than the radius and keeps out of all discs."""
    end = advance(path.segments[-1, :3], *path.segments[-1, 3:])
    offset = np.abs(end - goal)
    offset[2] = radius * abs(wrap(end[2] - goal[2]))
    arrives = offset.max() <= 1e-9 * (radius + np.abs(goal[:2]).max() + path.length)
    bends = np.abs(path.segments[:, 3]).max() * radius <= 1.0 + 1e-12
    return bool(arrives and bends and (approach(path, discs[:, :2]) >= discs[:, 2]).all())


# --- planning ---------------------------------------------------------------------------------------


def plan(start: np.ndarray, goal: np.ndarray, radius: float, obstacles: np.ndarray, margin: float = 0.0) -> Path:
    """A short path between two poses that keeps clear of circular obstacles; `shortest` if that does.

    Otherwise the shortest of the six words and of the tangent graph that passed the check of clearance,
    curvature and arrival: a short path, not provably the shortest.

    Args:
        start: ``(3,)`` pose [m, m, rad].
        goal: ``(3,)`` pose.
        radius: Turn radius [m], the tightest turn.
        obstacles: ``(m, 3)`` x, y and radius [m], as many as there are, overlapping or not.
        margin: Distance [m] to keep from them.

    Raises:
        NoPath: (a ValueError) if none was found; the message tells a closed way, which is certain, from a search
            that failed.
        ValueError: for numbers that make no sense, and for a start or a goal within the margin of an obstacle.
    """
    direct = shortest(start, goal, radius)
    start, goal, _ = checked(start, goal, radius)
    discs = _discs(obstacles, margin)
    for name, pose in (("start", start), ("goal", goal)):
        depth = discs[:, 2] - np.hypot(discs[:, 0] - pose[0], discs[:, 1] - pose[1])
        if (depth > 0.0).any():
            raise ValueError(
                f"the {name} is {depth.max():.6g} m inside obstacle {depth.argmax()} or its margin: move the {name} or "
                "the obstacle, or ask for less margin"
            )
    if _sound(direct, goal, radius, discs):
        return direct
    along = float(np.arctan2(goal[1] - start[1], goal[0] - start[0]))
    for effort in (QUICK, THOROUGH):
        guides = _guides(discs, radius, effort.directions, along)
        pieces = _search(start, goal, radius, guides, discs, radius * np.array(effort.leads))
        around = None if pieces is None else _joined(start, pieces)
        if around is not None and not _sound(around, goal, radius, discs):
            around = None
        word = _clear_word(start, goal, radius, discs, np.inf if around is None else around.length)
        if word is not None:
            return word
        if around is not None:
            return around
    if _closed(start, goal, discs, _HAIR * radius):
        raise NoPath(
            "the obstacles with their margin close every way to the goal: ask for less margin or remove an obstacle"
        )
    raise NoPath(
        f"no path with turns of {radius:.6g} m or more was found, which does not prove that there is none: move the "
        "poses away from the obstacles, turn tighter or ask for less margin"
    )


def _clear_word(start: np.ndarray, goal: np.ndarray, radius: float, discs: np.ndarray, limit: float) -> Path | None:
    """The shortest of the six words that keeps clear and is shorter than ``limit`` [m], or None."""
    values = lengths(start, goal, radius)
    for k in np.argsort(values):
        if not values[k] < limit:
            return None
        path = word_path(start, goal, radius, WORDS[k])
        if _sound(path, goal, radius, discs):
            return path
    return None


def _closed(start: np.ndarray, goal: np.ndarray, discs: np.ndarray, hair: float) -> bool:
    """Whether not even a taut string joins start and goal, however sharply it may bend.

    The discs are smaller by a hair or two here: poses may lie on their edge, and no rounding closes a gap.
    """
    guides, smaller = (np.column_stack([discs[:, :2], np.maximum(discs[:, 2] - k * hair, 0.0)]) for k in (1.0, 2.0))
    return _search(start, goal, 0.0, guides, smaller, np.zeros(1)) is None


def _discs(obstacles: np.ndarray, margin: float) -> np.ndarray:
    """The clearance circles ``(m, 3)``.

    Raises:
        ValueError: for obstacles that are no circles, or a margin that is negative.
    """
    obstacles = np.asarray(obstacles, float)
    if obstacles.size == 0:
        obstacles = np.zeros((0, 3))
    if obstacles.ndim != 2 or obstacles.shape[1] != 3:
        raise ValueError(f"obstacles must be rows (x, y, radius), got shape {obstacles.shape}")
    if not np.isfinite(obstacles).all() or (obstacles[:, 2] < 0.0).any():
        bad = ~np.isfinite(obstacles).all(-1) | (obstacles[:, 2] < 0.0)
        raise ValueError(f"obstacle {bad.argmax()} must have finite numbers and a radius of 0 or more: correct it")
    if not 0.0 <= margin < np.inf:
        raise ValueError(f"the margin must be finite and 0 or more, got {margin}")
    return obstacles + [0.0, 0.0, margin]
