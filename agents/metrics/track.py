"""Metrics of turns on a track, from a rollout's truth and estimates."""

import numpy as np

from agents.metrics import Metric, core_of, position_nees, register_metrics, rms, rmse
from agents.metrics.turning import CIRCLE, ESTIMATES, TURN_STEPS, circle_fit, input_error
from agents.rollouts import Rollout
from vessel_gym.tasks.circle_track import CircleTrack

METRICS = (
    TURN_STEPS,
    Metric("track_error", "Off track", "m", "lower", 1, "RMS distance of the true ship from the track."),
    *CIRCLE,
    Metric("roll", "Roll", "°", "lower", 2, "RMS roll of the true ship."),
    Metric(
        "position_rmse", "Position", "m", "lower", 2, "RMS error of the estimated position, all of its components.",
        of=rmse("x", "y"),
    ),
    Metric(
        "current_rmse", "Current", "m/s", "lower", 3,
        "RMS error of the estimated current, for which filters also take the leeway.",
        of=rmse("current north", "current east"),
    ),
    *ESTIMATES,
    position_nees("x", "y"),
)  # fmt: skip


def compute(rollout: Rollout) -> dict[str, np.ndarray]:
    """Metrics that have no function of their own, ``(N,)`` by key.

    The unknown input is NaN where none is estimated, and so is the circle of an episode that flew less than half of it.
    """
    core = core_of(rollout)
    h, alive, names = rollout.history, rollout.alive, core.vehicle.state_names
    scenario = core.task.scenario_of(h["reference"][0])
    place = h["truth"][..., [names.index("x"), names.index("y")]]
    radius_error, out_of_round = circle_fit(rollout, 1.0 / np.abs(scenario[:, 2]))
    return {
        "track_error": rms(core.task.off_track(scenario, place), alive),
        "radius_error": radius_error,
        "out_of_round": out_of_round,
        "rudder_rate": np.rad2deg(rms(np.diff(h["actuators"][..., 0], axis=0) / core.vehicle.dt, alive[1:])),
        "roll": np.rad2deg(rms(h["truth"][..., names.index("phi")], alive)),
        "input_rmse": 1e3 * input_error(rollout),
    }


register_metrics(CircleTrack, METRICS, compute)
