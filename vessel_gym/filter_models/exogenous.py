"""The exogenous input of a vehicle: increments, ambient flows and faults of actuators."""

from collections.abc import Mapping, Sequence
from functools import cached_property
from operator import attrgetter

import numpy as np

from estimators.checks import short_repr
from vessel_gym.checks import is_compiled
from vessel_gym.disturbances import Disturbance
from vessel_gym.processes import block_diagonal
from vessel_gym.vehicles.vehicle import Vehicle


def input_channels(vehicle: Vehicle) -> tuple[str, ...]:
    """Names of input channels: increments, ambient flows, faults and losses of actuators."""
    faults: tuple[str, ...] = getattr(vehicle, "faults", ())  # optional
    return (
        *vehicle.increments,
        *vehicle.ambient_flows,
        *faults,
        *(f"{name.removesuffix('fault')}loss" for name in faults),
    )


def change_of(name: str) -> str:
    """Name of the change of a state's component in a step."""
    return f"change of {name}"


def spread(components: Mapping[int, np.ndarray], size: int, like: np.ndarray) -> np.ndarray:
    """Vectors ``(..., size)`` with ``components (...)`` by index and 0 elsewhere."""
    zero = np.zeros(like.shape[:-1])
    return np.stack([components.get(i, zero) for i in range(size)], -1)


def cruising(vehicle: Vehicle) -> np.ndarray:
    """State ``(n,)`` of the cruising vehicle."""
    return vehicle.start(vehicle.cruise[0][None])[0][0]


