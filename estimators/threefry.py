"""Random words and numbers of counters, compiled.

The words are those of Threefry-2x64 with 13 rounds (Salmon, Moraes, Dror & Shaw 2011, Parallel random numbers: as easy
as 1, 2, 3), a generator by counters that passes BigCrush; the normal numbers those of Box & Muller (1958), of sums,
products and square roots alone, hence the same to the last bit on every processor.
"""

from typing import Any

import numpy as np

from estimators.compiled import gufunc, inlined, part, sincos_near_zero

_U = np.uint64
_LOW, _PARITY = _U(0xFFFFFFFF), _U(0x1BD11BDAA9FC1A22)


# --- words ------------------------------------------------------------------------------------------


@inlined
def _mixed(x: Any, y: Any, bits: Any) -> tuple[Any, Any]:
    x += y
    return x, ((y << _U(bits)) | (y >> _U(64 - bits))) ^ x


@inlined
def _mixed_four_times(x: Any, y: Any, a: int, b: int, c: int, d: int) -> tuple[Any, Any]:
    x, y = _mixed(x, y, a)
    x, y = _mixed(x, y, b)
    x, y = _mixed(x, y, c)
    return _mixed(x, y, d)


@inlined
def threefry(c0: Any, c1: Any, k0: Any, k1: Any) -> tuple[Any, Any]:
    """Two random words of a counter ``(c0, c1)`` under a key ``(k0, k1)``, all of 64 bits."""
    k2 = _PARITY ^ k0 ^ k1
    x, y = _mixed_four_times(c0 + k0, c1 + k1, 16, 42, 12, 31)
    x, y = _mixed_four_times(x + k1, y + k2 + _U(1), 16, 32, 24, 21)
    x, y = _mixed_four_times(x + k2, y + k0 + _U(2), 16, 42, 12, 31)
    return _mixed(x + k0, y + k1 + _U(3), 16)


@gufunc("void(uint64[:], uint64, uint64, uint64[:])", "(k),(),()->(k)")
def derived(key: np.ndarray, first: Any, second: Any, out: np.ndarray) -> None:
    """The words ``(2,)`` of a counter of two words under a key ``(2,)``: another key."""
    out[0], out[1] = threefry(first, second, key[0], key[1])


# --- numbers ----------------------------------------------------------------------------------------


@inlined
def _log_unit(m: Any) -> float:
    """``ln((m + 0.5) / 2^32)`` of a whole number below 2^32, without a branch, as fdlibm has it (Sun, 1993)."""
    bits = np.float64(np.float64(m) + 0.5).view(np.int64)
    exponent = (bits - np.int64(0x3FE6A09E667F3BCD)) >> np.int64(52)  # so that the rest lies within sqrt(2) of 1
    f = np.int64(bits - (exponent << np.int64(52))).view(np.float64) - 1.0
    s = f / (2.0 + f)
    z = s * s
    r = z * (
        6.666666666666735130e-01 + z * (3.999999999940941908e-01 + z * (2.857142874366239149e-01
        + z * (2.222219843214978396e-01 + z * (1.818357216161805012e-01 + z * (1.531383769920937332e-01
        + z * 1.479819860511658591e-01)))))
    )  # fmt: skip
    half, k = 0.5 * f * f, np.float64(exponent - np.int64(32))
    return k * 6.93147180369123816490e-01 - ((half - (s * (half + r) + k * 1.90821492927058770002e-10)) - f)


@inlined
def _sincos_of_turn(m: Any) -> tuple[float, float]:
    """Sine and cosine of ``(m + 0.5) / 2^32`` turns, without a branch."""
    quarter = (m + _U(0x20000000)) >> _U(30)
    x = (np.float64(np.int64(m) - np.int64(quarter << _U(30))) + 0.5) * 1.4629180792671596e-09  # 2 pi / 2^32
    sine, cosine = sincos_near_zero(x)
    odd = (quarter & _U(1)) != _U(0)
    s, c = cosine if odd else sine, sine if odd else cosine
    return (
        -s if (quarter & _U(2)) != _U(0) else s,
        -c if ((quarter + _U(1)) & _U(2)) != _U(0) else c,
    )


