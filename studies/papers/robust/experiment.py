"""The robust filters of Rudianto et al. (2024): the paper's figures, and its claim put to the test.

The world is a random two-state system in continuous time, discretised exactly; the filters assume
it, and the condition says where the world differs. Matrices of a population of systems have the
leading axes (system, 1), runs (system, run).
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from agents.jobs import Job
from estimators import Belief, Gaussian, LinearModel, make, van_loan, zero_order_hold

STATES = MEASUREMENTS = 2  # x1 and x2 (figure 1); y is a vector (after eq. 4)
MARGIN = (0.1, 1.0)  # 1/s, decay rate of the slowest mode: stable, memory of 1 to 10 s
INTENSITY = (0.1, 10.0)  # 1/s, of the process noise, log-uniform
MEASUREMENT_VARIANCE = 1.0  # the unit of y
PRIOR_VARIANCE = (
    10.0  # of each state, mean 0: the filter knows little at first (on figures 3 and 4)
)
STEP = 0.1  # s
INPUT_PERIOD = 100  # steps of the square wave u, so that an error of A keeps mattering
_HORIZON = (
    20  # steps that nature plans beyond the last: near its end it would have nothing to anticipate
)


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


def draw(seed: int) -> Dynamics:
    """The random system of a seed; ``page.md`` has the recipe."""
    rng, n = np.random.default_rng(seed), STATES
    M, B, C = rng.normal(size=(n, n)), rng.normal(size=(n, 1)), rng.normal(size=(MEASUREMENTS, n))
    margin = rng.uniform(*MARGIN)
    q = np.exp(rng.uniform(*np.log(INTENSITY)))
    return Dynamics(
        M - (growth(M) + margin) * np.eye(n), B, C / np.linalg.norm(C, axis=1, keepdims=True), q
    )


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


def discretised(systems: Sequence[Dynamics], runs: int = 1) -> StateSpace:
    """Models of one step with leading axes ``(systems / runs, runs)``."""
    steps = []
    for A, B, C, q in systems:
        transition, noise = van_loan(A, np.eye(STATES), q * np.eye(STATES), STEP)
        steps.append((transition, C, noise, zero_order_hold(A, B, STEP)[1]))
    stacked = (np.array(matrices) for matrices in zip(*steps, strict=True))
    A, C, Q, B = (matrices.reshape(-1, runs, *matrices.shape[1:]) for matrices in stacked)
    return StateSpace(A, B, C, Q, MEASUREMENT_VARIANCE * np.eye(C.shape[-2]))


def prior(*batch: int) -> Gaussian:
    """The filters' first estimate."""
    return Gaussian(np.zeros((*batch, STATES)), PRIOR_VARIANCE * np.eye(STATES))


def known_input(step: int) -> np.ndarray:
    """The square wave u ``(1,)``."""
    return np.array([1.0 if step % INPUT_PERIOD < INPUT_PERIOD / 2 else -1.0])


# --- the least-favourable model -------------------------------------------------------------------


@dataclass(frozen=True)
class LeastFavourable:
    """The noise that hurts `robust-kf` most within its ball; lists over time, leading axes over systems.

    With its prediction error ``e`` and unit noise ``z = (w, v)``, ``x+ = A x + B u + W z``, ``y = C
    x + D z``, the error of the filter with gain G obeys ``e+ = F e + N z``, ``F = A - G C``, ``N =
    W - G D``. The least-favourable density is the nominal one times ``exp(theta |e+|^2 / 2)`` at
    every step. Later steps integrated out, last first::

        X = Omega+ + theta I     Z = (I - N' X N)^-1     Omega = F' (X + X N Z N' X) F
        z | e ~ N(Z N' X F e, Z)

    The first error is left as the prior has it. With tolerance 0 it is the model itself.

    Source: Levy & Nikoukhah (2013), sec. III and V.
    """

    shift: list[np.ndarray]  # (..., n + p, n) mean of z for an error e
    root: list[np.ndarray]  # (..., n + p, n + p) root of z's covariance
    error_map: list[np.ndarray]  # (..., n, n) F
    error_noise: list[np.ndarray]  # (..., n, n + p) N
    start_weight: (
        np.ndarray
    )  # (..., n, n) Omega_0: nature would start with covariance (V_0^-1 - Omega_0)^-1
    claimed: np.ndarray  # (..., n, n) the filter's prediction covariance after the last step


