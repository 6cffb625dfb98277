"""What carries out the sentences of formulas (`estimators.formulas`), compiled once for all.

Numbers stand in a scratch ``w (size, L)``, L rows of the batch side by side. A matrix is a place in it and two steps:
its entry (i, j) is ``w[place + i * step + j * other]``; transposed and cut out of others it needs no copy.
"""

import numpy as np
from numba import njit

from estimators.compiled import inlined, lazy, part
from estimators.formulas import Verb

LANES = 64
"""Rows side by side."""


_WORDS = 16  # a sentence: its verb, three sizes, then four places and their steps
_EPS = float(np.finfo(float).eps)
_SWEEPS = 30


@part
def _load(source: np.ndarray, start: int, column: int, count: int, w: np.ndarray, place: int, block: int) -> None:
    """Columns of some rows of an array."""
    for k in range(count):
        out = w[place + k]
        for r in range(block):
            out[r] = source[start + r, column + k]


@part
def _store(w: np.ndarray, s: np.ndarray, out: np.ndarray, start: int, block: int) -> None:
    """A matrix, row by row, to columns of some rows of an array."""
    for i in range(s[1]):
        for j in range(s[2]):
            a, column = w[s[3] + i * s[4] + j * s[5]], s[0] + i * s[2] + j
            for r in range(block):
                out[start + r, column] = a[r]


@part
def _matmul(w: np.ndarray, s: np.ndarray) -> None:
    """``A B``."""
    for i in range(s[1]):
        for j in range(s[2]):
            out, a, b = s[4] + i * s[5] + j * s[6], s[7] + i * s[8], s[10] + j * s[12]
            if w.shape[1] == 1:
                total = w[a, 0] * w[b, 0]
                for k in range(1, s[3]):
                    total += w[a + k * s[9], 0] * w[b + k * s[11], 0]
                w[out, 0] = total
                continue
            z, x, y = w[out], w[a], w[b]
            for r in range(w.shape[1]):
                z[r] = x[r] * y[r]
            for k in range(1, s[3] - 1, 2):  # two at once, added one after the other
                x, y, u, v = w[a + k * s[9]], w[b + k * s[11]], w[a + (k + 1) * s[9]], w[b + (k + 1) * s[11]]
                for r in range(w.shape[1]):
                    z[r] = (z[r] + x[r] * y[r]) + u[r] * v[r]
            if s[3] % 2 == 0:
                x, y = w[a + (s[3] - 1) * s[9]], w[b + (s[3] - 1) * s[11]]
                for r in range(w.shape[1]):
                    z[r] += x[r] * y[r]


@part
def _symmetrise(w: np.ndarray, s: np.ndarray) -> None:
    """``(A + A') / 2``."""
    for i in range(s[1]):
        for j in range(i + 1):
            out, other = w[s[4] + i * s[5] + j * s[6]], w[s[4] + j * s[5] + i * s[6]]
            a, b = w[s[7] + i * s[8] + j * s[9]], w[s[7] + j * s[8] + i * s[9]]
            for r in range(w.shape[1]):
                out[r] = 0.5 * (a[r] + b[r])
            if i != j:
                for r in range(w.shape[1]):
                    other[r] = out[r]


@inlined
def _entry(verb: int, a: float, b: float, c: float) -> float:
    if verb == Verb.ADD:
        return a + b
    if verb == Verb.SUBTRACT:
        return a - b
    if verb == Verb.MULTIPLY:
        return a * b
    if verb == Verb.DIVIDE:
        return a / b
    if verb == Verb.MAXIMUM:
        return a if a > b or np.isnan(a) else b
    if verb == Verb.MINIMUM:
        return a if a < b or np.isnan(a) else b
    if verb == Verb.GREATER:
        return 1.0 if a > b else 0.0
    if verb == Verb.WHERE:
        return b if a != 0.0 else c
    if verb == Verb.SQRT:
        return np.sqrt(a)
    if verb == Verb.ABSOLUTE:
        return abs(a)
    if verb == Verb.FLOOR:
        return np.floor(a)
    if verb == Verb.ISFINITE:
        return 1.0 if a - a == 0.0 else 0.0
    return np.log1p(a)


