"""Errors of a filter, and their size relative to its covariance."""

import numpy as np
from numpy.typing import ArrayLike

from estimators.angles import difference
from estimators.checks import as_array
from estimators.linalg import masked, semidefinite_form


def rmse(
    estimate: ArrayLike,
    truth: ArrayLike,
    angles: tuple[int, ...] = (),
    axis: int | tuple[int, ...] | None = None,
) -> np.ndarray:
    """Root mean square error of vectors ``(..., n)``, one value a component.

    Args:
        estimate: ``(..., n)``.
        truth: ``(..., n)``.
        angles: components whose difference is wrapped.
        axis: leading axes to average over; None: all of them.
    """
    error = difference(np.asarray(estimate, float), np.asarray(truth, float), angles)
    axis = tuple(range(error.ndim - 1)) if axis is None else axis
    return np.sqrt(np.mean(error**2, axis=axis))


def nees(
    mean: ArrayLike, cov: ArrayLike, truth: ArrayLike, angles: tuple[int, ...] = ()
) -> np.ndarray:
    """Normalised estimation error squared ``(x - x^)' P^-1 (x - x^)``, shape ``(...)``.

    Chi-square with n degrees of freedom for a consistent filter (Bar-Shalom et al. 2001, sec. 5.4).
    A component whose true value is NaN is unknown and adds nothing, nor a degree of freedom. A NaN
    in the estimate gives NaN.
    """
    truth, mean = np.asarray(truth, float), np.asarray(mean, float)
    values = nis(difference(truth, mean, angles), cov, np.abs(mean).max(-1, keepdims=True))
    return np.where(np.isnan(mean).any(-1), np.nan, values)[()]


def nis(innovation: ArrayLike, innovation_cov: ArrayLike, size: ArrayLike = 0.0) -> np.ndarray:
    """Normalised innovation squared ``e' S^-1 e``, shape ``(...)``.

    Chi-square for a consistent filter. The degrees of freedom are the rank of S, restricted to the
    measurements that arrived. Measurements that are missing (NaN), or that others determine without
    noise, add nothing. Infinite where a measurement contradicts an exact one by more than rounding.

    Args:
        innovation: ``(..., p)``.
        innovation_cov: ``(..., p, p)``.
        size: ``(..., p)`` or ``(..., 1)`` magnitude of the measurements, which sets the
            innovation's rounding error. The magnitude of the state, ``abs(mean).max(-1,
            keepdims=True)``, serves, too. 0: no rounding error.
    """
    error, cov = as_array("innovation", innovation), np.asarray(innovation_cov, float)
    arrived = ~np.isnan(error)
    form = semidefinite_form(np.where(arrived, error, 0.0), masked(cov, arrived), size)[0]
    return np.where(np.isinf(error).any(-1), np.inf, form)[()]
