"""What `huber-kf` and `robust-kf` promise beyond the common laws, and where each of them loses."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from estimators import Filter, Gaussian, LinearModel, make, nees
from estimators.robust import least_favourable_covariance
from tests.estimators.cases import (
    Record,
    System,
    assert_same,
    kalman_system,
    random_covariance,
    rounding,
    simulate,
    track,
)

GAMMA = 1.345


# --- huber-kf -------------------------------------------------------------------------------------


def _whitened_residuals(
    model: LinearModel, prior: Gaussian, y: np.ndarray, x: np.ndarray
) -> np.ndarray:
    """``[R^-1/2 (y - C x); P^-1/2 (x- - x)]`` with Cholesky roots, for one row."""
    roots = np.linalg.cholesky(model.R), np.linalg.cholesky(prior.cov)
    return np.concatenate(
        [np.linalg.solve(roots[0], y - model.C @ x), np.linalg.solve(roots[1], prior.mean - x)]
    )


def _by_the_formulas(
    model: LinearModel, prior: Gaussian, y: np.ndarray, gamma: float, iterations: int
):
    """Karlgaard's reweighted updates in information form, with inverses; the weights start at the prediction."""
    root_R, root_P = np.linalg.cholesky(model.R), np.linalg.cholesky(prior.cov)
    x = prior.mean
    for _ in range(iterations):
        psi = np.minimum(
            1.0, gamma / np.maximum(np.abs(_whitened_residuals(model, prior, y, x)), 1e-300)
        )
        R = root_R @ np.diag(1.0 / psi[: model.p]) @ root_R.T
        P = root_P @ np.diag(1.0 / psi[model.p :]) @ root_P.T
        cov = np.linalg.inv(np.linalg.inv(P) + model.C.T @ np.linalg.inv(R) @ model.C)
        x = cov @ (np.linalg.inv(P) @ prior.mean + model.C.T @ np.linalg.inv(R) @ y)
    return x, cov


def _one_update(filter: Filter, prior: Gaussian, y: np.ndarray):
    return filter.update(filter.init(prior), y)


@pytest.mark.parametrize("size", [1.0, 5.0, 100.0], ids=["small", "large", "huge"])
@pytest.mark.parametrize("iterations", [1, 2, 5])
def test_the_huber_update_is_karlgaards_in_information_form(iterations: int, size: float):
    for seed in range(10):
        system = kalman_system(seed)
        y = np.random.default_rng(seed).normal(scale=size, size=system.model.p)
        filter = make("huber-kf", system.model, iterations=iterations, tolerance=1e-300)
        belief = _one_update(filter, system.prior, y)
        mean, cov = _by_the_formulas(system.model, system.prior, y, GAMMA, iterations)
        # The formulas invert; the filter does not. Weights of 1 / 100 cost the inverses two digits
        # or so.
        np.testing.assert_allclose(
            belief.mean, mean, rtol=0, atol=1e-10 * max(1.0, np.abs(mean).max())
        )
        np.testing.assert_allclose(belief.cov, cov, rtol=0, atol=1e-10 * np.abs(cov).max())


def test_with_many_iterations_the_update_minimises_hubers_loss():
    """The M-estimating equation: the gradient of the loss with psi = clip(zeta, -gamma, gamma) vanishes."""
    for seed in range(1, 4):
        system = kalman_system(seed)
        model, prior = system.model, system.prior
        y = np.random.default_rng(seed).normal(scale=4.0, size=model.p)
        filter = make(
            "huber-kf", model, iterations=150, tolerance=1e-14
        )  # an error halves in three, or sooner
        x = _one_update(filter, prior, y).mean
        root_R, root_P = np.linalg.cholesky(model.R), np.linalg.cholesky(prior.cov)
        slope = -np.concatenate([np.linalg.solve(root_R, model.C), np.linalg.inv(root_P)])
        zeta = _whitened_residuals(model, prior, y, x)
        assert np.abs(zeta).max() > GAMMA  # not the Kalman filter's minimum
        np.testing.assert_allclose(slope.T @ np.clip(zeta, -GAMMA, GAMMA), 0.0, atol=1e-12)


