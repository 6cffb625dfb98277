"""Do objects still hold what they held? In machine code: a loop in Python takes longer than most programs."""

from collections.abc import Callable, Iterable
from functools import cache
from operator import getitem, length_hint
from typing import Any

import numpy as np

from estimators.engine import machine
from estimators.engine.emit import Emitter, Module
from estimators.engine.matching import DATA, described, matcher
from estimators.engine.program import Program
from estimators.engine.tracer import Tracer

_BYTES = bytes.__basicsize__ - 1
"""From the beginning of an object of bytes to its contents."""
_ROW = 3 * 8  # bytes of the table


class Snapshot:
    """Lengths, items, attributes and contents of arrays as they are now. Of objects the identity counts.

    Args:
        watched: A function of `READ`, and a holder, a key and the value that it gives of these; the
            key of a length is not looked at.
        arrays: Arrays and the bytes that they hold, in C order.
    """

    def __init__(
        self, watched: Iterable[tuple[Callable[[Any, Any], Any], Any, Any, Any]],
        arrays: Iterable[tuple[np.ndarray, bytes]],
    ) -> None:  # fmt: skip
        self._kept = list(watched), list(arrays)  # whose addresses the table has
        rows: list[list[tuple[int, int, int]]] = [[] for _ in READ]
        for read, holder, key, value in self._kept[0]:
            expected = (value, 0) if read is length_hint else (id(key), id(value))
            rows[READ.index(read)].append((id(holder), *expected))
        plain = [(array, contents) for array, contents in self._kept[1] if array.flags.c_contiguous]
        rows.append(
            [(id(array), id(contents) + _BYTES, len(contents)) for array, contents in plain]
        )
        self._table = np.array(
            [*map(len, rows), *(word for each in rows for row in each for word in row)], np.int64
        )
        self._arrays = [array for array, _ in plain]
        self._described, self._dtypes = (
            described(self._arrays),
            [array.dtype for array in self._arrays],
        )
        self._others = [
            (array, contents) for array, contents in self._kept[1] if not array.flags.c_contiguous
        ]
        self._matches, self._holds = matcher(), _holds()

    def holds(self) -> bool:
        """Is everything as it was?"""
        alike = self._matches(self._described, *self._arrays)  # else other numbers of bytes
        return (
            alike is not None
            and self._holds(self._table)
            and all(array.tobytes() == contents for array, contents in self._others)
        )


READ = length_hint, getitem, getattr
"""Functions of a holder and a key by which objects are read."""


@cache
def _holds() -> Callable[..., bool]:
    """The function of a table of addresses, whose first row counts its rows of lengths, items, attributes, arrays."""
    return machine.load(b"snapshot", _text)


def _text() -> str:
    """The function in LLVM IR."""
    emitter = Emitter(Program(), Module({}), 1)
    pointer, word, line, value = emitter.pointer, emitter.word, emitter.line, emitter.one.value
    table = pointer(pointer("%args", 0), DATA)

    def length(at: Tracer) -> Tracer:
        return value(line(f"call i64 @PyObject_Size(ptr {pointer(table, at)})"), "i") == word(
            table, at + 8
        )

    def read(function: str) -> Callable[[Tracer], Tracer]:
        def same(at: Tracer) -> Tracer:
            found = line(
                f"call ptr @{function}(ptr {pointer(table, at)}, ptr {pointer(table, at + 8)})"
            )
            address = value(line(f"ptrtoint ptr {found} to i64"), "i")
            emitter.lines.append(
                f"  call void @Py_DecRef(ptr {found})"
            )  # the snapshot keeps the one that it was
            return address == word(table, at + 16)

        return same

    def contents(at: Tracer) -> Tracer:
        data, expected = pointer(pointer(table, at), DATA), pointer(table, at + 8)
        size = emitter.one.name(word(table, at + 16))
        order = line(f"call i32 @memcmp(ptr {data}, ptr {expected}, i64 {size})")
        return value(line(f"icmp eq i32 {order}, 0"), "b")

    sections = length, read("PyObject_GetItem"), read("PyObject_GetAttr"), contents
    at, alike = value(str(8 * len(sections)), "i"), value("true", "b")
    for section, same in enumerate(sections):

        def row(
            _: Tracer, at: Tracer, _alike: Tracer, same: Callable[[Tracer], Tracer] = same
        ) -> list[Any]:
            return [at + _ROW, same(at)]

        at, alike = emitter.loop(
            0, word(table, 8 * section), row, [at, alike], going=lambda _, alike: alike
        )
    answer = line(f"select i1 {emitter.one.name(alike)}, ptr @_Py_TrueStruct, ptr @_Py_FalseStruct")
    return "\n".join([
        "declare void @Py_IncRef(ptr)", "declare void @Py_DecRef(ptr)", "declare void @PyErr_Clear()",
        "declare i64 @PyObject_Size(ptr)", "declare ptr @PyObject_GetItem(ptr, ptr)",
        "declare ptr @PyObject_GetAttr(ptr, ptr)", "declare i32 @memcmp(ptr, ptr, i64)",
        "@_Py_TrueStruct = external global i8", "@_Py_FalseStruct = external global i8",
        "define ptr @call(ptr %self, ptr %args, i64 %count) {", "entry:", *emitter.lines,
        "  call void @PyErr_Clear()", f"  call void @Py_IncRef(ptr {answer})", f"  ret ptr {answer}", "}",
    ])  # fmt: skip
