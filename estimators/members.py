"""What ensemble filters compute of the members of one row, compiled: these stay in the cache meanwhile.

Members are last here, an ensemble is ``(n, N)``: loops over the members of a component are vector instructions. Sums
over members have eight partial sums in a fixed order, so that a row's numbers depend neither on its batch nor on the
processor.

Notation: the anomalies ``A (n, N)`` of the members and ``Y (k, N)`` of the readings that they expect, of those k that
arrived; ``S = Y Y' / (N - 1) + R`` and ``C P = Y A' / (N - 1)``.
"""

from typing import Any

import numpy as np

from estimators.compiled import dot, gufunc, inlined, part, sincos

_TURN = 2.0 * np.pi


# --- angles -----------------------------------------------------------------------------------------


@inlined
def _near(angle: float, centre: float) -> float:
    """The angle, whole turns taken off so that it lies within half a turn of ``centre``."""
    return angle - _TURN * np.rint((angle - centre) / _TURN)


@part
def _step_together(before: Any, after: Any) -> None:
    """Takes off whole turns that some members of an angle ``(N,)`` made over a step, and the first did not.

    A transition may wrap its angles. Members that cross the seam would then be a turn away from the others; over one
    step all turn by nearly as much as the first.
    """
    first, apart = after[0] - before[0], 0
    for j in range(len(after)):
        apart += abs(after[j] - before[j] - first) > np.pi
    if apart:
        for j in range(len(after)):
            after[j] = before[j] + _near(after[j] - before[j], first)


@part
def _gather(angle: Any) -> int:
    """Members of an angle ``(N,)`` beside the first, or, where they are spread out, beside their circular mean.

    Returns:
        How many have changed by whole turns.
    """
    centre, apart, moved = angle[0], 0, 0
    for j in range(len(angle)):
        apart += abs(_near(angle[j], centre) - centre) > 0.25 * np.pi
    if apart:
        sine, cosine = 0.0, 0.0
        for j in range(len(angle)):
            s, c = sincos(angle[j])
            sine, cosine = sine + s, cosine + c
        centre = np.arctan2(sine, cosine)
    for j in range(len(angle)):
        near = _near(angle[j], centre)
        moved += near != angle[j]
        angle[j] = near
    return moved


# --- moments ----------------------------------------------------------------------------------------


@part
def _departed(a: Any, mean: Any, out: Any) -> None:
    """The anomalies of ``(k, N)``."""
    for i in range(len(a)):
        for j in range(a.shape[1]):
            out[i, j] = a[i, j] - mean[i]


@part
def _averaged(a: Any, out: Any) -> None:
    """The means ``(k,)`` of ``(k, N)`` over the members; none where these have no finite covariance."""
    weights = np.full(a.shape[1], 1.0 / a.shape[1])
    for i in range(len(a)):
        out[i] = dot(a[i], weights) if np.isfinite(dot(a[i], a[i])) else np.nan


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
def _add_noise(root: Any, normals: Any, index: Any, k: int, out: Any) -> None:
    """Adds ``L n_i``, the normals n ``(r, N)`` centred over the members, of the rows ``index (k,)`` of L ``(:, r)``."""
    noise, mean = np.empty((1, out.shape[1])), np.empty(1)
    for r in range(root.shape[1]):
        centred = False
        for a in range(k):
            if root[index[a], r] != 0.0:
                if not centred:
                    _averaged(normals[r : r + 1], mean)
                    _departed(normals[r : r + 1], mean, noise)
                    centred = True
                _add(root[index[a], r], noise[0], out[a])


# --- small matrices ---------------------------------------------------------------------------------


@part
def _cholesky(s: Any, k: int) -> None:
    """``S = L L'`` of the first k rows, L in place of the lower triangle."""
    for j in range(k):
        for i in range(j, k):
            for m in range(j):
                s[i, j] -= s[i, m] * s[j, m]
        s[j, j] = np.sqrt(s[j, j])
        for i in range(j + 1, k):
            s[i, j] /= s[j, j]


@part
def _solve(L: Any, k: int, b: Any, transposed: bool) -> None:
    """``L^-1 B``, or ``L'^-1 B``, in place of the first k rows of B."""
    for step in range(k):
        i = k - 1 - step if transposed else step
        for other in range(step):
            m = k - 1 - other if transposed else other
            _add(-L[m, i] if transposed else -L[i, m], b[m], b[i])
        for c in range(b.shape[1]):
            b[i, c] /= L[i, i]


