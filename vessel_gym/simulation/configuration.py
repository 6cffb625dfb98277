"""Options of an environment, and the parts that they fix for all episodes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import SimpleNamespace
from typing import Any, Self

import numpy as np

from estimators.checks import as_number, short_repr
from vessel_gym.caching import cached
from vessel_gym.checks import is_compiled, one_of
from vessel_gym.checks import options as checked_options
from vessel_gym.disturbances import Disturbance
from vessel_gym.models.assumed import check_fit
from vessel_gym.models.estimation import Estimation, EstimatorChoice, build, chosen_disturbance
from vessel_gym.models.input_conditions import check_causal
from vessel_gym.models.state_space import StateSpace
from vessel_gym.sensor_faults import SensorFault
from vessel_gym.sensors import Sensor, Sensors
from vessel_gym.simulation.draws import StartNumbers, filter_prior
from vessel_gym.simulation.loop import Delivery, Estimator
from vessel_gym.simulation.mission import Mission
from vessel_gym.simulation.state import Stage, State
from vessel_gym.simulation.truth import INFO, Info
from vessel_gym.simulation.whole_step import WholeStep
from vessel_gym.simulation.world import World
from vessel_gym.system import System, Task, Vehicle

OBSERVE = ("mean", "mean+std", "measurement")
"""Contents of an observation: estimates, also with standard deviations, or raw measurements."""
TERMINATIONS = ("belief", "task")
"""Sources of the decision that a mission is complete: the estimate, or the task from the truth."""


@cached
def _world(
    system: System,
    sensors: str | Sequence[Sensor],
    faults: Sequence[SensorFault],
    disturbance: str | Disturbance,
) -> World:
    """World of an environment: vehicle, sensors, disturbance and task."""
    chosen = chosen_disturbance(system, disturbance)
    check_fit(system.vehicle, chosen)
    given = system.sensors_of(sensors, faults)
    space = StateSpace.of_world(system.vehicle, chosen, given)
    check_causal(space)
    return World(space)


@dataclass(frozen=True, eq=False)
class Options:
    """Arguments of an environment.

    Args:
        estimator: Name of the estimator; None for the environment's default. Besides the filters of
            the `estimators` package there are ``truth`` (oracle), ``measurement`` (last
            measurement, zero-order hold) and ``dead-reckoning``. An `estimators.Filter` subclass,
            or a function of the model that returns a filter, also serves.
        estimator_options: Options of the estimator, which override the environment's tuning.
            ``model`` selects one of several models. ``assume`` sets the filter's assumptions about
            the world (see `vessel_gym.models.assumed.Assumptions`). ``late`` sets the use of
            late measurements: ``"fused"`` at the time when they were taken (the default), ``"as
            new"`` or ``"discarded"``.
        sensors: ``"clean"``, ``"nominal"``, ``"degraded"`` (10 % of the nominal measurements are
            lost, and 5 % are outliers of ten times the noise), ``"budget"`` (cheap instruments by
            their datasheets, with biases that filters estimate) or ``"denied"`` (nominal, but
            from a random time the position fix is lost for at most 120 s), see
            docs/sensor-suites.md. A list of `vessel_gym.sensors.Sensor` also serves; it may include
            entries of ``system.vehicle.sensors``.
        disturbance: ``"calm"``, ``"moderate"``, ``"rough"``, another key of
            ``system.disturbances``, or a `vessel_gym.disturbances.Disturbance`.
        mismatch: Relative standard deviation of the true parameters from the filter's, 0 to 0.25.
        observe: Content of an observation. ``"mean"`` is the estimate, ``"mean+std"`` also its
            standard deviations. ``"measurement"`` is raw measurements and their mask.
        termination: What decides that the mission is complete: ``"belief"``, the estimate (default
            where estimates are observed), or ``"task"``, the truth (default where measurements are
            observed). Limits of the task and time end any episode.
        guidance: With True, an observation describes the mission relative to the estimate or the
            last measurements, such as a distance from the path. With False, it contains the
            estimate or the measurements, the mission's parameters (such as the path) and the
            actuators. The default is True where estimates are observed.
        sensor_faults: Faults of sensors with their times: a list of
            `vessel_gym.sensor_faults.SensorFault`.

    Raises:
        ValueError: for an unknown name (the message lists the known ones) or a number out of range.
        TypeError: for an unknown argument, an option that the estimator does not have, or sensors,
            faults or a disturbance that are no objects of the classes above.
    """

    estimator: EstimatorChoice | None = None
    estimator_options: dict[str, Any] | None = None
    sensors: str | Sequence[Sensor] = "nominal"
    disturbance: str | Disturbance = "moderate"
    mismatch: float = 0.0
    observe: str = "mean"
    termination: str | None = None
    guidance: bool | None = None
    sensor_faults: Sequence[SensorFault] = ()

    def __post_init__(self) -> None:
        raw = one_of("observe mode", self.observe, OBSERVE) == "measurement"
        if not 0.0 <= as_number(self.mismatch) <= 0.25:
            raise ValueError(
                f"mismatch must be between 0 and 0.25, got {short_repr(self.mismatch)}"
            )
        termination = one_of(
            "termination",
            ("task" if raw else "belief") if self.termination is None else self.termination,
            TERMINATIONS,
        )
        if self.guidance is not None and not isinstance(self.guidance, bool):
            raise ValueError(
                f"guidance must be True, False or None, got {short_repr(self.guidance)}"
            )
        guidance = not raw if self.guidance is None else self.guidance
        given = checked_options("estimator_options", self.estimator_options)
        vars(self).update(
            mismatch=float(self.mismatch), termination=termination, guidance=guidance,
            estimator_options=given, sensors=_as_tuple(self.sensors),
            sensor_faults=_as_tuple(self.sensor_faults),
        )  # fmt: skip


def _numpy_methods(vehicle: Vehicle, disturbance: Disturbance, task: Task) -> dict[str, str]:
    """Methods in NumPy, as error messages name them, and the fields that they fill in."""
    fields = {
        vehicle: {"actuate": "actuators", "known_input": "u", "step": "state"},
        disturbance: {"effect": "exogenous"},
        task: {
            "exogenous": "imposed", "reference": "reference", "score": "reward",
            "commanded": "commanded",
        },
    }  # fmt: skip
    return {
        f"{method} of {type(part).__name__}": field
        for part, methods in fields.items()
        if not is_compiled(part)
        for method, field in methods.items()
    }


def _as_tuple(value: Any) -> Any:
    """A tuple in place of a list, so that environments with equal sensors share their parts."""
    return tuple(value) if isinstance(value, list) else value


_mission, _info = cached(Mission), cached(Info)
_whole_step = cached(WholeStep)


class Configuration:
    """Parts that a system and its options fix; episodes and copies of an environment share them.

    Args:
        system: The environment as data.
        options: Arguments of the environment.
        by_rows: Has the filter parameters of its own in each row?

    Attributes:
        world: True world, with vehicle, sensors and disturbance.
        numpy_methods: Methods in NumPy of vehicle, disturbance and task, whose results in a step
            must be finite, and the fields of the record that they fill in.
        sensors: Sensors of the world.
        delivery: Faults and delays of measurements.
        estimators: The estimator and, with ``raw``, that of raw measurements.
        mission: The task's part of a step.
        estimation: Estimator and its model.
        raw: Estimation from raw measurements, if they are observed with guidance; otherwise None.
        prior_index: Indices of the true state's components in the filter's widest model.
        scores: Function of sums of rewards and steps that returns scores.

    Raises:
        ValueError: as `Options`.
        TypeError: as `Options`.
    """

    def __init__(self, system: System, options: Options, by_rows: bool = False) -> None:
        self.system, self.options = system, options
        self.world = world = _world(
            system, options.sensors, options.sensor_faults, options.disturbance
        )
        vehicle, raw = system.vehicle, options.observe == "measurement"
        self.sensors: Sensors = world.sensors
        self.numpy_methods = _numpy_methods(vehicle, world.disturbance, system.task)
        rest = self.sensors, world.disturbance
        choice = system.estimator if options.estimator is None else options.estimator
        self.estimation: Estimation = build(system, choice, options.estimator_options, *rest)
        if by_rows:
            by_row = self.estimation.filter.by_rows()
            self.estimation = replace(self.estimation, filter=by_row)
        self.raw: Estimation | None = None
        if options.guidance and raw:
            wide = {"model": vehicle.kinds[0]}  # raw guidance is equal for all estimators
            self.raw = build(system, "measurement", wide, *rest)
        self.action_size = len(vehicle.action_names)
        self.prior_index = tuple(
            vehicle.state_names.index(name) for name in vehicle.estimated(vehicle.kinds[0])
        )
        ending, guidance = str(options.termination), bool(options.guidance)
        given = system.task, self.estimation, ending, self.prior_index, options.observe
        self.mission = _mission(*given, guidance, self.raw)
        self._info = info = _info(world, self.estimation, system.task)
        self.true_state, self.unknown_input = info.true_state, info.unknown_input
        self.scores = info.scores
        self.delivery = Delivery(self.sensors)
        both = (self.estimation, "belief"), (self.raw, "raw")
        self.estimators = [Estimator(each, field, info.oracle) for each, field in both if each]

    @cached_property
    def whole_steps(self) -> Sequence[WholeStep]:
        """World, estimator and mission as one program, without and with the arrays of ``info``.

        Empty if they cannot be one.
        """
        parts = self.world, self.estimation, self.mission
        if self.raw is not None or not WholeStep.serves(*parts):
            return ()
        return tuple(_whole_step(*parts, info) for info in (None, self._info))

    @cached_property
    def info(self) -> Stage:
        """Stage that returns ``info``."""
        return Stage(self._info, compiled=True, own=len(INFO))

    @cached_property
    def draws(self) -> StartNumbers:
        """Random numbers of an episode's start."""
        size, mismatch = len(self.prior_index), self.options.mismatch
        return StartNumbers.of(self.world, self.system.task.uniforms, size, mismatch)

    @cached_property
    def observation_size(self) -> int:
        """Number of components of an observation, which one at a start without noise has."""
        task, size = self.system.task, self.sensors.size
        scenario, steps = task.scenario(np.full((1, task.uniforms), 0.5), {}), np.zeros(1, int)
        prior = task.prior(scenario)
        _, actuators = self.world.vehicle.start(np.array(prior.mean))
        now = State(
            scenario=scenario, steps=steps, actuators=actuators, y=np.zeros((1, size)),
            available=np.ones((1, size), bool),
        )  # fmt: skip
        for each in self.estimators:
            known = filter_prior(prior, each.estimation.space)
            belief = SimpleNamespace(mean=known.mean, cov=known.cov[None], input_mean=None)
            setattr(now, each.field, belief)
        reference = task.reference(scenario, steps, prior.mean)
        return self.mission.observation(now, reference).shape[1]

    def __reduce__(self) -> tuple[Any, ...]:
        return Configuration, (self.system, self.options)

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self
