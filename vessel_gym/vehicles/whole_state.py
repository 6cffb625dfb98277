"""What vehicles share whose filters estimate all of their state, with their own equations of motion as the model."""

from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from vessel_gym.vehicles.integration import kicked, runge_kutta


class WholeState:
    """A vehicle of which filters have one model, the nonlinear one, that leaves out nothing.

    It begins with its actuators as they are while it cruises. Kicks change some of its state at the end of a step, a
    flow carries it over the step.
    """

    body: Any
    """Its numbers; ``body.vector(factors)`` are the coefficients of its equations of motion."""
    dt: float
    substeps: int
    state_names: ClassVar[tuple[str, ...]]
    action_names: ClassVar[tuple[str, ...]]
    kicked: ClassVar[tuple[str, ...]]
    flows: ClassVar[tuple[str, ...]]
    cruise: Any
    equations: ClassVar[Any]
    """The equations of motion, `vessel_gym.vehicles.integration.Rates`; who overrides `moved` needs none."""
    carried: ClassVar[np.ndarray | None] = None
    kinds: ClassVar[tuple[str, ...]] = ("nonlinear",)
    linear_kinds: ClassVar[tuple[str, ...]] = ()

    def estimated(self, kind: str) -> tuple[str, ...]:
        """All of the state."""
        return self.state_names

    @property
    def process_sd(self) -> np.ndarray:
        """The models leave out nothing."""
        return np.zeros(len(self.state_names))

    def known_input(self, before: np.ndarray, after: np.ndarray, commanded: np.ndarray | None) -> np.ndarray:
        """The actuators at the start of a step and at its end."""
        return np.concatenate([before, after], -1)

    def linear(self, kind: str) -> tuple[Any, ...]:
        """There is none."""
        raise NotImplementedError

    @cached_property
    def kicks(self) -> tuple[str, ...]:
        """One for each component that is kicked, in its unit."""
        return tuple(f"kick {name}" for name in self.kicked)

    @cached_property
    def faults(self) -> tuple[str, ...]:
        """What may be added to its actuators over a step, in their units."""
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

    def moved(
        self, state: np.ndarray, before: np.ndarray, after: np.ndarray, flow: np.ndarray, parameters: np.ndarray
    ) -> np.ndarray:
        """The state one step later, without kicks."""
        return runge_kutta(self.equations, state, before, after, flow, parameters, self.dt, self.substeps)

    def step(
        self, state: np.ndarray, before: np.ndarray, after: np.ndarray, forcing: np.ndarray, parameters: np.ndarray
    ) -> np.ndarray:
        """The state one step later, with actuators moving from ``before`` to ``after``."""
        kicks = len(self.kicked)
        moved = self.moved(state, before, after, forcing[..., kicks:], parameters)
        return kicked(moved, forcing[..., :kicks], [self.state_names.index(name) for name in self.kicked])

    def drift(self, x: np.ndarray, u: np.ndarray, flow: np.ndarray) -> np.ndarray:
        """A step without kicks, as filters know it."""
        a = len(self.action_names)
        return self.moved(x, u[..., :a], u[..., a : 2 * a], flow, self._nominal)

    @cached_property
    def _nominal(self) -> np.ndarray:
        """The coefficients that filters know ``(k,)``."""
        return self.body.vector()