class Forces:
    """Effect of a disturbance on a vehicle, sorted into increments, flows and faults.

    Args:
        vehicle: Vehicle.
        disturbance: Disturbance.

    Raises:
        ValueError: for a force that the vehicle does not have, another ship or another time step
            than the vehicle's.
    """

    def __init__(self, vehicle: Vehicle, disturbance: Disturbance) -> None:
        _check_fit(vehicle, disturbance)
        self.vehicle, self.disturbance = vehicle, disturbance
        self.meets = type(disturbance).met is not Disturbance.met
        """Does the disturbance's state follow the vehicle's motion?"""
        meets = is_compiled(disturbance.met) or not self.meets
        self.effect_compiled = is_compiled(disturbance.effect) and meets
        """Can a measurement function with the effect be compiled?"""
        self.drift_compiled = is_compiled(vehicle.drift) and self.effect_compiled
        """Can a transition with drift and effect be compiled?"""
        known, increments = input_channels(vehicle), len(vehicle.increments)
        self.to = [known.index(name) for name in disturbance.forces]
        self.outside = increments + len(vehicle.ambient_flows)
        """Number of increments and flows, the first components of an exogenous input."""
        self.faulty = max(self.to, default=-1) >= self.outside
        """Does the exogenous input have faults and losses of actuators?"""
        self.channels = known if self.faulty else known[: self.outside]
        """Names of the components of an exogenous input."""
        self.size = len(self.channels)
        self._losses = (self.outside + self.size) // 2
        self.white_indices = [known.index(name) for name in disturbance.white_increments]
        self.increments = [i for i in range(increments) if i in self.to + self.white_indices]
        """Indices of the increments that the disturbance gives."""
        self.has_increments = min(self.to, default=increments) < increments
        """Does an increment follow from the disturbance's state, instead of being white?"""

    @cached_property
    def constant(self) -> bool:
        """Is the effect declared linear, so that it is `gains` times z at every state?"""
        return getattr(self.disturbance.effect, "linear", False) and not self.faulty

    @cached_property
    def input_names(self) -> tuple[str, ...]:
        """Names of the components of the unknown input d."""
        named = self.disturbance.inputs
        return tuple(self.channels[i] for i in self.increments) if named is None else tuple(named)

    @cached_property
    def inputs(self) -> list[int]:
        """Indices of d's components in the exogenous input followed by the changes of z."""
        changes = [*self.channels, *map(change_of, self.disturbance.names)]
        return [changes.index(name) for name in self.input_names]

    @cached_property
    def unknown(self) -> list[int]:
        """Indices of the exogenous inputs treated as d; an actuator's fault includes its loss."""
        acting = [i for i in self.inputs if i < self.size]
        faults = range(self.outside, self._losses)
        return acting + [i + self.size - self._losses for i in acting if i in faults]

    @cached_property
    def gains(self) -> np.ndarray:
        """Gains ``(f, s + k)`` of white increments and, if the effect is `constant`, of z."""
        white = np.eye(self.size)[:, self.white_indices]
        z = self.linear if self.constant else np.zeros((self.size, self.disturbance.process.size))
        return np.ascontiguousarray(np.hstack([white, z]))

    def add(self, exogenous: np.ndarray, effect: np.ndarray, actuators: np.ndarray) -> np.ndarray:
        """Exogenous input ``(..., f)`` plus an effect, with losses of actuators."""
        columns = list(np.moveaxis(exogenous, -1, 0))
        for j, i in enumerate(self.to):
            columns[i] = effect[..., j]
        if self.faulty:
            for j, lost in enumerate(range(self._losses, self.size)):
                columns[self.outside + j] = (
                    columns[self.outside + j] - columns[lost] * actuators[..., j]
                )
        return np.stack(columns, -1)

    def of_actuators(self, exogenous: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Additions and lost shares of the actuators ``(..., a)``, from ``exogenous``."""
        return exogenous[..., self.outside : self._losses], exogenous[..., self._losses :]

    def on(self, z: np.ndarray, state: np.ndarray, unknown: Sequence[int] = ()) -> np.ndarray:
        """Exogenous input ``(..., f)`` without its white noise; 0 in ``unknown`` components."""
        effect = self.disturbance.effect(z, state)
        return spread(
            {i: effect[..., j] for j, i in enumerate(self.to) if i not in unknown},
            self.size,
            effect,
        )

    def moved(self, x: np.ndarray, u: np.ndarray, exogenous: np.ndarray) -> np.ndarray:
        """Estimated components of the vehicle a step later, without increments."""
        if self.faulty:
            u = self.vehicle.faulty(u, *self.of_actuators(exogenous))  # type: ignore[attr-defined]
        flow = exogenous[..., len(self.vehicle.increments) : self.outside]
        return self.vehicle.drift(x, u, flow)

    @cached_property
    def linear(self) -> np.ndarray:
        """Exogenous input ``(f, k)`` per unit of each component of z, for the cruising vehicle."""
        k, state = self.disturbance.process.size, cruising(self.vehicle)
        still = self.on(np.zeros((1, k)), state[None])
        return (self.on(np.eye(k), np.tile(state, (k, 1))) - still).T

    @cached_property
    def carried(self) -> np.ndarray | None:
        """Effect ``(n, k)`` of z on the initial state, if flows carry the vehicle."""
        carried, first = self.vehicle.carried, len(self.vehicle.increments)
        return None if carried is None else carried @ self.linear[first : self.outside]

    @property
    def increment_cov(self) -> np.ndarray:
        """Stationary covariance of the increments."""
        return self.cov[np.ix_(self.increments, self.increments)]

    @cached_property
    def input_cov(self) -> np.ndarray:
        """Covariance of d: from the disturbance's ``input_sd``, or else the stationary one."""
        if self.disturbance.input_sd is not None:
            return np.diag(np.square(self.disturbance.input_sd))
        root = self.disturbance.process.root
        return block_diagonal(self.cov, root @ root.T)[np.ix_(self.inputs, self.inputs)]

    @cached_property
    def white(self) -> np.ndarray:
        """Root ``(f, m)`` of the covariance of the white part of the exogenous input."""
        white = np.zeros((self.size, self.disturbance.white.shape[-1]))
        white[self.white_indices] = self.disturbance.white
        return white

    @cached_property
    def cov(self) -> np.ndarray:
        """Stationary covariance of the exogenous input."""
        return (
            self.linear @ self.disturbance.process.start_cov @ self.linear.T
            + self.white @ self.white.T
        )


# --- a disturbance that does not fit --------------------------------------------------------------


def _check_fit(vehicle: Vehicle, disturbance: Disturbance) -> None:
    """Refuse a disturbance that was made for another vehicle.

    Raises:
        ValueError: naming the input channel, the ship or the time step.
    """
    who = type(disturbance).__name__
    for name in (*disturbance.forces, *disturbance.white_increments):
        if name not in input_channels(vehicle):
            raise ValueError(
                f"{who} gives {short_repr(name)}, but what acts on this vehicle is"
                f" {', '.join(input_channels(vehicle))}"
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