def test_measurements_near_enough_to_the_prediction_are_treated_exactly_as_by_the_kalman_filter():
    system = kalman_system(2)
    model, rng = system.model, np.random.default_rng(2)
    root = np.linalg.cholesky(model.R)
    zeta = rng.uniform(-GAMMA, GAMMA, size=(200, model.p))
    y = system.mean @ model.C.T + zeta @ root.T
    huber, kalman = (
        _one_update(make(name, model), system.rows(200), y) for name in ("huber-kf", "kf")
    )
    record = Record(np.empty((1, 200, model.n)), y[None], np.zeros((1, 200, system.m)), None)
    (tolerance,) = rounding(
        make("kf", model), system.rows(200), record
    )  # BLAS may sum in two orders
    within = (np.abs(_prediction_residuals(system, kalman.mean)) < GAMMA).all(-1)
    assert within.sum() > 20
    np.testing.assert_allclose(
        huber.mean[within], kalman.mean[within], rtol=0, atol=tolerance["mean"]
    )
    np.testing.assert_allclose(huber.cov[within], kalman.cov[within], rtol=0, atol=tolerance["cov"])


def _prediction_residuals(system: System, x: np.ndarray) -> np.ndarray:
    return np.linalg.solve(np.linalg.cholesky(system.cov), (x - system.mean)[..., None])[..., 0]


def test_the_influence_of_one_measurement_is_bounded_and_its_limit_is_known():
    """With the weights of the prediction, e / (C P C' + R |e| / (gamma sigma)) tends to gamma / sigma."""
    model = LinearModel(np.eye(2), [[1.0, 0.5]], np.eye(2), [[4.0]])
    prior = Gaussian(np.zeros(2), [[2.0, 0.3], [0.3, 1.0]])
    filter = make("huber-kf", model, iterations=1)
    limit = prior.cov @ model.C[0] * GAMMA / 2.0
    moved = np.array([_one_update(filter, prior, [y]).mean for y in (2.0, 20.0, 200.0, 2e6, 2e12)])
    assert (np.diff(np.abs(moved), axis=0) > 0.0).all()
    assert (np.abs(moved) <= np.abs(limit)).all()
    np.testing.assert_allclose(moved[-1], limit, rtol=1e-9)


def test_a_measurement_without_noise_is_believed_however_far_it_lies():
    model = LinearModel(np.eye(2), np.eye(2), np.eye(2), np.diag([0.0, 1.0]))
    belief = _one_update(
        make("huber-kf", model), Gaussian(np.zeros(2), np.eye(2)), np.array([50.0, 50.0])
    )
    assert belief.healthy
    np.testing.assert_allclose(belief.mean[0], 50.0, rtol=1e-12)
    assert belief.mean[1] < 5.0  # the noisy one is taken for an outlier


def test_a_state_that_is_known_exactly_stays_where_it_is():
    model = LinearModel(np.eye(2), [[1.0, 1.0]], np.zeros((2, 2)), [[1.0]])
    for cov in (np.diag([0.0, 1.0]), np.zeros((2, 2))):
        belief = _one_update(make("huber-kf", model), Gaussian([1.0, 2.0], cov), np.array([30.0]))
        assert belief.healthy
        assert belief.mean[0] == 1.0
        assert belief.cov[0, 0] == 0.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"gamma": 0.0}, "gamma must be positive"),
        ({"gamma": np.nan}, "gamma must be positive"),
        ({"iterations": 0}, "iterations must be a whole number of at least 1, got 0"),
        ({"tolerance": 0.0}, "tolerance must be positive"),
    ],
)
def test_the_huber_filter_refuses_options_that_mean_nothing(
    options: dict[str, float], message: str
):
    with pytest.raises(ValueError, match=message):
        make("huber-kf", kalman_system(0).model, **options)


# --- robust-kf ------------------------------------------------------------------------------------


def test_beside_a_bias_a_large_ball_runs_away_and_a_small_one_does_not():
    """A bias that returns by 4.5e-4 a step, 600 steps: no measurement shows its difference from the state."""
    kept = np.exp(-4.5e-4)
    model = LinearModel(
        np.diag([1.0, kept]), [[1.0, 1.0]], np.diag([1e-4, 1.0 - kept**2]), [[1e-4]]
    )
    variances = []
    for radius in (0.0, 1e-6, 0.01):
        filter = make("robust-kf", model, radius=radius)
        belief = filter.init(Gaussian(np.zeros(2), np.diag([4.0, 1.0])))
        for _ in range(600):
            belief = filter.update(filter.predict(belief), [0.0])
        variances.append(belief.cov[1, 1])
    assert variances[1] < 3.0 * variances[0]
    assert variances[2] > 100.0 * variances[0]


