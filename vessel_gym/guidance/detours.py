"""Paths of bounded curvature round circular obstacles: the shortest one in a graph of places where a path can touch.

Between two places where it touches obstacles, a shortest path is one of Dubins' six words; along an obstacle that is
wider than the turn radius it may follow the edge (Boissonnat & Lazard 1996, A polynomial-time algorithm for computing
a shortest path of bounded curvature amidst moderate obstacles). So the nodes of the graph are *touches*: poses on the
edge of a clearance circle, along it, either way round. They are the ends of the common tangents of clearance circles
and of the turning circles of start and goal, and evenly spread ones between. Edges are the shortest words and arcs
that keep clear. A* finds the shortest way through; then each touch slides along its edge until no slide shortens it.

Inside, lengths count in turn radii from the start's position. Clearance circles are ``(m, 3)`` x, y, radius; touches
are rows ``(n, 6)`` x, y, heading, circle (none: -1), side (1: the circle is on the left, -1: on the right) and
bearing from the circle's centre.
"""

from dataclasses import replace

import numpy as np
from numba import njit

from estimators import wrap
from estimators.compiled import gufunc, lazy
from vessel_gym.guidance.words import (
    Path,
    advance,
    chain,
    checked,
    follow_on,
    numbers,
    pieces_of,
    relative,
    shortest,
    whole,
)

_FULL = 2.0 * np.pi
_HAIR = 1e-9  # turn radii that touches keep from edges, so that what touches one passes the check
_FAR = 1e6  # turn radii: farther off, a hair is rounding
_NOWHERE = -1.0
_START, _GOAL = -1.0, -2.0  # kinds of circles that belong to no obstacle
_ALONG = 6  # follows the edge; lower numbers are words
_SIDES = np.array([[1, 0, 1], [1, 0, -1], [-1, 0, 1], [-1, 0, -1], [1, -1, 1], [-1, 1, -1]], float)  # of the words

TOUCHES = 12, 48
"""Evenly spread touches a clearance circle and way round, and in the second search, for what is shorter."""
_NEAR = 1.01  # times its lower bound: a path as short as that needs no second search
_SLIDE = 1e-4  # rad, the smallest slide of a touch: what it leaves is of its square


class NoPath(ValueError):
    """No path was found; where the way is not shown to be closed, this is no proof that there is none."""


# --- what keeps clear -------------------------------------------------------------------------------


@njit(error_model="numpy")
def _put(row: np.ndarray, values: np.ndarray) -> None:
    """Writes values to the beginning of a row; Numba takes a second to compile ``row[:] = values``."""
    for k in range(len(values)):
        row[k] = values[k]


@njit(error_model="numpy")
def _far(a: np.ndarray, b: np.ndarray) -> float:
    return np.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2)


@njit(error_model="numpy")
def _straight_clear(x: float, y: float, cos: float, sin: float, length: float, discs: np.ndarray) -> bool:
    """Whether a straight keeps out of all discs."""
    for k in range(len(discs)):
        dx, dy = discs[k, 0] - x, discs[k, 1] - y
        along = min(max(dx * cos + dy * sin, 0.0), length)
        ax, ay = dx - along * cos, dy - along * sin
        if ax * ax + ay * ay < discs[k, 2] * discs[k, 2]:
            return False
    return True


@njit(error_model="numpy")
def _arc_clear(x: float, y: float, heading: float, bend: float, angle: float, discs: np.ndarray) -> bool:
    """Whether an arc from a place that is clear, of radius ``bend`` (L positive), keeps out of all discs."""
    radius, side = abs(bend), 1.0 if bend > 0.0 else -1.0
    cx, cy = x - bend * np.sin(heading), y + bend * np.cos(heading)
    for k in range(len(discs)):
        dx, dy = discs[k, 0] - cx, discs[k, 1] - cy
        square, room = dx * dx + dy * dy, discs[k, 2]
        if square >= (radius + room) ** 2 or (radius >= room and square <= (radius - room) ** 2):
            continue
        nearest = whole(side * (np.arctan2(dy, dx) - heading) + 0.5 * np.pi)
        if nearest < angle:
            return False
        ex, ey = dx - bend * np.sin(heading + side * angle), dy + bend * np.cos(heading + side * angle)
        if ex * ex + ey * ey < room * room:
            return False
    return True


