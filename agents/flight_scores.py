"""What a flight along a path was like: figures of each episode, from a rollout's truth and estimates."""

from typing import Any

import numpy as np

from agents.metrics import NEES, RETURN, SCORE, UNHEALTHY, Metric, common, core_of, mean_nees, rms
from agents.rollouts import Rollout
from estimators.angles import difference

METRICS = (
    SCORE,
    RETURN,
    Metric("steps", "Steps", "", "lower", 0, "Steps until the aircraft believed to be there, or the flight was lost."),
    Metric("arrived", "Arrived", "%", "higher", 0, "Flights that ended within 8 m of the goal.", True),
    Metric("hit", "Hit", "%", "lower", 0, "Flights that ended in an obstacle.", True),
    Metric("miss", "Miss distance", "m", "lower", 2, "Distance from the goal in plan at the end of the flight."),
    Metric("cross_track", "Cross-track", "m", "lower", 2, "RMS distance of the truth from the path in plan."),
    Metric("altitude", "Altitude", "m", "lower", 3, "RMS error of the true altitude against the commanded one."),
    Metric("clearance", "Clearance", "m", "higher", 1, "Least distance of the truth from the edge of an obstacle."),
    Metric("effort", "Effort", "", "lower", 4, "RMS change of the commands in a step, as a share of their range."),
    Metric("position_rmse", "Position", "m", "lower", 3, "RMS error of the estimated position in plan."),
    Metric("height_rmse", "Height", "m", "lower", 3, "RMS error of the estimated altitude."),
    Metric("velocity_rmse", "Velocity", "m/s", "lower", 3, "RMS error of the estimated velocity over ground."),
    Metric("bank_rmse", "Bank", "mrad", "lower", 2, "RMS error of the estimated bank."),
    Metric("wind_rmse", "Wind", "m/s", "lower", 3, "RMS error of the estimated level wind, gusts included."),
    Metric("position_nees", "Position NEES/n", "", "near 1", 2, "The same as NEES/n, for the position alone."),
    NEES,
    UNHEALTHY,
)  # fmt: skip

_KINDS = {
    "position_rmse": ("x", "y"),
    "height_rmse": ("h",),
    "velocity_rmse": ("north", "east", "climb"),
    "bank_rmse": ("phi",),
}
POSITION = ("x", "y", "h")


def scores(rollout: Rollout) -> dict[str, np.ndarray]:
    """Every metric of every episode, ``(N,)`` by key; see `agents.scores.scores`."""
    core, h, alive = core_of(rollout), rollout.history, rollout.alive
    task, vehicle = core.task, core.vehicle
    error = difference(h["estimate"], h["truth"], core.filter.model.state_angles)
    cross, above = path_errors(rollout)
    course = task.course_of(h["reference"][0])
    rows = np.arange(len(course))
    last = h["truth"][rollout.length, rows]
    clearance = task.clearance(h["truth"], task.course_of(h["reference"]))
    commands = task.body.actions(h["actuators"])
    change = np.sqrt(np.mean(np.diff(commands, axis=0) ** 2, axis=-1)) / 2.0
    wind = np.hypot(error[..., 7] + error[..., 9], error[..., 8] + error[..., 10])
    squares = {key: (error[..., components(vehicle, names)] ** 2).sum(-1) for key, names in _KINDS.items()}
    return (
        common(rollout)
        | {
            "arrived": 100.0 * (rollout.end == "arrived"),
            "hit": 100.0 * (rollout.end == "hit an obstacle"),
            "miss": np.hypot(*(last[:, :2] - task.goal(course)[:, :2]).T),
            "cross_track": rms(cross, alive),
            "altitude": rms(above, alive),
            "clearance": _or_nan(np.where(alive, clearance, np.inf).min(0)),
            "effort": rms(change, alive[1:]),
            "wind_rmse": rms(wind, alive),
            "position_nees": mean_nees(rollout, components(vehicle, POSITION)),
        }
        | {key: rms(np.sqrt(square), alive) * (1e3 if key == "bank_rmse" else 1.0) for key, square in squares.items()}
    )


def components(vehicle: Any, names: tuple[str, ...]) -> tuple[int, ...]:
    """Which components of a vehicle's state have these names."""
    return tuple(vehicle.truth_names.index(name) for name in names)


def path_errors(rollout: Rollout) -> tuple[np.ndarray, np.ndarray]:
    """How far the truth is from the path in plan, and above the commanded altitude [m]: ``(T + 1, N)`` each.

    The aircraft is looked for near the farthest place it has reached, as in the score.
    """
    task, h = core_of(rollout).task, rollout.history
    course = task.course_of(h["reference"][0])
    farthest, off = task.begin(h["truth"][0], course)[:, 0], []
    for truth in h["truth"]:
        true = task.track(truth, course, farthest)
        farthest = np.maximum(farthest, true[:, 0])
        off.append(true[:, 1])
    return np.stack(off), h["truth"][..., 2] - task.altitude_of(course)


def _or_nan(values: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(values), values, np.nan)
