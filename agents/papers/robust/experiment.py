"""The robust filters of Rudianto et al. (2024): the paper's figures, and a test of its claim.

The world is a random two-state system in continuous time, discretised exactly; the filters assume
it, and the condition says where the world differs. Matrices of a population of systems have the
leading axes (system, 1), runs (system, run).
"""

from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

from agents.page import text
from agents.papers.figures import figure, over_time, panels
from agents.papers.measures import Row, geometric
from estimators import Gaussian, LinearModel, Series, make, run, van_loan, zero_order_hold

STATES = MEASUREMENTS = 2  # x1 and x2 (figure 1); y is a vector (after eq. 4)
MARGIN = (0.1, 1.0)  # 1/s, decay rate of the slowest mode: stable, memory of 1 to 10 s
INTENSITY = (0.1, 10.0)  # 1/s, of the process noise, log-uniform
MEASUREMENT_VARIANCE = 1.0  # the unit of y
# of each state, mean 0: the filter knows little at first (on figures 3 and 4)
PRIOR_VARIANCE = 10.0
PRIOR = Gaussian(np.zeros(STATES), PRIOR_VARIANCE * np.eye(STATES))
"""The filters' first estimate."""
STEP = 0.1  # s
INPUT_PERIOD = 100  # steps of the square wave u, so that an error of A keeps mattering
# steps that nature plans beyond the last: near its end it would have nothing to anticipate
_HORIZON = 20


class Condition(NamedTuple):
    """Differences between the world and the filters' assumptions; none by default.

    Attributes:
        rate: Probability that a measurement is an outlier.
        size: Factor on the noise of an outlier.
        tolerance: c of the least-favourable model that the measurements come from.
        parameters: Relative error of A (Frobenius norm), in a direction of its own for every run.
    """

    rate: float = 0.0
    size: float = 10.0
    tolerance: float = 0.0
    parameters: float = 0.0


class Dynamics(NamedTuple):
    """``x' = A x + B u + w``, ``w`` white, intensity ``q I``; ``y = C x + v``, equal variances."""

    A: np.ndarray  # (n, n), 1/s
    B: np.ndarray  # (n, 1)
    C: np.ndarray  # (p, n)
    q: float  # 1/s


def draw(seed: int) -> Dynamics:
    """The random system of a seed; ``page.md`` has the recipe."""
    rng, n = np.random.default_rng(seed), STATES
    M, B, C = rng.normal(size=(n, n)), rng.normal(size=(n, 1)), rng.normal(size=(MEASUREMENTS, n))
    margin = rng.uniform(*MARGIN)
    q = np.exp(rng.uniform(*np.log(INTENSITY)))
    A = M - (growth(M) + margin) * np.eye(n)
    return Dynamics(A, B, C / np.linalg.norm(C, axis=1, keepdims=True), q)


def growth(A: np.ndarray) -> float:
    """Growth rate of the slowest mode, 1/s."""
    return float(np.linalg.eigvals(A).real.max())


def mistaken(system: Dynamics, error: float, rng: np.random.Generator) -> Dynamics:
    """The system with another A, off by ``error |A|`` in a random direction.

    Directions that leave the slowest mode less than half the smallest margin are drawn again: both
    worlds are stable.
    """
    while True:
        direction = rng.normal(size=system.A.shape)
        A = system.A + error * np.linalg.norm(system.A) / np.linalg.norm(direction) * direction
        if growth(A) <= -0.5 * MARGIN[0]:
            return system._replace(A=A)


def discretised(systems: Sequence[Dynamics], runs: int = 1) -> LinearModel:
    """Models of one step with leading axes ``(systems / runs, runs)``."""
    steps = []
    for A, B, C, q in systems:
        transition, noise = van_loan(A, np.eye(STATES), q * np.eye(STATES), STEP)
        steps.append((transition, C, noise, zero_order_hold(A, B, STEP)[1]))
    stacked = (np.array(matrices) for matrices in zip(*steps, strict=True))
    A, C, Q, B = (matrices.reshape(-1, runs, *matrices.shape[1:]) for matrices in stacked)
    return LinearModel(A, C, Q, MEASUREMENT_VARIANCE * np.eye(MEASUREMENTS), B)


def known_input(steps: int) -> np.ndarray:
    """The square wave u ``(T, 1)``."""
    return np.where(np.arange(steps) % INPUT_PERIOD < INPUT_PERIOD / 2, 1.0, -1.0)[:, None]


