"""NMEA 0183: sentences of a ship's instruments as rows of channels, parsed by pynmea2.

GGA, RMC and GLL give positions, HDT the heading, ROT the yaw rate, VTG surge and sway, RSA the rudder, RPM the
revolutions of the first shaft, MWD the true and MWV the relative wind. Without HDT the heading is that of HDG, if this
has the variation. Other sentences are passed over.
"""

import math
import re
from collections.abc import Callable, Iterable, Iterator
from datetime import datetime
from typing import Any

from vessel_gym.logs.columns import Column, Columns

HEADER = (
    "time [s]", "latitude [deg]", "longitude [deg]", "heading [deg]", "yaw rate [deg/min]", "surge [kn]", "sway [kn]",
    "rudder [deg]", "revolutions [rpm]", "wind speed [m/s]", "wind direction [deg]", "relative wind speed [m/s]",
    "relative wind direction [deg]",
)  # fmt: skip
"""Columns of the rows, in the units of the sentences."""
_NAMES = tuple(each.partition(" [")[0] for each in HEADER)
_SENTENCE = re.compile(r"\$[A-Z]{2}([A-Z]{3}),")
_OTHER = re.compile(r"[$!][A-Z]{2}[A-Z0-9]+,.*\*[0-9A-F]{2}\s*$")
_DAY = 86400.0
_SPEEDS = {"M": 1.0, "N": 1852.0 / 3600.0, "K": 1.0 / 3.6}
"""Factors to m/s by the letter of the unit."""
_CLOCKS = ("GGA", "RMC", "GLL", "ZDA")

Row = dict[str, float]


def is_nmea(line: str) -> bool:
    """True of a line with an NMEA sentence, if only a manufacturer's or one of other ships."""
    return _SENTENCE.search(line) is not None or _OTHER.search(line) is not None


def is_comment(line: str) -> bool:
    """True of a line that a logger may write above the first sentence: empty, or behind a #."""
    return line.startswith("#") or not line.strip()


def rows(lines: Iterable[str], columns: Columns, name: str, remark: Callable[[int, str], None]) -> Iterator:
    """Parse sentences one by one, as they come from a file or a pipe.

    A time in front of a sentence (seconds or ISO 8601, or the c: of a TAG block) is when it came. Without one, a
    sentence has the time of the last fix; days go on at midnight.

    Args:
        lines: Of the log.
        columns: Column map; what it does not name is as in `HEADER`.
        name: Of the log, for errors.
        remark: Called with line and sentence of what is damaged.

    Yields:
        As `vessel_gym.logs.rows`: first the columns, then lines and numbers, NaN of channels not in that sentence.
    """
    from vessel_gym.extras import require

    require("pynmea2")
    taken = columns.completed(dict(zip(_NAMES[1:], HEADER[1:], strict=True))).of(HEADER, name)
    yield taken
    clock, heading, fixed, kinds = _Clock(), math.nan, math.nan, set[str]()
    for line, text in enumerate(lines, 1):
        match = _SENTENCE.search(text)
        kind = match[1] if match else ""
        if match is None or (kind not in _READ and kind not in _CLOCKS):
            continue
        try:
            sentence = _parse(text[match.start() :])
            clock.hear(text[: match.start()], kind, sentence)
            row = _READ[kind](sentence) if kind in _READ else {}
        except ValueError as error:
            remark(line, f"{kind}: {error}")
            continue
        if math.isnan(clock.time):
            remark(line, f"{kind}: no time has come before it")
            continue
        kinds.add(kind)
        if kind == "HDG" and "HDT" in kinds:
            continue
        heading = row.get("heading", heading)
        if kind == "VTG":
            row = _velocity(row, heading)
        if "latitude" in row:  # one fix may be told by several sentences
            row = {} if clock.time == fixed else row
            fixed = clock.time
        if row:
            yield line, _numbers(row | {"time": clock.time}, taken)


def _parse(text: str) -> Any:
    """The sentence.

    Raises:
        ValueError: if it is damaged.
    """
    import pynmea2

    try:
        return pynmea2.parse(text.strip())
    except pynmea2.ChecksumError:
        raise ValueError("the checksum does not match") from None
    except (pynmea2.ParseError, IndexError, KeyError, TypeError):
        raise ValueError("the sentence cannot be read") from None


def _numbers(row: Row, taken: list[Column]) -> list[float]:
    numbers = []
    for column in taken:
        name = column.header.partition(" [")[0]
        numbers.append(row[name] * column.factor + column.offset if name in row else math.nan)
    return numbers


