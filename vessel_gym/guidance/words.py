"""Shortest paths of bounded curvature between two poses: Dubins' six words in closed form.

A word names the pieces of a path: L and R are arcs of the turn radius, S is a straight. Three pieces are
always enough, and only LSL, LSR, RSL, RSR, LRL and RLR can be shortest (Dubins 1957, On curves of minimal
length with a constraint on average curvature; formulas as in Shkel & Lumelsky 2001, Classification of the
Dubins set). Poses are (x, y, theta): theta from +x towards +y, L turns theta up.

Where a piece has length zero, rounding can turn it into a full circle, and the length is wrong by 2 pi R. So
every word is first asked whether it reaches the goal without its first or without its last arc.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numba import njit

from estimators.checks import as_array, finite_array, number, shaped_array, shown
from estimators.checks import numbers as real_numbers
from estimators.compiled import gufunc, part
from vessel_gym.checks import check_numbers

WORDS = ("LSL", "LSR", "RSL", "RSR", "LRL", "RLR")
"""The order of the last axis of `lengths`."""
TURNS = {"L": 1.0, "S": 0.0, "R": -1.0}
"""Curvature of a piece in units of 1 / R."""
_CURVATURES = np.array([[TURNS[letter] for letter in word] for word in WORDS])

_FULL = 2.0 * np.pi
_ORDER = np.arange(len(WORDS), dtype=float)  # tells the compiled functions how many words there are
_NONE = (np.inf, np.inf, np.inf)
Pose = np.ndarray | tuple[float, ...]


# --- the words, for a start at the origin heading along +x and a radius of 1 ------------------------


@part
def whole(angle: float) -> float:
    """An angle modulo a full turn, in [0, 2 pi]; many times faster than ``%``."""
    return max(angle - _FULL * np.floor(angle / _FULL), 0.0)


@part
def _turn(angle: float) -> float:
    """The angle in [0, 2 pi), where a hair below a full turn is none: headings that agree need no circle."""
    angle = whole(angle)
    return 0.0 if angle > _FULL - 1e-11 else angle


@part
def _lsl(x: float, y: float, a: float, sin: float, cos: float, hair: float) -> tuple[float, float, float]:
    """First arc, straight and last arc of LSL to the pose (x, y, a); errors below a hair are rounding."""
    dx, dy = x - sin, y + cos - 1.0  # from the centre of the first arc to that of the last
    if abs(dy) < hair and dx > -hair:
        return 0.0, max(dx, 0.0), _turn(a)
    along = dx * cos + dy * sin
    if abs(dy * cos - dx * sin) < hair and along > -hair:
        return _turn(a), max(along, 0.0), 0.0
    heading = np.arctan2(dy, dx)
    return whole(heading), np.hypot(dx, dy), whole(a - heading)


@part
def _lsr(x: float, y: float, a: float, sin: float, cos: float, hair: float) -> tuple[float, float, float]:
    """First arc, straight and last arc of LSR; infinite where the two circles overlap."""
    dx, dy = x + sin, y - cos - 1.0
    distance = np.hypot(dx, dy)
    if distance < 2.0 - hair:
        return _NONE
    if abs(dy + 2.0) < hair and dx > -hair:
        return 0.0, max(dx, 0.0), _turn(-a)
    along = dx * cos + dy * sin
    if abs(dx * sin - dy * cos - 2.0) < hair and along > -hair:
        return _turn(a), max(along, 0.0), 0.0
    straight = np.sqrt(max((distance - 2.0) * (distance + 2.0), 0.0))
    heading = np.arctan2(dy, dx) + np.arctan2(2.0, straight)
    return whole(heading), straight, whole(heading - a)


@part
def _lrl(x: float, y: float, a: float, sin: float, cos: float, hair: float) -> tuple[float, float, float]:
    """The three arcs of LRL, the middle one of half a turn or more; infinite where no circle fits between.

    A middle arc of less than half a turn is never part of a shortest path (Dubins 1957), and a full circle
    in the middle is left out.
    """
    dx, dy = x - sin, y + cos - 1.0
    distance = np.hypot(dx, dy)
    if distance > 4.0 + hair:
        return _NONE
    if distance < hair:
        return _turn(a), 0.0, 0.0
    # Without the first arc the middle circle is beside the start, without the last one beside the goal.
    nx, ny = -0.5 * dx, 1.0 + 0.5 * dy
    middle = whole(-np.arctan2(nx, ny))
    if abs(np.hypot(nx, ny) - 1.0) < hair and middle >= np.pi:
        return 0.0, middle, _turn(a + middle)
    nx, ny = 0.5 * dx + sin, cos - 0.5 * dy
    middle = whole(np.arctan2(nx, ny) - a)
    if abs(np.hypot(nx, ny) - 1.0) < hair and middle >= np.pi:
        return _turn(a + middle), middle, 0.0
    half = np.pi - np.arcsin(min(0.25 * distance, 1.0))
    heading = np.arctan2(dy, dx)
    return whole(heading + half), 2.0 * half, whole(a - heading + half)


@part
def relative(start: Pose, goal: Pose, radius: float) -> tuple[float, float, float, float, float, float]:
    """The goal seen from the start: x and y in units of the radius, heading, its sine and cosine, what is rounding."""
    dx, dy = (goal[0] - start[0]) / radius, (goal[1] - start[1]) / radius
    sin, cos, a = np.sin(start[2]), np.cos(start[2]), goal[2] - start[2]
    hair = 1e-12 * (10.0 + (abs(start[0]) + abs(start[1]) + abs(goal[0]) + abs(goal[1])) / radius)
    return dx * cos + dy * sin, dy * cos - dx * sin, a, np.sin(a), np.cos(a), hair


@part
def pieces_of(word: int, seen: tuple[float, float, float, float, float, float]) -> tuple[float, float, float]:
    """The three lengths of a word of `WORDS` to a goal that is seen so; a word that begins with R is its mirror's."""
    x, y, a, sin, cos, hair = seen
    if word == 2 or word == 3 or word == 5:
        y, a, sin = -y, -a, -sin
    if word == 0 or word == 3:
        return _lsl(x, y, a, sin, cos, hair)
    if word == 1 or word == 2:
        return _lsr(x, y, a, sin, cos, hair)
    return _lrl(x, y, a, sin, cos, hair)


