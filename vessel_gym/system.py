"""An environment as data: a vehicle, a task, disturbances and a default estimator."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import gymnasium as gym
from gymnasium.envs.registration import load_env_creator

from estimators.checks import finite_array, integer, short_repr
from vessel_gym.checks import all_are, check_names, check_numbers, instance, one_of, options
from vessel_gym.disturbances import Disturbance
from vessel_gym.models.state_space import StateSpace
from vessel_gym.models.structure import readers
from vessel_gym.sensor_faults import LOSS, SensorFault
from vessel_gym.sensors import SUITE_NAMES, SUITES, Sensor, Sensors, in_quality
from vessel_gym.tasks.task import Estimate, Task
from vessel_gym.vehicles.vehicle import Trims, Vehicle

__all__ = ["Estimate", "System", "Task", "Trims", "Vehicle"]


def registered(name: str) -> Any:
    """System of the environment that is registered under this name; None: no such environment."""
    spec = gym.registry.get(name)
    made: Any = None if spec is None else spec.entry_point
    return getattr(load_env_creator(made) if isinstance(made, str) else made, "system", None)


def check_task(task: Task) -> None:
    """Refuse a task with missing or invalid attributes.

    Raises:
        TypeError: for an object that is no task, or end reasons that are no strings.
        ValueError: for an invalid value, naming the attribute.
    """
    instance("task of a system", task, Task)
    title = type(task).__name__
    integer(f"horizon of {title}", task.horizon, 1)
    integer(f"uniforms of {title}", task.uniforms, 0)
    reasons, success = task.end_reasons, task.success
    check_names(f"end_reasons of {title}", reasons)
    if len(set(reasons)) < len(reasons):
        raise ValueError(
            f"end_reasons of {title} must differ from each other, got {short_repr(reasons)}"
        )
    if not reasons or success not in ("", *reasons[1:]):
        raise ValueError(
            f"success of {title} must be one of its end_reasons, or empty, got"
            f" {short_repr(success)}"
        )
    check_numbers(title, {"perfect": task.perfect}, positive="perfect")
    for name in ("prior_sd", "state_scale", "std_scale"):
        sizes = getattr(task, name, ())
        if (finite_array(f"{name} of {title}", sizes, "n") < 0.0).any():
            raise ValueError(
                f"{name} of {title} must be numbers of at least 0, got {short_repr(sizes)}"
            )
    needed = ("vehicle", "prior_sd") if type(task).prior is Task.prior else ()
    unset = [name for name in needed if not hasattr(task, name)]
    if unset:
        raise TypeError(
            f"{title} needs {unset[0]}, from which `Task.prior` follows: see docs/own-task.md"
        )


@dataclass(frozen=True, eq=False)
class System:
    """One environment as data.

    Attributes:
        name: The environment's id.
        vehicle: The vehicle.
        task: The mission.
        disturbances: Disturbances by name: ``"calm"``, ``"moderate"``, ``"rough"``.
        estimator: The default estimator.
        filter_model: Kind of the filters' model.
        tuning: Function of a filter's name and of the `StateSpace` of its model that returns
            options of the filter.
        filter_models: Kinds of the models of particular filters, by name of the filter.
        sensors: Sensors in nominal quality; None for the vehicle's own.
    """

    name: str
    vehicle: Vehicle
    task: Task
    disturbances: Mapping[str, Disturbance]
    estimator: str
    filter_model: str
    tuning: Callable[[str, StateSpace], dict[str, Any]]
    filter_models: Mapping[str, str] = field(default_factory=dict)
    sensors: tuple[Sensor, ...] | None = None

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Pickle a registered system by its name, which must be registered where it is loaded."""
        if registered(self.name) is self:
            return registered, (self.name,)
        return super().__reduce_ex__(protocol)

    def __post_init__(self) -> None:
        for name in ("name", "estimator", "filter_model"):
            instance(f"{name} of a system", getattr(self, name), str)
        missing = [name for name in Vehicle.__annotations__ if not hasattr(self.vehicle, name)]
        if missing:
            text = (
                f"vehicle of a system must have {', '.join(missing[:3])}, as"
                " vessel_gym.system.Vehicle says"
            )
            raise TypeError(f"{text}, got {short_repr(self.vehicle)}")
        check_task(self.task)
        disturbances = options("disturbances of a system", self.disturbances)
        for each in disturbances.values():
            instance("each of the disturbances of a system", each, Disturbance)
        if not disturbances:
            raise ValueError("disturbances of a system must hold one at least, by name")
        one_of("filter_model of a system", self.filter_model, self.vehicle.kinds)
        options("filter_models of a system", self.filter_models)
        if not all_are(Sensor, self.nominal_sensors):
            given = short_repr(self.nominal_sensors)
            raise TypeError(f"sensors of a system must be Sensor objects, got {given}")
        if not callable(self.tuning):
            raise TypeError(
                "tuning of a system must be a function of (name, space), got"
                f" {short_repr(self.tuning)}"
            )

    @property
    def nominal_sensors(self) -> tuple[Sensor, ...]:
        """Sensors in nominal quality."""
        return self.vehicle.sensors if self.sensors is None else self.sensors

    @property
    def _outage(self) -> tuple[SensorFault, ...]:
        """Loss of the position fix: of all sensors of x or, if none measures x, of psi.

        It begins at a time that is drawn uniformly, so that it ends within an episode of more than
        `LOSS` seconds, and in the first half of a shorter one.
        """
        sensors_of = partial(readers, self.vehicle, self.nominal_sensors)
        fixes = sensors_of("x") or sensors_of("psi")
        if not fixes:
            raise ValueError(
                f'{self.name} has no sensors="denied": none of its sensors measures a state x or'
                " psi, so there is no fix to lose"
            )
        seconds = self.task.horizon * self.vehicle.dt
        latest = seconds - LOSS if seconds > LOSS else 0.5 * seconds  # it then lasts to the end
        return tuple(SensorFault(name, "off", begin=(0.0, latest), duration=LOSS) for name in fixes)

    def sensors_of(
        self, choice: "str | Sequence[Sensor]", faults: Sequence[SensorFault] = ()
    ) -> Sensors:
        """Sensors of a suite by name, or the user's own, with their faults.

        Raises:
            ValueError: for an unknown name, a suite that the vehicle does not have, or sensors that
                do not fit the vehicle, see `Sensors`.
            TypeError: for objects that are no sensors, or no faults of sensors.
        """
        vehicle = self.vehicle
        if isinstance(choice, str):
            name = one_of("sensor suite", choice, SUITE_NAMES)
            if name == "denied" and isinstance(faults, list | tuple):
                faults = (*faults, *self._outage)
            if name == "budget":
                from vessel_gym.sensors.grades import read_grades  # late, as it reads files

                choice = read_grades(self).suite(name)
            else:
                choice = in_quality(self.nominal_sensors, **SUITES.get(name, {}))
        return Sensors(
            choice,
            vehicle.state_names,
            vehicle.increments + vehicle.ambient_flows,
            vehicle.dt,
            faults,
        )
