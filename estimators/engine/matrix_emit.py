"""Instructions of matrices as loops in LLVM IR with constant bounds, over entries whose rows stand side by side."""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from estimators.engine.arrays import SCALAR_FUNCTIONS
from estimators.engine.emit import Emitter, Module, type_of
from estimators.engine.program import Columns, Instruction, Program, View
from estimators.engine.tracer import Tracer, cast, constant

CHUNK = 8
"""Numbers in a vector, and partial sums of an inner product: part of its definition."""
_UNROLLED = 16  # entries up to which there is no loop
_OUTLINED = frozenset((
    "each", "join", "matmul", "inner", "solve", "solve lower", "solve upper", "cholesky",
    "semidefinite cholesky", "rotate",
))  # fmt: skip
_NONE = np.zeros(0)
Index = Any
"""A whole number, or the tracer of one."""


class Matrix:
    """A matrix in memory, whose entries are numbers of all rows that are side by side.

    Args:
        emitter: Emits what is read and written.
        view: Its place.
        count: Entries of a row of the matrix that are read and written together, as lanes of
            vectors.
    """

    def __init__(self, emitter: "MatrixEmitter", view: View, count: int = 1) -> None:
        self._emitter, self.view, self._count = emitter, view, count
        self.shape = view.shape

    def __getitem__(self, at: tuple[Index, Index]) -> Tracer:
        return self._emitter.load(self.view, *at, self._count)

    def __setitem__(self, at: tuple[Index, Index], x: Any) -> None:
        emitter = self._emitter
        lanes: Any = (
            x.program if isinstance(x, Tracer) else emitter.lanes(emitter.width * self._count)
        )
        x = cast(constant(lanes, x), "f")
        place = emitter.address(self.view.value, _entry(self.view, *at))
        emitter.lines.append(
            f"  store {type_of('f', lanes.width)} {lanes.name(x)}, ptr {place}, align 8"
        )


def _entry(view: View, i: Index, j: Index) -> Index:
    """Index in the value of an entry of a view."""
    entry = view.start
    for index, step in zip((i, j), view.steps, strict=True):
        entry = entry + index * step if step else entry
    return entry


