"""The iterated extended Kalman filter: a measurement linearised where the estimate will be."""

import numpy as np

from estimators.belief import Belief
from estimators.checks import integer, number
from estimators.filter import Model
from estimators.kalman import GaussianFilter
from estimators.linalg import solve
from estimators.measurement import Measurement
from estimators.models import LinearModel


class IteratedExtendedKalmanFilter(GaussianFilter[Belief], verified=True):
    """An `ekf` whose update is the most probable state, given the prediction as a Gaussian and the measurement.

    That state minimises, with ``P = P-``::

        V(x) = (y - h(x))' R^-1 (y - h(x)) / 2 + (x - x-)' P^-1 (x - x-) / 2

    and is found by Gauss and Newton's method: the measurement is linearised at the last estimate,
    not at the prediction, until that moves it no more. Written as ``x = x- + P a`` nothing is
    inverted but S::

        a <- a + t (C' S^-1 [y - h(x) + C P a] - a)      C = dh/dx at x      S = C P C' + R

    t is 1, and half of it after each step by which V would have risen. The update is then that of
    the `ekf`, with C and the innovation ``y - h(x) - C (x- - x)`` of the last x. So the belief's
    innovation and its covariance give the density of the measurement to second order about the
    estimate (Laplace's method). One iteration is the `ekf`, and so is any number on a linear model.

    Sources: Bell & Cathey (1993), The iterated Kalman filter update as a Gauss-Newton method;
    Skoglund, Hendeby & Axehill (2015), Extended Kalman filter modifications based on an
    optimization view point, for the shorter steps.

    Args:
        model: A `LinearModel` or a `NonlinearModel`.
        iterations: Largest number of times that the measurement is linearised.
        tolerance: A row stops when a whole step is shorter than this many standard deviations of
            the prediction.

    Raises:
        ValueError: if ``iterations`` is below 1 or ``tolerance`` is not positive.
    """

    name = "iekf"
    formulas = False  # how often a function is asked follows from its answers

    def __init__(self, model: Model, iterations: int = 20, tolerance: float = 1e-6) -> None:
        super().__init__(model)
        self.iterations = integer("iterations", iterations, 1)
        self.tolerance = number("tolerance", tolerance, 0.0, what="positive")

    def _measurement(
        self, belief: Belief, y: np.ndarray, available: np.ndarray | None, R: np.ndarray | None
    ) -> Measurement:
        best = super()._measurement(belief, y, available, R)
        if isinstance(self.model, LinearModel):
            return best
        cov, a, length = belief.cov, np.zeros(belief.mean.shape), np.ones(belief.mean.shape[:-1])
        shift, cost = np.zeros(belief.mean.shape), _cost(best, a, a)
        running = np.ones(length.shape, bool)
        for _ in range(self.iterations - 1):
            straight = best.innovation + np.matvec(best.C, shift)
            S = best.C @ cov @ best.C.mT + best.R
            step = np.vecmat(solve(S, straight[..., None])[..., 0], best.C) - a
            running = running & (np.vecdot(step, np.matvec(cov, step)) > self.tolerance**2)
            if not running.any():
                break
            a_tried = a + length[..., None] * step
            tried = np.matvec(cov, a_tried)
            measurement = super()._measurement(
                belief.replace(mean=belief.mean + tried), y, available, R
            )
            cost_tried = _cost(measurement, a_tried, tried)
            known = np.isfinite(measurement.innovation).all(-1) & np.isfinite(measurement.C).all(
                (-2, -1)
            )
            taken = (
                running & known & ~(cost_tried > cost)
            )  # a measurement without noise has no cost, and whole steps
            length = np.where(taken, 1.0, 0.5 * length)
            a, shift = (
                np.where(taken[..., None], new, old) for new, old in ((a_tried, a), (tried, shift))
            )
            cost = np.where(taken, cost_tried, cost)
            best = best._replace(
                innovation=np.where(taken[..., None], measurement.innovation, best.innovation),
                C=np.where(taken[..., None, None], measurement.C, best.C),
            )
        return best._replace(innovation=best.innovation + np.matvec(best.C, shift))


def _cost(measurement: Measurement, a: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """``2 V (...)`` at ``x- + shift``, ``shift = P a``; not a number where R is singular."""
    e = measurement.innovation
    return np.vecdot(e, solve(measurement.R, e[..., None])[..., 0]) + np.vecdot(a, shift)
