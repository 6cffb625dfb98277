"""The robust filters of Rudianto et al. (2024): the paper's figures, and its claim put to the test.

The world is a random two-state system in continuous time, discretised exactly; the filters believe it, and the
condition says where it is otherwise (`settings.robust.Condition`). Every matrix of a population of systems has the
leading axes (system, 1), every run (system, run).
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_are, solve_discrete_lyapunov

from agents.cells import Cell
from agents.page import Bullets, Claim, Claims, Entry, Facts, Figure, Page, Prose, Section, Table, listed, number
from agents.plotting import BELIEVED, INK, PALETTE, RAW, TRUE, data_uri, styled
from agents.reproduction.settings import robust as settings
from agents.reproduction.settings.robust import Condition
from agents.statistics import Interval, mean_interval, paired_difference
from estimators import Belief, Gaussian, LinearModel, make, van_loan, zero_order_hold

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# --- random systems ---------------------------------------------------------------------------------


class Dynamics(NamedTuple):
    """``x' = A x + B u + w``, ``w`` white with intensity ``q I``; ``y = C x + v``, ``v`` of equal variances."""

    A: np.ndarray  # (n, n), 1/s
    B: np.ndarray  # (n, 1)
    C: np.ndarray  # (p, n)
    q: float  # 1/s


class StateSpace(NamedTuple):
    """``x+ = A x + B u + w``, ``y = C x + v`` with ``w ~ N(0, Q)``, ``v ~ N(0, R)``; leading axes: system, run."""

    A: np.ndarray  # (..., n, n)
    B: np.ndarray  # (..., n, 1)
    C: np.ndarray  # (..., p, n)
    Q: np.ndarray  # (..., n, n)
    R: np.ndarray  # (p, p)

    @property
    def model(self) -> LinearModel:
        """The same for a filter."""
        return LinearModel(self.A, self.C, self.Q, self.R, self.B)


def draw(seed: int, readings: int = settings.READINGS) -> Dynamics:
    """The random system of a seed, by `settings.RECIPE`, with as many of its readings."""
    rng, n = np.random.default_rng(seed), settings.STATES
    M, B, C = rng.normal(size=(n, n)), rng.normal(size=(n, 1)), rng.normal(size=(settings.READINGS, n))
    margin = rng.uniform(*settings.MARGIN)
    q = np.exp(rng.uniform(*np.log(settings.INTENSITY)))
    C /= np.linalg.norm(C, axis=1, keepdims=True)
    return Dynamics(M - (_growth(M) + margin) * np.eye(n), B, C[:readings], q)


def _growth(A: np.ndarray) -> float:
    """Growth rate of the slowest mode, 1/s."""
    return float(np.linalg.eigvals(A).real.max())


def mistaken(system: Dynamics, error: float, rng: np.random.Generator) -> Dynamics:
    """The system with another A, off by ``error |A|`` in a random direction.

    Directions that leave the slowest mode less than half the smallest margin are drawn again: both worlds are stable.
    """
    while True:
        direction = rng.normal(size=system.A.shape)
        A = system.A + error * np.linalg.norm(system.A) / np.linalg.norm(direction) * direction
        if _growth(A) <= -0.5 * settings.MARGIN[0]:
            return system._replace(A=A)


def discretised(systems: Sequence[Dynamics], runs: int = 1) -> StateSpace:
    """Models of one step with leading axes ``(systems / runs, runs)``."""
    steps = []
    for A, B, C, q in systems:
        transition, noise = van_loan(A, np.eye(settings.STATES), q * np.eye(settings.STATES), settings.STEP)
        steps.append((transition, C, noise, zero_order_hold(A, B, settings.STEP)[1]))
    stacked = (np.array(matrices) for matrices in zip(*steps, strict=True))
    A, C, Q, B = (matrices.reshape(-1, runs, *matrices.shape[1:]) for matrices in stacked)
    return StateSpace(A, B, C, Q, settings.READING_VARIANCE * np.eye(C.shape[-2]))


def _prior(*batch: int) -> Gaussian:
    n = settings.STATES
    return Gaussian(np.zeros((*batch, n)), settings.PRIOR_VARIANCE * np.eye(n))


def known_input(step: int) -> np.ndarray:
    """The square wave u ``(1,)``."""
    return np.array([1.0 if step % settings.INPUT_PERIOD < settings.INPUT_PERIOD / 2 else -1.0])


# --- the least-favourable model ---------------------------------------------------------------------


@dataclass(frozen=True)
class LeastFavourable:
    """The noise that hurts `robust-kf` most within its ball; lists over time, leading axes over systems.

    With its prediction error ``e`` and unit noise ``z = (w, v)``, ``x+ = A x + B u + W z``, ``y = C x + D z``, the
    error of the filter with gain G obeys ``e+ = F e + N z``, ``F = A - G C``, ``N = W - G D``. The least-favourable
    density is the nominal one times ``exp(theta |e+|^2 / 2)`` at every step. Later steps integrated out, last first::

        X = Omega+ + theta I     Z = (I - N' X N)^-1     Omega = F' (X + X N Z N' X) F
        z | e ~ N(Z N' X F e, Z)

    The first error is left as the prior has it: where readings hardly show the state, nature would want one so large
    that the start ruled the run, and its noise is then not the worst from another start. With tolerance 0
    it is the model itself.

    Source: Levy & Nikoukhah (2013), sec. III and V.
    """

    shift: list[np.ndarray]  # (..., n + p, n) mean of z for an error e
    root: list[np.ndarray]  # (..., n + p, n + p) root of z's covariance
    error_map: list[np.ndarray]  # (..., n, n) F
    error_noise: list[np.ndarray]  # (..., n, n + p) N
    start_weight: np.ndarray  # (..., n, n) Omega_0: nature would start with covariance (V_0^-1 - Omega_0)^-1
    claimed: np.ndarray  # (..., n, n) the filter's prediction covariance after the last step


def noise_roots(model: StateSpace) -> tuple[np.ndarray, np.ndarray]:
    """W ``(..., n, n + p)`` and D ``(p, n + p)`` with ``W W' = Q``, ``D D' = R``, ``W D' = 0``."""
    n, p = model.A.shape[-1], model.R.shape[-1]
    W = np.concatenate([np.linalg.cholesky(model.Q), np.zeros((*model.Q.shape[:-1], p))], axis=-1)
    D = np.hstack([np.zeros((p, n)), np.linalg.cholesky(model.R)])
    return W, D


