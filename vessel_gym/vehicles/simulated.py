"""Vehicles with parameters from a file: their actuators, and their numerical integration."""

from dataclasses import fields
from typing import Any, ClassVar, NamedTuple

import numpy as np

from estimators.checks import integer
from vessel_gym.checks import check_numbers, instance
from vessel_gym.vehicles.integration import runge_kutta
from vessel_gym.vehicles.vehicle import Vehicle


class Actuator(NamedTuple):
    """Response of an actuator to an action in [-1, 1] over a step.

    The command is ``kept * before + base + gain (offset + action)``. A lag leaves the share ``lag``
    of the difference between actuator and command. A step changes the actuator by at most ``turn``,
    and its limits are +-``limit``.
    """

    above: float
    """Gain of actions from 0 on."""
    below: float
    """Gain of negative actions."""
    offset: float = 0.0
    base: float = 0.0
    kept: float = 0.0
    lag: float = 0.0
    turn: float = np.inf
    limit: float = np.inf


def actuated(before: np.ndarray, action: np.ndarray, parameters: np.ndarray) -> np.ndarray:
    """Actuators ``(..., a)`` after a step from ``before``, with parameters ``(a, 8)``.

    A row of the parameters is an `Actuator`.
    """
    above, below, offset, base, kept, lag, turn, limit = parameters.T
    asked = kept * before + base + np.where(action < 0.0, below, above) * (offset + action)
    asked = np.where(lag > 0.0, asked + (before - asked) * lag, asked)
    turned = np.clip(asked, before - turn, before + turn)
    return np.clip(turned, -limit, limit)


class SimulatedVehicle(Vehicle):
    """Base class of vehicles that integrate equations of motion by the Runge-Kutta method.

    The first field of a subclass is the parameters from a file. Further fields are ``dt`` and,
    unless derived from the parameters, ``substeps``.

    Raises:
        TypeError: for parameters of another class.
        ValueError: for a step that is not positive, or fewer than one substep.
    """

    body: Any
    """Particulars; ``body.vector(factors)`` returns the coefficients of the equations of motion."""
    substeps: Any
    """Number of equal parts of a step, each of which is one Runge-Kutta step."""
    equations: ClassVar[Any]
    """Equations of motion, a `vessel_gym.vehicles.integration.Rates`."""
    printed_equations: ClassVar[Any]
    """Equations of motion with the misprints of the source paper, used if ``as_printed``."""
    as_printed: Any = False
    _actuators: Any
    """Parameters ``(a, 8)``; each row is an `Actuator`."""
    __dataclass_fields__: ClassVar[dict[str, Any]]

    def __post_init__(self) -> None:
        title, first = type(self).__name__, fields(self)[0]
        kind: Any = first.type
        instance(f"{first.name} of {title}", getattr(self, first.name), kind)
        check_numbers(self, positive="dt")
        if "substeps" in self.__dataclass_fields__:
            integer(f"substeps of {title}", self.substeps, 1)

    def parameters(self, mismatch: float, normals: np.ndarray) -> np.ndarray:
        """True coefficients ``(B, k)``; mismatch is their relative standard deviation."""
        return self.body.vector(1.0 + mismatch * np.clip(normals, -2.0, 2.0))

    def actuate(self, actuators: np.ndarray, action: np.ndarray) -> np.ndarray:
        """Actuators ``(..., a)`` after a step of ``action`` in [-1, 1], within limits and rates."""
        return actuated(actuators, action, self._actuators)

    def moved(
        self, state: np.ndarray, before: np.ndarray, after: np.ndarray, flow: np.ndarray,
        parameters: np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        """State ``(..., n)`` one step later, without increments."""
        rates = self.printed_equations if self.as_printed else self.equations
        given = state, before, after - before, flow, parameters
        return runge_kutta(rates, *given, self.dt, self.substeps)
