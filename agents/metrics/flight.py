"""Metrics of flights along a path, from a rollout's truth and estimates."""

import numpy as np

from agents.metrics import at_end, core_of, ended, nees_in, register_metrics, rms, rmse, steps
from agents.metrics.costs import tails
from agents.metrics.metric import described
from agents.rollouts import Rollout
from vessel_gym.tasks.flight import Flight
from vessel_gym.vehicles.puna import airspeed

POSITION = ("x", "y", "h")

METRICS = described(
    "flight",
    steps=steps,
    position_nees=nees_in(*POSITION),
    arrived=ended("arrived"),
    hit=ended("hit an obstacle"),
    position_rmse=rmse("x", "y"),
    height_rmse=rmse("h"),
    velocity_rmse=rmse("north", "east", "climb"),
    bank_rmse=rmse("phi", scale=1e3),
)


def compute(rollout: Rollout) -> dict[str, np.ndarray]:
    """Metrics that have no function of their own, ``(N,)`` by key."""
    core, h, alive = core_of(rollout), rollout.history, rollout.alive
    task = core.task
    cross, above = path_errors(rollout)
    scenario = task.scenario_of(h["reference"][0])
    clearance = task.clearance(h["truth"], task.scenario_of(h["reference"]))
    return {
        "miss": np.hypot(*(at_end(rollout)[:, :2] - task.goal(scenario)[:, :2]).T),
        "cross_track": rms(cross, alive),
        "altitude": rms(above, alive),
        "clearance": _or_nan(np.where(alive, clearance, np.inf).min(0)),
        "energy": _energy(rollout, scenario),
        **tails("off_track", cross, alive, task.TRACK_TOLERANCE),
        "wind_rmse": rms(_wind_error(rollout), alive),
    }


def _energy(rollout: Rollout, scenario: np.ndarray) -> np.ndarray:
    """Relative energy of the propeller ``(N,)``; NaN if the truth does not hold the wind."""
    core, h = core_of(rollout), rollout.history
    forces, names = core.config.world.forces, core.truth_names
    if not set(forces.disturbance.names) <= set(names):
        return np.full(len(rollout.seeds), np.nan)
    z = h["truth"][..., [names.index(name) for name in forces.disturbance.names]]
    state = h["truth"][..., : len(core.vehicle.state_names)]
    wind = forces.on(z, state)[..., len(core.vehicle.increments) : forces.outside]
    power = h["actuators"][1:, :, 0] * airspeed(state, wind)[1:]
    work = np.where(rollout.alive[1:], power, 0.0).sum(0) * core.vehicle.dt
    return np.asarray(work / (core.task.body.cruise[0] * core.task.length_of(scenario)))


def _wind_error(rollout: Rollout) -> np.ndarray:
    """Error of the estimated level wind [m/s] ``(T + 1, N)``; NaN if a filter assumes none."""
    core, h = core_of(rollout), rollout.history
    composition = core.composition
    if not len(composition.estimated):
        return np.full(rollout.alive.shape, np.nan)
    error = composition.flow(h["estimate"]) - composition.flow(core.estimated(h["truth"]))
    return np.hypot(error[..., 0], error[..., 1])


def path_errors(rollout: Rollout) -> tuple[np.ndarray, np.ndarray]:
    """True cross-track error in plan and height above the commanded altitude [m], ``(T + 1, N)``.

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