class LeastFavourable(NamedTuple):
    """The noise that hurts `robust-kf` most within its ball, over T steps.

    With its prediction error ``e`` and unit noise ``z = (w, v)``, ``x+ = A x + B u + W z``, ``y = C
    x + D z``, the error of the filter with gain G obeys ``e+ = F e + N z``, ``F = A - G C``, ``N =
    W - G D``. The least-favourable density is the nominal one times ``exp(theta |e+|^2 / 2)`` at
    every step. Later steps integrated out, last first::

        X = Omega+ + theta I     Z = (I - N' X N)^-1     Omega = F' (X + X N Z N' X) F
        z | e ~ N(Z N' X F e, Z)

    The first error is left as the prior has it. With tolerance 0 it is the model itself.

    Source: Levy & Nikoukhah (2013), sec. III and V.
    """

    shift: np.ndarray  # (T, ..., n + p, n) mean of z for an error e
    root: np.ndarray  # (T, ..., n + p, n + p) root of z's covariance
    error_map: np.ndarray  # (T, ..., n, n) F
    error_noise: np.ndarray  # (T, ..., n, n + p) N
    # (..., n, n) Omega_0: nature would start with covariance (V_0^-1 - Omega_0)^-1
    start_weight: np.ndarray
    claimed: np.ndarray  # (..., n, n) the filter's prediction covariance after the last step


def noise_roots(model: Any) -> tuple[np.ndarray, np.ndarray]:
    """W ``(..., n, n + p)`` and D ``(p, n + p)`` with ``W W' = Q``, ``D D' = R``, ``W D' = 0``."""
    W = np.concatenate([np.linalg.cholesky(model.Q), 0.0 * model.C.mT], axis=-1)
    return W, np.hstack([np.zeros((model.p, model.n)), np.linalg.cholesky(model.R)])


def least_favourable(model: Any, tolerance: float, steps: int) -> LeastFavourable:
    """The worst noise over a number of steps against ``robust-kf`` of that tolerance."""
    (W, D), A, C, eye = noise_roots(model), model.A, model.C, np.eye(model.n)
    unseen = np.zeros((steps + 1, *A.shape[:-2], model.p))
    V = track(model, unseen, "robust-kf", radius=tolerance).predicted.cov
    V, after = V[:-1], V[1:]
    G = A @ V @ C.mT @ np.linalg.inv(C @ V @ C.mT + model.R)
    F, N = A - G @ C, W - G @ D
    difference = np.linalg.inv(F @ V @ F.mT + N @ N.mT) - np.linalg.inv(after)  # theta I
    theta = np.trace(difference, axis1=-2, axis2=-1)[..., None, None] / model.n
    shift, omega, units = np.empty(N.mT.shape), np.zeros_like(eye), np.eye(model.n + model.p)
    root = np.empty((*N.shape[:-2], *units.shape))
    for k in range(steps)[::-1]:
        X = omega + theta[k] * eye
        Z = np.linalg.inv(units - N[k].mT @ X @ N[k])
        shift[k] = Z @ N[k].mT @ X @ F[k]
        root[k] = np.linalg.cholesky(Z)
        omega = F[k].mT @ (X + X @ N[k] @ Z @ N[k].mT @ X) @ F[k]
    return LeastFavourable(shift, root, F, N, omega, after[-1])


# --- runs -----------------------------------------------------------------------------------------


class Record(NamedTuple):
    """True states ``(T, ..., n)`` and measurements ``(T, ..., p)``."""

    x: np.ndarray
    y: np.ndarray


def simulate(
    model: Any, world: Any, condition: Condition, steps: int, runs: int, seed: int
) -> Record:
    """Runs of every system: measurements from the ``world``, its noise as the condition has it.

    A seed gives the underlying noise in every condition. Nature's error ``e`` is that of a filter
    which assumes the model and sees no outlier.
    """
    W, D = noise_roots(world)
    worst, u = least_favourable(model, condition.tolerance, steps + _HORIZON), known_input(steps)
    z_rng, outlier_rng = (np.random.default_rng([seed, stream]) for stream in range(2))
    batch = (len(model.A), runs)
    x = e = np.sqrt(PRIOR_VARIANCE) * z_rng.normal(size=(*batch, model.n))
    xs, ys = [], []
    for k in range(steps):
        unit = z_rng.normal(size=(*batch, model.n + model.p))
        z = np.matvec(worst.shift[k], e) + np.matvec(worst.root[k], unit)
        outlier = outlier_rng.random((*batch, model.p)) < condition.rate
        xs.append(x)
        ys.append(np.matvec(world.C, x) + np.where(outlier, condition.size, 1.0) * np.matvec(D, z))
        e = np.matvec(worst.error_map[k], e) + np.matvec(worst.error_noise[k], z)
        x = np.matvec(world.A, x) + np.matvec(world.B, u[k]) + np.matvec(W, z)
    return Record(np.array(xs), np.array(ys))


