"""Angles: the one place where they are wrapped."""

import numpy as np

_TURN = 2.0 * np.pi


def wrap(angle: np.ndarray | float) -> np.ndarray:
    """Wrap angles to (-pi, pi].

    Args:
        angle: Angles in rad, any shape.

    Returns:
        The same angles in (-pi, pi], same shape.
    """
    return np.pi - np.mod(np.pi - angle, _TURN)


def difference(a: np.ndarray, b: np.ndarray, angles: tuple[int, ...]) -> np.ndarray:
    """``a - b`` of vectors ``(..., n)``, with the components in ``angles`` wrapped.

    State angles stay unwrapped inside filters, so this is where a residual becomes small again.
    """
    residual = a - b
    for i in angles:
        residual[..., i] = wrap(residual[..., i])
    return residual
