"""Jacobians by differences, of functions that only NumPy can compute; and the check of a user's own."""

from functools import cache

import numpy as np

from estimators.angles import difference, short_way
from estimators.varying import Function

_EPS = float(np.finfo(float).eps)


def values_at(
    name: str, function: Function, points: np.ndarray, u: np.ndarray | None, size: int
) -> tuple[np.ndarray, float]:
    """Values as of `estimators.models.at_points`, and the relative rounding of the type that the function returned."""
    returned = np.asarray(function(points, None if u is None else u[..., None, :]))
    expected = points.shape[:-1] + (size,)
    if returned.shape != expected:
        raise ValueError(
            f"{name} must broadcast over leading axes: "
            f"x of shape {points.shape} gave {returned.shape}, expected {expected}"
        )
    few = returned.dtype in (np.float16, np.float32)
    eps = float(np.finfo(returned.dtype).eps) if few else _EPS
    return returned.astype(float, copy=False), eps


def central_differences(
    name: str, function: Function, x: np.ndarray, u: np.ndarray | None, size: int, angles: tuple[int, ...],
    step: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """``f(x)`` and ``df/dx`` by fourth-order differences of ``step (..., n)``, all columns in one call.

    The second-order ones would turn a rounding of ``f`` in its last digit into 1e-10 of the
    Jacobian. Components in ``angles`` are differenced the short way round, so that it does not
    matter where ``f`` wraps them.

    Raises:
        ValueError: if ``f`` does not broadcast, or returns fewer digits than float64 has.
    """
    n = x.shape[-1]
    points = _offsets(n) * step[..., None, :]
    points += x[..., None, :]
    values, eps = values_at(name, function, points, u, size)
    if eps > _EPS:
        raise ValueError(
            f"{name} returns numbers of few digits (float32?), whose differences are mostly"
            " rounding: compute it in float64, give its Jacobian, or use ukf"
        )
    pairs = values[..., 1:, :].reshape(
        values.shape[:-2] + (2, 2, n, size)
    )  # near and far, to either side
    change = pairs[..., 0, :, :] - pairs[..., 1, :, :]
    for i in angles:
        change[..., i] = short_way(change[..., i])
    columns, far = change[..., 0, :, :], change[..., 1, :, :]
    columns *= 8.0
    columns -= far
    columns /= 12.0 * step[..., None]
    return values[..., 0, :], columns.mT


@cache
def _offsets(n: int) -> np.ndarray:
    """Points of a difference, in steps ``(4 n + 1, n)``: the centre, one step to either side, two steps."""
    eye = np.eye(n)
    return np.concatenate([np.zeros((1, n)), eye, -eye, 2.0 * eye, -2.0 * eye])


def steps(x: np.ndarray, cov: np.ndarray | None, angles: tuple[int, ...] = ()) -> np.ndarray:
    """Steps of a difference in each component ``(..., n)``.

    A share r of the belief's standard deviation, the same for all components: the error of a
    fourth-order difference, ``r^4`` of what bends over a deviation and ``eps F / r`` of rounding,
    is smallest near ``r = (eps F)^(1/5)``, with F the largest state in units of its deviation,
    since what is computed from states is rounded like them. The step is a power of two, so that
    ``x`` plus the step is exact, and has at least half the digits of ``x``. Where the belief has no
    spread there is no scale to follow; the step is then 2^-10. An angle's is 2^-8 rad at most,
    however little is known of it: a step of several turns could not be told from one of none.

    Args:
        x: ``(..., n)``.
        cov: ``(..., n, n)`` covariance of ``x``; None: no spread.
        angles: Indices of the components that are angles.
    """
    size = np.abs(x)
    if cov is None:
        wanted = np.full(x.shape, 2.0**-10)
    else:
        sd = np.sqrt(np.asarray(cov).diagonal(0, -2, -1))
        spread = sd > 0.0
        everywhere = spread.all()
        deviations = (
            size / sd if everywhere else np.where(spread, size, 0.0) / np.where(spread, sd, 1.0)
        )
        share = np.power(_EPS * np.maximum.reduce(deviations, -1, keepdims=True), 0.2)
        wanted = sd * np.minimum(np.maximum(share, 2.0**-10), 2.0**-3)
        if not everywhere:
            wanted = np.where(spread, wanted, 2.0**-10)
    for i in angles:
        wanted[..., i] = np.minimum(wanted[..., i], 2.0**-8)
    return np.ldexp(1.0, np.frexp(np.maximum(wanted, 2.0**-26 * size))[1] - 1)


def check_jacobian(
    name: str, function: Function, jacobian: np.ndarray, x: np.ndarray, u: np.ndarray | None, angles: tuple[int, ...],
    step: np.ndarray,
) -> None:  # fmt: skip
    """Compare a user's Jacobian with differences to either side, between which it must lie where f bends or has a kink.

    A belief may reach much further than f is straight. An entry that differs over ``step (..., n)``
    is therefore compared over shorter ones, too, and is right if it agrees with one.

    Raises:
        ValueError: naming the entry that differs most, both values, and what to look for.
    """
    offsets = _offsets(x.shape[-1])[: 2 * x.shape[-1] + 1]  # one step to either side
    excess, scale = np.full(jacobian.shape, np.inf), np.zeros(jacobian.shape[:-1] + (1,))
    for shorter in (1.0, 2.0**-10, 2.0**-20):
        change = np.maximum(shorter * step, 2.0**-27 * np.abs(x))[..., None, :]
        values, eps = values_at(
            name, function, x[..., None, :] + offsets * change, u, jacobian.shape[-2]
        )
        slopes = difference(values[..., 1:, :], values[..., :1, :], angles).mT / np.concatenate(
            [change, -change], -1
        )
        forward, backward = np.split(slopes, 2, axis=-1)  # (..., size, n) each
        low, high = np.minimum(forward, backward), np.maximum(forward, backward)
        scale = np.fmax(scale, np.maximum(np.abs(low), np.abs(high)).max(-1, keepdims=True))
        rounding = max(1e-8, 4.0 * eps) * np.abs(values[..., 0, :, None]) / step[..., None, :]
        beyond = np.maximum(low - jacobian, jacobian - high) - 1e-3 * scale - rounding
        excess = np.minimum(
            excess, np.where(np.isfinite(beyond) & np.isfinite(low + high), beyond, 0.0)
        )
        if (excess <= 0.0).all():
            return
    worst = np.unravel_index(np.argmax(excess / np.where(scale > 0.0, scale, 1.0)), excess.shape)
    i, j = (int(k) for k in worst[-2:])
    raise ValueError(
        f"{name}_jacobian differs from {name}: entry ({i}, {j}) is {jacobian[worst]:.6g}, "
        f"by differences {0.5 * (forward + backward)[worst]:.6g}"
    )
