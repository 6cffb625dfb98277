"""Products, factorisations and solutions of matrices as loops in LLVM IR."""

from collections.abc import Callable, Sequence
from operator import add
from typing import Any

import numpy as np

from estimators.engine.matrix_emit import CHUNK, Index, Matrix, MatrixEmitter
from estimators.engine.program import Instruction, View
from estimators.engine.tracer import Tracer, cast, constant, where

# columns of a product that are summed at a time: as many vectors as processors have registers for
_ACROSS = 48
_EPS = float(np.finfo(float).eps)
_SWEEPS = 30


def _adding(products: Callable[[Index], list[Tracer]]) -> Callable[..., list[Tracer]]:
    """The body of a loop that adds products to their sums."""
    return lambda k, *sums: list(map(add, sums, products(k)))


class LinearEmitter(MatrixEmitter):
    """Linear algebra of rows side by side, in one order of operations; a failure is NaN in its row.

    Terms of a sum are added in their order; those of an inner product in eight partial sums.
    """

    def _operands(self, instruction: Instruction) -> list[Matrix]:
        views: Any = instruction.operands
        return [Matrix(self, view) for view in views]

    # --- products ---------------------------------------------------------------------------------

    def _emit_matmul(self, instruction: Instruction) -> None:
        a, b = self._operands(instruction)
        (rows, inner), columns = a.shape, b.shape[1]
        result = self.matrix(instruction.result, (rows, columns))
        if inner >= 2 * CHUNK and a.view.steps[1] == b.view.steps[0] == 1:
            right = View(b.view.value, (columns, inner), b.view.start, b.view.steps[::-1])
            self._inner_products(a.view, right, result)
            return
        together, target = self.width == 1 and b.view.steps[1] == 1, result.view

        def some(i: Index, first: Index, count: int) -> None:
            """Sums of neighbouring entries of a row: of a row alone vectors of them."""
            size = CHUNK if together else 1
            parts = [(first + j, min(size, count - j)) for j in range(0, count, size)]

            def products(k: Index) -> list[Tracer]:
                x = a[i, k]
                return [
                    self.spread(x, self.width * n) * Matrix(self, b.view, n)[k, j] for j, n in parts
                ]

            sums = self.loop(1, inner, _adding(products), products(0))
            for (j, n), total in zip(parts, sums, strict=True):
                Matrix(self, target, n)[i, j] = total

        self.over(rows, columns, some, _ACROSS if together else 4)

    def _inner_products(self, a: View, b: View, target: Matrix) -> None:
        symmetric = a == b

        def one(i: Index, j: Index) -> None:
            target[i, j] = total = self._inner_product(a, i, b, j)
            if symmetric:
                target[j, i] = total

        rows, columns = target.shape
        self.loop(
            0, rows, lambda i: self.loop(0, i + 1 if symmetric else columns, lambda j: one(i, j))
        )

    def _inner_product(self, a: View, i: Index, b: View, j: Index) -> Tracer:
        """``a_i . b_j``: eight partial sums, added by halves, then the remaining terms in order."""
        count = a.shape[1]
        whole = count // CHUNK * CHUNK
        lanes = self.lanes(CHUNK if self.width == 1 else self.width)

        def products(k: Index) -> list[Tracer]:
            if self.width == 1:
                return [self.load(a, i, k, CHUNK) * self.load(b, j, k, CHUNK)]
            return [self.load(a, i, k + m) * self.load(b, j, k + m) for m in range(CHUNK)]

        sums = [constant(lanes, 0.0)] * (1 if self.width == 1 else CHUNK)
        sums = self.loop(0, whole, _adding(products), sums, CHUNK)
        if self.width == 1:
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

    def _emit_solve_lower(self, instruction: Instruction) -> None:
        """Entries ``z_i`` in order: ``b_i`` less the ``t_ik z_k`` before it, divided by ``t_ii``.

        Columns of a row alone that are neighbours are eight lanes of vectors.
        """
        t, b = self._operands(instruction)
        z = self.matrix(instruction.result, b.shape)
        neighbours = (
            self.width == 1 and b.view.steps[1] == 1 and b.view.value not in self.program.tables
        )

        def column(_: Index, c: Index, count: int) -> None:
            right, solution = Matrix(self, b.view, count), Matrix(self, z.view, count)

            def wide(i: Index, k: Index) -> Tracer:
                return self.spread(t[i, k], self.width * count)

            def entry(i: Index) -> None:
                def less(k: Index, rest: Tracer) -> list[Tracer]:
                    return [rest - wide(i, k) * solution[k, c]]

                (rest,) = self.loop(0, i, less, [right[i, c]])
                solution[i, c] = rest / wide(i, i)

            self.loop(0, z.shape[0], entry)

        self.over(1, z.shape[1], column, CHUNK if neighbours else 1)

    def _emit_cholesky(self, instruction: Instruction) -> None:
        """``L L' = S``; a pivot that is not positive gives NaN or, semidefinite, zeros."""
        (s,) = self._operands(instruction)
        n, f = s.shape[0], self.matrix(instruction.result, s.shape)
        self.copy(s.view, f)

        def column(j: Index) -> None:
            def divide(i: Index) -> None:
                f[i, j] = f[i, j] / root
                f[j, i] = constant(self.own, 0.0)

            def reduce(i: Index) -> None:
                x = f[i, j]

                def entry(k: Index) -> None:
                    f[i, k] = f[i, k] - x * f[k, j]

                self.loop(j + 1, i + 1, entry)

            pivot = f[j, j]
            if instruction.opcode == "cholesky":
                root = diagonal = where(pivot > 0.0, pivot, np.nan).sqrt()
            else:
                root = where(n * _EPS * s[j, j] >= pivot, np.inf, pivot.sqrt())
                diagonal = where(root == np.inf, 0.0, root)
            self.loop(j + 1, n, divide)
            f[j, j] = diagonal
            self.loop(j + 1, n, reduce)

        self.loop(0, n, column)

    _emit_semidefinite_cholesky = _emit_cholesky

    def _emit_rotate(self, instruction: Instruction) -> None:
        """``A V`` with orthogonal columns by one-sided Jacobi rotations, then V if wanted."""
        (a,) = self._operands(instruction)
        (m, n), wanted = a.shape, instruction.attributes[0]
        z, v = (
            self.matrix(instruction.result, (m, n)),
            self.matrix(instruction.result, (wanted, n), m * n),
        )
        self.copy(a.view, z)

        def unit(i: Index, j: Index, _: int) -> None:
            v[i, j] = self.spread(cast(constant(self.one, i) == j, "f"), self.width)

        self.over(wanted, n, unit)
        still = constant(self.one, np.False_)

        def row(p: Index, turning: Tracer) -> list[Tracer]:
            return self.loop(
                p + 1, n, lambda q, turned: [turned | self._turned((z, v), p, q)], [turning]
            )

        def sweep(_: Index, turning: Tracer) -> list[Tracer]:
            return self.loop(0, cast(turning, "i") * n, row, [still])  # none once all stand still

        self.loop(0, _SWEEPS, sweep, [constant(self.one, np.True_)])

    def _turned(self, matrices: Sequence[Matrix], p: Index, q: Index) -> Tracer:
        """Turn columns p and q where they are not orthogonal; a mask: were any row's not?"""

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

                self.loop(0, matrix.shape[0], entry)

        self.loop(0, cast(some, "i"), turn)
        return some
