"""Laws of the filters with unknown input: what they share with each other, with the papers and with least squares."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from scipy.linalg import block_diag

from estimators import (
    Belief,
    Gaussian,
    LinearModel,
    NonlinearModel,
    Schedule,
    chi_square_band,
    compiled,
    input_delayed,
    make,
    nees,
    rmse,
    stacked,
)
from tests.estimators.cases import (
    INPUT_PRIOR,
    Case,
    Record,
    System,
    assert_same,
    every_case,
    flat_prior_posterior,
    observable_directions,
    pushed_vehicle,
    shaken_vehicle,
    simulate,
    some_measurements,
    track,
    unknown_input_system,
)
from tests.estimators.test_reference import darouach

NO_FEEDTHROUGH = ["kf-umv-ui-wdf", "ekf-ui-wdf", "ukf-umv", "ulise"]
MIXED = [(4, 4, 2, 1), (5, 5, 3, 1), (5, 5, 3, 2)]
"""(n, p, q, rank H) with 0 < rank H < q."""


def _mixed(seed: int, n: int, p: int, q: int, rank: int) -> System:
    return unknown_input_system(seed, True, n, p, q, rank=rank)


def _one_run(record: Record) -> Record:
    return record._replace(y=record.y[:, 0], u=record.u[:, 0])


def _as_functions(model: LinearModel) -> NonlinearModel:
    """The linear model as functions that tell nothing of their being linear."""
    return NonlinearModel(
        compiled(model.transition),
        compiled(model.measurement),
        model.Q,
        model.R,
        G=model.G,
        H=model.H,
    )


# --- the papers, and least squares over a whole run -----------------------------------------------


def _yong_zhu_frazzoli(
    system: System, y: np.ndarray, u: np.ndarray
) -> list[tuple[np.ndarray, ...]]:
    """ULISE as printed: the measurements transformed by the singular vectors of H, with inverses and a pseudo-inverse.

    At each time after the first: x, P, d(k-1) whole and its covariance, d1(k) and its covariance.
    """
    model = system.model
    A, B, C, G, H, Q, R = (getattr(model, name) for name in "ABCGHQR")
    U, s, Vt = np.linalg.svd(H)
    r, inv = int((s > 1e-9).sum()), np.linalg.inv
    U1, U2, V1, V2 = U[:, :r], U[:, r:], Vt[:r].T, Vt[r:].T
    T1, T2 = U1.T - U1.T @ R @ U2 @ inv(U2.T @ R @ U2) @ U2.T, U2.T
    C1, C2, R1, R2 = T1 @ C, T2 @ C, T1 @ R @ T1.T, T2 @ R @ T2.T
    G1, G2, M1, V = G @ V1, G @ V2, np.diag(1.0 / s[:r]), np.hstack([V1, V2])
    eye = np.eye(model.n)
    K = (
        system.cov @ C2.T @ inv(C2 @ system.cov @ C2.T + R2)
    )  # the first measurement: no input came before it
    x, P, out = system.mean + K @ (T2 @ y[0] - C2 @ system.mean), (eye - K @ C2) @ system.cov, []
    for k in range(1, len(y)):
        d1, Pd1 = M1 @ (T1 @ y[k - 1] - C1 @ x), M1 @ (C1 @ P @ C1.T + R1) @ M1.T
        hat = A - G1 @ M1 @ C1
        tilde = hat @ P @ hat.T + Q + G1 @ M1 @ R1 @ M1.T @ G1.T
        weight = inv(C2 @ tilde @ C2.T + R2)
        Pd2 = inv(G2.T @ C2.T @ weight @ C2 @ G2)
        M2 = Pd2 @ G2.T @ C2.T @ weight
        xp, z2 = A @ x + B @ u[k - 1] + G1 @ d1, T2 @ y[k]
        d2, P12 = M2 @ (z2 - C2 @ xp), (M1 @ C1 @ P @ A.T - Pd1 @ G1.T) @ C2.T @ M2.T
        N, W, star = eye - G2 @ M2 @ C2, G2 @ M2 @ R2, xp + G2 @ d2
        Ps = G2 @ M2 @ R2 @ M2.T @ G2.T + N @ tilde @ N.T
        Rs = C2 @ Ps @ C2.T + R2 - C2 @ W - W.T @ C2.T
        L = (Ps @ C2.T - W) @ np.linalg.pinv(Rs, rcond=1e-9, hermitian=True)
        x, Nn = star + L @ (z2 - C2 @ star), eye - L @ C2
        P = Nn @ Ps @ Nn.T + L @ R2 @ L.T + L @ W.T @ Nn.T + Nn @ W @ L.T
        now, now_cov = M1 @ (T1 @ y[k] - C1 @ x), M1 @ (C1 @ P @ C1.T + R1) @ M1.T
        past_cov = V @ np.block([[Pd1, P12], [P12.T, Pd2]]) @ V.T
        out.append((x, P, V1 @ d1 + V2 @ d2, past_cov, V1 @ now, V1 @ now_cov @ V1.T))
    return out


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("n", "p", "q", "rank"), [(4, 3, 1, 0), *MIXED, (4, 3, 2, 2)])
def test_ulise_gives_what_the_formulas_of_its_paper_give(
    seed: int, n: int, p: int, q: int, rank: int
):
    system = _mixed(seed, n, p, q, rank)
    record = _one_run(simulate(system, seed, runs=1, steps=30))
    beliefs = track(make("ulise", system.model, input_prior=1e3), system.prior, record)[1:]
    for b, expected in zip(beliefs, _yong_zhu_frazzoli(system, record.y, record.u), strict=True):
        given = b.mean, b.cov, b.input_mean, b.input_cov, b.feedthrough_mean, b.feedthrough_cov
        for one, other in zip(given, expected, strict=True):
            np.testing.assert_allclose(
                one, other, rtol=0, atol=1e-9 * max(1.0, np.abs(other).max())
            )


def _least_squares_over_the_run(
    system: System, y: np.ndarray, u: np.ndarray, available: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The last two states and inputs of a run and their covariance, by one weighted least-squares problem.

    Unknowns are all states and all inputs, ``x_0, d_0, x_1, d_1, ...``; nothing is known of any
    input beforehand. In the directions in which the last measurement does not show d, it gets unit
    information, to be left out by the caller.
    """
    model, steps = system.model, len(y)
    n, width = model.n, model.n + model.q
    A, B, C, G, H, Q, R = (getattr(model, name) for name in "ABCGHQR")
    information, right = np.zeros((steps * width, steps * width)), np.zeros(steps * width)

    def add(rows: np.ndarray, value: np.ndarray, cov: np.ndarray, columns: slice) -> None:
        weight = np.linalg.inv(cov)
        information[columns, columns] += rows.T @ weight @ rows
        right[columns] += rows.T @ weight @ value

    add(np.eye(n), system.mean, system.cov, slice(n))
    for k in range(steps):
        seen, here = available[k], slice(k * width, (k + 1) * width)
        add(np.hstack([C, H])[seen], y[k][seen], R[seen][:, seen], here)
        if k:
            both = slice((k - 1) * width, k * width + n)
            add(np.hstack([-A, -G, np.eye(n)]), B @ u[k - 1], Q, both)
    information[-model.q :, -model.q :] += np.eye(model.q) - observable_directions(H[available[-1]])
    cov = np.linalg.inv(information)
    last = slice(-2 * width, None)
    return (cov @ right)[last], cov[last, last]


