"""Unbiased minimum-variance filtering with a feedthrough matrix of any rank."""

from typing import Any, cast

import numpy as np

from estimators.belief import FeedthroughBelief
from estimators.engine import compiled
from estimators.filter import Changes
from estimators.input_observability import observable_ranks
from estimators.kalman import joint_covariance, of_joint
from estimators.linalg import congruence, identity, joined, symmetric_blocks, symmetrise
from estimators.models import LinearModel
from estimators.unknown_input import DelayedInputFilter, waiting


@compiled
class ULISE(DelayedInputFilter):
    """ULISE: estimates state and unknown input together, whatever the rank of H.

    What H shows of d(k) is estimated at once and drives the next prediction, as in `kf-umv-ui`; the
    rest shows in the next measurement, as in `kf-umv-ui-wdf`. Let d1(k-1) be what measurement k-1
    has shown of d(k-1), which is in the prediction ``x-`` already, and N the projector on the other
    directions. Then::

        D = (H' S^-1 H)^+ H' S^-1             F = (I - H D) C G N
        M = (F' S^-1 F)^+ F' S^-1             d(k-1) = d1(k-1) + M e
        L = K (I - H D) + (I - K (I - H D) C) G M
        x = x- + L e                          P from x~ = (I - L C) x~- - L v
        d1(k) = D (I - C G M) e               x-+ = A x + B u + G d1

    with ``x-+`` the next prediction. The source splits H by its singular values and transforms the
    measurements to match; its estimates are the same, because least squares does not depend on
    coordinates. The form with projectors lets the rank of H differ between the rows of a batch. If
    a channel with feedthrough drops out, the part of d(k) that it would have shown is estimated,
    without a prior, from the next measurement.

    In directions that H hardly shows, d(k) first counts as noise of covariance ``input_prior``,
    which adds to S, also in the formula of D. The belief keeps the matrix by which this part of
    d(k) changes the errors of x and d1 (``input_reach``). At the next measurement that matrix takes
    the place of G, so these directions are still estimated without bias. Only directions that
    neither measurement shows well are estimated from N(0, ``input_prior``). Covariances are
    computed in Joseph form.

    The whole input is known one step late: ``input_mean`` is d(k-1) (``input_delay`` 1),
    ``feedthrough_mean`` is d1(k). With H = 0 this is `kf-umv-ui-wdf`; with rank H = q the states
    are those of `kf-umv-ui`. With ``delayed_feedthrough`` no input shows at once, and ``F = C G +
    H``.

    Source: Yong, Zhu & Frazzoli (2016), A unified filter for simultaneous input and state
    estimation of linear discrete-time stochastic systems.

    Args:
        model: A `LinearModel` with rank(C2 G2) = q - rank(H). C2 belongs to the measurements
            without feedthrough, G2 to the inputs that H does not show.
        input_prior: Covariance ``(q, q)`` of the unknown input where two measurements hardly show
            it; a number stands for that number times identity. Set it to the square of usual
            inputs.

    Raises:
        ValueError: if the rank condition fails.
    """

    name = "ulise"
    record = FeedthroughBelief
    linear = True
    model: LinearModel

    def _check_model(self) -> None:
        C, G, H = cast(Any, (self.model.C, self.model.G, self.model.H))
        if any(map(callable, (C, G, H))):
            return
        if self.model.delayed_feedthrough:  # d(k) shows at k + 1 alone, through both
            observable = np.linalg.matrix_rank((C @ G + H) @ self._root)
        else:
            observable = np.add(*observable_ranks(C, G @ self._root, H @ self._root))
        self._require_rank(
            "rank(H) + rank(C2 G2)",
            observable,
            "measure the input, or a state that it drives directly, by a measurement that no other"
            " unknown input disturbs",
        )

    def _begin(self, mean: np.ndarray, cov: np.ndarray, rng: Any) -> Changes:
        return super()._begin(mean, cov, rng) | self._prior_feedthrough(mean)

    def _prior_feedthrough(self, mean: np.ndarray) -> Changes:
        """Arrays about the input that acts now, before its first measurement."""
        n, q, rows = self.model.n, self.model.q, mean.shape[:-1]
        return {
            "feedthrough_mean": np.zeros(rows + (q,)),
            "feedthrough_cov": np.zeros(rows + (q, q)),
            "state_feedthrough_cov": np.zeros(rows + (n, q)),
            "feedthrough_observed": np.zeros(rows + (q, q)),
            "input_reach": np.zeros(rows + (n + q, q)),
        }

    def _predict(self, belief: Any, u: Any, mean: Any, A: Any, Q: Any, *more: Any) -> Changes:
        (G,), n, q = more, self.model.n, self.model.q
        # Directions of d that are not in d1, and their share in the errors, wait for the next
        # measurement.
        observed = belief.feedthrough_observed
        reach = belief.input_reach * (1.0 - waiting(belief))
        joint = symmetric_blocks(
            self._covariance(belief), belief.state_feedthrough_cov, belief.feedthrough_cov
        )
        joint = joint - congruence(reach, self._prior_cov(observed))
        drive = joined([joined([A, G], -1), np.eye(q, n + q, n)], -2)
        joint = congruence(drive, joint)
        reach = drive @ reach + joined([G, identity(q)], -2) @ (identity(q) - observed)
        return self._prior_feedthrough(mean) | {
            "mean": mean + np.matvec(G, belief.feedthrough_mean),
            "cov": symmetrise(joint[..., :n, :n] + Q),
            "input_mean": belief.feedthrough_mean,
            "input_cov": symmetrise(joint[..., n:, n:] + self._prior_cov(observed)),
            "state_input_cov": joint[..., :n, n:],
            "input_observed": observed,
            "pending": np.ones(mean.shape[:-1], bool),
            "input_reach": reach,
        }

    def _observable_input(self, belief: Any, C: Any, H: Any) -> np.ndarray:
        late = super()._observable_input(belief, C, H)
        now = np.broadcast_to(self._feedthrough(H)[0] @ self._root, late.shape)
        return np.concatenate([now, late], -1)

    def _feedthrough(self, H: Any) -> tuple[Any, Any]:
        """Feedthrough matrices ``(..., p, q)`` of d(k) and of d(k-1)."""
        none = np.zeros(H.shape)
        return (none, H) if self.model.delayed_feedthrough else (H, none)

    def _update(
        self, belief: Any, u: Any, e: Any, C: Any, R: Any, available: Any, *more: Any
    ) -> Changes:
        (H, delayed), n, q = self._feedthrough(*more), self.model.n, self.model.q
        pending = waiting(belief)
        reach = belief.input_reach * pending + np.eye(n + q, q, -n) * (1.0 - pending)
        G, rest = reach[..., :n, :], reach[..., n:, :]
        CP, F = C @ belief.cov, C @ G + delayed * pending
        S = CP @ C.mT + R
        solved, share = self._solved(S, joined([CP, H, F], -1), H, F)
        K, SH, SF = solved[..., :n].mT, solved[..., n : n + q], solved[..., n + q :]
        D, now = self._gain(H, SH, share)
        M, newly_observed = self._gain(F, SF - SH @ (D @ F), share)
        K, D = K - (K @ H) @ D, now @ D
        # (x, d(k-1), d(k)) = (x-, d1(k-1), 0) + Z e
        Z = joined([K + (G - K @ F) @ M, rest @ M, D - (D @ F) @ M], -2)
        correction = np.matvec(Z, e)
        observed, present = belief.input_observed + newly_observed, -1.0 * (Z @ H)
        past = joined([reach, np.zeros((q, q))], -2) - Z @ F
        # Inputs cancel in Z e where they are seen; elsewhere they have their prior.
        kept = joined([np.zeros((n, q)), belief.input_observed, np.zeros((q, q))], -2)
        errors = joined([np.eye(n + 2 * q, n) - Z @ C, kept], -1)
        cov = congruence(errors, joint_covariance(belief)) + congruence(Z, R)
        cov = cov + congruence(past, self._prior_cov(observed))
        cov = symmetrise(cov + congruence(present, self._prior_cov(now)))
        carried = joined([present[..., :n, :], present[..., n + q :, :]], -2)
        both = slice(n + q)
        return of_joint(correction[..., both], cov[..., both, both], n) | {
            "mean": belief.mean + correction[..., :n],
            "innovation_cov": S,
            "input_mean": belief.input_mean + correction[..., n : n + q],
            "input_observed": observed,
            "pending": np.zeros(belief.pending.shape, bool),
            "input_reach": carried @ (identity(q) - now),
            "feedthrough_mean": correction[..., n + q :],
            "feedthrough_cov": cov[..., n + q :, n + q :],
            "state_feedthrough_cov": cov[..., :n, n + q :],
            "feedthrough_observed": now,
        }
