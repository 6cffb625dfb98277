"""Controllers that need no training, registered by the class of their task.

Each acts on the observation alone, in modes ``"mean"`` and ``"mean+std"``: what it regulates is
what the estimator believes. Every task of the package has an ``"autopilot"``, by which studies
measure others: linear-quadratic, with what the task needs beside it. Ships have two more:

- ``"pid"``: proportional, integral and derivative action (`agents.controllers.loops`);
- ``"lqg"``: the autopilot's regulator without its integral.

They may import vehicles, tasks and `estimators`; agents and studies import them.
"""

from collections.abc import Callable
from typing import Any, TypeVar

from agents.named import named_object
from estimators.tunable import check_parameters
from vessel_gym.registry import Registry
from vessel_gym.system import System

AUTOPILOT = "autopilot"
"""The controller of every task that others are measured by.

Those of the package, but for trials, have defaults that were tuned on the default filters.
"""
RANDOM = "random"
"""The name of `agents.agent.RandomAgent`, for any task."""
PPO = "ppo"
"""The name of the trained agent that comes with the package; in studies, of one trained anew."""
_TAKEN = (RANDOM, PPO, "checkpoint")  # what else agents are called, by commands and in studies

Factory = Callable[..., Any]
"""Makes an `agents.agent.Agent` for a system, and for parameters by name."""
F = TypeVar("F", bound=Factory)


def _ours() -> None:
    from agents.controllers import dive, flight, turning  # noqa: F401


CONTROLLERS: Registry[Factory] = Registry("controller", _ours)


def register_controller(task_type: type, name: str) -> Callable[[F], F]:
    """Decorator: register a class, or a function of a `System`, as a controller for a task class.

    The class or function makes the controller from a `System`, and from parameters as keywords, if
    it has an attribute ``tunable``: their ranges (`estimators.Log`, `estimators.Linear`) by name.
    Subclasses of the task class inherit the controller.

    Args:
        task_type: The class of the task.
        name: Name of the controller for `agents.load_agent`, commands and studies. Commands and
            studies use the controller ``"autopilot"`` by default.

    Raises:
        TypeError: for a task type that is no class.
        ValueError: for an empty or reserved name, a name with a colon, or a name that another
            module has registered for this class.
    """
    if not isinstance(name, str) or not name or ":" in name or name in _TAKEN:
        raise ValueError(
            f"a controller needs a name without a colon, other than {', '.join(_TAKEN)}, got"
            f" {name!r}"
        )

    def register(factory: F) -> F:
        CONTROLLERS.register(task_type, factory, factory.__module__, name)
        return factory

    return register


def controller_names(system: System) -> tuple[str, ...]:
    """The names of a system's controllers, the autopilot first."""
    return tuple(sorted(CONTROLLERS.of(system.task), key=lambda name: (name != AUTOPILOT, name)))


def is_controller(name: str, system: System) -> bool:
    """True for a controller that is registered for a system, and for ``"module:object"``."""
    return ":" in name or name in CONTROLLERS.of(system.task)


def make_controller(name: str, system: System, **parameters: float) -> Any:
    """The controller of a system.

    Args:
        name: As registered; or ``"module:object"``, a user's own, which is imported and called with
            the system and the parameters.
        system: What is flown.
        parameters: Parameters that the controller's attribute ``tunable`` names.

    Raises:
        ValueError: if there is no such controller, or it does not fly this system; for an unknown
            parameter, or one that is not a finite number or not above 0 where it must be.
        numpy.linalg.LinAlgError: if no controller stabilises the vehicle with these parameters.
        TypeError: if what is named makes no agent.
    """
    factory = controller_factory(name, system)
    check_parameters(name, getattr(factory, "tunable", {}), parameters)
    made = factory(system, **parameters)
    if not all(callable(getattr(made, method, None)) for method in ("reset", "act")):
        raise TypeError(f"an agent has reset and act, but {name!r} makes {type(made).__name__}")
    return made


def controller_factory(name: str, system: System) -> Factory:
    """The class or function that makes the controller of a system, as for `make_controller`.

    Raises:
        ValueError: if there is no such controller.
        TypeError: if what is named cannot be called.
    """
    controllers = CONTROLLERS.of(system.task)
    if ":" not in name and name not in controllers:
        raise ValueError(unknown_controller(name, system))
    factory: Factory = controllers.get(name) or named_object(name)
    if not callable(factory):
        raise TypeError(
            f"{name!r} makes no agent: it cannot be called with the environment's system"
        )
    return factory


def unknown_controller(name: str, system: System, *others: str) -> str:
    """A sentence about a name that is not known for a system.

    Args:
        name: That one.
        system: What was to be flown.
        others: What may be named beside controllers.
    """
    known = ", ".join((*controller_names(system), *others, "your own as module:object"))
    task = type(system.task).__name__
    return (
        f"unknown agent {name!r} for {task}: choose {known}, or name one with"
        " agents.register_controller"
    )
