"""Vehicle, disturbance and sensors' biases as one state space, of the world or of a filter.

With w ~ N(0, Q), v ~ N(0, R) and an unknown input d, the state moves as ``x+ = f(x, u) + G d + w``
and is measured as ``y = h(x, u) + H d + v``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, Self

import numpy as np

from estimators.differences import central_differences, steps
from vessel_gym.disturbances import Disturbance
from vessel_gym.processes import Process, block_diagonal, product
from vessel_gym.sensors import Sensors
from vessel_gym.vehicles.vehicle import Vehicle


def force_names(vehicle: Vehicle) -> tuple[str, ...]:
    """Names of forces: increments, flows, and faults and losses of actuators."""
    losses = map(_loss_of, vehicle.faults)
    return *vehicle.increments, *vehicle.ambient_flows, *vehicle.faults, *losses


def _loss_of(fault: str) -> str:
    """Name of the lost share of an actuator's effect, from the name of its fault."""
    return f"{fault.removesuffix('fault')}loss"


def cruising(vehicle: Vehicle) -> np.ndarray:
    """State ``(n,)`` of the cruising vehicle."""
    return vehicle.start(vehicle.cruise[0][None])[0][0]


def _placed(values: np.ndarray, places: Sequence[int], size: int) -> np.ndarray:
    """Vectors ``(..., size)`` with values ``(..., k)`` at some places and 0 elsewhere."""
    columns = [np.zeros(values.shape[:-1])] * size
    for j, i in enumerate(places):
        columns[i] = values[..., j]
    return np.stack(columns, -1) if columns else values