def track(model: Any, y: np.ndarray, kind: str, **options: Any) -> Series:
    """Beliefs of a filter before and after each measurement of ``y (T, systems, runs, p)``."""
    return run(make(kind, model, **options), PRIOR, y, known_input(len(y)))


def squared_errors(options: Mapping[str, Any], model: Any, record: Record) -> np.ndarray:
    """Squared error of the updated state at each time ``(T, systems, runs)``."""
    return np.square(track(model, record.y, **options).mean - record.x).sum(-1)


def rms_errors(
    settings: Mapping[str, Any], population: str, condition: Condition
) -> dict[str, np.ndarray]:
    """RMSE of the updated state by filter on the same measurements.

    It is that of every system over its runs ``(systems,)``, or of every run of the single system of
    a population ``(runs,)``.
    """
    of, seed = settings["populations"][population], settings["noise_seed"]
    first, systems, runs = (of[key] for key in ("first", "systems", "runs"))
    drawn = [draw(seed) for seed in range(first, first + systems)]
    model = world = discretised(drawn)
    if condition.parameters:
        rng = np.random.default_rng([seed, 2])
        off = [mistaken(s, condition.parameters, rng) for s in drawn for _ in range(runs)]
        world = discretised(off, runs)
    record = simulate(model, world, condition, settings["steps"], runs, seed)
    found = {}
    for name, options in settings["filters"].items():
        squares = squared_errors(options, model, record)[settings["skipped"] :].mean(0)
        found[name] = np.sqrt(squares[0] if systems == 1 else squares.mean(1))
    return found


# --- the paper's own system -----------------------------------------------------------------------


def kalman(settings: Mapping[str, Any], runs: int, condition: Condition) -> tuple[Any, Any, Series]:
    """The system in the paper's place, a record of it, and the Kalman filter that follows it."""
    model = discretised([draw(settings["populations"]["paper"]["first"])])
    sizes = settings["steps"], runs, settings["noise_seed"]
    record = simulate(model, model, condition, *sizes)
    return model, record, track(model, record.y, "kf")


def first_run(model: Any, of: Series) -> tuple[np.ndarray, np.ndarray]:
    """Variances ``(T, n)`` and Kalman gains ``K = P+ C' R^-1 (T, n, p)`` of the first run."""
    cov = of.cov[:, 0, 0]
    return np.diagonal(cov, axis1=-2, axis2=-1), cov @ model.C[0, 0].T @ np.linalg.inv(model.R)


def printed_estimates(model: Any, y: np.ndarray) -> np.ndarray:
    """Estimates ``(T, n)`` of the algorithm as printed, eqs (6) to (9) and step 4's summary."""
    A, B, C, Q = (each[0, 0] for each in (model.A, model.B, model.C, model.Q))
    x, P, found = PRIOR.mean, PRIOR.cov, []
    for measurement, u in zip(y, known_input(len(y)), strict=True):
        K = P @ C.T @ np.linalg.inv(C @ P @ C.T + model.R)
        x, P = x + K @ (measurement - C @ x), (np.eye(len(A)) - K @ C) @ P
        found.append(x)
        x, P = A @ x + B @ u, A @ P @ A.T + Q
    return np.array(found)


# --- tables ---------------------------------------------------------------------------------------


