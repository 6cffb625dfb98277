"""Plane vectors in the frame of a heading."""

import numpy as np

from estimators.engine import sincos


def ahead_and_aside(
    north: np.ndarray, east: np.ndarray, heading: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Components ``(...)`` of vectors along a heading [rad] and to starboard of it."""
    sin, cos = sincos(heading)
    return north * cos + east * sin, east * cos - north * sin
