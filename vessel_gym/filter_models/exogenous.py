"""The exogenous input of a vehicle: increments, ambient flows and faults of actuators."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from operator import attrgetter
from typing import Any

import numpy as np

from estimators.checks import numbers, short_repr
from estimators.engine import TracedArray
from vessel_gym.checks import is_integer
from vessel_gym.disturbances import Disturbance
from vessel_gym.foreign import Copying
from vessel_gym.processes import block_diagonal
from vessel_gym.sensors import check_values
from vessel_gym.vehicles.vehicle import Vehicle
from vessel_gym.verified import is_verified


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
        ValueError: for a force that the vehicle does not have, a white force that is no increment,
            or another time step than the vehicle's.
    """

    def __init__(self, vehicle: Vehicle, disturbance: Disturbance) -> None:
        try:
            mistake = next(_mistakes(vehicle, disturbance), None)
        except (TypeError, AttributeError) as error:
            mistake = (
                f"{type(disturbance).__name__} is not what a Disturbance must be:"
                f" {short_repr(str(error))}"
            )
        if mistake is not None:
            raise ValueError(mistake)
        self.vehicle, self.disturbance = vehicle, disturbance
        self.verified = is_verified(vehicle) and is_verified(disturbance)
        self.meets = type(disturbance).met is not Disturbance.met
        """Does the disturbance's state follow the vehicle's motion?"""
        effect, drift = disturbance.effect, vehicle.drift
        self.effect_verified = is_verified(disturbance) or (is_verified(effect) and not self.meets)
        """Can a measurement function with the effect be compiled?"""
        owner = getattr(drift, "__self__", vehicle)  # a wrapper's drift belongs to another vehicle
        drift_verified = is_verified(owner) or is_verified(drift)
        self.drift_verified = drift_verified and self.effect_verified
        """Can a transition with drift and effect be compiled?"""
        self._effect = effect if self.effect_verified else Copying(effect)
        self._drift: Callable[..., Any] = drift if drift_verified else Copying(drift)
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
        effect = self._effect(z, state)
        return spread(
            {i: effect[..., j] for j, i in enumerate(self.to) if i not in unknown},
            self.size,
            effect,
        )

    def moved(self, x: np.ndarray, u: np.ndarray, exogenous: np.ndarray) -> np.ndarray:
        """Estimated components of the vehicle a step later, without increments."""
        if self.faulty:
            u = self.vehicle.faulty(u, *self.of_actuators(exogenous))  # type: ignore[attr-defined]
        after = self._drift(x, u, exogenous[..., len(self.vehicle.increments) : self.outside])
        return after if isinstance(after, TracedArray) else np.asarray(after, float)

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


def _mistakes(vehicle: Vehicle, disturbance: Disturbance) -> Iterator[str]:
    """Reasons why a disturbance does not fit a vehicle."""
    who, known = type(disturbance).__name__, input_channels(vehicle)
    yield from _mistaken_values(who, disturbance)
    for name in (*disturbance.forces, *disturbance.white_increments):
        if name not in known:
            yield (
                f"{who} gives {short_repr(name)}, but what acts on this vehicle is"
                f" {', '.join(known)}"
            )
    for name in disturbance.white_increments:
        if name not in vehicle.increments or name in disturbance.forces:
            increments = ", ".join(vehicle.increments)
            yield (
                f"{who} gives white increments to {name}, which must be an increment ({increments})"
                " that its effect does not give"
            )
    ship = getattr(disturbance, "ship", None)
    flown = getattr(vehicle, "ship", ship)
    dimensions = attrgetter("length", "beam", "draught", "mass")
    if ship and dimensions(ship) != dimensions(flown):
        yield f"{who} was made for another ship than the vehicle's: give it ship=vehicle.ship"
    if disturbance.dt not in (None, vehicle.dt):
        own, dt = disturbance.dt, vehicle.dt
        yield f"{who} was made for steps of {own} s, the vehicle's are {dt:g} s: give it dt={dt:g}"
    yield from _contradictions(who, disturbance)
    for name in disturbance.names:
        if name in vehicle.state_names:
            yield f"{who} calls a component {name!r}, as another is called"
    yield from _mistakes_of_effect(f"effect of {who}", vehicle, disturbance)


def _mistaken_values(who: str, disturbance: Disturbance) -> Iterator[str]:
    """Attributes of a disturbance that no vehicle can take."""
    for what in ("forces", "white_increments", "names", "inputs"):
        given: Any = getattr(disturbance, what) or ()
        if isinstance(given, str) or len(set(given)) < len(given):
            yield f"{what} of {who} must be a tuple of different names, got {short_repr(given)}"
    believed: Any = disturbance.believed
    if not isinstance(believed, Disturbance | None):
        yield f"believed of {who} must be a Disturbance, or None, got {short_repr(believed)}"
    for what, least, wanted in (("input_sd", 0.0, "of at least 0"), ("scale", 1e-300, "above 0")):
        given = getattr(disturbance, what)
        sizes = numbers(given or ())
        if sizes is None or not ((sizes >= least) & np.isfinite(sizes)).all():
            yield f"{what} of {who} must be numbers {wanted}, got {short_repr(given)}"
    uniforms = disturbance.uniforms
    if not is_integer(uniforms) or uniforms < 0:
        yield (
            f"uniforms of {who} must be a whole number of at least 0, got {short_repr(uniforms)}"
        )


def _contradictions(who: str, disturbance: Disturbance) -> Iterator[str]:
    """Parts of a disturbance that contradict each other, and a process that grows."""
    for name in disturbance.averaged:
        if name not in disturbance.forces:
            yield f"averaged of {who} must name some of its forces, got {short_repr(name)}"
    owners = [
        next(c for c in type(disturbance).__mro__ if name in vars(c))
        for name in ("effect", "effect_at")
    ]
    if disturbance.uniforms and owners[0] is not owners[1] and issubclass(*owners):
        yield (
            f"{owners[0].__name__} gives another effect, but as a field it acts by effect_at: give"
            " that instead"
        )
    names, white, process = disturbance.names, disturbance.white_increments, disturbance.process
    possible = *disturbance.forces, *white, *map(change_of, names)
    for name in disturbance.inputs or ():
        if name not in possible:
            yield (
                f"{who} has the unknown input {short_repr(name)}, which must be one of"
                f" {', '.join(possible)}"
            )
    modulus = np.abs(np.linalg.eigvals(process.transition)).max(initial=0.0)
    if modulus > 1.0 + 1e-6:
        yield (
            f"process of {who} grows by a factor of {modulus:.3g} a step: eigenvalues must be of"
            " modulus 1 at most"
        )
    if len(names) != process.size:
        yield f"{who} names {len(names)} components of a state that has {process.size}"
    for what, rows in (("white", len(white)), ("scale", process.size)):
        given = getattr(disturbance, what)
        if given is not None and len(given) != rows:
            yield f"{what} of {who} must have {rows} rows, got {len(given)}"


def _mistakes_of_effect(effect: str, vehicle: Vehicle, disturbance: Disturbance) -> Iterator[str]:
    z, state = np.zeros((2, disturbance.process.size)), np.tile(cruising(vehicle), (2, 1))
    given = check_values(effect, "z", (2, len(disturbance.forces)), disturbance.effect, z, state)
    if not isinstance(given, np.ndarray):
        yield f"{effect} must give an array, got a {type(given).__name__}"
    elif not np.isfinite(given).all():
        gave = f"gave {short_repr(given[0].tolist())} for z = 0 and a vehicle that cruises"
        yield f"{effect} {gave}: it must be real and finite"
