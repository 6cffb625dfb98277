"""Base class of vehicles: motion, exogenous input, and models of filters; docs/own-equations.md."""

from collections.abc import Mapping
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np

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


class Vehicle:
    """Base class of vehicles in batches ``(B, ...)``: state, actuators, motion, filters' models.

    A subclass must define the attributes without a value, `parameters`, `actuate` and `moved`. By
    default filters estimate the whole state with one nonlinear model, which leaves out nothing.

    The exogenous input ``(B, f)`` acts on the vehicle. Its first components are increments, which
    change the state at the end of a step. Then come flows, which are constant over the step. The
    equations may be compiled or plain NumPy; they must broadcast over leading axes.
    """

    dt: float
    """Time step [s]."""
    state_names: tuple[str, ...]
    """Components of the vehicle's own state, without disturbances."""
    angles: tuple[str, ...]
    """Components of the state that are angles [rad]."""
    action_names: tuple[str, ...]
    """Components of the action."""
    incremented: ClassVar[tuple[str, ...]]
    """Component of the state that each increment changes."""
    ambient_flows: ClassVar[tuple[str, ...]]
    """Flows in the exogenous input, which carry the vehicle over a step."""
    sensors: Any
    """Sensors in nominal quality, a tuple of `Sensor` in the order of the measurements."""
    normals: int
    """Number of standard normal numbers that `parameters` needs."""
    parameter_names: tuple[str, ...]
    """Components of the parameters."""
    cruise: Any
    """Estimated components ``(n,)`` and known input ``(m,)`` of the vehicle cruising northward."""
    rates: Mapping[str, str]
    """State of which each rate is the derivative, such as ``{"r": "psi"}``.

    If no sensor measures a rate, ``estimator="measurement"`` computes it from two measurements of
    this state.
    """
    kinds: ClassVar[tuple[str, ...]] = ("nonlinear",)
    """Names of the models for filters; the nonlinear one with the most states comes first."""
    linear_kinds: ClassVar[tuple[str, ...]] = ()
    """Names of the linear ones among the models."""
    carried: np.ndarray | None = None
    """Effect ``(n, flows)`` of initial flows on the prior; None if speeds are flow-relative."""
    steering: Any = ()
    """Indices of actuators that are angles [rad] of rudders, fins or wings, a tuple.

    Their travel, reversals and saturation are measured by `agents.metrics`.
    """
    grades: str | None = None
    """File of grades of the sensors, see `vessel_gym.sensors.grades`; None without grades."""
    noise: Any = {}
    """Schedules of Q and R by name, instead of ``process_sd`` and the sensors' noise."""

    @cached_property
    def increments(self) -> tuple[str, ...]:
        """Names of the increments, the first components of the exogenous input."""
        return tuple(f"{name} increment" for name in self.incremented)

    @cached_property
    def faults(self) -> tuple[str, ...]:
        """Names of the faults of actuators, which are additions in the actuators' units."""
        return tuple(f"{name} fault" for name in self.action_names)

    def faulty(self, u: np.ndarray, faults: np.ndarray) -> np.ndarray:
        """Known input with additions ``faults (..., a)`` to actuators."""
        none = np.zeros((*faults.shape[:-1], u.shape[-1] - 2 * len(self.action_names)))
        return u + np.concatenate([faults, faults, none], -1)

    def parameters(self, mismatch: float, normals: np.ndarray) -> np.ndarray:
        """True parameters ``(B, k)``: the filter's, spread by ``mismatch``.

        The random numbers are ``normals (B, normals)``.
        """
        raise NotImplementedError

    @cached_property
    def nominal_parameters(self) -> np.ndarray:
        """Parameters ``(k,)`` of filters' models."""
        return self.parameters(0.0, np.zeros((1, self.normals)))[0]

    def start(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """State ``(B, n)`` and actuators ``(B, a)``, from states x that the prior describes.

        Default: the state x, and the actuators of the cruising vehicle.
        """
        return x.copy(), self.cruise[1][: len(self.action_names)] + np.zeros((*x.shape[:-1], 1))

    def actuate(self, actuators: np.ndarray, action: np.ndarray) -> np.ndarray:
        """Actuators ``(B, a)`` one step after an action in [-1, 1], within limits and rates."""
        raise NotImplementedError

    def moved(
        self, state: np.ndarray, before: np.ndarray, after: np.ndarray, flow: np.ndarray,
        parameters: np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        """State ``(B, n)`` one step later, without increments.

        Args:
            state: ``(B, n)``.
            before: Actuators ``(B, a)`` at the beginning of the step.
            after: Actuators ``(B, a)`` at the end of the step.
            flow: Flows ``(B, ambient_flows)`` over the step.
            parameters: ``(B, k)`` as `parameters` returns them.
        """
        raise NotImplementedError

    def step(
        self, state: np.ndarray, before: np.ndarray, after: np.ndarray, exogenous: np.ndarray,
        parameters: np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        """State ``(B, n)`` one step later, with increments.

        Args:
            state: ``(B, n)``.
            before: Actuators ``(B, a)`` at the beginning of the step.
            after: Actuators ``(B, a)`` at the end of the step.
            exogenous: Increments and flows ``(B, f)``.
            parameters: ``(B, k)`` as `parameters` returns them.
        """
        flow = exogenous[..., len(self.incremented) :]
        columns = list(np.moveaxis(self.moved(state, before, after, flow, parameters), -1, 0))
        for i, name in enumerate(self.incremented):
            component = self.state_names.index(name)
            columns[component] = columns[component] + exogenous[..., i]
        return np.stack(columns, -1)

    def estimated(self, kind: str) -> tuple[str, ...]:
        """Components of the state that filters with a model estimate, in their order.

        The task's prior describes the components of the first model in ``kinds``. Another model may
        have fewer, which must be the leading ones of these. Default: all components.
        """
        return self.state_names

    @property
    def process_sd(self) -> np.ndarray:
        """Standard deviations ``(n,)`` of the model error of a step in estimated components.

        Default: zeros.
        """
        return np.zeros(len(self.state_names))

    def drift(self, x: np.ndarray, u: np.ndarray, flow: np.ndarray) -> np.ndarray:
        """Estimated components ``(..., n)`` one step later, with the filter's parameters.

        Args:
            x: Estimated components ``(..., n)``.
            u: Known input ``(..., m)``.
            flow: Flows ``(..., ambient_flows)`` over the step.
        """
        a = len(self.action_names)
        return self.moved(x, u[..., :a], u[..., a : 2 * a], flow, self.nominal_parameters)

    def known_input(
        self, before: np.ndarray, after: np.ndarray, commanded: np.ndarray | None
    ) -> np.ndarray:
        """Known input of filters over a step ``(B, m)``: actuators, and commands of the task.

        Default: actuators at the start of the step, then at its end.
        """
        return np.concatenate([before, after], -1)

    def linear(self, kind: str) -> tuple[Any, ...] | Trims:
        """A and B of a linear model, and the effect ``(n, ambient_flows)`` of flows over a step.

        Each is a matrix or a function of the known input. For a linearised nonlinear model, return
        `Trims`.
        """
        raise NotImplementedError
