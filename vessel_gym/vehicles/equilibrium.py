"""Steady motions of vehicles, as roots of their accelerations."""

from collections.abc import Callable

import numpy as np

from estimators.differences import central_differences, steps


def root(
    residual: Callable[..., np.ndarray], guess: np.ndarray, held: np.ndarray | None = None
) -> np.ndarray:
    """Roots ``(..., n)`` of a function by Newton's method; NaN where it does not converge.

    Args:
        residual: Function of vectors ``(..., n)``, and of ``held``, with values ``(..., n)``.
        guess: Start ``(..., n)``.
        held: Vectors ``(..., m)`` that are not changed.
    """
    x, n = guess, guess.shape[-1]
    for _ in range(30):
        step = steps(x, None)
        values, jacobian = central_differences("residual", residual, x, held, n, (), step)
        change = np.linalg.solve(jacobian, values[..., None])[..., 0]
        x = x - change
        converged = (np.abs(change) <= 1e-12 * (1.0 + np.abs(x))).all(-1, keepdims=True)
        if converged.all():
            return x
    return np.where(converged, x, np.nan)