@gufunc(
    "void(float64[:], float64[:], float64, float64[:], float64[:, :])",
    "(n),(n),(),(w)->(w,n)",
)
def _word_pieces(start: np.ndarray, goal: np.ndarray, radius: float, order: np.ndarray, out: np.ndarray) -> None:
    seen = relative(start, goal, radius)
    for word in range(len(order)):
        out[word, 0], out[word, 1], out[word, 2] = pieces_of(word, seen)


@njit()
def _follow_on(s: float, x: float, y: float, heading: float, curvature: float) -> tuple[float, float, float]:
    """The pose ``s`` metres on from a pose."""
    half = 0.5 * curvature * s
    chord = s if abs(half) < 1e-9 else s * np.sin(half) / half
    return x + chord * np.cos(heading + half), y + chord * np.sin(heading + half), heading + 2.0 * half


def follow_on(
    s: np.ndarray, x: np.ndarray, y: np.ndarray, heading: np.ndarray, curvature: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The poses ``(...)`` at ``s`` metres along arcs of ``curvature`` [1/m] (0: straights)."""
    half = 0.5 * curvature * s
    straight = abs(half) < 1e-9
    chord = np.where(straight, s, s * np.sin(half) / np.where(straight, 1.0, half))
    return x + chord * np.cos(heading + half), y + chord * np.sin(heading + half), heading + 2.0 * half


@gufunc("void(float64[:], float64[:], float64[:], float64[:], float64[:, :])", "(n),(k),(k),(w)->(k,w)")
def _chained(
    start: np.ndarray, curvatures: np.ndarray, lengths: np.ndarray, room: np.ndarray, rows: np.ndarray
) -> None:
    x, y, heading = start[0], start[1], start[2]
    for k in range(len(lengths)):
        rows[k, 0], rows[k, 1], rows[k, 2], rows[k, 3], rows[k, 4] = x, y, heading, curvatures[k], lengths[k]
        x, y, heading = _follow_on(lengths[k], x, y, heading, curvatures[k])


_MOST_SAMPLES = 10**7

# --- paths ------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Path:
    """Arcs and straights end to end, the heading continuous at every joint.

    The segments are plain rows, so that the paths of many vehicles stack into one array; rows of length 0 fill up.
    """

    segments: np.ndarray  # (k, 5): x, y [m] and heading [rad] where it begins, curvature [1/m], length [m]
    lower_bound: float = 0.0  # m, no path between these poses, round the obstacles that were given, is shorter

    def __post_init__(self) -> None:
        segments = finite_array("segments of a path", self.segments, "k", 5)
        if not len(segments) or (segments[:, 4] < 0.0).any():
            raise ValueError("segments of a path must be one or more, of lengths that are not negative")
        check_numbers(self, not_negative="lower_bound")
        object.__setattr__(self, "segments", segments)

    @cached_property
    def ends(self) -> np.ndarray:
        """Arc length ``(k,)`` [m] at which each segment ends."""
        return np.cumsum(self.segments[:, 4])

    @property
    def length(self) -> float:
        """Length [m]."""
        return float(self.ends[-1])

    @property
    def word(self) -> str:
        """One letter a segment: L (heading up), S or R (heading down)."""
        return "".join("SLR"[int(side)] for side in np.sign(self.segments[:, 3]))

    def pose(self, s: np.ndarray | float) -> np.ndarray:
        """Poses ``(..., 3)`` at arc lengths ``s`` [m] of any shape; beyond an end, that end's.

        The heading is not wrapped: it grows and falls with the turns from the start's on.
        """
        s = np.asarray(np.clip(as_array("s", s), 0.0, self.length))
        k = self._index(s)
        row = self.segments[k]
        return advance(row[..., :3], row[..., 3], s - self.ends[k] + row[..., 4])

    def curvature(self, s: np.ndarray | float) -> np.ndarray:
        """Curvature [1/m] at arc lengths ``s`` [m], L positive; at a joint that of the segment that ends there."""
        return self.segments[self._index(np.asarray(np.clip(as_array("s", s), 0.0, self.length))), 3]

    def sample(self, spacing: float) -> np.ndarray:
        """Poses ``(n, 3)`` from end to end, evenly spaced at no more than ``spacing`` [m].

        Raises:
            ValueError: for a spacing that is not positive.
        """
        number("spacing of samples", spacing, 0.0, what="positive")
        if self.length / spacing > _MOST_SAMPLES:
            raise ValueError(
                f"spacing of samples must give {_MOST_SAMPLES} at most, got {spacing:g} for {self.length:g} m"
            )
        return self.pose(np.linspace(0.0, self.length, 1 + max(int(np.ceil(self.length / spacing)), 1)))

    def _index(self, s: np.ndarray) -> np.ndarray:
        return np.minimum(np.searchsorted(self.ends, s), len(self.ends) - 1)


def advance(pose: np.ndarray, curvature: np.ndarray | float, length: np.ndarray | float) -> np.ndarray:
    """The poses ``(..., 3)`` at ``length`` [m] along arcs of ``curvature`` [1/m] (0: straights), exact for both."""
    pose, curvature = shaped_array("pose", pose, "...", 3), as_array("curvature", curvature)
    length = as_array("length", length)
    turn = curvature * length
    chord = length * np.sinc(turn / _FULL)  # 2 sin(turn / 2) / curvature, also where that is 0
    middle = pose[..., 2] + 0.5 * turn
    return np.stack(
        [pose[..., 0] + chord * np.cos(middle), pose[..., 1] + chord * np.sin(middle), pose[..., 2] + turn], -1
    )


def chain(start: np.ndarray, curvatures: np.ndarray, lengths: np.ndarray) -> Path:
    """The path of pieces from a pose ``(3,)``; pieces of length 0 are left out unless there is nothing else.

    Args:
        start: ``(3,)`` pose.
        curvatures: ``(k,)`` 1/m.
        lengths: ``(k,)`` m.

    Raises:
        ValueError: for what is no pose, or curvatures and lengths that are not as many.
    """
    start, curvatures = finite_array("start", start, 3), finite_array("curvatures", curvatures, "k")
    lengths = finite_array("lengths, as many as curvatures,", lengths, len(curvatures))
    kept = lengths > 0.0
    if not kept.any():
        return Path(np.array([[*start, 0.0, 0.0]]))
    return Path(_chained(start, curvatures[kept], lengths[kept], np.empty(5)))


# --- shortest paths ---------------------------------------------------------------------------------


def lengths(start: np.ndarray, goal: np.ndarray, radius: np.ndarray | float) -> np.ndarray:
    """Lengths ``(..., 6)`` [m] of the words, in the order of `WORDS`, for many pairs of poses at once.

    The smallest along the last axis is the distance; a word that does not join the two poses is infinite.

    Args:
        start: ``(..., 3)`` poses [m, m, rad].
        goal: ``(..., 3)`` poses; leading axes broadcast.
        radius: Turn radius [m], ``(...)``.

    Raises:
        ValueError: for poses that are not finite or a radius that is not positive.
    """
    start, goal, radius = checked(start, goal, radius)
    pieces = _word_pieces(start, goal, radius, _ORDER)
    return (pieces[..., 0] + pieces[..., 1] + pieces[..., 2]) * radius[..., None]


def candidates(start: np.ndarray, goal: np.ndarray, radius: float) -> dict[str, float]:
    """The length [m] of each word that joins two poses ``(3,)``; LRL and RLR do so only between near ones.

    Raises:
        ValueError: for poses that are not finite or a radius that is not positive.
    """
    values = lengths(*_single(start, goal, radius), radius)
    return {word: float(value) for word, value in zip(WORDS, values, strict=True) if np.isfinite(value)}


def word_path(start: np.ndarray, goal: np.ndarray, radius: float, word: str) -> Path:
    """The path of one word of `WORDS` between two poses ``(3,)``.

    Raises:
        ValueError: for bad poses or radius, or where this word does not join them.
    """
    start, goal, _ = checked(*_single(start, goal, radius), radius)
    if not isinstance(word, str) or word not in WORDS:
        raise ValueError(f"unknown word {shown(word)}: choose one of {', '.join(WORDS)}")
    pieces = _word_pieces(start, goal, radius, _ORDER)[WORDS.index(word)]
    if not np.isfinite(pieces).all():
        raise ValueError(f"no path {word} joins these poses: `candidates` says which words do")
    return chain(start, _CURVATURES[WORDS.index(word)] / radius, pieces * radius)


def shortest(start: np.ndarray, goal: np.ndarray, radius: float) -> Path:
    """The shortest path between two poses ``(3,)`` that never turns tighter than the radius [m].

    Of words of equal length the first in `WORDS` is taken. Pieces of length 0 are left out, so the word of the
    path may be shorter: a goal straight ahead is reached by S.

    Raises:
        ValueError: for poses that are not finite or a radius that is not positive.
    """
    start, goal, _ = checked(*_single(start, goal, radius), radius)
    pieces = _word_pieces(start, goal, radius, _ORDER)
    word = ((pieces[:, 0] + pieces[:, 1] + pieces[:, 2]) * radius).argmin()
    path = chain(start, _CURVATURES[word] / radius, pieces[word] * radius)
    return replace(path, lower_bound=path.length)


def numbers(name: str, value: object) -> np.ndarray:
    """A float array.

    Raises:
        ValueError: for what is none.
    """
    array = real_numbers(value)
    if array is None:
        raise ValueError(f"the {name} must be numbers, got {shown(value)}")
    return array


def checked(
    start: np.ndarray, goal: np.ndarray, radius: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Poses ``(..., 3)`` and radius as float arrays.

    Raises:
        ValueError: for poses that are not finite or a radius that is not positive.
    """
    start, goal, radius = numbers("start", start), numbers("goal", goal), numbers("turn radius", radius)
    for name, pose in (("start", start), ("goal", goal)):
        if pose.ndim == 0 or pose.shape[-1] != 3:
            raise ValueError(f"the {name} must be a pose (x, y, theta), got shape {pose.shape}")
        if not np.isfinite(pose).all():
            raise ValueError(f"the {name} must be finite: replace {pose[~np.isfinite(pose)][0]} by a number")
    if not (np.isfinite(radius) & (radius > 0.0)).all():
        raise ValueError(f"the turn radius must be positive and finite, got {radius.min()}")
    return start, goal, radius


def _single(start: np.ndarray, goal: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    start, goal = numbers("start", start), numbers("goal", goal)
    if numbers("turn radius", radius).ndim:
        raise ValueError(f"the turn radius must be one number, got {shown(radius)}: `lengths` takes many")
    if start.shape != (3,) or goal.shape != (3,):
        raise ValueError(
            f"start and goal must each be one pose (x, y, theta), got shapes {start.shape} and {goal.shape}: "
            "`lengths` takes many"
        )
    return start, goal
