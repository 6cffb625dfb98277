"""Maximum likelihood estimates of a filter's parameters: Q, R, the prior and others.

::

    def build(q, r):
        return make("kf", LinearModel(A, C, q * np.eye(2), [[r]])), Gaussian(mean, cov)

    found = fit(build, {"q": 1.0, "r": 1.0}, y)
    print(found)  # estimates, 95 % intervals, and what the measurements cannot tell

No truth is needed: a filter predicts each measurement, and the estimate is the set of parameters
that makes the measurements most likely.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np

from estimators.checks import as_array, number
from estimators.factory import unknown
from estimators.models import Gaussian
from estimators.randomness import RandomKeys
from estimators.series import run

_POSITIVE = "a positive number, or be named in signed if it may have any sign"
_QUANTILE = 1.959963984540054
_LARGEST = 300.0
"""Largest logarithm of a parameter, of either sign."""
_LITTLE = 0.1
"""Less information than this on a logarithm leaves its 95 % interval a factor of 490 either way."""
_WORSE = 1.0
"""A larger difference in log-likelihood counts as less likely."""
_LEFT = 0.02
"""Largest gain in log-likelihood that is left where a search has converged."""
_INVOLVED = 0.1
"""Share of a direction above which it involves a parameter."""
_SMOOTH, _ROUGH = 0.1, 0.5
"""Steps of the Hessian's differences in standard errors; the second where members are drawn."""
_AWAY = np.arange(4.0, 68.0, 4.0)
"""Distances along a direction without information at which a better point is sought."""
_SCALES = sorted(np.arange(-64.0, 65.0, 8.0), key=abs)
"""Logarithms of common factors of all positive parameters with which a search may begin."""


@dataclass(frozen=True, eq=False)
class Fit:
    """Estimated parameters with standard errors and intervals.

    Attributes:
        estimates: Maximum-likelihood estimate of each parameter, by name.
        standard_errors: Standard error of each, by name; infinite where the measurements do not
            determine the parameter, or the search found no maximum.
        intervals: 95 % interval of each, by name, symmetric in the logarithm of a positive
            parameter; infinite in the same cases.
        log_likelihood: Log-likelihood of all measurements at the estimates.
        undetermined: Combinations of parameters that the measurements cannot determine, a sentence
            for each.
        converged: True if the search found a maximum.
        filter: The filter built with the estimates.
        prior: The prior built with the estimates.
    """

    estimates: dict[str, float]
    standard_errors: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    log_likelihood: float
    undetermined: tuple[str, ...]
    converged: bool
    filter: Any
    prior: Gaussian

    def __str__(self) -> str:
        width = max(map(len, self.estimates))
        lines = [
            f"log-likelihood {self.log_likelihood:.6g}"
            + ("" if self.converged else ", search did not converge")
        ]
        for name, value in self.estimates.items():
            low, high = self.intervals[name]
            lines.append(f"{name:{width}} {value:.4g}  [{low:.4g}, {high:.4g}]")
        return "\n".join([*lines, *self.undetermined])


