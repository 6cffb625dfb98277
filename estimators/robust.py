"""Robust filters: one for measurements with outliers, one for a model that is not quite right."""

from typing import Any, ClassVar

import numpy as np

from estimators.checks import AT_LEAST_0, integer, number
from estimators.engine import compiled
from estimators.filter import Changes, Model
from estimators.kalman import ExtendedKalmanFilter, joseph_update
from estimators.linalg import (
    joined,
    principal_root,
    regular,
    semidefinite_cholesky,
    solve,
    solve_lower,
    symmetrise,
)
from estimators.tunable import Log


@compiled
class HuberKalmanFilter(ExtendedKalmanFilter):
    """A Kalman filter whose update minimises Huber's loss: for measurements with outliers.

    The whitened residuals of the measurement and of the prediction, ``zeta = [R^-1/2 (y - h(x));
    (P-)^-1/2 (x- - x)]`` with Cholesky roots, enter the loss quadratically up to ``gamma`` and
    linearly beyond. With ``psi = min(1, gamma / |zeta|)`` a Kalman update is done with::

        R~ = R^1/2 diag(psi_y)^-1 R^T/2
        P~ = (P-)^1/2 diag(psi_x)^-1 (P-)^T/2

    and the residuals are computed again, which lowers the loss each time. The first weights are
    those of the residuals at the prediction, so that an outlier loses weight before it moves the
    estimate. The posterior covariance is that of the last update, ``(P~^-1 + C' R~^-1 C)^-1``, so
    it grows with an outlier. Where every ``|zeta|`` is below ``gamma`` the update is the Kalman
    filter's. A nonlinear model is linearised at the prediction.

    P- and R need only be positive semidefinite: with ``M = [C (P-)^1/2, R^1/2]`` and ``S~ = M
    diag(psi)^-1 M'``, the absolute residuals are those of ``psi^-1 M' S~^-1 e``, the prediction's
    first.

    Few iterations are better than many. At the minimum of the loss, measurement or prediction
    loses weight, whichever has the larger variance. An outlier enlarges P, so at the next outlier
    the prediction loses weight (``docs/estimators/robust.md``).

    Sources: Huber (1964), Robust estimation of a location parameter; Karlgaard & Schaub (2007),
    Huber-based divided difference filtering, who start from least squares instead of the
    prediction.

    Args:
        model: A `LinearModel` or a `NonlinearModel`.
        gamma: Residual, in standard deviations, beyond which the loss is linear. 1.345 keeps 95 %
            of the efficiency of least squares on Gaussian noise; infinity gives the Kalman filter.
        iterations: Number of times that the weights are computed.

    Raises:
        ValueError: if ``gamma`` is not positive or ``iterations`` is below 1.
    """

    name = "huber-kf"
    tunable: ClassVar = {"gamma": Log(0.3, 10.0)}

    def __init__(self, model: Model, gamma: float = 1.345, iterations: int = 2) -> None:
        super().__init__(model)
        if not isinstance(gamma, float) or gamma != np.inf:
            gamma = number("gamma", gamma, 0.0, what="positive (standard deviations)")
        self.gamma, self.iterations = gamma, integer("iterations", iterations, 1)

    def _update(
        self, belief: Any, u: Any, e: Any, C: Any, R: Any, available: Any, *_: Any
    ) -> Changes:
        n, gamma = self.model.n, self._option("gamma", belief)
        root_P, root_R = semidefinite_cholesky(belief.cov), semidefinite_cholesky(R)
        M = joined([C @ root_P, root_R], -1)
        S = M @ M.mT
        seen = _inflation(solve_lower(regular(root_R), e[..., None])[..., 0], gamma)
        inflation = np.concatenate([np.ones(belief.mean.shape), seen], -1)
        for _repeat in range(self.iterations - 1):
            S_weighted = S + (M * (inflation - 1.0)[..., None, :]) @ M.mT
            solved = solve(S_weighted, e[..., None])[..., 0]
            inflation = _inflation(inflation * np.matvec(M.mT, solved), gamma)
        # `inflation` is 1 / psi of the last update.
        P = _reweighted(belief.cov, root_P, inflation[..., :n])
        noise = _reweighted(R, root_R, inflation[..., n:])
        mean, cov, _weighted = joseph_update(belief.mean, P, e, C, noise)
        return {"mean": mean, "cov": cov, "innovation_cov": S}


def _inflation(zeta: np.ndarray, gamma: Any) -> np.ndarray:
    """``1 / psi (..., k)`` of residuals."""
    return np.maximum(1.0, np.abs(zeta) / gamma)


def _reweighted(cov: np.ndarray, root: np.ndarray, inflation: np.ndarray) -> np.ndarray:
    """``L diag(inflation) L'`` for ``cov = L L'``: exactly ``cov`` where nothing is inflated."""
    return cov + (root * (inflation - 1.0)[..., None, :]) @ root.mT


