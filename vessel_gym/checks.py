"""What arguments may be, and the sentence that answers one that may not."""

import inspect
from collections.abc import Collection, Mapping
from typing import Any

from estimators.checks import as_number as number
from estimators.checks import numbers, shown
from estimators.factory import unknown

__all__ = ["function", "no_others", "number", "numbers", "one_of", "options"]


def one_of(kind: str, value: object, known: Collection[str]) -> str:
    """A value that is one of the known names.

    Raises:
        ValueError: if it is none, saying which there are.
    """
    if isinstance(value, str) and value in known:
        return value
    raise ValueError(unknown(kind, value, known))


def function(name: str, value: object, of: str) -> None:
    """Refuse what cannot be called.

    Raises:
        TypeError: for anything but a function, or None.
    """
    if value is not None and not callable(value):
        raise TypeError(f"{name} must be a function of {of}, got {shown(value)}")


def options(name: str, value: object) -> dict[str, Any]:
    """A copy of options by name; None: none.

    Raises:
        TypeError: if they are not a mapping from strings.
    """
    if value is None:
        return {}
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise TypeError(f"{name} must be a dictionary of values by name, or None, got {shown(value)}")
    return dict(value)


def no_others(name: str, made: type, others: Mapping[str, object]) -> None:
    """Refuse arguments that a class collects only to say that neither it nor one below it has them.

    Raises:
        TypeError: naming the first, and those that there are.
    """
    for other in others:
        own = (base.__dict__["__init__"] for base in made.__mro__ if base.__module__.startswith("vessel_gym.") and
               "__init__" in base.__dict__)  # fmt: skip
        listed = [parameter for function in own for parameter in inspect.signature(function).parameters.values()]
        known = dict.fromkeys(p.name for p in listed if p.kind is not p.VAR_KEYWORD and p.name != "self")
        raise TypeError(unknown(f"argument of {name}", other, list(known)))
