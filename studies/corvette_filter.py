"""The extended Kalman filter of a corvette in plain NumPy, for studies that compare libraries.

The state is position north, east [m], heading [rad], surge, sway [m/s], yaw rate [rad/s] and
current north, east [m/s]. Compass, rate gyro and two coordinates of a receiver are measured.
Equations of motion: `vessel_gym.vehicles.corvette_equations`. Update: Joseph's form.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

import numpy as np

from vessel_gym.vehicles import corvette_equations
from vessel_gym.vehicles.files import load

STATES, SEEN, DT = 8, np.array([2, 5, 0, 1]), 0.5
"""Number of states, measured states, and step [s]."""
Q = np.diag([0.04, 0.04, 1e-8, 9e-4, 1.6e-3, 3.6e-7, 6.4e-4, 6.4e-4])
R = np.array([4e-6, 4e-6, 4.0, 4.0])
"""Covariance of process noise, and variances of the sensors."""
START = np.array([300.0, 50.0, 0.2, 15.0, -0.5, 0.01, -0.1, 0.1])
SPREAD = np.array([1.0, 1.0, 1e-3, 0.1, 0.1, 1e-3, 0.15, 0.13])
"""A state in a turn, and the standard deviations of an estimate."""
OUTPUTS = STATES + STATES**2
INPUTS = OUTPUTS + 1 + 2 * len(SEEN)
"""Mean and covariance of a row; and with rudder, measurements and mask, one after the other."""
_SHIP = load("corvette").vector()


@contextmanager
def own_sine() -> Iterator[None]:
    """Context in which the equations take NumPy's sine, or a library's, and not our engine's."""
    with patch.object(corvette_equations, "sincos", lambda angle: (np.sin(angle), np.cos(angle))):
        yield


def rates(x: np.ndarray, rudder: np.ndarray) -> np.ndarray:
    """Rates ``(..., 8)`` of the state of a ship that does not roll; the current decays."""
    calm = np.zeros((*x.shape[:-1], 5))
    whole = np.concatenate([x[..., :6], calm[..., :2]], -1)
    around = np.concatenate([x[..., 6:], calm], -1)
    moved = corvette_equations.corvette_rates.function(whole, rudder, around, _SHIP)
    return np.concatenate([moved[..., :6], -0.01 * x[..., 6:]], -1)


def transition(x: Any, rudder: Any) -> Any:
    """State ``(..., 8)`` after a step by the classical Runge-Kutta method."""
    k1 = rates(x, rudder)
    k2 = rates(x + 0.5 * DT * k1, rudder)
    k3 = rates(x + 0.5 * DT * k2, rudder)
    k4 = rates(x + DT * k3, rudder)
    return x + DT / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


def ekf_step(row: Any, linearise: Callable[..., Any], xp: Any = np) -> Any:
    """Mean and covariance ``(72,)`` after prediction and update, one sensor after the other.

    Args:
        row: ``(81,)``, see `INPUTS`. The mask is 1 where a sensor has measured, otherwise 0.
        linearise: ``linearise(transition, x, rudder)`` returns the value and its Jacobian by x.
        xp: NumPy, or a module with its functions.
    """
    end = OUTPUTS
    cov, rudder = row[STATES:end].reshape(STATES, STATES), row[end : end + 1]
    x, A = linearise(transition, row[:STATES], rudder)
    P = A @ cov @ A.T + Q
    for sensor, state in enumerate(SEEN):
        y, available = row[end + 1 + sensor], row[end + 5 + sensor]
        e = y - x[state]
        if state == 2:  # the difference of two headings is at most half a turn
            e = xp.where(e > np.pi, e - 2.0 * np.pi, xp.where(e < -np.pi, e + 2.0 * np.pi, e))
        PC = P[:, state] * available
        noise = R[sensor] * available + (1.0 - available)
        K = PC / (PC[state] * available + noise)
        x = x + K * (available * e)
        P = P - K[:, None] * PC
        P = P - (P[:, state] * available)[:, None] * K + (K * noise)[:, None] * K
    P = 0.5 * (P + P.T)
    return xp.concatenate([x, P.reshape(STATES**2)])


def random_inputs(rows: int) -> np.ndarray:
    """Inputs ``(rows, 81)`` of steps in a turn; every other row lacks the receiver."""
    rng = np.random.default_rng(0)
    mean = START + SPREAD * rng.normal(size=(rows, STATES))
    correlations = 0.8 * np.eye(STATES) + 0.2
    cov = rng.uniform(0.5, 2.0, (rows, 1, 1)) * correlations * np.outer(SPREAD, SPREAD)
    y = mean[:, SEEN] + 3.0 * np.sqrt(R) * rng.normal(size=(rows, len(SEEN)))
    available = np.ones_like(y)
    available[1::2, 2:] = 0.0
    rudder = rng.uniform(-0.3, 0.3, (rows, 1))
    return np.hstack([mean, cov.reshape(rows, -1), rudder, y, available])
