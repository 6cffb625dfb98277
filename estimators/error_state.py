"""The error-state Kalman filter: for states that are no vectors, and errors that are."""

from typing import Any, cast

import numpy as np

from estimators.belief import Belief
from estimators.differences import central_differences, steps
from estimators.filter import Rng
from estimators.kalman import GaussianFilter, joseph_update
from estimators.linalg import congruence, symmetrise
from estimators.measurement import Measurement
from estimators.models import Gaussian, ManifoldGaussian


class ErrorStateKalmanFilter(GaussianFilter[Belief], verified=True):
    """An `ekf` of the error of a state: the mean is a state ``(..., nx)``, the covariance ``(..., n, n)`` its error's.

    The model's ``difference`` and ``sum`` say what an error is (`NonlinearModel`); a prior is a `ManifoldGaussian`.
    With (+) for sum and (-) for difference::

        x- = f(x)       A = d(f(x (+) e) (-) f(x)) / de       P- = A P A' + Q
        e  = K (y - h(x-))      x = x- (+) e      P = G (I - K C) P- (I - K C)' G' + G K R K' G'

    at e = 0, with ``C = dh(x- (+) e) / de``. The reset ``G = d((x- (+) e) (-) x) / de``, at the e that was estimated,
    carries the covariance from errors about x- to errors about x; of attitudes it is ``I - [e]x / 2`` to first order.
    Jacobians are the model's own, or by central differences. On vectors it is the `ekf`.

    Source: Sola (2017), Quaternion kinematics for the error-state Kalman filter, ch. 5 to 7; G is that of sec. 6.3.

    Args:
        model: A `LinearModel` or a `NonlinearModel`, with or without a difference.
    """

    name = "eskf"
    formulas = False  # sum and difference are the user's
    manifolds = True
    _length: int | None = None
    """Of a state that is no vector, told by the first prior."""

    @property
    def _curved(self) -> Any:
        """The model, if its states are no vectors."""
        return self.model if getattr(self.model, "difference", None) is not None else None

    def _check_prior(self, prior: Gaussian) -> None:
        if self._curved is None:
            return super()._check_prior(prior)
        if prior.cov.shape[-1] != self.model.n:
            raise ValueError(f"the prior is for {prior.cov.shape[-1]} errors, the model has {self.model.n}")
        if not isinstance(prior, ManifoldGaussian):
            raise ValueError("the model has a difference: give the prior as ManifoldGaussian(state, cov of its error)")
        self._check_length("prior", prior.mean)
        if self._length is None:
            check_inverse(self._curved, prior)
            self._length = prior.mean.shape[-1]

    def _batch(self, belief: Belief) -> tuple[int, ...]:
        if self._curved is None or not isinstance(belief, self.record):
            return super()._batch(belief)
        self._check_length("belief", belief.mean)
        return belief.mean.shape[:-1]

    def _check_length(self, name: str, state: np.ndarray) -> None:
        if self._length not in (None, state.shape[-1]):
            raise ValueError(f"the {name} has a state of {state.shape[-1]} numbers, the first prior had {self._length}")

    def _returned(self, method: str, belief: Belief, batch: tuple[int, ...]) -> Belief:
        return super()._returned(method, belief, batch) if self._curved is None else belief

    def _update(self, belief: Belief, measurement: Measurement, rng: Rng) -> Belief:
        model, before = self._curved, belief.mean[..., None, :]
        if model is None:
            return super()._update(belief, measurement, rng)
        none = np.zeros(belief.cov.shape[:-1])
        error, cov, S = joseph_update(none, belief.cov, measurement.innovation, measurement.C, measurement.R)
        mean = model.sum(belief.mean, error)

        def moved(e: np.ndarray, u: np.ndarray | None) -> np.ndarray:
            return cast(np.ndarray, model.difference(model.sum(before, e), mean[..., None, :]))

        _, G = central_differences("difference", moved, error, None, model.n, (), steps(error, cov))
        return Belief.updated(belief, mean, symmetrise(congruence(G, cov)), measurement, S)


def check_inverse(model: Any, prior: Gaussian) -> None:
    """Compare a model's difference with its sum about a prior and a deviation away from it.

    Raises:
        ValueError: if one is not the inverse of the other, or has another shape, or takes no states of this length.
    """
    sd = np.sqrt(prior.cov.diagonal(0, -2, -1))
    small = 1e-3 * np.where(sd > 0.0, sd, 1.0)
    try:
        away = model.sum(prior.mean, np.where(np.arange(model.n) % 2, -sd, sd))
    except (ValueError, IndexError) as error:
        raise ValueError(
            f"sum must take states and errors, but a prior with a state of {prior.mean.shape[-1]} numbers and an error "
            f"of {model.n} ends in: {error}"
        ) from error
    for state in (prior.mean, np.asarray(away)):
        moved = np.asarray(model.sum(state, small))
        if moved.shape != np.broadcast_shapes(state.shape[:-1], small.shape[:-1]) + prior.mean.shape[-1:]:
            raise ValueError(
                f"sum must give a state like its first argument: of {state.shape} and an error {small.shape} it made "
                f"{moved.shape}"
            )
        back = np.asarray(model.difference(moved, state))
        if back.shape != moved.shape[:-1] + (model.n,):
            raise ValueError(f"difference gave an error of shape {back.shape}, expected {(*moved.shape[:-1], model.n)}")
        rounding = 16.0 * np.finfo(float).eps * np.abs(state).max(-1, keepdims=True)
        wrong = ~(np.abs(back - small) <= 1e-3 * np.abs(small) + rounding)
        if wrong.any():
            i = int(wrong.reshape(-1, model.n).any(0).argmax())
            raise ValueError(
                f"difference must be the inverse of sum: component {i} of difference(sum(x, e), x) is not that of e"
            )
