"""The Kalman filter and the extended Kalman filter, in Joseph form."""

from typing import Any, ClassVar, cast

import numpy as np

from estimators.angles import difference
from estimators.belief import Belief, InputBelief, Record
from estimators.checks import as_array, frozen
from estimators.filter import Filter, Model, Rng
from estimators.linalg import congruence, identity, joined, solve, symmetric_blocks, symmetrise
from estimators.measurement import Measurement
from estimators.model_checks import as_covariance
from estimators.models import LinearModel
from estimators.varying import resolve


class GaussianFilter(Filter[Record], verified=True):
    """Base of filters whose belief is a mean and a covariance: a linearised model and the Kalman update.

    The model says how it is linearised (a matrix, a Jacobian at the mean), or a mix-in does
    (`SigmaPoints`). An unknown input in the model is ignored.
    """

    formulas = True
    reversible: ClassVar[bool] = True
    """Can `smooth` go back through the steps? A class that overrides one says so again."""

    def _init(self, belief: Belief, rng: Rng) -> Record:
        own = self._unseen(belief.mean)
        return cast(Record, self.record.of(belief, **own) if own else belief)

    def _unseen(self, mean: np.ndarray) -> dict[str, Any]:
        """The record's own arrays, beside this mean, before any measurement."""
        return {}

    def _predict(self, belief: Record, u: np.ndarray | None, rng: Rng) -> Record:
        mean, cov = self._asked("_moved", belief, u)
        cov = symmetrise(cov + resolve(self.model.Q, u))
        own = self._own(belief, mean, u)
        record = self.record if own else Belief  # a record of one's own takes the rest from there
        return cast(Record, record.predicted(belief, mean, cov, u, **own))

    def _own(self, before: Record, mean: np.ndarray, u: np.ndarray | None) -> dict[str, Any]:
        """The record's own arrays after a prediction to this mean."""
        return self._unseen(mean)

    def _measurement(
        self, belief: Record, y: np.ndarray, available: np.ndarray | None, R: np.ndarray | None
    ) -> Measurement:
        measurement = super()._measurement(belief, y, available, R)
        if belief.innovation is None or not isinstance(belief, InputBelief):
            return measurement
        expected = np.matvec(
            measurement.H, belief.input_mean
        )  # by earlier measurements of the step
        innovation = difference(measurement.innovation, expected, self.model.measurement_angles)
        return measurement._replace(innovation=innovation)

    def _update(self, belief: Record, measurement: Measurement, rng: Rng) -> Record:
        mean, cov, S = joseph_update(
            belief.mean, belief.cov, measurement.innovation, measurement.C, measurement.R
        )
        return cast(Record, Belief.updated(belief, mean, cov, measurement, S))


