"""Forecast and analysis of ensembles: formulas of members and anomalies, as plain NumPy.

Members are last: an ensemble is ``(..., n, N)``, its anomalies ``A (..., n, N)``, and those of the
expected measurements ``Y (..., p, N)``. A missing measurement has unit variance, uncorrelated with
the others, zero anomalies and a zero innovation, so that no formula needs a special case. Keyword
arguments are static: a function is compiled once for each of their values.
"""

from collections.abc import Callable

import numpy as np

from estimators.engine import compiled
from estimators.linalg import (
    cholesky,
    identity,
    inner,
    joined,
    regular_root,
    rescuing,
    semidefinite_cholesky,
    singular,
    solve,
    solve_lower,
    solve_upper,
)

_TURN = 2.0 * np.pi


# --- moments --------------------------------------------------------------------------------------


def _mean(a: np.ndarray) -> np.ndarray:
    """Means ``(..., k, 1)`` over members ``(..., k, N)``, weighted first as sums may overflow."""
    return inner(a, np.full((1, a.shape[-1]), 1.0 / a.shape[-1]))


def average(a: np.ndarray) -> np.ndarray:
    """Means ``(..., k)`` over the members of ``(..., k, N)``; NaN where the variance overflows."""
    return np.where(np.isfinite(_mean(a * a)), _mean(a), np.nan)[..., 0]


