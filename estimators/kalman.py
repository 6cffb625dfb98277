"""The Kalman filter and the extended Kalman filter, in Joseph form."""

from typing import Any

import numpy as np

from estimators.belief import Belief, InputBelief
from estimators.checks import as_array, as_covariance, frozen
from estimators.engine import compiled
from estimators.filter import Changes, Filter, Model
from estimators.linalg import congruence, identity, joined, solve, symmetric_blocks, symmetrise
from estimators.models import LinearModel


def joseph_update(
    mean: np.ndarray, cov: np.ndarray, e: np.ndarray, C: np.ndarray, R: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The Kalman update in Joseph form.

    Args:
        mean: ``(..., n)`` prediction.
        cov: ``(..., n, n)`` its covariance.
        e: ``(..., p)`` innovation.
        C: ``(..., p, n)``.
        R: ``(..., p, p)``.

    Returns:
        The mean ``(..., n)`` and covariance ``(..., n, n)`` after the measurement, and S ``(...,
        p, p)``.
    """
    PC = cov @ C.mT
    S = C @ PC + R
    K = solve(S, PC.mT).mT
    left = congruence(identity(mean.shape[-1]) - K @ C, cov)
    return mean + np.matvec(K, e), symmetrise(left + congruence(K, R)), S


@compiled
class ExtendedKalmanFilter(Filter[Belief]):
    """EKF: linearises the model at the mean; exact on a linear model.

    Jacobians that the model does not give are exact for compiled functions, and by central
    differences for others. An unknown input in the model is ignored.

    Source: Jazwinski (1970), Stochastic Processes and Filtering Theory, ch. 8.
    """

    name = "ekf"
    reversible = True

    def _predict(self, belief: Any, u: Any, mean: Any, A: Any, Q: Any, *_: Any) -> Changes:
        return {"mean": mean, "cov": symmetrise(congruence(A, belief.cov) + Q)}

    def _update(
        self, belief: Any, u: Any, e: Any, C: Any, R: Any, available: Any, *_: Any
    ) -> Changes:
        mean, cov, S = joseph_update(belief.mean, belief.cov, e, C, R)
        return {"mean": mean, "cov": cov, "innovation_cov": S}


@compiled
class KalmanFilter(ExtendedKalmanFilter):
    """The minimum-variance filter of a linear Gaussian model.

    An unknown input ``d`` in the model is ignored unless its covariance D is given as
    ``input_cov``. Then d is white noise that acts on the measurement through H and on the next
    state through G, and is estimated with the state (``input_delay`` 0)::

        S = C P- C' + H D H' + R      [x; d] = [x-; 0] + [P- C'; D H'] S^-1 e
        x-+ = A x + B u + G d         P-+ = [A G] cov(x, d) [A G]' + Q

    with ``x-+`` and ``P-+`` the next prediction, which uses what the measurement shows of d.
    `kf-umv-ui` is the limit of a D that grows without bound. With ``delayed_feedthrough`` the
    measurement contains d(k-1), which has already moved the state (``input_delay`` 1)::

        x-+ = A x + B u     P-+ = A P A' + G D G' + Q     cov(x-+, d) = G D

    Source: Kalman (1960); covariance update in Joseph form; Anderson & Moore (1979), Optimal
    Filtering, sec. 5.4, for correlated noises of process and measurement.

    Args:
        model: A `LinearModel`.
        input_cov: ``(q, q)`` covariance D of the unknown input, or None to ignore the input; a
            number stands for that number times identity.

    Raises:
        ValueError: if the model is nonlinear, or ``input_cov`` does not fit its unknown inputs.
    """

    name = "kf"
    likelihood = "exact"
    reversible = True
    model: LinearModel
    input_cov: np.ndarray | None = None

    def __init__(self, model: Model, input_cov: np.ndarray | float | None = None) -> None:
        super().__init__(model)
        if not isinstance(model, LinearModel):
            raise ValueError("kf needs a LinearModel: use ekf for a nonlinear one")
        if input_cov is not None:
            self.input_cov = input_covariance("input_cov", input_cov, model.q)
            self.input_delay, self.record = int(model.delayed_feedthrough), InputBelief
            self.varies_by_row = False

    def _begin(self, mean: np.ndarray, cov: np.ndarray, rng: Any) -> Changes:
        if self.input_cov is None:
            return {}
        # Before the first step nothing has acted that a delayed feedthrough could show.
        return unseen_input(mean, self.input_cov * (not self.input_delay))

    def _predict(self, belief: Any, u: Any, mean: Any, A: Any, Q: Any, *more: Any) -> Changes:
        if self.input_cov is None:
            return super()._predict(belief, u, mean, A, Q)
        (G,), unseen = more, unseen_input(mean, self.input_cov)
        if not self.input_delay:
            return driven(belief, mean, A, Q, G) | unseen
        moved = driven(belief.replaced(unseen), mean, A, Q, G)
        unseen["state_input_cov"] = unseen["state_input_cov"] + G @ self.input_cov
        return moved | unseen

    def _update(
        self, belief: Any, u: Any, e: Any, C: Any, R: Any, available: Any, *more: Any
    ) -> Changes:
        if self.input_cov is None:
            return super()._update(belief, u, e, C, R, available)
        mean, cov = with_input(belief)
        mean, cov, S = joseph_update(mean, cov, e, joined([C, *more], -1), R)
        return of_joint(mean, cov, self.model.n) | {"innovation_cov": S}


def joint_covariance(belief: Any) -> np.ndarray:
    """Covariance ``(..., n + q, n + q)`` of state and unknown input."""
    return symmetric_blocks(belief.cov, belief.state_input_cov, belief.input_cov)


def of_joint(mean: np.ndarray, cov: np.ndarray, n: int) -> Changes:
    """Arrays of an `InputBelief` from mean and covariance of its n states and unknown inputs."""
    return {
        "mean": mean[..., :n],
        "cov": cov[..., :n, :n],
        "input_mean": mean[..., n:],
        "input_cov": cov[..., n:, n:],
        "state_input_cov": cov[..., :n, n:],
    }


def with_input(belief: Belief) -> tuple[np.ndarray, np.ndarray]:
    """Mean ``(..., k)`` and covariance ``(..., k, k)`` of state and, if estimated, input."""
    if not isinstance(belief, InputBelief):
        return belief.mean, belief.cov
    return np.concatenate([belief.mean, belief.input_mean], -1), joint_covariance(belief)


def driven(belief: Any, mean: Any, A: Any, Q: Any, G: Any) -> Changes:
    """Mean and covariance after a step in which the estimated input drives the model through G."""
    # One term of two, doubled: the sum is symmetrised.
    half = 2.0 * (A @ belief.state_input_cov) + G @ belief.input_cov
    cov = congruence(A, belief.cov) + half @ G.mT
    return {"mean": mean + np.matvec(G, belief.input_mean), "cov": symmetrise(cov + Q)}


def unseen_input(mean: np.ndarray, input_cov: np.ndarray) -> Changes:
    """Arrays of an `InputBelief` about an input of which only the covariance is known."""
    n, q, rows = mean.shape[-1], input_cov.shape[-1], mean.shape[:-1]
    return {
        "input_mean": np.zeros(rows + (q,)),
        "input_cov": np.zeros(rows + (q, q)) + input_cov,
        "state_input_cov": np.zeros(rows + (n, q)),
    }


def input_covariance(name: str, value: np.ndarray | float, q: int) -> np.ndarray:
    """A covariance ``(q, q)`` of the unknown input; a number stands for a multiple of identity."""
    if q == 0:
        raise ValueError(f"{name} needs an unknown input: give the model G, H or both")
    array = as_array(name, value)
    cov = as_covariance(name, array * np.eye(q) if array.ndim == 0 else array)
    if cov.shape[-1] != q:
        raise ValueError(f"{name} has shape {cov.shape}, but the model has {q} unknown input(s)")
    return frozen(cov)
