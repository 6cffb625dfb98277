"""Outlines of vehicles."""

from typing import NamedTuple

import numpy as np

_ANGLES = np.linspace(0.0, 2.0 * np.pi, 48)
CIRCLE = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], -1)
"""Points ``(48, 2)`` of a unit circle."""


class Hull(NamedTuple):
    """Outline of a vehicle, drawn to scale where that is larger than a least size."""

    above: np.ndarray  # (k, 2) forward and to starboard, in lengths (an aircraft's in spans)
    least: float  # smallest drawn length [pixels]
    height: float = 1.0  # of the outline from the side, over the width of that from above


def _mirrored(side: list[list[float]]) -> np.ndarray:
    """Closed outline from one side, given from the bow on the axis to the stern."""
    return np.array(side + [[ahead, -aside] for ahead, aside in side[::-1]])


HULLS = {
    "ship": Hull(_mirrored([
        [0.5, 0.0], [0.25, 0.06], [0.05, 0.07], [-0.5, 0.055],
    ]), 44.0),
    "torpedo": Hull(_mirrored([
        [0.5, 0.0], [0.46, 0.04], [0.36, 0.07], [-0.3, 0.07], [-0.38, 0.12], [-0.46, 0.12],
        [-0.5, 0.03],
    ]), 30.0),
    "aircraft": Hull(_mirrored([
        [0.17, 0.0], [0.15, 0.035], [0.08, 0.07], [-0.13, 0.5], [-0.25, 0.5], [-0.1, 0.08],
    ]), 28.0, height=0.08),
    "dot": Hull(0.5 * CIRCLE, 9.0),
}  # fmt: skip
"""Outlines by name, see `vessel_gym.tasks.task.HULLS`."""
