"""Environments: single and vector Gymnasium classes, and their systems by families.

They may import all other folders of `vessel_gym` except wrappers; users create them by
`gymnasium.make`. Each class, such as `SigmaCorvetteEnv`, is made when first asked for.
"""

from importlib import import_module
from typing import Any

from vessel_gym.envs.catalogue import CLASSES, environment_class

_MODULES = {"VesselEnv": "single", "VesselVectorEnv": "vector", "register_environment": "own"}
__all__ = [*CLASSES, *_MODULES]


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return getattr(import_module(f"vessel_gym.envs.{_MODULES[name]}"), name)
    if name not in CLASSES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return environment_class(name)


def __dir__() -> list[str]:
    return __all__
