"""What ensemble filters compute of the members of one row at a time, compiled: a row stays in the cache meanwhile.

Members are last here, an ensemble is ``(n, N)``: loops over the members of a component are vector instructions. Sums
over members have eight partial sums in a fixed order, so that a row's numbers depend neither on its batch nor on the
processor. Random numbers are functions of a row's key: each is drawn where it is needed, and nowhere else.

Notation: the anomalies ``A (n, N)`` of the members and ``Y (k, N)`` of the readings that they expect, of those k that
arrived; ``S = Y Y' / (N - 1) + R`` and ``C P = Y A' / (N - 1)``.
"""

from math import prod
from typing import Any

import numpy as np
from numba import types

from estimators.compiled import dot, inlined, loop, part, sincos
from estimators.randomness import normal_pair, threefry

PROCESS, READINGS = 1, 2
"""Uses of random numbers."""
_TURN = 2.0 * np.pi
_U = np.uint64


def _arrays(kinds: str) -> list[types.Type]:
    """Types of arrays: ``f3`` holds floats along three axes, ``i`` whole numbers, ``b`` truth values, ``u`` words.

    An exclamation mark before one that is written to; the others may be read-only.
    """
    dtypes = {"f": types.float64, "i": types.int64, "b": types.boolean, "u": types.uint64}
    return [types.Array(dtypes[kind[-2]], int(kind[-1]), "C", readonly=kind[0] != "!") for kind in kinds.split()]


# --- angles -----------------------------------------------------------------------------------------


@inlined
def _near(angle: float, centre: float) -> float:
    """The angle, whole turns taken off so that it lies within half a turn of ``centre``."""
    return angle - _TURN * np.rint((angle - centre) / _TURN)


@part
def _step_together(before: Any, after: Any) -> None:
    """Takes off whole turns that some members of an angle ``(N,)`` made over a step, and the first did not."""
    first, apart = after[0] - before[0], 0
    for j in range(len(after)):
        apart += abs(after[j] - before[j] - first) > np.pi
    if apart:
        for j in range(len(after)):
            after[j] = before[j] + _near(after[j] - before[j], first)


@part
def _gather(angle: Any) -> None:
    """Members of an angle ``(N,)`` beside the first, or, where they are spread out, beside their circular mean."""
    centre, apart = angle[0], 0
    for j in range(len(angle)):
        apart += abs(_near(angle[j], centre) - centre) > 0.25 * np.pi
    if apart:
        sine, cosine = 0.0, 0.0
        for j in range(len(angle)):
            s, c = sincos(angle[j])
            sine, cosine = sine + s, cosine + c
        centre = np.arctan2(sine, cosine)
    for j in range(len(angle)):
        angle[j] = _near(angle[j], centre)


# --- moments ----------------------------------------------------------------------------------------


@part
def _centred(a: Any, weights: Any) -> float:
    """The mean of a component ``(N,)`` over the members, which is taken off; ``weights`` are ``1 / N`` each."""
    mean = dot(a, weights)
    for j in range(len(a)):
        a[j] -= mean
    return mean


@part
def _departed(members: Any, mean: Any, anomalies: Any) -> None:
    """The anomalies of an ensemble ``(n, N)``."""
    for i in range(len(mean)):
        for j in range(members.shape[1]):
            anomalies[i, j] = members[i, j] - mean[i]


@part
def _covary(a: Any, k: int, b: Any, out: Any) -> None:
    """``A B' / (N - 1)`` of anomalies, of the first k rows of A."""
    for i in range(k):
        for j in range(len(b)):
            out[i, j] = dot(a[i], b[j]) / (a.shape[1] - 1)


@inlined
def _add(factor: float, a: Any, out: Any) -> None:
    """Adds ``factor a (N,)``."""
    for j in range(len(out)):
        out[j] += factor * a[j]


