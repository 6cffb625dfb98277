"""Compiled functions: a program for each row of a batch of arrays in C order."""

import itertools
import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from estimators.engine import machine
from estimators.engine.emit import Module, is_literal, literal, type_of
from estimators.engine.linear_emit import LinearEmitter
from estimators.engine.matching import described, in_memory, invoker
from estimators.engine.matrix_emit import Index
from estimators.engine.program import Instruction, Program, View
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
        program: What it computes; its instructions ``input`` and ``input matrix`` read the
            arguments.
        arguments: Rows of what it takes.
        outputs: For each result its scalars and views of matrices, one after the other, and an
            argument like it.

    Attributes:
        layout: Places of matrices in the scratch.
    """

    def __init__(
        self,
        program: Program,
        arguments: Sequence[Argument],
        outputs: Sequence[tuple[Any, Argument]],
    ) -> None:
        self.arguments, self.results = tuple(arguments), tuple(result for _, result in outputs)
        self.program, self.outputs = program, [entries for entries, _ in outputs]
        values = [
            part.value if isinstance(part, View) else part
            for parts in self.outputs
            for part in parts
        ]
        self.instructions = program.complete(values)
        self.layout, self._scratch = _laid_out(program, self.instructions, values)
        self._places, self._constants = _placed(program)
        self._codes: dict[int, tuple[int, Any]] = {}
        self.call: Callable[..., Any] = unlike

    def compute(self, arrays: Sequence[Any]) -> Any:
        """Results of arrays that have one batch, or none where all rows share them.

        From then on `call` gives them for arrays of such types and shapes, and None for others.
        """
        results = self.call(*arrays)
        if results is None:
            given = list(map(in_memory, arrays))
            leading = [
                a.shape[: a.ndim - len(own.shape)]
                for a, own in zip(given, self.arguments, strict=True)
            ]
            batch, shared = np.broadcast_shapes(*leading), 0
            for i, axes in enumerate(leading):
                if math.prod(axes) == 1:
                    shared |= (axes != batch) << i
                elif axes != batch:
                    given[i] = np.broadcast_to(given[i], batch + self.arguments[i].shape).copy()
            rows = math.prod(batch)
            width = LANES if rows >= FEW else 1
            room = machine.scratch(width * self._scratch)
            head = self._code(width)[0], rows, shared, room, self._constants.ctypes.data
            like = [(KINDS[each.kind], batch + each.shape) for each in self.results]
            self.call = call = partial(invoker(), described(head, given, like))
            results = call(*given)
        return results

    def _code(self, width: int) -> tuple[int, Any]:
        """Machine code for ``width`` rows side by side; programs with other numbers share it."""
        if width not in self._codes:
            program = self.program
            literals = [
                (value, literal(x, program.kinds[value], 1))
                for value, x in program.constants.items() if value not in self._places
            ]  # fmt: skip
            code = str((
                self.instructions, self.outputs, self.arguments, self.results, width, literals,
                self._places, program.sizes, program.kinds,
            )).encode()  # fmt: skip
            self._codes[width] = machine.load(code, lambda: self.text(width))
        return self._codes[width]

    def text(self, width: int) -> str:
        """The program in LLVM IR."""
        module = Module(self._places)
        return module.text([Driver(self, module, width).function(self.instructions, self.outputs)])


def unlike(*_: Any) -> None:
    """A call before there was one."""


def _placed(program: Program) -> tuple[dict[int, int], np.ndarray]:
    """The numbers that a program reads from memory, and where those of each constant begin."""
    read = {
        value: (x,)
        for value, x in program.constants.items()
        if not is_literal(x, program.kinds[value])
    }
    numbers = read | program.tables
    starts = itertools.accumulate(map(len, numbers.values()), initial=0)
    constants = np.array([x for each in numbers.values() for x in each], float)
    return dict(zip(numbers, starts, strict=False)), constants


def _laid_out(
    program: Program, instructions: Sequence[Instruction], outputs: Sequence[int]
) -> tuple[dict[int, int], int]:
    """Places of a program's matrices in its scratch, and its size.

    A matrix that is needed no longer gives its place to another one of its size.
    """
    places: dict[int, int] = {}
    total, free = 0, defaultdict[int, list[int]](list)
    last = {value: at for at, each in enumerate(instructions) for value in each.values}
    last |= dict.fromkeys(outputs, len(instructions))
    for at, each in enumerate(instructions):
        size = program.sizes.get(each.result)
        if size is not None:
            if not free[size]:
                free[size].append(total)
                total += size
            places[each.result] = free[size].pop()
        for value in {*each.values, *each.results} & places.keys():
            if last.get(value, at) == at:
                free[program.sizes[value]].append(places[value])
    return places, total


class Driver(LinearEmitter):
    """The loop over the rows: loads what a program reads, and stores what it gives."""

    def __init__(self, function: Function, module: Module, width: int) -> None:
        super().__init__(function.program, module, width, function.layout)
        self._function = function
        self._bases: list[list[str]] = []
        self.special["input"] = self._input
        self.special["input matrix"] = self._input_matrix

    def function(self, instructions: Sequence[Instruction], outputs: Sequence[Any]) -> str:
        """The function in LLVM IR."""
        arguments, results = self._function.arguments, self._function.results
        end, shared = (self.one.value(f"%{name}", "i") for name in ("end", "shared"))
        strides = [
            where((shared & (1 << i)) != 0, 0, each.size) for i, each in enumerate(arguments)
        ]

        def body(row: Tracer) -> None:
            own = [operation("minimum", row + lane, end - 1) for lane in range(self.width)]
            self._bases = self._places("a", strides, arguments, own)
            self.block(instructions)
            places = self._places("o", [each.size for each in results], results, own)
            for parts, result, bases in zip(outputs, results, places, strict=True):
                self._output(parts, result.kind, bases)

        self.loop(0, end, body, step=self.width)
        arrays = [f"%a{i}" for i in range(len(arguments))]
        arrays += [f"%o{i}" for i in range(len(results))]
        loads = [
            f"  {name}.at = getelementptr ptr, ptr %arrays, i64 {i}\n  {name} = load ptr, ptr {name}.at"
            for i, name in enumerate(arrays)
        ]
        head = (
            "define void @call(i64 %end, i64 %shared, ptr noalias %scratch,"
            " ptr noalias readonly %constants, ptr noalias readonly %arrays) #0 {\nentry:"
        )
        return "\n".join([head, *loads, *self.lines, "  ret void\n}"])

    def _places(
        self, letter: str, sizes: Sequence[Any], each: Sequence[Argument], rows: Sequence[Any]
    ) -> list[list[str]]:
        """Addresses of some rows of arguments or results."""
        pairs = enumerate(zip(sizes, each, strict=True))
        return [
            [self.at(f"%{letter}{i}", row * size, _MEMORY[one.kind]) for row in rows]
            for i, (size, one) in pairs
        ]

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

    def _input(self, instruction: Instruction) -> None:
        self.names[instruction.result] = self.own.name(self._loaded(*instruction.attributes))

    def _input_matrix(self, instruction: Instruction) -> None:
        argument, column = instruction.attributes
        size = self.program.sizes[instruction.result]
        target, bases = self.matrix(instruction.result, (1, size)), self._bases[argument]
        floats = self._function.arguments[argument].kind == "f"
        if floats and self.width == 1:  # as it stands in its row
            self.pointers[instruction.result] = self.at(bases[0], column)
            return

        def some(_: Index, j: Index, count: int) -> None:
            if floats and count == self.width:
                rows = [self.read(self.at(base, j + column), count) for base in bases]
                entries = self._transposed(rows)
            else:
                entries = [self._loaded(argument, j + column + m) for m in range(count)]
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


_MEMORY = {"f": "double", "i": "i64", "u": "i64", "b": "i8"}
