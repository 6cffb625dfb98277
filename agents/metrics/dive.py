"""Metrics of dives, from a rollout's truth and estimates."""

import numpy as np

from agents.metrics import at_end, core_of, ended, nees_in, register_metrics, rms, rmse, steps
from agents.metrics.costs import tails
from agents.metrics.metric import described
from agents.rollouts import Rollout
from vessel_gym.guidance.dive_path import follow, path_point
from vessel_gym.tasks.dive import Dive

POSITION = ("x", "y", "z")

METRICS = described(
    "dive",
    steps=steps,
    position_nees=nees_in(*POSITION),
    arrived=ended("arrived"),
    position_rmse=rmse(*POSITION),
    velocity_rmse=rmse("u", "v", "w"),
    rate_rmse=rmse("p", "q", "r", scale=1e3),
    attitude_rmse=rmse("phi", "theta", "psi", scale=1e3),
    current_rmse=rmse("current", "current north", "current east"),
)


def compute(rollout: Rollout) -> dict[str, np.ndarray]:
    """Metrics that have no function of their own, ``(N,)`` by key."""
    task, h, alive = core_of(rollout).task, rollout.history, rollout.alive
    cross, normal = path_errors(rollout)
    scenario = h["reference"][0, :, 8:]
    clearance = scenario[:, 2] + task.margin - task.position(h["truth"])[..., 2]
    goal = path_point(scenario[:, 1], scenario)[:, :3]
    seconds = np.hypot(scenario[:, 1], scenario[:, 2]) / task.auv.cruise_speed
    return {
        "miss": np.linalg.norm(task.position(at_end(rollout)) - goal, axis=-1),
        "cross_track": rms(cross, alive),
        "normal": rms(normal, alive),
        "clearance": np.where(alive, clearance, np.inf).min(0),
        **tails("off_track", np.hypot(cross, normal), alive, task.TRACK_TOLERANCE),
        "energy": (
            np.where(alive[1:], task.power(h["actuators"][1:]), 0.0).sum(0) * task.dt / seconds
        ),
    }


def path_errors(rollout: Rollout) -> tuple[np.ndarray, np.ndarray]:
    """Distances [m] of the truth from the path ``(T + 1, N)``: in plan, and vertically."""
    task, h = core_of(rollout).task, rollout.history
    rows = h["truth"].reshape(-1, h["truth"].shape[-1])
    scenario = h["reference"][..., 8:]
    where = follow(task.position(rows).reshape(scenario.shape), scenario, 0.0)
    return where[..., 1], where[..., 2] / np.sqrt(1.0 + where[..., 4] ** 2)


register_metrics(Dive, METRICS, compute)
