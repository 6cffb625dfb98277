"""Metrics of flights along a path, from a rollout's truth and estimates."""

import numpy as np

from agents.metrics import Metric, at_end, core_of, ended, position_nees, register_metrics, rms, rmse, steps
from agents.rollouts import Rollout
from vessel_gym.tasks.flight import Flight

POSITION = ("x", "y", "h")

METRICS = (
    Metric(
        "steps", "Steps", "", "lower", 0, "Steps until the aircraft believed to be there, or the flight was lost.",
        of=steps,
    ),
    Metric(
        "arrived", "Arrived", "%", "higher", 0, "Flights that ended within 8 m of the goal.", True, of=ended("arrived")
    ),
    Metric("hit", "Hit", "%", "lower", 0, "Flights that ended in an obstacle.", True, of=ended("hit an obstacle")),
    Metric("miss", "Miss distance", "m", "lower", 2, "Distance from the goal in plan at the end of the flight."),
    Metric("cross_track", "Cross-track", "m", "lower", 2, "RMS distance of the truth from the path in plan."),
    Metric("altitude", "Altitude", "m", "lower", 3, "RMS error of the true altitude against the commanded one."),
    Metric("clearance", "Clearance", "m", "higher", 1, "Least distance of the truth from the edge of an obstacle."),
    Metric("effort", "Effort", "", "lower", 4, "RMS change of the commands in a step, as a share of their range."),
    Metric(
        "position_rmse", "Position", "m", "lower", 3, "RMS error of the estimated position in plan.", of=rmse("x", "y")
    ),
    Metric("height_rmse", "Height", "m", "lower", 3, "RMS error of the estimated altitude.", of=rmse("h")),
    Metric(
        "velocity_rmse", "Velocity", "m/s", "lower", 3, "RMS error of the estimated velocity over ground.",
        of=rmse("north", "east", "climb"),
    ),
    Metric("bank_rmse", "Bank", "mrad", "lower", 2, "RMS error of the estimated bank.", of=rmse("phi", scale=1e3)),
    Metric("wind_rmse", "Wind", "m/s", "lower", 3, "RMS error of the estimated level wind, gusts included."),
    position_nees(*POSITION),
)  # fmt: skip


def compute(rollout: Rollout) -> dict[str, np.ndarray]:
    """Metrics that have no function of their own, ``(N,)`` by key."""
    core, h, alive = core_of(rollout), rollout.history, rollout.alive
    task = core.task
    cross, above = path_errors(rollout)
    scenario = task.scenario_of(h["reference"][0])
    clearance = task.clearance(h["truth"], task.scenario_of(h["reference"]))
    commands = task.body.actions(h["actuators"])
    change = np.sqrt(np.mean(np.diff(commands, axis=0) ** 2, axis=-1)) / 2.0
    return {
        "miss": np.hypot(*(at_end(rollout)[:, :2] - task.goal(scenario)[:, :2]).T),
        "cross_track": rms(cross, alive),
        "altitude": rms(above, alive),
        "clearance": _or_nan(np.where(alive, clearance, np.inf).min(0)),
        "effort": rms(change, alive[1:]),
        "wind_rmse": rms(_wind_error(rollout), alive),
    }


def _wind_error(rollout: Rollout) -> np.ndarray:
    """Error of the estimated level wind [m/s], ``(T + 1, N)``; NaN for a filter that assumes none."""
    core, h = core_of(rollout), rollout.history
    composition = core.composition
    if not len(composition.estimated):
        return np.full(rollout.alive.shape, np.nan)
    error = composition.flow(h["estimate"]) - composition.flow(core.estimated(h["truth"]))
    return np.hypot(error[..., 0], error[..., 1])


def path_errors(rollout: Rollout) -> tuple[np.ndarray, np.ndarray]:
    """Cross-track error in plan and height above the commanded altitude [m], of the truth, ``(T + 1, N)`` each.

    The aircraft is looked for near the farthest place it has reached, as in the score.
    """
    task, h = core_of(rollout).task, rollout.history
    scenario = task.scenario_of(h["reference"][0])
    farthest, off = task.initial_score_state(h["truth"][0], scenario)[:, 0], []
    for truth in h["truth"]:
        true = task.track(truth, scenario, farthest)
        farthest = np.maximum(farthest, true[:, 0])
        off.append(true[:, 1])
    return np.stack(off), h["truth"][..., 2] - task.altitude_of(scenario)


def _or_nan(values: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(values), values, np.nan)


register_metrics(Flight, METRICS, compute)
