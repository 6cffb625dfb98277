"""Metrics of dives, from a rollout's truth and estimates."""

import numpy as np

from agents.metrics import ended, register_metrics, rmse
from agents.metrics.costs import tails
from agents.metrics.metric import described, nees_in, once, rms_of
from agents.rollouts import Rollout
from vessel_gym.guidance.dive_path import follow
from vessel_gym.tasks.dive import Dive

POSITION = ("x", "y", "z")


@once
def path_errors(rollout: Rollout) -> tuple[np.ndarray, np.ndarray]:
    """Distances [m] of the truth from the path ``(T + 1, N)``: in plan, and vertically."""
    position = rollout.config.system.task.position(rollout.history["truth"])
    where = follow(position, rollout.scenario, 0.0)
    return where[..., 1], where[..., 2] / np.sqrt(1.0 + where[..., 4] ** 2)


def _clearance(rollout: Rollout) -> np.ndarray:
    task = rollout.config.system.task
    bottom = rollout.scenario[:, 2] + task.margin
    return (bottom - task.position(rollout.history["truth"])[..., 2]).min(0)


def _energy(rollout: Rollout) -> np.ndarray:
    task, (_, length, depth, _) = rollout.config.system.task, rollout.scenario.T
    power = task.power(rollout.history["actuators"][1:])
    seconds = np.hypot(length, depth) / task.auv.cruise_speed
    return power.sum(0, where=rollout.alive[1:]) * task.dt / seconds


METRICS = described(
    "dive",
    arrived=ended("arrived"),
    cross_track=rms_of(lambda rollout: path_errors(rollout)[0]),
    normal=rms_of(lambda rollout: path_errors(rollout)[1]),
    **tails(
        "off_track", lambda rollout: np.hypot(*path_errors(rollout)), lambda t: t.TRACK_TOLERANCE
    ),
    clearance=_clearance,
    energy=_energy,
    position_rmse=rmse(*POSITION),
    velocity_rmse=rmse("u", "v", "w"),
    rate_rmse=rmse("p", "q", "r", scale=1e3),
    attitude_rmse=rmse("phi", "theta", "psi", scale=1e3),
    current_rmse=rmse("current", "current north", "current east"),
    position_nees=nees_in(*POSITION),
)
register_metrics(Dive, METRICS)
