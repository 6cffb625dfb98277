"""Structure of a state space, read from traces of its functions: what depends on what."""

from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from estimators.engine import Argument, trace
from vessel_gym.caching import cached
from vessel_gym.models.state_space import StateSpace, cruising
from vessel_gym.sensors import Sensor
from vessel_gym.vehicles.vehicle import Vehicle


def used_entries(function: Callable[..., Any], *points: np.ndarray) -> list[np.ndarray]:
    """Masks of the entries of a function's arguments that its value depends on.

    The trace of the function says which. The value of a function that cannot be traced is compared
    with those one unit away in each entry.

    Args:
        function: Function of vectors.
        points: Vectors of the right sizes; ordinary ones, for functions that cannot be traced.
    """
    point, ends = np.concatenate(points), np.cumsum([0, *map(len, points)])

    def of_entries(*entries: Any) -> Any:
        parts = (entries[i:j] for i, j in pairwise(ends))
        return function(*(np.stack(part) if part else np.zeros(0) for part in parts))

    mask = np.zeros(len(point), bool)
    try:
        mask[[*trace(of_entries, [Argument(())] * len(point), sealed=True).arguments]] = True
    except Exception:  # NumPy raises errors of many kinds for tracers
        moved = point + np.eye(len(point) + 1, len(point), -1)
        value = function(*np.split(moved, ends[1:-1], -1))
        mask = (value[1:] != value[0]).any(-1)
    return np.split(mask, ends[1:-1])


@cached
def _used_by(reads: Callable[..., Any], vehicle: Vehicle) -> list[np.ndarray]:
    """Masks of the states, and of the increments and flows, that a sensor's function depends on."""
    exogenous = np.zeros(len(vehicle.increments + vehicle.ambient_flows))
    return used_entries(reads, cruising(vehicle), exogenous)


def readers(vehicle: Vehicle, sensors: Sequence[Sensor], name: str) -> list[str]:
    """Names of the sensors that depend on a state, increment or flow of the vehicle."""
    names = *vehicle.state_names, *vehicle.increments, *vehicle.ambient_flows
    own = np.equal(names, name)
    return [s.name for s in sensors if own[np.concatenate(_used_by(s.reads, vehicle))].any()]


def refuse_readers(space: StateSpace, names: Iterable[str], reason: str) -> None:
    """Refuse a sensor that depends on one of some states, increments or flows.

    Raises:
        ValueError: naming the sensor and the component, with the reason.
    """
    for name in names:
        if who := readers(space.vehicle, space.sensors.each, name):
            raise ValueError(f"{who[0]} reads {name}, {reason}")


@cached
def _moving_flows(vehicle: Vehicle, n: int) -> np.ndarray:
    """Mask of the flows that move the first ``n`` estimated components."""

    def moved(x: np.ndarray, u: np.ndarray, flow: np.ndarray) -> np.ndarray:
        return vehicle.drift(x, u, flow)[..., :n]

    return used_entries(moved, *vehicle.cruise, np.zeros(len(vehicle.ambient_flows)))[2]


def relevant(space: StateSpace) -> np.ndarray:
    """Indices of the disturbance's states that matter to a filter.

    A state matters if it affects, at once or later, estimated or measured quantities through an
    exogenous input that is not part of d.
    """
    vehicle, disturbance = space.vehicle, space.disturbance
    counts = np.ones(len(space.channels), bool)
    moving = _moving_flows(vehicle, len(space.vehicle_states))
    counts[space.flows] = [
        moves or bool(readers(vehicle, space.sensors.each, name))
        for moves, name in zip(moving, vehicle.ambient_flows, strict=True)
    ]
    counts[space.unknown] = False

    def acting(z: np.ndarray, state: np.ndarray) -> np.ndarray:
        effect = disturbance.effect(z, state)
        return space.exogenous(effect, np.ones(len(vehicle.action_names)))[..., counts]

    transition = disturbance.process.transition
    matters = used_entries(acting, np.ones(len(transition)), cruising(vehicle))[0]
    for _ in transition:
        matters |= (transition[matters] != 0.0).any(0)
    return np.flatnonzero(matters)
