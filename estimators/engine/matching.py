"""Are arrays like those of the last call? In machine code: in Python this takes longer than most programs."""

from collections.abc import Callable, Sequence
from functools import cache

import numpy as np

from estimators.engine import machine
from estimators.engine.emit import Emitter, Module
from estimators.engine.program import Program
from estimators.engine.tracer import Tracer, cast

_TYPE = object.__basicsize__ - 8
"""Bytes from an object's beginning to its type, the last field of the head that all objects have."""
DATA, _DIMENSIONS, _SHAPE, _DTYPE, _FLAGS = (object.__basicsize__ + at for at in (0, 8, 16, 40, 48))
"""And to the fields of an array (``PyArrayObject_fields``)."""
_CONTIGUOUS = 1  # in C order
_HALF = 0xFFFFFFFF  # of 8 bytes: what a field of 4 bytes is


def described(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """Types and shapes of arrays, for `matcher`; their types must live as long as this is used."""
    each = [[id(array.dtype), array.ndim, *array.shape] for array in arrays]
    return np.array([len(arrays), *(value for values in each for value in values)], np.int64)


@cache
def matcher() -> Callable[..., bool]:
    """The function ``(described, *objects)``: are these arrays in C order of such types and shapes, and as many?"""
    return machine.load(b"matching", _text)


def _text() -> str:
    """The function in LLVM IR."""
    emitter = Emitter(Program(), Module({}), 1)

    pointer, word = emitter.pointer, emitter.word

    def matches(i: Tracer, at: Tracer, _: Tracer) -> list[Tracer]:
        array = pointer("%args", 8 * i)
        is_array = word(array, _TYPE) == kind

        def fields(_: Tracer, at: Tracer, _alike: Tracer) -> list[Tracer]:
            axes, shape = word(table, at + 8), pointer(array, _SHAPE)
            alike = (word(array, _DTYPE) == word(table, at)) & ((word(array, _DIMENSIONS) & _HALF) == axes)
            alike = alike & ((word(array, _FLAGS) & _CONTIGUOUS) != 0)

            def axis(j: Tracer, alike: Tracer) -> list[Tracer]:
                return [alike & (word(shape, 8 * j) == word(table, at + 16 + 8 * j))]

            return [at + 16 + 8 * axes, *emitter.loop(0, cast(alike, "i") * axes, axis, [alike])]

        return emitter.loop(0, cast(is_array, "i"), fields, [at, is_array])  # of what is no array no field is read

    table, kind = pointer(pointer("%args", 0), DATA), word(pointer("%args", 0), _TYPE)
    count = emitter.one.value("%count", "i")
    as_many, start = word(table, 0) == count - 1, emitter.one.value("8", "i")
    _, alike = emitter.loop(1, count, matches, [start, as_many], going=lambda _, alike: alike)
    answer = emitter.line(f"select i1 {emitter.one.name(alike)}, ptr @_Py_TrueStruct, ptr @_Py_FalseStruct")
    return "\n".join([
        "declare void @Py_IncRef(ptr)", "@_Py_TrueStruct = external global i8", "@_Py_FalseStruct = external global i8",
        "define ptr @call(ptr %self, ptr %args, i64 %count) {", "entry:", *emitter.lines,
        f"  call void @Py_IncRef(ptr {answer})", f"  ret ptr {answer}", "}",
    ])  # fmt: skip
