"""Exact derivatives of traced functions in forward mode: a tangent beside each value.

Tangents are sparse: entries that are zero everywhere are left out. Loops that are not unrolled
have no derivative. At a kink (`numpy.where`, `numpy.abs`, `numpy.maximum`) the derivative belongs
to the side on which the value is. Derivatives of whole numbers, rounding and lookups are zero.
"""

from collections.abc import Callable, Sequence
from typing import Any

from estimators.engine.arrays import TracedArray, entries
from estimators.engine.program import Instruction, NotTraceable, Program
from estimators.engine.tracer import Tracer, operation, where

_FLAT = frozenset((
    "floor", "ceil", "trunc", "rint", "greater", "greater_equal", "equal", "not_equal", "isfinite", "isnan", "cast",
    "lookup", "bitwise_and", "bitwise_or", "bitwise_xor", "invert", "left_shift", "right_shift",
    "remainder",
))  # fmt: skip
"""Opcodes whose results do not change with their operands, but for jumps."""


_PARTIALS: dict[str, Callable[..., tuple[Any, ...]]] = {
    "negative": lambda y, x: (-1.0,),
    "absolute": lambda y, x: (where(x < 0.0, -1.0, 1.0),),
    "sqrt": lambda y, x: (0.5 / y,),
    "sin": lambda y, x: (operation("cos", x),),
    "cos": lambda y, x: (-operation("sin", x),),
    "tan": lambda y, x: (1.0 + y * y,),
    "exp": lambda y, x: (y,),
    "expm1": lambda y, x: (y + 1.0,),
    "log": lambda y, x: (1.0 / x,),
    "log1p": lambda y, x: (1.0 / (1.0 + x),),
    "arctan": lambda y, x: (1.0 / (1.0 + x * x),),
    "arcsin": lambda y, x: (1.0 / operation("sqrt", (1.0 - x) * (1.0 + x)),),
    "arccos": lambda y, x: (-(1.0 / operation("sqrt", (1.0 - x) * (1.0 + x))),),
    "tanh": lambda y, x: (1.0 - y * y,),
    "add": lambda z, x, y: (1.0, 1.0),
    "subtract": lambda z, x, y: (1.0, -1.0),
    "multiply": lambda z, x, y: (y, x),
    "divide": lambda z, x, y: (1.0 / y, -(z / y)),
    "arctan2": lambda z, x, y: (y / (x * x + y * y), -(x / (x * x + y * y))),
    "hypot": lambda z, x, y: (x / z, y / z),
    "maximum": lambda z, x, y: (where(x > y, 1.0, 0.0), where(x > y, 0.0, 1.0)),
    "minimum": lambda z, x, y: (where(x < y, 1.0, 0.0), where(x < y, 0.0, 1.0)),
    "copysign": lambda z, x, y: (
        where((x < 0.0) ^ (operation("copysign", 1.0, y) < 0.0), -1.0, 1.0),
        0.0,
    ),
    "fmod": lambda z, x, y: (1.0, -operation("trunc", x / y)),
}
"""Partial derivatives of a result, which comes first, to its operands."""


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
        if (
            any(known.get(value) for value in instruction.values)
            and instruction.result not in known
        ):
            known[instruction.result] = _tangent(program, instruction, known)
    return [known.get(output.value, {}) for output in outputs]


def jacobian(outputs: Any, inputs: Any) -> TracedArray:
    """Derivatives ``(*m, *n)`` of a traced array ``(*m)`` by another ``(*n)`` in it."""
    seeds, values = TracedArray.of(inputs), TracedArray.of(outputs)
    found = tangents(entries(values, seeds.flat[0].program), list(seeds.flat))
    rows = [[tangent.get(seed, 0.0) for seed in range(seeds.size)] for tangent in found]
    return TracedArray.of(rows).reshape(values.shape + seeds.shape)  # type: ignore[return-value]


def _tangent(program: Program, instruction: Instruction, known: dict[int, Tangent]) -> Tangent:
    """The tangent of an instruction's result."""
    opcode = instruction.opcode
    if opcode in _FLAT:
        return {}
    operands = [Tracer(program, value) for value in instruction.operands if isinstance(value, int)]
    own = [known.get(x.value, {}) for x in operands]
    if opcode == "where":
        seeds = sorted({*own[1], *own[2]})
        return {
            seed: where(operands[0], own[1].get(seed, 0.0), own[2].get(seed, 0.0)) for seed in seeds
        }
    if opcode not in _PARTIALS:
        raise NotTraceable(f"a traced function's {opcode} has no derivative here")
    factors = _PARTIALS[opcode](Tracer(program, instruction.result), *operands)
    total: Tangent = {}
    for factor, tangent in zip(factors, own, strict=True):
        for seed, slope in tangent.items():
            term = _times(factor, slope)
            if not isinstance(term, float) or term != 0.0:
                total[seed] = total[seed] + term if seed in total else term
    return total


def _times(factor: Any, slope: Any) -> Any:
    """A product; zeros that are so everywhere cost nothing."""
    if any(isinstance(each, float) and each == 0.0 for each in (factor, slope)):
        return 0.0
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
