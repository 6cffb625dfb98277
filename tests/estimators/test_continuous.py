"""The Kalman-Bucy filter: its differential equations, its limit, and `kf` on the way there."""

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from estimators import Gaussian, LinearModel, kalman_bucy, make, run, stationary_gain, van_loan
from tests.estimators.cases import random_covariance

# --- systems --------------------------------------------------------------------------------------

STIFF = LinearModel(
    A=[[-20.0, 0.0, 0.0], [1.0, -0.01, 0.0], [0.0, 1.0, -1.0]], B=[[1.0], [0.0], [0.5]],
    C=[[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], Q=np.diag([4.0, 0.02, 0.1]), R=np.diag([0.1, 0.5]),
)  # fmt: skip
"""Time constants of 0.05 s, 1 s and 100 s."""
PRIOR = Gaussian([1.0, -1.0, 0.5], np.diag([1.0, 0.2, 0.3]))


def drawn(seed: int, n: int = 3, p: int = 2) -> LinearModel:
    """A random system in continuous time, with a known input."""
    rng = np.random.default_rng(seed)
    A, C, B = rng.normal(size=(n, n)), rng.normal(size=(p, n)), rng.normal(size=(n, 1))
    return LinearModel(A, C, random_covariance(rng, n), random_covariance(rng, p), B)


def paths(steps: int, *rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Measurements ``(steps, ..., 2)`` and known inputs ``(steps, ..., 1)``."""
    rng = np.random.default_rng(steps)
    return rng.normal(size=(steps, *rows, 2)), rng.normal(size=(steps, *rows, 1))


def shares(found: np.ndarray, cov: np.ndarray) -> Any:
    """Largest entries of matrices ``(..., n, n)`` in units of the standard deviations of another."""
    sd = np.sqrt(np.diagonal(cov, axis1=-2, axis2=-1))
    return np.abs(found / sd[..., None] / sd[..., None, :]).max()


# --- the equations --------------------------------------------------------------------------------


def test_both_equations_are_solved_as_radau_solves_them():
    m, (y, u), t = STIFF, paths(2), [0.0, 0.1, 0.6]
    mean, cov, gain = kalman_bucy(m, PRIOR, t, y, u)
    solution = np.concatenate([PRIOR.mean, PRIOR.cov.ravel()])

    def slope(_: float, solution: np.ndarray, y: np.ndarray, u: np.ndarray) -> np.ndarray:
        x, P = solution[:3], solution[3:].reshape(3, 3)
        K = P @ m.C.T @ np.linalg.inv(m.R)
        moved = m.A @ x + m.B @ u + K @ (y - m.C @ x)
        return np.concatenate([moved, (m.A @ P + P @ m.A.T + m.Q - K @ m.R @ K.T).ravel()])

    for k in range(2):
        given = {"args": (y[k], u[k]), "rtol": 1e-11, "atol": 1e-13}
        solution = solve_ivp(slope, t[k : k + 2], solution, "Radau", **given).y[:, -1]
        np.testing.assert_allclose(mean[k + 1], solution[:3], rtol=0, atol=1e-10)
        np.testing.assert_allclose(cov[k + 1].ravel(), solution[3:], rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(gain, cov @ m.C.T @ np.linalg.inv(m.R), rtol=1e-12)


@pytest.mark.parametrize("noise", [1e-8, 1.0, 1e8])
@pytest.mark.parametrize("length", [0.01, 3.0, 1000.0])
def test_a_step_of_any_length_is_that_of_its_parts(length: float, noise: float):
    """Also where one exponential would overflow, and whatever is measured how precisely."""
    model = LinearModel(STIFF.A, STIFF.C, STIFF.Q, noise * STIFF.R, STIFF.B)
    (y, u), parts = paths(1, 2), np.array([0.0, 0.1, 0.2, 0.7, 1.0])
    rows = [np.repeat(each, 4, 0) for each in (y, u)]
    mean, cov, _ = kalman_bucy(model, PRIOR, [0.0, length], y, u)
    means, covs, _ = kalman_bucy(model, PRIOR, length * parts, *rows)
    assert shares(covs[-1] - cov[-1], cov[-1]) < 1e-10
    np.testing.assert_allclose(means[-1], mean[-1], rtol=1e-9, atol=1e-12)
    assert np.linalg.eigvalsh(covs).min() > 0.0


@pytest.mark.parametrize("seed", range(3))
def test_a_change_of_units_changes_nothing_else(seed: int):
    m, (y, u), t = drawn(seed), paths(4), np.array([0.0, 0.1, 0.5, 0.6, 2.0])
    D, E, minute = np.diag([1e-3, 1.0, 1e4]), np.diag([100.0, 1e-4]), 1.0 / 60.0
    back = np.linalg.inv(D)
    other = LinearModel(
        D @ m.A @ back / minute, E @ m.C @ back, D @ m.Q @ D / minute, E @ m.R @ E * minute,
        D @ m.B / minute,
    )  # fmt: skip
    mean, cov, gain = kalman_bucy(m, PRIOR, t, y, u)
    moved = Gaussian(D @ PRIOR.mean, D @ PRIOR.cov @ D)
    found = kalman_bucy(other, moved, t * minute, y @ E, u)
    np.testing.assert_allclose(found[0], mean @ D, rtol=1e-9)
    assert shares(found[1] - D @ cov @ D, found[1]) < 1e-10
    np.testing.assert_allclose(found[2], D @ gain @ np.linalg.inv(E) / minute, rtol=1e-7)


def test_a_row_has_its_own_mean_and_the_covariance_of_all():
    (y, u), t = paths(5, 3), np.linspace(0.0, 1.0, 6)
    together = kalman_bucy(STIFF, PRIOR, t, y, u)
    for i in range(3):
        alone = kalman_bucy(STIFF, PRIOR, t, y[:, i], u[:, i])
        np.testing.assert_allclose(together[0][:, i], alone[0], rtol=1e-12)
        for row, all_rows in zip(alone[1:], together[1:], strict=True):
            np.testing.assert_array_equal(row, all_rows)


# --- the limit of the Kalman filter ---------------------------------------------------------------

STEPS = 0.1, 0.01, 0.001


@pytest.mark.parametrize("seed", range(2))
def test_kf_tends_to_it_at_order_one_with_r_over_dt(seed: int):
    """Its covariance, its gain over dt, and its mean on one Brownian path of a second."""
    m, fine = drawn(seed), 2e-4
    normals = np.random.default_rng(seed).normal(size=(5000, 2))
    y = normals @ np.linalg.cholesky(m.R / fine).T
    limit = kalman_bucy(m, PRIOR, fine * np.arange(5001), y, np.zeros((5000, 1)))
    errors = []
    for dt in STEPS:
        every, (F, N) = round(dt / fine), van_loan(m.A, np.eye(3), m.Q, dt)
        averages = y.reshape(-1, every, 2).mean(1)
        kf = run(make("kf", LinearModel(F, m.C, N, m.R / dt)), PRIOR, averages).predicted
        gain = kf.cov @ m.C.T @ np.linalg.inv(m.C @ kf.cov @ m.C.T * dt + m.R)
        found = zip((kf.mean, kf.cov, gain), limit, strict=True)
        errors.append([np.sqrt(np.square(a - b[:-1:every]).mean()) for a, b in found])
    orders = -np.diff(np.log10(errors), axis=0)
    np.testing.assert_allclose(orders[1], 1.0, rtol=0, atol=0.1)


# --- the stationary filter ------------------------------------------------------------------------


@pytest.mark.parametrize("model", [STIFF, *map(drawn, range(3))])
def test_it_settles_at_the_gain_of_python_control(model: LinearModel):
    from control import lqe  # late: the import is slow

    K, P = stationary_gain(model)
    _, covs, gains = kalman_bucy(
        model, PRIOR, [0.0, 1000.0, 2000.0], np.zeros((2, 2)), np.zeros((2, 1))
    )
    theirs = lqe(model.A, np.eye(3), model.C, model.Q, model.R)
    for cov in (*covs[1:], theirs[1]):
        assert shares(cov - P, P) < 1e-10
    for gain in (*gains[1:], theirs[0]):
        np.testing.assert_allclose(gain, K, rtol=0, atol=1e-9 * np.abs(K).max())


@pytest.mark.parametrize(
    ("A", "C", "Q"),
    [
        ([[1.0, 0.0], [0.0, -1.0]], [[0.0, 1.0]], np.eye(2)),  # what grows is not measured
        (np.zeros((2, 2)), [[1.0, 1.0]], np.eye(2)),  # a difference is not measured
        (np.zeros((2, 2)), [[1.0, 1.0]], 1e-4 * np.eye(2)),  # here SciPy has a covariance of .0035
        (np.zeros((2, 2)), np.eye(2), np.zeros((2, 2))),  # constants: the gain tends to 0
    ],
)
def test_a_filter_without_a_stable_limit_has_no_gain(A: Any, C: Any, Q: Any):
    with pytest.raises(ValueError, match="no gain makes A - K C stable: measure what grows"):
        stationary_gain(LinearModel(A, C, Q, np.eye(len(C))))


# --- what does not fit ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"t": [0.0, 1.0, 1.0, 2.0]}, "times t must increase: each measurement is an average"),
        ({"t": [[0.0, 1.0]]}, r"t must have shape \(T,\), got \(1, 2\)"),
        ({"y": np.zeros((4, 2))}, r"y must have shape \(3, 2\), got \(4, 2\)"),
        ({"y": np.full((3, 2), np.nan)}, "y must be finite"),
        ({"u": None}, r"u must have shape \(3, 1\), got \(3, 0\)"),
        ({"u": np.zeros((3, 2))}, r"u must have shape \(3, 1\), got \(3, 2\)"),
        ({"prior": Gaussian(np.zeros(2), np.eye(2))}, r"the prior's mean has shape \(2,\)"),
        ({"prior": Gaussian(np.zeros((2, 3)), np.eye(3))}, r"prior's mean has shape \(2, 3\)"),
        ({"prior": Gaussian(np.zeros(3), np.eye(3)[None])}, r"prior's cov must have shape \(3, 3"),
        ({"model": LinearModel(STIFF.A, STIFF.C, STIFF.Q, np.diag([1.0, 0.0]), STIFF.B)},
         "R must be positive definite: the filter would differentiate"),
        ({"model": LinearModel(STIFF.A[None], STIFF.C, STIFF.Q, STIFF.R, STIFF.B)},
         r"A must have shape \(n, m\), got \(1, 3, 3\)"),
        ({"model": LinearModel(lambda u: STIFF.A, STIFF.C, STIFF.Q, STIFF.R, STIFF.B)},
         "A must be an array of real numbers"),
    ],
)  # fmt: skip
def test_what_the_filter_cannot_use_gets_one_sentence(changes: dict, sentence: str):
    y, u = paths(3)
    given = {"model": STIFF, "prior": PRIOR, "t": np.arange(4.0), "y": y, "u": u} | changes
    with pytest.raises(ValueError, match=sentence):
        kalman_bucy(**given)
