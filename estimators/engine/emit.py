"""Programs as LLVM IR: scalars straight-line, rows of the batch as lanes of vectors.

The operations and their order are those of the program at any width, without contraction or fast-math flags: a row has
the same bits alone, in any batch and on any processor.
"""

import itertools
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import reduce
from typing import Any

import numpy as np

from estimators.engine.elementary import EXPANSIONS
from estimators.engine.program import Instruction, Loop, Program
from estimators.engine.tracer import Tracer

_OPERATIONS = {
    "add": ("fadd", "add", "add"), "subtract": ("fsub", "sub", "sub"), "multiply": ("fmul", "mul", "mul"),
    "divide": ("fdiv",), "fmod": ("frem",), "and": ("", "and", "and", "and"), "or": ("", "or", "or", "or"),
    "xor": ("", "xor", "xor", "xor"), "left shift": ("", "shl", "shl"), "right shift": ("", "ashr", "lshr"),
    "greater": ("fcmp ogt", "icmp sgt", "icmp ugt", "icmp ugt"), "equal": ("fcmp oeq", *["icmp eq"] * 3),
    "greater equal": ("fcmp oge", "icmp sge", "icmp uge", "icmp uge"), "not equal": ("fcmp une", *["icmp ne"] * 3),
}  # fmt: skip
"""LLVM's operations on floats, integers, words and masks."""
_INTRINSICS = ("sqrt", "floor", "ceil", "trunc", "rint", "copysign")


def type_of(kind: str, width: int) -> str:
    """The LLVM type of so many lanes of a kind."""
    scalar = {"f": "double", "b": "i1"}.get(kind, "i64")
    return scalar if width == 1 else f"<{width} x {scalar}>"


def literal(value: Any, kind: str, width: int) -> str:
    """A constant in LLVM IR."""
    if kind == "f":
        text = f"0x{struct.unpack('<Q', struct.pack('<d', value))[0]:016X}"
    elif kind == "b":
        text = "true" if value else "false"
    else:
        text = str(int(value))
    return text if width == 1 else f"splat ({type_of(kind, 1)} {text})"


_LITERAL = (0.0, 1.0, -1.0, 0.5, -0.5, 2.0, np.inf, -np.inf)


def is_literal(value: Any, kind: str) -> bool:
    """Is a constant part of the code, and not one of the numbers that it reads from memory?"""
    return bool(kind != "f" or value in _LITERAL or np.isnan(value))


class Module:
    """What the functions of one program share: intrinsics, elementary functions and constants.

    Constants are no part of the code: programs of models that differ in their numbers alone are compiled once.

    Args:
        places: Where the numbers of constants begin in memory, by value; the others are `is_literal`.
    """

    def __init__(self, places: Mapping[int, int]) -> None:
        self.places = places
        self.declared: dict[str, None] = {}
        self.functions: dict[str, str] = {}
        self.outlined: dict[str, str] = {}

    def elementary(self, opcode: str, width: int) -> str:
        """An elementary function; its name."""
        name = f"@{opcode}.{width}"
        if name not in self.functions:
            self.functions[name] = ""
            count, expansion = EXPANSIONS[opcode]
            program = Program()
            operands = [program.new("f") for _ in range(count)]
            results = expansion(*(Tracer(program, value) for value in operands))
            values = [each.value for each in (results if isinstance(results, tuple) else (results,))]
            emitter = Emitter(program, self, width)
            emitter.literal = True
            emitter.names = {value: f"%p{i}" for i, value in enumerate(operands)}
            emitter.block(program.live(values))
            T = type_of("f", width)
            parameters = ", ".join(f"{T} %p{i}" for i in range(count))
            given = f"{{{T}, {T}}}" if len(values) == 2 else T
            if len(values) == 2:
                first = emitter.line(f"insertvalue {given} poison, {T} {emitter.name(values[0])}, 0")
                last = emitter.line(f"insertvalue {given} {first}, {T} {emitter.name(values[1])}, 1")
            else:
                last = emitter.name(values[0])
            body = "\n".join([*emitter.lines, f"  ret {given} {last}"])
            self.functions[name] = f"define internal {given} {name}({parameters}) #0 {{\nentry:\n{body}\n}}"
        return name

    def text(self, functions: Sequence[str]) -> str:
        """The module with these functions."""
        return "\n".join([*self.declared, *self.functions.values(), *functions, "attributes #0 = { nounwind }", ""])


