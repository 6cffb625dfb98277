"""Shortest ways from touch to touch round circular obstacles, for many scenes at once.

Units, scenes and touches as in `vessel_gym.guidance.touches`. An edge joins two touches by a Dubins word or, along a
disc that is wider than the turning circle, by its edge. Edges of all scenes are joined as one batch.
"""

from collections.abc import Generator
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from estimators.engine import compiled
from vessel_gym.guidance.touches import HAIR, all_touches, margins, meets, reaches, touch, turning_on
from vessel_gym.guidance.words import CURVATURES, follow_on, whole, word_pieces

_SLIDE = 1e-4  # rad, the smallest slide of a touch: what it leaves is of its square
_EXPANDED = 16  # touches from which all others are reached as one batch
_BOTH = np.array([1.0, -1.0])  # ways
DISCS = 4  # in one compiled function
_BENDS = np.concatenate([np.zeros((1, 3)), CURVATURES])  # of the ways along an edge


class Joints(NamedTuple):
    """The shortest clear ways along edges."""

    bends: np.ndarray  # (n, 3) radii of their pieces, positive to the left; 0: straight
    extents: np.ndarray  # (n, 3) angles of arcs, lengths of straights
    length: np.ndarray  # (n,) infinite where no way is clear
    free: np.ndarray  # (n,) lengths of the shortest words, clear or not


_Edges = tuple[np.ndarray, np.ndarray]  # touches (n, 7) where they begin and end
_Refinement = Generator[_Edges, Joints, np.ndarray]


# --- edges ------------------------------------------------------------------------------------------


