"""The filters under test, random models for them, and a simulator that knows the truth.

A new filter joins the suite by one more `Case` in `CASES`: its name and options, the kind of system
it is for, and the laws that it obeys. Every test that states a law takes its cases from here.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np
import pytest
from scipy.linalg import block_diag

from estimators import (
    Belief,
    Filter,
    Gaussian,
    LinearModel,
    NonlinearModel,
    RandomKeys,
    Rng,
    compiled,
    make,
    stacked,
)

INPUT_PRIOR = 50.0
"""Variance of the unknown input where no measurement shows it: that of `wild_input`."""


# --- random models --------------------------------------------------------------------------------


def random_covariance(rng: np.random.Generator, n: int, batch: tuple[int, ...] = ()) -> np.ndarray:
    """Positive definite ``(..., n, n)`` with eigenvalues of order 1."""
    root = rng.normal(size=(*batch, n, n))
    return root @ np.swapaxes(root, -1, -2) / n + 0.2 * np.eye(n)


def random_transition(rng: np.random.Generator, n: int, radius: float) -> np.ndarray:
    """``(n, n)`` with the given spectral radius."""
    A = rng.normal(size=(n, n))
    return A * radius / np.abs(np.linalg.eigvals(A)).max()


@dataclass(frozen=True)
class System:
    """A model, what it starts from, and how many known inputs it has."""

    model: LinearModel | NonlinearModel
    mean: np.ndarray
    cov: np.ndarray
    m: int

    @property
    def prior(self) -> Gaussian:
        return Gaussian(self.mean, self.cov)

    def rows(self, *batch: int) -> Gaussian:
        """The prior, once for each row of a batch."""
        return Gaussian(np.broadcast_to(self.mean, (*batch, self.model.n)), self.cov)


@cache
def kalman_system(seed: int, n: int = 4, p: int = 3, m: int = 2, radius: float = 0.98) -> System:
    """A random linear Gaussian system without unknown input."""
    rng = np.random.default_rng(seed)
    model = LinearModel(
        A=random_transition(rng, n, radius), B=rng.normal(size=(n, m)), C=rng.normal(size=(p, n)),
        Q=random_covariance(rng, n), R=random_covariance(rng, p),
    )  # fmt: skip
    return System(model, rng.normal(size=n), random_covariance(rng, n), m)


@cache
def unknown_input_system(
    seed: int,
    feedthrough: bool,
    n: int = 4,
    p: int = 3,
    q: int = 1,
    m: int = 2,
    rank: int | None = None,
) -> System:
    """A random stable, strongly detectable system with unknown input; ``rank`` of H, if not q.

    With A stable, strong detectability means that the transfer function from the unknown input to
    the measurement, ``T(z) = H + C (z I - A)^-1 G`` (times z in the directions without
    feedthrough), has full column rank for every |z| >= 1.
    Draws whose smallest singular value falls below a margin there are rejected, so that the filters
    are well conditioned; the same margin for every choice of p - 1 channels lets one channel be
    taken away.
    """
    rng = np.random.default_rng(seed)
    z = np.array([1.0, 1.3, 2.0, 5.0, 1e6])[:, None] * np.exp(1j * np.linspace(0.0, np.pi, 25))
    while True:
        A, C, G = random_transition(rng, n, 0.85), rng.normal(size=(p, n)), rng.normal(size=(n, q))
        H = rng.normal(size=(p, q)) if feedthrough else np.zeros((p, q))
        if rank is not None:
            H = H[:, :rank] @ rng.normal(size=(rank, q))
        transfer = H + C @ np.linalg.solve(z[..., None, None] * np.eye(n) - A, G.astype(complex))
        transfer = transfer @ (
            np.eye(q) + (z[..., None, None] - 1.0) * (np.eye(q) - observable_directions(H))
        )
        kept = [np.arange(p) != j for j in range(p)]
        if min(np.linalg.svd(transfer[..., rows, :])[1].min() for rows in kept) > 0.2:
            break
    model = LinearModel(
        A=A, B=rng.normal(size=(n, m)), C=C, G=G, H=H if feedthrough else None,
        Q=random_covariance(rng, n), R=random_covariance(rng, p),
    )  # fmt: skip
    return System(model, rng.normal(size=n), random_covariance(rng, n), m)


def input_as_state(system: System, D: np.ndarray) -> System:
    """The same system, whose unknown input is white with covariance D, and a part of the state."""
    model, n, q = stacked(system.model), system.model.n, system.model.q
    Q = block_diag(model.Q[:n, :n], D)
    model = LinearModel(model.A, model.C, Q, model.R, B=model.B)
    mean, cov = np.concatenate([system.mean, np.zeros(q)]), block_diag(system.cov, D)
    return System(model, mean, cov, system.m)


def observable_directions(F: np.ndarray) -> np.ndarray:
    """The orthogonal projector ``(q, q)`` on the directions of ``d`` that ``F d`` shows."""
    _, strength, directions = np.linalg.svd(F, full_matrices=False)
    shown = directions[strength > 1e-9]
    return shown.T @ shown


def counted_directions(F: np.ndarray, precision: np.ndarray, prior: float) -> np.ndarray:
    """The projector ``(q, q)`` on the directions that ``F d`` and noise of a precision show well.

    That is so where the prior has more than a tenth of the variance that is left.
    """
    values, directions = np.linalg.eigh(prior * F.T @ precision @ F)
    counted = directions[:, values > 0.1]
    return counted @ counted.T


@cache
def turning_vehicle(seed: int) -> System:
    """Position, heading and speed, seen as range, bearing and heading: nonlinear, with angles."""
    dt, beacon = 0.1, np.array([-30.0, 20.0])

    def transition(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        heading, speed = x[..., 2], x[..., 3]
        moved = speed * np.cos(heading), speed * np.sin(heading), u[..., 0], u[..., 1]
        drag = 0.2 * speed * np.abs(speed)
        return x + dt * (np.stack(moved, -1) - drag[..., None] * [0.0, 0.0, 0.0, 1.0])

    def measurement(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        away, across = x[..., 0] - beacon[0], x[..., 1] - beacon[1]
        return np.stack([np.hypot(away, across), np.arctan2(across, away), x[..., 2]], -1)

    model = NonlinearModel(
        compiled(transition), compiled(measurement),
        Q=np.diag([1e-3, 1e-3, 1e-4, 1e-3]), R=np.diag([0.1, 1e-3, 1e-2]),
        state_angles=(2,), measurement_angles=(1, 2),
    )  # fmt: skip
    heading = np.random.default_rng(seed).uniform(-3.0, 3.0)
    return System(model, np.array([0.0, 0.0, heading, 1.0]), np.diag([0.5, 0.5, 0.05, 0.1]), 2)


@cache
def pushed_vehicle(seed: int) -> System:
    """`turning_vehicle` with an unknown push along its heading, which turns it as well."""
    system = turning_vehicle(seed)

    def push(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        heading = x[..., 2:3]
        one = np.ones(heading.shape)
        parts = [np.cos(heading), np.sin(heading), 0.5 * one, 0.2 * one]
        return 0.1 * np.stack(parts, -2)

    return replace(system, model=replace(system.model, G=compiled(push), H=np.zeros((3, 1))))


@cache
def shaken_vehicle(seed: int) -> System:
    """`pushed_vehicle`, whose bearing and heading show the push at once."""
    system = pushed_vehicle(seed)
    return replace(system, model=replace(system.model, H=np.array([[0.0], [0.02], [0.1]])))


def without_channel(model: LinearModel | NonlinearModel, j: int) -> LinearModel | NonlinearModel:
    """The model of the same system without measurement channel ``j``."""
    kept = np.arange(model.p) != j
    angles = tuple(i - (i > j) for i in model.measurement_angles if i != j)
    changes = {
        "R": model.R[kept][:, kept],
        "measurement_angles": angles,
        "H": None if model.H is None else model.H[kept],
    }
    if isinstance(model, LinearModel):
        return replace(model, C=model.C[kept], **changes)
    return replace(model, measurement=lambda x, u: model.measurement(x, u)[..., kept], **changes)


# --- simulation -----------------------------------------------------------------------------------


class Record(NamedTuple):
    """What happened: times first, then runs, then components."""

    x: np.ndarray  # (T, runs, n) true state
    y: np.ndarray  # (T, runs, p) measurement
    u: np.ndarray  # (T, runs, m) known input over the step that follows
    d: np.ndarray | None  # (T, runs, q) unknown input: in this measurement and the step after it


def wild_input(rng: np.random.Generator, steps: int, runs: int, q: int) -> np.ndarray:
    """An unknown input of no known law: an offset, a swing, jumps; the same in every run."""
    k = np.arange(steps)[:, None, None]
    phase = rng.uniform(0.0, 6.0, size=q)
    jumps = np.repeat(rng.normal(scale=3.0, size=(steps // 10 + 1, 1, q)), 10, axis=0)[:steps]
    return np.broadcast_to(5.0 + 4.0 * np.sin(0.2 * k + phase) + jumps, (steps, runs, q))


def simulate(
    system: System,
    seed: int,
    runs: int,
    steps: int,
    d: np.ndarray | None = None,
    noise: float = 1.0,
) -> Record:
    """Draw a start from the prior and let the system run; ``d`` defaults to a wild one."""
    rng = np.random.default_rng(seed)
    model = system.model
    if d is None and model.q:
        d = wild_input(np.random.default_rng(seed + 1), steps, runs, model.q)
    roots = [noise * np.linalg.cholesky(S) for S in (system.cov, model.Q, model.R)]
    x = system.mean + np.matvec(roots[0], rng.normal(size=(runs, model.n)))
    u = rng.normal(size=(steps, runs, system.m))
    xs, ys = [], []
    for k in range(steps):
        y = model.measurement(x, u[k]) + np.matvec(roots[2], rng.normal(size=(runs, model.p)))
        xs.append(x)
        ys.append(y if d is None else y + np.matvec(model.H, d[k]))
        push = 0.0 if d is None else np.matvec(model.input_matrix(x, u[k]), d[k])
        x = model.transition(x, u[k]) + np.matvec(roots[1], rng.normal(size=(runs, model.n))) + push
    return Record(np.array(xs), np.array(ys), u, d)


def track(
    filter: Filter,
    prior: Gaussian,
    record: Record,
    rng: Rng = None,
    available: np.ndarray | None = None,
    R: np.ndarray | None = None,
) -> list[Belief]:
    """The belief after every measurement of a record; ``available`` and ``R`` have one a time."""
    belief, beliefs = filter.init(prior, rng=rng), []
    for k, y in enumerate(record.y):
        now = rng.at(k) if isinstance(rng, RandomKeys) else rng
        if k:
            belief = filter.predict(belief, record.u[k - 1], rng=now)
        mask, cov = (None if a is None else a[k] for a in (available, R))
        belief = filter.update(belief, y, rng=now, available=mask, R=cov)
        beliefs.append(belief)
    return beliefs


# --- what the formulas should give, by another road -----------------------------------------------


def textbook_kalman(
    system: System, y: np.ndarray, u: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Mean and covariance after every measurement of one run, by the formulas with inverses."""
    model, mean, cov, out = system.model, system.mean, system.cov, []
    for k in range(len(y)):
        if k:
            mean, cov = model.A @ mean + model.B @ u[k - 1], model.A @ cov @ model.A.T + model.Q
        gain = cov @ model.C.T @ np.linalg.inv(model.C @ cov @ model.C.T + model.R)
        mean, cov = mean + gain @ (y[k] - model.C @ mean), cov - gain @ model.C @ cov
        out.append((mean, cov))
    return out


