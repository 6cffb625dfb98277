"""Unbiased minimum-variance filtering with a feedthrough matrix of any rank."""

import numpy as np

from estimators.belief import Belief, FeedthroughBelief
from estimators.filter import Model, Rng
from estimators.linalg import congruence, driven, identity, joined, solve, symmetrise
from estimators.models import LinearModel, resolve
from estimators.reading import Reading
from estimators.unknown_input import DelayedInputFilter, hidden_directions, unbiased_gain, waiting


class ULISE(DelayedInputFilter[FeedthroughBelief]):
    """ULISE: state and unknown input together, whatever the rank of H.

    What H shows of d(k) is estimated at once and drives the next prediction, as in `kf-umv-ui`; the rest shows in the
    reading after it, as in `kf-umv-ui-wdf`. With N the projector on the directions of d(k-1) that its own reading
    did not show (the others are in the prediction ``x-`` already)::

        D = (H' S^-1 H)^+ H' S^-1             F = (I - H D) C G N
        M = (F' S^-1 F)^+ F' S^-1             d(k-1) = d1(k-1) + M e
        L = K (I - H D) + (I - K (I - H D) C) G M
        x = x- + L e                          P from x~ = (I - L C) x~- - L v
        d1(k) = D (I - C G M) e               x-+ = A x + B u + G d1

    These are the estimates of the source, which splits H by its singular values and transforms the readings to match:
    least squares does not depend on coordinates. Written with projectors they hold for any rank in any row, so
    that a channel of H that drops leaves its part of d(k) to the next reading, not to a prior. Only what neither
    reading shows falls back to N(0, ``input_prior``) for that step. Covariances follow in Joseph form.

    The input is known whole one step late: ``input_mean`` is d(k-1) (``input_delay`` 1), ``feedthrough_mean`` is d1(k).
    With H = 0 this is `kf-umv-ui-wdf`; with rank H = q the states are those of `kf-umv-ui`.

    Source: Yong, Zhu & Frazzoli (2016), A unified filter for simultaneous input and state estimation of linear
    discrete-time stochastic systems.

    Args:
        model: A `LinearModel` with rank(C2 G2) = q - rank(H): the readings that H leaves clean (C2) show the inputs
            that H does not (G2).
        input_prior: Covariance ``(q, q)`` of the unknown input where no reading shows it; a number
            stands for that number times identity. Its scale is the problem's: set it.

    Raises:
        ValueError: if the rank condition fails.
    """

    name = "ulise"
    record = FeedthroughBelief
    linear = True
    model: LinearModel

    def __init__(self, model: Model, input_prior: np.ndarray | float = 1.0) -> None:
        super().__init__(model, input_prior)
        p, q = self.model.p, self.model.q
        C, G, H = self.model.C, self.model.G, self.model.H
        if not (isinstance(C, np.ndarray) and isinstance(G, np.ndarray) and isinstance(H, np.ndarray)):
            return
        unseen, _ = hidden_directions(H, H, self._input_units)
        clean = np.eye(p) - H @ np.linalg.pinv(H, rcond=1e-9)
        CG = C @ G * self._input_units
        hidden, _ = hidden_directions(clean @ CG @ unseen, CG, np.ones(q))
        late, shown = _rank(unseen), q - _rank(hidden)
        if (shown < late).any():
            row = np.argmax(late - shown)
            late, shown = (np.broadcast_to(rank, (late - shown).shape).flat[row] for rank in (late, shown))
            raise ValueError(
                f"ulise needs rank(C2 G2) = q - rank(H) = {q} - {q - late}, got {shown}: measure the input, or a state "
                "that it drives directly, by a reading that no other unknown input disturbs"
            )

    def _init(self, belief: Belief, rng: Rng) -> FeedthroughBelief:
        return FeedthroughBelief.of(belief, **self._begun_input(belief.mean), **self._nothing_now(belief.mean))

    def _nothing_now(self, mean: np.ndarray) -> dict[str, np.ndarray]:
        """What a belief of this mean says of the input that acts now if no reading showed it."""
        n, q, rows = self.model.n, self.model.q, mean.shape[:-1]
        return {
            "feedthrough_mean": np.zeros(rows + (q,)),
            "feedthrough_cov": np.zeros(rows + (q, q)),
            "state_feedthrough_cov": np.zeros(rows + (n, q)),
            "feedthrough_observed": np.zeros(rows + (q, q)),
        }

    def _predict(self, belief: FeedthroughBelief, u: np.ndarray | None, rng: Rng) -> FeedthroughBelief:
        model = self.model
        mean, A = model.linearise_transition(belief.mean, u)
        G = model.input_matrix(belief.mean, u)
        mean = mean + np.matvec(G, belief.feedthrough_mean)
        cross, input_cov = belief.state_feedthrough_cov, belief.feedthrough_cov
        cov = symmetrise(driven(A, G, self._covariance(belief), cross, input_cov) + resolve(model.Q, u))
        return FeedthroughBelief.predicted(
            belief, mean, cov, u,
            input_mean=belief.feedthrough_mean,
            input_cov=symmetrise(input_cov + self._open(belief.feedthrough_observed)),
            state_input_cov=A @ cross + G @ input_cov, input_observed=belief.feedthrough_observed,
            pending=np.ones(mean.shape[:-1], bool), input_matrix=self._moving_G(belief, u),
            **self._nothing_now(mean),
        )  # fmt: skip

    def _shown_input(self, belief: FeedthroughBelief, reading: Reading) -> np.ndarray:
        late = super()._shown_input(belief, reading)
        now = np.broadcast_to(reading.H * self._input_units, late.shape)
        return np.concatenate([now, late], -1)

    def _update(self, belief: FeedthroughBelief, reading: Reading, rng: Rng) -> FeedthroughBelief:
        C, H, R, units = reading.C, reading.H, reading.R, self._input_units
        n, q = self.model.n, self.model.q
        before = belief.input_observed
        G = self._input_matrix(belief) * waiting(belief)
        CP = C @ belief.cov
        S = CP @ C.mT + R
        CGN = C @ (G @ (identity(q) - before))
        solved = solve(S if reading.spread is None else S + reading.spread, joined([CP, H, CGN], -1))
        K, SH, SF = solved[..., :n].mT, solved[..., n : n + q], solved[..., n + q :]
        D, now = unbiased_gain(H, SH, reading.whole_H, units)
        M, late = unbiased_gain(CGN - H @ (D @ CGN), SF - SH @ (D @ CGN), reading.whole @ G, units)
        GM, K = G @ M, K - (K @ H) @ D
        CGM = C @ GM
        Z = joined([K + GM - K @ CGM, M, D - D @ CGM], -2)  # (x, d(k-1), d(k)) = (x-, d1(k-1), 0) + Z e
        correction = np.matvec(Z, reading.innovation)
        # Errors: those of (x-, d1(k-1)) less Z (C x~- + v); what the inputs add to e cancels where they are seen.
        cross = belief.state_input_cov
        joint = joined([joined([belief.cov, cross], -1), joined([cross.mT, belief.input_cov], -1)], -2)
        kept = joined([np.zeros((n, q)), before, np.zeros((q, q))], -2)
        errors = joined([np.eye(n + 2 * q, n) - Z @ C, kept], -1)
        observed = before + late
        reach = joined([G, identity(q), -(D @ (C @ G))], -2)
        cov = congruence(errors, joint) + congruence(Z, R)
        cov = symmetrise(cov + congruence(reach, self._open(observed)))
        return FeedthroughBelief.updated(
            belief, belief.mean + correction[..., :n], cov[..., :n, :n], reading, S,
            input_mean=belief.input_mean + correction[..., n : n + q], input_cov=cov[..., n : n + q, n : n + q],
            state_input_cov=cov[..., :n, n : n + q], input_observed=observed,
            pending=np.zeros(belief.pending.shape, bool), input_matrix=belief.input_matrix,
            feedthrough_mean=correction[..., n + q :], feedthrough_cov=cov[..., n + q :, n + q :],
            state_feedthrough_cov=cov[..., :n, n + q :], feedthrough_observed=now,
        )  # fmt: skip


def _rank(projector: np.ndarray) -> np.ndarray:
    """The ranks ``(...)`` of projectors ``(..., q, q)``."""
    return np.asarray(np.rint(np.trace(projector, axis1=-2, axis2=-1)), dtype=int)
