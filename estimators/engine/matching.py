"""The Python function that calls compiled functions, in machine code.

Python's own comparison of arguments, and its fresh arrays for results, take longer than programs.

The function reads fields of arrays in memory, so it is used only if these lie where it reads them
and if it calls a known program rightly. ``VESSEL_GYM_FAST_CALLS=0`` turns it off; a call
then takes some 30 us more, and results keep their bits.
"""

import ctypes
import os
import sys
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from estimators.engine import machine
from estimators.engine.program import KINDS, NotTraceable

_HEAD = object.__basicsize__
"""Bytes of the head of all objects, which ends with the type; fields of its kind follow."""


def in_memory(value: Any, kind: str = "") -> np.ndarray:
    """An argument as an array in C order, of a type of the engine: its own type or a given one."""
    array = np.asarray(value)
    kind = kind or array.dtype.kind
    if kind not in KINDS:
        raise NotTraceable(f"a compiled function takes numbers, got {array.dtype}")
    array = np.require(array, KINDS[kind], ["C", "ALIGNED"])
    return array if array.dtype is KINDS[kind] else array.view(KINDS[kind])


_Invoker = Callable[..., Any]
_ENABLED = os.environ.get("VESSEL_GYM_FAST_CALLS") != "0"


@cache
def invoker() -> _Invoker | None:
    """The function of `_created`; None if it is turned off or would not work here."""
    if not (_ENABLED and is_layout_known()):
        return None
    invoke = _created()
    return invoke if is_right(invoke) else None


def is_layout_known() -> bool:
    """Do the fields of an array lie in memory where `_TEXT` reads them?"""
    if sys.implementation.name != "cpython" or np.ndarray.__basicsize__ < _HEAD + 52:
        return False
    array, pointer = np.zeros((2, 3)), ctypes.c_void_p

    def field(kind: Any, byte: int) -> Any:
        return kind.from_address(id(array) + byte).value

    known = (
        field(pointer, _HEAD - 8) == id(type(array))
        and field(pointer, _HEAD) == array.ctypes.data
        and field(ctypes.c_int, _HEAD + 8) == array.ndim
        and field(pointer, _HEAD + 24) == field(pointer, _HEAD + 16) + 8 * array.ndim  # strides
        and field(pointer, _HEAD + 40) == id(array.dtype)
        and field(ctypes.c_int, _HEAD + 48) == array.flags.num
    )
    shape = field(pointer, _HEAD + 16) if known else 0
    return bool(shape) and (*(ctypes.c_int64 * 2).from_address(shape),) == array.shape


def is_right(invoke: _Invoker) -> bool:
    """Does a program that doubles a number give the right array, and others for other arguments?"""
    x = in_memory([[1.5, 0.0]])
    code = machine.load(b"doubles", lambda name: _DOUBLES.replace("@doubles(", f"@{name}("))
    like = id(x.dtype), 2, 1, 2
    others = (x[0],), (x.astype(np.int64),), (np.zeros((1, 4))[:, ::2],)
    unlike = (), (x, x), (x, x, x), *((*each, None, x) for each in others)
    for several in (False, True):
        head = code, 1, 0, 0, 0, several, several, 3, 1
        table = np.array([*head, *like, id(None), 0, 0, 0, *like], np.int64)
        found: Any = invoke(table, _number, x, None, x)
        if type(found) is not (tuple if several else np.ndarray):
            return False
        (y,) = found if several else (found,)
        right = y.dtype is x.dtype and y.shape == x.shape and y[0, 0] == 3.0 and y.flags.owndata
        passed_on = [invoke(table, _number, *each) for each in unlike]
        if not right or y.flags.writeable == several or passed_on != [*map(len, unlike)]:
            return False
    return True


def _number(*arrays: Any) -> int:
    """The number of arrays that a call passes on, because they are unlike the expected ones."""
    return len(arrays)


@cache
def _created() -> _Invoker:
    """The function ``(table, otherwise, *arrays)`` that returns results in new arrays.

    A table of whole numbers has the address of the code, its arguments, the number of first results
    that are read-only, 1 for a tuple of results, the numbers of arguments and results, and for each
    of these the address of its type, its number of axes and its shape. An argument that must be
    None has None's address and no axes, one that is not read zeros. If the number, order in memory,
    types or shapes of arrays differ, the function returns ``otherwise(*arrays)``.
    """
    address = machine.load(b"invoker", lambda name: _TEXT.replace("@call(", f"@{name}("))
    # bytes: the collector of garbage may empty a structure of ctypes before the function reads it
    method = bytes(_Method(b"invoke", address, _FASTCALL, None))
    create = ctypes.pythonapi.PyCFunction_NewEx
    create.restype = ctypes.py_object
    create.argtypes = ctypes.c_char_p, ctypes.py_object, ctypes.c_void_p
    return create(method, method, None)


