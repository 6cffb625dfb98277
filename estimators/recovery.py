"""Recovery of rows whose step is not finite, or gives an invalid covariance.

Such rows are computed once more in NumPy: with pseudo-inverses in place of inverses, from a
covariance without negative eigenvalues, and without channels that are not finite
(`estimators.linalg.rescue`). A row that fails again keeps its values.
"""

from typing import Any

import numpy as np

from estimators.belief import Record, unmeasured
from estimators.linalg import (
    congruence,
    diagonal,
    identity,
    lacks_rank,
    masked,
    pseudo_inverse,
    rescue,
    semidefinite,
    symmetric_blocks,
)
from estimators.stepping import in_numpy, rows_of

_CROSS = {"cov": "", "input_cov": "state_input_cov", "feedthrough_cov": "state_feedthrough_cov"}
"""Covariances of a belief, and the name of each one's cross-covariance with the state."""
_KNOWN = 16.0 * np.finfo(float).eps
"""A variance after an update is rounding below this share of the terms that it is a sum of."""
_NEGATIVE = 1e-12
"""An eigenvalue of a covariance that is less negative, as a share of its trace, is rounding."""


def recovered(filter: Any, step: str, belief: Record, after: Record, data: Any) -> Record:
    """The belief ``after``, with rows that are not ``healthy`` checked, and recomputed where lost.

    Args:
        filter: The filter.
        step: "predict", "update", or "step" for both together.
        belief: The belief before the step.
        after: The belief after the step.
        data: The step's `estimators.filter.Data`.
    """
    # Where each row has a model of its own, rows cannot be computed apart.
    rows = after.healthy | True if filter.model_per_row else ~after.healthy
    data = rows_of(data, rows)
    with np.errstate(all="ignore"):
        before, found = belief[rows], after[rows]
        lost = ~_sound(found, step)
        if lost.any():
            apart = lost | filter.model_per_row
            some = rows_of(data, apart)
            again = before[apart].replaced({"u": some[0]})
            if step != "update":
                again = again.replaced(unmeasured(again.healthy.shape, filter.model.p))
                again = _attempt(filter, "predict", again, some)
            if step != "predict":
                again = _attempt(filter, "update", again, some)
            found = found.with_rows(lost, again[lost[apart]])
        if step == "update" and not filter.random:
            found = _without_rounding(filter, before, found, data)
    return after.with_rows(rows, found.replaced({"healthy": ~lost}))


def _sound(belief: Any, step: str) -> np.ndarray:
    """Mask ``(...)`` of rows that are finite, with valid covariances and a regular S."""
    sound = _finite(belief)
    for name in _CROSS:
        if name in belief.names():
            cov = np.where(sound[..., None, None], _with_state(belief, name), 0.0)
            values = np.linalg.eigvalsh(cov)
            sound &= values[..., 0] >= -_NEGATIVE * np.abs(values).sum(-1)
            sound &= (diagonal(cov) >= 0.0).all(-1)
    return sound if step == "predict" else sound & ~lacks_rank(belief.innovation_cov)


def _with_state(belief: Any, name: str) -> np.ndarray:
    """A covariance of a belief together with that of the state."""
    if name == "cov":
        return belief.cov
    return symmetric_blocks(belief.cov, getattr(belief, _CROSS[name]), getattr(belief, name))


def _clipped(belief: Any) -> Any:
    """The belief with negative eigenvalues of its covariances set to 0."""
    n = belief.cov.shape[-1]
    for name, cross in _CROSS.items():
        if name in belief.names():
            cov = semidefinite(_with_state(belief, name))
            variance = diagonal(cov)
            none = (variance <= 0.0) & np.isfinite(variance)
            cov = np.where(none[..., None] | none[..., None, :], 0.0, cov)
            parts = {cross: cov[..., :n, n:], name: cov[..., n:, n:]} if cross else {}
            belief = belief.replaced(parts | {"cov": cov[..., :n, :n]})
    return belief


def _finite(belief: Any) -> np.ndarray:
    """The rows ``(...)`` of which every array is finite."""
    finite, batch = np.ones_like(belief.healthy), belief.mean.ndim - 1
    for name in belief.names():
        array = getattr(belief, name)
        finite &= np.isfinite(array).all(tuple(range(batch, array.ndim)))
    return finite


def _attempt(filter: Any, step: str, belief: Any, data: Any) -> Any:
    """A prediction or an update in rescue; rows that are not finite keep what they had."""
    with rescue():
        after = filter._repaired(step, belief, data)
        after = after.replaced(in_numpy(filter, step, after, data))
    if not filter.random:
        after = _clipped(after)
    lost = ~_finite(after)
    return after.with_rows(lost, belief[lost])


def _without_rounding(filter: Any, before: Any, after: Any, data: Any) -> Any:
    """An update with 0 for variances of which noise-free measurements have left only rounding."""
    u, y, available, R, _ = data
    R = masked(filter._noise(before, u, R), available & np.isfinite(y))
    singular = lacks_rank(R)
    if not singular.any():
        return after
    S, C = after.innovation_cov, filter.expect(before, u)[1]
    C = np.where(after.available[..., None], C, 0.0)
    K = before.cov @ C.mT @ pseudo_inverse(S)
    terms = congruence(np.abs(identity(before.cov.shape[-1]) - K @ C), np.abs(before.cov))
    variance, size, noise = (diagonal(P) for P in (after.cov, terms, congruence(K, R)))
    known = (variance <= _KNOWN * size) & (variance > 2.0 * noise) & singular[..., None]
    row = known[..., None]
    changed = {"cov": np.where(row | known[..., None, :], 0.0, after.cov)}
    for cross in after.names():
        if cross in _CROSS.values():
            changed[cross] = np.where(row, 0.0, getattr(after, cross))
    return after.replaced(changed)