def covariance(members: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Sample covariance ``(..., n, n)`` of members ``(..., n, N)``."""
    A = members - mean[..., None]
    return inner(A, A) / (A.shape[-1] - 1)


# --- draws ----------------------------------------------------------------------------------------


def exact_noise(
    root: np.ndarray,
    normals: np.ndarray,
    A: np.ndarray | None = None,
    gram: np.ndarray | None = None,
) -> np.ndarray:
    """Noise ``L z (..., k, N)``: sample mean 0, covariance ``L L'``, no correlation with A.

    The normals are centred, lose their regression on the anomalies and are whitened::

        z <- z - (z A') (A A')^+ A        z <- chol(z z' / (N - 1))^-1 z

    A row of zeros stays one. N must be at least r + n + 1, where n is the number of anomalies.

    Source: second-order exact sampling of perturbations, Hoteit, Pham, Gharamti & Luo (2015),
    Mitigating observation perturbation sampling errors in the stochastic EnKF, Mon. Wea. Rev. 143.

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
    L = regular_root(gram)  # a row that repeats earlier ones has no share
    return solve_upper(L.mT, solve_lower(L, inner(A, z))).mT @ A


def _centred_noise(root: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """``L n_i (..., k, N)`` with the mean of the normals ``(..., r, N)`` removed."""
    return root @ (normals - _mean(normals))


def redraw(members: np.ndarray, kept: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Members ``(..., n, N)``, those not ``kept`` drawn from mean and covariance of the others.

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


# --- angles ---------------------------------------------------------------------------------------


def _near(angle: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Angles shifted by whole turns to within half a turn of ``centre``."""
    return angle - _TURN * np.rint((angle - centre) / _TURN)


def _any(mask: np.ndarray) -> np.ndarray:
    """Components ``(..., k, 1)`` for which a mask ``(..., k, N)`` holds for some member."""
    return inner(1.0 * mask, np.ones((1, mask.shape[-1]))) > 0.0


def _unwrap_step(after: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Angles ``(..., k, N)`` after a step, without whole turns that the first did not make.

    A transition may wrap its angles. Members that cross the seam would then be a turn away from the
    others; over one step all turn by nearly as much as the first.
    """
    change = after - before
    first = change[..., :1]
    return np.where(_any(np.abs(change - first) > np.pi), before + _near(change, first), after)


def _gather(angle: np.ndarray, about: np.ndarray | None = None) -> np.ndarray:
    """Angles ``(..., k, N)`` within half a turn of their circular mean, if they are spread out.

    Otherwise within half a turn of ``about (..., k, 1)``, near which that mean then lies, or of the
    first member.
    """
    ones, first = np.ones((1, angle.shape[-1])), angle[..., :1] if about is None else about
    centre = np.arctan2(inner(np.sin(angle), ones), inner(np.cos(angle), ones))
    centre = centre if about is None else _near(centre, about)
    centre = np.where(_any(np.abs(_near(angle, first) - first) > 0.25 * np.pi), centre, first)
    return np.where(np.isfinite(inner(angle * angle, ones)), _near(angle, centre), angle)


def _replace_rows(
    function: Callable[..., np.ndarray], rows: tuple[int, ...], a: np.ndarray, *others: np.ndarray
) -> np.ndarray:
    """``A (..., k, N)`` with some rows replaced by a function of these rows of A and of others."""
    if not rows:
        return a
    picked = ([each[..., i : i + 1, :] for i in rows] for each in (a, *others))
    changed = function(*(joined(each, -2) for each in picked))
    parts = [a[..., i : i + 1, :] for i in range(a.shape[-2])]
    for j, i in enumerate(rows):
        parts[i] = changed[..., j : j + 1, :]
    return joined(parts, -2)


# --- forecast -------------------------------------------------------------------------------------


@compiled(axes=(1, 2, 2), matrices=True)
def sample(
    mean: np.ndarray, root: np.ndarray, normals: np.ndarray, *, angles: tuple[int, ...], exact: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean ``(..., n)``, members ``x_i = m + L n_i`` of a prior, and their covariance.

    Args:
        mean: ``m (..., n)``.
        root: ``L (..., n, n)``, a square root of the covariance.
        normals: ``(..., n, N)``.
        angles: Components that are gathered where they are spread out: about their circular mean,
            near ``m``.
        exact: The members have the prior's covariance exactly, see `exact_noise`.
    """
    centre = mean[..., None]
    noise = exact_noise(root, normals) if exact else _centred_noise(root, normals)
    members = _replace_rows(_gather, angles, centre + noise, centre)
    mean = _mean(members)[..., 0]
    return mean, members, covariance(members, mean)


def forecast(
    before: np.ndarray, after: np.ndarray, root: np.ndarray, normals: np.ndarray, *,
    angles: tuple[int, ...], exact: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Mean ``(..., n)``, members ``x_i = f(x_i-) + L n_i`` and their covariance ``(..., n, n)``.

    The noise is centred, so that the mean follows the model. With exact draws the covariance is the
    sum of that of the moved members and ``L L'``, but for angles that are spread out; with
    independent draws it is so in expectation.

    Args:
        before: Members ``(..., n, N)``,
        after: and their transition.
        root: ``L (..., n, r)``, a square root of the process noise covariance.
        normals: ``(..., r, N)``.
        angles: Components that the transition may wrap.
        exact: Draws have no sample correlation with the moved members, see `exact_noise`.
    """
    members, noisy = _replace_rows(_unwrap_step, angles, after, before), root.shape[-1] > 0
    if noisy and exact:
        mean = average(members)
        A = members - mean[..., None]
        gram = inner(A, A)
        members = members + exact_noise(root, normals, A, gram)
        if not angles:
            return mean, members, gram / (members.shape[-1] - 1) + inner(root, root)
    elif noisy:
        members = members + _centred_noise(root, normals)
    members = _replace_rows(_gather, angles, members)
    mean = average(members)
    return mean, members, covariance(members, mean)


def expect(measurements: np.ndarray, *, angles: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Mean ``(..., p)`` and anomalies ``(..., p, N)`` of members' expected measurements."""
    measurements = _replace_rows(_gather, angles, measurements)
    mean = average(measurements)
    return mean, measurements - mean[..., None]


# --- analysis -------------------------------------------------------------------------------------


def perturbed_analysis(
    members: np.ndarray, mean: np.ndarray, Y: np.ndarray, innovation: np.ndarray,
    available: np.ndarray, R: np.ndarray, root: np.ndarray, normals: np.ndarray, cov: np.ndarray, *,
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
        normals: ``(..., p, N)``; finite or not where the root of the available measurements has no
            use for them.
        cov: Covariance of the members ``(..., n, n)``.
        inflation: Factor on the anomalies where a measurement is available.
        exact: Perturbations have no sample correlation with the members, see `exact_noise`.

    Returns:
        The mean and members of the analysis, and ``S``.
    """
    N, A = members.shape[-1], members - mean[..., None]
    Y, S = _seen(Y, available, R)
    gain = solve(S, inner(Y, A) / (N - 1))
    used = np.vecmat(1.0 * available, 1.0 * (np.abs(root) > 0.0)) > 0.0
    normals = np.where(used[..., None], normals, 0.0)
    noise = (
        exact_noise(root, normals, A, cov * (N - 1.0)) if exact else _centred_noise(root, normals)
    )
    A = A + gain.mT @ (noise - Y)
    return *_inflated(mean + np.vecmat(innovation, gain), A, available, inflation), S


def transform_analysis(
    members: np.ndarray, mean: np.ndarray, Y: np.ndarray, innovation: np.ndarray,
    available: np.ndarray, R: np.ndarray, *, inflation: float, regular: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Deterministic analysis by the symmetric ``A T``, ``T = (I + Y' R^-1 Y / (N - 1))^-1/2``.

    Args:
        members: ``(..., n, N)``,
        mean: and their mean ``(..., n)``.
        Y: ``(..., p, N)`` anomalies of the expected measurements.
        innovation: ``(..., p)``.
        available: Mask ``(..., p)``.
        R: ``(..., p, p)`` measurement covariance.
        inflation: Factor on the anomalies where a measurement is available.
        regular: R has an inverse.

    Returns:
        The mean and members of the analysis, and ``S``.
    """
    Y, S = _seen(Y, available, R)
    # T, N x N, needs an inverse of R, which lost rows may not have.
    regular = regular and not rescuing()
    analysis = _transform if regular and Y.shape[-2] > Y.shape[-1] else _reduced_gain
    shift, A = analysis(members - mean[..., None], Y, innovation, S, R)
    return *_inflated(mean + shift, A, available, inflation), S


def _seen(Y: np.ndarray, available: np.ndarray, R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Anomalies of the measurements that arrived, and S ``(..., p, p)``."""
    Y = np.where(available[..., None], Y, 0.0)
    return Y, inner(Y, Y) / (Y.shape[-1] - 1) + R


def _inflated(
    mean: np.ndarray, A: np.ndarray, available: np.ndarray, inflation: float
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and members about a mean, their anomalies inflated where a measurement arrived."""
    arrived = (1.0 * available).sum(-1) > 0.0
    members = mean[..., None] + np.where(arrived, inflation, 1.0)[..., None, None] * A
    return average(members), members


def _reduced_gain(
    A: np.ndarray, Y: np.ndarray, e: np.ndarray, S: np.ndarray, R: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Shift of the mean ``(..., n)`` and anomalies ``A - K~ Y``, not yet inflated.

    With ``S = L L'`` and the singular value decomposition ``L^-1 R^1/2 = V s U'``::

        K = (C P)' L'^-1 L^-1        K~ = (C P)' L'^-1 V (I + s)^-1 V' L^-1
    """
    L, N = cholesky(S), A.shape[-1]
    s, V = singular(solve_lower(L, semidefinite_cholesky(R)).mT)
    CP = solve_lower(L, inner(Y, A) / (N - 1))
    e = solve_lower(L, e[..., None])[..., 0]
    gain = solve_upper(L.mT, V @ ((1.0 / (1.0 + s))[..., None] * (V.mT @ CP)))
    return np.vecmat(e, CP), A - gain.mT @ Y


def _transform(
    A: np.ndarray, Y: np.ndarray, e: np.ndarray, S: np.ndarray, R: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Shift of the mean and anomalies as of `_reduced_gain`, with the N x N transform T itself.

    Less work than p x p where measurements outnumber the members, and more accurate, as S is
    ill-conditioned there (Bishop et al. 2001).
    """
    L, N = cholesky(R), A.shape[-1]
    white, e = solve_lower(L, Y), solve_lower(L, e[..., None])[..., 0]
    s, V = singular(white / np.sqrt(N - 1))
    v, along = s * s, np.vecmat(np.vecmat(e, white) / (N - 1), V)
    AV, root = A @ V, np.sqrt(1.0 + v)
    shift = np.matvec(AV, along / (1.0 + v))
    return shift, A - (AV * (v / (root * (1.0 + root)))[..., None, :]) @ V.mT