@part
def _combine(factors: Any, k: int, a: Any, out: Any) -> None:
    """Adds ``factors (k,)`` times the first k rows of A to one row ``(N,)``."""
    for i in range(k):
        if factors[i] != 0.0:
            _add(factors[i], a[i], out)


@part
def _inflated(mean: float, factor: float, anomalies: Any, weights: Any) -> bool:
    """The members ``(N,)`` of a component in place of their anomalies; whether all of them are finite."""
    for j in range(len(anomalies)):
        anomalies[j] = mean + factor * anomalies[j]
    return np.isfinite(dot(anomalies, weights))


# --- small matrices ---------------------------------------------------------------------------------


@part
def _cholesky(s: Any, k: int) -> bool:
    """``S = L L'`` of the first k rows, L in place of the lower triangle; whether S is far from singular.

    It may not be where earlier variances leave less than 1e-10 of one: the eigenvalues have to tell.
    """
    regular = True
    for j in range(k):
        whole = s[j, j]
        for i in range(j, k):
            for m in range(j):
                s[i, j] -= s[i, m] * s[j, m]
        if not s[j, j] > 1e-10 * whole:  # nor is NaN
            regular = False
        s[j, j] = np.sqrt(s[j, j])
        for i in range(j + 1, k):
            s[i, j] /= s[j, j]
    return regular


@part
def _solve(L: Any, k: int, b: Any, transposed: bool) -> None:
    """``L^-1 B``, or ``L'^-1 B``, in place of the first k rows of B."""
    for step in range(k):
        i = k - 1 - step if transposed else step
        for other in range(step):
            m = k - 1 - other if transposed else other
            factor = L[m, i] if transposed else L[i, m]
            for c in range(b.shape[1]):
                b[i, c] -= factor * b[m, c]
        for c in range(b.shape[1]):
            b[i, c] /= L[i, i]


@part
def _diagonalise(a: Any, k: int, v: Any) -> None:
    """``A = V' diag(m) V`` of the first k rows of a symmetric A: m to its diagonal, eigenvectors to the rows of V.

    By the rotations of Jacobi (1846), row by row, with the formulas of Golub & Van Loan (2013, sec. 8.5).
    """
    for i in range(k):
        for j in range(k):
            v[i, j] = 1.0 if i == j else 0.0
    for _ in range(30):
        aside, size = 0.0, 0.0
        for i in range(k):
            size += a[i, i] * a[i, i]
            for j in range(i):
                aside += a[i, j] * a[i, j]
        if not aside > 1e-34 * size:
            break
        for i in range(1, k):
            for j in range(i):
                if a[i, j] == 0.0:
                    continue
                ratio = 0.5 * (a[i, i] - a[j, j]) / a[i, j]
                t = 1.0 / (ratio + np.copysign(np.sqrt(1.0 + ratio * ratio), ratio))
                c = 1.0 / np.sqrt(1.0 + t * t)
                s = t * c
                for m in range(k):
                    x, y = a[m, j], a[m, i]
                    a[m, j], a[m, i] = c * x - s * y, s * x + c * y
                for m in range(k):
                    x, y = a[j, m], a[i, m]
                    a[j, m], a[i, m] = c * x - s * y, s * x + c * y
                    x, y = v[j, m], v[i, m]
                    v[j, m], v[i, m] = c * x - s * y, s * x + c * y


# --- random numbers ---------------------------------------------------------------------------------


