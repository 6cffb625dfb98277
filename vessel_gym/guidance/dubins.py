"""Shortest paths of bounded curvature between two poses: Dubins' six words in closed form.

A word names the pieces of a path: L and R are arcs of the turn radius, S is a straight. Three
pieces are always enough, and only LSL, LSR, RSL, RSR, LRL and RLR can be shortest (Dubins 1957, On
curves of minimal length with a constraint on average curvature; formulas as in Shkel & Lumelsky
2001, Classification of the Dubins set). Poses are (x, y, theta), with theta from +x towards +y; L
increases theta.

Rounding can turn a piece of length zero into a full circle, an error of 2 pi R. So every word is
first tried without its first arc, and without its last arc.
"""

from dataclasses import dataclass

import numpy as np

from estimators.angles import ahead_and_aside
from estimators.checks import as_array, finite_array, number
from estimators.engine import compiled, sincos

WORDS = ("LSL", "LSR", "RSL", "RSR", "LRL", "RLR")
"""Words in the order of the last axis of `lengths`."""
CURVATURES = np.array([["RSL".index(letter) - 1.0 for letter in word] for word in WORDS])
"""Curvatures ``(6, 3)`` of the words' pieces in units of 1 / R."""

COLUMNS = 5
"""Numbers in the row of a segment: x, y, heading, curvature and length."""
_FULL = 2.0 * np.pi


# --- the words, for a start at the origin heading along +x and a radius of 1 ----------------------


def whole(angle: np.ndarray) -> np.ndarray:
    """Angles modulo a full turn, in [0, 2 pi]."""
    return np.maximum(angle - _FULL * np.floor(angle / _FULL), 0.0)


def _turn(angle: np.ndarray) -> np.ndarray:
    """Angle in [0, 2 pi); a full turn within rounding is 0: equal headings need no circle."""
    angle = whole(angle)
    return np.where(angle > _FULL - 1e-11, 0.0, angle)


def _choose(
    cases: list[tuple[np.ndarray, list[np.ndarray]]], otherwise: list[np.ndarray]
) -> np.ndarray:
    """The three lengths ``(..., 3)`` of the first case that holds."""
    pieces = np.stack(otherwise, -1)
    for holds, lengths in reversed(cases):
        pieces = np.where(holds[..., None], np.stack(lengths, -1), pieces)
    return pieces


_Goal = tuple[np.ndarray, ...]
"""x, y, heading, its sine and cosine, and the size of rounding errors, ``(...)`` each."""


def _turn_straight_turn(goal: _Goal, side: float) -> np.ndarray:
    """First arc, straight and last arc of LSL (``side`` 1) or LSR (``side`` -1) to a goal.

    LSR is infinite if the two circles overlap.
    """
    x, y, a, sin, cos, hair = goal
    gap = 1.0 - side  # of LSR, whose straight goes from one side of the centres to the other
    dx, dy = x - side * sin, y + side * cos - 1.0  # from the first arc's centre to the last arc's
    distance, along, none = np.hypot(dx, dy), dx * cos + dy * sin, np.zeros_like(dx)
    ahead = (abs(dy + gap) < hair) & (dx > -hair)
    arrived = (abs(dy * cos - dx * sin + gap) < hair) & (along > -hair)
    straight = np.sqrt(np.maximum((distance - gap) * (distance + gap), 0.0))
    heading = np.arctan2(dy, dx) + np.arctan2(gap, straight)
    return _choose(
        [
            (distance < gap - hair, [none + np.inf] * 3),
            (ahead, [none, np.maximum(dx, 0.0), _turn(side * a)]),
            (arrived, [_turn(a), np.maximum(along, 0.0), none]),
        ],
        [whole(heading), straight, whole(side * (a - heading))],
    )


def _lrl(goal: _Goal) -> np.ndarray:
    """The three arcs of LRL to a goal, with half a turn or more in the middle.

    They are infinite if no circle fits. A middle arc of less than half a turn is never part of a
    shortest path (Dubins 1957), and a full circle in the middle is left out.
    """
    x, y, a, sin, cos, hair = goal
    dx, dy = x - sin, y + cos - 1.0
    distance, none = np.hypot(dx, dy), np.zeros_like(dx)
    # Without the first arc the middle circle touches the start, without the last arc the goal.
    nx, ny = -0.5 * dx, 1.0 + 0.5 * dy
    first = whole(-np.arctan2(nx, ny))
    no_first = (abs(np.hypot(nx, ny) - 1.0) < hair) & (first >= np.pi)
    nx, ny = 0.5 * dx + sin, cos - 0.5 * dy
    last = whole(np.arctan2(nx, ny) - a)
    no_last = (abs(np.hypot(nx, ny) - 1.0) < hair) & (last >= np.pi)
    half = np.pi - np.arcsin(np.minimum(0.25 * distance, 1.0))
    heading = np.arctan2(dy, dx)
    return _choose(
        [
            (distance > 4.0 + hair, [none + np.inf] * 3),
            (distance < hair, [_turn(a), none, none]),
            (no_first, [none, first, _turn(a + first)]),
            (no_last, [_turn(a + last), last, none]),
        ],
        [whole(heading + half), 2.0 * half, whole(a - heading + half)],
    )


