"""Programs as LLVM IR: scalars straight-line, rows of the batch as lanes of vectors.

The operations and their order are those of the program at any width, without contraction or
fast-math flags: a row has the same bits alone, in any batch and on any processor.
"""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from inspect import signature
from typing import Any

import numpy as np

from estimators.engine.elementary import EXPANSIONS
from estimators.engine.program import KINDS, Instruction, Program
from estimators.engine.tracer import Tracer, cast, constant, within

_OPERATIONS = {
    "add": ("fadd", "add", "add"), "subtract": ("fsub", "sub", "sub"),
    "multiply": ("fmul", "mul", "mul"), "divide": ("fdiv",), "negative": ("fneg",),
    "fmod": ("frem",), "bitwise_and": ("", "and", "and", "and"),
    "bitwise_or": ("", "or", "or", "or"), "bitwise_xor": ("", "xor", "xor", "xor"),
    "left_shift": ("", "shl", "shl"), "right_shift": ("", "ashr", "lshr"),
    "greater": ("fcmp ogt", "icmp sgt", "icmp ugt", "icmp ugt"),
    "greater_equal": ("fcmp oge", "icmp sge", "icmp uge", "icmp uge"),
    "equal": ("fcmp oeq", *["icmp eq"] * 3), "not_equal": ("fcmp une", *["icmp ne"] * 3),
}  # fmt: skip
"""LLVM's operations on floats, integers, words and masks."""
_UNROLLED = 4
_CASTS = {"if": "sitofp", "uf": "uitofp", "fi": "fptosi", "fu": "fptosi"}  # by both kinds
_INTRINSICS = {"absolute": "fabs"} | {
    each: each for each in ("sqrt", "floor", "ceil", "trunc", "rint", "copysign")
}


@cache
def type_of(kind: str, width: int) -> str:
    """The LLVM type of ``width`` lanes of a kind; "m" is a mask in memory."""
    scalar = {"f": "double", "b": "i1", "m": "i8"}.get(kind, "i64")
    return scalar if width == 1 else f"<{width} x {scalar}>"


def literal(value: Any, kind: str, width: int) -> str:
    """A constant in LLVM IR."""
    if kind == "f":
        text = f"0x{int(np.float64(value).view(np.uint64)):016X}"
    elif kind == "b":
        text = "true" if value else "false"
    else:
        text = str(int(value))
    return text if width == 1 else f"splat ({type_of(kind, 1)} {text})"


class Module:
    """Intrinsics, elementary functions and constants that the functions of one program share.

    Constants are not part of the code, so models that differ only in their numbers share one
    compiled program.

    Args:
        places: Offset in memory of each constant's numbers, by value; other constants are literals.
    """

    def __init__(self, places: Mapping[int, int]) -> None:
        self.places = places
        self.declared: dict[str, None] = {}
        self.functions: dict[str, str] = {}

    def elementary(self, opcode: str, width: int) -> str:
        """Add an elementary function and return its name."""
        name, T = f"@{opcode}.{width}", type_of("f", width)
        if name in self.functions:
            return name
        expansion, emitter = EXPANSIONS[opcode], Emitter(Program(), self, width)
        lanes, operands = emitter.own, [*signature(expansion).parameters]
        results = expansion(*(lanes.value(f"%{operand}") for operand in operands))
        given, last = T, ""
        if isinstance(results, tuple):
            given, last = f"{{{T}, {T}}}", "poison"
            for i, each in enumerate(results):
                last = emitter.line(f"insertvalue {given} {last}, {T} {lanes.name(each)}, {i}")
        parameters = ", ".join(f"{T} %{operand}" for operand in operands)
        self.functions[name] = "\n".join([
            f"define internal {given} {name}({parameters}) #1 {{\nentry:", *emitter.lines,
            f"  ret {given} {last or lanes.name(results)}\n}}",
        ])  # fmt: skip
        return name

    def intrinsic(self, opcode: str, width: int) -> str:
        """Declare one of LLVM's own functions and return its name."""
        T, lanes = type_of("f", width), "" if width == 1 else f"v{width}"
        name = f"@llvm.{_INTRINSICS[opcode]}.{lanes}f64"
        types = f"{T}, {T}" if opcode == "copysign" else T
        self.declared[f"declare {T} {name}({types})"] = None
        return name

    def text(self, function: str) -> str:
        """The module with a function beside its own."""
        return "\n".join(
            [
                *self.declared,
                *self.functions.values(),
                function,
                # vectors on the stack must not lie across cache lines
                "attributes #0 = { nounwind alignstack=64 }",
                "attributes #1 = { nounwind willreturn memory(none) }",
                "",
            ]
        )


