"""Unbiased minimum-variance filters that estimate an unknown input together with the state."""

from typing import Any, ClassVar, cast

import numpy as np

from estimators.belief import Belief, DelayedInputBelief, ObservedInputBelief
from estimators.engine import compiled
from estimators.filter import Changes, Filter, Model
from estimators.kalman import driven, input_covariance, of_joint, unseen_input
from estimators.linalg import (
    congruence,
    equilibrated,
    identity,
    joined,
    masked,
    pseudo_inverse,
    rescuing,
    singular,
    solve,
    symmetrise,
)
from estimators.models import LinearModel

OBSERVABLE = 0.1
"""Ratio of prior to remaining variance above which a direction of the input is observable."""


class UnknownInputFilter(Filter[Any]):
    """Base of filters with an unknown input: provides its prior and its observable directions.

    Let ``input_prior = W W'``, and let the innovation be ``e = F d`` plus noise of covariance S.
    Each eigenvalue of ``W' F' S^-1 F W`` belongs to a direction of ``d``: it is the ratio of the
    prior variance to the variance that the measurement alone leaves. Directions whose ratio exceeds
    `OBSERVABLE`, 0.1, are estimated without bias; the belief's ``input_observed`` is the projector
    on them. The other directions have the prior N(0, ``input_prior``), as in a Kalman filter: their
    effect on the measurement is noise.
    """

    likelihood = "diffuse"
    reversible = True
    linear: ClassVar[bool] = False
    """True if the filter needs a `LinearModel`."""

    def __init__(self, model: Model, input_prior: np.ndarray | float = 1.0) -> None:
        super().__init__(model)
        if self.linear and not isinstance(model, LinearModel):
            raise ValueError(
                f"{self.name} needs a LinearModel: for a nonlinear one use kf-umv-ui, without"
                " feedthrough ekf-ui-wdf or ukf-umv"
            )
        self.input_prior = input_covariance("input_prior", input_prior, model.q)
        try:
            self._root = np.linalg.cholesky(self.input_prior)
        except np.linalg.LinAlgError:
            raise ValueError(
                "input_prior must be positive definite: an input without variance is no input"
            ) from None
        self._inverse_root = np.linalg.inv(self._root)
        self._check_model()

    def _check_model(self) -> None:
        """Refuse a model whose unknown input the filter cannot estimate."""

    def _require_rank(self, condition: str, ranks: Any, remedy: str) -> None:
        """Refuse a model whose measurements, of ``ranks (...)``, do not show the whole input."""
        if (rank := np.min(ranks)) < (q := self.model.q):
            inputs = f"unknown input{'s' if q > 1 else ''}"
            raise ValueError(f"{self.name} needs {condition} = {q} {inputs}, got {rank}: {remedy}")

    def _begin(self, mean: np.ndarray, cov: np.ndarray, rng: Any) -> Changes:
        return self._prior_input(mean)

    def _prior_input(self, mean: np.ndarray) -> Changes:
        """Arrays about an input that no measurement has shown."""
        unseen = unseen_input(mean, self.input_prior)
        return unseen | {"input_observed": np.zeros(unseen["input_cov"].shape)}

    def _predict(self, belief: Any, u: Any, mean: Any, A: Any, Q: Any, *more: Any) -> Changes:
        return driven(belief, mean, A, Q, *more) | self._prior_input(mean)

    def _effect(self, belief: Any, C: Any, H: Any) -> tuple[Any, Any]:
        """F ``(..., p, q)`` of the input in the measurement, and G ``(..., n, q)`` in the state."""
        return H, np.zeros((self.model.n, self.model.q))

    def _update(
        self, belief: Any, u: Any, e: Any, C: Any, R: Any, available: Any, *more: Any
    ) -> Changes:
        """State and input together, from ``x = x- + G d`` and ``e = C x~- + F d + v``."""
        n, q = self.model.n, self.model.q
        F, G = self._effect(belief, C, *more)
        CP = C @ belief.cov
        S = CP @ C.mT + R
        solved, share = self._solved(S, joined([CP, F], -1), F)
        K, (M, observed) = solved[..., :n].mT, self._gain(F, solved[..., n:], share)
        Z = joined([K + (G - K @ F) @ M, M], -2)  # (x, d) = (x-, 0) + Z e
        # Errors: x~ = x~- + G d - Z e and d~ = d - Z e. Where d is seen its share cancels,
        # elsewhere it has its prior.
        reach = joined([G, identity(q)], -2) - Z @ F
        cov = congruence(np.eye(n + q, n) - Z @ C, belief.cov) + congruence(Z, R)
        cov = symmetrise(cov + congruence(reach, self._prior_cov(observed)))
        correction = np.matvec(Z, e)
        return of_joint(correction, cov, n) | {
            "mean": belief.mean + correction[..., :n],
            "innovation_cov": S,
            "input_observed": observed,
        }

    def _prior_cov(self, observed: np.ndarray) -> np.ndarray:
        """The prior's share ``(..., q, q)`` in directions of the input that were not observed."""
        return congruence(identity(self.model.q) - observed, self.input_prior)

    def _solved(self, S: Any, b: Any, *inputs: Any) -> tuple[Any, Any]:
        """``S^-1 B``, and the share of the input's prior that is added to a singular S.

        Where S has no variance, the unknown input is measured without noise. There ``S + a F F'``
        replaces S, which gives the same best unbiased estimate (Rao, 1971, Unified theory of linear
        estimation).
        """
        if not rescuing():
            return solve(S, b), 0.0
        F = joined([each @ self._root for each in inputs], -1)
        share = _share(S, F)[..., None, None]
        return solve(S + share * (F @ F.mT), b), share[..., 0]

    def _gain(self, F: np.ndarray, SF: np.ndarray, share: Any) -> tuple[np.ndarray, np.ndarray]:
        """M ``(..., q, p)`` of the estimate ``M e`` of d from ``e = F d + noise``, and a projector.

        F is ``(..., p, q)`` with the rows of missing measurements zero, SF is ``S^-1 F``, and
        ``share`` of the prior is in S. The projector ``(..., q, q)`` is on the directions shown.
        """
        root = self._root
        information = symmetrise(root.T @ (F.mT @ SF) @ root)
        # A row that is lost, and not finite, must not raise: it shows nothing.
        strength, directions = singular(np.where(np.isfinite(information), information, 0.0))
        hidden = (1.0 - (strength > OBSERVABLE / (1.0 + OBSERVABLE * share)))[..., None, :]
        gain = (directions / (strength[..., None, :] + hidden)) @ directions.mT
        unseen = (directions * hidden) @ directions.mT
        observed = identity(self.model.q) - root @ unseen @ self._inverse_root
        return root @ gain @ root.T @ SF.mT, observed

    def _observable_input(self, belief: Any, C: Any, H: Any) -> np.ndarray:
        """F of a measurement in units of the input's prior ``(..., p, k)``, k a multiple of q."""
        return self._effect(belief, C, H)[0] @ self._root

    def log_likelihood(self, predicted: Any, updated: Any) -> np.ndarray:
        """The diffuse log likelihood ``(...)`` of a measurement, integrated over the unknown input.

        In the directions that the measurement shows, the integral has a flat prior in units of d;
        in the others it has the input's prior. So the likelihood does not depend on ``input_prior``
        where a measurement shows all of d.

        Source: de Jong (1991), The diffuse Kalman filter.
        """
        e, S, q = updated.innovation, updated.innovation_cov, self.model.q
        effects = self.expect(predicted, updated.u)[1], self.model.value("H", updated.u)
        C, H = (np.where(updated.available[..., None], each, 0.0) for each in effects)
        observable = self._observable_input(predicted, C, H)
        # S may be singular: a share of the input's prior is added, which the integral takes out
        # again.
        share = _share(S, observable)[..., None]
        S = S + share[..., None] * observable @ observable.mT
        density = super().log_likelihood(predicted, updated.replaced({"innovation_cov": S}))
        precision = pseudo_inverse(S)
        for F in np.split(observable, observable.shape[-1] // q, -1):  # acting now, and a step ago
            values, directions = np.linalg.eigh(symmetrise(F.mT @ precision @ F))
            flat = values > OBSERVABLE / (1.0 + OBSERVABLE * share)
            prior, F = np.where(flat, 1.0, 1.0 - share), F @ directions
            size = np.where(flat, values, 1.0 + prior * np.maximum(values, 0.0)) / prior
            seen = precision @ F
            score = np.vecmat(e, seen)
            volume = congruence((self._root @ directions).mT, identity(q))
            _, volume = np.linalg.slogdet(masked(volume, flat))
            terms = np.square(score) / size - np.log(size * prior) + flat * np.log(2.0 * np.pi)
            density = density + 0.5 * terms.sum(-1) + 0.5 * volume
            precision = precision - (seen / size[..., None, :]) @ seen.mT
        return density


def _share(S: np.ndarray, F: np.ndarray) -> np.ndarray:
    """Factor ``(...)`` of ``F F'``, at most 1/2, that makes it about as large as S."""
    size = np.square(F / equilibrated(S)[0][..., None]).sum((-2, -1))
    return np.minimum(0.5, 1.0 / np.maximum(size, 1e-300))


@compiled
class UMVFilter(UnknownInputFilter):
    """KF-UMV-UI: estimates state and unknown input together; direct feedthrough, rank H = q.

    The input of a step is estimated from the same step's measurement (``input_delay`` 0)::

        Pd = (H' S^-1 H)^-1      M = Pd H' S^-1      d = M e
        x = x- + K (e - H d)     P = P- - K (S - H Pd H') K'     Pxd = -K H Pd
        x-+ = A x + B u + G d    P-+ = [A G] [[P, Pxd], [Pxd', Pd]] [A G]' + Q

    with ``x-+`` and ``P-+`` the next prediction. The code uses the Joseph form, which cannot lose
    definiteness. If a channel drops and the others hardly show a direction of ``d``, that direction
    has the prior N(0, ``input_prior``) for the step. The other channels still correct the state,
    and the next prediction is more uncertain.

    A nonlinear model is linearised as by the extended Kalman filter: A is the Jacobian of f at the
    estimate, C that of h at the prediction, and f gives the mean. What d adds is linear, ``G d``
    and ``H d``; the Jacobians neglect that G may depend on the state.

    Sources: Gillijns & De Moor (2007b), with direct feedthrough; Pan et al. (2010); Hermawan
    (2020), Table 2.5.

    Args:
        model: A model with rank(H) = q; a nonlinear one may give G as a function of ``(x, u)``.
        input_prior: Covariance ``(q, q)`` of the unknown input where a measurement hardly shows it;
            a number stands for that number times identity. Set it to the square of usual inputs.

    Raises:
        ValueError: if the rank condition fails.
    """

    name = "kf-umv-ui"
    record = ObservedInputBelief
    input_delay = 0

    def _check_model(self) -> None:
        if self.model.delayed_feedthrough:
            raise ValueError(
                "UMVFilter takes H d(k) for the input that acts now, but this model has"
                ' delayed_feedthrough: use EndedUMVFilter, which estimators.make("kf-umv-ui",'
                " model) builds of such a model"
            )
        if isinstance(self.model.H, np.ndarray):
            rank = np.linalg.matrix_rank(self.model.H)
            remedy = "measure the input or use ekf-ui-wdf, or kf-umv-ui-wdf if all is linear"
            self._require_rank("rank(H)", rank, remedy)


class DelayedInputFilter(UnknownInputFilter):
    """Base of filters that estimate the unknown input one step late: d(k-1) at k."""

    record: type[Belief] = DelayedInputBelief
    input_delay = 1
    reversible = True

    def _begin(self, mean: np.ndarray, cov: np.ndarray, rng: Any) -> Changes:
        unseen = self._prior_input(mean)
        if self.model.delayed_feedthrough:  # no input has acted yet: d(-1) is known to be 0
            unseen["input_cov"] = np.zeros(unseen["input_cov"].shape)
            unseen["input_observed"] = unseen["input_observed"] + identity(self.model.q)
        return unseen | {
            "pending": np.zeros(mean.shape[:-1], bool),
            "input_matrix": np.zeros(unseen["state_input_cov"].shape),
        }

    def _predict(self, belief: Any, u: Any, mean: Any, A: Any, Q: Any, *more: Any) -> Changes:
        (G,) = more
        return self._prior_input(mean) | {
            "mean": mean,
            "cov": symmetrise(congruence(A, self._covariance(belief)) + Q),
            "pending": np.ones(mean.shape[:-1], bool),
            "input_matrix": G + np.zeros(mean.shape[:-1] + G.shape[-2:]),
        }

    def _update(
        self, belief: Any, u: Any, e: Any, C: Any, R: Any, available: Any, *more: Any
    ) -> Changes:
        updated = super()._update(belief, u, e, C, R, available, *more)
        if self.model.delayed_feedthrough:  # before the first prediction d(-1) stays 0
            acted, q = waiting(belief), self.model.q
            updated["input_cov"] = updated["input_cov"] * acted
            updated["state_input_cov"] = updated["state_input_cov"] * acted
            observed = updated["input_observed"] * acted
            updated["input_observed"] = observed + (1.0 - acted) * identity(q)
        return updated | {"pending": np.zeros(belief.pending.shape, bool)}

    def _was_updated(self, belief: Any) -> bool:
        # An update without measurements leaves the input to its prior, which has moved the state.
        known = ~belief.pending & belief.healthy  # a lost prediction leaves what was before it
        open_input = known & belief.state_input_cov.any((-2, -1))
        return super()._was_updated(belief) or bool(open_input.any())

    def _effect(self, belief: Any, C: Any, H: Any) -> tuple[Any, Any]:
        drive = belief.input_matrix * waiting(belief)
        F = C @ belief.input_matrix
        return (F + H if self.model.delayed_feedthrough else F) * waiting(belief), drive

    def _covariance(self, belief: Any) -> np.ndarray:
        """The state's covariance, including an unknown input that no measurement has shown.

        This is the input of an earlier prediction that no measurement followed.
        """
        open_input = congruence(belief.input_matrix, self._prior_cov(belief.input_observed))
        return belief.cov + open_input * waiting(belief)


def waiting(belief: DelayedInputBelief) -> np.ndarray:
    """The belief's ``pending`` as ``(..., 1, 1)``."""
    return belief.pending[..., None, None]


class NoFeedthroughFilter(DelayedInputFilter):
    """Base of filters without d(k) in measurement k: H is 0, or feeds d(k-1) through."""

    def _check_model(self) -> None:
        model = self.model
        if not model.delayed_feedthrough and (callable(model.H) or np.any(model.H)):
            raise ValueError(f"{self.name} needs H = 0 (no feedthrough): use kf-umv-ui or ulise")
        C, H, G = getattr(model, "C", None), model.H, cast(Any, model.G)
        rank: Any = min(model.p, model.q)  # of a C G that changes, at most
        if not callable(G) and isinstance(H, np.ndarray):
            if isinstance(C, np.ndarray):
                rank = np.linalg.matrix_rank(C @ G + H)
            elif not H.any():
                rank = np.minimum(rank, np.linalg.matrix_rank(G))
        condition = f"rank(C G{' + H' * model.delayed_feedthrough})"
        self._require_rank(condition, rank, "measure a state that each input drives directly")


@compiled
class ExtendedUMVFilter(NoFeedthroughFilter):
    """EKF-UI-WDF (without direct feedthrough): the unknown input shows in the next measurement.

    With C the measurement's Jacobian at the prediction and ``G = df/dd`` at the estimate before it,
    step k estimates d(k-1) (``input_delay`` 1)::

        F = C G      Pd = (F' S^-1 F)^-1      M = Pd F' S^-1      d(k-1) = M e
        L = K + (I - K C) G M      P = (I - L C) P- (I - L C)' + L R L'
        x = x- + L e      x-+ = f(x, u)      P-+ = A P A' + Q

    with ``x-+`` and ``P-+`` the next prediction. The first update after ``init`` has no d(k-1) and
    is a Kalman update. Where a measurement hardly shows a direction of ``d``, because a channel
    dropped or C G lost rank at this state, that direction has the prior N(0, ``input_prior``) for
    that step. Jacobians are taken at a prediction without d(k-1): its effect on them within the
    step is neglected.

    With ``delayed_feedthrough`` the measurement also contains d(k-1) directly: ``F = C G + H``.

    Sources: Kitanidis (1987); Gillijns & De Moor (2007a) and Pan et al. (2010), both without direct
    feedthrough.

    Args:
        model: A model with H = 0 and rank(C G) = q, or with ``delayed_feedthrough`` and rank(C G +
            H) = q; a nonlinear one may give G as a function of ``(x, u)``.
        input_prior: Covariance ``(q, q)`` of the unknown input where a measurement hardly shows it;
            a number stands for that number times identity. Set it to the square of usual inputs.

    Raises:
        ValueError: if H feeds d(k) through, or the rank condition cannot hold.
    """

    name = "ekf-ui-wdf"


@compiled
class EndedUMVFilter(ExtendedUMVFilter):
    """KF-UMV-UI of a model with ``delayed_feedthrough``: H feeds through the last step's input.

    The input d(k-1) has moved the state x(k) through G before the measurement of step k shows it,
    through C and H::

        x(k) = A x(k-1) + B u(k-1) + G d(k-1) + w
        y(k) = C x(k) + H d(k-1) + v(k)      F = C G + H

    With this F the formulas are those of `ExtendedUMVFilter`; the belief is about x(k), which
    d(k-1) has already moved. The filter equals `UMVFilter` on the equivalent model of ``x' = x - G
    d(k-1)``, with ``G' = A G`` and ``H' = C G + H``.

    Sources: Gillijns & De Moor (2007b), with direct feedthrough; Kitanidis (1987).

    Args:
        model: A model with rank(C G + H) = q; a nonlinear one may give G as a function of ``(x,
            u)``.
        input_prior: Covariance ``(q, q)`` of the unknown input where a measurement hardly shows it;
            a number stands for that number times identity. Set it to the square of usual inputs.

    Raises:
        ValueError: if the model feeds d(k) through, or the rank condition cannot hold.
    """

    name = "kf-umv-ui"


@compiled
class DelayedUMVFilter(NoFeedthroughFilter):
    """KF-UMV-UI-WDF: unbiased, minimum variance, for linear models without direct feedthrough.

    The formulas are those of `ExtendedUMVFilter` with the next prediction ``x-+ = A x + B u``, and
    are exact here.

    Sources: Kitanidis (1987); Darouach & Zasadzinski (1997); Gillijns & De Moor (2007a), without
    direct feedthrough.

    Args:
        model: A `LinearModel` with H = 0 and rank(C G) = q.
        input_prior: Covariance ``(q, q)`` of the unknown input where a measurement hardly shows it.

    Raises:
        ValueError: if H feeds d(k) through, or the rank condition fails.
    """

    name = "kf-umv-ui-wdf"
    linear = True
