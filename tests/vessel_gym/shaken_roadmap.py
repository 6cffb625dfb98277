"""Another planner round circular obstacles, to hold `plan` against: random poses, joined and then shaken.

It shares no code and no idea with `vessel_gym.guidance`: poses are thrown at random about the obstacles and the square,
each pair is joined by the shortest clear path of arcs and straights that complex numbers find (the middle arc
of three may be short here), Dijkstra goes through them, and the poses on the way are then moved at random, all three
numbers of them, as long as that shortens it. Whether a piece keeps clear is found by marching along it, each
step as long as the nearest edge is away. The turn radius is 1.
"""

import numpy as np
from numba import njit

FULL = 2.0 * np.pi
STEP = 2e-3
"""The least step of the march: beside an edge it may cut 1e-6 deep."""


@njit(cache=True)
def _march(z: complex, heading: float, side: float, length: float, centres: np.ndarray, radii: np.ndarray) -> bool:
    s = 0.0
    while True:
        along = s + 0j if side == 0.0 else 1j * side * (1.0 - np.exp(1j * side * s))
        room = np.inf
        for k in range(len(radii)):
            room = min(room, abs(z + np.exp(1j * heading) * along - centres[k]) - radii[k])
        if room < -1e-9:
            return False
        if s >= length:
            return True
        s = min(s + max(room, STEP), length)


@njit(cache=True)
def _clear(
    z: complex, heading: float, sides: tuple[float, float, float], pieces: tuple[float, float, float],
    centres: np.ndarray, radii: np.ndarray,
) -> bool:  # fmt: skip
    for k in range(3):
        side, length = sides[k], pieces[k]
        if not _march(z, heading, side, length, centres, radii):
            return False
        along = length + 0j if side == 0.0 else 1j * side * (1.0 - np.exp(1j * side * length))
        z, heading = z + np.exp(1j * heading) * along, heading + side * length
    return True


@njit(cache=True)
def join(a: np.ndarray, b: np.ndarray, centres: np.ndarray, radii: np.ndarray, limit: float) -> float:
    """The length of the shortest clear path of three pieces between poses; infinite where none is below the limit."""
    za, zb = a[0] + 1j * a[1], b[0] + 1j * b[1]
    if abs(zb - za) >= limit:
        return np.inf
    best = limit
    for first in (1.0, -1.0):
        from_ = za + 1j * first * np.exp(1j * a[2])
        for last in (1.0, -1.0):
            way = zb + 1j * last * np.exp(1j * b[2]) - from_
            far, bearing = abs(way), np.angle(way)
            if first == last or far >= 2.0:
                straight = far if first == last else np.sqrt(far * far - 4.0)
                heading = bearing if first == last else bearing + first * np.arctan2(2.0, straight)
                pieces = ((first * (heading - a[2])) % FULL, straight, (last * (b[2] - heading)) % FULL)
                total = pieces[0] + pieces[1] + pieces[2]
                if total < best and _clear(za, a[2], (first, 0.0, last), pieces, centres, radii):
                    best = total
            if first == last and 1e-6 < far <= 4.0:
                for sign in (1.0, -1.0):
                    out = bearing + sign * np.arccos(0.25 * far)
                    one = out + first * 0.5 * np.pi
                    two = np.angle(2.0 * np.exp(1j * out) - way) + first * 0.5 * np.pi
                    pieces = (
                        (first * (one - a[2])) % FULL,
                        (first * (one - two)) % FULL,
                        (first * (b[2] - two)) % FULL,
                    )
                    total = pieces[0] + pieces[1] + pieces[2]
                    if total < best and _clear(za, a[2], (first, -first, first), pieces, centres, radii):
                        best = total
    return best if best < limit else np.inf