class Lanes(Program):
    """Numbers in machine code, ``width`` lanes each, whose operations are emitted immediately."""

    def __init__(self, emitter: "Emitter", width: int) -> None:
        super().__init__()
        self.emitter, self.width, self._names = emitter, width, dict[int, str]()

    def add(
        self, opcode: str, operands: Any, kind: str, size: Any = None, attributes: Any = ()
    ) -> int:
        """Emit an operation."""
        kinds = "".join(map(self.kinds.__getitem__, operands))
        names = [*map(self._names.__getitem__, operands)]
        T = type_of(kinds[0], self.width)
        if opcode in ("sin", "cos"):  # computed together; LLVM finds calls that are equal
            pair, function = f"{{{T}, {T}}}", self.emitter.module.elementary("sincos", self.width)
            both = self.emitter.line(f"call {pair} {function}({T} {names[0]})")
            text = f"extractvalue {pair} {both}, {opcode == 'cos':d}"
        elif opcode in EXPANSIONS or opcode in _INTRINSICS:
            module = self.emitter.module
            add = module.elementary if opcode in EXPANSIONS else module.intrinsic
            given = ", ".join(f"{T} {each}" for each in names)
            text = f"call {T} {add(opcode, self.width)}({given})"
        elif opcode in _OPERATIONS:
            text = f"{_OPERATIONS[opcode]['fiub'.index(kinds[0])]} {T} {', '.join(names)}"
        elif opcode == "where":
            chosen = type_of(kinds[1], self.width)
            text = f"select {T} {names[0]}, {chosen} {names[1]}, {chosen} {names[2]}"
        else:
            word = _CASTS.get(kinds + kind, "bitcast") if opcode == "cast" else "bitcast"
            text = f"{word} {T} {names[0]} to {type_of(kind, self.width)}"
        result = self.new(kind)
        self._names[result] = self.emitter.line(text)
        return result

    def constant(self, value: Any, kind: str) -> int:
        """A constant scalar, the same in all lanes."""
        result = super().constant(value, kind)
        self._names[result] = literal(value, kind, self.width)
        return result

    def value(self, name: str, kind: str = "f") -> Tracer:
        """The tracer of a value in LLVM IR."""
        result = self.new(kind)
        self._names[result] = name
        return Tracer(self, result)

    def name(self, x: Any) -> str:
        """The name of a tracer's value, or its literal."""
        return self._names[constant(self, x).value]


