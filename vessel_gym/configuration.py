"""What an environment consists of and no episode changes."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from estimators import FaultMonitor
from estimators.checks import shown
from estimators.engine.dependencies import Dependencies
from estimators.randomness import word
from vessel_gym.acceptance import checked_disturbance, checked_task, checked_vehicle
from vessel_gym.checks import number, one_of
from vessel_gym.disturbances import Disturbance
from vessel_gym.estimation import EstimatorChoice, build, chosen_disturbance
from vessel_gym.filter_models.build import Composition
from vessel_gym.filter_models.exogenous import Forces, change_of, input_channels
from vessel_gym.foreign import CheckedMethods, ours
from vessel_gym.mission import Mission
from vessel_gym.sensor_faults import SensorFault
from vessel_gym.sensors import Sensor, columns
from vessel_gym.sharing import shared
from vessel_gym.system import System
from vessel_gym.world import World

OBSERVE = ("mean", "mean+std", "mean+alarms", "mean+std+alarms", "measurement")
"""What may be observed: estimates, with their standard deviations and a monitor's alarms, or raw readings."""
ENDS = ("belief", "declaration", "task")
"""Who says that a mission is done: what the estimator believes, the agent, or the task, which knows the truth."""
DRAWN = ("task", "vehicle", "parameters", "filter")
"""What is drawn by itself at the start of an episode; then come the parts of the world and the sensors."""


@shared
def _world(
    system: System, sensors: str | Sequence[Sensor], faults: Sequence[SensorFault], disturbance: str | Disturbance
) -> World:
    """Vehicle, sensors and disturbance of an environment."""
    vehicle = checked_vehicle(system.vehicle)
    task = checked_task(system.task, vehicle)
    given, forces = system.sensors_of(sensors, faults), Forces(system.vehicle, chosen_disturbance(system, disturbance))
    users = not (ours(system.vehicle) and ours(forces.disturbance) and given.ours and ours(system.task))
    return World(vehicle, forces, checked_disturbance(forces.disturbance), given, task, users, not users)


_mission = lru_cache(maxsize=32)(Mission)


class Configuration:
    """All that a system and its options fix.

    Args:
        system: The environment as data; the other arguments are those of `vessel_gym.core.Core`.

    Raises:
        ValueError: as `vessel_gym.core.Core`.
        TypeError: likewise.
    """

    def __init__(
        self, system: System, estimator: EstimatorChoice | None, estimator_options: dict[str, Any],
        sensors: str | Sequence[Sensor], disturbance: str | Disturbance, mismatch: float, observe: str,
        ends: str | None, guidance: bool | None, sensor_faults: Sequence[SensorFault], num_threads: int,
    ) -> None:  # fmt: skip
        one_of("observe mode", observe, OBSERVE)
        if not 0.0 <= number(mismatch) <= 0.25:
            raise ValueError(f"mismatch must be between 0 and 0.25, got {shown(mismatch)}")
        raw = observe == "measurement"
        self.observe_mode, self.mismatch = observe, float(mismatch)
        self.ends = one_of("ends", ("task" if raw else "belief") if ends is None else ends, ENDS)
        if guidance is not None and not isinstance(guidance, bool):
            raise ValueError(f"guidance must be True, False or None, got {shown(guidance)}")
        self.guidance = not raw if guidance is None else guidance
        self.sensors_name, self.disturbance_name = (
            name if isinstance(name, str) else "own" for name in (sensors, disturbance)
        )
        self.world = world = _world(system, sensors, sensor_faults, disturbance)
        self.system, self.vehicle, self.task = system, system.vehicle, system.task
        self.sensors, self.forces, vehicle, task = world.sensors, world.forces, self.vehicle, self.task
        checked = world.vehicle, world.task, world.disturbance
        self.own_parts = [part for part in checked if isinstance(part, CheckedMethods)]
        choice, acting = system.estimator if estimator is None else estimator, world.forces.disturbance
        self.estimation = build(system, choice, estimator_options, world.sensors, acting, num_threads)
        self.composition, self.estimator = self.estimation.composition, self.estimation.filter.name
        self.estimations = {"loop": self.estimation}
        if self.guidance and raw:
            wide = {"model": vehicle.kinds[0]}  # the same whatever estimator is named
            self.estimations["held"] = build(system, "measurement", wide, world.sensors, acting, num_threads)
        self.success = task.ends.index(task.success)
        if self.ends == "declaration" and not task.success:
            raise ValueError(f"{system.name} goes on until time is up, so there is nothing to declare: ends='task'")
        self.action_size = len(vehicle.action_names) + (self.ends == "declaration")
        sizes, seen = task.sizes(self.sensors.size, len(self.composition.names)), observed(observe, self.guidance)
        if not isinstance(sizes, dict) or not all(part in sizes for part in seen):
            raise ValueError(f"sizes of {type(task).__name__} must give {', '.join(seen)}, got {shown(sizes)}")
        self.observation_size = sum(sizes[part] for part in seen) + len(alarming(observe, self.estimation.monitor))
        self.perfect = float(task.perfect), float(task.perfect == task.horizon)  # in all, and a step more
        self.based = tuple(vehicle.state_names.index(name) for name in vehicle.estimated(vehicle.kinds[0]))
        users = not (ours(task) and ours(self.composition.forces.disturbance))
        self.guided = self.guidance and observe == "mean"
        asked = self.composition, self.ends, self.based, self.guided, raw
        self.mission = (Mission if users else _mission)(world.task, *asked, users, not users)
        self.plain: dict[str, Any] = {"world": world, "mission": self.mission}  # whose functions are a user's, in NumPy
        self.untraced, self.changes = world.users or users, 0  # how often they have been traced anew
        self.reads: list[Dependencies] = []  # what those of them read that are traced
        self.true_state = TrueState.of(world, self.composition)
        self.unknown_input = UnknownInput.of(world, self.estimation.inputs)
        self.draws = Draws.of(world, len(self.based), self.mismatch)
        self.nominal = np.array(world.vehicle.parameters(0.0, np.zeros((1, vehicle.normals))))


