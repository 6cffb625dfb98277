"""From an update that is not finite, or no covariance, to the mildest remedy that gives a belief."""

import math
from typing import Any

import numpy as np

from estimators.belief import (
    Belief,
    EnsembleBelief,
    FeedthroughBelief,
    InputBelief,
    Record,
    Recovery,
    finite_rows,
)
from estimators.linalg import (
    SINGULAR,
    congruence,
    equilibrated,
    identity,
    lacks_rank,
    masked,
    pseudo_inverse,
    semidefinite,
    semidefinite_cholesky,
    symmetrise,
)
from estimators.measurement import Measurement
from estimators.randomness import RandomKeys


def recovered(
    filter: Any, belief: Record, updated: Record, measurement: Measurement, y: np.ndarray, rng: Any,
    available: np.ndarray | None, R: np.ndarray | None,
) -> Record:  # fmt: skip
    """The update with every lost row replaced by the mildest remedy that holds.

    Args:
        filter: With `_update`, `_init`, `_measurement` and `_condensed`.
        belief: The prediction.
        updated: The usual update of it.
        measurement: Of that update,
        y: and what it was made of.
        rng: Random numbers of the update.
        available: Mask of ``y``.
        R: Covariance of ``y``, or None.
    """
    even = semidefinite(belief.cov)
    uneven = (even != belief.cov).any((-2, -1)) & finite_rows(belief)
    if uneven.any():  # a prediction that is a covariance but for rounding is not given up for that
        belief = Belief.replace(belief, cov=even)
        again = attempt(filter, belief, measurement, rng)
        updated = updated.with_rows(uneven, again[uneven])
    lost, predicted = lost_rows(updated, belief, measurement.R), ~lost_rows(belief, belief)
    result = _mildest(filter, belief, updated, updated, measurement, lost & predicted, rng)
    lost = lost & ~predicted
    if lost.any():
        prior = belief.prior_mean, belief.prior_cov
        u = None if belief.u is None else np.nan_to_num(belief.u)
        initial = filter._init(Belief(*prior, *prior, np.zeros(lost.shape, np.int8), u), rng)
        measurement = filter._measurement(initial, y, available, R)
        fresh = attempt(filter, initial, measurement, rng)
        cured = lost & ~lost_rows(fresh, initial, measurement.R)
        result = result.with_rows(cured, fresh[cured])
        result = _mildest(filter, initial, result, fresh, measurement, lost & ~cured, rng)
        result = result.replace(
            recovery=np.where(lost, Recovery.PRIOR, result.recovery).astype(np.int8)
        )
    own = {name: getattr(result, name, None) for name in COVARIANCES}
    covs = {name: semidefinite(cov) for name, cov in own.items() if cov is not None}
    if (S := result.innovation_cov) is not None and measurement.C.size:
        covs["cov"] = np.where(_known(belief.cov, covs["cov"], measurement, S), 0.0, covs["cov"])
    return Belief.replace(result, **covs)


def _known(
    before: np.ndarray, after: np.ndarray, measurement: Measurement, S: np.ndarray
) -> np.ndarray:
    """The mask ``(..., n, n)`` of covariances of states of which perfect measurements left nothing but rounding."""
    K = before @ measurement.C.mT @ pseudo_inverse(np.where(np.isfinite(S), S, 0.0))
    terms = congruence(np.abs(identity(before.shape[-1]) - K @ measurement.C), np.abs(before))
    variance, size, noise = (
        P.diagonal(0, -2, -1) for P in (after, terms, congruence(K, measurement.R))
    )
    known = (
        (variance <= _KNOWN * size)
        & (variance > 2.0 * noise)
        & lacks_rank(measurement.R)[..., None]
    )[..., None]
    return known | known.mT


