"""Products of matrices as loops in LLVM IR."""

from collections.abc import Callable, Sequence
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
        operands: Any = instruction.operands
        a, b = operands
        target = self.target(instruction, (a.shape[0], b.shape[1]))
        if (picks := instruction.attributes[0]) is not None:
            self._scaled_rows(a, b, instruction.result, picks)
            return
        if self.width == 1 and b.shape[1] > 1:
            if b.steps[1] != 1:
                copied = View(self.temporary(instruction), b.shape, 0, (b.shape[1], 1))
                self.copy(b, copied)
                b = copied
            self.each(0, a.shape[0], lambda i: self._row_product(a, b, instruction.result, i))
            return
        self._products(a, b, target)

    def _scaled_rows(self, a: View, b: View, result: int, picks: Sequence[int]) -> None:
        """A product whose rows are multiples of rows of ``b``, or zeros."""
        columns, lanes = b.shape[1], CHUNK if self.width == b.steps[1] == 1 else 1

        def some(i: int, k: int, j: Index, count: int) -> None:
            T, total = type_of("f", self.width * count), literal(0.0, "f", self.width * count)
            if k >= 0:
                x = self.load(a, i, k)
                y = self.line(f"load {T}, ptr {self.address(b.value, self.index(b, k, j))}, align 8")
                total = self.line(f"fmul {T} {self.splat(x, count) if count > 1 else x}, {y}")
            place = self.address(result, self.plus(i * columns, j))
            self.lines.append(f"  store {T} {total}, ptr {place}, align 8")

        for i, k in enumerate(picks):
            self.chunks(columns, lanes, lambda j, count, i=i, k=k: some(i, k, j, count))  # type: ignore[misc]

    def _products(self, a: View, b: View, target: View) -> None:
        """Entries one beside the other, four at a time."""
        (rows, inner), columns = a.shape, b.shape[1]

        def some(i: Index, j: Index, count: int) -> None:
            beside = [self.plus(j, m) for m in range(count)]

            def products(k: Index) -> list[str]:
                x = self.load(a, i, k)
                return [self.line(f"fmul {self.T} {x}, {self.load(b, k, m)}") for m in beside]

            sums = products(0)
            if inner <= 4:
                for k in range(1, inner):
                    sums = self._sums([self.T] * count, sums, products(k))
            else:
                sums = self._accumulated(1, inner, products, sums, [self.T] * count)
            for m, total in zip(beside, sums, strict=True):
                self.store_at(total, target, i, m)

        self.each(0, rows, lambda i: self.chunks(columns, 4, lambda j, count: some(i, j, count)))

    def _sums(self, types: Sequence[str], sums: Sequence[str], products: Sequence[str]) -> list[str]:
        terms = zip(types, sums, products, strict=True)
        return [self.line(f"fadd {T} {total}, {product}") for T, total, product in terms]

    def _accumulated(
        self, low: int, high: int, products: Callable[[Index], Sequence[str]], sums: Sequence[str],
        types: Sequence[str], step: int = 1,
    ) -> list[str]:  # fmt: skip
        """Sums and the products that each index adds to them."""
        return self.loop(low, high, lambda k, *sums: self._sums(types, sums, products(k)), sums, types, step)

    def _row_product(self, a: View, b: View, result: int, i: Index) -> None:
        """A row of a product as vectors over its columns, which are neighbours in ``b``."""
        inner, columns = b.shape

        def some(first: Index, count: int) -> None:
            parts = [(self.plus(first, j), min(CHUNK, count - j)) for j in range(0, count, CHUNK)]
            types = [type_of("f", width) for _, width in parts]

            def products(k: Index) -> list[str]:
                x, found = self.load(a, i, k), []
                for (j, width), T in zip(parts, types, strict=True):
                    y = self.line(f"load {T}, ptr {self.address(b.value, self.index(b, k, j))}, align 8")
                    found.append(self.line(f"fmul {T} {self.splat(x, width)}, {y}"))
                return found

            sums = self._accumulated(1, inner, products, products(0), types)
            for (j, _), T, total in zip(parts, types, sums, strict=True):
                place = self.address(result, self.plus(self.times(i, columns), j))
                self.lines.append(f"  store {T} {total}, ptr {place}, align 8")

        self.chunks(columns, _ACROSS, some, 2)

    def _inner(self, instruction: Instruction) -> None:
        operands: Any = instruction.operands
        a, b = operands
        (rows, count), columns = a.shape, b.shape[0]
        target = self.target(instruction, (rows, columns))

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

        zero = literal(0.0, "f", CHUNK if together else self.width)
        sums = [zero] * (1 if together else CHUNK)
        if whole:
            sums = self._accumulated(0, whole, products, sums, [T] * len(sums), CHUNK)
        total, size = sums[0], CHUNK
        while together and size > 1:  # halves of the vector
            size //= 2
            lows, highs = (", ".join(f"i32 {m + first}" for m in range(size)) for first in (0, size))
            pair = [f"shufflevector {T} {total}, {T} poison, <{size} x i32> <{part}>" for part in (lows, highs)]
            T = f"<{size} x double>"
            total = self.line(f"fadd {T} {self.line(pair[0])}, {self.line(pair[1])}")
        if together:
            total = self.line(f"extractelement {T} {total}, i32 0")
        while len(sums) > 1:
            half = len(sums) // 2
            sums = self._sums([self.T] * half, sums[:half], sums[half:])
            total = sums[0]
        for k in range(whole, count):
            total = self.line(f"fadd {self.T} {total}, {self._product(a, i, b, j, k)}")
        return total

    def _product(self, a: View, i: Index, b: View, j: Index, k: Index) -> str:
        return self.line(f"fmul {self.T} {self.load(a, i, k)}, {self.load(b, j, k)}")
