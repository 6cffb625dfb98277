"""The experiment of A. E. Hermawan's thesis (ITS Surabaya, 2020): eqs. 4.3 to 4.6 and its five simulations.

A linear ship of three states (sway, yaw rate, heading) turns under a constant rudder while a deterministic step d, the
unknown input, enters both measurements ``(psi + d, d)``. There is no sea. The thesis compares the estimates with a
heading that was recorded in a turning circle trial.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from estimators import LinearModel
from vessel_gym.vehicles.corvette import AS_PRINTED

SAMPLES = 195
"""Samples of the record, Section 4.5."""
RUDDER = np.deg2rad(35.0)
"""Constant rudder angle u [rad], Section 4.3.1."""


@dataclass(frozen=True)
class Simulation:
    """One of the five simulations of Section 4.5.

    Attributes:
        Q: Process noise variance that the filter assumes, times identity.
        R: Measurement noise variance that it assumes, times identity.
        size: Height of the step d [rad]: up by ``size``, then down to ``-size``.
    """

    Q: float
    R: float
    size: float


SIMULATIONS = {
    "I": Simulation(1e-3, 1e-3, 0.01),
    "II": Simulation(1.0, 1e-3, 0.01),
    "III": Simulation(1e-3, 1.0, 0.01),
    "IV": Simulation(1.0, 1.0, 0.01),
    "V": Simulation(1e-3, 1e-3, 0.1),
}
"""Simulations by number. V prints 0.1 and 0.2, and calls them larger than the 1 and 2 of I to IV: read as 0.01."""
A, B = AS_PRINTED[0], AS_PRINTED[1][:, :1]
"""Eq. 4.3 to the digit, B of the rudder [rad]."""
C, G, H = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]), np.array([[0.0], [0.0], [1.0]]), np.ones((2, 1))
"""Matrices of the measurement and of d, eqs. 4.4 and 4.5."""


def unknown_input(size: float, switch: int, samples: int = SAMPLES) -> np.ndarray:
    """The step d ``(samples,)`` [rad]: ``size`` before sample ``switch``, ``-size`` from it on."""
    return np.where(np.arange(samples) < switch, size, -size)


def measurements(heading: np.ndarray, d: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Measurements ``(psi + d, d) + noise`` of eq. 4.5, ``(..., 2)`` [rad]."""
    return np.stack(np.broadcast_arrays(heading + d, d), -1) + noise


def filter_model(simulation: Simulation, A: Any = A, B: Any = B) -> LinearModel:
    """The filter's model of eqs. 4.4 and 4.5 with the stated Q and R; A and B of eq. 4.3 unless given."""
    # The thesis wraps no angle, and its record stays below 7 rad.
    return LinearModel(A, C, simulation.Q * np.eye(3), simulation.R * np.eye(2), B=B, G=G, H=H)
