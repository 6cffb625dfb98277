"""Products, factorisations and solutions of matrices as loops in LLVM IR."""

import math
from collections.abc import Callable, Sequence
from operator import add
from typing import Any

import numpy as np

from estimators.engine.emit import Module
from estimators.engine.matrix_emit import CHUNK, Index, Matrix, MatrixEmitter
from estimators.engine.program import Instruction, Program, View
from estimators.engine.tracer import Tracer, cast, constant, where

# columns of a product that are summed at a time: as many vectors as processors have registers for
_ACROSS = 48
_EPS = float(np.finfo(float).eps)
_SWEEPS = 30


class LinearEmitter(MatrixEmitter):
    """Rows side by side meet the same operations in the same order; what cannot be done is NaN in its row.

    Terms of a sum are added in their order; those of an inner product in eight partial sums.
    """

    def __init__(
        self, program: Program, module: Module, width: int, places: dict[int, int]
    ) -> None:
        super().__init__(program, module, width, places)
        self.special |= {
            "matmul": self._matmul, "inner": self._inner, "solve": self._solve,
            "solve lower": self._solve_triangular, "cholesky": self._cholesky,
            "solve upper": self._solve_triangular, "semidefinite cholesky": self._semidefinite_cholesky,
            "rotate": self._rotate,
        }  # fmt: skip

    def _operands(self, instruction: Instruction) -> list[Matrix]:
        views: Any = instruction.operands
        return [Matrix(self, view) for view in views]

    # --- products ---------------------------------------------------------------------------------

    def _matmul(self, instruction: Instruction) -> None:
        a, b = self._operands(instruction)
        (rows, inner), columns = a.shape, b.shape[1]
        together = self.width == 1 and columns > 1
        if together and b.view.steps[1] != 1:
            copied = self.matrix(instruction.result, b.shape, rows * columns)
            self.copy(b.view, copied)
            b = copied
        target = self.matrix(instruction.result, (rows, columns)).view

        def some(i: Index, first: Index, count: int) -> None:
            """Sums of neighbouring entries of a row: of a row alone vectors of them."""
            size = CHUNK if together else 1
            parts = [(first + j, min(size, count - j)) for j in range(0, count, size)]

            def products(k: Index) -> list[Tracer]:
                x = a[i, k]
                return [
                    self.spread(x, self.width * n) * Matrix(self, b.view, n)[k, j] for j, n in parts
                ]

            sums = products(0)
            if inner <= 4 and not together:
                for k in range(1, inner):
                    sums = list(map(add, sums, products(k)))
            else:
                sums = self._accumulated(1, inner, products, sums)
            for (j, n), total in zip(parts, sums, strict=True):
                Matrix(self, target, n)[i, j] = total

        size, unrolled = (_ACROSS, 2) if together else (4, 1)
        self.each(
            0,
            rows,
            lambda i: self.chunks(columns, size, lambda j, count: some(i, j, count), unrolled),
        )

    def _accumulated(
        self,
        low: int,
        high: int,
        products: Callable[[Index], list[Tracer]],
        sums: Sequence[Tracer],
        step: int = 1,
    ) -> list[Tracer]:
        """Sums and the products that each index adds to them."""
        return self.loop(low, high, lambda k, *sums: list(map(add, sums, products(k))), sums, step)

    def _inner(self, instruction: Instruction) -> None:
        a, b = self._operands(instruction)
        (rows, count), columns = a.shape, b.shape[0]
        target = self.matrix(instruction.result, (rows, columns))

        def one(i: Index, j: Index) -> None:
            total = self._inner_product(a.view, i, b.view, j, count)
            target[i, j] = total
            if instruction.attributes[0]:
                target[j, i] = total

        if instruction.attributes[0]:
            self.each(0, rows, lambda i: self.each(0, i + 1, lambda j: one(i, j)))
        else:
            self.over(rows, columns, one)

    def _inner_product(self, a: View, i: Index, b: View, j: Index, count: int) -> Tracer:
        """``a_i . b_j``: eight partial sums, added by halves, and what is left over in its order."""
        whole = count // CHUNK * CHUNK
        together = self.width == 1 and a.steps[1] == b.steps[1] == 1
        lanes = self.lanes(CHUNK if together else self.width)

        def products(k: Index) -> list[Tracer]:
            if together:
                return [self.load(a, i, k, CHUNK) * self.load(b, j, k, CHUNK)]
            return [self.load(a, i, k + m) * self.load(b, j, k + m) for m in range(CHUNK)]

        sums = [constant(lanes, 0.0)] * (1 if together else CHUNK)
        if whole:
            sums = self._accumulated(0, whole, products, sums, CHUNK)
        if together:
            vector = f"extractelement <{CHUNK} x double> {lanes.name(sums[0])}, i32"
            sums = [self.one.value(self.line(f"{vector} {m}")) for m in range(CHUNK)]
        while len(sums) > 1:
            half = len(sums) // 2
            sums = list(map(add, sums[:half], sums[half:]))
        total = sums[0]
        for k in range(whole, count):
            total = total + self.load(a, i, k) * self.load(b, j, k)
        return total

    # --- solutions --------------------------------------------------------------------------------

    def _substitute(
        self,
        factor: Callable[[Index, Index], Tracer],
        b: View,
        z: View,
        lower: bool,
        divided: str = "",
    ) -> None:
        """Entries ``z_i`` one after the other: ``b_i`` less the ``factor(i, k) z_k`` of those before it.

        They are divided by ``factor(i, i)`` "before" or "after". Columns of a row alone that are
        neighbours are eight lanes of vectors.
        """
        n, neighbours = (
            z.shape[0],
            self.width == 1 and b.steps[1] == 1 and b.value not in self.program.tables,
        )

        def column(c: Index, count: int) -> None:
            right, solution = Matrix(self, b, count), Matrix(self, z, count)

            def wide(i: Index, k: Index) -> Tracer:
                return self.spread(factor(i, k), self.width * count)

            def entry(m: Index) -> None:
                i = m if lower else n - 1 - m
                low, high = (0, i) if lower else (i + 1, n)
                first = right[i, c] / wide(i, i) if divided == "before" else right[i, c]
                rest = self.total(
                    first, low, high, lambda k, rest: rest - wide(i, k) * solution[k, c]
                )
                solution[i, c] = rest / wide(i, i) if divided == "after" else rest

            self.each(0, n, entry)

        self.chunks(z.shape[1], CHUNK if neighbours else 1, column)

    def _solve(self, instruction: Instruction) -> None:
        """``S^-1 B`` by ``S = L D L'``: L D below the diagonal, D on it, L where its transpose would be."""
        s, b = self._operands(instruction)
        n, z = s.shape[0], self.matrix(instruction.result, b.shape)
        f = self.matrix(instruction.result, s.shape, math.prod(b.shape))

        def column(j: Index) -> None:
            def below(i: Index) -> None:
                f[i, j] = self.total(s[i, j], 0, j, lambda k, rest: rest - f[i, k] * f[k, j])

            def above(i: Index) -> None:
                f[j, i] = f[i, j] / pivot

            self.each(j, n, below)
            pivot = f[j, j]
            pivot = where(pivot > 0.0, pivot, np.nan)
            f[j, j] = pivot
            self.each(j + 1, n, above)

        self.loop(0, n, column)
        self._substitute(lambda i, k: f[k, i], b.view, z.view, True)
        self._substitute(lambda i, k: f[i, k], z.view, z.view, False, "before")

    def _solve_triangular(self, instruction: Instruction) -> None:
        t, b = self._operands(instruction)
        z = self.matrix(instruction.result, b.shape)
        self._substitute(
            lambda i, k: t[i, k], b.view, z.view, instruction.opcode == "solve lower", "after"
        )

    def _cholesky(self, instruction: Instruction) -> None:
        (s,) = self._operands(instruction)
        n, f = s.shape[0], self.matrix(instruction.result, s.shape)
        self.fill(f, 0.0)

        def column(j: Index) -> None:
            def rest(i: Index) -> Tracer:
                return self.total(s[i, j], 0, j, lambda k, rest: rest - f[i, k] * f[j, k])

            def below(i: Index) -> None:
                f[i, j] = rest(i) / pivot

            square = rest(j)
            pivot = where(square > 0.0, square, np.nan).sqrt()
            f[j, j] = pivot
            self.each(j + 1, n, below)

        self.loop(0, n, column)

    def _semidefinite_cholesky(self, instruction: Instruction) -> None:
        """``L L' = S``; a pivot that is zero to rounding gives a column of zeros."""
        (s,) = self._operands(instruction)
        n, f = s.shape[0], self.matrix(instruction.result, s.shape)
        self.copy(s.view, f)

        def column(j: Index) -> None:
            def divide(i: Index) -> None:
                f[i, j] = f[i, j] / root
                f[j, i] = 0.0

            def reduce(i: Index) -> None:
                x = f[i, j]

                def entry(k: Index) -> None:
                    f[i, k] = f[i, k] - x * f[k, j]

                self.each(j + 1, i + 1, entry)

            pivot = f[j, j]
            root = where(n * _EPS * s[j, j] >= pivot, np.inf, pivot.sqrt())
            self.each(j + 1, n, divide)
            f[j, j] = where(root == np.inf, 0.0, root)
            self.each(j + 1, n, reduce)

        self.loop(0, n, column)

    def _rotate(self, instruction: Instruction) -> None:
        """``A V`` with orthogonal columns by one-sided Jacobi rotations, and V where it is wanted, behind it."""
        (a,) = self._operands(instruction)
        (m, n), wanted = a.shape, instruction.attributes[0]
        z, v = (
            self.matrix(instruction.result, (m, n)),
            self.matrix(instruction.result, (wanted, n), m * n),
        )
        self.copy(a.view, z)
        if wanted:

            def diagonal(i: Index) -> None:
                v[i, i] = 1.0

            self.fill(v, 0.0)
            self.each(0, n, diagonal)
        still = constant(self.one, np.False_)

        def row(p: Index, turning: Tracer) -> list[Tracer]:
            return self.loop(
                p + 1, n, lambda q, turned: [turned | self._turned((z, v), p, q)], [turning]
            )

        self.loop(0, _SWEEPS, lambda _, _turning: self.loop(0, n, row, [still]), [constant(self.one, np.True_)],
                  going=lambda turning: turning)  # fmt: skip

    def _turned(self, matrices: Sequence[Matrix], p: Index, q: Index) -> Tracer:
        """Turn columns p and q where they are not orthogonal; whether any row's were not."""

        def products(i: Index, aa: Tracer, bb: Tracer, ab: Tracer) -> list[Tracer]:
            x, y = matrices[0][i, p], matrices[0][i, q]
            return [aa + x * x, bb + y * y, ab + x * y]

        aa, bb, ab = self.loop(0, matrices[0].shape[0], products, [constant(self.own, 0.0)] * 3)
        apart = abs(ab) > _EPS * (aa * bb).sqrt()
        zeta = (bb - aa) / (2.0 * ab)
        root = (1.0 + zeta * zeta).sqrt()
        tangent = where(zeta >= 0.0, 1.0, -1.0) / (abs(zeta) + root)
        cosine = 1.0 / (1.0 + tangent * tangent).sqrt()
        sine, some = cosine * tangent, self.any(apart)

        def turn(_: Index) -> None:
            for matrix in matrices:

                def entry(i: Index, matrix: Matrix = matrix) -> None:
                    x, y = matrix[i, p], matrix[i, q]
                    matrix[i, p] = where(apart, cosine * x - sine * y, x)
                    matrix[i, q] = where(apart, sine * x + cosine * y, y)

                self.each(0, matrix.shape[0], entry)

        self.loop(0, cast(some, "i"), turn)
        return some
