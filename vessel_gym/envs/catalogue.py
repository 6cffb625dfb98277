"""The package's environments: a system by name, and the classes that are made from it."""

from collections.abc import Callable
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

from estimators.checks import short_repr
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
_OF_A_PAPER = "ItsunusaAUV", "PunaUAV", "SegorogeniAUV", "ThesisCorvette"
"""Environments whose source paper has misprints that run."""
CLASSES = [f"{name}{face}" for name in _SYSTEMS for face in ("Env", "VectorEnv")]


class OfAnyVessel:
    """Part of an environment whose vehicle may come from a file."""

    system_of: ClassVar[Any]

    def __init__(self, *arguments: Any, vessel: str | Path | None = None, **options: Any) -> None:
        if vessel is not None:
            self.system = self.system_of(vessel)
        super().__init__(*arguments, **options)


class OfAPaper:
    """Part of an environment that also runs with the misprints of its source paper."""

    printed_system: ClassVar[Any]

    def __init__(self, *arguments: Any, as_printed: bool = False, **options: Any) -> None:
        if not isinstance(as_printed, bool):
            raise ValueError(f"as_printed must be True or False, got {short_repr(as_printed)}")
        if as_printed:
            self.system = self.printed_system()
        super().__init__(*arguments, **options)


class _Manual:
    """Docstring of an environment's class, written when first read."""

    def __get__(self, _: Any, owner: Any) -> str:
        from vessel_gym.envs.manual import manual  # late, as it reads files

        return manual(owner.system)


@cache
def _system(name: str) -> tuple[Callable[..., System], partial[System]]:
    """Function that makes a system, and the call of it that makes an environment's system."""
    path, *vessel = _SYSTEMS[name]
    module, _, function = path.partition(".")
    system_of = getattr(import_module(f"vessel_gym.envs.{module}"), function)
    space = "vessel_gym/" if name in _OF_ANY_VESSEL else ""
    return system_of, partial(system_of, *vessel, f"{space}{name}-v0")


@cache
def environment_class(title: str) -> type:
    """Single or vector class of an environment, by its name; both have one system."""
    face = "VectorEnv" if title.endswith("VectorEnv") else "Env"
    name = title.removesuffix(face)
    module = import_module(f"vessel_gym.envs.{'single' if face == 'Env' else 'vector'}")
    options = (OfAnyVessel, _OF_ANY_VESSEL), (OfAPaper, _OF_A_PAPER)
    bases = *(part for part, names in options if name in names), getattr(module, f"Vessel{face}")
    system_of, own_system = _system(name)
    body = {
        "system": own_system(),
        "system_of": staticmethod(system_of),
        "printed_system": staticmethod(partial(own_system, True)),
        "__module__": "vessel_gym.envs",
    }
    doc = _Manual() if face == "Env" else f"Vector environment of `{name}Env`, with its manual."
    return type(title, bases, body | {"__doc__": doc})