def _assert_least_squares(
    filter_name: str, system: System, belief: Belief, record: Record, available: np.ndarray
):
    """The belief after the last measurement is what least squares over all measurements so far give."""
    model, n, q = system.model, system.model.n, system.model.q
    expected, cov = _least_squares_over_the_run(system, record.y, record.u, available)
    past, state, present = slice(n, n + q), slice(n + q, 2 * n + q), slice(2 * n + q, None)
    close = {"rtol": 0, "atol": 1e-9 * max(1.0, np.abs(cov).max())}
    np.testing.assert_allclose(belief.mean, expected[state], **close)
    np.testing.assert_allclose(belief.cov, cov[state, state], **close)
    now, given = (
        observable_directions(model.H[available[-1]]),
        (belief.input_mean, belief.input_cov),
    )
    if filter_name == "kf-umv-ui":
        np.testing.assert_allclose(given[0], expected[present], **close)
        np.testing.assert_allclose(given[1], cov[present, present], **close)
        return
    # What its own measurement showed of d(k-1) is not smoothed by the next one, so only the rest is
    # compared.
    rest = np.eye(q) - observable_directions(model.H[available[-2]])
    np.testing.assert_allclose(rest @ given[0], rest @ expected[past], **close)
    np.testing.assert_allclose(rest @ given[1] @ rest, rest @ cov[past, past] @ rest, **close)
    if filter_name == "ulise":
        np.testing.assert_allclose(belief.feedthrough_mean, now @ expected[present], **close)
        np.testing.assert_allclose(
            belief.feedthrough_cov, now @ cov[present, present] @ now, **close
        )


