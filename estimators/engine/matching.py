"""Are arrays like those of the last call? In machine code: in Python this takes longer than most programs."""

from collections.abc import Callable, Sequence
from functools import cache

import numpy as np

from estimators.engine import machine

_TYPE = object.__basicsize__ - 8
"""Bytes from an object's beginning to its type, the last field of the head that all objects have."""
_DATA, _DIMENSIONS, _SHAPE, _DTYPE, _FLAGS = (object.__basicsize__ + at for at in (0, 8, 16, 40, 48))
"""And to the fields of an array (``PyArrayObject_fields``)."""
_CONTIGUOUS = 1  # in C order


def described(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """Types and shapes of arrays, for `matcher`; their types must live as long as this is used."""
    each = [[id(array.dtype), array.ndim, *array.shape] for array in arrays]
    return np.array([len(arrays), *(value for values in each for value in values)], np.int64)


@cache
def matcher() -> Callable[..., bool]:
    """The function ``(described, *objects)``: are these arrays in C order of such types and shapes, and as many?"""
    return machine.load("matching", lambda: _TEXT)[0]  # type: ignore[return-value]


_TEXT = f"""declare void @Py_IncRef(ptr)
@_Py_TrueStruct = external global i8
@_Py_FalseStruct = external global i8

define ptr @call(ptr %self, ptr %args, i64 %count) {{
entry:
  %described = load ptr, ptr %args
  %own = getelementptr i8, ptr %described, i64 {_TYPE}
  %type = load ptr, ptr %own
  %place = getelementptr i8, ptr %described, i64 {_DATA}
  %table = load ptr, ptr %place
  %arrays = load i64, ptr %table
  %first = getelementptr i64, ptr %table, i64 1
  %others = sub i64 %count, 1
  %as_many = icmp eq i64 %arrays, %others
  br i1 %as_many, label %next, label %unlike
next:
  %i = phi i64 [1, %entry], [%after, %alike]
  %at = phi ptr [%first, %entry], [%behind, %alike]
  %more = icmp slt i64 %i, %count
  br i1 %more, label %object, label %like
object:
  %argument = getelementptr ptr, ptr %args, i64 %i
  %array = load ptr, ptr %argument
  %p0 = getelementptr i8, ptr %array, i64 {_TYPE}
  %kind = load ptr, ptr %p0
  %is_array = icmp eq ptr %kind, %type
  br i1 %is_array, label %fields, label %unlike
fields:
  %p1 = getelementptr i8, ptr %array, i64 {_DTYPE}
  %dtype = load i64, ptr %p1
  %expected = load i64, ptr %at
  %same = icmp eq i64 %dtype, %expected
  %p2 = getelementptr i8, ptr %array, i64 {_DIMENSIONS}
  %few = load i32, ptr %p2
  %dimensions = sext i32 %few to i64
  %p3 = getelementptr i64, ptr %at, i64 1
  %size = load i64, ptr %p3
  %fit = icmp eq i64 %dimensions, %size
  %p4 = getelementptr i8, ptr %array, i64 {_FLAGS}
  %flags = load i32, ptr %p4
  %order = and i32 %flags, {_CONTIGUOUS}
  %contiguous = icmp ne i32 %order, 0
  %both = and i1 %same, %fit
  %all = and i1 %both, %contiguous
  %p5 = getelementptr i8, ptr %array, i64 {_SHAPE}
  %shape = load ptr, ptr %p5
  %sizes = getelementptr i64, ptr %at, i64 2
  %behind = getelementptr i64, ptr %sizes, i64 %size
  br i1 %all, label %axis, label %unlike
axis:
  %j = phi i64 [0, %fields], [%k, %equal]
  %left = icmp slt i64 %j, %size
  br i1 %left, label %compare, label %alike
compare:
  %p6 = getelementptr i64, ptr %shape, i64 %j
  %n = load i64, ptr %p6
  %p7 = getelementptr i64, ptr %sizes, i64 %j
  %m = load i64, ptr %p7
  %even = icmp eq i64 %n, %m
  br i1 %even, label %equal, label %unlike
equal:
  %k = add i64 %j, 1
  br label %axis
alike:
  %after = add i64 %i, 1
  br label %next
like:
  call void @Py_IncRef(ptr @_Py_TrueStruct)
  ret ptr @_Py_TrueStruct
unlike:
  call void @Py_IncRef(ptr @_Py_FalseStruct)
  ret ptr @_Py_FalseStruct
}}"""
