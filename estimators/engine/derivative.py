"""Exact derivatives of traced functions in forward mode: the tangent of each instruction beside its value.

Tangents are sparse: one that is zero everywhere is not there. At a kink (`numpy.where`,
`numpy.abs`, `numpy.maximum`) the derivative is that of the side on which the value is; whole
numbers, rounding and lookups have none.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from estimators.engine.arrays import TracedArray, entries
from estimators.engine.program import Instruction, Loop, Program
from estimators.engine.tracer import NotTraceable, Tracer, constant, operation, where

_FLAT = frozenset((
    "floor", "ceil", "trunc", "rint", "greater", "greater equal", "equal", "not equal", "isfinite", "isnan", "cast",
    "lookup", "lookup matrix", "and", "or", "xor", "not", "left shift", "right shift", "whole remainder",
))  # fmt: skip
"""Opcodes whose results do not change with their operands, but for jumps."""


def _of_arcsine(x: Tracer, y: Tracer) -> Any:
    return 1.0 / operation("sqrt", (1.0 - x) * (1.0 + x))


_SLOPES: dict[str, Callable[[Tracer, Tracer], Any]] = {
    "negative": lambda x, y: -1.0,
    "absolute": lambda x, y: where(x < 0.0, -1.0, 1.0),
    "sqrt": lambda x, y: 0.5 / y,
    "sin": lambda x, y: operation("cos", x),
    "cos": lambda x, y: -operation("sin", x),
    "tan": lambda x, y: 1.0 + y * y,
    "exp": lambda x, y: y,
    "expm1": lambda x, y: y + 1.0,
    "log": lambda x, y: 1.0 / x,
    "log1p": lambda x, y: 1.0 / (1.0 + x),
    "arctan": lambda x, y: 1.0 / (1.0 + x * x),
    "arcsin": _of_arcsine,
    "arccos": lambda x, y: -_of_arcsine(x, y),
    "tanh": lambda x, y: 1.0 - y * y,
}
"""dy/dx of functions ``y`` of one number ``x``."""


def _over_square(x: Tracer, y: Tracer) -> tuple[Any, Any]:
    square = x * x + y * y
    return y / square, -(x / square)


_PARTIALS: dict[str, Callable[[Tracer, Tracer, Tracer], tuple[Any, Any]]] = {
    "add": lambda x, y, z: (1.0, 1.0),
    "subtract": lambda x, y, z: (1.0, -1.0),
    "multiply": lambda x, y, z: (y, x),
    "divide": lambda x, y, z: (1.0 / y, -(z / y)),
    "arctan2": lambda x, y, z: _over_square(x, y),
    "hypot": lambda x, y, z: (x / z, y / z),
    "maximum": lambda x, y, z: (_one(x > y), _one(~(x > y))),
    "minimum": lambda x, y, z: (_one(x < y), _one(~(x < y))),
    "copysign": lambda x, y, z: (
        where((x < 0.0) ^ (operation("copysign", 1.0, y) < 0.0), -1.0, 1.0),
        0.0,
    ),
    "fmod": lambda x, y, z: (1.0, -operation("trunc", x / y)),
}
"""dz/dx and dz/dy of functions ``z`` of two numbers."""


def _one(mask: Tracer) -> Any:
    return where(mask, 1.0, 0.0)


Tangent = dict[int, Any]
"""Derivatives to some of the seeds, by their place; the others are zero."""


def tangents(outputs: Sequence[Tracer], seeds: Sequence[Tracer]) -> list[Tangent]:
    """Derivatives of scalars to other scalars, of which they were computed.

    Raises:
        NotTraceable: if an instruction between them has no derivative.
    """
    if not outputs:
        return []
    program = outputs[0].program
    known: dict[int, Tangent] = {seed.value: {i: 1.0} for i, seed in enumerate(seeds)}
    for instruction in program.live([each.value for each in outputs]):
        _extend(program, instruction, known)
    return [known.get(output.value, {}) for output in outputs]


def jacobian(outputs: Any, inputs: Any) -> TracedArray:
    """Derivatives ``(*m, *n)`` of a traced array ``(*m)`` to another ``(*n)``, of which it was computed."""
    program = TracedArray.of(inputs).flat[0].program
    found = tangents(entries(outputs, program), list(TracedArray.of(inputs).flat))
    rows = [[tangent.get(seed, 0.0) for seed in range(np.size(inputs))] for tangent in found]
    return TracedArray.of(rows).reshape(np.shape(outputs) + np.shape(inputs))


def _extend(program: Program, instruction: Instruction, known: dict[int, Tangent]) -> None:
    """Put an instruction's tangent beside those that are known."""
    if instruction.result in known or not any(known.get(value) for value in instruction.values):
        return
    if instruction.opcode == "repeat":
        known.update(zip(instruction.results, _repeated(program, instruction, known), strict=True))
    else:
        known[instruction.result] = _tangent(program, instruction, known)


