"""Instructions of matrices as loops in LLVM IR with constant bounds, over entries whose rows stand side by side."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from estimators.engine.emit import Emitter, Module, literal, type_of
from estimators.engine.matrices import GIVE_MASKS
from estimators.engine.program import Columns, Instruction, Program, View

CHUNK = 8
"""Numbers in a vector, and partial sums of an inner product: part of its definition."""
_UNROLLED = 16  # entries up to which there is no loop
_MASKED = ("and", "or", "not")
_OUTLINED = frozenset((
    "each", "join", "matmul", "inner", "symmetrise", "solve", "eliminate", "solve lower", "solve upper", "cholesky",
    "semidefinite cholesky", "rotate",
))  # fmt: skip
_NONE = np.zeros(0)
Index = int | str


class _Own(NamedTuple):
    """The layout of an outlined function, whose matrices are its arguments."""

    places: dict[int, int]
    temporary: dict[int, int]


class MatrixEmitter(Emitter):
    """Entry e of a matrix is the vector at ``scratch + (place + e) * width``; tables have one number for all rows."""

    def __init__(self, program: Program, module: Module, width: int, layout: Any) -> None:
        super().__init__(program, module, width)
        self.layout = layout
        self.pointers: dict[int, str] = {}
        self.inlined = _UNROLLED  # entries of the operands up to which there is no call
        self.T, self.mask = type_of("f", width), type_of("b", width)
        self.special |= {
            "each": self._each, "element": self._element, "pack": self._pack, "join": self._join,
            "lookup matrix": self._lookup_matrix, "columns": self._columns,
        }  # fmt: skip

    # --- memory -------------------------------------------------------------------------------------

    def plus(self, a: Index, b: Index) -> Index:
        """A sum of indices."""
        if isinstance(a, int) and isinstance(b, int):
            return a + b
        if a == 0 or b == 0:
            return b if a == 0 else a
        return self.line(f"add i64 {a}, {b}")

    def times(self, a: Index, b: int) -> Index:
        """A product of an index and a number."""
        if isinstance(a, int):
            return a * b
        return 0 if b == 0 else a if b == 1 else self.line(f"mul i64 {a}, {b}")

    def index(self, view: View, i: Index, j: Index) -> Index:
        """Which entry of its value an entry of a view is."""
        return self.plus(view.start, self.plus(self.times(i, view.steps[0]), self.times(j, view.steps[1])))

    def address(self, value: int, entry: Index) -> str:
        """Where an entry of a matrix stands."""
        if value in self.pointers:
            lanes = 1 if value in self.program.tables else self.width
            return self.line(f"getelementptr double, ptr {self.pointers[value]}, i64 {self.times(entry, lanes)}")
        if value in self.program.tables:
            return self.constant(value, entry)
        place = self.times(self.plus(self.layout.places[value], entry), self.width)
        return self.line(f"getelementptr double, ptr %scratch, i64 {place}")

    def load(self, view: View | int, i: Index = 0, j: Index = 0) -> str:
        """An entry of a view, or a scalar, as a number."""
        if isinstance(view, int):
            name = self.name(view)
            return (
                name if self.program.kinds[view] == "f" else self.cast(name, self.program.kinds[view], "f", self.width)
            )
        if view.value >= 0 and view.value not in self.program.sizes:  # a scalar that stands for a matrix
            return self.load(view.value)
        place = self.address(view.value, self.index(view, i, j))
        if view.value in self.program.tables:
            return self.splat(self.line(f"load double, ptr {place}, align 8"), self.width)
        return self.line(f"load {self.T}, ptr {place}, align 8")

    def store(self, x: str, value: int, entry: Index) -> None:
        """Put a number into an entry of a matrix."""
        self.lines.append(f"  store {self.T} {x}, ptr {self.address(value, entry)}, align 8")

    def store_at(self, x: str, view: View, i: Index, j: Index) -> None:
        """Put a number into an entry of a view."""
        self.store(x, view.value, self.index(view, i, j))

    def temporary(self, instruction: Instruction) -> int:
        """A matrix for the time of an instruction."""
        value = -1 - instruction.result
        self.layout.places[value] = self.layout.temporary[instruction.result]
        return value

    def over(self, rows: int, columns: int, body: Callable[[Index, Index], None]) -> None:
        """A body for each entry, unrolled where they are few."""
        if rows * columns <= _UNROLLED:
            for i in range(rows):
                for j in range(columns):
                    body(i, j)
            return
        self.each(0, rows, lambda i: self.each(0, columns, lambda j: body(i, j)))

    def each(self, first: Index, count: Index, body: Callable[[Index], None], step: int = 1) -> None:
        """A body for each index."""
        if count == 1 and first == 0:
            body(0)
            return

        def carried(i: str) -> tuple[()]:
            body(i)
            return ()

        self.loop(first, count, carried, step=step)

    def chunks(self, count: int, size: int, body: Callable[[Index, int], None], unrolled: int = 1) -> None:
        """A body for so many neighbours at a time, and for those that are left; few chunks are unrolled."""
        whole = count // size * size
        if whole > unrolled * size:
            self.each(0, whole, lambda j: body(j, size), step=size)
        else:
            for j in range(0, whole, size):
                body(j, size)
        if count > whole:
            body(whole, count - whole)

    def total(self, first: str, low: Index, high: Index, term: Callable[[str, str], str]) -> str:
        """What a term makes of a number, index by index."""
        return self.loop(low, high, lambda k, total: [term(k, total)], [first], [self.T])[0]

    # --- functions ----------------------------------------------------------------------------------

    def specially(self, instruction: Instruction) -> None:
        """An instruction of matrices, as a call of a function where it is long."""
        entries = sum(math.prod(each.shape) for each in instruction.operands if isinstance(each, View))
        if instruction.opcode not in _OUTLINED or entries <= self.inlined:
            super().specially(instruction)
            return
        name = self._outlined(instruction)
        given = [
            f"ptr {self.address(each.value, each.start)}" if isinstance(each, View) else f"{self.T} {self.load(each)}"
            for each in instruction.operands
        ]
        given.append(f"ptr {self.address(instruction.result, 0)}")
        if instruction.result in self.layout.temporary:
            given.append(f"ptr {self.address(self.temporary(instruction), 0)}")
        self.lines.append(f"  call void {name}({', '.join(given)})")

    def emitter(self, program: Program, layout: Any) -> "MatrixEmitter":
        """What emits the body of an outlined function."""
        return type(self)(program, self.module, self.width, layout)

    def _outlined(self, instruction: Instruction) -> str:
        """The function of an instruction, one for all of its kind whose operands have the same shapes and steps."""
        shapes = [
            (each.shape, each.steps, each.value in self.program.tables) if isinstance(each, View) else None
            for each in instruction.operands
        ]
        same = [instruction.operands.index(each) for each in instruction.operands]
        key = str((instruction.opcode, instruction.attributes, shapes, same, self.width))
        if key not in self.module.outlined:
            name = f"@{instruction.opcode.replace(' ', '_')}.{len(self.module.outlined)}"
            self.module.outlined[key] = name
            program, own = Program(), _Own({}, {})
            operands: list[int | View] = []
            parameters: list[str] = []
            emitter = self.emitter(program, own)
            for i, each in enumerate(instruction.operands):
                if same[i] < i:
                    operands.append(operands[same[i]])
                    parameters.append(f"{'ptr' if isinstance(each, View) else self.T} %p{i}")
                    continue
                value = program.new("f", math.prod(each.shape) if isinstance(each, View) else None)
                if isinstance(each, View):
                    emitter.pointers[value] = f"%p{i}"
                    if each.value in self.program.tables:
                        program.tables[value] = _NONE
                    parameters.append(f"ptr %p{i}")
                    operands.append(View(value, each.shape, 0, each.steps))
                else:
                    emitter.names[value] = f"%p{i}"
                    parameters.append(f"{self.T} %p{i}")
                    operands.append(value)
            result = program.new("f", self.program.sizes[instruction.result])
            emitter.pointers[result], parameters = "%r", [*parameters, "ptr noalias %r"]
            if instruction.result in self.layout.temporary:
                own.temporary[result], parameters = 0, [*parameters, "ptr noalias %t"]
                emitter.pointers[-1 - result] = "%t"
            emitter.special[instruction.opcode](
                Instruction(instruction.opcode, tuple(operands), result, instruction.attributes)
            )
            head = f"define internal void {name}({', '.join(parameters)}) noinline nounwind {{\nentry:"
            self.module.functions[name] = "\n".join([head, *emitter.lines, "  ret void\n}"])
        return self.module.outlined[key]

    # --- entry by entry -----------------------------------------------------------------------------

    def _element(self, instruction: Instruction) -> None:
        place: Any = instruction.operands[0]
        value = self.load(place)
        if self.program.kinds[instruction.result] == "b":
            value = self.line(f"fcmp une {self.T} {value}, {literal(0.0, 'f', self.width)}")
        self.names[instruction.result] = value

    def _pack(self, instruction: Instruction) -> None:
        for i, value in enumerate(instruction.operands):
            assert isinstance(value, int)
            self.store(self.load(value), instruction.result, i)

    def _join(self, instruction: Instruction) -> None:
        places, width = instruction.attributes
        for view, place in zip(instruction.operands, places, strict=True):
            assert isinstance(view, View)
            target = View(instruction.result, view.shape, place, (width, 1))
            self.copy(view, target)

    def target(self, instruction: Instruction, shape: tuple[int, int]) -> View:
        """The result of an instruction as a matrix."""
        return View(instruction.result, shape, 0, (shape[1], 1))

    def copy(self, view: View, target: View) -> None:
        """Copy a matrix to where another one stands."""
        self.over(*view.shape, lambda i, j: self.store_at(self.load(view, i, j), target, i, j))

    def _lookup_matrix(self, instruction: Instruction) -> None:
        value: Any = instruction.operands[0]
        place, count = instruction.attributes
        size = self.program.sizes[instruction.result]
        index = self.within(self.name(value), 0.0, count - 1.0, self.width)
        index = self.line(f"fptosi {self.T} {index} to {type_of('i', self.width)}")
        starts = [self.times(self.lane(index, "i64", lane), size) for lane in range(self.width)]

        def entry(_: Index, e: Index) -> None:
            def one(lane: int) -> str:
                at = self.constant(place, self.plus(starts[lane], e))
                return self.line(f"load double, ptr {at}, align 8")

            self.store(self.lanes(one, "double"), instruction.result, e)

        self.over(1, size, entry)

    def _columns(self, instruction: Instruction) -> None:
        """A function of columns: of a batch one after the other, of one row eight side by side."""
        loop: Columns = instruction.attributes[0]
        count, size = len(loop.parameters), loop.size // max(loop.blocks, 1)
        views: Any = instruction.operands[:count]
        together = self.width == 1 and size >= CHUNK and all(view.steps[1] == 1 for view in views)
        width = CHUNK if together else self.width
        T = type_of("f", width)

        def some(first: Index, at: Index) -> None:
            j: Index = at
            if together:  # the last ones begin before the end, and compute some again
                j = self.call("smin", "ii", 1, self.times(at, CHUNK), str(size - CHUNK))  # type: ignore[arg-type]
            j = self.plus(first, j)
            inside = Emitter(self.program, self.module, width, self)
            for value in instruction.operands[count + (loop.blocks > 0) :]:
                if value not in self.program.constants:
                    name = self.names[value]  # type: ignore[index]
                    inside.names[value] = inside.splat(name, width, self.program.kinds[value]) if together else name  # type: ignore[index]
            for view, parameters in zip(views, loop.parameters, strict=True):
                for i, value in enumerate(parameters):
                    if together:
                        place = self.address(view.value, self.index(view, i, j))
                        inside.names[value] = self.line(f"load {T}, ptr {place}, align 8")
                    else:
                        inside.names[value] = self.load(view, i, j)
            inside.block(loop.body)
            found = [inside.name(value) for value in loop.results]
            types, start, step = [T] * len(found), j, loop.size
            if loop.interleaved:
                start, step = self.times(j, len(found)), 1
                if together:
                    found, types = [self._interleaved(found)], [type_of("f", width * len(found))]
            for i, (name, kind) in enumerate(zip(found, types, strict=True)):
                place = self.address(instruction.result, self.plus(start, i * step))
                self.lines.append(f"  store {kind} {name}, ptr {place}, align 8")

        def block(b: Index) -> None:
            passes: Index = -(-size // CHUNK) if together else size
            if loop.blocks:
                mask: Any = instruction.operands[count]
                wanted = self.line(f"fcmp une {self.T} {self.load(mask, 0, b)}, {literal(0.0, 'f', self.width)}")
                passes = self.line(f"select i1 {self.any(wanted)}, i64 {passes}, i64 0")
            self.each(0, passes, lambda at: some(self.times(b, size), at))

        self.each(0, max(loop.blocks, 1), block)

    def _interleaved(self, vectors: Sequence[str]) -> str:
        """The first entries of some vectors of a row, as many as a power of two, then the second ones, and so on."""
        if len(vectors) == 1:
            return vectors[0]
        pair = [self._interleaved(vectors[first::2]) for first in range(2)]
        count = CHUNK * len(vectors) // 2
        T, order = type_of("f", count), ", ".join(f"i32 {i}, i32 {i + count}" for i in range(count))
        return self.line(f"shufflevector {T} {pair[0]}, {T} {pair[1]}, <{2 * count} x i32> <{order}>")

    def _each(self, instruction: Instruction) -> None:
        _opcode, rows, columns = instruction.attributes
        target = self.target(instruction, (rows, columns))
        views = [each for each in instruction.operands if isinstance(each, View)]
        if self.width == 1 and rows * columns > 4:
            lines, across = _contiguous(rows, columns, views)
            if across > 4:
                self._each_chunk(instruction, lines, across)
                return

        def one(i: Index, j: Index) -> None:
            operands = [self.load(each, i, j) for each in instruction.operands]
            self.store_at(self._applied(instruction, operands, self.width), target, i, j)

        self.over(rows, columns, one)

    def _each_chunk(self, instruction: Instruction, rows: int, columns: int) -> None:
        """Vectors of neighbouring entries of one row of the batch; what is left over one by one."""
        scalars = {each: self.load(each) for each in instruction.operands if isinstance(each, int)}
        flat = rows < instruction.attributes[1]  # all entries are neighbours, whatever their rows

        def chunk(i: Index, j: Index, width: int) -> None:
            T, operands = type_of("f", width), []
            for each in instruction.operands:
                if isinstance(each, int):
                    operands.append(self.splat(scalars[each], width))
                    continue
                moving = 1 if flat else each.steps[1] if each.shape[1] > 1 else 0
                own = View(each.value, each.shape, each.start, (each.steps[0], moving))
                place = self.address(each.value, self.index(own, i, j if moving else 0))
                if moving:
                    operands.append(self.line(f"load {T}, ptr {place}, align 8"))
                else:
                    operands.append(self.splat(self.line(f"load double, ptr {place}, align 8"), width))
            result = self._applied(instruction, operands, width)
            entry = self.plus(self.times(i, columns), j)
            self.lines.append(f"  store {T} {result}, ptr {self.address(instruction.result, entry)}, align 8")

        def some(i: Index, j: Index, count: int) -> None:
            for at, width in [(j, CHUNK)] if count == CHUNK else [(self.plus(j, m), 1) for m in range(count)]:
                chunk(i, at, width)

        self.each(0, rows, lambda i: self.chunks(columns, CHUNK, lambda j, count: some(i, j, count)))

    def _applied(self, instruction: Instruction, operands: list[str], width: int) -> str:
        """The opcode of numbers, of which masks are those that are not 0."""
        opcode, T = instruction.attributes[0], type_of("f", width)
        kinds = ["f"] * len(operands)
        for k in range(len(operands)):
            if opcode in _MASKED or (opcode == "where" and k == 0):
                operands[k] = self.line(f"fcmp une {T} {operands[k]}, {literal(0.0, 'f', width)}")
                kinds[k] = "b"
        result = self.operation(opcode, "".join(kinds), operands, width)
        return self.cast(result, "b", "f", width) if opcode in GIVE_MASKS else result


def _contiguous(rows: int, columns: int, views: Sequence[View]) -> tuple[int, int]:
    """Rows, and entries of each that are neighbours in all views, or the same for all."""
    if any(view.steps[1] not in (0, 1) or (view.steps[1] == 0 and view.shape[1] > 1) for view in views):
        return rows, 1
    if rows > 1 and all(view.shape == (rows, columns) and view.steps[0] == columns for view in views):
        return 1, rows * columns
    return rows, columns
