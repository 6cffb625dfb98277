"""Consistency of a filter: its errors in many simulated runs compared with its covariances.

::

    from estimators.consistency import assess

    report = assess(filter, prior, np.random.default_rng(0))  # the filter on its own model
    report.passed()  # False for at most 5 % of consistent filters

Three tests, with p-values that hold whatever the correlation between times: the size of state
errors (NEES) and of innovations (NIS), and whiteness of innovations. Averages are over runs, at one
time.

Source: Bar-Shalom, Li & Kirubarajan (2001), Estimation with applications to tracking and
navigation, sec. 5.4.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtr, chdtrc, gammaincinv, ndtri

from estimators.belief import FeedthroughBelief, ObservedInputBelief
from estimators.filter import Filter, Model
from estimators.linalg import diagonal, masked, semidefinite_cholesky
from estimators.metrics import nees, nis
from estimators.models import Gaussian
from estimators.series import run

_ENDS = 0.025, 0.975
"""Probabilities below the lower and the upper end of a band."""


class Runs(NamedTuple):
    """M independent runs of T steps: times first, then runs, then components."""

    x: np.ndarray  # (T, M, n) true state
    y: np.ndarray  # (T, M, p) measurements
    u: np.ndarray | None = None  # (T, M, m) known input, held from measurement to measurement
    available: np.ndarray | None = None  # (T, M, p) mask of those that arrived; None: all


def simulate(
    model: Model,
    prior: Gaussian,
    rng: np.random.Generator,
    runs: int = 200,
    steps: int = 100,
    u: np.ndarray | None = None,
    d: np.ndarray | None = None,
) -> Runs:
    """Simulate a model, from starts drawn from a prior.

    Args:
        model: The model that generates the data.
        prior: Mean ``(n,)`` and covariance ``(n, n)`` of the start.
        rng: Generator of the noise.
        runs: Number of independent runs, M.
        steps: Number of measurements in each run, T.
        u: Known input, broadcast to ``(T, M, m)``.
        d: Unknown input, broadcast to ``(T, M, q)``; None: zero.

    Raises:
        AssertionError: if there is a ``d`` though the model has no unknown input.
    """
    u, d = (
        None if a is None else np.broadcast_to(a, (steps, runs, np.shape(a)[-1])) for a in (u, d)
    )
    x = prior.mean + _noise(prior.cov, rng, runs)
    xs, ys = [], []
    for k in range(steps):
        now = None if u is None else u[k]
        y = model.evaluated("measurement", x, now) + _noise(model.value("R", now), rng, runs)
        following = model.evaluated("transition", x, now) + _noise(model.value("Q", now), rng, runs)
        if d is not None:
            assert model.q, "the model has no unknown input"
            following = following + np.matvec(model.input_matrix(x, now), d[k])
            observed = k - model.delayed_feedthrough
            if observed >= 0:  # nothing has acted before the first
                y = y + np.matvec(model.value("H", now), d[observed])
        xs.append(x)
        ys.append(y)
        x = following
    return Runs(np.array(xs), np.array(ys), u)


def _noise(cov: np.ndarray, rng: np.random.Generator, runs: int) -> np.ndarray:
    return np.matvec(semidefinite_cholesky(cov), rng.normal(size=(runs, cov.shape[-1])))


# --- the three tests ------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Band:
    """Statistics, and the band in which each lies with 95 % probability for a consistent filter.

    Attributes:
        x: ``(K,)`` times or lags.
        found: ``(K, j)`` the statistics; j is 1 or, for whiteness, the number of measurements.
        expected: ``(K,)`` expected values of the statistics for a consistent filter.
        low: ``(K,)`` lower end of the band.
        high: ``(K,)`` upper end of the band.
        p_value: Probability that a consistent filter gives a result at least as extreme.
    """

    x: np.ndarray
    found: np.ndarray
    expected: np.ndarray
    low: np.ndarray
    high: np.ndarray
    p_value: float


def chi_square_test(values: np.ndarray, degrees: np.ndarray | int) -> Band:
    """Test the size of NEES or NIS: at each time their sum over runs is chi-square.

    The statistic is the sum divided by its degrees of freedom, NaN at times without any.

    Args:
        values: ``(T, M)`` one value for each time and run.
        degrees: Degrees of freedom, broadcast to ``(T, M)``: n for the NEES, the measurements that
            arrived for the NIS.
    """
    total, freedom = values.sum(1), np.broadcast_to(degrees, values.shape).sum(1)
    freedom = np.where(freedom > 0, freedom, np.nan)
    p = 2.0 * np.minimum(chdtr(freedom, total), chdtrc(freedom, total))
    low, high = (2.0 * gammaincinv(0.5 * freedom, level) / freedom for level in _ENDS)
    p_value = _any_of(np.where(np.isnan(freedom), 1.0, p))
    found = (total / freedom)[:, None]
    return Band(np.arange(len(found)), found, np.ones(len(found)), low, high, p_value)


@np.errstate(invalid="ignore", divide="ignore")
def whiteness_test(innovation: np.ndarray, innovation_cov: np.ndarray, lags: int = 20) -> Band:
    """Portmanteau test for white innovations in several runs, in which measurements may be missing.

    Innovations are whitened by the filter's covariance and then by their own sample covariance. So
    a wrong scale, which the NIS tests, does not count here. The test needs no truth, and one run is
    enough. The statistics are the autocorrelations of each measurement, NaN at a lag at which no
    two of its values arrived. The p-value is that of the portmanteau statistic over all lags and
    all pairs of measurements.

    Sources: Ljung & Box (1978), On a measure of lack of fit in time series models; Hosking (1980),
    The multivariate portmanteau statistic.

    Args:
        innovation: ``(T, M, p)``; NaN where a measurement is missing.
        innovation_cov: ``(T, M, p, p)``.
        lags: Number of lags, from lag 1 on; less than T.

    Raises:
        ValueError: if the innovations have no spread in some direction.
    """
    innovation, cov = np.asarray(innovation, float), np.asarray(innovation_cov, float)
    arrived = ~np.isnan(innovation)
    mask, innovation = 1.0 * arrived, np.where(arrived, innovation, 0.0)
    white = _standardised(_solve_root(masked(cov, arrived), innovation), mask)
    products, counts = (
        np.array([np.einsum("tmi,tmj->ij", a[lag:], a[:-lag]) for lag in range(1, lags + 1)])
        for a in (white, mask)
    )
    times = mask.sum((0, 1)).max()
    statistic = np.nansum(products**2 / counts) * (times + 2.0) / times
    own, number = (diagonal(a) for a in (products, counts))
    bound = ndtri(_ENDS[1]) / np.sqrt(number.min(-1))
    p = chdtrc((counts > 0).sum(), statistic)
    return Band(np.arange(1, lags + 1), own / number, np.zeros(lags), -bound, bound, float(p))


@np.errstate(invalid="ignore")
def _standardised(white: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Vectors ``(T, M, p)`` whitened by their own covariance, over those components that arrived.

    Correlations are estimated where both components arrived, so that none exceeds 1.
    """
    product = np.einsum("tmi,tmj->ij", white, white)
    squares = np.einsum("tmi,tmj->ij", white**2, mask)  # of i, where j arrived
    correlation = np.nan_to_num(product / np.sqrt(squares * squares.T))
    counts = mask.sum((0, 1))
    seen = counts > 0
    if not seen.any() or np.linalg.eigvalsh(correlation[seen][:, seen])[0] < 1e-12:
        raise ValueError(
            "the innovations have no spread in some direction: too few measurements for a test"
        )
    spread = np.sqrt(np.diagonal(squares) / np.maximum(counts, 1.0))
    return _solve_root(masked(correlation * spread * spread[:, None], mask > 0.0), white)


