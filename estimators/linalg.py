"""Small dense linear algebra over batches: covariances ``(..., n, n)`` and vectors ``(..., n)``."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache, lru_cache
from typing import Any

import numpy as np

from estimators.checks import frozen
from estimators.engine import is_traced, linear


@cache
def identity(n: int) -> np.ndarray:
    """The identity ``(n, n)``, read-only and cached."""
    return frozen(np.eye(n))


def diagonal(a: np.ndarray) -> np.ndarray:
    """The diagonals ``(..., n)`` of matrices ``(..., n, n)``."""
    return a.diagonal(0, -2, -1)


def all_finite(a: np.ndarray) -> np.ndarray:
    """Mask ``(...)`` of the matrices ``(..., i, j)`` whose entries are all finite."""
    return np.isfinite(a).all((-2, -1))


def symmetrise(a: np.ndarray) -> np.ndarray:
    """The symmetric part of ``(..., n, n)``, so that rounding never accumulates."""
    return linear.symmetrise(a) if is_traced(a) else 0.5 * (a + a.mT)


def congruence(a: np.ndarray, p: np.ndarray) -> np.ndarray:
    """``A P A'``: the covariance of a linear map."""
    if is_traced(a) or is_traced(p):
        return linear.congruence(a, p)
    return a @ p @ a.mT


