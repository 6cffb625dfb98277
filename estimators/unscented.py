"""Unscented filters: sigma points in place of Jacobians."""

from typing import cast

import numpy as np

from estimators.angles import difference
from estimators.belief import Belief, DelayedInputBelief, Record
from estimators.checks import number
from estimators.engine.matrices import is_traced
from estimators.filter import Filter, Model, inlinable
from estimators.kalman import GaussianFilter
from estimators.linalg import semidefinite_cholesky, solve_upper
from estimators.models import LinearModel, NonlinearModel, at_columns, at_points
from estimators.unknown_input import NoFeedthroughFilter


class SigmaPoints(Filter[Record], verified=True):
    """Sigma points in place of the linearisation of `Filter`: a mix-in of the unscented filters.

    A function f of x ~ N(x^, P), ``P = L L'``, is evaluated at the 2 n + 1 points ``x^`` and ``x^
    +- c L_i``, ``c = alpha sqrt(n + kappa)``. With ``f+-`` about the central ``f0 = f(x^)`` (angles
    wrapped there) and ``a_i = (f+ - f-) / 2c``, ``s_i = (f+ + f- - 2 f0) / 2c^2``, ``m = sum s_i``,
    the scaled transform is::

        mean f0 + m      cross-covariance L [a_i]'
        cov  sum a_i a_i' + c^2 sum s_i s_i' + (beta - alpha^2) m m'

    This is the weighted sum over the points, without the cancellation of its large weights of
    opposite sign. It is a covariance if ``beta >= -alpha^2 kappa / n``. A linear model needs no
    points: the transform is exact.

    The measurement is linearised statistically: ``C = Pxy' (P-)^-1 = [a_i] L^-1``, and what C
    leaves out, ``Pyy - C P- C'``, joins R. A Kalman update in Joseph form with these two is the
    unscented update.
    """

    reversible = True
    alpha: float
    beta: float
    kappa: float

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

    @inlinable("transition")
    def _propagate(
        self, mean: np.ndarray, cov: np.ndarray, u: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        if isinstance(self.model, LinearModel):
            return super()._propagate(mean, cov, u)
        points, _ = self._by_rows(self._spread, mean[..., None, :], cov)
        return self._by_rows(self._moments, self._values("transition", self.model.n, points, u))

    @inlinable("measurement")
    def _linearise(
        self, belief: Record, u: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        if isinstance(self.model, LinearModel):
            return super()._linearise(belief, u)
        points, root = self._full_spread(belief)
        return self._by_rows(
            self._measurement_slopes, self._values("measurement", self.model.p, points, u), root
        )

    def _slopes(self, belief: Record, u: np.ndarray | None) -> np.ndarray:
        if isinstance(self.model, LinearModel):
            return super()._slopes(belief, u)
        points, root = self._full_spread(belief)
        return self._by_rows(
            self._state_slopes, self._values("transition", self.model.n, points, u), root
        )

    def _full_spread(self, belief: Record) -> tuple[np.ndarray, np.ndarray]:
        """Points and a root with an inverse ``(..., n, n)``: where a belief has no spread slopes are derivatives."""
        centre = belief.mean[..., None, :]
        points, root = self._by_rows(self._spread, centre, belief.cov)
        flat = ~(np.abs(root.diagonal(0, -2, -1)) > 0.0)
        if is_traced(flat) or flat.any():
            step = np.maximum(2.0**-26 * np.abs(belief.mean), 2.0**-10)
            root = root + np.where(flat, step, 0.0)[..., None] * self._identity
            points = self._by_rows(self._points, centre, root)
        return points, root

    def _values(self, name: str, size: int, points: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        """A function of the model at the points ``(..., 2 n + 1, size)``: of all rows at once, or traced."""
        if is_traced(points):
            return at_columns(cast(NonlinearModel, self.model), name, points.mT, u, size).mT
        return at_points(name, getattr(self.model, name), points, u, size)

    # --- formulas: of arrays or, compiled, of what stands for them --------------------------------

    @property
    def _c2(self) -> float:
        return self.alpha**2 * (self.model.n + self.kappa)

    def _spread(self, centre: np.ndarray, cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The points ``(..., 2 n + 1, n)`` about a mean ``(..., 1, n)``, and the root of its covariance."""
        root = semidefinite_cholesky(cov)
        return self._points(centre, root), root

    def _points(self, centre: np.ndarray, root: np.ndarray) -> np.ndarray:
        offsets = np.sqrt(self._c2) * root.mT  # rows: along the columns of the root
        return np.concatenate(
            [centre + 0.0 * offsets[..., :1, :], centre + offsets, centre - offsets], axis=-2
        )

    def _transform(
        self, values: np.ndarray, angles: tuple[int, ...]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The unscented transform of a function's values ``(..., 2 n + 1, k)`` at the points.

        Returns:
            The mean ``(..., k)``, the slopes ``a (..., n, k)`` along the columns of the root, and
            what the covariance ``(..., k, k)`` has beyond ``a' a``.
        """
        n, c2 = self.model.n, self._c2
        centre = values[..., 0, :]
        apart = difference(values[..., 1:, :], centre[..., None, :], angles)
        above, below = apart[..., :n, :], apart[..., n:, :]
        slopes = (above - below) / (2.0 * np.sqrt(c2))
        bends = (above + below) / (2.0 * c2)
        shift = bends.sum(-2)
        excess = (
            c2 * (bends.mT @ bends)
            + (self.beta - self.alpha**2) * shift[..., :, None] * shift[..., None, :]
        )
        return centre + shift, slopes, excess

    def _moments(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and covariance of the next state."""
        mean, slopes, excess = self._transform(values, self.model.state_angles)
        return mean, slopes.mT @ slopes + excess

    def _state_slopes(self, values: np.ndarray, root: np.ndarray) -> np.ndarray:
        """The statistical linearisation of the transition."""
        return solve_upper(root.mT, self._transform(values, self.model.state_angles)[1]).mT

    def _measurement_slopes(
        self, values: np.ndarray, root: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The mean of the measurement, its statistical linearisation, and the covariance that this leaves out."""
        mean, slopes, excess = self._transform(values, self.model.measurement_angles)
        return mean, solve_upper(root.mT, slopes).mT, excess


class UnscentedKalmanFilter(SigmaPoints[Belief], GaussianFilter[Belief], verified=True):
    """UKF: a Kalman filter whose moments come from sigma points; on a linear model it is the Kalman filter exactly.

    Needs no Jacobian and keeps second-order terms: with the defaults the mean is right to third
    order for a Gaussian. An unknown input in the model is ignored.

    Sources: Julier & Uhlmann (2004), Unscented filtering and nonlinear estimation; van der Merwe
    (2004), scaled points; Lefebvre, Bruyninckx & De Schutter (2002), the statistical linearisation
    behind them.

    Args:
        model: A `LinearModel` or a `NonlinearModel`.
        alpha: Distance of the points, times ``sqrt(n + kappa)`` in standard deviations. A small one
            is nearly a Jacobian; 1 sees as far as the belief reaches.
        beta: Weight of the central point in the covariance; 2 is best for a Gaussian.
        kappa: Above -n; ``3 - n`` matches a Gaussian's fourth moment along each axis.

    Raises:
        ValueError: if ``alpha``, ``beta`` and ``kappa`` could give negative variances.
    """

    name = "ukf"
    idle = True

    def __init__(
        self, model: Model, alpha: float = 1.0, beta: float = 2.0, kappa: float = 0.0
    ) -> None:
        super().__init__(model)
        self._set_points(alpha, beta, kappa)


class UnscentedUMVFilter(SigmaPoints[DelayedInputBelief], NoFeedthroughFilter, verified=True):
    """UKF-UMV: `ekf-ui-wdf` with sigma points in place of Jacobians; the input shows one step late.

    With ``C = Pxy' (P-)^-1``, ``K = Pxy Pyy^-1`` and R replaced by ``Pyy - C P- C'``, where Pyy
    holds R::

        F = C G     M = (F' Pyy^-1 F)^-1 F' Pyy^-1     d(k-1) = M e     x = x- + (K + (I - K C) G M) e

    The points lie about a prediction that knows nothing of d(k-1), so that an input which moves the
    state beyond the range of ``P-`` within one step is seen through the wrong C.

    Source: Zheng et al. (2019), unscented Kalman filter with unknown input, unbiased and of minimum
    variance.

    Args:
        model: A model with H = 0 and rank(C G) = q; a nonlinear one may give G as a function of
            ``(x, u)``.
        input_prior: Covariance ``(q, q)`` of the unknown input where a measurement hardly shows it;
            a number stands for that number times identity.
        alpha: Spread of the sigma points, as in `UnscentedKalmanFilter`.
        beta: Weight of the central point, likewise.
        kappa: Likewise.

    Raises:
        ValueError: if H is not zero, the rank condition cannot hold, or variances could become
            negative.
    """

    name = "ukf-umv"

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
