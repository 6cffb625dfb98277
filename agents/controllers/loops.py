"""Controllers with a compiled law; gains of PID loops and linear-quadratic regulators."""

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np

from estimators import Linear
from estimators.discretisation import riccati_composition
from vessel_gym.system import System

Control = tuple[np.ndarray, np.ndarray]
"""Actions ``(..., a)`` and the next state ``(..., m)`` of a controller."""


class Controller:
    """A controller of a kind of task; subclasses take its parameters as keywords.

    Its law is a pure function, which is compiled once for a task and a vehicle. All that depends on
    parameters is in ``numbers``, so that new parameters compile nothing.

    Args:
        system: The environment's system.

    Attributes:
        numbers: Gains and others that follow from parameters, ``(n,)``, which subclasses set.

    Raises:
        ValueError: if the system's task or vehicle is of another kind.
    """

    kind: type
    vehicle: type = object
    state_size = 0
    """Length m of the state of `control`."""
    tunable: ClassVar[Mapping[str, Linear]] = {}
    """Ranges of the parameters, by name."""
    numbers: np.ndarray
    control: Callable[..., Control]
    """The law: actions ``(..., a)`` in [-1, 1], and the next state ``(..., m)``.

    Its arguments are the observation ``(..., k)``, the state, which is zero at an episode's start,
    the numbers ``(n,)``, and as keywords the system's task and vehicle.
    """

    def __init__(self, system: System) -> None:
        if not isinstance(system.task, self.kind) or not isinstance(system.vehicle, self.vehicle):
            raise ValueError(
                f"this controller is for a {self.kind.__name__}, not for a"
                f" {type(system.task).__name__} of {type(system.vehicle).__name__}"
            )
        self._task: Any = system.task
        self._vehicle: Any = system.vehicle
        self.reset(1)

    def reset(self, num_envs: int) -> None:
        """Set the state to zero."""
        self._state = np.zeros((num_envs, self.state_size))

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Actions ``(B, a)`` in [-1, 1] for observations ``(B, k)``."""
        actions, self._state = self.control(
            observations.astype(float), self._state, self.numbers,
            task=self._task, vehicle=self._vehicle,
        )  # fmt: skip
        return actions.astype(np.float32)


def pid_gains(
    response: float, damping: float, proportional: float, integral: float, damped: float
) -> tuple[float, float, float, float]:
    """Gains of a PID loop about the plant ``x'' + damping x' = response u``.

    With the proportional gain the plant has the natural frequency w. The derivative gain gives it
    the wanted damping, and the integral one is a share of the proportional one times w (Fossen
    2011, sec. 12.2, pole placement).

    Args:
        response: Of the second derivative to the actuation.
        damping: Of the plant [1/s].
        proportional: Proportional gain.
        integral: Integral gain, as a share of w times the proportional gain.
        damped: Damping ratio of the loop; 1 is critical.

    Returns:
        Proportional, integral and derivative gain, and w [rad/s].
    """
    frequency = float(np.sqrt(response * proportional))
    derivative = max(2.0 * damped * frequency - damping, 0.0) / response
    return proportional, integral * frequency * proportional, derivative, frequency


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
    """Gains K ``(..., m, n)`` of ``u = -K x`` for ``x+ = A x + B u``.

    They minimise the sum of ``x' Q x + u' R u``. Riccati's equation is solved by doubling: each
    round doubles the number of steps to go, of which P is the cost and F the transition of the
    regulated system.

    Args:
        A: ``(..., n, n)``.
        B: ``(..., n, m)``.
        Q: ``(n, n)`` cost of deviations.
        R: ``(m, m)`` cost of the input.

    Raises:
        numpy.linalg.LinAlgError: if no gains make the system stable at a finite cost.
    """
    F, G, P = A, B @ np.linalg.solve(R, B.mT), Q
    with np.errstate(all="ignore"):
        for _ in range(40):
            F, G, P = riccati_composition((F, G, P), (F, G, P))
            if np.abs(F).max() < 1e-16:
                return np.linalg.solve(R + B.mT @ P @ B, B.mT @ P @ A)
    raise np.linalg.LinAlgError(
        "no gains stabilise the system at these costs: choose tolerances nearer to each other"
    )