@pytest.mark.slow
@settings(derandomize=True, max_examples=200, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1), n=st.integers(1, 12), spread=st.floats(0.0, 4.0), size=st.floats(-9.0, 9.0),
    radius=st.floats(-8.0, 3.0).map(lambda power: 10.0**power),
)  # fmt: skip
def test_the_covariance_is_as_far_in_relative_entropy_as_was_allowed(
    seed: int, n: int, spread: float, size: float, radius: float
):
    rng = np.random.default_rng(seed)
    axes = np.linalg.qr(rng.normal(size=(n, n)))[0]
    values = 10.0 ** (size + rng.uniform(-spread, 0.0, size=n))
    P = axes * values @ axes.T
    V = least_favourable_covariance(0.5 * (P + P.T), radius)
    np.testing.assert_array_equal(V, V.T)
    # Both have the same axes: growth 1 / (1 - x) along each, largest along the largest, x = theta l
    # below 1.
    growth = np.diagonal(axes.T @ V @ axes) / values
    x = 1.0 - 1.0 / growth
    theta = x / values
    # V is exact to rounding of its largest entry, which is that much more of its smallest.
    rounding = 1e-13 * V.max() / values
    assert (growth > 1.0 - rounding).all()
    np.testing.assert_allclose(
        theta, theta[values.argmax()], rtol=0, atol=(2.0 * rounding / values).max()
    )
    entropy = 0.5 * (growth - 1.0 - np.log(growth)).sum()
    sure = rounding.max() / x.max()
    np.testing.assert_allclose(entropy, 0.5 * radius, rtol=1e-10 + 10.0 * n * sure)


def test_nothing_is_made_of_a_covariance_of_zero():
    np.testing.assert_array_equal(least_favourable_covariance(np.zeros((3, 2, 2)), 0.1), 0.0)
    V = least_favourable_covariance(np.diag([0.0, 2.0]), 0.1)
    assert V[1, 1] > 2.0
    np.testing.assert_array_equal(V[[0, 0, 1], [0, 1, 0]], 0.0)


def test_rows_that_are_not_finite_do_not_disturb_the_others():
    rng = np.random.default_rng(0)
    P = random_covariance(rng, 3, (4,))
    expected = least_favourable_covariance(P, 0.3)
    P[1], P[2, 0, 0] = np.nan, np.inf
    V = least_favourable_covariance(P, 0.3)
    np.testing.assert_array_equal(V[[0, 3]], expected[[0, 3]])
    assert not np.isfinite(V[1:3]).all((-2, -1)).any()


def test_with_a_ball_of_radius_0_the_robust_filter_is_the_kalman_filter_to_the_last_bit():
    system = kalman_system(4)
    record = simulate(system, 4, runs=3, steps=30)
    pairs = zip(
        *(track(f, system.rows(3), record) for f in _kalman_and("robust-kf", system, radius=0.0)),
        strict=True,
    )
    for kalman, robust in pairs:
        assert_same(kalman, robust)


def _kalman_and(name: str, system: System, **options: object) -> tuple[Filter, Filter]:
    return make("kf", system.model), make(name, system.model, **options)


@pytest.mark.parametrize("radius", [-0.1, np.inf, np.nan])
def test_the_robust_filter_refuses_a_radius_that_is_none(radius: float):
    with pytest.raises(ValueError, match="radius must be finite and not negative"):
        make("robust-kf", kalman_system(0).model, radius=radius)


def _constant_velocity(intensity: float = 0.01) -> System:
    """Position and velocity, pushed by white acceleration; the position is measured once a second."""
    A = np.array([[1.0, 1.0], [0.0, 1.0]])
    Q = intensity * np.array([[1.0 / 3.0, 0.5], [0.5, 1.0]])
    return System(
        LinearModel(A, [[1.0, 0.0]], Q, [[1.0]], B=np.zeros((2, 1))), np.zeros(2), np.eye(2), 1
    )


@pytest.mark.parametrize(
    "system", [kalman_system(0), _constant_velocity()], ids=["random", "constant velocity"]
)
def test_where_the_model_is_true_the_robust_filter_never_claims_more_than_it_has(system: System):
    """Only the upper side of the chi-square band: it is conservative by design."""
    runs, steps = 400, 60
    record = simulate(system, 0, runs, steps)
    beliefs = track(make("robust-kf", system.model, radius=0.1), system.rows(runs), record)
    means = np.array(
        [nees(b.mean, b.cov, x).mean() for b, x in zip(beliefs, record.x, strict=True)]
    )
    # False alarm of 0.1 % over all steps together (Bonferroni), were the filter no more than
    # consistent.
    assert means.max() < chi2.ppf(1.0 - 1e-3 / steps, system.model.n * runs) / runs
    assert means[10:].mean() < 0.98 * system.model.n