def joseph_update(
    mean: np.ndarray, cov: np.ndarray, innovation: np.ndarray, C: np.ndarray, R: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The Kalman update in Joseph form.

    Args:
        mean: ``(..., n)`` prediction.
        cov: ``(..., n, n)`` its covariance.
        innovation: ``(..., p)``.
        C: ``(..., p, n)``.
        R: ``(..., p, p)``.

    Returns:
        The mean ``(..., n)`` and covariance ``(..., n, n)`` after the measurement, and S ``(..., p,
        p)``.
    """
    PC = cov @ C.mT
    S = C @ PC + R
    K = solve(S, PC.mT).mT
    left = congruence(identity(mean.shape[-1]) - K @ C, cov)
    return mean + np.matvec(K, innovation), symmetrise(left + congruence(K, R)), S


class ExtendedKalmanFilter(GaussianFilter[Belief], verified=True):
    """Linearises the model at the mean; on a linear model it is the Kalman filter exactly.

    Jacobians that the model does not give are exact for functions that can be traced, and by
    central differences for others. An unknown input in the model is ignored.

    Source: Jazwinski (1970), Stochastic Processes and Filtering Theory, ch. 8.
    """

    name = "ekf"
    idle = True


class KalmanFilter(GaussianFilter[Belief], verified=True):
    """The minimum-variance filter of a linear Gaussian model.

    An unknown input ``d`` in the model is ignored unless its covariance D is told. It is then white
    noise that acts on the measurement through H and on the next state through G, and is estimated
    with the state (``input_delay`` 0)::

        S = C P- C' + H D H' + R      [x; d] = [x-; 0] + [P- C'; D H'] S^-1 e
        x-+ = A x + B u + G d         P-+ = [A G] cov(x, d) [A G]' + Q

    so that what the measurement shows of d is not forgotten in the prediction. `kf-umv-ui` is the
    limit of a D that grows without bound. With ``delayed_feedthrough`` the measurement contains
    d(k-1), which has moved the prediction::

        x-+ = A x + B u      P-+ = A P A' + G D G' + Q      cov(x-+, d) = G D      (``input_delay`` 1)

    Source: Kalman (1960); covariance update in Joseph form; Anderson & Moore (1979), Optimal
    Filtering, sec. 5.4, for noises of process and measurement that are correlated.

    Args:
        model: A `LinearModel`.
        input_cov: ``(q, q)`` covariance D of the unknown input, or None to ignore the input; a
            number stands for that number times identity.

    Raises:
        ValueError: if the model is nonlinear, or ``input_cov`` does not fit its unknown inputs.
    """

    name = "kf"
    idle = True
    likelihood = "exact"
    reversible = True
    model: LinearModel

    def __init__(self, model: Model, input_cov: np.ndarray | float | None = None) -> None:
        super().__init__(model)
        if not isinstance(model, LinearModel):
            raise ValueError("kf needs a LinearModel: use ekf for a nonlinear one")
        if input_cov is not None and model.q == 0:
            raise ValueError(
                "input_cov was given, but the model has no unknown input (G and H are missing)"
            )
        self.input_cov = (
            None if input_cov is None else input_covariance("input_cov", input_cov, model.q)
        )
        if self.input_cov is not None:
            self.input_delay, self.record = int(model.delayed_feedthrough), InputBelief

    def _unseen(self, mean: np.ndarray) -> dict[str, Any]:
        if self.input_cov is None:
            return {}
        # Before the first step nothing has acted that a delayed feedthrough could show.
        return unseen_input(
            mean, np.zeros(self.input_cov.shape) if self.input_delay else self.input_cov
        )

    def _own(self, before: Belief, mean: np.ndarray, u: np.ndarray | None) -> dict[str, Any]:
        if self.input_cov is None or not self.input_delay:
            return self._unseen(mean)
        unseen = unseen_input(mean, self.input_cov)
        driven = self.model.input_matrix(before.mean, u) @ self.input_cov
        return unseen | {"state_input_cov": unseen["state_input_cov"] + driven}

    def _input_matrix(self, belief: Belief) -> np.ndarray:
        """G of the last prediction ``(..., n, q)``."""
        return self.model.input_matrix(belief.mean, belief.u)

    def _moved(self, belief: Belief, u: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        if self.input_cov is None or not isinstance(belief, InputBelief):
            return super()._moved(belief, u)
        if not self.input_delay:
            return driven_on(self.model, belief, u)
        mean, cov = super()._moved(belief, u)
        return mean, cov + congruence(self.model.input_matrix(belief.mean, u), self.input_cov)

    def _update(self, belief: Belief, measurement: Measurement, rng: Rng) -> Belief:
        if self.input_cov is None:
            return super()._update(belief, measurement, rng)
        n, q = self.model.n, self.model.q
        if belief.innovation is not None:
            mean, joint = with_input(belief)
        else:  # d(k), of which nothing is known but D, or d(k-1), which has moved the state
            assert isinstance(belief, InputBelief)
            driven = belief.state_input_cov if self.input_delay else np.zeros((n, q))
            joint = symmetric_blocks(
                belief.cov, driven, belief.input_cov if self.input_delay else self.input_cov
            )
            mean = joined([belief.mean[..., None], np.zeros((q, 1))], -2)[..., 0]
        seen = joined([measurement.C, measurement.H], -1)
        mean, cov, S = joseph_update(mean, joint, measurement.innovation, seen, measurement.R)
        return InputBelief.updated(
            belief, mean[..., :n], cov[..., :n, :n], measurement, S,
            input_mean=mean[..., n:], input_cov=cov[..., n:, n:], state_input_cov=cov[..., :n, n:],
        )  # fmt: skip


def with_input(belief: Belief) -> tuple[np.ndarray, np.ndarray]:
    """Mean ``(..., k)`` and covariance ``(..., k, k)`` of the state, and of the unknown input if there is one."""
    if not isinstance(belief, InputBelief):
        return belief.mean, belief.cov
    cov = symmetric_blocks(belief.cov, belief.state_input_cov, belief.input_cov)
    return np.concatenate([belief.mean, belief.input_mean], -1), cov


def driven_on(
    model: Model, belief: InputBelief, u: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance one step on, without process noise, where the estimated input drives a model."""
    mean, A = model.linearise_transition(belief.mean, u, belief.cov)
    G = model.input_matrix(belief.mean, u)
    half = (
        2.0 * (A @ belief.state_input_cov) + G @ belief.input_cov
    )  # one term of two, doubled: to be symmetrised
    return mean + np.matvec(G, belief.input_mean), congruence(A, belief.cov) + half @ G.mT


def unseen_input(mean: np.ndarray, input_cov: np.ndarray) -> dict[str, np.ndarray]:
    """The own arrays of an `InputBelief` beside this mean, for an input of which only the covariance is known."""
    n, q, rows = mean.shape[-1], input_cov.shape[-1], mean.shape[:-1]
    return {
        "input_mean": np.zeros(rows + (q,)),
        "input_cov": np.zeros(rows + (q, q)) + input_cov,
        "state_input_cov": np.zeros(rows + (n, q)),
    }


def input_covariance(name: str, value: np.ndarray | float, q: int) -> np.ndarray:
    """A covariance ``(q, q)`` of the unknown input; a number stands for that number times identity."""
    array = as_array(name, value)
    cov = as_covariance(name, array * np.eye(q) if array.ndim == 0 else array)
    if cov.shape[-1] != q:
        raise ValueError(f"{name} has shape {cov.shape}, but the model has {q} unknown input(s)")
    return frozen(cov)
