"""What carries out the sentences of formulas (`estimators.formulas`), compiled once for all.

Numbers stand in a scratch ``w``, those of L rows of the batch side by side. A matrix is a place in it and two steps:
its entry (i, j) begins at ``w[L * (place + i * step + j * other)]``; transposed and cut out of others it needs no copy.

A sentence is `WORDS` of ``s`` from ``at`` on: its verb, three sizes, and four places with their steps, of which the
first is that of the result. Words have no sign, for an index that could be negative would have to be looked at.
"""

import math
from typing import Any

import numpy as np

from estimators.compiled import inlined, part, rowwise
from estimators.formulas import Verb

WORDS = 16
_LANES = np.uint64(64)  # rows side by side
_EPS = float(np.finfo(float).eps)
_SWEEPS = 30
_0, _1, _2, _3 = (np.uint64(i) for i in range(4))


@inlined
def _place(s: Any, at: Any, which: int, i: Any, j: Any, L: Any) -> Any:
    """Where an entry of one of the places begins."""
    first = at + np.uint64(4 + 3 * which)
    return L * (s[first] + i * s[first + _1] + j * s[first + _2])


@part
def _load(source: Any, start: Any, column: Any, count: Any, w: Any, place: Any, L: Any, block: Any) -> None:
    """Columns of some rows of an array."""
    for k in range(count):
        out = L * (place + k)
        for r in range(block):
            w[out + r] = source[start + r, column + k]


@part
def _store(w: Any, s: Any, at: Any, out: Any, start: Any, L: Any, block: Any) -> None:
    """A matrix, row by row, to columns of some rows of an array."""
    for i in range(s[at + _1]):
        for j in range(s[at + _2]):
            a = L * (s[at + _3] + i * s[at + np.uint64(4)] + j * s[at + np.uint64(5)])
            column = s[at] + i * s[at + _2] + j
            for r in range(block):
                out[start + r, column] = w[a + r]


@part
def _matmul(w: Any, s: Any, at: Any, L: Any) -> None:
    """``A B``."""
    rows, columns, inner = s[at + _1], s[at + _2], s[at + _3]
    across, down = L * s[at + np.uint64(9)], L * s[at + np.uint64(11)]
    if _1 == L:  # sums side by side, for the terms of one wait for each other
        beside, other = s[at + np.uint64(6)], s[at + np.uint64(12)]
        for i in range(rows):
            first, x, y = _place(s, at, 0, i, _0, L), _place(s, at, 1, i, _0, L), _place(s, at, 2, _0, _0, L)
            for j in range(columns):
                w[first + j * beside] = w[x] * w[y + j * other]
            for k in range(_1, inner):
                factor, b = w[x + k * across], y + k * down
                for j in range(columns):
                    w[first + j * beside] += factor * w[b + j * other]
        return
    for i in range(rows):
        for j in range(columns):
            z, x, y = _place(s, at, 0, i, j, L), _place(s, at, 1, i, _0, L), _place(s, at, 2, _0, j, L)
            for r in range(L):
                w[z + r] = w[x + r] * w[y + r]
            for k in range(_1, inner - (inner + _1) % _2, _2):  # two at once, added one after the other
                a, b = x + k * across, y + k * down
                for r in range(L):
                    w[z + r] = (w[z + r] + w[a + r] * w[b + r]) + w[a + across + r] * w[b + down + r]
            if inner % _2 == _0:
                a, b = x + (inner - _1) * across, y + (inner - _1) * down
                for r in range(L):
                    w[z + r] += w[a + r] * w[b + r]


@part
def _symmetrise(w: Any, s: Any, at: Any, L: Any) -> None:
    """``(A + A') / 2``."""
    for i in range(s[at + _1]):
        for j in range(i + _1):
            z, x, y = _place(s, at, 0, i, j, L), _place(s, at, 1, i, j, L), _place(s, at, 1, j, i, L)
            for r in range(L):
                w[z + r] = 0.5 * (w[x + r] + w[y + r])
            if i != j:
                x = _place(s, at, 0, j, i, L)
                for r in range(L):
                    w[x + r] = w[z + r]