@compiled(axes=(1, 1, 2))
def candidates(a: np.ndarray, b: np.ndarray, discs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All ways along edges: by the edge of a disc and by each word.

    LRL and RLR turn farther than half a turn: beside a shorter word they are left out.

    Args:
        a: ``(..., 7)``.
        b: ``(..., 7)``.
        discs: ``(..., m, 3)``.

    Returns:
        Their lengths, infinite where they cross a disc, and the extents of their pieces ``(..., 7, 4)``, and the length
        of the shortest word, whether it is clear or not.
    """
    pieces = word_pieces(a, b, np.ones_like(a[..., 0]))
    lengths = pieces[..., 0] + pieces[..., 1] + pieces[..., 2]
    free = np.minimum(np.minimum(lengths[..., 0], lengths[..., 1]), np.minimum(lengths[..., 2], lengths[..., 3]))
    turning = np.where(free[..., None] <= np.pi, np.inf, lengths[..., 4:])
    follows = (a[..., 3] == b[..., 3]) & (a[..., 6] == b[..., 6]) & (a[..., 6] != 0.0)
    angle, none = whole(a[..., 4] * (b[..., 5] - a[..., 5])), np.zeros_like(free)
    along = np.where(follows, angle * abs(a[..., 6]), np.inf)
    ways = [_unblocked(a, a[..., 6, None], angle[..., None], along, discs)]
    for word, bends in enumerate(CURVATURES):
        length = lengths[..., word] if word < 4 else turning[..., word - 4]
        ways.append(_unblocked(a, bends, pieces[..., word, :], length, discs))
    extents = np.concatenate([np.stack([angle, none, none], -1)[..., None, :], pieces], -2)
    free = np.minimum(free, np.minimum(turning[..., 0], turning[..., 1]))
    return np.concatenate([np.stack(ways, -1)[..., None], extents], -1), free


def _unblocked(
    a: np.ndarray, bends: np.ndarray, extents: np.ndarray, length: np.ndarray, discs: np.ndarray
) -> np.ndarray:
    """The length of ways of pieces ``(..., k)`` from touches, infinite where they cross a disc."""
    pose, crosses = (a[..., 0], a[..., 1], a[..., 2]), length == np.inf
    for k in range(extents.shape[-1]):
        for d in range(discs.shape[-2]):
            disc = discs[..., d, 0], discs[..., d, 1], discs[..., d, 2]
            crosses = crosses | meets(*pose, bends[..., k], extents[..., k], *disc)
        pose = follow_on(extents[..., k], *pose, bends[..., k])
    return np.where(crosses, np.inf, length)


def join(a: np.ndarray, b: np.ndarray, scene: np.ndarray, discs: np.ndarray) -> Joints:
    """The shortest clear ways from touches ``(n, 7)`` to others in scenes ``(n,)`` with discs ``(S, 4 g, 3)``."""
    ways, free = _candidates(a, b, scene, discs[:, :DISCS])
    for k in range(DISCS, discs.shape[1], DISCS):
        others = _candidates(a, b, scene, discs[:, k : k + DISCS])[0]
        ways[..., 0] = np.maximum(ways[..., 0], others[..., 0])
    rows, best = np.arange(len(a)), ways[..., 0].argmin(1)
    bends, chosen = _BENDS[best], ways[rows, best]
    bends[best == 0, 0] = a[best == 0, 6]
    return Joints(bends, chosen[:, 1:], chosen[:, 0], free)


def _candidates(a: np.ndarray, b: np.ndarray, scene: np.ndarray, discs: np.ndarray) -> Any:
    return candidates(a, b, discs if len(discs) == 1 else discs[scene])


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
    edges = reaches(discs, gaps)
    tasks = [_refined(way, edges[s], np.pi / count) for s, way in enumerate(found)]
    results = [np.zeros((0, 2))] * len(tasks)
    answers: dict[int, Joints | None] = {s: None for s, way in enumerate(found) if len(way)}
    while answers:
        asked: dict[int, _Edges] = {}
        for s, joints in answers.items():
            try:
                asked[s] = tasks[s].send(joints)  # type: ignore[arg-type]  # None starts it
            except StopIteration as stop:
                results[s] = stop.value
        answers = _answers(asked, discs) if asked else {}
    return results


def _answers(asked: dict[int, _Edges], discs: np.ndarray) -> dict[int, Joints | None]:
    """The ways along edges of scenes, joined as one batch."""
    sizes = [len(a) for a, _ in asked.values()]
    a, b = (np.concatenate(ends) for ends in zip(*asked.values(), strict=True))
    joints = join(a, b, np.repeat(list(asked), sizes), discs)
    if len(sizes) == 1:
        return dict.fromkeys(asked, joints)
    parts = zip(*(np.split(part, np.cumsum(sizes)[:-1]) for part in joints), strict=True)
    return {s: Joints(*part) for s, part in zip(asked, parts, strict=True)}


def _search(
    start: np.ndarray, goal: np.ndarray, discs: np.ndarray, touches: np.ndarray, exists: np.ndarray, limit: np.ndarray
) -> list[np.ndarray]:
    """The touches ``(k, 7)`` of the shortest ways from start to goal below limits; none where there is none.

    Words that ignore the obstacles say how much is left at least. Ways with one touch come first: they bound the
    length, and most touches then lie too far off for any way.
    """
    nowhere = np.tile([-1.0, 0.0, 0.0, 0.0], (len(discs), 1))
    first, last = np.concatenate([start, nowhere], -1), np.concatenate([goal, nowhere], -1)
    away = [np.hypot(touches[..., 0] - p[:, None, 0], touches[..., 1] - p[:, None, 1]) for p in (first, last)]
    straight = away[0] + away[1]
    scene, number = np.nonzero(exists & (straight < limit[:, None]))
    order = np.lexsort((straight[scene, number], scene))
    scene, nodes = scene[order], touches[scene, number][order]
    a, b = np.concatenate([first, first[scene], nodes]), np.concatenate([last, nodes, last[scene]])
    joints = join(a, b, np.concatenate([np.arange(len(discs)), scene, scene]), discs)
    direct, way, ends = np.split(joints.length, [len(discs), len(discs) + len(scene)])
    _, near, ahead = np.split(joints.free, [len(discs), len(discs) + len(scene)])
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
        way, before = _relaxed(way, before, v, u, way[u] + join(nodes[u], nodes[v], scene[u], discs).length)
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


def _refined(way: np.ndarray, edges: np.ndarray, step: float) -> _Refinement:
    """Curvatures and lengths ``(k, 2)`` of a way ``(n, 7)`` whose touches slide and are left out where they can be."""
    way, _ = yield from _taut(way)
    way = yield from _slide(way, edges, step)
    _, joints = yield from _taut(way)
    pieces: list[list[float]] = []
    for bends, extents in zip(joints.bends.tolist(), joints.extents.tolist(), strict=True):
        for bend, extent in zip(bends, extents, strict=True):
            curvature = 1.0 / bend if bend else 0.0
            if extent > 0.0 and pieces and pieces[-1][0] == curvature:
                pieces[-1][1] += extent * abs(bend or 1.0)
            elif extent > 0.0:
                pieces.append([curvature, extent * abs(bend or 1.0)])
    return np.array(pieces or [[0.0, 0.0]])


def _taut(way: np.ndarray) -> Generator[_Edges, Joints, tuple[np.ndarray, Joints]]:
    """The way without the touches that it is no longer without, and the ways along its edges."""
    i, n = 1, len(way) - 1
    while True:
        joints = yield np.concatenate([way[:-1], way[:-2]]), np.concatenate([way[1:], way[2:]])
        length = joints.length
        without = np.nonzero(length[n:][i - 1 :] < (length[: n - 1] + length[1:n] + HAIR)[i - 1 :])[0]
        if not len(without):
            return way, Joints(*(part[:n] for part in joints))
        i, n = i + without[0], n - 1
        way = np.delete(way, i, 0)


def _slide(way: np.ndarray, edges: np.ndarray, step: float) -> _Refinement:
    """Move the touches along their edges until no slide of `_SLIDE` shortens the way.

    Each touch in turn slides forwards or backwards by the step, which halves when none of them shortens the way. Where
    two neighbours' arcs meet without a straight between, neither can slide alone: then one follows the other.
    """
    touches = len(way) - 2
    turn, better = 0, False  # what is tried next: slides of each touch alone, with the one before, with the one after
    while step > _SLIDE and touches:
        legs, straights, moved, shorter = yield from _survey(way, edges, step)
        half, slid = 0, None
        while step > _SLIDE and slid is None:
            if turn == 3 * touches:
                half, step = (half, step) if better else (half + 1, 0.5 * step)
                turn, better = 0, False
                continue
            i, j = 1 + turn // 3, turn // 3 + (1, 0, 2)[turn % 3]
            if i == j:
                if True in shorter[i - 1][half]:
                    slid = way.copy()
                    slid[i] = moved[i - 1, half, shorter[i - 1][half].index(True)]
            elif 0 < j <= touches and straights[min(i, j)] ** 2 < 4.0 * step:
                limit = sum(legs[min(i, j) - 1 : max(i, j) + 1]) * (1.0 - 1e-12)
                slid = yield from _follow(way, i, j, moved[i - 1, half], edges, limit)
            turn += 1
        if slid is not None:
            way, better = slid, True
    return way


@cache
def _windows(touches: int, steps: int) -> _Edges:
    """Where the edges of a way, and of its touches' slides by some steps each way, begin and end in one array."""
    slid = touches + 2 + np.arange(touches * steps * 2)
    before = np.repeat(np.arange(touches), 2 * steps)
    legs = np.arange(touches + 1)
    return np.concatenate([legs, before, slid]), np.concatenate([legs + 1, slid, before + 2])


def _survey(
    way: np.ndarray, edges: np.ndarray, step: float
) -> Generator[_Edges, Joints, tuple[list[float], list[float], np.ndarray, list[list[list[bool]]]]]:
    """Slides by a step and all its halves, joined as one batch.

    Returns:
        The lengths ``(n - 1,)`` of a way's legs, their straights where these turn both ways (otherwise infinite), the
        touches ``(n - 2, h, 2, 7)`` slid forwards and backwards, and a mask of those that shorten the way.
    """
    n, count = len(way) - 2, 1 + int(np.log2(step / _SLIDE))
    kept = way[1:-1, None, None]
    bearing = kept[..., 5] + (step * 0.5 ** np.arange(count))[:, None] * _BOTH
    moved = touch(edges[way[1:-1, 3].astype(int)][:, None, None], kept[..., 3], kept[..., 4], bearing)
    nodes, (begins, ends) = np.concatenate([way, moved.reshape(-1, 7)]), _windows(n, count)
    joints = yield nodes[begins], nodes[ends]
    legs, slid = joints.length[: n + 1], joints.length[n + 1 :].reshape(2, *bearing.shape)
    limit = (legs[:-1] + legs[1:]) * (1.0 - 1e-12)
    both = joints.bends[: n + 1, 0] * joints.bends[: n + 1, 2] < 0.0
    straights = np.where(both, joints.extents[: n + 1, 1], np.inf)
    return legs.tolist(), straights.tolist(), moved, (slid[0] + slid[1] < limit[:, None, None]).tolist()


def _follow(
    way: np.ndarray, i: int, j: int, poses: np.ndarray, edges: np.ndarray, limit: float
) -> Generator[_Edges, Joints, np.ndarray | None]:
    """The way with touch i at the first of two poses that shorten it below a limit, if any does.

    Its neighbour j goes where the arcs through both meet without a straight between.
    """
    edge, side = edges[int(way[j, 3])], way[j, 4]
    x, y = poses[:, :1] - _BOTH * np.sin(poses[:, 2:3]), poses[:, 1:2] + _BOTH * np.cos(poses[:, 2:3])
    bearings = turning_on(np.stack([x, y, np.full_like(x, 2.0), np.broadcast_to(side * _BOTH, x.shape)], -1), edge)
    first, last = min(i, j) - 1, max(i, j) + 1
    tried = np.empty((2, 4, 4, 7))
    tried[:, :, 0], tried[:, :, 3] = way[first], way[last]
    tried[:, :, i - first] = poses[:, None]
    tried[:, :, j - first] = touch(edge, way[j, 3], side, bearings.reshape(2, 4))
    joints = yield tried[:, :, :-1].reshape(-1, 7), tried[:, :, 1:].reshape(-1, 7)
    legs = joints.length.reshape(2, 4, 3)
    lengths = legs[..., 0] + legs[..., 1] + legs[..., 2]
    for sign in range(2):
        if (lengths[sign] < limit).any():
            way = way.copy()
            way[first : last + 1] = tried[sign, np.nanargmin(lengths[sign])]
            return way
    return None
