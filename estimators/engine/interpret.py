"""A program's instructions one after the other in NumPy, for all rows at once: slow, and without a compiler."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from estimators.engine.elementary import EXPANSIONS, bits_float, float_bits
from estimators.engine.function import Function
from estimators.engine.program import Instruction
from estimators.engine.tracer import _EXACT, KINDS

_ROUNDED = frozenset(("add", "subtract", "multiply", "divide", "sqrt", *EXPANSIONS))
_COMPUTED: dict[str, Any] = {name: function for name, (_, function) in EXPANSIONS.items()} | _EXACT
_COMPUTED |= {"where": np.where, "bits": float_bits, "from bits": bits_float}


def interpret(
    function: Function, arrays: Sequence[np.ndarray], noise: float, rng: np.random.Generator
) -> list[np.ndarray]:
    """A program of scalars, of arrays in C order: without noise to the bit what it gives compiled.

    Args:
        function: Without matrices.
        arrays: Its arguments, which have one batch or none.
        noise: How far each rounded result is at most off, as a part of it: for sensitivity to
            rounding.
        rng: Draws the noise.
    """
    leading = [
        a.shape[: a.ndim - len(own.shape)]
        for a, own in zip(arrays, function.arguments, strict=True)
    ]
    batch = np.broadcast_shapes(*leading)
    columns = [a.reshape((*own, -1)) for a, own in zip(arrays, leading, strict=True)]
    program = function.program
    values: dict[int, Any] = {
        value: KINDS[program.kinds[value]].type(x) for value, x in program.constants.items()
    }

    def run(instructions: Sequence[Instruction]) -> None:
        for each in instructions:
            if each.opcode == "input":
                values[each.result] = columns[each.attributes[0]][..., each.attributes[1]]
                continue
            operands: Any = [values[value] for value in each.operands]  # type: ignore[index]
            if each.opcode == "repeat":
                loop = each.attributes[0]
                for _ in range(loop.count):
                    if loop.masks and not np.any(operands[: loop.masks]):
                        break
                    values.update(zip(loop.parameters, operands, strict=True))
                    run(loop.body)
                    operands = [values[value] for value in loop.after]
                values.update(zip(loop.results, operands, strict=True))
            elif each.opcode == "cast":
                x = np.asarray(operands[0])
                x = (
                    np.fmin(np.fmax(x, -9.2e18), 9.2e18).astype(np.int64)
                    if x.dtype.kind == "f"
                    else x
                )
                values[each.result] = x.astype(KINDS[program.kinds[each.result]])
            elif each.opcode == "lookup":
                place, count, width, column = each.attributes
                entry = np.fmin(np.fmax(operands[0], 0), count - 1).astype(np.int64)
                values[each.result] = program.tables[place][entry * width + column]
            else:
                values[each.result] = result = _COMPUTED[each.opcode](*operands)
                if noise and each.opcode in _ROUNDED and program.kinds[each.result] == "f":
                    values[each.result] = result * (
                        1.0 + noise * rng.uniform(-1.0, 1.0, np.shape(result))
                    )

    with np.errstate(all="ignore"):
        run(function.instructions)
    found = []
    for parts, row in zip(function.outputs, function.results, strict=True):
        found.append(np.empty((*batch, len(parts)), KINDS[row.kind]))
        for column, part in enumerate(parts):
            found[-1][..., column] = values[part]
    return [
        each.reshape(batch + row.shape) for each, row in zip(found, function.results, strict=True)
    ]
