"""Consistency of a filter: its errors in many simulated runs beside its covariances.

::

    from estimators.consistency import assess, consistency_figure

    report = assess(filter, prior, np.random.default_rng(0))  # the filter on its own model
    report.passed()  # False for at most 5 % of consistent filters
    consistency_figure(report).savefig("consistency.png")

Four tests, with p-values that hold whatever the correlation between times: the size of state errors
(NEES) and of innovations (NIS), whiteness of innovations, coverage of credible intervals. Averages
are over runs, at one time.

Source: Bar-Shalom, Li & Kirubarajan (2001), Estimation with applications to tracking and
navigation, sec. 5.4.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.special import bdtr, bdtrc, bdtrik, gammainc, gammaincc, gammaincinv, ndtri

from estimators.angles import difference
from estimators.belief import FeedthroughBelief, ObservedInputBelief
from estimators.filter import Filter, Model
from estimators.linalg import masked, semidefinite_cholesky
from estimators.metrics import nees, nis
from estimators.models import Gaussian
from estimators.series import run
from estimators.varying import resolve

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Curves = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | float, dict[str, np.ndarray]]
"""What a panel of the figure shows: x, low and high ends of a band, expected values, curves by name."""
LEVELS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99)


class Runs(NamedTuple):
    """M independent runs of T steps: times first, then runs, then components."""

    x: np.ndarray  # (T, M, n) true state
    y: np.ndarray  # (T, M, p) measurements
    u: np.ndarray | None = (
        None  # (T, M, m) known input at the measurements, held over the step that follows
    )
    available: np.ndarray | None = (
        None  # (T, M, p) mask of the measurements that arrived; None: all
    )


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
        model: What generates the data.
        prior: Mean ``(n,)`` and covariance ``(n, n)`` of the start.
        rng: Where the noise comes from.
        runs: How many independent runs, M.
        steps: How many measurements in each, T.
        u: Known input, broadcast to ``(T, M, m)``.
        d: Unknown input, broadcast to ``(T, M, q)``; None: zero.

    Raises:
        ValueError: if ``runs`` or ``steps`` is below 2, or there is a ``d`` that the model has not.
    """
    if d is not None and model.H is None:
        raise ValueError("d was given, but the model has no unknown input (G and H are missing)")
    if runs < 2 or steps < 2:
        raise ValueError(f"runs and steps must be at least 2, got {runs} and {steps}")
    u, d = (
        None if a is None else np.broadcast_to(a, (steps, runs, np.shape(a)[-1])) for a in (u, d)
    )
    x = prior.mean + _noise(prior.cov, rng, runs)
    xs, ys = [], []
    for k in range(steps):
        now = None if u is None else u[k]
        y = model.measurement(x, now) + _noise(resolve(model.R, now), rng, runs)
        following = model.transition(x, now) + _noise(resolve(model.Q, now), rng, runs)
        if d is not None and model.H is not None:
            observed = k - 1 if model.delayed_feedthrough else k
            if observed >= 0:  # nothing has acted before the first measurement
                y = y + np.matvec(resolve(model.H, now), d[observed])
            following = following + np.matvec(model.input_matrix(x, now), d[k])
        xs.append(x)
        ys.append(y)
        x = following
    return Runs(np.array(xs), np.array(ys), u)


def _noise(cov: np.ndarray, rng: np.random.Generator, runs: int) -> np.ndarray:
    return np.matvec(semidefinite_cholesky(cov), rng.normal(size=(runs, cov.shape[-1])))


# --- the four tests -------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Band:
    """A mean over runs beside the interval in which chi-square theory expects it.

    Attributes:
        mean: ``(T,)`` mean over runs at each time.
        expected: ``(T,)`` degrees of freedom: what the mean should be.
        low: ``(T,)`` lower end of the interval for one time; 0 for a filter that may be
            conservative.
        high: ``(T,)`` upper end.
        confidence: Probability of that interval.
        p_value: That a consistent filter would leave the band as far at any time (Bonferroni: at
            most).
    """

    mean: np.ndarray
    expected: np.ndarray
    low: np.ndarray
    high: np.ndarray
    confidence: float
    p_value: float

    def curves(self) -> Curves:
        """Times, ends of the interval, 1, and the mean, each divided by the degrees of freedom."""
        degrees = np.where(self.expected > 0, self.expected, np.nan)
        return (
            np.arange(len(self.mean)),
            self.low / degrees,
            self.high / degrees,
            1.0,
            {"found": self.mean / degrees},
        )


