"""Wrapping of angles and of their differences, and vectors in the frame of a heading."""

from typing import Any

import numpy as np

from estimators.engine import is_traced, sincos

_TURN = 2.0 * np.pi
_LOWEST = np.nextafter(-np.pi, 0.0)


def wrap(angle: np.ndarray | float) -> np.ndarray:
    """Wrap angles to (-pi, pi].

    Args:
        angle: Angles in rad, any shape.

    Returns:
        The same angles in (-pi, pi], same shape.
    """
    below: Any = np.pi - angle
    rest = (
        below - _TURN * np.floor(below / _TURN) if is_traced(angle) else np.mod(below, _TURN)
    )  # floor is vectorised
    return np.maximum(np.pi - rest, _LOWEST)  # a hair above pi is rounded to a whole turn


def short_way(change: np.ndarray) -> np.ndarray:
    """Changes of an angle the short way round; half a turn keeps or changes its sign."""
    return change - _TURN * np.rint(change / _TURN)


def difference(a: np.ndarray, b: np.ndarray, angles: tuple[int, ...]) -> np.ndarray:
    """``a - b`` of vectors ``(..., n)``, with the components in ``angles`` wrapped.

    State angles stay unwrapped inside filters, so this is where a residual becomes small again.
    """
    residual = a - b
    if angles and is_traced(residual):
        are_angles = np.isin(np.arange(residual.shape[-1]), angles)
        return np.where(are_angles, wrap(residual), residual)
    if angles:
        index = ..., angles[0] if len(angles) == 1 else list(angles)
        residual[index] = wrap(residual[index])
    return residual


def ahead_and_aside(
    north: np.ndarray, east: np.ndarray, heading: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Components ``(...)`` of vectors along a heading [rad] and to starboard of it."""
    sin, cos = sincos(heading)
    return north * cos + east * sin, east * cos - north * sin
