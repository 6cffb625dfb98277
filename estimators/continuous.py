"""The Kalman filter of continuous time, for continuous measurements.

Measurements at single times are for `make` ``("kf", sampled(A, C, Q, R, B))``.
"""

import numpy as np
from scipy.linalg import solve_continuous_are

from estimators.checks import as_array, broadcast, finite_array
from estimators.discretisation import matrices, riccati_step, with_inputs
from estimators.linalg import congruence, identity, lacks_rank, symmetrise
from estimators.models import Gaussian, LinearModel


def kalman_bucy(
    model: LinearModel, prior: Gaussian, t: np.ndarray, y: np.ndarray, u: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Means, covariances and gains of the Kalman-Bucy filter at given times.

    The model is ``x' = A x + B u + w``, ``y = C x + v`` with white noises of intensities Q and R: a
    variance per unit of time, and a variance times a unit of time. The filter is ::

        x' = A x + B u + K (y - C x)      K = P C' R^-1      P' = A P + P A' + Q - K R K'

    Both equations are solved exactly, over steps of any length, with u and y held over each step.
    The covariances and gains depend on neither.

    Source: Kalman & Bucy (1961), New results in linear filtering and prediction theory, J. Basic
    Engineering 83.

    Args:
        model: Its matrices are those of continuous time, arrays without batch axes. Unknown inputs
            and angles are ignored.
        prior: Mean ``(..., n)`` and covariance ``(n, n)`` of the state at the first time.
        t: ``(T,)`` times, which increase.
        y: ``(T - 1, ..., p)`` measurement averaged over each step: the increment of its integral,
            divided by the step's length.
        u: ``(T - 1, ..., m)`` known input over each step, if the model has B.

    Returns:
        Means ``(T, ..., n)``, covariances ``(T, n, n)`` and gains ``(T, n, p)``.

    Raises:
        ValueError: naming the argument whose shape is wrong or which is not finite; or if R is
            singular, or times do not increase.
    """
    A, B, C, Q, R = matrices(model, "ABCQR")
    precision, (n, m), p = _inverse(R), B.shape, model.p
    lengths = np.diff(finite_array("t", t, "T")).tolist()
    if min(lengths, default=1.0) <= 0.0:
        raise ValueError("times t must increase: each measurement is an average over a step")
    rows = as_array("y", y).shape[1:-1]
    y = finite_array("y", y, len(lengths), *rows, p)
    u = finite_array("u", y[..., :0] if u is None else u, *y.shape[:-1], m)
    # u and y are further states, which stay: the innovation is linear in the states then.
    innovation = np.hstack([C, np.zeros((p, m)), -np.eye(p)])
    system = with_inputs(A, np.hstack([B, np.zeros((n, p))]))
    rates = system, np.pad(Q, (0, m + p)), congruence(innovation.T, precision)
    steps = {dt: riccati_step(*rates, dt) for dt in {*lengths}}
    mean = broadcast("the prior's mean", prior.mean, rows + (n,))
    cov = np.pad(finite_array("the prior's cov", prior.cov, n, n), (0, m + p))
    means, covs = [mean], [cov]
    for dt, given in zip(lengths, np.concatenate([u, y], -1), strict=True):
        F, N, Y = steps[dt]
        F = F @ np.linalg.inv(identity(len(cov)) + cov @ Y)
        mean = np.matvec(F, np.concatenate([mean, given], -1))[..., :n]
        cov = symmetrise(congruence(F, cov) + congruence(F @ cov, Y) + N)
        means.append(mean)
        covs.append(cov)
    cov = np.array(covs)[:, :n, :n]
    return np.array(means), cov, cov @ C.T @ precision


def stationary_gain(model: LinearModel) -> tuple[np.ndarray, np.ndarray]:
    """Gain K ``(n, p)`` and covariance P ``(n, n)`` to which `kalman_bucy` tends.

    ::

        K = P C' R^-1      0 = A P + P A' + Q - K R K'

    Args:
        model: Its matrices are those of continuous time, see `kalman_bucy`.

    Raises:
        ValueError: if R is singular, or no gain makes the dynamics of the error, ``A - K C``,
            stable.
    """
    A, C, Q, R = matrices(model, "ACQR")
    precision = _inverse(R)
    try:
        P = solve_continuous_are(A.T, C.T, Q, R)
        K = P @ C.T @ precision
        poles = np.linalg.eigvals(A - K @ C)
    except np.linalg.LinAlgError:
        poles = np.array([np.nan])
    # Where there is no solution, SciPy may also return one that grew until rounding stopped it.
    if not (poles.real < -1e-8 * np.abs(poles).max()).all():
        raise ValueError(
            "no gain makes A - K C stable: measure what grows or stays, and give what stays noise"
        )
    return K, P


def _inverse(R: np.ndarray) -> np.ndarray:
    """``R^-1``.

    Raises:
        ValueError: if R is singular.
    """
    if lacks_rank(R):
        raise ValueError(
            "R must be positive definite: the filter would differentiate a channel without noise"
        )
    return np.linalg.inv(R)
