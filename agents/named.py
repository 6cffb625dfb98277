"""Look-up of environments and of ``"module:object"``, which runs the code of the module."""

from importlib import import_module
from types import ModuleType
from typing import Any

import gymnasium as gym
from gymnasium.envs.registration import load_env_creator


def named_object(name: str) -> Any:
    """Import the object that ``"module:object"`` names.

    Raises:
        ValueError: if there is no such module, or no such object in it.
    """
    module, _, attribute = name.partition(":")
    imported = imported_module(module, name)
    if not hasattr(imported, attribute):
        raise ValueError(f"module {module!r} has no {attribute!r}")
    return getattr(imported, attribute)


def imported_module(module: str, name: str) -> ModuleType:
    """The module of a name that is ``"module:object"``.

    Raises:
        ValueError: if there is no such module.
    """
    if not all(part.isidentifier() for part in module.split(".")):
        raise ValueError(
            f"{name!r} names no module: your own is module:object, with the module as Python"
            " imports it"
        )
    try:
        return import_module(module)
    except (ImportError, SyntaxError) as error:
        raise ValueError(
            f"cannot import {module!r} for {name!r} ({error}): is its folder on the Python path?"
        ) from None


def vector_class(env_id: str) -> type:
    """The class of the native batch of an environment; ``object`` where it has none.

    Raises:
        gymnasium.error.Error: if there is no such environment.
    """
    creator = loaded(gym.spec(env_id).vector_entry_point)
    return creator if isinstance(creator, type) else object


def loaded(entry: Any) -> Any:
    """The entry point of a registered environment, imported if it is a text."""
    return load_env_creator(entry) if isinstance(entry, str) else entry
