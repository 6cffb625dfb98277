"""Compiled functions: a program for each row of a batch, over arrays whose rows lie one after the other."""

import math
import pickle
import zlib
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from io import BytesIO
from typing import Any, NamedTuple

import numpy as np

from estimators.engine import machine
from estimators.engine.emit import Emitter, Module, is_literal, literal, type_of
from estimators.engine.linear_emit import LinearEmitter
from estimators.engine.matching import Call, described, in_memory, matcher
from estimators.engine.matrix_emit import Index, Matrix
from estimators.engine.program import Instruction, Program, View
from estimators.engine.tracer import KINDS, Tracer, cast, operation, where

LANES = 8
"""Rows side by side in a batch; a row alone has a program of its own."""
FEW = 4
"""Rows from which on vectors are worth it."""
# instructions, above which those of matrices are all calls: LLVM's time grows faster than a function
_LONG = 400
_LARGEST = (
    1 << 14
)  # bytes of scratch a row, above which rows are computed one by one, each a vector of its entries
_LARGEST_SOLVED = 1 << 17  # where scalars would be computed one after the other otherwise
_SOLVING = frozenset(
    (
        "solve",
        "eliminate",
        "cholesky",
        "semidefinite cholesky",
        "solve lower",
        "solve upper",
        "rotate",
    )
)


class Argument(NamedTuple):
    """An argument of a compiled function: the shape and kind of its rows."""

    shape: tuple[int, ...]
    kind: str = "f"

    @property
    def size(self) -> int:
        """Entries of a row."""
        return int(np.prod(self.shape, dtype=int))


_broadcast = lru_cache(np.broadcast_shapes)


