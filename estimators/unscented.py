"""Unscented filters: sigma points in place of Jacobians."""

from typing import Any

import numpy as np

from estimators.angles import difference
from estimators.checks import number
from estimators.engine import compiled
from estimators.filter import Changes, Filter, Model
from estimators.kalman import ExtendedKalmanFilter
from estimators.linalg import (
    congruence,
    diagonal,
    identity,
    semidefinite_cholesky,
    solve_upper,
    symmetrise,
)
from estimators.models import LinearModel, at_columns
from estimators.unknown_input import NoFeedthroughFilter


class SigmaPoints(Filter[Any]):
    """Mix-in of the unscented filters: sigma points in place of the linearisation of `Filter`.

    A function f of x ~ N(x^, P), ``P = L L'``, is evaluated at the 2 n + 1 points ``x^`` and ``x^
    +- c L_i``, ``c = alpha sqrt(n + kappa)``. Its values are ``f0`` at ``x^``, and ``f+`` and
    ``f-`` at the two points of each i; their angles are wrapped about ``f0``. With ``a_i = (f+ -
    f-) / 2c``, ``s_i = (f+ + f- - 2 f0) / 2c^2`` and ``m = sum s_i`` the scaled transform is::

        mean f0 + m      cross-covariance L [a_i]'
        cov  sum a_i a_i' + c^2 sum s_i s_i' + (beta - alpha^2) m m'

    This is the weighted sum over the points, without the cancellation of its large weights of
    opposite sign. ``cov`` is positive semidefinite if ``beta >= -alpha^2 kappa / n``. A linear
    model needs no points: the transform is exact.

    The measurement is linearised statistically: ``C = Pxy' (P-)^-1 = [a_i] L^-1``, and the rest of
    the covariance, ``Pyy - C P- C'``, is added to R. A Kalman update in Joseph form with this C and
    R is the unscented update.
    """

    def _set_points(self, alpha: float, beta: float, kappa: float) -> None:
        """Check and keep the options of the transform."""
        alpha = number(
            "alpha", alpha, 0.0, what="positive (the points' distance in standard deviations)"
        )
        kappa = number("kappa", kappa, -self.model.n, what=f"above -n = {-self.model.n}")
        beta = number("beta", beta, what="a finite number")
        lowest = 0.0 - alpha**2 * kappa / self.model.n
        if not lowest <= beta:
            raise ValueError(
                f"beta must be at least -alpha^2 kappa / n = {lowest:g} for variances to be, got"
                f" {beta}"
            )
        self.alpha, self.beta, self.kappa = alpha, beta, kappa
        self._c2 = alpha**2 * (self.model.n + kappa)

    def propagate(self, belief: Any, u: np.ndarray | None) -> tuple[Any, ...]:
        """Next mean ``(..., n)`` and covariance without process noise, and Q."""
        if isinstance(self.model, LinearModel):
            mean, A, Q = super().propagate(belief, u)
            return mean, congruence(A, belief.cov), Q
        points, _ = self._spread(belief)
        mean, slopes, excess = self._transform("transition", points, u)
        return mean, slopes.mT @ slopes + excess, self._process_noise(belief, u)

    def expect(self, belief: Any, u: np.ndarray | None, R: Any = None) -> tuple[Any, ...]:
        """Expected measurement, its statistical linearisation C, and R with what C leaves out."""
        if isinstance(self.model, LinearModel):
            return super().expect(belief, u, R)
        mean, C, excess = self._linearised("measurement", belief, u)
        # A variance that is not finite marks a missing measurement; here points left h's domain.
        return mean, C, self._noise(belief, u, R) + np.where(np.isfinite(excess), excess, 0.0)

    def _slopes(self, belief: Any, u: np.ndarray | None) -> np.ndarray:
        if isinstance(self.model, LinearModel):
            return super()._slopes(belief, u)
        return self._linearised("transition", belief, u)[1]

    def _linearised(self, name: str, belief: Any, u: Any) -> tuple[Any, Any, Any]:
        """The transform of a function of the model: mean, statistical linearisation, and excess."""
        points, root = self._spread(belief, invertible=True)
        mean, slopes, excess = self._transform(name, points, u)
        return mean, solve_upper(root.mT, slopes).mT, excess

    def _spread(self, belief: Any, invertible: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """The points ``(..., 2 n + 1, n)``, and the root of the covariance along which they lie.

        An invertible root has a small step where the belief has no spread: slopes are derivatives.
        """
        root = semidefinite_cholesky(belief.cov)
        if invertible:
            flat = ~(np.abs(diagonal(root)) > 0.0)
            step = np.maximum(2.0**-26 * np.abs(belief.mean), 2.0**-10)
            root = root + np.where(flat, step, 0.0)[..., None] * identity(self.model.n)
        centre, offsets = belief.mean[..., None, :], np.sqrt(self._c2) * root.mT
        points = [centre + 0.0 * offsets[..., :1, :], centre + offsets, centre - offsets]
        return np.concatenate(points, axis=-2), root

    def _transform(
        self, name: str, points: np.ndarray, u: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The unscented transform of a function of the model.

        Returns:
            The mean ``(..., k)``, the slopes ``a (..., n, k)`` along the columns of the root, and
            the part of the covariance ``(..., k, k)`` beyond ``a' a``.
        """
        model, n, c2 = self.model, self.model.n, self._c2
        values = at_columns(model, name, points.mT, u).mT
        angles = model.state_angles if name == "transition" else model.measurement_angles
        centre = values[..., 0, :]
        apart = difference(values[..., 1:, :], centre[..., None, :], angles)
        above, below = apart[..., :n, :], apart[..., n:, :]
        slopes = (above - below) / (2.0 * np.sqrt(c2))
        bends = (above + below) / (2.0 * c2)
        shift = bends.sum(-2)
        weight = self.beta - self.alpha**2
        excess = c2 * (bends.mT @ bends) + weight * shift[..., :, None] * shift[..., None, :]
        return centre + shift, slopes, excess


@compiled
class UnscentedKalmanFilter(SigmaPoints, ExtendedKalmanFilter):
    """UKF: a Kalman filter of moments from sigma points; exact on a linear model.

    Needs no Jacobian and keeps second-order terms: with the defaults the mean is right to third
    order for a Gaussian. An unknown input in the model is ignored.

    Sources: Julier & Uhlmann (2004), Unscented filtering and nonlinear estimation; van der Merwe
    (2004), scaled points; Lefebvre, Bruyninckx & De Schutter (2002), the statistical linearisation
    behind them.

    Args:
        model: A `LinearModel` or a `NonlinearModel`.
        alpha: Distance of the points, which is alpha times ``sqrt(n + kappa)`` standard deviations.
            A small alpha nearly gives the Jacobian; 1 covers the spread of the belief.
        beta: Weight of the central point in the covariance; 2 is best for a Gaussian.
        kappa: Above -n; ``3 - n`` matches a Gaussian's fourth moment along each axis.

    Raises:
        ValueError: if ``alpha``, ``beta`` and ``kappa`` could give negative variances.
    """

    name = "ukf"
    reversible = True

    def __init__(
        self, model: Model, alpha: float = 1.0, beta: float = 2.0, kappa: float = 0.0
    ) -> None:
        super().__init__(model)
        self._set_points(alpha, beta, kappa)

    def _predict(self, belief: Any, u: Any, mean: Any, cov: Any, Q: Any, *_: Any) -> Changes:
        return {"mean": mean, "cov": symmetrise(cov + Q)}


@compiled
class UnscentedUMVFilter(SigmaPoints, NoFeedthroughFilter):
    """UKF-UMV: `ekf-ui-wdf` with sigma points in place of Jacobians; the input shows one step late.

    With ``C = Pxy' (P-)^-1`` and ``K = Pxy Pyy^-1``, where Pyy includes R::

        F = C G      M = (F' Pyy^-1 F)^-1 F' Pyy^-1      d(k-1) = M e
        x = x- + (K + (I - K C) G M) e

    The covariance is that of `ekf-ui-wdf`, with ``Pyy - C P- C'`` in place of R.

    The points lie about a prediction without d(k-1). So the estimate of an input that moves the
    state beyond the spread of ``P-`` within one step uses the wrong C.

    Source: Zheng et al. (2019), unscented Kalman filter with unknown input, unbiased and of minimum
    variance.

    Args:
        model: A model with H = 0 and rank(C G) = q; a nonlinear one may give G as a function of
            ``(x, u)``.
        input_prior: Covariance ``(q, q)`` of the unknown input where a measurement hardly shows it;
            a number stands for that number times identity.
        alpha: Spread of the sigma points, as in `UnscentedKalmanFilter`.
        beta: Weight of the central point in the covariance.
        kappa: Spread of the sigma points, above -n.

    Raises:
        ValueError: if H feeds d(k) through, if the rank condition cannot hold, or if a variance
            could become negative.
    """

    name = "ukf-umv"
    reversible = True

    def __init__(
        self,
        model: Model,
        input_prior: np.ndarray | float = 1.0,
        alpha: float = 1.0,
        beta: float = 2.0,
        kappa: float = 0.0,
    ) -> None:
        super().__init__(model, input_prior)
        self._set_points(alpha, beta, kappa)

    def propagate(self, belief: Any, u: np.ndarray | None) -> tuple[Any, ...]:
        """Next mean; P, which includes the effect of an input not measured so far; and Q."""
        return super().propagate(belief.replaced({"cov": self._covariance(belief)}), u)

    def _predict(self, belief: Any, u: Any, mean: Any, cov: Any, Q: Any, *more: Any) -> Changes:
        predicted = super()._predict(belief, u, mean, identity(self.model.n), Q, *more)
        return predicted | {"cov": symmetrise(cov + Q)}
