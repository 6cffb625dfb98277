"""Simulation of a ship over windows of its trials, with exact derivatives by coefficients and initial state."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vessel_gym.identification.trial import Trial
from vessel_gym.vehicles.manoeuvring import STATE, rates, rates_and_slopes

_N = len(STATE)


@dataclass(frozen=True, eq=False)
class Windows:
    """Windows of one length, as a batch.

    Attributes:
        states: ``(T + 1, B, 6)`` measured.
        control: ``(T, B, 2)``.
        air: ``(T, B, 4)``.
        block: ``(B,)`` number of the part of the log that a window lies in: windows of other blocks share no data.
        dt: Time step [s].
    """

    states: np.ndarray
    control: np.ndarray
    air: np.ndarray
    block: np.ndarray
    dt: float


def windows(trials: Sequence[Trial], steps: int, block_steps: int) -> Windows | None:
    """Consecutive windows of ``steps`` in blocks of ``block_steps``; None if every trial is shorter."""
    parts, block, blocks = [], [], 0
    for trial in trials:
        for first in range(0, len(trial) - steps + 1, steps):
            parts.append(trial.part(first, first + steps))
            block.append(blocks + first // block_steps)
        blocks += 1 + len(trial) // block_steps
    if not parts:
        return None
    states, control, air = (np.stack([getattr(part, key) for part in parts], 1) for key in ("states", "control", "air"))
    return Windows(states, control, air, np.array(block), trials[0].dt)


def simulate(
    state: np.ndarray, control: np.ndarray, air: np.ndarray, c: np.ndarray, p: np.ndarray, dt: float
) -> np.ndarray:
    """States ``(T + 1, ..., 6)`` from ``state (..., 6)``, by the midpoint rule.

    Args:
        state: Initial state ``(..., 6)``.
        control: ``(T, ..., 2)``, constant over each step.
        air: ``(T, ..., 4)``, likewise.
        c: Coefficients ``(k,)`` or ``(..., k)``.
        p: `Particulars.vector`.
        dt: Time step [s].
    """
    states = [state]
    for u, w in zip(control, air, strict=True):
        middle = state + 0.5 * dt * rates(state, u, w, c, p)
        state = state + dt * rates(middle, u, w, c, p)
        states.append(state)
    return np.stack(states)


def simulate_with_slopes(
    state: np.ndarray, control: np.ndarray, air: np.ndarray, c: np.ndarray, p: np.ndarray, dt: float, every: int
) -> tuple[np.ndarray, np.ndarray]:
    """States ``(T // every, B, 6)`` of each ``every``-th step, and derivatives ``(T // every, B, 6, 6 + k)``.

    The derivatives are by the initial state and by the coefficients, of the midpoint rule itself, exact to rounding.
    """
    slopes = np.zeros((len(state), _N, _N + len(c)))
    slopes[:, :, :_N] = np.eye(_N)
    states, derivatives = [], []

    def change(state: np.ndarray, slopes: np.ndarray, k: int) -> tuple[np.ndarray, np.ndarray]:
        found = rates_and_slopes(state, control[k], air[k], c, p)
        changing = found[:, :, 1 : 1 + _N] @ slopes
        changing[:, :, _N:] += found[:, :, 1 + _N :]
        return found[:, :, 0], changing

    for k in range(len(control)):
        rate, changing = change(state, slopes, k)
        rate, changing = change(state + 0.5 * dt * rate, slopes + 0.5 * dt * changing, k)
        state, slopes = state + dt * rate, slopes + dt * changing
        if (k + 1) % every == 0:
            states.append(state)
            derivatives.append(slopes)
    return np.stack(states), np.stack(derivatives)