@inlined
def _rotate(c: float, s: float, a: Any, b: Any) -> None:
    """``c a - s b`` and ``s a + c b`` in place of vectors a and b."""
    for m in range(len(a)):
        x, y = a[m], b[m]
        a[m], b[m] = c * x - s * y, s * x + c * y


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
        if not aside > 1e-32 * size:
            break
        for i in range(1, k):
            for j in range(i):
                if not a[i, j] * a[i, j] > 1e-36 * size:
                    continue
                ratio = 0.5 * (a[i, i] - a[j, j]) / a[i, j]
                t = 1.0 / (ratio + np.copysign(np.sqrt(1.0 + ratio * ratio), ratio))
                c = 1.0 / np.sqrt(1.0 + t * t)
                s = t * c
                first, second = a[j, j] - t * a[i, j], a[i, i] + t * a[i, j]
                _rotate(c, s, a[j, :k], a[i, :k])
                _rotate(c, s, v[j, :k], v[i, :k])
                a[j, j], a[i, i], a[i, j], a[j, i] = first, second, 0.0, 0.0
                for m in range(k):
                    a[m, j], a[m, i] = a[j, m], a[i, m]


@part
def _softened(L: Any, k: int, R: Any, V: Any, out: Any) -> None:
    """``(I + B^1/2)^-1`` with ``B = L^-1 R L'^-1 = V' diag(m) V``; m to the diagonal of R."""
    _solve(L, k, R, False)
    for i in range(k):
        for j in range(i):
            R[i, j], R[j, i] = R[j, i], R[i, j]
    _solve(L, k, R, False)
    _diagonalise(R, k, V)
    for i in range(k):
        for j in range(k):
            out[i, j] = 0.0
            for m in range(k):
                out[i, j] += V[m, i] * V[m, j] / (1.0 + np.sqrt(max(R[m, m], 0.0)))


_MOST = 100.0
"""Square of the most that anomalies are inflated by: an absurd reading shall not inflate what it does not show."""


@part
def _wanting(x: float, share: Any, size: Any, N: int, a: float, b: float) -> float:
    """Whether `_scale` lies above x: positive, or below."""
    slope = a / x - b
    for m in range(len(share)):
        q = x * (1.0 - share[m]) + share[m]
        slope += x * (1.0 - share[m]) * size[m] / (q * q) / (N - 1)
    return slope


@part
def _scale(share: Any, size: Any, N: int, certainty: float) -> float:
    """The square x of the inflation of anomalies that a reading asks for: the finite-size filter's, in its dual form.

    The least of ``sum_m z_m^2 / q_m / (N - 1) + a / x + b log x`` downhill of 1, ``q = x (1 - m) + m``: the reading's
    likelihood, and a prior of the scale that stands for ``certainty`` samples of N. m are the ``share (k,)`` of R in S
    by its directions, k at most N, z^2 the ``size (k,)`` of the innovation there in units of S. The prior's mode tends
    to 1 where readings tell nothing (Bocquet, Raanes & Hannart 2015, eq. 36).
    """
    a, b = (N + 1.0) / N, N / (N - 1.0)
    mode = (a / b) ** (0.5 * (N - len(share) + share.sum()) / N)
    a, b = certainty * a / mode, certainty * b * mode
    low, high = (1.0, _MOST) if _wanting(1.0, share, size, N, a, b) > 0.0 else (1.0 / _MOST, 1.0)
    for _ in range(50):
        x = 0.5 * (low + high)
        if _wanting(x, share, size, N, a, b) > 0.0:
            low = x
        else:
            high = x
    return low


