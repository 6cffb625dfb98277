"""PX4's ULog: fields of its topics as channels, each with times of its own, read by pyulog."""

import io
from collections.abc import Iterator
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from vessel_gym.logs.columns import Columns
from vessel_gym.logs.log import Channel, LogError

_TIME = "timestamp [us]"
_DEFAULTS = {
    "x": "vehicle_local_position.x",
    "y": "vehicle_local_position.y",
    "heading": "vehicle_local_position.heading",
    "yaw rate": "vehicle_angular_velocity.xyz[2]",
}
"""Fields in SI units that every PX4 log has."""


def read(path: Path, columns: Columns) -> dict[str, Channel]:
    """Channels of a ULog file.

    A column is a topic and its field, ``actuator_servos.control[0]``; those of `_DEFAULTS` need no map. Lines are rows
    of the topic, counted from 1.

    Args:
        path: The file.
        columns: Column map.

    Raises:
        LogError: if the file is damaged, or has none of the columns.
        OSError: if it cannot be read.
    """
    from vessel_gym.extras import require

    require("pyulog")
    with path.open("rb") as file:
        begins = file.read(4)
    if begins != b"ULog":
        raise LogError(f"{path.name}: not a ULog file that can be read: it does not begin as one")
    chosen = columns.completed(_DEFAULTS)
    topics = _topics(path, {str(table.get("column", "")).partition(".")[0] for table in chosen.chosen.values()})
    fields = dict(_fields(topics))
    known = {
        name: table for name, table in chosen.chosen.items() if name in columns.chosen or str(table["column"]) in fields
    }
    channels = {}
    for column in Columns(known, chosen.source).of([_TIME, *fields], path.name)[1:]:
        times, values = fields[column.header]
        values = values * column.factor + column.offset
        channels[column.channel] = Channel(column.channel, 1e-6 * times, values, np.arange(1, len(times) + 1))
    return channels


def _topics(path: Path, names: set[str]) -> list[Any]:
    from pyulog import ULog

    try:
        with path.open("rb") as file, redirect_stdout(io.StringIO()):  # it prints what it thinks of the file
            return ULog(file, sorted(names)).data_list
    except Exception as error:  # whatever a damaged file makes of its parser; it was opened above
        raise LogError(f"{path.name}: not a ULog file that can be read: {type(error).__name__} in pyulog") from None


def _fields(topics: list[Any]) -> Iterator[tuple[str, tuple[np.ndarray, np.ndarray]]]:
    """Times [us] and values of the fields of each topic's first instance."""
    for topic in topics:
        if topic.multi_id == 0 and "timestamp" in topic.data:
            times = np.asarray(topic.data["timestamp"], float)
            for name, values in topic.data.items():
                yield f"{topic.name}.{name}", (times, np.asarray(values, float))
