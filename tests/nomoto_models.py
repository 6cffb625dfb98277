"""Nomoto's model of how a ship steers, from the equations of motion.

Maintainers hold the ships that come with the package against published figures with it. Source:
Nomoto, Taguchi, Honda & Hirano (1957), On the steering qualities of ships.
"""

from dataclasses import dataclass

import numpy as np

from vessel_gym.vehicles.corvette_equations import CorvetteParameters


@dataclass(frozen=True)
class Nomoto:
    """Nomoto's model ``r / delta = K (1 + T3 s) / ((1 + T1 s) (1 + T2 s))``, made non-dimensional with L and U.

    ``K' = K L / U`` and ``T' = T U / L``; ``T = T1 + T2 - T3`` is the time constant of the
    first-order model with the same response to slow helm.
    """

    K: float
    T: float
    T1: float  # the longer of the two
    T2: float
    T3: float


def nomoto_linear(ship: CorvetteParameters) -> Nomoto:
    """The model of the true equations linearised on the straight course at service speed."""
    _, A, B = np.split(ship.jacobian(np.array([ship.speed, 0.0, 0.0, 0.0]))[1:], [1, 3], 1)
    # r(s) / delta(s) = (b2 s + a21 b1 - a11 b2) / (s^2 - tr s + det)
    determinant, trace = np.linalg.det(A), np.trace(A)
    numerator = A[1, 0] * B[0, 0] - A[0, 0] * B[1, 0]
    T3, total = B[1, 0] / numerator, -trace / determinant
    T1, T2 = sorted((-1.0 / np.linalg.eigvals(A)).tolist(), key=abs, reverse=True)
    unit = ship.length / ship.speed
    return Nomoto(
        float(numerator / determinant * unit),
        float((total - T3) / unit),
        T1 / unit,
        T2 / unit,
        float(T3 / unit),
    )
