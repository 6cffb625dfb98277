"""The Kalman filter and the extended Kalman filter, in Joseph form."""

import numpy as np

from estimators.belief import Belief
from estimators.filter import Filter, Model, Reading, Streams
from estimators.linalg import congruence, product, solve, symmetrise
from estimators.models import LinearModel, as_covariance, resolve


class ExtendedKalmanFilter(Filter):
    """Linearises the model at the mean; on a linear model it is the Kalman filter exactly.

    Jacobians that the model does not give are taken by central differences. An unknown input in
    the model is ignored.

    Source: Jazwinski (1970), Stochastic Processes and Filtering Theory, ch. 8.
    """

    name = "ekf"
    shares = True

    def _predict(self, belief: Belief, u: np.ndarray | None, rng: Streams) -> Belief:
        mean, cov = self._propagate(belief.mean, belief.cov, u)
        cov = symmetrise(cov + self._process_noise(u))
        return Belief(mean, cov, belief.prior_mean, belief.prior_cov, belief.healthy, u)

    def _update(self, belief: Belief, reading: Reading, rng: Streams) -> Belief:
        C, R = reading.C, self._measurement_noise(reading, belief.u)
        mean, cov, S = joseph_update(belief.mean, belief.cov, reading.innovation, C, R)
        return Belief(
            mean, cov, belief.prior_mean, belief.prior_cov, np.ones(mean.shape[:-1], bool), belief.u,
            reading.innovation, S, reading.available,
        )  # fmt: skip

    def _process_noise(self, u: np.ndarray | None) -> np.ndarray:
        return resolve(self.model.Q, u)

    def _measurement_noise(self, reading: Reading, u: np.ndarray | None) -> np.ndarray:
        return reading.R


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
        The mean ``(..., n)`` and covariance ``(..., n, n)`` after the reading, and S ``(..., p, p)``.
    """
    PC = product(cov, C.mT)
    S = product(PC.mT, C.mT) + R
    K = solve(S, PC.mT).mT
    left = congruence(np.eye(mean.shape[-1]) - product(K, C), cov)
    return mean + np.matvec(K, innovation), symmetrise(left + product(K, R) @ K.mT), S


class KalmanFilter(ExtendedKalmanFilter):
    """The minimum-variance filter of a linear Gaussian model.

    An unknown input ``d`` in the model is ignored unless its covariance is told, in which case it
    is treated as white noise: ``G D G'`` is added to Q and ``H D H'`` to R. (Their correlation
    through ``d`` is not used: this is what an engineer does who has a Kalman filter and a variance.)

    Source: Kalman (1960); covariance update in Joseph form.

    Args:
        model: A `LinearModel`.
        input_cov: ``(q, q)`` covariance D of the unknown input, or None to ignore the input.

    Raises:
        ValueError: if the model is nonlinear, or ``input_cov`` does not fit its unknown inputs.
    """

    name = "kf"
    model: LinearModel

    def __init__(self, model: Model, input_cov: np.ndarray | float | None = None) -> None:
        super().__init__(model)
        if not isinstance(model, LinearModel):
            raise ValueError("kf needs a LinearModel: use ekf for a nonlinear one")
        if input_cov is not None and model.q == 0:
            raise ValueError("input_cov was given, but the model has no unknown input (G and H are missing)")
        self.input_cov = None if input_cov is None else input_covariance("input_cov", input_cov, model.q)

    def _process_noise(self, u: np.ndarray | None) -> np.ndarray:
        Q = super()._process_noise(u)
        if self.input_cov is None or self.model.G is None:
            return Q
        return Q + congruence(resolve(self.model.G, u), self.input_cov)

    def _measurement_noise(self, reading: Reading, u: np.ndarray | None) -> np.ndarray:
        if self.input_cov is None or reading.H is None:
            return reading.R
        return reading.R + congruence(reading.H, self.input_cov)


def input_covariance(name: str, value: np.ndarray | float, q: int) -> np.ndarray:
    """A covariance ``(q, q)`` of the unknown input; a number stands for that number times identity."""
    array = np.asarray(value, dtype=float)
    cov = as_covariance(name, array * np.eye(q) if array.ndim == 0 else array)
    if cov.shape[-1] != q:
        raise ValueError(f"{name} has shape {cov.shape}, but the model has {q} unknown input(s)")
    return cov
