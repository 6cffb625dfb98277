"""The robust filters of Rudianto et al. (2024): the paper's figures, and its claim put to the test.

The world is a random two-state system in continuous time, discretised exactly; the filters believe it, and the
condition says where it is otherwise (`settings.robust.Condition`). Every matrix of a population of systems has the
leading axes (system, 1), every run (system, run).
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_are, solve_discrete_lyapunov

from agents.cells import Cell
from agents.reproduction.settings import robust as settings
from agents.reproduction.settings.robust import Condition
from estimators import Belief, Gaussian, LinearModel, make, van_loan, zero_order_hold

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
    """The random system of a seed with as many of its readings; ``pages/robust.md`` has the recipe."""
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
    for k in range(steps):
        V = belief.cov
        G = model.A @ V @ C.mT @ np.linalg.inv(C @ V @ C.mT + model.R)
        F.append(model.A - G @ C)
        N.append(W - G @ D)
        P = F[-1] @ V @ F[-1].mT + N[-1] @ N[-1].mT
        belief = filter.predict(filter.update(belief, np.zeros(C.shape[-2])), known_input(k))
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


def cell_name(population: str, condition: Condition) -> str:
    """The name of the cell of a population under a condition."""
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
            found[cell_name(population, condition)] = Cell(
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
