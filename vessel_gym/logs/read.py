"""Logs from files and pipes: CSV with any of three separators, NMEA 0183, Parquet, ULog."""

import csv
import math
from array import array
from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime
from itertools import chain
from pathlib import Path
from typing import TextIO

import numpy as np

from vessel_gym.logs.columns import Column, Columns
from vessel_gym.logs.log import Channel, Log, LogError
from vessel_gym.logs.nmea import is_comment, is_nmea
from vessel_gym.logs.nmea import rows as sentence_rows
from vessel_gym.logs.ulog import read as read_ulog

MOST_ROWS = 4_000_000
"""A longer log does not fit in memory everywhere: 40 hours at 25 measurements a second."""
_MOST_REMARKS = 1000
_LONGEST_LINE = 1_000_000
_COMMENTS = 1000
_MISSING = ("", "nan", "na", "n/a", "null", "none", "-")
_LARGEST = 1e15


def read(path: Path, columns: Columns | None = None) -> Log:
    """Read a log.

    A field without a number is NaN. A row with text where a number belongs, or with too few fields, is kept as far as
    it can be read and is named in the log's remarks, and so is a damaged sentence.

    Args:
        path: CSV (separated by commas, semicolons or tabs; the first line names the columns), NMEA 0183 (``.nmea``, or
            a sentence in the first line that is no comment), ``.parquet``, or ``.ulg``.
        columns: The column map; columns are recognised by their names without one.

    Raises:
        LogError: if the file is no log, in one sentence with its line.
        OSError: if it cannot be read.
    """
    path = Path(path)
    columns = columns or Columns({})
    if path.suffix.lower() in (".parquet", ".pq"):
        return _log(path.name, _parquet(path, columns), [])
    if path.suffix.lower() == ".ulg":
        return Log(path.name, _projected(_enough(path.name, read_ulog(path, columns))))
    remarks: list[tuple[int, str]] = []
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
        lines = _lines(file, path.name)
        lines, sentences = _recognised(lines)
        sentences = sentences or path.suffix.lower() == ".nmea"
        found = _table(rows(lines, columns, path.name, remarks, sentences), path.name)
    return _log_of_sentences(path.name, found, remarks) if sentences else _log(path.name, found, remarks)


def _lines(file: TextIO, name: str) -> Iterator[str]:
    """Lines of a file; what has none would fill the memory.

    Raises:
        LogError: if a line is too long for any log.
    """
    number = 0
    while line := file.readline(_LONGEST_LINE):
        number += 1
        if len(line) == _LONGEST_LINE:
            raise LogError(f"{name}, line {number}: longer than {_LONGEST_LINE:,} characters; no log has such lines")
        yield line


def _recognised(lines: Iterable[str]) -> tuple[Iterator[str], bool]:
    """The lines, and whether they are NMEA 0183: the first one that is no comment has a sentence."""
    lines, opening = iter(lines), []
    for line in lines:
        opening.append(line)
        if not is_comment(line) or len(opening) == _COMMENTS:
            break
    return chain(opening, lines), bool(opening) and is_nmea(opening[-1])


def _table(parsed: Iterator, name: str) -> tuple[list[Column], np.ndarray]:
    """Columns of `rows`, and a table ``(N, 1 + columns)`` of line and numbers."""
    taken, values = next(parsed), array("d")
    for count, (line, row) in enumerate(parsed, 1):
        if count > MOST_ROWS:
            raise LogError(f"{name}, line {line}: more than {MOST_ROWS:,} rows; thin the log, or cut it in parts")
        values.append(line)
        values.extend(row)
    return taken, np.frombuffer(values).reshape(-1, 1 + len(taken))  # a copy would double the memory


def rows(
    lines: Iterable[str],
    columns: Columns,
    name: str = "the log",
    remarks: list[tuple[int, str]] | None = None,
    sentences: bool | None = None,
) -> Iterator:
    """Parse lines one by one, as they come from a file or a pipe.

    Args:
        lines: Of a CSV log, its header first, or NMEA 0183.
        columns: The column map.
        name: Of the log, for errors.
        remarks: Damaged rows are added to it: line and sentence.
        sentences: True for NMEA 0183; the first line that is no comment decides if not given.

    Yields:
        First the columns (`Column`), the time first; then for each row its line and its numbers in the channels' units.

    Raises:
        LogError: if the header is missing or names no channel.
    """
    if sentences is None:
        lines, sentences = _recognised(lines)
    if sentences:
        yield from sentence_rows(lines, columns, name, lambda *what: _remark(remarks, *what))
        return
    lines = iter(lines)
    first = next(lines, "")
    if not first.strip() or "\0" in first:
        raise LogError(f"{name}, line 1: a log begins with a line that names its columns")
    separator = max(",;\t", key=first.count)
    header = _fields(first, separator)
    taken = columns.of(header, name)
    titles = [each.strip() for each in header]
    places = [titles.index(each.header) for each in taken]
    yield taken
    for line, text in enumerate(lines, 2):
        try:
            row = _fields(text, separator)
        except csv.Error as error:
            _remark(remarks, line, f"the row cannot be read: {error}")
            continue
        if row:
            yield line, _numbers(row, taken, places, line, remarks)


def _fields(line: str, separator: str) -> list[str]:
    """Fields of one line: a quote that nothing ends does not swallow those below it."""
    return next(csv.reader([line], delimiter=separator), [])