@part
def _entrywise(flat: np.ndarray, rows: int, s: np.ndarray) -> None:
    """Entry by entry, as many at once as lie side by side in all matrices; ``flat`` is the scratch in one row."""
    verb, size = s[0], s[3] * rows
    for i in range(s[1]):
        for j in range(s[2]):
            o, a = rows * (s[4] + i * s[5] + j * s[6]), rows * (s[7] + i * s[8] + j * s[9])
            b, c = rows * (s[10] + i * s[11] + j * s[12]), rows * (s[13] + i * s[14] + j * s[15])
            if rows == 1:  # no slices, which would take longer than what is done with them
                for k in range(size):
                    flat[o + k] = _entry(verb, flat[a + k], flat[b + k], flat[c + k])
                continue
            out, x, y, z = flat[o : o + size], flat[a : a + size], flat[b : b + size], flat[c : c + size]
            if verb == Verb.ADD:
                _each(Verb.ADD, out, x, y, z)
            elif verb == Verb.SUBTRACT:
                _each(Verb.SUBTRACT, out, x, y, z)
            elif verb == Verb.MULTIPLY:
                _each(Verb.MULTIPLY, out, x, y, z)
            elif verb == Verb.WHERE:
                _each(Verb.WHERE, out, x, y, z)
            else:
                _each(verb, out, x, y, z)