def _repeated(
    program: Program, instruction: Instruction, known: dict[int, Tangent]
) -> list[Tangent]:
    """Tangents of what a loop gives: the loop once more, with the tangents of what it carries."""
    loop: Loop = instruction.attributes[0]
    initial: Any = instruction.operands
    carried = [
        (i, seed)
        for i, seeds in enumerate(_reached(program, instruction, known))
        for seed in sorted(seeds)
    ]

    def body(*parameters: int) -> list[int]:
        count = len(loop.parameters)
        inside = dict(known)
        for (i, seed), value in zip(carried, parameters[count:], strict=True):
            inside.setdefault(parameters[i], {})[seed] = Tracer(program, value)
        renamed = dict(zip(loop.parameters, parameters[:count], strict=True))
        for each in loop.body:
            copied = program.copy(each, renamed)
            _extend(program, copied, inside)
        after = [renamed.get(value, value) for value in loop.after]
        slopes = [inside.get(after[i], {}).get(seed, 0.0) for i, seed in carried]
        return [*after, *(constant(program, slope).value for slope in slopes)]

    tangents = [
        constant(program, known.get(initial[i], {}).get(seed, 0.0)).value for i, seed in carried
    ]
    results = program.repeat(loop.count, body, [*initial, *tangents], loop.masks)
    found: list[Tangent] = [{} for _ in loop.parameters]
    for (i, seed), value in zip(carried, results[len(initial) :], strict=True):
        found[i][seed] = Tracer(program, value)
    return found


def _reached(
    program: Program, instruction: Instruction, known: dict[int, Tangent]
) -> list[set[int]]:
    """The seeds on which each number that a loop carries depends, after any pass."""
    loop: Loop = instruction.attributes[0]
    operands: Any = instruction.operands
    seeds = [set(known.get(value, {})) for value in operands]
    while True:
        reached = {value: set(tangent) for value, tangent in known.items()}
        reached.update(zip(loop.parameters, seeds, strict=True))
        for each in loop.body:
            found = set().union(*(reached.get(value, set()) for value in each.values))
            reached.update(dict.fromkeys(each.results, set() if each.opcode in _FLAT else found))
        after = [seeds[i] | reached.get(value, set()) for i, value in enumerate(loop.after)]
        after = [
            each if program.kinds[value] == "f" else set()
            for each, value in zip(after, loop.after, strict=True)
        ]
        if after == seeds:
            return seeds
        seeds = after


def _tangent(program: Program, instruction: Instruction, known: dict[int, Tangent]) -> Tangent:
    """The tangent of an instruction's result."""
    opcode = instruction.opcode
    if opcode in _FLAT:
        return {}
    if opcode not in _SLOPES and opcode not in _PARTIALS and opcode != "where":
        raise NotTraceable(f"a traced function's {opcode} has no derivative here")
    operands = [Tracer(program, value) for value in instruction.operands if isinstance(value, int)]
    own = [known.get(x.value, {}) for x in operands]
    result = Tracer(program, instruction.result)
    if opcode == "where":
        seeds = sorted({*own[1], *own[2]})
        return {
            seed: where(operands[0], own[1].get(seed, 0.0), own[2].get(seed, 0.0)) for seed in seeds
        }
    if opcode in _SLOPES:
        return _combined([(_SLOPES[opcode](operands[0], result), own[0])])
    pairs = zip(_PARTIALS[opcode](operands[0], operands[1], result), own, strict=True)
    return _combined([pair for pair in pairs if pair[1]])


def _combined(terms: Sequence[tuple[Any, Tangent]]) -> Tangent:
    """A sum of tangents, each times a factor."""
    total: Tangent = {}
    for factor, tangent in terms:
        for seed, slope in tangent.items():
            term = _times(factor, slope)
            if not isinstance(term, float) or term != 0.0:
                total[seed] = total[seed] + term if seed in total else term
    return total


def _times(factor: Any, slope: Any) -> Any:
    """A product in which ones, and zeros that are so everywhere, cost nothing."""
    for one, other in ((factor, slope), (slope, factor)):
        if isinstance(one, float) and one == 0.0:
            return 0.0
        if isinstance(one, float) and one == 1.0:
            return other
        if isinstance(one, float) and one == -1.0:
            return -other
    return factor * slope


def linearise(
    function: Callable[..., Any], x: Any, *others: Any, slopes: Callable[..., Any] | None = None
) -> tuple[Any, Any]:
    """A function's value ``(k,)`` at a traced vector x ``(n,)``, and its Jacobian by x ``(k, n)``.

    Args:
        function: Of x and ``others``, vectors, entry by entry
            (`estimators.engine.arrays.TracedArray`).
        x: Traced.
        others: Traced, constant or None.
        slopes: Its Jacobian, a function of the same; None: tangents give it.

    Raises:
        NotTraceable: if it does what cannot be traced, or what has no derivative.
    """
    own = x if isinstance(x, TracedArray) else x.scalars()
    rest = [each.scalars() if hasattr(each, "scalars") else each for each in others]
    value = function(own, *rest)
    return value, jacobian(value, own) if slopes is None else slopes(own, *rest)
