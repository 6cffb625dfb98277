"""The Kalman filter that carries a triangular root of its covariance."""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from estimators.belief import Belief
from estimators.filter import Filter, Rng
from estimators.linalg import joined, semidefinite_cholesky, symmetrise, whitened
from estimators.measurement import Measurement
from estimators.varying import resolve


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RootBelief(Belief):
    """The belief of a filter that carries a root of its covariance.

    Attributes:
        root: ``(..., n, n)`` lower triangular L with ``L L' = cov``. It has the digits that cov has lost where its
            eigenvalues are further apart than 1e16.
    """

    root: np.ndarray

    def replace(self, **changes: Any) -> Self:
        """This belief with some fields changed; rows of another covariance get a root of it."""
        if "cov" in changes and "root" not in changes:
            same = (changes["cov"] == self.cov).all((-2, -1))[..., None, None]
            with np.errstate(all="ignore"):
                changes["root"] = np.where(same, self.root, semidefinite_cholesky(changes["cov"]))
        return Belief.replace(self, **changes)


class SquareRootKalmanFilter(Filter[RootBelief], verified=True):
    """A `kf`, or on a nonlinear model an `ekf`, of triangular roots: ``P = L L'``, ``Q = W W'``, ``R = V V'``.

    What is on the left is turned by an orthogonal matrix (a QR decomposition of its transpose) into what is on the
    right, and neither a covariance is formed nor anything subtracted::

        predict  [A L, W] -> [L-, 0]      update  [V, C L-; 0, L-] -> [F, 0; K F, L],   F F' = S

    So cov, which is formed of L when it is given back, is a covariance however badly scaled, and L has relative errors
    of the condition of L, the root of that of P: 16 digits do what takes `kf` 32. The mean moves by ``K F (F^-1 e)``.
    An unknown input in the model is ignored.

    Sources: Kailath, Sayed & Hassibi (2000), Linear Estimation, sec. 12.2, the array algorithms; Kaminski, Bryson &
    Schmidt (1971), Discrete square root filtering, for what they are worth.
    """

    name = "srkf"
    record = RootBelief

    def _init(self, belief: Belief, rng: Rng) -> RootBelief:
        return RootBelief.of(belief, root=semidefinite_cholesky(belief.cov))

    def _predict(self, belief: RootBelief, u: np.ndarray | None, rng: Rng) -> RootBelief:
        mean, A = self.model.linearise_transition(belief.mean, u, belief.cov)
        root = triangular(joined([A @ belief.root, semidefinite_cholesky(resolve(self.model.Q, u))], -1))
        return RootBelief.predicted(belief, mean, squared(root), u, root=root)

    def _update(self, belief: RootBelief, measurement: Measurement, rng: Rng) -> RootBelief:
        n, p, L = self.model.n, self.model.p, belief.root
        seen = joined([semidefinite_cholesky(measurement.R), measurement.C @ L], -1)
        after = triangular(joined([seen, joined([np.zeros((n, p)), L], -1)], -2))
        F, KF, root = after[..., :p, :p], after[..., p:, :p], after[..., p:, p:]
        mean = belief.mean + np.matvec(KF, whitened(F, measurement.innovation))
        return RootBelief.updated(belief, mean, squared(root), measurement, squared(seen), root=root)


def squared(root: np.ndarray) -> np.ndarray:
    """``L L'``, symmetric to the last bit."""
    return symmetrise(root @ root.mT)


def triangular(array: np.ndarray) -> np.ndarray:
    """Lower triangular ``L (..., m, m)`` with ``L L' = M M'``, its diagonal not negative, of ``M (..., m, k)``.

    A row that is not finite comes out as NaN.
    """
    finite = np.isfinite(array).all((-2, -1))[..., None, None]
    upper: Any = np.linalg.qr(np.where(finite, array, 0.0).mT, mode="r")
    signs = np.where(upper.diagonal(0, -2, -1) < 0.0, -1.0, 1.0)
    return np.where(finite, upper.mT * signs[..., None, :], np.nan)
