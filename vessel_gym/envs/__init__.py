"""The environments: single and vector classes on the batched core, and systems by families.

They may import all other folders of `vessel_gym`; users create them by `gymnasium.make`. The
classes of an environment, such as `SigmaCorvetteEnv` and `SigmaCorvetteVectorEnv`, and its system
are made when first asked for.
"""

from typing import Any

from vessel_gym.envs.catalogue import CLASSES, classes
from vessel_gym.envs.own import register_environment
from vessel_gym.envs.single import VesselEnv
from vessel_gym.envs.vector import VesselVectorEnv

__all__ = [*CLASSES, "VesselEnv", "VesselVectorEnv", "register_environment"]


def __getattr__(name: str) -> Any:
    if name not in CLASSES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return classes(name.removesuffix("Env").removesuffix("Vector"))[name]


def __dir__() -> list[str]:
    return __all__