def _mildest(
    filter: Any,
    start: Record,
    result: Record,
    failed: Record,
    measurement: Measurement,
    lost: np.ndarray,
    rng: Any,
) -> Record:
    """The result with each lost row as the mildest remedy but the prior gives it; ``start`` is finite there."""
    S = failed.innovation_cov
    remedies = [
        (Recovery.PSEUDO_INVERSE, lambda: filter._condensed(start, measurement, S, lost)),
        (Recovery.WITHOUT_CHANNEL, lambda: _without_offending(measurement, S)),
        (
            Recovery.PREDICTION,
            lambda: (measurement.only(np.zeros(measurement.available.shape, bool)), lost),
        ),
    ]
    for remedy, milder in remedies if filter.mixes and S is not None else remedies[1:]:
        if not lost.any():
            return result
        changed = milder()
        if changed is None:
            continue
        milder_measurement, tried = changed[0], lost & changed[1]
        if not tried.any():
            continue
        again = attempt(filter, start, milder_measurement, rng)
        cured = tried & ~lost_rows(again, start)
        if remedy == Recovery.PSEUDO_INVERSE:  # in the channels as they are, not as they were mixed
            again = again.replace(
                innovation=measurement.innovation, innovation_cov=S, available=measurement.available
            )
        again = again.replace(recovery=np.full(lost.shape, remedy, np.int8))
        result, lost = result.with_rows(cured, again[cured]), lost & ~cured
    if lost.any():  # a filter that fails even without a measurement keeps what it had
        kept = start.replace(recovery=np.full(lost.shape, Recovery.PREDICTION, np.int8))
        result = result.with_rows(lost, kept[lost])
    return result


def attempt(filter: Any, belief: Record, measurement: Measurement, rng: Any) -> Record:
    """`_update`; the mean is NaN in rows where that of one's own stops at a singular matrix."""
    try:
        updated: Record = filter._update(belief, measurement, rng)
        return updated
    except np.linalg.LinAlgError:
        if filter.verified:
            raise
    batch, n = belief.mean.shape[:-1], belief.cov.shape[-1]
    S = (
        congruence(measurement.C, belief.cov) + measurement.R
        if measurement.C.shape[-1] == n
        else None
    )
    failed = Belief.replace(
        belief, mean=np.full(belief.mean.shape, np.nan), innovation=measurement.innovation, innovation_cov=S,
        available=measurement.available,
    )  # fmt: skip
    if math.prod(batch) > 1:
        for row in np.eye(math.prod(batch), dtype=bool):
            row = row.reshape(batch)
            own = rng[row] if isinstance(rng, RandomKeys) else rng
            failed = failed.with_rows(
                row, attempt(filter, belief[row], measurement.of_rows(row), own)
            )
    return failed


def condensed(
    measurement: Measurement, S: np.ndarray, lost: np.ndarray, F: np.ndarray | None
) -> tuple[Measurement, np.ndarray] | None:
    """The measurement in the directions in which S is not singular, so that ``S^-1`` of it is S's pseudo-inverse.

    Directions are told apart with each channel in units of its innovation. Rows that are not lost
    stay as they are. An unknown input that shows where S has nothing is seen there without noise:
    ``S + a F F'`` takes the place of S, from which the best unbiased estimate is the same (Rao,
    1971, Unified theory of linear estimation).

    Args:
        measurement: Of a filter's update.
        S: ``(..., p, p)`` covariance of its innovation.
        lost: ``(...)`` the rows that are lost.
        F: ``(..., p, k)`` how an unknown input, in units of its prior, shows in it; None: there is
            none.

    Returns:
        The measurement and the rows ``(...)`` that it is for, or None.
    """
    scale, scaled = equilibrated(S)
    spread = None
    if F is not None:
        F = F / scale[..., None]
        size = np.square(F).sum((-2, -1), keepdims=True)
        spread = 1.0 / np.where(size > 0.0, size, 1.0)
        scaled = scaled + spread * (F @ F.mT)
    chosen = lost & np.isfinite(scaled).all((-2, -1))
    if not chosen.any():
        return None
    eye = identity(S.shape[-1])
    values, vectors = np.linalg.eigh(np.where(chosen[..., None, None], scaled, eye))
    kept = values > SINGULAR * S.shape[-1]
    T = np.where(kept[..., None], vectors.mT / scale[..., None, :], 0.0)
    return measurement.mixed(np.where(chosen[..., None, None], T, eye), spread), chosen


def doubtful_rows(updated: Belief, R: np.ndarray) -> np.ndarray:
    """The rows ``(...)`` that are not finite, or of which a measurement left nothing, perhaps, but rounding."""
    if isinstance(
        updated, EnsembleBelief
    ):  # whose mean is that of the members, and no variance of theirs negative
        return ~np.isfinite(updated.mean.sum(-1))
    total = updated.mean.sum(-1) + updated.cov.sum((-2, -1))
    if isinstance(updated, InputBelief):
        total = total + updated.input_mean.sum(-1)
    if isinstance(updated, FeedthroughBelief):
        total = total + updated.feedthrough_cov.sum((-2, -1))
    if (S := updated.innovation_cov) is not None:
        exhausted = S.diagonal(0, -2, -1) > _DIGITS * R.diagonal(0, -2, -1)
        total = total + np.where(exhausted, np.nan, 0.0).sum(-1)
    return ~np.isfinite(total)


