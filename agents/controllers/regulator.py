"""The linear-quadratic regulator that the classical controllers share."""

import numpy as np
from scipy.linalg import solve_discrete_are


def regulator_gains(A: np.ndarray, B: np.ndarray, Q: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Gains K ``(m, n)`` of ``u = -K x`` that minimise the sum of ``x' Q x + u' R u`` for ``x+ = A x + B u``.

    Args:
        A: ``(n, n)``.
        B: ``(n, m)``.
        Q: ``(n, n)`` cost of deviations.
        R: ``(m, m)`` cost of the input.
    """
    P = solve_discrete_are(A, B, Q, R)
    return np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