class Emitter:
    """Instructions of a program as lines of a function, with ``width`` rows as lanes."""

    def __init__(self, program: Program, module: Module, width: int) -> None:
        self.program, self.module, self.width = program, module, width
        self.lines: list[str] = []
        self.label = "entry"  # of the basic block
        self.scalars: dict[int, int] = {}  # of the program, as values of `own`
        self._read: dict[tuple[str, int, int], int] = {}
        self._numbers: Iterator[int] = itertools.count(1)
        self._lanes: dict[int, Lanes] = {}
        self.one, self.own = self.lanes(1), self.lanes(width)

    # --- lines ------------------------------------------------------------------------------------

    def line(self, text: str) -> str:
        """Add a line that computes a result, and return its name."""
        name = f"%v{next(self._numbers)}"
        self.lines.append(f"  {name} = {text}")
        return name

    def begin(self, label: str) -> None:
        """Begin a basic block."""
        self.lines.append(f"{label}:")
        self.label = label

    def fresh(self, stem: str) -> str:
        """A new label."""
        return f"{stem}{next(self._numbers)}"

    def lanes(self, width: int) -> Lanes:
        """Numbers with ``width`` lanes."""
        if width not in self._lanes:
            self._lanes[width] = Lanes(self, width)
        return self._lanes[width]

    def scalar(self, value: int) -> Tracer:
        """A scalar of the program."""
        return Tracer(self.own, self._own_value(value))

    def _own_value(self, value: int) -> int:
        if value in self.module.places:  # read once a basic block
            place = self.label, self.width, value
            if place not in self._read:
                number = self.read(self.constant(value, 0), 1)
                self._read[place] = self.spread(number, self.width).value
            return self._read[place]
        if value not in self.scalars:
            number, kind = self.program.constants[value], self.program.kinds[value]
            self.scalars[value] = self.own.constant(number, kind)
        return self.scalars[value]

    def at(self, base: str, entry: Any, T: str = "double") -> str:
        """The address of an entry."""
        return self.line(f"getelementptr {T}, ptr {base}, i64 {self.one.name(entry)}")

    def constant(self, value: int, entry: Any) -> str:
        """The address of an entry of a constant."""
        return self.at("%constants", entry + self.module.places[value])

    def read(self, address: str, width: int) -> Tracer:
        """Floats from memory."""
        return self.lanes(width).value(
            self.line(f"load {type_of('f', width)}, ptr {address}, align 8")
        )

    def spread(self, x: Tracer, width: int, each: bool = False) -> Tracer:
        """Widen a number to more lanes: repeat all its lanes in turn, or each of them in place."""
        lanes: Any = x.program
        if lanes.width == width:
            return x
        name, T = lanes.name(x), type_of(x.kind, lanes.width)
        if lanes.width == 1:
            one, T = T, f"<1 x {T}>"
            name = self.line(f"insertelement {T} poison, {one} {name}, i32 0")
        period = width // lanes.width
        order = (lane // period if each else lane % lanes.width for lane in range(width))
        lines = ", ".join(f"i32 {lane}" for lane in order)
        repeated = self.line(f"shufflevector {T} {name}, {T} poison, <{width} x i32> <{lines}>")
        return self.lanes(width).value(repeated, x.kind)

    def loop(
        self, first: Any, count: Any, body: Callable[..., Any], initial: Sequence[Tracer] = (),
        step: int = 1,
    ) -> list[Tracer]:  # fmt: skip
        """Carried values after ``for i in range(first, count, step)``.

        A small number of passes is unrolled.
        """
        if type(first) is type(count) is int and count - first <= _UNROLLED * step:
            for i in range(first, count, step):
                initial = body(i, *initial) or ()
            return list(initial)
        before, head, inside, done = self.label, *map(self.fresh, ("head", "body", "done"))
        first, count = self.one.name(first), self.one.name(count)
        counter, advanced = f"%{self.fresh('i')}", f"%{self.fresh('n')}"
        self.lines.append(f"  br label %{head}")
        self.begin(head)
        at = len(self.lines)
        programs: list[Any] = [x.program for x in initial]
        carried = [
            p.value(f"%{self.fresh('c')}", x.kind) for p, x in zip(programs, initial, strict=True)
        ]
        test = self.line(f"icmp slt i64 {counter}, {count}")
        self.lines.append(f"  br i1 {test}, label %{inside}, label %{done}")
        self.begin(inside)
        after = body(self.one.value(counter, "i"), *carried) or ()
        self.lines.append(f"  {advanced} = add i64 {counter}, {step}")
        self.lines.append(f"  br label %{head}")
        end = self.label
        phis = [f"  {counter} = phi i64 [{first}, %{before}], [{advanced}, %{end}]"]
        for p, x, one, two in zip(programs, carried, initial, after, strict=True):
            kind = type_of(x.kind, p.width)
            phis.append(
                f"  {p.name(x)} = phi {kind} [{p.name(one)}, %{before}], [{p.name(two)}, %{end}]"
            )
        self.lines[at:at] = phis
        self.begin(done)
        return carried

    # --- instructions -----------------------------------------------------------------------------

    def block(self, instructions: Sequence[Instruction]) -> None:
        """Instructions in order."""
        for each in instructions:
            if (emit := getattr(self, f"_emit_{each.opcode}", None)) is not None:
                emit(each)
                continue
            operands = [self._own_value(value) for value in each.operands]  # type: ignore[arg-type]
            kind = self.program.kinds[each.result]
            self.scalars[each.result] = self.own.add(each.opcode, operands, kind)

    def gather(self, one: Callable[[int], str], kind: str = "f") -> str:
        """A vector of a function's values for each lane."""
        if self.width == 1:
            return one(0)
        vector, T = "poison", type_of(kind, 1)
        for lane in range(self.width):
            parts = f"<{self.width} x {T}> {vector}, {T} {one(lane)}, i32 {lane}"
            vector = self.line(f"insertelement {parts}")
        return vector

    def lane(self, vector: str, kind: str, lane: int) -> str:
        """One lane of a vector."""
        if self.width == 1:
            return vector
        return self.line(f"extractelement {type_of(kind, self.width)} {vector}, i32 {lane}")

    def any(self, mask: Tracer) -> Tracer:
        """Is a mask true in any lane?"""
        if self.width == 1:
            return mask
        name, T = f"@llvm.vector.reduce.or.v{self.width}i1", type_of("b", self.width)
        self.module.declared[f"declare i1 {name}({T})"] = None
        return self.one.value(self.line(f"call i1 {name}({T} {self.own.name(mask)})"), "b")

    def _emit_lookup(self, instruction: Instruction) -> None:
        value: Any = instruction.operands[0]
        place, count, across, column = instruction.attributes
        index = self.scalar(value)  # a float or an integer
        zero = KINDS[index.kind].type(0)
        entries = self.own.name(cast(within(index, zero, zero + (count - 1)), "i"))

        def one(lane: int) -> str:
            entry = self.one.value(self.lane(entries, "i", lane), "i")
            return self.one.name(self.read(self.constant(place, entry * across + column), 1))

        self.scalars[instruction.result] = self.own.value(self.gather(one)).value