def least_favourable(model: StateSpace, tolerance: float, steps: int) -> LeastFavourable:
    """The worst noise over a number of steps against ``robust-kf`` of the same tolerance."""
    (W, D), C, eye = noise_roots(model), model.C, np.eye(model.A.shape[-1])
    filter = make("robust-kf", model.model, radius=tolerance)
    belief = filter.init(_prior(*model.A.shape[:-2]))
    F, N, theta = [], [], []
    for _ in range(steps):
        V = belief.cov
        G = model.A @ V @ C.mT @ np.linalg.inv(C @ V @ C.mT + model.R)
        F.append(model.A - G @ C)
        N.append(W - G @ D)
        P = F[-1] @ V @ F[-1].mT + N[-1] @ N[-1].mT
        belief = filter.predict(filter.update(belief, np.zeros(C.shape[-2])))
        difference = np.linalg.inv(P) - np.linalg.inv(belief.cov)  # theta I
        theta.append(np.trace(difference, axis1=-2, axis2=-1)[..., None, None] / len(eye))
    shift, root, omega = [], [], np.zeros_like(eye)
    for F_t, N_t, theta_t in zip(F[::-1], N[::-1], theta[::-1], strict=True):
        X = omega + theta_t * eye
        Z = np.linalg.inv(np.eye(N_t.shape[-1]) - N_t.mT @ X @ N_t)
        shift.append(Z @ N_t.mT @ X @ F_t)
        root.append(np.linalg.cholesky(Z))
        omega = F_t.mT @ (X + X @ N_t @ Z @ N_t.mT @ X) @ F_t
    return LeastFavourable(shift[::-1], root[::-1], F, N, omega, belief.cov)


# --- runs -------------------------------------------------------------------------------------------


class Record(NamedTuple):
    """True states and readings; the first axis is time."""

    x: np.ndarray  # (T, ..., n)
    y: np.ndarray  # (T, ..., p)


_HORIZON = 20
"""Steps that nature plans beyond the last: near its end it would have nothing to anticipate."""


def simulate(model: StateSpace, world: StateSpace, condition: Condition, steps: int, runs: int, seed: int) -> Record:
    """Runs of every system: readings from the ``world``, its noise as the condition has it.

    The same seed gives the same underlying noise in every condition. Nature's error ``e`` is that of a filter which
    believes the model and sees no outlier.
    """
    W, D = noise_roots(world)
    worst = least_favourable(model, condition.tolerance, steps + _HORIZON)
    z_rng, outlier_rng = (np.random.default_rng([seed, stream]) for stream in range(2))
    batch = (len(model.A), runs)
    x = e = np.sqrt(settings.PRIOR_VARIANCE) * z_rng.normal(size=(*batch, W.shape[-2]))
    xs, ys = [], []
    for k in range(steps):
        z = np.matvec(worst.shift[k], e) + np.matvec(worst.root[k], z_rng.normal(size=(*batch, W.shape[-1])))
        outlier = outlier_rng.random((*batch, len(D))) < condition.rate
        xs.append(x)
        ys.append(np.matvec(world.C, x) + np.where(outlier, condition.size, 1.0) * np.matvec(D, z))
        e = np.matvec(worst.error_map[k], e) + np.matvec(worst.error_noise[k], z)
        x = np.matvec(world.A, x) + np.matvec(world.B, known_input(k)) + np.matvec(W, z)
    return Record(np.array(xs), np.array(ys))


def track(name: str, model: StateSpace, y: np.ndarray) -> Iterable[tuple[Belief, Belief]]:
    """The beliefs of a filter of `settings.FILTERS` before and after each reading of ``y (T, systems, runs, p)``."""
    kind, options = settings.FILTERS[name]
    filter = make(kind, model.model, **options)
    predicted = filter.init(_prior(*y.shape[1:-1]))
    for k, reading in enumerate(y):
        updated = filter.update(predicted, reading)
        yield predicted, updated
        predicted = filter.predict(updated, known_input(k))


def errors(
    seeds: Sequence[int],
    readings: int,
    runs: int,
    noise_seed: int,
    steps: int,
    skipped: int,
    condition: Mapping[str, float],
) -> dict[str, np.ndarray]:
    """RMSE of the state vector after the reading, ``(systems, runs)`` by filter, on the same readings.

    Args:
        seeds: Of the systems.
        readings: Of each system.
        runs: Of each system.
        noise_seed: Of everything that a run draws.
        steps: Readings a run.
        skipped: Readings at the start that do not count.
        condition: A `Condition` as a mapping.
    """
    what = Condition(**condition)
    systems = [draw(seed, readings) for seed in seeds]
    model = world = discretised(systems)
    if what.parameters:
        rng = np.random.default_rng([noise_seed, 2])
        world = discretised([mistaken(s, what.parameters, rng) for s in systems for _ in range(runs)], runs)
    record = simulate(model, world, what, steps, runs, noise_seed)
    return {name: _rmse(track(name, model, record.y), record.x, skipped) for name in settings.FILTERS}


def _rmse(beliefs: Iterable[tuple[Belief, Belief]], x: np.ndarray, skipped: int) -> np.ndarray:
    squares = [((after.mean - state) ** 2).sum(-1) for (_, after), state in zip(beliefs, x, strict=True)]
    return np.sqrt(np.mean(squares[skipped:], axis=0))


# --- the paper's own system -------------------------------------------------------------------------


def example(seed: int, noise_seed: int, runs: int, steps: int, disturbance: Mapping[str, float]) -> dict[str, Any]:
    """The system of a seed without and with disturbance: its first run, and RMSE over all runs.

    Returns:
        ``x (T, n)``, ``outlier (T,)``; for each filter a mapping with ``clean`` and ``disturbed (T, n)`` estimates,
        their ``rmse`` and ``disturbed_rmse (T,)``, and from the run without disturbance ``variance (T, n)`` and
        ``gain (T, 2)``, the extreme singular values of ``K = P+ C' R^-1``; ``correction (T,)`` per innovation,
        ``|K e| / |e|``, from the run with disturbance; ``printed`` and ``steady``, see `printed_difference` and
        `steady_state`.
    """
    model = discretised([draw(seed)])
    clean, disturbed = (
        simulate(model, model, condition, steps, runs, noise_seed)
        for condition in (Condition(), Condition(**disturbance))
    )
    x, outlier = clean.x[:, 0, 0], (clean.y != disturbed.y).any(-1)[:, 0, 0]
    found: dict[str, Any] = {"x": x, "outlier": outlier.astype(float)}
    for name in settings.FILTERS:
        free, hit = (list(track(name, model, record.y)) for record in (clean, disturbed))
        gains = [after.cov[0, 0] @ model.C[0, 0].T @ np.linalg.inv(model.R) for _, after in free]
        moved = [
            np.linalg.norm((after.mean - before.mean)[0, 0]) / np.linalg.norm((y - before.mean @ model.C[0, 0].T)[0, 0])
            for (before, after), y in zip(hit, disturbed.y, strict=True)
        ]
        found[name] = {
            "clean": np.array([after.mean[0, 0] for _, after in free]),
            "disturbed": np.array([after.mean[0, 0] for _, after in hit]),
            "rmse": _rmse_over_runs(free, clean.x),
            "disturbed_rmse": _rmse_over_runs(hit, disturbed.x),
            "variance": np.array([np.diagonal(after.cov[0, 0]) for _, after in free]),
            "gain": np.linalg.svd(gains, compute_uv=False),
            "correction": np.array(moved),
        }
    kf = [after.mean[0, 0] for _, after in track("kf", model, clean.y[:, :, :1])]
    return found | {"printed": printed_difference(model, clean.y[:, 0, 0], np.array(kf)), "steady": steady_state(model)}


