"""A log in memory: channels with times, in SI units and one frame."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import numpy as np

CHANNELS = {
    "x": "m", "y": "m", "heading": "rad", "surge": "m/s", "sway": "m/s", "yaw rate": "rad/s", "rudder": "rad",
    "revolutions": "1/s", "wind speed": "m/s", "wind direction": "rad", "relative wind speed": "m/s",
    "relative wind direction": "rad", "latitude": "deg", "longitude": "deg",
}  # fmt: skip
"""Names of channels and their units. x is north and y east (or any horizontal axes, y clockwise of x); heading and wind
directions count clockwise from x, a relative one from the bow; winds come from there. Positive rudder turns the ship to
starboard. Surge and sway are over ground."""
ANGLES = ("heading", "wind direction", "relative wind direction")


class LogError(ValueError):
    """A log that cannot be used; the text names the file and its line, and says what to do."""


@dataclass(frozen=True, eq=False)
class Channel:
    """One measured quantity.

    Attributes:
        name: One of `CHANNELS`.
        times: ``(N,)`` [s].
        values: ``(N,)`` in the channel's unit; NaN where a row has no number.
        lines: ``(N,)`` line of the file, counted from 1.
    """

    name: str
    times: np.ndarray
    values: np.ndarray
    lines: np.ndarray

    @property
    def unit(self) -> str:
        """Of the values."""
        return CHANNELS[self.name]

    def measured(self) -> tuple[np.ndarray, np.ndarray]:
        """Times ``(M,)`` and values ``(M,)`` of the numbers, without rows whose time does not go on."""
        good = np.isfinite(self.times) & np.isfinite(self.values)
        times, values = self.times[good], self.values[good]
        onward = np.ones(len(times), bool)
        onward[1:] = times[1:] > np.maximum.accumulate(times)[:-1]
        return times[onward], values[onward]


@dataclass(frozen=True, eq=False)
class Log:
    """A measured voyage.

    Attributes:
        name: Of its file.
        channels: By name.
        remarks: Line and sentence of each damaged row.
    """

    name: str
    channels: dict[str, Channel]
    remarks: Sequence[tuple[int, str]] = field(default_factory=tuple)

    def __getitem__(self, name: str) -> Channel:
        if name not in self.channels:
            raise LogError(f"{self.name} has no {name}: it has {', '.join(self.channels)}")
        return self.channels[name]

    def __contains__(self, name: object) -> bool:
        return name in self.channels

    @property
    def span(self) -> tuple[float, float]:
        """First and last time [s]."""
        times = [channel.times[np.isfinite(channel.times)] for channel in self.channels.values()]
        return min(float(each.min()) for each in times), max(float(each.max()) for each in times)

    def sampled(
        self, names: Sequence[str], dt: float, hold: Collection[str] = ()
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The channels on a common grid.

        A measurement belongs to the nearest time of the grid; the last one counts where several do.

        Args:
            names: Channels.
            dt: Step of the grid [s].
            hold: Channels that keep their value until the next one, as inputs do.

        Returns:
            Times ``(T,)``, values ``(T, k)`` and a mask ``(T, k)`` of those that were measured; others are NaN.

        Raises:
            LogError: if a channel is missing.
        """
        first, last = self.span
        times = first + dt * np.arange(round((last - first) / dt) + 1)
        values, available = np.full((len(times), len(names)), np.nan), np.zeros((len(times), len(names)), bool)
        for column, name in enumerate(names):
            at, measured = self[name].measured()
            index = np.clip(np.round((at - first) / dt).astype(int), 0, len(times) - 1)
            values[index, column], available[index, column] = measured, True
            if name in hold and len(at):
                before = np.maximum(np.searchsorted(at, times + 0.5 * dt, side="right") - 1, 0)
                values[:, column] = measured[before]
        return times, values, available
