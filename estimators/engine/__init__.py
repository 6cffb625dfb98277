"""Equations as NumPy functions: traced once, derived exactly, compiled in a fraction of a second.

See docs/engine.md. `compiled` compiles a function of arrays ``(..., n)``, which can use `along`,
`lookup`, `sincos` and others in addition to NumPy's functions; `trace` makes programs of filters
and of whole steps. This package imports no other module of `estimators`. Other code imports
the names below, from here, and nothing from its modules.
"""

from estimators.engine import linear
from estimators.engine.arrays import TracedArray, lookup
from estimators.engine.compiled import Compiled, SideBySide, compiled, trace
from estimators.engine.derivative import jacobian, linearise
from estimators.engine.elementary import (
    as_float,
    as_integer,
    as_word,
    bits_float,
    float_bits,
    log_scaled,
    sincos,
    sincos_near_zero,
)
from estimators.engine.function import Argument, Function
from estimators.engine.matching import invoker
from estimators.engine.matrices import (
    TracedMatrix,
    along,
    by_entries,
    columnwise,
    is_traced,
    matrix,
)
from estimators.engine.program import NotTraceable

__all__ = [
    "Argument",
    "Compiled",
    "Function",
    "NotTraceable",
    "SideBySide",
    "TracedArray",
    "TracedMatrix",
    "along",
    "as_float",
    "as_integer",
    "as_word",
    "bits_float",
    "by_entries",
    "columnwise",
    "compiled",
    "float_bits",
    "invoker",
    "is_traced",
    "jacobian",
    "linear",
    "linearise",
    "log_scaled",
    "lookup",
    "matrix",
    "sincos",
    "sincos_near_zero",
    "trace",
]
