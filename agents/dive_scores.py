"""What a dive was like: figures of each episode, from a rollout's truth and estimates."""

from typing import Any

import numpy as np

from agents.metrics import NEES, RETURN, SCORE, UNHEALTHY, Metric, common, core_of, mean_nees, rms
from agents.rollouts import Rollout
from estimators.angles import difference
from vessel_gym.guidance.dive_path import follow, path_point

METRICS = (
    SCORE,
    RETURN,
    Metric("steps", "Steps", "", "lower", 0, "Steps until the vehicle believed to be there, or the dive was lost."),
    Metric("arrived", "Arrived", "%", "higher", 0, "Dives that ended within 0.5 m of the goal.", True),
    Metric("miss", "Miss distance", "m", "lower", 2, "Distance from the goal at the end of the dive."),
    Metric("cross_track", "Cross-track", "m", "lower", 3, "RMS distance of the truth from the path in plan."),
    Metric("normal", "Path-normal", "m", "lower", 3, "RMS distance across the path in the vertical plane along it."),
    Metric(
        "energy", "Energy", "", "lower", 2,
        "Energy used, relative to that of covering the path at cruising speed; below 1 for a dive that ended early.",
    ),
    Metric("position_rmse", "Position", "m", "lower", 3, "RMS error of the estimated position, all of its components."),
    Metric("velocity_rmse", "Velocity", "m/s", "lower", 4, "RMS error of the estimated velocity through the water."),
    Metric("rate_rmse", "Rates", "mrad/s", "lower", 2, "RMS error of the estimated angular velocity."),
    Metric("attitude_rmse", "Attitude", "mrad", "lower", 2, "RMS error of the estimated attitude angles."),
    Metric("current_rmse", "Current", "m/s", "lower", 4, "RMS error of the estimated current."),
    Metric("position_nees", "Position NEES/n", "", "near 1", 2, "The same as NEES/n, for the position alone."),
    NEES,
    UNHEALTHY,
)  # fmt: skip

_KINDS = {
    "position_rmse": ("x", "y", "z"),
    "velocity_rmse": ("u", "v", "w"),
    "rate_rmse": ("p", "q", "r"),
    "attitude_rmse": ("phi", "theta", "psi"),
    "current_rmse": ("current", "current north", "current east"),
}
_MILLI = ("rate_rmse", "attitude_rmse")


def scores(rollout: Rollout) -> dict[str, np.ndarray]:
    """Every metric of every episode, ``(N,)`` by key; see `agents.scores.scores`."""
    core, h, alive = core_of(rollout), rollout.history, rollout.alive
    task, vehicle = core.task, core.vehicle
    error = difference(h["estimate"], h["truth"], core.filter.model.state_angles)
    squares = {key: (error[..., components(vehicle, key)] ** 2).sum(-1) for key in _KINDS}
    cross, normal = path_errors(rollout)
    course = h["reference"][0, :, 8:]
    goal = path_point(course[:, 1], course)[:, :3]
    last = h["truth"][rollout.length, np.arange(len(course))]
    seconds = np.hypot(course[:, 1], course[:, 2]) / task.auv.cruise_speed
    return (
        common(rollout)
        | {
            "arrived": 100.0 * (rollout.end == "arrived"),
            "miss": np.linalg.norm(task.position(last) - goal, axis=-1),
            "cross_track": rms(cross, alive),
            "normal": rms(normal, alive),
            "energy": np.where(alive[1:], task.power(h["actuators"][1:]), 0.0).sum(0) * task.dt / seconds,
            "position_nees": mean_nees(rollout, components(vehicle, "position_rmse")),
        }
        | {key: rms(np.sqrt(square), alive) * (1e3 if key in _MILLI else 1.0) for key, square in squares.items()}
    )


def components(vehicle: Any, kind: str) -> tuple[int, ...]:
    """Which components of a vehicle's state are of a kind: ``"position_rmse"`` and so on."""
    return tuple(i for i, name in enumerate(vehicle.truth_names) if name in _KINDS[kind])


def path_errors(rollout: Rollout) -> tuple[np.ndarray, np.ndarray]:
    """Distances [m] of the truth from the path, ``(T + 1, N)`` each: across it in plan, and in the vertical plane."""
    task, h = core_of(rollout).task, rollout.history
    rows = h["truth"].reshape(-1, h["truth"].shape[-1])
    course = h["reference"][..., 8:]
    where = follow(task.position(rows).reshape(course.shape), course, 0.0)
    return where[..., 1], where[..., 2] / np.sqrt(1.0 + where[..., 4] ** 2)
