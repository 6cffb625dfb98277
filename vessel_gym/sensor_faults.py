"""Scheduled faults of sensors, which change measurements before delivery.

The kinds are those of PX4's failure injection; its "wrong" is divided into bias, drift (spoofing,
if a whole fix drifts) and scale. For faults of actuators see `vessel_gym.disturbances.Fault`.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from estimators.checks import as_number, numbers, short_repr
from vessel_gym.checks import instance, one_of

KINDS = {
    "off": "",
    "stuck": "",
    "bias": "what is added",
    "drift": "what a second adds",
    "scale": "the factor",
    "garbage": "the standard deviation of the noise that is read instead",
}
"""Kinds of sensor faults, and the meaning of their sizes."""


@dataclass(frozen=True)
class SensorFault:
    """A fault of a sensor, for a time.

    Attributes:
        sensor: Name of the sensor.
        kind: ``"off"``: nothing arrives. ``"stuck"``: every measurement during the fault
            repeats the last one before it or, without one, the first one during it. ``"bias"``,
            ``"drift"``, ``"scale"`` and ``"garbage"`` have a ``size``.
        size: For ``"bias"`` the addition, for ``"drift"`` the addition per second, for ``"scale"``
            the factor, for ``"garbage"`` the standard deviation of noise that replaces the
            measurement. One number in the units of the channels, or one for each channel.
        begin: Time after an episode's start [s]; a pair: drawn uniformly between both in each
            episode.
        duration: Time [s] from the beginning to the end of the fault; infinity: it never ends.

    Raises:
        ValueError: for an unknown kind, an invalid size for the kind, or invalid times.
    """

    sensor: str
    kind: str
    size: float | tuple[float, ...] | None = None
    begin: float | tuple[float, float] = 0.0
    duration: float = np.inf

    def __post_init__(self) -> None:
        instance("sensor of a fault", self.sensor, str)
        one_of("kind of sensor fault", self.kind, KINDS)
        size, meant = None if isinstance(self.size, bool) else numbers(self.size), KINDS[self.kind]
        if not meant and self.size is not None:
            raise ValueError(f"{self} has no size, got {short_repr(self.size)}")
        if meant and (size is None or size.ndim > 1 or not np.isfinite(size).all()):
            raise ValueError(
                f"size of {self} must be {meant}, one for all channels or one for each, got"
                f" {short_repr(self.size)}"
            )
        if self.kind == "garbage" and np.any(np.less(size, 0.0)):  # type: ignore[arg-type]
            raise ValueError(f"size of {self} must be 0 or more, got {short_repr(self.size)}")
        earliest, latest = self.begins
        if not 0.0 <= earliest <= latest < np.inf:
            raise ValueError(
                f"begin of {self} must be 0 s or more, or two such times in order, got"
                f" {short_repr(self.begin)}"
            )
        if not as_number(self.duration) > 0.0:
            raise ValueError(
                f"duration of {self} must be a time above 0 s, got {short_repr(self.duration)}"
            )

    def __str__(self) -> str:
        return f"the fault {self.kind!r} of {self.sensor}"

    @property
    def begins(self) -> tuple[float, float]:
        """Earliest and latest time [s] of the beginning; NaN for anything else."""
        begin: Any = self.begin
        pair = begin if isinstance(begin, list | tuple) or np.ndim(begin) else (begin, begin)
        earliest, latest = map(as_number, pair) if len(pair) == 2 else (np.nan, np.nan)
        return earliest, latest


LOSS = 120.0
"""Time [s] for which ``sensors="denied"`` loses the fix."""
