"""Smoothers: the least-squares solution for all times at once, and what follows from it."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.stats import chi2

from estimators import (
    Gaussian,
    KalmanFilter,
    LinearModel,
    NonlinearModel,
    make,
    nees,
    run,
    smooth,
)
from estimators.kalman import with_input
from tests.estimators.batch import least_squares, marginals
from tests.estimators.cases import (
    INPUT_PRIOR,
    assert_close,
    assert_same,
    gaps,
    input_as_state,
    kalman_system,
    pushed_vehicle,
    simulate,
    turning_vehicle,
    unknown_input_system,
)

UNKNOWN = ("kf-umv-ui", "kf-umv-ui-wdf", "ekf-ui-wdf", "ukf-umv")


@pytest.mark.parametrize(
    ("name", "q"), [*((name, 0) for name in ("kf", "ekf", "ukf")), *product(UNKNOWN, (1, 2))]
)
def test_smoothed_states_and_inputs_are_least_squares(name: str, q: int):
    """Of all times at once, some measurements missing."""
    now, T = name == "kf-umv-ui", 20
    late = q > 0 and not now  # the input is of the step before
    system = unknown_input_system(q, now, p=4, q=q) if q else kalman_system(0)
    record = simulate(system, 1, runs=2, steps=T)
    y, n = gaps(record.y) if q == 0 else record.y, system.model.n
    y[5, :, 0] = np.nan  # the others show the input, too
    filter = make(name, system.model, **({"input_prior": INPUT_PRIOR} if q else {}))
    smoothed = smooth(run(filter, system.prior, y, u=record.u))
    known = {T - 1: np.eye(q)} if late else {}  # the last one acts on nothing
    for i in range(2):
        solution = least_squares(system, y[:, i], record.u[:, i], known)
        assert_close(smoothed.mean[:, i], solution.x, 1e-9)
        assert_close(smoothed.cov[:, i], marginals(solution.cov[: T * n, : T * n], n), 1e-9)
        for k in range(q and T - late):
            d, at = slice(T * n + q * k, T * n + q * (k + 1)), (k + late, i)
            assert_close(smoothed.input_mean[at], solution.d[k], 1e-9)
            assert_close(smoothed.input_cov[at], solution.cov[d, d], 1e-9)
            own = solution.cov[n * (k + late) :, d][:n]
            assert_close(smoothed.state_input_cov[at], own, 1e-9)


@pytest.mark.parametrize("name", ["kf-umv-ui", "kf-umv-ui-wdf"])
def test_an_input_that_nothing_shows_is_smoothed_with_its_prior(name: str):
    late, T = int(name != "kf-umv-ui"), 15
    system = unknown_input_system(3, not late)
    record = simulate(system, 1, runs=1, steps=T)
    # Of that input, or the one before, nothing shows at once, but later measurements tell of it.
    record.y[6] = np.nan
    filter = make(name, system.model, input_prior=INPUT_PRIOR)
    series = run(filter, system.prior, record.y, u=record.u)
    smoothed, known = smooth(series), {T - 1: np.eye(1)} if late else {}
    known[6 - late] = np.eye(1) / np.sqrt(INPUT_PRIOR)
    solution = least_squares(system, record.y[:, 0], record.u[:, 0], known)
    assert_close(smoothed.mean[:, 0], solution.x, 1e-8)
    assert_close(smoothed.input_mean[late:, 0], solution.d[: T - late], 1e-8)
    assert smoothed.input_cov[6, 0, 0, 0] < 0.5 * series.updated.input_cov[6, 0, 0, 0]


@pytest.mark.parametrize("assumed", [0.5, 20.0])
def test_an_input_of_known_variance_is_smoothed_as_a_state(assumed: float):
    system = unknown_input_system(0, True)
    augmented, record = input_as_state(system, [[assumed]]), simulate(system, 1, runs=2, steps=15)
    smoothed, other = (
        smooth(run(make("kf", each.model, **options), each.prior, record.y, u=record.u))
        for each, options in ((system, {"input_cov": assumed}), (augmented, {}))
    )
    for one, expected in zip(with_input(smoothed), (other.mean, other.cov), strict=True):
        assert_close(one, expected, 1e-9)


@pytest.mark.parametrize(
    ("name", "make_system"),
    [("robust-kf", kalman_system), ("ukf", turning_vehicle), ("ekf-ui-wdf", pushed_vehicle)],
)
def test_a_smoothed_covariance_is_never_larger_than_the_filters(name: str, make_system):
    system = make_system(0)
    record = simulate(system, 1, runs=5, steps=30)
    series = run(make(name, system.model), system.prior, gaps(record.y), u=record.u)
    filtered, smoothed = (with_input(each)[1] for each in (series.updated, smooth(series)))
    assert np.linalg.eigvalsh(filtered - smoothed).min() > -1e-9 * np.abs(filtered).max()
    assert np.linalg.eigvalsh(smoothed).min() > -1e-12 * np.abs(filtered).max()


@pytest.mark.parametrize("name", ["ekf", "ukf"])
def test_smoothed_errors_are_as_large_as_the_smoother_says(name: str):
    """One time of each of 400 independent runs: a false alarm has probability 1e-4."""
    system = turning_vehicle(0)
    record = simulate(system, 5, runs=400, steps=25)
    smoothed = smooth(run(make(name, system.model), system.prior, record.y, u=record.u))
    values = nees(smoothed.mean[12], smoothed.cov[12], record.x[12], system.model.state_angles)
    low, high = chi2.interval(1.0 - 1e-4, 400 * system.model.n)
    assert low < values.sum() < high


@pytest.mark.parametrize("name", ["kf", "kf-umv-ui-wdf", "etkf"])
def test_a_fixed_lag_is_a_smoother_of_a_longer_series(name: str):
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


def test_smoothed_members_have_exact_moments_without_draws():
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


def test_a_user_defined_filter_has_a_smoother_if_it_says_so():
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
def test_a_vague_prior_is_smoothed_as_a_vaguer_one(name: str):
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