@inlined
def normal_pair(word: Any) -> tuple[float, float]:
    """Two independent standard normal numbers of a random word."""
    radius = np.sqrt(-2.0 * _log_unit(word >> _U(32)))
    sine, cosine = _sincos_of_turn(word & _LOW)
    return radius * cosine, radius * sine


@gufunc("void(uint64[:], uint64, uint64, float64[:], float64[:])", "(k),(),(),(m)->(m)")
def normals(key: np.ndarray, step: Any, use: Any, blank: np.ndarray, out: np.ndarray) -> None:
    """Standard normal numbers ``(m,)``, as many as ``blank`` has: four of a counter."""
    for i in range(0, len(out), 4):
        first, second = threefry(_U(i // 4), (step << _U(16)) | use, key[0], key[1])
        a, b = normal_pair(first)
        c, d = normal_pair(second)
        out[i] = a
        if i + 1 < len(out):
            out[i + 1] = b
        if i + 2 < len(out):
            out[i + 2] = c
        if i + 3 < len(out):
            out[i + 3] = d


@gufunc("void(uint64[:], uint64, uint64, float64[:], float64[:])", "(k),(),(),(m)->(m)")
def uniforms(key: np.ndarray, step: Any, use: Any, blank: np.ndarray, out: np.ndarray) -> None:
    """Numbers ``(m,)`` from 0 to below 1, as many as ``blank`` has: two of a counter."""
    for i in range(0, len(out), 2):
        first, second = threefry(_U(i // 2), (step << _U(16)) | use, key[0], key[1])
        out[i] = np.float64(first >> _U(11)) * 2.0**-53
        if i + 1 < len(out):
            out[i + 1] = np.float64(second >> _U(11)) * 2.0**-53


@gufunc("void(uint64[:], uint64, uint64, boolean[:], float64[:, :], float64[:, :])", "(k),(),(),(m),(N,m)->(N,m)")
def of_members(key: np.ndarray, step: Any, use: Any, wanted: np.ndarray, blank: np.ndarray, out: np.ndarray) -> None:
    """Standard normal numbers ``(N, m)`` of ``wanted`` components, as many as ``blank`` has: four members a counter."""
    four, counter = np.empty((4, (len(out) + 3) // 4)), (step << _U(16)) | use
    for i in range(out.shape[1]):
        if not wanted[i]:
            continue
        for j in range(four.shape[1]):  # side by side in vector instructions
            first, second = threefry(_U(j) | (_U(i) << _U(32)), counter, key[0], key[1])
            four[0, j], four[1, j] = normal_pair(first)
            four[2, j], four[3, j] = normal_pair(second)
        for j in range(len(out)):
            out[j, i] = four[j % 4, j // 4]


@part
def words_of_rows(keys: np.ndarray, kind: int, steps: np.ndarray, counter: int, use: int, out: np.ndarray) -> None:
    """Two random words ``(2, B)`` of a part of each row, for kernels: keys ``(B, parts, 2)``, steps ``(B,)``."""
    for row in range(len(steps)):
        of_step = (_U(steps[row]) << _U(16)) | _U(use)
        out[0, row], out[1, row] = threefry(_U(counter), of_step, keys[row, kind, 0], keys[row, kind, 1])


@part
def normals_of_rows(
    keys: np.ndarray, kind: int, steps: np.ndarray, count: int, words: np.ndarray, out: np.ndarray, at: int
) -> None:
    """So many standard normal numbers of a part of each row, to ``out (..., B)`` from ``at`` on; one more may follow.

    Rows stand side by side so that loops over them become vector instructions; ``words (2, B)`` is room for theirs.
    """
    for i in range(0, count, 2):
        if i % 4 == 0:
            words_of_rows(keys, kind, steps, i // 4, 0, words)
        for row in range(len(steps)):
            out[at + i, row], out[at + i + 1, row] = normal_pair(words[i % 4 // 2, row])