class Function:
    """A program, compiled for one row and for many when it is first needed for as many.

    Args:
        program: What it computes; its instructions ``input`` and ``input matrix`` read the
            arguments.
        arguments: Rows of what it takes.
        outputs: For each result its scalars and views of matrices, one after the other, and an
            argument like it.

    Attributes:
        layout: Where matrices stand.
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
        self._instructions: tuple[Instruction, ...] | bytes = program.complete(values)
        self.layout = Layout(program, self.instructions, values)
        largest = (
            _LARGEST
            if _SOLVING.isdisjoint(each.opcode for each in self.instructions)
            else _LARGEST_SOLVED
        )
        self._wide = LANES if self.layout.size * 8 <= largest else 1
        self._places, self._constants = _placed(program)
        self._entries: dict[int, Callable[..., None]] = {}
        self._last: Call | None = None
        self._shapes: list[
            tuple[int, ...]
        ] = []  # of the arguments before, as few are worth describing

    def compute(self, arrays: Sequence[Any]) -> Sequence[np.ndarray]:
        """Results of arrays that have one batch, or none where all rows share them."""
        results = self.repeated(arrays)
        return self.prepared(list(map(in_memory, arrays))) if results is None else results

    def repeated(self, arrays: Sequence[Any]) -> Sequence[np.ndarray] | None:
        """The same of arguments like those of the last call, which need no preparation; None: they are others."""
        last = self._last
        if last is None or (results := last.fresh(last.described, *arrays)) is None:
            return None
        last.run(*arrays, *results)
        return results

    def prepared(self, arrays: list[np.ndarray]) -> Sequence[np.ndarray]:
        """The same of arrays `in_memory`, unlike those of the last call; of axes that differ they are repeated."""
        leading = [
            a.shape[: a.ndim - len(own.shape)]
            for a, own in zip(arrays, self.arguments, strict=True)
        ]
        batch: tuple[int, ...] = ()
        for axes in leading:
            if axes != batch and axes:
                batch = _broadcast(batch, axes)
        rows, shared = math.prod(batch), 0
        for i, axes in enumerate(leading):
            if axes != batch:
                if any(n != 1 for n in axes):
                    whole = np.empty(batch + arrays[i].shape[len(axes) :], arrays[i].dtype)
                    whole[...] = arrays[i]
                    arrays[i] = whole
                else:
                    shared |= 1 << i
        results = [np.empty(batch + row.shape, KINDS[row.kind]) for row in self.results]
        if rows:
            self(rows, shared, *arrays, *results)
            shapes = [array.shape for array in arrays]
            if shapes == self._shapes:
                run, (width, entry) = partial(self, rows, shared), self._entry(rows)
                if self.stacked(width):
                    run = partial(entry, rows, shared, self._constants, self._constants)
                self._last = Call(
                    matcher(), described(arrays, results), [a.dtype for a in arrays], run
                )
            self._shapes = shapes
        return results

    def __call__(self, rows: int, shared: int, *arrays: np.ndarray) -> None:
        """Compute rows of arrays.

        Args:
            rows: How many.
            shared: Bits of the arguments that have one row for all.
            arrays: The arguments and the results, in C order and of the types that they have here.
                Nothing is checked.
        """
        width, entry = self._entry(rows)
        entry(rows, shared, machine.scratch(width * self.layout.size), self._constants, *arrays)

    def stacked(self, width: int) -> bool:
        """Do the matrices of so many rows side by side stand on the stack, where they need no scratch?"""
        return 8 * width * self.layout.size <= _LARGEST

    def _entry(self, rows: int) -> tuple[int, Callable[..., None]]:
        """Number of rows side by side where there are so many, and the machine code."""
        width = self._wide if rows >= FEW else 1
        return width, self._entries.get(width) or self.compiled(width)

    @property
    def instructions(self) -> tuple[Instruction, ...]:
        """Instructions of the program that its outputs need, in order; compressed once there is machine code."""
        kept = self._instructions
        return (
            tuple(map(Instruction._make, pickle.loads(zlib.decompress(kept))))
            if isinstance(kept, bytes)
            else kept
        )

    def compiled(self, width: int) -> Callable[..., None]:
        """The machine code for so many rows side by side, which programs that differ in numbers alone share."""
        program, instructions = (
            self.program,
            _serialised([*map(tuple, self.instructions)]),
        )  # faster than records
        literals = [
            (value, literal(x, program.kinds[value], 1))
            for value, x in program.constants.items() if value not in self._places
        ]  # fmt: skip
        code = _serialised((
            self.outputs, self.arguments, self.results, width, literals, self._places, program.sizes,
            program.kinds,
        ))  # fmt: skip
        entry = machine.load(instructions + code, lambda: self.text(width))
        self._instructions = zlib.compress(
            instructions, level=1
        )  # a twentieth: tuples of a program take megabytes
        self._entries[width] = entry
        return entry

    def text(self, width: int) -> str:
        """The program in LLVM IR."""
        module, instructions = Module(self._places), self.instructions
        emitter = Driver(self, module, width)
        if len(instructions) > _LONG:
            emitter.inlined = 0
        entry = _entry_point(2 + len(self.arguments) + len(self.results))
        return module.text([emitter.function(instructions, self.outputs), entry])


def _serialised(value: Any) -> bytes:
    """Bytes of a value, the same of equal parts, which need not be one object as they would with a memo."""
    file = BytesIO()
    pickler = pickle.Pickler(file, protocol=5)
    pickler.fast = True
    pickler.dump(value)
    return file.getvalue()


def _entry_point(pointers: int) -> str:
    """The module's Python function, in LLVM IR: a call through ctypes would take longer than most programs.

    It takes two whole numbers and so many arrays of NumPy, whose data begin where their object
    says, right behind the head that all objects have (``PyArrayObject_fields``). It looks at
    nothing else of them: their owner has checked them. While it computes many rows, other threads
    of Python run.
    """
    emitter = Emitter(Program(), Module({}), 1)
    numbers = [
        emitter.line(f"call i64 @PyLong_AsSsize_t(ptr {emitter.pointer('%args', 8 * i)})")
        for i in range(2)
    ]
    arrays = [
        emitter.pointer(emitter.pointer("%args", 8 * i + 16), object.__basicsize__)
        for i in range(pointers)
    ]
    return "\n".join([
        "declare i64 @PyLong_AsSsize_t(ptr)", "declare ptr @PyEval_SaveThread()", "declare void @Py_IncRef(ptr)",
        "declare void @PyEval_RestoreThread(ptr)", "@_Py_NoneStruct = external global i8",
        "define ptr @call(ptr %self, ptr %args, i64 %count) {", "entry:", *emitter.lines,
        f"  %many = icmp sge i64 {numbers[0]}, {FEW}", "  br i1 %many, label %release, label %compute",
        "release:", "  %released = call ptr @PyEval_SaveThread()", "  br label %compute",
        "compute:", "  %thread = phi ptr [null, %entry], [%released, %release]",
        f"  call void @run({', '.join([f'i64 {each}' for each in numbers] + [f'ptr {each}' for each in arrays])})",
        "  br i1 %many, label %restore, label %done",
        "restore:", "  call void @PyEval_RestoreThread(ptr %thread)", "  br label %done",
        "done:", "  call void @Py_IncRef(ptr @_Py_NoneStruct)", "  ret ptr @_Py_NoneStruct", "}",
    ])  # fmt: skip


def _placed(program: Program) -> tuple[dict[int, int], np.ndarray]:
    """The numbers that a program reads from memory, and where those of each constant begin."""
    read = {
        value: (x,)
        for value, x in program.constants.items()
        if not is_literal(x, program.kinds[value])
    }
    numbers = read | program.tables
    starts = np.cumsum([0, *map(len, numbers.values())]).tolist()
    return dict(zip(numbers, starts, strict=False)), np.concatenate([*numbers.values(), ()])


class Layout:
    """Places of a program's matrices in its scratch; one that is needed no longer gives its place to another."""

    def __init__(
        self, program: Program, instructions: Sequence[Instruction], outputs: Sequence[int]
    ) -> None:
        self.places: dict[int, int] = {}
        self.temporary: dict[int, int] = {}  # of instructions that need room besides
        self.size = 0
        if program.sizes.keys() == program.tables.keys():  # scalars alone
            return
        last = {value: at for at, each in enumerate(instructions) for value in each.values}
        last |= {value: len(instructions) for value in outputs}
        free: dict[int, list[int]] = {}
        for at, each in enumerate(instructions):
            size = program.sizes.get(each.result)
            if size is not None:
                self.places[each.result] = self._placed(size, free)
            if each.opcode in ROOM:
                extra = each.attributes[-1]
                self.temporary[each.result] = self._placed(extra, free)
                free.setdefault(extra, []).append(self.temporary[each.result])
            for value in {*each.values, *each.results}:
                if last.get(value, at) == at and value in self.places:
                    free.setdefault(program.sizes[value], []).append(self.places[value])

    def _placed(self, size: int, free: dict[int, list[int]]) -> int:
        if free.get(size):
            return free[size].pop()
        self.size += size
        return self.size - size


