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
    kalman_system,
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
    """Karlgaard's reweighted updates in information form; weights start at the prediction."""
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


def test_the_influence_of_one_measurement_is_bounded_and_its_limit_is_known():
    """With the prediction's weights e / (C P C' + R |e| / (gamma sigma)) tends to gamma / sigma."""
    model = LinearModel(np.eye(2), [[1.0, 0.5]], np.eye(2), [[4.0]])
    prior = Gaussian(np.zeros(2), [[2.0, 0.3], [0.3, 1.0]])
    filter = make("huber-kf", model, iterations=1)
    limit = prior.cov @ model.C[0] * GAMMA / 2.0
    moved = np.array([_one_update(filter, prior, [y]).mean for y in (2.0, 20.0, 200.0, 2e6, 2e12)])
    assert (np.diff(np.abs(moved), axis=0) > 0.0).all()
    assert (np.abs(moved) <= np.abs(limit)).all()
    np.testing.assert_allclose(moved[-1], limit, rtol=1e-9)


def test_a_measurement_without_noise_is_believed_and_a_state_that_is_known_stays():
    model = LinearModel(np.eye(2), np.eye(2), np.eye(2), np.diag([0.0, 1.0]))
    belief = _one_update(make("huber-kf", model), Gaussian(np.zeros(2), np.eye(2)), [50.0, 50.0])
    assert belief.healthy
    np.testing.assert_allclose(belief.mean[0], 50.0, rtol=1e-12)
    assert belief.mean[1] < 5.0  # the noisy one is taken for an outlier
    model = LinearModel(np.eye(2), [[1.0, 1.0]], np.zeros((2, 2)), [[1.0]])
    belief = _one_update(make("huber-kf", model), Gaussian([1.0, 2.0], np.diag([0, 1.0])), [30.0])
    assert belief.healthy
    assert belief.mean[0] == 1.0
    assert belief.cov[0, 0] == 0.0


# --- robust-kf ------------------------------------------------------------------------------------


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


def test_nothing_is_made_of_a_variance_of_zero_and_other_rows_do_not_matter():
    P = np.stack([np.zeros((2, 2)), np.diag([0.0, 2.0]), np.full((2, 2), np.nan), np.eye(2)])
    V = least_favourable_covariance(P, 0.1)
    np.testing.assert_array_equal(V[0], 0.0)
    np.testing.assert_array_equal(V[1, [0, 0, 1], [0, 1, 0]], 0.0)
    assert V[1, 1, 1] > 2.0
    assert not np.isfinite(V[2]).all()
    np.testing.assert_array_equal(V[3], least_favourable_covariance(np.eye(2), 0.1))


def _constant_velocity(intensity: float = 0.01) -> System:
    """Position and velocity under white acceleration; the position is measured every second."""
    A = np.array([[1.0, 1.0], [0.0, 1.0]])
    Q = intensity * np.array([[1.0 / 3.0, 0.5], [0.5, 1.0]])
    return System(
        LinearModel(A, [[1.0, 0.0]], Q, [[1.0]], B=np.zeros((2, 1))), np.zeros(2), np.eye(2), 1
    )


def test_where_the_model_is_true_the_robust_filter_never_claims_more_than_it_has():
    """Only the upper side of the chi-square band: it is conservative by design."""
    system, runs, steps = _constant_velocity(), 400, 60
    record = simulate(system, 0, runs, steps)
    beliefs = track(make("robust-kf", system.model, radius=0.1), system.rows(runs), record)
    means = [nees(b.mean, b.cov, x).mean() for b, x in zip(beliefs, record.x, strict=True)]
    # False alarm of 0.1 % over all steps together (Bonferroni), were it no more than consistent.
    assert max(means) < chi2.ppf(1.0 - 1e-3 / steps, system.model.n * runs) / runs
    assert np.mean(means[10:]) < 0.98 * system.model.n


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
    """Standard errors, over paired runs, by which the RMSE is below a share of the reference's."""
    excess = ratio**2 * reference - errors
    return float(excess.mean() / (excess.std(ddof=1) / np.sqrt(len(excess))))


SURE = 4.0
"""Standard errors by which each claim holds: a false one passes with probability 3e-5 at most."""
OUTLIERS, MANOEUVRES = "measurements have outliers", "the vehicle manoeuvres"


