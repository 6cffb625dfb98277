"""Shortest ways along touches round circular obstacles, for many scenes at once.

Units, scenes and touches are those of `vessel_gym.guidance.touches`. An edge joins two touches by a
Dubins word or, on a disc that is wider than the turning circle, along the disc's edge. Edges of all
scenes are computed as one batch.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from estimators.engine import compiled, repeat
from vessel_gym.guidance.touches import HAIR, all_touches, meets, reaches, touch, turning_on
from vessel_gym.guidance.words import CURVATURES, whole, word_pieces

_SHARES = 1.03, np.inf  # multiples of lower bounds; touches below the first are joined first
_SLIDE = 1e-4  # rad, the smallest slide of a touch; the error of the length is of second order
TOUCHES, DISCS = 8, 4  # numbers of both in one compiled function


# --- edges ----------------------------------------------------------------------------------------


def _words(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pieces ``(..., 6, 3)`` and lengths ``(..., 6)`` of the words between poses, without discs.

    LRL and RLR contain more than half a turn: beside a shorter word they get infinite lengths.
    """
    pieces = word_pieces(a, b, np.ones_like(a[..., 0]))
    words = pieces[..., 0] + pieces[..., 1] + pieces[..., 2]
    short = (words[..., :4].min(-1) <= np.pi)[..., None]
    return pieces, np.concatenate([words[..., :4], np.where(short, np.inf, words[..., 4:])], -1)


