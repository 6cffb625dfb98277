"""Routes of a ship: straight legs between waypoints, joined by arcs of one radius that touch both legs.

Waypoints are rows (north, east) in metres; `read_waypoints` takes them from a TOML or CSV file.
"""

import csv
from itertools import combinations
from pathlib import Path as File

import numpy as np

from estimators.angles import wrap
from estimators.checks import numbers, short_repr
from vessel_gym.guidance.words import Path, chain
from vessel_gym.toml_file import TomlFile

WAYPOINTS = 8
"""Waypoints of a route at most."""
SEGMENTS = 2 * WAYPOINTS - 3
"""Straights and arcs of a route at most."""
SHARPEST = np.deg2rad(120.0)
"""Greatest change of course at a waypoint [rad]."""
LONGEST = 1e5
"""m: a route beyond is a slip in the unit."""


def route(waypoints: object, radius: float, clearance: float = 0.0) -> tuple[np.ndarray, Path]:
    """Waypoints ``(k, 2)`` relative to the first one, north and east [m], and the path along them.

    Args:
        waypoints: Rows (north, east) [m], 2 to `WAYPOINTS`.
        radius: Radius of the arcs [m].
        clearance: Least distance [m] between legs that do not follow each other.

    Raises:
        ValueError: for what is no such list, a change of course above `SHARPEST`, a leg too short for its arcs, a route
            longer than `LONGEST`, or legs within the clearance of each other.
    """
    points = numbers(waypoints)
    if points is None or points.ndim != 2 or points.shape[1] != 2:
        raise ValueError(f"waypoints must be rows (north, east), metres, got {short_repr(waypoints)}")
    if not 2 <= len(points) <= WAYPOINTS:
        raise ValueError(f"waypoints must be 2 to {WAYPOINTS}, got {len(points)}")
    if not np.isfinite(points).all():
        raise ValueError(f"waypoints must be finite, got {short_repr(waypoints)}")
    with np.errstate(over="ignore"):
        points = points - points[0]
        legs = np.diff(points, axis=0)
        length = np.hypot(*legs.T)
    if not length.sum() <= LONGEST:
        raise ValueError(f"the legs of a route must be {LONGEST:.0f} m together at most, got {length.sum():.4g} m")
    if not length.all():
        first = 1 + int(length.argmin())
        raise ValueError(f"waypoints {first} and {first + 1} are the same place")
    course = np.arctan2(legs[:, 1], legs[:, 0])
    turn = wrap(np.diff(course))
    if (np.abs(turn) > SHARPEST).any():
        at = int(np.abs(turn).argmax())
        raise ValueError(
            f"the course changes by {np.rad2deg(abs(turn[at])):.0f} degrees at waypoint {at + 2}, more than "
            f"{np.rad2deg(SHARPEST):.0f}"
        )
    tangent = np.pad(radius * np.tan(0.5 * np.abs(turn)), 1)
    straight = length - tangent[:-1] - tangent[1:]
    if (straight < 0.0).any():
        at = int(straight.argmin())
        raise ValueError(
            f"leg {at + 1} of the route is {length[at]:.0f} m long and needs {length[at] - straight[at]:.0f} m for its "
            f"arcs of {radius:.0f} m radius"
        )
    for i, j in combinations(range(len(legs)), 2):
        apart = np.inf if j == i + 1 else _apart(points[i], points[i + 1], points[j], points[j + 1])
        if apart <= clearance:
            raise ValueError(
                f"legs {i + 1} and {j + 1} of the route come within {apart:.0f} m of each other, nearer than "
                f"{clearance:.0f} m"
            )
    lengths = np.zeros(2 * len(legs) - 1)
    lengths[::2], lengths[1::2] = straight, radius * np.abs(turn)
    curvatures = np.zeros(len(lengths))
    curvatures[1::2] = np.sign(turn) / radius
    return points, chain(np.array([0.0, 0.0, course[0]]), curvatures, lengths)


def _apart(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> float:
    """Least distance [m] between the legs from a to b and from c to d; 0 where they cross."""

    def side(p: np.ndarray, q: np.ndarray, r: np.ndarray) -> float:
        return float((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]))

    def to_leg(p: np.ndarray, q: np.ndarray, r: np.ndarray) -> float:
        share = np.clip((p - q) @ (r - q) / ((r - q) @ (r - q)), 0.0, 1.0)
        return float(np.hypot(*(q + share * (r - q) - p)))

    if side(a, b, c) * side(a, b, d) < 0.0 and side(c, d, a) * side(c, d, b) < 0.0:
        return 0.0
    return min(to_leg(a, c, d), to_leg(b, c, d), to_leg(c, a, b), to_leg(d, a, b))


