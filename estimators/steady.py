"""Steady state of a Kalman filter, and the filter that has its covariance from the start."""

from collections.abc import Callable
from functools import reduce
from typing import Any, NamedTuple

import numpy as np

from estimators.checks import indices, shaped_array
from estimators.discretisation import RiccatiMap, matrices, riccati_composition
from estimators.engine import compiled
from estimators.filter import Changes, Model
from estimators.kalman import ExtendedKalmanFilter, joseph_update
from estimators.linalg import congruence, identity, masked, rescue, solve, symmetrise
from estimators.models import LinearModel
from estimators.varying import resolve, sized

_NEAR = 1e-4
"""Eigenvalues this near to 1 count as 1: rounding moves those of coupled integrators as far."""
_ROUNDING = 1e-9
"""Singular values below this share of the largest entry of A are rounding."""
_RESIDUAL = 1e-10
"""Largest change of a steady covariance over a period, in units of standard deviations."""
_DOUBLINGS = 40


class SteadyState(NamedTuple):
    """Gain and covariances to which the Kalman filter of a time-invariant model converges.

    Attributes:
        gain: ``(T, n, p)`` in each phase of the measurements' period; columns of channels that a
            phase does not measure are 0.
        before: ``(T, n, n)`` covariance of the prediction.
        after: ``(T, n, n)`` covariance after the measurement.
    """

    gain: np.ndarray
    before: np.ndarray
    after: np.ndarray


def steady_state(model: LinearModel, measured: Any = None, names: Any = None) -> SteadyState:
    """Steady state of a Kalman filter, from the stationary solution of the Riccati equation.

    Where channels are measured at different rates, the filter converges to a cycle, the solution
    of the periodic Riccati equation.

    The solution exists if measurements show, and process noise excites, each mode of A that does
    not decay (tests of Popov, Belevitch and Hautus). It is computed by doubling the number of
    periods. Then it is tried: one more period must reproduce the covariance to 1e-10, and the
    filter's errors must decay.

    Sources: Anderson & Moore (1979), Optimal Filtering, ch. 4; Bittanti, Colaneri & De Nicolao
    (1991), The periodic Riccati equation; Chu, Fan, Lin & Wang (2004), Structure-preserving
    algorithms for periodic discrete-time algebraic Riccati equations, for the doubling.

    Args:
        model: A `LinearModel` of which A, C, Q and R are matrices, without batch axes. Its unknown
            input is ignored.
        measured: ``(T, p)`` mask of the channels that are measured in each of the T phases of a
            period; None: all channels in every step.
        names: Names of the n states, for error messages; None: their indices.

    Raises:
        ValueError: if there is no steady state, naming the states that measurements do not show or
            that no noise excites; if a matrix of the model depends on the known input; or if
            ``measured`` has another shape.
    """
    A, C, Q, R = _matrices(model)
    measured, eye = _phases(measured, model.p), identity(model.n)
    for hidden, why in ((_hidden(A, C), _UNDETERMINED), (_hidden(A.T, Q), _WITHOUT_NOISE)):
        if hidden.any():
            listed = ", ".join(str((names or range(model.n))[i]) for i in np.flatnonzero(hidden))
            raise ValueError(f"there is no steady state: {why.format(listed)}")
    C, R = np.where(measured[..., None], C, 0.0), masked(R, measured)
    with np.errstate(all="ignore"), rescue():  # channels without noise may repeat others
        period = limit = reduce(riccati_composition, zip(*_steps(A, C, Q, R), strict=True))
        for _ in range(_DOUBLINGS):
            limit = riccati_composition(limit, limit)
        cov = symmetrise(limit[1])
        errors = period[0] @ np.linalg.inv(eye + cov @ period[2])
        sd = np.sqrt(np.maximum(cov.diagonal(), np.finfo(float).tiny))
        residual = errors @ cov @ period[0].T + period[1] - cov
        converged = (np.abs(residual) <= _RESIDUAL * sd * sd[:, None]).all()
        if not converged or np.abs(np.linalg.eigvals(errors)).max() > 1.0 - _ROUNDING:
            raise ValueError("there is no steady state: the errors of the filter do not decay")
        phases = []
        for each in zip(C, R, strict=True):
            before = symmetrise(congruence(A, cov) + Q)
            # Unit innovations move means of 0 by the columns of the gain.
            gain, cov, _ = joseph_update(np.zeros(C.shape[1:]), before, identity(model.p), *each)
            phases.append((gain.T, before, cov))
    return SteadyState(*map(np.stack, zip(*phases, strict=True)))


_UNDETERMINED = "measurements do not determine {}: add a sensor that does, or leave them out"
_WITHOUT_NOISE = "no process noise excites {}, whose gain so ends at 0: give them noise in Q"


def _matrices(model: Any) -> list[np.ndarray]:
    """A, C, Q and R of a model, checked to be matrices."""
    try:
        return matrices(model, "ACQR")
    except (AttributeError, TypeError, ValueError):
        raise ValueError(
            "a steady state needs a LinearModel of which A, C, Q and R are single matrices: give"
            " steady-kf such a model of the usual motion as design"
        ) from None


def _phases(measured: Any, p: int) -> np.ndarray:
    """Mask ``(T, p)`` of the channels that are measured in each phase."""
    measured = np.ones((1, p)) if measured is None else measured
    return shaped_array("measured", measured, "T", p) != 0.0


