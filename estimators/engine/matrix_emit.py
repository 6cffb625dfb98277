"""Instructions of matrices as loops in LLVM IR, over entries whose rows stand side by side."""

from collections.abc import Callable
from copy import copy
from typing import Any

from estimators.engine.arrays import SCALAR_FUNCTIONS
from estimators.engine.emit import Emitter, Module, type_of
from estimators.engine.program import Columns, Instruction, Program, View
from estimators.engine.tracer import Tracer, cast, operation

CHUNK = 8
"""Numbers in a vector, and partial sums of an inner product, whose number defines its rounding."""
Index = Any
"""A whole number, or the tracer of one."""


class Matrix:
    """A matrix in memory, whose entries are numbers of all rows that are side by side.

    Args:
        emitter: Emitter of the loads and stores.
        view: Place of the matrix.
        count: Entries of a row of the matrix that are read and written together, as lanes of
            vectors.
    """

    def __init__(self, emitter: "MatrixEmitter", view: View, count: int = 1) -> None:
        self._emitter, self.view, self._count = emitter, view, count
        self.shape = view.shape

    def __getitem__(self, at: tuple[Index, Index]) -> Tracer:
        return self._emitter.load(self.view, *at, self._count)

    def __setitem__(self, at: tuple[Index, Index], x: Tracer) -> None:
        emitter = self._emitter
        lanes: Any = x.program
        x = cast(x, "f")
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
    """Emitter of programs with matrices.

    Entry e of a matrix is the vector at ``scratch + (place + e) * width``; tables have one number
    for all rows.
    """

    def __init__(
        self, program: Program, module: Module, width: int, places: dict[int, int]
    ) -> None:
        super().__init__(program, module, width)
        self.places_of = places
        self.pointers: dict[int, str] = {}

    # --- memory -----------------------------------------------------------------------------------

    def address(self, value: int, entry: Index) -> str:
        """Address of an entry of a matrix."""
        if value in self.pointers:  # of a row alone
            return self.at(self.pointers[value], entry)
        if value in self.program.tables:
            return self.constant(value, entry)
        return self.at("%scratch", (entry + self.places_of[value]) * self.width)

    def load(self, view: View | int, i: Index = 0, j: Index = 0, count: int = 1) -> Tracer:
        """Neighbouring entries of a view as numbers, or a scalar in as many lanes."""
        width = self.width * count
        if isinstance(view, int):
            return self.spread(cast(self.scalar(view), "f"), width)
        place = self.address(view.value, _entry(view, i, j))
        shared = view.value in self.program.tables  # by all rows
        moving = view.steps[1] == 1 and view.shape[1] > 1
        entries = self.read(place, (1 if shared else self.width) * (count if moving else 1))
        return self.spread(entries, width, each=shared)

    def matrix(self, value: int, shape: tuple[int, int], start: int = 0) -> Matrix:
        """A value as a matrix, row by row."""
        return Matrix(self, View(value, shape, start, (shape[1], 1)))

    def over(self, rows: int, columns: int, body: Callable[..., None], size: int = 1) -> None:
        """Emit a body for each entry, or for each ``size`` neighbours in a row and for the rest."""
        whole = columns // size * size

        def row(i: Index) -> None:
            self.loop(0, whole, lambda j: body(i, j, size), step=size)
            if columns > whole:
                body(i, whole, columns - whole)

        self.loop(0, rows, row)

    # --- entry by entry ---------------------------------------------------------------------------

    def _emit_element(self, instruction: Instruction) -> None:
        place: Any = instruction.operands[0]
        kind = self.program.kinds[instruction.result]
        self.scalars[instruction.result] = cast(self.load(place), kind).value

    def _emit_pack(self, instruction: Instruction) -> None:
        target = self.matrix(instruction.result, (1, len(instruction.operands)))
        for j, value in enumerate(instruction.operands):
            target[0, j] = self.load(value)

    def _emit_join(self, instruction: Instruction) -> None:
        places, width = instruction.attributes
        views: Any = instruction.operands
        for view, place in zip(views, places, strict=True):
            self.copy(view, Matrix(self, View(instruction.result, view.shape, place, (width, 1))))

    def copy(self, view: View, target: Matrix) -> None:
        """Copy a matrix to where another one stands."""

        def one(i: Index, j: Index, _: int) -> None:
            target[i, j] = self.load(view, i, j)

        self.over(*view.shape, one)

    def _emit_each(self, instruction: Instruction) -> None:
        name, kinds, rows, columns = instruction.attributes
        views: list[Any] = list(instruction.operands)
        whole = (rows, columns), (columns, 1)
        if all(isinstance(v, int) or (v.shape, v.steps) == whole for v in views):
            rows, columns = 1, rows * columns  # they lie in one piece
            views = [
                v if isinstance(v, int) else View(v.value, (1, columns), v.start, (0, 1))
                for v in views
            ]
        target = self.matrix(instruction.result, (rows, columns)).view
        together = self.width == 1 and all(
            isinstance(each, int) or each.steps[1] == min(each.shape[1] - 1, 1) for each in views
        )

        def some(i: Index, j: Index, count: int) -> None:
            loaded = [self.load(each, i, j, count) for each in views]
            result = SCALAR_FUNCTIONS[name](*map(cast, loaded, kinds))
            Matrix(self, target, count)[i, j] = result

        self.over(rows, columns, some, CHUNK if together else 1)

    def _emit_columns(self, instruction: Instruction) -> None:
        """Emit a function of columns; neighbouring columns fill eight lanes together."""
        loop: Columns = instruction.attributes[0]
        views: Any = instruction.operands[: len(loop.parameters)]
        outer: Any = instruction.operands[len(loop.parameters) :]
        neighbours = loop.size >= CHUNK and all(view.steps[1] == 1 for view in views)
        count = max(CHUNK // self.width, 1) if neighbours else 1
        width = count * self.width
        target = self.matrix(instruction.result, (len(loop.results), loop.size))

        def some(at: Index) -> None:
            j = operation("minimum", at, loop.size - count)  # the last ones compute some again
            inside = copy(self)
            inside.width, inside.own = width, self.lanes(width)
            inside.scalars = {value: self.spread(self.scalar(value), width).value for value in outer
                              if value not in self.program.constants}  # fmt: skip
            for view, parameters in zip(views, loop.parameters, strict=True):
                for i, value in enumerate(parameters):
                    inside.scalars[value] = self.load(view, i, j, count).value
            inside.block(loop.body)
            for i, value in enumerate(loop.results):
                target[i, j] = inside.scalar(value)

        self.loop(0, loop.size, some, step=count)