def report(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Tables and measures."""
    rmse = cache(partial(rms_errors, settings))
    made = {"conditions": _conditions, "systems": _systems, "figures": _figures}
    return {
        "tables": {name: table(settings, rmse) for name, table in made.items()},
        "figures": _drawn(settings),
        "rows": [Row(settings["paper"], "no number is printed")],
    }


def _drawn(settings: Mapping[str, Any]) -> list[Any]:
    """Figures 1 to 5 in one run of the printed algorithm, the Kalman filter."""
    model, calm, of = kalman(settings, 1, Condition())
    _, _, disturbed = kalman(settings, 1, Condition(**settings["outliers"]))
    times, (variances, gain) = STEP * np.arange(len(calm.x)), first_run(model, of)
    real, estimate = {"real": calm.x[:, 0, 0]}, {"estimate": of.mean[:, 0, 0]}
    both = {"without disturbance": of.mean[:, 0, 0], "with disturbance": disturbed.mean[:, 0, 0]}
    names, sds = ("x1", "x2"), np.sqrt(variances).T
    gains = {f"K{i + 1}{j + 1}": gain[:, i, j] for i in range(STATES) for j in range(MEASUREMENTS)}
    of_each = {f"P{i + 1}{i + 1}": of for i, of in enumerate(variances.T)}
    beside = panels(times, names, real | estimate, sds)
    robustness = panels(times, names, real | both)
    return [
        figure("1", "Estimates of x1 and x2.", *panels(times, names, estimate, sds)),
        figure("2", "Estimates of x1 and x2 with the true states.", *beside),
        figure("3", "Kalman gain over time.", over_time(times, "gain", gains)),
        figure("4", "Covariance of the error over time.", over_time(times, "variance", of_each)),
        figure("5", "Estimates with and without disturbance.", *robustness),
    ]


def ratio(ours: Any, other: Any, decimals: int) -> str:
    """Geometric mean of paired ratios."""
    return text(geometric(np.log(ours) - np.log(other)), decimals)


Errors = Callable[[str, Condition], dict[str, np.ndarray]]
"""`rms_errors` for a population and a condition."""


def _conditions(settings: Mapping[str, Any], rmse: Errors) -> list[Any]:
    """RMSE of the Kalman filter in each condition, and ratios of the others to it."""
    _, *others = settings["filters"]
    found: list[Any] = [("sweep", "value", "KF, RMSE", *(f"{name} / KF" for name in others))]
    for sweep in settings["sweeps"]:
        for value in sweep["values"]:
            of = rmse("random", Condition(**sweep.get("beside", {}) | {sweep["varied"]: value}))
            cells = (ratio(of[name], of["kf"], 3) for name in others)
            kf = np.exp(np.log(of["kf"]).mean())
            found.append((sweep["name"], f"{value:g}", f"{kf:.2f}", *cells))
    return found


def _systems(settings: Mapping[str, Any], rmse: Errors) -> list[Any]:
    """Quantiles over the systems of the ratios to the Kalman filter."""
    quantiles = {"best": 0.0, "10 %": 0.1, "median": 0.5, "90 %": 0.9, "worst": 1.0}
    found: list[Any] = [("condition", "filter", "systems below the KF [%]", *quantiles)]
    for key in ("nothing wrong", "outliers", "least_favourable", "parameters"):
        of = rmse("random", Condition(**settings.get(key, {})))
        for name in [*of][1:]:
            ratios = of[name] / of["kf"]
            cells = (f"{q:.2f}" for q in np.quantile(ratios, [*quantiles.values()]))
            below = f"{100.0 * (ratios < 1.0).mean():.0f}"
            found.append((key.replace("_", " "), name, below, *cells))
    return found


def _figures(settings: Mapping[str, Any], rmse: Errors) -> list[Any]:
    """The paper's figures, on the system in its place."""
    model, record, of = kalman(settings, settings["populations"]["paper"]["runs"], Condition())
    error = np.sqrt(np.square(of.mean - record.x).sum(-1).mean((1, 2)))
    late = np.sqrt(np.mean(error[settings["skipped"] :] ** 2))
    variances, gains = first_run(model, of)
    gain = np.linalg.norm(gains, 2, (-2, -1))
    printed = np.abs(printed_estimates(model, record.y[:, 0, 0]) - of.mean[:, 0, 0]).max()
    found: list[Any] = [
        ("on the paper's system", "at the first measurement", "at the last"),
        ("RMSE", f"{error[0]:.2f}", f"{late:.2f}"),
        ("largest singular value of the gain", f"{gain[0]:.2f}", f"{gain[-1]:.2f}"),
        *((f"variance of x{i + 1}", f"{of[0]:.2f}", f"{of[-1]:.2f}")
          for i, of in enumerate(variances.T)),
        ("printed algorithm less kf, at most", f"{printed:.0e}", ""),
    ]  # fmt: skip
    hit, usual = rmse("paper", Condition(**settings["outliers"])), rmse("paper", Condition())
    for name in settings["filters"]:
        affected = ratio(hit[name], usual[name], 2)
        found.append((f"{name}, RMSE with outliers over without", affected, ""))
    return found
