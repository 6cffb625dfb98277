"""Filters that `studies.speed` times: ours, filterpy's, and the Kalman filter in bare NumPy."""

from collections.abc import Callable
from itertools import count
from typing import Any

import numpy as np

from estimators import Gaussian, LinearModel, NonlinearModel, RandomKeys, make
from estimators.engine import compiled

STATES, MEASUREMENTS, INPUTS = 12, 8, 2
"""Size of the system of the filters."""
Step = Callable[[np.ndarray], Any]
"""Prediction and update by measurements ``(rows, p)``; returns the means ``(rows, n)``."""

_rng = np.random.default_rng(0)
A, C = _rng.normal(size=(STATES, STATES)), _rng.normal(size=(MEASUREMENTS, STATES))
A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
G, H = _rng.normal(size=(STATES, INPUTS)), _rng.normal(size=(MEASUREMENTS, INPUTS))
Q, R = 0.1 * np.eye(STATES), np.eye(MEASUREMENTS)


def prior(rows: int) -> Gaussian:
    """Prior with another covariance in each row."""
    spread = np.linspace(1.0, 2.0, rows)[:, None, None]
    return Gaussian(np.zeros((rows, STATES)), spread * np.eye(STATES))


def nonlinear(M: np.ndarray) -> tuple[Callable[..., np.ndarray], Callable[..., np.ndarray]]:
    """``M (x + 0.1 sin x)`` as a function of x, and its Jacobian."""

    def value(x: np.ndarray, u: Any = None) -> np.ndarray:
        return np.matvec(M, x + 0.1 * np.sin(x))

    def slope(x: np.ndarray, u: Any = None) -> np.ndarray:
        return M * (1.0 + 0.1 * np.cos(x))[..., None, :]

    return value, slope


(move, moving), (see, seeing) = nonlinear(A), nonlinear(C)
NONLINEAR = "ekf", "ukf"
"""Filters that are timed on the nonlinear system, whose transition and measurement these are."""


def ours(name: str, rows: int, plain: bool = False) -> Step:
    """A filter of the package; a nonlinear model is compiled, or plain NumPy of a user."""
    model: Any = LinearModel(A, C, Q, R, G=G, H=H)
    if name in NONLINEAR and plain:
        model = NonlinearModel(
            move, see, Q, R, transition_jacobian=moving, measurement_jacobian=seeing
        )
    elif name in NONLINEAR:
        model = NonlinearModel(compiled(move), compiled(see), Q, R)
    try:
        filter = make(name, model)
    except ValueError:  # a filter without feedthrough
        filter = make(name, LinearModel(A, C, Q, R, G=G))
    keys = map(RandomKeys.seeded(range(rows)).at, count())
    belief = filter.init(prior(rows), rng=next(keys))

    def step(y: np.ndarray) -> np.ndarray:
        nonlocal belief
        rng = next(keys) if filter.random else None
        belief = filter.update(filter.predict(belief, rng=rng), y, rng=rng)
        return belief.mean

    return step


def filterpys(name: str) -> Step:
    """The filter of filterpy that computes the same for one row."""
    from filterpy import kalman

    functions: tuple[Any, ...] = ()
    if name == "kf":
        rival = kalman.KalmanFilter(STATES, MEASUREMENTS)
        rival.F, rival.H = A, C
    elif name == "ekf":
        rival = kalman.ExtendedKalmanFilter(STATES, MEASUREMENTS)
        functions = seeing, see

        def predict_x(u: Any = 0) -> None:  # which is left to its user
            rival.F, rival.x = moving(rival.x), move(rival.x)

        rival.predict_x = predict_x
    else:
        points = kalman.MerweScaledSigmaPoints(STATES, 1.0, 2.0, 0.0)
        rival = kalman.UnscentedKalmanFilter(STATES, MEASUREMENTS, 1.0, see, move, points)
    rival.x, rival.P, rival.Q, rival.R = prior(1).mean[0].copy(), prior(1).cov[0].copy(), Q, R

    def step(y: np.ndarray) -> np.ndarray:
        rival.predict()
        rival.update(y[0], *functions)
        return rival.x[None]

    return step


def numpy_kalman(rows: int) -> Step:
    """Equations of the Kalman filter in NumPy, 64 rows at a time, without any check."""
    mean, cov = prior(rows).mean.copy(), prior(rows).cov.copy()

    def step(y: np.ndarray) -> np.ndarray:
        for first in range(0, rows, 64):
            few = slice(first, first + 64)
            x, P = mean[few] @ A.T, A @ cov[few] @ A.T + Q
            PC = P @ C.T
            K = np.linalg.solve(C @ PC + R, PC.mT)
            P -= PC @ K
            mean[few] = x + np.vecmat(y[few] - x @ C.T, K)
            cov[few] = 0.5 * (P + P.mT)
        return mean

    return step
