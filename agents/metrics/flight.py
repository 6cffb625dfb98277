"""Metrics of flights along a path, from a rollout's truth and estimates."""

import numpy as np

from agents.metrics import ended, register_metrics, rmse
from agents.metrics.costs import tails
from agents.metrics.metric import described, nees_in, once, rms_of
from agents.rollouts import Rollout
from vessel_gym.tasks.flight import ALTITUDE, LENGTH, Flight
from vessel_gym.vehicles.puna import airspeed

POSITION = ("x", "y", "h")


@once
def path_errors(rollout: Rollout) -> tuple[np.ndarray, np.ndarray]:
    """True cross-track error in plan and height above the commanded altitude [m], ``(T + 1, N)``.

    The aircraft is looked for near the farthest place it has reached, as in the score.
    """
    task, scenario = rollout.config.system.task, rollout.scenario
    truth = rollout.history["truth"]
    farthest, off = task.initial_score_state(truth[0], scenario)[:, 0], []
    for state in truth:
        true = task.track(state, scenario, farthest)
        farthest = np.maximum(farthest, true[:, 0])
        off.append(true[:, 1])
    return np.stack(off), truth[..., 2] - scenario[:, ALTITUDE]


def _clearance(rollout: Rollout) -> np.ndarray:
    """Least distance from an obstacle [m]; NaN where there is none."""
    task, truth = rollout.config.system.task, rollout.history["truth"]
    least = task.clearance(truth, rollout.scenario).min(0)
    return np.where(np.isfinite(least), least, np.nan)


def _energy(rollout: Rollout) -> np.ndarray | None:
    """Relative energy of the propeller ``(N,)``; None if the truth does not hold the wind."""
    config, h = rollout.config, rollout.history
    space, names = config.world.space, config.true_state.names
    task, vehicle = config.system.task, config.system.vehicle
    if not set(space.disturbance.names) <= set(names):
        return None
    z = h["truth"][..., [names.index(name) for name in space.disturbance.names]]
    state = h["truth"][..., : len(vehicle.state_names)]
    acting = space.exogenous(space.disturbance.effect(z, state), h["actuators"])
    wind = acting[..., space.flows]
    power = h["actuators"][1:, :, 0] * airspeed(state, wind)[1:]
    work = power.sum(0, where=rollout.alive[1:]) * vehicle.dt
    return work / (task.body.cruise[0] * rollout.scenario[:, LENGTH])


METRICS = described(
    "flight",
    arrived=ended("arrived"),
    hit=ended("hit an obstacle"),
    cross_track=rms_of(lambda rollout: path_errors(rollout)[0]),
    altitude=rms_of(lambda rollout: path_errors(rollout)[1]),
    **tails("off_track", lambda rollout: path_errors(rollout)[0], lambda t: t.TRACK_TOLERANCE),
    clearance=_clearance,
    energy=_energy,
    position_rmse=rmse("x", "y"),
    height_rmse=rmse("h"),
    velocity_rmse=rmse("north", "east", "climb"),
    bank_rmse=rmse("phi", scale=1e3),
    position_nees=nees_in(*POSITION),
)
register_metrics(Flight, METRICS)
