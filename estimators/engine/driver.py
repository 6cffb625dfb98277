"""The loop of a compiled function over the rows of a batch, in LLVM IR."""

import itertools
import math
from collections import defaultdict
from collections.abc import Sequence
from typing import Any

from estimators.engine.emit import Module, type_of
from estimators.engine.linear_emit import LinearEmitter
from estimators.engine.matrix_emit import CHUNK, Index
from estimators.engine.program import Instruction, View
from estimators.engine.tracer import Tracer, cast, operation, where


class Driver(LinearEmitter):
    """The loop over the rows: loads what a program reads, and stores what it gives."""

    def __init__(self, function: Any, width: int) -> None:
        super().__init__(function.program, Module(function.places), width, function.layout)
        self._function = function
        self._together = width if width > 1 else CHUNK  # entries that are moved at a time
        self._bases: dict[int, list[str]] = {}
        self._squares: dict[tuple[int, int], list[Tracer]] = {}
        self._columns = defaultdict[int, set[int]](set)
        for each in function.instructions:
            if each.opcode == "input":
                argument, column = each.attributes
                self._columns[argument].add(column)

    def text(self, name: str) -> str:
        """The module in LLVM IR, with the function under a name."""
        function = self._function
        arguments, results = function.arguments, function.results
        end, shared = (self.one.value(f"%{name}", "i") for name in ("end", "shared"))

        strides = {
            i: where((shared & (1 << i)) != 0, 0, each.size) for i, each in arguments.items()
        }

        def body(row: Tracer) -> None:
            first = operation("minimum", row, end - self.width)  # the last ones are computed again
            own = [first + lane for lane in range(self.width)]

            def places(array: str, size: Any, kind: str) -> list[str]:
                T = type_of(_MEMORY.get(kind, kind), 1)
                return [self.at(array, each * size, T) for each in own]

            for i, each in arguments.items():
                self._bases[i] = places(f"%a{i}", strides[i], each.kind)
            self.block(function.instructions)
            for i, (parts, each) in enumerate(zip(function.outputs, results, strict=True)):
                self._result(parts, each.kind, places(f"%o{i}", each.size, each.kind))

        self.loop(0, end, body, step=self.width)
        arrays = {f"%a{i}": i for i in arguments}
        arrays |= {f"%o{i}": function.count + i for i in range(len(results))}
        loads = [
            f"  {name}.at = getelementptr ptr, ptr %arrays, i64 {i}\n"
            f"  {name} = load ptr, ptr {name}.at"
            for name, i in arrays.items()
        ]
        head = (
            f"define void @{name}(i64 %end, i64 %shared, ptr noalias %scratch,"
            " ptr noalias readonly %constants, ptr noalias readonly %arrays) #0 {\nentry:"
        )
        return self.module.text("\n".join([head, *loads, *self.lines, "  ret void\n}"]))

    def _loaded(self, argument: int, column: Any) -> Tracer:
        """An entry of the rows of an argument."""
        kind = self._function.arguments[argument].kind
        memory = _MEMORY.get(kind, kind)
        T = type_of(memory, 1)

        def one(lane: int) -> str:
            return self.line(f"load {T}, ptr {self.at(self._bases[argument][lane], column, T)}")

        value = self.gather(one, memory)
        if kind == "b":
            wide = type_of(memory, self.width)
            value = self.line(f"trunc {wide} {value} to {type_of(kind, self.width)}")
        return self.own.value(value, kind)

    def _emit_input(self, instruction: Instruction) -> None:
        """An entry of an argument; many neighbouring ones are read together."""
        argument, column = instruction.attributes
        each, width = self._function.arguments[argument], self.width
        start = min(column - column % width, each.size - width)
        near = self._columns[argument].intersection(range(start, start + width))
        if each.kind != "f" or start < 0 or 2 * len(near) <= width:
            self.scalars[instruction.result] = self._loaded(argument, column).value
            return
        if (argument, start) not in self._squares:
            rows = [self.read(self.at(base, start), width) for base in self._bases[argument]]
            self._squares[argument, start] = self._transposed(rows)
        self.scalars[instruction.result] = self._squares[argument, start][column - start].value

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

        self.over(1, size, some, self._together)

    def _transposed(self, rows: Sequence[Tracer]) -> list[Tracer]:
        """Transpose a square matrix by swapping blocks, in ever smaller sizes."""
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

    def _result(self, parts: Sequence[Any], kind: str, bases: Sequence[str]) -> None:
        """Store the scalars and matrices of a result."""
        column = 0
        for whole, group in itertools.groupby(parts, lambda part: isinstance(part, View)):
            if whole:
                for view in group:
                    self._output(view, kind, bases, column)
                    column += math.prod(view.shape)
                continue
            entries = [*map(self.scalar, group)]
            for at in range(0, len(entries), self.width):
                self._stored_together(entries[at : at + self.width], kind, bases, column + at)
            column += len(entries)

    def _stored_together(
        self, entries: Sequence[Tracer], kind: str, bases: Sequence[str], column: Any
    ) -> None:
        """Store neighbouring entries, as many at once as there are lanes."""
        if kind != "f" or not len(entries) == self.width > 1:
            for m, entry in enumerate(entries):
                self._stored(entry, kind, bases, column + m)
            return
        T = type_of("f", self.width)
        for row, base in zip(self._transposed(entries), bases, strict=True):
            place = self.at(base, column)
            self.lines.append(f"  store {T} {self.own.name(row)}, ptr {place}, align 8")

    def _output(self, view: View, kind: str, bases: Sequence[str], first: int) -> None:
        """Store a matrix from a column on."""
        if view.steps == (view.shape[1], 1):  # it lies in one piece
            view = View(view.value, (1, math.prod(view.shape)), view.start, (0, 1))

        def some(i: Index, j: Index, count: int) -> None:
            at = i * view.shape[1] + j + first
            entries = [self.load(view, i, j + m) for m in range(count)]
            self._stored_together(entries, kind, bases, at)

        self.over(*view.shape, some, self._together)

    def _stored(self, x: Tracer, kind: str, bases: Sequence[str], column: Any) -> None:
        memory, value = _MEMORY.get(kind, kind), self.own.name(cast(x, kind))
        if kind == "b":
            wide = type_of(kind, self.width)
            value = self.line(f"zext {wide} {value} to {type_of(memory, self.width)}")
        T = type_of(memory, 1)
        for lane, base in enumerate(bases):
            place = self.at(base, column, T)
            self.lines.append(f"  store {T} {self.lane(value, memory, lane)}, ptr {place}")


_MEMORY = {"b": "m"}
