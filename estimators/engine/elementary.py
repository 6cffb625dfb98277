"""Elementary functions of sums, products, quotients and roots: equal bits on every machine.

They are plain NumPy functions of arrays, without a branch, and within 2 units in the last place of
the exact value, tangents within 4. The polynomials and reductions are those of fdlibm (Sun
Microsystems, 1993); sine and cosine take off quarters of a turn in three parts (Cody & Waite, 1980)
and are accurate for angles up to 1e6 rad.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from estimators.engine.arrays import TracedArray, each_entry
from estimators.engine.program import KINDS
from estimators.engine.tracer import Tracer, cast, operation, where

_LN2_HIGH, _LN2_LOW, _PER_LN2 = (
    6.93147180369123816490e-01,
    1.90821492927058770002e-10,
    1.44269504088896338700,
)
_INTEGER = 6755399441055744.0  # 1.5 * 2^52: adding it leaves a whole number in the low bits
_PI_LOW = 1.2246467991473531772e-16
_HALF_PI_LOW, _QUARTER_PI = 0.5 * _PI_LOW, 0.25 * np.pi


def _of_arrays(function: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """A conversion of tracers, of arrays of tracers entry by entry, and of NumPy's numbers."""

    def convert(x: Any) -> Any:
        return each_entry(function, x) if isinstance(x, TracedArray) else function(x)

    return convert


def _viewed(x: Any, kind: str, other: str) -> Any:
    """The bits of a number of a kind as another kind."""
    x = cast(x, kind)
    if isinstance(x, Tracer):
        return Tracer(x.program, x.program.add("bits", (x.value,), other))
    return x.view(KINDS[other])


float_bits = _of_arrays(lambda x: _viewed(x, "f", "u"))
"""The 64 bits of a float as a word."""
bits_float = _of_arrays(lambda x: _viewed(x, "u", "f"))
"""The float of 64 bits."""
as_float = _of_arrays(lambda x: cast(x, "f"))
"""Whole numbers, words or masks as floats."""
as_word = _of_arrays(lambda x: cast(x, "u"))
"""Whole numbers as words of 64 bits, modulo 2^64; floats are truncated."""
as_integer = _of_arrays(lambda x: cast(x, "i"))
"""Words as whole numbers of 64 bits with a sign; floats are truncated."""


def _polynomial(z: Any, *coefficients: float) -> Any:
    """``c0 + z (c1 + z (c2 + ...))``."""
    *others, total = coefficients
    for c in reversed(others):
        total = c + z * total
    return total


def _power_of_two(k: Any) -> Any:
    """``2^k`` of a whole number in [-1022, 1023], as a float."""
    return bits_float((float_bits(k + _INTEGER) + np.uint64(1023)) << np.uint64(52))


def _scaled(y: Any, k: Any) -> Any:
    """``y 2^k``, in two steps that overflow only if the result does."""
    half = operation("floor", 0.5 * k)
    return y * _power_of_two(half) * _power_of_two(k - half)


def sincos_near_zero(x: Any) -> tuple[Any, Any]:
    """Sine and cosine of an angle within an eighth of a turn of 0."""
    z = x * x
    sine = x + x * z * _polynomial(
        z, -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04,
        2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10,
    )  # fmt: skip
    cosine = 1.0 - 0.5 * z + z * z * _polynomial(
        z, 4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05,
        -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11,
    )  # fmt: skip
    return sine, cosine


def _sincos(angle: Any) -> tuple[Any, Any]:
    """Sine and cosine."""
    rounded = angle * 0.6366197723675814 + _INTEGER
    quarters, bits = rounded - _INTEGER, float_bits(rounded)
    x = (
        angle
        - quarters * 1.5707963267341256
        - quarters * 6.077100506303966e-11
        - quarters * 2.0222662487959506e-21
    )
    x = where(
        x > 0.786, 0.786, where(x < -0.786, -0.786, x)
    )  # angles without an accurate digit stay bounded
    sine, cosine = sincos_near_zero(x)
    odd = (bits & np.uint64(1)) == np.uint64(1)
    s, c = where(odd, cosine, sine), where(odd, sine, cosine)
    return _negated(s, bits), _negated(c, bits + np.uint64(1))


def _negated(x: Any, bits: Any) -> Any:
    """The number with its sign changed where the second lowest of some bits is set."""
    return bits_float(float_bits(x) ^ ((bits & np.uint64(2)) << np.uint64(62)))


def _exp(x: Any) -> Any:
    x = where(x > 800.0, 800.0, where(x < -800.0, -800.0, x))
    k = operation("rint", x * _PER_LN2)
    high, low = x - k * _LN2_HIGH, k * _LN2_LOW
    r = high - low
    z = r * r
    c = r - z * _polynomial(
        z, 1.66666666666666019037e-01, -2.77777777770155933842e-03, 6.61375632143793436117e-05,
        -1.65339022054652515390e-06, 4.13813679705723846039e-08,
    )  # fmt: skip
    return _scaled(1.0 - ((low - (r * c) / (2.0 - c)) - high), k)


def log_scaled(f: Any, k: Any) -> Any:
    """``ln((1 + f) 2^k)`` for 1 + f within a factor of sqrt(2) of 1."""
    s = f / (2.0 + f)
    z = s * s
    r = z * _polynomial(
        z, 6.666666666666735130e-01, 3.999999999940941908e-01, 2.857142874366239149e-01,
        2.222219843214978396e-01, 1.818357216161805012e-01, 1.531383769920937332e-01,
        1.479819860510658591e-01,
    )  # fmt: skip
    half = 0.5 * f * f
    return k * _LN2_HIGH - ((half - (s * (half + r) + k * _LN2_LOW)) - f)