@part
def _entrywise(w: Any, s: Any, at: Any, L: Any) -> None:
    """Entry by entry, as many at once as lie side by side in all matrices."""
    verb, size = np.int64(s[at]), L * s[at + _3]
    for i in range(s[at + _1]):
        for j in range(s[at + _2]):
            z, x = _place(s, at, 0, i, j, L), _place(s, at, 1, i, j, L)
            y, m = _place(s, at, 2, i, j, L), _place(s, at, 3, i, j, L)
            if verb == Verb.ADD:
                for r in range(size):
                    w[z + r] = w[x + r] + w[y + r]
            elif verb == Verb.SUBTRACT:
                for r in range(size):
                    w[z + r] = w[x + r] - w[y + r]
            elif verb == Verb.MULTIPLY:
                for r in range(size):
                    w[z + r] = w[x + r] * w[y + r]
            elif verb == Verb.DIVIDE:
                for r in range(size):
                    w[z + r] = w[x + r] / w[y + r]
            elif verb == Verb.WHERE:
                for r in range(size):
                    a, b = w[y + r], w[m + r]
                    w[z + r] = a if w[x + r] != 0.0 else b
            elif verb == Verb.GREATER:
                for r in range(size):
                    w[z + r] = 1.0 if w[x + r] > w[y + r] else 0.0
            elif verb == Verb.MAXIMUM:
                for r in range(size):
                    a, b = w[x + r], w[y + r]
                    w[z + r] = a if a > b or a != a else b
            elif verb == Verb.MINIMUM:
                for r in range(size):
                    a, b = w[x + r], w[y + r]
                    w[z + r] = a if a < b or a != a else b
            elif verb == Verb.SQRT:
                for r in range(size):
                    w[z + r] = np.sqrt(w[x + r])
            elif verb == Verb.ABSOLUTE:
                for r in range(size):
                    w[z + r] = abs(w[x + r])
            elif verb == Verb.FLOOR:
                for r in range(size):
                    w[z + r] = np.floor(w[x + r])
            elif verb == Verb.ISFINITE:
                for r in range(size):
                    w[z + r] = 1.0 if w[x + r] - w[x + r] == 0.0 else 0.0
            elif verb == Verb.REMAINDER:
                for r in range(size):
                    a, b = np.fmod(w[x + r], w[y + r]), w[y + r]
                    w[z + r] = math.copysign(0.0, b) if a == 0.0 else (a + b if (a < 0.0) != (b < 0.0) else a)
            else:
                for r in range(size):
                    w[z + r] = np.log1p(w[x + r])


@part
def _solve(w: Any, s: Any, at: Any, L: Any) -> None:
    """``S^-1 B`` by ``S = L D L'``, which is left beside; NaN where S is not positive definite."""
    n = s[at + _1]
    for j in range(n):
        pivot = _place(s, at, 3, j, j, L)
        for i in range(j, n):  # L D below the diagonal, D on it, and L where its transpose would be
            z, x = _place(s, at, 3, i, j, L), _place(s, at, 1, i, j, L)
            for r in range(L):
                w[z + r] = w[x + r]
            for k in range(j):
                x, y = _place(s, at, 3, i, k, L), _place(s, at, 3, k, j, L)
                for r in range(L):
                    w[z + r] -= w[x + r] * w[y + r]
        for r in range(L):
            w[pivot + r] = w[pivot + r] if w[pivot + r] > 0.0 else np.nan
        for i in range(j + _1, n):
            z, x = _place(s, at, 3, j, i, L), _place(s, at, 3, i, j, L)
            for r in range(L):
                w[z + r] = w[x + r] / w[pivot + r]
    for c in range(s[at + _2]):
        for i in range(n):
            z, x = _place(s, at, 0, i, c, L), _place(s, at, 2, i, c, L)
            for r in range(L):
                w[z + r] = w[x + r]
            for k in range(i):
                x, y = _place(s, at, 3, k, i, L), _place(s, at, 0, k, c, L)
                for r in range(L):
                    w[z + r] -= w[x + r] * w[y + r]
        for below in range(n):
            i = n - _1 - below
            z, pivot = _place(s, at, 0, i, c, L), _place(s, at, 3, i, i, L)
            for r in range(L):
                w[z + r] /= w[pivot + r]
            for k in range(i + _1, n):
                x, y = _place(s, at, 3, i, k, L), _place(s, at, 0, k, c, L)
                for r in range(L):
                    w[z + r] -= w[x + r] * w[y + r]


