"""One sensor: its measurement, noise, rate, drop-outs, bias and delay."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from estimators.checks import numbers, short_repr
from estimators.engine import compiled
from vessel_gym.checks import check_names, check_numbers, function, instance
from vessel_gym.processes import Process

Known = Mapping[str, np.ndarray]
"""States by name, ``(...)`` each, from the measurements of preceding sensors."""


@dataclass(frozen=True, eq=False)
class Bias:
    """Slowly moving error of a sensor's first channels, which filters estimate as further states.

    Attributes:
        names: Names of the filter's states, one for each of the channels with a bias.
        start: Standard deviations at the start.
        pace: Standard deviations of a random walk's increment in 1 s; 0 for a constant bias.
        scale: An agent that observes standard deviations receives those of the states divided by
            this number.
        time: Correlation time [s] of a stationary first-order Gauss-Markov process, instead of
            ``pace``. Its standard deviation is ``start`` at all times. None: no such process.
        constant: Standard deviations of a constant error besides the moving bias, with states of
            its own, such as the static error of a compass beside its dynamic error; 0 for none.

    Raises:
        ValueError: for negative values, a number of values that differs from the number of names,
            or a ``time`` together with a pace.
    """

    names: tuple[str, ...]
    start: tuple[float, ...]
    pace: tuple[float, ...] = ()
    scale: float = 1.0
    time: float | None = None
    constant: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        check_names("names of a bias", self.names)
        if not self.names:
            raise ValueError("names of a bias must be one or more")
        object.__setattr__(self, "names", tuple(self.names))
        for name in ("start", "pace", "constant"):
            k, values = len(self.names), getattr(self, name)
            values = (0.0,) * k if isinstance(values, tuple) and not values else values
            _check_entries(f"the bias {self.names}", name, values, k, "not_negative")
            object.__setattr__(self, name, tuple(map(float, values)))
        check_numbers(self, positive="scale time?")
        if self.time is not None and any(self.pace):
            raise ValueError(
                f"the bias {self.names} has a correlation time, so it is stationary: give it no"
                " pace"
            )

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states, first biases, then constants if there are any."""
        constants = tuple(f"constant {name}" for name in self.names) if any(self.constant) else ()
        return self.names + constants

    @property
    def gain(self) -> np.ndarray:
        """Matrix ``(channels, states)`` that adds the states to the measurement."""
        k = len(self.names)
        return np.tile(np.eye(k), len(self.states) // k)

    def process(self, dt: float) -> Process:
        """Process of the states over a step of ``dt`` [s]."""
        if self.time is None:
            moving = Process.walk(self.start, self.pace, dt)
        else:
            moving = Process.wandering(self.start, self.time, dt)
        if not any(self.constant):
            return moving
        return Process.joined(moving, Process.walk(self.constant, (0.0,) * len(self.names), dt))


@dataclass(frozen=True, eq=False)
class Sensor:
    """A sensor, whose channels are measured and lost together.

    Attributes:
        name: Name of the sensor.
        channels: Name of each channel's quantity, with the unit.
        reads: Function that returns the measurement without noise ``(..., k)`` from the vehicle's
            state ``(..., n)`` and exogenous input ``(..., f)``, see `vessel_gym.system.Vehicle`. It
            must broadcast.
        sd: Standard deviation of each channel's white noise. If it depends on the measurement, a
            function from measurements without noise ``(..., k)`` to standard deviations ``(...,
            k)``. The world evaluates the function at the true measurement, a filter's R at the
            expected one.
        rate: Measurements a second [Hz], a divisor of the steps a second; None: one in every step.
        dropout: Probability that a measurement is lost.
        outliers: Probability that a measurement is an outlier.
        outlier_scale: Noise of an outlier, relative to ordinary noise.
        bias: Slowly moving error of the first channels, as many as the `Bias` has names.
        range: Least and greatest value of each channel; no measurement arrives beyond them.
        angles: Indices of the channels that are angles [rad].
        scale: Divisor of each channel in a raw observation; None: 1.
        gives: State or component of the exogenous input that each channel measures directly; None
            for a channel that measures neither.
        inverse: Function that computes further states, by name, from the measurements ``(..., k)``
            and from the states that sensors earlier in the list give. None: no further states.
        latency: Time [s] from a measurement to its arrival.
    """

    name: str
    channels: tuple[str, ...]
    reads: Callable[[np.ndarray, np.ndarray], np.ndarray]
    sd: Any
    rate: float | None = None
    dropout: float = 0.0
    outliers: float = 0.0
    outlier_scale: float = 10.0
    bias: Bias | None = None
    range: tuple[tuple[float, float], ...] | None = None
    angles: tuple[int, ...] = ()
    scale: tuple[float, ...] | None = None
    gives: tuple[str | None, ...] | None = None
    inverse: Callable[[np.ndarray, Known], Known] | None = None
    latency: float = 0.0

    def __post_init__(self) -> None:
        instance("name of a sensor", self.name, str)
        title = self.name
        if self.bias is not None:
            instance(f"bias of {title}", self.bias, Bias)
        function(f"inverse of {title}", self.inverse, "(measurements, known)")
        check_names(f"channels of {title}", self.channels)
        if not self.channels:
            raise ValueError(f"channels of {title} must be one or more names")
        self._check_channels(title, len(self.channels))
        check_numbers(title, vars(self), share="dropout outliers", positive="rate?")
        check_numbers(title, vars(self), not_negative="outlier_scale latency")
        if not callable(self.reads):
            raise ValueError(
                f"reads of {title} must be a function of (state, exogenous), got"
                f" {short_repr(self.reads)}"
            )

    def _check_channels(self, title: str, k: int) -> None:
        """Refuse attributes that do not fit k channels.

        Raises:
            ValueError: naming the attribute.
        """
        kinds = {"sd": "not_negative", "scale": "positive", "range": "", "gives": ""}
        for name, kind in kinds.items():
            values = getattr(self, name)
            if not (callable(values) if name == "sd" else values is None):
                _check_entries(title, name, values, k, kind)
        for ends in self.range or ():
            pair = numbers(ends)
            if pair is None or pair.shape != (2,) or not pair[0] < pair[1]:
                each = "(least, greatest) for each channel"
                raise ValueError(f"range of {title} must have {each}, got {short_repr(self.range)}")
        angles = self.angles if isinstance(self.angles, tuple | list) else (None,)
        if any(not isinstance(i, int | np.integer) or not 0 <= i < k for i in angles):
            raise ValueError(
                f"angles of {title} must be indices below {k}, got {short_repr(self.angles)}"
            )
        if self.bias is not None and len(self.bias.names) > k:
            raise ValueError(f"{title} has {k} channels, but a bias on {len(self.bias.names)}")

    def period(self, dt: float) -> int:
        """Steps of ``dt`` [s] from one measurement to the next.

        Raises:
            ValueError: if measurements would fall between steps.
        """
        if self.rate is None:
            return 1
        steps = 1.0 / max(self.rate * dt, 1e-300)
        if not 0.5 <= steps <= SLOWEST or abs(steps - round(steps)) > 1e-6 * steps:
            raise ValueError(
                f"{self.name} reads at {self.rate:g} Hz, which does not divide the {1.0 / dt:g}"
                " steps a second: its measurements would fall between steps"
            )
        return round(steps)

    def delay(self, dt: float) -> int:
        """Latency in steps of ``dt`` [s].

        Raises:
            ValueError: if the latency is not a whole number of steps, or exceeds 1000 steps.
        """
        steps = self.latency / dt
        if abs(steps - np.rint(steps)) > 1e-6 * max(steps, 1.0):
            raise ValueError(
                f"latency of {self.name} is {self.latency:g} s, which is no whole number of steps"
                f" of {dt:g} s: its measurements would arrive between steps"
            )
        if steps > LONGEST:
            raise ValueError(f"latency of {self.name} is {steps:g} steps, of {LONGEST} at most")
        return round(steps)


def _check_entries(title: str, name: str, values: Any, k: int, kind: str) -> None:
    """Check that there are k entries, one for each channel, of one kind of numbers.

    Raises:
        ValueError: naming the attribute.
    """
    several = isinstance(values, tuple | list) or np.ndim(values) > 0
    if not (several and len(values) == k):
        hint = f": write ({values!r},)" if k == 1 and isinstance(values, int | float) else ""
        raise ValueError(f"{name} of {title} must have {k} entries, got {short_repr(values)}{hint}")
    for value in values if kind else ():
        check_numbers(title, {name: value}, **{kind: name})


SLOWEST = 1e9
"""Most steps from one measurement to the next."""
LONGEST = 1000
"""Longest delay of a measurement in steps; filters keep the history of that many steps."""


def in_quality(
    nominal: Sequence[Sensor],
    noise: float = 1.0,
    dropout: float = 0.0,
    outliers: float = 0.0,
    lossless: bool = False,
) -> tuple[Sensor, ...]:
    """Sensors with noise and losses other than nominal ones.

    Args:
        nominal: Sensors of a vehicle.
        noise: Standard deviations relative to nominal.
        dropout: Probability that a sensor's measurement is lost, besides its own.
        outliers: Probability that a measurement is an outlier, besides the sensor's own.
        lossless: Does no sensor lose a measurement?

    Raises:
        ValueError: if a number is out of range.
    """
    given = {"noise": noise, "dropout": dropout, "outliers": outliers}
    check_numbers("in_quality", given, not_negative="noise", share="dropout outliers")
    return tuple(
        replace(
            sensor,
            sd=_scaled(noise, sensor.sd),
            dropout=0.0 if lossless else min(sensor.dropout + dropout, 1.0),
            outliers=min(sensor.outliers + outliers, 1.0),
        )
        for sensor in nominal
    )


def _scaled(factor: float, sd: Any) -> Any:
    if not callable(sd):
        return tuple(factor * each for each in sd)
    return sd if factor == 1.0 else partial(_scaled_at, factor, sd)


def _scaled_at(factor: float, sd: Callable[[np.ndarray], np.ndarray], y: np.ndarray) -> np.ndarray:
    return factor * np.asarray(sd(y))


SUITES: dict[str, dict[str, Any]] = {
    "clean": {"noise": 0.05, "lossless": True},
    "nominal": {},
    "degraded": {"dropout": 0.10, "outliers": 0.05},
}
"""Suites for the sensors of any vehicle and environment: arguments of `in_quality`."""
SUITE_NAMES = (*SUITES, "budget", "denied")
"""Names of all suites of an environment.

``budget`` is a choice of grades (`vessel_gym.sensors.grades`). ``denied`` is the nominal suite
without the position fix for `vessel_gym.sensor_faults.LOSS` seconds.
"""


def plain(components: Sequence[int]) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Make the argument ``reads`` of a `Sensor` that measures these components of the state."""
    return partial(_columns, chosen=tuple(components))


@compiled
def _columns(state: np.ndarray, exogenous: np.ndarray, *, chosen: tuple[int, ...]) -> np.ndarray:
    return state[..., list(chosen)]
