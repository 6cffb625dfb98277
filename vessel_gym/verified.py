"""Declaration of parts and functions that need no run-time checks, because tests verify them."""

from collections.abc import Callable
from functools import partial
from types import MethodType
from typing import Any, ClassVar, TypeVar

from estimators.engine import Compiled

_Function = TypeVar("_Function", bound=Callable[..., Any])


class Verified:
    """Base of parts whose classes can be verified: ``class Ferry(Ship, verified=True)``.

    A verified part is constant. Its methods are traceable NumPy (docs/engine.md) without side
    effects, give a row alone the same values as in a batch, and are finite for ordinary numbers.
    They are compiled, and called without copies and checks.
    """

    verified: ClassVar[bool] = False
    """Was this class declared with ``verified=True``? Its subclasses must declare it themselves."""

    def __init_subclass__(cls, verified: bool = False, **arguments: Any) -> None:
        super().__init_subclass__(**arguments)
        cls.verified = verified


def verified(function: _Function) -> _Function:
    """Declare that a sensor's function or a system's tuning fulfils the promises of `Verified`."""
    vars(function)["verified"] = True
    return function


def is_verified(part: Any) -> bool:
    """Is a part verified, with the disturbance ``beside`` it? A partial is if its function is.

    A function that is `estimators.engine.compiled` counts as verified.
    """
    part = part.func if isinstance(part, partial) else part
    beside = getattr(part, "beside", None)
    return declared(part.__func__ if isinstance(part, MethodType) else part) is True and (
        beside is None or is_verified(beside)
    )


def declared(part: Any) -> Any:
    """Declaration of a function, of a class, or of an object's class; None: no declaration.

    Attributes that an object forwards from another one do not count.
    """
    if isinstance(part, Compiled):
        return True
    own = getattr(part, "__dict__", {}).get("verified", vars(type(part)).get("verified"))
    return part.verified if isinstance(own, property) and not isinstance(part, type) else own
