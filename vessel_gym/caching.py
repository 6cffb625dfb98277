"""Cache of objects that are built from equal arguments."""

from collections.abc import Callable
from functools import lru_cache, wraps
from typing import Any, TypeVar

_Builder = TypeVar("_Builder", bound=Callable[..., Any])


def cached(build: _Builder) -> _Builder:
    """Return one object for all calls of a function or class with equal arguments.

    Systems, sensors and parts are constants: those without an equality of their own are equal if
    they are identical. With arguments that cannot be hashed, such as arrays, the function is called
    each time.
    """
    kept = lru_cache(maxsize=64)(build)

    @wraps(build, updated=())
    def builder(*arguments: Any) -> Any:
        try:
            hash(arguments)
        except TypeError:
            return build(*arguments)
        return kept(*arguments)

    return builder  # type: ignore[return-value]
