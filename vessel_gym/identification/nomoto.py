"""Nomoto's models of the yaw rate, first and second order, as rivals of the manoeuvring model.

First order: ``T r' + r = K (d + d0)``. Second order: ``T1 T2 r'' + (T1 + T2) r' + r = K (d + d0 + T3 d')``.
Source: Nomoto, Taguchi, Honda & Hirano (1957), Int. Shipbuilding Progress 4; Fossen (2011), sec. 7.2.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vessel_gym.identification.prediction import windows
from vessel_gym.identification.trial import Trial


@dataclass(frozen=True)
class Nomoto:
    """A Nomoto model.

    Attributes:
        K: Gain [1/s].
        times: Time constants [s]: ``(T,)``, or ``(T1, T2, T3)``.
        offset: Rudder angle that is not recorded [rad].
    """

    K: float
    times: tuple[float, ...]
    offset: float

    def yaw_rate(self, start: np.ndarray, rudder: np.ndarray, dt: float) -> np.ndarray:
        """Yaw rates ``(T + 1, ...)`` [rad/s] from ``start (...)`` under ``rudder (T, ...)``, exactly for held rudders.

        The second order is two first orders in a row, of which the second passes the share ``T3 / T2`` on at once; it
        begins as it would in a steady turn.
        """
        rates, lagged = [start], start
        first, *others = self.times
        slow = np.exp(-dt / first)
        fast, direct = (np.exp(-dt / others[0]), others[1] / others[0]) if others else (0.0, 1.0)
        passed = start.copy()
        for angle in rudder:
            lagged = slow * lagged + (1.0 - slow) * self.K * (angle + self.offset)
            passed = fast * passed + (1.0 - fast) * lagged
            rates.append(direct * lagged + (1.0 - direct) * passed)
        return np.stack(rates)


def identify_nomoto(trials: Sequence[Trial], length: float, order: int = 1) -> Nomoto:
    """The Nomoto model with the least simulation error of the yaw rate over windows.

    Args:
        trials: At least one that is longer than a window.
        length: Of the windows [s].
        order: 1 or 2.

    Raises:
        ValueError: if every trial is shorter than a window.
    """
    from scipy.optimize import least_squares

    dt = trials[0].dt
    each = windows(trials, max(2, round(length / dt)), 1)
    if each is None:
        raise ValueError(f"the logs are shorter than {length:.3g} s, a window of identification")
    measured, rudder = each.states[..., 5], each.control[..., 0]

    def model(x: np.ndarray) -> Nomoto:
        return Nomoto(float(x[0]), tuple(float(each) for each in np.exp(x[2:])), float(x[1]))

    def errors(x: np.ndarray) -> np.ndarray:
        return (model(x).yaw_rate(measured[0], rudder, dt) - measured)[1:].ravel()

    start = np.array([0.1, 0.0, np.log(0.2 * length), np.log(0.02 * length), np.log(0.02 * length)])[: 2 * order + 1]
    return model(least_squares(errors, start, x_scale=[0.01, 0.01, *(0.1,) * (2 * order - 1)]).x)
