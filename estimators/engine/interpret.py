"""A program's instructions one after the other in NumPy, for all rows at once: slow, and without a compiler."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from estimators.engine.elementary import EXPANSIONS, bits_float, float_bits
from estimators.engine.function import Function
from estimators.engine.program import Instruction, Program
from estimators.engine.tracer import _EXACT, KINDS

_ROUNDED = frozenset(("add", "subtract", "multiply", "divide", "sqrt", *EXPANSIONS))
Rows = dict[int, Any]


def interpret(
    function: Function, arrays: Sequence[np.ndarray], axes: Sequence[int], noise: float = 0.0,
    rng: np.random.Generator | None = None,
) -> list[np.ndarray]:  # fmt: skip
    """A program of scalars, of arrays in C order: to the bit what it gives compiled.

    Args:
        function: Without matrices.
        arrays: Its arguments, which have one batch or none.
        axes: How many last axes of each are a row's.
        noise: How far each rounded result is at most off, as a part of it: for sensitivity to rounding.
        rng: Draws the noise.
    """
    batch = np.broadcast_shapes(*(a.shape[: a.ndim - k] for a, k in zip(arrays, axes, strict=True)))
    columns = [
        np.broadcast_to(a, batch + a.shape[a.ndim - k :]).reshape((*batch, -1))
        for a, k in zip(arrays, axes, strict=True)
    ]
    program = function.program
    values: Rows = {value: KINDS[program.kinds[value]].type(found) for value, found in program.constants.items()}

    def perturbed(result: Any) -> Any:
        return result if rng is None else result * (1.0 + noise * rng.uniform(-1.0, 1.0, np.shape(result)))

    def run(instructions: Sequence[Instruction]) -> None:
        for each in instructions:
            if each.opcode == "input":
                values[each.result] = columns[each.attributes[0]][..., each.attributes[1]]
            elif each.opcode == "repeat":
                loop = each.attributes[0]
                carried = [values[value] for value in each.operands]  # type: ignore[index]
                for _ in range(loop.count):
                    values.update(zip(loop.parameters, carried, strict=True))
                    run(loop.body)
                    carried = [values[value] for value in loop.after]
                values.update(zip(loop.results, carried, strict=True))
            else:
                result = _result(program, each, [values[value] for value in each.operands])  # type: ignore[index]
                rounded = noise and each.opcode in _ROUNDED and program.kinds[each.result] == "f"
                values[each.result] = perturbed(result) if rounded else result

    with np.errstate(all="ignore"):
        run(function.instructions)
    return [
        np.stack([np.broadcast_to(values[part], batch).astype(KINDS[row.kind]) for part in parts], -1).reshape(
            batch + row.shape) if parts else np.empty(batch + row.shape, KINDS[row.kind])
        for parts, row in zip(function.outputs, function.results, strict=True)
    ]  # fmt: skip


def _result(program: Program, instruction: Instruction, operands: list[Any]) -> Any:
    """One instruction of scalars."""
    opcode, kind = instruction.opcode, program.kinds[instruction.result]
    if opcode in EXPANSIONS:
        return EXPANSIONS[opcode][1](*operands)
    if opcode in _EXACT:
        return _EXACT[opcode](*operands)
    if opcode == "where":
        return np.where(*operands)
    if opcode == "bits":
        return float_bits(operands[0])
    if opcode == "from bits":
        return bits_float(operands[0])
    if opcode == "whole remainder":
        return np.remainder(*operands)
    if opcode == "cast":
        x = operands[0]
        if np.asarray(x).dtype.kind == "f":
            x = np.where(x > -9.2e18, np.where(x < 9.2e18, x, 9.2e18), -9.2e18).astype(np.int64)
        return np.asarray(x).astype(KINDS[kind])
    assert opcode == "lookup", opcode
    place, count, width, column = instruction.attributes
    index = operands[0]
    if np.asarray(index).dtype.kind == "f":
        index = np.where(index > 0.0, np.where(index < count - 1.0, index, count - 1.0), 0.0)
    entry = np.clip(np.asarray(index).astype(np.int64), 0, count - 1)
    return program.tables[place][entry * width + column]
