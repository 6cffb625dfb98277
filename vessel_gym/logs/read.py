"""Logs from files and pipes: CSV with any of three separators, Parquet."""

import csv
import math
from array import array
from collections.abc import Iterable, Iterator
from datetime import datetime
from itertools import chain
from pathlib import Path

import numpy as np

from vessel_gym.logs.columns import Column, Columns
from vessel_gym.logs.log import Channel, Log, LogError

MOST_ROWS = 4_000_000
"""A longer log does not fit in memory everywhere: 40 hours at 25 measurements a second."""
_MOST_REMARKS = 1000
_MISSING = ("", "nan", "na", "n/a", "null", "none", "-")
_LARGEST = 1e15


def read(path: Path, columns: Columns | None = None) -> Log:
    """Read a log.

    A field without a number is NaN. A row with text where a number belongs, or with too few fields, is kept as far as
    it can be read and is named in the log's remarks.

    Args:
        path: CSV (separated by commas, semicolons or tabs; the first line names the columns), or ``.parquet``.
        columns: The column map; columns are recognised by their names without one.

    Raises:
        LogError: if the file is no log, in one sentence with its line.
        OSError: if it cannot be read.
    """
    path = Path(path)
    columns = columns or Columns({})
    if path.suffix.lower() in (".parquet", ".pq"):
        return _log(path.name, _parquet(path, columns), [])
    remarks: list[tuple[int, str]] = []
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
        parsed = rows(file, columns, path.name, remarks)
        taken, values = next(parsed), array("d")
        count = 0
        for line, row in parsed:
            count += 1
            if count > MOST_ROWS:
                raise LogError(
                    f"{path.name}, line {line}: more than {MOST_ROWS:,} rows; thin the log, or cut it in parts"
                )
            values.append(line)
            values.extend(row)
    table = np.frombuffer(values, float).reshape(-1, 1 + len(taken)) if count else np.empty((0, 1 + len(taken)))
    return _log(path.name, (taken, table), remarks)


def rows(
    lines: Iterable[str], columns: Columns, name: str = "the log", remarks: list[tuple[int, str]] | None = None
) -> Iterator:
    """Parse lines one by one, as they come from a file or a pipe.

    Args:
        lines: Of a CSV log, its header first.
        columns: The column map.
        name: Of the log, for errors.
        remarks: Damaged rows are added to it: line and sentence.

    Yields:
        First the columns (`Column`), the time first; then for each row its line and its numbers in the channels' units.

    Raises:
        LogError: if the header is missing or names no channel.
    """
    lines = iter(lines)
    first = next(lines, "")
    if not first.strip() or "\0" in first:
        raise LogError(f"{name}, line 1: a log begins with a line that names its columns")
    separator = max(",;\t", key=first.count)
    parsed = csv.reader(chain([first], lines), delimiter=separator)
    header = next(parsed)
    taken = columns.of(header, name)
    titles = [each.strip() for each in header]
    places = [titles.index(each.header) for each in taken]
    yield taken
    while True:
        line = parsed.line_num + 1
        try:
            row = next(parsed)
        except StopIteration:
            return
        except csv.Error as error:
            _remark(remarks, line, f"the row cannot be read: {error}")
            continue
        if row:
            yield line, _numbers(row, taken, places, line, remarks)


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
    if np.isfinite(times).sum() < 2:
        raise LogError(f"{name}, line 2: fewer than two rows have a time")
    channels = {
        column.channel: Channel(column.channel, times, table[:, 2 + i], lines) for i, column in enumerate(taken[1:])
    }
    return Log(name, _projected(channels), tuple(remarks))


def _projected(channels: dict[str, Channel]) -> dict[str, Channel]:
    """Channels with x and y in place of latitude and longitude, on the tangent plane (WGS 84) of the first fix."""
    if "latitude" not in channels or "longitude" not in channels:
        return channels
    latitude, longitude = channels["latitude"], channels["longitude"]
    fixed = np.flatnonzero(np.isfinite(latitude.values) & np.isfinite(longitude.values))
    if len(fixed) == 0:
        return channels
    origin = np.deg2rad([latitude.values[fixed[0]], longitude.values[fixed[0]]])
    a, squared = 6378137.0, 6.69437999014e-3
    flat = 1.0 - squared * np.sin(origin[0]) ** 2
    north, east = a * (1.0 - squared) / flat**1.5, a * np.cos(origin[0]) / np.sqrt(flat)
    turned = (np.deg2rad(longitude.values) - origin[1] + np.pi) % (2.0 * np.pi) - np.pi
    plane = {"x": north * (np.deg2rad(latitude.values) - origin[0]), "y": east * turned}
    kept = {name: channel for name, channel in channels.items() if name not in ("latitude", "longitude")}
    return kept | {name: Channel(name, latitude.times, values, latitude.lines) for name, values in plane.items()}