def flat_prior_posterior(
    mean: np.ndarray, cov: np.ndarray, drive: np.ndarray, C: np.ndarray, H: np.ndarray,
    R: np.ndarray, y: np.ndarray, input_precision: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Least squares for ``(x, d)``: ``x - drive d ~ N(mean, cov)``, ``y = C x + H d + N(0, R)``.

    ``d`` has the information ``input_precision`` (0: nothing is known of it). This is what an
    unbiased minimum-variance update must give, in information form: the filters compute it in
    covariance form.
    """
    n = len(mean)
    P, V = np.linalg.inv(cov), np.linalg.inv(R)
    from_prior, from_measurement = np.hstack([np.eye(n), -drive]), np.hstack([C, H])
    information = from_prior.T @ P @ from_prior + from_measurement.T @ V @ from_measurement
    information[n:, n:] += input_precision
    posterior = np.linalg.inv(information)
    return posterior @ (from_prior.T @ P @ mean + from_measurement.T @ V @ y), posterior


# --- the registry ---------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Case:
    """A filter with its options, a family of random systems for it, and the laws that it obeys.

    Laws: ``kalman`` is exactly the Kalman filter on a linear Gaussian model; ``unknown-input``
    estimates state and unknown input without bias; ``consistent`` has errors as large as it says;
    ``own-noise`` takes a covariance with a measurement as it takes the model's; ``linear`` has
    linear systems; ``deterministic`` uses no randomness; ``ensemble`` carries members, and with
    ``square-root`` updates them without; ``long`` is tried over a very long run, one case for each
    way in which filters carry a covariance on.
    """

    id: str
    name: str
    system: Callable[[int], System]
    laws: frozenset[str]
    options: dict[str, object]

    @lru_cache(maxsize=256)  # noqa: B019 : cases stay, and a filter keeps its programs
    def make(self, model: LinearModel | NonlinearModel) -> Filter:
        """The filter, the same one for the same model."""
        return make(self.name, model, **self.options)


def _case(
    id: str, name: str, system: Callable[[int], System], laws: str, **options: object
) -> Case:
    own = () if name == "steady-kf" else ("own-noise",)
    return Case(id, name, system, frozenset((*laws.split(), *own)), options)


def _kalman_case(id: str, laws: str, **options: object) -> Case:
    """On a random system without unknown input; the filter is the first word of ``id``."""
    return _case(id, id.split(" ")[0], kalman_system, f"{laws} linear", **options)


def _input_case(
    id: str, laws: str = "linear consistent", system: Callable[[int], System] | None = None,
    feedthrough: bool = False, **sizes: int,
) -> Case:  # fmt: skip
    """On a system with unknown input."""

    def random_system(seed: int) -> System:
        return unknown_input_system(seed, feedthrough, **sizes)

    return _case(
        id, id.split(" ")[0], system or random_system, f"unknown-input deterministic {laws}",
        input_prior=INPUT_PRIOR,
    )  # fmt: skip


_EXACT = "kalman consistent deterministic"
_LONG = "linear consistent long"
CASES = (
    _kalman_case("kf", f"{_EXACT} long"),
    _kalman_case("ekf", _EXACT),
    _kalman_case("enkf", "ensemble", members=20),
    _case("enkf on a turning vehicle", "enkf", turning_vehicle, "ensemble", members=20),
    _kalman_case("etkf", "ensemble square-root long", members=20),
    _kalman_case(
        "etkf with fewer members than states",
        "ensemble square-root",
        members=3,
        draws="independent",
    ),
    _kalman_case("pf", "", particles=40),
    _case("pf on a turning vehicle", "pf", turning_vehicle, "", particles=40),
    _case("ekf on a turning vehicle", "ekf", turning_vehicle, "deterministic"),
    _case("steady-kf", "steady-kf", kalman_system, ""),
    _case(
        "steady-kf with two rates", "steady-kf", kalman_system, "", measured=[[1, 1, 1], [1, 0, 1]]
    ),
    _input_case("kf-umv-ui", _LONG, feedthrough=True),
    _input_case("kf-umv-ui with two inputs", feedthrough=True, p=4, q=2),
    _input_case("kf-umv-ui on a shaken vehicle", "", shaken_vehicle),
    _input_case("kf-umv-ui-wdf", _LONG),
    _input_case("kf-umv-ui-wdf with two inputs", p=4, q=2),
    _input_case("ekf-ui-wdf"),
    _input_case("ekf-ui-wdf on a pushed vehicle", "", pushed_vehicle),
    _input_case("ulise without feedthrough"),
    _input_case("ulise with one input of two fed through", feedthrough=True, p=4, q=2, rank=1),
    _kalman_case("ukf", _EXACT),
    _case("ukf on a turning vehicle", "ukf", turning_vehicle, "deterministic"),
    _input_case("ukf-umv"),
    _input_case("ukf-umv on a pushed vehicle", "", pushed_vehicle),
    _kalman_case("huber-kf", "deterministic"),
    _kalman_case("huber-kf with gamma infinite", _EXACT, gamma=np.inf),
    _kalman_case("robust-kf", "deterministic"),
    _kalman_case("robust-kf with a ball of radius 0", _EXACT, radius=0.0),
)


def every_case(*laws: str) -> Callable[[Callable], Callable]:
    """Parametrise a test over the cases that obey all of ``laws``; the table reads these.

    By day each filter has its first case, at night all.
    """
    chosen = [case for case in CASES if case.laws.issuperset(laws)]
    first = {case.name: case.id for case in reversed(chosen)}.values()
    marks = {case.id: () if case.id in first else pytest.mark.nightly for case in chosen}

    def decorate(test: Callable) -> Callable:
        test.laws = laws
        params = [pytest.param(case, id=case.id, marks=marks[case.id]) for case in chosen]
        return pytest.mark.parametrize("case", params)(test)

    return decorate


def one_of_each(*laws: str) -> Callable[[Callable], Callable]:
    """Parametrise a test over the first case of each filter that obeys all of ``laws``."""
    chosen = {case.name: case for case in reversed(CASES) if case.laws.issuperset(laws)}
    return pytest.mark.parametrize("case", chosen.values(), ids=chosen.keys())


def some_cases(*names: str) -> Callable[[Callable], Callable]:
    """Parametrise a test of what filters have in common over a few cases by name."""
    return pytest.mark.parametrize(
        "case", [case for case in CASES if case.id in names], ids=lambda case: case.id
    )


# --- comparing beliefs ----------------------------------------------------------------------------


def arrays(belief: Belief) -> dict[str, np.ndarray]:
    """The arrays of a belief by name, without those that it does not have."""
    return {name: value for name, value in belief.arrays().items() if value is not None}


def assert_close(given: np.ndarray, expected: np.ndarray, tolerance: float, name: str = "") -> None:
    """Equal to ``tolerance``, relative to the largest entry where that exceeds 1."""
    scale = max(1.0, float(np.abs(expected).max(initial=0.0)))
    np.testing.assert_allclose(given, expected, rtol=0.0, atol=tolerance * scale, err_msg=name)


def assert_same(
    one: Belief, other: Belief, tolerance: float = 0.0, ignore: Sequence[str] = ()
) -> None:
    """Every array of two beliefs agrees to ``tolerance``, as of `assert_close`.

    0 is to the last bit, for two runs of the same operations on one machine; other operations round
    otherwise.
    """
    one, other = arrays(one), arrays(other)
    assert one.keys() == other.keys()
    for name in one.keys() - set(ignore):
        assert one[name].shape == other[name].shape, name
        assert_close(one[name], other[name], tolerance, name)


def gaps(y: np.ndarray) -> np.ndarray:
    """Measurements of which every fifth is missing."""
    return np.where(np.random.default_rng(0).random(y.shape) < 0.2, np.nan, y)


def some_measurements(rng: np.random.Generator, p: int, *shape: int) -> np.ndarray:
    """A mask ``(..., p)``: mostly every measurement arrives, else a single one or none.

    With only some of them the unknown input can stay partly unseen. (Dropping each one at random
    would leave systems whose unknown input is detectable from all measurements, but not from those
    that are left: there an unbiased filter diverges, as it must.)
    """
    single_or_none = np.eye(p + 1, p, dtype=bool)[rng.integers(p + 1, size=shape)]
    return single_or_none | (rng.random((*shape, 1)) < 0.7)


def assert_covariance(cov: np.ndarray, scale: float | np.ndarray = 0.0) -> None:
    """Symmetric exactly, positive semidefinite to rounding of its own size, or of ``scale``."""
    np.testing.assert_array_equal(cov, np.swapaxes(cov, -1, -2))
    eigenvalues = np.linalg.eigvalsh(cov)
    assert (eigenvalues[..., 0] >= -1e-12 * np.maximum(eigenvalues[..., -1], scale)).all(), (
        eigenvalues.min()
    )


def by_age(y: np.ndarray, delay: np.ndarray) -> np.ndarray:
    """Measurements ``(T, ..., ages, p)`` in the order in which they come, each ``delay`` steps late."""
    late = np.broadcast_to(delay, y.shape)
    ages = late[late < len(y)].max(initial=0) + 1  # what comes after the end does not come at all
    arrived = np.full((*y.shape[:-1], ages, y.shape[-1]), np.nan)
    for age in range(ages):
        arrived[age:, ..., age, :] = np.where(late == age, y, np.nan)[: len(y) - age]
    return arrived