def _log(x: Any) -> Any:
    small = x < 2.2250738585072014e-308
    bits = as_integer(float_bits(where(small, x * 18014398509481984.0, x)))  # 2^54
    exponent = (bits - 0x3FE6A09E667F3BCD) >> 52  # so that the rest lies within sqrt(2) of 1
    f = bits_float(as_word(bits - (exponent << 52))) - 1.0
    k = as_float(exponent) - where(small, 54.0, 0.0)
    value = log_scaled(f, k)
    special = where(x == 0.0, -np.inf, where(x == np.inf, np.inf, np.nan))
    return where((x > 0.0) & (x < np.inf), value, special)


def _log1p(x: Any) -> Any:
    u = 1.0 + x
    missing = where(u > 2.0, 1.0 - (u - x), x - (u - 1.0))
    log = _log(u)
    log = where((x > -1.0) & (x < np.inf), log + missing / where(u == 0.0, 1.0, u), log)
    return where(x == 0.0, x, log)


def _arctan(x: Any) -> Any:
    a = operation("absolute", x)

    def chosen(*values: Any) -> Any:
        result = values[-1]
        for bound, value in zip((2.4375, 1.1875, 0.6875, 0.4375), values[-2::-1], strict=True):
            result = where(a < bound, value, result)
        return result

    over = chosen(a, 2.0 * a - 1.0, a - 1.0, a - 1.5, -1.0)
    under = chosen(1.0, 2.0 + a, 1.0 + a, 1.0 + 1.5 * a, a)
    high = chosen(
        0.0, 4.63647609000806093515e-01, 7.85398163397448278999e-01, 9.82793723247329054082e-01,
        1.57079632679489655800,
    )  # fmt: skip
    low = chosen(
        0.0, 2.26987774529616870924e-17, 3.06161699786838301793e-17, 1.39033110312309984516e-17,
        6.12323399573676603587e-17,
    )  # fmt: skip
    t = over / under
    z = t * t
    series = z * _polynomial(
        z, 3.33333333333329318027e-01, -1.99999999998764832476e-01, 1.42857142725034663711e-01,
        -1.11111104054623557880e-01, 9.09088713343650656196e-02, -7.69187620504482999495e-02,
        6.66107313738753120669e-02, -5.83357013379057348645e-02, 4.97687799461593236017e-02,
        -3.65315727442169155270e-02, 1.62858201153657823623e-02,
    )  # fmt: skip
    return operation("copysign", high - ((t * series - low) - t), x)


def _arctan2(y: Any, x: Any) -> Any:
    over, under = operation("absolute", y), operation("absolute", x)
    alike = (over == under) & ((over == 0.0) | (over == np.inf))
    ratio = where(alike, where(over == 0.0, 0.0, 1.0), over / where(alike, 1.0, under))
    angle = _arctan(ratio)
    astern = operation("copysign", 1.0, x) < 0.0
    return operation("copysign", where(astern, np.pi - (angle - _PI_LOW), angle), y)


def _arcsine_series(z: Any) -> Any:
    """``arcsin(x) / x - 1`` for ``z = x^2`` up to 1/4."""
    over = z * _polynomial(
        z, 1.66666666666666657415e-01, -3.25565818622400915405e-01, 2.01212532134862925881e-01,
        -4.00555345006794114027e-02, 7.91534994289814532176e-04, 3.47933107596021167570e-05,
    )  # fmt: skip
    return over / _polynomial(
        z, 1.0, -2.40339491173441421878e00, 2.02094576023350569471e00, -6.88283971605453293030e-01,
        7.70381505559019352791e-02,
    )  # fmt: skip


def _arcsin(x: Any) -> Any:
    a = operation("absolute", x)
    small = a < 0.5
    z = where(small, x * x, 0.5 * (1.0 - a))
    root, series = operation("sqrt", z), _arcsine_series(z)
    high = bits_float(float_bits(root) & np.uint64(0xFFFFFFFF00000000))  # half of its digits
    low = (z - high * high) / where(root == 0.0, 1.0, root + high)
    beyond = 2.0 * root * series - (_HALF_PI_LOW - 2.0 * low)
    beyond = _QUARTER_PI - (beyond - (_QUARTER_PI - 2.0 * high))
    return where(small, x + x * series, operation("copysign", beyond, x))


def _hypot(x: Any, y: Any) -> Any:
    a, b = operation("absolute", x), operation("absolute", y)
    large, small = where(a > b, a, b), where(a > b, b, a)
    ratio = small / where(large == 0.0, 1.0, large)
    return where(
        (a == np.inf) | (b == np.inf), np.inf, large * operation("sqrt", 1.0 + ratio * ratio)
    )


def _tanh(x: Any) -> Any:
    size = operation("absolute", x)
    twice = 2.0 * where(size > 22.0, 22.0, size)
    power = _exp(twice)
    rise = where(power == 1.0, twice, (power - 1.0) * (twice / _log(power)))  # exp(2 x) - 1
    return operation("copysign", rise / (rise + 2.0), x)


EXPANSIONS: dict[str, Callable[..., Any]] = {
    "sincos": _sincos, "exp": _exp, "log": _log, "log1p": _log1p, "arctan": _arctan,
    "arctan2": _arctan2, "arcsin": _arcsin, "hypot": _hypot, "tanh": _tanh,
}  # fmt: skip
"""Formulas of functions, by their opcodes."""


def sincos(angle: Any) -> tuple[Any, Any]:
    """Sine and cosine of angles ``(...)``."""
    if isinstance(angle, Tracer | TracedArray):
        return np.sin(angle), np.cos(angle)
    with np.errstate(all="ignore"):
        return _sincos(np.asarray(angle, float)[()])
