"""The interface between vehicle and environment: motion, exogenous input, and models of filters."""

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np

from vessel_gym.sensors import Sensor

GRAVITY = 9.81  # m/s2


class Trims(NamedTuple):
    """Steady motions about which a nonlinear model is linearised; the known input selects one.

    At a known input u the model is linearised about motion number ``u[component] scale + middle``,
    rounded down and limited to 0 to k - 1 (`estimators.Schedule`). The last component of u must be
    1, because its column of B holds the constant part of the model.
    """

    x: np.ndarray
    """Estimated components of the vehicle's state in each motion ``(k, n)``."""
    u: np.ndarray
    """Known input in each motion ``(k, m)``."""
    component: int
    """Index of the component of the known input that selects the motion."""
    scale: float
    """Number of motions by which the selection moves when this component rises by 1."""
    middle: float
    """Index of the motion at which this component is 0, plus one half."""


class Vehicle(Protocol):
    """Interface of a vehicle in batches ``(B, ...)``: state, actuators, motion, filters' models.

    The exogenous input ``(B, f)`` acts on the vehicle. Its first components are increments, which
    change the state at the end of a step. Then come flows, which are constant over the step. The
    equations may be compiled or plain NumPy; they must broadcast over leading axes.

    Four further attributes are optional:

    - ``faults``, the names of what may be added to actuators over a step, together with ``faulty``,
      a method that returns the known input with these faults (see
      `vessel_gym.vehicles.whole_state.WholeState`);
    - ``noise``, schedules of Q and R by name, which filters assume instead of ``process_sd`` and
      the sensors' noise;
    - ``steering``, the indices of actuators that are angles [rad] of rudders, fins or wings, whose
      travel, reversals and saturation `agents.metrics` measures;
    - ``grades``, a file of grades of the sensors, see `vessel_gym.sensors.grades`.
    """

    @property
    def dt(self) -> float:
        """Time step [s]."""

    @property
    def state_names(self) -> tuple[str, ...]:
        """Components of the vehicle's own state, without disturbances."""

    @property
    def angles(self) -> tuple[str, ...]:
        """Components of the state that are angles [rad]."""

    @property
    def action_names(self) -> tuple[str, ...]:
        """Components of the action."""

    @property
    def increments(self) -> tuple[str, ...]:
        """First components of the exogenous input, added to the state at the end of a step."""

    @property
    def incremented(self) -> tuple[str, ...]:
        """Component of the state that each increment changes."""

    @property
    def ambient_flows(self) -> tuple[str, ...]:
        """Further components of the exogenous input, flows that carry the vehicle over a step."""

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """Sensors in nominal quality, in the order of the measurements."""

    @property
    def normals(self) -> int:
        """Number of standard normal numbers that `parameters` needs."""

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Components of the parameters."""

    def parameters(self, mismatch: float, normals: np.ndarray) -> np.ndarray:
        """True parameters ``(B, k)``: the filter's, spread by ``mismatch``.

        The random numbers are ``normals (B, normals)``.
        """

    def start(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """State ``(B, n)`` and actuators ``(B, a)``, from states x that the prior describes."""

    def actuate(self, actuators: np.ndarray, action: np.ndarray) -> np.ndarray:
        """Actuators ``(B, a)`` one step after an action in [-1, 1], within limits and rates."""

    def step(
        self,
        state: np.ndarray,
        before: np.ndarray,
        after: np.ndarray,
        exogenous: np.ndarray,
        parameters: np.ndarray,
    ) -> np.ndarray:
        """State ``(B, n)`` one step later.

        Args:
            state: ``(B, n)``.
            before: Actuators ``(B, a)`` at the beginning of the step.
            after: Actuators ``(B, a)`` at the end of the step.
            exogenous: Increments and flows ``(B, f)``.
            parameters: ``(B, k)`` as `parameters` returns them.
        """

    @property
    def kinds(self) -> tuple[str, ...]:
        """Names of the models for filters; the nonlinear one with the most states comes first."""

    @property
    def linear_kinds(self) -> tuple[str, ...]:
        """Names of the linear ones among the models."""

    def estimated(self, kind: str) -> tuple[str, ...]:
        """Components of the state that filters with a model estimate, in their order.

        The task's prior describes the components of the first model in ``kinds``. Another model may
        have fewer, which must be the leading ones of these.
        """

    @property
    def cruise(self) -> tuple[np.ndarray, np.ndarray]:
        """Estimated components ``(n,)`` and known input ``(m,)`` of the cruising vehicle."""

    @property
    def process_sd(self) -> np.ndarray:
        """Standard deviations ``(n,)`` of the model error of a step in estimated components."""

    def drift(self, x: np.ndarray, u: np.ndarray, flow: np.ndarray) -> np.ndarray:
        """Estimated components ``(..., n)`` one step later, with the filter's parameters.

        Args:
            x: Estimated components ``(..., n)``.
            u: Known input ``(..., m)``.
            flow: Flows ``(..., ambient_flows)`` over the step.
        """

    def known_input(
        self, before: np.ndarray, after: np.ndarray, commanded: np.ndarray | None
    ) -> np.ndarray:
        """Known input of filters over a step ``(B, m)``: actuators, and commands of the task."""

    def linear(self, kind: str) -> tuple[Any, ...] | Trims:
        """A and B of a linear model, each a matrix or a function of the known input.

        If flows move the estimated components, a third entry holds the effect of each flow over a
        step ``(n, ambient_flows)``, again a matrix or a function. For a linearised nonlinear model,
        return `Trims`.
        """

    @property
    def rates(self) -> Mapping[str, str]:
        """State of which each rate is the derivative, such as ``{"r": "psi"}``.

        If no sensor measures a rate, ``estimator="measurement"`` computes it from two measurements
        of this state.
        """

    @property
    def carried(self) -> np.ndarray | None:
        """Effect ``(n, flows)`` of initial flows on the prior; None if speeds are flow-relative."""