class MatrixEmitter(Emitter):
    """Entry e of a matrix is the vector at ``scratch + (place + e) * width``; tables have one number for all rows."""

    def __init__(
        self, program: Program, module: Module, width: int, places: dict[int, int]
    ) -> None:
        super().__init__(program, module, width)
        self.places_of = places
        self.pointers: dict[int, str] = {}
        self.inlined = _UNROLLED  # entries of the operands up to which there is no call
        self.special |= {
            "each": self._each, "element": self._element, "pack": self._pack, "join": self._join,
            "columns": self._columns,
        }  # fmt: skip

    # --- memory -----------------------------------------------------------------------------------

    def address(self, value: int, entry: Index) -> str:
        """Address of an entry of a matrix."""
        table = value in self.program.tables
        if value in self.pointers:
            return self.at(self.pointers[value], entry * (1 if table else self.width))
        if table:
            return self.constant(value, entry)
        return self.at("%scratch", (entry + self.places_of[value]) * self.width)

    def load(self, view: View | int, i: Index = 0, j: Index = 0, count: int = 1) -> Tracer:
        """Neighbouring entries of a view from one on, or a scalar in as many lanes, as numbers."""
        width = self.width * count
        value = view if isinstance(view, int) else view.value
        if value >= 0 and value not in self.program.sizes:
            if value in self.program.constants and value not in self.module.places:
                return constant(self.lanes(width), float(self.program.constants[value]))
            return self.spread(cast(self.scalar(value), "f"), width)
        assert isinstance(view, View)
        place = self.address(value, _entry(view, i, j))
        if value in self.program.tables and self.width > 1:
            return self.spread(self.read(place, 1), width)
        moving = view.steps[1] == 1 and view.shape[1] > 1
        return self.spread(self.read(place, width if moving else self.width), width)

    def matrix(self, value: int, shape: tuple[int, int], start: int = 0) -> Matrix:
        """A value as a matrix, row by row."""
        return Matrix(self, View(value, shape, start, (shape[1], 1)))

    def over(self, rows: int, columns: int, body: Callable[[Index, Index], None]) -> None:
        """A body for each entry, unrolled where they are few."""
        if rows * columns <= _UNROLLED:
            for i in range(rows):
                for j in range(columns):
                    body(i, j)
            return
        self.each(0, rows, lambda i: self.each(0, columns, lambda j: body(i, j)))

    def each(
        self, first: Index, count: Index, body: Callable[[Index], None], step: int = 1
    ) -> None:
        """A body for each index."""
        if isinstance(count, int) and isinstance(first, int) and (first, count) == (0, 1):
            body(0)
        else:
            self.loop(first, count, body, step=step)

    def chunks(
        self, count: int, size: int, body: Callable[[Index, int], None], unrolled: int = 1
    ) -> None:
        """A body for so many neighbours at a time, and for those that are left; few chunks are unrolled."""
        whole = count // size * size
        if whole > unrolled * size:
            self.each(0, whole, lambda j: body(j, size), step=size)
        else:
            for j in range(0, whole, size):
                body(j, size)
        if count > whole:
            body(whole, count - whole)

    def total(
        self, first: Tracer, low: Index, high: Index, term: Callable[[Index, Tracer], Any]
    ) -> Tracer:
        """Fold a term over indices, beginning with a number."""
        return self.loop(low, high, lambda k, total: [term(k, total)], [first])[0]

    # --- functions --------------------------------------------------------------------------------

    def specially(self, instruction: Instruction) -> None:
        """An instruction of matrices, as a call of a function where it is long."""
        entries = sum(
            math.prod(each.shape) for each in instruction.operands if isinstance(each, View)
        )
        if instruction.opcode not in _OUTLINED or entries <= self.inlined:
            super().specially(instruction)
            return
        name, T = self._outlined(instruction), type_of("f", self.width)
        given = [
            f"ptr {self.address(each.value, each.start)}" if isinstance(each, View)
            else f"{T} {self.own.name(self.load(each))}"
            for each in instruction.operands
        ]  # fmt: skip
        given.append(f"ptr {self.address(instruction.result, 0)}")
        self.lines.append(f"  call void {name}({', '.join(given)})")

    def emitter(self, program: Program, places: dict[int, int]) -> "MatrixEmitter":
        """Emitter of the body of an outlined function."""
        return type(self)(program, self.module, self.width, places)

    def _outlined(self, instruction: Instruction) -> str:
        """The function of an instruction, one for all of its kind whose operands have the same shapes and steps."""
        shapes = [
            (
                (each.shape, each.steps, each.value in self.program.tables)
                if isinstance(each, View)
                else None
            )
            for each in instruction.operands
        ]
        same = [instruction.operands.index(each) for each in instruction.operands]
        key = str((instruction.opcode, instruction.attributes, shapes, same, self.width))
        if key in self.module.outlined:
            return self.module.outlined[key]
        name = self.module.outlined[key] = (
            f"@{instruction.opcode.replace(' ', '_')}.{len(self.module.outlined)}"
        )
        program = Program()
        operands: list[int | View] = []
        parameters: list[str] = []
        emitter = self.emitter(program, {})
        for i, each in enumerate(instruction.operands):
            parameters.append(
                f"{'ptr' if isinstance(each, View) else type_of('f', self.width)} %p{i}"
            )
            if same[i] < i:
                operands.append(operands[same[i]])
            elif isinstance(each, View):
                value = program.new("f", math.prod(each.shape))
                emitter.pointers[value] = f"%p{i}"
                if each.value in self.program.tables:
                    program.tables[value] = _NONE
                operands.append(View(value, each.shape, 0, each.steps))
            else:
                operands.append(program.new("f"))
                emitter.names[len(program.kinds) - 1] = f"%p{i}"
        result = program.new("f", self.program.sizes[instruction.result])
        emitter.pointers[result] = "%r"
        parameters.append("ptr noalias %r")
        emitter.special[instruction.opcode](
            instruction._replace(operands=tuple(operands), result=result)
        )
        head = f"define internal void {name}({', '.join(parameters)}) noinline nounwind {{\nentry:"
        self.module.functions[name] = "\n".join([head, *emitter.lines, "  ret void\n}"])
        return name

    # --- entry by entry ---------------------------------------------------------------------------

    def _element(self, instruction: Instruction) -> None:
        place: Any = instruction.operands[0]
        value = cast(self.load(place), self.program.kinds[instruction.result])
        self.names[instruction.result] = self.own.name(value)

    def _pack(self, instruction: Instruction) -> None:
        target = self.matrix(instruction.result, (1, len(instruction.operands)))
        for j, value in enumerate(instruction.operands):
            target[0, j] = self.load(value)

    def _join(self, instruction: Instruction) -> None:
        places, width = instruction.attributes
        views: Any = instruction.operands
        for view, place in zip(views, places, strict=True):
            self.copy(view, Matrix(self, View(instruction.result, view.shape, place, (width, 1))))

    def copy(self, view: View, target: Matrix) -> None:
        """Copy a matrix to where another one stands."""

        def one(i: Index, j: Index) -> None:
            target[i, j] = self.load(view, i, j)

        self.over(*view.shape, one)

    def fill(self, target: Matrix, value: float) -> None:
        """The same number in all entries."""

        def one(i: Index, j: Index) -> None:
            target[i, j] = value

        self.over(*target.shape, one)

    def _each(self, instruction: Instruction) -> None:
        name, kinds, rows, columns = instruction.attributes
        function, operands = SCALAR_FUNCTIONS[name], instruction.operands
        target, views = (
            self.matrix(instruction.result, (rows, columns)).view,
            [each for each in operands if isinstance(each, View)],
        )
        if rows > 1 and all(
            each.shape == (rows, columns) and each.steps == (columns, 1) for each in views
        ):  # they lie in one piece
            rows, columns = 1, rows * columns
            target = View(target.value, (1, columns), 0, (0, 1))
            operands = tuple(
                View(each.value, (1, columns), each.start, (0, 1))
                if isinstance(each, View)
                else each
                for each in operands
            )
        together = self.width == 1 and all(
            each.steps[1] == min(each.shape[1] - 1, 1) for each in views
        )
        scalars = {each: self.load(each) for each in operands if isinstance(each, int)}

        def some(i: Index, j: Index, count: int) -> None:
            loaded = [
                self.load(each, i, j, count) if isinstance(each, View)
                else self.spread(scalars[each], self.width * count)
                for each in operands
            ]  # fmt: skip
            Matrix(self, target, count)[i, j] = function(*map(cast, loaded, kinds))

        def chunk(i: Index, j: Index, count: int) -> None:
            if count == CHUNK:
                some(i, j, count)
            else:
                for m in range(count):
                    some(i, j + m, 1)

        if together and columns > 4:
            self.each(0, rows, lambda i: self.chunks(columns, CHUNK, partial(chunk, i)))
        else:
            self.over(rows, columns, lambda i, j: some(i, j, 1))

    def _columns(self, instruction: Instruction) -> None:
        """A function of columns: of a batch one after the other, of one row eight side by side."""
        loop: Columns = instruction.attributes[0]
        count, size = len(loop.parameters), loop.size // max(loop.blocks, 1)
        views: Any = instruction.operands[:count]
        together = self.width == 1 and size >= CHUNK and all(view.steps[1] == 1 for view in views)
        width = CHUNK if together else self.width

        def some(first: Index, at: Index) -> None:
            j = at
            if together:  # the last ones begin before the end, and compute some again
                last = self.one.name(at * CHUNK), str(size - CHUNK)
                j = self.one.value(self.call("smin", "ii", 1, *last), "i")
            j = first + j
            inside = Emitter(self.program, self.module, width, self)
            for value in instruction.operands[count + (loop.blocks > 0) :]:
                if value not in self.program.constants:
                    inside.names[value] = inside.own.name(self.spread(self.scalar(value), width))  # type: ignore[arg-type, index]
            for view, parameters in zip(views, loop.parameters, strict=True):
                for i, value in enumerate(parameters):
                    inside.names[value] = inside.own.name(
                        self.load(view, i, j, width // self.width)
                    )
            inside.block(loop.body)
            found = [inside.name(value) for value in loop.results]
            start, step, lanes = j, loop.size, inside.own
            if loop.interleaved:
                start, step = j * len(found), 1
                if together:
                    found, lanes = [self._interleaved(found)], self.lanes(width * len(found))
            target = self.matrix(instruction.result, (1, loop.size * len(loop.results)))
            for i, name in enumerate(found):
                target[0, start + i * step] = lanes.value(name)

        def block(b: Index) -> None:
            passes: Index = -(-size // CHUNK) if together else size
            if loop.blocks:
                mask: Any = instruction.operands[count]
                passes = cast(self.any(cast(self.load(mask, 0, b), "b")), "i") * passes
            self.each(0, passes, lambda at: some(b * size, at))

        self.each(0, max(loop.blocks, 1), block)

    def _interleaved(self, vectors: Sequence[str]) -> str:
        """The first entries of some vectors of a row, as many as a power of two, then the second ones, and so on."""
        if len(vectors) == 1:
            return vectors[0]
        pair = [self._interleaved(vectors[first::2]) for first in range(2)]
        count = CHUNK * len(vectors) // 2
        T, order = type_of("f", count), ", ".join(f"i32 {i}, i32 {i + count}" for i in range(count))
        return self.line(
            f"shufflevector {T} {pair[0]}, {T} {pair[1]}, <{2 * count} x i32> <{order}>"
        )
