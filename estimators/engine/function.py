"""Compiled functions: a program for each row of a batch of arrays in C order."""

import itertools
import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from functools import partial
from operator import attrgetter, itemgetter
from typing import Any, NamedTuple

import numpy as np

from estimators.engine import machine
from estimators.engine.emit import LITERAL, Module, literal, type_of
from estimators.engine.linear_emit import LinearEmitter
from estimators.engine.matching import described, in_memory, invoker
from estimators.engine.matrix_emit import Index
from estimators.engine.program import Instruction, Program, View, value_of
from estimators.engine.tracer import KINDS, Tracer, cast, operation, where

LANES = 8
"""Rows side by side in a batch; a row alone has a program of its own."""
FEW = 4
"""Rows from which on vectors are worth it."""


class Argument(NamedTuple):
    """An argument of a compiled function: the shape and kind of its rows."""

    shape: tuple[int, ...]
    kind: str = "f"

    @property
    def size(self) -> int:
        """Entries of a row."""
        return math.prod(self.shape)


class Function:
    """A program, compiled for one row and for many when it is first needed for as many.

    Args:
        program: What it computes; its instructions ``input`` and ``input_matrix`` read the
            arguments.
        arguments: Rows of what it takes.
        outputs: For each result its scalars and views of matrices, one after the other, and an
            argument like it.
        sealed: Takes the arguments that it reads alone, and gives read-only arrays.

    Attributes:
        arguments: Rows of what `call` takes, by their numbers.
        layout: Places of matrices in the scratch.
    """

    def __init__(
        self,
        program: Program,
        arguments: Sequence[Argument],
        outputs: Sequence[tuple[Any, Argument]],
        sealed: bool = False,
    ) -> None:
        self.program, self._sealed = program, sealed
        self.outputs: tuple[Any, ...] = tuple(map(itemgetter(0), outputs))
        self.results: tuple[Argument, ...] = tuple(map(itemgetter(1), outputs))
        values = [*map(value_of, itertools.chain(*self.outputs))]
        self.instructions = program.complete(values)
        self.arguments: dict[int, Argument] = {}
        for each in self.instructions:
            if sealed and each.opcode in _INPUTS:
                self.arguments[each.attributes[0]] = arguments[each.attributes[0]]
        if not sealed:
            self.arguments = dict(enumerate(arguments))
        self.layout, self._scratch = _laid_out(program, self.instructions, values)
        self._places, self._literals, self._constants = _placed(program)
        self._codes: dict[int, int] = {}
        self.call: Callable[..., Any] = unlike

    def compute(self, arrays: Sequence[Any]) -> Any:
        """Results of arrays that have one batch, or none where all rows share them.

        From then on `call` gives them for arrays of such types and shapes, and None for others.
        """
        results = self.call(*arrays)
        if results is None:
            own, given, leading = list(self.arguments.values()), [], []
            for array, each in zip(arrays, own, strict=True):
                given.append(a := in_memory(array, each.kind))
                leading.append(a.shape[: a.ndim - len(each.shape)])
            batch = leading[0] if len({*leading}) == 1 else np.broadcast_shapes(*leading)
            shared = 0
            for i, axes in enumerate(leading):
                if math.prod(axes) == 1:
                    shared |= (axes != batch) << i
                elif axes != batch:
                    given[i] = np.broadcast_to(given[i], batch + own[i].shape).copy()
            rows = math.prod(batch)
            width = LANES if rows >= FEW else 1
            room = machine.scratch(width * self._scratch)
            flags = ~0x400 if self._sealed else -1  # NPY_ARRAY_WRITEABLE
            head = self._code(width), rows, shared, room, machine.address(self._constants), flags
            like = [*map(attrgetter("dtype", "shape"), given)]
            for each in self.results:
                like.append((KINDS[each.kind], batch + each.shape))
            self.call = call = partial(invoker(), described(head, len(given), like))
            results = call(*given)
        return results

    def _code(self, width: int) -> int:
        """Machine code for ``width`` rows side by side; programs with other numbers share it."""
        if width not in self._codes:
            code = str((
                self.instructions, self.outputs, self.arguments, self.results, width,
                self._literals, self._places, self.program.sizes, self.program.kinds,
            )).encode()  # fmt: skip
            self._codes[width] = machine.load(code, partial(self.text, width))
        return self._codes[width]

    def text(self, width: int, name: str) -> str:
        """The program in LLVM IR, as a function of a name."""
        driver = Driver(self, Module(self._places), width)
        return driver.module.text([driver.function(name, self.instructions, self.outputs)])