def _numbers(
    row: list[str], taken: list[Column], places: list[int], line: int, remarks: list[tuple[int, str]] | None
) -> list[float]:
    """Numbers of a row."""
    numbers = []
    for column, place in zip(taken, places, strict=True):
        value = math.nan
        if place >= len(row):
            _remark(remarks, line, f"the row has {len(row)} fields, {column.header!r} is field {place + 1}")
        else:
            text = row[place].strip()
            try:
                value = _time(text) if math.isnan(column.factor) else float(text) * column.factor + column.offset
            except ValueError:
                if text.lower() not in _MISSING:
                    _remark(remarks, line, f"{column.header!r} is {text[:40]!r}, which is no number")
        numbers.append(value if abs(value) < _LARGEST else math.nan)
    return numbers


def _time(text: str) -> float:
    return datetime.fromisoformat(text).timestamp()


def _remark(remarks: list[tuple[int, str]] | None, line: int, sentence: str) -> None:
    if remarks is not None and len(remarks) < _MOST_REMARKS:
        remarks.append((line, sentence))


def _parquet(path: Path, columns: Columns) -> tuple[list[Column], np.ndarray]:
    """Columns and table of a Parquet file; its rows count from 1, below a header as in a CSV file."""
    from vessel_gym.extras import require

    require("pyarrow")
    import pyarrow.parquet as parquet

    try:
        file = parquet.ParquetFile(path)
        taken = columns.of(file.schema_arrow.names, path.name)
        if file.metadata.num_rows > MOST_ROWS:
            raise LogError(f"{path.name}: more than {MOST_ROWS:,} rows; thin the log, or cut it in parts")
        table = file.read([each.header for each in taken])
        numbers = [
            np.asarray(table[each.header].cast("double").to_numpy(), float) * each.factor + each.offset
            for each in taken
        ]
    except (OSError, ValueError) as error:
        if isinstance(error, LogError | FileNotFoundError):
            raise
        raise LogError(f"{path.name}: not a Parquet file that can be read: {str(error).splitlines()[0]}") from None
    return taken, np.stack([np.arange(2.0, table.num_rows + 2.0), *numbers], -1)


def _log(name: str, found: tuple[list[Column], np.ndarray], remarks: list[tuple[int, str]]) -> Log:
    """The log of a table whose first two columns are line and time."""
    taken, table = found
    times, lines = table[:, 1], table[:, 0].astype(int)
    channels = {
        column.channel: Channel(column.channel, times, table[:, 2 + i], lines) for i, column in enumerate(taken[1:])
    }
    return Log(name, _projected(_enough(name, channels, remarks)), tuple(remarks))


def _log_of_sentences(name: str, found: tuple[list[Column], np.ndarray], remarks: list[tuple[int, str]]) -> Log:
    """The log of sentences: each channel has the rows that carry it."""
    taken, table = found
    channels = {}
    for i, column in enumerate(taken[1:]):
        lines, times, values = table[np.isfinite(table[:, 2 + i])][:, [0, 1, 2 + i]].T
        if len(lines):
            channels[column.channel] = Channel(column.channel, _spread(times), values, lines.astype(int))
    return Log(name, _projected(_enough(name, channels, remarks)), tuple(remarks))


def _spread(times: np.ndarray) -> np.ndarray:
    """Times of one kind of sentence: the k-th of n that have the time of one fix is k/n on the way to the next."""
    first = np.flatnonzero(np.concatenate([[True], np.diff(times) != 0.0]))
    count = np.diff(np.append(first, len(times)))
    step = np.diff(times[first], append=np.nan)
    usual = np.nanmedian(step) if len(step) > 1 else 0.0
    step = np.where((step > 0.0) & (step < 2.0 * usual), step, usual)  # not over gaps
    part = np.arange(len(times)) - np.repeat(first, count)
    return times + part / np.repeat(count, count) * np.repeat(step, count)


def _enough(name: str, channels: dict[str, Channel], remarks: Sequence[tuple[int, str]] = ()) -> dict[str, Channel]:
    """The channels.

    Raises:
        LogError: if fewer than two of their rows have a time.
    """
    if max((np.isfinite(each.times).sum() for each in channels.values()), default=0) < 2:
        few = "fewer than two rows have a time"
        raise LogError(f"{name}: {few}; line {remarks[0][0]}: {remarks[0][1]}" if remarks else f"{name}, line 2: {few}")
    return {key: each for key, each in channels.items() if np.isfinite(each.times).any()}


def tangent_plane(latitude: float, longitude: float) -> tuple[float, float]:
    """Metres north in a degree of latitude and east in one of longitude, on the tangent plane (WGS 84) of a place."""
    a, squared = 6378137.0, 6.69437999014e-3
    sine = math.sin(math.radians(latitude))
    flat = 1.0 - squared * sine**2
    north, east = a * (1.0 - squared) / flat**1.5, a * math.cos(math.radians(latitude)) / math.sqrt(flat)
    return math.radians(north), math.radians(east)


def turned(longitude: np.ndarray, origin: float) -> np.ndarray:
    """Degrees of longitude east of the origin, between -180 and 180."""
    return (longitude - origin + 180.0) % 360.0 - 180.0


def _projected(channels: dict[str, Channel]) -> dict[str, Channel]:
    """Channels with x and y in place of latitude and longitude, on the tangent plane of the first fix."""
    if "latitude" not in channels or "longitude" not in channels:
        return channels
    latitude, longitude = channels["latitude"], channels["longitude"]
    if len(latitude.values) != len(longitude.values):  # topics of their own
        return channels
    fixed = np.flatnonzero(np.isfinite(latitude.values) & np.isfinite(longitude.values))
    if len(fixed) == 0:
        return channels
    origin = latitude.values[fixed[0]], longitude.values[fixed[0]]
    north, east = tangent_plane(*origin)
    plane = {"x": north * (latitude.values - origin[0]), "y": east * turned(longitude.values, origin[1])}
    kept = {name: channel for name, channel in channels.items() if name not in ("latitude", "longitude")}
    return kept | {name: Channel(name, latitude.times, values, latitude.lines) for name, values in plane.items()}
