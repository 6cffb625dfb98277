"""`numpy.zeros`, `numpy.asarray` and the like while a function that is not ours is traced.

NumPy lets tracers take part in its functions of arrays, but not in those that make one. Users write
results into fresh arrays, and begin functions with `numpy.asarray`. So these functions are others
in the thread that traces, for code that is neither the engine's nor NumPy's, until it is traced.
"""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from threading import RLock, local
from typing import Any

import numpy as np

from estimators.engine.arrays import TracedArray
from estimators.engine.tracer import Tracer

_FILLED = {"zeros": 0.0, "ones": 1.0, "empty": 0.0}
_CONVERTING = ("array", "asarray", "asanyarray", "ascontiguousarray")
_replacing = RLock()
_thread = local()


@contextmanager
def traced_creation() -> Iterator[None]:
    """Fresh arrays can hold tracers: in this thread, while this is open."""
    with _replacing:
        own = {name: getattr(np, name) for name in (*_FILLED, *_CONVERTING)}
        for name, function in own.items():
            setattr(np, name, _replaced(name, function))
        before, _thread.open = getattr(_thread, "open", False), True
        try:
            yield
        finally:
            _thread.open = before
            for name, function in own.items():
                setattr(np, name, function)


def _replaced(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(function)
    def make(*args: Any, **kwargs: Any) -> Any:
        if getattr(_thread, "open", False):
            caller = sys._getframe(1)
            module = str(caller.f_globals.get("__name__"))
            # Compiled extensions have no frame: they write into what they get as if it were plain
            # memory.
            by_name = name in caller.f_code.co_names
            if by_name and not module.startswith(("estimators.engine", "numpy", "scipy")):
                found = (
                    _filled(name, *args, **kwargs)
                    if name in _FILLED
                    else _converted(name, *args, **kwargs)
                )
                if found is not None:
                    return found
        return function(*args, **kwargs)

    return make


def _filled(name: str, shape: Any, dtype: Any = float, **others: Any) -> TracedArray | None:
    """A fresh array of floats."""
    if others or dtype is None or np.dtype(dtype) != float:
        return None
    return np.full(shape, _FILLED[name], object).view(TracedArray)


def _converted(name: str, value: Any, dtype: Any = None, **others: Any) -> TracedArray | None:
    """Tracers, or lists of them, as an array; what has none in it is as ever."""
    if not _traced(value) or others.keys() - {"copy", "order"}:
        return None
    array = _stacked(value)
    if dtype is not None and np.dtype(dtype) != object:
        return TracedArray.of(array.astype(dtype))
    return array.copy() if name == "array" and others.get("copy", True) else array


def _traced(value: Any) -> bool:
    if isinstance(value, list | tuple):
        return any(map(_traced, value))
    return isinstance(value, Tracer | TracedArray)


def _stacked(value: Any) -> TracedArray:
    if isinstance(value, list | tuple):
        return TracedArray.of(np.stack([_stacked(each) for each in value]))
    return value if isinstance(value, TracedArray) else TracedArray.of(value)
