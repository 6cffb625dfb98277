"""Laws of filters with unknown input, against each other, the papers and least squares."""

import re
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

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
    stacked,
)
from estimators.kalman import with_input
from estimators.varying import resolve
from tests.estimators.batch import least_squares
from tests.estimators.cases import (
    INPUT_PRIOR,
    Case,
    Record,
    System,
    assert_close,
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

MIXED = [(4, 4, 2, 1), (5, 5, 3, 1), (5, 5, 3, 2)]
"""(n, p, q, rank H) with 0 < rank H < q."""
I2 = np.eye(2)


def _one_run(system: System, seed: int, steps: int) -> Record:
    record = simulate(system, seed, runs=1, steps=steps)
    return record._replace(y=record.y[:, 0], u=record.u[:, 0])


def _as_functions(model: LinearModel) -> NonlinearModel:
    """The linear model as functions that tell nothing of their being linear."""
    f, h = compiled(model.transition), compiled(model.measurement)
    return NonlinearModel(f, h, model.Q, model.R, G=model.G, H=model.H)


# --- the papers, and least squares over a whole run -----------------------------------------------


def _yong_zhu_frazzoli(
    system: System, y: np.ndarray, u: np.ndarray
) -> list[tuple[np.ndarray, ...]]:
    """ULISE as printed: measurements transformed by the singular vectors of H, with inverses.

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
    # No input came before the first measurement.
    K = system.cov @ C2.T @ inv(C2 @ system.cov @ C2.T + R2)
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
    system = unknown_input_system(seed, True, n, p, q, rank=rank)
    record = _one_run(system, seed, 30)
    beliefs = track(make("ulise", system.model, input_prior=1e3), system.prior, record)[1:]
    for b, expected in zip(beliefs, _yong_zhu_frazzoli(system, record.y, record.u), strict=True):
        given = b.mean, b.cov, b.input_mean, b.input_cov, b.feedthrough_mean, b.feedthrough_cov
        for one, other in zip(given, expected, strict=True):
            assert_close(one, other, 1e-9)


def _assert_least_squares(
    name: str, system: System, belief: Belief, record: Record, available: np.ndarray
):
    """The belief at the end is what least squares over all measurements give."""
    model, n, q = system.model, system.model.n, system.model.q
    seen_before, now = (observable_directions(model.H[mask]) for mask in available[-2:])
    unseen = np.linalg.svd(np.eye(q) - now)[0][:, : q - round(np.trace(now))].T
    y = np.where(available, record.y, np.nan)
    found = least_squares(system, y, record.u, {len(y) - 1: unseen})
    first = len(y) * n
    blocks = slice(first - n, first), slice(-2 * q, -q), slice(-q, None)
    state, past, present = (found.cov[block, block] for block in blocks)
    assert_close(belief.mean, found.x[-1], 1e-9)
    assert_close(belief.cov, state, 1e-9)
    if name == "kf-umv-ui":
        assert_close(belief.input_mean, found.d[-1], 1e-9)
        assert_close(belief.input_cov, present, 1e-9)
        return
    # What its own measurement showed of d(k-1) is not smoothed by the next one, so only the rest is
    # compared.
    rest = np.eye(q) - seen_before
    assert_close(rest @ belief.input_mean, rest @ found.d[-2], 1e-9)
    assert_close(rest @ belief.input_cov @ rest, rest @ past @ rest, 1e-9)
    if name == "ulise":
        assert_close(belief.feedthrough_mean, now @ found.d[-1], 1e-9)
        assert_close(belief.feedthrough_cov, now @ present @ now, 1e-9)


@pytest.mark.parametrize("seed", range(2))
@every_case("unknown-input", "linear")
def test_the_filter_gives_what_least_squares_over_the_whole_run_give(case: Case, seed: int):
    """Nothing that measurements show is lost on the way, with one channel missing at times."""
    system, steps = case.system(seed), 8
    p = system.model.p
    record = _one_run(system, seed, steps)
    available = np.arange(p) != np.random.default_rng(seed).integers(2 * p, size=(steps, 1))
    belief = track(case.make(system.model), system.prior, record, available=available)[-1]
    _assert_least_squares(case.name, system, belief, record, available)


def test_ulise_leaves_to_the_next_measurement_what_a_dropped_channel_would_have_shown():
    system = unknown_input_system(0, True)
    system = replace(system, model=replace(system.model, H=np.array([[2.0], [0.0], [0.0]])))
    record, available = _one_run(system, 3, 8), np.ones((8, 3), bool)
    available[[2, 3, 6], 0] = False
    beliefs = track(make("ulise", system.model), system.prior, record, available=available)
    _assert_least_squares("ulise", system, beliefs[-1], record, available)
    assert beliefs[6].feedthrough_observed[0, 0] == 0.0
    assert beliefs[7].input_observed[0, 0] == pytest.approx(1.0)


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
    linear, functions = (
        track(filter, system.rows(6), record, available=available)
        for filter in (make(exact, system.model), make(name, _as_functions(system.model)))
    )
    for one, other in zip(functions, linear, strict=True):
        assert_same(one, other, 1e-11)


@pytest.mark.parametrize("name", ["ekf-ui-wdf", "ukf-umv"])
def test_a_driven_direction_that_depends_on_the_state_is_taken_at_the_estimate_before_the_step(
    name: str,
):
    system = pushed_vehicle(0)
    filter, record = make(name, system.model), _one_run(system, 0, 6)
    belief = track(filter, system.prior, record)[-1]
    predicted = filter.predict(belief, record.u[-1])
    G = system.model.G(belief.mean, record.u[-1])
    np.testing.assert_array_equal(predicted.input_matrix, G)
    assert np.abs(G - system.model.G(predicted.mean, None)).max() > 1e-4


# --- what hardly shows ----------------------------------------------------------------------------


def _weak(name: str, seed: int) -> System:
    rank = 1 if name == "ulise" else 2
    return unknown_input_system(seed, name in ("kf-umv-ui", "ulise"), p=4, q=2, rank=rank)


CORRELATED = np.array([[1.0, 0.3], [0.3, 0.2]])
"""A covariance of two inputs, of which some directions show well and others hardly."""


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", ["kf-umv-ui", "kf-umv-ui-wdf", "ekf-ui-wdf", "ukf-umv", "ulise"])
def test_what_hardly_shows_is_estimated_as_by_a_kalman_filter_told_its_prior(name: str, seed: int):
    """Any measurements missing: d is white and has its prior, but for what shows well."""
    system, steps = unknown_input_system(seed, name == "kf-umv-ui", p=4, q=2), 40
    model, n, q = system.model, system.model.n, system.model.q
    record = _one_run(system, seed, steps)
    available = np.random.default_rng(seed).random((steps, model.p)) < 0.5
    filter, root = make(name, model, input_prior=CORRELATED), np.linalg.cholesky(CORRELATED)
    beliefs = track(filter, system.prior, record, available=available)
    mean, cov, late, kinds = system.mean, system.cov, np.zeros((n, q)), set()
    for k, (belief, mask) in enumerate(zip(beliefs, available, strict=True)):
        C, H, R = model.C[mask], model.H[mask], model.R[mask][:, mask]
        F = (C @ late + H) @ root
        values, directions = np.linalg.eigh(F.T @ np.linalg.inv(C @ cov @ C.T + R) @ F)
        kinds |= set(np.digitize(values, [1e-6, 0.1]).tolist())
        hidden = np.linalg.inv(root).T @ directions[:, values <= 0.1]
        posterior, joint = flat_prior_posterior(
            mean, cov, late, C, H, R, record.y[k][mask], hidden @ hidden.T
        )
        for one, other in zip(with_input(belief), (posterior, joint), strict=True):
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-9 * np.abs(joint).max())
        drive = np.hstack([model.A, model.G * (not filter.input_delay)])
        late = model.G * filter.input_delay
        mean = drive @ posterior + model.B @ record.u[k]
        cov = drive @ joint @ drive.T + model.Q
    assert kinds == {0, 1, 2}  # not, hardly, well


@pytest.mark.parametrize("name", ["kf-umv-ui", "ekf-ui-wdf", "ulise"])
def test_in_which_coordinates_an_input_is_told_does_not_matter(name: str):
    """Other units of each input, and sums of them: measurements missing, too."""
    system = _weak(name, 1)
    record = simulate(system, 1, runs=6, steps=25)
    available = np.random.default_rng(1).random((25, 6, 4)) < 0.7
    T = np.array([[1e6, 0.0], [5e-4, 1e-3]])
    back = np.linalg.inv(T)
    changed = replace(system.model, G=system.model.G @ back, H=system.model.H @ back)
    plain, told = (
        track(make(name, model, input_prior=cov), system.rows(6), record, available=available)
        for model, cov in ((system.model, CORRELATED), (changed, T @ CORRELATED @ T.T))
    )
    for one, other in zip(plain, told, strict=True):
        assert_close(other.mean, one.mean, 1e-7)
        assert_close(other.cov, one.cov, 1e-7)
        assert_close(np.matvec(back, other.input_mean), one.input_mean, 1e-7)
        assert_close(back @ other.input_cov @ back.T, one.input_cov, 1e-7)
        assert_close(back @ other.input_observed @ T, one.input_observed, 1e-7)


def test_what_ulise_hardly_sees_at_once_it_sees_without_bias_in_the_next_measurement():
    system = unknown_input_system(2, True, p=4, q=2)
    system = replace(system, model=replace(system.model, H=system.model.H * [1.0, 1e-3]))
    d = np.zeros((9, 1, 2))
    d[4] = 0.0, 1e3
    record = simulate(system, 2, runs=1, steps=9, d=d, noise=0.0)
    beliefs = track(make("ulise", system.model, input_prior=INPUT_PRIOR), system.rows(1), record)
    np.testing.assert_allclose(np.trace(beliefs[4].feedthrough_observed[0]), 1.0, rtol=1e-9)
    errors = [float(np.abs(b.mean - x).max()) for b, x in zip(beliefs, record.x, strict=True)]
    assert errors[4] > 0.1
    assert max(errors[:4] + errors[5:]) < 1e-9
    np.testing.assert_allclose(beliefs[5].input_mean, d[4], rtol=0, atol=1e-9)


def test_feedthrough_may_be_a_function_of_the_known_input_and_of_another_rank_in_every_row():
    system, rows = unknown_input_system(0, True, 4, 4, 2, rank=1), 3
    model, rng = system.model, np.random.default_rng(0)
    H = np.stack([np.zeros((4, 2)), model.H, rng.normal(size=(4, 2))])
    record = simulate(system, 0, rows, 12)
    record.u[..., 0] = np.arange(rows)

    def run(feedthrough: object, row: object) -> Belief:
        filter = make("ulise", replace(model, H=feedthrough), input_prior=1e3)
        belief = filter.init(system.rows(*record.y[0, row].shape[:-1]))
        for y, u in zip(record.y[:, row], record.u[:, row], strict=True):
            belief = filter.predict(filter.update(belief, y, u=u), u)
        return filter.update(belief, record.y[0, row])

    scheduled, batched = run(lambda u: H[u[..., 0].astype(int)], slice(None)), run(H, slice(None))
    assert_same(scheduled, batched, 1e-12)
    for i in range(rows):
        assert_same(batched[i], run(H[i], i), 1e-12)
    ranks = np.trace(batched.feedthrough_observed, axis1=-2, axis2=-1)
    np.testing.assert_allclose(ranks, [0.0, 1.0, 2.0], rtol=0, atol=1e-12)


# --- an input that is a state, or comes a step later ----------------------------------------------


def _assert_stacked_is_direct(
    system: System, model: LinearModel | NonlinearModel, name: str, tolerance: float
) -> None:
    """A filter of the stacked model says of its state what `kf-umv-ui` says of (x, d).

    And again of d as the input of the step before. It begins with what `kf-umv-ui` knows at first.
    """
    record, n, p = simulate(system, 1, runs=6, steps=30), system.model.n, system.model.p
    available = some_measurements(np.random.default_rng(1), p, 30, 6)
    direct = make("kf-umv-ui", system.model, input_prior=INPUT_PRIOR)
    direct = track(direct, system.rows(6), record, None, available)
    late = make(name, stacked(model), input_prior=INPUT_PRIOR)
    belief = late.init(Gaussian(*with_input(direct[0])))
    for k in range(1, 30):
        belief = late.predict(belief, record.u[k - 1])
        belief, expected = late.update(belief, record.y[k], available=available[k]), direct[k]
        mean, cov = with_input(expected)
        assert_close(belief.mean, mean, tolerance)
        assert_close(belief.cov, cov, tolerance)
        assert_close(belief.mean[..., n:], belief.input_mean, tolerance)
        assert_close(belief.cov[..., n:, n:], belief.input_cov, tolerance)
        assert_close(belief.input_observed, expected.input_observed, tolerance)


@pytest.mark.parametrize("name", ["kf-umv-ui-wdf", "ekf-ui-wdf", "ukf-umv", "ulise"])
def test_with_the_input_as_a_state_filters_without_feedthrough_are_the_one_with_it(name: str):
    system = unknown_input_system(1, True, p=4, q=2)
    functions = name in ("ekf-ui-wdf", "ukf-umv")
    model = _as_functions(system.model) if functions else system.model
    _assert_stacked_is_direct(system, model, name, 1e-9)


def _shaken() -> System:
    """`shaken_vehicle` with a push that is fixed in space."""
    system = shaken_vehicle(0)
    return replace(system, model=replace(system.model, G=[[0.05], [0.1], [0.05], [0.02]]))


@pytest.mark.parametrize("own", [False, True], ids=["traced", "with Jacobians"])
def test_with_the_input_as_a_state_a_nonlinear_system_is_followed_as_with_feedthrough(own: bool):
    system = _shaken()
    model = system.model
    if own:
        jacobians = {
            f"{name}_jacobian": lambda x, u, name=name: getattr(system.model, f"linearise_{name}")(
                x, u
            )[1]
            for name in ("transition", "measurement")
        }
        model = replace(system.model, **jacobians)
    given = stacked(model)
    assert (
        (given.transition_jacobian is not None) == (given.measurement_jacobian is not None) == own
    )
    assert own or given.is_compiled("transition", "measurement")
    _assert_stacked_is_direct(system, model, "ekf-ui-wdf", 1e-7)


def test_matrices_of_many_rows_or_of_the_known_input_stay_so_with_the_input_as_a_state():
    models = [unknown_input_system(seed, True, p=4, q=2).model for seed in range(3)]
    tables = {name: np.stack([getattr(model, name) for model in models]) for name in "ABCGHQR"}
    u = np.arange(3.0)[:, None]
    ways: dict[type, Callable] = {
        np.ndarray: lambda table: table,
        Schedule: lambda table: Schedule(table, 0, 1.0, 0.5),
        type(lambda: 0): lambda table: lambda u: table[u[..., 0].astype(int)],
    }
    for kind, way in ways.items():
        changing = {name: way(tables[name]) for name in "ABG"}
        given = stacked(replace(models[0], **changing))
        assert isinstance(given.A, kind)
        for i, model in enumerate(models):
            changing = {name: getattr(model, name) for name in "ABG"}
            expected = stacked(replace(models[0], **changing))
            for name in "ABG":
                matrix = resolve(getattr(given, name), u)
                matrix = matrix[i] if matrix.ndim > 2 else matrix
                np.testing.assert_array_equal(matrix, getattr(expected, name))


def test_without_direct_feedthrough_the_input_delayed_filter_is_the_one_with_it():
    """Whatever drops: X' + G d of `kf-umv-ui` is x of `kf-umv-ui-wdf`, and d is its d."""
    system = unknown_input_system(4, False, p=4, q=2)
    model = replace(system.model, B=None)
    again = input_delayed(model)
    late, now = (
        make(name, each, input_prior=25.0)
        for name, each in (("kf-umv-ui-wdf", model), ("kf-umv-ui", again))
    )
    rng = np.random.default_rng(4)
    y = rng.normal(size=(60, 4))
    y[rng.random(y.shape) < 0.1] = np.nan
    one = late.predict(late.update(late.init(system.prior), y[0]))
    # The first measurement tells of no input yet: the input_delayed filter begins behind it.
    other = now.init(Gaussian(one.mean, one.cov))
    for k in range(1, 60):
        one, other = late.update(one, y[k]), now.update(other, y[k])
        assert other.input_mean == pytest.approx(one.input_mean, abs=1e-7)
        assert other.mean + model.G @ other.input_mean == pytest.approx(one.mean, abs=1e-7)
        one, other = late.predict(one), now.predict(other)


# --- consistency ----------------------------------------------------------------------------------


def test_on_a_mildly_nonlinear_system_state_and_input_are_as_uncertain_as_the_filter_says():
    """Each mean within 3 standard errors (false alarm 0.27 %), NEES within its band of 99.7 %."""
    system, runs = _shaken(), 1000
    record = simulate(system, 6, runs, 25)
    filter = make("kf-umv-ui", system.model, input_prior=INPUT_PRIOR)
    final = track(filter, system.rows(runs), record)[-1]
    for errors, cov in (
        (final.mean - record.x[-1], final.cov),
        (final.input_mean - record.d[-1], final.input_cov),
    ):
        assert (np.abs(errors.mean(0)) < 3.0 * errors.std(0, ddof=1) / np.sqrt(runs)).all()
        low, high = chi_square_band(runs, errors.shape[-1], 0.997)
        assert low < nees(errors, cov, np.zeros(errors.shape)).mean() < high


# --- what a filter refuses ------------------------------------------------------------------------


def _functions(**changes: object) -> NonlinearModel:
    given = {"transition": lambda x, u: x, "measurement": lambda x, u: x, "Q": I2, "R": I2}
    return NonlinearModel(**{**given, **changes})


def _matrices(**changes: object) -> LinearModel:
    return LinearModel(**{"A": I2, "C": I2, "Q": I2, "R": I2, **changes})


# The input drives a state that is not measured; of two inputs one is fed through, and takes up the
# measurement that would show the other, or does not.
HIDDEN = _matrices(C=[[1.0, 0.0]], R=[[1.0]], G=[[0.0], [1.0]])
BLOCKED, FREE, H = [[0.0, 1.0], [0.0, 0.0]], [[0.0, 0.0], [0.0, 1.0]], [[1.0, 0.0], [0.0, 0.0]]
LATE = "kf-umv-ui-wdf", "ekf-ui-wdf", "ukf-umv"
FEEDTHROUGH = "H = 0 (no feedthrough): use kf-umv-ui or ulise"
RANK = "rank(C2 G2) = q - rank(H)"
ADVICE = (
    ": measure the input, or a state that it drives directly, by a measurement that no other"
    " unknown input disturbs"
)


@pytest.mark.parametrize(
    ("names", "model", "needs"),
    [
        (LATE, _matrices(G=[[1.0], [0.0]], H=[[0.0], [1.0]]), FEEDTHROUGH),
        (LATE, _matrices(G=np.ones((2, 1)), H=lambda u: np.zeros((2, 1))), FEEDTHROUGH),
        (
            LATE,
            HIDDEN,
            "rank(C G) = 1 unknown input, got 0: measure a state that each input drives",
        ),
        (LATE[1:], _functions(G=np.ones((2, 2))), "rank(C G) = 2 unknown inputs, got at most 1: "),
        (LATE[1:], _functions(), "an unknown input"),
        (["ulise"], HIDDEN, f"{RANK} = 1 - 0, got 0{ADVICE}"),
        (["ulise"], _matrices(G=np.stack([FREE, BLOCKED]), H=H), f"{RANK} = 2 - 1, got 0{ADVICE}"),
    ],
)
def test_a_model_whose_input_no_measurement_could_show_is_refused_in_a_sentence(
    names: Sequence[str], model: LinearModel | NonlinearModel, needs: str
):
    for name in names:
        with pytest.raises(ValueError, match=rf"^{name} needs {re.escape(needs)}[^\n]*$"):
            make(name, model)
    assert make("ulise", _matrices(G=FREE, H=H)).input_delay == 1


def test_a_driven_direction_of_the_wrong_shape_is_named():
    filter = make("ekf-ui-wdf", _functions(G=lambda x, u: np.ones((2, 2)), H=np.zeros((2, 1))))
    with pytest.raises(
        ValueError, match=r"^G gave a matrix of shape \(2, 2\), expected \(..., 2, 1"
    ):
        filter.predict(filter.init(Gaussian(np.zeros(2), I2)))
    with pytest.raises(ValueError, match="cannot tell q"):
        _functions(G=lambda x, u: np.ones((2, 1)))


def test_a_model_without_unknown_input_has_none_to_be_a_state_or_late():
    for model in (_matrices(), _functions()):
        with pytest.raises(ValueError, match=r"^stacked needs an unknown input"):
            stacked(model)
    for model in (_matrices(), _matrices(G=np.ones((2, 1)), H=np.ones((2, 1)))):
        with pytest.raises(ValueError, match=r"^input_delayed needs .* without feedthrough"):
            input_delayed(model)