@compiled(axes=(1, 1, 0))
def word_pieces(start: np.ndarray, goal: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Lengths ``(..., 6, 3)`` of the words' pieces, in units of the radius ``(...)``."""
    dx, dy = (goal[..., 0] - start[..., 0]) / radius, (goal[..., 1] - start[..., 1]) / radius
    x, y = ahead_and_aside(dx, dy, start[..., 2])
    a = goal[..., 2] - start[..., 2]
    sin, cos = sincos(a)
    reach = abs(start[..., 0]) + abs(start[..., 1]) + abs(goal[..., 0]) + abs(goal[..., 1])
    hair = 1e-12 * (10.0 + reach / radius)
    left = x, y, a, sin, cos, hair
    right = x, -y, -a, -sin, cos, hair  # R is the mirror image of L
    straight = _turn_straight_turn
    words = [
        straight(left, 1.0),
        straight(left, -1.0),
        straight(right, -1.0),
        straight(right, 1.0),
    ]
    return np.stack([*words, _lrl(left), _lrl(right)], -2)


@compiled(axes=(0, 0, 0, 0, 0))
def follow_on(
    s: np.ndarray, x: np.ndarray, y: np.ndarray, heading: np.ndarray, curvature: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Poses ``(...)`` at ``s`` metres along arcs of ``curvature`` [1/m] (0: straights)."""
    half = 0.5 * curvature * s
    straight = abs(half) < 1e-9
    chord = np.where(straight, s, s * np.sin(half) / np.where(straight, 1.0, half))
    return (
        x + chord * np.cos(heading + half),
        y + chord * np.sin(heading + half),
        heading + 2.0 * half,
    )


def chained(start: np.ndarray, curvatures: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Segments ``(..., k, 5)`` of pieces ``(..., k)`` end to end from poses ``(..., 3)``."""
    begins = np.concatenate([start[..., 2:], curvatures * lengths], -1).cumsum(-1)[..., :-1]
    x, y, _ = follow_on(lengths, 0.0, 0.0, begins, curvatures)
    places = (
        np.concatenate([start[..., i : i + 1], by], -1).cumsum(-1)[..., :-1]
        for i, by in enumerate((x, y))
    )
    return np.stack([*places, begins, curvatures, lengths], -1)


@compiled(axes=(0, 1))
def pose_along(
    along: np.ndarray, segments: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x, y [m] and heading [rad] ``(...)`` at ``along (...)`` [m] on paths ``(..., 5 k)``.

    The heading is continuous. Before its start and beyond its end a path is straight.
    """
    x, y, heading, curvature, length = (segments[..., i::COLUMNS] for i in range(COLUMNS))
    covered = np.clip(along[..., None] - (length.cumsum(-1) - length), 0.0, length)
    by_x, by_y, _ = follow_on(covered, 0.0, 0.0, heading, curvature)
    outside = along - np.clip(along, 0.0, length.sum(-1))
    theta = heading[..., 0] + (curvature * covered).sum(-1)
    return (
        x[..., 0] + by_x.sum(-1) + outside * np.cos(theta),
        y[..., 0] + by_y.sum(-1) + outside * np.sin(theta),
        theta,
    )


def nearest(
    x: np.ndarray, y: np.ndarray, arc: tuple[np.ndarray, ...], low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Point of an arc or a straight that is nearest to (x, y), ``(...)`` each.

    Args:
        x: First coordinate of the place [m].
        y: Second coordinate of the place [m].
        arc: x, y [m], heading [rad] and curvature [1/m] of the segment's origin.
        low: Least arc length from the origin [m].
        high: Greatest arc length from the origin [m].

    Returns:
        Arc length in [low, high], and x, y and heading there.
    """
    origin_x, origin_y, heading, curvature = arc
    ahead, aside = ahead_and_aside(x - origin_x, y - origin_y, heading)
    straight, side = curvature == 0.0, np.where(curvature > 0.0, 1.0, -1.0)
    radius = 1.0 / np.where(straight, 1.0, abs(curvature))
    full = 2.0 * np.pi * radius
    beyond = np.arctan2(ahead, radius - side * aside) * radius - low
    s = low + (beyond - full * np.floor(beyond / full))
    end = np.where(s - high < low + full - s, high, low)
    s = np.where(straight, np.clip(ahead, low, high), np.where(s <= high, s, end))
    return s, *follow_on(s, *arc)


@compiled
def distances(segments: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distances ``(...)`` of arcs and straights ``(..., 5)`` from points ``(..., 2)``."""
    *arc, length = (segments[..., i] for i in range(5))
    x, y = points[..., 0], points[..., 1]
    _, at_x, at_y, _ = nearest(x, y, tuple(arc), 0.0 * length, length)
    return np.hypot(x - at_x, y - at_y)


# --- paths ----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Path:
    """Arcs and straights end to end, with a continuous heading.

    The segments are plain rows, so that the paths of many vehicles stack into one array, padded by
    rows of length 0.
    """

    segments: np.ndarray  # (k, 5): initial x, y [m], heading [rad], curvature [1/m], length [m]

    @property
    def length(self) -> float:
        """Length of the path [m]."""
        return float(self.segments[:, 4].sum())

    @property
    def word(self) -> str:
        """One letter for each segment, L (heading increases), S or R (heading decreases)."""
        return "".join("SLR"[int(side)] for side in np.sign(self.segments[:, 3]))

    def pose(self, s: np.ndarray | float) -> np.ndarray:
        """Poses ``(..., 3)`` at arc lengths ``s`` [m] of any shape, clipped to the path.

        The heading is not wrapped: it follows the turns from the start continuously.
        """
        s = np.clip(as_array("s", s), 0.0, self.length)
        return np.stack(pose_along.function(s, self.segments.ravel()), -1)

    def sample(self, spacing: float) -> np.ndarray:
        """Poses ``(n, 3)`` from end to end, evenly spaced by at most ``spacing`` [m].

        Raises:
            ValueError: for a spacing that is not positive.
        """
        count = int(np.ceil(self.length / number("spacing", spacing, 0.0, what="positive")))
        return self.pose(np.linspace(0.0, self.length, 1 + max(count, 1)))

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Distance ``(m,)`` [m] of the path from points ``(m, 2)``, in closed form."""
        return distances(self.segments, points[..., None, :]).min(-1)


def path_of(segments: np.ndarray) -> Path:
    """Path of segments ``(k, 5)`` end to end, without those of length 0."""
    kept = segments[segments[:, 4] > 0.0]
    return Path(kept if len(kept) else np.array([[*segments[0, :3], 0.0, 0.0]]))


# --- shortest paths -------------------------------------------------------------------------------


def lengths(start: np.ndarray, goal: np.ndarray, radius: np.ndarray | float) -> np.ndarray:
    """Lengths ``(..., 6)`` [m] of the words, in the order of `WORDS`, for many pairs of poses.

    The smallest along the last axis is the length of the shortest path. A word that does not join
    the two poses is infinite; LRL and RLR join near poses only.

    Args:
        start: ``(..., 3)`` poses [m, m, rad].
        goal: ``(..., 3)`` poses; leading axes broadcast.
        radius: Turn radius [m], ``(...)``.

    Raises:
        ValueError: for poses that are not finite or a radius that is not positive.
    """
    start, goal, radius = checked(start, goal, radius, "...")
    total: np.ndarray = word_pieces(start, goal, radius).sum(-1) * radius[..., None]
    return total


@compiled(axes=(1, 1, 0))
def shortest_pieces(start: np.ndarray, goal: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Segments ``(..., 3, 5)`` of shortest paths between poses ``(..., 3)``, some of length 0.

    Of words of equal length, the first in `WORDS` is taken.
    """
    pieces = word_pieces(start, goal, radius) * radius[..., None, None]
    total = pieces.sum(-1)
    length, lengths, curvatures = total[..., 0], pieces[..., 0, :], CURVATURES[0]
    for word in range(1, len(WORDS)):
        shorter = total[..., word] < length
        length = np.where(shorter, total[..., word], length)
        lengths = np.where(shorter, pieces[..., word, :], lengths)
        curvatures = np.where(shorter, CURVATURES[word], curvatures)
    return chained(start, curvatures / radius[..., None], lengths)


def shortest(start: np.ndarray, goal: np.ndarray, radius: float) -> Path:
    """The shortest path between two poses ``(3,)`` that never turns tighter than the radius [m].

    Of words of equal length, the first in `WORDS` is taken. Pieces of length 0 are left out, so
    that the path's word may be shorter: a goal straight ahead has the word S.

    Raises:
        ValueError: for poses that are not finite or a radius that is not positive.
    """
    start, goal, turn = checked(start, goal, radius)
    return path_of(shortest_pieces(start, goal, turn))


def checked(
    start: np.ndarray, goal: np.ndarray, radius: np.ndarray | float, *many: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two poses ``(3,)`` and a radius as float arrays; with ``"..."``, many, ``(..., 3)``.

    Raises:
        ValueError: for poses that are not finite or a radius that is not positive.
    """
    poses = finite_array("start", start, *many, 3), finite_array("goal", goal, *many, 3)
    turn = finite_array("turn radius", radius, *many)
    if (turn <= 0.0).any():
        raise ValueError(f"the turn radius must be positive, got {turn.min()}")
    return *poses, turn