def _hidden(A: np.ndarray, C: np.ndarray) -> np.ndarray:
    """Mask ``(n,)`` of the states in modes that do not decay and that C does not show."""
    modes, hidden = np.linalg.eigvals(A), np.zeros(len(A), bool)
    modes = np.where(np.abs(modes - 1.0) < _NEAR, 1.0, modes)
    C = C / np.maximum(np.linalg.norm(C, axis=1, keepdims=True), np.finfo(float).tiny)
    for mode in {*modes[np.abs(modes) > 1.0 - _NEAR].tolist()}:
        both = np.concatenate([A - mode * identity(len(A)), C])
        _, values, directions = np.linalg.svd(both)
        unseen = directions[values < _ROUNDING * max(1.0, np.abs(A).max())]
        hidden |= (np.abs(unseen) > _NEAR).any(0)
    return hidden


def _steps(A: np.ndarray, C: np.ndarray, Q: np.ndarray, R: np.ndarray) -> RiccatiMap:
    """The map of each step: a prediction, then the measurement ``C (T, p, n)``, ``R (T, p, p)``."""
    CQ, CA = C @ Q, C @ A
    S = CQ @ C.mT + R
    left = identity(len(A)) - solve(S, CQ).mT @ C
    return left @ A, left @ Q, CA.mT @ solve(S, CA)


@compiled
class SteadyKalmanFilter(ExtendedKalmanFilter):
    """Kalman filter of constant gain: predictions have the covariance of the `steady_state`.

    The gain is constant for each set of channels that are measured together. The covariance before
    a measurement is the mean over the phases that measure the smallest set with all channels that
    have arrived. Between measurements, and without them, the filter dead-reckons: it predicts by
    the model, which need not have a Jacobian, and its covariance does not grow.

    With ``axes`` the covariance is constant in axes that turn with the vehicle, such as those along
    and across the path. The gain turns with them.

    States of ``nuisance``, such as constant biases, keep their prior mean and covariance, and get
    no gain, where they have a part in a mode without noise, or in one that measurements do not
    determine.

    Source: Anderson & Moore (1979), Optimal Filtering, ch. 4.

    Args:
        model: A `LinearModel` or `NonlinearModel`; an unknown input is ignored.
        design: `LinearModel` of matrices, of which the steady state and R are; None: ``model``.
        measured: ``(T, p)`` mask of the channels in each phase, as for `steady_state`.
        nuisance: Indices of states that may do without a gain.
        axes: Function of the mean ``(..., n)`` that returns the matrix ``(..., n, n)`` from the
            axes of ``design`` to those of ``model``; None: the axes are the same.
        names: Names of the n states, for error messages; None: their indices.

    Raises:
        ValueError: as `steady_state`, or for a design model of another size.
    """

    name = "steady-kf"
    varies_by_row = False
    _axes = {"predict": (1,), "update": (1, 2, 2)}

    def __init__(
        self, model: Model, design: LinearModel | None = None, measured: Any = None,
        nuisance: tuple[int, ...] = (), axes: Callable[[np.ndarray], np.ndarray] | None = None,
        names: Any = None,
    ) -> None:  # fmt: skip
        super().__init__(model)
        A, C, Q, R = _matrices(model if design is None else design)
        shaped_array("C of design", C, model.p, model.n)
        kept, spare = np.arange(model.n), indices("nuisance", nuisance, model.n)
        for transition, rows in ((A.T, Q), (A, C)):
            hidden = _hidden(transition[np.ix_(kept, kept)], rows[:, kept])
            kept = kept[~(hidden & np.isin(kept, spare))]
        square, every = np.ix_(kept, kept), names or range(model.n)
        reduced = LinearModel(A[square], C[:, kept], Q[square], R)
        steady = steady_state(reduced, measured, [every[i] for i in kept])
        before = congruence(identity(model.n)[:, kept], steady.before)
        phases = _phases(measured, model.p)
        sets = sorted({tuple(each) for each in phases if each.any()}, key=sum)
        means = [before[(phases == each).all(-1)].mean(0) for each in sets]
        self.axes, self._sets, self._before = axes, np.array(sets), np.array(means)
        self._between, self._R = before.mean(0), R
        fixed = ~np.isin(np.arange(model.n), kept)
        self._fixed = fixed & fixed[:, None]

    def propagate(self, belief: Any, u: np.ndarray | None) -> tuple[Any, ...]:
        """Next mean ``(..., n)``."""
        function, linear = self.model.transition, isinstance(self.model, LinearModel)
        mean = function(belief.mean, u) if linear else resolve(function, belief.mean, u)
        return (sized("transition", mean, self.model.n),)

    def _noise(self, belief: Any, u: np.ndarray | None, R: Any) -> Any:
        """R ``(..., p, p)``: the one that is given, or the design's."""
        return self._R if R is None else R

    def _predict(self, belief: Any, u: Any, mean: Any, *_: Any) -> Changes:
        cov = self._turned(mean, self._between)
        return {"mean": mean, "cov": np.where(self._fixed, belief.cov, cov)}

    def _update(
        self, belief: Any, u: Any, e: Any, C: Any, R: Any, available: Any, *_: Any
    ) -> Changes:
        # Channels that have arrived and that a set does not measure.
        others, before = np.matvec(1.0 * ~self._sets, 1.0 * available), self._before[-1]
        for i in reversed(range(len(self._sets) - 1)):
            before = np.where(others[..., i : i + 1, None] == 0.0, self._before[i], before)
        mean, cov, S = joseph_update(belief.mean, self._turned(belief.mean, before), e, C, R)
        some = ((1.0 * available).sum(-1) > 0.0)[..., None, None]
        cov = np.where(some & ~self._fixed, cov, belief.cov)
        return {"mean": mean, "cov": cov, "innovation_cov": S}

    def _turned(self, mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
        """A covariance in the axes of the model."""
        return cov if self.axes is None else symmetrise(congruence(self.axes(mean), cov))