class TrueState(NamedTuple):
    """The components of `vessel_gym.core.Core.truth`."""

    names: tuple[str, ...]
    drifting: bool  # is the disturbance's state among them?
    alone: bool  # are they the vehicle's state and nothing else?
    estimated: list[int]  # places of those that the filter estimates; -1: it alone thinks that there is one

    @classmethod
    def of(cls, world: World, composition: Composition) -> "TrueState":
        """That of a world, beside a filter's."""
        disturbance, vehicle = world.forces.disturbance, world.forces.vehicle.state_names
        drifting = disturbance.told == "states" or len(composition.held) > 0
        names = *vehicle, *(disturbance.names if drifting else ()), *world.sensors.bias_names
        estimated = [names.index(name) if name in names else -1 for name in composition.names]
        return cls(names, drifting, len(names) == len(vehicle), estimated)


class UnknownInput(NamedTuple):
    """Places of the true unknown input."""

    columns: Any  # of `noise` or `forcing`, or of both and a last column of NaN
    array: str  # "noise", "forcing" or, where both hold a part, ""

    @classmethod
    def of(cls, world: World, names: tuple[str, ...]) -> "UnknownInput":
        """Those of components by these names."""
        disturbance = world.forces.disturbance
        new = (*disturbance.names, *world.sensors.bias_names)
        new = (*disturbance.shakes, *map(change_of, new))  # components of `noise`
        acting = (*new, *input_channels(world.forces.vehicle)[: world.forces.size])
        places = [acting.index(name) if name in acting else len(acting) for name in names]
        fresh, forced = all(i < len(new) for i in places), all(len(new) <= i < len(acting) for i in places)
        chosen = columns([i - len(new) for i in places] if forced else places)
        return cls(chosen, "noise" if fresh else "forcing" if forced else "")


class Draws(NamedTuple):
    """Random numbers of an episode's start."""

    words: tuple[int, ...]  # of the keys of its parts
    counts: tuple[tuple[int, int, int], ...]  # uniform and normal numbers of each, and the use of these
    world: int  # keys before those of the sensors
    parameters: slice  # normals of the vehicle's parameters

    @classmethod
    def of(cls, world: World, based: int, mismatch: float) -> "Draws":
        """Those of a world whose prior is about ``based`` components of the vehicle's state."""
        biased = [sensor for sensor in world.sensors.each if sensor.bias is not None]
        parts = "disturbance", *(f"bias of {sensor.name}" for sensor in biased)
        sensed = (f"sensor {sensor.name}" for sensor in world.sensors.each)
        words = tuple(word(name) for name in (*DRAWN, *parts, *sensed))
        spread, uniforms = world.forces.vehicle.normals if mismatch else 0, world.task.uniforms
        normals = [(0, root.shape[-1], 1) for root in world.start_roots]
        counts = [(uniforms, 0, 0), (0, based, 0), (0, spread, 0), (0, 0, 0), *normals]
        counts += [(0, 0, 0)] * len(world.sensors.each)
        return cls(words, tuple(counts), len(DRAWN) + len(parts), slice(end := uniforms + based, end + spread))


def observed(observe: str, guidance: bool) -> tuple[str, ...]:
    """The parts of an observation, in the words of `vessel_gym.system.Task.sizes`."""
    if observe == "measurement":
        return *(("guided",) if guidance else ()), "readings", "mission"
    return "guided" if guidance else "unguided", *(("std",) if "std" in observe else ())


def alarming(observe: str, monitor: FaultMonitor | None) -> tuple[str, ...]:
    """Names of the sensors whose alarms an observation shows behind all else.

    Raises:
        ValueError: if it shows some, and no monitor watches.
    """
    if "alarms" not in observe:
        return ()
    if monitor is None:
        raise ValueError(
            f'observe="{observe}" shows the alarms of a monitor: give one, estimator_options={{"monitor": "cusum"}}'
        )
    return monitor.names
