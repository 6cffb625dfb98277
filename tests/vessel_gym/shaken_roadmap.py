"""Another planner round circular obstacles, to hold `plan` against: random poses, joined and then shaken.

It shares no code and no idea with `vessel_gym.guidance`: poses are thrown at random about the
obstacles and the square, each pair is joined by the shortest clear path of arcs and straights that
complex numbers find (the middle arc of three may be short here), Dijkstra goes through them, and
the poses on the way are then moved at random, all three numbers of them, as long as that shortens
it. The turn radius is 1.
"""

import numpy as np

FULL = 2.0 * np.pi
SIDES = np.array(
    [[f, 0, g] for f in (1, -1) for g in (1, -1)] + [[f, -f, f] for f in (1, -1) for _ in range(2)],
    float,
)
"""Of the pieces of paths: arcs to the left 1, to the right -1, straights 0."""


def pieces(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Lengths ``(n, 8, 3)`` of the pieces of all paths between poses ``(n, 3)``; infinite for none."""
    found = []
    for first, middle, last in SIDES[[0, 1, 2, 3, 4, 6]]:
        way = b[:, 0] + 1j * b[:, 1] + 1j * last * np.exp(1j * b[:, 2])
        way = way - (a[:, 0] + 1j * a[:, 1] + 1j * first * np.exp(1j * a[:, 2]))
        far, bearing = np.abs(way), np.angle(way)
        if middle == 0.0:
            straight = far if first == last else np.sqrt(np.maximum(far * far - 4.0, 0.0))
            heading = bearing if first == last else bearing + first * np.arctan2(2.0, straight)
            lengths = (
                (first * (heading - a[:, 2])) % FULL,
                straight,
                (last * (b[:, 2] - heading)) % FULL,
            )
            found.append(np.where((first == last) | (far >= 2.0), lengths, np.inf))
            continue
        for sign in (1.0, -1.0):
            out = bearing + sign * np.arccos(np.minimum(0.25 * far, 1.0))
            one = out + first * 0.5 * np.pi
            two = np.angle(2.0 * np.exp(1j * out) - way) + first * 0.5 * np.pi
            lengths = first * np.array([one - a[:, 2], one - two, b[:, 2] - two]) % FULL
            found.append(np.where((far > 1e-6) & (far <= 4.0), lengths, np.inf))
    return np.moveaxis(np.array(found), 2, 0)


def clear(
    a: np.ndarray, sides: np.ndarray, lengths: np.ndarray, centres: np.ndarray, radii: np.ndarray
) -> np.ndarray:
    """Mask of the paths ``(n,)`` of pieces ``(n, 3)`` from poses ``(n, 3)`` that keep clear."""
    z, heading, free = (a[:, 0] + 1j * a[:, 1])[:, None], a[:, 2:], np.ones(len(a), bool)
    for side, length in zip(sides.T[..., None], lengths.T[..., None], strict=True):
        ahead, arc = np.exp(1j * heading), side != 0.0
        centre = z + 1j * side * ahead
        end = np.where(arc, centre + (z - centre) * np.exp(1j * side * length), z + length * ahead)
        off = (centres - z) / ahead
        beside = np.abs(off - np.clip(off.real, 0.0, length))
        turned = side * np.angle((centres - centre) / np.where(arc, z - centre, 1.0)) % FULL
        ends = np.minimum(np.abs(centres - z), np.abs(centres - end))
        round_ = np.where(turned <= length, np.abs(np.abs(centres - centre) - 1.0), ends)
        free &= (np.where(arc, round_, beside) >= radii - 1e-9).all(-1)
        z, heading = end, heading + side * length
    return free


def join(
    a: np.ndarray, b: np.ndarray, centres: np.ndarray, radii: np.ndarray, limit: np.ndarray
) -> np.ndarray:
    """Lengths ``(n,)`` of the shortest clear paths between poses; infinite where none is below the limit."""
    lengths = pieces(a, b)
    totals = np.where(lengths.sum(-1) < limit[:, None], lengths.sum(-1), np.inf)
    rows = np.arange(len(a))
    while len(rows):
        best = totals[rows].argmin(1)
        blocked = np.isfinite(totals[rows, best])
        rows, best = rows[blocked], best[blocked]
        blocked = ~clear(a[rows], SIDES[best], lengths[rows, best], centres, radii)
        rows, best = rows[blocked], best[blocked]
        totals[rows, best] = np.inf
    return totals.min(1)


def thrown(
    start: np.ndarray,
    goal: np.ndarray,
    centres: np.ndarray,
    radii: np.ndarray,
    count: int,
    rng: np.random.Generator,
) -> np.ndarray:
    """Random poses ``(count, 3)``, the first and the last given: most of them along edges, some anywhere."""
    low, high = np.minimum(start[:2], goal[:2]) - 3.0, np.maximum(start[:2], goal[:2]) + 3.0
    poses = [start]
    while len(poses) < count - 1:
        if rng.random() < 0.8:
            k, bearing, side = (
                rng.integers(len(radii)),
                rng.uniform(-np.pi, np.pi),
                rng.choice([1.0, -1.0]),
            )
            z = centres[k] + (radii[k] + 1e-6 + rng.exponential(0.05)) * np.exp(1j * bearing)
            heading = bearing + side * 0.5 * np.pi + 0.1 * rng.standard_normal()
        else:
            z, heading = complex(*rng.uniform(low, high)), rng.uniform(-np.pi, np.pi)
        if (np.abs(z - centres) >= radii).all():
            poses.append(np.array([z.real, z.imag, heading]))
    return np.array([*poses, goal])


def dijkstra(poses: np.ndarray, centres: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """The poses ``(k, 3)`` on the shortest way from the first to the last; none where there is none."""
    n = len(poses)
    way, before, done = np.full(n, np.inf), np.zeros(n, int), np.zeros(n, bool)
    way[0], left = 0.0, np.hypot(*(poses[:, :2] - poses[-1, :2]).T)
    while not done[-1]:
        u = int(np.where(done, np.inf, way).argmin())
        if done[u] or way[u] == np.inf:
            return poses[:0]
        done[u] = True
        limit = np.minimum(way, way[-1] - left) - way[u]
        v = np.nonzero(~done & (np.hypot(*(poses[:, :2] - poses[u, :2]).T) < limit))[0]
        reached = way[u] + join(
            np.broadcast_to(poses[u], (len(v), 3)), poses[v], centres, radii, limit[v]
        )
        v, reached = v[reached < way[v]], reached[reached < way[v]]
        way[v], before[v] = reached, u
    nodes = [n - 1]
    while nodes[-1] > 0:
        nodes.append(int(before[nodes[-1]]))
    return poses[nodes[::-1]]


def shaken(
    way: np.ndarray, centres: np.ndarray, radii: np.ndarray, shakes: int, rng: np.random.Generator
) -> float:
    """The length of a way, shaken so often."""
    n = len(way)
    legs = join(way[:-1], way[1:], centres, radii, np.full(n - 1, np.inf))
    for _ in range(shakes if n > 2 else 0):
        i = rng.integers(1, n - 1)
        pose = way[i] + 10.0 ** rng.uniform(-4.0, 0.0) * rng.standard_normal(3)
        limit = np.full(2, legs[i - 1] + legs[i])
        new = join(
            np.stack([way[i - 1], pose]), np.stack([pose, way[i + 1]]), centres, radii, limit
        )
        if new.sum() < limit[0]:
            way[i], legs[i - 1 : i + 1] = pose, new
    return float(legs.sum())


def shortest_found(
    start: np.ndarray, goal: np.ndarray, obstacles: np.ndarray, rng: np.random.Generator, throws: int, count: int,
    shakes: int,
) -> float:  # fmt: skip
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
    centres, radii = obstacles[:, 0] + 1j * obstacles[:, 1], obstacles[:, 2]
    ways = [
        dijkstra(thrown(start, goal, centres, radii, count, rng), centres, radii)
        for _ in range(throws)
    ]
    return min(
        [shaken(way, centres, radii, shakes, rng) for way in ways if len(way)], default=np.inf
    )