class _Method(ctypes.Structure):
    """``PyMethodDef``."""

    _fields_ = (("name", ctypes.c_char_p), ("function", ctypes.c_void_p), ("flags", ctypes.c_int),
                ("doc", ctypes.c_char_p))  # fmt: skip


_FASTCALL = 0x80
_DOUBLES = """
define void @doubles(i64 %end, i64 %shared, ptr %scratch, ptr %constants, ptr %arrays) {
  %in = load ptr, ptr %arrays
  %out_at = getelementptr ptr, ptr %arrays, i64 3 ; after the arguments
  %out = load ptr, ptr %out_at
  %x = load double, ptr %in
  %y = fadd double %x, %x
  store double %y, ptr %out
  ret void
}
"""
"""The program of `is_right`."""
_HEADER = "{ptr, i64, i64, ptr, ptr, i64, i64, i64, i64}"
"""Numbers of a table before its types and shapes."""
_TEXT = f"""
declare ptr @PyTuple_New(i64)
declare i32 @PyTuple_SetItem(ptr, i64, ptr)
declare ptr @PyArray_Empty(i32, ptr, ptr, i32)
declare void @Py_IncRef(ptr)
declare void @Py_DecRef(ptr)
declare ptr @PyTuple_GetItem(ptr, i64)
declare ptr @PyObject_Vectorcall(ptr, ptr, i64, ptr)

define internal ptr @field(ptr %object, i64 %byte) {{
  %place = getelementptr i8, ptr %object, i64 %byte
  %value = load ptr, ptr %place
  ret ptr %value
}}

; An entry of the table is the address of a type, the number of axes, and a shape. The next one, or
; null where the array has another type or shape, or is not in C order and aligned.
define internal ptr @matched(ptr %array, ptr %entry, ptr %type) {{
  %own = call ptr @field(ptr %array, i64 {_HEAD - 8})
  %is_array = icmp eq ptr %own, %type
  br i1 %is_array, label %fields, label %other
fields:
  %dtype = call ptr @field(ptr %array, i64 {_HEAD + 40})
  %dtype_expected = load ptr, ptr %entry
  %same_dtype = icmp eq ptr %dtype, %dtype_expected
  %flags_at = getelementptr i8, ptr %array, i64 {_HEAD + 48}
  %flags = load i32, ptr %flags_at
  %ready = and i32 %flags, {0x101}
  %is_ready = icmp eq i32 %ready, {0x101}
  %axes_at = getelementptr i8, ptr %array, i64 {_HEAD + 8}
  %axes32 = load i32, ptr %axes_at
  %axes = zext i32 %axes32 to i64
  %axes_entry = getelementptr i64, ptr %entry, i64 1
  %axes_expected = load i64, ptr %axes_entry
  %same_axes = icmp eq i64 %axes, %axes_expected
  %shape = call ptr @field(ptr %array, i64 {_HEAD + 16})
  %shape_expected = getelementptr i64, ptr %entry, i64 2
  %next = getelementptr i64, ptr %shape_expected, i64 %axes
  %two = and i1 %same_dtype, %is_ready
  %three = and i1 %two, %same_axes
  br i1 %three, label %axis, label %other
axis:
  %i = phi i64 [0, %fields], [%following, %same]
  %done = icmp eq i64 %i, %axes
  br i1 %done, label %alike, label %size
size:
  %size_at = getelementptr i64, ptr %shape, i64 %i
  %size_own = load i64, ptr %size_at
  %expected_at = getelementptr i64, ptr %shape_expected, i64 %i
  %size_expected = load i64, ptr %expected_at
  %same_size = icmp eq i64 %size_own, %size_expected
  br i1 %same_size, label %same, label %other
same:
  %following = add i64 %i, 1
  br label %axis
alike:
  ret ptr %next
other:
  ret ptr null
}}

define ptr @call(ptr %self, ptr %args, i64 %count) {{
entry:
  %first = load ptr, ptr %args
  %type = call ptr @field(ptr %first, i64 {_HEAD - 8})
  %table = call ptr @field(ptr %first, i64 {_HEAD})
  %head = load {_HEADER}, ptr %table
  %inputs = extractvalue {_HEADER} %head, 7
  %outputs = extractvalue {_HEADER} %head, 8
  %sealed = extractvalue {_HEADER} %head, 5
  %begin = getelementptr i64, ptr %table, i64 9
  %expected = add i64 %inputs, 2
  %all = add i64 %inputs, %outputs
  %data = alloca ptr, i64 %all
  %arrays = getelementptr ptr, ptr %args, i64 2
  %as_many = icmp eq i64 %count, %expected
  br i1 %as_many, label %argument, label %unlike
argument:
  %i = phi i64 [0, %entry], [%i_next, %alike], [%i_next, %ignored]
  %at = phi ptr [%begin, %entry], [%at_next, %alike], [%behind, %ignored]
  %ended = icmp eq i64 %i, %inputs
  br i1 %ended, label %create, label %given
given:
  %i_next = add i64 %i, 1
  %array_at = getelementptr ptr, ptr %arrays, i64 %i
  %array = load ptr, ptr %array_at
  %kind = load ptr, ptr %at
  %is_none = icmp eq ptr %kind, %array ; as it has to be
  %is_unread = icmp eq ptr %kind, null
  %is_ignored = or i1 %is_none, %is_unread
  br i1 %is_ignored, label %ignored, label %match
ignored:
  %behind = getelementptr i64, ptr %at, i64 2
  br label %argument
match:
  %at_next = call ptr @matched(ptr %array, ptr %at, ptr %type)
  %is_other = icmp eq ptr %at_next, null
  br i1 %is_other, label %unlike, label %alike
alike:
  %contents = call ptr @field(ptr %array, i64 {_HEAD})
  %contents_at = getelementptr ptr, ptr %data, i64 %i
  store ptr %contents, ptr %contents_at
  br label %argument
create:
  %results = call ptr @PyTuple_New(i64 %outputs)
  %no_tuple = icmp eq ptr %results, null
  br i1 %no_tuple, label %failed, label %result
result:
  %j = phi i64 [0, %create], [%j_next, %made]
  %of = phi ptr [%at, %create], [%of_next, %made]
  %complete = icmp eq i64 %j, %outputs
  br i1 %complete, label %run, label %make
make:
  %j_next = add i64 %j, 1
  %dtype = load ptr, ptr %of
  %axes_at = getelementptr i64, ptr %of, i64 1
  %axes = load i64, ptr %axes_at
  %axes32 = trunc i64 %axes to i32
  %shape = getelementptr i64, ptr %of, i64 2
  %of_next = getelementptr i64, ptr %shape, i64 %axes
  call void @Py_IncRef(ptr %dtype) ; NumPy takes the reference
  %fresh = call ptr @PyArray_Empty(i32 %axes32, ptr %shape, ptr %dtype, i32 0)
  %no_array = icmp eq ptr %fresh, null
  br i1 %no_array, label %lost, label %made
made:
  %fresh_flags_at = getelementptr i8, ptr %fresh, i64 {_HEAD + 48}
  %fresh_flags = load i32, ptr %fresh_flags_at
  %is_sealed = icmp slt i64 %j, %sealed
  %kept = select i1 %is_sealed, i32 {~0x400}, i32 -1 ; NPY_ARRAY_WRITEABLE
  %own_flags = and i32 %fresh_flags, %kept
  store i32 %own_flags, ptr %fresh_flags_at
  %set = call i32 @PyTuple_SetItem(ptr %results, i64 %j, ptr %fresh)
  %fresh_contents = call ptr @field(ptr %fresh, i64 {_HEAD})
  %place = add i64 %inputs, %j
  %fresh_at = getelementptr ptr, ptr %data, i64 %place
  store ptr %fresh_contents, ptr %fresh_at
  br label %result
run:
  %code = extractvalue {_HEADER} %head, 0
  %rows = extractvalue {_HEADER} %head, 1
  %shared = extractvalue {_HEADER} %head, 2
  %scratch = extractvalue {_HEADER} %head, 3
  %constants = extractvalue {_HEADER} %head, 4
  call void %code(i64 %rows, i64 %shared, ptr %scratch, ptr %constants, ptr %data)
  %several = extractvalue {_HEADER} %head, 6
  %is_several = icmp ne i64 %several, 0
  br i1 %is_several, label %whole, label %single
whole:
  ret ptr %results
single:
  %only = call ptr @PyTuple_GetItem(ptr %results, i64 0)
  call void @Py_IncRef(ptr %only)
  call void @Py_DecRef(ptr %results)
  ret ptr %only
lost:
  call void @Py_DecRef(ptr %results)
  ret ptr null ; and MemoryError is set
failed:
  ret ptr null
unlike:
  %otherwise_at = getelementptr ptr, ptr %args, i64 1
  %otherwise = load ptr, ptr %otherwise_at
  %rest = sub i64 %count, 2
  %found = call ptr @PyObject_Vectorcall(ptr %otherwise, ptr %arrays, i64 %rest, ptr null)
  ret ptr %found
}}
"""
"""``invoke`` in LLVM IR; fields of arrays stand where NumPy's ``PyArrayObject_fields`` has them."""
