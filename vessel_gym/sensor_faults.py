"""Faults of sensors, scheduled: what goes wrong between a sensor and whoever reads it.

The kinds are those of PX4's failure injection, its "wrong" in three: a bias, a drift (of several
channels of a fix: spoofing) and a scale. Faults of actuators are another matter:
`vessel_gym.disturbances.Fault`.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from estimators.checks import numbers, short_repr
from vessel_gym.checks import check_numbers, instance, one_of

KINDS = {
    "off": "",
    "stuck": "",
    "bias": "what is added",
    "drift": "what a second adds",
    "scale": "the factor",
    "garbage": "the standard deviation of the noise that is read instead",
}
"""What may be wrong with a sensor, and what the size of that is."""


@dataclass(frozen=True)
class SensorFault:
    """A fault of a sensor, for a time.

    Attributes:
        sensor: Its name.
        kind: ``"off"``, nothing arrives; ``"stuck"``, always the last measurement from before, or
            the first where there was none; ``"bias"``, ``"drift"``, ``"scale"`` or ``"garbage"``.
        size: Of these four, in the units of the channels: what is added, what a second adds, the
            factor, the standard deviation of the noise that is read instead. One for all channels,
            or one for each.
        begin: Seconds after an episode's start; a pair: drawn in each episode, uniformly between
            the two.
        end: Seconds after an episode's start at which it is over, or a pair as for ``begin``;
            infinity: never.
        duration: Seconds from the drawn beginning to the end, in place of ``end``; None: as ``end``
            says.

    Raises:
        ValueError: for a kind that there is not, a size that it does not have, times that make no
            sense, or a duration beside an end.
    """

    sensor: str
    kind: str
    size: float | tuple[float, ...] | None = None
    begin: float | tuple[float, float] = 0.0
    end: float | tuple[float, float] = np.inf
    duration: float | None = None

    def __post_init__(self) -> None:
        instance("sensor of a fault", self.sensor, str)
        one_of("kind of sensor fault", self.kind, KINDS)
        size, meant = None if isinstance(self.size, bool) else numbers(self.size), KINDS[self.kind]
        if not meant and self.size is not None:
            raise ValueError(f"{self} has no size, got {short_repr(self.size)}")
        if meant and (size is None or size.ndim > 1 or not np.isfinite(size).all()):
            raise ValueError(f"size of {self} must be {meant}, one for all channels or one for each, "
                             f"got {short_repr(self.size)}")  # fmt: skip
        if self.kind == "garbage" and np.any(np.less(size, 0.0)):  # type: ignore[arg-type]
            raise ValueError(f"size of {self} must be 0 or more, got {short_repr(self.size)}")
        (_, begin), (end, _) = self.times("begin"), self.times("end")
        check_numbers(str(self), {"duration": self.duration}, positive="duration?")
        if self.duration is not None and end < np.inf:
            raise ValueError(f"{self} has a duration, which fixes its end: leave one of them out")
        if not begin < end:
            raise ValueError(
                f"{self} must begin before it ends, got begin {short_repr(self.begin)} and end"
                f" {short_repr(self.end)}"
            )

    def __str__(self) -> str:
        return f"the fault {self.kind!r} of {self.sensor}"

    def times(self, name: str) -> tuple[float, float]:
        """Between which seconds it begins, or ends.

        Raises:
            ValueError: if it is no number of at least 0, nor a pair of them in order.
        """
        time = getattr(self, name)
        given = None if isinstance(time, bool) else numbers(time)
        pair = (
            np.resize(given, 2)
            if given is not None and given.shape in ((), (2,))
            else np.full(2, np.nan)
        )
        ordered = 0.0 <= pair[0] <= pair[1] and (
            np.isfinite(pair).all() or (name == "end" and pair[0] == np.inf)
        )
        if not ordered:
            raise ValueError(f"{name} of {self} must be 0 s or more, or two such times in order, "
                             f"got {short_repr(time)}")  # fmt: skip
        return float(pair[0]), float(pair[1])


LOSS = 120.0
"""Seconds for which ``sensors="denied"`` takes away the fix."""


def lost_fix(sensors: Iterable[str], seconds: float) -> tuple[SensorFault, ...]:
    """Loss of the fix for `LOSS` seconds, within an episode that lasts longer than that.

    The loss begins at a time drawn uniformly: in an episode of up to ``seconds`` > `LOSS`, such
    that it is over by then; in a shorter one, whose mission takes about half of its time limit, in
    the first half, and it lasts to the end.

    Args:
        sensors: Names of the sensors that are the fix.
        seconds: Longest duration of an episode.
    """
    latest = seconds - LOSS if seconds > LOSS else 0.5 * seconds
    return tuple(SensorFault(name, "off", begin=(0.0, latest), duration=LOSS) for name in sensors)
