"""Outlines of vehicles."""

from dataclasses import dataclass

import numpy as np

_ANGLES = np.linspace(0.0, 2.0 * np.pi, 48)
CIRCLE = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], -1)
"""Points ``(48, 2)`` of a unit circle."""


@dataclass(frozen=True, eq=False)
class Hull:
    """Outline of a vehicle.

    Attributes:
        above: Outline ``(k, 2)`` forward and to starboard, in lengths (an aircraft's in spans).
        least: Smallest drawn length [pixels].
        height: Height of the outline from the side, over the width of that from above.
        scaled: Is the outline drawn to scale where that is larger?
    """

    above: np.ndarray
    least: float
    height: float = 1.0
    scaled: bool = True


def _mirrored(side: np.ndarray) -> np.ndarray:
    """Closed outline from one side, given from the bow on the axis to the stern."""
    return np.concatenate([side, side[::-1] * [1.0, -1.0]])


_SHIP = _mirrored(
    np.array([[0.5, 0.0], [0.375, 0.04], [0.25, 0.06], [0.05, 0.07], [-0.3, 0.066], [-0.5, 0.055]])
)
_TURN = np.linspace(0.0, 0.5 * np.pi, 12)
_NOSE = np.stack([0.22 + 0.28 * np.cos(_TURN), 0.08 * np.sin(_TURN)], -1)
_STERN = np.array(
    [[-0.2, 0.08], [-0.32, 0.062], [-0.38, 0.12], [-0.46, 0.12], [-0.46, 0.032], [-0.5, 0.02]]
)
_TORPEDO = _mirrored(np.concatenate([_NOSE, _STERN]))
_WING = _mirrored(np.array([
    [0.17, 0.0], [0.15, 0.035], [0.08, 0.07], [-0.12, 0.48], [-0.13, 0.5], [-0.25, 0.5],
    [-0.22, 0.47], [-0.1, 0.1], [-0.13, 0.03],
]))  # fmt: skip

HULLS = {
    "ship": Hull(_SHIP, 44.0),
    "torpedo": Hull(_TORPEDO, 30.0),
    "aircraft": Hull(_WING, 28.0, height=0.08),
    "dot": Hull(0.5 * CIRCLE, 9.0, scaled=False),
}
"""Outlines by name, see `vessel_gym.tasks.workspace.HULLS`."""