@njit(cache=True)
def _thrown(
    start: np.ndarray, goal: np.ndarray, centres: np.ndarray, radii: np.ndarray, count: int, rng: np.random.Generator
) -> np.ndarray:
    """Random poses ``(count, 3)``, the first and the last given: most of them along edges, some anywhere."""
    poses = np.empty((count, 3))
    poses[0], poses[count - 1] = start, goal
    low, high = np.minimum(start[:2], goal[:2]) - 3.0, np.maximum(start[:2], goal[:2]) + 3.0
    n = 1
    while n < count - 1:
        if rng.random() < 0.8:
            k, bearing = rng.integers(0, len(radii)), rng.uniform(-np.pi, np.pi)
            z = centres[k] + (radii[k] + 1e-6 + rng.exponential(0.05)) * np.exp(1j * bearing)
            side = 1.0 if rng.random() < 0.5 else -1.0
            poses[n, 0], poses[n, 1] = z.real, z.imag
            poses[n, 2] = bearing + side * 0.5 * np.pi + 0.1 * rng.standard_normal()
        else:
            poses[n, 0], poses[n, 1] = rng.uniform(low[0], high[0]), rng.uniform(low[1], high[1])
            poses[n, 2] = rng.uniform(-np.pi, np.pi)
        n += (np.abs(poses[n, 0] + 1j * poses[n, 1] - centres) >= radii).all()
    return poses


@njit(cache=True)
def _dijkstra(poses: np.ndarray, centres: np.ndarray, radii: np.ndarray) -> np.ndarray:
    n = len(poses)
    way, before, done = np.full(n, np.inf), np.zeros(n, np.int64), np.zeros(n, np.bool_)
    way[0] = 0.0
    while True:
        u = np.argmin(np.where(done, np.inf, way))
        if done[u] or way[u] == np.inf:
            return poses[:0]
        if u == n - 1:
            break
        done[u] = True
        for v in range(1, n):
            room = min(way[v], way[n - 1] - np.hypot(poses[v, 0] - poses[n - 1, 0], poses[v, 1] - poses[n - 1, 1]))
            if not done[v]:
                reached = way[u] + join(poses[u], poses[v], centres, radii, room - way[u])
                if reached < way[v]:
                    way[v], before[v] = reached, u
    v, nodes = n - 1, [n - 1]
    while v > 0:
        v = before[v]
        nodes.append(v)
    return poses[np.array(nodes[::-1])]


@njit(cache=True)
def _shaken(way: np.ndarray, centres: np.ndarray, radii: np.ndarray, shakes: int, rng: np.random.Generator) -> float:
    way = way.copy()
    n = len(way)
    legs = np.array([join(way[i], way[i + 1], centres, radii, np.inf) for i in range(n - 1)])
    for _ in range(shakes if n > 2 else 0):
        i = rng.integers(1, n - 1)
        pose = way[i] + 10.0 ** rng.uniform(-4.0, 0.0) * rng.standard_normal(3)
        whole = legs[i - 1] + legs[i]
        first = join(way[i - 1], pose, centres, radii, whole)
        second = join(pose, way[i + 1], centres, radii, whole - first) if first < whole else np.inf
        if first + second < whole:
            way[i], legs[i - 1], legs[i] = pose, first, second
    return legs.sum()


@njit(cache=True)
def shortest_found(
    start: np.ndarray,
    goal: np.ndarray,
    obstacles: np.ndarray,
    rng: np.random.Generator,
    throws: int,
    count: int,
    shakes: int,
) -> float:
    """The length of the shortest path found in some throws of ``count`` poses; infinite where none was found.

    Args:
        start: ``(3,)`` pose in turn radii and rad.
        goal: ``(3,)`` pose.
        obstacles: ``(m, 3)`` x, y, radius in turn radii.
        rng: Its randomness.
        throws: How often poses are thrown.
        count: How many.
        shakes: How often a way is shaken.
    """
    centres, radii = obstacles[:, 0] + 1j * obstacles[:, 1], obstacles[:, 2].copy()
    best = np.inf
    for _ in range(throws):
        way = _dijkstra(_thrown(start, goal, centres, radii, count, rng), centres, radii)
        if len(way):
            best = min(best, _shaken(way, centres, radii, shakes, rng))
    return best
