"""Filters as the source papers print them, misprints included, to reproduce the papers.

``estimators.make(name, model, as_printed=True)`` builds them, and without the option the filters of
these names without misprints.
"""

from typing import Any

import numpy as np

from estimators.engine import compiled
from estimators.ensemble import EnsembleTransformFilter
from estimators.filter import Changes
from estimators.linalg import all_finite, cholesky, congruence, solve, symmetrise
from estimators.models import LinearModel
from estimators.unknown_input import UMVFilter


class PrintedSquareRootFilter(EnsembleTransformFilter):
    """EnKF-SR as printed: anomalies ``A V sqrt(I - s's)`` without the ``V'`` of `enkf-sr`.

    ``L^-1 Y / sqrt(N - 1) = U s V'`` with ``S = L L'``. The second moments are those of `enkf-sr`,
    but the mean of the members moves at random, by about a quarter of the spread at N = 10 (Sakov &
    Oke 2008b; Livings, Dance & Nichols 2008). V is N x N, and is applied without being formed: its
    first columns span the rows of ``L^-1 Y``, the others are Householder's.

    Sources: Evensen (2004), Sampling strategies and square root analysis schemes for the EnKF;
    Herlambang, Subchan & Nurhadi, Table 1.
    """

    def _analysis(
        self, belief: Any, e: Any, Y: Any, S: Any, R: Any, available: Any, rng: Any
    ) -> tuple[Any, Any]:
        X = np.linalg.inv(cholesky(S)) @ Y / np.sqrt(self.members - 1)
        X[~all_finite(X)] = 0.0  # rows without a finite mean are lost anyway
        anomalies, factor = _times_basis(belief.members - belief.mean[..., None], X)
        _, s, Wt = np.linalg.svd(factor)
        kept, scale = s.shape[-1], np.sqrt(np.maximum(1.0 - s**2, 0.0))[..., None, :]
        anomalies[..., :kept] = (anomalies[..., :kept] @ Wt.mT) * scale
        shift, _ = super()._analysis(belief, e, Y, S, R, available, rng)
        return shift, anomalies


def _times_basis(A: np.ndarray, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``A Q (..., n, N)`` and ``F (..., p, p)``, where ``X = F Q[:, :p]'`` and Q is orthogonal."""
    reflectors, weights = np.linalg.qr(X.mT, mode="raw")
    p = X.shape[-2]
    for i in range(p):
        v = reflectors[..., i, :].copy()
        v[..., :i], v[..., i] = 0.0, 1.0
        A = A - weights[..., i, None, None] * (A @ v[..., None]) * v[..., None, :]
    return A, np.tril(reflectors[..., :p])


@compiled
class PrintedUMVFilter(UMVFilter):
    """KF-UMV-UI by Table 2.5 of Hermawan's thesis (2020), to the letter.

    The prediction has the first q columns of B where u and G belong, and a covariance that no
    derivation gives. The update is that of `UMVFilter`::

        x-+ = A x + B d
        P-+ = A P A' + B H' R^-1 C A' + A C' R^-1 H B' + B Pd B' + Q

    Args:
        model: A `LinearModel` with rank(H) = q, and at least q columns in B.
        input_prior: Covariance ``(q, q)`` of the unknown input where a measurement hardly shows it.

    Raises:
        ValueError: for another model.
    """

    def _check_model(self) -> None:
        super()._check_model()
        if not isinstance(self.model, LinearModel) or self.model.B is None:
            raise ValueError(
                "kf-umv-ui as printed multiplies d by B: give it a LinearModel with a B, or leave"
                " as_printed out"
            )

    def _predict(self, belief: Any, u: Any, mean: Any, A: Any, Q: Any, *more: Any) -> Changes:
        model: Any = self.model
        B, C, H, R = (model.value(each, u) for each in "BCHR")
        B = B[..., : model.q]
        cross = A @ C.mT @ solve(R, H) @ B.mT
        cov = congruence(A, belief.cov) + cross + cross.mT + congruence(B, belief.input_cov) + Q
        printed = np.matvec(A, belief.mean) + np.matvec(B, belief.input_mean)
        return {"mean": printed, "cov": symmetrise(cov)} | self._prior_input(mean)
