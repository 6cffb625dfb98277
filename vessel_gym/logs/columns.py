"""Column maps: which column of a file is which channel, in which unit."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from estimators.factory import unknown
from vessel_gym.logs.log import CHANNELS, LogError
from vessel_gym.toml_file import TomlFile

_KNOT = 1852.0 / 3600.0
_TURN = 2.0 * np.pi
_UNITS = {
    "m": {"m": 1.0, "km": 1000.0, "ft": 0.3048, "nmi": 1852.0},
    "m/s": {"m/s": 1.0, "kn": _KNOT, "knots": _KNOT, "km/h": 1.0 / 3.6},
    "rad": {"rad": 1.0, "deg": _TURN / 360.0, "°": _TURN / 360.0},
    "rad/s": {"rad/s": 1.0, "deg/s": _TURN / 360.0, "°/s": _TURN / 360.0, "deg/min": _TURN / 21600.0},
    "1/s": {"1/s": 1.0, "rps": 1.0, "Hz": 1.0, "rpm": 1.0 / 60.0, "1/min": 1.0 / 60.0},
    "deg": {"deg": 1.0, "°": 1.0, "rad": 360.0 / _TURN},
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0},
}
"""Factors by unit."""
ISO = "iso"
"""Unit of times as text: 2020-11-12T11:07:23.5Z."""
_TIME = ("t", "time", "timestamp")
_KEYS = ("column", "unit", "sign", "offset")


@dataclass(frozen=True)
class Column:
    """A column of a file.

    Attributes:
        channel: "time", or one of `CHANNELS`.
        header: The column's name in the file.
        factor: Of the channel's unit; NaN for times as text.
        offset: Added after the factor.
    """

    channel: str
    header: str
    factor: float
    offset: float = 0.0


@dataclass(frozen=True)
class Columns:
    """A column map; without one, columns are recognised by their names.

    Attributes:
        chosen: Tables of the map by channel: column, unit, sign, offset.
        source: Name of the file that it comes from.
    """

    chosen: dict[str, dict[str, object]]
    source: str = "the column map"

    def completed(self, defaults: Mapping[str, str]) -> "Columns":
        """The map with these columns for channels that it does not name, or names without a column."""
        given = {channel: {"column": column} | self.chosen.get(channel, {}) for channel, column in defaults.items()}
        return Columns({**self.chosen, **given}, self.source)

    def of(self, header: Sequence[str], name: str) -> list[Column]:
        """Columns of a file with this header, the time first.

        Raises:
            LogError: if the time or every channel is missing, a named column does not exist, or a unit is unknown.
        """
        names = [each.strip() for each in header]
        plain = {_plain(each): each for each in reversed(names)}
        found = []
        for channel in ("time", *CHANNELS):
            table = self.chosen.get(channel)
            if table is None:
                title = next(
                    (plain[each] for each in (_TIME if channel == "time" else (channel,)) if each in plain), None
                )
                if title is None or (self.chosen and channel != "time"):
                    continue
                table = {"column": title}
            title = str(table.get("column", channel))
            if title not in names:
                if _plain(title) not in plain:
                    raise LogError(f"{name}, line 1: there is no column {title!r} for the {channel}; {_listed(names)}")
                title = plain[_plain(title)]
            found.append(self._column(channel, title, table, name))
        if not found or found[0].channel != "time":
            raise LogError(f"{name}, line 1: no column is the time; name it in a column map; {_listed(names)}")
        if len(found) == 1:
            known = ", ".join(CHANNELS)
            raise LogError(
                f"{name}, line 1: no column is a known channel; write a column map of some of {known}; {_listed(names)}"
            )
        return found

    def _column(self, channel: str, title: str, table: dict[str, object], name: str) -> Column:
        units = _UNITS["s" if channel == "time" else CHANNELS[channel]]
        inside = re.search(r"[\[(]([^\])]*)[\])]\s*$", title)
        named = inside is not None and not inside[1].isdigit()  # xyz[2] is an index
        unit = str(table.get("unit", inside[1].strip() if inside and named else next(iter(units))))
        if channel == "time" and unit.lower() == ISO:
            return Column(channel, title, float("nan"))
        if unit not in units:
            raise LogError(f"{name}: {unknown(f'unit of {channel}', unit, units)}")
        sign, offset = (float(str(table.get(key, default))) for key, default in (("sign", 1), ("offset", 0)))
        return Column(channel, title, sign * units[unit], offset * units[unit])


def read_columns(path: Path) -> Columns:
    """A column map of a TOML file.

    It has a table for the time and for each channel: its column and, if it needs them, unit, sign (1 or -1) and offset
    (in that unit). A text instead of a table is the column.

    Raises:
        ValueError: for anything wrong in the file, in one sentence with its line.
        OSError: if it cannot be read.
    """
    file = TomlFile(path)
    for channel, table in file.data.items():
        if channel != "time" and channel not in CHANNELS:
            raise file.fault((channel,), unknown("channel", channel, ("time", *CHANNELS)))
        if isinstance(table, str):
            file.data[channel] = table = {"column": table}
        if not isinstance(table, dict):
            raise file.fault((channel,), f"{channel} must be a column's name, or a table with one")
        for key, value in table.items():
            if key not in _KEYS:
                raise file.fault((channel, key), unknown(f"key of {channel}", key, _KEYS))
            if key == "sign" and value not in (1, -1):
                raise file.fault((channel, key), f"sign must be 1 or -1, got {value!r}")
            if key == "offset" and not isinstance(value, int | float):
                raise file.fault((channel, key), f"offset must be a number, got {value!r}")
            if key in ("column", "unit") and not isinstance(value, str):
                raise file.fault((channel, key), f"{key} must be a text, got {value!r}")
    return Columns(file.data, str(path))


def _plain(title: str) -> str:
    """A column's name without its unit, in small letters, words apart."""
    return re.sub(r"[\s_]+", " ", re.sub(r"[\[(].*$", "", title)).strip().lower()


def _listed(names: Sequence[str]) -> str:
    first = ", ".join(repr(each[:40]) for each in names[:12])
    return f"the columns are {first}{' ...' if len(names) > 12 else ''}"
