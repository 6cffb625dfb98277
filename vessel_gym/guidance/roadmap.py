"""Shortest ways from touch to touch round circular obstacles, for many scenes at once.

Units, scenes and touches as in `vessel_gym.guidance.touches`. An edge joins two touches by a Dubins word or, along a
disc that is wider than the turning circle, by its edge. Edges of all scenes are joined as one batch.
"""

from collections.abc import Sequence

import numpy as np

from estimators.engine import compiled, repeat
from vessel_gym.guidance.touches import HAIR, all_touches, arc_meets, line_meets, margins, reaches, touch, turning_on
from vessel_gym.guidance.words import CURVATURES, whole, word_pieces

_SLIDE = 1e-4  # rad, the smallest slide of a touch: what it leaves is of its square
_EXPANDED = 16  # touches from which all others are reached as one batch
_HALVES = 0.5 ** np.maximum(np.arange(-1, 64), 0)
_BOTH = np.array([1.0, -1.0])  # ways
DISCS = 4  # in one compiled function


# --- edges ------------------------------------------------------------------------------------------


@compiled(axes=(1, 1, 2))
def join(a: np.ndarray, b: np.ndarray, discs: np.ndarray) -> tuple[np.ndarray, ...]:
    """The shortest clear ways from touches ``(..., 7)`` to others among discs ``(..., 4 g, 3)``.

    LRL and RLR turn farther than half a turn: beside a shorter word they are left out.

    Returns:
        Their lengths, infinite where no way is clear, and those of the shortest words, clear or not; the radii
        ``(..., 3)`` of their pieces, positive to the left and 0 of straights, and the angles of arcs and lengths of
        straights ``(..., 3)``.
    """
    pieces = word_pieces(a, b, np.ones_like(a[..., 0]))
    words = pieces[..., 0] + pieces[..., 1] + pieces[..., 2]
    free = np.minimum(np.minimum(words[..., 0], words[..., 1]), np.minimum(words[..., 2], words[..., 3]))
    words = np.concatenate([words[..., :4], np.where(free[..., None] <= np.pi, np.inf, words[..., 4:])], -1)
    follows = (a[..., 3] == b[..., 3]) & (a[..., 6] == b[..., 6]) & (a[..., 6] != 0.0)
    angle, none = whole(a[..., 4] * (b[..., 5] - a[..., 5])), np.zeros_like(free)
    along = np.where(follows, angle * abs(a[..., 6]), np.inf)
    lengths = np.concatenate([along[..., None], words], -1)
    extents = np.concatenate([np.stack([angle, none, none], -1)[..., None, :], pieces], -2)

    def clear(lengths: np.ndarray, discs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The lengths, infinite for ways that cross one of the next discs, and the discs with these last."""
        meets = [_meets(a, [a[..., 6]], extents[..., 0, :1], discs[..., :DISCS, :])]
        meets += [
            _meets(a, bends, extents[..., k, :], discs[..., :DISCS, :])
            for k, bends in enumerate(CURVATURES.tolist(), 1)
        ]
        rest = np.concatenate([discs[..., DISCS:, :], discs[..., :DISCS, :]], -2)
        return np.where(np.stack(meets, -1), np.inf, lengths), rest

    lengths, _ = repeat(discs.shape[-2] // DISCS, clear, lengths, discs)
    length, bends, chosen = lengths[..., 0], np.stack([a[..., 6], none, none], -1), extents[..., 0, :]
    for way, turns in enumerate(CURVATURES, 1):
        better = lengths[..., way] < length
        length, bends = np.where(better, lengths[..., way], length), np.where(better[..., None], turns, bends)
        chosen = np.where(better[..., None], extents[..., way, :], chosen)
    return length, np.minimum(free, np.minimum(words[..., 4], words[..., 5])), bends, chosen


def _meets(a: np.ndarray, bends: Sequence[np.ndarray | float], extents: np.ndarray, discs: np.ndarray) -> np.ndarray:
    """Mask of the ways from touches, of pieces of some bends and extents, that cross any of the discs."""
    x, y, heading = a[..., 0], a[..., 1], a[..., 2]
    sin, cos, crosses = np.sin(heading), np.cos(heading), x != x
    for k, bend in enumerate(bends):
        extent = extents[..., k]
        if isinstance(bend, float) and bend == 0.0:
            crosses = crosses | (line_meets(x, y, sin, cos, extent, discs) & (extent > 0.0))
            x, y = x + extent * cos, y + extent * sin
            continue
        centre, begin = (x - bend * sin, y + bend * cos), (bend * sin, -bend * cos)
        heading = heading + np.where(bend > 0.0, extent, -extent)
        sin, cos = np.sin(heading), np.cos(heading)
        end = bend * sin, -bend * cos
        crosses = crosses | (arc_meets(centre, bend, extent, begin, end, discs) & (extent > 0.0))
        x, y = centre[0] + end[0], centre[1] + end[1]
    return crosses


@compiled(axes=(1, 1, 1, 1, 0, 2))
def _slid(
    before: np.ndarray, kept: np.ndarray, after: np.ndarray, edge: np.ndarray, angle: np.ndarray, discs: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Touches slid along their edges by angles, between those before and after them on a way.

    Returns:
        The touches ``(..., 7)``, and of the legs before and after them the lengths and the straights where these turn
        both ways (otherwise infinite).
    """
    moved, none = touch(edge, kept[..., 3], kept[..., 4], kept[..., 5] + angle), np.zeros_like(angle)

    def leg(*carried: np.ndarray) -> tuple[np.ndarray, ...]:
        a, b, end, _, length, _, straight = carried
        next_length, _, bends, extents = join(a, b, discs)
        next_straight = np.where(bends[..., 0] * bends[..., 2] < 0.0, extents[..., 1], np.inf)
        return b, end, end, length, next_length, straight, next_straight

    return moved, *repeat(2, leg, before, moved, after, none, none, none, none)[3:]


def _of(scene: np.ndarray, discs: np.ndarray) -> np.ndarray:
    """The discs of scenes ``(n,)``; those of one scene are all the same."""
    return discs if len(discs) == 1 else discs[scene]


# --- the shortest way -------------------------------------------------------------------------------


def ways(start: np.ndarray, goal: np.ndarray, discs: np.ndarray, count: int, limit: np.ndarray) -> list[np.ndarray]:
    """Curvatures and lengths ``(k, 2)`` of short ways below limits; none where none is found.

    Args:
        start: ``(S, 3)`` poses at the origin.
        goal: ``(S, 3)`` poses.
        discs: ``(S, m, 3)``.
        count: Evenly spread touches a disc and way round.
        limit: ``(S,)``.
    """
    gaps = margins(discs)
    found = _search(start, goal, discs, *all_touches(start, goal, discs, gaps, count), limit)
    counts = np.array([len(way) for way in found])
    rest, results = np.nonzero(counts)[0], [np.zeros((0, 2))] * len(found)
    if len(rest):
        touches, index = counts[rest] - 2, np.arange(counts.max())
        padded = np.stack([found[s][np.minimum(index, counts[s] - 1)] for s in rest])
        refined = _refined(padded, touches, reaches(discs, gaps)[rest], discs[rest], np.pi / count)
        for s, pieces in zip(rest, refined, strict=True):
            results[s] = pieces
    return results


def _search(
    start: np.ndarray, goal: np.ndarray, discs: np.ndarray, scene: np.ndarray, nodes: np.ndarray, limit: np.ndarray
) -> list[np.ndarray]:
    """The touches ``(k, 7)`` of the shortest ways from start to goal below limits; none where there is none.

    Words that ignore the obstacles say how much is left at least. Ways with one touch come first: they bound the
    length, and most touches then lie too far off for any way.
    """
    nowhere = np.tile([-1.0, 0.0, 0.0, 0.0], (len(discs), 1))
    first, last = np.concatenate([start, nowhere], -1), np.concatenate([goal, nowhere], -1)
    straight = sum(np.hypot(*(nodes[:, i] - p[scene, i] for i in (0, 1))) for p in (first, last))
    order = np.lexsort((straight, scene))
    order = order[(straight < limit[scene])[order]]
    scene, nodes = scene[order], nodes[order]
    a, b = np.concatenate([first, first[scene], nodes]), np.concatenate([last, nodes, last[scene]])
    length, free, *_ = join(a, b, _of(np.concatenate([np.arange(len(discs)), scene, scene]), discs))
    direct, way, ends = np.split(length, [len(discs), len(discs) + len(scene)])
    _, near, ahead = np.split(free, [len(discs), len(discs) + len(scene)])
    best, by = _relaxed(np.minimum(direct, limit), np.full(len(discs), -1), scene, np.arange(len(way)), way + ends)
    kept = near + ahead < best[scene] * (1.0 + HAIR)
    by = np.where(by >= 0, np.cumsum(kept)[by] - 1, by) if len(kept) else by
    scene, nodes, way, ends, ahead = scene[kept], nodes[kept], way[kept], ends[kept], ahead[kept]
    before, fresh = np.full(len(way), -1), np.ones(len(way), bool)
    while True:  # Bellman and Ford, from the most promising
        fresh &= way + ahead < best[scene]
        chosen = _lowest(np.where(fresh, way + ahead, np.inf), scene, _EXPANDED)
        chosen = np.sort(chosen[fresh[chosen]])
        if not len(chosen):
            break
        fresh[chosen] = False
        u, v = _pairs(scene, chosen)
        room = np.minimum(way[v], best[scene[v]] - ahead[v]) - way[u]
        close = (np.hypot(nodes[u, 0] - nodes[v, 0], nodes[u, 1] - nodes[v, 1]) < room) & (u != v)
        u, v, known = u[close], v[close], way
        way, before = _relaxed(way, before, v, u, way[u] + join(nodes[u], nodes[v], _of(scene[u], discs))[0])
        fresh |= way < known
        best, by = _relaxed(best, by, scene, np.arange(len(way)), way + ends)
    none = np.zeros((0, 7))
    return [_back(before, by[s], first[s], last[s], nodes) if best[s] < limit[s] else none for s in range(len(discs))]


def _lowest(values: np.ndarray, scene: np.ndarray, count: int) -> np.ndarray:
    """The nodes of the lowest values, so many of each scene; nodes are sorted by ``scene``."""
    sizes = np.bincount(scene)
    rank = np.arange(len(scene)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    return np.lexsort((values, scene))[rank < count]


def _pairs(scene: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All pairs of some nodes ``u`` and any of the same scene; nodes are sorted by ``scene``."""
    sizes = np.bincount(scene)
    counts, begins = sizes[scene[u]], (np.cumsum(sizes) - sizes)[scene[u]]
    v = np.arange(counts.sum()) + np.repeat(begins - np.cumsum(counts) + counts, counts)
    return np.repeat(u, counts), v


def _relaxed(
    lengths: np.ndarray, before: np.ndarray, ends: np.ndarray, by: np.ndarray, through: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The least lengths of ways to nodes, and the nodes before these, with ways to some ``ends`` by way of others."""
    least, before = lengths.copy(), before.copy()
    np.minimum.at(least, ends, through)
    taken = (through == least[ends]) & (through < lengths[ends])
    before[ends[taken][::-1]] = by[taken][::-1]  # of equal ones the first
    return least, before


def _back(before: np.ndarray, v: int, first: np.ndarray, last: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """The touches from the first by way of v to the last, each after that which is ``before`` it (the first: -1)."""
    found = [last]
    while v >= 0:
        found.append(nodes[v])
        v = before[v]
    return np.array([first, *found[::-1]])


# --- refinement -------------------------------------------------------------------------------------


def _refined(
    ways: np.ndarray, touches: np.ndarray, edges: np.ndarray, discs: np.ndarray, step: float
) -> list[np.ndarray]:
    """Curvatures and lengths ``(k, 2)`` of ways whose touches slide and are left out where they can be.

    Args:
        ways: ``(S, n, 7)`` touches from start to goal, which fills up.
        touches: ``(S,)`` how many there are between both.
        edges: ``(S, m, 4)`` of the discs.
        discs: ``(S, m, 3)``.
        step: The first slide of a touch [rad].
    """
    _taut(ways, touches, discs)
    _slide(ways, touches, edges, discs, step)
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


def _taut(ways: np.ndarray, touches: np.ndarray, discs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Leave out the touches that ways are no longer without; radii and extents ``(S, n - 1, 3)`` of their pieces."""
    n, left = ways.shape[1] - 1, np.zeros(len(ways), int)
    while True:
        a, b = np.concatenate([ways[:, :-1], ways[:, :-2]], 1), np.concatenate([ways[:, 1:], ways[:, 2:]], 1)
        length, _, bends, extents = join(a, b, discs[:, None])
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


def _slide(ways: np.ndarray, touches: np.ndarray, edges: np.ndarray, discs: np.ndarray, step: float) -> None:
    """Move the touches along their edges until no slide of `_SLIDE` shortens the ways.

    Each touch in turn slides forwards or backwards by the step, alone, with the one before and with the one after, and
    the step halves when no slide shortens the way. Where two neighbours' arcs meet without a straight between, neither
    can slide alone: then one follows the other.
    """
    most = ways.shape[1] - 2
    number, place, later = np.arange(most), np.arange(3 * most).reshape(most, 3), touches[:, None] - 1 - np.arange(most)
    movable = np.stack([later >= 0, (later >= 0) & (number > 0), later > 0], -1)  # alone, with the neighbours
    steps, turn, better = np.full(len(ways), step), np.zeros(len(ways), int), np.zeros(len(ways), bool)
    rows = np.nonzero(touches)[0]
    while len(rows):
        # What is left of this round, a next one of this step if the way got shorter, then rounds of half the step.
        halves = steps[rows, None] * _HALVES[: 2 + int(np.log2(steps[rows].max() / _SLIDE))]
        moved, legs, straights, shorter = _survey(ways[rows], edges[rows], discs[rows], halves)
        tried = np.empty((*halves.shape, most, 3), bool)
        tried[..., 0] = shorter.any(2)
        np.less(straights[:, None] ** 2, 4.0 * halves[..., None, None], out=tried[..., 1:])
        tried &= movable[rows, None] & (halves > _SLIDE)[..., None, None]
        ahead = place >= turn[rows, None, None]
        tried[:, 0] &= ahead
        tried[:, 1] &= ~ahead & better[rows, None, None]
        tried, asked = tried.reshape(len(rows), -1), np.arange(len(rows))
        while len(asked):
            pick = tried[asked].argmax(-1)
            found = tried[asked, pick]
            steps[rows[asked[~found]]] = 0.0
            asked, pick = asked[found], pick[found]
            half, at = np.divmod(pick, 3 * most)
            i, kind = np.divmod(at, 3)
            row, both, slid = rows[asked], moved[asked, half, :, i], kind == 0
            ways[row[slid], i[slid] + 1] = both[slid, shorter[asked, half, :, i].argmax(-1)[slid]]
            if not slid.all():
                on = ~slid
                j = i[on] + 2 * kind[on] - 3
                slid[on] = _follow(ways, row[on], i[on], j, both[on], edges, discs, legs[asked[on]])
            steps[row[slid]], turn[row[slid]], better[row[slid]] = halves[asked, half][slid], at[slid] + 1, True
            asked, pick = asked[~slid], pick[~slid]
            tried[asked, pick] = False
        rows = rows[steps[rows] > _SLIDE]


def _survey(
    ways: np.ndarray, edges: np.ndarray, discs: np.ndarray, steps: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Slides of touches alone by steps ``(S, h)``.

    Returns:
        The touches ``(S, h, 2, n - 2, 7)`` slid forwards and backwards; of the legs before and after each touch as it
        is the lengths ``(S, n - 2, 2)`` and the straights of `_slid`; a mask ``(S, h, 2, n - 2)`` of the slides that
        shorten the way.
    """
    kept, most = ways[:, None, 1:-1], ways.shape[1] - 2
    angles = np.zeros((len(ways), 1 + 2 * steps.shape[1], 1))
    angles[:, 1::2, 0], angles[:, 2::2, 0] = steps, -steps
    edge = edges[np.arange(len(ways))[:, None, None], kept[..., 3].astype(int)]
    moved, *legs = _slid(ways[:, None, :-2], kept, ways[:, None, 2:], edge, angles, discs[:, None, None])
    length, shape = legs[0] + legs[1], (*steps.shape, 2, most)
    shorter = (length[:, 1:] < length[:, :1] * (1.0 - 1e-12)).reshape(shape)
    lengths, straights = (np.stack([leg[:, 0] for leg in legs[k : k + 2]], -1) for k in (0, 2))
    return moved[:, 1:].reshape(*shape, 7), lengths, straights, shorter


def _follow(
    ways: np.ndarray, rows: np.ndarray, i: np.ndarray, j: np.ndarray, poses: np.ndarray, edges: np.ndarray,
    discs: np.ndarray, legs: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Move touches i of some ways to the first of two poses ``(rows, 2, 7)`` that shortens them, and the next, j, too.

    Touch j goes where the arcs through both meet without a straight between.

    Returns:
        A mask of the ways that are shorter now.
    """
    number, low, after = np.arange(len(rows)), np.minimum(i, j), (i < j)[:, None, None, None]
    limit = (legs[number, low, 0] + legs[number, low, 1] + legs[number, low + 1, 1]) * (1.0 - 1e-12)
    kept = ways[rows, j + 1]
    edge = edges[rows, kept[:, 3].astype(int)][:, None, None]
    disc, side = kept[:, 3, None, None], kept[:, 4, None, None]
    circle = np.empty((len(rows), 2, 2, 4))
    circle[..., 0] = poses[..., :1] - _BOTH * np.sin(poses[..., 2:3])
    circle[..., 1] = poses[..., 1:2] + _BOTH * np.cos(poses[..., 2:3])
    circle[..., 2], circle[..., 3] = 2.0, side * _BOTH
    moved = touch(edge, disc, side, turning_on(circle, edge).reshape(len(rows), 2, 4))
    poses = np.broadcast_to(poses[:, :, None], moved.shape)
    first, last = (np.broadcast_to(ways[rows, low + k][:, None, None], moved.shape) for k in (0, 3))
    tried = np.stack([first, np.where(after, poses, moved), np.where(after, moved, poses), last], -2)
    lengths = join(tried[..., :-1, :], tried[..., 1:, :], discs[rows, None, None, None])[0]
    lengths = lengths[..., 0] + lengths[..., 1] + lengths[..., 2]
    best, shorter = lengths.argmin(-1), lengths.min(-1) < limit[:, None]
    sign, done = shorter.argmax(-1), shorter.any(-1)
    chosen = number[done], sign[done], best[number, sign][done]
    ways[rows[done, None], low[done, None] + [1, 2]] = tried[chosen][:, 1:3]
    return done