def _solve_root(cov: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """``L^-1 v`` with ``cov = L L'``."""
    return np.linalg.solve(np.linalg.cholesky(cov), vector[..., None])[..., 0]


def _any_of(p: np.ndarray) -> float:
    """The p-value of many tests together, whatever their correlation (Bonferroni)."""
    p = np.where(np.isnan(p), 0.0, p)  # what is not a number is not consistent
    return float(min(1.0, p.size * p.min()))


@dataclass(frozen=True, eq=False)
class Consistency:
    """The three tests of a filter on data of known truth.

    Attributes:
        name: Name of the filter.
        nees: Size of state errors at each time.
        nis: Size of innovations, less the share of an estimated unknown input; None for ``ulise``,
            whose innovations carry the inputs of two steps.
        whiteness: Whiteness of innovations; None where they carry an unknown input.
    """

    name: str
    nees: Band
    nis: Band | None
    whiteness: Band | None

    @property
    def p_value(self) -> float:
        """Bonferroni bound on the probability of so extreme a result of a consistent filter."""
        tests = filter(None, (self.nees, self.nis, self.whiteness))
        return _any_of(np.array([test.p_value for test in tests]))

    def passed(self, false_alarm: float = 0.05) -> bool:
        """Return True unless these runs show that the filter is inconsistent.

        Args:
            false_alarm: Largest probability that a consistent filter is rejected.
        """
        return self.p_value >= false_alarm


def assess(
    filter: Filter,
    prior: Gaussian,
    rng: np.random.Generator,
    data: Runs | None = None,
) -> Consistency:
    """Run a filter many times and test whether it is consistent.

    Args:
        filter: The filter.
        prior: Prior of the filter, with mean ``(n,)`` and covariance ``(n, n)``.
        rng: Noise of the simulation, and draws of the filter if it makes any.
        data: The runs, such as ``simulate(other_model, ...)``; None: 200 runs of 100 steps,
            simulated with the filter's own model, without known input.
    """
    data = simulate(filter.model, prior, rng) if data is None else data
    series = run(filter, prior, data.y, data.u, available=data.available, rng=rng)
    beliefs, angles = series.updated, filter.model.state_angles
    errors = nees(series.mean, series.cov, data.x, angles)
    states = chi_square_test(errors, (~np.isnan(data.x)).sum(-1))
    innovations = whiteness = None
    if not isinstance(beliefs, FeedthroughBelief):
        innovations = chi_square_test(*_surprise(beliefs))
    if filter.input_delay is None:
        e = np.where(beliefs.available, beliefs.innovation, np.nan)
        whiteness = whiteness_test(e, beliefs.innovation_cov, min(20, len(data.y) - 1))
    return Consistency(filter.name, states, innovations, whiteness)


def _surprise(beliefs: Any) -> tuple[np.ndarray, np.ndarray]:
    """NIS ``(...)`` and its degrees of freedom, less those of an estimated unknown input."""
    size = np.abs(beliefs.mean).max(-1, keepdims=True)
    values = nis(beliefs.innovation, beliefs.innovation_cov, size)
    degrees = beliefs.available.sum(-1)
    if isinstance(beliefs, ObservedInputBelief):
        values = values - nis(beliefs.input_mean, beliefs.input_cov, size)
        degrees = degrees - np.round(diagonal(beliefs.input_observed).sum(-1))
    return values, degrees
