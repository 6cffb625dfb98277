"""Regulators: loops of proportional, integral and derivative action, and linear-quadratic gains."""

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.linalg import solve_discrete_are

from vessel_gym.system import System

Control = tuple[np.ndarray, np.ndarray]
"""Actions ``(..., a)`` and the next state ``(..., m)`` of a controller."""


class Controller:
    """A controller of a kind of task, which it is designed for.

    Its law, `control`, is a pure function. One in NumPy serves; the package's are compiled.

    Args:
        system: The environment's system.

    Raises:
        ValueError: if the system's task or vehicle is of another kind.
    """

    kind: type
    vehicle: type = object
    state_size = 0
    """Length m of the state of `control`."""

    def __init__(self, system: System) -> None:
        if not isinstance(system.task, self.kind) or not isinstance(system.vehicle, self.vehicle):
            raise ValueError(
                f"this controller is for a {self.kind.__name__}, not for a"
                f" {type(system.task).__name__} of {type(system.vehicle).__name__}"
            )
        self._task: Any = system.task
        self._vehicle: Any = system.vehicle
        self._design()
        self.reset(1)

    def _design(self) -> None:
        """Compute gains and tables."""

    def reset(self, num_envs: int) -> None:
        """Set the state to zero."""
        self._state = np.zeros((num_envs, self.state_size))

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Actions ``(B, a)`` in [-1, 1] for observations ``(B, k)``."""
        actions, self._state = self.control(observations.astype(float), self._state)
        return actions.clip(-1.0, 1.0).astype(np.float32)

    def control(self, observation: np.ndarray, state: np.ndarray) -> Control:
        """Actions ``(..., a)`` without their limits, and the next state ``(..., m)``.

        Args:
            observation: ``(..., k)``.
            state: ``(..., m)``, such as an integral; zeros at an episode's start.
        """
        raise NotImplementedError


class Loop:
    """A PID loop about the plant ``x'' + damping x' = response u``.

    No gain is chosen by hand. The proportional one asks for the tolerated actuation at the
    tolerated error (Bryson's ratio); with it the plant has the natural frequency w, and the
    derivative one damps it critically; the integral one is w / 10 of the proportional one (Fossen
    2011, sec. 12.2, pole placement).

    Args:
        response: Of the second derivative to the actuation.
        damping: Of the plant [1/s].
        error: What is tolerated of the error.
        actuation: And of the actuator.
        dt: Time step [s].
    """

    def __init__(
        self, response: float, damping: float, error: float, actuation: float, dt: float
    ) -> None:
        self.proportional = actuation / error
        self.frequency = np.sqrt(response * self.proportional)
        self.derivative = max(2.0 * self.frequency - damping, 0.0) / response
        self.integral = 0.1 * self.frequency * self.proportional
        self._dt = dt

    def act(
        self, error: np.ndarray, rate: np.ndarray, integral: np.ndarray, limit: float,
        ahead: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """The actuation within its limits, and the next integral, ``(...)`` each.

        The integral waits where the actuator is at a limit, so that it cannot wind up.

        Args:
            error: What is wanted less what is, ``(...)``.
            rate: Of the error ``(...)``.
            integral: Of the error ``(...)``.
            limit: Largest actuation, to either side.
            ahead: Actuation that is known to be needed, ``(...)``.
        """
        wanted = (
            ahead + self.proportional * error + self.integral * integral + self.derivative * rate
        )
        integral = integral + self._dt * error * (np.abs(wanted) < limit)
        return np.clip(wanted, -limit, limit), integral


def jacobian(function: Callable[[np.ndarray], np.ndarray], x: np.ndarray) -> np.ndarray:
    """Derivatives ``(m, n)`` of a function of vectors ``(n,)``, by central differences."""
    step = 1e-5
    columns = [function(x + e) - function(x - e) for e in step * np.eye(len(x))]
    return np.stack(columns, -1) / (2.0 * step)


def first_order(A: np.ndarray, B: np.ndarray, rate: int, dt: float) -> tuple[float, float]:
    """The plant ``r' + damping r = response u`` nearest to ``x+ = A x + B u``: (response, damping).

    Its transfer function has the value and the slope at frequency 0 of that to the component
    ``rate`` of x: Nomoto's reduction to first order. The step response of a stable plant ends as
    high, and lies as far below its end, in all.

    Args:
        A: ``(n, n)``, without an eigenvalue of 1.
        B: ``(n,)``.
        rate: Which component.
        dt: Time step [s].
    """
    end = np.linalg.solve(np.eye(len(A)) - A, B)
    # trapezoidal rule
    lag = dt * (np.linalg.solve(np.eye(len(A)) - A, end)[rate] / end[rate] - 0.5)
    return float(end[rate] / lag), float(1.0 / lag)


def bryson(*tolerances: float) -> np.ndarray:
    """The diagonal cost that counts tolerated deviations alike; an infinite one does not count."""
    return np.diag(np.array(tolerances) ** -2)


def regulator_gains(A: np.ndarray, B: np.ndarray, Q: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Gains K ``(m, n)`` of ``u = -K x`` for ``x+ = A x + B u``.

    They minimise the sum of ``x' Q x + u' R u``.

    Args:
        A: ``(n, n)``.
        B: ``(n, m)``.
        Q: ``(n, n)`` cost of deviations.
        R: ``(m, m)`` cost of the input.
    """
    P = solve_discrete_are(A, B, Q, R)
    return np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