def masked(R: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """R ``(..., p, p)`` with a unit, uncorrelated variance where ``kept (..., p)`` is False."""
    return np.where(kept[..., None] & kept[..., None, :], R, identity(R.shape[-1]))


@np.errstate(all="ignore")
def equilibrated(s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations ``(..., p)``, 1 where a variance is 0, and S in these units."""
    scale = np.sqrt(diagonal(s))
    scale = np.where(scale > 0.0, scale, 1.0)
    return scale, s / scale[..., None] / scale[..., None, :]


def joined(parts: Sequence[np.ndarray], axis: int) -> np.ndarray:
    """Matrices ``(..., i, j)`` below (axis -2) or beside (axis -1) each other, in one batch."""
    batch = np.broadcast_shapes(*(part.shape[:-2] for part in parts))
    return np.concatenate([np.broadcast_to(part, batch + part.shape[-2:]) for part in parts], axis)


def symmetric_blocks(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """``[[A, B], [B', C]]``: the covariance of two vectors together."""
    return joined([joined([a, b], -1), joined([b.mT, c], -1)], -2)


def solve(s: np.ndarray, b: np.ndarray) -> np.ndarray:
    """``S^-1 B`` for symmetric positive definite ``S (..., p, p)`` and ``B (..., p, k)``.

    A row whose ``S`` is singular comes out as NaN instead of raising: inside a rollout the filter
    then recovers that row alone (see `estimators.filter.Filter.update`).
    """
    if is_traced(s) or is_traced(b):
        return linear.solve_definite(s, b)
    if rescuing():
        return pseudo_inverse(s) @ b
    return _solved(s, b)


@np.errstate(all="ignore")
def _solved(s: np.ndarray, b: np.ndarray) -> np.ndarray:
    """``S^-1 B`` in NumPy; a singular row is NaN."""
    try:
        return np.linalg.solve(s, b)
    except np.linalg.LinAlgError:
        lost = (np.linalg.slogdet(s)[0] == 0.0)[..., None, None]  # as there, by a pivot of 0
        return np.where(lost, np.nan, np.linalg.solve(np.where(lost, identity(s.shape[-1]), s), b))


@contextmanager
def rescue() -> Iterator[None]:
    """Let `solve` and `cholesky` take singular matrices, by pseudo-inverses."""
    token = _RESCUE.set(True)
    try:
        yield
    finally:
        _RESCUE.reset(token)


def rescuing() -> bool:
    """Are lost rows computed again, see `rescue`?"""
    return _RESCUE.get()


def solve_upper(t: np.ndarray, b: np.ndarray) -> np.ndarray:
    """``T^-1 B`` for an upper triangular ``T (..., n, n)``; a singular row is NaN."""
    if is_traced(t) or is_traced(b):
        return linear.solve_upper(t, b)
    return _solved(t, b)


def solve_lower(t: np.ndarray, b: np.ndarray) -> np.ndarray:
    """``T^-1 B`` for a lower triangular ``T (..., n, n)``; a singular row is NaN."""
    if is_traced(t) or is_traced(b):
        return linear.solve_lower(t, b)
    return _solved(t, b)


def singular(a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Singular values ``(..., n)`` of ``A (..., m, n)``, m at least n, and V ``(..., n, n)``.

    Raises:
        numpy.linalg.LinAlgError: in NumPy, if A is not finite.
    """
    if is_traced(a):
        turned, V = linear.rotated(a)
        return np.sqrt(np.square(turned).sum(-2)), V
    _, values, directions = np.linalg.svd(a, full_matrices=False)
    return values, directions.mT


def principal_root(cov: np.ndarray) -> np.ndarray:
    """``W (..., n, n)`` with ``W W' = P``, positive semidefinite, and orthogonal columns.

    The columns are the eigenvectors of P, each scaled by the root of its eigenvalue. They are found
    by rotating the columns of a triangular root (Veselic & Hari 1989), which needs fewer rotations
    than P itself.
    """
    root = semidefinite_cholesky(cov)
    if is_traced(cov):
        return linear.orthogonal(root)
    vectors, values, _ = np.linalg.svd(root)
    return vectors * values[..., None, :]


@np.errstate(all="ignore")
def semidefinite_cholesky(a: np.ndarray, rounding: float = 0.0) -> np.ndarray:
    """Lower triangular ``L (..., n, n)`` with ``L L' = A`` for a positive semidefinite ``A``.

    A pivot at or below ``rounding`` times its diagonal entry, at least n times eps, gives a column
    of zeros, where `numpy.linalg.cholesky` would raise. The columns are computed one by one over
    the whole batch, which is as fast for a few states.
    """
    if is_traced(a):
        return linear.semidefinite_cholesky(a)
    n = a.shape[-1]
    root, share = np.zeros(a.shape), max(rounding, n * _EPS)
    for j in range(n):
        column = a[..., j:, j] - np.matvec(root[..., j:, :j], root[..., j, :j])
        pivot = column[..., :1]
        pivot = np.where(pivot <= share * a[..., j, j, None], np.inf, pivot)
        root[..., j:, j] = column / np.sqrt(pivot)
    return root


def regular(root: np.ndarray) -> np.ndarray:
    """A triangular root with a huge pivot where a row repeats others: its share is then 0."""
    repeats = np.where(diagonal(root) == 0.0, _HUGE, 0.0)
    return root + repeats[..., None] * identity(root.shape[-1])


def shared_root(cov: np.ndarray) -> np.ndarray:
    """`semidefinite_cholesky` of covariances ``(..., n, n)``; one ``(n, n)`` for equal rows.

    The last results are cached, because episodes begin with the same covariance again and again.
    """
    n = cov.shape[-1]
    rows = cov.reshape(-1, n, n)
    equal = len(rows) > 0 and (rows == rows[0]).all()
    return _kept_root(rows[0].tobytes(), n) if equal else semidefinite_cholesky(cov)


@lru_cache(maxsize=16)
def _kept_root(cov: bytes, n: int) -> np.ndarray:
    return semidefinite_cholesky(np.frombuffer(cov).reshape(n, n))


_RESCUE = ContextVar("rescue", default=False)
_HUGE = 1e150
"""Pivot of a row that repeats others, which makes the row's share 0."""
_EPS = np.finfo(float).eps
_DIGITS = 8.0 * _EPS
"""Share of the size of its numbers below which a standard deviation is rounding."""


def cholesky(s: np.ndarray) -> np.ndarray:
    """The lower factor of ``S (..., p, p)``; a row that is not positive definite is NaN."""
    if is_traced(s):
        return linear.cholesky(s)
    if rescuing():
        return regular(semidefinite_cholesky(np.where(np.isfinite(s), s, 0.0)))
    try:
        return np.linalg.cholesky(s)
    except np.linalg.LinAlgError:
        root = semidefinite_cholesky(s)
        lowest = diagonal(root).min(-1)[..., None, None]
        return np.where(lowest > 0.0, root, np.nan)


@np.errstate(all="ignore")
def semidefinite_form(
    e: np.ndarray, s: np.ndarray, size: Any
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """``e' S^+ e (...)`` for a semidefinite S, and its first independent components ``(..., p)``.

    The result is ``(form, half, independent)``, with half the log-determinant of the independent
    components. The form is infinite where e is outside the range of S by more than the rounding of
    numbers of ``size (..., p)``, and NaN where S is not finite. Ranks are decided in units of
    standard deviations.
    """
    rounding = _DIGITS * np.broadcast_to(size, e.shape)
    exact = diagonal(s) <= np.square(rounding)
    scale, unit = equilibrated(s)
    finite = all_finite(unit)[..., None, None]
    kept = finite[..., 0] & ~exact
    scale = np.where(exact, 1e12 * rounding + 1e-100, np.where(finite[..., 0], scale, np.nan))
    e = e / scale
    root = semidefinite_cholesky(np.where(kept[..., None] & kept[..., None, :], unit, 0.0), 1e-12)
    spread = diagonal(root)
    along = solve_lower(regular(root), e[..., None])[..., 0]
    outside = np.abs(e - np.matvec(root, along))
    largest = np.maximum(1.0, np.abs(along).max(-1, keepdims=True))
    wrong = (outside > 1e-6 * largest + 8.0 * rounding / scale).any(-1)
    independent = spread > 0.0
    logs = np.log(np.where(independent, spread * scale, 1.0)).sum(-1)
    return np.where(wrong, np.inf, np.square(along).sum(-1)), logs, independent


def pseudo_inverse(s: np.ndarray) -> np.ndarray:
    """``S^+`` of covariances ``(..., p, p)``, in units of standard deviations.

    Entries that are not finite count as 0, because the eigenvalue solver would raise.
    """
    scale, unit = equilibrated(np.where(np.isfinite(s), s, 0.0))
    inverse = np.linalg.pinv(unit, rcond=SINGULAR * s.shape[-1], hermitian=True)
    return inverse / scale[..., None] / scale[..., None, :]


def lacks_rank(cov: np.ndarray) -> np.ndarray:
    """Mask ``(...)`` of covariances with a direction without variance, but for rounding.

    A row that is not finite gives False, because the eigenvalue solver would raise.
    """
    unit = equilibrated(cov)[1]
    finite = all_finite(unit)[..., None, None]
    lowest = np.linalg.eigvalsh(np.where(finite, unit, identity(cov.shape[-1])))[..., 0]
    return lowest <= SINGULAR * cov.shape[-1]


SINGULAR = 1e-13
"""Eigenvalues of a covariance with unit diagonal below p times this are rounding."""


@np.errstate(all="ignore")
def semidefinite(cov: np.ndarray) -> np.ndarray:
    """Covariances ``(..., n, n)`` with negative eigenvalues, which are rounding here, set to 0.

    Noise-free measurements leave variances that are only rounding, of either sign.
    """
    cov = symmetrise(cov)
    finite = all_finite(cov)[..., None, None]
    values, vectors = np.linalg.eigh(np.where(finite, cov, 0.0))
    wrong = (values[..., 0] < -1e-12 * np.abs(values).sum(-1))[..., None, None]
    repaired = (vectors * np.maximum(values, 0.0)[..., None, :]) @ vectors.mT
    return np.where(wrong, symmetrise(repaired), cov)