@njit(error_model="numpy")
def _word_clear(pose: np.ndarray, word: int, pieces: tuple[float, float, float], discs: np.ndarray) -> bool:
    """Whether a word from a pose keeps out of all discs."""
    x, y, heading = pose[0], pose[1], pose[2]
    for k in range(3):
        length, side = pieces[k], _SIDES[word, k]
        if length == 0.0:
            continue
        if side == 0.0:
            if not _straight_clear(x, y, np.cos(heading), np.sin(heading), length, discs):
                return False
        elif not _arc_clear(x, y, heading, side, length, discs):
            return False
        x, y, heading = follow_on(length, x, y, heading, side)
    return True


@njit(error_model="numpy")
def _join(a: np.ndarray, b: np.ndarray, discs: np.ndarray, limit: float) -> tuple[int, float, float]:
    """The shortest clear way from one touch to another below a limit.

    Returns:
        Which word, `_ALONG` or -1 for none; its length, or the limit; the length of the shortest word, clear or not.
    """
    best, length, free = -1, limit, np.inf
    if a[3] >= 0.0 and a[3] == b[3] and a[4] == b[4] and discs[int(a[3]), 2] >= 1.0:
        radius, angle = _far(a, discs[int(a[3])]), whole(a[4] * (b[5] - a[5]))
        if angle * radius < length and _arc_clear(a[0], a[1], a[2], a[4] * radius, angle, discs):
            best, length = _ALONG, angle * radius
    seen = relative(a, b, 1.0)
    for word in range(6):
        if word >= 4 and min(free, length) <= np.pi:  # LRL and RLR turn farther
            break
        pieces = pieces_of(word, seen)
        total = pieces[0] + pieces[1] + pieces[2]
        free = min(free, total)
        if total < length and _word_clear(a, word, pieces, discs):
            best, length = word, total
    return best, length, free


# --- tangents and touches ---------------------------------------------------------------------------


@njit(error_model="numpy")
def _circles(start: np.ndarray, goal: np.ndarray, turn: float, discs: np.ndarray, gaps: np.ndarray) -> np.ndarray:
    """Directed circles ``(4 + 2 m, 5)`` x, y, radius, side, kind: the turning circles of both poses, then the discs."""
    circles = np.empty((4 + 2 * len(discs), 5))
    for i in range(4):
        pose, side = (start if i < 2 else goal), 1.0 - 2.0 * (i % 2)
        circles[i, 0], circles[i, 1] = pose[0] - side * turn * np.sin(pose[2]), pose[1] + side * turn * np.cos(pose[2])
        circles[i, 2], circles[i, 3], circles[i, 4] = turn, side, _START if i < 2 else _GOAL
    for k in range(len(discs)):
        for i in range(2):
            row = circles[4 + 2 * k + i]
            row[0], row[1], row[2] = discs[k, 0], discs[k, 1], discs[k, 2] + gaps[k]
            row[3], row[4] = 1.0 - 2.0 * i, k
    return circles


