"""Parts that need no checks: vehicles, tasks, disturbances and functions which say that their tests verify them."""

from collections.abc import Callable
from functools import partial
from types import MethodType
from typing import Any, ClassVar, TypeVar

from estimators.engine import Compiled

_Function = TypeVar("_Function", bound=Callable[..., Any])


class Verified:
    """Base of parts whose classes can be verified: ``class Ferry(Ship, verified=True)``.

    A verified part is a constant, and its methods are NumPy that can be traced (docs/engine.md):
    pure, a row in a batch as alone, finite for ordinary numbers. They are compiled, and called
    without copies and checks.
    """

    verified: ClassVar[bool] = False
    """Do tests hold that this very class is as promised? A class argument, which subclasses do not inherit."""

    def __init_subclass__(cls, verified: bool = False, **arguments: Any) -> None:
        super().__init_subclass__(**arguments)
        cls.verified = verified


def verified(function: _Function) -> _Function:
    """Declare that a function of a sensor, or a system's tuning, is as a `Verified` part's methods are."""
    vars(function)["verified"] = True
    return function


def is_verified(part: Any) -> bool:
    """Is a part verified, with all that it stands beside? A partial function is if the function is.

    A function that is `estimators.engine.compiled` declares itself pure, and counts as verified.
    """
    part = part.func if isinstance(part, partial) else part
    beside = getattr(part, "beside", None)
    return declared(part.__func__ if isinstance(part, MethodType) else part) is True and (
        beside is None or is_verified(beside)
    )


def declared(part: Any) -> Any:
    """Declaration of a function or a class, or of an object's class; None: there is none.

    An attribute that an object passes on from another one does not count.
    """
    if isinstance(part, Compiled):
        return True
    own = getattr(part, "__dict__", {}).get("verified", vars(type(part)).get("verified"))
    return part.verified if isinstance(own, property) and not isinstance(part, type) else own