@part
def _among_members(own: Any, k: int, L: Any, e: Any, certainty: float, white: Any, G: Any, V: Any, shift: Any) -> float:
    """``I - T`` to G, with ``T = (I + x G)^-1/2``, ``x (I + x G)^-1 Y' R^-1 e / (N - 1)`` to shift ``(N,)``; and x.

    ``G = Y' R^-1 Y / (N - 1)`` is N x N: less work than p x p where readings outnumber the members, and more
    digits, as S is ill-conditioned there (Bishop et al. 2001). L ``(k, k)`` comes as R and is overwritten, e as well.
    x is 1 unless there is a ``certainty``, see `_scale`; 0: R is singular, and nothing else has changed.
    """
    N, apart = own.shape[1], True
    for a in range(k):
        for b in range(a):
            apart = apart and L[a, b] == 0.0
    if apart:
        for a in range(k):
            L[a, a] = np.sqrt(L[a, a])
    else:
        _cholesky(L, k)
    for a in range(k):
        total = 0.0
        for b in range(a + 1):
            total += L[a, b] * L[a, b]
        if not L[a, a] * L[a, a] > 1e-12 * total:
            return 0.0
    for a in range(k):
        for j in range(N):
            white[a, j] = own[a, j] / L[a, a] if apart else own[a, j]
        e[a, 0] /= L[a, a] if apart else 1.0
    if not apart:
        _solve(L, k, white, False)
        _solve(L, k, e, False)
    for j in range(N):
        shift[j] = 0.0
        for i in range(N):
            G[j, i] = 0.0
        for a in range(k):
            _add(white[a, j], white[a], G[j])
        for i in range(N):
            G[j, i] /= N - 1
    for a in range(k):
        _add(e[a, 0] / (N - 1), white[a], shift)
    _diagonalise(G, N, V)
    values, along, x = np.empty(N), np.empty(N), 1.0
    for m in range(N):
        values[m], along[m] = max(G[m, m], 0.0), dot(V[m], shift)
    if certainty > 0.0:
        share, size = 1.0 / (1.0 + values), np.zeros(N)
        for m in range(N):
            if values[m] > 1e-14 * values.max():
                size[m] = share[m] * along[m] ** 2 * (N - 1) / values[m]
        x = _scale(share, size, N, certainty)
    for j in range(N):
        shift[j] = 0.0
        for i in range(N):
            G[j, i] = 0.0
    for m in range(N):
        value = x * values[m]
        _add(x * along[m] / (1.0 + value), V[m], shift)
        root = np.sqrt(1.0 + value)
        for j in range(N):
            _add(value / (root * (1.0 + root)) * V[m, j], V[m], G[j])
    return x


@part
def _inflated(share: Any, V: Any, e: Any, certainty: float, N: int, M: Any) -> float:
    """What `_scale` says; to e and M what then becomes of e and of `_softened`.

    Shares, V and e are those of ``B = V' diag(m) V``, see `_softened`, and ``L^-1 e``.
    """
    k = len(share)
    along = np.zeros(k)
    for m in range(k):
        for a in range(k):
            along[m] += V[m, a] * e[a, 0]
    x = _scale(share, along * along, N, certainty)
    for i in range(k):
        e[i, 0] = 0.0
        for j in range(k):
            M[i, j] = 0.0
        for m in range(k):
            q = x * (1.0 - share[m]) + share[m]
            e[i, 0] += x / q * V[m, i] * along[m]
            for j in range(k):
                M[i, j] += x / (q + np.sqrt(q * share[m])) * V[m, i] * V[m, j]
    return x


@part
def _taper(taper: Any, index: Any, k: int, R: Any, own: Any, e: Any, S: Any) -> None:
    """Divides R by the taper ``(p,)`` of the readings: R stays, and innovation and anomalies shrink by its root."""
    whole = True
    for a in range(k):
        whole = whole and taper[index[a]] == 1.0
    for a in range(0 if whole else k):
        for b in range(k):
            share = np.sqrt(taper[index[a]] * taper[index[b]])
            if share < 1.0:
                S[a, b] = R[a, b] + share * (S[a, b] - R[a, b])
        root = np.sqrt(taper[index[a]])
        for j in range(own.shape[1]):
            own[a, j] *= root
        e[a, 0] *= root


# --- kernels ----------------------------------------------------------------------------------------

_ROW, _BITS, _SMALL, _LAST = "float64[:]", "boolean[:]", "float64[:, :]", "float64[:, ::1]"


@gufunc(
    f"void({_LAST}, {_LAST}, {_BITS}, {_SMALL}, {_LAST}, {_ROW}, {_LAST})",
    "(n,N),(n,N),(n),(n,r),(r,N)->(n),(n,N)",
)
def forecast(before: Any, after: Any, wrapped: Any, root: Any, normals: Any, mean: Any, out: Any) -> None:
    """The mean ``(n,)``, and members ``x_i = f(x_i-) + L n_i`` whose noise moves it by nothing; angles within a turn.

    Args:
        before: ``(n, N)``,
        after: and ``(n, N)`` what the transition makes of them.
        wrapped: ``(n,)`` which components it may have wrapped.
        root: ``(n, r)`` L, a root of the process noise.
        normals: ``(r, N)``.
        mean: ``(n,)`` and
        out: ``(n, N)`` take the results.
    """
    for i in range(len(after)):
        for j in range(after.shape[1]):
            out[i, j] = after[i, j]
        if wrapped[i]:
            _step_together(before[i], out[i])
    _averaged(out, mean)
    _add_noise(root, normals, np.arange(len(out)), len(out), out)
    for i in range(len(out)):
        # Readings of the members will be gathered: one that is a turn away would be no nearer for any reading.
        if wrapped[i] and np.isfinite(mean[i]) and _gather(out[i]):
            mean[i] = dot(out[i], np.full(out.shape[1], 1.0 / out.shape[1]))