@pytest.mark.parametrize("seed", range(2))
@every_case("unknown-input", "linear")
def test_the_filter_gives_what_least_squares_over_the_whole_run_give(case: Case, seed: int):
    """Nothing that measurements show of the newest state is lost on the way, with one channel missing at times."""
    system, steps = case.system(seed), 8
    p = system.model.p
    record = _one_run(simulate(system, seed, runs=1, steps=steps))
    available = np.arange(p) != np.random.default_rng(seed).integers(2 * p, size=(steps, 1))
    belief = track(case.make(system.model), system.prior, record, available=available)[-1]
    _assert_least_squares(case.name, system, belief, record, available)


def test_ulise_leaves_to_the_next_measurement_what_a_dropped_channel_of_feedthrough_would_have_shown():
    system = unknown_input_system(0, True)
    model = dataclasses.replace(system.model, H=np.array([[2.0], [0.0], [0.0]]))
    system = dataclasses.replace(system, model=model)
    record = _one_run(simulate(system, 3, runs=1, steps=8))
    available = np.ones((8, 3), bool)
    available[[2, 3, 6], 0] = False
    beliefs = track(make("ulise", model), system.prior, record, available=available)
    _assert_least_squares("ulise", system, beliefs[-1], record, available)
    assert beliefs[6].feedthrough_observed[0, 0] == 0.0
    assert beliefs[7].input_observed[0, 0] == pytest.approx(1.0)
    # The filter with feedthrough alone has to fall back to the prior there.
    fallen = track(make("kf-umv-ui", model), system.prior, record, available=available)
    assert fallen[6].input_observed[0, 0] == 0.0
    assert np.abs(fallen[7].mean - beliefs[7].mean).max() > 0.01


# --- reductions -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "exact"),
    [("ekf-ui-wdf", "kf-umv-ui-wdf"), ("ukf-umv", "kf-umv-ui-wdf"), ("kf-umv-ui", "kf-umv-ui")],
)
def test_on_functions_that_are_linear_the_nonlinear_filters_are_the_linear_one(
    name: str, exact: str
):
    system = unknown_input_system(1, exact == "kf-umv-ui", p=4, q=2)
    record = simulate(system, 1, runs=6, steps=40)
    available = some_measurements(np.random.default_rng(1), 4, 40, 6)
    linear = track(make(exact, system.model), system.rows(6), record, available=available)
    functions = track(
        make(name, _as_functions(system.model)), system.rows(6), record, available=available
    )
    for one, other in zip(functions, linear, strict=True):
        assert_same(one, other, 1e-11)


def _with_a_white_input(model: NonlinearModel, cov: np.ndarray) -> NonlinearModel:
    """The model with d as further states, white and of this covariance."""
    n = model.n

    def transition(z: np.ndarray, u: np.ndarray) -> np.ndarray:
        x = model.transition(z[..., :n], u) + np.matvec(model.G, z[..., n:])
        return np.concatenate([x, np.zeros(z[..., n:].shape)], -1)

    return NonlinearModel(
        transition, lambda z, u: model.measurement(z[..., :n], u) + np.matvec(model.H, z[..., n:]),
        block_diag(model.Q, cov), model.R, state_angles=model.state_angles, measurement_angles=model.measurement_angles,
    )  # fmt: skip


def _shaken() -> System:
    """`shaken_vehicle` with a push that is fixed in space."""
    system = shaken_vehicle(0)
    return dataclasses.replace(
        system, model=dataclasses.replace(system.model, G=[[0.05], [0.1], [0.05], [0.02]])
    )


def test_on_a_nonlinear_system_it_is_the_limit_of_an_extended_kalman_filter_told_the_variance_of_the_input():
    system = _shaken()
    model, record = system.model, simulate(system, 3, runs=20, steps=30)
    unbiased = track(make("kf-umv-ui", model), system.rows(20), record)
    apart = []
    for variance in (1e2, 1e4, 1e6):
        cov = np.array([[variance]])
        prior = Gaussian(np.append(system.mean, 0.0), block_diag(system.cov, cov))
        prior = Gaussian(np.broadcast_to(prior.mean, (20, 5)), prior.cov)
        told = track(make("ekf", _with_a_white_input(model, cov)), prior, record)
        pairs = [
            (np.concatenate([b.mean, b.input_mean], -1), a.mean)
            for a, b in zip(told, unbiased, strict=True)
        ]
        pairs += [
            (np.concatenate([np.concatenate([b.cov, b.state_input_cov], -1),
                             np.concatenate([b.state_input_cov.mT, b.input_cov], -1)], -2), a.cov)
            for a, b in zip(told, unbiased, strict=True)
        ]  # fmt: skip
        apart.append(max(float(np.abs(one - other).max()) for one, other in pairs))
    assert apart[2] < 1e-3
    np.testing.assert_allclose(np.divide(apart[:2], apart[1:]), 100.0, rtol=0.1)