def fit(
    build: Callable[..., tuple[Any, Gaussian]],
    start: Mapping[str, float],
    y: np.ndarray,
    u: np.ndarray | None = None,
    t: np.ndarray | None = None,
    signed: Iterable[str] = (),
    rng: RandomKeys | int = 0,
) -> Fit:
    """Estimate the parameters of a filter from measurements alone, by maximum likelihood.

    The density of all measurements (`Series.log_likelihood`) is maximised by gradients (L-BFGS-B).
    A simplex (Nelder & Mead) replaces gradients that lead to no maximum. It is also used for
    filters that draw random numbers, which are then the same throughout. Standard errors come from
    the observed information, the second derivatives at the maximum.

    Source: Ljung (1999), System Identification, sec. 7.4; Harvey (1989), Forecasting, Structural
    Time Series Models and the Kalman Filter, sec. 3.4.

    Args:
        build: Function that makes a filter and its prior from the parameters, given by name.
        start: Parameters at which the search begins, by name: positive numbers, which are searched
            as their logarithms. The measurements may be in other units, so the search begins with
            the likeliest common factor of all, from e^-64 to e^64. Then one parameter at a time is
            changed by factors of e^8 and e^4, as long as that makes the measurements likelier.
        y: ``(T, ..., p)`` measurements, as `run` takes them; rows of a batch are independent series
            of the same parameters.
        u: Known inputs, as `run` takes them.
        t: Times, as `run` takes them.
        signed: Names of parameters that may have any sign; start them at their order of magnitude.
        rng: Seed or keys of the numbers that a filter draws.

    Raises:
        ValueError: if a start is missing, is not positive or gives no likelihood, or an argument
            does not fit (see `run`).
        TypeError: if ``build`` does not take these names, or gives no filter and prior.
    """
    if others := set(signed := tuple(signed)) - start.keys():
        raise ValueError(unknown("signed parameter", others.pop(), start))
    positive = np.array([name not in signed for name in start])
    origin = np.array([
        number(f"start of {name}", value, *((0.0, np.inf, _POSITIVE) if name not in signed
                                            else (-np.inf, np.inf, "a finite number")))
        for name, value in start.items()
    ])  # fmt: skip
    units = np.where(positive | (origin == 0.0), 1.0, np.abs(origin))
    y = as_array("y", y)
    arrived = np.isfinite(y)

    def evaluate(filter: Any, prior: Gaussian) -> float:
        with np.errstate(all="ignore"):
            series = run(filter, prior, y, u, t, rng=rng)
            lost = arrived & ~series.updated.available & ~series.updated.healthy[..., None]
            # A measurement that is given up must not pay.
            return np.inf if lost.any() else -float(series.log_likelihood.sum())

    search = _Search(build, tuple(start), positive, units, evaluate)
    first = origin / units
    first[positive] = np.log(first[positive])
    filter, prior = search.built(first)
    scaled = (search.cost(first + far * positive) for far in _SCALES)
    if not (np.isfinite(evaluate(filter, prior)) or any(map(np.isfinite, scaled))):
        raise ValueError(
            "the measurements have no likelihood at the start: begin where the filter can follow"
            " them"
        )
    return search.fit(first, getattr(filter, "random", False))


# --- the search -----------------------------------------------------------------------------------