@gufunc(f"void({_LAST}, {_BITS}, {_ROW}, {_LAST})", "(p,N),(p)->(p),(p,N)")
def expected(readings: Any, wrapped: Any, mean: Any, anomalies: Any) -> None:
    """The mean ``(p,)`` of readings that members expect, and their anomalies; those that are angles about it."""
    for i in range(len(readings)):
        for j in range(readings.shape[1]):
            anomalies[i, j] = readings[i, j]
        if wrapped[i]:
            _gather(anomalies[i])
    _averaged(anomalies, mean)
    _departed(anomalies, mean, anomalies)


@part
def _chosen(wanted: Any, arrived: Any, Y: Any, S: Any, R: Any, own: Any, L: Any, shares: Any, index: Any) -> int:
    """The rows of Y, S and R that are wanted and arrived; how many, and to ``index``, which."""
    k = 0
    for i in range(len(arrived)):
        if wanted[i] and arrived[i]:
            for j in range(Y.shape[1]):
                own[k, j] = Y[i, j]
            index[k] = i
            k += 1
    for a in range(k):
        for b in range(k):
            L[a, b], shares[a, b] = S[index[a], index[b]], R[index[a], index[b]]
    return k


@part
def _innovation_cov(Y: Any, arrived: Any, R: Any, S: Any) -> None:
    """``S = Y Y' / (N - 1) + R`` of the readings that arrived; of the others R."""
    for i in range(len(S)):
        for j in range(i + 1):
            S[i, j] = R[i, j]
            if arrived[i] and arrived[j]:
                S[i, j] += dot(Y[i], Y[j]) / (Y.shape[1] - 1)
            S[j, i] = S[i, j]


@gufunc(
    f"void({_LAST}, {_ROW}, {_LAST}, {_ROW}, {_BITS}, {_SMALL}, {_SMALL}, {_LAST}, {_SMALL}, float64, "
    f"{_ROW}, {_LAST}, {_SMALL})",
    "(n,N),(n),(p,N),(p),(p),(p,p),(p,p),(p,N),(p,n),()->(n),(n,N),(p,p)",
)
def perturbed(
    members: Any, before: Any, Y: Any, innovation: Any, arrived: Any, R: Any, root: Any, normals: Any, taper: Any,
    inflation: float, mean: Any, A: Any, S: Any,
) -> None:  # fmt: skip
    """The analysis of perturbed readings, ``x_i = x_i- + K (y + v_i - h(x_i-))`` with ``K = (C P)' S^-1``.

    Args:
        members: ``(n, N)``,
        before: and ``(n,)`` their mean.
        Y: ``(p, N)`` anomalies of the readings that they expect.
        innovation: ``(p,)``.
        arrived: ``(p,)`` which readings there are.
        R: ``(p, p)`` their covariance,
        root: and ``(p, p)`` a root of it.
        normals: ``(p, N)``, as many as its root has a use for.
        taper: ``(p, n)`` factors on the gain.
        inflation: Factor on the anomalies of components that a reading may correct.
        mean: ``(n,)``,
        A: ``(n, N)`` and
        S: ``(p, p)`` take the mean and the members after it, and the innovation's covariance.
    """
    (n, N), p, index = members.shape, len(R), np.empty(len(R), np.int64)
    own, D, gain, L, shares = np.empty((p, N)), np.zeros((p, N)), np.empty((p, n)), np.empty((p, p)), np.empty((p, p))
    _innovation_cov(Y, arrived, R, S)
    k = _chosen(arrived, arrived, Y, S, R, own, L, shares, index)
    _departed(members, before, A)
    _covary(own, k, A, gain)
    _cholesky(L, k)
    _solve(L, k, gain, False)
    _solve(L, k, gain, True)
    _add_noise(root, normals, index, k, D)
    for a in range(k):
        for j in range(N):
            D[a, j] -= own[a, j]
    for c in range(n):
        shift, factor = before[c], 1.0
        for a in range(k):
            share = taper[index[a], c]
            if share > 0.0:
                gain[a, c] *= share
                shift += gain[a, c] * innovation[index[a]]
                _add(gain[a, c], D[a], A[c])
                factor = inflation
        for j in range(N):
            A[c, j] = shift + factor * A[c, j]
    _averaged(A, mean)


