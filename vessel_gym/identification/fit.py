"""Coefficients of a ship's manoeuvring model from trials: simulation errors of windows, minimised with exact gradients.

Each window is simulated from an initial state of its own, which is estimated with the coefficients and eliminated.
Errors of neighbouring moments and of windows of several lengths are dependent. So the weight of the data against what
is assumed follows from cross-validation: it is the smallest whose error of left-out trials exceeds the least by at most
a standard error of the difference of both. The rule of Hastie, Tibshirani & Friedman (2009, The Elements of Statistical
Learning, sec. 7.10) has the standard error of the least error itself, which trials of unequal difficulty make large.
Differences are paired by trial. Intervals follow from the spread of the gradients between blocks of the logs. They
widen where wind and waves of minutes move the ship.

Source: Ljung (1999), System Identification, sec. 7.4 and 10.2, for the method; Marquardt (1963) for the search.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from vessel_gym.identification.prediction import Windows, simulate, simulate_with_slopes, windows
from vessel_gym.identification.trial import Trial, pace
from vessel_gym.vehicles.manoeuvring import COEFFICIENTS, STATE, Particulars
from vessel_gym.vehicles.measured_ship import MeasuredShip

LENGTHS = (60.0, 120.0, 240.0)
"""Lengths of windows [s] of a ship that sails her length in 15 s; of others in proportion."""
_PACE = 15.0
_N = len(STATE)
_WEIGHTS = (1 / 2000, 1 / 1000, 1 / 500)
"""Of the data, tried in turn. Larger ones fit a ship that keeps no course to her disturbances: errors of left-out
trials do not show it, as initial states are fitted to them, and intervals of hull coefficients then miss."""
_FEWEST = 3
"""Blocks that cross-validation needs: a standard error of two differences has one degree of freedom."""
_STEPS, _RESCALED, _LEAST_GAIN = 25, 6, 0.1


def identify(trials: Sequence[Trial], particulars: Particulars, fixed: Collection[str] = ()) -> MeasuredShip:
    """Identify the coefficients.

    Args:
        trials: At least one, on one grid.
        particulars: What is known of the ship.
        fixed: Coefficients that keep what is assumed of them; those of the wind where no trial has any.

    Raises:
        ValueError: if every trial is shorter than the shortest window, the propeller never turns ahead, or a
            coefficient is unknown.
    """
    unknown = sorted(set(fixed) - set(COEFFICIENTS))
    if unknown:
        raise ValueError(f"{unknown[0]!r} is no coefficient of the model: {', '.join(COEFFICIENTS)}")
    ahead = np.concatenate([trial.control[trial.control[:, 1] > 0.0, 1] for trial in trials])
    if not ahead.size:
        raise ValueError(
            "the propeller never turns ahead in the logs: they tell nothing of thrust, of a rudder in the slipstream "
            "and of revolutions of service"
        )
    problem = _Problem(trials, particulars, fixed)
    c, weight = problem.weighted()
    dispersion, covariance = problem.spread(c, weight)
    return MeasuredShip(
        particulars,
        c,
        covariance,
        degrees_of_freedom=problem.blocks - 1,
        dispersion=dispersion,
        errors=problem.errors(),
        logs=tuple(trial.name for trial in trials),
        revolutions=float(np.median(ahead)),
        rudder_rate=rudder_rate(trials, particulars.length),
    )


def rudder_rate(trials: Sequence[Trial], length: float) -> float:
    """Rate [rad/s] of the steering gear: the fastest 0.5 % of the logs.

    It is at most that of SOLAS II-1/29.3 (65 degrees in 28 s, for a ship of 150 m, others by Froude's scale): a log of
    commanded angles shows jumps.
    """
    fastest = max(float(np.quantile(np.abs(np.diff(trial.control[:, 0])) / trial.dt, 0.995)) for trial in trials)
    return min(fastest, float(np.deg2rad(65.0) / (28.0 * np.sqrt(length / 150.0))))


def within_an_error(errors: np.ndarray) -> int:
    """Index of the first row of ``errors`` whose sum exceeds the least by at most a standard error of the difference.

    Rows whose errors are not finite are left out; the index is 0 if none is left, or if there is one column. Of two
    columns the first row is found that is not worse than the least in both.

    Args:
        errors: ``(weights, trials)`` in ascending order of the weights.
    """
    finite, count = np.isfinite(errors).all(1), errors.shape[1]
    if count < 2 or not finite.any():
        return 0
    known = np.flatnonzero(finite)
    beyond = errors[known] - errors[known[errors[known].sum(1).argmin()]]
    return int(known[np.argmax(beyond.sum(1) <= np.sqrt(count) * beyond.std(1, ddof=1))])


@dataclass
class _Normal:
    """Normal equations after elimination of the initial states: ``A dc = b``, and their parts."""

    A: np.ndarray
    b: np.ndarray
    gradients: np.ndarray  # (blocks, k) of the data alone, unweighted
    information: np.ndarray  # (blocks, k, k) likewise
    steps: list[np.ndarray]  # (B, 6, k + 1) of each set's initial states


def window_lengths(trials: Sequence[Trial], particulars: Particulars) -> list[float]:
    """Lengths [s] of the windows of these trials."""
    unit = pace(particulars, np.concatenate([trial.states[:, 3] for trial in trials]))
    return [max(2, round(length / _PACE * unit / trials[0].dt)) * trials[0].dt for length in LENGTHS]


class _Problem:
    """Least squares of windows, with what is assumed of the coefficients."""

    def __init__(self, trials: Sequence[Trial], particulars: Particulars, fixed: Collection[str]) -> None:
        dt = trials[0].dt
        steps = [round(length / dt) for length in window_lengths(trials, particulars)]
        speed = float(np.sqrt(np.mean(np.concatenate([trial.states[:, 3] for trial in trials]) ** 2)))
        unit = particulars.length / max(speed, 1e-9)
        sets = {n * dt: windows(trials, n, steps[-1]) for n in steps}
        self.sets: dict[float, Windows] = {length: each for length, each in sets.items() if each is not None}
        if not self.sets:
            raise ValueError(f"the logs are shorter than {steps[0] * dt:.3g} s, the shortest window")
        self.p, self.every = particulars.vector(), max(1, steps[0] // 60)
        table = particulars.coefficients
        self.mean, self.sd = np.array([each.mean for each in table]), np.array([each.sd for each in table])
        held = np.array([each in fixed for each in COEFFICIENTS])
        self.precision = 1.0 / np.where(held, 1e-6 * self.sd, self.sd) ** 2
        size = np.array([particulars.length, particulars.length, 1.0, speed, speed, 1.0 / unit])
        self.start_sd = size * (0.01, 0.01, 0.01, 0.075, 0.075, 0.045)
        self.floor = size * (0.0017, 0.0017, 0.002, 0.02, 0.02, 0.012)
        self.initial = [each.states[0].copy() for each in self.sets.values()]
        self.scales: list[np.ndarray] = []
        self.numbers = np.unique(np.concatenate([each.block for each in self.sets.values()]))
        self.blocks = len(self.numbers)
        ends = np.cumsum([1 + len(trial) // steps[-1] for trial in trials])
        trial = np.searchsorted(ends, self.numbers, side="right")
        self.groups = np.unique(trial, return_inverse=True)[1] if trial.min() < trial.max() else np.arange(self.blocks)

    def _residuals(self, initial: list[np.ndarray], c: np.ndarray, slopes: bool) -> list[Any]:
        """Errors ``(T, B, 6)`` of each set, with their derivatives if asked."""
        found: list[Any] = []
        for state, each in zip(initial, self.sets.values(), strict=True):
            arguments = (state, each.control, each.air, c, self.p, each.dt)
            measured = each.states[self.every :: self.every]
            if slopes:
                states, derivatives = simulate_with_slopes(*arguments, self.every)
                found.append((measured - states, derivatives))
            else:
                found.append((measured - simulate(*arguments)[self.every :: self.every],))
        return found

    def rescale(self, c: np.ndarray) -> None:
        """Take the RMS of each set's errors as their scale, single errors above three medians cut."""
        self.scales = []
        for (error,) in self._residuals(self.initial, c, slopes=False):
            square = error**2
            cut = np.minimum(square, 9.0 * np.median(square, axis=(0, 1)))
            self.scales.append(np.maximum(np.sqrt(cut.mean((0, 1))), self.floor))

    def cost(self, initial: list[np.ndarray], c: np.ndarray, weight: float) -> float:
        """Half of the weighted sum of squares."""
        with np.errstate(all="ignore"):  # a step too far may diverge: its cost is infinite
            data = float(self.data_costs(initial, c).sum())
            total = weight * data + 0.5 * float((self.precision * (c - self.mean) ** 2).sum())
        return total if np.isfinite(total) else np.inf

    def data_costs(self, initial: list[np.ndarray], c: np.ndarray) -> np.ndarray:
        """Half of the sum of squares of the data alone, by block."""
        found = np.zeros(self.blocks)
        for (error,), scale, state, each in zip(
            self._residuals(initial, c, slopes=False), self.scales, initial, self.sets.values(), strict=True
        ):
            squares = ((error / scale) ** 2).sum((0, 2)) + (((state - each.states[0]) / self.start_sd) ** 2).sum(-1)
            np.add.at(found, np.searchsorted(self.numbers, each.block), 0.5 * squares)
        return found

    def linearise(self, c: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Information ``(B, 6 + k, 6 + k)`` and gradient ``(B, 6 + k)`` of the windows of each set about ``c``."""
        parts = []
        for (error, slopes), scale, each, state in zip(
            self._residuals(self.initial, c, slopes=True), self.scales, self.sets.values(), self.initial, strict=True
        ):
            rows = error.shape[1]
            J = np.moveaxis(slopes / scale[:, None], 1, 0).reshape(rows, -1, _N + len(c))
            e = np.moveaxis(error / scale, 1, 0).reshape(rows, -1, 1)
            H, g = J.transpose(0, 2, 1) @ J, (J.transpose(0, 2, 1) @ e)[..., 0]
            H[:, :_N, :_N] += np.diag(self.start_sd**-2)
            g[:, :_N] += (each.states[0] - state) / self.start_sd**2
            parts.append((H, g))
        return parts

    def normal(
        self,
        c: np.ndarray,
        parts: list[tuple[np.ndarray, np.ndarray]],
        weight: float,
        damping: float = 0.0,
        sets: Any = None,
    ) -> _Normal:
        """The normal equations of `linearise`, damped, without the initial states."""
        k = len(c)
        information, gradients, steps = np.zeros((self.blocks, k, k)), np.zeros((self.blocks, k)), []
        for (H, g), each in zip(parts, sets or self.sets.values(), strict=True):
            starts = H[:, :_N, :_N] * (1.0 + damping * np.eye(_N))
            step = np.linalg.solve(starts, np.concatenate([H[:, :_N, _N:], g[:, :_N, None]], -1))
            steps.append(step)
            block = np.searchsorted(self.numbers, each.block)
            np.add.at(information, block, H[:, _N:, _N:] - H[:, _N:, :_N] @ step[..., :-1])
            gradient = g[:, _N:] - (H[:, _N:, :_N] @ step[..., -1:])[..., 0]
            np.add.at(gradients, block, gradient)
        A = weight * information.sum(0) + np.diag(self.precision)
        A[np.diag_indices(k)] *= 1.0 + damping
        return _Normal(A, weight * gradients.sum(0) + self.precision * (self.mean - c), gradients, information, steps)

    def weighted(self) -> tuple[np.ndarray, float]:
        """The minimum of the cost, and the weight of the data that cross-validation chooses (`within_an_error`).

        Of fewer than `_FEWEST` blocks it is the smallest weight. Coefficients then stay closest to what is assumed of
        them, and intervals widest. Scales of the errors are those of the first weight.
        """
        c, tried = self.search(self.mean, _WEIGHTS[0], _RESCALED), []
        for weight in _WEIGHTS if self.blocks >= _FEWEST else _WEIGHTS[:1]:
            c = self.search(c, weight)
            tried.append((self.left_out(c, weight), weight, c, self.initial))
        _, weight, c, self.initial = tried[within_an_error(np.array([each[0] for each in tried]))]
        return c, weight

    def left_out(self, c: np.ndarray, weight: float) -> np.ndarray:
        """Half of the sums of squares of each trial (of a single trial, of each block) at the minimum without it.

        To first order of the errors about the minimum ``c`` of all. Initial states are fitted to the windows of the
        trial that is left out, so that its errors are smaller than those of a forecast; this holds for all weights.
        Blocks of a single trial follow each other, and a disturbance across two of them is in both parts. So their
        errors favour the data more than those of trials do.
        """
        now, errors = self.normal(c, self.linearise(c), weight), self.data_costs(self.initial, c)
        found = np.zeros(self.groups.max() + 1)
        for group in range(len(found)):
            own = self.groups == group
            information, gradient = now.information[own].sum(0), now.gradients[own].sum(0)
            change = np.linalg.solve(now.A - weight * information, now.b - weight * gradient)
            found[group] = errors[own].sum() + 0.5 * change @ information @ change - gradient @ change
        return found

    def search(self, c: np.ndarray, weight: float, rescaled: int = 0) -> np.ndarray:
        """The minimum, by Levenberg and Marquardt's method; initial states move along.

        Args:
            c: Coefficients to begin with.
            weight: Of the data.
            rescaled: Steps before which scales of the errors are estimated anew.
        """
        damping = 1e-3
        for count in range(_STEPS):
            if count < rescaled:
                self.rescale(c)
            parts, cost = self.linearise(c), self.cost(self.initial, c, weight)
            while True:
                now = self.normal(c, parts, weight, damping)
                change = np.linalg.solve(now.A, now.b)
                change *= min(1.0, 2.0 / float(np.abs(change / self.sd).max()))  # two assumed deviations at most
                initial = [
                    state + step[..., -1] - step[..., :-1] @ change
                    for state, step in zip(self.initial, now.steps, strict=True)
                ]
                gain = cost - self.cost(initial, c + change, weight)
                if gain > 0.0:
                    break
                damping *= 10.0
                if damping > 1e6:
                    return c
            c, self.initial, damping = c + change, initial, max(0.2 * damping, 1e-6)
            if count >= rescaled and gain < _LEAST_GAIN:
                break
        return c

    def spread(self, c: np.ndarray, weight: float) -> tuple[float, np.ndarray]:
        """Dispersion of the data, at least 1, and the covariance ``(k, k)`` of the estimates.

        Blocks are independent. The gradient of each is that at the estimate without it (the jackknife, CR3 of Bell &
        McCaffrey 2002), to first order. The dispersion is the variance of gradients between blocks over that of
        independent errors.
        """
        parts = self.linearise(c)
        now = self.normal(c, parts, weight)
        inverse = np.linalg.inv(now.A)
        left_out = now.A - weight * now.information
        gradients = np.linalg.solve(left_out, now.gradients[..., None])[..., 0] @ now.A
        spread = gradients.T @ gradients * (1.0 - 1.0 / self.blocks)
        information = now.information.sum(0)
        dispersion = max(1.0, float(np.trace(inverse @ spread) / np.trace(inverse @ information)))
        # What a few blocks say of each direction is as uncertain as what all say of the mean: half of each.
        between = 0.5 * weight**2 * (spread + dispersion * information)
        return dispersion, inverse @ (np.diag(self.precision) + between) @ inverse + np.diag(
            self._bias(c, parts, weight) ** 2
        )

    def _bias(self, c: np.ndarray, parts: list[tuple[np.ndarray, np.ndarray]], weight: float) -> np.ndarray:
        """Error ``(k,)`` of estimates from windows, told from those of short and of long windows alone, to first order.

        A disturbance that lasts is mistaken for motion that decays slowly: damping is estimated too small, by an error
        that is inversely proportional to the length of the window.
        """
        inverse, steps = 1.0 / np.array(list(self.sets)), []
        if len(inverse) == 1:
            return 0.0 * c
        for each, part in zip(self.sets.values(), parts, strict=True):
            alone = self.normal(c, [part], len(parts) * weight, sets=[each])
            steps.append(np.linalg.solve(alone.A, alone.b))
        return (steps[0] - steps[-1]) * inverse.mean() / (inverse[0] - inverse[-1])

    def errors(self) -> dict[float, np.ndarray]:
        """RMS error of each set of windows, by length."""
        return dict(zip(self.sets, self.scales, strict=True))
