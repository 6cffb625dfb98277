"""Poses at which paths of bounded curvature touch circular obstacles, for many scenes at once.

Lengths are in turn radii. Scenes are the first axis. Discs are ``(S, m, 3)`` x, y, radius, NaN for
missing ones. Touches are rows ``(..., 7)``: x, y, heading, disc (none: -1), side (1: the disc is on
the left, -1: on the right), bearing from the disc's centre, and radius of the edge, positive to the
left, if a path can follow it (otherwise 0).
"""

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from estimators.engine import compiled

HAIR = 1e-9
"""Distance in turn radii between touches and discs, with which a path passes the check."""
_FULL = 2.0 * np.pi
_SIDES = np.array([1.0, -1.0])


# --- clearance ------------------------------------------------------------------------------------


def meets(
    pose: np.ndarray, bends: Sequence[np.ndarray | float], extents: np.ndarray, discs: np.ndarray
) -> np.ndarray:
    """Mask of ways from poses ``(..., 3)`` that cross a disc; arcs must begin outside of discs.

    Args:
        pose: ``(..., 3)`` initial poses.
        bends: Radii of the pieces, positive to the left; 0.0 for a straight.
        extents: ``(..., k)`` angles of arcs and lengths of straights; pieces of 0 cross nothing.
        discs: ``(..., m, 3)``.
    """
    x, y, heading = pose[..., 0], pose[..., 1], pose[..., 2]
    sin, cos, crosses = np.sin(heading), np.cos(heading), x != x
    for k, bend in enumerate(bends):
        extent, straight = extents[..., k], isinstance(bend, float) and bend == 0.0
        bx, by = bend * sin, -bend * cos  # from the centre to the beginning of the arc
        radius = abs(bend)
        x, y, side = x - bx, y - by, np.where(bend > 0.0, 1.0, -1.0)
        if straight:
            ex, ey = extent * cos, extent * sin
        else:
            heading = heading + side * extent
            sin, cos = np.sin(heading), np.cos(heading)
            ex, ey = bend * sin, -bend * cos
        for d in range(discs.shape[-2]):
            dx, dy, room = discs[..., d, 0] - x, discs[..., d, 1] - y, discs[..., d, 2]
            if straight:
                along = np.clip(dx * cos + dy * sin, 0.0, extent)
                hit = (dx - along * cos) ** 2 + (dy - along * sin) ** 2 < room**2
            else:
                apart, inner = dx * dx + dy * dy, radius - room
                within = (inner >= 0.0) & (apart <= inner * inner)
                circle = (apart < (radius + room) ** 2) & ~within  # False for NaN
                # the circle's nearest point, from the arc's beginning
                beyond_half = side * (bx * dy - by * dx) < 0.0
                before_end = side * (dx * ey - dy * ex) > 0.0
                passed = np.where(
                    beyond_half, (extent >= np.pi) & before_end, (extent >= np.pi) | before_end
                )
                hit = circle & (passed | ((dx - ex) ** 2 + (dy - ey) ** 2 < room**2))
            crosses = crosses | (hit & (extent > 0.0))
        x, y = x + ex, y + ey
    return crosses


# --- tangents -------------------------------------------------------------------------------------


@compiled(axes=(1, 2))
def reaches(disc: np.ndarray, discs: np.ndarray) -> np.ndarray:
    """Edge ``(..., 4)`` of a disc for touches: x, y, radius, and radius of arcs along it.

    The last number is 0 if the turning circle is wider than the disc. The distance between edge and
    disc ``(..., 3)`` is `HAIR`, or half of the narrowest gap to another of ``discs (..., m, 3)``.
    """
    far = np.hypot(disc[..., :1] - discs[..., 0], disc[..., 1:2] - discs[..., 1])
    apart = far - disc[..., 2:] - discs[..., 2]
    reach = disc[..., 2] + np.minimum(HAIR, np.where(apart > 0.0, 0.5 * apart, np.inf).min(-1))
    return np.stack(
        [disc[..., 0], disc[..., 1], reach, np.where(disc[..., 2] >= 1.0, reach, 0.0)], -1
    )


def circles(start: np.ndarray, goal: np.ndarray, turn: float, edges: np.ndarray) -> np.ndarray:
    """Directed circles ``(S, 4 + 2 m, 4)`` of start, goal and edges, left ones first.

    A row is x, y, radius and side.

    Args:
        start: ``(S, 3)`` poses.
        goal: ``(S, 3)`` poses.
        turn: Radius of the turning circles of start and goal.
        edges: ``(S, m, 4)`` edges of the discs.
    """
    rounds, poses = np.empty((len(start), 4 + 2 * edges.shape[1], 4)), np.stack([start, goal], 1)
    aside = turn * np.stack([-np.sin(poses[..., 2]), np.cos(poses[..., 2])], -1)
    rounds[:, :4, :2] = (poses[:, :, None, :2] + _SIDES[:, None] * aside[:, :, None]).reshape(
        -1, 4, 2
    )
    rounds[:, :4, 2], rounds[:, 4:, :3] = turn, edges[..., :3].repeat(2, 1)
    rounds[:, ::2, 3], rounds[:, 1::2, 3] = _SIDES
    return rounds


