"""Simulated against measured trials: errors some time ahead and over a whole run, beside simpler models."""

from collections.abc import Callable

import numpy as np

from vessel_gym.identification.nomoto import Nomoto
from vessel_gym.identification.prediction import simulate
from vessel_gym.identification.trial import Trial
from vessel_gym.vehicles.measured_ship import MeasuredShip

Predict = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""States ``(T + 1, B, 6)`` from initial ones ``(B, 6)``, control ``(T, B, 2)`` and air ``(T, B, 4)``."""


def predictors(ship: MeasuredShip, dt: float, nomoto: dict[str, Nomoto]) -> dict[str, Predict]:
    """The identified model, also without wind; Nomoto's models at constant speed; a ship that goes on turning."""
    p, c = ship.particulars.vector(), ship.coefficients

    def model(state: np.ndarray, control: np.ndarray, air: np.ndarray) -> np.ndarray:
        return simulate(state, control, air, c, p, dt)

    def calm(state: np.ndarray, control: np.ndarray, air: np.ndarray) -> np.ndarray:
        return simulate(state, control, np.zeros_like(air), c, p, dt)

    def constant(state: np.ndarray, control: np.ndarray, air: np.ndarray) -> np.ndarray:
        return _carried(state, np.broadcast_to(state[..., 5], (len(control) + 1, *state.shape[:-1])), dt)

    def steered(by: Nomoto) -> Predict:
        return lambda state, control, air: _carried(state, by.yaw_rate(state[..., 5], control[..., 0], dt), dt)

    return {
        "identified model": model, "without wind": calm, **{name: steered(by) for name, by in nomoto.items()},
        "goes on as it goes": constant,
    }  # fmt: skip


def _carried(state: np.ndarray, yaw_rate: np.ndarray, dt: float) -> np.ndarray:
    """States of a ship that keeps her velocity and turns at these rates ``(T + 1, B)``."""
    middle = 0.5 * (yaw_rate[1:] + yaw_rate[:-1]) * dt
    psi = state[..., 2] + np.concatenate([np.zeros_like(yaw_rate[:1]), np.cumsum(middle, 0)])
    u, v = state[..., 3], state[..., 4]
    halfway = 0.5 * (psi[1:] + psi[:-1])
    moved = np.stack([u * np.cos(halfway) - v * np.sin(halfway), u * np.sin(halfway) + v * np.cos(halfway)], -1) * dt
    position = state[..., :2] + np.concatenate([np.zeros_like(moved[:1]), np.cumsum(moved, 0)])
    velocity = np.broadcast_to(state[..., 3:5], (*psi.shape, 2))
    return np.concatenate([position, psi[..., None], velocity, yaw_rate[..., None]], -1)


def ahead(predict: Predict, trial: Trial, length: float, seconds: float) -> tuple[float, float]:
    """RMS error of heading [rad] and position [lengths] some time ahead of every second moment; NaN of short trials."""
    steps, every = round(seconds / trial.dt), max(1, round(2.0 / trial.dt))
    starts = np.arange(0, len(trial) - steps + 1, every)
    if len(starts) == 0:
        return np.nan, np.nan
    control, air = (np.stack([a[i : i + steps] for i in starts], 1) for a in (trial.control, trial.air))
    error = predict(trial.states[starts], control, air)[-1] - trial.states[starts + steps]
    return float(np.sqrt((error[:, 2] ** 2).mean())), float(np.sqrt((error[:, :2] ** 2).sum(-1).mean())) / length


def whole(predict: Predict, trial: Trial) -> float:
    """RMS error of the yaw rate over a whole run, simulated from its first state, over the RMS of the yaw rate."""
    states = predict(trial.states[:1], trial.control[:, None], trial.air[:, None])[:, 0]
    rate = trial.states[:, 5]
    return float(np.sqrt(((states[:, 5] - rate) ** 2).mean() / (rate**2).mean()))
