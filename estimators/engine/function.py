"""Compiled functions: a program for each row of a batch of arrays in C order."""

import ctypes
import itertools
import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from functools import partial
from operator import itemgetter
from typing import Any, ClassVar, NamedTuple

import numpy as np

from estimators.engine import machine
from estimators.engine.emit import LITERAL, Module, type_of
from estimators.engine.linear_emit import LinearEmitter
from estimators.engine.matching import in_memory, invoker
from estimators.engine.matrix_emit import CHUNK, Index
from estimators.engine.program import KINDS, Instruction, Program, View, value_of
from estimators.engine.tracer import Tracer, cast, operation, where

FEW = 4
"""Least number of rows for which vectors are faster; fewer have the program of a single row."""


class Argument(NamedTuple):
    """An argument of a compiled function: the shape and kind of its rows."""

    shape: tuple[int, ...]
    kind: str = "f"

    @property
    def size(self) -> int:
        """Entries of a row."""
        return math.prod(self.shape)


class Function:
    """A program with its machine code for one row and for many, each compiled at first need.

    Args:
        program: The program; its instructions ``input`` and ``input_matrix`` read the arguments.
        arguments: Shape and kind of a row of each argument.
        outputs: For each result its scalars or the view of a matrix, and an argument like it.
        several: Does the traced function give a tuple of results?
        sealed: Does it take only the arguments that it reads, and return read-only arrays?
        own: Number of last results that are the caller's own: writable, though ``sealed``.

    Attributes:
        arguments: Shape and kind of a row of each argument of `call`, by its index.
        call: Results for arrays like the last ones; None for others, which need `compute`.
        computed: Calls of `compute` by all functions, each some 30 us slower than `call`.
        layout: Places of matrices in the scratch.
        several: As given.
    """

    computed: ClassVar[int] = 0

    def __init__(
        self,
        program: Program,
        arguments: Sequence[Argument],
        outputs: Sequence[tuple[Any, Argument]],
        several: bool,
        sealed: bool,
        own: int = 0,
    ) -> None:
        self.program, self.several = program, several
        self._sealed = len(outputs) - own if sealed else 0
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
        self._address = self._constants.__array_interface__["data"][0]
        self._codes: dict[int, int] = {}
        self.call: Callable[..., Any] = _like_none  # for arrays like the last ones

    def compute(self, *arrays: Any) -> tuple[np.ndarray, ...]:
        """Results for arrays of one batch; an array without batch axes is shared by all rows."""
        Function.computed += 1
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
        width = machine.lanes() if rows >= FEW else 1
        room = machine.scratch(width * self._scratch)
        head = self._code(width), rows, shared, room, self._address
        if (invoke := invoker()) is None:
            return self._called(head, given, batch)
        table = [*head, self._sealed, len(own), len(self.results)]
        for a in given:
            table += id(a.dtype), a.ndim, *a.shape
        for each in self.results:
            shape = batch + each.shape
            table += id(KINDS[each.kind]), len(shape), *shape
        call = partial(invoke, np.array(table, np.int64))
        results: Any = call(*given)
        self.call = call
        return results

    def _called(
        self, head: Sequence[int], given: Sequence[np.ndarray], batch: tuple[int, ...]
    ) -> tuple[np.ndarray, ...]:
        """Results by ctypes, for a Python or a NumPy whose arrays `invoker` does not know."""
        results = [np.empty(batch + each.shape, KINDS[each.kind]) for each in self.results]
        data = np.array([a.ctypes.data for a in (*given, *results)], np.uintp)
        code, *numbers = head
        _CODE(code)(*numbers, data.ctypes.data)
        for array in results[: self._sealed]:
            array.setflags(write=False)
        return tuple(results)

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


_CODE = ctypes.PYFUNCTYPE(None, ctypes.c_int64, ctypes.c_int64, *[ctypes.c_void_p] * 3)
"""Type of compiled programs; it keeps the lock of the interpreter, as the scratch is shared."""


def _like_none(*arrays: Any) -> None:
    """The first `Function.call`: no arrays are like the last ones."""


def _placed(program: Program) -> tuple[dict[int, int], dict[int, Any], np.ndarray]:
    """Constants of a program: offsets of those in memory, literals, numbers in memory."""
    places, literals, numbers = dict[int, int](), dict[int, Any](), list[float]()
    for value, x in program.constants.items():
        if program.kinds[value] != "f" or x in LITERAL or x != x:
            literals[value] = x
        else:
            places[value] = len(numbers)
            numbers.append(x)
    for value, table in program.tables.items():
        places[value] = len(numbers)
        numbers.extend(table)
    return places, literals, np.array(numbers, float)


def _laid_out(
    program: Program, instructions: Sequence[Instruction], outputs: Sequence[int]
) -> tuple[dict[int, int], int]:
    """Places of a program's matrices in its scratch, and its size.

    The place of a matrix that is no longer needed is used for another one of its size.
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
        self._together = width if width > 1 else CHUNK  # entries that are moved at a time
        self._bases: dict[int, list[str]] = {}
        self._squares: dict[tuple[int, int], list[Tracer]] = {}
        self._columns = defaultdict[int, set[int]](set)
        for each in function.instructions:
            if each.opcode == "input":
                argument, column = each.attributes
                self._columns[argument].add(column)

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
                T = type_of(_MEMORY.get(kind, kind), 1)
                return [self.at(array, each * size, T) for each in own]

            for (i, each), stride in zip(arguments.items(), strides, strict=True):
                self._bases[i] = places(f"%a{i}", stride, each.kind)
            self.block(instructions)
            for i, (parts, each) in enumerate(zip(outputs, results, strict=True)):
                self._result(parts, each.kind, places(f"%o{i}", each.size, each.kind))

        self.loop(0, end, body, step=self.width)
        arrays = [f"%a{i}" for i in arguments] + [f"%o{i}" for i in range(len(results))]
        loads = [
            f"  {name}.at = getelementptr ptr, ptr %arrays, i64 {i}\n"
            f"  {name} = load ptr, ptr {name}.at"
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


_INPUTS = "input", "input_matrix"
_MEMORY = {"b": "m"}
