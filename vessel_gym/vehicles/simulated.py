"""Vehicles that are simulated: actuators, integration of equations of motion, steady motions."""

import math
from collections.abc import Callable
from dataclasses import fields
from typing import Any, ClassVar, NamedTuple

import numpy as np

from estimators.checks import integer
from estimators.differences import central_differences, steps
from estimators.engine import Compiled, compiled
from vessel_gym.checks import check_numbers, instance
from vessel_gym.vehicles.vehicle import Vehicle

Rates = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Equations of motion: rates ``(..., n)`` of a state ``(..., n)``.

Arguments are the state, actuators ``(..., a)``, a flow ``(..., f)`` and coefficients ``(..., k)``.
"""


def runge_kutta(
    rates: Rates, state: np.ndarray, before: np.ndarray, change: np.ndarray, flow: np.ndarray,
    c: np.ndarray, dt: float, substeps: int = 1,
) -> np.ndarray:  # fmt: skip
    """State ``(..., n)`` a step later.

    Over the step the flow is constant. Actuators move linearly, so that their rate limits are
    integrated exactly.

    Args:
        rates: Equations of motion, `estimators.engine.compiled` or plain NumPy.
        state: ``(..., n)``.
        before: Actuators ``(..., a)`` at the beginning of the step.
        change: Change of the actuators ``(..., a)`` over the step.
        flow: ``(..., f)``.
        c: Coefficients ``(..., k)``.
        dt: Length of the step [s].
        substeps: Number of equal parts of the step.
    """
    part = _part if isinstance(rates, Compiled) else _part.function
    h, shares = np.array(dt / substeps), np.array([0.0, 0.5, 1.0])
    for i in range(substeps):
        state = part(state, before, change, flow, c, h, (i + shares) / substeps, rates=rates)
    return state


def resolving_substeps(dt: float, fastest: float) -> int:
    """Smallest number of equal substeps in which `runge_kutta` resolves the modes of linear motion.

    A mode with eigenvalue ``lambda`` is resolved in substeps h with ``|lambda| h <= 1/2``. The
    eigenvalue of the numerical solution is then within 0.08 % of ``|lambda|``. An oscillation is
    ``(|lambda| h)^4 / 120`` too slow, at most 0.05 %, and its damping ratio is ``(|lambda| h)^5 /
    144`` too large, at most 0.0002. Beyond ``2 sqrt(2)`` an undamped oscillation would grow.

    Args:
        dt: Length of the step [s].
        fastest: Largest modulus of the eigenvalues [1/s].
    """
    return max(1, math.ceil(2.0 * dt * fastest - 1e-9))


@compiled(axes=(1, 1, 1, 1, 1, 0, 1))
def _part(
    state: np.ndarray, before: np.ndarray, change: np.ndarray, flow: np.ndarray, c: np.ndarray,
    h: np.ndarray, shares: np.ndarray, *, rates: Rates,
) -> np.ndarray:  # fmt: skip
    """One substep of length ``h ()``.

    ``shares (3,)`` of the actuators' change have passed at its start, middle and end.
    """
    start, middle, end = (before + share * change for share in shares)
    k1 = rates(state, start, flow, c)
    k2 = rates(state + 0.5 * h * k1, middle, flow, c)
    k3 = rates(state + 0.5 * h * k2, middle, flow, c)
    k4 = rates(state + h * k3, end, flow, c)
    return state + h / 6.0 * k1 + h / 3.0 * k2 + h / 3.0 * k3 + h / 6.0 * k4


def root(
    residual: Callable[..., np.ndarray], guess: np.ndarray, held: np.ndarray | None = None
) -> np.ndarray:
    """Roots ``(..., n)`` of a function by Newton's method; NaN where it does not converge.

    Args:
        residual: Function of vectors ``(..., n)``, and of ``held``, with values ``(..., n)``.
        guess: Start ``(..., n)``.
        held: Vectors ``(..., m)`` that are not changed.
    """
    x, n = guess, guess.shape[-1]
    for _ in range(30):
        step = steps(x, None)
        values, jacobian = central_differences("residual", residual, x, held, n, (), step)
        change = np.linalg.solve(jacobian, values[..., None])[..., 0]
        x = x - change
        converged = (np.abs(change) <= 1e-12 * (1.0 + np.abs(x))).all(-1, keepdims=True)
        if converged.all():
            return x
    return np.where(converged, x, np.nan)


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
    """Equations of motion, a `vessel_gym.vehicles.simulated.Rates`."""
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
        above, below, offset, base, kept, lag, turn, limit = self._actuators.T
        gain = np.where(action < 0.0, below, above)
        asked = kept * actuators + base + gain * (offset + action)
        asked = np.where(lag > 0.0, asked + (actuators - asked) * lag, asked)
        turned = np.clip(asked, actuators - turn, actuators + turn)
        return np.clip(turned, -limit, limit)

    def moved(
        self, state: np.ndarray, before: np.ndarray, after: np.ndarray, flow: np.ndarray,
        parameters: np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        """State ``(..., n)`` one step later, without increments."""
        rates = self.printed_equations if self.as_printed else self.equations
        given = state, before, after - before, flow, parameters
        return runge_kutta(rates, *given, self.dt, self.substeps)