def _rmse_over_runs(beliefs: Iterable[tuple[Belief, Belief]], x: np.ndarray) -> np.ndarray:
    return np.sqrt([((after.mean - state) ** 2).sum(-1).mean() for (_, after), state in zip(beliefs, x, strict=True)])


def printed_difference(model: StateSpace, y: np.ndarray, kf: np.ndarray) -> float:
    """Largest difference of the algorithm as printed, eqs (6) to (9) and the summary of step 4, from ``kf (T, n)``."""
    A, B, C, Q, R = model.A[0, 0], model.B[0, 0], model.C[0, 0], model.Q[0, 0], model.R
    x, P = np.zeros(len(A)), settings.PRIOR_VARIANCE * np.eye(len(A))
    largest = 0.0
    for k, reading in enumerate(y):
        K = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
        x, P = x + K @ (reading - C @ x), (np.eye(len(A)) - K @ C) @ P
        largest = max(largest, float(np.abs(x - kf[k]).max()))
        x, P = A @ x + B @ known_input(k), A @ P @ A.T + Q
    return largest


def steady_state(model: StateSpace) -> dict[str, float]:
    """Eqs (11) to (14) put to the test on one system, as norms relative to that of the covariance in each.

    Returns:
        ``printed_11`` and ``corrected_11``: residual of eq. (11) at the solution of the Riccati equation, as printed
        and with the missing A; ``printed_14``: residual of eq. (14) where eq. (12) holds; ``growth``: how much
        more variance eq. (12) has than the Riccati equation.
    """
    A, C, Q, R = model.A[0, 0], model.C[0, 0], model.Q[0, 0], model.R
    P = solve_discrete_are(A.T, C.T, Q, R)
    S = C @ P @ C.T + R
    K = P @ C.T @ np.linalg.inv(S)
    free = solve_discrete_lyapunov(A, Q)
    K_free = free @ C.T @ np.linalg.inv(C @ free @ C.T + R)

    def residual(difference: np.ndarray, cov: np.ndarray) -> float:
        return float(np.linalg.norm(difference) / np.linalg.norm(cov))

    return {
        "printed_11": residual(A @ P @ A.T + Q - K @ S @ K.T - P, P),
        "corrected_11": residual(A @ P @ A.T + Q - A @ K @ S @ K.T @ A.T - P, P),
        "printed_14": residual(K_free @ C @ free, free),
        "growth": float(np.trace(free) / np.trace(P)),
    }


# --- cells ------------------------------------------------------------------------------------------


def _study() -> dict[str, tuple[Condition, ...]]:
    """The conditions of every population, each once."""
    everything = dict.fromkeys(c for group in (*settings.SWEEPS.values(), *settings.CROSSED.values()) for c in group)
    return {
        settings.RANDOM: tuple(everything),
        settings.PAPER: tuple(everything),
        settings.ONE_READING: settings.ALONE,
    }


def _cell_name(population: str, condition: Condition) -> str:
    what = ", ".join(f"{key} {value:g}" for key, value in condition._asdict().items())
    return f"{population}: {what}"


def cells() -> dict[str, Cell]:
    """Everything to compute, by name."""
    found = {
        "example": Cell(
            f"{__name__}:example",
            {
                "seed": settings.PAPER_SEED,
                "noise_seed": settings.NOISE_SEED,
                "runs": settings.POPULATIONS[settings.PAPER].runs,
                "steps": settings.STEPS,
                "disturbance": settings.DISTURBANCE._asdict(),
            },
            "robust, figures 1 to 5",
        )
    }
    for population, conditions in _study().items():
        which = settings.POPULATIONS[population]
        for condition in conditions:
            found[_cell_name(population, condition)] = Cell(
                f"{__name__}:errors",
                {
                    "seeds": list(which.seeds),
                    "readings": which.readings,
                    "runs": which.runs,
                    "noise_seed": settings.NOISE_SEED,
                    "steps": settings.STEPS,
                    "skipped": settings.SKIPPED,
                    "condition": condition._asdict(),
                },
                f"robust, {population}",
            )
    return found


# --- what the cells say -----------------------------------------------------------------------------

Results = Mapping[str, Mapping[str, Any]]
_ROBUST = tuple(name for name, (kind, _) in settings.FILTERS.items() if kind == "robust-kf")
_OTHERS = ("huber-kf", *_ROBUST)
_NOTHING = Condition()


def _rmse_of_units(results: Results, population: str, condition: Condition, name: str) -> np.ndarray:
    """RMSE of each unit of an interval: of every system over its runs, or of every run of the single system."""
    values = np.asarray(results[_cell_name(population, condition)][name])
    return values[0] if len(values) == 1 else np.sqrt(np.mean(values**2, axis=1))


def _log_ratio(results: Results, population: str, condition: Condition, name: str) -> Interval:
    """Mean logarithm of a filter's RMSE over that of the KF on the same readings, one unit a pair."""
    ours, kf = (np.log(_rmse_of_units(results, population, condition, filter)) for filter in (name, "kf"))
    return _known(paired_difference(ours, kf))


def _known(interval: Interval | None) -> Interval:
    assert interval is not None  # every population has at least two units
    return interval


def _ratio(results: Results, population: str, condition: Condition, name: str) -> Interval:
    """The geometric mean of a filter's RMSE over that of the KF."""
    return _exp(_log_ratio(results, population, condition, name))


def _exp(log: Interval) -> Interval:
    return Interval(*(float(np.exp(value)) for value in (log.mean, log.low, log.high)))


def _ratios(results: Results, condition: Condition, name: str, population: str = settings.RANDOM) -> np.ndarray:
    """Every unit's RMSE over that of the KF."""
    ours, kf = (_rmse_of_units(results, population, condition, filter) for filter in (name, "kf"))
    return ours / kf


def _words(ratio: Interval) -> str:
    return f"{number(ratio.mean, 3)} ± {number(ratio.half, 3)}"


# --- tables -----------------------------------------------------------------------------------------

_HEAD = [("KF, RMSE", ""), *((f"{name} / KF", "") for name in _OTHERS)]
_RATIO_NOTE = (
    "KF: geometric mean of the RMSE of the state vector, in units of the state, where a reading has σ = "
    "1. Others: geometric "
    "mean of the RMSE divided by that of the KF on the same readings, from the paired difference of "
    "logarithms, ± half of the "
    "95 % interval (Student's t). Bold: the interval excludes 1. "
)


def _ratio_table(
    results: Results,
    title: str,
    name: str,
    note: str,
    rows: Mapping[str, Sequence[tuple[str, Condition]]],
    populations: list[str],
) -> Table:
    """KF error and ratios; a section for every population and group of rows."""
    several = len(rows) > 1
    sections = [
        (
            settings.POPULATIONS[population].title + several * f"; {group}",
            [_row(results, population, *row) for row in named],
        )
        for population in populations
        for group, named in rows.items()
    ]
    return Table(title, _RATIO_NOTE + note, "condition", _HEAD, sections, name)


def _row(results: Results, population: str, label: str, condition: Condition) -> tuple[str, list[Entry]]:
    kf = np.exp(np.log(_rmse_of_units(results, population, condition, "kf")).mean())
    entries = [Entry(number(float(kf), 2))]
    for name in _OTHERS:
        entries.append(_ratio_entry(_ratio(results, population, condition, name)))
    return label, entries


