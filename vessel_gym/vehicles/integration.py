"""Fourth-order Runge-Kutta integration of all equations of motion."""

import math
from collections.abc import Callable

import numpy as np

from estimators.engine import Compiled, compiled

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
    for i in range(substeps):
        shares = i / substeps, (i + 0.5) / substeps, (i + 1) / substeps
        state = part(state, before, change, flow, c, dt / substeps, shares, rates=rates)
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
    h: float, shares: tuple[float, float, float], *, rates: Rates,
) -> np.ndarray:  # fmt: skip
    """One substep of length ``h``.

    ``shares`` of the actuators' change have passed at its start, middle and end.
    """
    start, middle, end = (before + share * change for share in shares)
    k1 = rates(state, start, flow, c)
    k2 = rates(state + 0.5 * h * k1, middle, flow, c)
    k3 = rates(state + 0.5 * h * k2, middle, flow, c)
    k4 = rates(state + h * k3, end, flow, c)
    return state + h / 6.0 * k1 + h / 3.0 * k2 + h / 3.0 * k3 + h / 6.0 * k4
