"""Structure of a state space, read from traces of its functions: what depends on what."""

from collections.abc import Callable
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np

from estimators.engine import Argument, trace
from vessel_gym.models.state_space import StateSpace
from vessel_gym.sensors import Sensor, Sensors


def used_entries(function: Callable[..., Any], *sizes: int) -> list[np.ndarray]:
    """Masks of the entries of a function's arguments that its value depends on.

    A function that cannot be traced may depend on all.

    Args:
        function: Function of vectors.
        sizes: Size of each vector.
    """
    ends = np.cumsum((0, *sizes))

    def of_entries(*entries: Any) -> Any:
        parts = (entries[i:j] for i, j in pairwise(ends))
        return function(*(np.stack(part) if part else np.zeros(0) for part in parts))

    mask = np.zeros(ends[-1], bool)
    try:
        mask[[*trace(of_entries, [Argument(())] * len(mask), sealed=True).arguments]] = True
    except TypeError:
        mask[:] = True
    return np.split(mask, ends[1:-1])


_used_by_sensor = lru_cache(maxsize=256)(used_entries)


def reader(sensors: Sensors, name: str) -> Sensor | None:
    """First sensor whose measurement depends on a state, increment or flow; None without one."""
    names = sensors.state_names, sensors.exogenous_names
    place = sum(names, ()).index(name)
    for sensor in sensors.each:
        if np.concatenate(_used_by_sensor(sensor.reads, *map(len, names)))[place]:
            return sensor
    return None


def relevant(space: StateSpace) -> np.ndarray:
    """Indices of the disturbance's states that matter to a filter.

    A state matters if it affects, at once or later, estimated or measured quantities through an
    exogenous input that is not part of d.
    """
    vehicle, disturbance, n = space.vehicle, space.disturbance, len(space.own)
    x, u = map(len, vehicle.cruise)
    size, states, k = len(space.channels), len(vehicle.state_names), disturbance.process.size

    def moved(x: np.ndarray, u: np.ndarray, exogenous: np.ndarray) -> np.ndarray:
        return space.drift(x, u, exogenous)[..., :n]

    counts = used_entries(moved, x, u, size)[2]
    for i, name in enumerate(space.channels[: space.outside]):
        counts[i] |= i < space.increments or reader(space.sensors, name) is not None
    counts[space.unknown] = False

    def acting(z: np.ndarray, state: np.ndarray) -> np.ndarray:
        effect = disturbance.effect(z, state)
        return space.exogenous(effect, np.ones(len(vehicle.action_names)))[..., counts]

    matters, transition = used_entries(acting, k, states)[0], disturbance.process.transition
    for _ in transition:
        matters |= (transition[matters] != 0.0).any(0)
    return np.flatnonzero(matters)