@dataclass(eq=False)
class _Search:
    """Cost of ``theta (k,)``: logarithms of positive parameters, others in units of their start."""

    build: Callable[..., tuple[Any, Gaussian]]
    names: tuple[str, ...]
    positive: np.ndarray
    units: np.ndarray
    evaluate: Callable[[Any, Gaussian], float]
    rough = False  # the cost is not smooth
    best = np.empty(0)  # (k,) where the last search ended
    least = np.inf  # the cost there
    _costs: dict[bytes, float] = field(default_factory=dict)  # by the parameters' bytes

    def values(self, theta: np.ndarray) -> dict[str, float]:
        """The parameters themselves, by name."""
        values = theta * self.units
        values[self.positive] = np.exp(theta[self.positive])
        return dict(zip(self.names, values.tolist(), strict=True))

    def built(self, theta: np.ndarray) -> tuple[Any, Gaussian]:
        """The filter and its prior."""
        return self.build(**self.values(theta))

    def cost(self, theta: np.ndarray) -> float:
        """The negative log-likelihood; infinite where there is none."""
        key = theta.tobytes()
        if key not in self._costs:
            try:
                value = self.evaluate(*self.built(theta))
            except (ValueError, ArithmeticError):
                value = np.inf  # the numbers are far from the start, and no filter takes them
            self._costs[key] = np.inf if np.isnan(value) else value
        return self._costs[key]

    def fit(self, first: np.ndarray, rough: bool) -> Fit:
        """The fit of a search from here, by gradients or, if the cost is rough, by a simplex."""
        starts, self.rough = self._starts(first), rough
        if rough:
            starts = [min(starts, key=self.cost)]  # a simplex takes many steps
        first = starts[0]
        while True:
            self.best = best = self._likeliest([self._minimum(start) for start in starts])
            self.least = self.cost(best)
            slopes, information = self._derivatives(_ROUGH if self.rough else _SMOOTH)
            covariance, flat, peaked = _covariance(information, self.positive)
            with np.errstate(invalid="ignore"):
                gain = 0.5 * slopes @ covariance @ slopes + sum(abs(slopes @ way) for way in flat)
            converged = peaked and bool(gain < _LEFT)
            # A search may end on a plateau, as that of a variance beside a far greater one.
            points = [best + far * way for way in flat for far in (*_AWAY, *-_AWAY)]
            starts = [self._likeliest([best, *points])]
            if starts[0] is best:
                if converged or self.rough:
                    return self._report(np.sqrt(np.diagonal(covariance)), flat, converged)
                starts, self.rough = [first], True  # gradients lead to no minimum

    def _likeliest(self, points: list[np.ndarray]) -> np.ndarray:
        """The first point ``(k,)``, unless another's cost is lower by more than rounding."""
        costs = [self.cost(point) for point in points]
        return points[0 if costs[0] <= min(costs) + _LEFT else int(np.argmin(costs))]

    def _report(self, spread: np.ndarray, flat: list[np.ndarray], converged: bool) -> Fit:
        """The record of what the search found."""
        best, estimates = self.best, self.values(self.best)
        loose = np.sum([np.abs(way) > _INVOLVED for way in flat], 0) + (not converged)
        errors = np.where(loose, np.inf, spread)
        low, high = (self.values(best + z * errors) for z in (-_QUANTILE, _QUANTILE))
        sd = np.where(self.positive, [*estimates.values()], self.units) * errors
        filter, prior = self.built(best)
        return Fit(
            estimates=estimates,
            standard_errors=dict(zip(self.names, sd.tolist(), strict=True)),
            intervals={name: (low[name], high[name]) for name in self.names},
            log_likelihood=-self.least,
            undetermined=tuple(dict.fromkeys(map(self._statement, flat))),
            converged=converged,
            filter=filter,
            prior=prior,
        )

    def _starts(self, first: np.ndarray) -> list[np.ndarray]:
        """Starts ``(k,)`` near a minimum, though the measurements may be in other units.

        The first moves all positive parameters together, which keeps the middle of a ridge. The
        second goes on from there by one parameter at a time.
        """
        common, axes = 1.0 * self.positive, np.diag(1.0 * self.positive)[self.positive]
        best = min((first + far * common for far in _SCALES), key=self.cost)
        together = self._descended(self._descended(best, [common], 4.0), [common], 2.0)
        apart = self._descended(self._descended(together, axes, 8.0), axes, 4.0)
        return [together] if apart is together else [together, apart]

    def _descended(self, best: np.ndarray, ways: Any, stride: float) -> np.ndarray:
        """The point ``(k,)`` that strides along these ways reach as long as the cost falls."""
        least = self.cost(best)
        while True:
            moved = [best + far * way for way in ways for far in (stride, -stride)]
            moved = [theta for theta in moved if (self.positive * np.abs(theta) < _LARGEST).all()]
            costs = [self.cost(theta) for theta in moved]
            if min(costs, default=np.inf) >= least - _LEFT:
                return best
            best, least = moved[int(np.argmin(costs))], min(costs)

    def _minimum(self, start: np.ndarray) -> np.ndarray:
        """The parameters ``(k,)`` of least cost."""
        from scipy.optimize import Bounds, minimize  # late: the import is slow

        least = self.cost(start)
        worst = least + 100.0 * (1.0 + abs(least))  # what a search can step back from
        edge = np.where(self.positive, _LARGEST, np.inf)
        if self.rough:
            method, jac, simplex = "Nelder-Mead", None, np.eye(len(start) + 1, len(start), -1)
            options = {"initial_simplex": start + 0.5 * simplex, "xatol": 1e-3, "fatol": 1e-3}
        else:
            method, jac, options = "L-BFGS-B", "3-point", {"ftol": 1e-13, "gtol": 1e-4}
        return minimize(
            lambda theta: min(self.cost(theta), worst),
            start, method=method, jac=jac, bounds=Bounds(-edge, edge), options=options,
        ).x  # fmt: skip

    def _derivatives(self, step: float) -> tuple[np.ndarray, np.ndarray]:
        """First and second derivatives ``(k,)`` and ``(k, k)`` by central differences.

        Steps are a share of a standard error. A second derivative is NaN if it differs over a
        whole standard error: curvature on a small scale alone is roughness, not a minimum.
        """
        best, least = self.best, self.least

        def along(move: np.ndarray) -> tuple[float, float]:
            ahead, behind = self.cost(best + move), self.cost(best - move)
            return 0.5 * (ahead - behind), ahead - 2.0 * least + behind

        sizes = np.full(len(best), 0.01 * step)
        for _ in range(2):
            moves = np.diag(sizes)
            curvatures = np.array([along(move)[1] for move in moves]) / sizes**2
            sizes = np.clip(step / np.sqrt(np.maximum(curvatures, 1e-300)), 1e-6, step)
        moves = np.diag(sizes)
        slopes, curvatures = np.array([along(move) for move in moves]).T
        wide = np.array([along(move / step)[1] for move in moves]) * step**2
        known = (curvatures > _LITTLE * sizes**2) & np.isfinite(wide)
        differ = known & ((wide < 0.25 * curvatures) | (wide > 4.0 * curvatures))
        hessian = np.diag(np.where(differ, np.nan, curvatures))
        for i, j in combinations(range(len(best)), 2):
            ends = along(moves[i] + moves[j])[1] - along(moves[i] - moves[j])[1]
            hessian[i, j] = hessian[j, i] = 0.25 * ends
        return slopes / sizes, hessian / sizes / sizes[:, None]

    def _statement(self, way: np.ndarray) -> str:
        """A direction without information in words."""
        moved = np.flatnonzero(np.abs(way) > _INVOLVED).tolist()
        *names, last = (self.names[i] for i in moved)
        if names:
            up = way * way[moved[0]] > 0.0
            ways = " and ".join(f"{self.names[i]} {'up' if up[i] else 'down'}" for i in moved)
            return (
                f"the measurements cannot tell {', '.join(names)} and {last} apart: with {ways}"
                " they are as likely"
            )
        far = np.where(np.abs(way) > _INVOLVED, _AWAY[-1], 0.0)
        less, more = (self.cost(self.best + each) <= self.least + _WORSE for each in (-far, far))
        if less and more:
            return f"the measurements tell nothing of {last}: they are as likely with another"
        if less or more:
            size = "small" if less else "great"
            return (
                f"measurements say of {last} only that it is {size}: as likely if it is"
                f" {size}er still"
            )
        return f"measurements say of {last} only its order of magnitude"


def _covariance(
    information: np.ndarray, positive: np.ndarray
) -> tuple[np.ndarray, list[np.ndarray], bool]:
    """Covariance ``(k, k)`` of estimates, directions without information, and if it is a maximum.

    Logarithms need no units. The unit of another parameter follows from its standard error with all
    else known; a direction is flat if it is known 300 times less well.
    """
    finite = np.isfinite(information)
    information = np.where(finite, information, 0.0)
    known = np.sqrt(np.maximum(np.diagonal(information), 0.0))
    units = np.where(positive | (known == 0.0), 1.0, known / (300.0 * np.sqrt(_LITTLE)))
    values, vectors = np.linalg.eigh(information / units / units[:, None])
    flat = values <= _LITTLE
    inverse = np.where(flat, 0.0, 1.0 / np.where(flat, 1.0, values))
    covariance = (vectors * inverse) @ vectors.T / units / units[:, None]
    peaked = finite.all() and values[0] > -max(1.0, 1e-3 * values[-1])
    ways = vectors.T[flat] / units
    return covariance, [*(ways / np.linalg.norm(ways, axis=-1, keepdims=True))], bool(peaked)