@part
def _drawn(keys: Any, steps: Any, given: Any, row: int, use: int, component: int, four: Any, out: Any) -> None:
    """Standard normals of the members ``(N,)``: those ``given`` for all rows, or else those of the row's key.

    The latter are those of `estimators.randomness.Numbers.members`; ``four (4, N / 4)`` is room for them.
    """
    if len(given):
        for j in range(len(out)):
            out[j] = given[row, j, component]
        return
    counter, own = (steps[row] << _U(16)) | _U(use), _U(component) << _U(32)
    for j in range(four.shape[1]):
        first, second = threefry(_U(j) | own, counter, keys[row, 0], keys[row, 1])
        four[0, j], four[1, j] = normal_pair(first)
        four[2, j], four[3, j] = normal_pair(second)
    for j in range(len(out)):
        out[j] = four[j % 4, j // 4]


# --- kernels ----------------------------------------------------------------------------------------


@loop(_arrays("f3 f3 i1 f3 u2 u1 f3 !f2 !f3"))
def forecast(
    before: Any, after: Any, angles: Any, roots: Any, keys: Any, steps: Any, given: Any, mean: Any, out: Any
) -> None:
    """Members ``x_i = f(x_i-) + L n_i`` with standard normals n that are centred over the members, and their mean.

    Args:
        before: ``(B, n, N)``,
        after: and ``(B, n, N)`` what the transition makes of them.
        angles: Components that it may have wrapped.
        roots: ``(1 or B, n, r)`` L, a root of the process noise.
        keys: ``(B, 2)`` of the rows,
        steps: and ``(B,)`` their steps.
        given: ``(B, N, r)`` normals, where no key gives them, or ``(0, 0, 0)``.
        mean: ``(B, n)`` takes the mean,
        out: and ``(B, n, N)`` the members.
    """
    _, n, N = after.shape
    noise, four, weights = np.empty(N), np.empty((4, (N + 3) // 4)), np.full(N, 1.0 / N)
    for b in range(len(after)):
        root, x = roots[min(b, len(roots) - 1)], out[b]
        for i in range(n):
            for j in range(N):
                x[i, j] = after[b, i, j]
        for i in angles:
            _step_together(before[b, i], x[i])
        for i in range(n):
            mean[b, i] = dot(x[i], weights)
        for r in range(root.shape[1]):
            _drawn(keys, steps, given, b, PROCESS, r, four, noise)
            _centred(noise, weights)
            for i in range(n):
                if root[i, r] != 0.0:
                    _add(root[i, r], noise, x[i])


@part
def _innovate(
    readings: Any, y: Any, arrived: Any, R: Any, angles: Any, seams: Any, weights: Any,
    Y: Any, index: Any, innovation: Any, S: Any,
) -> int:  # fmt: skip
    """The anomalies Y of the readings that arrived; k, how many these are, and to ``index (k,)``, which.

    The innovation ``(p,)``, 0 where nothing arrived, and its covariance S ``(p, p)``, unit there.
    """
    p, N, k = len(y), readings.shape[1], 0
    for i in range(p):
        innovation[i] = 0.0
        for j in range(p):
            S[i, j] = 1.0 if i == j else 0.0
        if not arrived[i]:
            continue
        for j in range(N):
            Y[k, j] = readings[i, j]
        if seams[i]:
            _gather(Y[k])
        innovation[i] = y[i] - _centred(Y[k], weights)
        if angles[i]:
            innovation[i] = max(np.pi - np.mod(np.pi - innovation[i], _TURN), np.nextafter(-np.pi, 0.0))
        index[k] = i
        k += 1
    for a in range(k):
        for b in range(a + 1):
            i, j = index[a], index[b]
            S[i, j] = S[j, i] = dot(Y[a], Y[b]) / (N - 1) + R[i, j]
    return k


@loop([*_arrays("f3 f3 f2 f2 b2 f3 f3 b1 b1 f2"), types.float64, *_arrays("u2 u1 f3 !f2 !f3 !f2 !f3 !b1")])
def perturbed(
    members: Any, readings: Any, before: Any, y: Any, arrived: Any, Rs: Any, roots: Any, angles: Any, seams: Any,
    taper: Any, inflation: float, keys: Any, steps: Any, given: Any,
    mean: Any, out: Any, innovation: Any, S: Any, lost: Any,
) -> None:  # fmt: skip
    """The analysis of perturbed readings, ``x_i = x_i- + K (y + v_i - h(x_i-))`` with ``K = (C P)' S^-1``.

    Args:
        members: ``(B, n, N)``, with
        readings: ``(B, p, N)`` that they expect,
        before: and ``(B, n)`` their mean.
        y: ``(B, p)`` readings,
        arrived: and ``(B, p)`` which there are.
        Rs: ``(1 or B, p, p)`` covariance of the readings,
        roots: and ``(1 or B, p, p)`` a root of it.
        angles: ``(p,)`` which of them are angles,
        seams: and ``(p,)`` which of these may be wrapped.
        taper: ``(p, n)`` factors on the gain.
        inflation: Factor on the anomalies of components that a reading may correct.
        keys: ``(B, 2)`` of the rows,
        steps: and ``(B,)`` their steps.
        given: ``(B, N, p)`` normals, where no key gives them, or ``(0, 0, 0)``.
        mean: ``(B, n)`` takes the mean,
        out: ``(B, n, N)`` the members,
        innovation: ``(B, p)`` and
        S: ``(B, p, p)`` its covariance,
        lost: and ``(B,)`` whether something is not finite, or S all but singular.
    """
    (_, n, N), p = members.shape, y.shape[1]
    Y, D, gain, L, index = np.empty((p, N)), np.empty((p, N)), np.empty((p, n)), np.empty((p, p)), np.empty(p, np.int64)
    noise, four, weights, own = np.empty(N), np.empty((4, (N + 3) // 4)), np.full(N, 1.0 / N), np.empty(p)
    for b in range(len(members)):
        R, root, A, e = Rs[min(b, len(Rs) - 1)], roots[min(b, len(roots) - 1)], out[b], innovation[b]
        k = _innovate(readings[b], y[b], arrived[b], R, angles, seams, weights, Y, index, e, S[b])
        _departed(members[b], before[b], A)
        _covary(Y, k, A, gain)
        for a in range(k):
            for m in range(k):
                L[a, m] = S[b, index[a], index[m]]
            for j in range(N):
                D[a, j] = -Y[a, j]
        sound = _cholesky(L, k)
        _solve(L, k, gain, False)
        _solve(L, k, gain, True)
        for i in range(p):  # v_i = L n_i: a number is drawn if a reading that arrived has a share of it
            shared = False
            for a in range(k):
                shared |= root[index[a], i] != 0.0
            if shared:
                _drawn(keys, steps, given, b, READINGS, i, four, noise)
                _centred(noise, weights)
                for a in range(k):
                    if root[index[a], i] != 0.0:
                        _add(root[index[a], i], noise, D[a])
        for c in range(n):
            mean[b, c], factor = before[b, c], 1.0
            for a in range(k):
                own[a] = taper[index[a], c] * gain[a, c]
                mean[b, c] += own[a] * e[index[a]]
                if taper[index[a], c] > 0.0:
                    factor = inflation
            _combine(own, k, D, A[c])
            sound &= _inflated(mean[b, c], factor, A[c], weights) and np.isfinite(mean[b, c])
        lost[b] = not (sound and np.isfinite(e.sum()))


@part
def _transposed(a: Any, k: int) -> None:
    """The first k rows and columns of A, in place."""
    for i in range(k):
        for j in range(i):
            a[i, j], a[j, i] = a[j, i], a[i, j]


@part
def _softened(shares: Any, k: int, V: Any, out: Any) -> None:
    """``(I + B^1/2)^-1`` of the first k rows of a symmetric B, which is overwritten."""
    _diagonalise(shares, k, V)
    for i in range(k):
        for j in range(k):
            out[i, j] = 0.0
            for m in range(k):
                out[i, j] += V[m, i] * V[m, j] / (1.0 + np.sqrt(max(shares[m, m], 0.0)))


@loop([*_arrays("f3 f3 f2 f2 b2 f3 b1 b1 b2 b2"), types.float64, *_arrays("!f2 !f3 !f2 !f3 !b1")])
def transformed(
    members: Any, readings: Any, before: Any, y: Any, arrived: Any, Rs: Any, angles: Any, seams: Any,
    states: Any, channels: Any, inflation: float, mean: Any, out: Any, innovation: Any, S: Any, lost: Any,
) -> None:  # fmt: skip
    """The analysis of a symmetric transform, ``A <- A - K~ Y``, with ``S = L L'``::

        K = (C P)' L'^-1 L^-1        K~ = (C P)' L'^-1 (I + B^1/2)^-1 L^-1        B = L^-1 R L'^-1

    Args:
        states: ``(g, n)`` which components form a group,
        channels: and ``(g, p)`` the readings that may correct it.

    The others are those of `perturbed`.
    """
    (_, n, N), p = members.shape, y.shape[1]
    Y, own, index, at = np.empty((p, N)), np.empty((p, N)), np.empty(p, np.int64), np.empty(p, np.int64)
    L, B, V, M = np.empty((p, p)), np.zeros((p, p)), np.empty((p, p)), np.empty((p, p))
    CP, gain, e, column, weights = np.empty((p, n)), np.empty((p, n)), np.empty((p, 1)), np.empty(p), np.full(N, 1.0 / N)
    for b in range(len(members)):
        R, A = Rs[min(b, len(Rs) - 1)], out[b]
        arrivals = _innovate(readings[b], y[b], arrived[b], R, angles, seams, weights, Y, index, innovation[b], S[b])
        _departed(members[b], before[b], A)
        sound = np.isfinite(innovation[b].sum())
        for c in range(n):
            mean[b, c] = before[b, c]
        for g in range(len(states)):
            k = 0
            for a in range(arrivals):
                if channels[g, index[a]]:
                    at[k], e[k, 0] = index[a], innovation[b, index[a]]
                    for j in range(N):
                        own[k, j] = Y[a, j]
                    k += 1
            for a in range(k):
                for m in range(k):
                    L[a, m], B[a, m] = S[b, at[a], at[m]], R[at[a], at[m]]
            if not _cholesky(L, k):
                sound = False
                break
            _solve(L, k, B, False)
            _transposed(B, k)
            _solve(L, k, B, False)
            _softened(B, k, V, M)
            _covary(own, k, A, CP)
            _solve(L, k, CP, False)
            _solve(L, k, e, False)
            for a in range(k):
                for c in range(n):
                    gain[a, c] = 0.0
                    for m in range(k):
                        gain[a, c] -= M[a, m] * CP[m, c]
            _solve(L, k, gain, True)
            for c in range(n):
                if k and states[g, c]:
                    for a in range(k):
                        mean[b, c] += CP[a, c] * e[a, 0]
                        column[a] = gain[a, c]
                    _combine(column, k, own, A[c])
                    for j in range(N):
                        A[c, j] *= inflation
        for c in range(n):
            sound &= _inflated(mean[b, c], 1.0, A[c], weights) and np.isfinite(mean[b, c])
        lost[b] = not sound


@loop(_arrays("f3 f2 !f3"))
def _covariances(members: Any, mean: Any, out: Any) -> None:
    """``A A' / (N - 1)`` of members ``(B, n, N)``."""
    A = np.empty(members.shape[1:])
    for b in range(len(members)):
        _departed(members[b], mean[b], A)
        _covary(A, len(A), A, out[b])


# --- of arrays as a belief has them -----------------------------------------------------------------


def members_last(ensemble: np.ndarray) -> np.ndarray:
    """An ensemble ``(..., N, n)`` as rows ``(B, n, N)``, a view where it lies in memory so."""
    *batch, N, n = ensemble.shape
    return np.ascontiguousarray(ensemble.mT.reshape(prod(batch), n, N))


def covariance(ensemble: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """That of members ``(..., N, n)`` about ``mean (..., n)``."""
    out = np.empty(mean.shape + mean.shape[-1:])
    rows = prod(mean.shape[:-1]), mean.shape[-1]
    _covariances(members_last(ensemble), np.ascontiguousarray(mean).reshape(rows), out.reshape(*rows, rows[1]))
    return out