@dataclass(frozen=True, eq=False)
class StateSpace:
    """Vehicle, disturbance and sensors' biases as one state.

    The state x has components of the vehicle, of the disturbance, all biases, and increments over
    the step that has ended. The exogenous input ``(..., f)`` has increments, flows and, if the
    disturbance gives any, faults of actuators.

    Attributes:
        vehicle: Vehicle.
        disturbance: Disturbance that acts on it.
        sensors: Sensors.
        kind: Kind of model, one of the vehicle's ``kinds``; None for the world.
        kept: Indices of the components of the disturbance's state in x.
        assumed_as: One of `vessel_gym.models.assumed.ASSUMED`.
        inputs: Names of the components of the unknown input d.
        last: Indices of the increments in x, which sensors show.
        stacked: Is d appended to the filter's state? Measurements show it as it acts.
    """

    vehicle: Any
    disturbance: Disturbance
    sensors: Sensors
    kind: str | None
    kept: Any
    assumed_as: str = "states"
    inputs: tuple[str, ...] = ()
    last: tuple[int, ...] = ()
    stacked: bool = False

    @classmethod
    def of_world(cls, vehicle: Vehicle, disturbance: Disturbance, sensors: Sensors) -> Self:
        """State space with every component of the vehicle's and the disturbance's state."""
        every = np.arange(disturbance.process.size)
        return cls(vehicle, disturbance, sensors, None, every)

    # --- names and places -------------------------------------------------------------------------

    @cached_property
    def vehicle_states(self) -> tuple[str, ...]:
        """Components of the vehicle's state in x."""
        names: tuple[str, ...] = self.vehicle.state_names
        return names if self.kind is None else self.vehicle.estimated(self.kind)

    @property
    def last_names(self) -> tuple[str, ...]:
        """Names of the states that are increments over the step that has ended."""
        return tuple(f"last {self.vehicle.increments[i]}" for i in self.last)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Components of the filter's state."""
        kept = (self.disturbance.names[i] for i in self.kept)
        now = (f"{name} now" for name in self.inputs) if self.stacked else ()
        return *self.vehicle_states, *kept, *self.sensors.bias_names, *self.last_names, *now

    @cached_property
    def increments(self) -> int:
        """Number of increments, the first components of an exogenous input."""
        return len(self.vehicle.increments)

    @cached_property
    def increments_and_flows(self) -> int:
        """Number of increments and flows, after which come faults."""
        return self.increments + len(self.vehicle.ambient_flows)

    @cached_property
    def flows(self) -> slice:
        """Places of flows in an exogenous input."""
        return slice(self.increments, self.increments_and_flows)

    @cached_property
    def channels(self) -> tuple[str, ...]:
        """Names of the components of an exogenous input."""
        names = *self.vehicle.increments, *self.vehicle.ambient_flows
        faulty = not {*names}.issuperset(self.disturbance.forces)
        return (*names, *self.vehicle.faults) if faulty else names

    @property
    def faulty(self) -> bool:
        """Does the disturbance give faults of actuators?"""
        return len(self.channels) > self.increments_and_flows

    @cached_property
    def unknown(self) -> list[int]:
        """Indices of the components of d in the exogenous input."""
        return [*map(self.channels.index, self.inputs)]

    @cached_property
    def disturbed_increments(self) -> list[int]:
        """Indices of the increments that the disturbance gives."""
        given = (*self.disturbance.forces, *self.disturbance.white_increments)
        return [i for i, name in enumerate(self.vehicle.increments) if name in given]

    @property
    def noise_names(self) -> tuple[str, ...]:
        """Names of what is new in a step: white increments, and changes of states and biases."""
        states = *self.disturbance.names, *self.sensors.bias_names
        return *self.disturbance.white_increments, *(f"change of {name}" for name in states)

    @property
    def scored_inputs(self) -> tuple[str, ...]:
        """Names of the unknown inputs of a coming step, for filters that estimate none.

        The names are the increments that follow from the disturbance's state. Without such
        increments they are what is new in a step.
        """
        if {*self.disturbance.forces}.isdisjoint(self.vehicle.increments):
            return self.noise_names
        return tuple(self.vehicle.increments[i] for i in self.disturbed_increments)

    # --- exogenous input --------------------------------------------------------------------------

    def exogenous(
        self, effect: np.ndarray, actuators: np.ndarray, white: np.ndarray | None = None
    ) -> np.ndarray:
        """Exogenous input ``(..., f)`` over a step.

        Args:
            effect: ``(..., k)`` effect of the disturbance.
            actuators: ``(..., a)`` at the beginning of the step, of which a fault loses a share.
            white: ``(..., s)`` white increments; None: zeros.
        """
        zero = np.zeros(effect.shape[:-1])
        given = dict(zip(self.disturbance.forces, np.moveaxis(effect, -1, 0), strict=True))
        if white is not None:
            given |= zip(self.disturbance.white_increments, np.moveaxis(white, -1, 0), strict=True)
        for j, fault in enumerate(self.channels[self.increments_and_flows :]):
            if (lost := given.get(_loss_of(fault))) is not None:
                given[fault] = given.get(fault, zero) - lost * actuators[..., j]
        return np.stack([given.get(name, zero) for name in self.channels], -1)

    def expected_exogenous(self, x: np.ndarray, u: np.ndarray | None = None) -> np.ndarray:
        """Exogenous input ``(..., f)`` that follows from x, with 0 in the components of d.

        Without a known input u ``(..., m)``, actuators are 0.
        """
        size, actions = len(self.channels), len(self.vehicle.action_names)
        if not len(self.kept):
            return np.zeros((*x.shape[:-1], size))
        own, kept, *_ = self.split(x)
        effect = self.disturbance.effect(self._whole_z(kept), self._whole_state(own))
        exogenous = self.exogenous(effect, np.zeros(actions) if u is None else u[..., :actions])
        known = [i for i in range(size) if i not in self.unknown]
        return _placed(exogenous[..., known], known, size)

    def flow(self, mean: np.ndarray, input_mean: np.ndarray | None = None) -> np.ndarray:
        """Ambient flow ``(..., k)`` from means of state and d ``(..., q)``; 0 if unknown."""
        acting = self.expected_exogenous(mean)
        if input_mean is not None:
            acting = product(self.selected, input_mean, acting)
        return acting[..., self.flows]

    # --- f and h ----------------------------------------------------------------------------------

    def split(self, x: np.ndarray) -> tuple[np.ndarray, ...]:
        """Components of x of the vehicle, the disturbance, the biases, and the last increments."""
        sizes = len(self.vehicle_states), len(self.kept), self.sensors.bias.size, len(self.last)
        return tuple(x[..., i:j] for i, j in pairwise(np.cumsum((0, *sizes))))

    def _whole_state(self, own: np.ndarray) -> np.ndarray:
        """State ``(..., n)`` of the vehicle; 0 in components that are not in x."""
        names = self.vehicle.state_names
        return _placed(own, [*map(names.index, self.vehicle_states)], len(names))

    def _whole_z(self, kept: np.ndarray) -> np.ndarray:
        """State ``(..., k)`` of the disturbance; 0 in components that are not in x."""
        return _placed(kept, self.kept, self.disturbance.process.size)

    def vehicle_step(self, own: np.ndarray, u: Any, exogenous: np.ndarray) -> np.ndarray:
        """Estimated components ``(..., n)`` of the vehicle a step later, without increments."""
        if self.faulty:
            u = self.vehicle.faulty(u, exogenous[..., self.increments_and_flows :])
        return self.vehicle.drift(own, u, exogenous[..., self.flows])

    def transition(self, x: np.ndarray, u: Any) -> np.ndarray:
        """Next state ``f(x, u) (..., n)``."""
        if u.shape[:-1] != x.shape[:-1]:
            x = np.broadcast_to(x, np.broadcast_shapes(x.shape[:-1], u.shape[:-1]) + x.shape[-1:])
        (own, kept, biases, _), acting = self.split(x), self.expected_exogenous(x, u)
        increments, k = acting[..., : self.increments], len(self.kept)
        after = self.vehicle_step(own, u, acting)
        after = product(self.incremented[: len(self.vehicle_states)], increments, after)
        slow = self.slow.advance(np.concatenate([kept, biases], -1))
        z = self._whole_z(slow[..., :k])
        z = self.disturbance.met(z, self._whole_state(own), self._whole_state(after))
        parts = after, z[..., self.kept], slow[..., k:], increments[..., list(self.last)]
        return np.concatenate(parts, -1)

    def measurement(self, x: np.ndarray, u: np.ndarray | None = None) -> np.ndarray:
        """Expected measurement ``h(x, u) (..., p)``, which does not depend on u."""
        (own, _, biases, last), flows = self.split(x), self.expected_exogenous(x)[..., self.flows]
        acting = np.concatenate([_placed(last, self.last, self.increments), flows], -1)
        return self.sensors.exact(self._whole_state(own), acting, biases)

    @cached_property
    def slow(self) -> Process:
        """Joint process of the disturbance's states in x, and of the biases."""
        process, square = self.disturbance.process, np.ix_(self.kept, self.kept)
        kept = Process(
            process.transition[square], process.root[self.kept], process.start_cov[square]
        )
        return Process.joined(kept, self.sensors.bias)

    # --- G and H ----------------------------------------------------------------------------------

    @cached_property
    def incremented(self) -> np.ndarray:
        """Effect ``(n, increments)`` of increments on the next state."""
        last = len(self.vehicle_states) + self.slow.size
        effect = np.zeros((last + len(self.last), self.increments))
        for j, name in enumerate(self.vehicle.incremented):
            if name in self.vehicle_states:
                effect[self.vehicle_states.index(name), j] = 1.0
        effect[np.arange(last, len(effect)), self.last] = 1.0
        return effect

    @cached_property
    def selected(self) -> np.ndarray:
        """Effect ``(f, q)`` of d on the exogenous input."""
        return np.eye(len(self.channels))[:, self.unknown]

    @cached_property
    def G(self) -> np.ndarray:
        """Effect ``(n, q)`` of the increments in d on the next state."""
        return self.incremented @ self.selected[: self.increments]

    @cached_property
    def H(self) -> np.ndarray:
        """Effect ``(p, q)`` of d on measurements, for the cruising vehicle."""
        units = self.selected[: self.increments_and_flows].T
        state = np.broadcast_to(cruising(self.vehicle), (len(units), len(self.vehicle.state_names)))
        return (self.sensors.exact(state, units) - self.sensors.exact(state, 0.0 * units)).T

    def input_matrix(self, x: np.ndarray, u: Any) -> np.ndarray:
        """``G(x, u) (..., n, q)``, with central differences about zero flows and faults."""
        n, acting, q = len(self.vehicle_states), self.expected_exogenous(x, u), len(self.inputs)

        def drift(d: np.ndarray, u: np.ndarray | None) -> np.ndarray:
            exogenous = acting[..., None, :] + np.matvec(self.selected, d)
            return self.vehicle_step(
                np.broadcast_to(x[..., None, :n], (*d.shape[:-1], n)), u, exogenous
            )

        none, angles = np.zeros((*x.shape[:-1], q)), self.angles
        slopes = central_differences("drift", drift, none, u, n, angles, steps(none, None))[1]
        rest = np.zeros((*x.shape[:-1], len(self.G) - n, q))
        return self.G + np.concatenate([slopes, rest], -2)

    @property
    def angles(self) -> tuple[int, ...]:
        """Indices of the states that are angles."""
        return tuple(i for i, name in enumerate(self.vehicle_states) if name in self.vehicle.angles)

    # --- covariances ------------------------------------------------------------------------------

    @cached_property
    def linear_effect(self) -> np.ndarray:
        """Exogenous input ``(f, k)`` per unit of the disturbance's state at cruise."""
        k, state = self.disturbance.process.size, cruising(self.vehicle)
        z, actuators = np.eye(k + 1, k, -1), np.zeros(len(self.vehicle.action_names))
        effect = self.disturbance.effect(z, np.tile(state, (k + 1, 1)))
        exogenous = self.exogenous(effect, actuators)
        return (exogenous[1:] - exogenous[0]).T

    @cached_property
    def start_effect(self) -> np.ndarray | None:
        """Effect ``(n, k)`` of the disturbance on the initial state, if flows carry the vehicle."""
        carried = self.vehicle.carried
        return None if carried is None else carried @ self.linear_effect[self.flows]

    @cached_property
    def white(self) -> np.ndarray:
        """Root ``(f, m)`` of the covariance of the white increments, as exogenous input."""
        names = self.disturbance.white_increments
        white = np.zeros((len(self.channels), self.disturbance.white.shape[-1]))
        white[[*map(self.channels.index, names)]] = self.disturbance.white
        return white

    @cached_property
    def cov(self) -> np.ndarray:
        """Stationary covariance ``(f, f)`` of the exogenous input."""
        linear = self.linear_effect
        return linear @ self.disturbance.process.start_cov @ linear.T + self.white @ self.white.T

    @cached_property
    def input_cov(self) -> np.ndarray:
        """Covariance ``(q, q)`` of d: from the disturbance's ``input_sd``, or stationary."""
        if self.disturbance.input_sd is not None:
            return np.diag(np.square(self.disturbance.input_sd))
        return self.cov[np.ix_(self.unknown, self.unknown)]

    @cached_property
    def Q(self) -> np.ndarray:
        """Covariance ``(n, n)`` of process noise."""
        n = len(self.vehicle_states)
        slow = slice(n, n + self.slow.size)
        white = self.white.copy()
        white[self.unknown] = 0.0
        cov = self.cov if self.assumed_as == "process-noise" else white @ white.T
        Q = self.incremented @ cov[: self.increments, : self.increments] @ self.incremented.T
        Q[slow, slow] += self.slow.root @ self.slow.root.T
        Q[:n, :n] += np.diag(np.asarray(self.vehicle.process_sd)[:n] ** 2)
        return Q

    @cached_property
    def R(self) -> Any:
        """Covariance ``(p, p)`` of measurement noise, which may depend on the state."""
        cruise, n = np.zeros(len(self.incremented)), len(self.vehicle_states)
        cruise[:n] = self.vehicle.cruise[0][:n]
        return self.sensors.noise(self.measurement, cruise, None)

    @cached_property
    def scale(self) -> np.ndarray:
        """Divisors of observed standard deviations, after those of the vehicle's state."""
        disturbance = self.disturbance
        sizes = disturbance.scale or np.sqrt(np.diag(disturbance.process.start_cov))
        last = np.sqrt(np.diag(self.cov))[list(self.last)]
        inputs = np.sqrt(np.diag(self.input_cov)) if self.stacked else np.zeros(0)
        parts = np.asarray(sizes, float)[self.kept], self.sensors.bias_scale, last, inputs
        return np.concatenate(parts)

    def joint_prior(self, cov: np.ndarray) -> np.ndarray:
        """Prior covariance of vehicle, whole disturbance and biases, from the vehicle's ``(n, n)``.

        The flow carries a vehicle with velocities over ground from the first moment.
        """
        process, n = self.disturbance.process, len(cov)
        whole = block_diagonal(cov, process.start_cov, self.sensors.bias.start_cov)
        if self.start_effect is None:
            return whole
        root = np.eye(len(whole))
        root[:n, n : n + process.size] = self.start_effect
        return root @ whole @ root.T
