"""State space of a filter: what it assumes of vehicle, disturbance and sensors."""

from dataclasses import replace
from operator import attrgetter

import numpy as np

from estimators.checks import short_repr
from vessel_gym.checks import one_of
from vessel_gym.disturbances import Disturbance
from vessel_gym.models.state_space import StateSpace, force_names
from vessel_gym.models.structure import readers, relevant
from vessel_gym.sensors import Sensors
from vessel_gym.vehicles.vehicle import Vehicle

ASSUMED = ("states", "unknown-input", "white-input", "process-noise")
"""Ways in which a filter assumes a disturbance.

``states``: the disturbance's state is part of the filter's state. ``unknown-input``: the
disturbance's ``inputs`` are the unknown input d, and further effective components are states.
``white-input``: the same model, and d is white noise of known variance. ``process-noise``: the
disturbance's increments are process noise, and flows are not modelled.
"""


def assumed_space(
    vehicle: Vehicle,
    kind: str,
    disturbance: Disturbance,
    sensors: Sensors,
    assumed_as: str | None = None,
) -> StateSpace:
    """State space of a filter.

    Args:
        vehicle: Vehicle.
        kind: Kind of model, one of the vehicle's ``kinds``.
        disturbance: Disturbance that the filter assumes.
        sensors: Sensors that the filter assumes.
        assumed_as: One of `ASSUMED`; None: the disturbance's default.

    Raises:
        ValueError: for an unknown way to assume it, a disturbance that was made for another
            vehicle, or a sensor that reads states which the filter does not estimate.
    """
    how = disturbance.assumed_as if assumed_as is None else assumed_as
    assumed_as = one_of("way to assume a disturbance", how, ASSUMED)
    check_fit(vehicle, disturbance)
    whole = StateSpace.of_world(vehicle, disturbance, sensors)
    space = replace(whole, kind=kind, assumed_as=assumed_as)
    _check_sensors(space)
    if assumed_as in ("unknown-input", "white-input"):
        increments = (vehicle.increments[i] for i in space.disturbed_increments)
        named = disturbance.inputs
        space = replace(space, inputs=tuple(increments if named is None else named))
    kept = np.zeros(0, int) if assumed_as == "process-noise" else relevant(space)
    unmodelled = (i for i in space.disturbed_increments if i not in space.unknown)
    last = (i for i in unmodelled if readers(vehicle, sensors.each, vehicle.increments[i]))
    return replace(space, kept=kept, last=tuple(last))


def _check_sensors(space: StateSpace) -> None:
    """Refuse a sensor that reads what is not estimated, and a bias with the name of another state.

    Raises:
        ValueError: naming the sensor or the bias, and the component.
    """
    sensors, disturbance = space.sensors, space.disturbance
    for name in space.vehicle.state_names:
        unknown = name not in space.vehicle_states
        if unknown and (who := readers(space.vehicle, sensors.each, name)):
            raise ValueError(
                f"{who[0]} reads {name}, which filters of this model do not estimate (they"
                f" estimate {', '.join(space.vehicle_states)}): leave it out, or choose another"
                " model"
            )
    for name in sensors.bias_names:
        if name in disturbance.names:
            raise ValueError(
                f"a bias is called {name!r}, as is a component of {type(disturbance).__name__}"
            )


def check_fit(vehicle: Vehicle, disturbance: Disturbance) -> None:
    """Refuse a disturbance that was made for another vehicle.

    Raises:
        ValueError: naming the input channel, the ship or the time step.
    """
    who, channels = type(disturbance).__name__, force_names(vehicle)
    for name in (*disturbance.forces, *disturbance.white_increments):
        if name not in channels:
            raise ValueError(
                f"{who} gives {short_repr(name)}, but what acts on this vehicle is"
                f" {', '.join(channels)}"
            )
    ship = getattr(disturbance, "ship", None)
    dimensions = attrgetter("length", "beam", "draught", "mass")
    if ship and dimensions(ship) != dimensions(getattr(vehicle, "ship", ship)):
        raise ValueError(
            f"{who} was made for another ship than the vehicle's: give it ship=vehicle.ship"
        )
    if disturbance.dt not in (None, vehicle.dt):
        raise ValueError(
            f"{who} was made for steps of {disturbance.dt} s, the vehicle's are {vehicle.dt:g} s:"
            f" give it dt={vehicle.dt:g}"
        )