@compiled
class RobustKalmanFilter(ExtendedKalmanFilter):
    """Minimax filter for a model that is only known within a relative-entropy ball.

    At each step nature may replace the joint density of the next state and the measurement by any
    other within relative entropy ``radius / 2`` of the model's. Against the worst choice the best
    estimate is a Kalman filter that replaces the prediction covariance ``P = A P+ A' + Q`` by V::

        V = (I - theta P)^-1 P
        sum_i [x_i / (1 - x_i) + log(1 - x_i)] = radius    x_i = theta l_i < 1

    with the eigenvalues ``l_i`` of P. This least-favourable V is the covariance of the predicted
    belief. It is too large where the model is true, by design. ``radius = 0`` gives the Kalman
    filter exactly. With a nonlinear model the filter is the robust EKF, linearised at the mean. The
    worst choice depends on the units of the states, so scale them such that errors of 1 are equally
    bad.

    Sources: Levy & Nikoukhah (2013), Robust state space filtering under incremental model
    perturbations subject to a relative entropy tolerance; Zorzi (2017), Robust Kalman filtering
    under model perturbations, tau = 0, whose c is ``radius``. Levy and Nikoukhah's c, the relative
    entropy itself, is half of it.

    Args:
        model: A `LinearModel` or a `NonlinearModel`.
        radius: Zorzi's tolerance c: twice the relative entropy allowed at each step, not negative.

    Raises:
        ValueError: if ``radius`` is negative or not finite.
    """

    name = "robust-kf"
    reversible = True
    tunable: ClassVar = {"radius": Log(1e-9, 1.0)}

    def __init__(self, model: Model, radius: float = 0.01) -> None:
        super().__init__(model)
        self.radius = number("radius", radius, AT_LEAST_0, what="finite and not negative")

    def _predict(self, belief: Any, u: Any, mean: Any, A: Any, Q: Any, *_: Any) -> Changes:
        predicted = super()._predict(belief, u, mean, A, Q)
        if self.radius > 0.0:
            radius = self._option("radius", belief)
            predicted["cov"] = least_favourable_covariance(predicted["cov"], radius)
        return predicted


def least_favourable_covariance(cov: np.ndarray, radius: Any) -> np.ndarray:
    """``V = (I - theta P)^-1 P``, the largest covariance within relative entropy ``radius / 2``.

    Args:
        cov: ``(..., n, n)`` P, positive semidefinite; a row that is not finite is returned as it
            is.
        radius: Twice the relative entropy, positive: a number, or ``(..., 1)`` of each row.

    Returns:
        ``(..., n, n)`` V, with KL(N(0, V) || N(0, P)) = radius / 2.
    """
    finite = np.isfinite(cov)
    root = principal_root(np.where(finite, cov, 0.0))
    V = cov + symmetrise(
        (root * _entropy_odds(np.square(root).sum(-2), radius)[..., None, :]) @ root.mT
    )
    return np.where(finite, V, cov)


def _entropy_odds(values: np.ndarray, radius: Any) -> np.ndarray:
    """``o_i = x_i / (1 - x_i)``, ``x_i = theta l_i``, with ``sum_i [o_i - log(1 + o_i)] = radius``.

    Newton's method in ``t = 1 - theta l_max``. The sum is convex and decreasing in t, so from a t
    that is too small the iterates rise to the root and never pass it. Such a start is known: ``o -
    log(1 + o) >= radius`` for the largest alone if ``o = radius + sqrt(2 radius)``. It costs a
    fifth of bisection to the same accuracy.

    Args:
        values: ``(..., n)`` eigenvalues, not negative.
        radius: Positive number, or ``(..., 1)`` of each row.
    """
    largest = values.max(-1)[..., None]
    ratio = np.where(values < largest, values / np.where(largest > 0.0, largest, 1.0), 1.0)
    rest = 1.0 - ratio
    start = np.minimum(1.0 / (1.0 + radius + np.sqrt(2.0 * radius)), _BELOW_ONE)
    t = start + 0.0 * largest
    for _ in range(_NEWTON_STEPS):
        left = rest + ratio * t  # 1 - x, without cancellation near x = 1
        odds = ratio * (1.0 - t) / left
        excess = _odds_entropy(odds).sum(-1)[..., None] - radius
        slope = (odds * ratio / left).sum(-1)[..., None]
        t = np.minimum(np.maximum(t + excess / slope, start), _BELOW_ONE)
    return ratio * (1.0 - t) / (rest + ratio * t)


_NEWTON_STEPS = 10
_BELOW_ONE = np.nextafter(1.0, 0.0)


def _odds_entropy(odds: np.ndarray) -> np.ndarray:
    """``o - log(1 + o)``, by its series where the difference would cancel."""
    series = odds * odds * (1.0 / 2.0 - odds * (1.0 / 3.0 - odds * (1.0 / 4.0 - odds / 5.0)))
    return np.where(odds < 1e-3, series, odds - np.log1p(odds))