def _ratio_entry(ratio: Interval) -> Entry:
    """Bold where the interval excludes 1."""
    sure = ratio.high < 1.0 or ratio.low > 1.0
    return Entry(number(ratio.mean, 3), number(ratio.half, 3), sure)


def _percent(value: float) -> str:
    return f"{100.0 * value:g} %"


def _outlier_table(results: Results) -> Table:
    rows = {
        f"outliers of {settings.OUTLIERS.size:g} σ": [
            (f"{_percent(c.rate)} of readings", c) for c in settings.SWEEPS["rate"]
        ],
        f"{_percent(settings.OUTLIERS.rate)} outliers": [(f"of {c.size:g} σ", c) for c in settings.SWEEPS["size"]],
    }
    return _ratio_table(results, "Outliers", "outliers", "", rows, [settings.RANDOM, settings.PAPER])


def _model_error_table(results: Results) -> Table:
    rows = {
        "least-favourable model": [(f"c = {c.tolerance:g}", c) for c in settings.SWEEPS["tolerance"]],
        "error of A": [(f"δ = {_percent(c.parameters)}", c) for c in settings.SWEEPS["parameters"]],
    }
    note = (
        "Least favourable: nature's noise is the worst for robust-kf within its ball of size c. δ: the "
        "true A is off by δ|A| "
        "(Frobenius norm) in a random direction, drawn again where the true system would not be stable."
    )
    return _ratio_table(results, "Model error", "model-error", note, rows, [settings.RANDOM, settings.PAPER])


_MODEL_ERRORS = {
    "least-favourable model": f"least-favourable model, c = {settings.LEAST_FAVOURABLE.tolerance:g}",
    "parameter error": f"A off by δ = {_percent(settings.PARAMETERS.parameters)}",
}


def _crossed_table(results: Results) -> Table:
    rows = {
        _MODEL_ERRORS[name]: [(f"{_percent(c.rate)} outliers", c) for c in conditions]
        for name, conditions in settings.CROSSED.items()
    }
    note = f"Outliers of {settings.OUTLIERS.size:g} σ."
    return _ratio_table(results, "Both at once", "both", note, rows, [settings.RANDOM, settings.PAPER])


def _one_reading_table(results: Results) -> Table:
    rows = {"two readings or one": list(zip(_ALONE, settings.ALONE, strict=True))}
    populations = [settings.RANDOM, settings.ONE_READING]
    title = "The same systems with two readings and with the first alone"
    return _ratio_table(results, title, "one-reading", "", rows, populations)


_ALONE = (
    "nothing wrong",
    f"{_percent(settings.OUTLIERS.rate)} outliers of {settings.OUTLIERS.size:g} σ",
    f"A off by {_percent(settings.PARAMETERS.parameters)}",
)
_SHOWN = (_NOTHING, settings.OUTLIERS, settings.LEAST_FAVOURABLE, settings.PARAMETERS)
_SHOWN_TITLES = (
    "nothing wrong",
    f"{_percent(settings.OUTLIERS.rate)} outliers of {settings.OUTLIERS.size:g} σ",
    f"least favourable, c = {settings.LEAST_FAVOURABLE.tolerance:g}",
    f"A off by {_percent(settings.PARAMETERS.parameters)}",
)


def _spread_table(results: Results) -> Table:
    sections = []
    for title, condition in zip(_SHOWN_TITLES, _SHOWN, strict=True):
        rows = []
        for name in _OTHERS:
            ratios = _ratios(results, condition, name)
            quantiles = np.quantile(ratios, (0.0, 0.1, 0.5, 0.9, 1.0))
            share = 100.0 * float((ratios < 1.0).mean())
            rows.append((name, [Entry(number(share, 0)), *(Entry(number(float(q), 2)) for q in quantiles)]))
        sections.append((title, rows))
    head = [
        ("systems below the KF", "%"), ("best", ""), ("10 %", ""), ("median", ""), ("90 %", ""), ("worst", "")
    ]  # fmt: skip
    note = (
        f"RMSE over that of the KF in each of the {settings.POPULATIONS[settings.RANDOM].title}, "
        f"{settings.POPULATIONS[settings.RANDOM].runs} runs each: quantiles over the systems. The noise "
        f"of so few runs is in them."
    )
    return Table("System by system", note, "filter", head, sections, "systems")


# --- claims -----------------------------------------------------------------------------------------


def _verdict(ratios: Sequence[Interval]) -> str:
    """Whether every ratio is below 1: "true", "false" where one is above beyond chance, else "undecided"."""
    if all(ratio.high < 1.0 for ratio in ratios):
        return "true"
    below, above = sum(ratio.high < 1.0 for ratio in ratios), sum(ratio.low > 1.0 for ratio in ratios)
    counts = f"below in {below} and above in {above} of {len(ratios)}"
    return f"false, {counts}" if above else f"undecided, {counts}"


def _lower(results: Results, text: str, name: str, sweep: Sequence[tuple[str, Condition]]) -> Claim:
    """The claim that a filter has less error than the KF in every condition, over the random systems."""
    ratios = [_ratio(results, settings.RANDOM, condition, name) for _, condition in sweep]
    evidence = "; ".join(f"{label}: {_words(ratio)}" for (label, _), ratio in zip(sweep, ratios, strict=True))
    return Claim(text, _verdict(ratios), evidence)


def _labelled(key: str, form: Callable[[float], str]) -> list[tuple[str, Condition]]:
    """The conditions of a sweep in which something is wrong, with a label each."""
    return [(form(getattr(c, key)), c) for c in settings.SWEEPS[key] if getattr(c, key)]


def _claims(results: Results) -> list[Claim]:
    rates, sizes = _labelled("rate", _percent), _labelled("size", "{:g} σ".format)
    tolerances, parameters = _labelled("tolerance", "c {:g}".format), _labelled("parameters", _percent)
    found = [
        _printed_claim(results),
        _lower(results, "Under outliers of 10 σ huber-kf has less error than the KF at every rate.", "huber-kf", rates),
        _lower(results, "At 10 % outliers huber-kf has less error than the KF at every size.", "huber-kf", sizes),
    ]
    for name in _ROBUST:
        found += [
            _lower(results, f"Under the least-favourable model {name} has less error than the KF.", name, tolerances),
            _lower(results, f"With errors of A {name} has less error than the KF.", name, parameters),
            _lower(results, f"Under outliers {name} has less error than the KF.", name, rates),
        ]
    found += [
        _lower(results, "With errors of A huber-kf has less error than the KF.", "huber-kf", parameters),
        *_cost_claims(results),
        *_crossed_claims(results),
        _consistency_claim(results),
    ]
    return found


def _printed_claim(results: Results) -> Claim:
    return Claim(
        "The algorithm that the paper prints as RKF has less error than the KF.",
        "false, it is the KF",
        f"eqs (6) to (9) and the summary of step 4, as printed, differ from our KF by at most "
        f"{results['example']['printed']:.0e} over {settings.STEPS} readings",
    )