# --- each on its own ground, on the other's and on neither's --------------------------------------

RUNS, STEPS, SKIPPED = 400, 100, 20


def _with_outliers(
    system: System, record: Record, seed: int, share: float = 0.1, size: float = 10.0
) -> Record:
    """Every measurement has noise ``size`` times as large with probability ``share``."""
    rng = np.random.default_rng(seed)
    noise = record.y - record.x @ system.model.C.T
    return record._replace(y=record.y + (size - 1.0) * noise * (rng.random(noise.shape) < share))


def _squared_errors(filter: Filter, system: System, record: Record) -> np.ndarray:
    """Squared length of the state error in each run, mean over time once the start is forgotten."""
    beliefs = track(filter, system.rows(record.x.shape[1]), record)
    return np.mean(
        [((b.mean - x) ** 2).sum(-1) for b, x in zip(beliefs, record.x, strict=True)][SKIPPED:],
        axis=0,
    )


def _margin(errors: np.ndarray, reference: np.ndarray, ratio: float) -> float:
    """By how many standard errors, over paired runs, the RMSE is below ``ratio`` times the reference's."""
    excess = ratio**2 * reference - errors
    return float(excess.mean() / (excess.std(ddof=1) / np.sqrt(len(excess))))


def _errors(system: System, record: Record, radius: float = 0.1) -> dict[str, np.ndarray]:
    filters = (
        make("kf", system.model),
        make("huber-kf", system.model),
        make("robust-kf", system.model, radius=radius),
    )
    return {filter.name: _squared_errors(filter, system, record) for filter in filters}


SURE = 4.0
"""Standard errors by which each claim below must hold: one that is just untrue passes with probability 3e-5."""


@pytest.mark.parametrize("intensity", [0.01, 0.1])
def test_with_outliers_the_huber_filter_has_at_most_60_percent_of_the_kalman_filters_error(
    intensity: float,
):
    system = _constant_velocity(intensity)
    clean = simulate(system, 1, RUNS, STEPS)
    errors = _errors(system, _with_outliers(system, clean, 2))
    assert _margin(errors["huber-kf"], errors["kf"], 0.6) > SURE
    # The robust filter, which trusts measurements more, is worse than the Kalman filter there.
    assert _margin(errors["robust-kf"], errors["kf"], 1.0) < -SURE


@pytest.mark.slow
@pytest.mark.parametrize("intensity", [0.01, 0.1, 1.0])
def test_without_outliers_the_huber_filter_is_within_5_percent_of_the_kalman_filter(
    intensity: float,
):
    system = _constant_velocity(intensity)
    errors = _errors(system, simulate(system, 3, RUNS, STEPS), radius=0.01)
    assert _margin(errors["huber-kf"], errors["kf"], 1.05) > SURE
    assert _margin(errors["robust-kf"], errors["kf"], 1.05) > SURE
    # Nothing beats the Kalman filter where its assumptions hold.
    assert _margin(errors["huber-kf"], errors["kf"], 1.0) < -SURE


def test_when_the_vehicle_manoeuvres_more_than_the_model_says_the_robust_filter_wins_and_the_huber_filter_loses():
    system = _constant_velocity()
    moving = dataclasses.replace(
        system, model=dataclasses.replace(system.model, Q=10.0 * system.model.Q)
    )
    errors = _errors(system, simulate(moving, 4, RUNS, STEPS))
    assert _margin(errors["robust-kf"], errors["kf"], 0.9) > SURE
    assert _margin(errors["huber-kf"], errors["kf"], 1.1) < -SURE


# --- Levy and Nikoukhah's least-favourable model --------------------------------------------------


@dataclasses.dataclass(frozen=True)
class LeastFavourable:
    """The worst model in the ball against the robust filter, over a given number of steps.

    With the prediction error ``e`` and unit white noise ``v``, ``x+ = A x + W v``, ``y = C x + D
    v``, the filter's error obeys ``e+ = F e + N v``, ``F = A - G C``, ``N = W - G D``, G its gain.
    The least-favourable joint density is the nominal one times ``exp(theta_t |e_{t+1}|^2 / 2)`` at
    every step (Levy & Nikoukhah 2013, the saddle point of sec. III). To run it forward as a
    state-space model each step's noise must anticipate later steps: integrating them out, last
    first, leaves ``exp(e' Omega e / 2)`` (their sec. V)::

        X = Omega_{t+1} + theta_t I      Z = (I - N' X N)^-1      Omega_t = F' (X + X N Z N' X) F
        v | e ~ N(Z N' X F e, Z)         e_0 ~ N(0, (V_0^-1 - Omega_0)^-1)

    At the last step the error of the filter then has exactly the covariance V that the filter
    claims.
    """

    system: System
    shift: list[np.ndarray]  # (n + p, n) mean of the noise for an error e
    cov: list[np.ndarray]  # (n + p, n + p) covariance of the noise
    error_map: list[np.ndarray]  # (n, n) F
    error_noise: list[np.ndarray]  # (n, n + p) N
    start: np.ndarray  # (n, n) covariance of the first error
    claimed: np.ndarray  # (n, n) V after the last step


