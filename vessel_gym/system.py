"""What an environment is made of: a vehicle, a task, disturbances and a default estimator, as data."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from estimators.checks import finite_array, shown, whole
from vessel_gym.checks import check_names, check_numbers, instance, one_of, options
from vessel_gym.disturbances import Disturbance
from vessel_gym.sensor_faults import SensorFault
from vessel_gym.sensors import SUITES, Sensor, Sensors
from vessel_gym.tasks.task import Estimate, Task

if TYPE_CHECKING:
    from vessel_gym.composition import Composition

__all__ = ["Estimate", "System", "Task", "Trims", "Vehicle"]


class Trims(NamedTuple):
    """Steady motions about which a nonlinear model is made straight: the nearest one holds, by the known input.

    The known input's last component must be 1: what no matrix gives stands in its column of B.
    """

    x: np.ndarray  # (k, n) what filters estimate of the vehicle,
    u: np.ndarray  # (k, m) and the known input
    component: int  # of the known input that tells one from another,
    scale: float  # how many there are to a unit of it,
    middle: float  # and which is that of 0, and half of one more: see `estimators.Schedule`


class Vehicle(Protocol):
    """A vehicle in batches ``(B, ...)``: its own state and actuators, how they move, and what filters know of that.

    What acts on it is a forcing ``(B, f)``: kicks, which change its state at the end of a step, then flows, which are
    held over it. The equations may be compiled or plain NumPy: anything that broadcasts over leading axes.

    A vehicle may have ``faults``, too, as `vessel_gym.vehicles.whole_state.WholeState` has: the names of what may be
    added to its actuators over a step, and ``faulty``, the known input with that; without them it has none.
    """

    @property
    def dt(self) -> float:
        """Time step [s]."""

    @property
    def state_names(self) -> tuple[str, ...]:
        """Components of its state: of itself alone, not of what carries or kicks it."""

    @property
    def angles(self) -> tuple[str, ...]:
        """Those of them that are angles [rad]."""

    @property
    def action_names(self) -> tuple[str, ...]:
        """Components of the action."""

    @property
    def kicks(self) -> tuple[str, ...]:
        """The first parts of its forcing: what is added to its state at the end of a step."""

    @property
    def kicked(self) -> tuple[str, ...]:
        """And to which component each."""

    @property
    def flows(self) -> tuple[str, ...]:
        """The other parts of its forcing: what carries it over a step."""

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """Its sensors, in their nominal quality, in the order of the readings."""

    @property
    def normals(self) -> int:
        """How many normal numbers `parameters` needs."""

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Components of the parameters."""

    def parameters(self, mismatch: float, normals: np.ndarray) -> np.ndarray:
        """The truth's parameters ``(B, k)``, spread around the filter's."""

    def start(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """State ``(B, n)`` and actuators ``(B, a)`` from what the task's prior describes, see `estimated`."""

    def actuate(self, actuators: np.ndarray, action: np.ndarray) -> np.ndarray:
        """Actuators one step later, within limits and rates."""

    def step(
        self,
        state: np.ndarray,
        before: np.ndarray,
        after: np.ndarray,
        forcing: np.ndarray,
        parameters: np.ndarray,
    ) -> np.ndarray:
        """The state one step later, with actuators moving from ``before`` to ``after``."""

    @property
    def kinds(self) -> tuple[str, ...]:
        """The models that filters may have of it, the widest of nonlinear ones first."""

    @property
    def linear_kinds(self) -> tuple[str, ...]:
        """And which of them are linear."""

    def estimated(self, kind: str) -> tuple[str, ...]:
        """The components of its state that filters with a model estimate, in their order.

        Those of the first of ``kinds`` are what a task's prior describes; those of others are its first ones.
        """

    @property
    def cruise(self) -> tuple[np.ndarray, np.ndarray]:
        """What filters estimate, and the known input, where it goes its usual way: where models are looked at."""

    @property
    def process_sd(self) -> np.ndarray:
        """Standard deviations of what the models leave out in a step, of what filters estimate."""

    def drift(self, x: np.ndarray, u: np.ndarray, flow: np.ndarray) -> np.ndarray:
        """What filters estimate ``(..., n)`` one step on, under the known input and a flow, with their parameters."""

    def known_input(self, before: np.ndarray, after: np.ndarray, commanded: np.ndarray | None) -> np.ndarray:
        """What its filters are told over a step ``(B, m)``: of the actuators, and of what a task may command."""

    def linear(self, kind: str) -> "tuple[Any, ...] | Trims":
        """A and B of a linear model, each a matrix or a function of the known input.

        And where flows move what it estimates, what each does over a step ``(n, flows)``, likewise. Or the `Trims`
        about which the nonlinear model is made straight.
        """

    @property
    def rates(self) -> Mapping[str, str]:
        """Which component of the state is the rate of which, for what no sensor reads."""

    @property
    def carried(self) -> np.ndarray | None:
        """What a flow adds at the start to what the prior describes ``(n, flows)``, if velocities are over ground."""


def check_task(task: Task) -> None:
    """Refuse a task whose figures make no sense.

    Raises:
        TypeError: for what is no task.
        ValueError: naming the figure.
    """
    missing = [name for name in ("horizon", "uniforms", "ends", "success", "score") if not hasattr(task, name)]
    if missing:
        raise TypeError(f"task of a system must have {missing[0]}, as vessel_gym.system.Task has, got {shown(task)}")
    title = type(task).__name__
    whole(f"horizon of {title}", task.horizon, 1)
    whole(f"uniforms of {title}", task.uniforms, 0)
    check_names(f"ends of {title}", task.ends)
    if len(set(task.ends)) < len(task.ends):
        raise ValueError(f"ends of {title} must differ from each other, got {shown(task.ends)}")
    if hasattr(task, "perfect"):
        check_numbers(title, {"perfect": task.perfect}, positive="perfect")
    if not task.ends or task.success not in ("", *task.ends[1:]):
        raise ValueError(f"success of {title} must be one of its ends, or empty, got {shown(task.success)}")
    for name in ("prior_sd", "state_scale", "std_scale"):
        if hasattr(task, name) and (finite_array(f"{name} of {title}", getattr(task, name), "n") < 0.0).any():
            raise ValueError(f"{name} of {title} must be numbers of at least 0, got {shown(getattr(task, name))}")


@dataclass(frozen=True)
class System:
    """One environment as data.

    Attributes:
        name: The environment's id.
        vehicle: What moves.
        task: What is asked of it.
        disturbances: By name: ``"calm"``, ``"moderate"``, ``"rough"``.
        estimator: The default estimator.
        filter_model: The kind of model that filters use, unless ``filter_models`` says otherwise.
        tuning: Options of a filter by name, given what it is told.
        filter_models: Kinds of particular filters.
        sensors: In their nominal quality; None: the vehicle's own.
    """

    name: str
    vehicle: Vehicle
    task: Task
    disturbances: Mapping[str, Disturbance]
    estimator: str
    filter_model: str
    tuning: Callable[[str, "Composition"], dict[str, Any]]
    filter_models: Mapping[str, str] = field(default_factory=dict)
    sensors: tuple[Sensor, ...] | None = None

    def __post_init__(self) -> None:
        for name in ("name", "estimator", "filter_model"):
            instance(f"{name} of a system", getattr(self, name), str)
        missing = [name for name in vars(Vehicle) if name[0] != "_" and not hasattr(self.vehicle, name)]
        if missing:
            text = f"vehicle of a system must have {', '.join(missing[:3])}, as vessel_gym.system.Vehicle says"
            raise TypeError(f"{text}, got {shown(self.vehicle)}")
        check_task(self.task)
        disturbances = options("disturbances of a system", self.disturbances)
        for each in disturbances.values():
            instance("each of the disturbances of a system", each, Disturbance)
        if not disturbances:
            raise ValueError("disturbances of a system must hold one at least, by name")
        one_of("filter_model of a system", self.filter_model, self.vehicle.kinds)
        options("filter_models of a system", self.filter_models)
        sensors = () if self.sensors is None else self.sensors
        if not isinstance(sensors, tuple | list) or not all(isinstance(each, Sensor) for each in sensors):
            raise TypeError(f"sensors of a system must be Sensor objects, or None, got {shown(self.sensors)}")
        if not callable(self.tuning):
            raise TypeError(f"tuning of a system must be a function of (name, told), got {shown(self.tuning)}")

    def sensors_of(self, choice: "str | Sequence[Sensor]", faults: Sequence[SensorFault] = ()) -> Sensors:
        """Its sensors in the quality of a suite by name, or somebody's own, with their faults.

        Raises:
            ValueError: for a name that there is not, or sensors that do not fit the vehicle, see `Sensors`.
            TypeError: for what is no sensor, or no fault of one.
        """
        vehicle = self.vehicle
        if isinstance(choice, str):
            suite = SUITES[one_of("sensor suite", choice, SUITES)]
            choice = suite.of(vehicle.sensors if self.sensors is None else self.sensors)
        elif not (isinstance(choice, list | tuple) and choice and all(isinstance(part, Sensor) for part in choice)):
            raise TypeError(f"sensors must be one of {', '.join(SUITES)}, or Sensor objects, got {shown(choice)}")
        return Sensors(choice, vehicle.state_names, vehicle.kicks + vehicle.flows, vehicle.dt, faults)