def _cost_claims(results: Results) -> list[Claim]:
    """What each filter costs where nothing is wrong."""
    found = []
    for name in _OTHERS:
        ratio = _ratio(results, settings.RANDOM, _NOTHING, name)
        verdict = "false" if ratio.low > 1.0 else "true" if ratio.high < 1.0 else "undecided"
        found.append(Claim(f"Where nothing is wrong {name} costs nothing.", verdict, f"RMSE / KF {_words(ratio)}"))
    return found


def _crossed_claims(results: Results) -> list[Claim]:
    found = []
    for name, conditions in settings.CROSSED.items():
        sweep = [(f"{_percent(c.rate)} outliers", c) for c in conditions if c.rate]
        found += [
            _lower(
                results, f"With outliers and {_MODEL_ERRORS[name]}, {filter} has less error than the KF.", filter, sweep
            )
            for filter in ("huber-kf", _ROBUST[0])
        ]
    return found


def _consistency_claim(results: Results) -> Claim:
    """The paper's word "consistently", taken system by system."""
    shares = {
        f"{name}, {title}": float((_ratios(results, condition, name) < 1.0).mean())
        for title, condition, names in (
            (_SHOWN_TITLES[1], settings.OUTLIERS, ("huber-kf",)),
            (_SHOWN_TITLES[2], settings.LEAST_FAVOURABLE, _ROBUST),
            (_SHOWN_TITLES[3], settings.PARAMETERS, _ROBUST),
        )
        for name in names
    }
    everywhere = [label for label, share in shares.items() if share == 1.0]
    verdict = (
        "true" if len(everywhere) == len(shares) else "false" + (f", only {listed(everywhere)}" if everywhere else "")
    )
    evidence = "systems with less error than the KF: " + "; ".join(f"{k}: {100 * v:.0f} %" for k, v in shares.items())
    return Claim("“RKF consistently gives lower errors” on its own ground: in every system drawn.", verdict, evidence)


def _figure_claims(results: Results) -> list[Claim]:
    """What the paper reads off its figures, on the system in its place; the printed algorithm is our kf."""
    kf = results["example"]["kf"]
    rmse, gain, variance = (np.asarray(kf[key]) for key in ("rmse", "gain", "variance"))
    runs = settings.POPULATIONS[settings.PAPER].runs
    settled = float(np.sqrt(np.mean(rmse[settings.SKIPPED :] ** 2)))
    start = np.sqrt(settings.PRIOR_VARIANCE * settings.STATES)
    after = settings.SKIPPED * settings.STEP
    affected = {}
    for name in settings.FILTERS:
        hit, free = (
            np.log(_rmse_of_units(results, settings.PAPER, condition, name))
            for condition in (settings.DISTURBANCE, _NOTHING)
        )
        affected[name] = _exp(_known(paired_difference(hit, free)))
    unmoved = [name for name, ratio in affected.items() if ratio.low <= 1.0]
    return [
        Claim(
            "The estimates approach the true states with time (figures 1, 2).",
            "true" if settled < rmse[0] < start else "false",
            f"RMSE of {runs} runs: {start:.2f} before any reading, {rmse[0]:.2f} after the first, {settled:.2f} from "
            f"{after:g} s on",
        ),
        Claim(
            "The gain is large at first and settles (figure 3).",
            "true" if gain[0, 0] > gain[-1, 0] else "false",
            f"largest singular value {gain[0, 0]:.2f} at the first reading, {gain[-1, 0]:.2f} at the last",
        ),
        Claim(
            "The diagonal of the error covariance falls (figure 4).",
            "true" if (variance[-1] < variance[0]).all() else "false",
            f"from {_pair(variance[0])} after the first reading to {_pair(variance[-1])} after the last",
        ),
        Claim(
            "Disturbance does not keep the estimates from the true states (figure 5).",
            "true" if len(unmoved) == len(affected) else "false" + (f", but for {listed(unmoved)}" if unmoved else ""),
            "RMSE with disturbance over without: "
            + "; ".join(f"{name} {number(r.mean, 2)} ± {number(r.half, 2)}" for name, r in affected.items()),
        ),
    ]


def _pair(values: np.ndarray) -> str:
    return listed([f"{value:.2f}" for value in values])


# --- figures ----------------------------------------------------------------------------------------

_COLOURS = dict(zip(("kf", *_OTHERS), (INK, BELIEVED, PALETTE[5], TRUE), strict=True))
_MARKERS = dict(zip(("kf", *_OTHERS), ("", "s", "^", "o"), strict=True))
_TICKS = (0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.2, 1.5, 2.0)


def _ratio_axis(panel: "Axes", ticks: Sequence[float] = _TICKS) -> None:
    """A logarithmic axis of ratios with 1 drawn."""
    from matplotlib.ticker import NullFormatter, NullLocator

    panel.set_yscale("log")
    panel.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    panel.yaxis.set_minor_locator(NullLocator())
    panel.yaxis.set_minor_formatter(NullFormatter())
    panel.axhline(1.0, color=INK, linewidth=0.9)
    panel.grid()


def _sweep(panel: "Axes", results: Results, conditions: Sequence[Condition], labels: Sequence[str]) -> None:
    """Ratios with bands over a sweep, its conditions side by side; the single system as open markers."""
    places = np.arange(len(conditions))
    for name in _OTHERS:
        ratios = [_ratio(results, settings.RANDOM, condition, name) for condition in conditions]
        low, mean, high = (np.array([getattr(ratio, end) for ratio in ratios]) for end in ("low", "mean", "high"))
        panel.fill_between(places, low, high, color=_COLOURS[name], alpha=0.22, linewidth=0.0)
        panel.plot(places, mean, color=_COLOURS[name], marker=_MARKERS[name], markersize=4, label=name)
        single = [_ratio(results, settings.PAPER, condition, name).mean for condition in conditions]
        panel.plot(
            places, single, color=_COLOURS[name], marker=_MARKERS[name], markersize=4, markerfacecolor="white",
            linestyle=":", linewidth=0.8,
        )  # fmt: skip
    panel.set_xticks(places, labels)
    _ratio_axis(panel)


def _sweep_figure(results: Results) -> Figure:
    from matplotlib.figure import Figure as Canvas

    axes: tuple[tuple[str, str, Callable[[float], str]], ...] = (
        ("rate", f"outliers of {settings.OUTLIERS.size:g} σ [% of readings]", lambda v: f"{100 * v:g}"),
        ("size", f"size of {_percent(settings.OUTLIERS.rate)} outliers [σ]", "{:g}".format),
        ("tolerance", "tolerance c of the least-favourable model", "{:g}".format),
        ("parameters", "error of A [% of |A|]", lambda v: f"{100 * v:g}"),
    )
    with styled():
        canvas = Canvas(figsize=(7.2, 5.6), layout="constrained")
        panels = canvas.subplots(2, 2, sharey="row")
        for panel, (key, label, form), title in zip(
            panels.flat, axes, ("(a) how many outliers", "(b) how large", "(c) worst noise", "(d) wrong A"), strict=True
        ):
            conditions = settings.SWEEPS[key]
            _sweep(panel, results, conditions, [form(getattr(c, key)) for c in conditions])
            panel.set_xlabel(label)
            panel.set_title(title, loc="left")
        for row in panels:
            row[0].set_ylabel("RMSE / RMSE of the KF")
        panels[0, 0].set_ylim(0.18, 2.05)
        panels[1, 0].set_ylim(0.94, 1.32)
        for panel in panels[1]:
            _ratio_axis(panel, (0.95, 1.0, 1.05, 1.1, 1.2, 1.3))
        canvas.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
        image = data_uri(canvas)
    return Figure(
        image,
        "Error relative to the KF, one thing wrong at a time",
        "Below the line at 1 a filter beats the KF. Filled: geometric mean over 200 random systems with "
        "its 95 % band. "
        "Open, dotted: the single system in the paper's place. The two rows have different scales.",
    )