@compiled(axes=(1, 1, 2))
def _tangent(
    a: np.ndarray, b: np.ndarray, discs: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mask of clear straights between directed circles, with headings and lengths.

    On a circle that turns to side +-1, the point with heading psi is the centre + side radius (sin
    psi, -cos psi).
    """
    bend = a[..., 2] * a[..., 3]
    dx, dy, wider = b[..., 0] - a[..., 0], b[..., 1] - a[..., 1], bend - b[..., 2] * b[..., 3]
    square = dx * dx + dy * dy - wider * wider
    exists = square > 0.0
    total = np.where(exists, square + wider * wider, 1.0)
    length = np.sqrt(np.where(exists, square, 0.0))
    cos, sin = (dx * length - dy * wider) / total, (dy * length + dx * wider) / total
    heading = np.arctan2(sin, cos)
    begin = np.stack([a[..., 0] + bend * sin, a[..., 1] - bend * cos, heading], -1)
    return exists & ~meets(begin, [0.0], length[..., None], discs), heading, length


def tangents(rounds: np.ndarray, discs: np.ndarray) -> tuple[np.ndarray, ...]:
    """Clear straights between directed circles; none begins at the goal's or ends at the start's.

    Args:
        rounds: ``(S, n, 4)`` as of `circles`.
        discs: ``(S, m, 3)``.

    Returns:
        Scenes, indices of the first and last circles, headings and lengths, ``(e,)`` each.
    """
    clear, headings, lengths = _tangent(rounds[:, :, None], rounds[:, None], discs[:, None, None])
    clear[:, 2:4] = clear[:, :, :2] = False
    return *np.nonzero(clear), headings[clear], lengths[clear]


@compiled(axes=(1, 0, 0, 2))
def _arc_clear(
    circle: np.ndarray, heading: np.ndarray, angle: np.ndarray, discs: np.ndarray
) -> np.ndarray:
    """Mask of clear arcs on directed circles ``(..., 4)``, from a heading by an angle."""
    bend = circle[..., 2] * circle[..., 3]
    begin = np.stack(
        [circle[..., 0] + bend * np.sin(heading), circle[..., 1] - bend * np.cos(heading), heading],
        -1,
    )
    return (bend == 0.0) | ~meets(begin, [bend], angle[..., None], discs)


def string(start: np.ndarray, goal: np.ndarray, discs: np.ndarray) -> np.ndarray:
    """Lengths ``(S,)`` of shortest ways without a turn radius; infinite if the way is closed.

    The discs are smaller by two `HAIR` here: poses may lie on an edge, and no rounding closes a
    gap.
    """
    discs = discs - [0.0, 0.0, 2.0 * HAIR]
    discs[..., 2] = np.maximum(discs[..., 2], 0.0)
    rounds = circles(start, goal, 0.0, discs + [0.0, 0.0, HAIR])
    scene, i, j, heading, line = tangents(rounds, discs)
    count, scenes = len(scene), np.tile(scene, 2)
    owner = np.concatenate([i, j])  # first the ends that leave circles, then those that arrive
    circle, headings = rounds[scenes, owner], np.tile(heading, 2)
    turned = circle[:, 3] * headings % _FULL  # grows along the circle
    group = scenes * rounds.shape[1] + owner
    order = np.lexsort((turned, group))
    first = np.diff(group[order], prepend=-1) > 0
    starts = np.nonzero(first)[0]
    following = np.roll(order, -1)
    following[np.append(starts[1:], len(order))[: len(starts)] - 1] = order[starts]
    angle = (turned[following] - turned[order]) % _FULL
    near = discs if len(discs) == 1 else discs[scenes[order]]
    linked = (following != order) & _arc_clear(circle[order], headings[order], angle, near)
    sources = np.nonzero(i < 2)[0]
    if not len(sources):
        return np.full(len(discs), np.inf)
    number = np.arange(2 * count)
    heads = np.stack([number, number], -1)  # of a line and of an arc; the node itself for none
    ways = np.zeros((2 * count, 2))
    heads[:count, 0], ways[:count, 0] = number[count:], line
    heads[order[linked], 1] = following[linked]
    ways[order[linked], 1] = (angle * circle[order, 2])[linked]
    graph = csr_array(
        (ways.ravel(), heads.ravel(), np.arange(0, 4 * count + 1, 2)), shape=(2 * count, 2 * count)
    )
    way, ends = dijkstra(graph, indices=sources, min_only=True)[count:], (j == 2) | (j == 3)
    shortest = np.full(len(discs), np.inf)
    np.minimum.at(shortest, scene[ends], way[ends])
    return shortest


# --- touches --------------------------------------------------------------------------------------


@compiled(axes=(1, 0, 0, 0))
def touch(edge: np.ndarray, disc: np.ndarray, side: np.ndarray, bearing: np.ndarray) -> np.ndarray:
    """Touches ``(..., 7)`` on edges of `reaches` ``(..., 4)``, by bearings from the centres."""
    x = edge[..., 0] + edge[..., 2] * np.cos(bearing)
    y = edge[..., 1] + edge[..., 2] * np.sin(bearing)
    return np.stack(
        [x, y, bearing + side * (0.5 * np.pi), disc, side, bearing, side * edge[..., 3]], -1
    )


@compiled(axes=(1, 0, 0, 0, 2))
def _placed(
    edge: np.ndarray, disc: np.ndarray, side: np.ndarray, bearing: np.ndarray, discs: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """`touch`, and the mask of touches outside of all discs ``(..., m, 3)``."""
    touches = touch(edge, disc, side, bearing)
    x, y = touches[..., 0], touches[..., 1]
    clear = x == x
    for d in range(discs.shape[-2]):
        dx, dy = x - discs[..., d, 0], y - discs[..., d, 1]
        clear = clear & ~(dx * dx + dy * dy < discs[..., d, 2] ** 2)
    return touches, clear


@compiled
def turning_on(circle: np.ndarray, edge: np.ndarray) -> np.ndarray:
    """Bearings ``(..., 2)`` at which turning circles with centres on a circle touch a disc.

    Args:
        circle: ``(..., 4)`` x, y, radius, and 1 if the disc lies outside of the turning circle, -1
            if inside.
        edge: ``(..., 4)`` edge of the disc from `reaches`.
    """
    apart, sign = circle[..., 2], circle[..., 3]
    dx, dy = circle[..., 0] - edge[..., 0], circle[..., 1] - edge[..., 1]
    reach, distance = 1.0 + sign * edge[..., 2], np.sqrt(dx * dx + dy * dy)
    exists = (
        (np.minimum(apart, reach) > 0.0)
        & (abs(distance - reach) <= apart)
        & (distance + reach >= apart)
    )
    exists = exists & (distance > 0.0)
    cos = (distance * distance + reach * reach - apart * apart) / np.where(
        exists, 2.0 * distance * reach, 1.0
    )
    middle = np.arctan2(dy, dx) + np.where(sign > 0.0, 0.0, np.pi)
    half = np.where(exists, np.arccos(np.clip(np.where(exists, cos, 0.0), -1.0, 1.0)), np.nan)
    return np.stack([middle - half, middle + half], -1)


@compiled
def _between(circle: np.ndarray, edge: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bearings ``(..., 8)`` of turning circles that touch a circle and a disc, and sides.

    The sides are those of the disc. NaN if no such circle exists, as between a disc and itself.
    """
    bearings, sides = [], []
    for out in _SIDES:
        for sign in _SIDES:
            radius, outside = 1.0 + out * circle[..., 2], sign + 0.0 * circle[..., 3]
            centres = np.stack([circle[..., 0], circle[..., 1], radius, outside], -1)
            bearings.append(turning_on(centres, edge))
            sides += [sign * out * circle[..., 3]] * 2
    return np.concatenate(bearings, -1), np.stack(sides, -1)


def all_touches(
    start: np.ndarray, goal: np.ndarray, discs: np.ndarray, edges: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Touches on clear tangents, on turning circles between circles, and evenly spread.

    Args:
        start: ``(S, 3)`` poses at the origin.
        goal: ``(S, 3)`` poses.
        discs: ``(S, m, 3)``.
        edges: ``(S, m, 4)`` of the discs.
        count: Number of evenly spread touches for each disc and direction.

    Returns:
        Scenes ``(n,)`` and touches ``(n, 7)`` outside of all discs.
    """
    rounds = circles(start, goal, 1.0, edges)
    scene, i, j, heading, _ = tangents(rounds, discs)
    circle = np.concatenate([i, j])
    on_disc = circle >= 4
    circle, scene = circle[on_disc], np.concatenate([scene, scene])[on_disc]
    disc, side = circle // 2 - 2, 1.0 - 2.0 * (circle % 2)
    bearing = np.concatenate([heading, heading])[on_disc] - side * (0.5 * np.pi)
    touches = touch(edges[scene, disc], disc.astype(float), side, bearing)

    along = np.arctan2(goal[:, 1], goal[:, 0]) + 0.5 * np.pi
    spread = (along[:, None] + np.arange(count) * (_FULL / count))[:, None].repeat(
        discs.shape[1], 1
    )
    dx, dy = (discs[:, None, :, i] - discs[:, :, None, i] for i in (0, 1))
    # a gap is passed at its narrowest place
    gap = np.hypot(dx, dy) - discs[:, :, None, 2] - discs[:, None, :, 2]
    narrow = np.where((gap > 0.0) & (gap < 1.0), np.arctan2(dy, dx), np.nan)
    bearing, side = (
        each.reshape(narrow.shape[:2] + (-1,))
        for each in _between(rounds[:, None], edges[:, :, None])
    )
    left = np.concatenate([spread, narrow], -1)
    ways = np.ones_like(left)
    bearing = np.concatenate([bearing, left, left], -1)
    side = np.concatenate([side, ways, -ways], -1)
    number = np.arange(discs.shape[1])[:, None] + 0.0
    others, clear = _placed(edges[:, :, None], number, side, bearing, discs[:, None, None])
    return np.concatenate([scene, np.nonzero(clear)[0]]), np.concatenate([touches, others[clear]])
