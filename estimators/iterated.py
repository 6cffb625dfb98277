"""The iterated extended Kalman filter: a measurement linearised where the estimate will be."""

from typing import Any

import numpy as np

from estimators.angles import difference
from estimators.checks import integer, number
from estimators.filter import Changes, Model
from estimators.kalman import ExtendedKalmanFilter
from estimators.linalg import solve
from estimators.models import LinearModel


class IteratedExtendedKalmanFilter(ExtendedKalmanFilter):
    """An `ekf` whose update is the most probable state, given prediction and measurement.

    That state minimises, with ``P = P-``::

        V(x) = (y - h(x))' R^-1 (y - h(x)) / 2 + (x - x-)' P^-1 (x - x-) / 2

    and is found by the Gauss-Newton method. The measurement is linearised at the latest estimate,
    not at the prediction, until the estimate stops moving. Written as ``x = x- + P a``, a step
    inverts only S::

        a <- a + t (C' S^-1 [y - h(x) + C P a] - a)
        C = dh/dx at x      S = C P C' + R

    Each step begins with the step length t = 1. If it would raise V, it is tried again with half of
    t. After the last step the update is that of the `ekf`, with C at the last x and the innovation
    ``y - h(x) - C (x- - x)``. So the belief's innovation and its covariance give the density of the
    measurement to second order about the estimate (Laplace's method). One iteration gives the
    `ekf`, and so does any number of iterations on a linear model.

    Sources: Bell & Cathey (1993), The iterated Kalman filter update as a Gauss-Newton method;
    Skoglund, Hendeby & Axehill (2015), Extended Kalman filter modifications based on an
    optimization view point, for the step lengths.

    Args:
        model: A `LinearModel` or a `NonlinearModel`.
        iterations: Largest number of times that the measurement is linearised.
        tolerance: A row of a batch stops when its step for t = 1 is shorter than this many standard
            deviations of the prediction.

    Raises:
        ValueError: if ``iterations`` is below 1 or ``tolerance`` is not positive.
    """

    name = "iekf"
    reversible = True

    def __init__(self, model: Model, iterations: int = 20, tolerance: float = 1e-6) -> None:
        super().__init__(model)
        self.iterations = integer("iterations", iterations, 1)
        self.tolerance = number("tolerance", tolerance, 0.0, what="positive")

    def _update(
        self, belief: Any, u: Any, e: Any, C: Any, R: Any, available: Any, *_: Any
    ) -> Changes:
        if not isinstance(self.model, LinearModel):
            e, C = self._most_probable(belief, u, e, C, R, available)
        return super()._update(belief, u, e, C, R, available) | {"innovation": e}

    def _most_probable(
        self, belief: Any, u: Any, e: Any, C: Any, R: Any, available: Any
    ) -> tuple[np.ndarray, np.ndarray]:
        """Innovation and C of the measurement linearised at the most probable state."""
        cov, a, length = belief.cov, np.zeros(belief.mean.shape), np.ones(belief.mean.shape[:-1])
        y, shift, cost = self.expect(belief, u, R)[0] + e, a, _cost(e, R, a, a)
        running = np.ones(length.shape, bool)
        for _ in range(self.iterations - 1):
            straight = e + np.matvec(C, shift)
            S = C @ cov @ C.mT + R
            step = np.vecmat(solve(S, straight[..., None])[..., 0], C) - a
            running = running & (np.vecdot(step, np.matvec(cov, step)) > self.tolerance**2)
            if not running.any():
                break
            a_tried = a + length[..., None] * step
            tried = np.matvec(cov, a_tried)
            h, C_tried, _ = self.expect(belief.replaced({"mean": belief.mean + tried}), u, R)
            e_tried = difference(y, h, self.model.measurement_angles)
            e_tried = np.where(available, e_tried, 0.0)
            C_tried = np.where(available[..., None], C_tried, 0.0)
            cost_tried = _cost(e_tried, R, a_tried, tried)
            finite = np.isfinite(e_tried).all(-1) & np.isfinite(C_tried).all((-2, -1))
            # With a singular R the cost is NaN, and every step is taken whole.
            taken = running & finite & ~(cost_tried > cost)
            length, cost = np.where(taken, 1.0, 0.5 * length), np.where(taken, cost_tried, cost)
            row = taken[..., None]
            a, shift = np.where(row, a_tried, a), np.where(row, tried, shift)
            e, C = np.where(row, e_tried, e), np.where(row[..., None], C_tried, C)
        return e + np.matvec(C, shift), C


def _cost(e: np.ndarray, R: np.ndarray, a: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """``2 V (...)`` at ``x- + shift``, ``shift = P a``; not a number where R is singular."""
    return np.vecdot(e, solve(R, e[..., None])[..., 0]) + np.vecdot(a, shift)