def _crossed_figure(results: Results) -> Figure:
    from matplotlib.figure import Figure as Canvas

    with styled():
        canvas = Canvas(figsize=(7.2, 3.2), layout="constrained")
        panels = canvas.subplots(1, len(settings.CROSSED), sharey=True)
        for panel, (name, conditions) in zip(panels, settings.CROSSED.items(), strict=True):
            _sweep(panel, results, conditions, [f"{100 * c.rate:g}" for c in conditions])
            panel.set_title(_MODEL_ERRORS[name], loc="left")
            panel.set_xlabel(f"outliers of {settings.OUTLIERS.size:g} σ [% of readings]")
        panels[0].set_ylabel("RMSE / RMSE of the KF")
        canvas.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
        image = data_uri(canvas)
    return Figure(image, "Both at once", "As before: outliers on top of a model error.")


def _systems_figure(results: Results) -> Figure:
    from matplotlib.figure import Figure as Canvas

    with styled():
        canvas = Canvas(figsize=(7.2, 2.9), layout="constrained")
        panels = canvas.subplots(1, len(_SHOWN), sharey=True)
        for panel, condition, title in zip(panels, _SHOWN, _SHOWN_TITLES, strict=True):
            for name in _OTHERS:
                ratios = np.sort(_ratios(results, condition, name))
                panel.plot(
                    100.0 * (np.arange(len(ratios)) + 0.5) / len(ratios), ratios, color=_COLOURS[name], label=name
                )
            _ratio_axis(panel, (0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0))
            panel.set_ylim(0.3, 5.0)
            panel.set_xticks((0, 50, 100))
            panel.set_title(title, loc="left", fontsize=9)
        panels[0].set_ylabel("RMSE / RMSE of the KF")
        canvas.supxlabel("share of systems with at most this ratio [%]", fontsize=10)
        canvas.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
        image = data_uri(canvas)
    return Figure(
        image,
        "System by system",
        "The 200 systems in the order of their ratio: where a curve crosses 1, the filter stops winning. Cut off at 5.",
    )


@cache
def _traits() -> dict[str, np.ndarray]:
    """Of every random system: how well the readings show their weakest direction, and how sure its prediction is."""
    weakest, doubt = [], []
    for seed in settings.POPULATIONS[settings.RANDOM].seeds:
        model = discretised([draw(seed)])
        A, C, Q = model.A[0, 0], model.C[0, 0], model.Q[0, 0]
        P = solve_discrete_are(A.T, C.T, Q, model.R)
        weakest.append(np.linalg.svd(C, compute_uv=False)[-1])
        doubt.append(np.trace(C @ P @ C.T) / np.trace(model.R))
    return {"weakest": np.array(weakest), "doubt": np.array(doubt)}


_WHERE = (
    ("huber-kf", settings.OUTLIERS, "doubt", "variance of the prediction / of the reading"),
    (_ROBUST[1], _NOTHING, "weakest", "smallest singular value of C"),
)
"""Filter, condition, trait of the system and its label: what explains where each filter gains or loses."""


def _halves_table(results: Results) -> Table:
    """Ratios in the systems whose readings show their weakest direction better, and worse, than the median's do."""
    weakest = _traits()["weakest"]
    shown = weakest > np.median(weakest)
    sections = []
    for half, title in ((shown, "weakest direction shown better than the median"), (~shown, "shown worse")):
        rows = []
        for label, condition in zip(_SHOWN_TITLES, _SHOWN, strict=True):
            entries = []
            for name in _OTHERS:
                ratio = _exp(_known(mean_interval(np.log(_ratios(results, condition, name)[half]))))
                entries.append(_ratio_entry(ratio))
            rows.append((label, entries))
        sections.append((title, rows))
    note = (
        "RMSE over that of the KF, as before, with the random systems split at the median of the "
        "smallest singular value "
        "of C. The split was made after the results were seen: it explains, it does not confirm."
    )
    head = [(f"{name} / KF", "") for name in _OTHERS]
    return Table("By how well the readings show the state", note, "condition", head, sections, "halves")


def _rank_correlation(results: Results, name: str, condition: Condition, trait: str) -> float:
    return _spearman(_traits()[trait], _ratios(results, condition, name))


def _hurt_by_outliers(results: Results) -> np.ndarray:
    """By what factor outliers raise the error of the KF in every random system."""
    hit, free = (_rmse_of_units(results, settings.RANDOM, c, "kf") for c in (settings.OUTLIERS, _NOTHING))
    return hit / free


def _spearman(a: np.ndarray, b: np.ndarray) -> float:
    from scipy.stats import spearmanr

    return float(spearmanr(a, b).statistic)


def _traits_figure(results: Results) -> Figure:
    from matplotlib.figure import Figure as Canvas

    traits = _traits()
    with styled():
        canvas = Canvas(figsize=(7.2, 2.9), layout="constrained")
        panels = canvas.subplots(1, 2)
        for panel, (name, condition, trait, label) in zip(panels, _WHERE, strict=True):
            ratios = _ratios(results, condition, name)
            panel.scatter(traits[trait], ratios, s=9, color=_COLOURS[name], alpha=0.6, linewidths=0.0)
            panel.set_xscale("log")
            _ratio_axis(panel, (0.3, 0.4, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0))
            panel.set_ylim(0.9 * ratios.min(), 1.1 * ratios.max())
            panel.set_xlabel(label)
            panel.set_title(f"{name}: {_SHOWN_TITLES[_SHOWN.index(condition)]}", loc="left")
        panels[0].set_ylabel("RMSE / RMSE of the KF")
        image = data_uri(canvas)
    return Figure(
        image,
        "What makes the difference",
        "Each dot is a random system, as measured; rank correlations stand above.",
    )


_DRAWN = ("kf", "huber-kf", _ROBUST[1])
"""Filters in the figures of the single system."""


def _time() -> np.ndarray:
    return settings.STEP * np.arange(settings.STEPS)


