"""Jacobians by differences, of functions in NumPy."""

from functools import cache

import numpy as np

from estimators.angles import short_way
from estimators.varying import Function, sized

_EPS = float(np.finfo(float).eps)


def central_differences(
    name: str, function: Function, x: np.ndarray, u: np.ndarray | None, size: int,
    angles: tuple[int, ...], step: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """``f(x)`` and ``df/dx`` by fourth-order differences of ``step (..., n)``, in one call.

    Second-order differences would turn a rounding of ``f`` in its last digit into 1e-10 of the
    Jacobian. Components in ``angles`` are differenced the short way round, so that it does not
    matter where ``f`` wraps them.

    Raises:
        ValueError: if ``f`` returns other than ``size`` values, or fewer digits than float64 has.
    """
    n = x.shape[-1]
    points = x[..., None, :] + _offsets(n) * step[..., None, :]
    values = np.asarray(function(points, None if u is None else u[..., None, :]))
    if values.dtype.kind == "f" and values.dtype.itemsize < 8:
        raise ValueError(
            f"{name} returns numbers of few digits (float32?), whose differences are mostly"
            " rounding: compute it in float64, give its Jacobian, or use ukf"
        )
    values = sized(name, values.astype(float, copy=False), size)
    sides = values[..., 1:, :].reshape(*x.shape[:-1], 2, 2, n, size)  # near, far; above, below
    change = sides[..., 0, :, :] - sides[..., 1, :, :]
    for i in angles:
        change[..., i] = short_way(change[..., i])
    columns = (8.0 * change[..., 0, :, :] - change[..., 1, :, :]) / (12.0 * step[..., None])
    return values[..., 0, :], columns.mT


@cache
def _offsets(n: int) -> np.ndarray:
    """Points of a difference, in steps ``(4 n + 1, n)``: centre, one step to either side, two."""
    eye = np.eye(n)
    return np.concatenate([np.zeros((1, n)), eye, -eye, 2.0 * eye, -2.0 * eye])


def steps(x: np.ndarray, cov: np.ndarray | None, angles: tuple[int, ...] = ()) -> np.ndarray:
    """Steps of a difference in each component ``(..., n)``.

    The step is a share r of the belief's standard deviation, the same for all components. A
    fourth-order difference has an error of ``r^4`` from curvature and of ``eps F / r`` from
    rounding, which is smallest near ``r = (eps F)^(1/5)``. F is the largest state in units of its
    deviation, as values computed from states are rounded like these. The step is a power of two, so
    that ``x`` plus the step is exact, and has at least half the digits of ``x``. Without spread the
    step is 2^-10. The step of an angle is 2^-8 rad at most, because larger ones could be whole
    turns.

    Args:
        x: ``(..., n)``.
        cov: ``(..., n, n)`` covariance of ``x``; None: no spread.
        angles: Indices of the components that are angles.
    """
    size, wanted = np.abs(x), np.full(x.shape, 2.0**-10)
    if cov is not None:
        sd = np.sqrt(np.asarray(cov).diagonal(0, -2, -1))
        spread = sd > 0.0
        deviations = np.where(spread, size, 0.0) / np.where(spread, sd, 1.0)
        share = np.power(_EPS * deviations.max(-1, keepdims=True), 0.2)
        wanted = np.where(spread, sd * np.clip(share, 2.0**-10, 2.0**-3), wanted)
    for i in angles:
        wanted[..., i] = np.minimum(wanted[..., i], 2.0**-8)
    return np.ldexp(1.0, np.frexp(np.maximum(wanted, 2.0**-26 * size))[1] - 1)
