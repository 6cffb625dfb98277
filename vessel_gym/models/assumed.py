"""State space of a filter: what it assumes of vehicle, disturbance and sensors."""

from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any

import numpy as np

from estimators import factory
from estimators.checks import number, short_repr
from vessel_gym import checks
from vessel_gym.disturbances import Disturbance
from vessel_gym.models.state_space import StateSpace, force_names
from vessel_gym.models.structure import readers, refuse_readers, relevant
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
    assumed_as = checks.one_of("way to assume a disturbance", how, ASSUMED)
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
    known, disturbance = space.vehicle_states, space.disturbance
    refuse_readers(
        space,
        [name for name in space.vehicle.state_names if name not in known],
        f"which filters of this model do not estimate (they estimate {', '.join(known)}): leave it"
        " out, or choose another model",
    )
    for name in space.sensors.bias_names:
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


# --- options ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Assumptions:
    """Assumptions of a filter that differ from the world: ``estimator_options={"assume": {...}}``.

    Attributes:
        disturbance: Assumed disturbance, by name or as an object; None: the true one.
        how: One of `ASSUMED` (``"as"`` in the options); None: the disturbance's default.
        Q: Factor on the covariances of process noise and of a white input.
        R: Factor on the covariance of measurement noise, or factors by the names of sensors.
    """

    disturbance: str | Disturbance | None = None
    how: str | None = None
    Q: float = 1.0
    R: float | tuple[tuple[str, float], ...] = 1.0

    @classmethod
    def of(cls, options: object) -> "Assumptions":
        """Assumptions from the value of the option ``assume``.

        Raises:
            TypeError: for anything but a dictionary, or an unknown key.
            ValueError: for a factor that is not positive, or an unknown way to assume a
                disturbance.
        """
        given = checks.options("assume", options)
        known = ("disturbance", "as", "Q", "R")
        for key in given:
            if key not in known:
                raise TypeError(factory.unknown("key of assume", key, known))
        for key in ("Q", "R"):
            if key == "R" and isinstance(given.get(key), dict):
                factors = given[key].items()
                given[key] = tuple((name, _factor(f"R of {name}", f)) for name, f in factors)
            elif key in given:
                given[key] = _factor(f"{key} of assume", given[key])
        if "as" in given:
            how = given.pop("as")
            given["how"] = checks.one_of("way to assume a disturbance", how, ASSUMED)
        return cls(**given)

    def scaled(self, model: Any, sensors: Sensors) -> Any:
        """A model with the factors on Q and R.

        Raises:
            ValueError: for a factor of a sensor that is not there.
        """
        if self.Q == self.R == 1.0:
            return model
        Q, R = (
            noise.scaled(factor) if callable(noise) else factor * noise
            for factor, noise in ((self.Q, model.Q), (self._R(sensors), model.R))
        )
        return replace(model, Q=Q, R=R)

    def _R(self, sensors: Sensors) -> float | np.ndarray:
        """The factor on R, or factors ``(p, p)`` if sensors have their own."""
        if not isinstance(self.R, tuple):
            return self.R
        root, names = np.ones(sensors.size), [sensor.name for sensor in sensors.each]
        for name, factor in self.R:
            if name not in names:
                raise ValueError(factory.unknown("sensor in R of assume", name, names))
            root[sensors.owner == names.index(name)] = np.sqrt(factor)
        return root[:, None] * root


def _factor(name: str, value: object) -> float:
    """A factor of assumptions."""
    return number(name, value, low=0.0, what="a factor above 0")