def _estimates_figure(results: Results, truth: bool) -> Figure:
    from matplotlib.figure import Figure as Canvas

    example, t = results["example"], _time()
    x = np.asarray(example["x"])
    with styled():
        canvas = Canvas(figsize=(7.2, 3.4), layout="constrained")
        panels = canvas.subplots(settings.STATES, 1, sharex=True)
        for i, panel in enumerate(panels):
            if truth:
                panel.plot(t, x[:, i], color=RAW, linewidth=2.6, label="true")
            for name, line in zip(_DRAWN, ("-", "--", "-."), strict=True):
                panel.plot(
                    t, np.asarray(example[name]["clean"])[:, i], line, color=_COLOURS[name], linewidth=0.9, label=name
                )
            panel.set_ylabel(f"$x_{i + 1}$")
            panel.set_title(f"({'ab'[i]})", loc="left")
            panel.margins(x=0.01)
            panel.grid()
        panels[-1].set_xlabel("time [s]")
        canvas.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=4)
        image = data_uri(canvas)
    if truth:
        return Figure(
            image, "The paper's figure 2: estimates with the true states", "One run; x in units of the state."
        )
    return Figure(
        image, "The paper's figure 1: estimates of both states", "One run without disturbance; x in units of the state."
    )


def _gain_figure(results: Results) -> Figure:
    from matplotlib.figure import Figure as Canvas

    example, t = results["example"], _time()
    with styled():
        canvas = Canvas(figsize=(7.2, 3.0), layout="constrained")
        panel = canvas.subplots()
        for name in ("kf", _ROBUST[1]):
            gain = np.asarray(example[name]["gain"])
            panel.fill_between(t, gain[:, 1], gain[:, 0], color=_COLOURS[name], alpha=0.15, linewidth=0.0)
            panel.plot(t, gain[:, 0], color=_COLOURS[name], label=name)
            panel.plot(t, gain[:, 1], color=_COLOURS[name])
        moved, outlier = (np.asarray(values) for values in (example["huber-kf"]["correction"], example["outlier"]))
        hit = outlier > 0.0
        panel.plot(t[~hit], moved[~hit], "s", color=_COLOURS["huber-kf"], markersize=2.5, label="huber-kf, |K e| / |e|")
        panel.plot(t[hit], moved[hit], "x", color=PALETTE[6], markersize=5, label="huber-kf, at an outlier")
        panel.set_yscale("log")
        panel.set_xlabel("time [s]")
        panel.set_ylabel("gain [state / reading]")
        panel.margins(x=0.01)
        panel.grid()
        canvas.legend(*panel.get_legend_handles_labels(), loc="outside upper right", ncols=4)
        image = data_uri(canvas)
    return Figure(
        image,
        "The paper's figure 3: the gain",
        "Bands: from the smallest to the largest singular value of K, which bound |K e| / |e|; they do "
        "not depend on the "
        "readings. huber-kf weighs every reading: its |K e| / |e| in the run with disturbance lies in "
        "the band of the KF "
        "or under it, low at most outliers.",
    )


def _covariance_figure(results: Results) -> Figure:
    from matplotlib.figure import Figure as Canvas

    example, t = results["example"], _time()
    with styled():
        canvas = Canvas(figsize=(7.2, 2.7), layout="constrained")
        panels = canvas.subplots(1, settings.STATES, sharey=True)
        for i, panel in enumerate(panels):
            for name in reversed(_DRAWN):
                panel.plot(t, np.asarray(example[name]["variance"])[:, i], color=_COLOURS[name], label=name)
            panel.set_yscale("log")
            panel.set_yticks((0.2, 0.5, 1.0, 2.0, 5.0), ["0.2", "0.5", "1", "2", "5"])
            panel.minorticks_off()
            panel.set_title(f"variance of $x_{i + 1}$", loc="left")
            panel.set_xlabel("time [s]")
            panel.grid()
        panels[0].set_ylabel("P after the reading [state²]")
        canvas.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
        image = data_uri(canvas)
    return Figure(
        image,
        "The paper's figure 4: diagonal of the error covariance",
        f"From {settings.PRIOR_VARIANCE:g} before the first reading. huber-kf's grows a little with "
        f"every reading it doubts; "
        "robust-kf's is the least-favourable one, larger by design.",
    )


def _disturbance_figure(results: Results) -> Figure:
    from matplotlib.figure import Figure as Canvas

    example, t = results["example"], _time()
    x, hit = np.asarray(example["x"])[:, 0], np.asarray(example["outlier"]) > 0.0
    with styled():
        canvas = Canvas(figsize=(7.2, 4.4), layout="constrained")
        panels = canvas.subplots(len(_DRAWN), 1, sharex=True, sharey=True)
        for panel, name in zip(panels, _DRAWN, strict=True):
            panel.plot(t, x, color=RAW, linewidth=2.2, label="true")
            panel.plot(t, np.asarray(example[name]["clean"])[:, 0], color=TRUE, label="estimate without disturbance")
            panel.plot(
                t, np.asarray(example[name]["disturbed"])[:, 0], color=BELIEVED, label="estimate with disturbance"
            )
            panel.set_title(name, loc="left")
            panel.set_ylabel("$x_1$")
            panel.margins(x=0.01)
            panel.grid()
            floor = panel.get_ylim()[0]
            panel.plot(t[hit], np.full(hit.sum(), floor), "|", color=INK, markersize=7, clip_on=False, label="outlier")
        panels[-1].set_xlabel("time [s]")
        canvas.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=4)
        image = data_uri(canvas)
    return Figure(
        image,
        "The paper's figure 5: estimates with and without disturbance",
        f"One run, the same noise in both: {_percent(settings.DISTURBANCE.rate)} of the readings have "
        f"{settings.DISTURBANCE.size:g} times the noise.",
    )


# --- the page ---------------------------------------------------------------------------------------


def page(results: Results) -> Page:
    """The page, from the values of every cell under the same names."""
    return Page(
        settings.TITLE,
        f"{settings.JOURNAL}: the figures of its random two-state system, and its claim over "
        f"{settings.POPULATIONS[settings.RANDOM].title}",
        _answer(results),
        [
            Section("The paper's claims", [Claims(_claims(results), _CLAIMS_NOTE)]),
            Section("What the paper prints, and what we assumed", [Prose(_NO_NUMBERS), _assumptions()]),
            Section("The paper's figures", _paper_figures(results)),
            Section("Outliers and model error", [
                _sweep_figure(results), _outlier_table(results), _model_error_table(results)
            ]),
            Section("Both at "
            "once", [Prose(_crossed_words(results)), _crossed_figure(results), _crossed_table(results)]),
            Section("Where each of them loses", [
                _systems_figure(results), _spread_table(results), Prose(_where_words(results)),
                _traits_figure(results), _halves_table(results),
                _one_reading_table(results),
            ]),
            Section("Misprints", [Prose(_steady_words(results)), Bullets(list(settings.MISPRINTS))]),
        ],
    )  # fmt: skip


def _paper_figures(results: Results) -> list[Any]:
    table = Table(
        "The paper's figures beside ours",
        "The paper prints curves without a number that could be set beside ours; only their shape compares.",
        "figure",
        [("shows", ""), ("verdict", "")],
        [("", [(name, [Entry(what), Entry("not comparable: no number is printed; shape as below")])
               for name, what in settings.FIGURES.items()])],
    )  # fmt: skip
    return [
        table,
        Claims(_figure_claims(results), "On the system of the stated seed; its KF is the printed algorithm."),
        _estimates_figure(results, truth=False),
        _estimates_figure(results, truth=True),
        _gain_figure(results),
        _covariance_figure(results),
        _disturbance_figure(results),
    ]