def noise_roots(model: StateSpace) -> tuple[np.ndarray, np.ndarray]:
    """W ``(..., n, n + p)`` and D ``(p, n + p)`` with ``W W' = Q``, ``D D' = R``, ``W D' = 0``."""
    n, p = model.A.shape[-1], model.R.shape[-1]
    W = np.concatenate([np.linalg.cholesky(model.Q), np.zeros((*model.Q.shape[:-1], p))], axis=-1)
    return W, np.hstack([np.zeros((p, n)), np.linalg.cholesky(model.R)])


def least_favourable(model: StateSpace, tolerance: float, steps: int) -> LeastFavourable:
    """The worst noise over a number of steps against ``robust-kf`` of the same tolerance."""
    (W, D), C, eye = noise_roots(model), model.C, np.eye(model.A.shape[-1])
    filter = make("robust-kf", model.model, radius=tolerance)
    belief = filter.init(prior(*model.A.shape[:-2]))
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


# --- runs -----------------------------------------------------------------------------------------


class Record(NamedTuple):
    """True states ``(T, ..., n)`` and measurements ``(T, ..., p)``."""

    x: np.ndarray
    y: np.ndarray


def simulate(
    model: StateSpace, world: StateSpace, condition: Condition, steps: int, runs: int, seed: int
) -> Record:
    """Runs of every system: measurements from the ``world``, its noise as the condition has it.

    The same seed gives the same underlying noise in every condition. Nature's error ``e`` is that
    of a filter which assumes the model and sees no outlier.
    """
    W, D = noise_roots(world)
    worst = least_favourable(model, condition.tolerance, steps + _HORIZON)
    z_rng, outlier_rng = (np.random.default_rng([seed, stream]) for stream in range(2))
    batch = (len(model.A), runs)
    x = e = np.sqrt(PRIOR_VARIANCE) * z_rng.normal(size=(*batch, W.shape[-2]))
    xs, ys = [], []
    for k in range(steps):
        z = np.matvec(worst.shift[k], e) + np.matvec(
            worst.root[k], z_rng.normal(size=(*batch, W.shape[-1]))
        )
        outlier = outlier_rng.random((*batch, len(D))) < condition.rate
        xs.append(x)
        ys.append(np.matvec(world.C, x) + np.where(outlier, condition.size, 1.0) * np.matvec(D, z))
        e = np.matvec(worst.error_map[k], e) + np.matvec(worst.error_noise[k], z)
        x = np.matvec(world.A, x) + np.matvec(world.B, known_input(k)) + np.matvec(W, z)
    return Record(np.array(xs), np.array(ys))


def track(
    options: Mapping[str, Any], model: StateSpace, y: np.ndarray
) -> Iterable[tuple[Belief, Belief]]:
    """The beliefs of a filter before and after each measurement of ``y (T, systems, runs, p)``."""
    filter = make(
        options["kind"],
        model.model,
        **{key: value for key, value in options.items() if key != "kind"},
    )
    predicted = filter.init(prior(*y.shape[1:-1]))
    for k, measurement in enumerate(y):
        updated = filter.update(predicted, measurement)
        yield predicted, updated
        predicted = filter.predict(updated, known_input(k))


def errors(
    first: int, systems: int, runs: int, noise_seed: int, steps: int, skipped: int, condition: Mapping[str, float],
    filters: Mapping[str, Any],
) -> dict[str, np.ndarray]:  # fmt: skip
    """RMSE of the updated state, ``(systems, runs)`` by filter, on the same measurements; see the settings."""
    what = Condition(**condition)
    drawn = [draw(seed) for seed in range(first, first + systems)]
    model = world = discretised(drawn)
    if what.parameters:
        rng = np.random.default_rng([noise_seed, 2])
        world = discretised(
            [mistaken(s, what.parameters, rng) for s in drawn for _ in range(runs)], runs
        )
    record = simulate(model, world, what, steps, runs, noise_seed)
    return {
        name: _rmse(track(options, model, record.y), record.x, skipped)
        for name, options in filters.items()
    }


