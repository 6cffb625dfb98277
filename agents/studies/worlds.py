"""Look-up of the environments, estimators and agents of a study, the package's own or ``module:object``."""

import json
from dataclasses import replace
from functools import cache
from typing import Any

import gymnasium as gym

import vessel_gym  # noqa: F401  (registers the environments)
from agents.controllers import CONTROLLERS, make_controller
from agents.metrics import TASK_METRICS
from agents.named import imported_module, named_object, vector_class
from agents.rollouts import batch
from agents.source import source_digest
from agents.wrapped import Wrapped, taken_options, wrapped_system
from estimators.factory import unknown
from vessel_gym.envs import VesselVectorEnv
from vessel_gym.estimation import estimator_names
from vessel_gym.sensor_faults import SensorFault


def environment_id(name: str) -> str:
    """The id of an environment of a `vessel_gym.system.System`, as `registered_id`.

    Raises:
        ValueError: if there is no such environment, or it is one of others.
    """
    env_id = registered_id(name)
    if not issubclass(vector_class(env_id), VesselVectorEnv):
        raise ValueError(
            f"{name!r} is no environment of vessel_gym, and only those can be used here: evaluate,"
            " watch and ablate take others, and a script of your own trains on them"
            " (docs/any-environment.md)"
        )
    return env_id


@cache
def registered_id(name: str) -> str:
    """The id under which Gymnasium has an environment.

    Args:
        name: An id; ``"module:id"``, registered when the module is imported; or ``"module:class"``,
            a `VesselVectorEnv` with an attribute ``max_episode_steps``, registered here.

    Raises:
        ValueError: if there is no such environment.
    """
    module, _, own = name.rpartition(":")
    env_id = own or name
    if module and env_id not in gym.registry:
        imported_module(module, name)
    if module and env_id not in gym.registry:
        cls = named_object(name)
        if not (isinstance(cls, type) and issubclass(cls, VesselVectorEnv)):
            raise ValueError(f"{name!r} is neither a registered id nor a VesselVectorEnv class")
        steps = getattr(cls, "max_episode_steps", None)
        if not isinstance(steps, int):
            raise ValueError(
                f"{name!r} needs an attribute max_episode_steps: how long is an episode?"
            )
        env_id = f"{own}-v0"
        if env_id not in gym.registry:
            gym.register(env_id, vector_entry_point=cls, max_episode_steps=steps)
    if env_id not in gym.registry:
        ours = [
            id
            for id, spec in gym.registry.items()
            if str(spec.entry_point).startswith("vessel_gym")
        ]
        raise ValueError(f"{unknown('environment', name, ours)} (your own: module:id)")
    return env_id


@cache
def system_of(name: str) -> Any:
    """The system of an environment; of one of others, the `Wrapped` that stands for it.

    Raises:
        ValueError: as `registered_id` and `wrapped_system`.
    """
    env_id = registered_id(name)
    found: Any = vector_class(env_id)
    return found.system if issubclass(found, VesselVectorEnv) else wrapped_system(env_id)


def estimated_world(name: str) -> Any:
    """The `system_of` an environment with an estimator.

    Raises:
        ValueError: if there is no such environment, or it has none.
    """
    system = system_of(name)
    if not system.estimator:
        raise ValueError(
            f"{name!r} has no estimator in the loop: wrap it in"
            " vessel_gym.wrappers.EstimatedObservation"
        )
    return system


def options_of_command(env_id: str, options: dict[str, Any]) -> dict[str, Any]:
    """Options of a command as an environment takes them, see `taken_options`."""
    return taken_options(env_id, options) if isinstance(system_of(env_id), Wrapped) else options


def environment_options(environment: str, options: dict[str, Any]) -> dict[str, Any]:
    """A study's options as an environment takes them.

    Estimator, sensors and disturbance of one's own are imported; of late sensors and faults those
    are taken that the environment has.
    """
    names = {key: options[key] for key in ("estimator", "sensors", "disturbance") if key in options}
    made = options | {
        key: named_object(name) if ":" in name else name for key, name in names.items()
    }
    latency, faults = made.pop("latency", {}), made.pop("faults", ())
    if isinstance(system_of(environment), Wrapped):
        return taken_options(
            registered_id(environment),
            made | {"latency": latency or None, "faults": faults or None},
        )
    if not latency and not faults:
        return made
    chosen = system_of(environment).sensors_of(made.get("sensors", "nominal"))
    there = {sensor.name for sensor in chosen.each}
    own = [SensorFault(**fault) for fault in faults if fault["sensor"] in there]
    return made | {
        "sensors": [
            replace(sensor, latency=latency.get(sensor.name, sensor.latency))
            for sensor in chosen.each
        ],
        "sensor_faults": [*own, *chosen.faults],
    }


def classical_controller(agent: str, environment: str) -> Any:
    """The controller that an agent which does not learn stands for, see `agents.controllers.make_controller`."""
    return make_controller(agent, system_of(environment))


def refusal(name: str, options: dict[str, Any]) -> Exception | None:
    """Why an environment refuses options, if it does.

    It is a ValueError if it cannot carry the estimator, and a TypeError for an option. Each
    environment is built once for that.
    """
    key = name, json.dumps(options, sort_keys=True)
    if key not in _REFUSALS:
        try:
            batch(registered_id(name), 1, environment_options(name, options)).close()
            _REFUSALS[key] = None
        except (ValueError, TypeError) as error:
            _REFUSALS[key] = error
    return _REFUSALS[key]


_REFUSALS: dict[tuple[str, str], Exception | None] = {}


def check_estimator_name(name: str) -> None:
    """Refuse what is no estimator.

    Raises:
        ValueError: naming the mistake.
    """
    if ":" in name:
        if not callable(named_object(name)):
            raise ValueError(f"{name!r} is not an estimator: it cannot be called")
    elif name not in estimator_names():
        raise ValueError(unknown("estimator", name, ("default", *estimator_names())))


def digests(*names: str) -> dict[str, str]:
    """The source of whatever is the user's own among names, so that results follow its changes."""
    own = sorted({name.rpartition(":")[0] for name in names if ":" in name})
    return {module: source_digest(module) for module in own}


def registered(environment: str, controller: str) -> dict[str, str]:
    """The source of the metrics of an environment's task and of its controller of that name, if they are not ours.

    Modules of ours are part of what computes a job; those of others need not be imported by
    anything that it names.
    """
    task = system_of(environment).task
    modules = {TASK_METRICS.modules(task).get(""), CONTROLLERS.modules(task).get(controller)}
    return {
        module: source_digest(module) for module in sorted(m for m in modules if m and not _ours(m))
    }


def import_own(own: dict[str, str]) -> None:
    """Import the modules that source digests are of: whatever they register is there."""
    for module in own:
        imported_module(module, module)


def _ours(module: str) -> bool:
    return module.partition(".")[0] in ("agents", "vessel_gym")