def unlike(*_: Any) -> None:
    """A call before there was one."""


def _placed(program: Program) -> tuple[dict[int, int], dict[int, str], np.ndarray]:
    """Constants of a program: begins in memory, texts of those in the code, numbers in memory."""
    numbers: dict[int, Any] = {}
    literals: dict[int, str] = {}
    for value, x in program.constants.items():
        kind = program.kinds[value]
        if kind != "f" or x in LITERAL or x != x:
            literals[value] = literal(x, kind, 1)
        else:
            numbers[value] = (x,)
    numbers |= program.tables
    starts = itertools.accumulate(map(len, numbers.values()), initial=0)
    constants = np.array([*itertools.chain(*numbers.values())], float)
    return dict(zip(numbers, starts, strict=False)), literals, constants


def _laid_out(
    program: Program, instructions: Sequence[Instruction], outputs: Sequence[int]
) -> tuple[dict[int, int], int]:
    """Places of a program's matrices in its scratch, and its size.

    A matrix that is needed no longer gives its place to another one of its size.
    """
    places: dict[int, int] = {}
    total, free = 0, defaultdict[int, list[int]](list)
    last: dict[int, int] = {}
    for at, each in enumerate(instructions):
        last |= dict.fromkeys(each.values, at)
    last |= dict.fromkeys(outputs, len(instructions))
    for at, each in enumerate(instructions):
        size = program.sizes.get(each.result)
        if size is not None:
            if not free[size]:
                free[size].append(total)
                total += size
            places[each.result] = free[size].pop()
        for value in {*each.values, each.result} & places.keys():
            if last.get(value, at) == at:
                free[program.sizes[value]].append(places[value])
    return places, total