# --- what hardly shows ----------------------------------------------------------------------------

WEAK = {
    "kf-umv-ui": lambda seed: unknown_input_system(seed, True, p=4, q=2),
    **{name: lambda seed: unknown_input_system(seed, False, p=4, q=2) for name in NO_FEEDTHROUGH},
    "ulise with full feedthrough": lambda seed: unknown_input_system(seed, True, p=4, q=2),
    "ulise with one input of two fed through": lambda seed: unknown_input_system(
        seed, True, p=4, q=2, rank=1
    ),
}
CORRELATED = np.array([[1.0, 0.3], [0.3, 0.2]])
"""A covariance of two inputs: the measurements of these systems show some directions well and others hardly."""


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", ["kf-umv-ui", "kf-umv-ui-wdf", "ekf-ui-wdf", "ukf-umv", "ulise"])
def test_what_hardly_shows_is_estimated_as_by_a_kalman_filter_told_its_prior(name: str, seed: int):
    """A whole run, any measurements missing: d is a white state of the prior's covariance, but for what shows well."""
    system, steps = WEAK[name](seed), 40
    model, n, q = system.model, system.model.n, system.model.q
    record = _one_run(simulate(system, seed, runs=1, steps=steps))
    available = np.random.default_rng(seed).random((steps, model.p)) < 0.5
    filter, root = make(name, model, input_prior=CORRELATED), np.linalg.cholesky(CORRELATED)
    beliefs = track(filter, system.prior, record, available=available)
    mean, cov, late, kinds = system.mean, system.cov, np.zeros((n, q)), set()
    for k, (belief, mask) in enumerate(zip(beliefs, available, strict=True)):
        C, H, R = model.C[mask], model.H[mask], model.R[mask][:, mask]
        F = (C @ late + H) @ root
        values, directions = np.linalg.eigh(F.T @ np.linalg.inv(C @ cov @ C.T + R) @ F)
        kinds |= {
            "well" if value > 0.1 else "hardly" if value > 1e-6 else "not" for value in values
        }
        hidden = directions[:, values <= 0.1]
        precision = np.linalg.inv(root).T @ hidden @ hidden.T @ np.linalg.inv(root)
        posterior, joint = flat_prior_posterior(
            mean, cov, late, C, H, R, record.y[k][mask], precision
        )
        close = {"rtol": 0, "atol": 1e-9 * max(1.0, np.abs(joint).max())}
        np.testing.assert_allclose(
            np.concatenate([belief.mean, belief.input_mean]), posterior, **close
        )
        np.testing.assert_allclose(belief.cov, joint[:n, :n], **close)
        np.testing.assert_allclose(belief.input_cov, joint[n:, n:], **close)
        np.testing.assert_allclose(belief.state_input_cov, joint[:n, n:], **close)
        mean, cov = posterior[:n], joint[:n, :n]
        drive = np.hstack([model.A, model.G])
        if filter.input_delay:
            mean, cov, late = model.A @ mean, model.A @ cov @ model.A.T, model.G
        else:
            mean, cov = drive @ posterior, drive @ joint @ drive.T
        mean, cov = mean + model.B @ record.u[k], cov + model.Q
    assert kinds == {"well", "hardly", "not"}


@pytest.mark.parametrize(
    "family", ["kf-umv-ui", "ekf-ui-wdf", "ulise with one input of two fed through"]
)
def test_in_which_coordinates_an_input_is_told_does_not_matter(family: str):
    """Other units of each input, and sums of them: measurements missing, too."""
    system, name = WEAK[family](1), family.split(" ")[0]
    record = simulate(system, 1, runs=6, steps=25)
    available = np.random.default_rng(1).random((25, 6, 4)) < 0.7
    T = np.array([[1e6, 0.0], [5e-4, 1e-3]])
    back = np.linalg.inv(T)
    changed = dataclasses.replace(system.model, G=system.model.G @ back, H=system.model.H @ back)
    plain, told = (
        track(make(name, model, input_prior=cov), system.rows(6), record, available=available)
        for model, cov in ((system.model, CORRELATED), (changed, T @ CORRELATED @ T.T))
    )
    for one, other in zip(plain, told, strict=True):
        for given, expected in (
            (other.mean, one.mean), (other.cov, one.cov), (np.matvec(back, other.input_mean), one.input_mean),
            (back @ other.input_cov @ back.T, one.input_cov), (back @ other.input_observed @ T, one.input_observed),
        ):  # fmt: skip
            np.testing.assert_allclose(
                given, expected, rtol=0, atol=1e-7 * max(1.0, np.abs(expected).max())
            )