@inlined
def _each(verb: int, out: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> None:
    for r in range(len(out)):
        out[r] = _entry(verb, a[r], b[r], c[r])


@part
def _solve(w: np.ndarray, s: np.ndarray) -> None:
    """``S^-1 B`` by ``S = L D L'``, which is left beside; NaN where S is not positive definite."""
    n, rows, f = s[1], w.shape[1], s[13]
    for j in range(n):
        for i in range(j, n):  # L D below the diagonal, D on it, and L where its transpose would be
            out, a = w[f + i * n + j], w[s[7] + i * s[8] + j * s[9]]
            for r in range(rows):
                out[r] = a[r]
            for k in range(j):
                x, y = w[f + i * n + k], w[f + k * n + j]
                for r in range(rows):
                    out[r] -= x[r] * y[r]
        pivot = w[f + j * n + j]
        for r in range(rows):
            pivot[r] = pivot[r] if pivot[r] > 0.0 else np.nan
        for i in range(j + 1, n):
            out, a = w[f + j * n + i], w[f + i * n + j]
            for r in range(rows):
                out[r] = a[r] / pivot[r]
    for c in range(s[2]):
        for i in range(n):
            out, b = w[s[4] + i * s[5] + c * s[6]], w[s[10] + i * s[11] + c * s[12]]
            for r in range(rows):
                out[r] = b[r]
            for k in range(i):
                x, y = w[f + k * n + i], w[s[4] + k * s[5] + c * s[6]]
                for r in range(rows):
                    out[r] -= x[r] * y[r]
        for i in range(n - 1, -1, -1):
            out, pivot = w[s[4] + i * s[5] + c * s[6]], w[f + i * n + i]
            for r in range(rows):
                out[r] /= pivot[r]
            for k in range(i + 1, n):
                x, y = w[f + i * n + k], w[s[4] + k * s[5] + c * s[6]]
                for r in range(rows):
                    out[r] -= x[r] * y[r]


@part
def _cholesky(w: np.ndarray, s: np.ndarray) -> None:
    """``L L' = S``; a pivot that is zero to rounding gives a column of zeros."""
    n, rows = s[1], w.shape[1]
    for i in range(n):
        for j in range(n):
            out, a = w[s[4] + i * s[5] + j * s[6]], w[s[7] + i * s[8] + j * s[9]]
            for r in range(rows):
                out[r] = a[r] if i >= j else 0.0
    for j in range(n):
        pivot, whole = w[s[4] + j * (s[5] + s[6])], w[s[7] + j * (s[8] + s[9])]
        for r in range(rows):
            pivot[r] = np.sqrt(pivot[r]) if not pivot[r] <= n * _EPS * whole[r] else np.inf
        for i in range(j + 1, n):
            out = w[s[4] + i * s[5] + j * s[6]]
            for r in range(rows):
                out[r] /= pivot[r]
        for r in range(rows):
            pivot[r] = 0.0 if pivot[r] == np.inf else pivot[r]
        for i in range(j + 1, n):
            x = w[s[4] + i * s[5] + j * s[6]]
            for k in range(j + 1, i + 1):
                out, y = w[s[4] + i * s[5] + k * s[6]], w[s[4] + k * s[5] + j * s[6]]
                for r in range(rows):
                    out[r] -= x[r] * y[r]


@part
def _rotate(w: np.ndarray, s: np.ndarray) -> None:
    """V, and ``A V`` with orthogonal columns."""
    m, n, rows = s[1], s[2], w.shape[1]
    for j in range(n):
        for i in range(m):
            out, a = w[s[7] + i * s[8] + j * s[9]], w[s[10] + i * s[11] + j * s[12]]
            for r in range(rows):
                out[r] = a[r]
        for i in range(n):
            out = w[s[4] + i * s[5] + j * s[6]]
            for r in range(rows):
                out[r] = 1.0 if i == j else 0.0
    for _ in range(_SWEEPS):
        turning = False
        for p in range(n):
            for q in range(p + 1, n):
                for r in range(rows):
                    aa, bb, ab = 0.0, 0.0, 0.0
                    for i in range(m):
                        x, y = w[s[7] + i * s[8] + p * s[9], r], w[s[7] + i * s[8] + q * s[9], r]
                        aa, bb, ab = aa + x * x, bb + y * y, ab + x * y
                    if not abs(ab) > _EPS * np.sqrt(aa * bb):
                        continue
                    turning = True
                    zeta = (bb - aa) / (2.0 * ab)
                    t = (1.0 if zeta >= 0.0 else -1.0) / (abs(zeta) + np.sqrt(1.0 + zeta * zeta))
                    cosine = 1.0 / np.sqrt(1.0 + t * t)
                    sine = cosine * t
                    for i in range(m):
                        a, b = s[7] + i * s[8] + p * s[9], s[7] + i * s[8] + q * s[9]
                        x, y = w[a, r], w[b, r]
                        w[a, r], w[b, r] = cosine * x - sine * y, sine * x + cosine * y
                    for i in range(n):
                        a, b = s[4] + i * s[5] + p * s[6], s[4] + i * s[5] + q * s[6]
                        x, y = w[a, r], w[b, r]
                        w[a, r], w[b, r] = cosine * x - sine * y, sine * x + cosine * y
        if not turning:
            return


@part
def _lookup(w: np.ndarray, s: np.ndarray, numbers: np.ndarray) -> None:
    """The matrix of a table."""
    size = s[1] * s[2]
    for r in range(w.shape[1]):
        at = w[s[7], r]
        entry = 0 if not at >= 0.0 else int(min(at, s[3] - 1.0))
        for i in range(s[1]):
            for j in range(s[2]):
                w[s[4] + i * s[5] + j * s[6], r] = numbers[s[10] + entry * size + i * s[2] + j]


_X = "float64[:, ::1]"
_ARGUMENTS = f"int64(int64[::1], float64[::1], {_X}, {_X}, {_X}, boolean[:, ::1], {_X}, {_X})"


@lazy(lambda f: njit(_ARGUMENTS, error_model="numpy", nogil=True, cache=True)(f))
def carried_out(
    words: np.ndarray, numbers: np.ndarray, first: np.ndarray, second: np.ndarray, third: np.ndarray, mask: np.ndarray,
    fourth: np.ndarray, out: np.ndarray,
) -> int:  # fmt: skip
    """Carry out a `estimators.formulas.Program` on arrays ``(B, k)``.

    Args:
        words: The program's sentences, what stands where, what is loaded and stored.
        numbers: Its constants and tables.
        first: What is given, array number 0; those that follow are numbers 1 to 4.
        second: Likewise.
        third: Likewise.
        mask: Likewise.
        fourth: Likewise.
        out: Where results are put.

    Returns:
        In how many rows the last column of the results is not 0.
    """
    sentences, constants, loads, stores, size = words[0], words[1], words[2], words[3], words[4]
    where = 5 + _WORDS * sentences
    load, store = where + constants, where + constants + 4 * loads
    rows, marked = len(out), 0
    w = np.empty((size, min(rows, LANES)))
    flat = w.ravel()
    for i in range(constants):
        w[words[where + i]] = numbers[i]
    tables = numbers[constants:]
    for start in range(0, rows, LANES):
        block = min(LANES, rows - start)
        for i in range(loads):
            array, column, place, count = words[load + 4 * i : load + 4 * i + 4]
            if array == 0:
                _load(first, start, column, count, w, place, block)
            elif array == 1:
                _load(second, start, column, count, w, place, block)
            elif array == 2:
                _load(third, start, column, count, w, place, block)
            elif array == 3:
                _load(mask, start, column, count, w, place, block)
            else:
                _load(fourth, start, column, count, w, place, block)
        for i in range(sentences):
            sentence = words[5 + _WORDS * i : 5 + _WORDS * (i + 1)]
            verb = sentence[0]
            if verb == Verb.MATMUL:
                _matmul(w, sentence)
            elif verb <= Verb.WHERE:
                _entrywise(flat, w.shape[1], sentence)
            elif verb == Verb.SOLVE:
                _solve(w, sentence)
            elif verb == Verb.SYMMETRISE:
                _symmetrise(w, sentence)
            elif verb == Verb.CHOLESKY:
                _cholesky(w, sentence)
            elif verb == Verb.ROTATE:
                _rotate(w, sentence)
            else:
                _lookup(w, sentence, tables)
        for i in range(stores):
            _store(w, words[store + 6 * i : store + 6 * i + 6], out, start, block)
        for r in range(block):
            marked += out[start + r, out.shape[1] - 1] != 0.0
    return marked
