"""States of a filter's model: vehicle, disturbance and sensors' biases."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vessel_gym.filter_models.exogenous import Forces, cruising, spread
from vessel_gym.processes import Process
from vessel_gym.sensors import Sensors
from vessel_gym.vehicles.vehicle import Vehicle


@dataclass(frozen=True, eq=False)
class Parts:
    """Parts of a filter's model.

    Attributes:
        forces: Effect of the assumed disturbance on the vehicle.
        sensors: Assumed sensors.
        own: Estimated components of the vehicle's state, first in the filter's state.
        estimated: Indices of the estimated components of the disturbance's state, which follow. The
            sensors' biases come next.
        unknown: Indices of the exogenous inputs that are treated as the unknown input d.
        ended: Indices of the increments that sensors show. Their values over the ended step are the
            last components of the filter's state.
    """

    forces: Forces
    sensors: Sensors
    own: tuple[str, ...]
    estimated: np.ndarray
    unknown: list[int]
    ended: list[int]

    @property
    def ended_names(self) -> tuple[str, ...]:
        """Names of the states that are increments."""
        return tuple(f"last {self.vehicle.increments[i]}" for i in self.ended)

    @property
    def base(self) -> int:
        """Number of components from the vehicle's state."""
        return len(self.own)

    @property
    def incremented(self) -> np.ndarray:
        """Effect ``(n, increments)`` of the vehicle's increments on the filter's state."""
        last = self.base + self.drift.size
        effect = np.zeros((last + len(self.ended), len(self.vehicle.increments)))
        for j, name in enumerate(self.vehicle.incremented):
            if name in self.own:
                effect[self.own.index(name), j] = 1.0
        effect[np.arange(last, len(effect)), self.ended] = 1.0
        return effect

    @property
    def vehicle(self) -> Vehicle:
        """Vehicle of the forces."""
        return self.forces.vehicle

    @cached_property
    def drift(self) -> Process:
        """Joint process of the estimated states of the disturbance, and of the biases."""
        process, square = self.forces.disturbance.process, np.ix_(self.estimated, self.estimated)
        estimated = Process(
            process.transition[square], process.root[self.estimated], process.start_cov[square]
        )
        return Process.joined(estimated, self.sensors.bias)

    def state(self, x: np.ndarray) -> np.ndarray:
        """State ``(..., n)`` of the vehicle from the filter's; 0 where not estimated."""
        names, own = self.vehicle.state_names, x[..., : self.base]
        if self.own == names:
            return own
        return spread(
            {names.index(name): own[..., i] for i, name in enumerate(self.own)}, len(names), own
        )

    def acting(self, x: np.ndarray) -> np.ndarray:
        """Exogenous input ``(..., f)`` of a filter's state, without d; ``(f,)`` if zero."""
        if not len(self.estimated):
            return np.zeros(self.forces.size)
        return self.forces.on(self._z(x[..., self.base :]), self.state(x), self.unknown)

    def _z(self, estimated: np.ndarray) -> np.ndarray:
        """State z of the disturbance with the ``estimated`` components; the others are 0."""
        components = {int(i): estimated[..., j] for j, i in enumerate(self.estimated)}
        return spread(components, self.forces.disturbance.process.size, estimated)

    def drifted(self, x: np.ndarray, after: np.ndarray) -> np.ndarray:
        """States of disturbance and biases a step later, when the vehicle's is ``after``."""
        drift, k = self.drift, len(self.estimated)
        moved = drift.advance(x[..., self.base : self.base + drift.size])
        if not (k and self.forces.meets):
            return moved
        z = self.forces.disturbance.met(self._z(moved), self.state(x), self.state(after))
        return np.concatenate(
            [np.stack([z[..., int(i)] for i in self.estimated], -1), moved[..., k:]], -1
        )

    def expected(self, x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        """Measurements without noise ``(..., p)`` in states ``(..., m)`` of a filter."""
        first, increments = self.base + len(self.estimated), len(self.vehicle.increments)
        last = first + self.sensors.bias.size
        ended = spread({i: x[..., last + j] for j, i in enumerate(self.ended)}, increments, x)
        flows = self.acting(x)[..., increments : self.forces.outside]
        flows = np.broadcast_to(flows, (*x.shape[:-1], flows.shape[-1]))
        return self.sensors.exact(
            self.state(x), np.concatenate([ended, flows], -1), x[..., first:last]
        )


# --- what is relevant -----------------------------------------------------------------------------


def near(vehicle: Vehicle, count: int) -> np.ndarray:
    """Random states ``(count, n)`` near that of the cruising vehicle."""
    return cruising(vehicle) + np.random.default_rng(0).standard_normal(
        (count, len(vehicle.state_names))
    )


def seen(sensors: Sensors, state: np.ndarray) -> np.ndarray:
    """Effect ``(..., p, f)`` of a unit of each increment and flow on measurements."""
    size = len(sensors.exogenous_names)
    units = np.broadcast_to(np.eye(size + 1, size, -1), (*state.shape[:-1], size + 1, size))
    with np.errstate(all="ignore"):
        y = sensors.exact(np.repeat(state[..., None, :], size + 1, -2), units)
        return np.swapaxes(np.nan_to_num(y[..., 1:, :] - y[..., :1, :]), -1, -2)


def seen_anywhere(vehicle: Vehicle, sensors: Sensors) -> np.ndarray:
    """Does a measurement depend on an increment or flow ``(p, f)``, in any of eight states?"""
    return np.any(seen(sensors, near(vehicle, 8)), 0)


def seen_alike(vehicle: Vehicle, sensors: Sensors, i: int) -> bool:
    """Is the effect of an exogenous input on measurements equal in all states?"""
    here, elsewhere = (
        seen(sensors, state)[..., i] for state in (cruising(vehicle), near(vehicle, 5))
    )
    return np.allclose(elsewhere, here, rtol=1e-9, atol=1e-9)


def moving(forces: Forces, n: int) -> np.ndarray:
    """Mask ``(f,)`` of flows and faults that move the first ``n`` estimated components."""
    x, u = forces.vehicle.cruise
    still = forces.moved(x, u, np.zeros(forces.size))[:n]
    return np.array([(forces.moved(x, u, unit)[:n] != still).any() for unit in np.eye(forces.size)])


def relevant(
    forces: Forces, sensors: Sensors, n: int, unknown: list[int], changing: list[int]
) -> np.ndarray:
    """Indices of the disturbance's states that a filter with ``n`` states of the vehicle estimates.

    A state is relevant if it affects, at once or later, estimated or measured quantities through an
    exogenous input that is not ``unknown``. The states ``changing`` by an unknown input are
    relevant, too. An effect may depend on both states in any way, so that it is evaluated in
    several places.
    """
    vehicle, process = forces.vehicle, forces.disturbance.process
    counts, size = moving(forces, n), len(vehicle.state_names)
    counts[: len(vehicle.increments)] = True
    counts[: forces.outside] |= seen_anywhere(vehicle, sensors).any(0)
    counts[unknown] = False
    rng, matters = np.random.default_rng(0), np.isin(np.arange(process.size), changing)
    for far in (0.0, 1.0, 10.0, 100.0):
        z = 0.5 * rng.standard_normal(process.size) * (far > 0.0)
        for offset in (*far * rng.standard_normal((2, size)), np.full(size, far)):
            rows = np.tile(cruising(vehicle) + offset, (process.size + 1, 1))
            with np.errstate(all="ignore"):
                given = forces.on(np.vstack([z, z + np.eye(process.size)]), rows)
            matters = matters | ((given[1:] != given[0]) & counts).any(-1)
    for _ in process.transition:
        matters = matters | (process.transition[matters] != 0.0).any(0)
    return np.flatnonzero(matters)


def check_estimated(own: tuple[str, ...], vehicle: Vehicle, sensors: Sensors) -> None:
    """Refuse a sensor that reads a component of the state which the filter does not estimate.

    Raises:
        ValueError: naming the sensor and the component.
    """
    names, state = vehicle.state_names, cruising(vehicle)
    missing = [i for i, name in enumerate(names) if name not in own]
    states = np.vstack([state, state + np.eye(len(names))[missing]])
    y = sensors.exact(states, np.zeros((len(states), len(sensors.exogenous_names))))
    for i, changed in zip(missing, y[1:] != y[0], strict=True):
        if changed.any():
            raise ValueError(
                f"{sensors.of_channel(np.argmax(changed)).name} reads {names[i]}, which filters of"
                f" this model do not estimate (they estimate {', '.join(own)}): leave it out, or"
                " choose another model"
            )