def test_what_ulise_hardly_sees_at_once_it_sees_without_bias_in_the_next_measurement():
    system = unknown_input_system(2, True, p=4, q=2)
    model = dataclasses.replace(system.model, H=system.model.H * [1.0, 1e-3])
    d = np.zeros((9, 1, 2))
    d[4] = 0.0, 1e3
    record = simulate(dataclasses.replace(system, model=model), 2, runs=1, steps=9, d=d, noise=0.0)
    beliefs = track(make("ulise", model, input_prior=INPUT_PRIOR), system.rows(1), record)
    np.testing.assert_allclose(np.trace(beliefs[4].feedthrough_observed[0]), 1.0, rtol=1e-9)
    errors = [float(np.abs(b.mean - x).max()) for b, x in zip(beliefs, record.x, strict=True)]
    assert errors[4] > 0.1
    assert max(errors[:4] + errors[5:]) < 1e-9
    np.testing.assert_allclose(beliefs[5].input_mean, d[4], rtol=0, atol=1e-9)


# --- an input that is a state ---------------------------------------------------------------------


def _begun_alike(
    system: System, record: Record, available: np.ndarray, filter_name: str, model: object
) -> tuple:
    """Beliefs of `kf-umv-ui`, and of a filter of the stacked model that begins with what that knows of (x, d)."""
    direct = track(
        make("kf-umv-ui", system.model, input_prior=INPUT_PRIOR),
        system.rows(6),
        record,
        None,
        available,
    )
    late = make(filter_name, model, input_prior=INPUT_PRIOR)
    belief = late.init(Gaussian(*_joint(direct[0])))
    beliefs = []
    for k in range(1, len(record.y)):
        belief = late.update(
            late.predict(belief, record.u[k - 1]), record.y[k], available=available[k]
        )
        beliefs.append(belief)
    return direct[1:], beliefs


