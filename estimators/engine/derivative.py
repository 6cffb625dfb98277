"""Exact derivatives of traced functions in forward mode: a tangent beside each value.

Tangents are sparse: entries that are zero everywhere are left out. A value on which much depends,
such as an intermediate state of an integration, is a seed: later values have tangents by it. In the
end the chain rule turns these into tangents by the inputs (Griewank & Walther 2008, Evaluating
Derivatives, ch. 9). Loops that are not unrolled have no derivative. At a kink, such as `numpy.abs`
at 0 or `numpy.maximum` of equal numbers, the derivative is that of the branch taken. Derivatives of
whole numbers, rounding and lookups are zero.
"""

from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np

from estimators.engine.arrays import TracedArray, entries
from estimators.engine.matrices import by_entries, stored
from estimators.engine.program import Instruction, NotTraceable, Program
from estimators.engine.tracer import GIVE_MASKS, OF_WORDS, Tracer, operation, program_of, where

_FLAT = {"floor", "ceil", "trunc", "rint", "cast", "lookup"} | GIVE_MASKS | OF_WORDS
"""Opcodes whose results are piecewise constant in their operands."""


_PARTIALS: dict[str, Callable[..., tuple[Any, ...]]] = {
    "negative": lambda y, x: (-1.0,),
    "absolute": lambda y, x: (where(x < 0.0, -1.0, 1.0),),
    "sqrt": lambda y, x: (0.5 / y,),
    "sin": lambda y, x: (operation("cos", x),),
    "cos": lambda y, x: (-operation("sin", x),),
    "exp": lambda y, x: (y,),
    "log": lambda y, x: (1.0 / x,),
    "log1p": lambda y, x: (1.0 / (1.0 + x),),
    "arctan": lambda y, x: (1.0 / (1.0 + x * x),),
    "arcsin": lambda y, x: (1.0 / operation("sqrt", (1.0 - x) * (1.0 + x)),),
    "tanh": lambda y, x: (1.0 - y * y,),
    "add": lambda z, x, y: (1.0, 1.0),
    "subtract": lambda z, x, y: (1.0, -1.0),
    "multiply": lambda z, x, y: (y, x),
    "divide": lambda z, x, y: (1.0 / y, -(z * (1.0 / y))),
    "arctan2": lambda z, x, y: (y / (x * x + y * y), -(x / (x * x + y * y))),
    "hypot": lambda z, x, y: (x / z, y / z),
    "copysign": lambda z, x, y: (
        where((x < 0.0) ^ (operation("copysign", 1.0, y) < 0.0), -1.0, 1.0),
    ),
    "fmod": lambda z, x, y: (1.0, -operation("trunc", x / y)),
}
"""Partial derivatives of an opcode's result (first argument) by its operands; absent ones are 0."""


Tangent = dict[int, Any]
"""Derivatives by some of the seeds, by their index; the others are zero."""
_DENSE, _OFTEN = 2, 3
"""Values with more derivatives and uses than these are seeds."""


def jacobian(outputs: Any, inputs: Any) -> Any:
    """Derivatives ``(*m, *n)`` of a traced array ``(*m)`` by another ``(*n)`` in it.

    Raises:
        NotTraceable: if an instruction between them has no derivative.
    """
    seeds, values = TracedArray.of(inputs), TracedArray.of(outputs)
    program: Any = program_of(seeds.flat)
    found, tangents = entries(values, program), dict[int, Tangent]()
    for i, seed in enumerate(seeds.flat):
        tangents[seed.value] = {i: 1.0}
    live = program.live([x.value for x in found])
    uses = Counter(value for each in live for value in each.operands)
    inner = dict[int, Tangent]()
    for each in live:
        if each.result not in tangents and any(map(tangents.get, each.values)):
            tangent = _tangent(program, each, tangents)
            if len(tangent) > _DENSE and uses[each.result] > _OFTEN:
                seed = seeds.size + len(inner)
                inner[seed], tangent = tangent, {seed: 1.0}
            tangents[each.result] = tangent
    slopes = np.zeros((len(found), seeds.size)).astype(object)
    for row, output in zip(slopes, found, strict=True):
        for i, slope in _chained(tangents.get(output.value, {}), inner).items():
            row[i] = slope
    return slopes.reshape(values.shape + seeds.shape).view(TracedArray)


def _chained(tangent: Tangent, inner: dict[int, Tangent]) -> Tangent:
    """The tangent by the inputs alone, by the chain rule through the inner seeds."""
    total = dict(tangent)
    for seed in reversed(inner):  # each depends on earlier ones
        if (factor := total.pop(seed, None)) is not None:
            for earlier, slope in inner[seed].items():
                total[earlier] = _sum(total.get(earlier), factor, slope)
    return total


def _tangent(program: Program, instruction: Instruction, tangents: dict[int, Tangent]) -> Tangent:
    """The tangent of an instruction's result."""
    opcode = instruction.opcode
    if opcode in _FLAT:
        return {}
    operands = [Tracer(program, value) for value in instruction.operands if isinstance(value, int)]
    own = [tangents.get(x.value, {}) for x in operands]
    if opcode == "where":
        seeds = sorted({*own[1], *own[2]})
        return {
            seed: where(operands[0], own[1].get(seed, 0.0), own[2].get(seed, 0.0)) for seed in seeds
        }
    if opcode not in _PARTIALS:
        raise NotTraceable(f"a traced function's {opcode} has no derivative here")
    factors = _PARTIALS[opcode](Tracer(program, instruction.result), *operands)
    total: Tangent = {}
    for factor, tangent in zip(factors, own, strict=False):
        for seed, slope in tangent.items():
            total[seed] = _sum(total.get(seed), factor, slope)
    return total


def _sum(total: Any, factor: Any, slope: Any) -> Any:
    """``total + factor slope``, of which the total may be None for 0 and the factor is often -1."""
    if isinstance(factor, float) and factor == -1.0:
        return -slope if total is None else total - slope
    return factor * slope if total is None else total + factor * slope


def linearise(
    function: Callable[..., Any], x: Any, u: Any, slopes: Callable[..., Any] | None = None
) -> tuple[Any, Any]:
    """A function's value ``(k,)`` at a traced vector x ``(n,)``, and its Jacobian by x ``(k, n)``.

    Args:
        function: Function of vectors x and u, traced entry by entry
            (`estimators.engine.arrays.TracedArray`).
        x: Traced.
        u: Traced, constant or None.
        slopes: Jacobian as a function of x and u; None: derived by `jacobian`.

    Raises:
        NotTraceable: if an operation cannot be traced or has no derivative.
    """
    x, u, program = by_entries(x), by_entries(u), program_of(x.flat)
    own = [each.value for each in entries(x, program)]
    if len({*own} - program.constants.keys()) < len(own):
        # Derivatives are by values: entries that are constant or share one get their own.
        x = by_entries(stored(program, program.add("pack", tuple(own), "f", len(own)), x.shape))
    value: Any = TracedArray.of(function(x, u))
    value = value.reshape(value.shape or 1)  # a number is a vector, too
    return value, jacobian(value, x) if slopes is None else slopes(x, u)
