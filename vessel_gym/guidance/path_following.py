"""Where a vehicle is on a path of arcs and straights, and what the path does there and further on.

A path is rows (x, y, heading where it begins, curvature, length), as `vessel_gym.guidance.dubins` plans them,
flattened; rows of length 0 at the end fill up. Before its start and beyond its end a path goes straight on for `LEAD`
metres.

A path may cross itself. Where two places are near, the one along which the vehicle flies counts: a heading that is off
counts like `PER_RAD` metres a radian, and twice that at most. So no memory is needed.
"""

import numpy as np
from numba import njit

from estimators.checks import as_array, shaped_array
from estimators.compiled import gufunc
from vessel_gym.checks import check_pair
from vessel_gym.guidance.words import follow_on

LEAD = 50.0
"""Metres for which the path goes straight on at both ends."""
PER_RAD = 20.0
"""Metres that count like a heading that is off by a small angle, a radian."""
COLUMNS = 5
"""Numbers a segment."""
_FAR = 1e6  # m: what is farther off is treated as this far, so that nothing overflows
_FULL = 2.0 * np.pi


@njit()
def _closest(x: float, y: float, curvature: float, low: float, high: float) -> float:
    """Arc length in [low, high] of the point closest to (x ahead, y to the side of positive curvature) of a segment."""
    if curvature == 0.0:
        return min(max(x, low), high)
    radius, side = 1.0 / abs(curvature), 1.0 if curvature > 0.0 else -1.0
    full = _FULL * radius
    s = np.arctan2(x, radius - side * y) * radius
    s = low + (s - low) % full
    if s <= high:
        return s
    return high if s - high < low + full - s else low


@gufunc(
    "void(float64[:], float64[:], float64[:], float64[:], float64[:], float64[:])",
    "(p),(w),(c),(a),(k)->(k)",
)
def _follow(
    pose: np.ndarray, window: np.ndarray, segments: np.ndarray, ahead: np.ndarray, room: np.ndarray, out: np.ndarray
) -> None:
    x, y = min(max(pose[0], -_FAR), _FAR), min(max(pose[1], -_FAR), _FAR)
    count, whole = 0, 0.0
    while count < len(segments) // COLUMNS and segments[COLUMNS * count + 4] > 0.0:
        whole += segments[COLUMNS * count + 4]
        count += 1
    best, s_best = np.inf, 0.0
    px, py, heading = segments[0], segments[1], segments[2]
    begin = 0.0
    for k in range(-1, count + 1):
        on = COLUMNS * min(max(k, 0), count - 1)
        rx, ry, angle, curvature, length = (
            segments[on], segments[on + 1], segments[on + 2], segments[on + 3], segments[on + 4],
        )  # fmt: skip
        first, last = 0.0, length
        if k < 0:
            curvature, first, last = 0.0, -LEAD, 0.0
        elif k == count:
            rx, ry, angle = follow_on(length, rx, ry, angle, curvature)
            curvature, last = 0.0, LEAD
        low, high = max(first, window[0] - begin), min(last, window[1] - begin)
        if low <= high:
            cos, sin = np.cos(angle), np.sin(angle)
            dx, dy = x - rx, y - ry
            s = _closest(dx * cos + dy * sin, dy * cos - dx * sin, curvature, low, high)
            ax, ay, at = follow_on(s, rx, ry, angle, curvature)
            cost = (x - ax) ** 2 + (y - ay) ** 2 + 2.0 * window[2] ** 2 * (1.0 - np.cos(pose[2] - at))
            if cost < best:
                best, s_best = cost, begin + s
                px, py, heading = ax, ay, at
        if 0 <= k < count:
            begin += length
    out[0] = s_best
    out[1] = (y - py) * np.cos(heading) - (x - px) * np.sin(heading)
    out[2] = heading
    near, far = s_best + ahead[0], s_best + ahead[1]
    out[3], out[4], begin = 0.0, 0.0, 0.0
    for k in range(count):
        end = begin + segments[COLUMNS * k + 4]
        curvature = segments[COLUMNS * k + 3]
        out[3] += curvature * max(min(end, near) - max(begin, s_best), 0.0) / ahead[0]
        out[4] += curvature * max(min(end, far) - max(begin, near), 0.0) / (ahead[1] - ahead[0])
        begin = end
    out[5] = whole - s_best
    out[6] = np.hypot(x - px, y - py)


_ANYWHERE = np.array([-np.inf, np.inf, PER_RAD])
_NOTHING_AHEAD = np.array([1.0, 2.0])


def _flat(segments: object) -> np.ndarray:
    """Paths ``(..., 5 k)``."""
    flat = shaped_array("segments", segments, "...", "5 k")
    if not flat.shape[-1] or flat.shape[-1] % COLUMNS:
        raise ValueError(f"segments must hold {COLUMNS} numbers for each piece of a path, got {flat.shape[-1]}")
    return flat


def follow(pose: np.ndarray, segments: np.ndarray, ahead: tuple[float, float]) -> np.ndarray:
    """Where poses are on their paths, ``(..., 7)``.

    Args:
        pose: ``(..., 3)`` x, y [m] and course [rad].
        segments: ``(..., 5 k)`` the paths.
        ahead: Two distances [m] on: mean curvatures are wanted up to the first, and from there to the second.

    Returns:
        Progress of the closest point [m], cross-track error (positive to the side of positive curvature) [m], heading
        of the path there [rad], its two mean curvatures ahead [1/m], remaining path [m], distance [m].
    """
    pose, segments = shaped_array("pose", pose, "...", 3), _flat(segments)
    check_pair("ahead", ahead)
    return _follow(pose, _ANYWHERE, segments, as_array("ahead", ahead), np.empty(7))


def track(position: np.ndarray, segments: np.ndarray, low: np.ndarray | float, high: np.ndarray | float) -> np.ndarray:
    """The same of positions ``(..., 2)``, closest between the progresses ``low`` and ``high`` [m], whatever the course.

    For whoever remembers how far the vehicle has come: neither a crossing nor a short cut makes progress.
    """
    position, segments = shaped_array("position", position, "...", 2), _flat(segments)
    pose = np.concatenate([position, np.zeros_like(position[..., :1])], -1)
    window = np.stack(np.broadcast_arrays(as_array("low", low), as_array("high", high), 0.0), -1)
    return _follow(pose, window, segments, _NOTHING_AHEAD, np.empty(7))