@njit(error_model="numpy")
def _tangents(circles: np.ndarray, discs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The clear straights from one directed circle to another.

    On a circle that turns to side +-1, the point of heading psi is the centre + side radius (sin psi, -cos psi).

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


@njit(error_model="numpy", inline="always")
def _gaps(discs: np.ndarray) -> np.ndarray:
    """What touches keep from each edge: a hair, or half of the narrowest gap to another circle if that is less."""
    gaps = np.full(len(discs), _HAIR)
    for k in range(len(discs)):
        for j in range(len(discs)):
            gap = _far(discs[k], discs[j]) - discs[k, 2] - discs[j, 2]
            if gap > 0.0:
                gaps[k] = min(gaps[k], 0.5 * gap)
    return gaps


@njit(error_model="numpy")
def _set_touch(row: np.ndarray, disc: int, side: float, bearing: float, discs: np.ndarray, gaps: np.ndarray) -> None:
    reach = discs[disc, 2] + gaps[disc]
    row[0], row[1] = discs[disc, 0] + reach * np.cos(bearing), discs[disc, 1] + reach * np.sin(bearing)
    row[2], row[3], row[4], row[5] = bearing + side * 0.5 * np.pi, disc, side, bearing


@njit(error_model="numpy")
def _outside(row: np.ndarray, discs: np.ndarray) -> bool:
    outside = True
    for k in range(len(discs)):
        outside &= (row[0] - discs[k, 0]) ** 2 + (row[1] - discs[k, 1]) ** 2 >= discs[k, 2] ** 2
    return outside


@njit(error_model="numpy", inline="always")
def _touches(start: np.ndarray, goal: np.ndarray, discs: np.ndarray, gaps: np.ndarray, count: int) -> np.ndarray:
    """The nodes of the graph ``(n, 6)``: start, touches, goal."""
    m = len(discs)
    circles = _circles(start, goal, 1.0, discs, gaps)
    pairs, lines = _tangents(circles, discs)
    rows = np.empty((2 + 2 * len(pairs) + 2 * m * (count + m) + 8 * m * len(circles), 6))
    rows[0, 3:] = _NOWHERE
    _put(rows[0], start)
    n = 1
    for e in range(len(pairs)):
        for i in pairs[e]:
            if i >= 4:
                side = circles[i, 3]
                _set_touch(rows[n], (i - 4) // 2, side, lines[e, 0] - side * 0.5 * np.pi, discs, gaps)
                n += 1
    along = np.arctan2(goal[1] - start[1], goal[0] - start[0]) + 0.5 * np.pi
    for k in range(m):
        for i in range(len(circles)):
            if i >= 4 and (i - 4) // 2 == k:
                continue
            for out in (1.0, -1.0):
                for sign in (1.0, -1.0):
                    for bearing in _turning_on(circles[i], 1.0 + out * circles[i, 2], discs[k], gaps[k], sign):
                        _set_touch(rows[n], k, sign * out * circles[i, 3], bearing, discs, gaps)
                        n += _outside(rows[n], discs)
        for i in range(count + m):
            if i < count:
                bearing = along + i * _FULL / count
            else:  # a narrow gap is passed at its narrowest place
                other = discs[i - count]
                if not 0.0 < _far(discs[k], other) - discs[k, 2] - other[2] < 1.0:
                    continue
                bearing = np.arctan2(other[1] - discs[k, 1], other[0] - discs[k, 0])
            for side in (1.0, -1.0):
                _set_touch(rows[n], k, side, bearing, discs, gaps)
                n += _outside(rows[n], discs)
    rows[n, 3:] = _NOWHERE
    _put(rows[n], goal)
    return rows[: n + 1].copy()


@njit(error_model="numpy")
def _turning_on(circle: np.ndarray, apart: float, disc: np.ndarray, gap: float, sign: float) -> np.ndarray:
    """The bearings at which the turning circles touch a disc whose centres lie ``apart`` from that of a circle.

    Args:
        circle: x, y: a circle that the turning circles are to touch.
        apart: 1 and its radius for those beside it, 1 less its radius for those about it.
        disc: What else to touch.
        gap: What to keep from its edge.
        sign: 1: the disc lies outside of the turning circle, -1: inside.

    Returns:
        Two bearings from the disc's centre, or none.
    """
    dx, dy = circle[0] - disc[0], circle[1] - disc[1]
    reach, distance = 1.0 + sign * (disc[2] + gap), np.sqrt(dx * dx + dy * dy)
    if min(apart, reach) <= 0.0 or abs(distance - reach) > apart or distance + reach < apart or distance == 0.0:
        return np.empty(0)
    cos = (distance * distance + reach * reach - apart * apart) / (2.0 * distance * reach)
    middle, half = np.arctan2(dy, dx) + (0.0 if sign > 0.0 else np.pi), np.arccos(min(max(cos, -1.0), 1.0))
    return np.array([middle - half, middle + half])


# --- the shortest way -------------------------------------------------------------------------------


@njit(error_model="numpy", inline="always")
def _search(nodes: np.ndarray, discs: np.ndarray, limit: float) -> np.ndarray:
    """The rows of ``nodes`` on the shortest way from the first to the last below a limit, by A*; none if there is none.

    Words that ignore the obstacles say how much is left at least. Ways with one touch come first: they bound the
    length, and most touches then lie too far off for any way.
    """
    last = len(nodes) - 1
    way, ahead = np.full(last + 1, np.inf), np.zeros(last + 1)
    before, kept = np.zeros(last + 1, np.int64), np.zeros(last + 1, np.int64)
    way[0], way[last] = 0.0, _join(nodes[0], nodes[last], discs, limit)[1]
    straight = np.array([_far(nodes[0], node) + _far(node, nodes[last]) for node in nodes])
    count = 0
    for v in np.argsort(straight):
        if v == 0 or v == last or straight[v] >= way[last]:
            continue
        on, rest, ahead[v] = _join(nodes[v], nodes[last], discs, way[last] - _far(nodes[0], nodes[v]))
        if _far(nodes[0], nodes[v]) + ahead[v] >= way[last]:
            continue
        how, length, free = _join(nodes[0], nodes[v], discs, way[last] - ahead[v])
        if free + ahead[v] < way[last]:
            kept[count] = v
            count += 1
            if how >= 0:
                way[v] = length
                if on >= 0 and length + rest < way[last]:
                    way[last], before[last] = length + rest, v
    kept[count] = last
    while True:
        chosen = count
        for i in range(count):
            if way[kept[i]] + ahead[kept[i]] < way[kept[chosen]] + ahead[kept[chosen]]:
                chosen = i
        u = kept[chosen]
        if u == last:
            break
        count -= 1
        for i in range(chosen, count + 1):
            kept[i] = kept[i + 1]
        for v in kept[: count + 1]:
            room = min(way[v], way[last] - ahead[v]) - way[u]
            if _far(nodes[u], nodes[v]) < room:
                how, length, _ = _join(nodes[u], nodes[v], discs, room)
                if how >= 0:
                    way[v], before[v] = way[u] + length, u
    if way[last] == limit:
        return nodes[:0].copy()
    count, v = 1, last
    while v > 0:
        v, count = before[v], count + 1
    found, v = np.empty((count, 6)), last
    for i in range(count - 1, -1, -1):
        _put(found[i], nodes[v])
        v = before[v]
    return found


@njit(error_model="numpy")
def _taut(way: np.ndarray, discs: np.ndarray) -> np.ndarray:
    """The way without the touches that it is no longer without."""
    i = 1
    while i < len(way) - 1:
        length = _join(way[i - 1], way[i], discs, np.inf)[1] + _join(way[i], way[i + 1], discs, np.inf)[1]
        if _join(way[i - 1], way[i + 1], discs, length + _HAIR)[0] >= 0:
            way = np.concatenate((way[:i], way[i + 1 :]))
        else:
            i += 1
    return way


@njit(error_model="numpy")
def _legs(way: np.ndarray, i: int, j: int, discs: np.ndarray, limit: float) -> float:
    """The length of the way from touch i to touch j, or something above the limit."""
    length = 0.0
    for k in range(i, j):
        if length < limit:
            how, leg, _ = _join(way[k], way[k + 1], discs, limit - length)
            length = length + leg if how >= 0 else np.inf
    return length


@njit(error_model="numpy", inline="always")
def _follow(way: np.ndarray, i: int, j: int, discs: np.ndarray, gaps: np.ndarray, limit: float) -> float:
    """Set touch j so that an arc through it goes over into one through its neighbour i without a straight between.

    Returns:
        The length from before both to after both, or infinity where none is below the limit; then nothing is set.
    """
    first, last = min(i, j) - 1, max(i, j) + 1
    kept, best = way[j].copy(), way[j].copy()
    disc, least = int(kept[3]), limit
    circle = np.empty(2)
    for side in (1.0, -1.0):
        circle[0], circle[1] = way[i, 0] - side * np.sin(way[i, 2]), way[i, 1] + side * np.cos(way[i, 2])
        for bearing in _turning_on(circle, 2.0, discs[disc], gaps[disc], kept[4] * side):
            _set_touch(way[j], disc, kept[4], bearing, discs, gaps)
            if _outside(way[j], discs):
                length = _legs(way, first, last, discs, least)
                if length < least:
                    least = length
                    _put(best, way[j])
    _put(way[j], best)
    return least if least < limit else np.inf


@njit(error_model="numpy", inline="always")
def _slide(way: np.ndarray, discs: np.ndarray, gaps: np.ndarray, step: float) -> None:
    """Move the touches along their edges until no slide of `_SLIDE` shortens the way.

    Where two neighbours' arcs meet without a straight between, neither can slide alone: then one follows the other.
    """
    row = np.empty(6)
    while step > _SLIDE:
        better = False
        for i in range(1, len(way) - 1):
            for j in (i, i - 1, i + 1):
                if not 0 < j < len(way) - 1 or (j != i and not _meet(way[min(i, j)], way[max(i, j)], discs, step)):
                    continue
                first, last = min(i, j) - 1, max(i, j) + 1
                limit = _legs(way, first, last, discs, np.inf) * (1.0 - 1e-12)
                for sign in (1.0, -1.0):
                    _put(row, way[i])
                    _set_touch(way[i], int(row[3]), row[4], row[5] + sign * step, discs, gaps)
                    if _outside(way[i], discs):
                        if j == i:
                            length = _legs(way, first, last, discs, limit)
                        else:
                            length = _follow(way, i, j, discs, gaps, limit)
                        if length < limit:
                            better, limit = True, length
                            break
                    _put(way[i], row)
        if not better:
            step *= 0.5


@njit(error_model="numpy", inline="always")
def _meet(a: np.ndarray, b: np.ndarray, discs: np.ndarray, step: float) -> bool:
    """Whether the way between touches turns both ways with so short a straight between that a step could close it."""
    how = _join(a, b, discs, np.inf)[0]
    return (how == 1 or how == 2) and pieces_of(how, relative(a, b, 1.0))[1] ** 2 < 4.0 * step


@njit(error_model="numpy", inline="always")
def _pieces(way: np.ndarray, discs: np.ndarray) -> np.ndarray:
    """Curvatures and lengths ``(k, 2)`` of a way, successive ones of one curvature joined."""
    pieces, count = np.zeros((1 + 3 * len(way), 2)), 0
    for i in range(len(way) - 1):
        how, length, _ = _join(way[i], way[i + 1], discs, np.inf)
        sides, parts = np.zeros(3), (length, 0.0, 0.0)
        if how == _ALONG:
            sides[0] = way[i, 4] / _far(way[i], discs[int(way[i, 3])])
        else:
            sides, parts = _SIDES[how], pieces_of(how, relative(way[i], way[i + 1], 1.0))
        for k in range(3):
            if parts[k] > 0.0:
                count += pieces[count, 1] > 0.0 and pieces[count, 0] != sides[k]
                pieces[count, 0] = sides[k]
                pieces[count, 1] += parts[k]
    return pieces[: count + (len(way) > 0)].copy()


# --- the string -------------------------------------------------------------------------------------


@njit(error_model="numpy", inline="always")
def _string(start: np.ndarray, goal: np.ndarray, discs: np.ndarray) -> float:
    """The length of the shortest way that may bend as sharply as it likes; infinite where there is none.

    The discs are smaller by a hair or two here: poses may lie on their edge, and no rounding closes a gap.
    """
    discs = discs.copy()
    for disc in discs:
        disc[2] = max(disc[2] - 2.0 * _HAIR, 0.0)
    circles = _circles(start, goal, 0.0, discs, np.full(len(discs), _HAIR))
    pairs, lines = _tangents(circles, discs)
    e = len(pairs)
    owner, turned = np.empty(2 * e, np.int64), np.empty(2 * e)  # where tangents leave their circle, where they arrive
    for i in range(e):
        for end in range(2):
            owner[i + end * e] = pairs[i, end]
            turned[i + end * e] = (circles[pairs[i, end], 3] * lines[i, 0]) % _FULL
    order = np.argsort(owner * 7.0 + turned)
    arcs, angles = _arcs(circles, discs, owner[order], turned[order])
    way = np.full(2 * e, np.inf)
    for i in range(e):
        if pairs[i, 0] < 2:
            way[i] = 0.0
    changed = True
    while changed:  # Bellman and Ford
        changed = False
        for i in range(e):
            if way[i] + lines[i, 1] < way[e + i]:
                way[e + i] = way[i] + lines[i, 1]
                changed = True
        for i in range(len(arcs)):
            tail, head = order[arcs[i, 0]], order[arcs[i, 1]]
            reached = way[tail] + angles[i] * circles[owner[tail], 2]
            if reached < way[head]:
                way[head] = reached
                changed = True
    least = np.inf
    for i in range(e):
        if circles[pairs[i, 1], 4] == _GOAL:
            least = min(least, way[e + i])
    return least


@njit(error_model="numpy", inline="always")
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
    count = first = 0
    while first < points:
        last = first
        while last < points and owner[last] == owner[first]:
            last += 1
        x, y, radius, side = circles[owner[first]][:4]
        for p in range(first, last):
            following = p + 1 if p + 1 < last else first
            angle = (turned[following] - turned[p]) % _FULL
            heading = side * turned[p]
            ax, ay = x + side * radius * np.sin(heading), y - side * radius * np.cos(heading)
            if following != p and _arc_clear(ax, ay, heading, side * radius, angle, discs):
                pairs[count, 0], pairs[count, 1], angles[count] = p, following, angle
                count += 1
        first = last
    return pairs[:count].copy(), angles[:count].copy()


# --- the check --------------------------------------------------------------------------------------


@gufunc("void(float64[:, :], float64[:, :], float64[:])", "(k,s),(m,p)->(m)")
def _approach(segments: np.ndarray, points: np.ndarray, nearest: np.ndarray) -> None:
    for k in range(len(points)):
        nearest[k] = np.inf
    for i in range(len(segments)):
        x, y, heading, curvature, length = (
            segments[i, 0], segments[i, 1], segments[i, 2], segments[i, 3], segments[i, 4],
        )  # fmt: skip
        cos, sin = np.cos(heading), np.sin(heading)
        ex, ey, _ = follow_on(length, x, y, heading, curvature)
        for k in range(len(points)):
            dx, dy = points[k, 0] - x, points[k, 1] - y
            ahead, left = dx * cos + dy * sin, dy * cos - dx * sin
            if curvature == 0.0:
                distance = np.hypot(ahead - min(max(ahead, 0.0), length), left)
            else:
                radius, side = 1.0 / max(abs(curvature), 1e-300), 1.0 if curvature > 0.0 else -1.0
                beside = radius - side * left  # from the point to the centre
                if np.arctan2(ahead, beside) % _FULL * radius <= length:
                    distance = abs(np.hypot(ahead, beside) - radius)
                else:
                    distance = min(np.hypot(dx, dy), np.hypot(points[k, 0] - ex, points[k, 1] - ey))
            nearest[k] = min(nearest[k], distance)


def approach(path: Path, points: np.ndarray) -> np.ndarray:
    """The distance ``(m,)`` [m] at which a path passes points ``(m, 2)``, in closed form.

    Args:
        path: The path.
        points: x, y [m].
    """
    return _approach(path.segments, points)


def _sound(segments: np.ndarray, goal: np.ndarray, radius: float, discs: np.ndarray) -> bool:
    """Whether a path ends at the goal, turns no tighter than the radius and keeps out of all discs."""
    last = segments[-1]
    off = advance(last[:3], last[3], last[4]) - goal
    off[2] = radius * wrap(off[2])
    size = radius + np.abs(goal[:2]).max() + segments[:, 4].sum()
    bends = np.abs(segments[:, 3]).max() * radius <= 1.0 + 1e-12
    return bool(np.abs(off).max() <= 1e-9 * size and bends and (_approach(segments, discs[:, :2]) >= discs[:, 2]).all())


# --- planning ---------------------------------------------------------------------------------------


@lazy(
    njit(
        "Tuple((float64, float64[:, ::1]))(float64[::1], float64[::1], float64[:, ::1], int64, float64)",
        cache=True, error_model="numpy",
    )
)  # fmt: skip
def _way(start: np.ndarray, goal: np.ndarray, discs: np.ndarray, count: int, limit: float) -> tuple[float, np.ndarray]:
    """A lower bound and the curvatures and lengths ``(k, 2)`` of a way below a limit, if any, all in turn radii."""
    bound = _string(start, goal, discs)
    if bound == np.inf:
        return bound, np.empty((0, 2))
    gaps = _gaps(discs)
    way = _search(_touches(start, goal, discs, gaps, count), discs, limit)
    if len(way):
        way = _taut(way, discs)
        _slide(way, discs, gaps, np.pi / count)
        way = _taut(way, discs)
    return bound, _pieces(way, discs)


def _detour(
    start: np.ndarray, goal: np.ndarray, radius: float, obstacles: np.ndarray, count: int, limit: float
) -> tuple[float, np.ndarray]:
    """A lower bound [m] and the curvatures [1/m] and lengths [m] ``(k, 2)`` of a way below a limit [m], if any."""
    origin = [start[0], start[1], 0.0]
    discs, to = np.ascontiguousarray((obstacles - origin) / radius), (goal - origin) / [radius, radius, 1.0]
    bound, pieces = _way(np.array([0.0, 0.0, start[2]]), to, discs, count, limit / radius)
    return bound * radius, pieces * [1.0 / radius, radius]


def plan(start: np.ndarray, goal: np.ndarray, radius: float, obstacles: np.ndarray, margin: float = 0.0) -> Path:
    """A short path between two poses that keeps clear of circular obstacles; `shortest` if that does.

    Otherwise the shortest way from touch to touch that passed the check of clearance, curvature and arrival: a short
    path, not provably the shortest. No path is shorter than its ``lower_bound``.

    Args:
        start: ``(3,)`` pose [m, m, rad].
        goal: ``(3,)`` pose.
        radius: Turn radius [m], the tightest turn.
        obstacles: ``(m, 3)`` x, y and radius [m], as many as there are, overlapping or not.
        margin: Distance [m] to keep from them.

    Raises:
        NoPath: (a ValueError) if none was found; the message tells a closed way, which is certain, from a search
            that failed.
        ValueError: for numbers that make no sense, for a start or a goal within the margin of an obstacle, and for a
            way round obstacles over more than a million turn radii, where rounding decides.
    """
    direct = shortest(start, goal, radius)
    start, goal, _ = checked(start, goal, radius)
    discs = _discs(obstacles, margin)
    for name, pose in (("start", start), ("goal", goal)):
        if (np.square(discs[:, :2] - pose[:2]).sum(-1) < np.square(discs[:, 2])).any():
            depth = discs[:, 2] - np.hypot(discs[:, 0] - pose[0], discs[:, 1] - pose[1])
            raise ValueError(
                f"the {name} is {depth.max():.6g} m inside obstacle {depth.argmax()} or its margin: move the {name} or "
                "the obstacle, or ask for less margin"
            )
    if _sound(direct.segments, goal, float(radius), discs):
        return direct
    size = np.abs(np.concatenate([discs - [*start[:2], 0.0], [goal - start]])[:, :2]).max() / float(radius)
    if size > _FAR:
        raise ValueError(
            f"poses and obstacles must lie within {_FAR:.0e} turn radii of each other for a way round, got {size:.0e}: "
            "turn wider or leave out what is far away"
        )
    path = None
    for count in TOUCHES:
        bound, pieces = _detour(start, goal, float(radius), discs, count, path.length if path else np.inf)
        if bound == np.inf:
            raise NoPath(
                "the obstacles with their margin close every way to the goal: ask for less margin or remove an obstacle"
            )
        if len(pieces):
            found = chain(start, pieces[:, 0], pieces[:, 1])
            if _sound(found.segments, goal, float(radius), discs):
                path = replace(found, lower_bound=min(max(bound, direct.length), found.length))
        if path and path.length <= _NEAR * path.lower_bound:
            break
    if path:
        return path
    raise NoPath(
        f"no path with turns of {radius:.6g} m or more was found, which does not prove that there is none: move the "
        "poses away from the obstacles, turn tighter or ask for less margin"
    )


def _discs(obstacles: np.ndarray, margin: float) -> np.ndarray:
    """The clearance circles ``(m, 3)``.

    Raises:
        ValueError: for obstacles that are no circles, or a margin that is negative.
    """
    obstacles, room = numbers("obstacles", obstacles), numbers("margin", margin)
    if obstacles.size == 0:
        obstacles = np.zeros((0, 3))
    if obstacles.ndim != 2 or obstacles.shape[1] != 3:
        raise ValueError(f"obstacles must be rows (x, y, radius), got shape {obstacles.shape}")
    if not np.isfinite(obstacles).all() or (obstacles[:, 2] < 0.0).any():
        bad = ~np.isfinite(obstacles).all(-1) | (obstacles[:, 2] < 0.0)
        raise ValueError(f"obstacle {bad.argmax()} must have finite numbers and a radius of 0 or more: correct it")
    if room.ndim or not 0.0 <= room < np.inf:
        raise ValueError(f"the margin must be finite and 0 or more, got {margin}")
    return obstacles + [0.0, 0.0, float(room)]
