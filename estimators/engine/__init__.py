"""Equations as NumPy functions: traced once, derived exactly, compiled in a fraction of a second.

See docs/engine.md. `compiled` compiles a function of arrays ``(..., n)``. The other names are
functions that compiled code can use in addition to NumPy's. This package imports only
`estimators.checks`; filters, models and `vessel_gym` import it.
"""

from estimators.engine.compiled import Compiled, compiled, trace
from estimators.engine.derivative import jacobian
from estimators.engine.elementary import (
    as_float,
    as_integer,
    as_word,
    bits_float,
    float_bits,
    repeat,
    sincos,
    sincos_near_zero,
)
from estimators.engine.matrices import along
from estimators.engine.program import NotTraceable
from estimators.engine.tables import lookup

__all__ = [
    "Compiled",
    "NotTraceable",
    "along",
    "as_float",
    "as_integer",
    "as_word",
    "bits_float",
    "compiled",
    "float_bits",
    "jacobian",
    "lookup",
    "repeat",
    "sincos",
    "sincos_near_zero",
    "trace",
]
