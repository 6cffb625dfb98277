"""Metrics of dives, from a rollout's truth and estimates."""

import numpy as np

from agents.metrics import Metric, at_end, core_of, ended, position_nees, register_metrics, rms, rmse, steps
from agents.metrics.costs import off_track, tails
from agents.rollouts import Rollout
from vessel_gym.guidance.dive_path import follow, path_point
from vessel_gym.tasks.dive import Dive

POSITION = ("x", "y", "z")

METRICS = (
    Metric(
        "steps", "Steps", "", "lower", 0, "Steps until the vehicle believed to be there, or the dive was lost.",
        of=steps,
    ),
    Metric(
        "arrived", "Arrived", "%", "higher", 0, "Dives that ended within 0.5 m of the goal.", True, of=ended("arrived")
    ),
    Metric("miss", "Miss distance", "m", "lower", 2, "Distance from the goal at the end of the dive."),
    Metric("cross_track", "Cross-track", "m", "lower", 3, "RMS distance of the truth from the path in plan."),
    Metric("normal", "Path-normal", "m", "lower", 3, "RMS distance across the path in the vertical plane along it."),
    *off_track(2),
    Metric(
        "clearance", "Clearance", "m", "higher", 2,
        "Least height above the depth at which the dive is lost.", cost=True,
    ),
    Metric(
        "energy", "Energy", "", "lower", 2,
        "Energy used, relative to that of covering the path at cruising speed; below 1 for a dive that ended early.",
        cost=True,
    ),
    Metric(
        "position_rmse", "Position", "m", "lower", 3, "RMS error of the estimated position, all of its components.",
        of=rmse(*POSITION),
    ),
    Metric(
        "velocity_rmse", "Velocity", "m/s", "lower", 4, "RMS error of the estimated velocity through the water.",
        of=rmse("u", "v", "w"),
    ),
    Metric(
        "rate_rmse", "Rates", "mrad/s", "lower", 2, "RMS error of the estimated angular velocity.",
        of=rmse("p", "q", "r", scale=1e3),
    ),
    Metric(
        "attitude_rmse", "Attitude", "mrad", "lower", 2, "RMS error of the estimated attitude angles.",
        of=rmse("phi", "theta", "psi", scale=1e3),
    ),
    Metric(
        "current_rmse", "Current", "m/s", "lower", 4, "RMS error of the estimated current.",
        of=rmse("current", "current north", "current east"),
    ),
    position_nees(*POSITION),
)  # fmt: skip


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
        "energy": np.where(alive[1:], task.power(h["actuators"][1:]), 0.0).sum(0) * task.dt / seconds,
    }


def path_errors(rollout: Rollout) -> tuple[np.ndarray, np.ndarray]:
    """Distances [m] of the truth from the path, ``(T + 1, N)`` each: across it in plan, and in the vertical plane."""
    task, h = core_of(rollout).task, rollout.history
    rows = h["truth"].reshape(-1, h["truth"].shape[-1])
    scenario = h["reference"][..., 8:]
    where = follow(task.position(rows).reshape(scenario.shape), scenario, 0.0)
    return where[..., 1], where[..., 2] / np.sqrt(1.0 + where[..., 4] ** 2)


register_metrics(Dive, METRICS, compute)
