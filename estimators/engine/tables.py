"""Tables that are the same for all rows: entries at an index, and interpolation."""

from typing import Any

import numpy as np

from estimators.engine.arrays import FUNCTIONS, TracedArray, each_entry
from estimators.engine.tracer import Tracer, cast, operation, where


def _interpolated(x: Any, xp: Any, fp: Any) -> Any:
    """`numpy.interp` of constant tables, as NumPy computes it."""
    xp, fp = np.asarray(xp, float), np.asarray(fp, float)
    slopes = np.append(np.diff(fp) / np.diff(xp), 0.0)

    def one(x: Any) -> Any:
        index: Any = 0  # of the last entry that is at most x
        for bound in xp[1:]:
            index = cast(x >= float(bound), "i") + index
        value = lookup(slopes, index) * (x - lookup(xp, index)) + lookup(fp, index)
        value = where(
            x >= float(xp[-1]), float(fp[-1]), where(x < float(xp[0]), float(fp[0]), value)
        )
        return where(operation("isnan", x), x, value)

    return each_entry(one, x)


def lookup(table: Any, index: Any) -> Any:
    """Entry ``(...)`` or ``(..., m)`` of a table ``(k,)`` or ``(k, m)``; beyond, the nearest.

    Args:
        table: Numbers that are the same for all rows.
        index: Whole numbers, or floats, which are truncated; NaN is 0.
    """
    table = np.asarray(table, float)
    if isinstance(index, TracedArray):
        found = TracedArray.of([lookup(table, each) for each in index.flat])
        return found.reshape(index.shape + table.shape[1:])
    if not isinstance(index, Tracer):
        return table[np.clip(np.nan_to_num(index, nan=0.0), 0, len(table) - 1).astype(int)]
    program, width = index.program, table[0].size
    place, entry = program.table(table), index if index.kind == "f" else cast(index, "i")
    own = place, len(table), width
    values = [
        Tracer(program, program.add("lookup", (entry.value,), "f", None, (*own, column)))
        for column in range(width)
    ]
    return values[0] if table.ndim == 1 else TracedArray.of(values).reshape(table.shape[1:])


FUNCTIONS[np.interp] = _interpolated
