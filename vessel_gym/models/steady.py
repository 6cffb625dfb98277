"""Design of the filter of constant gain: a model about cruise, and axes that turn with the path."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from estimators import LinearModel, Model
from estimators.engine import sincos
from estimators.linalg import congruence, identity
from vessel_gym.caching import cached
from vessel_gym.disturbances import Disturbance
from vessel_gym.models.assumed import assumed_space
from vessel_gym.models.linear import filter_model
from vessel_gym.models.state_space import StateSpace
from vessel_gym.sensors import Sensors
from vessel_gym.vehicles.vehicle import Vehicle

_EAST = {"x": "y", "north": "east"}
"""Words in names of components to the north, and those in names of components to the east."""

_LONGEST = 10_000
"""Longest common period of sensors for which a gain is computed, in steps."""


def steady_options(space: StateSpace, model: Model) -> dict[str, Any]:
    """Options of ``steady-kf``: its gain is that of the cruising vehicle, in axes of its path.

    A constant bias, which has no gain, counts as noise of its sensor: otherwise a precise sensor
    with a bias would be trusted.
    """
    sensors, u = space.sensors, space.vehicle.cruise[1]
    parts: Any = space.vehicle, space.kind, space.disturbance, sensors, space.assumed_as
    still = ~sensors.bias.root.any(-1)
    biases = sensors.bias.start_cov * np.outer(still, still)
    R = model.value("R", u) + congruence(sensors.bias_gain, biases)
    if (period := math.lcm(*sensors.periods)) > _LONGEST:
        raise ValueError(
            f"all sensors report together once in {period} steps, and a gain needs them within"
            f" {_LONGEST}: choose rates that divide each other"
        )
    return {
        "design": LinearModel(*_about_cruise(*parts), model.value("Q", u), R),
        "measured": (np.arange(period)[:, None] % sensors.periods == 0)[:, sensors.owner],
        "nuisance": [*map(space.names.index, sensors.bias_names)],
        "axes": path_axes(space.names),
        "names": space.names,
    }


@cached
def _about_cruise(
    vehicle: Vehicle, kind: str, disturbance: Disturbance, sensors: Sensors, assumed_as: str
) -> tuple[np.ndarray, np.ndarray]:
    """A and C of a filter's model at cruise, without flows and biases, for any Q and R."""
    space = assumed_space(vehicle, kind, disturbance, sensors, assumed_as)
    model, (cruise, u), n = filter_model(space), vehicle.cruise, len(space.vehicle_states)
    x = np.concatenate([cruise[:n], np.zeros(model.n - n)])
    return model.linearise_transition(x, u)[1], model.linearise_measurement(x, u)[1]


def path_axes(names: tuple[str, ...]) -> Callable[[np.ndarray], np.ndarray] | None:
    """Function of states ``(..., n)`` that returns their rotation ``(..., n, n)`` from path axes.

    It turns the components x and y, and north and east, of which the names of states have these
    words. The path is along the heading ``psi``, or along the velocity ``north``, ``east``. None:
    the states have no direction.
    """
    alike = [" ".join(_EAST.get(word, word) for word in name.split()) for name in names]
    pairs = [(i, names.index(j)) for i, j in enumerate(alike) if j in names and j != names[i]]
    for along in ("psi",), ("north", "east"):
        if pairs and {*along}.issubset(names):
            return partial(_rotation, pairs=pairs, along=[*map(names.index, along)])
    return None


def _rotation(mean: np.ndarray, pairs: list[tuple[int, int]], along: list[int]) -> np.ndarray:
    """Rotation ``(..., n, n)`` of pairs of components by a heading, or by the course."""
    direction, n = [mean[..., i] for i in along], mean.shape[-1]
    if len(along) == 1:
        sin, cos = sincos(*direction)
    else:
        speed = np.maximum(np.hypot(*direction), 1e-9)
        cos, sin = (each / speed for each in direction)
    entries = np.zeros((n, n), int)
    for i, j in pairs:
        entries[[i, j, j, i], [i, j, i, j]] = 1, 1, 2, 3
    sin, cos = sin[..., None, None], cos[..., None, None]
    turned = np.where(entries == 3, -sin, np.where(entries == 2, sin, identity(n)))
    return np.where(entries == 1, cos, turned)
