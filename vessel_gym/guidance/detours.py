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

from estimators.checks import finite_array
from estimators.compiled import gufunc, lazy, part
from vessel_gym.checks import instance
from vessel_gym.guidance.words import (
    Path,
    _follow_on,
    chain,
    checked,
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


Touch = tuple[float, float, float, float, float, float]


class NoPath(ValueError):
    """No path was found; where the way is not shown to be closed, this is no proof that there is none."""


# --- what keeps clear -------------------------------------------------------------------------------


@part
def _row(rows: np.ndarray, i: int) -> Touch:
    """A touch as a tuple: Numba takes many times as long to compile what passes rows of arrays on."""
    return rows[i, 0], rows[i, 1], rows[i, 2], rows[i, 3], rows[i, 4], rows[i, 5]


@part
def _put(rows: np.ndarray, i: int, touch: Touch) -> None:
    rows[i, 0], rows[i, 1], rows[i, 2], rows[i, 3], rows[i, 4], rows[i, 5] = touch


@part
def _far(ax: float, ay: float, bx: float, by: float) -> float:
    return np.sqrt((ax - bx) ** 2 + (ay - by) ** 2)


@part
def _apart(rows: np.ndarray, i: int, j: int) -> float:
    return _far(rows[i, 0], rows[i, 1], rows[j, 0], rows[j, 1])


@part
def _straight_clear(x: float, y: float, cos: float, sin: float, length: float, discs: np.ndarray) -> bool:
    """Whether a straight keeps out of all discs."""
    for k in range(len(discs)):
        dx, dy = discs[k, 0] - x, discs[k, 1] - y
        along = min(max(dx * cos + dy * sin, 0.0), length)
        ax, ay = dx - along * cos, dy - along * sin
        if ax * ax + ay * ay < discs[k, 2] * discs[k, 2]:
            return False
    return True


@part
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


@part
def _word_clear(pose: Touch, word: int, pieces: tuple[float, float, float], discs: np.ndarray) -> bool:
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
        x, y, heading = _follow_on(length, x, y, heading, side)
    return True


@part
def _join(a: Touch, b: Touch, discs: np.ndarray, limit: float) -> tuple[int, float, float]:
    """The shortest clear way from one touch to another below a limit.

    Returns:
        Which word, `_ALONG` or -1 for none; its length, or the limit; the length of the shortest word, clear or not.
    """
    best, length, free = -1, limit, np.inf
    disc = int(max(a[3], 0.0))
    if a[3] >= 0.0 and a[3] == b[3] and a[4] == b[4] and discs[disc, 2] >= 1.0:
        radius, angle = _far(a[0], a[1], discs[disc, 0], discs[disc, 1]), whole(a[4] * (b[5] - a[5]))
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


@part
def _circles(start: np.ndarray, goal: np.ndarray, turn: float, discs: np.ndarray, gaps: np.ndarray) -> np.ndarray:
    """Directed circles ``(4 + 2 m, 5)`` x, y, radius, side, kind: the turning circles of both poses, then the discs."""
    circles = np.empty((4 + 2 * len(discs), 5))
    for i in range(len(circles)):
        side = 1.0 - 2.0 * (i % 2)
        if i < 4:
            pose = start if i < 2 else goal
            x, y = pose[0] - side * turn * np.sin(pose[2]), pose[1] + side * turn * np.cos(pose[2])
            radius, kind = turn, _START if i < 2 else _GOAL
        else:
            k = (i - 4) // 2
            x, y, radius, kind = discs[k, 0], discs[k, 1], discs[k, 2] + gaps[k], float(k)
        circles[i, 0], circles[i, 1], circles[i, 2], circles[i, 3], circles[i, 4] = x, y, radius, side, kind
    return circles


@part
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
    return pairs[:count], lines[:count]


@part
def _gaps(discs: np.ndarray) -> np.ndarray:
    """What touches keep from each edge: a hair, or half of the narrowest gap to another circle if that is less."""
    gaps = np.full(len(discs), _HAIR)
    for k in range(len(discs)):
        for j in range(len(discs)):
            apart = _far(discs[k, 0], discs[k, 1], discs[j, 0], discs[j, 1]) - discs[k, 2] - discs[j, 2]
            if apart > 0.0:
                gaps[k] = min(gaps[k], 0.5 * apart)
    return gaps


@part
def _touch(disc: int, side: float, bearing: float, discs: np.ndarray, gaps: np.ndarray) -> Touch:
    reach = discs[disc, 2] + gaps[disc]
    x, y = discs[disc, 0] + reach * np.cos(bearing), discs[disc, 1] + reach * np.sin(bearing)
    return x, y, bearing + side * 0.5 * np.pi, float(disc), side, bearing


@part
def _outside(touch: Touch, discs: np.ndarray) -> bool:
    outside = True
    for k in range(len(discs)):
        outside &= (touch[0] - discs[k, 0]) ** 2 + (touch[1] - discs[k, 1]) ** 2 >= discs[k, 2] ** 2
    return outside


@part
def _touches(
    circles: np.ndarray, pairs: np.ndarray, lines: np.ndarray, discs: np.ndarray, gaps: np.ndarray, along: float,
    count: int,
) -> np.ndarray:  # fmt: skip
    """The touches ``(n, 6)`` on clear ``lines`` between ``pairs`` of circles, between turning circles, and others.

    Args:
        circles: ``(4 + 2 m, 5)``.
        pairs: ``(e, 2)``.
        lines: ``(e, 2)`` headings and lengths.
        discs: ``(m, 3)``.
        gaps: ``(m,)``.
        along: The bearing of the first of the evenly spread ones [rad].
        count: How many of these a circle and way round.
    """
    m = len(discs)
    rows = np.empty((2 * len(pairs) + 2 * m * (count + m) + 8 * m * len(circles), 6))
    n = 0
    for e in range(len(pairs)):
        for end in range(2):
            i = pairs[e, end]
            if i >= 4:
                side = circles[i, 3]
                _put(rows, n, _touch((i - 4) // 2, side, lines[e, 0] - side * 0.5 * np.pi, discs, gaps))
                n += 1
    for k in range(m):
        for i in range(len(circles)):
            if i >= 4 and (i - 4) // 2 == k:
                continue
            for way in range(4):
                out, sign = 1.0 - 2.0 * (way // 2), 1.0 - 2.0 * (way % 2)
                apart = 1.0 + out * circles[i, 2]
                for bearing in _turning_on(circles[i, 0], circles[i, 1], apart, k, discs, gaps, sign):
                    touch = _touch(k, sign * out * circles[i, 3], bearing, discs, gaps)
                    if _outside(touch, discs):
                        _put(rows, n, touch)
                        n += 1
        for i in range(count + m):
            bearing = along + i * _FULL / count
            if i >= count:  # a narrow gap is passed at its narrowest place
                x, y, radius = discs[i - count, 0], discs[i - count, 1], discs[i - count, 2]
                if not 0.0 < _far(discs[k, 0], discs[k, 1], x, y) - discs[k, 2] - radius < 1.0:
                    continue
                bearing = np.arctan2(y - discs[k, 1], x - discs[k, 0])
            for way in range(2):
                touch = _touch(k, 1.0 - 2.0 * way, bearing, discs, gaps)
                if _outside(touch, discs):
                    _put(rows, n, touch)
                    n += 1
    return rows[:n]


@part
def _turning_on(
    x: float, y: float, apart: float, disc: int, discs: np.ndarray, gaps: np.ndarray, sign: float
) -> tuple[float, float]:
    """The bearings at which the turning circles touch a disc whose centres lie ``apart`` from that of a circle.

    Args:
        x: Of the centre of a circle that the turning circles are to touch.
        y: Likewise.
        apart: 1 and its radius for those beside it, 1 less its radius for those about it.
        disc: What else to touch.
        discs: ``(m, 3)``.
        gaps: ``(m,)`` what to keep from edges.
        sign: 1: the disc lies outside of the turning circle, -1: inside.

    Returns:
        Two bearings from the disc's centre; NaN for none, which is outside of nothing.
    """
    dx, dy = x - discs[disc, 0], y - discs[disc, 1]
    reach, distance = 1.0 + sign * (discs[disc, 2] + gaps[disc]), np.sqrt(dx * dx + dy * dy)
    if min(apart, reach) <= 0.0 or abs(distance - reach) > apart or distance + reach < apart or distance == 0.0:
        return np.nan, np.nan
    cos = (distance * distance + reach * reach - apart * apart) / (2.0 * distance * reach)
    middle, half = np.arctan2(dy, dx) + (0.0 if sign > 0.0 else np.pi), np.arccos(min(max(cos, -1.0), 1.0))
    return middle - half, middle + half


@part
def _sorted(keys: np.ndarray) -> np.ndarray:
    """What sorts so few keys: Numba's own sort takes seconds to compile."""
    order = np.arange(len(keys))
    for i in range(1, len(keys)):
        j = i
        while j > 0 and keys[order[j - 1]] > keys[i]:
            order[j] = order[j - 1]
            j -= 1
        order[j] = i
    return order


# --- the shortest way -------------------------------------------------------------------------------


@part
def _search(nodes: np.ndarray, discs: np.ndarray, straight: np.ndarray, order: np.ndarray, limit: float) -> np.ndarray:
    """The rows of ``nodes`` on the shortest way from the first to the last below a limit, by A*; none if there is none.

    Words that ignore the obstacles say how much is left at least. Ways with one touch come first: they bound the
    length, and most touches then lie too far off for any way.

    Args:
        nodes: ``(n, 6)`` start, touches, goal.
        discs: ``(m, 3)``.
        straight: ``(n,)`` lengths of the straights by way of each.
        order: ``(n,)`` what sorts them.
        limit: What the length must be below.
    """
    last = len(nodes) - 1
    way, ahead = np.full(last + 1, np.inf), np.zeros(last + 1)
    before, kept = np.zeros(last + 1, np.int64), np.zeros(last + 1, np.int64)
    start, goal = _row(nodes, 0), _row(nodes, last)
    way[0], way[last] = 0.0, _join(start, goal, discs, limit)[1]
    count = 0
    for i in range(last + 1):
        v = order[i]
        if v == 0 or v == last or straight[v] >= way[last]:
            continue
        near = _apart(nodes, 0, v)
        on, rest, ahead[v] = _join(_row(nodes, v), goal, discs, way[last] - near)
        if near + ahead[v] >= way[last]:
            continue
        how, length, free = _join(start, _row(nodes, v), discs, way[last] - ahead[v])
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
        for i in range(count + 1):
            v = kept[i]
            room = min(way[v], way[last] - ahead[v]) - way[u]
            if _apart(nodes, u, v) < room:
                how, length, _ = _join(_row(nodes, u), _row(nodes, v), discs, room)
                if how >= 0:
                    way[v], before[v] = way[u] + length, u
    if way[last] == limit:
        return np.empty((0, 6))
    count, v = 1, last
    while v > 0:
        v, count = before[v], count + 1
    found, v = np.empty((count, 6)), last
    for i in range(count - 1, -1, -1):
        _put(found, i, _row(nodes, v))
        v = before[v]
    return found


@part
def _taut(way: np.ndarray, discs: np.ndarray) -> np.ndarray:
    """The way without the touches that it is no longer without."""
    i = 1
    while i < len(way) - 1:
        before, after = _row(way, i - 1), _row(way, i + 1)
        length = _join(before, _row(way, i), discs, np.inf)[1] + _join(_row(way, i), after, discs, np.inf)[1]
        if _join(before, after, discs, length + _HAIR)[0] >= 0:
            for k in range(i + 1, len(way)):
                _put(way, k - 1, _row(way, k))
            way = way[:-1]
        else:
            i += 1
    return way


@part
def _legs(way: np.ndarray, i: int, j: int, discs: np.ndarray, limit: float) -> float:
    """The length of the way from touch i to touch j, or something above the limit."""
    length = 0.0
    for k in range(i, j):
        if length < limit:
            how, leg, _ = _join(_row(way, k), _row(way, k + 1), discs, limit - length)
            length = length + leg if how >= 0 else np.inf
    return length


@part
def _follow(way: np.ndarray, i: int, j: int, discs: np.ndarray, gaps: np.ndarray, limit: float) -> float:
    """Set touch j so that an arc through it goes over into one through its neighbour i without a straight between.

    Returns:
        The length from before both to after both, or infinity where none is below the limit; then nothing is set.
    """
    first, last = min(i, j) - 1, max(i, j) + 1
    kept = best = _row(way, j)
    disc, least = int(kept[3]), limit
    for side in (1.0, -1.0):
        x, y = way[i, 0] - side * np.sin(way[i, 2]), way[i, 1] + side * np.cos(way[i, 2])
        for bearing in _turning_on(x, y, 2.0, disc, discs, gaps, kept[4] * side):
            touch = _touch(disc, kept[4], bearing, discs, gaps)
            if _outside(touch, discs):
                _put(way, j, touch)
                length = _legs(way, first, last, discs, least)
                if length < least:
                    best, least = touch, length
    _put(way, j, best)
    return least if least < limit else np.inf


@part
def _slide(way: np.ndarray, discs: np.ndarray, gaps: np.ndarray, step: float) -> None:
    """Move the touches along their edges until no slide of `_SLIDE` shortens the way.

    Where two neighbours' arcs meet without a straight between, neither can slide alone: then one follows the other.
    """
    while step > _SLIDE:
        better = False
        for i in range(1, len(way) - 1):
            for j in (i, i - 1, i + 1):
                first, last = min(i, j) - 1, max(i, j) + 1
                if not 0 < j < len(way) - 1 or (j != i and not _meet(way, first + 1, discs, step)):
                    continue
                limit = _legs(way, first, last, discs, np.inf) * (1.0 - 1e-12)
                kept = _row(way, i)
                for sign in (1.0, -1.0):
                    touch = _touch(int(kept[3]), kept[4], kept[5] + sign * step, discs, gaps)
                    if _outside(touch, discs):
                        _put(way, i, touch)
                        if j == i:
                            length = _legs(way, first, last, discs, limit)
                        else:
                            length = _follow(way, i, j, discs, gaps, limit)
                        if length < limit:
                            better, limit = True, length
                            break
                    _put(way, i, kept)
        if not better:
            step *= 0.5


@part
def _meet(way: np.ndarray, i: int, discs: np.ndarray, step: float) -> bool:
    """Whether the way to the next touch turns both ways with so short a straight between that a step could close it."""
    a, b = _row(way, i), _row(way, i + 1)
    how = _join(a, b, discs, np.inf)[0]
    return (how == 1 or how == 2) and pieces_of(how, relative(a, b, 1.0))[1] ** 2 < 4.0 * step


@part
def _pieces(way: np.ndarray, discs: np.ndarray) -> np.ndarray:
    """Curvatures and lengths ``(k, 2)`` of a way, successive ones of one curvature joined."""
    pieces, count = np.zeros((1 + 3 * len(way), 2)), 0
    for i in range(len(way) - 1):
        a, b = _row(way, i), _row(way, i + 1)
        how, length, _ = _join(a, b, discs, np.inf)
        parts = (length, 0.0, 0.0) if how == _ALONG else pieces_of(how, relative(a, b, 1.0))
        for k in range(3):
            if parts[k] > 0.0:
                disc = int(max(a[3], 0.0))
                side = a[4] / _far(a[0], a[1], discs[disc, 0], discs[disc, 1]) if how == _ALONG else _SIDES[how, k]
                count += pieces[count, 1] > 0.0 and pieces[count, 0] != side
                pieces[count, 0] = side
                pieces[count, 1] += parts[k]
    return pieces[: count + (len(way) > 0)]


# --- the string -------------------------------------------------------------------------------------


@lazy(njit("float64(float64[::1], float64[::1], float64[:, ::1])", cache=True, error_model="numpy"))
def _string(start: np.ndarray, goal: np.ndarray, discs: np.ndarray) -> float:
    """The length of the shortest way that may bend as sharply as it likes; infinite where there is none.

    The discs are smaller by a hair or two here: poses may lie on their edge, and no rounding closes a gap.
    """
    discs = discs.copy()
    for k in range(len(discs)):
        discs[k, 2] = max(discs[k, 2] - 2.0 * _HAIR, 0.0)
    circles = _circles(start, goal, 0.0, discs, np.full(len(discs), _HAIR))
    pairs, lines = _tangents(circles, discs)
    e = len(pairs)
    owner, turned, along = (
        np.empty(2 * e, np.int64),
        np.empty(2 * e),
        np.empty(2 * e),
    )  # where tangents leave their circle, then arrive
    way, following, arcs = np.full(2 * e, np.inf), np.full(2 * e, -1), np.empty(2 * e)
    for i in range(2 * e):
        owner[i] = pairs[i % e, i // e]
        turned[i] = circles[owner[i], 3] * lines[i % e, 0] % _FULL  # grows along the circle
        along[i] = owner[i] * 7.0 + turned[i]
        if i < e and owner[i] < 2:
            way[i] = 0.0
    order, first = _sorted(along), 0
    for i in range(2 * e):
        tail = order[i]
        last = i + 1 == 2 * e or owner[order[i + 1]] != owner[tail]
        head = order[first if last else i + 1]
        angle = (turned[head] - turned[tail]) % _FULL
        if head != tail and _runs_clear(circles[owner[tail]], turned[tail], angle, discs):
            following[tail], arcs[tail] = head, angle * circles[owner[tail], 2]
        first = i + 1 if last else first
    shorter = True
    while shorter:  # Bellman and Ford
        shorter = False
        for i in range(2 * e):
            if i < e and way[i] + lines[i, 1] < way[e + i]:
                way[e + i], shorter = way[i] + lines[i, 1], True
            if following[i] >= 0 and way[i] + arcs[i] < way[following[i]]:
                way[following[i]], shorter = way[i] + arcs[i], True
    shortest = np.inf
    for i in range(e):
        if circles[pairs[i, 1], 4] == _GOAL:
            shortest = min(shortest, way[e + i])
    return shortest


@part
def _runs_clear(circle: np.ndarray, turned: float, angle: float, discs: np.ndarray) -> bool:
    """Whether an arc keeps out of all discs that begins where ``turned`` is a circle's side times the heading."""
    bend = circle[3] * circle[2]
    heading = circle[3] * turned
    x, y = circle[0] + bend * np.sin(heading), circle[1] - bend * np.cos(heading)
    return _arc_clear(x, y, heading, bend, angle, discs)


# --- the check --------------------------------------------------------------------------------------


@part
def _nearest(segments: np.ndarray, px: float, py: float) -> float:
    """The distance at which a path passes a point."""
    nearest = np.inf
    for i in range(len(segments)):
        x, y, heading, curvature, length = (
            segments[i, 0], segments[i, 1], segments[i, 2], segments[i, 3], segments[i, 4],
        )  # fmt: skip
        cos, sin = np.cos(heading), np.sin(heading)
        dx, dy = px - x, py - y
        ahead, left = dx * cos + dy * sin, dy * cos - dx * sin
        if curvature == 0.0:
            distance = np.hypot(ahead - min(max(ahead, 0.0), length), left)
        else:
            radius, side = 1.0 / max(abs(curvature), 1e-300), 1.0 if curvature > 0.0 else -1.0
            beside = radius - side * left  # from the point to the centre
            if np.arctan2(ahead, beside) % _FULL * radius <= length:
                distance = abs(np.hypot(ahead, beside) - radius)
            else:
                ex, ey, _ = _follow_on(length, x, y, heading, curvature)
                distance = min(np.hypot(dx, dy), np.hypot(px - ex, py - ey))
        nearest = min(nearest, distance)
    return nearest


@gufunc("void(float64[:, :], float64[:], float64[:])", "(k,s),(p)->()")
def _approach(segments: np.ndarray, point: np.ndarray, nearest: np.ndarray) -> None:
    nearest[0] = _nearest(segments, point[0], point[1])


def approach(path: Path, points: np.ndarray) -> np.ndarray:
    """The distance ``(m,)`` [m] at which a path passes points ``(m, 2)``, in closed form.

    Args:
        path: The path.
        points: x, y [m].
    """
    instance("path", path, Path)
    return _approach(path.segments, finite_array("points", points, "...", 2))


@lazy(njit("boolean(float64[:, :], float64[:], float64, float64[:, :])", cache=True, error_model="numpy"))
def _sound(segments: np.ndarray, goal: np.ndarray, radius: float, discs: np.ndarray) -> bool:
    """Whether a path ends at the goal, turns no tighter than the radius and keeps out of all discs."""
    last, size = len(segments) - 1, radius + max(abs(goal[0]), abs(goal[1]))
    for i in range(last + 1):
        size += segments[i, 4]
        if not abs(segments[i, 3]) * radius <= 1.0 + 1e-12:
            return False
    x, y, heading, curvature, length = (
        segments[last, 0], segments[last, 1], segments[last, 2], segments[last, 3], segments[last, 4],
    )  # fmt: skip
    x, y, heading = _follow_on(length, x, y, heading, curvature)
    turned = abs((heading - goal[2] + np.pi) % _FULL - np.pi)
    sound = max(abs(x - goal[0]), abs(y - goal[1]), radius * turned) <= 1e-9 * size
    for k in range(len(discs)):
        sound = sound and _nearest(segments, discs[k, 0], discs[k, 1]) >= discs[k, 2]
    return sound


# --- planning ---------------------------------------------------------------------------------------


@lazy(
    njit(
        "float64[:, ::1](float64[::1], float64[::1], float64[:, ::1], int64, float64)", cache=True, error_model="numpy",
    )
)  # fmt: skip
def _detour(start: np.ndarray, goal: np.ndarray, discs: np.ndarray, count: int, limit: float) -> np.ndarray:
    """The curvatures and lengths ``(k, 2)`` of a way below a limit, if any, by so many evenly spread touches."""
    gaps = _gaps(discs)
    circles = _circles(start, goal, 1.0, discs, gaps)
    pairs, lines = _tangents(circles, discs)
    touches = _touches(circles, pairs, lines, discs, gaps, np.arctan2(goal[1], goal[0]) + 0.5 * np.pi, count)
    nodes, straight = np.empty((len(touches) + 2, 6)), np.empty(len(touches) + 2)
    _put(nodes, 0, (start[0], start[1], start[2], _NOWHERE, _NOWHERE, _NOWHERE))
    _put(nodes, len(nodes) - 1, (goal[0], goal[1], goal[2], _NOWHERE, _NOWHERE, _NOWHERE))
    for i in range(len(touches)):
        _put(nodes, i + 1, _row(touches, i))
    for i in range(len(nodes)):
        straight[i] = _apart(nodes, i, 0) + _apart(nodes, i, len(nodes) - 1)
    way = _search(nodes, discs, straight, _sorted(straight), limit)
    if len(way):
        way = _taut(way, discs)
        _slide(way, discs, gaps, np.pi / count)
        way = _taut(way, discs)
    return _pieces(way, discs)


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
    radius, discs = float(radius), _discs(obstacles, margin)
    for name, pose in (("start", start), ("goal", goal)):
        if (np.square(discs[:, :2] - pose[:2]).sum(-1) < np.square(discs[:, 2])).any():
            depth = discs[:, 2] - np.hypot(discs[:, 0] - pose[0], discs[:, 1] - pose[1])
            raise ValueError(
                f"the {name} is {depth.max():.6g} m inside obstacle {depth.argmax()} or its margin: move the {name} or "
                "the obstacle, or ask for less margin"
            )
    if _sound(direct.segments, goal, radius, discs):
        return direct
    size = np.abs(np.concatenate([discs - [*start[:2], 0.0], [goal - start]])[:, :2]).max() / radius
    if size > _FAR:
        raise ValueError(
            f"poses and obstacles must lie within {_FAR:.0e} turn radii of each other for a way round, got {size:.0e}: "
            "turn wider or leave out what is far away"
        )
    units, origin = [1.0 / radius, radius], [start[0], start[1], 0.0]
    here, there = np.array([0.0, 0.0, start[2]]), (goal - origin) / [radius, radius, 1.0]
    rounds = np.ascontiguousarray((discs - origin) / radius)
    bound = _string(here, there, rounds) * radius
    if bound == np.inf:
        raise NoPath(
            "the obstacles with their margin close every way to the goal: ask for less margin or remove an obstacle"
        )
    path = None
    for count in TOUCHES:
        pieces = _detour(here, there, rounds, count, (path.length if path else np.inf) / radius) * units
        if len(pieces):
            found = chain(start, pieces[:, 0], pieces[:, 1])
            if _sound(found.segments, goal, radius, discs):
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
