"""Unbiased minimum-variance filters that estimate an unknown input together with the state."""

import numpy as np

from estimators.belief import Belief
from estimators.filter import Filter, Model, Reading, Streams
from estimators.kalman import input_covariance
from estimators.linalg import congruence, inverse, product, solve, symmetrise
from estimators.models import LinearModel, resolve


class UnknownInputFilter(Filter):
    """What the filters with and without feedthrough share: their input prior and its bookkeeping.

    A missing reading can leave directions of ``d`` undetermined. Those get N(0, ``input_prior``)
    for that step, and the belief's ``input_observed`` is the projector on the others.
    """

    model: LinearModel

    def __init__(self, model: Model, input_prior: np.ndarray | float = 1.0) -> None:
        super().__init__(model)
        if not isinstance(model, LinearModel):
            raise ValueError(f"{self.name} needs a LinearModel")
        if model.q == 0:
            raise ValueError(f"{self.name} needs an unknown input: give the model G, H or both")
        self.input_prior = input_covariance("input_prior", input_prior, model.q)
        self._input_units = np.sqrt(np.diagonal(self.input_prior))
        if not self._input_units.all():
            raise ValueError("input_prior must have positive variances: an input without variance is no input")
        self._state_rows = np.eye(model.n + model.q)[:, : model.n]

    def _init(self, belief: Belief, rng: Streams) -> Belief:
        return self._with_unseen_input(belief, np.zeros(belief.mean.shape[:-1], bool))

    def _with_unseen_input(self, belief: Belief, pending: np.ndarray) -> Belief:
        """The belief with nothing known of the input beyond its prior."""
        batch, n, q = belief.mean.shape[:-1], self.model.n, self.model.q
        return Belief(
            belief.mean, belief.cov, belief.prior_mean, belief.prior_cov, belief.healthy, belief.u,
            input_mean=np.zeros(batch + (q,)), input_cov=np.zeros(batch + (q, q)) + self.input_prior,
            state_input_cov=np.zeros(batch + (n, q)), input_observed=np.zeros(batch + (q, q)), pending=pending,
        )  # fmt: skip


