"""The package's environments: a system by name, and the classes that are made from it."""

from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

from vessel_gym.envs.manual import manual
from vessel_gym.envs.single import VesselEnv
from vessel_gym.envs.vector import VesselVectorEnv
from vessel_gym.system import System

_SYSTEMS = {
    "AUV": ("auv.auv_system", "remus-100"),
    "FixedWing": ("fixed_wing.fixed_wing_system", "puna"),
    "ItsunusaAUV": ("auv.auv_system", "itsunusa"),
    "PunaUAV": ("fixed_wing.fixed_wing_system", "puna"),
    "SegorogeniAUV": ("auv.auv_system", "segorogeni"),
    "Ship": ("ship.ship_system", "mariner"),
    "SigmaChannel": ("ship.channel_system", "corvette"),
    "SigmaCorvette": ("ship.ship_system", "corvette"),
    "ThesisCorvette": ("thesis_corvette.thesis_system",),
}
"""Function of `vessel_gym.envs` that makes an environment's system, and its vehicle if it has one.

The last argument of the function is the environment's id.
"""
_OF_ANY_VESSEL = "AUV", "FixedWing", "Ship"
"""Environments whose users may name another vehicle."""
CLASSES = [f"{name}{face}" for name in _SYSTEMS for face in ("Env", "VectorEnv")]


class OfAnyVessel:
    """Part of an environment whose vehicle may come from a file."""

    system_of: ClassVar[Any]

    def __init__(self, *arguments: Any, vessel: str | Path | None = None, **options: Any) -> None:
        if vessel is not None:
            self.system = self.system_of(vessel)
        super().__init__(*arguments, **options)


@cache
def classes(name: str) -> dict[str, type]:
    """Single and vector class of an environment, with one system, by their names."""
    path, *vessel = _SYSTEMS[name]
    module, _, function = path.partition(".")
    system_of = getattr(import_module(f"vessel_gym.envs.{module}"), function)
    own, space = ((OfAnyVessel,), "vessel_gym/") if name in _OF_ANY_VESSEL else ((), "")
    system: System = system_of(*vessel, f"{space}{name}-v0")
    body = {"system": system, "system_of": staticmethod(system_of), "__module__": "vessel_gym.envs"}
    made = {}
    for base, doc in (
        (VesselEnv, manual(system)),
        (VesselVectorEnv, f"Vector environment of `{name}Env`, which has the manual."),
    ):
        title = base.__name__.replace("Vessel", name)
        made[title] = type(title, (*own, base), body | {"__doc__": doc})
    return made