def _joint(belief: Belief) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of state and input together."""
    cov = np.block(
        [[belief.cov, belief.state_input_cov], [belief.state_input_cov.mT, belief.input_cov]]
    )
    return np.concatenate([belief.mean, belief.input_mean], -1), 0.5 * (cov + cov.mT)


def _assert_stacked_is_direct(direct: list[Belief], late: list[Belief], tolerance: float) -> None:
    """What the one says of (x, d) now the other says of its state, and again of d as the input of the step before."""
    n = direct[0].mean.shape[-1]
    for one, other in zip(direct, late, strict=True):
        for given, expected in (
            *zip((other.mean, other.cov), _joint(one), strict=True), (other.mean[..., n:], other.input_mean),
            (other.cov[..., n:, n:], other.input_cov), (other.input_observed, one.input_observed),
        ):  # fmt: skip
            close = tolerance * max(1.0, float(np.abs(expected).max()))
            np.testing.assert_allclose(given, expected, rtol=0, atol=close)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("name", ["kf-umv-ui-wdf", "ekf-ui-wdf", "ukf-umv", "ulise"])
def test_with_the_input_as_a_state_filters_without_feedthrough_are_the_one_with_it(
    name: str, seed: int
):
    system = unknown_input_system(seed, True, p=4, q=2)
    record = simulate(system, seed, runs=6, steps=30)
    available = some_measurements(np.random.default_rng(seed), 4, 30, 6)
    _assert_stacked_is_direct(
        *_begun_alike(system, record, available, name, stacked(system.model)), 1e-9
    )
    if name in ("ekf-ui-wdf", "ukf-umv"):
        functions = stacked(_as_functions(system.model))
        _assert_stacked_is_direct(*_begun_alike(system, record, available, name, functions), 1e-9)


@pytest.mark.parametrize("own", [False, True], ids=["traced", "with Jacobians"])
def test_with_the_input_as_a_state_a_nonlinear_system_is_followed_as_with_feedthrough(own: bool):
    system = _shaken()
    model = system.model
    if own:
        jacobians = {
            f"{name}_jacobian": lambda x, u, name=name: getattr(model, f"linearise_{name}")(x, u)[1]
            for name in ("transition", "measurement")
        }
        system = dataclasses.replace(system, model=dataclasses.replace(model, **jacobians))
    record = simulate(system, 2, runs=6, steps=30)
    available = some_measurements(np.random.default_rng(2), 3, 30, 6)
    told = stacked(system.model)
    assert (told.transition_jacobian is not None) == (told.measurement_jacobian is not None) == own
    for name in ("transition", "measurement"):
        assert own or told.is_compiled(name)
    _assert_stacked_is_direct(*_begun_alike(system, record, available, "ekf-ui-wdf", told), 1e-7)


@pytest.mark.parametrize("way", ["rows", "schedule", "function"])
def test_matrices_of_many_rows_or_of_the_known_input_stay_so_with_the_input_as_a_state(way: str):
    systems = [unknown_input_system(seed, True, p=4, q=2) for seed in range(6)]
    tables = {name: np.stack([getattr(s.model, name) for s in systems]) for name in "ABCGHQR"}
    record = simulate(systems[0], 0, runs=6, steps=12)
    record.u[..., 0] = np.arange(6)

    def told(name: str) -> object:
        table = tables[name]
        if way == "rows" or name in "CHQR":
            return table if way == "rows" else table[0]
        return (
            Schedule(table, 0, 1.0, 0.5)
            if way == "schedule"
            else lambda u: table[u[..., 0].astype(int)]
        )

    model = LinearModel(**{name: told(name) for name in "ABCGHQR"})
    given = stacked(model)
    assert isinstance(given.A, {"rows": np.ndarray, "schedule": Schedule, "function": object}[way])
    filter = make("kf-umv-ui-wdf", given, input_prior=INPUT_PRIOR)
    whole = track(filter, Gaussian(np.zeros((6, 6)), np.eye(6)), record)[-1]
    for i, system in enumerate(systems):
        shared = {name: tables[name][i if way == "rows" else 0] for name in "CHQR"}
        alone = make(
            "kf-umv-ui-wdf",
            stacked(dataclasses.replace(system.model, **shared)),
            input_prior=INPUT_PRIOR,
        )
        row = record._replace(y=record.y[:, i], u=record.u[:, i])
        expected = track(alone, Gaussian(np.zeros(6), np.eye(6)), row)[-1]
        np.testing.assert_allclose(
            whole.mean[i], expected.mean, rtol=0, atol=1e-9 * np.abs(expected.mean).max()
        )


def test_a_model_without_unknown_input_has_none_to_be_a_state():
    for model in (_matrices(), _functions()):
        assert _refusal(lambda model=model: stacked(model)).startswith(
            "stacked needs an unknown input"
        )


# --- matrices that change -------------------------------------------------------------------------


def test_feedthrough_may_be_a_function_of_the_known_input_and_of_another_rank_in_every_row():
    system, rows = _mixed(0, 4, 4, 2, 1), 3
    model, rng = system.model, np.random.default_rng(0)
    H = np.stack([np.zeros((4, 2)), model.H, rng.normal(size=(4, 2))])
    record = simulate(system, 0, rows, 12)
    record.u[..., 0] = np.arange(rows)

    def run(feedthrough: object, rows: object) -> Belief:
        filter = make("ulise", dataclasses.replace(model, H=feedthrough), input_prior=1e3)
        belief = filter.init(system.rows(*record.y[0, rows].shape[:-1]))
        for y, u in zip(record.y[:, rows], record.u[:, rows], strict=True):
            belief = filter.predict(filter.update(belief, y, u=u), u)
        return filter.update(belief, record.y[0, rows])

    scheduled, batched = run(lambda u: H[u[..., 0].astype(int)], slice(None)), run(H, slice(None))
    assert_same(scheduled, batched, 1e-12)
    for i in range(rows):
        assert_same(batched[i], run(H[i], i), 1e-12)
    ranks = np.trace(batched.feedthrough_observed, axis1=-2, axis2=-1)
    np.testing.assert_allclose(ranks, [0.0, 1.0, 2.0], rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ["ekf-ui-wdf", "ukf-umv"])
def test_a_driven_direction_that_depends_on_the_state_is_taken_at_the_estimate_before_the_step(
    name: str,
):
    system = pushed_vehicle(0)
    model, filter = system.model, make(name, system.model)
    record = _one_run(simulate(system, 0, runs=1, steps=6))
    belief = track(filter, system.prior, record)[-1]
    predicted = filter.predict(belief, record.u[-1])
    G = model.G(belief.mean, record.u[-1])
    np.testing.assert_array_equal(predicted.input_matrix, G)
    y = model.measurement(predicted.mean, None) + 0.01
    fixed = make(name, dataclasses.replace(model, G=G))
    expected = fixed.update(predicted.replace(input_matrix=None), y)
    assert_same(filter.update(predicted, y).replace(input_matrix=None), expected, 1e-13)
    elsewhere = model.G(belief.mean + np.array([0.0, 0.0, 0.5, 0.0]), None)
    moved = make(name, dataclasses.replace(model, G=elsewhere)).update(
        predicted.replace(input_matrix=None), y
    )
    assert np.abs(moved.mean - expected.mean).max() > 1e-4


# --- bias and consistency -------------------------------------------------------------------------

RUNS = 1000


def _errors(filter_name: str, system: System, model: LinearModel | NonlinearModel, seed: int):
    """Errors of state and input at the end of some runs, and the covariance that the filter gives for each."""
    record = simulate(system, seed, RUNS, 25)
    filter = make(filter_name, model, input_prior=INPUT_PRIOR)
    final = track(filter, system.rows(RUNS), record)[-1]
    d = record.d[-1 - filter.input_delay]
    return (final.mean - record.x[-1], final.cov), (final.input_mean - d, final.input_cov)


def _assert_unbiased_and_consistent(errors: np.ndarray, cov: np.ndarray) -> None:
    """Every mean within 3 standard errors (false alarm 0.27 %), and the NEES within its band of 99.7 %."""
    assert (np.abs(errors.mean(0)) < 3.0 * errors.std(0, ddof=1) / np.sqrt(len(errors))).all()
    low, high = chi_square_band(len(errors), errors.shape[-1], 0.997)
    assert low < nees(errors, cov, np.zeros(errors.shape)).mean() < high


@pytest.mark.parametrize("name", ["ekf-ui-wdf", "ukf-umv"])
def test_on_the_system_of_darouach_1995_as_functions_state_and_input_are_unbiased_and_consistent(
    name: str,
):
    model = dataclasses.replace(darouach(), B=np.zeros((3, 1)))
    system = System(model, np.array([1.0, -1.0, 2.0]), 5.0 * np.eye(3), 1)
    for errors, cov in _errors(name, system, _as_functions(model), 5):
        _assert_unbiased_and_consistent(errors, cov)


def test_on_a_mildly_nonlinear_system_state_and_input_are_as_uncertain_as_the_filter_with_feedthrough_says():
    system = _shaken()
    for errors, cov in _errors("kf-umv-ui", system, system.model, 6):
        _assert_unbiased_and_consistent(errors, cov)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "ignorant"), [("ekf-ui-wdf", "ekf"), ("ukf-umv", "ukf")])
def test_a_vehicle_that_is_pushed_is_followed_by_a_filter_that_knows_of_the_push(
    name: str, ignorant: str
):
    system, runs, steps = pushed_vehicle(0), 50, 100
    record = simulate(system, 1, runs, steps)
    errors = {}
    for filter_name in (name, ignorant):
        beliefs = track(make(filter_name, system.model), system.rows(runs), record)
        errors[filter_name] = rmse(np.array([b.mean for b in beliefs[20:]]), record.x[20:], (2,))
    assert (errors[name] < 0.5 * errors[ignorant])[:3].all()  # position and heading
    estimates = np.array(
        [b.input_mean for b in track(make(name, system.model), system.rows(runs), record)[20:]]
    )
    assert rmse(estimates, record.d[19:-1])[0] < 0.5 * np.std(record.d[19:-1])


# --- what a filter refuses ------------------------------------------------------------------------

I2 = np.eye(2)


def _functions(**changes: object) -> NonlinearModel:
    given = {"transition": lambda x, u: x, "measurement": lambda x, u: x, "Q": I2, "R": I2}
    return NonlinearModel(**{**given, **changes})


def _matrices(**changes: object) -> LinearModel:
    return LinearModel(**{"A": I2, "C": I2, "Q": I2, "R": I2, **changes})


def _refusal(build: Callable[[], object]) -> str:
    with pytest.raises(ValueError, match=r"needs|gave|cannot") as caught:
        build()
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("name", ["kf-umv-ui-wdf", "ekf-ui-wdf", "ukf-umv"])
def test_filters_without_feedthrough_refuse_feedthrough_and_say_which_take_it(name: str):
    message = f"{name} needs H = 0 (no feedthrough): use kf-umv-ui or ulise"
    for H in (np.array([[0.0], [1.0]]), lambda u: np.zeros((2, 1))):
        assert _refusal(lambda H=H: make(name, _matrices(G=[[1.0], [0.0]], H=H))) == message


@pytest.mark.parametrize("name", ["ekf-ui-wdf", "ukf-umv"])
def test_nonlinear_filters_refuse_inputs_that_no_measurement_could_tell_apart(name: str):
    tail = ": measure a state that each input drives directly"
    one_measurement = {"measurement": lambda x, u: x[..., :1], "R": [[1.0]]}
    message = _refusal(lambda: make(name, _functions(G=I2, **one_measurement)))
    assert message == f"{name} needs rank(C G) = 2 unknown inputs, got at most 1{tail}"
    message = _refusal(lambda: make(name, _functions(G=np.ones((2, 2)))))
    assert message == f"{name} needs rank(C G) = 2 unknown inputs, got at most 1{tail}"
    message = _refusal(lambda: make(name, _matrices(C=[[1.0, 0.0]], R=[[1.0]], G=[[0.0], [1.0]])))
    assert message == f"{name} needs rank(C G) = 1 unknown input, got 0{tail}"
    assert "needs an unknown input" in _refusal(lambda: make(name, _functions()))


def test_a_driven_direction_of_the_wrong_shape_is_named():
    model = _functions(G=lambda x, u: np.ones((2, 2)), H=np.zeros((2, 1)))
    filter = make("ekf-ui-wdf", model)
    belief = filter.init(Gaussian(np.zeros(2), I2))
    assert (
        _refusal(lambda: filter.predict(belief))
        == "G gave a matrix of shape (2, 2), expected (..., 2, 1)"
    )
    assert "cannot tell q" in _refusal(lambda: _functions(G=lambda x, u: np.ones((2, 1))))


def test_ulise_says_which_rank_it_needs_and_what_to_do():
    hidden = {"C": [[1.0, 0.0]], "R": [[1.0]], "G": [[0.0], [1.0]]}
    advice = (
        ": measure the input, or a state that it drives directly, by a measurement that no other"
        " unknown input disturbs"
    )
    assert (
        _refusal(lambda: make("ulise", _matrices(**hidden)))
        == f"ulise needs rank(C2 G2) = q - rank(H) = 1 - 0, got 0{advice}"
    )
    # The measurement that would show the second input is taken up by the first.
    blocked = {"G": [[0.0, 1.0], [0.0, 0.0]], "H": [[1.0, 0.0], [0.0, 0.0]]}
    assert (
        _refusal(lambda: make("ulise", _matrices(**blocked)))
        == f"ulise needs rank(C2 G2) = q - rank(H) = 2 - 1, got 0{advice}"
    )
    free = {"G": [[0.0, 0.0], [0.0, 1.0]], "H": [[1.0, 0.0], [0.0, 0.0]]}
    assert make("ulise", _matrices(**free)).input_delay == 1
    rows = {"G": np.stack([free["G"], blocked["G"]]), "H": blocked["H"]}
    assert "= 2 - 1, got 0" in _refusal(lambda: make("ulise", _matrices(**rows)))


# --- numbers that do not behave -------------------------------------------------------------------


def test_retimed_a_filter_with_feedthrough_is_the_one_without():
    """X' + G d of `kf-umv-ui` on the input_delayed model is x of `kf-umv-ui-wdf`, and d is its d, whatever drops."""
    rng = np.random.default_rng(4)
    n, p, q, steps = 4, 3, 2, 60
    A = rng.standard_normal((n, n))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    C, G = rng.standard_normal((p, n)), rng.standard_normal((n, q))
    model = LinearModel(A, C, 0.1 * np.eye(n), 0.2 * np.eye(p), G=G, H=np.zeros((p, q)))
    again = input_delayed(model)
    assert pytest.approx(C @ G) == again.H
    late, now = (
        make("kf-umv-ui-wdf", model, input_prior=25.0),
        make("kf-umv-ui", again, input_prior=25.0),
    )
    prior = Gaussian(np.zeros(n), np.eye(n))
    y = rng.standard_normal((steps, p))
    y[rng.random((steps, p)) < 0.1] = np.nan
    one = late.predict(late.update(late.init(prior), y[0]))
    # The first measurement tells of no input yet: the input_delayed filter begins behind it.
    other = now.init(Gaussian(one.mean, one.cov))
    for k in range(1, steps):
        one, other = late.update(one, y[k]), now.update(other, y[k])
        assert other.input_mean == pytest.approx(one.input_mean, abs=1e-7)
        assert other.mean + G @ other.input_mean == pytest.approx(one.mean, abs=1e-7)
        one, other = late.predict(one), now.predict(other)


@pytest.mark.parametrize("given", [{}, {"G": np.ones((2, 1)), "H": np.ones((1, 1))}])
def test_retimed_needs_an_input_without_feedthrough(given):
    with pytest.raises(
        ValueError, match="input_delayed needs an unknown input without feedthrough"
    ):
        input_delayed(LinearModel(np.eye(2), np.ones((1, 2)), np.eye(2), np.eye(1), **given))
