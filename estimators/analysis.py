"""Moments, draws and angles of ensembles, in plain NumPy.

Members are last: an ensemble is ``(..., n, N)``, its anomalies ``A (..., n, N)``. Keyword arguments
are static: a function is compiled once for each of their values.
"""

from typing import Any

import numpy as np

from estimators.engine import compiled
from estimators.linalg import (
    cholesky,
    diagonal,
    identity,
    joined,
    regular,
    semidefinite_cholesky,
    solve_lower,
    solve_upper,
)

_TURN = 2.0 * np.pi


# --- moments --------------------------------------------------------------------------------------


def _mean(a: np.ndarray) -> np.ndarray:
    """Means ``(..., k, 1)`` over members ``(..., k, N)``, weighted first as sums may overflow."""
    return a @ np.full((a.shape[-1], 1), 1.0 / a.shape[-1])


def average(a: np.ndarray) -> np.ndarray:
    """Means ``(..., k)`` over the members of ``(..., k, N)``; NaN where the variance overflows."""
    return np.where(np.isfinite(_mean(a * a)), _mean(a), np.nan)[..., 0]


def covariance(members: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Sample covariance ``(..., n, n)`` of members ``(..., n, N)``."""
    A = members - mean[..., None]
    return A @ A.mT / (A.shape[-1] - 1)


# --- draws ----------------------------------------------------------------------------------------


def noise(
    root: np.ndarray, normals: np.ndarray, exact: bool, A: Any = None, gram: Any = None
) -> np.ndarray:
    """Noise ``L z (..., k, N)`` of sample mean 0, of normals that are centred.

    Exact noise has the sample covariance ``L L'`` and no correlation with A: the normals lose their
    regression on the anomalies, and are whitened::

        z <- z - (z A') (A A')^+ A        z <- chol(z z' / (N - 1))^-1 z

    A row of zeros stays one. N must be at least r + n + 1, where n is the number of anomalies.

    Source: second-order exact sampling of perturbations, Hoteit, Pham, Gharamti & Luo (2015),
    Mitigating observation perturbation sampling errors in the stochastic EnKF, Mon. Wea. Rev. 143.

    Args:
        root: ``L (..., k, r)``.
        normals: Standard normals ``(..., r, N)``.
        exact: Is the noise exact? Otherwise draws are independent.
        A: Anomalies of the members ``(..., n, N)``, or None.
        gram: ``A A' (..., n, n)``.
    """
    z = normals - _mean(normals)
    if not exact:
        return root @ z
    if A is not None:
        L = regular(semidefinite_cholesky(gram))  # a row that repeats earlier ones has no share
        z = z - solve_upper(L.mT, solve_lower(L, A @ z.mT)).mT @ A
        z = z - _mean(z)  # the anomalies' rounding, where these nearly repeat each other
    cov = z @ z.mT / (z.shape[-1] - 1)
    absent = np.where(diagonal(cov) == 0.0, 1.0, 0.0)
    W = cholesky(cov + absent[..., None] * identity(cov.shape[-1]))
    return solve_upper(W.mT, root.mT).mT @ z


# --- angles ---------------------------------------------------------------------------------------


def _near(angle: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Angles shifted by whole turns to within half a turn of ``centre``."""
    return angle - _TURN * np.rint((angle - centre) / _TURN)


def gathered(
    members: np.ndarray, angles: tuple[int, ...], about: np.ndarray | None = None
) -> np.ndarray:
    """Members ``(..., k, N)`` whose angles are within half a turn of their circular mean.

    The mean is within half a turn of ``about (..., k, 1)``, or of the first member.
    """
    if not angles:
        return members
    parts = [members[..., i : i + 1, :] for i in range(members.shape[-2])]
    ones = np.ones((members.shape[-1], 1))
    for i in angles:
        near = parts[i][..., :1] if about is None else about[..., i : i + 1, :]
        centre = np.arctan2(np.sin(parts[i]) @ ones, np.cos(parts[i]) @ ones)
        parts[i] = _near(parts[i], _near(centre, near))
    return joined(parts, -2)


@compiled(axes=(1, 2, 2), matrices=True)
def sample(
    mean: np.ndarray, root: np.ndarray, normals: np.ndarray, *, angles: tuple[int, ...], exact: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean ``(..., n)``, members ``x_i = m + L n_i`` of a prior, and their covariance.

    Args:
        mean: ``m (..., n)``.
        root: ``L (..., n, n)``, a square root of the covariance.
        normals: ``(..., n, N)``.
        angles: Components that are gathered about their circular mean, near ``m``.
        exact: The members have the prior's covariance exactly, see `noise`.
    """
    centre = mean[..., None]
    members = gathered(centre + noise(root, normals, exact), angles, centre)
    mean = _mean(members)[..., 0]
    return mean, members, covariance(members, mean)