def _gains(
    S: np.ndarray, CP: np.ndarray, F: np.ndarray, whole: np.ndarray | None, units: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The Kalman gain, and the best linear unbiased estimate of ``d`` from ``e = F d + noise of covariance S``.

    ``K = P- C' S^-1`` and ``M = (F' S^-1 F)^-1 F' S^-1``, the latter restricted to the directions that F
    shows. Directions are told apart with each input in units of its prior, so that the units do not matter.

    Args:
        S: ``(..., p, p)`` innovation covariance.
        CP: ``(..., p, n)``.
        F: ``(..., p, q)`` with the rows of missing readings zero.
        whole: F as it would be with every reading, against which a direction counts as shown;
            None when nothing is missing: F then shows every direction.
        units: ``(q,)`` standard deviations of the inputs' prior.

    Returns:
        K ``(..., n, p)``, M ``(..., q, p)`` and the projector ``(..., q, q)`` on the directions shown.
    """
    n, q = CP.shape[-1], F.shape[-1]
    right = np.empty(CP.shape[:-1] + (n + q,))
    right[..., :n], right[..., n:] = CP, F
    solved = solve(S, right)
    K, SF = solved[..., :n].mT, solved[..., n:]
    information = F.mT @ SF
    if whole is None:
        return K, inverse(information) @ SF.mT, np.zeros(information.shape) + (1.0 if q == 1 else np.eye(q))
    strongest = np.linalg.svd(whole * units, compute_uv=False).max(-1)
    _, strength, directions = np.linalg.svd(F * units)
    shown = np.zeros(directions.shape[:-1], bool)
    shown[..., : strength.shape[-1]] = strength > 1e-9 * strongest[..., None]
    hidden = directions * ~shown[..., None]
    unseen = hidden.mT @ hidden
    scale = units[:, None] * units
    seen, information = np.eye(q) - unseen, information * scale
    # The hidden directions get a finite information of the same size, so that the inverse stays well conditioned.
    size = np.trace(information, axis1=-2, axis2=-1)[..., None, None]
    cov = seen @ inverse(information + np.where(size > 0.0, size, 1.0) * unseen) @ seen
    return K, (cov * scale) @ SF.mT, seen * (units[:, None] / units)


class UnbiasedMinimumVarianceFilter(UnknownInputFilter):
    """KF-UMV-UI: state and unknown input together, with direct feedthrough (rank H = q).

    The input of a step is estimated from the same step's reading (``input_delay`` 0)::

        Pd = (H' S^-1 H)^-1      M = Pd H' S^-1      d = M e
        x = x- + K (e - H d)     P = P- - K (S - H Pd H') K'      Pxd = -K H Pd
        x-+ = A x + B u + G d    P-+ = [A G] [[P, Pxd], [Pxd', Pd]] [A G]' + Q

    computed in the equivalent Joseph form, which cannot lose definiteness. When a channel drops so
    that H loses a row that ``d`` needs, ``d`` falls back to N(0, ``input_prior``) for that step: the
    state is corrected by the channels that remain and the next prediction is the more uncertain.

    Sources: Gillijns & De Moor (2007b); Pan et al. (2010); Hermawan (2020), Table 2.5.

    Args:
        model: A `LinearModel` with rank(H) = q.
        input_prior: Covariance ``(q, q)`` of the unknown input where no reading shows it; a number
            stands for that number times identity. Its scale is the problem's: set it.

    Raises:
        ValueError: if the rank condition fails.
    """

    name = "kf-umv-ui"
    input_delay = 0

    def __init__(self, model: Model, input_prior: np.ndarray | float = 1.0) -> None:
        super().__init__(model, input_prior)
        if not callable(model.H):
            rank = int(np.linalg.matrix_rank(model.H).min())
            if rank < model.q:
                raise ValueError(
                    f"kf-umv-ui needs rank(H) = {model.q} unknown input{'s' if model.q > 1 else ''}, got {rank}: "
                    "measure the input or use kf-umv-ui-wdf"
                )

    def _predict(self, belief: Belief, u: np.ndarray | None, rng: Streams) -> Belief:
        model = self.model
        mean, A = model.linearise_transition(belief.mean, u)
        G = resolve(model.G, u)
        mean = mean + np.matvec(G, belief.input_mean)
        # Half of the terms in P_xd, doubled by symmetrising.
        half = 2.0 * (A @ belief.state_input_cov) + G @ belief.input_cov
        cov = symmetrise(congruence(A, belief.cov) + product(half, G.mT) + resolve(model.Q, u))
        predicted = Belief(mean, cov, belief.prior_mean, belief.prior_cov, belief.healthy, u)
        return self._with_unseen_input(predicted, belief.pending)

    def _update(self, belief: Belief, reading: Reading, rng: Streams) -> Belief:
        C, H, R = reading.C, reading.H, reading.R
        PC = product(belief.cov, C.mT)
        S = product(PC.mT, C.mT) + R
        whole = None if reading.complete else resolve(self.model.H, belief.u)
        K, M, observed = _gains(S, PC.mT, H, whole, self._input_units)
        n = self.model.n
        Z = np.empty(K.shape[:-2] + (n + self.model.q, self.model.p))  # (x, d) = (x-, 0) + Z e
        Z[..., :n, :], Z[..., n:, :] = K - product(K, H) @ M, M
        correction = np.matvec(Z, reading.innovation)
        # Errors: x~ = x~- - L (C x~- + v), as L H = 0, and d~ = -M (C x~- + v) where d is seen (M H = I).
        cov = symmetrise(congruence(self._state_rows - product(Z, C), belief.cov) + product(Z, R) @ Z.mT)
        input_cov = cov[..., n:, n:]
        if not reading.complete:
            input_cov = input_cov + congruence(np.eye(self.model.q) - observed, self.input_prior)
        return Belief(
            belief.mean + correction[..., :n], cov[..., :n, :n], belief.prior_mean, belief.prior_cov,
            np.ones(correction.shape[:-1], bool), belief.u, reading.innovation, S, reading.available,
            correction[..., n:], input_cov, cov[..., :n, n:], observed, belief.pending,
        )  # fmt: skip


class UnbiasedMinimumVarianceFilterWithoutFeedthrough(UnknownInputFilter):
    """KF-UMV-UI-WDF: the unknown input acts on the state only, and shows in the next reading.

    At step k it estimates d(k-1) (``input_delay`` 1)::

        F = C G     Pd = (F' S^-1 F)^-1     M = Pd F' S^-1     d(k-1) = M e     L = K + (I - K C) G M
        x = x- + L e      P = (I - L C) P- (I - L C)' + L R L'      x-+ = A x + B u      P-+ = A P A' + Q

    The first update after ``init`` has no d(k-1): it is a Kalman update.

    Sources: Kitanidis (1987); Darouach & Zasadzinski (1997); Gillijns & De Moor (2007a).

    Args:
        model: A `LinearModel` with H = 0 and rank(C G) = q.
        input_prior: Covariance ``(q, q)`` of the unknown input where no reading shows it.

    Raises:
        ValueError: if H is not zero or the rank condition fails.
    """

    name = "kf-umv-ui-wdf"
    input_delay = 1

    def __init__(self, model: Model, input_prior: np.ndarray | float = 1.0) -> None:
        super().__init__(model, input_prior)
        if callable(model.H) or np.any(model.H):
            raise ValueError("kf-umv-ui-wdf needs H = 0 (no feedthrough): use kf-umv-ui")
        C, G = self.model.C, self.model.G
        if not callable(C) and not callable(G):
            rank = int(np.linalg.matrix_rank(C @ G).min())
            if rank < model.q:
                raise ValueError(
                    f"kf-umv-ui-wdf needs rank(C G) = {model.q} unknown input{'s' if model.q > 1 else ''}, "
                    f"got {rank}: measure a state that each input drives directly"
                )

    def _predict(self, belief: Belief, u: np.ndarray | None, rng: Streams) -> Belief:
        cov = belief.cov
        if belief.pending.any():  # an earlier prediction never met its reading: its input stays unknown
            unseen = congruence(resolve(self.model.G, belief.u), self.input_prior)
            cov = cov + unseen * belief.pending[..., None, None]
        mean, A = self.model.linearise_transition(belief.mean, u)
        cov = symmetrise(congruence(A, cov) + resolve(self.model.Q, u))
        predicted = Belief(mean, cov, belief.prior_mean, belief.prior_cov, belief.healthy, u)
        return self._with_unseen_input(predicted, np.ones(mean.shape[:-1], bool))

    def _update(self, belief: Belief, reading: Reading, rng: Streams) -> Belief:
        C, R = reading.C, reading.R
        G = resolve(self.model.G, belief.u)
        PC = product(belief.cov, C.mT)
        S = product(PC.mT, C.mT) + R
        pending = belief.pending[..., None, None]
        complete = reading.complete and bool(pending.all())
        whole = None if complete else resolve(self.model.C, belief.u) @ G
        K, M, observed = _gains(S, PC.mT, (C @ G) * pending, whole, self._input_units)
        n, q = self.model.n, self.model.q
        GM = G @ M
        Z = np.empty(K.shape[:-2] + (n + q, self.model.p))  # (x, d) = (x-, 0) + Z e
        Z[..., :n, :], Z[..., n:, :] = K + GM - K @ (C @ GM), M
        correction = np.matvec(Z, reading.innovation)
        # Errors: x~ = x~- - L (C x~- + v), the input's share in it cancelling, and d~ = -M (C x~- + v).
        cov = congruence(self._state_rows - product(Z, C), belief.cov) + product(Z, R) @ Z.mT
        if not complete:
            hidden = congruence(np.eye(q) - observed, self.input_prior)
            reach = np.concatenate([G * pending, np.broadcast_to(np.eye(q), M.shape[:-2] + (q, q))], -2)
            cov = cov + congruence(reach, hidden)
        cov = symmetrise(cov)
        healthy, settled = np.ones(correction.shape[:-1], bool), np.zeros(correction.shape[:-1], bool)
        return Belief(
            belief.mean + correction[..., :n], cov[..., :n, :n], belief.prior_mean, belief.prior_cov, healthy, belief.u,
            reading.innovation, S, reading.available, correction[..., n:], cov[..., n:, n:], cov[..., :n, n:], observed,
            settled,
        )  # fmt: skip