def _noise_roots(model: LinearModel) -> tuple[np.ndarray, np.ndarray]:
    """W ``(n, n + p)`` and D ``(p, n + p)`` with ``W W' = Q``, ``D D' = R``, ``W D' = 0``."""
    W = np.hstack([np.linalg.cholesky(model.Q), np.zeros((model.n, model.p))])
    D = np.hstack([np.zeros((model.p, model.n)), np.linalg.cholesky(model.R)])
    return W, D


def _least_favourable(system: System, radius: float, steps: int) -> LeastFavourable:
    model, (W, D), eye = system.model, _noise_roots(system.model), np.eye(system.model.n)
    filter = make("robust-kf", model, radius=radius)
    belief, V = filter.init(system.prior), system.cov
    F, N, theta = [], [], []
    for _ in range(steps):
        G = model.A @ V @ model.C.T @ np.linalg.inv(model.C @ V @ model.C.T + model.R)
        F.append(model.A - G @ model.C)
        N.append(W - G @ D)
        P = F[-1] @ V @ F[-1].T + N[-1] @ N[-1].T
        belief = filter.predict(filter.update(belief, np.zeros(model.p)), np.zeros(system.m))
        V = belief.cov
        difference = np.linalg.inv(P) - np.linalg.inv(V)
        theta.append(difference[0, 0])
        np.testing.assert_allclose(difference, theta[-1] * eye, rtol=0, atol=1e-9)
    shift, cov, omega = [], [], np.zeros_like(eye)
    for F_t, N_t, theta_t in zip(F[::-1], N[::-1], theta[::-1], strict=True):
        X = omega + theta_t * eye
        Z = np.linalg.inv(np.eye(N_t.shape[1]) - N_t.T @ X @ N_t)
        shift.append(Z @ N_t.T @ X @ F_t)
        cov.append(Z)
        omega = F_t.T @ (X + X @ N_t @ Z @ N_t.T @ X) @ F_t
    start = np.linalg.inv(np.linalg.inv(system.cov) - omega)
    return LeastFavourable(system, shift[::-1], cov[::-1], F, N, start, V)


@pytest.mark.slow
@pytest.mark.parametrize("radius", [0.01, 0.1, 0.3])
@pytest.mark.parametrize(
    "system", [_constant_velocity(), kalman_system(0), kalman_system(1, n=3, p=1)]
)
def test_under_the_least_favourable_model_the_error_is_as_large_as_the_filter_claims(
    system: System, radius: float
):
    worst = _least_favourable(system, radius, 60)
    cov = worst.start
    for shift, spread, F, N in zip(
        worst.shift, worst.cov, worst.error_map, worst.error_noise, strict=True
    ):
        assert np.linalg.eigvalsh(spread).min() > 0.0
        closed = F + N @ shift
        cov = closed @ cov @ closed.T + N @ spread @ N.T
    np.testing.assert_allclose(cov, worst.claimed, rtol=0, atol=1e-10 * np.abs(worst.claimed).max())


def test_a_gap_in_the_measurements_costs_the_robust_filter_its_confidence_exponentially():
    """The ball acts at every step: without measurements the covariance grows by a factor each time."""
    system, steps = _constant_velocity(), 40
    sizes = {}
    for name, filter in zip(
        ("kf", "robust-kf"), _kalman_and("robust-kf", system, radius=0.1), strict=True
    ):
        belief, sizes[name] = filter.init(system.prior), []
        for _ in range(steps):
            belief = filter.predict(belief, np.zeros(1))
            sizes[name].append(np.log(belief.cov[0, 0]))
    growth = np.diff(sizes["robust-kf"])[-10:]
    # In the end only the largest eigenvalue counts, and o - log(1 + o) = radius is its growth 1 + o
    # at each step.
    assert (growth > np.log(1.5)).all()
    assert (np.diff(sizes["kf"])[-10:] < np.log(1.5)).all()