@compiled
def free_length(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Lengths ``(...)`` of the shortest words between poses, a lower bound among discs."""
    return _words(a, b)[1].min(-1)


@compiled(axes=(1, 1, 2))
def join(
    a: np.ndarray, b: np.ndarray, discs: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shortest clear ways between touches ``(..., 7)`` among discs ``(..., 4 g, 3)``.

    Returns:
        Lengths of the ways, infinite if none is clear; radii ``(..., 3)`` of the pieces, positive
        to the left and 0 for straights; angles of arcs and lengths of straights ``(..., 3)``.
    """
    pieces, words = _words(a, b)
    follows = (a[..., 3] == b[..., 3]) & (a[..., 6] == b[..., 6]) & (a[..., 6] != 0.0)
    angle, none = whole(a[..., 4] * (b[..., 5] - a[..., 5])), np.zeros_like(a[..., 0])
    along = np.where(follows, angle * abs(a[..., 6]), np.inf)
    lengths = np.concatenate([along[..., None], words], -1)
    extents = np.concatenate([np.stack([angle, none, none], -1)[..., None, :], pieces], -2)

    def clear(lengths: np.ndarray, discs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lengths, infinite for ways across one of the next discs, and the rotated discs."""
        next_discs = discs[..., :DISCS, :]
        met = [meets(a, [a[..., 6]], extents[..., 0, :1], next_discs)]
        for k, bends in enumerate(CURVATURES.tolist(), 1):
            met.append(meets(a, bends, extents[..., k, :], next_discs))
        rest = np.concatenate([discs[..., DISCS:, :], next_discs], -2)
        return np.where(np.stack(met, -1), np.inf, lengths), rest

    lengths, _ = repeat(discs.shape[-2] // DISCS, clear, lengths, discs)
    length, chosen = lengths[..., 0], extents[..., 0, :]
    bends = np.stack([a[..., 6], none, none], -1)
    for way, turns in enumerate(CURVATURES, 1):
        better = lengths[..., way] < length
        length = np.where(better, lengths[..., way], length)
        bends = np.where(better[..., None], turns, bends)
        chosen = np.where(better[..., None], extents[..., way, :], chosen)
    return length, bends, chosen


# --- the shortest way -----------------------------------------------------------------------------


def ways(
    start: np.ndarray, goal: np.ndarray, discs: np.ndarray, count: int, limit: np.ndarray
) -> list[np.ndarray]:
    """Curvatures and lengths ``(k, 2)`` of short ways below limits; empty if no way is found.

    Args:
        start: ``(S, 3)`` poses at the origin.
        goal: ``(S, 3)`` poses.
        discs: ``(S, m, 3)``.
        count: Number of evenly spread touches for each disc and direction.
        limit: ``(S,)`` upper bounds of the lengths.
    """
    edges = reaches(discs, discs[:, None])
    found = _search(start, goal, discs, *all_touches(start, goal, discs, edges, count), limit)
    counts = np.array([len(way) for way in found])
    rest, results = np.nonzero(counts)[0], [np.zeros((0, 2))] * len(found)
    if len(rest):
        touches, index = counts[rest] - 2, np.arange(counts.max())
        padded = np.stack([found[s][np.minimum(index, counts[s] - 1)] for s in rest])
        refined = _refined(padded, touches, edges[rest], discs[rest], np.pi / count)
        for s, pieces in zip(rest, refined, strict=True):
            results[s] = pieces
    return results


def _search(
    start: np.ndarray,
    goal: np.ndarray,
    discs: np.ndarray,
    scene: np.ndarray,
    nodes: np.ndarray,
    limit: np.ndarray,
) -> list[np.ndarray]:
    """Touches ``(k, 7)`` of the shortest ways from start to goal below limits; empty without one.

    Words that ignore the obstacles give a lower bound of the length through each touch. Ways with
    one touch come first: they bound the length, and exclude most touches.
    """
    nowhere = np.tile([-1.0, 0.0, 0.0, 0.0], (len(discs), 1))
    first, last = np.concatenate([start, nowhere], -1), np.concatenate([goal, nowhere], -1)
    ahead, least = free_length(nodes, last[scene]), np.full(len(discs), np.inf)
    within = free_length(first[scene], nodes) + ahead
    np.fmin.at(least, scene, within)
    shortest = np.minimum(join(first, last, discs)[0], limit)
    best, (way, ends) = shortest.copy(), np.full((2, len(scene)), np.inf)
    for share in _SHARES:
        promising = (within < best[scene] * (1.0 + HAIR)) & (within <= share * least[scene])
        i = np.nonzero(promising & (way == np.inf))[0]
        way[i] = join(first[scene[i]], nodes[i], discs[scene[i]])[0]
        ends[i] = join(nodes[i], last[scene[i]], discs[scene[i]])[0]
        np.minimum.at(best, scene[i], way[i] + ends[i])
    kept = np.nonzero(within < best[scene] * (1.0 + HAIR))[0]
    straight = sum(
        np.hypot(*(nodes[kept, i] - p[scene[kept], i] for i in (0, 1))) for p in (first, last)
    )
    kept = kept[np.lexsort((straight, scene[kept]))]
    scene, nodes, way, ends, ahead = (each[kept] for each in (scene, nodes, way, ends, ahead))
    best, by, before = _bellman_ford(scene, nodes, discs, shortest, way, ends, ahead)
    none = np.zeros((0, 7))
    return [
        _back(before, by[s], first[s], last[s], nodes) if best[s] < limit[s] else none
        for s in range(len(discs))
    ]


def _bellman_ford(
    scene: np.ndarray,
    nodes: np.ndarray,
    discs: np.ndarray,
    best: np.ndarray,
    way: np.ndarray,
    ends: np.ndarray,
    ahead: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shortest ways: their lengths and last touches by scene, and all touches' predecessors.

    A last touch of -1 stands for the way of length ``best``, a predecessor of -1 for the start.

    Args:
        scene: ``(n,)`` scenes of the touches, sorted.
        nodes: ``(n, 7)`` touches.
        discs: ``(S, m, 3)``.
        best: ``(S,)`` upper bounds of the lengths.
        way: ``(n,)`` lengths from the start to the touches without another touch between.
        ends: ``(n,)`` lengths from the touches to the goal without another touch between.
        ahead: ``(n,)`` lower bounds of the lengths from the touches to the goal.
    """
    number, by, before = np.arange(len(way)), np.full(len(discs), -1), np.full(len(way), -1)
    fresh, poses = np.ones(len(way), bool), np.ascontiguousarray(nodes[:, :3])
    while True:
        best, by = _relaxed(best, by, scene, number, way + ends)
        fresh &= way + ahead < best[scene]
        u, v = _pairs(scene, np.nonzero(fresh)[0])
        room = np.minimum(way[v], best[scene[v]] - ahead[v]) - way[u]
        u, v, room = u[room > 0.0], v[room > 0.0], room[room > 0.0]
        close = free_length(poses[u], poses[v]) < room
        u, v, known = u[close], v[close], way
        if not len(u):
            return best, by, before
        through = way[u] + join(nodes[u], nodes[v], discs[scene[u]])[0]
        way, before = _relaxed(way, before, v, u, through)
        fresh = way < known


def _pairs(scene: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All pairs of the nodes ``u`` with nodes of their scene; nodes are sorted by ``scene``."""
    sizes = np.bincount(scene)
    counts, begins = sizes[scene[u]], (np.cumsum(sizes) - sizes)[scene[u]]
    v = np.arange(counts.sum()) + np.repeat(begins - np.cumsum(counts) + counts, counts)
    return np.repeat(u, counts), v


def _relaxed(
    lengths: np.ndarray, before: np.ndarray, ends: np.ndarray, by: np.ndarray, through: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Least lengths to nodes and their predecessors, after relaxing edges to ``ends``."""
    least, before = lengths.copy(), before.copy()
    np.minimum.at(least, ends, through)
    taken = (through == least[ends]) & (through < lengths[ends])
    before[ends[taken][::-1]] = by[taken][::-1]  # the first of equal ones
    return least, before


def _back(
    before: np.ndarray, v: int, first: np.ndarray, last: np.ndarray, nodes: np.ndarray
) -> np.ndarray:
    """Touches from the first by way of v to the last; ``before`` holds predecessors, or -1."""
    found = [last]
    while v >= 0:
        found.append(nodes[v])
        v = before[v]
    return np.array([first, *found[::-1]])


# --- refinement -----------------------------------------------------------------------------------


def _refined(
    ways: np.ndarray, touches: np.ndarray, edges: np.ndarray, discs: np.ndarray, step: float
) -> list[np.ndarray]:
    """Curvatures and lengths ``(k, 2)`` of ways after sliding and removing touches.

    Args:
        ways: ``(S, n, 7)`` touches from start to goal, padded by the goal.
        touches: ``(S,)`` numbers of touches between start and goal.
        edges: ``(S, m, 4)`` edges of the discs.
        discs: ``(S, m, 3)``.
        step: First slide of a touch [rad].
    """
    _taut(ways, touches, discs)
    most = -(-ways.shape[1] // TOUCHES) * TOUCHES - ways.shape[1]
    longer = np.concatenate([ways, ways[:, -1:].repeat(most, 1)], 1)
    steps = np.where(touches > 0, step, 0.0)
    ways[:] = _slid(longer, touches.astype(float), edges, discs, steps)[:, : ways.shape[1]]
    results = []
    for legs in zip(*_taut(ways, touches, discs), strict=True):
        pieces: list[list[float]] = []
        for bend, extent in zip(*(part.ravel().tolist() for part in legs), strict=True):
            curvature = 1.0 / bend if bend else 0.0
            if extent > 0.0 and pieces and pieces[-1][0] == curvature:
                pieces[-1][1] += extent * abs(bend or 1.0)
            elif extent > 0.0:
                pieces.append([curvature, extent * abs(bend or 1.0)])
        results.append(np.array(pieces or [[0.0, 0.0]]))
    return results


def _taut(
    ways: np.ndarray, touches: np.ndarray, discs: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Remove touches without which ways are no longer; return radii and extents of the pieces.

    Both are ``(S, n - 1, 3)``.
    """
    n, left = ways.shape[1] - 1, np.zeros(len(ways), int)
    while True:
        a = np.concatenate([ways[:, :-1], ways[:, :-2]], 1)
        b = np.concatenate([ways[:, 1:], ways[:, 2:]], 1)
        length, bends, extents = join(a, b, discs[:, None])
        number = np.arange(n - 1)
        without = length[:, n:] < length[:, : n - 1] + length[:, 1:n] + HAIR
        without &= (number >= left[:, None]) & (number < touches[:, None])
        rows = np.nonzero(without.any(-1))[0]
        if not len(rows):
            return bends[:, :n], extents[:, :n]
        left[rows] = i = without[rows].argmax(-1)
        touches[rows] -= 1
        index = np.arange(n + 1)
        index = np.minimum(index + (index > i[:, None]), n)
        ways[rows] = ways[rows[:, None], index]


def _picked(rows: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Rows ``(..., k)`` of arrays ``(..., m, k)`` at indices ``(...)``, which are clipped."""
    found = rows[..., 0, :]
    for i in range(1, rows.shape[-2]):
        found = np.where((index >= i)[..., None], rows[..., i, :], found)
    return found


def _meeting(
    pose: np.ndarray, option: np.ndarray, other: np.ndarray, edge: np.ndarray
) -> np.ndarray:
    """Touch ``(..., 7)`` beside ``other`` whose arc meets the arc of a pose.

    Args:
        pose: ``(..., 7)`` touch, in which a turning circle begins or ends.
        option: ``(...)`` 0 or 1: one of the two left turns that touch the disc, 2 or 3: right ones.
        other: ``(..., 7)`` a touch of the disc, on the side to keep.
        edge: ``(..., 4)`` edge of the disc.
    """
    turn, sin, cos = np.where(option < 2.0, 1.0, -1.0), np.sin(pose[..., 2]), np.cos(pose[..., 2])
    x, y = pose[..., 0] - turn * sin, pose[..., 1] + turn * cos
    circle = np.stack([x, y, np.zeros_like(x) + 2.0, other[..., 4] * turn], -1)
    bearings = turning_on(circle, edge)
    bearing = np.where((option == 0.0) | (option == 2.0), bearings[..., 0], bearings[..., 1])
    return touch(edge, other[..., 3], other[..., 4], bearing)


def _legs(
    count: np.ndarray, touches: Sequence[np.ndarray], discs: np.ndarray
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Length of the first ``count`` of three legs; their straights, infinite between like turns."""

    def leg(i: np.ndarray, total: np.ndarray, *straights: np.ndarray) -> tuple[np.ndarray, ...]:
        here, there = (_picked(np.stack(ends, -2), i) for ends in (touches[:3], touches[1:]))
        length, bends, extents = join(here, there, discs)
        straight = np.where(bends[..., 0] * bends[..., 2] < 0.0, extents[..., 1], np.inf)
        return i + 1.0, total + length, *straights[1:], straight

    zeros = [np.zeros_like(count)] * 5
    _, total, *straights = repeat(3, leg, *zeros, active=lambda i, *_: i < count)
    return total, straights


def _best_slide(
    touches: Sequence[np.ndarray],
    alone: np.ndarray,
    first: np.ndarray,
    edges: np.ndarray,
    discs: np.ndarray,
    step: np.ndarray,
) -> tuple[np.ndarray, ...]:
    """Best slide that shortens a way: forwards if possible, otherwise backwards.

    Args:
        touches: Four consecutive touches; the second slides alone, or the second and third
            together.
        alone: Mask of the ways in which the second slides alone.
        first: Mask of the ways in which the third slides, and the second moves to where the arcs
            meet.
        edges: Edges of the discs.
        discs: Discs.
        step: Slide [rad].

    Returns:
        Direction 1, -1 or 0 (no slide), the two touches in the middle, and for each of the last
        three legs the straight between opposite turns (infinite without one).
    """
    a, b, c, d = touches
    moving, following = np.where(first[..., None], c, b), np.where(first[..., None], b, c)
    edge, next_edge = _picked(edges, moving[..., 3]), _picked(edges, following[..., 3])
    zero, last = np.zeros_like(step), np.where(alone, 2.0, 8.0)

    def candidate(
        number: np.ndarray, best: np.ndarray, sign: np.ndarray, *kept: np.ndarray
    ) -> tuple[Any, ...]:
        """Candidate by number: the present way, two slides alone, or eight of two touches."""
        as_is, own = number == 0.0, np.where(number <= np.where(alone, 1.0, 4.0), 1.0, -1.0)
        pose = touch(edge, moving[..., 3], moving[..., 4], moving[..., 5] + own * step)
        option = number - np.where(number > 4.0, 5.0, 1.0)
        met = np.where(alone[..., None], c, _meeting(pose, option, following, next_edge))
        low = np.where(as_is[..., None], b, np.where(first[..., None], met, pose))
        high = np.where(as_is[..., None], c, np.where(first[..., None], pose, met))
        allowed = (sign == 0.0) | (sign == own)
        legs = np.where(allowed, np.where(alone, 2.0, 3.0), 0.0)
        total, straights = _legs(legs, (a, low, high, d), discs)
        better = as_is | (allowed & (total < best))
        best = np.where(better, total * np.where(as_is, 1.0 - 1e-12, 1.0), best)
        shorter = better[..., None]
        middle = np.where(shorter, low, kept[0]), np.where(shorter, high, kept[1])
        straights = [np.where(better, *pair) for pair in zip(straights, kept[2:], strict=True)]
        return number + 1.0, best, np.where(better & ~as_is, own, sign), *middle, *straights

    present = zero, zero, zero, b, c, zero, zero, zero
    return repeat(9, candidate, *present, active=lambda number, *_: number <= last)[2:]


def _next_place(
    place: np.ndarray,
    failed: np.ndarray,
    count: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
    step: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Next place of `_slid` and failures in a row, past pairs that cannot slide together.

    Returns:
        Place, 0 after the last one; failures; and mask of ways in which every slide failed, for
        which both begin anew at 0.
    """
    i = np.floor(place / 3.0)
    for k, movable, straight in ((1.0, i > 0.0, before), (2.0, i < count - 1.0, after)):
        together = movable & (straight * straight < 4.0 * step)
        skipped = (place == 3.0 * i + k) & ~together
        place, failed = place + skipped, failed + skipped
    done = failed >= 3.0 * count
    place = np.where(done | (place >= 3.0 * count), 0.0, place)
    return place, np.where(done, 0.0, failed), done


@compiled(axes=(2, 0, 2, 2, 0))
def _slid(
    way: np.ndarray, count: np.ndarray, edges: np.ndarray, discs: np.ndarray, step: np.ndarray
) -> np.ndarray:
    """Touches ``(..., n, 7)`` of a way, slid along edges until no slide of `_SLIDE` shortens it.

    Each touch in turn slides forwards or backwards by the step: alone, with the one before and with
    the one after. The step halves when no slide shortens the way. Where the arcs of two neighbours
    meet without a straight between, neither can slide alone; then one slides, and the other moves
    to where the arcs meet.

    Args:
        way: Touches from the start to the goal, padded by the goal.
        count: Number of touches between start and goal.
        edges: ``(..., m, 4)`` edges of the discs.
        discs: ``(..., m, 3)``.
        step: First slide [rad].
    """

    def attempt(
        way: np.ndarray,
        step: np.ndarray,
        place: np.ndarray,
        failed: np.ndarray,
        before: np.ndarray,
        after: np.ndarray,
    ) -> tuple[np.ndarray, ...]:
        """Slide touch ``place // 3``; ``place % 3``: alone, with the one before or after."""
        i = np.floor(place / 3.0)
        alone, first = place == 3.0 * i, place == 3.0 * i + 1.0
        low = np.where(first, i - 1.0, i)
        a, b, c, d = (_picked(way, low + k) for k in range(4))
        touches = a, b, c, np.where(alone[..., None], c, d)
        sign, b, c, *straights = _best_slide(touches, alone, first, edges, discs, step)
        changed, rows = np.where(sign == 0.0, np.inf, low), [way[..., 0, :]]
        for n in range(1, way.shape[-2]):
            row = np.where((changed == n - 1.0)[..., None], b, way[..., n, :])
            rows.append(np.where((changed == n - 2.0)[..., None], c, row))
        before = np.where(alone, straights[1], before)
        after = np.where(alone | first, straights[2], after)
        failed, place = np.where(sign == 0.0, failed + 1.0, 0.0), place + 1.0
        place, failed, done = _next_place(place, failed, count, before, after, step)
        return np.stack(rows, -2), np.where(done, 0.5 * step, step), place, failed, before, after

    zero = np.zeros_like(step)
    begin = way, step, zero, zero, zero, zero
    return repeat(10**6, attempt, *begin, active=lambda way, step, *_: step > _SLIDE)[0]