class Driver(LinearEmitter):
    """The loop over the rows: loads what a program reads, and stores what it gives."""

    def __init__(self, function: Function, module: Module, width: int) -> None:
        super().__init__(function.program, module, width, function.layout)
        self._function = function
        self._bases: dict[int, list[str]] = {}

    def function(
        self, name: str, instructions: Sequence[Instruction], outputs: Sequence[Any]
    ) -> str:
        """The function in LLVM IR."""
        arguments, results = self._function.arguments, self._function.results
        end, shared = (self.one.value(f"%{name}", "i") for name in ("end", "shared"))
        strides = [
            where((shared & (1 << i)) != 0, 0, each.size)
            for i, each in enumerate(arguments.values())
        ]

        def body(row: Tracer) -> None:
            own = [operation("minimum", row + lane, end - 1) for lane in range(self.width)]

            def places(array: str, size: Any, kind: str) -> list[str]:
                return [self.at(array, each * size, _MEMORY[kind]) for each in own]

            for (i, each), stride in zip(arguments.items(), strides, strict=True):
                self._bases[i] = places(f"%a{i}", stride, each.kind)
            self.block(instructions)
            for i, (parts, each) in enumerate(zip(outputs, results, strict=True)):
                self._output(parts, each.kind, places(f"%o{i}", each.size, each.kind))

        self.loop(0, end, body, step=self.width)
        arrays = [f"%a{i}" for i in arguments] + [f"%o{i}" for i in range(len(results))]
        loads = [
            f"  {name}.at = getelementptr ptr, ptr %arrays, i64 {i}\n  {name} = load ptr, ptr {name}.at"
            for i, name in enumerate(arrays)
        ]
        head = (
            f"define void @{name}(i64 %end, i64 %shared, ptr noalias %scratch,"
            " ptr noalias readonly %constants, ptr noalias readonly %arrays) #0 {\nentry:"
        )
        return "\n".join([head, *loads, *self.lines, "  ret void\n}"])

    def _loaded(self, argument: int, column: Any) -> Tracer:
        """An entry of the rows of an argument."""
        kind = self._function.arguments[argument].kind
        memory = _MEMORY[kind]

        def one(lane: int) -> str:
            place = self.at(self._bases[argument][lane], column, memory)
            return self.line(f"load {memory}, ptr {place}")

        value = self.gather(one, memory)
        if kind == "b":
            T = memory if self.width == 1 else f"<{self.width} x {memory}>"
            value = self.line(
                f"icmp ne {T} {value}, {'0' if self.width == 1 else 'zeroinitializer'}"
            )
        return self.own.value(value, kind)

    def _emit_input(self, instruction: Instruction) -> None:
        self.names[instruction.result] = self.own.name(self._loaded(*instruction.attributes))

    def _emit_input_matrix(self, instruction: Instruction) -> None:
        (argument,) = instruction.attributes
        size = self.program.sizes[instruction.result]
        target, bases = self.matrix(instruction.result, (1, size)), self._bases[argument]
        floats = self._function.arguments[argument].kind == "f"
        if floats and self.width == 1:  # as it stands in its row
            self.pointers[instruction.result] = bases[0]
            return

        def some(_: Index, j: Index, count: int) -> None:
            if floats and count == self.width:
                rows = [self.read(self.at(base, j), count) for base in bases]
                entries = self._transposed(rows)
            else:
                entries = [self._loaded(argument, j + m) for m in range(count)]
            for m, entry in enumerate(entries):
                target[0, j + m] = entry

        self.over(1, size, some, LANES)

    def _transposed(self, rows: Sequence[Tracer]) -> list[Tracer]:
        """The columns of a square matrix: blocks change places, smaller ones from turn to turn."""
        n, names, T = len(rows), [self.own.name(row) for row in rows], type_of("f", len(rows))
        size = n // 2
        while size:
            for i in (i for i in range(n) if not i & size):
                pair = f"shufflevector {T} {names[i]}, {T} {names[i + size]}, <{n} x i32> "
                order = [j - size + n if j & size else j for j in range(n)]
                names[i], names[i + size] = (
                    self.line(f"{pair}<{', '.join(f'i32 {j + part}' for j in order)}>")
                    for part in (0, size)
                )
            size //= 2
        return [self.own.value(name) for name in names]

    def _output(self, parts: Sequence[Any], kind: str, bases: Sequence[str]) -> None:
        """Store scalars and matrices in columns one after the other."""
        column = 0
        for part in parts:
            if isinstance(part, View):
                self._output_matrix(part, kind, bases, column)
                column += math.prod(part.shape)
            else:
                self._stored(self.scalar(part), kind, bases, column)
                column += 1

    def _output_matrix(self, view: View, kind: str, bases: Sequence[str], column: int) -> None:
        if view.steps == (view.shape[1], 1):  # it lies in one piece
            view = View(view.value, (1, math.prod(view.shape)), view.start, (0, 1))

        def some(i: Index, j: Index, count: int) -> None:
            at = column + i * view.shape[1] + j
            entries = [self.load(view, i, j + m) for m in range(count)]
            if kind == "f" and count == self.width > 1:
                for entry, base in zip(self._transposed(entries), bases, strict=True):
                    T, place = type_of("f", count), self.at(base, at)
                    self.lines.append(f"  store {T} {self.own.name(entry)}, ptr {place}, align 8")
            else:
                for m, entry in enumerate(entries):
                    self._stored(entry, kind, bases, at + m)

        self.over(*view.shape, some, LANES)

    def _stored(self, x: Tracer, kind: str, bases: Sequence[str], column: Any) -> None:
        memory, value = _MEMORY[kind], self.own.name(cast(x, kind))
        if kind == "b":
            R = "i8" if self.width == 1 else f"<{self.width} x i8>"
            value = self.line(f"zext {type_of('b', self.width)} {value} to {R}")
        for lane, base in enumerate(bases):
            place = self.at(base, column, memory)
            self.lines.append(f"  store {memory} {self.lane(value, memory, lane)}, ptr {place}")


_INPUTS = "input", "input_matrix"
_MEMORY = {"f": "double", "i": "i64", "u": "i64", "b": "i8"}
