"""Factorisations and solutions of small matrices as loops in LLVM IR."""

from collections.abc import Callable
from typing import Any

import numpy as np

from estimators.engine.emit import Module, literal, type_of
from estimators.engine.matrix_emit import CHUNK, Index
from estimators.engine.product_emit import ProductEmitter
from estimators.engine.program import Instruction, Program, View

_EPS = float(np.finfo(float).eps)
_SWEEPS = 30


class LinearEmitter(ProductEmitter):
    """Rows side by side meet the same operations in the same order; what cannot be done is NaN in its row."""

    def __init__(self, program: Program, module: Module, width: int, layout: Any) -> None:
        super().__init__(program, module, width, layout)
        self.special |= {
            "symmetrise": self._symmetrise, "solve": self._solve, "eliminate": self._eliminate,
            "solve lower": self._solve_triangular, "solve upper": self._solve_triangular, "cholesky": self._cholesky,
            "semidefinite cholesky": self._semidefinite_cholesky, "rotate": self._rotate,
        }  # fmt: skip
        self._across = 1  # columns that are solved side by side
        self._zero, self._one, self._nan = (literal(x, "f", width) for x in (0.0, 1.0, np.nan))

    def _do(self, operation: str, *operands: str) -> str:
        return self.line(f"{operation} {self.T} {', '.join(operands)}")

    def _choose(self, order: str, a: str, b: str, chosen: str, other: str) -> str:
        """``chosen`` where ``a order b``."""
        return self.line(f"select {self.mask} {self._do(f'fcmp {order}', a, b)}, {self.T} {chosen}, {self.T} {other}")

    def _minus(self, rest: str, x: str, y: str) -> str:
        return self._do("fsub", rest, self._do("fmul", x, y))

    def _symmetrise(self, instruction: Instruction) -> None:
        a: Any = instruction.operands[0]
        n = a.shape[0]
        half = literal(0.5, "f", self.width)

        def one(i: Index, j: Index) -> None:
            mean = self._do("fmul", half, self._do("fadd", self.load(a, i, j), self.load(a, j, i)))
            for row, column in ((i, j), (j, i)):
                self.store(mean, instruction.result, self.plus(self.times(row, n), column))

        self.each(0, n, lambda i: self.each(0, self.plus(i, 1), lambda j: one(i, j)))

    def _for_columns(self, b: View, solution: Callable[[Index], None]) -> None:
        """A body for each column; those of a row alone that are neighbours are eight lanes of vectors."""
        neighbours = self.width == 1 and b.steps[1] == 1 and b.value not in self.program.tables

        def some(c: Index, count: int) -> None:
            self._across, self.T = count, type_of("f", self.width * count)
            solution(c)
            self._across, self.T = 1, type_of("f", self.width)

        self.chunks(b.shape[1], CHUNK if neighbours else 1, some)

    def _factor(self, view: View, i: Index, j: Index) -> str:
        """An entry for all columns that are solved together."""
        own, self.T = self.T, type_of("f", self.width)
        x, self.T = self.load(view, i, j), own
        return self.splat(x, self._across) if self._across > 1 else x

    def _substituted(self, z: View, c: Index, low: Index, high: Index, factor: Any, rest: str) -> str:
        """An entry less what those of the column before it contribute."""
        return self.total(rest, low, high, lambda k, total: self._minus(total, factor(k), self.load(z, k, c)))

    def _solve(self, instruction: Instruction) -> None:
        """``S^-1 B`` by ``S = L D L'``: L D below the diagonal, D on it, L where its transpose would be."""
        operands: Any = instruction.operands
        s, b = operands
        n = s.shape[0]
        f = View(self.temporary(instruction), s.shape, 0, (n, 1))
        z = self.target(instruction, b.shape)

        def column(j: Index) -> None:
            def below(i: Index) -> None:
                rest = self.total(
                    self.load(s, i, j), 0, j, lambda k, t: self._minus(t, self.load(f, i, k), self.load(f, k, j))
                )
                self.store_at(rest, f, i, j)

            self.each(j, n, below)
            pivot = self.load(f, j, j)
            pivot = self._choose("ogt", pivot, self._zero, pivot, self._nan)
            self.store_at(pivot, f, j, j)
            self.each(self.plus(j, 1), n, lambda i: self.store_at(self._do("fdiv", self.load(f, i, j), pivot), f, j, i))

        self.loop(0, n, lambda j: column(j))

        def solution(c: Index) -> None:
            def forward(i: Index) -> None:
                rest = self._substituted(z, c, 0, i, lambda k: self._factor(f, k, i), self.load(b, i, c))
                self.store_at(rest, z, i, c)

            def backward(m: Index) -> None:
                i = self.line(f"sub i64 {n - 1}, {m}")
                rest = self._do("fdiv", self.load(z, i, c), self._factor(f, i, i))
                rest = self._substituted(z, c, self.plus(i, 1), n, lambda k: self._factor(f, i, k), rest)
                self.store_at(rest, z, i, c)

            self.loop(0, n, lambda i: forward(i))
            self.loop(0, n, lambda m: backward(m))

        self._for_columns(b, solution)

    def _solve_triangular(self, instruction: Instruction) -> None:
        operands: Any = instruction.operands
        t, b = operands
        self._divide(t, b, self.target(instruction, b.shape), instruction.opcode == "solve lower")

    def _divide(self, t: View, b: View, z: View, lower: bool) -> None:
        """``T^-1 B`` of a triangular T, which may stand where B does."""
        n = t.shape[0]

        def solution(c: Index) -> None:
            def entry(m: Index) -> None:
                i = m if lower else self.line(f"sub i64 {n - 1}, {m}")
                low, high = (0, i) if lower else (self.plus(i, 1), n)
                rest = self._substituted(z, c, low, high, lambda k: self._factor(t, i, k), self.load(b, i, c))
                self.store_at(self._do("fdiv", rest, self._factor(t, i, i)), z, i, c)

            self.each(0, n, entry)

        self._for_columns(b, solution)

    def _cholesky(self, instruction: Instruction) -> None:
        s: Any = instruction.operands[0]
        n = s.shape[0]
        f = self.target(instruction, s.shape)
        self.over(n, n, lambda i, j: self.store_at(self._zero, f, i, j))

        def column(j: Index) -> None:
            def below(i: Index) -> str:
                return self.total(
                    self.load(s, i, j), 0, j, lambda k, t: self._minus(t, self.load(f, i, k), self.load(f, j, k))
                )

            rest = below(j)
            pivot = self._choose("ogt", rest, self._zero, rest, self._nan)
            pivot = self.call("sqrt", "f", self.width, pivot)
            self.store_at(pivot, f, j, j)
            self.each(self.plus(j, 1), n, lambda i: self.store_at(self._do("fdiv", below(i), pivot), f, i, j))

        self.loop(0, n, lambda j: column(j))

    def _semidefinite_cholesky(self, instruction: Instruction) -> None:
        """``L L' = S``; a pivot that is zero to rounding gives a column of zeros."""
        s: Any = instruction.operands[0]
        n = s.shape[0]
        f = self.target(instruction, s.shape)
        infinite, smallest = (literal(x, "f", self.width) for x in (np.inf, n * _EPS))

        def start(i: Index) -> None:
            self.each(0, self.plus(i, 1), lambda j: self.store_at(self.load(s, i, j), f, i, j))
            self.each(self.plus(i, 1), n, lambda j: self.store_at(self._zero, f, i, j))

        self.loop(0, n, lambda i: start(i))

        def column(j: Index) -> None:
            pivot = self.load(f, j, j)
            bound = self._do("fmul", smallest, self.load(s, j, j))
            root = self._choose("ole", pivot, bound, infinite, self.call("sqrt", "f", self.width, pivot))
            self.each(self.plus(j, 1), n, lambda i: self.store_at(self._do("fdiv", self.load(f, i, j), root), f, i, j))
            self.store_at(self._choose("oeq", root, infinite, self._zero, root), f, j, j)

            def below(i: Index) -> None:
                x = self.load(f, i, j)
                self.each(self.plus(j, 1), self.plus(i, 1), lambda k: self.store_at(
                    self._minus(self.load(f, i, k), x, self.load(f, k, j)), f, i, k))  # fmt: skip

            self.each(self.plus(j, 1), n, below)

        self.loop(0, n, lambda j: column(j))

    def _eliminate(self, instruction: Instruction) -> None:
        """``S^-1 B`` by Gaussian elimination with partial pivoting; where lanes pivot otherwise, numbers are chosen."""
        operands: Any = instruction.operands
        s, b = operands
        n = s.shape[0]
        f = View(self.temporary(instruction), s.shape, 0, (n, 1))
        z = self.target(instruction, b.shape)
        self.copy(s, f)
        self.copy(b, z)

        def column(j: Index) -> None:
            number = self.splat(self.line(f"sitofp i64 {j} to double"), self.width)
            largest = self.call("fabs", "f", self.width, self.load(f, j, j))

            def better(i: Index, best: str, size: str) -> list[str]:
                own = self.call("fabs", "f", self.width, self.load(f, i, j))
                where = self.splat(self.line(f"sitofp i64 {i} to double"), self.width)
                return [self._choose("ogt", own, size, where, best), self._choose("ogt", own, size, own, size)]

            best, _ = self.loop(self.plus(j, 1), n, better, [number, largest], [self.T, self.T])
            self._exchange(f, j, j, best)
            self._exchange(z, 0, j, best)
            pivot = self.load(f, j, j)
            pivot = self._choose("oeq", pivot, self._zero, self._nan, pivot)
            self.store_at(pivot, f, j, j)

            def below(i: Index) -> None:
                factor = self._do("fdiv", self.load(f, i, j), pivot)
                for view, low in ((f, self.plus(j, 1)), (z, 0)):
                    self.each(low, view.shape[1], lambda k, view=view: self.store_at(  # type: ignore[misc]
                        self._minus(self.load(view, i, k), factor, self.load(view, j, k)), view, i, k))  # fmt: skip

            self.each(self.plus(j, 1), n, below)

        self.loop(0, n, lambda j: column(j))
        self._divide(f, z, z, False)

    def _exchange(self, view: View, low: Index, j: Index, best: str) -> None:
        """Exchange row j, from a column on, with the best one of each lane."""

        def entry(k: Index) -> None:
            top = self.load(view, j, k)

            def other(i: Index, found: str) -> list[str]:
                number = self.line(f"sitofp i64 {i} to double")
                chosen = self._do("fcmp oeq", self.splat(number, self.width), best)
                own = self.load(view, i, k)
                self.store_at(self.line(f"select {self.mask} {chosen}, {self.T} {top}, {self.T} {own}"), view, i, k)
                return [self.line(f"select {self.mask} {chosen}, {self.T} {own}, {self.T} {found}")]

            found = self.loop(self.plus(j, 1), view.shape[0], other, [top], [self.T])[0]
            self.store_at(found, view, j, k)

        self.each(low, view.shape[1], entry)

    def _rotate(self, instruction: Instruction) -> None:
        """``A V`` with orthogonal columns by one-sided Jacobi rotations, and V where it is wanted, behind it."""
        a: Any = instruction.operands[0]
        (m, n), wanted = a.shape, instruction.attributes[0]
        z = self.target(instruction, a.shape)
        v = View(instruction.result, (wanted, n), m * n, (n, 1))
        self.copy(a, z)
        if wanted:
            self.over(n, n, lambda i, j: self.store_at(self._zero, v, i, j))
            self.each(0, n, lambda i: self.store_at(self._one, v, i, i))

        def row(p: str, turning: str) -> list[str]:
            return self.loop(
                self.plus(p, 1), n, lambda q, turned: [self._turned(z, v, p, q, turned)], [turning], ["i1"]
            )

        def sweep(_: str, _turning: str) -> list[str]:
            return self.loop(0, n, row, ["false"], ["i1"])

        self.loop(0, _SWEEPS, sweep, ["true"], ["i1"], going=lambda turning: turning)

    def _turned(self, z: View, v: View, p: Index, q: Index, turned: str) -> str:
        """Turns columns p and q where they are not orthogonal; whether any row's ever were not."""
        zero = self._zero

        def products(i: str, aa: str, bb: str, ab: str) -> list[str]:
            x, y = self.load(z, i, p), self.load(z, i, q)
            pairs = ((aa, x, x), (bb, y, y), (ab, x, y))
            return [self._do("fadd", total, self._do("fmul", one, other)) for total, one, other in pairs]

        aa, bb, ab = self.loop(0, z.shape[0], products, [zero] * 3, [self.T] * 3)
        size = self.call("sqrt", "f", self.width, self._do("fmul", aa, bb))
        bound = self._do("fmul", literal(_EPS, "f", self.width), size)
        apart = self._do("fcmp ogt", self.call("fabs", "f", self.width, ab), bound)
        zeta = self._do("fdiv", self._do("fsub", bb, aa), self._do("fmul", literal(2.0, "f", self.width), ab))
        root = self.call("sqrt", "f", self.width, self._do("fadd", self._one, self._do("fmul", zeta, zeta)))
        sign = self._choose("oge", zeta, zero, self._one, literal(-1.0, "f", self.width))
        tangent = self._do("fdiv", sign, self._do("fadd", self.call("fabs", "f", self.width, zeta), root))
        root = self.call("sqrt", "f", self.width, self._do("fadd", self._one, self._do("fmul", tangent, tangent)))
        cosine = self._do("fdiv", self._one, root)
        sine = self._do("fmul", cosine, tangent)
        some = self.any(apart)
        turn, on = self.fresh("rotate"), self.fresh("on")
        self.lines.append(f"  br i1 {some}, label %{turn}, label %{on}")
        self.begin(turn)
        for view in (z, v):
            self.each(0, view.shape[0], lambda i, view=view: self._rotated(view, i, p, q, cosine, sine, apart))  # type: ignore[misc]
        self.lines.append(f"  br label %{on}")
        self.begin(on)
        return self.line(f"or i1 {turned}, {some}")

    def _rotated(self, view: View, i: Index, p: Index, q: Index, cosine: str, sine: str, apart: str) -> None:
        x, y = self.load(view, i, p), self.load(view, i, q)
        one = self._minus(self._do("fmul", cosine, x), sine, y)
        other = self._do("fadd", self._do("fmul", sine, x), self._do("fmul", cosine, y))
        self.store_at(self.line(f"select {self.mask} {apart}, {self.T} {one}, {self.T} {x}"), view, i, p)
        self.store_at(self.line(f"select {self.mask} {apart}, {self.T} {other}, {self.T} {y}"), view, i, q)
