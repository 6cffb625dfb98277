"""Costs of an episode to the vehicle's owner, unweighted: wear of its steering, tails of errors."""

from collections.abc import Callable
from typing import Any

import numpy as np

from agents.metrics.metric import PerEpisode, described, once
from agents.rollouts import Rollout

DEAD_BAND = float(np.deg2rad(0.1))
"""Motion [rad] back from a turning point that is no reversal yet, but numerical noise."""
_NEAR = 1e-6  # of the way between the limits of a step: actions are float32


def _steering(rollout: Rollout) -> np.ndarray:
    """Actuators that steer [rad], ``(T + 1, N, a)``; after an episode's end they rest."""
    return rollout.history["actuators"][..., list(rollout.config.system.vehicle.steering)]


def _minutes(rollout: Rollout) -> np.ndarray:
    """Duration of each episode [min], ``(N,)``."""
    return rollout.length * rollout.config.system.vehicle.dt / 60.0


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
    vehicle, actuators = rollout.config.system.vehicle, rollout.history["actuators"]
    rows = actuators[:-1].reshape(-1, actuators.shape[-1])
    most = np.ones((len(rows), len(vehicle.action_names)))
    after, low, high = (
        each.reshape(actuators[1:].shape)[..., list(vehicle.steering)]
        for each in (actuators[1:], *(vehicle.actuate(rows, action) for action in (-most, most)))
    )
    near = _NEAR * (high - low)
    limited = ((after >= high - near) | (after <= low + near)) & (high > low)
    return 100.0 * limited.any(-1).mean(0, where=rollout.alive[1:])


STEERING = described(
    "steering", steering_travel=_travel, reversals=_reversals, saturation=_saturation
)
"""What steering costs any vehicle whose ``steering`` says which of its actuators steer."""


def tails(
    name: str,
    error: Callable[[Rollout], np.ndarray],
    margin: Callable[[Any], float],
    scale: float = 1.0,
) -> dict[str, PerEpisode]:
    """Tails of an error by key: 95th percentile, maximum, share of time beyond the margin.

    Args:
        name: Name of the error, with which the first two keys begin.
        error: Function of a rollout: ``(T + 1, N)``, of either sign.
        margin: Function of the task, in the error's unit.
        scale: Factor from the error's unit to the metric's unit.
    """

    @once
    def size(rollout: Rollout) -> np.ndarray:
        return np.where(rollout.alive, np.abs(error(rollout)), np.nan)

    def outside(rollout: Rollout) -> np.ndarray:
        beyond = size(rollout) > margin(rollout.config.system.task)
        return 100.0 * beyond.mean(0, where=rollout.alive)

    return {
        f"{name}_95": lambda rollout: scale * np.nanpercentile(size(rollout), 95.0, axis=0),
        f"{name}_max": lambda rollout: scale * np.nanmax(size(rollout), axis=0),
        "outside": outside,
    }
