"""Small dense linear algebra over batches: covariances ``(..., n, n)`` and vectors ``(..., n)``."""

from collections.abc import Sequence
from contextlib import suppress
from functools import cache, lru_cache

import numpy as np

from estimators.formulas import is_noted, orthogonal, root_of, rotated, symmetric


@cache
def identity(n: int) -> np.ndarray:
    """The identity ``(n, n)``, read-only: made once."""
    eye = np.eye(n)
    eye.setflags(write=False)
    return eye


def symmetrise(a: np.ndarray) -> np.ndarray:
    """The symmetric part of ``(..., n, n)``, so that rounding never accumulates."""
    return symmetric(a) if is_noted(a) else 0.5 * (a + a.mT)


def congruence(a: np.ndarray, p: np.ndarray) -> np.ndarray:
    """``A P A'``: what a linear map does to a covariance."""
    return a @ p @ a.mT


def driven(
    A: np.ndarray, G: np.ndarray, cov: np.ndarray, state_input_cov: np.ndarray, input_cov: np.ndarray
) -> np.ndarray:
    """``[A G] [[P, Pxd], [Pxd', Pd]] [A G]'``, not yet symmetrised: where one term of two is doubled instead."""
    half = 2.0 * (A @ state_input_cov) + G @ input_cov
    return congruence(A, cov) + half @ G.mT


def neutralised(R: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """R ``(..., p, p)`` with a unit, uncorrelated variance where the mask ``kept (..., p)`` is False."""
    return np.where(kept[..., None] & kept[..., None, :], R, identity(R.shape[-1]))


def equilibrated(s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations ``(..., p)``, 1 where S has none, and S ``(..., p, p)`` in units of them."""
    scale = np.sqrt(np.diagonal(s, axis1=-2, axis2=-1))
    scale = np.where(scale > 0.0, scale, 1.0)
    return scale, s / scale[..., None] / scale[..., None, :]


def joined(parts: Sequence[np.ndarray], axis: int) -> np.ndarray:
    """Matrices ``(..., i, j)`` below (axis -2) or beside (axis -1) each other, one batch for all."""
    if not any(is_noted(part) for part in parts):
        batch = np.broadcast_shapes(*(part.shape[:-2] for part in parts))
        parts = [np.broadcast_to(part, batch + part.shape[-2:]) for part in parts]
    return np.concatenate(parts, axis)


def solve(s: np.ndarray, b: np.ndarray) -> np.ndarray:
    """``S^-1 B`` for symmetric positive definite ``S (..., p, p)`` and ``B (..., p, k)``.

    A row whose ``S`` is singular comes out as NaN instead of raising: inside a rollout the filter
    then recovers that row alone (see `estimators.filter.Filter.update`).
    """
    try:
        return np.linalg.solve(s, b)
    except np.linalg.LinAlgError:
        batch = np.broadcast_shapes(s.shape[:-2], b.shape[:-2])
        s = np.broadcast_to(s, batch + s.shape[-2:])
        b = np.broadcast_to(b, batch + b.shape[-2:])
        solution = np.full(b.shape, np.nan)
        for row in np.ndindex(batch):
            with suppress(np.linalg.LinAlgError):
                solution[row] = np.linalg.solve(s[row], b[row])
        return solution


def singular(a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Singular values ``(..., n)`` of ``A (..., m, n)``, zeros among them, and V ``(..., n, n)``, column by column."""
    n = a.shape[-1]
    if is_noted(a):
        turned, V = rotated(a)
        return np.sqrt(np.square(turned).sum(-2)), V
    _, found, directions = np.linalg.svd(a)
    values = np.zeros(a.shape[:-2] + (n,))
    values[..., : found.shape[-1]] = found
    return values, directions.mT


def principal_root(cov: np.ndarray) -> np.ndarray:
    """``W (..., n, n)`` with ``W W' = P``, positive semidefinite, and orthogonal columns.

    These are the eigenvectors of P, each as long as the root of its eigenvalue; found by turning the columns of a
    triangular root (Veselic & Hari 1989), which takes fewer turns than P itself.
    """
    root = semidefinite_cholesky(cov)
    if is_noted(cov):
        return orthogonal(root)
    vectors, values, _ = np.linalg.svd(root)
    return vectors * values[..., None, :]


def semidefinite_cholesky(a: np.ndarray) -> np.ndarray:
    """Lower triangular ``L (..., n, n)`` with ``L L' = A`` for symmetric positive semidefinite ``A``.

    A pivot that is zero to rounding gives a column of zeros, where `numpy.linalg.cholesky` would raise. Column by
    column over the whole batch, which for a few states is as fast.
    """
    if is_noted(a):
        return root_of(a)
    n = a.shape[-1]
    rest, root = np.array(a), np.zeros(a.shape)
    for j in range(n):
        pivot = rest[..., j, j]
        pivot = np.where(pivot <= n * _EPS * a[..., j, j], np.inf, pivot)
        column = rest[..., j:, j] / np.sqrt(pivot)[..., None]
        root[..., j:, j] = column
        rest[..., j:, j:] -= column[..., :, None] * column[..., None, :]
    return root


def shared_root(cov: np.ndarray) -> np.ndarray:
    """`semidefinite_cholesky` of covariances ``(..., n, n)``; one ``(n, n)`` for all rows where they are the same.

    Those of the last ones are kept: episodes begin with the same covariance again and again.
    """
    n = cov.shape[-1]
    rows = cov.reshape(-1, n, n)
    alike = len(rows) == 1 or (len(rows) > 0 and (rows == rows[0]).all())
    return _kept_root(rows[0].tobytes(), n) if alike else semidefinite_cholesky(cov)


@lru_cache(maxsize=16)
def _kept_root(cov: bytes, n: int) -> np.ndarray:
    return semidefinite_cholesky(np.frombuffer(cov).reshape(n, n))


_EPS = np.finfo(float).eps


def whitened(root: np.ndarray, e: np.ndarray) -> np.ndarray:
    """``L^-1 e`` for a triangular root ``L (..., p, p)``; a column of zeros counts as a unit one: it weighs nothing."""
    entries: list[np.ndarray] = []
    for i in range(e.shape[-1]):
        rest, pivot = e[..., i], root[..., i, i]
        for j, entry in enumerate(entries):
            rest = rest - root[..., i, j] * entry
        entries.append(rest / np.where(pivot > 0.0, pivot, 1.0))
    return np.concatenate([entry[..., None] for entry in entries], -1)


def cholesky(s: np.ndarray) -> np.ndarray:
    """The lower factor of ``S (..., p, p)``; a row that is not positive definite comes out as NaN."""
    try:
        return np.linalg.cholesky(s)
    except np.linalg.LinAlgError:
        factor = np.full(s.shape, np.nan)
        for row in np.ndindex(s.shape[:-2]):
            with suppress(np.linalg.LinAlgError):
                factor[row] = np.linalg.cholesky(s[row])
        return factor
