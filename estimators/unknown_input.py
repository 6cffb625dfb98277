"""Unbiased minimum-variance filters that estimate an unknown input together with the state."""

from typing import Any, ClassVar, TypeVar, cast

import numpy as np

from estimators.belief import Belief, DelayedInputBelief, InputBelief
from estimators.engine.matrices import is_traced
from estimators.filter import Model, Rng
from estimators.kalman import (
    GaussianFilter,
    driven_on,
    input_covariance,
    joseph_update,
    unseen_input,
    with_input,
)
from estimators.linalg import (
    congruence,
    equilibrated,
    identity,
    joined,
    lacks_rank,
    masked,
    pseudo_inverse,
    singular,
    solve,
    symmetrise,
)
from estimators.measurement import Measurement
from estimators.models import LinearModel

WithInput = TypeVar("WithInput", bound=InputBelief)
Delayed = TypeVar("Delayed", bound=DelayedInputBelief)


class UnknownInputFilter(GaussianFilter[WithInput], verified=True):
    """Base of filters with and without feedthrough: the input's prior and its directions observable in a measurement.

    With ``input_prior = W W'`` and ``e = F d`` and noise of covariance S, the eigenvalues of ``W'
    F' S^-1 F W`` are the prior variances of as many directions of ``d``, over those that the
    measurement alone leaves them. Directions where this exceeds `OBSERVABLE` are estimated without
    bias, the others from N(0, ``input_prior``), as by a Kalman filter: their effect on the
    measurement is noise. The belief's ``input_observed`` is the projector on the former.
    """

    likelihood = "diffuse"
    reversible = True
    linear: ClassVar[bool] = False
    """The filter needs a `LinearModel`."""

    def __init__(self, model: Model, input_prior: np.ndarray | float = 1.0) -> None:
        super().__init__(model)
        if self.linear and not isinstance(model, LinearModel):
            raise ValueError(
                f"{self.name} needs a LinearModel: for a nonlinear one use kf-umv-ui, without"
                " feedthrough ekf-ui-wdf or ukf-umv"
            )
        if model.q == 0:
            raise ValueError(f"{self.name} needs an unknown input: give the model G, H or both")
        self.input_prior = input_covariance("input_prior", input_prior, model.q)
        try:
            self._root = np.linalg.cholesky(self.input_prior)
        except np.linalg.LinAlgError:
            raise ValueError(
                "input_prior must be positive definite: an input without variance is no input"
            ) from None
        self._inverse_root = np.linalg.inv(self._root)

    def _unseen(self, mean: np.ndarray) -> dict[str, Any]:
        unseen = unseen_input(mean, self.input_prior)
        return unseen | {"input_observed": np.zeros(unseen["input_cov"].shape)}

    def _open(self, observed: np.ndarray) -> np.ndarray:
        """The prior's share ``(..., q, q)`` in directions of the input that were not ``observed (..., q, q)``."""
        return congruence(identity(self.model.q) - observed, self.input_prior)

    def _observable_input(self, belief: WithInput, measurement: Measurement) -> np.ndarray | None:
        """F of the first measurement of a step, in units of the input's prior; to later ones the prior is noise."""
        return (
            self._observable(belief, measurement) @ self._root
            if belief.innovation is None
            else None
        )

    def _moved(self, belief: WithInput, u: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        return driven_on(self.model, belief, u)

    def _observable(self, belief: WithInput, measurement: Measurement) -> np.ndarray:
        """F ``(..., p, q)`` of the first measurement of a step."""
        return measurement.H

    def _drive(self, belief: WithInput) -> np.ndarray:
        """G ``(..., n, q)`` by which the input in that measurement has moved the predicted state."""
        return np.zeros((self.model.n, self.model.q))

    def _update(self, belief: WithInput, measurement: Measurement, rng: Rng) -> WithInput:
        n = self.model.n
        correction, cov, observed, S = self._estimated(belief, measurement)
        own = {
            "input_mean": correction[..., n:],
            "input_cov": cov[..., n:, n:],
            "state_input_cov": cov[..., :n, n:],
        }
        mean, own["input_observed"] = belief.mean + correction[..., :n], observed
        updated = self.record.updated(
            belief, mean, cov[..., :n, :n], measurement, S, **own, **self._met(belief)
        )
        return cast(WithInput, updated)

    def _met(self, belief: WithInput) -> dict[str, Any]:
        """The record's arrays after an update, besides those of the input."""
        return {}

    def log_likelihood(self, predicted: WithInput, updated: WithInput) -> np.ndarray:
        """The diffuse log likelihood ``(...)`` of a measurement: that of `Filter`, integrated over the unknown input.

        Over all values alike in the directions that the measurement shows, in units of d, and over
        the input's prior in the others. So it does not depend on ``input_prior`` where a
        measurement shows all of d.

        Source: de Jong (1991), The diffuse Kalman filter.
        """
        e, S, available, q = (
            updated.innovation,
            updated.innovation_cov,
            updated.available,
            self.model.q,
        )
        assert e is not None
        assert S is not None
        measurement = self._measurement(predicted, np.zeros(e.shape), available, None)
        observable = self._observable_input(predicted, measurement)
        if observable is None:  # a later measurement of the step, in whose S the prior is
            assert predicted.input_observed is not None
            root = self._inverse_root.T @ (
                identity(q) - self._inverse_root @ predicted.input_observed @ self._root
            )
            observable = (
                joined([measurement.C, measurement.H], -1) @ self._joint(predicted)[..., -q:] @ root
            )
            S = symmetrise(S - observable @ observable.mT)
        observable = np.broadcast_to(observable, (*e.shape, observable.shape[-1]))
        # Where S is singular a share of the input's prior is added, which the integral takes out
        # again.
        size = np.square(observable / equilibrated(S)[0][..., None]).sum((-2, -1))
        share = np.where(lacks_rank(S) & (size > 0.0), 1.0 / np.where(size > 0.0, size, 1.0), 0.0)[
            ..., None
        ]
        S = S + share[..., None] * observable @ observable.mT
        density = super().log_likelihood(predicted, updated.replace(innovation_cov=S))
        precision = pseudo_inverse(S)
        for F in np.split(
            observable, observable.shape[-1] // q, -1
        ):  # what acts now, then what acted a step before
            values, directions = np.linalg.eigh(symmetrise(F.mT @ precision @ F))
            flat = values > OBSERVABLE / (1.0 + OBSERVABLE * share)
            prior, F = np.where(flat, 1.0, 1.0 - share), F @ directions
            size = np.where(flat, values, 1.0 + prior * np.maximum(values, 0.0)) / prior
            seen = precision @ F
            score = np.vecmat(e, seen)
            volume = congruence((self._root @ directions).mT, identity(q))
            _, volume = np.linalg.slogdet(masked(volume, flat))
            density = density + 0.5 * (
                np.square(score) / size - np.log(size * prior) + flat * np.log(2.0 * np.pi)
            ).sum(-1)
            density, precision = (
                density + 0.5 * volume,
                precision - (seen / size[..., None, :]) @ seen.mT,
            )
        return density

    def _solved(
        self, belief: WithInput, measurement: Measurement, S: np.ndarray, b: np.ndarray
    ) -> np.ndarray:
        """``S^-1 B``; where S is singular with a share of the prior in it, see `estimators.recovery.condensed`."""
        if measurement.spread is None:
            return solve(S, b)
        F = self._observable_input(belief, measurement)
        assert F is not None
        return solve(S + measurement.spread * (F @ F.mT), b)

    def _gain(
        self, F: np.ndarray, SF: np.ndarray, measurement: Measurement
    ) -> tuple[np.ndarray, np.ndarray]:
        """M ``(..., q, p)`` of the estimate ``M e`` of d from ``e = F d`` and noise of covariance S, and a projector.

        F is ``(..., p, q)`` with the rows of missing measurements zero, SF is ``S^-1 F``; the
        measurement tells the share of the prior that is in S. The projector ``(..., q, q)`` is on
        the directions shown.
        """
        root, share = self._root, 0.0 if measurement.spread is None else measurement.spread[..., 0]
        information = symmetrise(root.T @ (F.mT @ SF) @ root)
        # A row that is lost, and not finite, must not raise: it shows nothing.
        strength, directions = singular(np.where(np.isfinite(information), information, 0.0))
        hidden = (1.0 - (strength > OBSERVABLE / (1.0 + OBSERVABLE * share)))[..., None, :]
        gain = (directions / (strength[..., None, :] + hidden)) @ directions.mT
        unseen = (directions * hidden) @ directions.mT
        return (
            root @ gain @ root.T @ SF.mT,
            identity(self.model.q) - root @ unseen @ self._inverse_root,
        )

    def _joint(self, belief: WithInput) -> np.ndarray:
        """The covariance ``(..., n + q, n + q)`` of state and input, with the input's prior where none was shown."""
        return with_input(belief)[1]

    def _estimated(
        self, belief: WithInput, measurement: Measurement
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """State and input together, of ``x = x- + G d`` and ``e = C x~- + F d + v``.

        Returns:
            The correction ``(..., n + q)`` of (x-, 0), the covariance of (x, d), the directions
            observed, and S.
        """
        if belief.innovation is not None:
            return self._revised(belief, measurement)
        C, R, n, q = measurement.C, measurement.R, self.model.n, self.model.q
        F, G = self._observable(belief, measurement), self._drive(belief)
        CP = C @ belief.cov
        S = CP @ C.mT + R
        solved = self._solved(belief, measurement, S, joined([CP, F], -1))
        K, (M, observed) = solved[..., :n].mT, self._gain(F, solved[..., n:], measurement)
        Z = joined([K + (G - K @ F) @ M, M], -2)  # (x, d) = (x-, 0) + Z e
        # Errors: x~ = x~- + G d - Z e and d~ = d - Z e. Where d is seen its share cancels,
        # elsewhere it has its prior.
        reach = joined([G, identity(q)], -2) - Z @ F
        cov = congruence(np.eye(n + q, n) - Z @ C, belief.cov) + congruence(Z, R)
        cov = symmetrise(cov + congruence(reach, self._open(observed)))
        return np.matvec(Z, measurement.innovation), cov, observed, S

    def _revised(
        self, belief: WithInput, measurement: Measurement
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The same after earlier measurements of the step: their information on d and that of this one add up.

        It is a Kalman update of state and input together, of covariance J, in which the prior
        counts where measurements had not shown d. N has ``1 / (1 + strength)`` of each direction.
        Where all measurements together show other directions, the prior's information changes by T,
        and with it what was estimated::

            D = (J_dd^-1 + T)^-1      L = J_d (I - T D)      z <- z - L T d      J <- J - L T J_d'
        """
        n, q, root, inverse_root = self.model.n, self.model.q, self._root, self._inverse_root
        before = belief.input_observed
        assert before is not None
        z = joined([np.zeros((n, 1)), belief.input_mean[..., None]], -2)[..., 0]
        seen = joined([measurement.C, measurement.H], -1)
        z, joint, S = joseph_update(
            z, self._joint(belief), measurement.innovation, seen, measurement.R
        )
        M, observable = congruence(inverse_root, joint[..., n:, n:]), inverse_root @ before @ root
        MP = M @ observable
        N = symmetrise(M - MP @ solve(identity(q) + observable @ MP, MP.mT))
        values, directions = singular(np.where(np.isfinite(N), N, 0.0))
        hidden = (1.0 - (values * (1.0 + OBSERVABLE) < 1.0))[..., None, :]
        values = values[..., None, :]
        D = (
            root
            @ (directions * (values / (1.0 - (1.0 - hidden) * values)))
            @ directions.mT
            @ root.T
        )
        observed = identity(q) - root @ (directions * hidden) @ directions.mT @ inverse_root
        T = inverse_root.T @ inverse_root @ (before - observed)
        L = joint[..., n:] - joint[..., n:] @ T @ D
        z = z - np.matvec(L @ T, z[..., n:])
        return z, symmetrise(joint - L @ T @ joint[..., n:, :]), observed, S


OBSERVABLE = 0.1
"""A direction of the input is observable where its prior has more than this share of the variance that is left."""


class UMVFilter(UnknownInputFilter[InputBelief], verified=True):
    """KF-UMV-UI: state and unknown input together, with direct feedthrough (rank H = q).

    The input of a step is estimated from the same step's measurement (``input_delay`` 0)::

        Pd = (H' S^-1 H)^-1      M = Pd H' S^-1      d = M e
        x = x- + K (e - H d)     P = P- - K (S - H Pd H') K'      Pxd = -K H Pd
        x-+ = A x + B u + G d    P-+ = [A G] [[P, Pxd], [Pxd', Pd]] [A G]' + Q

    computed in the equivalent Joseph form, which cannot lose definiteness. When a channel drops so
    that the others hardly show a direction of ``d``, it has the prior N(0, ``input_prior``) for
    that step: the state is corrected by the channels that remain and the next prediction is the
    more uncertain.

    A nonlinear model is linearised as by the extended Kalman filter: A is the Jacobian of f at the
    estimate, C that of h at the prediction, and f gives the mean. What d adds is linear, ``G d``
    and ``H d``: how a G that is a function of the state bends it is neglected.

    Sources: Gillijns & De Moor (2007b); Pan et al. (2010); Hermawan (2020), Table 2.5.

    Args:
        model: A model with rank(H) = q; a nonlinear one may give G as a function of ``(x, u)``.
        input_prior: Covariance ``(q, q)`` of the unknown input where a measurement hardly shows it;
            a number stands for that number times identity. Its scale is the problem's: set it.

    Raises:
        ValueError: if the rank condition fails.
    """

    name = "kf-umv-ui"
    record = InputBelief
    input_delay = 0

    def __init__(self, model: Model, input_prior: np.ndarray | float = 1.0) -> None:
        super().__init__(model, input_prior)
        self.idle = np.array_equal(
            self._root @ self._inverse_root, np.eye(model.q)
        )  # else the prior is rounded
        if model.delayed_feedthrough:
            raise ValueError(
                "UMVFilter takes H d(k) for the input that acts now, but this model has"
                ' delayed_feedthrough: use EndedUMVFilter, which estimators.make("kf-umv-ui",'
                " model) builds of such a model"
            )
        if isinstance(model.H, np.ndarray):
            rank = int(np.linalg.matrix_rank(model.H).min())
            if rank < model.q:
                late = "kf-umv-ui-wdf" if isinstance(model, LinearModel) else "ekf-ui-wdf"
                raise ValueError(
                    f"kf-umv-ui needs rank(H) = {model.q} unknown"
                    f" input{'s' if model.q > 1 else ''}, got {rank}: measure the input or use"
                    f" {late}"
                )


class DelayedInputFilter(UnknownInputFilter[Delayed], verified=True):
    """Base of filters that estimate the unknown input one step late: d(k-1) at k."""

    record: type[Belief] = DelayedInputBelief
    input_delay = 1

    def __init__(self, model: Model, input_prior: np.ndarray | float = 1.0) -> None:
        super().__init__(model, input_prior)
        self._G = model.G if isinstance(model.G, np.ndarray) else np.zeros((model.n, model.q))

    def _unseen(self, mean: np.ndarray) -> dict[str, Any]:
        unseen = super()._unseen(mean)
        G = np.zeros(unseen["state_input_cov"].shape) if callable(self.model.G) else None
        if (
            self.model.delayed_feedthrough
        ):  # nothing has acted that a measurement could contain: d(-1) is known to be 0
            unseen["input_cov"] = np.zeros(unseen["input_cov"].shape)
            unseen["input_observed"] = unseen["input_observed"] + identity(self.model.q)
        return unseen | {"pending": np.zeros(mean.shape[:-1], bool), "input_matrix": G}

    def _own(self, before: Delayed, mean: np.ndarray, u: np.ndarray | None) -> dict[str, Any]:
        G = self._asked("_moving_G", before, u) if callable(self.model.G) else None
        return super()._unseen(mean) | {
            "pending": np.ones(mean.shape[:-1], bool),
            "input_matrix": G,
        }

    def _met(self, belief: Delayed) -> dict[str, Any]:
        return {
            "pending": np.zeros(belief.pending.shape, bool),
            "input_matrix": belief.input_matrix,
        }

    def _estimated(
        self, belief: Delayed, measurement: Measurement
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        correction, cov, observed, S = super()._estimated(belief, measurement)
        if belief.innovation is not None or not self.model.delayed_feedthrough:
            return correction, cov, observed, S
        n, q, acted = (
            self.model.n,
            self.model.q,
            waiting(belief),
        )  # before the first prediction d(-1) stays 0
        of_state = np.concatenate([np.ones(n), np.zeros(q)])
        kept = acted + (1.0 - acted) * np.outer(of_state, of_state)
        return correction, cov * kept, observed * acted + (1.0 - acted) * identity(q), S

    def _input_matrix(self, belief: Delayed) -> np.ndarray:
        """G of the last prediction ``(..., n, q)``."""
        return self._G if belief.input_matrix is None else belief.input_matrix

    def _drive(self, belief: Delayed) -> np.ndarray:
        return self._input_matrix(belief) * waiting(belief)

    def _observable(self, belief: Delayed, measurement: Measurement) -> np.ndarray:
        driven = measurement.C @ self._input_matrix(belief)
        return (driven + measurement.H if self.model.delayed_feedthrough else driven) * waiting(
            belief
        )

    def _joint(self, belief: Delayed) -> np.ndarray:
        n, q = self.model.n, self.model.q
        drive = joined([joined([identity(n), self._drive(belief)], -1), np.eye(q, n + q, n)], -2)
        return congruence(drive, super()._joint(belief))

    def _moving_G(self, belief: Belief, u: np.ndarray | None) -> np.ndarray | None:
        """G of a prediction, where it changes."""
        G = self.model.input_matrix(belief.mean, u)
        return G if is_traced(G) else np.broadcast_to(G, belief.mean.shape[:-1] + G.shape[-2:])

    def _covariance(self, belief: Delayed) -> np.ndarray:
        """The state's covariance, with the input that an earlier prediction left open if no measurement followed."""
        return belief.cov + congruence(
            self._input_matrix(belief), self._open(belief.input_observed)
        ) * waiting(belief)


def waiting(belief: DelayedInputBelief) -> np.ndarray:
    """The belief's ``pending`` as ``(..., 1, 1)``."""
    return belief.pending[..., None, None]


class NoFeedthroughFilter(DelayedInputFilter[DelayedInputBelief], verified=True):
    """Base of filters that know nothing of d(k) at k: H is 0, or feeds d(k-1) through (``delayed_feedthrough``).

    Each says how it linearises a nonlinear model.
    """

    reversible = True

    def __init__(self, model: Model, input_prior: np.ndarray | float = 1.0) -> None:
        super().__init__(model, input_prior)
        if not model.delayed_feedthrough and (callable(model.H) or np.any(model.H)):
            raise ValueError(f"{self.name} needs H = 0 (no feedthrough): use kf-umv-ui or ulise")
        C, H, changes = getattr(model, "C", None), model.H, callable(model.G)
        if constant := isinstance(C, np.ndarray) and isinstance(H, np.ndarray) and not changes:
            rank = int(np.linalg.matrix_rank(C @ self._G + H).min())
        elif changes or callable(H) or np.any(H):
            rank = min(model.p, model.q)
        else:  # C G changes, but is never of higher rank than this
            rank = min(model.p, int(np.linalg.matrix_rank(self._G).min()))
        if rank < model.q:
            condition = "C G + H" if model.delayed_feedthrough else "C G"
            raise ValueError(
                f"{self.name} needs rank({condition}) = {model.q} unknown"
                f" input{'s' if model.q > 1 else ''}, got {'' if constant else 'at most '}{rank}:"
                " measure a state that each input drives directly"
            )

    def _moved(
        self, belief: DelayedInputBelief, u: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        return self._propagate(belief.mean, self._covariance(belief), u)


class ExtendedUMVFilter(NoFeedthroughFilter, verified=True):
    """EKF-UI-WDF: the unknown input acts on the state only, and shows in the next measurement.

    With C the measurement's Jacobian at the prediction and ``G = df/dd`` at the estimate before it,
    step k estimates d(k-1) (``input_delay`` 1)::

        F = C G     Pd = (F' S^-1 F)^-1     M = Pd F' S^-1     d(k-1) = M e     L = K + (I - K C) G M
        x = x- + L e      P = (I - L C) P- (I - L C)' + L R L'      x-+ = f(x, u)      P-+ = A P A' + Q

    The first update after ``init`` has no d(k-1): it is a Kalman update. Where a measurement hardly
    shows a direction of ``d``, because a channel dropped or C G lost rank at this state, that
    direction has the prior N(0, ``input_prior``) for that step. Jacobians are taken at a prediction
    that knows nothing of d(k-1): what an input does to them within one step is neglected.

    With ``delayed_feedthrough`` the measurement contains d(k-1) besides: ``F = C G + H``.

    Sources: Kitanidis (1987); Gillijns & De Moor (2007a); Pan et al. (2010), the extended filter
    without feedthrough.

    Args:
        model: A model with H = 0 and rank(C G) = q, or with ``delayed_feedthrough`` and rank(C G +
            H) = q; a nonlinear one may give G as a function of ``(x, u)``.
        input_prior: Covariance ``(q, q)`` of the unknown input where a measurement hardly shows it;
            a number stands for that number times identity. Its scale is the problem's: set it.

    Raises:
        ValueError: if H is not zero or the rank condition cannot hold.
    """

    name = "ekf-ui-wdf"


class EndedUMVFilter(ExtendedUMVFilter, verified=True):
    """KF-UMV-UI of a model whose H feeds through the input of the step that has ended (``delayed_feedthrough``).

    The input d(k-1) has moved the state x(k) through G before the measurement of step k shows it,
    through C and H::

        x(k) = A x(k-1) + B u(k-1) + G d(k-1) + w      y(k) = C x(k) + H d(k-1) + v(k)      F = C G + H

    With F the formulas are those of `ExtendedUMVFilter`, so that the belief is about x(k) with the
    input in it. It is `UMVFilter` on the equivalent model of ``x' = x - G d(k-1)``, with ``G' = A
    G`` and ``H' = C G + H``: see `estimators.input_delayed`.

    Sources: Gillijns & De Moor (2007b); Kitanidis (1987).

    Args:
        model: A model with rank(C G + H) = q; a nonlinear one may give G as a function of ``(x,
            u)``.
        input_prior: Covariance ``(q, q)`` of the unknown input where a measurement hardly shows it;
            a number stands for that number times identity. Its scale is the problem's: set it.

    Raises:
        ValueError: if the model feeds d(k) through, or the rank condition cannot hold.
    """

    name = "kf-umv-ui"


class DelayedUMVFilter(NoFeedthroughFilter, verified=True):
    """KF-UMV-UI-WDF: unbiased and of minimum variance for a linear model without feedthrough (rank C G = q).

    The formulas of `ExtendedUMVFilter`, exact here, with ``x-+ = A x + B u``.

    Sources: Kitanidis (1987); Darouach & Zasadzinski (1997); Gillijns & De Moor (2007a).

    Args:
        model: A `LinearModel` with H = 0 and rank(C G) = q.
        input_prior: Covariance ``(q, q)`` of the unknown input where a measurement hardly shows it.

    Raises:
        ValueError: if H is not zero or the rank condition fails.
    """

    name = "kf-umv-ui-wdf"
    linear = True