@part
def _eliminate(w: Any, s: Any, at: Any, L: Any) -> None:
    """``S^-1 B`` by elimination with partial pivoting, row by row of the batch; NaN where S is singular."""
    n, columns = s[at + _1], s[at + _2]
    for i in range(n):
        for j in range(n):
            z, x = _place(s, at, 3, i, j, L), _place(s, at, 1, i, j, L)
            for r in range(L):
                w[z + r] = w[x + r]
        for c in range(columns):
            z, x = _place(s, at, 0, i, c, L), _place(s, at, 2, i, c, L)
            for r in range(L):
                w[z + r] = w[x + r]
    for r in range(L):
        for j in range(n):
            best = j
            for i in range(j + _1, n):
                if abs(w[_place(s, at, 3, i, j, L) + r]) > abs(w[_place(s, at, 3, best, j, L) + r]):
                    best = i
            if best != j:
                for k in range(j, n):
                    x, y = _place(s, at, 3, j, k, L) + r, _place(s, at, 3, best, k, L) + r
                    w[x], w[y] = w[y], w[x]
                for c in range(columns):
                    x, y = _place(s, at, 0, j, c, L) + r, _place(s, at, 0, best, c, L) + r
                    w[x], w[y] = w[y], w[x]
            pivot = w[_place(s, at, 3, j, j, L) + r]
            pivot = pivot if pivot != 0.0 else np.nan
            w[_place(s, at, 3, j, j, L) + r] = pivot
            for i in range(j + _1, n):
                factor = w[_place(s, at, 3, i, j, L) + r] / pivot
                for k in range(j + _1, n):
                    w[_place(s, at, 3, i, k, L) + r] -= factor * w[_place(s, at, 3, j, k, L) + r]
                for c in range(columns):
                    w[_place(s, at, 0, i, c, L) + r] -= factor * w[_place(s, at, 0, j, c, L) + r]
        for c in range(columns):
            for below in range(n):
                i = n - _1 - below
                z = _place(s, at, 0, i, c, L) + r
                for k in range(i + _1, n):
                    w[z] -= w[_place(s, at, 3, i, k, L) + r] * w[_place(s, at, 0, k, c, L) + r]
                w[z] /= w[_place(s, at, 3, i, i, L) + r]


@part
def _cholesky(w: Any, s: Any, at: Any, L: Any) -> None:
    """``L L' = S``; a pivot that is zero to rounding gives a column of zeros."""
    n = s[at + _1]
    for i in range(n):
        for j in range(n):
            z, x = _place(s, at, 0, i, j, L), _place(s, at, 1, i, j, L)
            for r in range(L):
                w[z + r] = w[x + r] if i >= j else 0.0
    for j in range(n):
        pivot, whole = _place(s, at, 0, j, j, L), _place(s, at, 1, j, j, L)
        for r in range(L):
            nothing = w[pivot + r] <= np.float64(n) * _EPS * w[whole + r]
            w[pivot + r] = np.inf if nothing else np.sqrt(w[pivot + r])
        for i in range(j + _1, n):
            z = _place(s, at, 0, i, j, L)
            for r in range(L):
                w[z + r] /= w[pivot + r]
        for r in range(L):
            w[pivot + r] = 0.0 if w[pivot + r] == np.inf else w[pivot + r]
        for i in range(j + _1, n):
            x = _place(s, at, 0, i, j, L)
            for k in range(j + _1, i + _1):
                z, y = _place(s, at, 0, i, k, L), _place(s, at, 0, k, j, L)
                for r in range(L):
                    w[z + r] -= w[x + r] * w[y + r]


@inlined
def _turn(w: Any, x: Any, y: Any, turns: Any, L: Any) -> None:
    """Turns ``x`` and ``y`` of each row by its own angle; a row without one keeps its bits."""
    for r in range(L):
        a, b, cosine, sine = w[x + r], w[y + r], turns[r], turns[L + r]
        w[x + r] = cosine * a - sine * b if sine != 0.0 else a
        w[y + r] = sine * a + cosine * b if sine != 0.0 else b


