"""Sharing of objects that are built from equal, constant values."""

import pickle
from collections.abc import Callable
from dataclasses import dataclass, field, fields, is_dataclass
from functools import lru_cache, wraps
from io import BytesIO
from types import FunctionType
from typing import Any, TypeVar

import numpy as np

from estimators.engine import Compiled
from vessel_gym.verified import declared

_Builder = TypeVar("_Builder", bound=Callable[..., Any])
_KEPT = 32  # objects kept for a builder
_IMMUTABLE, _HEAP = 1 << 8, 1 << 9
"""Flags of classes, ``Py_TPFLAGS_IMMUTABLETYPE`` and ``Py_TPFLAGS_HEAPTYPE``."""


def shared(build: _Builder) -> _Builder:
    """Return one object for all calls of a function with equal constants.

    Functions and parts that are not verified, and writable arrays, may change; with such arguments
    the function is called each time.
    """

    @lru_cache(maxsize=_KEPT)
    def built(key: _Arguments) -> Any:
        return build(*key.arguments)

    @wraps(build)
    def builder(*arguments: Any) -> Any:
        values = _values(arguments)
        # outside of the except, so that errors of ``build`` come alone
        return build(*arguments) if values is None else built(_Arguments(values, arguments))

    return builder  # type: ignore[return-value]


def _values(arguments: tuple[Any, ...]) -> bytes | None:
    """Values of constants as bytes; None if an argument may change."""
    values = BytesIO()
    pickler = _Values(values)
    try:
        for each in arguments:
            pickler.dump(each)
            pickler.clear_memo()  # objects that arguments have in common do not matter
    except (pickle.PicklingError, TypeError, AttributeError):
        return None
    return values.getvalue()


@dataclass(frozen=True)
class _Arguments:
    """Arguments, which are equal if their values are."""

    values: bytes
    arguments: tuple[Any, ...] = field(compare=False)


class _Values(pickle.Pickler):
    """Pickler of the values of constants, which refuses all else."""

    def reducer_override(self, value: Any) -> Any:
        """Fields of a dataclass without its caches; identities of classes and functions."""
        if not (_constant(value) if (verified := declared(value)) is None else verified):
            raise pickle.PicklingError("it may change")
        if is_dataclass(value) and not isinstance(value, type):
            return type(value), tuple(getattr(value, each.name) for each in fields(value))
        if isinstance(value, FunctionType | Compiled) or (
            isinstance(value, type) and not _built_in(value)
        ):
            return int, (id(value),)  # the cached arguments keep it alive
        return NotImplemented


def _constant(value: Any) -> bool:
    """Is a value without a declaration constant, apart from its parts?"""
    if isinstance(value, type):
        return _built_in(value) or getattr(vars(value).get("__dataclass_params__"), "frozen", False)
    return not (
        isinstance(value, FunctionType) or (isinstance(value, np.ndarray) and value.flags.writeable)
    )


def _built_in(kind: type) -> bool:
    """Is a class immutable for Python code?"""
    return not kind.__flags__ & _HEAP or bool(kind.__flags__ & _IMMUTABLE)
