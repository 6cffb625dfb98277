"""Forecast and analysis of ensembles: formulas of members and anomalies, as plain NumPy.

Members are last: an ensemble is ``(..., n, N)``, its anomalies ``A (..., n, N)``, and those of the expected
measurements ``Y (..., p, N)``. A missing measurement has unit variance, uncorrelated with the others, zero anomalies
and a zero innovation, so that no formula needs a special case. Keyword arguments are static: a function is compiled
once for each of their values.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from estimators.engine import compiled, repeat
from estimators.engine.matrices import is_traced
from estimators.linalg import (
    cholesky,
    identity,
    inner,
    joined,
    masked,
    semidefinite_cholesky,
    singular,
    solve,
    solve_lower,
    solve_upper,
)
from estimators.localisation import Groups

_TURN = 2.0 * np.pi
_MOST = 100.0
"""Largest squared inflation by the finite-size filter: an absurd measurement shall not inflate unobserved states."""
_ABSURD = 1e300
"""Largest squared innovation that counts: beyond, sums overflow."""
_HUGE = 1e150
"""Pivot of an anomaly that is a combination of others."""
_ONE = np.array(1.0)
Moments = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Members ``(..., n, N)``, their mean, anomalies of the measurements, innovation, mask of those available, and R."""


# --- moments --------------------------------------------------------------------------------------------


def _mean(a: np.ndarray) -> np.ndarray:
    """Means ``(..., k, 1)`` over the members of ``(..., k, N)``, weighted first: sums of large members overflow."""
    return inner(a, np.full((1, a.shape[-1]), 1.0 / a.shape[-1]))


def average(a: np.ndarray) -> np.ndarray:
    """Means ``(..., k)`` over the members of ``(..., k, N)``; NaN where the variance overflows."""
    return np.where(np.isfinite(_mean(a * a)), _mean(a), np.nan)[..., 0]


