"""Are arrays like those of the last call? In machine code: in Python this takes longer than most programs.

So does making fresh arrays for results, which are made at once.
"""

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from estimators.engine import machine
from estimators.engine.emit import Emitter, Module
from estimators.engine.program import Program
from estimators.engine.tracer import KINDS, NotTraceable, Tracer, cast

_TYPE = object.__basicsize__ - 8
"""Bytes from an object's beginning to its type, the last field of the head that all objects have."""
DATA, _DIMENSIONS, _SHAPE, _DTYPE, _FLAGS = (object.__basicsize__ + at for at in (0, 8, 16, 40, 48))
"""And to the fields of an array (``PyArrayObject_fields``)."""
_READY = 0x101  # in C order, and aligned
_HALF = 0xFFFFFFFF  # of 8 bytes: what a field of 4 bytes is


def in_memory(value: Any) -> np.ndarray:
    """An argument as an array in C order, of a type that the engine has."""
    array = np.asarray(value)
    if array.dtype not in KINDS.values():
        if array.dtype.kind not in "fiub":
            raise NotTraceable(f"a compiled function takes numbers, got {array.dtype}")
        array = array.astype(float if array.dtype.kind == "f" else KINDS[array.dtype.kind])
    flags = array.flags
    return array if flags.c_contiguous and flags.aligned else np.array(array, order="C")


def kind_of(array: np.ndarray) -> str:
    """The letter of an array's type."""
    return next(kind for kind, dtype in KINDS.items() if dtype == array.dtype)


class Call(NamedTuple):
    """A call whose arguments needed no preparation: the next one of arrays like these needs none either."""

    fresh: Callable[..., Sequence[np.ndarray] | None]
    described: np.ndarray
    types: list[np.dtype]  # which are kept for those that are described
    run: Callable[..., None]


def described(arrays: Sequence[np.ndarray], results: Sequence[np.ndarray] = ()) -> np.ndarray:
    """Types and shapes of arrays, for `matcher`; their types must live as long as this is used."""
    words: list[int] = []
    for each in (arrays, results):
        words += [
            len(each),
            *(word for array in each for word in (id(array.dtype), array.ndim, *array.shape)),
        ]
    return np.array(words, np.int64)


@cache
def matcher() -> Callable[..., tuple[np.ndarray, ...] | None]:
    """The function ``(described, *objects)``: fresh arrays like the results, or None.

    They are None unless the objects are arrays in C order of such types and shapes, and as many.
    """
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
            alike = (word(array, _DTYPE) == word(table, at)) & (
                (word(array, _DIMENSIONS) & _HALF) == axes
            )
            alike = alike & ((word(array, _FLAGS) & _READY) == _READY)

            def axis(j: Tracer, alike: Tracer) -> list[Tracer]:
                return [alike & (word(shape, 8 * j) == word(table, at + 16 + 8 * j))]

            return [at + 16 + 8 * axes, *emitter.loop(0, cast(alike, "i") * axes, axis, [alike])]

        return emitter.loop(
            0, cast(is_array, "i"), fields, [at, is_array]
        )  # of what is no array no field is read

    table, kind = pointer(pointer("%args", 0), DATA), word(pointer("%args", 0), _TYPE)
    count = emitter.one.value("%count", "i")
    as_many, start = word(table, 0) == count - 1, emitter.one.value("8", "i")
    at, alike = emitter.loop(1, count, matches, [start, as_many], going=lambda _, alike: alike)
    emitter.lines.append(f"  br i1 {emitter.one.name(alike)}, label %alike, label %unlike")
    emitter.begin("alike")
    results = word(table, at)
    fresh = emitter.line(f"call ptr @PyTuple_New(i64 {emitter.one.name(results)})")

    def result(i: Tracer, at: Tracer, _: Tracer) -> list[Tracer]:
        dtype, axes = pointer(table, at), word(table, at + 8)
        emitter.lines.append(f"  call void @Py_IncRef(ptr {dtype})")  # NumPy takes the reference
        shape, few = (
            emitter.at(table, at + 16, "i8"),
            emitter.line(f"trunc i64 {emitter.one.name(axes)} to i32"),
        )
        array = emitter.line(f"call ptr @PyArray_Empty(i32 {few}, ptr {shape}, ptr {dtype}, i32 0)")
        emitter.line(
            f"call i32 @PyTuple_SetItem(ptr {fresh}, i64 {emitter.one.name(i)}, ptr {array})"
        )
        return [
            at + 16 + 8 * axes,
            emitter.one.value(emitter.line(f"icmp ne ptr {array}, null"), "b"),
        ]

    there = emitter.one.value(emitter.line(f"icmp ne ptr {fresh}, null"), "b")
    _, made = emitter.loop(0, results, result, [at + start, there], going=lambda _, made: made)
    answer, lost = (
        emitter.line(f"select i1 {emitter.one.name(made)}, ptr {one}, ptr {other}")
        for one, other in ((fresh, "null"), ("null", fresh))  # without memory it raises
    )
    return "\n".join([
        *(f"declare void @{name}(ptr)" for name in ("Py_IncRef", "Py_DecRef")), "@_Py_NoneStruct = external global i8",
        "declare ptr @PyTuple_New(i64)", "declare i32 @PyTuple_SetItem(ptr, i64, ptr)",
        "declare ptr @PyArray_Empty(i32, ptr, ptr, i32)",
        "define ptr @call(ptr %self, ptr %args, i64 %count) {", "entry:", *emitter.lines,
        f"  call void @Py_DecRef(ptr {lost})", f"  ret ptr {answer}", "unlike:",
        "  call void @Py_IncRef(ptr @_Py_NoneStruct)", "  ret ptr @_Py_NoneStruct", "}",
    ])  # fmt: skip
