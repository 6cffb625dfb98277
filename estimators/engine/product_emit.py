"""Products of matrices as loops in LLVM IR."""

from collections.abc import Sequence
from typing import Any

from estimators.engine.emit import Module, literal, type_of
from estimators.engine.matrix_emit import CHUNK, Index, MatrixEmitter
from estimators.engine.program import Instruction, Program, View

_ACROSS = 48  # columns of a product that are summed at a time: as many vectors as processors have registers for


class ProductEmitter(MatrixEmitter):
    """Terms are added in their order; those of an inner product in eight partial sums."""

    def __init__(self, program: Program, module: Module, width: int, layout: Any) -> None:
        super().__init__(program, module, width, layout)
        self.special |= {"matmul": self._matmul, "inner": self._inner}

    def _matmul(self, instruction: Instruction) -> None:
        a, b = instruction.operands
        assert isinstance(a, View)
        assert isinstance(b, View)
        target = View(instruction.result, (a.shape[0], b.shape[1]), 0, (b.shape[1], 1))
        if self.width == 1 and b.shape[1] > 1:
            if b.steps[1] != 1:
                copied = View(self.temporary(instruction), b.shape, 0, (b.shape[1], 1))
                self.copy(b, copied)
                b = copied
            self.each(0, a.shape[0], lambda i: self._row_product(a, b, instruction.result, i))
            return
        self._products(a, b, target)

    def _products(self, a: View, b: View, target: View) -> None:
        """Entries one beside the other, four at a time."""
        (rows, inner), columns = a.shape, b.shape[1]

        def some(i: Index, j: Index, count: int) -> None:
            beside = [self.plus(j, m) for m in range(count)]

            def products(k: Index) -> list[str]:
                x = self.load(a, i, k)
                return [self.line(f"fmul {self.T} {x}, {self.load(b, k, m)}") for m in beside]

            def add(k: Index, *sums: str) -> list[str]:
                pairs = zip(sums, products(k), strict=True)
                return [self.line(f"fadd {self.T} {total}, {product}") for total, product in pairs]

            sums: Sequence[str] = products(0)
            if inner <= 4:
                for k in range(1, inner):
                    sums = add(k, *sums)
            else:
                sums = self.loop(1, inner, add, sums, [self.T] * count)
            for m, total in zip(beside, sums, strict=True):
                self.store_at(total, target, i, m)

        whole = columns // 4 * 4

        def row(i: Index) -> None:
            if whole > 4:
                self.loop(0, whole, lambda j: some(i, j, 4), step=4)
            elif whole:
                some(i, 0, 4)
            if columns > whole:
                some(i, whole, columns - whole)

        self.each(0, rows, row)

    def _row_product(self, a: View, b: View, result: int, i: Index) -> None:
        """A row of a product as vectors over its columns, which are neighbours in ``b``."""
        inner, columns = b.shape
        whole = columns // _ACROSS * _ACROSS

        def some(first: Index, count: int) -> None:
            parts = [(self.plus(first, j), min(CHUNK, count - j)) for j in range(0, count, CHUNK)]
            types = [type_of("f", width) for _, width in parts]

            def products(k: Index) -> list[str]:
                x, found = self.load(a, i, k), []
                for (j, width), T in zip(parts, types, strict=True):
                    y = self.line(f"load {T}, ptr {self.address(b.value, self.index(b, k, j))}, align 8")
                    found.append(self.line(f"fmul {T} {self.splat(x, width)}, {y}"))
                return found

            def add(k: Index, *sums: str) -> list[str]:
                terms = zip(types, sums, products(k), strict=True)
                return [self.line(f"fadd {T} {total}, {product}") for T, total, product in terms]

            sums = self.loop(1, inner, add, products(0), types)
            for (j, _), T, total in zip(parts, types, sums, strict=True):
                place = self.address(result, self.plus(self.times(i, columns), j))
                self.lines.append(f"  store {T} {total}, ptr {place}, align 8")

        if whole > 2 * _ACROSS:
            self.loop(0, whole, lambda j: some(j, _ACROSS), step=_ACROSS)
        else:
            for j in range(0, whole, _ACROSS):
                some(j, _ACROSS)
        if columns > whole:
            some(whole, columns - whole)

    def _inner(self, instruction: Instruction) -> None:
        a, b = instruction.operands
        assert isinstance(a, View)
        assert isinstance(b, View)
        (rows, count), columns = a.shape, b.shape[0]
        target = View(instruction.result, (rows, columns), 0, (columns, 1))

        def one(i: Index, j: Index) -> None:
            total = self._inner_product(a, i, b, j, count)
            self.store_at(total, target, i, j)
            if instruction.attributes[0]:
                self.store_at(total, target, j, i)

        if instruction.attributes[0]:
            self.each(0, rows, lambda i: self.each(0, self.plus(i, 1), lambda j: one(i, j)))
        else:
            self.over(rows, columns, one)

    def _inner_product(self, a: View, i: Index, b: View, j: Index, count: int) -> str:
        """``a_i . b_j``: eight partial sums, added by halves, and what is left over in its order."""
        whole = count // CHUNK * CHUNK
        together = self.width == 1 and a.steps[1] == b.steps[1] == 1
        T = type_of("f", CHUNK) if together else self.T

        def products(k: Index) -> list[str]:
            if together:
                places = (self.address(v.value, self.index(v, m, k)) for v, m in ((a, i), (b, j)))
                pair = [self.line(f"load {T}, ptr {place}, align 8") for place in places]
                return [self.line(f"fmul {T} {pair[0]}, {pair[1]}")]
            return [self._product(a, i, b, j, self.plus(k, m)) for m in range(CHUNK)]

        def add(k: Index, *sums: str) -> list[str]:
            pairs = zip(sums, products(k), strict=True)
            return [self.line(f"fadd {T} {total}, {product}") for total, product in pairs]

        zero = literal(0.0, "f", CHUNK if together else self.width)
        sums = [zero] * (1 if together else CHUNK)
        if whole:
            sums = self.loop(0, whole, add, sums, [T] * len(sums), step=CHUNK)
        if together:
            sums = [self.line(f"extractelement {T} {sums[0]}, i32 {m}") for m in range(CHUNK)]
        while len(sums) > 1:
            half = len(sums) // 2
            pairs = zip(sums[:half], sums[half:], strict=True)
            sums = [self.line(f"fadd {self.T} {x}, {y}") for x, y in pairs]
        total = sums[0]
        for k in range(whole, count):
            total = self.line(f"fadd {self.T} {total}, {self._product(a, i, b, j, k)}")
        return total

    def _product(self, a: View, i: Index, b: View, j: Index, k: Index) -> str:
        return self.line(f"fmul {self.T} {self.load(a, i, k)}, {self.load(b, j, k)}")
