"""Common part of our vehicles: equations of motion over a step, actuators, filters that estimate all of the state."""

from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from vessel_gym.vehicles.actuators import actuated
from vessel_gym.vehicles.integration import incremented, runge_kutta
from vessel_gym.verified import Verified


class Simulated(Verified, verified=True):
    """Equations of motion, integrated by Runge and Kutta, with increments at the end of a step."""

    dt: float
    substeps: int
    state_names: ClassVar[tuple[str, ...]]
    incremented: ClassVar[tuple[str, ...]]
    equations: ClassVar[Any]
    """The equations of motion, `vessel_gym.vehicles.integration.Rates`; who overrides `moved` needs none."""
    carried: ClassVar[np.ndarray | None] = None
    normals: ClassVar[int]
    parameters: Any
    _actuators: Any
    """The parameters of its actuators, see `vessel_gym.vehicles.actuators.actuator_parameters`."""

    @cached_property
    def _nominal(self) -> np.ndarray:
        """The coefficients that filters know ``(k,)``."""
        return self.parameters(0.0, np.zeros((1, self.normals)))[0]

    def actuate(self, actuators: np.ndarray, action: np.ndarray) -> np.ndarray:
        """Actuators ``(..., a)`` after a step of ``action`` in [-1, 1], within limits and rates."""
        return actuated(actuators, action, self._actuators)

    def moved(
        self,
        state: np.ndarray,
        before: np.ndarray,
        after: np.ndarray,
        flow: np.ndarray,
        parameters: np.ndarray,
    ) -> np.ndarray:
        """The state one step later, without increments."""
        return runge_kutta(
            self.equations, state, before, after, flow, parameters, self.dt, self.substeps
        )

    def step(
        self,
        state: np.ndarray,
        before: np.ndarray,
        after: np.ndarray,
        exogenous: np.ndarray,
        parameters: np.ndarray,
    ) -> np.ndarray:
        """The state one step later, with actuators moving from ``before`` to ``after``."""
        increments = len(self.incremented)
        moved = self.moved(state, before, after, exogenous[..., increments:], parameters)
        return incremented(
            moved,
            exogenous[..., :increments],
            [self.state_names.index(name) for name in self.incremented],
        )


class WholeState(Simulated, verified=True):
    """A vehicle of which filters have one model, the nonlinear one, that leaves out nothing.

    It begins with its actuators as they are while it cruises. Increments change some of its state
    at the end of a step, a flow carries it over the step.
    """

    body: Any
    """Its numbers; ``body.vector(factors)`` are the coefficients of its equations of motion."""
    action_names: ClassVar[tuple[str, ...]]
    ambient_flows: ClassVar[tuple[str, ...]]
    cruise: Any
    kinds: ClassVar[tuple[str, ...]] = ("nonlinear",)
    linear_kinds: ClassVar[tuple[str, ...]] = ()

    def estimated(self, kind: str) -> tuple[str, ...]:
        """All of the state."""
        return self.state_names

    @property
    def process_sd(self) -> np.ndarray:
        """The models leave out nothing."""
        return np.zeros(len(self.state_names))

    def known_input(
        self, before: np.ndarray, after: np.ndarray, commanded: np.ndarray | None
    ) -> np.ndarray:
        """The actuators at the start of a step and at its end."""
        return np.concatenate([before, after], -1)

    def linear(self, kind: str) -> tuple[Any, ...]:
        """There is none."""
        raise NotImplementedError

    @cached_property
    def increments(self) -> tuple[str, ...]:
        """One for each component that is incremented, in its unit."""
        return tuple(f"{name} increment" for name in self.incremented)

    @cached_property
    def faults(self) -> tuple[str, ...]:
        """Names of faults that may be added to its actuators over a step, in their units."""
        return tuple(f"{name} fault" for name in self.action_names)

    def faulty(self, u: np.ndarray, offsets: np.ndarray, losses: np.ndarray) -> np.ndarray:
        """The known input with ``offsets (..., a)`` of the actuators, and without the share ``losses`` of them."""
        a = len(self.action_names)
        before, after, rest = u[..., :a], u[..., a : 2 * a], u[..., 2 * a :]
        added = offsets - losses * before
        rest = np.broadcast_to(rest, (*added.shape[:-1], rest.shape[-1]))
        return np.concatenate([before + added, after + added, rest], -1)

    def parameters(self, mismatch: float, normals: np.ndarray) -> np.ndarray:
        """Coefficients ``(B, k)`` of the truth: the filter's, with a relative spread on the uncertain ones."""
        return self.body.vector(1.0 + mismatch * np.clip(normals, -2.0, 2.0))

    def start(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """State ``(..., n)`` and actuators ``(..., a)`` to begin with."""
        return x.copy(), self.cruise[1][: len(self.action_names)] + np.zeros((*x.shape[:-1], 1))

    def drift(self, x: np.ndarray, u: np.ndarray, flow: np.ndarray) -> np.ndarray:
        """A step without increments, as filters know it."""
        a = len(self.action_names)
        return self.moved(x, u[..., :a], u[..., a : 2 * a], flow, self._nominal)