@gufunc(
    f"void({_LAST}, {_ROW}, {_LAST}, {_ROW}, {_BITS}, {_SMALL}, boolean[:, :], {_SMALL}, float64, float64, "
    f"{_ROW}, {_LAST}, {_SMALL})",
    "(n,N),(n),(p,N),(p),(p),(p,p),(g,n),(g,p),(),()->(n),(n,N),(p,p)",
)
def transformed(
    members: Any, before: Any, Y: Any, innovation: Any, arrived: Any, R: Any, states: Any, channels: Any,
    inflation: float, certainty: float, mean: Any, A: Any, S: Any,
) -> None:  # fmt: skip
    """The analysis of a symmetric transform, ``A <- A - K~ Y``.

    With ``S = L L'`` and ``B = L^-1 R L'^-1``::

        K = (C P)' L'^-1 L^-1        K~ = (C P)' L'^-1 (I + B^1/2)^-1 L^-1

    Where more readings arrived than there are members, the same is computed as ``A <- A T``, see `_among_members`.

    ``states (g, n)`` tells which components form a group, ``channels (g, p)`` what share of a reading's information it
    gets; with a ``certainty`` above 0 anomalies are inflated before the analysis, see `_scale`. All else is as for
    `perturbed`.
    """
    (n, N), p, index, which = members.shape, len(R), np.empty(len(R), np.int64), np.empty(len(members), np.int64)
    own, L, shares, M, V = np.empty((p, N)), np.empty((p, p)), np.empty((p, p)), np.empty((p, p)), np.empty((p, p))
    CP, gain, e = np.empty((p, n)), np.empty((p, n)), np.empty((p, 1))
    many = N if p > N else 0
    white, T, U, shift = np.empty((p, many)), np.empty((many, many)), np.empty((many, many)), np.empty(many)
    _innovation_cov(Y, arrived, R, S)
    _departed(members, before, A)
    for c in range(n):
        mean[c] = before[c]
    for g in range(len(states)):
        k, count, x = _chosen(channels[g], arrived, Y, S, R, own, L, shares, index), 0, 1.0
        if k == 0:
            continue
        for c in range(n):
            if states[g, c]:
                which[count] = c
                count += 1
        for a in range(k):
            e[a, 0] = innovation[index[a]]
        _taper(channels[g], index, k, shares, own, e, L)
        if k > N:
            for a in range(k):
                for b in range(k):
                    M[a, b] = shares[a, b]
            x = _among_members(own, k, M, e, certainty, white, T, U, shift)
            for i in range(count if x > 0.0 else 0):
                row = A[which[i]]
                mean[which[i]] += dot(row, shift)
                for j in range(N):
                    own[0, j] = row[j]
                for j in range(N):
                    _add(-own[0, j], T[j], row)
        if k <= N or x == 0.0:
            x = 1.0
            for a in range(k):
                for i in range(count):
                    CP[a, i] = dot(own[a], A[which[i]]) / (N - 1)
            _cholesky(L, k)
            _softened(L, k, shares, V, M)
            _solve(L, k, CP[:, :count], False)
            _solve(L, k, e, False)
            if certainty > 0.0:
                x = _inflated(np.maximum(np.diag(shares[:k, :k]), 0.0), V, e, certainty, N, M)
            for a in range(k):
                for i in range(count):
                    gain[a, i] = 0.0
                    for m in range(k):
                        gain[a, i] += M[a, m] * CP[m, i]
            _solve(L, k, gain[:, :count], True)
            for i in range(count):
                for a in range(k):
                    mean[which[i]] += CP[a, i] * e[a, 0]
                    _add(-gain[a, i], own[a], A[which[i]])
        for i in range(count):
            for j in range(N):
                A[which[i], j] *= inflation * np.sqrt(x)
    for c in range(n):
        for j in range(N):
            A[c, j] += mean[c]
    _averaged(A, mean)


@gufunc(f"void({_LAST}, {_ROW}, {_SMALL})", "(n,N),(n)->(n,n)")
def covariance(members: Any, mean: Any, out: Any) -> None:
    """``A A' / (N - 1)`` of members ``(n, N)``."""
    A = np.empty(members.shape)
    _departed(members, mean, A)
    _covary(A, len(A), A, out)