@part
def _rotate(w: Any, s: Any, at: Any, L: Any) -> None:
    """``A V`` with orthogonal columns, and V where it is wanted: pairs of columns that are not yet are turned."""
    m, n, wanted = s[at + _1], s[at + _2], s[at + _3]
    turns = np.empty(np.uint64(3) * L)
    for j in range(n):
        for i in range(m):
            z, x = _place(s, at, 1, i, j, L), _place(s, at, 2, i, j, L)
            for r in range(L):
                w[z + r] = w[x + r]
        for i in range(wanted):
            z = _place(s, at, 0, i, j, L)
            for r in range(L):
                w[z + r] = 1.0 if i == j else 0.0
    for _ in range(_SWEEPS):
        turning = False
        for p in range(n):
            for q in range(p + _1, n):
                for r in range(np.uint64(3) * L):
                    turns[r] = 0.0
                for i in range(m):
                    x, y = _place(s, at, 1, i, p, L), _place(s, at, 1, i, q, L)
                    for r in range(L):
                        a, b = w[x + r], w[y + r]
                        turns[r] += a * a
                        turns[L + r] += b * b
                        turns[L + L + r] += a * b
                aside = 0.0
                for r in range(L):
                    aa, bb, ab = turns[r], turns[L + r], turns[L + L + r]
                    apart = 1.0 if abs(ab) > _EPS * np.sqrt(aa * bb) else 0.0
                    zeta = (bb - aa) / (2.0 * ab)
                    tangent = (1.0 if zeta >= 0.0 else -1.0) / (abs(zeta) + np.sqrt(1.0 + zeta * zeta))
                    cosine = 1.0 / np.sqrt(1.0 + tangent * tangent)
                    turns[r], turns[L + r] = cosine, cosine * tangent if apart != 0.0 else 0.0
                    aside += apart
                if aside > 0.0:
                    turning = True
                    for i in range(m):
                        _turn(w, _place(s, at, 1, i, p, L), _place(s, at, 1, i, q, L), turns, L)
                    for i in range(wanted):
                        _turn(w, _place(s, at, 0, i, p, L), _place(s, at, 0, i, q, L), turns, L)
        if not turning:
            return


@part
def _lookup(w: Any, s: Any, at: Any, L: Any, tables: Any) -> None:
    """The matrix of a table."""
    rows, columns, entries = s[at + _1], s[at + _2], np.float64(s[at + _3])
    for r in range(L):
        index = w[_place(s, at, 1, _0, _0, L) + r]
        entry = _0 if not index >= 0.0 else np.uint64(min(index, entries - 1.0))
        for i in range(rows):
            for j in range(columns):
                found = tables[s[at + np.uint64(10)] + (entry * rows + i) * columns + j]
                w[_place(s, at, 0, i, j, L) + r] = found


_X = "float64[:, ::1]"


@rowwise(f"int64(uint64[::1], float64[::1], {_X}, {_X}, {_X}, boolean[:, ::1], {_X}, {_X})")
def carried_out(
    s: np.ndarray, numbers: np.ndarray, first: np.ndarray, second: np.ndarray, third: np.ndarray, mask: np.ndarray,
    fourth: np.ndarray, out: np.ndarray,
) -> int:  # fmt: skip
    """Carry out a `estimators.formulas.Program` on arrays ``(B, k)``.

    Args:
        s: The program's sentences, what stands where, what is loaded and stored.
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
    sentences, constants, loads, stores, size = s[0], s[1], s[2], s[3], s[4]
    begin, four, six, words = np.uint64(5), np.uint64(4), np.uint64(6), np.uint64(WORDS)
    where = begin + words * sentences
    load, store = where + constants, where + constants + four * loads
    rows, marked = np.uint64(len(out)), 0
    L = min(rows, _LANES)
    w, tables = np.empty(size * L), numbers[constants:]
    for i in range(constants):
        for r in range(L):
            w[L * s[where + i] + r] = numbers[i]
    for start in range(_0, rows, _LANES):
        block = min(_LANES, rows - start)
        for at in range(load, load + four * loads, four):
            array, column, place, count = np.int64(s[at]), s[at + _1], s[at + _2], s[at + _3]
            if array == 0:
                _load(first, start, column, count, w, place, L, block)
            elif array == 1:
                _load(second, start, column, count, w, place, L, block)
            elif array == 2:
                _load(third, start, column, count, w, place, L, block)
            elif array == 3:
                _load(mask, start, column, count, w, place, L, block)
            else:
                _load(fourth, start, column, count, w, place, L, block)
        for at in range(begin, where, words):
            verb = np.int64(s[at])
            if verb == Verb.MATMUL:
                _matmul(w, s, at, L)
            elif verb <= Verb.WHERE:
                _entrywise(w, s, at, L)
            elif verb == Verb.SOLVE:
                _solve(w, s, at, L)
            elif verb == Verb.SYMMETRISE:
                _symmetrise(w, s, at, L)
            elif verb == Verb.CHOLESKY:
                _cholesky(w, s, at, L)
            elif verb == Verb.ROTATE:
                _rotate(w, s, at, L)
            elif verb == Verb.ELIMINATE:
                _eliminate(w, s, at, L)
            else:
                _lookup(w, s, at, L, tables)
        for i in range(stores):
            _store(w, s, store + six * i, out, start, L, block)
        for r in range(block):
            marked += out[start + r, out.shape[1] - 1] != 0.0
    return marked