@pytest.mark.parametrize("intensity", [0.01, 0.1])
@pytest.mark.parametrize(
    ("world", "shares"),
    [
        # The robust filter trusts measurements more.
        (OUTLIERS, {"huber-kf": (0.0, 0.6), "robust-kf": (1.0, np.inf)}),
        (MANOEUVRES, {"huber-kf": (1.1, np.inf), "robust-kf": (0.0, 0.9)}),
        # Nothing beats the Kalman filter where its assumptions hold.
        ("the model is true", {"huber-kf": (1.0, 1.05), "robust-kf": (1.0, 1.2)}),
    ],
)
def test_each_wins_on_its_own_ground_and_loses_on_the_others(
    world: str, shares: dict[str, tuple[float, float]], intensity: float
):
    """Root mean square errors lie between such shares of the Kalman filter's."""
    system = _constant_velocity(intensity)
    Q = system.model.Q * (10.0 if world == MANOEUVRES else 1.0)
    true = dataclasses.replace(system, model=dataclasses.replace(system.model, Q=Q))
    record = simulate(true, 1, RUNS, STEPS)
    if world == OUTLIERS:
        record = _with_outliers(system, record, 2)
    reference = _squared_errors(make("kf", system.model), system, record)
    for name, (low, high) in shares.items():
        options = {"radius": 0.1} if name == "robust-kf" else {}
        errors = _squared_errors(make(name, system.model, **options), system, record)
        assert high == np.inf or _margin(errors, reference, high) > SURE
        assert low == 0.0 or _margin(errors, reference, low) < -SURE


# --- Levy and Nikoukhah's least-favourable model --------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("radius", [0.01, 0.1, 0.3])
@pytest.mark.parametrize("system", [_constant_velocity(), kalman_system(1, n=3, p=1)])
def test_under_the_least_favourable_model_the_error_is_as_large_as_the_filter_claims(
    system: System, radius: float
):
    """The worst model in the ball against the robust filter, over a given number of steps.

    With the prediction error ``e`` and unit white noise ``v``, ``x+ = A x + W v``, ``y = C x + D
    v``, the filter's error obeys ``e+ = F e + N v``, ``F = A - G C``, ``N = W - G D``, G its gain.
    The least-favourable joint density is the nominal one times ``exp(theta_t |e_{t+1}|^2 / 2)`` at
    every step (Levy & Nikoukhah 2013, the saddle point of sec. III). To run it forward as a
    state-space model each step's noise must anticipate later steps: integrating them out, last
    first, leaves ``exp(e' Omega e / 2)`` (their sec. V)::

        X = Omega_{t+1} + theta_t I      Z = (I - N' X N)^-1      Omega_t = F' (X + X N Z N' X) F
        v | e ~ N(Z N' X F e, Z)         e_0 ~ N(0, (V_0^-1 - Omega_0)^-1)

    At the last step the error of the filter then has exactly the covariance V that it claims.
    """
    model, eye = system.model, np.eye(system.model.n)
    W = np.hstack([np.linalg.cholesky(model.Q), np.zeros((model.n, model.p))])
    D = np.hstack([np.zeros((model.p, model.n)), np.linalg.cholesky(model.R)])
    filter = make("robust-kf", model, radius=radius)
    belief, V, steps = filter.init(system.prior), system.cov, []
    for _ in range(60):
        G = model.A @ V @ model.C.T @ np.linalg.inv(model.C @ V @ model.C.T + model.R)
        F, N = model.A - G @ model.C, W - G @ D
        belief = filter.predict(filter.update(belief, np.zeros(model.p)), np.zeros(system.m))
        P, V = F @ V @ F.T + N @ N.T, belief.cov
        theta = np.linalg.inv(P) - np.linalg.inv(V)
        np.testing.assert_allclose(theta, theta[0, 0] * eye, rtol=0, atol=1e-9)
        steps.append((F, N, theta))
    worst, omega = [], 0.0 * eye
    for F, N, theta in reversed(steps):
        X = omega + theta
        Z = np.linalg.inv(np.eye(N.shape[1]) - N.T @ X @ N)
        assert np.linalg.eigvalsh(Z).min() > 0.0
        worst.append((F + N @ Z @ N.T @ X @ F, N @ Z @ N.T))
        omega = F.T @ (X + X @ N @ Z @ N.T @ X) @ F
    cov = np.linalg.inv(np.linalg.inv(system.cov) - omega)
    for closed, spread in reversed(worst):
        cov = closed @ cov @ closed.T + spread
    np.testing.assert_allclose(cov, V, rtol=0, atol=1e-10 * np.abs(V).max())
