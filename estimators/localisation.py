"""Localisation of ensemble filters: which measurement may correct which state, and by how much."""

import numpy as np

from estimators.checks import as_array, frozen, number

Groups = tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...]
"""Groups of as many states and measurements each: indices of states ``(g, c)``, indices of the measurements that
correct them ``(g, k)``, and square roots of their taper ``(g, k)``."""


def check_taper(localisation: np.ndarray, n: int, p: int) -> np.ndarray:
    """The taper ``(n, p)`` of a localisation, read-only.

    Raises:
        ValueError: for another shape, or numbers that do not lie between 0 and 1.
    """
    taper = as_array("localisation", localisation)
    if taper.shape != (n, p):
        raise ValueError(f"localisation has shape {taper.shape}, expected (n, p) = {(n, p)}")
    if not ((taper >= 0.0) & (taper <= 1.0)).all():
        raise ValueError(f"localisation must lie between 0 and 1, got {taper.min():g} to {taper.max():g}")
    return frozen(taper)


def group_states(taper: np.ndarray) -> Groups:
    """Groups of states with equal rows of a taper ``(n, p)``, those of the same sizes together."""
    rows, group = np.unique(taper, axis=0, return_inverse=True)
    blocks: dict[tuple[int, int], list[tuple[np.ndarray, ...]]] = {}
    for i, row in enumerate(rows):
        states, channels = np.flatnonzero(group.reshape(-1) == i), np.flatnonzero(row)
        blocks.setdefault((len(states), len(channels)), []).append((states, channels, np.sqrt(row[channels])))
    return tuple((np.stack(s), np.stack(c), np.stack(r)) for s, c, r in (zip(*b, strict=True) for b in blocks.values()))


def gaspari_cohn(distance: np.ndarray | float, radius: float) -> np.ndarray:
    """A taper for a localisation: like a Gaussian, from 1 at no distance to 0 at twice the radius and beyond.

    The Gaussian that it is like has a standard deviation of ``sqrt(0.3)`` of the radius.

    Source: Gaspari & Cohn (1999), eq. 4.10.

    Args:
        distance: Any shape, of either sign.
        radius: In the same units.

    Raises:
        ValueError: for a radius that is not positive, or a distance that is not a number.
    """
    distance = as_array("distance", distance)
    if np.isnan(distance).any():
        raise ValueError("distance must be numbers, got NaN: a pair that is to be left out is far apart, at np.inf")
    r = np.abs(distance) / number("radius", radius, 0.0, np.inf, "a positive number")
    near = 1.0 + r**2 * (-5.0 / 3.0 + r * (0.625 + r * (0.5 - 0.25 * r)))
    s = np.clip(r, 1.0, 2.0)
    far = 4.0 + s * (-5.0 + s * (5.0 / 3.0 + s * (0.625 + s * (-0.5 + s / 12.0)))) - 2.0 / (3.0 * s)
    return np.where(r < 1.0, near, np.where(r < 2.0, np.maximum(far, 0.0), 0.0))
