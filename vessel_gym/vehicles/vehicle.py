"""The interface of a vehicle to an environment: its motion, what acts on it, and the models of filters."""

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np

from vessel_gym.sensors import Sensor


class Trims(NamedTuple):
    """Steady motions about which a nonlinear model is linearised: the nearest one holds, by the known input.

    The known input's last component must be 1: what no matrix gives stands in its column of B.
    """

    x: np.ndarray  # (k, n) what filters estimate of the vehicle,
    u: np.ndarray  # (k, m) and the known input
    component: int  # of the known input that tells one from another,
    scale: float  # how many there are to a unit of it,
    middle: float  # and which is that of 0, and half of one more: see `estimators.Schedule`


class Vehicle(Protocol):
    """A vehicle in batches ``(B, ...)``: its own state and actuators, how they move, and what filters know of that.

    What acts on it is an exogenous input ``(B, f)``: increments, which change its state at the end
    of a step, then flows, which are held over it. The equations may be compiled or plain NumPy:
    anything that broadcasts over leading axes.

    A vehicle may have ``faults``, too, as `vessel_gym.vehicles.whole_state.WholeState` has: the
    names of what may be added to its actuators over a step, and ``faulty``, the known input with
    that; without them it has none. And ``noise``: schedules of Q and R by name, which its filters
    assume instead of ``process_sd`` and the sensors' noise. And ``steering``: the indices of its
    actuators that are angles [rad] of rudders, fins or wings, whose travel, reversals and
    saturation `agents.metrics` measures. And ``grades``: a file of grades of its sensors, see
    `vessel_gym.sensors.grades`.
    """

    @property
    def dt(self) -> float:
        """Time step [s]."""

    @property
    def state_names(self) -> tuple[str, ...]:
        """Components of its state: of itself alone, not of what carries or shakes it."""

    @property
    def angles(self) -> tuple[str, ...]:
        """Components of the state that are angles [rad]."""

    @property
    def action_names(self) -> tuple[str, ...]:
        """Components of the action."""

    @property
    def increments(self) -> tuple[str, ...]:
        """The first parts of its exogenous input: what is added to its state at the end of a step."""

    @property
    def incremented(self) -> tuple[str, ...]:
        """And to which component each."""

    @property
    def ambient_flows(self) -> tuple[str, ...]:
        """The other parts of its exogenous input: what carries it over a step."""

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """Its sensors, in their nominal quality, in the order of the measurements."""

    @property
    def normals(self) -> int:
        """Number of normal numbers that `parameters` needs."""

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Components of the parameters."""

    def parameters(self, mismatch: float, normals: np.ndarray) -> np.ndarray:
        """The truth's parameters ``(B, k)``, spread around the filter's."""

    def start(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """State ``(B, n)`` and actuators ``(B, a)`` from what the task's prior describes, see `estimated`."""

    def actuate(self, actuators: np.ndarray, action: np.ndarray) -> np.ndarray:
        """Actuators one step later, within limits and rates."""

    def step(
        self,
        state: np.ndarray,
        before: np.ndarray,
        after: np.ndarray,
        exogenous: np.ndarray,
        parameters: np.ndarray,
    ) -> np.ndarray:
        """The state one step later, with actuators moving from ``before`` to ``after``."""

    @property
    def kinds(self) -> tuple[str, ...]:
        """The models that filters may have of it, the widest of nonlinear ones first."""

    @property
    def linear_kinds(self) -> tuple[str, ...]:
        """And which of them are linear."""

    def estimated(self, kind: str) -> tuple[str, ...]:
        """The components of its state that filters with a model estimate, in their order.

        Those of the first of ``kinds`` are what a task's prior describes; those of others are its
        first ones.
        """

    @property
    def cruise(self) -> tuple[np.ndarray, np.ndarray]:
        """Estimated components and known input of a vehicle that cruises, where models are inspected."""

    @property
    def process_sd(self) -> np.ndarray:
        """Standard deviations of what the models leave out in a step, of what filters estimate."""

    def drift(self, x: np.ndarray, u: np.ndarray, flow: np.ndarray) -> np.ndarray:
        """Estimated components ``(..., n)`` a step later, under known input and flow, with the filters' parameters."""

    def known_input(
        self, before: np.ndarray, after: np.ndarray, commanded: np.ndarray | None
    ) -> np.ndarray:
        """Known input of its filters over a step ``(B, m)``: actuators, and commands of a task."""

    def linear(self, kind: str) -> tuple[Any, ...] | Trims:
        """A and B of a linear model, each a matrix or a function of the known input.

        Where flows move what the model estimates, the effect of each over a step ``(n,
        ambient_flows)`` comes third, a matrix or a function, too. Or the `Trims` about which the
        nonlinear model is linearised.
        """

    @property
    def rates(self) -> Mapping[str, str]:
        """Components of the state by those of which they are rates, for what no sensor reads."""

    @property
    def carried(self) -> np.ndarray | None:
        """Effect of ambient flows at the start on the prior ``(n, flows)``, if velocities are over ground."""