class _Clock:
    """Time [s] of the sentences, from the first day's midnight or as the logger wrote it in front of them.

    Attributes:
        time: Of the last sentence; NaN before the first.
    """

    def __init__(self) -> None:
        self.time = math.nan
        self._of_day, self._day, self._first = math.nan, 0, 0

    def hear(self, prefix: str, kind: str, sentence: Any) -> None:
        """Take the time of a sentence, if it has one."""
        written = _written_time(prefix)
        if written is not None:
            self.time = written
            return
        at = sentence.timestamp if kind in _CLOCKS else None
        if at is None or isinstance(at, str):
            return
        of_day = 3600.0 * at.hour + 60.0 * at.minute + at.second + 1e-6 * at.microsecond
        if of_day < self._of_day - 0.5 * _DAY:
            self._day += 1
        self._of_day, day = of_day, _date(kind, sentence)
        if day is not None:
            self._first = self._first or day - self._day
            self._day = day - self._first
        self.time = self._day * _DAY + of_day


def _date(kind: str, sentence: Any) -> int | None:
    """Day of a sentence that names one, counted from the year 1."""
    if kind == "RMC" and hasattr(sentence.datestamp, "toordinal"):
        return int(sentence.datestamp.toordinal())
    if kind == "ZDA" and all(isinstance(each, int) for each in (sentence.year, sentence.month, sentence.day)):
        return datetime(sentence.year, sentence.month, sentence.day).toordinal()
    return None


def _written_time(prefix: str) -> float | None:
    """Time [s] in front of a sentence."""
    tag = re.search(r"\\.*\bc:(\d+)", prefix)
    text = tag[1] if tag else prefix.strip(" \t,;")
    if not text:
        return None
    try:
        number = float(text)
    except ValueError:
        try:
            return datetime.fromisoformat(text).timestamp()
        except ValueError:
            return None
    if not math.isfinite(number):
        return None
    return 1e-3 * number if tag and number > 1e11 else number


def _number(value: Any, what: str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise ValueError(f"it has no {what}")
    return number


def _valid(status: Any) -> None:
    if status != "A":
        raise ValueError("the instrument says that it is not valid")


def _position(sentence: Any) -> Row:
    if not (sentence.lat and sentence.lon):
        raise ValueError("it has no position")
    return {
        "latitude": _number(sentence.latitude, "latitude"),
        "longitude": _number(sentence.longitude, "longitude"),
    }


def _gga(sentence: Any) -> Row:
    if not sentence.gps_qual:
        raise ValueError("it has no fix")
    return _position(sentence)


def _rmc(sentence: Any) -> Row:
    _valid(sentence.status)
    return _position(sentence)


def _hdt(sentence: Any) -> Row:
    return {"heading": _number(sentence.heading, "heading")}


def _hdg(sentence: Any) -> Row:
    """True heading of a magnetic compass."""
    heading = _number(sentence.heading, "heading")
    if not sentence.variation:
        raise ValueError("it has no variation, so that its heading is magnetic")
    signs = {"E": 1.0, "W": -1.0}
    parts = ((sentence.deviation, sentence.dev_dir), (sentence.variation, sentence.var_dir))
    return {"heading": (heading + sum(float(each) * signs.get(to, math.nan) for each, to in parts if each)) % 360.0}


def _rot(sentence: Any) -> Row:
    _valid(sentence.status)
    return {"yaw rate": _number(sentence.rate_of_turn, "rate of turn")}


def _rsa(sentence: Any) -> Row:
    _valid(sentence.rsa_starboard_status)
    return {"rudder": _number(sentence.rsa_starboard, "rudder angle")}


def _rpm(sentence: Any) -> Row:
    if sentence.source != "S" or str(sentence.engine_no) not in ("0", "1"):
        return {}
    _valid(sentence.status)
    return {"revolutions": _number(sentence.speed, "revolutions")}


def _mwd(sentence: Any) -> Row:
    return {
        "wind direction": _number(sentence.direction_true, "true wind direction"),
        "wind speed": _number(sentence.wind_speed_meters, "wind speed"),
    }


def _mwv(sentence: Any) -> Row:
    _valid(sentence.status)
    if sentence.reference != "R":
        return {}
    factor = _SPEEDS.get(sentence.wind_speed_units, math.nan)
    return {
        "relative wind direction": _number(sentence.wind_angle, "wind angle"),
        "relative wind speed": _number(factor * _number(sentence.wind_speed, "wind speed"), "unit of the wind speed"),
    }


def _vtg(sentence: Any) -> Row:
    return {
        "course": _number(sentence.true_track, "course"),
        "speed": _number(sentence.spd_over_grnd_kts, "speed in knots"),
    }


def _velocity(row: Row, heading: float) -> Row:
    """Surge and sway of course and speed, by the last heading."""
    if math.isnan(heading):
        return {}
    angle = math.radians(row["course"] - heading)
    return {"surge": row["speed"] * math.cos(angle), "sway": row["speed"] * math.sin(angle)}


_READ: dict[str, Callable[[Any], Row]] = {
    "GGA": _gga, "RMC": _rmc, "GLL": _rmc, "HDT": _hdt, "HDG": _hdg, "ROT": _rot, "RSA": _rsa, "RPM": _rpm, "MWD": _mwd,
    "MWV": _mwv, "VTG": _vtg,
}  # fmt: skip
"""Channels of a sentence by its kind."""