class Emitter:
    """Instructions of a program as lines of a function, with ``width`` rows side by side."""

    def __init__(self, program: Program, module: Module, width: int, within: "Emitter | None" = None) -> None:
        self.program, self.module, self.width = program, module, width
        self.lines: list[str] = within.lines if within else []
        self.labels: list[str] = within.labels if within else ["entry"]
        self._numbers: Iterator[int] = within._numbers if within else itertools.count(1)
        self.names: dict[int, str] = {}
        self._pairs: dict[int, str] = {}  # sine and cosine of a value
        self.literal = False  # are all constants part of the code?
        self.special: dict[str, Callable[[Instruction], None]] = {}

    # --- lines --------------------------------------------------------------------------------------

    def line(self, text: str) -> str:
        """A line that gives a result; its name."""
        name = f"%v{next(self._numbers)}"
        self.lines.append(f"  {name} = {text}")
        return name

    def begin(self, label: str) -> None:
        """Begin a basic block."""
        self.lines.append(f"{label}:")
        self.labels.append(label)

    def fresh(self, stem: str) -> str:
        """A new label."""
        return f"{stem}{next(self._numbers)}"

    def call(self, intrinsic: str, kinds: str, width: int, *operands: str, suffix: str = "") -> str:
        """A call of one of LLVM's intrinsics, whose operands are of these kinds."""
        scalar = "f64" if kinds[0] == "f" else "i64"
        types = [type_of(kind, width) for kind in kinds]
        name = f"@llvm.{intrinsic}.{scalar if width == 1 else f'v{width}{scalar}'}"
        extra = ", i1" if suffix else ""
        self.module.declared[f"declare {types[0]} {name}({', '.join(types)}{extra})"] = None
        pairs = ", ".join(f"{kind} {operand}" for kind, operand in zip(types, operands, strict=True))
        return self.line(f"call {types[0]} {name}({pairs}{suffix})")

    def name(self, value: int) -> str:
        """The name of a scalar, or its literal."""
        if value not in self.program.constants:
            return self.names[value]
        if self.literal or value not in self.module.places:
            return literal(self.program.constants[value], self.program.kinds[value], self.width)
        place = self.constant(value, 0)
        return self.splat(self.line(f"load double, ptr {place}, align 8"), self.width)

    def constant(self, value: int, entry: int | str) -> str:
        """The address of an entry of a constant."""
        first = self.module.places[value]
        at = first + entry if isinstance(entry, int) else self.line(f"add i64 {entry}, {first}")
        return self.line(f"getelementptr double, ptr %constants, i64 {at}")

    def splat(self, x: str, width: int, kind: str = "f") -> str:
        """A vector of one scalar."""
        if width == 1:
            return x
        T = type_of(kind, width)
        first = self.line(f"insertelement {T} poison, {type_of(kind, 1)} {x}, i32 0")
        return self.line(f"shufflevector {T} {first}, {T} poison, <{width} x i32> zeroinitializer")

    def loop(
        self, first: int | str, count: int | str, body: Callable[..., Sequence[str] | None],
        initial: Sequence[str] = (), types: Sequence[str] = (), step: int = 1,
        going: Callable[..., str] | None = None,
    ) -> list[str]:  # fmt: skip
        """A loop ``for i in range(first, count, step)``, while ``going``; names of what it carries, afterwards."""
        before, head, inside, done = self.labels[-1], *map(self.fresh, ("head", "body", "done"))
        counter, advanced = f"%{self.fresh('i')}", f"%{self.fresh('n')}"
        self.lines.append(f"  br label %{head}")
        self.begin(head)
        at = len(self.lines)
        carried = [f"%{self.fresh('c')}" for _ in initial]
        test = self.line(f"icmp slt i64 {counter}, {count}")
        if going is not None:
            test = self.line(f"and i1 {test}, {going(*carried)}")
        self.lines.append(f"  br i1 {test}, label %{inside}, label %{done}")
        self.begin(inside)
        after = body(counter, *carried)
        self.lines.append(f"  {advanced} = add i64 {counter}, {step}")
        self.lines.append(f"  br label %{head}")
        end = self.labels[-1]
        phis = [f"  {counter} = phi i64 [{first}, %{before}], [{advanced}, %{end}]"]
        for name, kind, one, two in zip(carried, types, initial, after or (), strict=True):
            phis.append(f"  {name} = phi {kind} [{one}, %{before}], [{two}, %{end}]")
        self.lines[at:at] = phis
        self.begin(done)
        return carried

    # --- instructions -------------------------------------------------------------------------------

    def block(self, instructions: Sequence[Instruction]) -> None:
        """Instructions in order."""
        for instruction in instructions:
            if instruction.opcode in self.special:
                self.specially(instruction)
            elif instruction.opcode == "repeat":
                self._repeat(instruction)
            elif instruction.opcode == "lookup":
                self.names[instruction.result] = self._lookup(instruction)
            elif instruction.opcode in ("sin", "cos"):
                self.names[instruction.result] = self._sine_or_cosine(instruction)
            else:
                values: Any = instruction.operands
                kinds = "".join(self.program.kinds[value] for value in values)
                operands = [self.name(value) for value in values]
                self.names[instruction.result] = self.operation(
                    instruction.opcode, kinds, operands, self.width, self.program.kinds[instruction.result]
                )

    def specially(self, instruction: Instruction) -> None:
        """An instruction that is more than one operation of scalars."""
        self.special[instruction.opcode](instruction)

    def operation(self, opcode: str, kinds: str, operands: Sequence[str], width: int, result: str = "f") -> str:
        """One opcode of scalars of some kinds, ``width`` of them side by side."""
        kind, T = kinds[0], type_of(kinds[0], width)
        if opcode in EXPANSIONS:
            name = self.module.elementary(opcode, width)
            return self.line(f"call {T} {name}({', '.join(f'{T} {each}' for each in operands)})")
        if opcode in _OPERATIONS:
            return self.line(f"{_OPERATIONS[opcode]['fiub'.index(kind)]} {T} {', '.join(operands)}")
        if opcode in _INTRINSICS:
            return self.call(opcode, kinds, width, *operands)
        if opcode == "where":
            chosen = type_of(kinds[1], width)
            return self.line(f"select {T} {operands[0]}, {chosen} {operands[1]}, {chosen} {operands[2]}")
        if opcode in ("maximum", "minimum"):
            return self._extreme(opcode, kind, operands, width)
        return self._other(opcode, kind, operands, width, result)

    def _extreme(self, opcode: str, kind: str, operands: Sequence[str], width: int) -> str:
        """NumPy's: the first operand where it is NaN, the second where that is."""
        T, mask = type_of(kind, width), type_of("b", width)
        order = "gt" if opcode == "maximum" else "lt"
        if kind == "f":
            beyond = self.line(f"fcmp o{order} {T} {operands[0]}, {operands[1]}")
            missing = self.line(f"fcmp uno {T} {operands[0]}, {operands[0]}")
            chosen = self.line(f"or {mask} {beyond}, {missing}")
        else:
            chosen = self.line(f"icmp {kind.replace('i', 's')}{order} {T} {operands[0]}, {operands[1]}")
        return self.line(f"select {mask} {chosen}, {T} {operands[0]}, {T} {operands[1]}")

    def _other(self, opcode: str, kind: str, operands: Sequence[str], width: int, result: str) -> str:
        T, x = type_of(kind, width), operands[0]
        if opcode == "negative":
            return self.line(f"fneg {T} {x}" if kind == "f" else f"sub {T} {literal(0, kind, width)}, {x}")
        if opcode == "absolute":
            return self.call("fabs", "f", width, x) if kind == "f" else self.call("abs", "i", width, x, suffix=", i1 0")
        if opcode == "isfinite":
            zero = self.line(f"fsub {T} {x}, {x}")
            return self.line(f"fcmp oeq {T} {zero}, {literal(0.0, 'f', width)}")
        if opcode == "isnan":
            return self.line(f"fcmp uno {T} {x}, {x}")
        if opcode == "not":
            return self.line(f"xor {T} {x}, {literal(1 if kind == 'b' else -1, kind, width)}")
        if opcode in ("bits", "from bits"):
            return self.line(f"bitcast {T} {x} to {type_of(result, width)}")
        if opcode == "cast":
            return self.cast(x, kind, result, width)
        if opcode == "whole remainder":
            return self._whole_remainder(kind, operands, width)
        raise NotImplementedError(opcode)

    def _whole_remainder(self, kind: str, operands: Sequence[str], width: int) -> str:
        T, mask, (x, y) = type_of(kind, width), type_of("b", width), operands
        zero, one = literal(0, kind, width), literal(1, kind, width)
        none = self.line(f"icmp eq {T} {y}, {zero}")  # NumPy gives 0
        y = self.line(f"select {mask} {none}, {T} {one}, {T} {y}")
        if kind == "u":
            return self.line(f"urem {T} {x}, {y}")
        minus = self.line(f"icmp eq {T} {y}, {literal(-1, kind, width)}")  # overflows of the lowest number; gives 0
        y = self.line(f"select {mask} {minus}, {T} {one}, {T} {y}")
        rest = self.line(f"srem {T} {x}, {y}")
        signs = self.line(f"xor {T} {rest}, {y}")
        apart = self.line(f"icmp slt {T} {signs}, {zero}")
        some = self.line(f"icmp ne {T} {rest}, {zero}")
        both = self.line(f"and {mask} {apart}, {some}")
        moved = self.line(f"add {T} {rest}, {y}")
        return self.line(f"select {mask} {both}, {T} {moved}, {T} {rest}")

    def cast(self, x: str, kind: str, result: str, width: int) -> str:
        """A value of a kind as one of another."""
        T, R = type_of(kind, width), type_of(result, width)
        if kind == "b":
            return self.line(f"select {T} {x}, {R} {literal(1, result, width)}, {R} {literal(0, result, width)}")
        if result == "f":
            return self.line(f"{'sitofp' if kind == 'i' else 'uitofp'} {T} {x} to {R}")
        if kind == "f":
            x = self.within(x, -9.2e18, 9.2e18, width)
            return self.line(f"fptosi {T} {x} to {R}")
        return x

    def within(self, x: str, low: float, high: float, width: int) -> str:
        """Numbers within bounds; NaN becomes the lower one, or 0."""
        T, mask = type_of("f", width), type_of("b", width)
        for order, bound in (("ogt", low), ("olt", high)):
            inside = self.line(f"fcmp {order} {T} {x}, {literal(bound, 'f', width)}")
            x = self.line(f"select {mask} {inside}, {T} {x}, {T} {literal(bound, 'f', width)}")
        return x

    def _sine_or_cosine(self, instruction: Instruction) -> str:
        value: Any = instruction.operands[0]
        T = type_of("f", self.width)
        if value not in self._pairs:
            name = self.module.elementary("sincos", self.width)
            self._pairs[value] = self.line(f"call {{{T}, {T}}} {name}({T} {self.name(value)})")
        return self.line(f"extractvalue {{{T}, {T}}} {self._pairs[value]}, {int(instruction.opcode == 'cos')}")

    def lanes(self, one: Callable[[int], str], scalar: str) -> str:
        """A vector of what a function gives for each lane, of a type of LLVM."""
        if self.width == 1:
            return one(0)
        vector = "poison"
        for lane in range(self.width):
            vector = self.line(f"insertelement <{self.width} x {scalar}> {vector}, {scalar} {one(lane)}, i32 {lane}")
        return vector

    def lane(self, vector: str, scalar: str, lane: int) -> str:
        """One lane of a vector."""
        if self.width == 1:
            return vector
        return self.line(f"extractelement <{self.width} x {scalar}> {vector}, i32 {lane}")

    def any(self, mask: str) -> str:
        """Is a mask true in any lane?"""
        if self.width == 1:
            return mask
        name, T = f"@llvm.vector.reduce.or.v{self.width}i1", type_of("b", self.width)
        self.module.declared[f"declare i1 {name}({T})"] = None
        return self.line(f"call i1 {name}({T} {mask})")

    def _lookup(self, instruction: Instruction) -> str:
        value: Any = instruction.operands[0]
        place, count, across, column = instruction.attributes
        kind, index = self.program.kinds[value], self.name(value)
        if kind == "f":
            index = self.within(index, 0.0, count - 1.0, self.width)
            index = self.line(f"fptosi {type_of('f', self.width)} {index} to {type_of('i', self.width)}")
        else:
            for call, bound in (("smax", 0), ("smin", count - 1)):
                index = self.call(call, "ii", self.width, index, literal(bound, "i", self.width))

        def one(lane: int) -> str:
            entry = self.lane(index, "i64", lane)
            at = self.line(f"add i64 {self.line(f'mul i64 {entry}, {across}')}, {column}")
            return self.line(f"load double, ptr {self.constant(place, at)}, align 8")

        return self.lanes(one, "double")

    def _repeat(self, instruction: Instruction) -> None:
        loop: Loop = instruction.attributes[0]
        types = [type_of(self.program.kinds[value], self.width) for value in loop.parameters]

        def body(_: str, *carried: str) -> list[str]:
            outside = dict(self._pairs)
            self.names.update(zip(loop.parameters, carried, strict=True))
            self.block(loop.body)
            self._pairs = outside
            return [self.name(value) for value in loop.after]

        def going(*carried: str) -> str:
            return self.any(reduce(lambda a, b: self.line(f"or {types[0]} {a}, {b}"), carried[: loop.masks]))

        initial = [self.name(value) for value in instruction.operands if isinstance(value, int)]
        results = self.loop(0, loop.count, body, initial, types, going=going if loop.masks else None)
        self.names.update(zip(loop.results, results, strict=True))