ROOM = frozenset(("matmul", "solve", "eliminate"))
"""Opcodes whose last attribute is how many numbers they need besides their results."""


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
        given = [*(f"i64 %{each}" for each in ("end", "shared")), "ptr noalias %scratch"]
        if self._function.stacked(self.width):
            given[-1] = "ptr %unused"
            self.lines.insert(
                0,
                f"  %scratch = alloca [{self.width * self._function.layout.size} x double],"
                " align 64",
            )
        given.append("ptr noalias readonly %constants")
        given += [f"ptr %a{i}" for i in range(len(arguments))] + [
            f"ptr %o{i}" for i in range(len(results))
        ]
        return "\n".join(
            [
                f"define internal void @run({', '.join(given)}) #0 {{\nentry:",
                *self.lines,
                "  ret void\n}",
            ]
        )

    def emitter(self, program: Program, layout: Any) -> LinearEmitter:
        """Emitter of the body of an outlined function, which has no rows of its own."""
        return LinearEmitter(program, self.module, self.width, layout)

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
        return self._gathered(
            self._bases[argument], column, self._function.arguments[argument].kind
        )

    def _gathered(self, bases: Sequence[str], column: Any, kind: str) -> Tracer:
        """An entry of the rows that begin at these addresses."""
        memory = _MEMORY[kind]

        def one(lane: int) -> str:
            place = self.at(bases[lane], column, memory)
            return self.line(f"load {memory}, ptr {place}, align {_ALIGN[kind]}")

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
        size, kind = self.program.sizes[instruction.result], self._function.arguments[argument].kind
        bases = self._bases[argument]
        if self.width == 1 and kind == "f":  # as it stands in its row
            self.pointers[instruction.result] = self.at(bases[0], column)
        else:
            self._take(self.matrix(instruction.result, (1, size)), bases, column, kind)

    def _take(self, target: Matrix, bases: Sequence[str], column: int, kind: str) -> None:
        """Neighbouring columns of rows as a matrix, of floats eight columns at a time."""

        def some(j: Index, count: int) -> None:
            if count == self.width and kind == "f":
                entries = self._transposed(
                    [self.read(self.at(base, j + column), count) for base in bases]
                )
            else:
                entries = [self._gathered(bases, j + column + m, kind) for m in range(count)]
            for m, entry in enumerate(entries):
                target[0, j + m] = entry

        self.chunks(target.shape[1], LANES if kind == "f" else 1, some)

    def _transposed(self, rows: Sequence[Tracer]) -> list[Tracer]:
        """The columns of a square matrix: its blocks change places, smaller ones from turn to turn."""
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
            if not isinstance(part, View):
                self._stored(self.scalar(part), kind, bases, column)
                column += 1
                continue
            rows, columns = part.shape
            if part.steps == (columns, 1):  # it lies in one piece
                rows, columns, part = (
                    1,
                    rows * columns,
                    View(part.value, (1, rows * columns), part.start, (0, 1)),
                )

            def some(
                i: Index, j: Index, count: int, part: View = part, first: int = column
            ) -> None:
                entries = [self.load(part, i, j + m) for m in range(count)]
                at = first + i * part.shape[1] + j
                if count == self.width and kind == "f":
                    for entry, base in zip(self._transposed(entries), bases, strict=True):
                        self.lines.append(
                            f"  store {type_of('f', count)} {self.own.name(entry)}, ptr"
                            f" {self.at(base, at)}, align 8"
                        )
                else:
                    for m, entry in enumerate(entries):
                        self._stored(entry, kind, bases, at + m)

            def row(i: Any, some: Any = some, n: int = columns) -> None:
                self.chunks(n, LANES, partial(some, i))

            self.each(0, rows, row)
            column += rows * columns

    def _stored(self, x: Tracer, kind: str, bases: Sequence[str], column: Any) -> None:
        memory, value = _MEMORY[kind], self.own.name(cast(x, kind))
        if kind == "b":
            R = "i8" if self.width == 1 else f"<{self.width} x i8>"
            value = self.line(f"zext {type_of('b', self.width)} {value} to {R}")
        for lane, base in enumerate(bases):
            place = self.at(base, column, memory)
            self.lines.append(
                f"  store {memory} {self.lane(value, memory, lane)}, ptr {place}, align"
                f" {_ALIGN[kind]}"
            )


_MEMORY = {"f": "double", "i": "i64", "u": "i64", "b": "i8"}
_ALIGN = {"f": 8, "i": 8, "u": 8, "b": 1}