_CLAIMS_NOTE = (
    "RMSE over that of the KF, geometric mean over 200 random systems with 95 % interval. True: below 1 in every "
    "condition named. False: above 1 in at least one, beyond chance. Undecided: neither. Costs nothing: not above 1."
)
_NO_NUMBERS = (
    "The paper prints no matrix, no step, no seed and no table of results, so that no number of ours "
    "can be set beside one "
    "of its own; only the shape of its five figures can. The algorithm that it prints is the plain "
    "Kalman filter. Huber's "
    "loss stands in its text alone, and model uncertainty in its title: we take huber-kf for the one "
    "and robust-kf (Levy and "
    "Nikoukhah 2013, Zorzi 2017) for the other."
)


def _assumptions() -> Facts:
    low, high = settings.INTENSITY
    random = settings.POPULATIONS[settings.RANDOM]
    return Facts(
        "Ours, fixed before the runs reported here",
        [
            ("system", settings.RECIPE),
            ("margin", f"uniform from {settings.MARGIN[0]:g} to {settings.MARGIN[1]:g} 1/s: stable, "
            f"memory of 1 to 10 s"),
            ("process noise", f"white, intensity q I, q log-uniform from {low:g} to {high:g} 1/s"),
            ("reading noise", f"variance {settings.READING_VARIANCE:g}, independent: the unit of y"),
            ("start", f"mean 0, variance {settings.PRIOR_VARIANCE:g} of each state, for truth and filters alike"),
            ("known input", f"square wave ±1, period {settings.INPUT_PERIOD * settings.STEP:g} s"),
            ("discretisation", f"exact (Van Loan 1978), step {settings.STEP:g} s, {settings.STEPS} steps"),
            ("errors count", f"after {settings.SKIPPED * settings.STEP:g} s, when the start is forgotten"),
            ("seeds", f"paper's place {settings.PAPER_SEED}; others {random.seeds[0]} to {random.seeds[-1]}; noise "
             f"{settings.NOISE_SEED}, the same in every condition"),
            ("huber-kf", f"γ = {settings.HUBER_THRESHOLD:g}: 95 % of the efficiency of least squares on "
            f"Gaussian noise"),
            ("robust-kf", f"c = {settings.TOLERANCES[0]:g}, the package's default, and c = "
            f"{settings.TOLERANCES[1]:g}; at "
             "each step a mean off by √c standard deviations: meant for errors of A of some 12 % and 40 %"),
            ("two readings", "the paper calls y a vector. A trial with one reading came first; "
            "robust-kf fared so ill in "
             "it, with nothing wrong, that the study uses two and shows the trial at the end. It also "
             "led us to add the "
             "smaller c"),
            ("least-favourable model", "nature plans its noise to the end of the run, against robust-kf "
            "of the same c "
             "that sees no outlier; the start is left as the prior has it"),
        ],
    )  # fmt: skip


def _answer(results: Results) -> list[str]:
    huber, small, large = (_Effects.of(results, name) for name in _OTHERS)
    largest = _percent(_LARGEST_ERROR.parameters)
    outliers = f"{_percent(settings.OUTLIERS.rate)} of the readings off by {settings.OUTLIERS.size:g} σ"
    return [
        "The filter that the paper prints is the Kalman filter and gains nothing; of the two filters that its words "
        f"describe, huber-kf {_pays(huber.outliers)} under outliers, the minimax filter robust-kf "
        f"{_pays(small.wrong)} with c = {settings.TOLERANCES[0]:g} and {_pays(large.wrong)} with "
        f"c = {settings.TOLERANCES[1]:g} under an error of A of {largest}, and none of them everywhere.",
        f"With {outliers} huber-kf has {_words(huber.outliers)} of the KF's error, geometric mean over 200 random "
        f"systems; it has {_words(huber.nothing)} of it where nothing is wrong and "
        f"{_words(huber.wrong)} where A is off "
        f"by {largest}.",
        f"robust-kf with c = {settings.TOLERANCES[0]:g} (with c = {settings.TOLERANCES[1]:g}) has "
        f"{_words(small.wrong)} "
        f"({_words(large.wrong)}) where A is off by {largest}, {_words(small.nothing)} "
        f"({_words(large.nothing)}) where "
        f"nothing is wrong, and {_words(small.outliers)} ({_words(large.outliers)}) under those outliers.",
        "The paper has no table of results, so that no number can be set beside ours; the shape of its figures can.",
    ]


_LARGEST_ERROR = settings.SWEEPS["parameters"][-1]


class _Effects(NamedTuple):
    """Ratios to the KF over the random systems."""

    nothing: Interval
    outliers: Interval
    wrong: Interval

    @classmethod
    def of(cls, results: Results, name: str) -> "_Effects":
        conditions = (_NOTHING, settings.OUTLIERS, _LARGEST_ERROR)
        return cls(*(_ratio(results, settings.RANDOM, condition, name) for condition in conditions))


def _pays(ratio: Interval) -> str:
    return "pays" if ratio.high < 1.0 else "loses" if ratio.low > 1.0 else "makes no certain difference"


def _crossed_words(results: Results) -> str:
    parts = []
    for name, conditions in settings.CROSSED.items():
        ratios = [_ratio(results, settings.RANDOM, c, "huber-kf") for c in conditions]
        better = [_percent(c.rate) for c, ratio in zip(conditions, ratios, strict=True) if ratio.high < 1.0]
        found = f"at {listed(better)} outliers" if better else "nowhere"
        parts.append(f"with the {name} {found}")
    return (
        "A large innovation is an outlier to huber-kf and a model error to robust-kf, and they draw "
        "opposite conclusions. "
        f"huber-kf has less error than the KF {listed(parts)}."
    )


def _where_words(results: Results) -> str:
    found = [
        f"{number(_rank_correlation(results, name, condition, trait), 2, signed=True)} between the ratio of {name} "
        f"({_SHOWN_TITLES[_SHOWN.index(condition)]}) and the {label}"
        for name, condition, trait, label in _WHERE
    ]
    hurt = _spearman(_traits()["doubt"], _hurt_by_outliers(results))
    return (
        f"Rank correlation (Spearman) over the random systems: {listed(found)}. The surer the prediction is, the less "
        "the KF heeds a reading, and the less the outliers harm it that huber-kf guards against: "
        "the correlation of that "
        f"variance and the factor by which they raise the error of the KF is {number(hurt, 2, signed=True)}. "
        "A relative-entropy ball acts at every step and enlarges most what the readings hardly show: there "
        "robust-kf costs most, even under the model that is least favourable to it, as the two tables below say."
    )


def _steady_words(results: Results) -> str:
    steady = results["example"]["steady"]
    return (
        "Those that matter to who implements the paper. Measured on the system in the paper's place: "
        "the solution of the "
        f"Riccati equation misses eq. (11) as printed by {100 * steady['printed_11']:.1f} % of its "
        f"norm, and with the "
        f"missing A by {steady['corrected_11']:.0e}; eq. (12) read literally gives "
        f"{steady['growth']:.1f} times its variance, and "
        f"eq. (14) is then off by {100 * steady['printed_14']:.0f} %."
    )