_DIGITS = 1e4
"""An update that shrinks a variance by more than this may leave nothing but rounding, of either sign."""


def proper(cov: np.ndarray) -> bool:
    """Is the first row of covariances ``(..., n, n)`` symmetric and positive semidefinite?"""
    if cov.size == 0:
        return True
    first = cov[(0,) * (cov.ndim - 2)]
    with np.errstate(over="ignore"):
        return np.array_equal(first, first.T) and bool(
            np.linalg.eigvalsh(first)[0] >= -_ROUNDING * np.trace(first)
        )


def evened(cov: np.ndarray) -> np.ndarray:
    """Covariances ``(..., n, n)``, made symmetric where they are so but for rounding."""
    with np.errstate(over="ignore", invalid="ignore"):
        even, size = symmetrise(cov), np.abs(cov).max((-2, -1), keepdims=True)
        rounding = np.abs(cov - even).max((-2, -1), keepdims=True) <= _ROUNDING * size
    return np.where(rounding, even, cov)


def lost_rows(updated: Belief, start: Belief, R: np.ndarray | None = None) -> np.ndarray:
    """The rows ``(...)`` of an update that are not finite, are no covariance, or divided by a singular S."""
    finite = finite_rows(updated)
    size = np.maximum(np.abs(updated.cov).max((-2, -1)), np.abs(start.cov).max((-2, -1)))
    cov = np.where(finite[..., None, None], updated.cov, 0.0)
    skew = np.abs(cov - cov.mT).max((-2, -1))
    lost = (
        ~finite | (np.linalg.eigvalsh(cov)[..., 0] < -_ROUNDING * size) | (skew > _ROUNDING * size)
    )
    if R is None or updated.innovation_cov is None:
        return lost
    return lost | (lacks_rank(R) & lacks_rank(updated.innovation_cov))


_ROUNDING = 1e-9
_KNOWN = 16.0 * np.finfo(float).eps
"""A variance that an update leaves is rounding where it is less, as a share of the terms that it is a sum of."""


def _without_offending(
    measurement: Measurement, S: np.ndarray | None
) -> tuple[Measurement, np.ndarray]:
    """The measurement without the channels of which something is not finite, and those that repeat earlier ones.

    Returns:
        The measurement and the rows ``(...)`` in which it is another one.
    """
    kept = np.isfinite(measurement.innovation) & np.isfinite(
        np.diagonal(measurement.R, axis1=-2, axis2=-1)
    )
    for rows in (measurement.C, measurement.H):
        kept = kept & np.isfinite(rows).all(-1)
    if measurement.anomalies is not None:
        kept = kept & np.isfinite(measurement.anomalies).all(-2)
    if S is not None:
        kept = kept & np.isfinite(np.diagonal(S, axis1=-2, axis2=-1))
        _, scaled = equilibrated(masked(S, kept))
        kept = kept & (np.diagonal(semidefinite_cholesky(scaled), axis1=-2, axis2=-1) > 1e-6)
    kept = kept & measurement.available
    return measurement.only(kept), (kept != measurement.available).any(-1)


def unsound_rows(filter: Any, belief: Belief, updated: Belief, rows: np.ndarray) -> np.ndarray:
    """Those of some rows ``(...)`` in which an update is not finite, or a covariance has a negative eigenvalue."""
    sound = finite_rows(updated)[rows]
    with np.errstate(all="ignore"):
        for cov in (belief.cov, *(getattr(updated, name, None) for name in COVARIANCES)):
            if cov is not None:
                sound &= filter._by_rows(positive_pivots, cov[rows])[..., 0] == cov.shape[-1]
    unsound = np.array(rows)
    unsound[rows] = ~sound
    return unsound


def positive_pivots(cov: np.ndarray) -> np.ndarray:
    """Number ``(..., 1)`` of positive pivots of a covariance ``(..., n, n)``, but for the rounding of its trace."""
    size = (_NEGATIVE * np.abs(cov.diagonal(0, -2, -1)).sum(-1) + 1e-300)[..., None, None]
    root = semidefinite_cholesky(cov + size * identity(cov.shape[-1]))
    return (1.0 * (root.diagonal(0, -2, -1) > 0.0)).sum(-1)[..., None]


_NEGATIVE = 0.5e-12
"""An eigenvalue of a covariance that is less negative, as a share of its trace, is left as it is."""
COVARIANCES = "cov", "input_cov", "feedthrough_cov"
