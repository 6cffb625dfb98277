"""Programs of traced functions: instructions of one row in static single assignment form.

A value is a number that stands for a scalar, or for a matrix, which is never written again once it
is complete. Kinds of values are those of NumPy by a letter: ``f`` float64, ``i`` int64, ``u``
uint64 (random words), ``b`` a mask.
"""

import struct
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

KINDS = {
    "f": np.dtype(float),
    "i": np.dtype(np.int64),
    "u": np.dtype(np.uint64),
    "b": np.dtype(bool),
}
LITERAL = (0.0, 1.0, -1.0, 0.5, -0.5, 2.0, np.inf, -np.inf)
"""Floats that are literals in the code; other constants are read from memory."""
_LONGEST = 100_000  # values of a program; LLVM needs a second for 20,000


class NotTraceable(TypeError):
    """The function uses an operation that cannot be traced; it can run in NumPy."""


class View(NamedTuple):
    """A matrix among the entries of a value, at ``start + i * steps[0] + j * steps[1]``."""

    value: int
    shape: tuple[int, int]
    start: int
    steps: tuple[int, int]


class Instruction(NamedTuple):
    """``result = opcode(operands)`` of values and views; attributes are constants."""

    opcode: str
    operands: tuple[int | View, ...]
    result: int
    attributes: tuple[Any, ...] = ()

    @property
    def values(self) -> set[int]:
        """The values that it reads."""
        return {each.value if isinstance(each, View) else each for each in self.operands}


class Columns(NamedTuple):
    """Body of a ``columns``: its parameters are the entries of a column of each view."""

    size: int
    parameters: tuple[tuple[int, ...], ...]
    body: tuple[Instruction, ...]
    results: tuple[int, ...]


class Program:
    """Instructions as they were traced.

    Attributes:
        kinds: Letter of the kind of each value.
        sizes: Number of entries of each value that is a matrix.
        constants: Constant scalars by value number.
        tables: Constant matrices, the same for all rows, by value number.
    """

    def __init__(self) -> None:
        self.kinds: Any = []
        self.sizes: dict[int, int] = {}
        self.constants: dict[int, Any] = {}
        self.tables: dict[int, np.ndarray] = {}
        self._blocks: list[dict[Any, Instruction]] = [{}]  # in order
        self._constants: dict[tuple[str, Any], int] = {}

    def new(self, kind: str, size: int | None = None) -> int:
        """A new value: a scalar, or a matrix of ``size`` entries."""
        self.kinds.append(kind)
        if size is not None:
            self.sizes[len(self.kinds) - 1] = size
        return len(self.kinds) - 1

    def constant(self, value: Any, kind: str) -> int:
        """A constant scalar; 0.0 and -0.0 are different constants."""
        key = kind, struct.pack("<d", value) if kind == "f" else int(value)
        if key not in self._constants:
            self._constants[key] = self.new(kind)
            self.constants[self._constants[key]] = value
        return self._constants[key]

    def table(self, values: np.ndarray) -> int:
        """A matrix, the same for all rows."""
        flat = np.array(values, float).ravel()
        key = "table", flat.tobytes()
        if key not in self._constants:
            self._constants[key] = self.new("f", flat.size)
            self.tables[self._constants[key]] = flat
        return self._constants[key]

    def add(
        self, opcode: str, operands: tuple[int | View, ...], kind: str, size: int | None = None,
        attributes: tuple[Any, ...] = (),
    ) -> int:  # fmt: skip
        """An instruction's result, or the earlier result of the same instruction."""
        key = opcode, operands, kind, size, attributes
        for block in self._blocks:
            if (earlier := block.get(key)) is not None:
                return earlier.result
        if len(self.kinds) > _LONGEST:
            raise NotTraceable(
                "its loops are too long to be unrolled: use NumPy's functions of arrays"
            )
        result = self.new(kind, size)
        block = self._blocks[0 if opcode == "element" else -1]  # a loop reads it once, before
        block[key] = Instruction(opcode, operands, result, attributes)
        return result

    def columns(self, views: Sequence[View], body: Callable[..., Sequence[int]]) -> int:
        """The matrix of results of a body, traced once, for each column of matrices."""
        parameters = tuple(tuple(self.new("f") for _ in range(view.shape[0])) for view in views)
        self._blocks.append({})
        results = tuple(body(*parameters))
        inside = tuple(self._blocks.pop().values())
        if any(each.result in self.sizes for each in inside):
            raise TypeError("a function of columns computes scalars, no matrices")
        own = {each.result for each in inside}.union(*parameters)
        outer = sorted(set(results).union(*(each.values for each in inside)) - own)
        count = views[0].shape[1]
        loop = Columns(count, parameters, inside, results)
        value = self.new("f", len(results) * count)
        self._blocks[-1][loop] = Instruction("columns", (*views, *outer), value, (loop,))
        return value

    def live(self, outputs: Sequence[int]) -> list[Instruction]:
        """The instructions that outputs need, in order."""
        needed, kept = set(outputs), []
        for each in reversed(self._blocks[0].values()):
            if each.result in needed:
                kept.append(each)
                needed |= each.values
        return kept[::-1]

    def complete(self, outputs: Sequence[int]) -> tuple[Instruction, ...]:
        """The instructions that outputs need; nothing can be added to the program afterwards."""
        live = tuple(self.live(outputs))
        self._blocks, self._constants, self.kinds = [{}], {}, "".join(self.kinds)
        return live
