"""Smoothers: the least-squares solution for all times at once, and what follows from it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag

from estimators import (
    Gaussian,
    KalmanFilter,
    LinearModel,
    NonlinearModel,
    make,
    nees,
    run,
    smooth,
    stacked,
)
from estimators.metrics import chi_square_band
from tests.estimators.batch import least_squares, marginals
from tests.estimators.cases import (
    INPUT_PRIOR,
    System,
    assert_close,
    assert_same,
    kalman_system,
    pushed_vehicle,
    simulate,
    turning_vehicle,
    unknown_input_system,
)

UNKNOWN = ("kf-umv-ui", "kf-umv-ui-wdf", "ekf-ui-wdf", "ukf-umv")


def gaps(y: np.ndarray) -> np.ndarray:
    return np.where(np.random.default_rng(0).random(y.shape) < 0.2, np.nan, y)


def at_all_times(system: System, solution) -> tuple[np.ndarray, np.ndarray]:
    """The states and their covariances, of the least-squares solution."""
    T, n = solution.x.shape
    return solution.x, marginals(solution.cov[: T * n, : T * n], n)


@pytest.mark.parametrize("name", ["kf", "ekf", "ukf"])
def test_smoothed_states_are_the_least_squares_solution_for_all_of_them(name: str):
    system = kalman_system(0)
    record = simulate(system, 0, runs=2, steps=20)
    y = gaps(record.y)
    y[4] = np.nan
    smoothed = smooth(run(make(name, system.model), system.prior, y, u=record.u))
    for i in range(2):
        x, cov = at_all_times(system, least_squares(system, y[:, i], record.u[:, i]))
        assert_close(smoothed.mean[:, i], x, 1e-9)
        assert_close(smoothed.cov[:, i], cov, 1e-9)


@pytest.mark.parametrize("name", UNKNOWN)
@pytest.mark.parametrize("q", [1, 2])
def test_smoothed_states_and_inputs_are_the_least_squares_solution_for_all_of_them(
    name: str, q: int
):
    now, T = name == "kf-umv-ui", 20
    late = 0 if now else 1  # of the step before
    system = unknown_input_system(q, now, p=4, q=q)
    record = simulate(system, 1, runs=2, steps=T)
    y, n = record.y, system.model.n
    y[5, :, 0] = np.nan  # the others show the input, too
    filter = make(name, system.model, input_prior=INPUT_PRIOR)
    smoothed = smooth(run(filter, system.prior, y, u=record.u))
    told = {} if now else {T - 1: np.eye(q)}  # the last one acts on nothing
    for i in range(2):
        solution = least_squares(system, y[:, i], record.u[:, i], told)
        x, cov = at_all_times(system, solution)
        assert_close(smoothed.mean[:, i], x, 1e-9)
        assert_close(smoothed.cov[:, i], cov, 1e-9)
        inputs = marginals(solution.cov[T * n :, T * n :], q)
        assert_close(smoothed.input_mean[late:, i], solution.d[: T - late], 1e-9)
        assert_close(smoothed.input_cov[late:, i], inputs[: T - late], 1e-9)
        for k in range(T - late):
            own = solution.cov[n * (k + late) :, T * n + q * k :][:n, :q]
            assert_close(smoothed.state_input_cov[k + late, i], own, 1e-9)


@pytest.mark.parametrize("name", ["kf-umv-ui", "kf-umv-ui-wdf"])
def test_an_input_that_no_measurement_shows_is_smoothed_with_its_prior(name: str):
    now, T = name == "kf-umv-ui", 15
    late = 0 if now else 1
    system = unknown_input_system(3, now)
    record = simulate(system, 1, runs=1, steps=T)
    # Of that input, or the one before, nothing shows at once, but later measurements tell of it.
    record.y[6] = np.nan
    filter = make(name, system.model, input_prior=INPUT_PRIOR)
    series = run(filter, system.prior, record.y, u=record.u)
    smoothed = smooth(series)
    told = {6 - late: np.eye(1) / np.sqrt(INPUT_PRIOR)} | ({} if now else {T - 1: np.eye(1)})
    solution = least_squares(system, record.y[:, 0], record.u[:, 0], told)
    assert_close(smoothed.mean[:, 0], solution.x, 1e-8)
    assert_close(smoothed.input_mean[late:, 0], solution.d[: T - late], 1e-8)
    assert smoothed.input_cov[6, 0, 0, 0] < 0.5 * series.updated.input_cov[6, 0, 0, 0]


@pytest.mark.parametrize("assumed", [0.5, 20.0])
def test_an_input_whose_variance_is_told_is_smoothed_as_the_state_that_it_could_be(assumed: float):
    system = unknown_input_system(0, True)
    record = simulate(system, 1, runs=2, steps=15)
    filter, whole, n = make("kf", system.model, input_cov=assumed), stacked(system.model), 4
    smoothed = smooth(run(filter, system.prior, record.y, u=record.u))
    Q, prior = np.array(whole.Q), block_diag(system.cov, assumed)
    Q[n:, n:] = assumed
    as_state = make("kf", LinearModel(whole.A, whole.C, Q, whole.R, B=whole.B))
    other = smooth(run(as_state, Gaussian([*system.mean, 0.0], prior), record.y, u=record.u))
    assert_close(smoothed.mean, other.mean[..., :n], 1e-9)
    assert_close(smoothed.input_mean, other.mean[..., n:], 1e-9)
    assert_close(smoothed.input_cov, other.cov[..., n:, n:], 1e-9)


@pytest.mark.parametrize(
    ("name", "make_system"),
    [("robust-kf", kalman_system), ("ukf", turning_vehicle), ("ekf-ui-wdf", pushed_vehicle)],
)
def test_a_smoothed_covariance_is_never_larger_than_the_filters(name: str, make_system):
    system = make_system(0)
    record = simulate(system, 1, runs=5, steps=30)
    series = run(make(name, system.model), system.prior, gaps(record.y), u=record.u)
    smoothed = smooth(series)
    for own, covs in (("cov", series.cov), ("input_cov", series.updated.input_cov)):
        if covs is not None:
            less = np.linalg.eigvalsh(covs - getattr(smoothed, own))
            assert less.min() > -1e-9 * np.abs(covs).max()
            assert np.linalg.eigvalsh(getattr(smoothed, own)).min() > -1e-12 * np.abs(covs).max()


@pytest.mark.parametrize("name", ["ekf", "ukf"])
def test_smoothed_errors_are_as_large_as_the_smoother_says(name: str):
    """One time of each of 400 independent runs: a false alarm has probability 1e-4."""
    system = turning_vehicle(0)
    record = simulate(system, 5, runs=400, steps=25)
    smoothed = smooth(run(make(name, system.model), system.prior, record.y, u=record.u))
    values = nees(smoothed.mean[12], smoothed.cov[12], record.x[12], system.model.state_angles)
    low, high = chi_square_band(400, system.model.n, 1.0 - 1e-4)
    assert low < values.mean() < high


@pytest.mark.parametrize("name", ["kf", "kf-umv-ui-wdf", "etkf"])
def test_a_fixed_lag_is_a_whole_smoother_whose_series_ends_so_much_later(name: str):
    system = unknown_input_system(0, False) if name == "kf-umv-ui-wdf" else kalman_system(0)
    (_, y, u, _), filter = simulate(system, 1, runs=2, steps=8), make(name, system.model)
    series = run(filter, system.prior, y, u=u, rng=0)
    lagged = smooth(series, lag=3)
    for k in (0, 4, 6, 7):
        part = smooth(run(filter, system.prior, y[: k + 4], u=u[: k + 4], rng=0))
        assert_same(lagged[k], part[k], 1e-11)
    assert_same(smooth(series, lag=0), series.updated, 1e-11)
    assert_same(smooth(series, lag=9), smooth(series), 1e-11)


def test_a_row_that_was_lost_does_not_pass_on_what_came_later():
    f = NonlinearModel(
        lambda x, u: np.where(u > 0.0, np.inf, x), lambda x, u: x, [[0.1]], [[1.0]],
        transition_jacobian=lambda x, u: np.ones(x.shape + (1,)),
    )  # fmt: skip
    u, y = np.zeros((8, 2, 1)), np.random.default_rng(0).normal(size=(8, 2, 1))
    u[3, 0] = 1.0  # the step to the fifth measurement loses the first row
    series = run(make("ekf", f), Gaussian([0.0], [[1.0]]), y, u=u)
    smoothed = smooth(series)
    assert_same(smoothed[3, 0], series.updated[3, 0], 1e-12)
    assert np.isfinite(smoothed.mean).all()
    assert np.isfinite(smoothed.cov).all()


def test_angles_are_smoothed_across_their_seam():
    def turned(by: float) -> NonlinearModel:
        def f(x: np.ndarray, u: np.ndarray) -> np.ndarray:
            angle = np.remainder(x[..., 0] + 0.3 * x[..., 1] + by, 2.0 * np.pi) - by
            return np.stack([angle, x[..., 1]], -1)

        angles = {"state_angles": (0,), "measurement_angles": (0,)}
        return NonlinearModel(f, lambda x, u: x[..., :1], 1e-3 * np.eye(2), [[0.01]], **angles)

    y = (0.3 * np.arange(30.0) + 0.05 * np.random.default_rng(0).normal(size=30))[:, None]
    prior = Gaussian([0.0, 1.0], 0.1 * np.eye(2))
    wrapped, apart = (smooth(run(make("ekf", turned(by)), prior, y)) for by in (0.1, 1.7))
    turns = (wrapped.mean - apart.mean) / [2.0 * np.pi, 1.0]
    assert_close(turns, np.rint(turns) * [1.0, 0.0], 1e-9)
    assert_close(wrapped.cov, apart.cov, 1e-9)


# --- members --------------------------------------------------------------------------------------


def test_smoothed_members_have_the_moments_of_the_exact_smoother_where_nothing_is_drawn():
    """Without process noise a transform is exact, be its moments of full rank or not."""
    system = kalman_system(0)
    model = replace(system.model, Q=np.zeros((4, 4)))
    record = simulate(system, 1, runs=1, steps=10)
    etkf = make("etkf", model, members=3, draws="independent")
    series = run(etkf, system.prior, record.y, u=record.u, rng=0)
    begun, smoothed = series.predicted[0], smooth(series)
    exact = smooth(run(make("kf", model), Gaussian(begun.mean, begun.cov), record.y, u=record.u))
    assert_close(smoothed.mean, exact.mean, 1e-9)
    assert_close(smoothed.cov, exact.cov, 1e-9)


def test_many_members_are_smoothed_as_a_kalman_filter_is():
    """The members' mean is the exact smoother's, but for some 5 deviations of sampling."""
    system = kalman_system(0)
    record = simulate(system, 1, runs=1, steps=12)
    exact = smooth(run(make("kf", system.model), system.prior, record.y, u=record.u))
    filter = make("enkf", system.model, members=4000)
    smoothed = smooth(run(filter, system.prior, record.y, u=record.u, rng=0))
    sd = np.sqrt(np.diagonal(exact.cov, axis1=-2, axis2=-1))
    np.testing.assert_array_less(np.abs(smoothed.mean - exact.mean) / sd, 5.0 * 3.0 / np.sqrt(4000))
    spread = np.diagonal(smoothed.cov, axis1=-2, axis2=-1) / sd**2
    np.testing.assert_allclose(spread, 1.0, rtol=0, atol=5.0 * 3.0 * np.sqrt(2.0 / 4000))


# --- what has no smoother -------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["ulise", "huber-kf"])
def test_what_cannot_be_smoothed_says_so(name: str):
    """The latter may doubt its own prediction after it was made."""
    system = unknown_input_system(0, True)
    record = simulate(system, 1, runs=1, steps=4)
    series = run(make(name, system.model), system.prior, record.y, u=record.u)
    with pytest.raises(TypeError, match=f"{name} has no smoother: smooth a series of kf"):
        smooth(series)


def test_a_filter_of_ones_own_that_overrides_a_step_has_a_smoother_if_it_says_so():
    class Forgetting(KalmanFilter):
        def _predict(self, *arguments):
            return super()._predict(*arguments)

    class Declared(Forgetting):
        reversible = True

    system = kalman_system(0)
    record = simulate(system, 1, runs=2, steps=6)
    series, declared, forgetting = (
        run(cls(system.model), system.prior, record.y, u=record.u)
        for cls in (KalmanFilter, Declared, Forgetting)
    )
    np.testing.assert_allclose(smooth(declared).mean, smooth(series).mean, rtol=0, atol=1e-12)
    with pytest.raises(TypeError, match="has no smoother"):
        smooth(forgetting)


@pytest.mark.parametrize("name", ["kf", "ukf"])
def test_a_prior_of_which_next_to_nothing_is_known_is_smoothed_as_one_of_less(name: str):
    """A level, its slope and a week's pattern: there 1e7 and 1e12 are alike."""
    A, C = np.zeros((8, 8)), np.eye(1, 8) + np.eye(1, 8, 2)
    A[0, :2], A[1, 1], A[2, 2:], A[3:, 2:7] = 1.0, 1.0, -1.0, np.eye(5)
    filter = make(name, LinearModel(A, C, np.diag([0.1, 0.01, 0.02, 0, 0, 0, 0, 0]), [[0.5]]))
    y = np.cumsum(np.random.default_rng(1).normal(size=(60, 1)), 0)
    y[[2, 3, 9, 10, 11, 30]] = np.nan
    known, vague = (
        smooth(run(filter, Gaussian(np.zeros(8), P * np.eye(8)), y)) for P in (1e7, 1e12)
    )
    sd = np.sqrt(known.cov.diagonal(0, -2, -1))
    np.testing.assert_allclose(np.sqrt(vague.cov.diagonal(0, -2, -1)), sd, rtol=0.01)
    assert (np.abs(vague.mean - known.mean) < 0.01 * sd).all()
