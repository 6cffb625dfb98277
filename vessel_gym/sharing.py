"""Objects that are built of equal values are one and the same, if nobody can change these values."""

import pickle
from collections.abc import Callable
from dataclasses import dataclass, field, fields, is_dataclass
from functools import lru_cache, wraps
from io import BytesIO
from types import FunctionType
from typing import Any, TypeVar

import numpy as np

_Builder = TypeVar("_Builder", bound=Callable[..., Any])
_KEPT = 32  # objects of a builder
_OURS = "vessel_gym", "estimators", "numpy", "builtins", "functools", "copyreg", "collections"


def shared(build: _Builder) -> _Builder:
    """Return the same object whenever a function is called with the same immutable values of this package.

    Whatever somebody else has written, or an array that can be written to, may change: with such arguments the function
    is called anew.
    """

    @lru_cache(maxsize=_KEPT)
    def built(key: _Arguments) -> Any:
        return build(*key.arguments)

    @wraps(build)
    def builder(*arguments: Any) -> Any:
        values = BytesIO()
        pickler = _Values(values)
        try:
            for each in arguments:
                pickler.dump(each)
                pickler.clear_memo()  # whether two arguments have an object in common does not matter
        except (pickle.PicklingError, TypeError, AttributeError):
            return build(*arguments)
        return built(_Arguments(values.getvalue(), arguments))

    return builder  # type: ignore[return-value]


@dataclass(frozen=True)
class _Arguments:
    """Arguments, which are equal where their values are."""

    values: bytes
    arguments: tuple[Any, ...] = field(compare=False)


class _Values(pickle.Pickler):
    """The values of immutable objects of this package; others are refused."""

    def reducer_override(self, value: Any) -> Any:
        """Parts of one value: a record's fields, without what it has cached."""
        if isinstance(value, type | FunctionType) and value.__module__.partition(".")[0] not in _OURS:
            raise pickle.PicklingError("what somebody else has written may change")
        if isinstance(value, np.ndarray) and value.flags.writeable:
            raise pickle.PicklingError("an array may change")
        if is_dataclass(value) and not isinstance(value, type):
            return type(value), tuple(getattr(value, each.name) for each in fields(value))
        return NotImplemented