# --- files ------------------------------------------------------------------------------------------

_KINDS = {"waypoints": ("north", "east"), "positions": ("latitude", "longitude")}
"""Keys of a TOML file, and the columns of a CSV file that hold the same."""
_AXIS, _SQUARED = 6378137.0, 6.69437999014e-3
"""Semi-major axis [m] and squared eccentricity of the WGS 84 ellipsoid."""
_POLAR = 85.0  # degrees of latitude, beyond which a plane map is none


def read_waypoints(file: str | File) -> np.ndarray:
    """Waypoints ``(k, 2)``, north and east [m], from a file.

    A TOML file has ``waypoints = [[north, east], ...]`` [m] or ``positions = [[latitude, longitude], ...]`` [degrees];
    a CSV file has a header with the columns ``north,east`` or ``latitude,longitude``. Positions are projected about the
    middle latitude of the route and counted from the first one.

    Raises:
        ValueError: for another file, or anything wrong in it, in one sentence with its line.
        OSError: if the file cannot be read.
    """
    path = File(file)
    readers = {".toml": _of_toml, ".csv": _of_csv}
    if path.suffix.lower() not in readers:
        raise ValueError(f"a file of waypoints must end in {' or '.join(readers)}, got {short_repr(str(file))}")
    kind, rows = readers[path.suffix.lower()](path)
    if kind == "waypoints" or not len(rows):
        return rows
    if (np.abs(rows) > [_POLAR, 360.0]).any():
        raise ValueError(
            f"{path}: latitudes must lie within {_POLAR:g} degrees and longitudes within 360, got {short_repr(rows)}"
        )
    return _projected(np.deg2rad(rows))


def _of_toml(path: File) -> tuple[str, np.ndarray]:
    """Kind of a TOML file, and its rows ``(k, 2)``."""
    file = TomlFile(path)
    kinds = [kind for kind in _KINDS if kind in file.data]
    if len(kinds) != 1 or len(file.data) != 1:
        raise file.fault((), f"a file of waypoints must have one key, {' or '.join(_KINDS)}")
    rows = numbers(file.data[kinds[0]])
    if rows is None or rows.ndim != 2 or rows.shape[1] != 2 or not np.isfinite(rows).all():
        wanted = " and ".join(_KINDS[kinds[0]])
        raise file.fault((kinds[0],), f"{kinds[0]} must be rows of two finite numbers, {wanted}")
    return kinds[0], rows


def _of_csv(path: File) -> tuple[str, np.ndarray]:
    """Kind of a CSV file, and its rows ``(k, 2)``."""
    line = 1
    try:
        with path.open(encoding="utf-8-sig", newline="") as text:
            table = csv.reader(text, strict=True)
            header = [name.strip().lower() for name in next(table, [])]
            kinds = [kind for kind, columns in _KINDS.items() if set(columns) <= set(header)]
            if len(kinds) != 1:
                wanted = " or ".join(",".join(columns) for columns in _KINDS.values())
                raise ValueError(f"the header must have the columns {wanted}, got {short_repr(','.join(header))}")
            columns, rows = [(name, header.index(name)) for name in _KINDS[kinds[0]]], []
            for row in table:
                line = table.line_num
                if any(each.strip() for each in row):
                    rows.append([_number(name, row[i] if i < len(row) else "") for name, i in columns])
    except UnicodeDecodeError:
        raise ValueError(f"{path}, line {line}: the file is not text in UTF-8") from None
    except (ValueError, csv.Error) as error:
        raise ValueError(f"{path}, line {line}: {error}") from None
    return kinds[0], np.array(rows, float).reshape(-1, 2)


def _number(name: str, text: str) -> float:
    """A finite number of a CSV file."""
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise ValueError(f"{name} must be a finite number, got {short_repr(text)}")
    return value


def _projected(positions: np.ndarray) -> np.ndarray:
    """North and east [m] of latitudes and longitudes ``(k, 2)`` [rad], in the radii of curvature of the ellipsoid."""
    latitude = 0.5 * (positions[:, 0].min() + positions[:, 0].max())
    shape = 1.0 - _SQUARED * np.sin(latitude) ** 2
    meridian, parallel = _AXIS * (1.0 - _SQUARED) / shape**1.5, _AXIS * np.cos(latitude) / np.sqrt(shape)
    away = wrap(positions - positions[0])
    return away * [meridian, parallel]
