"""Look-up of the environments, estimators and agents of a study."""

import json
import os
import re
from collections.abc import Mapping
from contextlib import closing
from dataclasses import replace
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import gymnasium as gym

import vessel_gym  # noqa: F401  (registers the environments)
from agents.controllers import CONTROLLERS
from agents.metrics import TASK_METRICS
from agents.named import imported_module, named_object, vector_class
from agents.rollouts import batch
from agents.source import source_digest
from agents.wrapped import Wrapped, core_of, taken_options
from estimators.factory import unknown
from vessel_gym.envs import VesselVectorEnv
from vessel_gym.sensor_faults import SensorFault
from vessel_gym.sensors import Sensor
from vessel_gym.sensors.grades import NOMINAL, grades_of

OURS = "vessel_gym.envs:"
"""Beginning of the entry points of the package's environments."""
AT_RATE = re.compile(r"(.+) at (\d*\.?\d+) Hz")
"""A grade of a sensor at a rate."""


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
        name: An id; or ``"module:id"``, registered when the module is imported.

    Raises:
        ValueError: if there is no such environment.
    """
    module, _, env_id = name.rpartition(":")
    if module and env_id not in gym.registry:
        imported_module(module, name)
    if env_id not in gym.registry:
        own = environments(module.partition(".")[0], "vessel_gym.envs.own")
        known = [f"{module}:{each}" for each in own] if module else environments(OURS)
        raise ValueError(f"{unknown('environment', name, known)} (your own: module:id)")
    return env_id


def environments(*places: str) -> dict[str, str]:
    """Entry points by id of the environments whose entry point begins with one of some texts."""
    found = {}
    for name, spec in gym.registry.items():
        place = getattr(spec.entry_point, "__module__", str(spec.entry_point))
        if place.startswith(places):
            found[name] = place
    return found


@cache
def system_of(name: str) -> Any:
    """The system of an environment; of one of others, the `Wrapped` that stands for it.

    Raises:
        ValueError: as `registered_id`, or if one of others cannot be made.
    """
    env_id = registered_id(name)
    found: Any = vector_class(env_id)
    if issubclass(found, VesselVectorEnv):
        return found.system
    try:
        with closing(batch(env_id, 1)) as env:
            return core_of(env)
    except (ValueError, TypeError, ImportError, gym.error.Error) as error:
        raise ValueError(f"{env_id} cannot be made: {error}") from error


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


def environment_options(environment: str, options: dict[str, Any]) -> dict[str, Any]:
    """Options of a study or a command as an environment takes them.

    Estimator, sensors and disturbance of one's own are imported; of late sensors and faults those
    are taken that the environment has. ``tuned`` is a file of tuned parameters, whose estimator is
    taken.
    """
    system, made = system_of(environment), dict(options)
    if path := made.pop("tuned", None):
        from agents.tuning.tuned import load_tuned  # which looks up environments here

        made = load_tuned(path).options_for(environment, made)
    for key in ("estimator", "sensors", "disturbance"):
        if isinstance(name := made.get(key), str) and ":" in name:
            made[key] = named_object(name)
    if isinstance(grades := made.get("sensors"), dict):
        made["sensors"] = graded_sensors(environment, grades)
    if isinstance(system, Wrapped):
        return taken_options(registered_id(environment), made)
    latency, faults = made.pop("latency", {}), made.pop("faults", ())
    if latency or faults:
        chosen = system.sensors_of(made.get("sensors", "nominal"))
        there = {sensor.name for sensor in chosen.each}
        own = [SensorFault(**fault) for fault in faults if fault["sensor"] in there]
        made["sensors"] = [
            replace(sensor, latency=latency.get(sensor.name, sensor.latency))
            for sensor in chosen.each
        ]
        made["sensor_faults"] = [*own, *chosen.faults]
    return made


def graded_sensors(environment: str, grades: Mapping[str, str]) -> list[Sensor]:
    """Sensors of an environment, some of them of a grade and perhaps at a rate, the others nominal.

    Args:
        environment: One of ours.
        grades: Such as ``"SBAS"`` or ``"SBAS at 0.5 Hz"``, by sensor.

    Raises:
        ValueError: if there are no grades, or not this one of a sensor.
    """
    found = []
    for name, known in grades_of(system_of(environment)).items():
        words = grades.get(name, NOMINAL)
        at_rate = AT_RATE.fullmatch(words)
        if words in known:
            found.append(known[words])
        elif at_rate and at_rate[1] in known:
            found.append(replace(known[at_rate[1]], rate=float(at_rate[2])))
        else:
            raise ValueError(unknown(f"grade of {name}", words, known))
    return found


def refusal(name: str, options: dict[str, Any]) -> Exception | None:
    """Why an environment refuses options, if it does.

    It is a ValueError if it cannot carry the estimator, and a TypeError for an option. Each
    environment is built once for that.
    """
    return _refusal(name, json.dumps(options, sort_keys=True))


@cache
def _refusal(name: str, options: str) -> Exception | None:
    try:
        batch(registered_id(name), 1, environment_options(name, json.loads(options))).close()
    except (ValueError, TypeError) as error:
        return error
    return None


def digests(environment: str, controller: str, *options: Mapping[str, Any]) -> dict[str, str]:
    """The source of whatever is the user's own, so that results follow its changes.

    That is in the modules of the environment, of the controller, of values of options that are
    ``"module:object"``, and of whoever registered the controller or the metrics of the
    environment's task: nothing that a job names needs to import these. The file of a policy is
    given by its path. Modules of ours are part of what computes a job.
    """
    task = system_of(environment).task
    registered = (TASK_METRICS.modules(task).get(""), CONTROLLERS.modules(task).get(controller))
    own = {m for m in registered if m and not m.startswith(("agents.", "vessel_gym."))}
    names = [environment, controller, *(value for each in options for value in each.values())]
    own |= {name.rpartition(":")[0] for name in names if isinstance(name, str) and ":" in name}
    found = {module: source_digest(module) for module in sorted(own)}
    if os.path.isfile(controller):
        found[controller] = sha256(Path(controller).read_bytes()).hexdigest()
    return found


def import_own(own: dict[str, str]) -> None:
    """Import the modules that digests are of, for what they register; files are left out."""
    for module in own:
        if not os.path.isfile(module):
            imported_module(module, module)
