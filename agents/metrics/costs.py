"""Costs of an episode to the vehicle's owner, unweighted: wear of its steering, tails of errors."""

import numpy as np

from agents.metrics.metric import core_of, described
from agents.rollouts import Rollout

DEAD_BAND = float(np.deg2rad(0.1))
"""Motion [rad] back from a turning point that is no reversal yet, but numerical noise."""
_NEAR = 1e-6  # of the way between the limits of a step: actions are float32


def _steering(rollout: Rollout) -> np.ndarray:
    """Actuators that steer [rad], ``(T + 1, N, a)``; after an episode's end they rest."""
    last = np.minimum(np.arange(len(rollout.alive))[:, None], rollout.length)
    actuators = np.take_along_axis(rollout.history["actuators"], last[..., None], axis=0)
    return actuators[..., list(core_of(rollout).vehicle.steering)]


def _minutes(rollout: Rollout) -> np.ndarray:
    """Duration of each episode [min], ``(N,)``."""
    return rollout.length * core_of(rollout).vehicle.dt / 60.0


def _travel(rollout: Rollout) -> np.ndarray:
    moved = np.abs(np.diff(_steering(rollout), axis=0)).sum((0, 2))
    return np.rad2deg(moved) / _minutes(rollout)


def _reversals(rollout: Rollout) -> np.ndarray:
    return turning_points(_steering(rollout), DEAD_BAND).sum(-1) / _minutes(rollout)


def turning_points(values: np.ndarray, dead_band: float) -> np.ndarray:
    """Numbers of changes of direction over the first axis of ``(T, ...)``.

    A change counts once the value has gone back by more than the dead band from its last extreme.
    """
    extreme, direction, count = values[0], np.zeros(values.shape[1:]), np.zeros(values.shape[1:])
    for value in values[1:]:
        moved = value - extreme
        turned = (np.abs(moved) > dead_band) & (np.sign(moved) != direction)
        count += turned & (direction != 0.0)
        direction = np.where(turned, np.sign(moved), direction)
        extreme = np.where(turned | (moved * direction > 0.0), value, extreme)
    return count


def _saturation(rollout: Rollout) -> np.ndarray:
    """Share of steps [%] after which an actuator is at the limit of what the step allowed."""
    vehicle, actuators = core_of(rollout).vehicle, rollout.history["actuators"]
    steering, lived = list(vehicle.steering), rollout.alive[1:]
    before = np.where(lived[..., None], actuators[:-1], actuators[:1])
    rows = before.reshape(-1, before.shape[-1])
    most = np.ones((len(rows), len(vehicle.action_names)))
    low, high = (
        vehicle.actuate(rows, action).reshape(before.shape)[..., steering]
        for action in (-most, most)
    )
    after, near = actuators[1:][..., steering], _NEAR * (high - low)
    limited = ((after >= high - near) | (after <= low + near)) & (high > low)
    return 100.0 * (limited.any(-1) & lived).sum(0) / rollout.length


STEERING = described(
    "steering", steering_travel=_travel, reversals=_reversals, saturation=_saturation
)
"""What steering costs any vehicle whose ``steering`` says which of its actuators steer."""


def tails(
    name: str, error: np.ndarray, alive: np.ndarray, margin: float, scale: float = 1.0
) -> dict[str, np.ndarray]:
    """Tails of errors ``(T, N)`` by key: 95th percentile, maximum, share of time beyond the margin.

    Args:
        name: Of the error, with which the first two keys begin.
        error: Of either sign.
        alive: Mask of the times that count, ``(T, N)``.
        margin: In the error's unit.
        scale: The metric's units in one of the error.
    """
    size = np.where(alive, np.abs(error), np.nan)
    return {
        f"{name}_95": scale * np.nanpercentile(size, 95.0, axis=0),
        f"{name}_max": scale * np.nanmax(size, axis=0),
        "outside": 100.0 * (size > margin).sum(0) / alive.sum(0),
    }