def chi_square_test(
    values: np.ndarray,
    degrees: np.ndarray | int,
    confidence: float = 0.95,
    conservative: bool = False,
) -> Band:
    """Are NEES or NIS values as large as they should be? Their sum over runs is chi-square at each time.

    Args:
        values: ``(T, M)`` one value for each time and run.
        degrees: Degrees of freedom, broadcast to ``(T, M)``: n for the NEES, the measurements that
            arrived for the NIS.
        confidence: Of the interval that is returned for each time.
        conservative: The filter may be too careful: only values that are too large count against
            it.
    """
    T, M = values.shape
    total, freedom = values.sum(1), np.broadcast_to(degrees, values.shape).sum(1)
    seen = freedom > 0
    half = 0.5 * np.where(seen, freedom, 1)
    tail = (1.0 - confidence) / (1.0 if conservative else 2.0)
    upper, lower = gammaincc(half, 0.5 * total), gammainc(half, 0.5 * total)
    p = np.where(seen, upper if conservative else 2.0 * np.minimum(lower, upper), 1.0)
    low, high = (
        np.where(seen, 2.0 * gammaincinv(half, level) / M, 0.0) for level in (tail, 1.0 - tail)
    )
    return Band(
        total / M, freedom / M, np.zeros(T) if conservative else low, high, confidence, _any_of(p)
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Whiteness:
    """Autocorrelation of standardised innovations.

    Attributes:
        lags: ``(L,)``.
        correlation: ``(L, p)`` of each measurement with itself; NaN at a lag at which it never
            arrived twice.
        bound: ``(L, p)`` half-width of the interval for one lag and measurement.
        confidence: Probability of that interval.
        statistic: Portmanteau statistic over all lags and all pairs of measurements.
        degrees: Its chi-square degrees of freedom.
        p_value: That white innovations would give a larger one.
    """

    lags: np.ndarray
    correlation: np.ndarray
    bound: np.ndarray
    confidence: float
    statistic: float
    degrees: int
    p_value: float

    def curves(self) -> Curves:
        """Lags, ends of the interval, the correlation expected, and those of each measurement."""
        bound = self.bound.max(-1)
        return (
            self.lags,
            -bound,
            bound,
            0.0,
            {f"channel {j}": c for j, c in enumerate(self.correlation.T)},
        )


def whiteness_test(
    innovation: np.ndarray,
    innovation_cov: np.ndarray,
    available: np.ndarray | None = None,
    lags: int = 20,
    confidence: float = 0.95,
) -> Whiteness:
    """Are innovations white? The test of Ljung & Box for one measurement, of Hosking for several, over runs and gaps.

    Innovations are whitened by the covariance that the filter gives and then by the one that they
    have, so that a wrong scale, which is what the NIS tests, does not count here. It needs no
    truth, and one run will do.

    Sources: Ljung & Box (1978), On a measure of lack of fit in time series models; Hosking (1980),
    The multivariate portmanteau statistic.

    Args:
        innovation: ``(T, M, p)``, 0 where no measurement came.
        innovation_cov: ``(T, M, p, p)``, unit and uncorrelated there.
        available: ``(T, M, p)`` mask of the measurements that arrived; None: all.
        lags: How many lags, from 1 on.
        confidence: Of the interval that is returned for each lag.

    Raises:
        ValueError: if there are not more times than lags, or a measurement has no variance at all.
    """
    T = len(innovation)
    if not 0 < lags < T:
        raise ValueError(f"lags must be between 1 and {T - 1} for {T} times, got {lags}")
    mask = np.ones(innovation.shape) if available is None else np.asarray(available, float)
    white = _standardised(_solve_root(innovation_cov, innovation), mask)
    pairs = [(white[lag:], white[:-lag], mask[lag:], mask[:-lag]) for lag in range(1, lags + 1)]
    products = np.array([np.einsum("tmi,tmj->ij", late, early) for late, early, _, _ in pairs])
    counts = np.array([np.einsum("tmi,tmj->ij", late, early) for _, _, late, early in pairs])
    times = mask.sum((0, 1)).max()
    with np.errstate(invalid="ignore", divide="ignore"):
        scores = products**2 / counts * (times + 2.0) / times
        own, number = (np.einsum("lii->li", a) for a in (products, counts))
        correlation, bound = own / number, ndtri((1.0 + confidence) / 2.0) / np.sqrt(number)
    statistic, degrees = float(np.nansum(scores)), int((counts > 0).sum())
    p_value = float(gammaincc(0.5 * degrees, 0.5 * statistic)) if degrees else 1.0
    return Whiteness(
        np.arange(1, lags + 1), correlation, bound, confidence, statistic, degrees, p_value
    )


def _standardised(white: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Vectors ``(T, M, p)`` whitened by their own covariance, over those components that arrived.

    Correlations are estimated where both components arrived, so that none exceeds 1.
    """
    product = np.einsum("tmi,tmj->ij", white, white)
    squares = np.einsum("tmi,tmj->ij", white**2, mask)  # of i, where j arrived
    together = np.sqrt(squares * squares.T)
    correlation = np.where(together > 0.0, product / np.where(together > 0.0, together, 1.0), 0.0)
    counts = mask.sum((0, 1))
    spread = np.sqrt(np.diagonal(squares) / np.maximum(counts, 1.0))
    seen = counts > 0
    if (spread[seen] == 0.0).any() or np.linalg.eigvalsh(correlation[seen][:, seen]).min(
        initial=1.0
    ) < 1e-12:
        raise ValueError(
            "the innovations have no spread in some direction: too few measurements for a test"
        )
    return _solve_root(masked(correlation * spread * spread[:, None], mask > 0.0), white)


def _solve_root(cov: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """``L^-1 v`` with ``cov = L L'``."""
    return np.linalg.solve(np.linalg.cholesky(cov), vector[..., None])[..., 0]


@dataclass(frozen=True, eq=False)
class Coverage:
    """Coverage of credible intervals.

    Attributes:
        levels: ``(K,)`` nominal probability of each interval.
        share: ``(K, n)`` of the runs in which it contains the component.
        low: ``(K,)`` lower end of the binomial interval for one share.
        high: ``(K,)`` upper end; 1 for a filter that may be conservative.
        confidence: Probability of that interval.
        p_value: That a consistent filter would miss any level by as much (Bonferroni: at most).
    """

    levels: np.ndarray
    share: np.ndarray
    low: np.ndarray
    high: np.ndarray
    confidence: float
    p_value: float

    def curves(self) -> Curves:
        """Levels in percent, ends of the interval less the level, the excess expected, and that of each state."""
        found = 100.0 * (self.share.T - self.levels)
        low, high = 100.0 * (self.low - self.levels), 100.0 * (self.high - self.levels)
        high = np.minimum(
            high, max(-low.min(), found.max())
        )  # the band of a conservative filter has no end
        return (
            100.0 * self.levels,
            low,
            high,
            0.0,
            {f"state {i}": excess for i, excess in enumerate(found)},
        )


def coverage_test(
    mean: np.ndarray,
    cov: np.ndarray,
    truth: np.ndarray,
    levels: tuple[float, ...] = LEVELS,
    angles: tuple[int, ...] = (),
    confidence: float = 0.95,
    conservative: bool = False,
) -> Coverage:
    """Do the central intervals of each component contain it as often as they say, over runs at one time?

    Args:
        mean: ``(M, n)``.
        cov: ``(M, n, n)``.
        truth: ``(M, n)``.
        levels: Nominal probabilities.
        angles: Components whose difference is wrapped.
        confidence: Of the binomial interval that is returned.
        conservative: The filter may be too careful: only intervals that are too narrow count
            against it.
    """
    M = len(mean)
    nominal = np.asarray(levels, float)
    score = np.abs(difference(truth, mean, angles)) / np.sqrt(np.diagonal(cov, axis1=-2, axis2=-1))
    inside = (score <= ndtri((1.0 + nominal) / 2.0)[:, None, None]).sum(1)  # (K, n)
    below, above = bdtr(inside, M, nominal[:, None]), bdtrc(inside - 1.0, M, nominal[:, None])
    p = below if conservative else np.minimum(1.0, 2.0 * np.minimum(below, above))
    tail = (1.0 - confidence) / (1.0 if conservative else 2.0)
    low, high = (np.ceil(bdtrik(level, M, nominal)) / M for level in (tail, 1.0 - tail))
    return Coverage(
        nominal,
        inside / M,
        low,
        np.ones_like(high) if conservative else high,
        confidence,
        _any_of(p),
    )


def _any_of(p: np.ndarray) -> float:
    """The p-value of many tests together, whatever their correlation (Bonferroni)."""
    p = np.where(np.isnan(p), 0.0, p)  # what is not a number is not consistent
    return float(min(1.0, p.size * p.min()))


@dataclass(frozen=True, eq=False)
class Consistency:
    """The four tests of a filter on data of known truth.

    Attributes:
        name: The filter's.
        nees: Size of state errors at each time.
        nis: Size of innovations, less the share of an estimated unknown input; None for ``ulise``,
            whose innovations carry the inputs of two steps.
        whiteness: Whiteness of innovations; None where they carry an unknown input.
        coverage: Coverage of credible intervals at the last time.
        conservative: The filter may be too careful, and its innovations need not be white.
    """

    name: str
    nees: Band
    nis: Band | None
    whiteness: Whiteness | None
    coverage: Coverage
    conservative: bool = False

    @property
    def p_value(self) -> float:
        """That a consistent filter would fail any of the tests as clearly (Bonferroni: at most)."""
        white = None if self.conservative else self.whiteness
        tests = (self.nees, self.nis, white, self.coverage)
        return _any_of(np.array([test.p_value for test in tests if test is not None]))

    def passed(self, false_alarm: float = 0.05) -> bool:
        """Is there no sign in these runs that the filter is inconsistent?

        Args:
            false_alarm: Probability, at most, that a consistent filter is failed.
        """
        return self.p_value >= false_alarm


def assess(
    filter: Filter,
    prior: Gaussian,
    rng: np.random.Generator,
    data: Runs | None = None,
    runs: int = 200,
    steps: int = 100,
    lags: int = 20,
    levels: tuple[float, ...] = LEVELS,
    confidence: float = 0.95,
    conservative: bool = False,
) -> Consistency:
    """Run a filter many times and test whether it is consistent.

    Args:
        filter: The filter.
        prior: What it starts from, mean ``(n,)`` and covariance ``(n, n)``.
        rng: Noise of the simulation, and draws of the filter if it makes any.
        data: The runs, such as ``simulate(other_model, ...)``; None: simulated with the filter's
            own model, without known input.
        runs: How many, if ``data`` is None.
        steps: How many, if ``data`` is None.
        lags: Of the whiteness test.
        levels: Of the credible intervals.
        confidence: Of the intervals for one time, lag or level, which are what the figure shows.
        conservative: The filter may be too careful (as ``robust-kf`` is by design): only
            overconfidence counts against it, and innovations need not be white.
    """
    data = simulate(filter.model, prior, rng, runs, steps) if data is None else data
    series, angles = (
        run(filter, prior, data.y, data.u, available=data.available, rng=rng),
        filter.model.state_angles,
    )
    beliefs: Any = series.updated
    errors, size = (
        nees(series.mean, series.cov, data.x, angles),
        np.abs(series.mean).max(-1, keepdims=True),
    )
    surprise = nis(beliefs.innovation, beliefs.innovation_cov, size)
    degrees = beliefs.available.sum(-1).astype(float)
    if isinstance(beliefs, ObservedInputBelief):
        surprise = surprise - nis(beliefs.input_mean, beliefs.input_cov, size)
        degrees = degrees - np.round(np.trace(beliefs.input_observed, axis1=-2, axis2=-1))
    innovations = whiteness = None
    if not isinstance(beliefs, FeedthroughBelief):
        innovations = chi_square_test(surprise, degrees, confidence, conservative)
    if filter.input_delay is None:
        whiteness = whiteness_test(
            beliefs.innovation, beliefs.innovation_cov, beliefs.available, lags, confidence
        )
    coverage = coverage_test(
        series.mean[-1], series.cov[-1], data.x[-1], levels, angles, confidence, conservative
    )
    states = chi_square_test(errors, filter.model.n, confidence, conservative)
    return Consistency(filter.name, states, innovations, whiteness, coverage, conservative)


# --- the figure -----------------------------------------------------------------------------------


def consistency_figure(report: Consistency) -> "Figure":
    """The four tests in four panels, each with what is expected (dashed) and the band of a consistent filter.

    The figure belongs to no window: save it with ``figure.savefig(...)``.

    Raises:
        ModuleNotFoundError: without Matplotlib, which only this needs.
    """
    try:
        from matplotlib.figure import Figure
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "a figure needs Matplotlib: pip install matplotlib", name=error.name
        ) from None

    figure = Figure(figsize=(10.0, 7.0), layout="constrained")
    remark = " (not required)" if report.conservative else ""
    panels: tuple[tuple[Any, ...], ...] = (
        (report.nees, "State errors", "step", "NEES / states, mean over runs"),
        (report.nis, "Innovations", "step", "NIS / measurements, mean over runs"),
        (report.whiteness, f"Whiteness of innovations{remark}", "lag [steps]", "autocorrelation"),
        (
            report.coverage,
            "Credible intervals at the last step",
            "nominal probability [%]",
            "found minus nominal [%]",
        ),
    )
    for axes, (test, title, x, y) in zip(figure.subplots(2, 2).flat, panels, strict=True):
        axes.set(xlabel=x, ylabel=y)
        axes.set_title(
            title if test is None else f"{title}: {_p_value(test.p_value)}", fontsize="medium"
        )
        if test is None:
            axes.set(xticks=[], yticks=[])
            note = "not tested: innovations carry\nthe unknown input"
            axes.text(0.5, 0.5, note, ha="center", transform=axes.transAxes)
        else:
            _draw(axes, test)
    verdict = "no sign of inconsistency" if report.passed() else "inconsistent"
    figure.suptitle(f"{report.name}: {verdict} ({_p_value(report.p_value)} over all tests)")
    return figure


def _draw(axes: "Axes", test: Band | Whiteness | Coverage) -> None:
    """Curves over the band in which they lie if a filter is consistent."""
    x, low, high, expected, curves = test.curves()
    axes.fill_between(
        x, low, high, color="#c9d6e3", lw=0, label=f"{100.0 * test.confidence:g} % band"
    )
    axes.plot(x, np.broadcast_to(expected, x.shape), color="black", lw=0.8, ls="--")
    for label, values in curves.items():
        color, size = (
            "#1f5a94" if len(curves) == 1 else None,
            3 if len(x) <= 30 else 0,
        )  # markers on few points
        axes.plot(x, values, marker="o", ms=size, lw=1.0, color=color, label=label)
    axes.spines[["top", "right"]].set_visible(False)
    axes.margins(x=0.02)
    bottom, top = axes.get_ylim()
    axes.set_ylim(bottom, top + 0.2 * (top - bottom))  # room for the legend
    axes.legend(
        fontsize="small",
        frameon=False,
        ncols=4,
        loc="upper left",
        borderaxespad=0.0,
        columnspacing=1.2,
    )


def _p_value(p: float) -> str:
    return "p < 0.001" if p < 0.001 else f"p = {p:.2g}"
