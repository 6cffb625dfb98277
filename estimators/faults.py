"""Detection and isolation of sensor faults from the innovations of a filter.

::

    monitor = CusumMonitor({"gnss": (0, 1), "log": 2}, false_alarms=1e-4)
    state = monitor.start(batch)
    state = monitor.watch(state, belief)  # after every update
    state.alarm, state.accused  # (...) a mask; the number of the sensor in monitor.names or -1

As long as model and filter are right, innovations are independent of each other and have covariance
S. A fault in the direction ``f`` shows best in ``f' S^-1 e``, its matched filter. So sensors are
tested by ``w = S^-1 e``, each channel in units of its standard deviation. This also finds a
measurement that is unusual only in view of a correlated one (Basseville & Nikiforov, 1993,
Detection of Abrupt Changes, ch. 7).

Thresholds follow from the given rate of false alarms, not from data. Missing measurements do not
count, nor do measurements with a singular innovation covariance.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtrc, chdtri, ndtr, ndtri

from estimators.belief import Belief
from estimators.checks import integer, number, short_repr
from estimators.delayed import DelayedBelief
from estimators.linalg import all_finite, diagonal, identity, lacks_rank, masked, solve

Sensors = int | Mapping[str, int | Sequence[int]]
"""Number of channels, each a sensor by itself; or by name the channels of each sensor."""

_ABSURD = 1e100
"""Standard deviations at which an innovation is cut, so that squares can be summed up."""


class MonitorState(NamedTuple):
    """The state of a monitor and its verdict; leading axes are a batch.

    Attributes:
        alarm: ``(...)`` True where the last measurement raised an alarm.
        accused: ``(...)`` number of the sensor that is accused, -1 where there is no alarm.
        statistic: ``(...)`` test statistic divided by its threshold; above 1 there is an alarm.
        suspicion: ``(..., sensors)`` evidence against each sensor; the accused sensor has the most.
        memory: ``(..., k, j)`` numbers that the next step needs.
    """

    alarm: np.ndarray
    accused: np.ndarray
    statistic: np.ndarray
    suspicion: np.ndarray
    memory: np.ndarray

    def with_rows(self, rows: np.ndarray, other: "MonitorState") -> "MonitorState":
        """A copy in which ``other`` replaces the selected rows, see `Belief.with_rows`."""
        merged = MonitorState(*map(np.array, self))
        for mine, theirs in zip(merged, other, strict=True):
            mine[rows] = theirs
        return merged


class FaultMonitor(ABC):
    """Base of fault monitors, which test a filter's innovations sensor by sensor.

    Args:
        sensors: Number of channels of a measurement, each a sensor by itself; or a dictionary of
            the channels of each sensor by name.
        false_alarms: Share of the steps of one row that raise an alarm though nothing is wrong,
            between 1e-9 and 0.5.

    Raises:
        ValueError: if a channel is in no sensor or in several, or ``false_alarms`` is out of range.
    """

    _remembered: tuple[int, int]
    """Shape of the memory of one row."""

    def __init__(self, sensors: Sensors, false_alarms: float) -> None:
        if not isinstance(sensors, Mapping):
            sensors = {str(j): j for j in range(integer("sensors", sensors, 1))}
        groups = [np.atleast_1d(channels).tolist() for channels in sensors.values()]
        channels = sorted(channel for group in groups for channel in group)
        if channels != list(range(len(channels))) or not groups or not all(groups):
            raise ValueError(
                "sensors must have every channel, from 0, in exactly one of them, such as {'gnss':"
                f" (0, 1), 'log': 2}}, got {short_repr(sensors)}"
            )
        what = "a rate of false alarms a step, between 1e-9 and 0.5"
        self.false_alarms = number("false_alarms", false_alarms, 1e-9, 0.5, what)
        self.names = tuple(sensors)
        self._belongs = np.array([[1.0 * (j in group) for group in groups] for j in channels])

    def start(self, batch: int | tuple[int, ...] = ()) -> MonitorState:
        """The state before any measurement, for each row of a batch."""
        nothing, none = np.zeros(batch), np.full(batch, -1)
        suspicion = np.zeros((*nothing.shape, len(self.names)))
        memory = np.zeros(nothing.shape + self._remembered)
        return MonitorState(nothing > 0.0, none, nothing, suspicion, memory)

    def watch(self, state: MonitorState, belief: Belief | DelayedBelief) -> MonitorState:
        """The state after the innovation of an update.

        A measurement with a singular innovation covariance, for which a filter uses a
        pseudo-inverse, does not count. Of a `Delayed` filter the measurements of the present step
        are tested, not those that come late.

        Args:
            state: The state before.
            belief: The belief after the update.

        Raises:
            TypeError: if the innovations contain an unknown input, whose distribution is unknown.
        """
        if getattr(belief, "input_observed", None) is not None:
            raise TypeError(
                "the innovations of this filter carry its unknown input, so that they say nothing"
                " of faults: watch a filter that assumes the input as noise"
            )
        e, S = belief.innovation, belief.innovation_cov
        counts = all_finite(S) & ~lacks_rank(masked(S, belief.available))
        arrived = belief.available & counts[..., None]
        with np.errstate(all="ignore"):
            precision = solve(masked(S, arrived), identity(e.shape[-1]))
            most = _ABSURD * np.sqrt(diagonal(S))
            e = np.clip(e, -most, most)
            w = np.where(arrived, np.matvec(precision, e), 0.0)
            memory, statistic, suspicion = self._judged(
                state, w, precision, arrived, np.vecdot(e, w)
            )
        alarm = statistic > 1.0
        return MonitorState(
            alarm, np.where(alarm, suspicion.argmax(-1), -1), statistic, suspicion, memory
        )

    def run(self, beliefs: Belief) -> MonitorState:
        """The states after every update, from stacked beliefs with times first ``(T, ...)``.

        Raises:
            TypeError: as `watch`.
        """
        state, states = self.start(beliefs.mean.shape[1:-1]), list[MonitorState]()
        for k in range(len(beliefs.mean)):
            state = self.watch(state, beliefs[k])
            states.append(state)
        return MonitorState(*map(np.stack, zip(*states, strict=True)))

    @abstractmethod
    def _judged(
        self, state: MonitorState, w: Any, precision: Any, arrived: Any, squared: Any
    ) -> tuple[Any, Any, Any]:
        """The next memory, the statistic ``(...)`` and the suspicion of sensors ``(..., sensors)``.

        Args:
            state: The state before.
            w: ``(..., p)`` innovation times S^-1.
            precision: ``(..., p, p)`` S^-1.
            arrived: ``(..., p)`` mask of the channels that count.
            squared: ``(...)`` innovation squared in units of S.
        """


class ChiSquareMonitor(FaultMonitor):
    """Chi-square test of the innovations of the last steps: for bias, drift or more noise.

    The normalised innovation squared, summed over a window, is chi-square with as many degrees of
    freedom as measurements arrived in it, and the threshold its quantile. The evidence against a
    sensor is the part of the sum that would be missing without the sensor, converted to a standard
    normal deviate.

    Source: Mehra & Peschon (1971), An innovations approach to fault detection and diagnosis in
    dynamic systems; Bar-Shalom, Li & Kirubarajan (2001), sec. 5.4.

    Args:
        sensors: See `FaultMonitor`.
        false_alarms: Share of the steps in alarm though nothing is wrong. An alarm can last as long
            as the window.
        window: Number of steps in the sum. A short window shows a large fault sooner; a long one
            shows smaller lasting faults.

    Raises:
        ValueError: see `FaultMonitor`, or if the window is not a whole number above 0.
    """

    def __init__(self, sensors: Sensors, false_alarms: float = 1e-3, window: int = 10) -> None:
        super().__init__(sensors, false_alarms)
        self.window = integer("window", window, 1)
        degrees = np.arange(1, window * len(self._belongs) + 1)
        self._thresholds = np.append(np.inf, chdtri(degrees, self.false_alarms))
        self._remembered = window, 1 + 2 * len(self.names)

    def _judged(
        self, state: MonitorState, w: Any, precision: Any, arrived: Any, squared: Any
    ) -> tuple[Any, Any, Any]:
        together = self._belongs @ self._belongs.T > 0.0  # channels of one sensor
        parts = solve(np.where(together, precision, 0.0), w[..., None])[..., 0] * w
        by_sensor = parts @ self._belongs, arrived @ self._belongs
        now = np.concatenate([squared[..., None], *by_sensor], -1)[..., None, :]
        memory = np.concatenate([state.memory[..., 1:, :], now], -2)
        window = memory.sum(-2)
        values, degrees = np.split(window[..., 1:], 2, -1)
        statistic = window[..., 0] / self._thresholds[degrees.sum(-1).astype(int)]
        return memory, statistic, normal_deviate(values, degrees)


def normal_deviate(values: np.ndarray, degrees: np.ndarray) -> np.ndarray:
    """The standard normal deviate with the same tail probability as a chi-square value ``(...)``.

    Where the probability underflows it is the root of the deviance; without degrees of freedom it
    is minus infinity.
    """
    degrees = np.maximum(degrees, 1e-300)
    tail = chdtrc(degrees, np.maximum(values, 0.0))
    large = np.maximum(values, degrees)
    far = np.sqrt(large - degrees - degrees * np.log(large / degrees))
    return np.where(tail > 1e-300, -ndtri(tail), far)


class CusumMonitor(FaultMonitor):
    """CUSUM test of each channel's mean; detects a lasting bias sooner than `ChiSquareMonitor`.

    With ``w = S^-1 e`` of the innovation e, ``z = w / sqrt(diag S^-1)`` is standard normal in each
    channel. Each channel of each system of the batch has two sums, ``g+ = max(0, g+ + z - k)`` and
    ``g- = max(0, g- - z - k)``, with k half of ``shift``. A sum above the threshold raises the
    alarm, and all sums of the same system begin again at 0. The threshold treats the channels'
    rates of false alarms as if they added up. Channels that raise alarms together make the true
    rate lower, so the mean time between false alarms is never shorter than stated.

    Sources: Page (1954), Continuous inspection schemes; Brook & Evans (1972), An approach to the
    probability distribution of cusum run length, for the threshold; Basseville & Nikiforov (1993),
    Detection of Abrupt Changes, sec. 2.2 and ch. 5.

    Args:
        sensors: See `FaultMonitor`.
        false_alarms: False alarms per step: the reciprocal of the mean number of steps between
            them.
        shift: Size of the bias to find soonest, in standard deviations of a channel given the
            others.

    Raises:
        ValueError: see `FaultMonitor`, or if ``shift`` is below 0.05, or so large that one
            measurement shows it.
    """

    def __init__(self, sensors: Sensors, false_alarms: float = 1e-3, shift: float = 1.0) -> None:
        super().__init__(sensors, false_alarms)
        one = self.false_alarms / (2 * len(self._belongs))
        largest = -2.0 * float(ndtri(one))  # one measurement shows a larger one at once
        what = f"a number of standard deviations between 0.05 and {largest:.3g}"
        self.shift = number("shift", shift, 0.05, largest, what)
        self.threshold = _threshold(0.5 * self.shift, 1.0 / one)
        self._remembered = 2, len(self._belongs)

    def _judged(
        self, state: MonitorState, w: Any, precision: Any, arrived: Any, squared: Any
    ) -> tuple[Any, Any, Any]:
        z = w / np.sqrt(diagonal(precision))
        before = np.where(state.alarm[..., None, None], 0.0, state.memory)
        change = np.stack([z, -z], -2) - 0.5 * self.shift
        sums = np.where(arrived[..., None, :], np.maximum(before + change, 0.0), before)
        channels = sums.max(-2) / self.threshold
        suspicion = np.where(self._belongs > 0.0, channels[..., None], 0.0).max(-2)
        return sums, suspicion.max(-1), suspicion


def cusum_run_length(threshold: float, drift: float, mean: float = 0.0) -> float:
    """Mean number of steps until a one-sided CUSUM of unit normal numbers passes its threshold.

    ``L(s) = 1 + L(0) F(k - s) + integral over x in (0, h) of L(x) f(x + k - s)``, s the sum, F and
    f the normal distribution and density, solved on the nodes of Gauss and Legendre: a sharper form
    of the Markov chain of Brook & Evans (1972). For two sides, or independent channels, take the
    reciprocal of the sum of reciprocals.

    Source: Page (1954); Brook & Evans (1972), An approach to the probability distribution of cusum
    run length.

    Args:
        threshold: h.
        drift: k, subtracted from each number.
        mean: Mean of the numbers: 0 for the time between false alarms, a bias for the delay of its
            detection.
    """
    nodes, weights = np.polynomial.legendre.leggauss(32 + 4 * int(threshold))
    x, weights = 0.5 * threshold * (nodes + 1.0), 0.5 * threshold * weights
    from_s = np.append(0.0, x)  # where the sum is; it goes to 0 at once, or to a node
    k = drift - mean
    moves = np.exp(-0.5 * (x + k - from_s[:, None]) ** 2) * weights / np.sqrt(2.0 * np.pi)
    stays = np.eye(len(from_s)) - np.column_stack([ndtr(k - from_s), moves])
    return float(np.linalg.solve(stays, np.ones(len(from_s)))[0])


def _threshold(drift: float, run_length: float) -> float:
    """The threshold whose run length is this."""
    from scipy.optimize import brentq  # late: it takes longer to import than the whole package

    # A step makes a long run e times as long, and the matrix is not yet singular.
    high = step = 0.5 / drift
    while cusum_run_length(high, drift) < run_length:
        high += step
    excess = lambda h: np.log(cusum_run_length(h, drift) / run_length)  # noqa: E731
    return float(brentq(excess, 0.0, high, xtol=1e-10))
