"""Smoothers: estimates at every time from the measurements of a whole series.

A smoother goes back through the beliefs that a filter stored. Let z be the estimated quantities of
one time: the state, or the state and the unknown input. ``zeta = D z+`` is the part of the next z
that the past predicts, with mean ``zeta-`` and covariance ``P-``::

    J = cov(z, zeta) P-^-1     z^s = z + J (D z^s+ - zeta-)
    P^s = P + J (D P^s+ D' - P-) J'

For a Kalman filter z is the state and D the identity (Rauch, Tung & Striebel). For a filter that
estimates the unknown input of the same step, ``z = (x, d)``, ``D = [I, 0]`` and ``cov(z, zeta) =
P_z [A, G]'``. For a filter that estimates d one step late, ``z = (x, d(k-1))`` and ``D = [I, -G]``:
the next state without its input, about which nothing is assumed. All are the least-squares solution
for all states and inputs, given all measurements.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from estimators.angles import difference
from estimators.belief import Belief, InputBelief, Record
from estimators.checks import integer
from estimators.ensemble import EnsembleFilter
from estimators.kalman import KalmanFilter, of_joint, with_input
from estimators.linalg import all_finite, congruence, identity, joined, principal_root, semidefinite
from estimators.series import Series


def smooth(series: Series[Record], lag: int | None = None) -> Record:
    """Beliefs at each time, given all measurements of a series or those up to ``lag`` steps later.

    For a linear model, with or without an unknown input, the result is exact. A nonlinear model is
    linearised where the filter linearised it. For `robust-kf` the smoother uses the filter's
    enlarged prediction covariances. Members of an ensemble are smoothed by regression on their own
    predictions for the next time. On a linear model this is the ensemble Kalman smoother.

    Sources: Rauch, Tung & Striebel (1965), Maximum likelihood estimates of linear dynamic systems;
    Särkkä (2008), Unscented Rauch-Tung-Striebel smoother; Raanes (2016), On the ensemble
    Rauch-Tung-Striebel smoother and its equivalence to the ensemble Kalman smoother.

    Args:
        series: Result of `run`.
        lag: Number of steps after each time whose measurements are used (fixed-lag smoothing);
            None: all.

    Returns:
        The beliefs, times first. ``mean``, ``cov``, ``input_mean``, ``input_cov``,
        ``state_input_cov`` and ``ensemble`` are smoothed, as far as the filter has them. A late
        estimate of the unknown input stays where the filter has it, ``input_delay`` steps after the
        input acted.

    Raises:
        TypeError: if the filter has no smoother.
        ValueError: if ``lag`` is negative.
    """
    steps = None if lag is None else integer("lag", lag, 0)
    filter, updated, predicted = series.filter, series.updated, series.predicted
    if isinstance(filter, EnsembleFilter):
        return _members(filter, updated, predicted, steps)
    if not getattr(filter, "reversible", False):
        raise TypeError(
            f"{getattr(filter, 'name', filter)} has no smoother: smooth a series of kf, ekf, ukf,"
            " robust-kf, kf-umv-ui, kf-umv-ui-wdf, ekf-ui-wdf, ukf-umv or of members"
        )
    z, P = with_input(updated)
    D, J, left = _gains(filter, updated[:-1], predicted[1:], P[:-1])
    before = np.nan_to_num(predicted.mean[1:])

    def back(k: slice, z_later: np.ndarray, P_later: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        change = difference(np.matvec(D[k], z_later), before[k], filter.model.state_angles)
        return z[:-1][k] + np.matvec(J[k], change), left[k] + congruence(
            J[k], congruence(D[k], P_later)
        )

    smoothed, covs = _swept(back, steps, z, P)
    n, covs = updated.mean.shape[-1], semidefinite(covs)
    if isinstance(updated, InputBelief):
        return updated.replace(**of_joint(smoothed, covs, n))
    return updated.replace(mean=smoothed, cov=covs)


def _swept(
    back: Callable[..., tuple[np.ndarray, ...]], steps: int | None, *filtered: np.ndarray
) -> list[np.ndarray]:
    """Arrays of successive times, each smoothed from the next: backwards or in sweeps."""
    arrays, later = [np.array(each) for each in filtered], len(filtered[0]) - 1
    one_by_one = [slice(k, k + 1) for k in reversed(range(later))]
    for now in one_by_one if steps is None else [slice(0, later)] * steps:
        after = slice(now.start + 1, now.stop + 1)
        for array, values in zip(arrays, back(now, *(each[after] for each in arrays)), strict=True):
            array[now] = values
    return arrays


def _gains(
    filter: Any, updated: Belief, following: Belief, P: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """D ``(..., n, k)``, J ``(..., k, n)`` and what J leaves of P; J is 0 where a row was lost."""
    n, k, u = updated.mean.shape[-1], P.shape[-1], following.u
    A, D, cov = filter._slopes(updated, u), np.eye(n, k), following.cov
    if isinstance(updated, InputBelief):
        G = filter.model.input_matrix(updated.mean, u)
        if filter.input_delay == 0:
            A = joined([A, G], -1)
        else:
            A, D = joined([A, np.zeros(G.shape)], -1), joined([identity(n), -G], -1)
            # The prediction of a Kalman filter with ``input_cov`` contains it.
            if isinstance(filter, KalmanFilter) and filter.input_cov is not None:
                cov = cov - congruence(G, filter.input_cov)
    known = all_finite(cov) & all_finite(A)
    forgot = ~(following.healthy & known)[..., None, None]
    J, left = _regression(np.where(forgot, 0.0, A), P, np.where(forgot, 0.0, cov))
    D = np.broadcast_to(D, J.shape[:-2] + (n, k))
    return D, np.where(forgot, 0.0, J), np.where(forgot, P, left)


def _regression(A: np.ndarray, P: np.ndarray, cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """J ``(..., k, n)`` of z on ``A z`` plus noise, and what it leaves of P, the covariance of z.

    The covariance of the sum is ``cov``. J follows from a QR decomposition of roots: with a vague
    prior, a difference of covariances would lose all digits.
    """
    n, k = A.shape[-2:]
    root = principal_root(P)
    noise = principal_root(semidefinite(cov - congruence(A, P)))
    now = joined([root, np.zeros((k, n))], -1)
    both = joined([joined([A @ root, noise], -1), now], -2)
    scale = np.linalg.norm(both, axis=-1, keepdims=True)
    scale[scale == 0.0] = 1.0
    lower = np.linalg.qr((both / scale).mT)[1].mT
    J = lower[..., n:, :n] @ np.linalg.pinv(lower[..., :n, :n], rcond=1e-13)
    left = scale[..., n:, :] * lower[..., n:, n:]
    return scale[..., n:, :] * J / scale[..., :n, :].mT, left @ left.mT


def _members(filter: EnsembleFilter, updated: Any, predicted: Any, steps: int | None) -> Any:
    """Beliefs of an ensemble, smoothed member by member."""
    angles, members, ahead = filter.model.state_angles, updated.ensemble, predicted.ensemble[1:]
    spread, moved = (
        difference(each, belief.mean[..., None, :], angles)
        for each, belief in ((members[:-1], updated[:-1]), (ahead, predicted[1:]))
    )
    forgot = ~predicted.healthy[1:] | ~all_finite(moved)
    moved = np.where(forgot[..., None, None], 0.0, moved)
    gain, expected = np.linalg.pinv(moved, rcond=1e-10) @ spread, np.nan_to_num(ahead)

    def back(k: slice, later: np.ndarray) -> tuple[np.ndarray]:
        return (members[:-1][k] + difference(later, expected[k], angles) @ gain[k],)

    return updated.replace(ensemble=_swept(back, steps, members)[0])