def _rmse(beliefs: Iterable[tuple[Belief, Belief]], x: np.ndarray, skipped: int) -> np.ndarray:
    squares = [
        ((after.mean - state) ** 2).sum(-1) for (_, after), state in zip(beliefs, x, strict=True)
    ]
    return np.sqrt(np.mean(squares[skipped:], axis=0))


# --- the paper's own system -----------------------------------------------------------------------


def example(first: int, runs: int, noise_seed: int, steps: int) -> dict[str, Any]:
    """The Kalman filter on the system of a seed, with nothing wrong.

    Returns:
        ``rmse (T,)`` over all runs; of the first run ``variance (T, n)`` and ``gain (T,)``, the
        largest singular value of ``K = P+ C' R^-1``; ``printed``, see `printed_difference`.
    """
    model = discretised([draw(first)])
    x, y = simulate(model, model, Condition(), steps, runs, noise_seed)
    found = [after for _, after in track({"kind": "kf"}, model, y)]
    gains = [after.cov[0, 0] @ model.C[0, 0].T @ np.linalg.inv(model.R) for after in found]
    squares = [
        ((after.mean - state) ** 2).sum(-1).mean() for after, state in zip(found, x, strict=True)
    ]
    return {
        "rmse": np.sqrt(squares),
        "variance": np.array([np.diagonal(after.cov[0, 0]) for after in found]),
        "gain": np.linalg.svd(gains, compute_uv=False)[:, 0],
        "printed": printed_difference(
            model, y[:, 0, 0], np.array([after.mean[0, 0] for after in found])
        ),
    }


def printed_difference(model: StateSpace, y: np.ndarray, kf: np.ndarray) -> float:
    """Largest difference of the algorithm as printed, eqs (6) to (9) and the summary of step 4, from ``kf (T, n)``."""
    A, B, C, Q, R = model.A[0, 0], model.B[0, 0], model.C[0, 0], model.Q[0, 0], model.R
    x, P = np.zeros(len(A)), PRIOR_VARIANCE * np.eye(len(A))
    largest = 0.0
    for k, measurement in enumerate(y):
        K = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
        x, P = x + K @ (measurement - C @ x), (np.eye(len(A)) - K @ C) @ P
        largest = max(largest, float(np.abs(x - kf[k]).max()))
        x, P = A @ x + B @ known_input(k), A @ P @ A.T + Q
    return largest


# --- jobs -----------------------------------------------------------------------------------------


def sweeps(settings: Mapping[str, Any]) -> dict[str, list[Condition]]:
    """The conditions of each sweep, by the attribute that varies, and outliers on top of either model error."""
    values, outliers = settings["sweeps"], Condition(**settings["outliers"])
    found = {
        key: [Condition(**{key: v}) for v in values[key]]
        for key in ("rate", "tolerance", "parameters")
    }
    found["size"] = [outliers._replace(size=size) for size in values["size"]]
    for error in ("least_favourable", "parameters"):
        condition = Condition(**settings[error])
        found[f"{error}, outliers"] = [condition._replace(rate=rate) for rate in values["crossed"]]
    return found


def job_name(population: str, condition: Condition) -> str:
    """The name of the job of a population under a condition."""
    return f"{population}: " + ", ".join(
        f"{key} {value:g}" for key, value in condition._asdict().items()
    )


def jobs(settings: Mapping[str, Any]) -> dict[str, Job]:
    """Everything to compute, by name."""
    run = {key: settings[key] for key in ("noise_seed", "steps")}
    paper = {key: settings["populations"]["paper"][key] for key in ("first", "runs")}
    found = {"example": Job(f"{__name__}:example", paper | run, "robust, example")}
    run |= {key: settings[key] for key in ("filters", "skipped")}
    conditions = {
        "random": dict.fromkeys(
            condition for group in sweeps(settings).values() for condition in group
        ),
        "paper": (Condition(), Condition(**settings["outliers"])),
    }
    for population, which in settings["populations"].items():
        for condition in conditions[population]:
            arguments = which | run | {"condition": condition._asdict()}
            found[job_name(population, condition)] = Job(
                f"{__name__}:errors", arguments, f"robust, {population}"
            )
    return found