@compiled(axes=(2, 1), matrices=True)
def covariance(members: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Sample covariance ``(..., n, n)`` of members ``(..., n, N)``."""
    A = members - mean[..., None]
    return inner(A, A) / (A.shape[-1] - 1)


# --- draws ----------------------------------------------------------------------------------------------


def exact_noise(
    root: np.ndarray, normals: np.ndarray, A: np.ndarray | None = None, gram: np.ndarray | None = None
) -> np.ndarray:
    """Noise ``L z (..., k, N)`` with sample mean 0, sample covariance ``L L'`` and no sample correlation with A.

    The normals are centred, lose their regression on the anomalies and are whitened::

        z <- z - (z A') (A A')^+ A        z <- chol(z z' / (N - 1))^-1 z

    A row of zeros stays one. N must be at least r + n + 1, where n is the number of anomalies.

    Source: second-order exact sampling of perturbations, Hoteit, Pham, Gharamti & Luo (2015), Mitigating observation
    perturbation sampling errors in the stochastic EnKF, Mon. Wea. Rev. 143.

    Args:
        root: ``L (..., k, r)``.
        normals: Standard normals ``(..., r, N)``.
        A: Anomalies of the members ``(..., n, N)``; None: there are none.
        gram: ``A A' (..., n, n)``.
    """
    z = normals - _mean(normals)
    if A is not None and gram is not None:
        z = z - _regression(A, gram, z)
        z = z - _mean(z)  # the anomalies' rounding, where these nearly repeat each other
    cov = inner(z, z) / (z.shape[-1] - 1)
    absent = np.where(cov.diagonal(0, -2, -1) == 0.0, 1.0, 0.0)
    W = cholesky(cov + absent[..., None] * identity(cov.shape[-1]))
    return solve_upper(W.mT, root.mT).mT @ z


def _regression(A: np.ndarray, gram: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Projection ``z A' (A A')^+ A (..., r, N)`` of rows ``z`` on the rows of ``A (..., n, N)``."""
    L = semidefinite_cholesky(gram)
    repeats = np.where(L.diagonal(0, -2, -1) == 0.0, _HUGE, 0.0)  # of earlier rows: their share comes out as 0
    L = np.where(identity(gram.shape[-1]) > 0.0, L + repeats[..., None], L)
    return solve_upper(L.mT, solve_lower(L, inner(A, z))).mT @ A


def _centred_noise(root: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """``L n_i (..., k, N)`` with the mean of the normals ``(..., r, N)`` removed."""
    return root @ (normals - _mean(normals))


def redraw(members: np.ndarray, kept: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Members ``(..., n, N)`` of which those not ``kept`` are drawn from the mean and covariance of the others.

    Args:
        members: ``(..., n, N)``, finite where kept.
        kept: Mask ``(..., N)``, at least two a row.
        normals: Standard normals ``(..., n, N)``.
    """
    number = kept.sum(-1)[..., None]
    members = np.where(kept[..., None, :], members, 0.0)
    mean = members.sum(-1) / number
    A = np.where(kept[..., None, :], members - mean[..., None], 0.0)
    root = semidefinite_cholesky(inner(A, A) / (number[..., None] - 1.0))
    return np.where(kept[..., None, :], members, mean[..., None] + root @ normals)


# --- angles ---------------------------------------------------------------------------------------------


def _near(angle: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Angles shifted by whole turns to within half a turn of ``centre``."""
    return angle - _TURN * np.rint((angle - centre) / _TURN)


def _any(mask: np.ndarray) -> np.ndarray:
    """Mask ``(..., k, 1)`` of the components for which a mask ``(..., k, N)`` holds for some member."""
    return inner(1.0 * mask, np.ones((1, mask.shape[-1]))) > 0.0


def _unwrap_step(after: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Angles ``(..., k, N)`` after a step, without the whole turns that some members made and the first did not.

    A transition may wrap its angles. Members that cross the seam would then be a turn away from the others; over one
    step all turn by nearly as much as the first.
    """
    change = after - before
    first = change[..., :1]
    return np.where(_any(np.abs(change - first) > np.pi), before + _near(change, first), after)


def _gather(angle: np.ndarray) -> np.ndarray:
    """Angles ``(..., k, N)`` within half a turn of the first, or of the circular mean if they are spread out."""
    first, ones = angle[..., :1], np.ones((1, angle.shape[-1]))
    centre = np.arctan2(inner(np.sin(angle), ones), inner(np.cos(angle), ones))
    centre = np.where(_any(np.abs(_near(angle, first) - first) > 0.25 * np.pi), centre, first)
    return np.where(np.isfinite(inner(angle * angle, ones)), _near(angle, centre), angle)


def _gather_near(angle: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Angles ``(..., k, N)`` within half a turn of their circular mean, that near ``mean``, if they are spread out."""
    ones = np.ones((1, angle.shape[-1]))
    centre = _near(np.arctan2(inner(np.sin(angle), ones), inner(np.cos(angle), ones)), mean)
    return np.where(_any(np.abs(angle - mean) > 0.25 * np.pi), _near(angle, centre), angle)


def _replace_rows(
    function: Callable[..., np.ndarray], rows: tuple[int, ...], a: np.ndarray, *others: np.ndarray
) -> np.ndarray:
    """``A (..., k, N)`` with some rows, in rising order, replaced by a function of these rows of A and of others."""
    if not rows:
        return a
    picked = ([each[..., i : i + 1, :] for i in rows] for each in (a, *others))
    changed, parts, end = function(*(joined(each, -2) for each in picked)), [], 0
    for j, i in enumerate(rows):
        parts += [a[..., end:i, :]] if i > end else []
        parts.append(changed[..., j : j + 1, :])
        end = i + 1
    parts += [a[..., end:, :]] if end < a.shape[-2] else []
    return joined(parts, -2)


# --- forecast -------------------------------------------------------------------------------------------


@compiled(axes=(1, 2, 2), matrices=True)
def sample(
    mean: np.ndarray, root: np.ndarray, normals: np.ndarray, *, angles: tuple[int, ...], exact: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean ``(..., n)``, members ``x_i = m + L n_i`` of a prior, the noise centred, and their covariance.

    Args:
        mean: ``m (..., n)``.
        root: ``L (..., n, n)``, a square root of the covariance.
        normals: ``(..., n, N)``.
        angles: Components that are gathered where they are spread out: about their circular mean, near ``m``.
        exact: The members have the prior's covariance exactly, see `exact_noise`.
    """
    centre = mean[..., None]
    noise = exact_noise(root, normals) if exact else _centred_noise(root, normals)
    members = _replace_rows(_gather_near, angles, centre + noise, centre)
    mean = _mean(members)[..., 0]
    return mean, members, covariance(members, mean)


@compiled(axes=(2, 2, 2, 2), matrices=True)
def forecast(
    before: np.ndarray, after: np.ndarray, root: np.ndarray, normals: np.ndarray, *, angles: tuple[int, ...],
    exact: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Mean ``(..., n)``, members ``x_i = f(x_i-) + L n_i`` and their covariance ``(..., n, n)``.

    The noise is centred, so that the mean follows the model. With exact draws the covariance is the sum of that of the
    moved members and ``L L'``, but for angles that are spread out; with independent draws it is so in expectation.

    Args:
        before: Members ``(..., n, N)``,
        after: and their transition.
        root: ``L (..., n, r)``, a square root of the process noise covariance.
        normals: ``(..., r, N)``.
        angles: Components that the transition may wrap.
        exact: Draws have no sample correlation with the moved members, see `exact_noise`.
    """
    members = _replace_rows(_unwrap_step, angles, after, before)
    if exact and root.shape[-1] > 0:
        mean = average(members)
        A = members - mean[..., None]
        gram = inner(A, A)
        members = members + exact_noise(root, normals, A, gram)
        if not angles:
            return mean, members, gram / (members.shape[-1] - 1) + inner(root, root)
    elif root.shape[-1] > 0:
        members = members + _centred_noise(root, normals)
    members = _replace_rows(_gather, angles, members)
    mean = average(members)
    return mean, members, covariance(members, mean)


@compiled(axes=(2,), matrices=True)
def expect(measurements: np.ndarray, *, angles: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Mean ``(..., p)`` and anomalies ``(..., p, N)`` of the measurements that the members expect."""
    measurements = _replace_rows(_gather, angles, measurements)
    mean = average(measurements)
    return mean, measurements - mean[..., None]


# --- analysis -------------------------------------------------------------------------------------------


@compiled(axes=(2, 1, 2, 1, 1, 2, 2, 2, 2, 2), matrices=True)
def perturbed_analysis(
    members: np.ndarray, mean: np.ndarray, Y: np.ndarray, innovation: np.ndarray, available: np.ndarray,
    R: np.ndarray, root: np.ndarray, normals: np.ndarray, taper: np.ndarray, cov: np.ndarray, *,
    inflation: float, exact: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Stochastic analysis ``x_i = x_i- + K (y + v_i - h(x_i-))`` with ``K = (C P)' S^-1``.

    Args:
        members: ``(..., n, N)``,
        mean: and their mean ``(..., n)``.
        Y: ``(..., p, N)`` anomalies of the expected measurements.
        innovation: ``(..., p)``.
        available: Mask ``(..., p)``.
        R: ``(..., p, p)`` measurement covariance,
        root: and a square root of it; of the whole R, or of the available measurements.
        normals: ``(..., p, N)``; finite or not where the root of the available measurements has no use for them.
        taper: ``(p, n)`` factors on the gain.
        cov: Covariance of the members ``(..., n, n)``.
        inflation: Factor on the anomalies of components that a measurement may correct.
        exact: Perturbations have no sample correlation with the members, see `exact_noise`.

    Returns:
        The mean and members of the analysis, and ``S``.
    """
    N = members.shape[-1]
    A, Y = members - mean[..., None], np.where(available[..., None], Y, 0.0)
    S = inner(Y, Y) / (N - 1) + R
    gain = np.where(taper > 0.0, taper * solve(S, inner(Y, A) / (N - 1)), 0.0)
    arrived = 1.0 * available
    used = np.vecmat(arrived, 1.0 * (np.abs(root) > 0.0)) > 0.0
    normals = np.where(used[..., None], normals, 0.0)
    noise = exact_noise(root, normals, A, cov * (N - 1.0)) if exact else _centred_noise(root, normals)
    A = A + gain.mT @ (noise - Y)
    corrected = np.vecmat(arrived, 1.0 * (taper > 0.0)) > 0.0
    factor = np.where(corrected, inflation, 1.0)[..., None]
    after = (mean + np.vecmat(innovation, gain))[..., None] + factor * A
    return average(after), after, S


@compiled(axes=(2, 1, 2, 1, 1, 2), matrices=True)
def transform_analysis(
    members: np.ndarray, mean: np.ndarray, Y: np.ndarray, innovation: np.ndarray, available: np.ndarray,
    R: np.ndarray, *, inflation: float, certainty: float, regular: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Deterministic analysis by the symmetric transform ``A T``, ``T = (I + Y' R^-1 Y / (N - 1))^-1/2``.

    Args:
        members: ``(..., n, N)``,
        mean: and their mean ``(..., n)``.
        Y: ``(..., p, N)`` anomalies of the expected measurements.
        innovation: ``(..., p)``.
        available: Mask ``(..., p)``.
        R: ``(..., p, p)`` measurement covariance.
        inflation: Factor on the anomalies where a measurement is available.
        certainty: Of the scale of the anomalies, which `finite_size_inflation` then adapts, too; 0: it does not.
        regular: R is nonsingular, so that T may be formed, N x N, where measurements outnumber the members.

    Returns:
        The mean and members of the analysis, and ``S``.
    """
    N, p = members.shape[-1], Y.shape[-2]
    A, Y = members - mean[..., None], np.where(available[..., None], Y, 0.0)
    S = inner(Y, Y) / (N - 1) + R
    analysis = _transform if regular and p > N else _reduced_gain
    shift, A, x = analysis(A, Y, innovation, S, R, certainty)
    arrived = (1.0 * available).sum(-1) > 0.0
    factor = np.where(arrived, inflation * np.sqrt(x), 1.0)[..., None, None]
    after = (mean + shift)[..., None] + factor * A
    return average(after), after, S


def local_analysis(
    moments: Moments, groups: Groups, *, inflation: float, certainty: float, regular: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same as `transform_analysis` for each group of states, with R divided by its taper: each group is a row."""
    members, mean, Y, e, available, R = moments
    traced = is_traced(members)
    if traced:  # one after the other
        groups = tuple(group for together in groups for group in zip(*together, strict=True))
    means: dict[Any, np.ndarray] = {}
    rows: dict[Any, np.ndarray] = {}
    for states, channels, roots in groups:
        own, own_mean = np.take(members, states, -2), np.take(mean, states, -1)
        if channels.shape[-1] > 0:
            block = (
                np.take(np.take(R, channels, -2), channels, -1)
                if traced
                else (R[..., channels[:, :, None], channels[:, None, :]])
            )
            own_mean, own, _ = transform_analysis(
                own, own_mean, roots[..., None] * np.take(Y, channels, -2), roots * np.take(e, channels, -1),
                np.take(available, channels, -1), block,
                inflation=inflation, certainty=certainty, regular=regular,
            )  # fmt: skip
        for place in np.ndindex(states.shape):
            at = slice(place[-1], place[-1] + 1)
            means[states[place]], rows[states[place]] = own_mean[..., *place[:-1], at], own[..., *place[:-1], at, :]
    after_mean, after = (
        np.concatenate([parts[i] for i in range(len(parts))], axis) for parts, axis in ((means, -1), (rows, -2))
    )
    return after_mean, after, innovation_covariance(Y, available, R)


@compiled(axes=(2, 1, 2), matrices=True)
def innovation_covariance(Y: np.ndarray, available: np.ndarray, R: np.ndarray) -> np.ndarray:
    """``S (..., p, p)`` of anomalies ``(..., p, N)``, a mask ``(..., p)`` and ``R (..., p, p)``."""
    Y = np.where(available[..., None], Y, 0.0)
    return inner(Y, Y) / (Y.shape[-1] - 1) + R


def _reduced_gain(
    A: np.ndarray, Y: np.ndarray, e: np.ndarray, S: np.ndarray, R: np.ndarray, certainty: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shift of the mean ``(..., n)``, anomalies ``A - K~ Y``, and their squared inflation, which they still need.

    With ``S = L L'`` and the singular value decomposition ``L^-1 R^1/2 = V s U'``::

        K = (C P)' L'^-1 L^-1        K~ = (C P)' L'^-1 V (I + s)^-1 V' L^-1
    """
    L, N = cholesky(S), A.shape[-1]
    s, V = singular(solve_lower(L, semidefinite_cholesky(R)).mT)
    CP = solve_lower(L, inner(Y, A) / (N - 1))
    e = solve_lower(L, e[..., None])[..., 0]
    x, soft = _ONE, 1.0 / (1.0 + s)
    if certainty > 0.0:
        along, share = np.vecmat(e, V), s * s
        x = finite_size_inflation(share, along * along, N, certainty)
        q = x[..., None] * (1.0 - share) + share
        e = np.matvec(V, x[..., None] / q * along)
        soft = x[..., None] / (q + np.sqrt(q) * s)
    gain = solve_upper(L.mT, V @ (soft[..., None] * (V.mT @ CP)))
    return np.vecmat(e, CP), A - gain.mT @ Y, x


def _transform(
    A: np.ndarray, Y: np.ndarray, e: np.ndarray, S: np.ndarray, R: np.ndarray, certainty: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same as `_reduced_gain`, with ``T = (I + x G)^-1/2`` and ``G = Y' R^-1 Y / (N - 1)``, N x N.

    Less work than p x p where measurements outnumber the members, and more accurate, as S is ill-conditioned there
    (Bishop et al. 2001).
    """
    L, N = cholesky(R), A.shape[-1]
    white, e = solve_lower(L, Y), solve_lower(L, e[..., None])[..., 0]
    s, V = singular(white / np.sqrt(N - 1))
    v, along, x = s * s, np.vecmat(np.vecmat(e, white) / (N - 1), V), _ONE
    if certainty > 0.0:
        share = 1.0 / (1.0 + v)
        spanned = v > 1e-14 * v.sum(-1)[..., None]
        size = np.where(spanned, share * along * along * (N - 1) / np.where(spanned, v, 1.0), 0.0)
        x = finite_size_inflation(share, size, N, certainty)
    v, AV = x[..., None] * v, A @ V
    root = np.sqrt(1.0 + v)
    shift = np.matvec(AV, x[..., None] * along / (1.0 + v))
    return shift, A - (AV * (v / (root * (1.0 + root)))[..., None, :]) @ V.mT, x


def finite_size_inflation(share: np.ndarray, size: np.ndarray, N: int, certainty: float) -> np.ndarray:
    """Squared inflation ``x (...)`` of the anomalies by the finite-size filter EnKF-N, in its dual form.

    The minimum of ``sum_m z_m^2 / q_m / (N - 1) + a / x + b log x`` downhill of 1, ``q = x (1 - m) + m``: the
    likelihood of the measurement, and a prior of the scale worth ``certainty`` samples of N. The mode of the prior
    tends to 1 for measurements without information (Bocquet, Raanes & Hannart 2015, eq. 36).

    Args:
        share: Eigenvalues ``m (..., k)`` of R in units of S.
        size: ``z^2 (..., k)``, squared innovation along their directions in units of S.
        N: Members.
        certainty: Above 0.
    """
    a, b = (N + 1.0) / N, N / (N - 1.0)
    mode = np.exp(np.log(a / b) * 0.5 / N * (N - share.shape[-1] + share.sum(-1)))
    a, b = certainty * a / mode, certainty * b * mode
    size, rest = np.minimum(size, _ABSURD), np.maximum(1.0 - share, 0.0)
    directions = [(share[..., m], rest[..., m], size[..., m]) for m in range(share.shape[-1])]

    def is_below(x: np.ndarray) -> np.ndarray:
        slope = a / x - b
        for m, r, z in directions:
            q = x * r + m
            slope = slope + x * r * z / (q * q) / (N - 1)
        return slope > 0.0

    def halve(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x = 0.5 * (low + high)
        below = is_below(x)
        return np.where(below, x, low), np.where(below, high, x)

    grows = is_below(_ONE)
    return repeat(50, halve, np.where(grows, 1.0, 1.0 / _MOST), np.where(grows, _MOST, 1.0))[0]


def evensen_transform(
    after: np.ndarray, after_mean: np.ndarray, S: np.ndarray, moments: Moments, groups: Groups, inflation: float
) -> np.ndarray:
    """Members ``(..., n, N)`` with the anomalies as published by Evensen (2004): without the last ``V'``.

    Args:
        after: Members,
        after_mean: mean,
        S: and innovation covariance of `local_analysis`.
        moments: Its arguments.
        groups: Likewise.
        inflation: Likewise.
    """
    members, mean, Y, _, available, _ = moments
    after, N = np.array(after), members.shape[-1]
    for states, channels in ((own, used) for block in groups for own, used in zip(*block[:2], strict=True)):
        used = available & np.isin(np.arange(Y.shape[-2]), channels)
        X = np.linalg.inv(cholesky(masked(S, used))) @ np.where(used[..., None], Y, 0.0) / np.sqrt(N - 1)
        X[~np.isfinite(X).all((-2, -1))] = 0.0  # rows without a finite mean are lost anyway
        _, s, Vt = np.linalg.svd(X)
        scale = np.ones(X.shape[:-2] + (N,))
        scale[..., : s.shape[-1]] = np.sqrt(np.maximum(1.0 - s**2, 0.0))
        anomalies = scale[..., None] * (Vt @ (members - mean[..., None]).mT)  # (..., N, n)
        factor = np.where(used.any(-1), inflation, 1.0)[..., None]
        turned = (after_mean + (1.0 - factor) * anomalies.mean(-2))[..., None] + factor[..., None] * anomalies.mT
        after[..., states, :] = turned[..., states, :]
    return after


# --- rotation -------------------------------------------------------------------------------------------


def rotate_anomalies(anomalies: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Centred anomalies ``(..., N, n)`` after a uniformly random rotation of the members that keeps their mean.

    An N x N rotation moves ``A = V R`` (V orthonormal, R small) to ``V* R`` with V* uniform on the frames orthogonal to
    the vector of ones, so V* is drawn instead: O(N r^2) for rank r.

    Args:
        anomalies: With zero mean over the members.
        normals: Standard normals ``(..., N - 1, r)`` with r = min(N - 1, n).
    """
    frame, triangle = np.linalg.qr(normals)
    frame *= np.where(np.diagonal(triangle, axis1=-2, axis2=-1) < 0.0, -1.0, 1.0)[..., None, :]  # makes it uniform
    turned = np.zeros(anomalies.shape)
    turned[..., 1:, :] = frame @ np.linalg.qr(_reflected(anomalies)[..., 1:, :], mode="r")
    return _reflected(turned)


def _reflected(a: np.ndarray) -> np.ndarray:
    """``(..., N, k)`` mirrored so that the first unit vector and the normalised vector of ones change places."""
    members = a.shape[-2]
    normal = np.full(members, -1.0 / np.sqrt(members))
    normal[0] += 1.0
    return a - normal[:, None] * (np.vecmat(normal, a) * (2.0 / (normal @ normal)))[..., None, :]
