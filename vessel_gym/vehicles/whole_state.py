"""Common parts of vehicles: integration, actuators, and filters of the whole state."""

from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from estimators.engine import compiled
from vessel_gym.vehicles.actuators import actuated
from vessel_gym.vehicles.integration import incremented, runge_kutta


@compiled
class Simulated:
    """Equations of motion, integrated by Runge-Kutta, with increments at the end of a step."""

    dt: float
    substeps: int
    state_names: ClassVar[tuple[str, ...]]
    incremented: ClassVar[tuple[str, ...]]
    equations: ClassVar[Any]
    """Equations of motion, a `vessel_gym.vehicles.integration.Rates`, for the default `moved`."""
    carried: ClassVar[np.ndarray | None] = None
    normals: ClassVar[int]
    parameters: Any
    _actuators: Any
    """Parameters of the actuators, see `vessel_gym.vehicles.actuators.actuator_parameters`."""

    @cached_property
    def _nominal(self) -> np.ndarray:
        """Coefficients ``(k,)`` of filters' models."""
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
        """State one step later, without increments."""
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
        """State one step later, while actuators move from ``before`` to ``after``."""
        increments = len(self.incremented)
        moved = self.moved(state, before, after, exogenous[..., increments:], parameters)
        return incremented(
            moved,
            exogenous[..., :increments],
            [self.state_names.index(name) for name in self.incremented],
        )


@compiled
class WholeState(Simulated):
    """A vehicle whose filters estimate its whole state with one exact, nonlinear model.

    Actuators start at their values for the cruising vehicle. Increments change components of the
    state at the end of a step, and a flow carries the vehicle over the step.
    """

    body: Any
    """Particulars; ``body.vector(factors)`` returns the coefficients of the equations of motion."""
    action_names: ClassVar[tuple[str, ...]]
    ambient_flows: ClassVar[tuple[str, ...]]
    cruise: Any
    kinds: ClassVar[tuple[str, ...]] = ("nonlinear",)
    linear_kinds: ClassVar[tuple[str, ...]] = ()

    def estimated(self, kind: str) -> tuple[str, ...]:
        """All components of the state."""
        return self.state_names

    @property
    def process_sd(self) -> np.ndarray:
        """Zeros, because the model leaves out nothing."""
        return np.zeros(len(self.state_names))

    def known_input(
        self, before: np.ndarray, after: np.ndarray, commanded: np.ndarray | None
    ) -> np.ndarray:
        """Actuators at the start of a step, then at the end."""
        return np.concatenate([before, after], -1)

    def linear(self, kind: str) -> tuple[Any, ...]:
        """Raise an error, because there is no linear model."""
        raise NotImplementedError

    @cached_property
    def increments(self) -> tuple[str, ...]:
        """Names of the increments, one for each incremented component."""
        return tuple(f"{name} increment" for name in self.incremented)

    @cached_property
    def faults(self) -> tuple[str, ...]:
        """Names of the faults of actuators, which are additions in the actuators' units."""
        return tuple(f"{name} fault" for name in self.action_names)

    def faulty(self, u: np.ndarray, faults: np.ndarray) -> np.ndarray:
        """Known input with additions ``faults (..., a)`` to actuators."""
        a = len(self.action_names)
        rest = np.broadcast_to(u[..., 2 * a :], (*faults.shape[:-1], u.shape[-1] - 2 * a))
        return np.concatenate([u[..., :a] + faults, u[..., a : 2 * a] + faults, rest], -1)

    def parameters(self, mismatch: float, normals: np.ndarray) -> np.ndarray:
        """True coefficients ``(B, k)``; mismatch is their relative standard deviation."""
        return self.body.vector(1.0 + mismatch * np.clip(normals, -2.0, 2.0))

    def start(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Initial state ``(..., n)`` and actuators ``(..., a)``."""
        return x.copy(), self.cruise[1][: len(self.action_names)] + np.zeros((*x.shape[:-1], 1))

    def drift(self, x: np.ndarray, u: np.ndarray, flow: np.ndarray) -> np.ndarray:
        """State one step later in filters' models."""
        a = len(self.action_names)
        return self.moved(x, u[..., :a], u[..., a : 2 * a], flow, self._nominal)
