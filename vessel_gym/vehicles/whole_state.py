"""What vehicles share whose filters estimate all of their state, with their own equations of motion as the model."""

from collections.abc import Callable
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from vessel_gym.vehicles.integration import Kernel


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
    kernel: ClassVar[Kernel]
    """A step of the equations of motion."""
    forced: ClassVar[Callable[..., None]]
    """One of rows that are kicked at its end, see `vessel_gym.vehicles.integration.Kernels`."""
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
        shape = np.broadcast_shapes(u.shape[:-1], offsets.shape[:-1])
        known = np.array(np.broadcast_to(u, shape + u.shape[-1:]))
        added = offsets - losses * u[..., :a]
        known[..., :a] += added
        known[..., a : 2 * a] += added
        return known

    def parameters(self, mismatch: float, normals: np.ndarray) -> np.ndarray:
        """Coefficients ``(B, k)`` of the truth: the filter's, with a relative spread on the uncertain ones."""
        return self.body.vector(1.0 + mismatch * np.clip(normals, -2.0, 2.0))

    def start(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """State ``(B, n)`` and actuators ``(B, a)`` to begin with."""
        return np.array(x, float), self.cruise[1][None, : len(self.action_names)].repeat(len(x), 0)

    def advance(
        self, state: np.ndarray, control: np.ndarray, flow: np.ndarray, c: np.ndarray, out: np.ndarray | None = None
    ) -> np.ndarray:
        """The state after a step that nothing kicks; control is actuators before and after."""
        return self.kernel(state, control, flow, c, self.dt, self.substeps, out)

    def step(
        self, state: np.ndarray, before: np.ndarray, after: np.ndarray, forcing: np.ndarray, parameters: np.ndarray
    ) -> np.ndarray:
        """The state one step later, with actuators moving from ``before`` to ``after``."""
        moved = np.empty(state.shape)
        self.forced(state, before, after, forcing, parameters, self.dt, self.substeps, self._kicked, moved)
        return moved

    def drift(self, x: np.ndarray, u: np.ndarray, flow: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """A step that nothing kicks, as filters know it."""
        return self.advance(x, u, flow, self._nominal, out)

    @cached_property
    def _kicked(self) -> np.ndarray:
        """Which components are kicked."""
        return np.array([self.state_names.index(name) for name in self.kicked])

    @cached_property
    def _nominal(self) -> np.ndarray:
        """The coefficients that filters know ``(1, k)``: the one row of all states."""
        return self.body.vector()[None]
