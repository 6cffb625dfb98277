"""Estimates from a pipe: a filter's step as soon as the measurements of a time step are complete."""

from collections import deque
from collections.abc import Iterable, Iterator

import numpy as np

from estimators.angles import wrap
from estimators.models import Gaussian
from vessel_gym.identification.filtering import SENSORS, Gated, inputs, noise_of, prior, unknown_speed
from vessel_gym.identification.trial import ROUNDING, SLOW, fine
from vessel_gym.logs import Columns, LogError, rows
from vessel_gym.logs.log import ANGLES
from vessel_gym.logs.read import tangent_plane, turned
from vessel_gym.vehicles.measured_ship import MeasuredShip

_WIND = ("wind speed", "wind direction")
_CONTROL = ("rudder", "revolutions")
_NEEDED = (*SENSORS, *_CONTROL)
_PLANE = ("x", "y")
_HELD = ("x", "y", "heading")
_LONGEST_START, _RECENT = 60.0, 1000


def estimates(
    lines: Iterable[str], columns: Columns, ship: MeasuredShip, name: str, dt: float = 1.0
) -> Iterator[tuple[float, np.ndarray, np.ndarray]]:
    """Time, mean ``(15,)`` and covariance ``(15, 15)`` after each step, from the first in which every sensor answered.

    Args:
        lines: Of a CSV log, its header first, or of NMEA 0183.
        columns: The column map.
        ship: The vessel, with its noise.
        name: Of the filter.
        dt: Time step [s].

    Raises:
        LogError: if a sensor, the rudder or the revolutions have no column, or do not come within a minute.
        ValueError: if the vessel file has no noise.
    """
    noise = noise_of(ship)
    gated, fresh, plane = Gated(name, ship, dt), {each: _Fresh(each in ANGLES) for each in _HELD}, _Plane()
    parsed = rows(lines, columns, "the pipe")
    channels = [column.channel for column in next(parsed)]
    missing = [each for each in _NEEDED if each not in (*channels, *(_PLANE if "latitude" in channels else ()))]
    if missing:
        raise LogError(f"the pipe, line 1: no column is the {missing[0]}, which estimation needs")
    edge, slow, began = None, None, None
    latest: dict[str, float] = {}
    start, known = None, np.empty((0, 6))
    for line, numbers in parsed:
        row = plane(dict(zip(channels, numbers, strict=True)))
        time = row.pop("time")
        if not np.isfinite(time) or (edge is not None and time < edge - dt):
            continue  # time stood still or ran back
        edge, began = (time + dt, time) if edge is None or began is None else (edge, began)
        if start is None and time > began + _LONGEST_START and (never := [e for e in _NEEDED if e not in latest]):
            raise LogError(f"the pipe, line {line}: no {never[0]} has come for {_LONGEST_START:.0f} s")
        while time >= edge:
            if start is not None or all(each in latest for each in _NEEDED):
                y = np.array([latest.pop(each, np.nan) for each in SENSORS])
                u, slow = _known(latest, slow, dt)
                start = _start(ship, y, noise) if start is None else start
                known = np.concatenate([known[-2:], u[None]])
                belief = gated.step(start, y, inputs(ship, known, noise)[-1]).updated
                yield edge, np.asarray(belief.mean), np.asarray(belief.cov)
            edge += dt
        latest |= {
            each: value
            for each, value in row.items()
            if np.isfinite(value) and (each not in fresh or fresh[each](value))
        }


def _start(ship: MeasuredShip, y: np.ndarray, noise: np.ndarray) -> Gaussian:
    """Belief before the first measurement ``(4,)``: speeds are unknown, up to Froude numbers of ships."""
    start = prior(np.array([y[0], y[1], y[2], 0.0, 0.0, y[3]]), noise)
    cov = start.cov.copy()
    cov[3, 3] = cov[4, 4] = unknown_speed(ship.length)
    return Gaussian(start.mean, cov)


def _known(latest: dict[str, float], slow: np.ndarray | None, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Known input ``(6,)`` of the latest row, and the slow wind ``(2,)``."""
    wind = np.zeros(2)
    if all(each in latest for each in _WIND):
        wind = latest["wind speed"] * np.array([np.cos(latest["wind direction"]), np.sin(latest["wind direction"])])
    slow = wind if slow is None else slow + min(1.0, dt / SLOW) * (wind - slow)
    return np.array([*(latest[each] for each in _CONTROL), *wind, *slow]), slow


class _Plane:
    """Rows with x and y of latitude and longitude, from the first fix."""

    def __init__(self) -> None:
        self._origin: tuple[float, float] | None = None

    def __call__(self, row: dict[str, float]) -> dict[str, float]:
        latitude, longitude = row.get("latitude", np.nan), row.get("longitude", np.nan)
        if not np.isfinite(latitude + longitude):
            return row
        self._origin = self._origin or (latitude, longitude)
        north, east = tangent_plane(*self._origin)
        y = float(east * turned(np.asarray(longitude), self._origin[1]))
        return row | {"x": north * (latitude - self._origin[0]), "y": y}


class _Fresh:
    """False for a value that the instrument held, by its recent changes (`without_repeats`)."""

    def __init__(self, angle: bool) -> None:
        self._angle, self._last, self._change = angle, np.nan, np.nan
        self._bends: deque[float] = deque(maxlen=_RECENT)

    def __call__(self, value: float) -> bool:
        change, before = value - self._last, self._change
        bend, self._last, self._change = change - before, value, change
        bend = abs(float(wrap(bend)) if self._angle else bend)
        if bend > ROUNDING * abs(value):
            self._bends.append(bend)
        return change != 0.0 or not fine(np.array(self._bends))
