"""Compiled functions: a program for each row of a batch of arrays in C order."""

import ctypes
import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, ClassVar, NamedTuple

import numpy as np

from estimators.engine import machine
from estimators.engine.matching import in_memory, invoker
from estimators.engine.program import KINDS, LITERAL, Instruction, Program, View


class Argument(NamedTuple):
    """An argument of a compiled function: shape and kind of a row.

    With ``whole``, operations of its large vectors and matrices are loops
    (`estimators.engine.matrices`), not unrolled.
    """

    shape: tuple[int, ...]
    kind: str = "f"
    whole: bool = False

    @property
    def size(self) -> int:
        """Entries of a row."""
        return math.prod(self.shape)


class Function:
    """A program with its machine code for one row and for many, each compiled at first need.

    Args:
        program: The program; its instructions ``input`` and ``input_matrix`` read the arguments.
        arguments: Shape and kind of a row of each argument.
        outputs: For each result its scalars or the view of a matrix, and an argument like it.
        several: Does the traced function give a tuple of results?
        names: Names of the results of a function that gives a dictionary.
        sealed: Does it ignore arguments that it does not read, and return read-only arrays?
        own: Number of last results that are the caller's own: writable, though ``sealed``.

    Attributes:
        arguments: Shape and kind of a row of each argument that it reads, by its index.
        call: Results for arrays, in machine code if they are like the last ones; others are passed
            to ``otherwise``.
        computed: Calls of `compute` by all functions, each some 30 us slower than `call`.
        layout: Places of matrices in the scratch.
        places: Places of constants in memory; others are literals of the code.
        otherwise: Function of arrays unlike the last ones: `compute`, unless it is set.
    """

    computed: ClassVar[int] = 0

    def __init__(
        self,
        program: Program,
        arguments: Sequence[Argument | None],
        outputs: Sequence[tuple[Any, Argument]],
        several: bool,
        names: tuple[str, ...],
        sealed: bool,
        own: int = 0,
    ) -> None:
        self.program, self.names, self.count = program, names, len(arguments)
        self._several = several
        self._sealed = len(outputs) - own if sealed else 0
        self.outputs = [parts for parts, _ in outputs]
        self.results = [row for _, row in outputs]
        of_outputs = (each for parts in self.outputs for each in parts)
        values = [each.value if isinstance(each, View) else each for each in of_outputs]
        self.instructions = program.complete(values)
        read = {each.attributes[0] for each in self.instructions if each.opcode in _INPUTS}
        self.arguments = {
            i: row for i, row in enumerate(arguments) if row and (i in read or not sealed)
        }
        self.layout, self._scratch = _laid_out(program, self.instructions, values)
        self.places, self._literals, self._constants = _placed(program)
        self._address = self._constants.__array_interface__["data"][0]
        self._codes: dict[int, int] = {}
        self.otherwise: Callable[..., Any] = self.compute
        self.call: Callable[..., Any] = self.compute

    def compute(self, *arrays: Any) -> Any:
        """Results for arrays of one batch; an array without batch axes is shared by all rows."""
        Function.computed += 1
        given, leading = [*arrays], {}
        for i, each in self.arguments.items():
            given[i] = a = in_memory(arrays[i], each.kind)
            leading[i] = a.shape[: a.ndim - len(each.shape)]
        batch = np.broadcast_shapes(*leading.values())
        shared = 0
        for i, axes in leading.items():
            if math.prod(axes) == 1:
                shared |= (axes != batch) << i
            elif axes != batch:
                given[i] = np.broadcast_to(given[i], batch + self.arguments[i].shape).copy()
        rows = math.prod(batch)
        width = machine.lanes() if rows >= machine.lanes() else 1
        room = machine.scratch(width * self._scratch)
        head = self._code(width), rows, shared, room, self._address
        if (invoke := invoker()) is None:
            return self._called(head, given, batch)
        table = [*head, self._sealed, self._several, len(given), len(self.results)]
        for i, a in enumerate(given):
            table += (
                (id(a.dtype), a.ndim, *a.shape)
                if i in leading
                else (id(None) if a is None else 0, 0)
            )
        for each in self.results:
            shape = batch + each.shape
            table += id(KINDS[each.kind]), len(shape), *shape
        self.call = partial(invoke, np.array(table, np.int64), self.otherwise)
        return self.call(*given)

    def _called(self, head: Sequence[int], given: Sequence[Any], batch: tuple[int, ...]) -> Any:
        """Results by ctypes, for a Python or a NumPy whose arrays `invoker` does not know."""
        results = [np.empty(batch + each.shape, KINDS[each.kind]) for each in self.results]
        data = [a.ctypes.data if i in self.arguments else 0 for i, a in enumerate(given)]
        places = np.array([*data, *(a.ctypes.data for a in results)], np.uintp)
        code, *numbers = head
        _CODE(code)(*numbers, places.ctypes.data)
        for array in results[: self._sealed]:
            array.setflags(write=False)
        return tuple(results) if self._several else results[0]

    def _code(self, width: int) -> int:
        """Machine code for ``width`` rows side by side; programs with other numbers share it."""
        if width not in self._codes:
            code = str((
                self.instructions, self.outputs, self.arguments, self.count, self.results, width,
                self._literals, self.places, self.program.sizes, self.program.kinds,
            )).encode()  # fmt: skip
            self._codes[width] = machine.load(code, partial(self.text, width))
        return self._codes[width]

    def text(self, width: int, name: str) -> str:
        """The program in LLVM IR, as a function of a name."""
        from estimators.engine.driver import Driver  # late: code that is kept needs no emitters

        return Driver(self, width).text(name)


_CODE = ctypes.PYFUNCTYPE(None, ctypes.c_int64, ctypes.c_int64, *[ctypes.c_void_p] * 3)
"""Type of compiled programs; it keeps the lock of the interpreter, as the scratch is shared."""


def _placed(program: Program) -> tuple[dict[int, int], dict[int, Any], np.ndarray]:
    """Constants of a program: offsets of those in memory, literals, numbers in memory."""
    places, literals, numbers = dict[int, int](), dict[int, Any](), list[float]()
    for value, x in program.constants.items():
        if program.kinds[value] != "f" or x in LITERAL or x != x:
            literals[value] = x
        else:
            places[value] = len(numbers)
            numbers.append(x)
    for value, table in program.tables.items():
        places[value] = len(numbers)
        numbers.extend(table)
    return places, literals, np.array(numbers, float)


def _laid_out(
    program: Program, instructions: Sequence[Instruction], outputs: Sequence[int]
) -> tuple[dict[int, int], int]:
    """Places of a program's matrices in its scratch, and its size.

    The place of a matrix that is no longer needed is used for another one of its size.
    """
    places: dict[int, int] = {}
    total, free = 0, defaultdict[int, list[int]](list)
    of_matrices = [
        (at, each)
        for at, each in enumerate(instructions)
        if each.result in program.sizes or View in map(type, each.operands)
    ]
    last = {value: at for at, each in of_matrices for value in each.values}
    last |= dict.fromkeys(outputs, len(instructions))
    for at, each in of_matrices:
        size = program.sizes.get(each.result)
        if size is not None:
            if not free[size]:
                free[size].append(total)
                total += size
            places[each.result] = free[size].pop()
        for value in {*each.values, each.result} & places.keys():
            if last.get(value, at) == at:
                free[program.sizes[value]].append(places[value])
    return places, total


_INPUTS = "input", "input_matrix"
