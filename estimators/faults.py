"""Detection and isolation of sensor faults from the innovations of a filter.

::

    monitor = CusumMonitor({"gnss": (0, 1), "log": 2}, false_alarms=1e-4)
    state = monitor.start(batch)
    state = monitor.watch(state, belief)  # after every update
    state.alarm, state.accused  # (...) True or False; the number of the sensor in monitor.names, -1: none

As long as model and filter are right, innovations are independent of each other and as large as S
says. A fault in the direction ``f`` shows best in ``f' S^-1 e``, its matched filter. So a sensor is
judged by ``w = S^-1 e``, each channel in units of its own standard deviation there: a measurement
that is odd only beside another, with which it is correlated, speaks against the odd one the most
(Basseville & Nikiforov, 1993, Detection of Abrupt Changes, ch. 7).

Thresholds follow from the rate of false alarms that is stated, not from data. A measurement that is
missing counts for nothing, and nor does one that the filter could take in by a pseudo-inverse
alone.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Self

import numpy as np
from scipy.special import gammainccinv, ndtr, ndtri

from estimators.belief import Belief
from estimators.checks import integer, number, short_repr
from estimators.delayed import DelayedBelief
from estimators.linalg import identity, masked, solve

Sensors = int | Mapping[str, int | Sequence[int]]
"""How many channels there are, each a sensor by itself; or by name those of each sensor."""


_ABSURD = 1e100
"""Standard deviations of an innovation beyond which it counts as so many: their squares can be summed up."""


@dataclass(frozen=True, slots=True, eq=False)
class Watch:
    """The state of a monitor and its verdict; leading axes are a batch.

    Attributes:
        alarm: ``(...)`` whether the last measurement raised an alarm.
        accused: ``(...)`` number of the sensor that is accused, -1 where there is no alarm.
        statistic: ``(...)`` what is tested, in units of its threshold: an alarm is above 1.
        suspicion: ``(..., sensors)`` what speaks against each sensor; the accused has the most.
        memory: ``(..., k, j)`` what the next step needs.
    """

    alarm: np.ndarray
    accused: np.ndarray
    statistic: np.ndarray
    suspicion: np.ndarray
    memory: np.ndarray

    def __getitem__(self, rows: Any) -> Self:
        """That of some rows of the batch: a mask, an index or a slice over leading axes."""
        return type(self)(**{name: getattr(self, name)[rows] for name in self.__dataclass_fields__})

    def with_rows(self, rows: np.ndarray, other: "Watch") -> Self:
        """This one with the rows of a mask ``(...)`` replaced, in order, by those of ``other``.

        Raises:
            ValueError: if the two are of different monitors.
        """
        self.check_same_monitor(other)
        merged = {name: np.array(getattr(self, name)) for name in self.__dataclass_fields__}
        for name, array in merged.items():
            array[rows] = getattr(other, name)
        return type(self)(**merged)

    def check_same_monitor(self, other: "Watch") -> None:
        """Refuse a state of another monitor, which remembers something else or of other sensors."""
        mine, theirs = (
            (state.memory.shape[-2:], state.suspicion.shape[-1]) for state in (self, other)
        )
        if mine != theirs:
            raise ValueError(
                f"the state is of another monitor: it remembers {theirs[0]} of {theirs[1]} sensors,"
                f" this one {mine[0]} of {mine[1]}"
            )


class FaultMonitor(ABC):
    """Base of monitors: the sensors, and the innovations of a filter that are judged.

    Args:
        sensors: How many channels a measurement has, each a sensor by itself; or names with the
            channels of each.
        false_alarms: How many of the steps of one row raise an alarm though nothing is wrong.

    Raises:
        ValueError: if a channel is in no sensor or in several, or the rate is none.
    """

    def __init__(self, sensors: Sensors, false_alarms: float) -> None:
        self.names, groups = _grouped(sensors)
        self.false_alarms = number(
            "false_alarms",
            false_alarms,
            1e-9,
            0.5,
            "a rate of false alarms a step, between 1e-9 and 0.5",
        )
        owner = np.empty(sum(map(len, groups)), int)
        for sensor, channels in enumerate(groups):
            owner[channels] = sensor
        self._belongs = 1.0 * (owner[:, None] == np.arange(len(groups)))  # (p, sensors)
        self._together = owner[:, None] == owner  # (p, p)

    def start(self, batch: int | tuple[int, ...] = ()) -> Watch:
        """Nothing seen yet, for each row of a batch.

        Raises:
            ValueError: if the batch is no whole number from 0, or several.
        """
        batch = tuple(
            integer("batch", rows, 0) for rows in (batch if isinstance(batch, tuple) else (batch,))
        )
        nothing = np.zeros(batch)
        suspicion, memory = (
            np.zeros(nothing.shape + own) for own in ((len(self.names),), self._remembered)
        )
        return Watch(nothing > 0.0, np.full(batch, -1), nothing, suspicion, memory)

    def watch(self, state: Watch, belief: Belief | DelayedBelief[Any]) -> Watch:
        """The state after the innovation of an update.

        Args:
            state: The state before.
            belief: The belief after the update.

        Raises:
            ValueError: if the belief has seen no measurement, or its filter gives no covariance of
                innovations; if it is of another batch or other channels than the monitor; or if the
                state is of another monitor.
            TypeError: if its innovations carry an unknown input, whose law nobody knows.
        """
        e, S, arrived = self._innovation(belief)
        self.start().check_same_monitor(state)
        if e.shape[:-1] != state.alarm.shape:
            raise ValueError(
                f"the monitor watches rows {state.alarm.shape}, the belief has rows {e.shape[:-1]}"
            )
        return self._watched(state, e, S, arrived)

    def run(self, beliefs: Belief) -> Watch:
        """A whole series: beliefs after every update, stacked, times first ``(T, ...)``; likewise the result.

        Raises:
            ValueError: as `watch`; or if there are no times.
            TypeError: as `watch`.
        """
        e, S, arrived = self._innovation(beliefs)
        if e.ndim < 2 or not len(e):
            raise ValueError(
                f"beliefs must be stacked, times first, got innovations of shape {e.shape}"
            )
        states, state = [], self.start(e.shape[1:-1])
        for now in zip(e, S, arrived, strict=True):
            state = self._watched(state, *now)
            states.append(state)
        return Watch(
            **{
                name: np.stack([getattr(s, name) for s in states])
                for name in Watch.__dataclass_fields__
            }
        )

    def _innovation(
        self, belief: Belief | DelayedBelief[Any]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Innovation, its covariance, and the mask of what counts."""
        e, S, arrived = belief.innovation, belief.innovation_cov, belief.available
        if e is None or S is None or arrived is None:
            raise ValueError(
                "the belief has no innovation with its covariance: watch it after an update, of a"
                " filter that gives both (Belief.updated does)"
            )
        if getattr(belief, "input_observed", None) is not None:
            raise TypeError(
                "the innovations of this filter carry its unknown input, so that they say nothing"
                " of faults: watch a filter that is told of the input as noise"
            )
        if e.shape[-1] != len(self._belongs):
            raise ValueError(
                f"the monitor's sensors have {len(self._belongs)} channels, the measurements"
                f" {e.shape[-1]}"
            )
        return e, S, arrived & belief.healthy[..., None]

    def _watched(self, state: Watch, e: np.ndarray, S: np.ndarray, arrived: np.ndarray) -> Watch:
        with np.errstate(all="ignore"):
            precision = solve(masked(S, arrived), identity(e.shape[-1]))
            most = _ABSURD * np.sqrt(np.diagonal(S, axis1=-2, axis2=-1))
            e = np.clip(e, -most, most)
            w = np.where(arrived, np.matvec(precision, e), 0.0)
            memory, statistic, suspicion = self._judged(
                state, w, precision, arrived, np.vecdot(e, w)
            )
        alarm = statistic > 1.0
        return Watch(alarm, np.where(alarm, suspicion.argmax(-1), -1), statistic, suspicion, memory)

    _remembered: tuple[int, int]

    @abstractmethod
    def _judged(
        self,
        state: Watch,
        w: np.ndarray,
        precision: np.ndarray,
        arrived: np.ndarray,
        squared: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The next memory, the statistic ``(...)`` and the suspicion of each sensor ``(..., sensors)``.

        From w, the innovation times S^-1 ``(..., p)``, S^-1 itself, which channels count, and the
        innovation squared in units of S.
        """


class ChiSquareMonitor(FaultMonitor):
    """Chi-square test of the innovations of the last steps: for faults of any kind, as bias, drift or more noise.

    The normalised innovation squared, summed over a window, is chi-square with as many degrees of
    freedom as measurements arrived in it, and the threshold its quantile. What speaks against a
    sensor is the share of the sum that would not be there without it, as a standard normal deviate.

    Source: Mehra & Peschon (1971), An innovations approach to fault detection and diagnosis in
    dynamic systems; Bar-Shalom, Li & Kirubarajan (2001), sec. 5.4.

    Args:
        sensors: See `FaultMonitor`.
        false_alarms: Share of the steps in alarm though nothing is wrong; an alarm lasts for some
            steps, as the window does.
        window: How many steps count; the fewer, the sooner a great fault is seen, the more, the
            smaller a lasting one.

    Raises:
        ValueError: see `FaultMonitor`, or if the window is no whole number above 0.
    """

    def __init__(self, sensors: Sensors, false_alarms: float = 1e-3, window: int = 10) -> None:
        super().__init__(sensors, false_alarms)
        self.window = integer("window", window, 1)
        degrees = np.arange(1, window * len(self._belongs) + 1)
        self._thresholds = np.append(np.inf, 2.0 * gammainccinv(0.5 * degrees, self.false_alarms))
        self._remembered = window, 2 * (len(self.names) + 1)

    def _judged(
        self,
        state: Watch,
        w: np.ndarray,
        precision: np.ndarray,
        arrived: np.ndarray,
        squared: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        own = solve(np.where(self._together, precision, 0.0), w[..., None])[..., 0] * w
        now = [
            squared[..., None],
            own @ self._belongs,
            arrived.sum(-1, keepdims=True),
            arrived @ self._belongs,
        ]
        memory = np.concatenate(
            [state.memory[..., 1:, :], np.concatenate(now, -1)[..., None, :]], -2
        )
        values, degrees = np.split(memory.sum(-2), 2, -1)
        deviate = np.where(degrees > 0.0, normal_deviate(values, np.maximum(degrees, 1.0)), -np.inf)
        return (
            memory,
            values[..., 0] / self._thresholds[degrees[..., 0].astype(int)],
            deviate[..., 1:],
        )


def normal_deviate(values: np.ndarray, degrees: np.ndarray) -> np.ndarray:
    """The standard normal number that is as rare as a chi-square one ``(...)``, to some hundredths; far out its root.

    The signed root of the deviance with Barndorff-Nielsen's (1986) correction; near the mean, where
    that is 0 by 0, Wilson & Hilferty's (1931).
    """
    excess = values - degrees
    root = np.sqrt(np.maximum(excess - degrees * np.log(np.maximum(values, 1e-300) / degrees), 0.0))
    near, spread = root < 0.1, 2.0 / (9.0 * degrees)
    root = np.where(near, 1.0, np.copysign(root, excess))
    usual = (np.cbrt(values / degrees) + spread - 1.0) / np.sqrt(spread)
    score = np.where(near, 1.0, excess / np.sqrt(2.0 * degrees))
    return np.where(near, usual, root + np.log(score / root) / root)


class CusumMonitor(FaultMonitor):
    """CUSUM test of the mean of each channel: finds a lasting bias sooner than any test over a window.

    For each channel, ``z = w / sqrt(diag S^-1)`` is standard normal, and two sums are kept,
    ``g+ = max(0, g+ + z - k)`` and ``g- = max(0, g- - z - k)``, k half the shift. One that passes
    the threshold raises the alarm, and all sums of the row begin again. The threshold makes the
    mean time between false alarms of all channels together no shorter than stated: rates of
    channels add, but for what they have in common.

    Source: Page (1954), Continuous inspection schemes; Basseville & Nikiforov (1993), sec. 2.2 and
    ch. 5.

    Args:
        sensors: See `FaultMonitor`.
        false_alarms: Alarms a step though nothing is wrong, one over the mean time between them.
        shift: Size of the bias to find soonest, in standard deviations of what a channel tells
            beside the others.

    Raises:
        ValueError: see `FaultMonitor`, or if the shift is not positive or so large that no sums are
            needed.
    """

    def __init__(self, sensors: Sensors, false_alarms: float = 1e-3, shift: float = 1.0) -> None:
        super().__init__(sensors, false_alarms)
        self.shift = number(
            "shift", shift, low=0.05, what="a number of standard deviations above 0.05"
        )
        one = self.false_alarms / (2 * len(self._belongs))
        largest = -2.0 * float(ndtri(one))
        if self.shift >= largest:
            raise ValueError(
                f"shift must be below {largest:.3g}, got {shift}: one measurement tells so much,"
                " and a ChiSquareMonitor with a window of 1 will do"
            )
        self.threshold = _threshold(0.5 * self.shift, 1.0 / one)
        self._remembered = 2, len(self._belongs)

    def _judged(
        self,
        state: Watch,
        w: np.ndarray,
        precision: np.ndarray,
        arrived: np.ndarray,
        squared: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        z = w / np.sqrt(np.diagonal(precision, axis1=-2, axis2=-1))
        before = np.where(state.alarm[..., None, None], 0.0, state.memory)
        change = np.stack([z, -z], -2) - 0.5 * self.shift
        sums = np.where(arrived[..., None, :], np.maximum(before + change, 0.0), before)
        channels = sums.max(-2) / self.threshold
        suspicion = np.where(self._belongs > 0.0, channels[..., None], 0.0).max(-2)
        return sums, suspicion.max(-1), suspicion


def cusum_run_length(threshold: float, drift: float, mean: float = 0.0) -> float:
    """Mean number of steps until a one-sided CUSUM of unit normal numbers passes its threshold, from 0.

    ``L(s) = 1 + L(0) F(k - s) + integral over x in (0, h) of L(x) f(x + k - s)``, s the sum, F and
    f the normal distribution and density, solved on the nodes of Gauss and Legendre: a sharper form
    of the Markov chain of Brook & Evans (1972). Two sides, or independent channels, have the
    reciprocal of the sum of reciprocals.

    Source: Page (1954); Brook & Evans (1972), An approach to the probability distribution of cusum
    run length.

    Args:
        threshold: h.
        drift: k, what is taken off each number.
        mean: Of the numbers: 0 for the time between false alarms, a bias for the delay of its
            detection.
    """
    nodes, weights = np.polynomial.legendre.leggauss(32 + 4 * int(threshold))
    x, weights = 0.5 * threshold * (nodes + 1.0), 0.5 * threshold * weights
    from_s = np.append(0.0, x)  # where the sum is; it goes to 0 at once, or to a node
    k = drift - mean
    moves = np.exp(-0.5 * (x + k - from_s[:, None]) ** 2) * weights / np.sqrt(2.0 * np.pi)
    moves = np.column_stack([ndtr(k - from_s), moves])
    return float(np.linalg.solve(np.eye(len(from_s)) - moves, np.ones(len(from_s)))[0])


@lru_cache
def _threshold(drift: float, run_length: float) -> float:
    """The threshold whose run length is this."""
    from scipy.optimize import brentq  # late: it takes longer to import than the whole package

    high = step = (
        0.5 / drift
    )  # which makes a long run e times as long, and a matrix is not yet singular
    while cusum_run_length(high, drift) < run_length:
        high += step
    return float(
        brentq(lambda h: np.log(cusum_run_length(h, drift) / run_length), 0.0, high, xtol=1e-10)
    )


def _grouped(sensors: Sensors) -> tuple[tuple[str, ...], list[list[int]]]:
    """Names of sensors, and the channels of each."""
    if not isinstance(sensors, Mapping):
        p = integer("sensors", sensors, 1)
        return tuple(str(j) for j in range(p)), [[j] for j in range(p)]
    groups = [np.atleast_1d(np.asarray(channels)).tolist() for channels in sensors.values()]
    channels = [j for group in groups for j in group]
    if (
        not channels
        or sorted(map(repr, channels)) != sorted(map(repr, range(len(channels))))
        or not all(groups)
    ):
        raise ValueError(
            "sensors must have every channel, from 0, in exactly one of them, such as {'gnss':"
            f" (0, 1), 'log': 2}}, got {short_repr(sensors)}"
        )
    return tuple(sensors), groups
