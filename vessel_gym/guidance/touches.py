"""Poses at which paths of bounded curvature touch circular obstacles, for many scenes at once.

Lengths count in turn radii. Scenes are the first axis: discs are ``(S, m, 3)`` x, y, radius, NaN where a scene has
fewer; touches are rows ``(..., 7)``: x, y, heading, disc (none: -1), side (1: the disc is on the left, -1: on the
right), bearing from the disc's centre, and the radius of the edge, positive to the left, if a path can follow it
(otherwise 0).
"""

import numpy as np

from estimators.engine import compiled
from vessel_gym.guidance.words import whole

HAIR = 1e-9
"""Turn radii that touches keep from edges, so that a path that touches a disc passes the check."""
_FULL = 2.0 * np.pi


# --- clearance --------------------------------------------------------------------------------------


@compiled(axes=(0,) * 8)
def meets(
    x: np.ndarray, y: np.ndarray, heading: np.ndarray, bend: np.ndarray, extent: np.ndarray,
    east: np.ndarray, north: np.ndarray, room: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Mask of the pieces of paths from places that are clear which cross a disc.

    Args:
        x: Of the origin of a piece.
        y: Likewise.
        heading: Likewise [rad].
        bend: Radius, positive to the left; 0: straight.
        extent: Angle [rad] of an arc, length of a straight; a piece of 0 meets nothing.
        east: x of the disc's centre.
        north: y of the disc's centre.
        room: Radius of the disc.
    """
    sin, cos = np.sin(heading), np.cos(heading)
    dx, dy, square = east - x, north - y, room * room
    along = np.minimum(np.maximum(dx * cos + dy * sin, 0.0), extent)
    ax, ay = dx - along * cos, dy - along * sin
    radius, side = abs(bend), np.where(bend > 0.0, 1.0, -1.0)
    dx, dy = east - (x - bend * sin), north - (y + bend * cos)
    apart = dx * dx + dy * dy
    beside = (apart >= (radius + room) ** 2) | ((radius >= room) & (apart <= (radius - room) ** 2))
    nearest = whole(side * (np.arctan2(dy, dx) - heading) + 0.5 * np.pi)
    last = heading + side * extent
    ex, ey = dx - bend * np.sin(last), dy + bend * np.cos(last)
    arc = ~beside & ((nearest < extent) | (ex * ex + ey * ey < square))
    return np.where(bend == 0.0, ax * ax + ay * ay < square, arc) & (extent > 0.0)


def outside(touches: np.ndarray, discs: np.ndarray) -> np.ndarray:
    """Mask of the touches ``(..., 7)`` in none of the discs ``(..., m, 3)``."""
    away = touches[..., None, :2] - discs[..., :2]
    within = away[..., 0] ** 2 + away[..., 1] ** 2 < discs[..., 2] ** 2
    return ~(within.any(-1) | np.isnan(touches[..., 0]))


# --- tangents ---------------------------------------------------------------------------------------


def margins(discs: np.ndarray) -> np.ndarray:
    """Distances ``(S, m)`` that touches keep from edges: a hair, or half of the narrowest gap to another disc."""
    far = np.hypot(*(discs[:, :, None, i] - discs[:, None, :, i] for i in (0, 1)))
    apart = far - discs[:, :, None, 2] - discs[:, None, :, 2]
    return np.minimum(HAIR, np.where(apart > 0.0, 0.5 * apart, np.inf).min(-1, initial=np.inf))


def circles(start: np.ndarray, goal: np.ndarray, turn: float, discs: np.ndarray, gaps: np.ndarray) -> np.ndarray:
    """Directed circles ``(S, 4 + 2 m, 4)`` x, y, radius, side: of the start, of the goal, then the discs, left first.

    Args:
        start: ``(S, 3)`` poses.
        goal: ``(S, 3)`` poses.
        turn: Radius of the turning circles of both.
        discs: ``(S, m, 3)``.
        gaps: ``(S, m)`` what to keep from their edges.
    """
    pose = np.repeat(np.stack([start, goal], 1), 2, axis=1)
    side = np.tile([1.0, -1.0], 2 + discs.shape[1]) * np.ones((len(discs), 1))
    x = pose[..., 0] - side[:, :4] * turn * np.sin(pose[..., 2])
    y = pose[..., 1] + side[:, :4] * turn * np.cos(pose[..., 2])
    rounds = np.repeat(discs + gaps[..., None] * [0.0, 0.0, 1.0], 2, axis=1)
    turning = np.stack([x, y, np.full_like(x, turn)], -1)
    return np.concatenate([np.concatenate([turning, rounds], 1), side[..., None]], -1)


def tangents(rounds: np.ndarray, discs: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Clear straights from directed circles to others.

    On a circle that turns to side +-1, the point of heading psi is the centre + side radius (sin psi, -cos psi).

    Args:
        rounds: ``(S, n, 4)`` as of `circles`: none begins at the goal's or ends at the start's.
        discs: ``(S, m, 3)``.

    Returns:
        Which exist, their headings and lengths, ``(S, n, n)`` each.
    """
    n = rounds.shape[1]
    wanted = ~np.eye(n, dtype=bool)
    wanted[2:4], wanted[:, :2] = False, False
    x, y, radius, side = np.moveaxis(rounds, -1, 0)
    bends = radius * side
    dx, dy = x[:, None] - x[:, :, None], y[:, None] - y[:, :, None]
    bend = bends[:, :, None] - bends[:, None]
    square = dx * dx + dy * dy - bend * bend
    exists = wanted & (square > 0.0)
    scene, i = np.nonzero(exists)[:2]
    dx, dy, bend, square, leaving = dx[exists], dy[exists], bend[exists], square[exists], bends[scene, i]
    length, total = np.sqrt(square), square + bend * bend
    cos, sin = (dx * length - dy * bend) / total, (dy * length + dx * bend) / total
    heading, lengths = np.arctan2(sin, cos), np.zeros(exists.shape)
    px, py, there = x[scene, i] + leaving * sin, y[scene, i] - leaving * cos, discs[scene]
    away_x, away_y = there[..., 0] - px[:, None], there[..., 1] - py[:, None]
    along = np.clip(away_x * cos[:, None] + away_y * sin[:, None], 0.0, length[:, None])
    off_x, off_y = away_x - along * cos[:, None], away_y - along * sin[:, None]
    clear = ~(off_x * off_x + off_y * off_y < there[..., 2] ** 2).any(-1)
    headings = np.zeros(exists.shape)
    headings[exists], lengths[exists], exists[exists] = heading, length, clear
    return exists, headings, lengths


def string(start: np.ndarray, goal: np.ndarray, discs: np.ndarray) -> np.ndarray:
    """Lengths ``(S,)`` of the shortest ways that may bend as sharply as they like; infinite where there is none.

    The discs are smaller by a hair or two here: poses may lie on their edge, and no rounding closes a gap.
    """
    discs = discs - [0.0, 0.0, 2.0 * HAIR]
    discs[..., 2] = np.maximum(discs[..., 2], 0.0)
    rounds = circles(start, goal, 0.0, discs, np.full(discs.shape[:2], HAIR))
    exists, headings, lengths = tangents(rounds, discs)
    scene, i, j = np.nonzero(exists)
    heading, line, count = headings[exists], lengths[exists], len(scene)
    scenes, owner = np.tile(scene, 2), np.concatenate([i, j])  # tangents leave their circles, then arrive
    circle = rounds[scenes, owner]
    turned = circle[:, 3] * np.tile(heading, 2) % _FULL  # grows along the circle
    order = np.lexsort((turned, scenes * rounds.shape[1] + owner))
    group = (scenes * rounds.shape[1] + owner)[order]
    first = np.concatenate([[True], group[1:] != group[:-1]])[: len(group)]
    starts = np.nonzero(first)[0]
    following = np.concatenate([order[1:], order[:1]])
    following[np.append(starts[1:], len(order))[: len(starts)] - 1] = order[starts]
    angle = (turned[following] - turned[order]) % _FULL
    x, y, radius, side = circle[order].T
    bend, at = side * radius, side * turned[order]
    px, py = x + bend * np.sin(at), y - bend * np.cos(at)
    pose = (value[:, None] for value in (px, py, at, bend, angle))
    clear = (radius == 0.0) | ~meets(*pose, *np.moveaxis(discs[scenes[order]], -1, 0)).any(-1)
    linked = clear & (following != order)
    tails, heads, arcs = order[linked], following[linked], (angle * radius)[linked]
    way = np.where((np.arange(2 * count) < count) & (owner < 2), 0.0, np.inf)
    while True:  # Bellman and Ford
        shorter = way.copy()
        shorter[count:] = np.minimum(way[count:], way[:count] + line)
        shorter[heads] = np.minimum(shorter[heads], shorter[tails] + arcs)
        if np.array_equal(shorter, way):
            break
        way = shorter
    shortest = np.full(len(discs), np.inf)
    ends = np.nonzero((j == 2) | (j == 3))[0]
    np.minimum.at(shortest, scene[ends], way[count + ends])
    return shortest


# --- touches ----------------------------------------------------------------------------------------


def reaches(discs: np.ndarray, gaps: np.ndarray) -> np.ndarray:
    """Edges ``(S, m, 4)`` that touches lie on: x, y, radius, and the radius again or 0 where turns are wider."""
    reach = discs[..., 2] + gaps
    return np.stack([discs[..., 0], discs[..., 1], reach, np.where(discs[..., 2] >= 1.0, reach, 0.0)], -1)


def touch(edge: np.ndarray, disc: np.ndarray, side: np.ndarray, bearing: np.ndarray) -> np.ndarray:
    """Touches ``(..., 7)`` of discs at bearings from their centres; ``edge`` is one of `reaches` ``(..., 4)``."""
    touches = np.empty((*np.broadcast_shapes(edge.shape[:-1], np.shape(side), np.shape(bearing)), 7))
    touches[..., 0] = edge[..., 0] + edge[..., 2] * np.cos(bearing)
    touches[..., 1] = edge[..., 1] + edge[..., 2] * np.sin(bearing)
    touches[..., 2] = bearing + side * (0.5 * np.pi)
    touches[..., 3], touches[..., 4], touches[..., 5], touches[..., 6] = disc, side, bearing, side * edge[..., 3]
    return touches


@compiled
def turning_on(circle: np.ndarray, edge: np.ndarray) -> np.ndarray:
    """Bearings ``(..., 2)`` at which turning circles touch a disc and have their centres on a circle; NaN for none.

    Args:
        circle: ``(..., 4)`` x, y, its radius, and 1: the disc lies outside of the turning circle, or -1: inside.
        edge: ``(..., 4)`` of the disc, one of `reaches`.
    """
    apart, sign = circle[..., 2], circle[..., 3]
    dx, dy = circle[..., 0] - edge[..., 0], circle[..., 1] - edge[..., 1]
    reach, distance = 1.0 + sign * edge[..., 2], np.sqrt(dx * dx + dy * dy)
    exists = (np.minimum(apart, reach) > 0.0) & (abs(distance - reach) <= apart) & (distance + reach >= apart)
    exists = exists & (distance > 0.0)
    cos = (distance * distance + reach * reach - apart * apart) / np.where(exists, 2.0 * distance * reach, 1.0)
    middle = np.arctan2(dy, dx) + np.where(sign > 0.0, 0.0, np.pi)
    half = np.where(exists, np.arccos(np.minimum(np.maximum(np.where(exists, cos, 0.0), -1.0), 1.0)), np.nan)
    return np.stack([middle - half, middle + half], -1)


def all_touches(
    start: np.ndarray, goal: np.ndarray, discs: np.ndarray, gaps: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Touches on clear tangents, between turning circles, and ``count`` evenly spread a disc and way round.

    Args:
        start: ``(S, 3)`` poses at the origin.
        goal: ``(S, 3)`` poses.
        discs: ``(S, m, 3)``.
        gaps: ``(S, m)``.
        count: How many of the last.

    Returns:
        Touches ``(S, n, 7)`` and a mask ``(S, n)`` of those that exist and lie outside of all discs.
    """
    scenes, m = discs.shape[:2]
    rounds, reach = circles(start, goal, 1.0, discs, gaps), reaches(discs, gaps)
    n = rounds.shape[1]
    exists, headings, _ = tangents(rounds, discs)
    side = np.tile([1.0, -1.0], 2 + m)
    number = np.arange(n) // 2 - 2
    ends = np.stack(np.broadcast_arrays(np.arange(n)[:, None], np.arange(n)), -1)  # of a tangent
    which = np.maximum(number[ends], 0)
    bearing = headings[..., None] - side[ends] * 0.5 * np.pi
    on_lines = touch(reach[:, which], which, side[ends], bearing).reshape(scenes, -1, 7)
    there = (exists[..., None] & (number[ends] >= 0)).reshape(scenes, -1)

    out, sign = np.array([1.0, 1.0, -1.0, -1.0]), np.array([1.0, -1.0, 1.0, -1.0])
    centres = np.empty((scenes, 1, n, 4, 4))
    centres[..., :2], centres[..., 3] = rounds[:, None, :, None, :2], sign
    centres[..., 2] = 1.0 + out * rounds[:, None, :, None, 2]
    between = turning_on(centres, reach[:, :, None, None])
    between = np.where((number == np.arange(m)[:, None])[:, :, None, None], np.nan, between)
    turns = np.broadcast_to((sign * out * side[:, None])[:, :, None], between.shape[1:])
    along = np.arctan2(goal[:, 1], goal[:, 0]) + 0.5 * np.pi
    spread = np.broadcast_to((along[:, None] + np.arange(count) * _FULL / count)[:, None], (scenes, m, count))
    away = reach[:, None, :, :2] - reach[:, :, None, :2]  # a narrow gap is passed at its narrowest place
    gap = np.hypot(away[..., 0], away[..., 1]) - discs[:, :, None, 2] - discs[:, None, :, 2]
    narrow = np.where((gap > 0.0) & (gap < 1.0), np.arctan2(away[..., 1], away[..., 0]), np.nan)
    even = np.repeat(np.concatenate([spread, narrow], -1), 2, axis=-1)
    ways = np.tile([1.0, -1.0], count + m) * np.ones((m, 1))
    bearing = np.concatenate([between.reshape(scenes, m, -1), even], -1)
    sides = np.concatenate([turns.reshape(m, -1), ways], -1)
    others = touch(reach[:, :, None], np.arange(m)[:, None], sides, bearing).reshape(scenes, -1, 7)
    clear = outside(others, discs[:, None])
    return np.concatenate([on_lines, others], 1), np.concatenate([there, clear], 1)
